"""Where compiled kernels are kept when their usual places cannot be written to."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import pytest

import svprep.kernels as kernels
from svprep.errors import EnvironmentProblem

CANDIDATES = pytest.mark.parametrize("writable", ["given", "in_tree", "user"])


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """Make every place unwritable, even for root: each is inside a plain file."""
    places = {name: tmp_path / name for name in ("given", "in_tree", "user")}
    for path in places.values():
        path.write_text("")
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("HOME", str(places["user"]))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(places["given"] / "cache"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.delitem(sys.modules, "numba", raising=False)
    return places | {"tmp": tmp_path / "tmp"}


@CANDIDATES
def test_numba_is_left_alone_where_it_has_a_place(places: dict[str, Path], writable: str) -> None:
    places[writable].unlink()
    assert kernels.ensure_cache_dir(places["in_tree"]) is None
    assert os.environ["NUMBA_CACHE_DIR"] == str(places["given"] / "cache")
    assert not list(places["tmp"].iterdir())


def test_else_a_private_temporary_folder_is_used_and_kept(places: dict[str, Path]) -> None:
    folder = kernels.ensure_cache_dir(places["in_tree"])
    assert folder is not None
    assert folder.parent == places["tmp"]
    assert folder.stat().st_mode & 0o077 == 0
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder)
    os.environ["NUMBA_CACHE_DIR"] = ""
    assert kernels.ensure_cache_dir(places["in_tree"]) == folder


@pytest.mark.skipif(os.name == "nt", reason="needs POSIX permissions")
@pytest.mark.parametrize("trap", ["open to all", "link"])
def test_a_folder_that_somebody_else_could_fill_is_not_used(
    places: dict[str, Path], tmp_path: Path, trap: str
) -> None:
    usual = places["tmp"] / f"svprep-numba-{os.getuid()}"
    if trap == "link":
        (tmp_path / "target").mkdir(mode=0o700)
        usual.symlink_to(tmp_path / "target")
    else:
        usual.mkdir()
        usual.chmod(0o777)
    folder = kernels.ensure_cache_dir(places["in_tree"])
    assert folder is not None
    assert folder != usual
    assert folder.parent == places["tmp"]
    assert not list(usual.iterdir())


def test_the_current_folder_is_left_clean_where_it_is_the_last_one(
    places: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(places["tmp"])
    usual = places["tmp"] / f"svprep-numba-{os.getuid()}"
    removed: list[object] = []
    monkeypatch.setattr(kernels.atexit, "register", lambda f, path, **options: removed.append(path))
    assert [kernels.ensure_cache_dir(places["in_tree"])] == removed
    assert not usual.exists()
    monkeypatch.setenv("TMPDIR", str(places["tmp"]))  # one that was named is not the last one
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(places["given"] / "cache"))
    assert kernels.ensure_cache_dir(places["in_tree"]) == usual


def test_without_any_place_the_error_says_what_to_do(
    places: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(places["user"]))
    with pytest.raises(EnvironmentProblem, match=r"Set NUMBA_CACHE_DIR to a folder"):
        kernels.ensure_cache_dir(places["in_tree"])
