"""The city generator, and the sample files in data/ with their manifest."""

from __future__ import annotations

import gzip
import hashlib
import json
import shlex
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from svprep.defects import DEFECTS, Code
from svprep.ingest import read
from svprep.model import ComponentFlag
from svprep.pipeline import BuildConfig, prepare

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "data"
SCRIPT = ROOT / "scripts" / "make_city.py"
MAX_FILE_BYTES = 1_000_000
MAX_DATA_BYTES = 2_000_000
COUNTS = ("objects", "faces", "vertices", "components", "closed", "solid")


def entries() -> list[dict]:
    with (DATA / "manifest.toml").open("rb") as file:
        return tomllib.load(file)["file"]


def make_city(output: Path, *options: str) -> dict:
    """Run the script; return its summary."""
    command = [sys.executable, str(SCRIPT), "-o", str(output), "--json", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def defects_of(path: Path) -> tuple[dict[str, int], np.ndarray]:
    """Build `path` in memory; return its non-zero defect counts and component flags."""
    prepared = prepare(read([path]), BuildConfig())
    totals = prepared.repair.defect_counts.sum(axis=0).tolist()
    found = {code.name: n for code, n in zip(DEFECTS, totals, strict=True) if n}
    return found, prepared.components.flags


@pytest.mark.parametrize("suffix", [".obj", ".obj.gz"])
def test_same_options_give_same_bytes(tmp_path: Path, suffix: str) -> None:
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    options = ("--objects", "60", "--seed", "3")
    assert make_city(first, *options) == make_city(second, *options)
    assert first.read_bytes() == second.read_bytes()


def test_another_seed_gives_another_city(tmp_path: Path) -> None:
    first, second = tmp_path / "a.obj", tmp_path / "b.obj"
    make_city(first, "--objects", "60", "--seed", "3")
    make_city(second, "--objects", "60", "--seed", "4")
    assert first.read_bytes() != second.read_bytes()


def test_summary_of_the_default_city(tmp_path: Path) -> None:
    summary = make_city(tmp_path / "city.obj", "--objects", "300")
    assert summary["objects"] == 300 == sum(summary["objects_by_kind"].values())
    absent = [kind for kind, n in summary["defects_planted"].items() if n == 0]
    assert absent == []
    # 17,420 objects are to have 1.0 to 1.15 million triangles, 57 to 66 an object. A
    # small city has more terrain around it for its size.
    assert 57 * 300 <= summary["triangles"] <= 90 * 300


@pytest.mark.parametrize("n_objects", [1, 2, 9, 25, 26, 101])
def test_any_number_of_objects(tmp_path: Path, n_objects: int) -> None:
    path = tmp_path / "city.obj"
    assert make_city(path, "--objects", str(n_objects))["objects"] == n_objects
    names = [line for line in path.read_text().splitlines() if line.startswith("o ")]
    assert len(set(names)) == n_objects


def test_origin_moves_every_vertex(tmp_path: Path) -> None:
    here, there = tmp_path / "a.obj", tmp_path / "b.obj"
    make_city(here, "--objects", "30")
    make_city(there, "--objects", "30", "--origin", "390000", "5820000", "40")
    moved = _vertices(there) - _vertices(here)
    np.testing.assert_allclose(
        moved, np.broadcast_to([390000, 5820000, 40], moved.shape), atol=2e-3
    )


def _vertices(path: Path) -> np.ndarray:
    lines = (line for line in path.read_text().splitlines() if line.startswith("v "))
    return np.array([[float(x) for x in line.split()[1:]] for line in lines])


def test_clean_city_has_no_findings(tmp_path: Path) -> None:
    path = tmp_path / "clean.obj"
    summary = make_city(path, "--objects", "300", "--clean")
    assert sum(summary["defects_planted"].values()) == 0
    found, flags = defects_of(path)
    assert found == {}
    solid = ComponentFlag.CLOSED | ComponentFlag.SOLID
    np.testing.assert_array_equal(flags, np.full(len(flags), solid))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["-o", "city.ply"], ".obj or .obj.gz"),
        (["-o", "city.obj", "--objects", "0"], "at least 1"),
        (["-o", "city.obj", "--seed", "-1"], "not be negative"),
    ],
)
def test_wrong_usage(options: list[str], expected: str) -> None:
    command = [sys.executable, str(SCRIPT), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert expected in done.stderr


def test_unwritable_output_is_one_line(tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPT), "-o", str(tmp_path / "absent" / "city.obj")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1


def test_manifest_covers_every_file() -> None:
    files = {p.relative_to(DATA).as_posix() for p in DATA.rglob("*") if p.is_file()}
    names = [entry["name"] for entry in entries()]
    assert sorted(names) == sorted(files - {"manifest.toml"})


@pytest.mark.parametrize("entry", entries(), ids=lambda entry: entry["name"])
def test_manifest_entry(entry: dict) -> None:
    assert entry["shows"].endswith(".")
    assert entry["licence"] == "MIT"
    assert hashlib.sha256((DATA / entry["name"]).read_bytes()).hexdigest() == entry["sha256"]
    expect = entry["expect"]
    codes = {code.name for code in Code}
    assert set(expect) <= {"refused", "defects", "unstated", *COUNTS}
    assert set(expect.get("defects", {})) <= codes
    assert set(expect.get("unstated", [])) <= codes | set(COUNTS)
    assert not set(expect.get("unstated", [])) & (set(expect) | set(expect.get("defects", {})))


def test_data_stays_small() -> None:
    sizes = {p.name: p.stat().st_size for p in DATA.rglob("*") if p.is_file()}
    assert {name: n for name, n in sizes.items() if n > MAX_FILE_BYTES} == {}
    assert sum(sizes.values()) <= MAX_DATA_BYTES


def test_small_city_shows_every_defect() -> None:
    found, _ = defects_of(DATA / "small_city.obj.gz")
    assert {code.name for code in Code} - set(found) == set()


def test_small_city_comes_from_its_command(tmp_path: Path) -> None:
    entry = next(e for e in entries() if "command" in e)
    _, script, *options = shlex.split(entry["command"])
    assert ROOT / script == SCRIPT
    output = options.index("-o") + 1
    assert ROOT / options[output] == DATA / entry["name"]
    options[output] = str(tmp_path / "city.obj.gz")
    subprocess.run([sys.executable, str(SCRIPT), *options], capture_output=True, check=True)
    # Not the bytes: another compressor or mathematical library may differ in the last digit.
    assert _outline(tmp_path / "city.obj.gz") == _outline(DATA / entry["name"])


def _outline(path: Path) -> tuple[list[str], Counter[str]]:
    """Return the objects' names, and how many vertices and faces there are."""
    lines = gzip.decompress(path.read_bytes()).decode("ascii").splitlines()
    names = [line for line in lines if line.startswith("o ")]
    return names, Counter(line[:2] for line in lines if line[:2] in ("v ", "f "))
