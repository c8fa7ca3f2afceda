"""Bad input: it builds with its defects reported, or is refused in one clear line."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from svprep.cache.verify import verify
from svprep.cli import run
from tests.dataset.datasets import (
    DATA,
    REFUSED_SHARED,
    SHARED,
    is_readable,
    label,
    manifest,
    shared_files,
)


def build_line(
    path: Path, folder: Path, capfd: pytest.CaptureFixture[str], *options: str
) -> tuple[int, str]:
    """Run a build and return its exit status and what it wrote to standard error.

    Checks what holds for any outcome: no traceback, at most one line, a valid
    cache on success and no file at all otherwise.
    """
    cache = folder / "out.svp.h5"
    status = run(["build", str(path), "-o", str(cache), *options])
    error = capfd.readouterr().err
    assert "Traceback" not in error
    if status == 0:
        assert error == ""
        assert verify(cache) == []
    else:
        assert error.count("\n") == 1
        assert error.startswith("svprep: ")
        assert list(folder.iterdir()) == []
    return status, error


@pytest.mark.parametrize("path", shared_files(), ids=label)
def test_shared_file(path: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    status, error = build_line(path, tmp_path, capfd)
    name = label(path)
    if not is_readable(path):
        assert status == 1
        assert path.name in error
        assert "not read yet" in error or "Known: .obj" in error
    elif name in REFUSED_SHARED:
        assert status == 1
        assert path.name in error
        assert REFUSED_SHARED[name] in error
    else:
        assert status == 0, error


def test_shared_files_are_there() -> None:
    if not SHARED.is_dir():
        pytest.skip("../shared/data is absent: its broken and reader files were not tried")
    names = {label(path) for path in shared_files()}
    assert set(REFUSED_SHARED) <= names


REFUSED_OWN = {n: e["expect"]["refused"] for n, e in manifest().items() if "refused" in e["expect"]}


@pytest.mark.parametrize("name", REFUSED_OWN)
def test_own_refused_file(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    status, error = build_line(DATA / name, tmp_path, capfd)
    assert status == 1
    assert Path(name).name in error
    assert REFUSED_OWN[name] in error


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"

BAD_TEXT = {
    "empty.obj": ("", "empty"),
    "no_faces.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "face"),
    "zero.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4"),
    "past_end.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "line 4"),
    "before_start.obj": ("v 0 0 0\nv 1 0 0\nf -1 -2 -3\n", "line 3"),
    "nan.obj": (TRIANGLE + "v nan 0 0\nf 1 2 4\n", "line 5"),
    "infinity.obj": (TRIANGLE + "v inf 0 0\nf 1 2 4\n", "line 5"),
    "overflow.obj": (TRIANGLE + "v 1e999 0 0\nf 1 2 4\n", "line 5"),
    "huge.obj": (TRIANGLE + "v 1e300 0 0\nf 1 2 4\n", "1e+300"),
    "flat.obj": ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "area"),
    "two_numbers.obj": (TRIANGLE + "v 1 2\n", "line 5"),
    "half_a_number.obj": (TRIANGLE + "v 1 2 3e\n", "line 5"),
    "binary.obj": ("\x00\x01\x02\x7fELF" * 50, "binary"),
    "bad.ply": ("ply\nformat ascii 1.0\nelement vertex 3\n", "bad.ply"),
    "bad.stl": ("solid nothing\n", "bad.stl"),
    "bad.off": ("OFF\n3 1 0\n0 0 0\n", "bad.off"),
    "bad.glb": ("glTF????", "bad.glb"),
    "bad.gltf": ("{", "bad.gltf"),
    "bad.obj.gz": ("this is not gzip", "gz"),
    "model.xyz": ("0 0 0\n", "Known: .obj"),
    "model": ("0 0 0\n", "Known: .obj"),
}


@pytest.mark.parametrize("name", BAD_TEXT)
def test_bad_text(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text, expected = BAD_TEXT[name]
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    path = tmp_path / "in" / name
    path.write_bytes(text.encode("latin-1"))
    status, error = build_line(path, tmp_path / "out", capfd)
    assert status == 1
    assert name in error
    assert expected in error


def test_missing_file_and_folder(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").mkdir()
    for path, expected in ((tmp_path / "gone.obj", "gone.obj"), (tmp_path, "folder")):
        status, error = build_line(path, tmp_path / "out", capfd)
        assert status == 1
        assert expected in error


def test_output_that_cannot_be(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "ok.obj"
    model.write_text(TRIANGLE)
    before = model.read_bytes()
    for target in (model, tmp_path, tmp_path / "no" / "such" / "x.svp.h5", f"{tmp_path}/sub/"):
        assert run(["build", str(model), "-o", str(target)]) == 1
        error = capfd.readouterr().err
        assert error.count("\n") == 1
        assert "-o" in error
    assert model.read_bytes() == before
    assert os.listdir(tmp_path) == ["ok.obj"]
