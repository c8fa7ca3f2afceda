"""Real GLB files and 3D Tiles, against the counts of INDEX.md."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from svprep.ingest.gltf import read_gltf
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile
from svprep.ingest.tileset import read_tileset
from tests.dataset.datasets import SHARED

WAGENINGEN = SHARED / "cities" / "wageningen_7-624-528"
STATION = SHARED / "cities" / "amsterdam_station.glb"


def needed(path: Path) -> Path:
    if not path.exists():
        pytest.skip(f"not run: ../shared/data/{path.relative_to(SHARED).as_posix()} is absent")
    return path


class Edges(NamedTuple):
    """Edges of the triangles of each object, vertices merged by exact coordinates."""

    n_open: int
    n_three_or_more: int
    n_badly_wound: int
    n_objects_badly_wound: int


def edges(mesh: ParsedFile, object_of_face: np.ndarray) -> Edges:
    _, vertex = np.unique(mesh.positions, axis=0, return_inverse=True)
    a = vertex.reshape(-1)[mesh.faces]
    b = a[:, [1, 2, 0]]
    n = int(vertex.max()) + 1
    rows = np.repeat(object_of_face, 3) * n + np.minimum(a, b).ravel()
    rows = rows * n + np.maximum(a, b).ravel()
    edge, index, count = np.unique(rows, return_inverse=True, return_counts=True)
    turns = np.bincount(index, np.where(a < b, 1, -1).ravel())
    is_bad = (count == 2) & (turns != 0)
    return Edges(
        int((count == 1).sum()),
        int((count >= 3).sum()),
        int(is_bad.sum()),
        np.unique(edge[is_bad] // (n * n)).size,
    )


@pytest.fixture(scope="module")
def wageningen():
    return read_tileset(needed(WAGENINGEN), lambda fraction: None, ReadOptions())


def test_wageningen_has_every_building_by_its_id(wageningen):
    assert len(wageningen.object_names) == 2956
    assert len(wageningen.faces) == 146_666
    assert all(name.startswith("NL.IMBAG.Pand.") for name in wageningen.object_names)
    # 13 buildings are several rows of a property table: separate objects of one name.
    assert len(set(wageningen.object_names)) == 2943
    assert len(wageningen.beside) == 5 + 13  # subtrees and contents


def test_wageningen_is_earth_centred(wageningen):
    assert wageningen.crs == "EPSG:4978"
    middle = wageningen.positions.mean(axis=0)
    latitude = np.degrees(np.arctan2(middle[2], np.hypot(*middle[:2]) * (1 - 0.00669437999)))
    longitude = np.degrees(np.arctan2(middle[1], middle[0]))
    assert (round(latitude, 1), round(longitude, 1)) == (52.0, 5.6)


def test_wageningen_edges_match_the_index(wageningen):
    object_of_face = np.repeat(np.arange(2956), np.diff(wageningen.object_face_start))
    assert edges(wageningen, object_of_face) == (1382, 20, 21_535, 1239)


def test_station_edges_match_the_index_by_primitive():
    """INDEX.md counts each of the 327 primitives; 249 nodes with a mesh are objects here.

    Walls of two materials are two primitives of one node, so what is open in each
    primitive meets in the object, and its edges of three and more faces are more.
    """
    raw = needed(STATION).read_bytes()
    mesh = read_gltf(np.frombuffer(raw + b"\n", np.uint8), STATION, "amsterdam_station")
    assert (len(mesh.object_names), len(mesh.faces)) == (249, 10_483)
    tree = json.loads(raw[20 : 20 + struct.unpack_from("<I", raw, 12)[0]])
    sizes: list[int] = []

    def walk(index: int) -> None:
        node = tree["nodes"][index]
        if "mesh" in node:
            for primitive in tree["meshes"][node["mesh"]]["primitives"]:
                sizes.append(tree["accessors"][primitive["indices"]]["count"] // 3)
        for child in node.get("children", []):
            walk(child)

    for root in tree["scenes"][0]["nodes"]:
        walk(root)
    by_primitive = np.repeat(np.arange(len(sizes)), sizes)
    by_node = np.repeat(np.arange(249), np.diff(mesh.object_face_start))
    assert len(sizes) == 327
    assert edges(mesh, by_primitive)[:3] == (4323, 886, 42)
    assert edges(mesh, by_node)[:3] == (2087, 5159, 6)
