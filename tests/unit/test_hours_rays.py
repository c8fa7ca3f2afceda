"""Rays of sun hours against brute force in float64; what is buried; batches and threads."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from svprep.errors import EnvironmentProblem, InputError
from svprep.hours import Kind, sun_hours, trace_points, tracing
from svprep.hours import buried as burying
from svprep.hours.buried import Burial
from svprep.hours.tracing import runs, steps_of
from svprep.model import ComponentFlag
from svprep.rays import Scene, displaced, offset_m
from tests.property.meshes import joined, moved, source_mesh, sphere, turned
from tests.unit.cache_samples import nothing
from tests.unit.hours_scenes import (
    BOTTOM,
    NORTH,
    TOP,
    VIENNA,
    arc_at,
    box,
    city,
    face_under,
    in_cache_frame,
    level,
    lit_by_brute_force,
    longest_run,
    sheet,
    surfaces_in,
)

DAY = "2026-06-21/05:00/21:00/1h"


def jumble(shift: float = 0.0, seed: int = 3):
    """Return ground, boxes that overlap, open boxes, slanted and loose triangles."""
    rng = np.random.default_rng(seed)
    parts = [level(-30, -30, 30, 30)]
    for k in range(10):
        low = np.round(rng.uniform([-25, -25, -1], [20, 20, 0]), 2)
        high = low + np.round(rng.uniform([1, 1, 2], [8, 8, 9]), 2)
        parts.append(box(tuple(low), tuple(high), without=() if k % 2 else tuple(TOP)))
    middle = rng.uniform([-25, -25, 1], [25, 25, 12], (40, 1, 3))
    loose = (middle + rng.normal(0, 1.5, (40, 3, 3))).reshape(-1, 3)
    parts.append(source_mesh(loose, np.arange(120).reshape(-1, 3)))
    return city(*(moved(part, (shift, shift, 0.0)) for part in parts))


@pytest.mark.parametrize("shift", [0.0, 7000.0], ids=["near", "far"])
def test_rays_agree_with_brute_force(shift: float) -> None:
    # The far one has a lone triangle at the other end: the grid is coarse, the offset larger.
    prepared = jumble(shift)
    arc = arc_at(VIENNA, "2026-03-20/06:30/18:30/2h")
    hours = sun_hours(prepared, arc, spacing_m=2.0)
    left = np.flatnonzero(~hours.is_buried)
    surfaces = surfaces_in(prepared)
    lit = hours.points.is_lit()[left]
    assert 0.3 < lit.mean() < 0.8
    for light, step in zip(arc.lights, arc.step_of_light, strict=True):
        wanted = lit_by_brute_force(
            prepared,
            surfaces,
            light.in_cache_frame(prepared.mesh.grid),
            hours.position[left],
            hours.face[left],
            hours.offset_m,
        )
        np.testing.assert_array_equal(lit[:, step], wanted)


def test_no_ray_slips_between_faces() -> None:
    ball = city(moved(sphere(12, 18, 20.0), (500.0, -300.0, 40.0)))
    mesh = ball.mesh
    scene = Scene(mesh.positions, mesh.faces)
    corners = mesh.positions[mesh.faces]
    aims = np.concatenate(
        [mesh.positions, (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2]
    )
    middle = (mesh.positions.min(axis=0) + mesh.positions.max(axis=0)) / 2
    for start in (middle, middle + np.float32([3.0, 1.0, -7.0])):
        for aim in aims:
            towards = (aim - start).astype(np.float32)
            assert scene.is_blocked(start.reshape(1, 3), towards / np.linalg.norm(towards))[0]


def test_a_face_never_shades_itself_however_low_the_sun() -> None:
    rng = np.random.default_rng(1)
    step = 2.0**-11
    for size in (0.2, 5.0, 900.0):
        for _ in range(20):
            middle = rng.uniform(size - 8000, 8000 - size, 3)
            corners = np.rint((middle + rng.normal(size=(3, 3)) * size / 3) / step) * step
            a, b, c = corners
            normal = np.cross(b - a, c - a)
            unit = normal / np.linalg.norm(normal)
            scene = Scene(corners.astype(np.float32), np.array([[0, 1, 2]]))
            share = rng.dirichlet(np.ones(3), 50)
            offset = max(1e-3, 4.0 * float(np.spacing(np.float32(8000.0))))
            starts = displaced(share @ corners, np.tile(unit, (50, 1)), offset)
            along = (b - a) / np.linalg.norm(b - a)
            for altitude in (2e-4, 1e-3, 1e-2):
                sun = (along * np.cos(altitude) + unit * np.sin(altitude)).astype(np.float32)
                assert not scene.is_blocked(starts, sun).any()


def test_how_far_before_a_face_rays_start() -> None:
    near = city(level(-5, -5, 5, 5))
    assert offset_m(near.mesh) == 1e-3
    far = city(level(-5, -5, 5, 5), level(9000, 9000, 9010, 9010))
    assert offset_m(far.mesh) == 4.0 * 2.0**-11


def test_the_inside_of_a_closed_room_gets_no_sun() -> None:
    # Walls and a lid that are no solid: the floor inside is not buried, but dark.
    shell = city(level(-20, -20, 20, 20), box((-3, -3, -1), (3, 3, 3), without=(0, 1)))
    face = face_under(shell, (1.0, 0.5, 0.0), "object 0")
    got = trace_points(shell, arc_at(VIENNA, DAY), in_cache_frame(shell, (1.0, 0.5, 0.0)), [face])
    assert (got.is_buried[0], got.total_steps[0], got.longest_steps[0]) == (False, 0, 0)
    outside = in_cache_frame(shell, (1.0, -9.0, 0.0))
    assert trace_points(shell, arc_at(VIENNA, DAY), outside, [face]).total_steps[0] > 8


def winding_numbers(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return how often triangles wind around each point (van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(corners[None].astype(float) - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=2)
    below = la * lb * lc + (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
    return np.arctan2(volume, below).sum(axis=1) / (2.0 * np.pi)


def test_what_is_in_a_solid_agrees_with_winding_numbers() -> None:
    prepared = jumble(seed=11)
    hours = sun_hours(prepared, arc_at(VIENNA, DAY), spacing_m=1.0)
    surfaces, mesh, parts = surfaces_in(prepared), prepared.mesh, prepared.components
    starts = hours.position + hours.offset_m * surfaces.normal[hours.face]
    inside = np.zeros(hours.n_samples, bool)
    for solid in np.flatnonzero(parts.flags & ComponentFlag.SOLID):
        begin, end = parts.face_start[solid : solid + 2]
        inside |= winding_numbers(mesh.positions[mesh.faces[begin:end]], starts) > 0.5
    assert inside.sum() > 100
    np.testing.assert_array_equal(hours.points.burial == Burial.IN_SOLID, inside)


def test_ground_under_a_solid_is_buried() -> None:
    prepared = city(level(-20, -20, 20, 20), box((-5, -5, -1), (5, 5, 6)))
    hours = sun_hours(prepared, arc_at(VIENNA, DAY), spacing_m=0.5)
    ground = hours.object == 0
    within = (np.abs(hours.position[:, :2] + prepared.mesh.grid.origin_m[:2]) < 5).all(axis=1)
    in_solid = hours.points.burial == Burial.IN_SOLID
    np.testing.assert_array_equal(in_solid, ground & within)
    assert abs(in_solid.sum() - 100 / 0.25) < 25
    assert not hours.points.total_steps[hours.is_buried].any()


def test_what_a_wall_has_under_the_ground_is_buried() -> None:
    for without in ((), tuple(BOTTOM)):
        house = box((-5, -5, -1), (5, 5, 6), without)
        prepared = city(level(-20, -20, 20, 20), house)
        hours = sun_hours(prepared, arc_at(VIENNA, DAY), spacing_m=0.5)
        z = hours.position[:, 2] + prepared.mesh.grid.origin_m[2]
        under = hours.points.burial == Burial.UNDER_GROUND
        np.testing.assert_array_equal(under, (hours.kind == Kind.WALL) & (z < 0.0))
        assert abs(under.sum() - 40 / 0.25) < 25
    # A roof over its own walls is no ground, whatever it is taken for.
    eaves = joined(level(-6, -6, 6, 6, 6.0), box((-5, -5, 0), (5, 5, 5), tuple(TOP)))
    assert not sun_hours(city(eaves), arc_at(VIENNA, DAY)).is_buried.any()


def test_a_party_wall_is_buried() -> None:
    prepared = city(box((0, 0, 0), (8, 10, 6)), box((8, 0, 0), (16, 10, 9)))
    hours = sun_hours(prepared, arc_at(VIENNA, DAY), spacing_m=0.5)
    x, _, z = (hours.position + prepared.mesh.grid.origin_m).T
    party = (x == 8.0) & (hours.kind == Kind.WALL) & (z < 6.0)
    np.testing.assert_array_equal(hours.is_buried, party)
    assert hours.is_buried.sum() > 400


def test_a_row_of_houses_does_not_bury_what_faces_it() -> None:
    # The ray of a west wall that looks at the row meets A's front, then A's back together
    # with B's front: only the solids' own faces tell that it starts outside all.
    prepared = city(
        box((-9, 0, 0), (-1, 10, 6)), box((0, 0, 0), (8, 10, 6)), box((8, 0, 0), (16, 10, 6))
    )
    face = face_under(prepared, (-1.0, 4.0, 3.0), "object 0")
    points = in_cache_frame(prepared, [(-1.0, 4.0, 3.0), (-1.0, 7.0, 1.0)])
    assert not trace_points(prepared, arc_at(VIENNA, DAY), points, [face, face]).is_buried.any()


@pytest.mark.parametrize("turn", [False, True])
def test_what_stands_in_a_solid_does_not_hide_that_a_point_is_in_it(turn: bool) -> None:
    # Above the point in the house: a chimney's bottom (a front face), or an open sheet.
    inner = level(-1, -1, 1, 1, 2.0) if turn else box((-1, -1, 2), (1, 1, 9))
    prepared = city(level(-20, -20, 20, 20), box((-5, -5, -1), (5, 5, 6)), inner)
    points = in_cache_frame(prepared, [(0.3, 0.2, 0.0), (7.0, 0.0, 0.0)])
    face = face_under(prepared, (0.3, 0.2, 0.0), "object 0")
    other = face_under(prepared, (7.0, 0.0, 0.0), "object 0")
    got = trace_points(prepared, arc_at(VIENNA, DAY), points, [face, other])
    assert got.is_buried.tolist() == [True, False]


def test_a_room_in_a_solid_is_outside_of_it() -> None:
    # A house with a cave: one component cannot hold it, so the cave is an inverted box.
    cave = turned(box((-2, -2, 1), (2, 2, 3)))
    prepared = city(box((-5, -5, 0), (5, 5, 6)), level(-1, -1, 1, 1, 7.0))
    assert len(prepared.components.flags) == 2
    hours = sun_hours(prepared, arc_at(VIENNA, DAY), spacing_m=1.0)
    assert not hours.is_buried.any()
    both = city(joined(box((-5, -5, 0), (5, 5, 6)), cave))
    assert sun_hours(both, arc_at(VIENNA, DAY), spacing_m=1.0).n_samples > 0


def test_a_tie_is_not_lit() -> None:
    # A wall that looks south, a sun exactly in the east: edge-on, though nothing hides it.
    wall = city(sheet([(-5, 0, 0), (5, 0, 0), (5, 0, 4), (-5, 0, 4)]))
    arc = arc_at(VIENNA, DAY)
    east = dataclasses.replace(arc.lights[0], x=1.0, y=0.0, z=0.0)
    just_south = dataclasses.replace(arc.lights[0], x=1.0, y=-1e-3, z=0.0)
    small = dataclasses.replace(arc, n_steps=2, step_of_light=(0, 1), lights=(east, just_south))
    got = trace_points(wall, small, in_cache_frame(wall, (0.0, 0.0, 2.0)), [0])
    assert got.is_lit().tolist() == [[False, True]]
    assert got.n_rays == 1


def test_neither_threads_nor_batches_change_a_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    prepared, arc = jumble(), arc_at(VIENNA, DAY)
    monkeypatch.setenv("SVPREP_THREADS", "1")
    one = sun_hours(prepared, arc, spacing_m=1.0)
    monkeypatch.setenv("SVPREP_THREADS", "3")
    monkeypatch.setattr(tracing, "RAYS_AT_ONCE", 300)
    monkeypatch.setattr(burying, "RAYS_AT_ONCE", 123)
    told: list[tuple[str, int, int]] = []
    many = sun_hours(prepared, arc, spacing_m=1.0, on_progress=lambda *said: told.append(said))
    for name in ("position", "face", "object", "kind", "is_buried"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name), strict=True)
    np.testing.assert_array_equal(one.points.bits, many.points.bits)
    assert one.points.n_rays == many.points.n_rays
    assert all(0 <= done <= of for _, done, of in told)
    assert ("sun rays", many.n_samples, many.n_samples) in told


def test_runs_count_what_bits_say() -> None:
    rng = np.random.default_rng(5)
    for n_steps in (1, 7, 8, 9, 64, 131):
        lit = rng.random((60, n_steps)) < 0.7
        bits = np.packbits(lit, axis=1, bitorder="little")
        np.testing.assert_array_equal(steps_of(bits, n_steps), lit)
        total, longest = runs(bits, n_steps)
        np.testing.assert_array_equal(total, lit.sum(axis=1))
        assert longest.tolist() == [longest_run(row) for row in lit]


def test_a_city_without_faces() -> None:
    hours = sun_hours(nothing(), arc_at(VIENNA, DAY))
    assert (hours.n_samples, hours.points.n_rays) == (0, 0)


def test_points_that_are_none_are_refused() -> None:
    prepared, arc = city(level(-5, -5, 5, 5)), arc_at(VIENNA, DAY)
    for positions, faces, said in (
        ([(0, 0, 0)], [2], "there are 2"),
        ([(0, 0, 0)], [-1], "there are 2"),
        ([(0, 0, np.nan)], [0], "not finite"),
        ([(0, 0, 0)], [0, 1], "1 positions, but 2 faces"),
    ):
        with pytest.raises(InputError, match=said):
            trace_points(prepared, arc, positions, faces)


def test_without_embree_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "embreex.rtcore_scene", None)
    with pytest.raises(EnvironmentProblem, match=r'"embreex".*svprep\[judge\]'):
        sun_hours(city(level(-5, -5, 5, 5)), arc_at(VIENNA, DAY))


def test_a_north_wall_in_winter_is_dark_and_its_back_is_not_asked() -> None:
    house = city(box((0, 0, 0), (8, 8, 6)))
    north = face_under(house, (4.0, 8.0, 3.0), "object 0")
    got = trace_points(
        house,
        arc_at(VIENNA, "2026-12-21/08:00/16:00/30m"),
        in_cache_frame(house, (4.0, 8.0, 3.0)),
        [north],
    )
    assert (got.total_steps[0], got.n_rays, len(NORTH)) == (0, 0, 2)
