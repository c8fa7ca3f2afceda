"""Every CityGML file of ../shared/data: what it holds, and the same city as CityJSON."""

from __future__ import annotations

import gzip
import json
from collections import Counter
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from svprep.ingest import read
from svprep.ingest.citygml_events import read_events
from svprep.ingest.citygml_links import Uses, resolve
from svprep.ingest.citygml_log import CityLog
from svprep.ingest.citygml_surfaces import Polygons, gather
from svprep.model import I64, SourceMesh
from tests.dataset.datasets import SHARED

DEN_HAAG = "cities/denhaag_01.gml.gz"
MUNICH = "cities/munich_lod2.gml"

# Objects, polygons, triangles, and edges of rings per object (open, of three or more faces,
# of two that run the same way). INDEX.md counts 41,197 triangles of The Hague: ten of its
# polygons repeat a corner beside itself, which makes a triangle less each. It counts 327
# edges of three or more faces there because it merges parts into their buildings, and 162
# in FZK-Haus because it merges the cells; both are tested below. Of Ingolstadt it says
# "thousands" of each, of all 13 houses together.
EXPECTED = {
    DEN_HAAG: (1991, 21804, 41187, 521, 0, 0),
    MUNICH: (111, 1056, 3530, 0, 0, 0),
    "cities/ingolstadt_lod3/0000000.xml.gz": (1, 8, 20, 0, 0, 0),
    "cities/ingolstadt_lod3/4018133.xml.gz": (8, 130, 600, 123, 19, 24),
    "cities/ingolstadt_lod3/4018149a.xml.gz": (4, 108, 592, 3, 10, 24),
    "cities/ingolstadt_lod3/4018154.xml.gz": (4, 3121, 6484, 982, 257, 10),
    "cities/ingolstadt_lod3/4018194.xml.gz": (2, 125, 358, 15, 17, 1),
    "cities/ingolstadt_lod3/4018204b.xml.gz": (4, 233, 786, 90, 60, 15),
    "cities/ingolstadt_lod3/4018206.xml.gz": (5, 2893, 7814, 98, 1838, 522),
    "cities/ingolstadt_lod3/4018210.xml.gz": (11, 2230, 8292, 0, 2256, 48),
    "cities/ingolstadt_lod3/4018215.xml.gz": (2, 4450, 12766, 96, 2842, 1051),
    "cities/ingolstadt_lod3/4018259.xml.gz": (3, 56, 244, 93, 5, 11),
    "cities/ingolstadt_lod3/4018262.xml.gz": (8, 1441, 4420, 476, 694, 49),
    "cities/ingolstadt_lod3/4018266.xml.gz": (1, 314, 1026, 0, 96, 32),
    "cities/ingolstadt_lod3/4018273.xml.gz": (4, 1824, 5824, 180, 824, 232),
    "broken/FZK-Haus_full.gml": (24, 201, 857, 3, 0, 0),
    "broken/val3dity/302_2.gml": (1, 6, 12, 4, 0, 0),
}


def located(name: str) -> Path:
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"../shared/data/{name} is not here")
    return path


@cache
def polygons_of(path: Path) -> tuple[CityLog, Uses, Polygons]:
    """Return the polygons before triangulation; these files have one level of detail each."""
    text = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    log = read_events(np.frombuffer(text, np.uint8), path, lambda fraction: None)
    uses = resolve(log, path)
    assert len(set(uses.lod.tolist())) == 1
    return log, uses, gather(log, uses, path)


@cache
def mesh_of(path: Path) -> SourceMesh:
    return read([path])


def edge_counts(polygons: Polygons, owner: I64) -> tuple[int, int, int]:
    """Return how many edges of rings are open, of three or more, of two that run alike."""
    start = polygons.ring_start
    here = polygons.corners.astype(np.int64)
    following = np.arange(1, here.size + 1)
    is_ring = np.diff(start) > 0
    following[start[1:][is_ring] - 1] = start[:-1][is_ring]
    there = here[following]
    of_corner = np.repeat(np.repeat(owner, np.diff(polygons.polygon_start)), np.diff(start))
    rows = np.stack([of_corner, np.minimum(here, there), np.maximum(here, there)])
    is_edge = here != there
    _, edge, count = np.unique(rows[:, is_edge], axis=1, return_inverse=True, return_counts=True)
    forward = np.bincount(edge.ravel(), (here < there)[is_edge])
    is_alike = (count == 2) & (forward != 1)
    return int((count == 1).sum()), int((count >= 3).sum()), int(is_alike.sum())


@pytest.mark.parametrize("name", EXPECTED)
def test_counts(name: str) -> None:
    path = located(name)
    log, uses, polygons = polygons_of(path)
    mesh = mesh_of(path)
    assert set(mesh.object_names) <= set(log.object_ids)
    assert all(mesh.object_types)
    assert (
        len(mesh.object_names),
        len(uses.polygon),
        len(mesh.faces),
        *edge_counts(polygons, uses.object_index),
    ) == EXPECTED[name]
    assert not [note for note in mesh.notes if "reference" in note or "no property" in note]


