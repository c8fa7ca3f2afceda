"""Kinds of surface as files name them, and geometry where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svprep.hours import Kind
from svprep.hours.semantics import UNSTATED, doubted_walls, stated_kinds
from svprep.model import Labels, Prepared
from tests.unit.hours_scenes import BOTTOM, SOUTH, TOP, box, city, level, surfaces_in

ROOF, WALL, GROUND, UNDERSIDE = Kind


def labelled(prepared: Prepared, type_name: str, *names: tuple[range, str]) -> Prepared:
    """Return a city of one box with some source faces named, and its type stated."""
    named = ("", *(name for _, name in names))
    surface = np.zeros(len(prepared.mesh.faces), np.uint8)
    for number, (faces, _) in enumerate(names, start=1):
        surface[np.isin(prepared.mesh.source_face, list(faces))] = number
    n = len(prepared.object_names)
    return replace(prepared, labels=Labels((type_name,) * n, ("",) * n, named, surface))


def kinds_of(prepared: Prepared, faces: range) -> set[Kind]:
    chosen = np.isin(prepared.mesh.source_face, list(faces))
    return {Kind(k) for k in surfaces_in(prepared).kind[chosen].tolist()}


@pytest.mark.parametrize(
    ("name", "nz", "kind"),
    [
        ("RoofSurface", 0.9, ROOF),
        ("roofsurface", 0.1, ROOF),  # a mansard
        ("RoofSurface", -0.9, UNDERSIDE),  # eaves
        ("OuterFloorSurface", 1.0, ROOF),
        ("WallSurface", 1.0, WALL),
        ("WallSurface", -1.0, WALL),
        ("GroundSurface", -1.0, UNDERSIDE),
        ("GroundSurface", 0.0, UNDERSIDE),
        ("GroundSurface", 1.0, UNSTATED),
        ("OuterCeilingSurface", -1.0, UNDERSIDE),
        ("Window", 0.0, WALL),
        ("Window", 0.8, ROOF),
        ("DoorSurface", -0.8, UNDERSIDE),
        ("TrafficArea", 1.0, GROUND),
        ("WaterSurface", -1.0, UNSTATED),
        ("ClosureSurface", 1.0, UNSTATED),
        ("", 1.0, UNSTATED),
    ],
)
def test_names(name: str, nz: float, kind: int) -> None:
    labels = Labels(("Building",), ("",), ("", name), np.array([1 if name else 0], np.uint8))
    assert stated_kinds(labels, np.zeros(1, np.int64), np.array([nz])).tolist() == [kind]


@pytest.mark.parametrize(
    "type_name", ["TINRelief", "Road", "LandUse", "WaterBody", "ReliefFeature"]
)
def test_land_is_ground_where_it_looks_up(type_name: str) -> None:
    nz = np.array([1.0, 0.2, 0.0, -1.0])
    labels = Labels((type_name,), ("",), ("",), np.zeros(4, np.uint8))
    found = stated_kinds(labels, np.zeros(4, np.int64), nz)
    assert found.tolist() == [GROUND, GROUND, UNSTATED, UNSTATED]


def test_names_come_before_geometry_and_are_counted() -> None:
    plain = city(box((0, 0, 0), (9, 9, 5)))
    named = labelled(plain, "Building", (SOUTH, "RoofSurface"))
    assert kinds_of(named, SOUTH) == {ROOF}
    assert kinds_of(named, TOP) == {ROOF}
    surfaces = surfaces_in(named)
    assert surfaces.is_stated.sum() == 2
    assert not surfaces_in(plain).is_stated.any()


def test_a_bottom_plate_of_an_open_shell_counts_its_lower_side() -> None:
    # Without walls or roof above it, geometry takes it for ground that looks up.
    plate = city(level(0, 0, 9, 9))
    assert kinds_of(plate, range(2)) == {GROUND}
    named = labelled(plate, "Building", (range(2), "GroundSurface"))
    assert kinds_of(named, range(2)) == {UNDERSIDE}
    assert (surfaces_in(named).normal[:, 2] == -1.0).all()


def test_a_box_named_throughout() -> None:
    names = ((BOTTOM, "GroundSurface"), (TOP, "RoofSurface"), (SOUTH, "WallSurface"))
    named = labelled(city(box((0, 0, 0), (9, 9, 5))), "Building", *names)
    assert kinds_of(named, BOTTOM) == {UNDERSIDE}
    assert kinds_of(named, TOP) == {ROOF}
    assert kinds_of(named, SOUTH) == {WALL}


def test_walls_are_doubted_where_a_file_calls_every_face_so() -> None:
    plain = city(box((0, 0, 0), (9, 9, 5)))
    named = labelled(plain, "Building", (range(12), "WallSurface"))
    assert kinds_of(named, SOUTH) == {WALL}
    assert kinds_of(named, TOP) == {ROOF}
    assert kinds_of(named, BOTTOM) == {UNDERSIDE}
    assert surfaces_in(named).is_stated.sum() == 8
    # A file that tells them apart is believed, however level its walls are.
    told = labelled(plain, "Building", (range(2, 12), "WallSurface"), (BOTTOM, "GroundSurface"))
    assert kinds_of(told, TOP) == {WALL}


def test_each_file_is_doubted_by_itself() -> None:
    labels = Labels(("",) * 2, ("",) * 2, ("", "WallSurface"), np.array([1, 1, 1, 0], np.uint8))
    nz = np.array([1.0, 0.0, -0.6, 1.0])
    source = np.array([1, 1, 3, 3], np.uint32)
    assert doubted_walls(labels, source, nz).tolist() == [True, False, False, False]
    assert not doubted_walls(Labels.none(2, 4), source, nz).any()
    nothing = Labels(("",), ("",), ("", "WallSurface"), np.zeros(0, np.uint8))
    assert len(doubted_walls(nothing, source[:0], nz[:0])) == 0
