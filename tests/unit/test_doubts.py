"""What is noted of inputs that can be read, but are hardly meant so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from svprep.ingest import read
from svprep.ingest.doubts import on_distance
from svprep.ingest.parsed import ParsedFile
from tests.unit.gltf_samples import SQUARE, Glb
from tests.unit.placed_boxes import box

TRIANGLE = "v {x} 0 0\nv {y} 0 0\nv {y} 1 0\nf 1 2 3\n"


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def tile() -> bytes:
    glb = Glb()
    glb.node(mesh=glb.mesh(glb.primitive(SQUARE)))
    return glb.bytes()


@pytest.mark.parametrize("folder", ["t", "t/a", "t/a/b"])
def test_a_tile_without_its_tileset_is_noted_once(folder: str) -> None:
    Path(folder).mkdir(parents=True)
    Path("t/tileset.json").write_text(json.dumps({"asset": {}, "root": {}}))
    paths = [Path(folder, name) for name in ("0.glb", "1.glb")]
    for path in paths:
        path.write_bytes(tile())
    (note,) = [n for n in read(paths).notes if "build that folder" in n]
    assert note.startswith("2 files (0.glb, ...): read where it stands by itself; t/tileset.json")


def test_a_tileset_is_not_looked_for_farther_up_or_of_other_formats() -> None:
    Path("t/a/b/c").mkdir(parents=True)
    Path("t/tileset.json").write_text("{}")
    Path("t/a/b/c/0.glb").write_bytes(tile())
    Path("t/0.obj").write_text(TRIANGLE.format(x=0, y=1))
    assert not any("tileset" in n for n in read(["t/a/b/c/0.glb", "t/0.obj"]).notes)


def test_a_tileset_is_found_from_below_it(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("t/a").mkdir(parents=True)
    Path("t/tileset.json").write_text("{}")
    Path("t/a/0.glb").write_bytes(tile())
    monkeypatch.chdir("t/a")
    assert any("; ../tileset.json places tiles" in n for n in read(["0.glb"]).notes)


def boxes(*at: tuple[float, float]) -> list[ParsedFile]:
    return [box("", x, y, 1000.0) for x, y in at]


@pytest.mark.parametrize(
    ("at", "says"),
    [
        ([(0, 0)], None),
        ([(0, 0), (10_900, 0)], None),
        ([(0, 0), (11_100, 0)], "f0 and f1 lie 10 km apart"),
        ([(0, 0), (0, -30_000)], "f0 and f1 lie 29 km apart"),
        ([(0, 0), (9_000, 9_000)], "f0 and f1 lie 11 km apart"),
        ([(5_000.0 * i, 0) for i in range(9)], None),  # a city of tiles has no gap
        ([(0, 0), (5_000, 0), (500_000, 6e6), (1_000, 0)], "f0 and f2 lie 6,0"),
    ],
)
def test_two_groups_far_apart(at: list[tuple[float, float]], says: str | None) -> None:
    notes = on_distance(boxes(*at), [f"f{i}" for i in range(len(at))])
    if says is None:
        assert notes == ()
    else:
        assert len(notes) == 1
        assert notes[0].startswith(says)
        assert notes[0].endswith("is one of them in another CRS?")


def test_files_far_apart_and_of_one_name_are_told_apart() -> None:
    for name, x in (("a", 0), ("b", 50_000)):
        Path(name).mkdir()
        Path(name, "city.obj").write_text(TRIANGLE.format(x=x, y=x + 1))
    mesh = read(["a/city.obj", "b/city.obj"])
    assert mesh.notes[0].startswith("a/city.obj and b/city.obj lie 50 km apart")


def test_files_without_faces_are_nowhere() -> None:
    empty = ParsedFile(
        np.zeros((0, 3)),
        np.zeros((0, 3), np.uint32),
        np.zeros(1, np.int64),
        np.zeros(0, np.uint32),
        (),
        boxes((0, 0))[0].face_findings,
        (),
    )
    assert on_distance([empty, *boxes((0, 0))], ["a", "b"]) == ()