def test_each_file_is_expected() -> None:
    located(DEN_HAAG)
    found = [p for kind in ("*.gml", "*.gml.gz", "*.xml", "*.xml.gz") for p in SHARED.rglob(kind)]
    assert {p.relative_to(SHARED).as_posix() for p in found} == set(EXPECTED)


def test_the_hague_merged_into_members() -> None:
    log, uses, polygons = polygons_of(located(DEN_HAAG))
    root = np.arange(len(log.object_types))
    for i, parent in enumerate(log.object_parents):
        root[i] = i if parent < 0 else root[parent]
    member = root[uses.object_index]
    assert len(np.unique(member)) == 845
    assert edge_counts(polygons, member) == (521, 327, 0)
    # The 63 duplicate faces of INDEX.md: walls between parts, each the other way around.
    rings = [tuple(ring) for ring in rings_on_grid(polygons, np.zeros(3), 0.001)]
    assert len(set(zip(member.tolist(), rings, strict=True))) == len(rings)
    turned = {(m, frozenset(ring)) for m, ring in zip(member.tolist(), rings, strict=True)}
    assert len(rings) - len(turned) == 63


def test_fzk_house_merged() -> None:
    _, uses, polygons = polygons_of(located("broken/FZK-Haus_full.gml"))
    assert edge_counts(polygons, uses.object_index * 0)[1] == 162


@pytest.mark.parametrize("name", [DEN_HAAG, MUNICH])
def test_surfaces_types_and_crs(name: str) -> None:
    mesh = mesh_of(located(name))
    counts = Counter(mesh.surface_names[i] for i in mesh.surface_of_polygon.tolist())
    types = Counter(mesh.object_types)
    if name == MUNICH:
        assert counts == {"WallSurface": 728, "RoofSurface": 217, "GroundSurface": 111}
        assert types == {"Building": 111}
        assert mesh.sources[0].crs == "urn:adv:crs:DE_DHDN_3GK4*DE_DHN92_NH"
        assert (mesh.positions.min(axis=0) >= [4424648.79, 5482614.69, 310.19]).all()
        assert (mesh.positions.max(axis=0) <= [4424852.33, 5482813.83, 330.28]).all()
        return
    assert counts == {"": 5595, "WallSurface": 11215, "RoofSurface": 3004, "GroundSurface": 1990}
    assert types == {"BuildingPart": 1653, "Building": 337, "TINRelief": 1}
    assert sum(bool(parent) for parent in mesh.object_parents) == 1654
    assert mesh.sources[0].crs == "urn:ogc:def:crs:EPSG::28992"
    assert mesh.positions[:, 1].min() == 457604.591


Ring = tuple[tuple[int, ...], ...]


def canonical(ring: list[tuple[int, ...]]) -> Ring:
    """Return a ring from its least corner on, in its own direction."""
    turned = (ring[i:] + ring[:i] for i, corner in enumerate(ring) if corner == min(ring))
    return tuple(min(turned))


def rings_on_grid(polygons: Polygons, origin: np.ndarray, step: float) -> list[Ring]:
    """Return every ring, rounded down to a grid as the converter to CityJSON did it."""
    cells = np.trunc((polygons.positions - origin) * (1 / step)).astype(np.int64)
    rows = list(map(tuple, cells.tolist()))
    corners, start = polygons.corners.tolist(), polygons.ring_start.tolist()
    return [canonical([rows[c] for c in corners[a:b]]) for a, b in pairwise(start)]


def rings_of_cityjson(city: dict) -> list[Ring]:
    """Return every ring of a CityJSON file in its integers, by a reader of a few lines."""
    rows = list(map(tuple, city["vertices"]))
    found = []
    for thing in city["CityObjects"].values():
        nested = [geometry["boundaries"] for geometry in thing["geometry"]]
        while nested:
            level = nested.pop()
            if isinstance(level[0], int):
                found.append(canonical([rows[i] for i in level]))
            else:
                nested.extend(level)
    return found


@pytest.mark.parametrize(
    ("name", "json_name", "n_rings"),
    [
        (DEN_HAAG, "cities/denhaag_01_v0.json", 21804),
        (MUNICH, "cities/munich_lod2_v0.json", 1056),
    ],
)
def test_the_same_rings_as_in_cityjson(name: str, json_name: str, n_rings: int) -> None:
    # The CityJSON is on a grid of 1 mm (The Hague) or 10 mm (Munich).
    polygons = polygons_of(located(name))[2]
    city = json.loads(located(json_name).read_text("utf-8"))
    origin, step = np.array(city["transform"]["translate"]), city["transform"]["scale"][0]
    ours = Counter(rings_on_grid(polygons, origin, step))
    assert ours == Counter(rings_of_cityjson(city))
    assert ours.total() == n_rings
