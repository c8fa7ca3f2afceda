"""Real CityJSON files against the counts of INDEX.md, and known-bad ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from svprep.defects import Code
from svprep.ingest.cityjson import read_cityjson
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile
from tests.dataset.datasets import SHARED

CITIES = SHARED / "cities"
BROKEN = SHARED / "broken"


def read(path: Path, lod: str = "highest") -> ParsedFile:
    if not path.exists():
        pytest.skip(f"not run: ../shared/data/{path.relative_to(SHARED).as_posix()} is absent")
    data = np.frombuffer(bytearray(path.read_bytes()) + b"\n", np.uint8)
    return read_cityjson(data, path, path.stem, lambda fraction: None, ReadOptions(lod=lod))


class Counts(NamedTuple):
    """As INDEX.md counts: edges of polygon rings, vertices merged inside each object."""

    objects: int
    triangles: int
    n_open: int
    n_three_or_more: int
    n_badly_wound: int


def counts(got: ParsedFile) -> Counts:
    """Count edges; those that two triangles of one polygon share are no edges of its rings."""
    _, place = np.unique(got.positions, axis=0, return_inverse=True)
    a = got.faces.astype(np.int64).ravel()
    b = np.roll(got.faces, -1, axis=1).astype(np.int64).ravel()
    polygon = np.repeat(got.source_face.astype(np.int64), 3)
    of_object = np.repeat(np.arange(len(got.object_names)), 3 * np.diff(got.object_face_start))
    inside = np.stack([polygon, np.minimum(a, b), np.maximum(a, b)], axis=1)
    _, edge, n_uses = np.unique(inside, axis=0, return_inverse=True, return_counts=True)
    is_ring = n_uses[edge.ravel()] == 1
    a, b = place.ravel()[a[is_ring]], place.ravel()[b[is_ring]]
    key = np.stack([of_object[is_ring], np.minimum(a, b), np.maximum(a, b)], axis=1)[a != b]
    _, edge, n_faces = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    net = np.bincount(edge.ravel(), np.where(a < b, 1, -1)[a != b])
    return Counts(
        len(got.object_names),
        len(got.faces),
        int((n_faces == 1).sum()),
        int((n_faces >= 3).sum()),
        int(((n_faces == 2) & (net != 0)).sum()),
    )


EXPECTED = {
    # 41,197 in INDEX.md: 10 of its triangles have a corner twice, that of a ring which names
    # a corner twice in a row. Such a corner is left out before triangulation.
    "denhaag_01_v0.json": Counts(1991, 41187, 521, 0, 0),
    "munich_lod2_v0.json": Counts(111, 3530, 0, 0, 0),
    "delft.city.json": Counts(570, 36271, 12513, 0, 0),
    "campus_terrain.city.json": Counts(306, 22499, 1897, 0, 0),
    # 38,772 and 21,383 / 322 / 10 in INDEX.md: see the next test.
    "delfshaven.city.json": Counts(853, 37536, 21631, 1, 10),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_counts_are_those_of_the_index(name: str) -> None:
    assert counts(read(CITIES / name)) == EXPECTED[name]


def test_delfshaven_differs_by_its_rings_of_two_corners() -> None:
    """633 rings of Delfshaven run there and back between two corners.

    They are no surfaces: each is a finding, and no triangle. INDEX.md counts their edges,
    two each between the same corners, and n - 2 triangles for each. With them the counts
    are the same.
    """
    path = CITIES / "delfshaven.city.json"
    got = read(path)
    assert np.count_nonzero(got.face_findings.code == Code.SHORT_POLYGON) == 633
    tree = json.loads(path.read_bytes())
    places = [tuple(vertex) for vertex in tree["vertices"]]
    found = np.zeros(3, np.int64)
    n_triangles = 0
    for described in tree["CityObjects"].values():
        runs: dict[tuple, list[int]] = {}
        for geometry in described["geometry"]:
            for ring in (ring for surface in geometry["boundaries"] for ring in surface):
                n_triangles += len(ring) - 2
                for p, q in zip(ring, ring[1:] + ring[:1], strict=True):
                    a, b = places[p], places[q]
                    if a != b:
                        runs.setdefault((min(a, b), max(a, b)), []).append(1 if a < b else -1)
        for steps in runs.values():
            found += [len(steps) == 1, len(steps) >= 3, len(steps) == 2 and sum(steps) != 0]
    assert found.tolist() == [21383, 322, 10]
    assert n_triangles == 38772  # no surface of this file has a hole


def test_the_hague_keeps_ids_types_parents_and_surfaces() -> None:
    path = CITIES / "denhaag_01_v0.json"
    got = read(path)
    tree = json.loads(path.read_bytes())["CityObjects"]
    assert list(got.object_names) == [name for name, o in tree.items() if o.get("geometry")]
    assert list(got.object_types) == [tree[name]["type"] for name in got.object_names]
    assert list(got.object_parents) == [tree[name].get("parent", "") for name in got.object_names]
    names = [
        geometry["semantics"]["surfaces"][value]["type"] if "semantics" in geometry else ""
        for name in got.object_names
        for geometry in tree[name]["geometry"]
        for value in np.ravel(
            geometry.get("semantics", {}).get("values", [0] * len(geometry["boundaries"]))
        ).tolist()
    ]
    assert [got.surface_names[i] for i in got.surface_of_polygon] == names


def test_munich_version_0_1_has_its_surfaces() -> None:
    got = read(CITIES / "munich_lod2_v0.json")
    assert set(got.surface_names) == {"", "WallSurface"}
    assert got.surface_of_polygon.all()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("val3dity/501.json", Counts(1, 36, 0, 4, 0)),
        ("val3dity/501_1.json", Counts(1, 20, 0, 3, 0)),
        ("val3dity/502.json", Counts(1, 36, 0, 12, 0)),
        ("val3dity/503.json", Counts(1, 36, 0, 4, 0)),
        ("val3dity/601.json", Counts(2, 24, 0, 0, 0)),
        ("val3dity/601_1.json", Counts(6, 76, 0, 0, 0)),
        ("tetra_1flip.city.json", Counts(1, 4, 0, 0, 3)),
        ("duplicate-vertices.json", Counts(1, 12, 4, 0, 0)),
    ],
)
def test_broken_files_are_read(name: str, expected: Counts) -> None:
    got = read(BROKEN / name)
    assert counts(got) == expected
    if name.startswith("val3dity/601"):
        assert len(set(got.object_parents)) == 1
        assert got.object_parents[0] not in ("", *got.object_names)


def test_no_cityjson_file_is_left_untried() -> None:
    if not SHARED.is_dir():
        pytest.skip("not run: ../shared/data is absent")
    found = {p.name for p in SHARED.rglob("*.json") if p.name != "tileset.json"}
    assert found <= {
        *EXPECTED, "501.json", "501_1.json", "502.json", "503.json", "601.json", "601_1.json",
        "tetra_1flip.city.json", "duplicate-vertices.json",
    }  # fmt: skip
