"""The wheel, away from the checkout: what it holds, and that it works there."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import svprep

ROOT = Path(__file__).resolve().parents[2]
NO_NETWORK = ("Failed to establish a new connection", "NameResolutionError", "ConnectTimeout")
CUBE = """\
o cube
v 0 0 0
v 4 0 0
v 4 4 0
v 0 4 0
v 0 0 4
v 4 0 4
v 4 4 4
v 0 4 4
f 1 4 3 2
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""


def run(
    *command: str | Path, cwd: Path, env: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command that has to succeed."""
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=env,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    shown = " ".join(map(str, command))
    assert done.returncode == 0, f"{shown}: status {done.returncode}\n{done.stdout}{done.stderr}"
    return done


def clean_environment(**more: str | Path) -> dict[str, str]:
    """Return the environment without what could lead to the checkout or to a Numba cache."""
    dropped = ("PYTHONPATH", "PYTHONHOME", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "VIRTUAL_ENV")
    kept = {name: value for name, value in os.environ.items() if name not in dropped}
    return kept | {name: str(value) for name, value in more.items()}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel; with the build backend that is installed, if it is."""
    out = tmp_path_factory.mktemp("wheel")
    isolation = ["--no-isolation"] if importlib.util.find_spec("hatchling") else []
    run(sys.executable, "-m", "build", "--wheel", *isolation, "--outdir", out, ROOT, cwd=out)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture
def installed(wheel: Path, tmp_path: Path) -> Path:
    """Install the wheel alone in a folder; the running environment has what it needs."""
    target = tmp_path / "installed"
    options = ["--no-deps", "--no-compile", "--quiet", "--disable-pip-version-check", "--no-index"]
    run(sys.executable, "-m", "pip", "install", *options, "--target", target, wheel, cwd=tmp_path)
    return target


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """Make a folder outside the checkout with a small model in it."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "cube.obj").write_text(CUBE)
    conformance = sorted((ROOT / "data" / "conformance").glob("*three*.obj"))
    for source in conformance[:1]:
        (folder / "broken.obj").write_bytes(source.read_bytes())
    return folder


@pytest.fixture
def read_only(installed: Path) -> Iterator[Path]:
    """Take away every folder of the install that Numba could write to.

    A plain file in the place of ``__pycache__`` stops root as well, who may
    write where permissions say no.
    """
    folders = [p for p in (installed, *installed.rglob("*")) if p.is_dir()]
    for folder in folders:
        (folder / "__pycache__").write_text("")
    for folder in folders:
        folder.chmod(0o555)
    yield installed
    for folder in folders:
        folder.chmod(0o755)


def build_and_validate(command: list[str | Path], folder: Path, env: dict[str, str]) -> None:
    assert "build" in run(*command, "--help", cwd=folder, env=env).stdout
    for model in sorted(folder.glob("*.obj")):
        run(*command, "build", model.name, cwd=folder, env=env)
        run(*command, "validate", f"{model.stem}.svp.h5", cwd=folder, env=env)


def draw(command: list[str | Path], folder: Path, env: dict[str, str]) -> None:
    """Draw a cache: shaders come out of the wheel, and a box casts a shadow."""
    view = ["--light", "dir:110,40", "--camera=-9,-12,9,2,2,1", "--size", "96x64"]
    cache = "cube.svp.h5"
    said = run(
        *command, "render", cache, *view, "--mask", "mask.png", "--json", cwd=folder, env=env
    )
    (light,) = json.loads(said.stdout)["lights"]
    assert 0.1 < light["shadow_share"] < 0.9
    for name in ("cube.png", "mask.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")


def test_the_wheel_holds_the_packages_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        metadata = next(name for name in names if name.endswith(".dist-info/METADATA"))
        entry_points = metadata.replace("METADATA", "entry_points.txt")
        assert "svprep = svprep.cli:main" in archive.read(entry_points).decode()
        assert f"Version: {svprep.__version__}" in archive.read(metadata).decode().splitlines()
    tops = {name.partition("/")[0] for name in names if ".dist-info/" not in name}
    assert "svprep" in tops
    assert tops <= {"svprep", "svprep_runtime"}  # never "runtime"
    for package in (ROOT / "svprep", ROOT / "runtime" / "svprep_runtime"):
        files = {p for p in package.rglob("*") if p.is_file() and "__pycache__" not in p.parts}
        assert {p.relative_to(package.parent).as_posix() for p in files} <= names
    assert "svprep/py.typed" in names


def test_the_wheel_works_outside_the_checkout(installed: Path, elsewhere: Path) -> None:
    env = clean_environment(PYTHONPATH=installed)
    code = "import svprep; print(svprep.__file__)"
    where = run(sys.executable, "-c", code, cwd=elsewhere, env=env).stdout
    assert Path(where.strip()).is_relative_to(installed)
    command = [sys.executable, installed / "bin" / "svprep"]
    build_and_validate(command, elsewhere, env)
    draw(command, elsewhere, env)


def test_a_read_only_install_without_a_home_works(
    read_only: Path, elsewhere: Path, tmp_path: Path
) -> None:
    home, temporary = tmp_path / "home", tmp_path / "tmp"
    home.write_text("")  # a file: nobody can make a folder in it
    temporary.mkdir()
    env = clean_environment(PYTHONPATH=read_only, HOME=home, TMPDIR=temporary)
    build_and_validate([sys.executable, read_only / "bin" / "svprep"], elsewhere, env)
    (cache,) = temporary.glob("svprep-numba-*")
    assert cache.stat().st_mode & 0o077 == 0
    assert list(cache.rglob("*.nbi"))


@pytest.fixture
def empty_environment(tmp_path: Path) -> Iterator[Path]:
    """Make an environment with nothing in it; it grows to 700 MB and does not stay."""
    venv = tmp_path / "venv"
    run(sys.executable, "-m", "venv", venv, cwd=tmp_path)
    yield venv / ("Scripts" if os.name == "nt" else "bin")
    shutil.rmtree(venv, ignore_errors=True)


def test_the_wheel_installs_into_an_empty_environment(
    wheel: Path, elsewhere: Path, empty_environment: Path
) -> None:
    command = [empty_environment / "python", "-m", "pip", "install", "--quiet", "--no-input"]
    command += ["--disable-pip-version-check", "--retries", "2", f"{wheel}[view]"]
    try:
        run(*command, cwd=elsewhere, env=clean_environment())
    except AssertionError as error:
        if any(sign in str(error) for sign in NO_NETWORK):
            pytest.skip("the package index cannot be reached")
        raise
    command = [empty_environment / "svprep"]
    build_and_validate(command, elsewhere, clean_environment())
    draw(command, elsewhere, clean_environment())
