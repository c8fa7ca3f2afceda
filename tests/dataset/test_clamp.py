"""No shadow is clamped away: whatever lies behind a caster lies in one of its segments.

Rays tell which casters lie between a point and a light; they know nothing of the boxes,
clusters and slabs that clamping goes by. Not one exception is allowed.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svprep.clamp import ClampCosts, clamp_lights
from svprep.light import Light, parse_light
from svprep.model import ClampTable, ComponentFlag, Prepared
from svprep.pipeline import BuildConfig, prepare
from svprep.reference import (
    CasterRays,
    casters,
    casters_between,
    outside_segments,
    segments_before_caster,
    surface_points,
)
from tests.dataset.datasets import DATA, build, buildable_files, label
from tests.property.meshes import cube, moved, side_by_side, source_mesh

FILES = buildable_files()
POINTS, POINTS_OF_LONG = 2_000, 20_000
SUNS = (
    *(
        f"dir:{azimuth},{altitude}"
        for altitude in (3, 10, 30, 60)
        for azimuth in (17.3, 135, 251.9)
    ),
    "dir:0,90",
    "dir:90,0",
    "dir:200.5,-20",
)
CITY = DATA / "small_city.obj.gz"
FLAT = {
    "conformance/opposite_faces.obj",
    "conformance/opposite_triangle.obj",
    "conformance/pancake.obj",
    "conformance/self_crossing_polygon.obj",
    "broken/degtri_sliding.off",
    "broken/notenoughindices.obj",
}
"""Files of which all faces lie in one plane: none is behind another one."""


def lamps(prepared: Prepared) -> list[str]:
    """Return five point lights: above, beside, amid, in a solid's box, and close over a face."""
    mesh, components = prepared.mesh, prepared.components
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    low, high = low.astype(np.float64), high.astype(np.float64)
    centre, extent = (low + high) / 2.0, high - low
    size = float(extent.max())
    solids = np.flatnonzero(components.flags & np.uint8(ComponentFlag.SOLID))
    chosen = int(solids[len(solids) // 2]) if len(solids) else 0
    faces = mesh.faces[components.face_start[chosen] : components.face_start[chosen + 1]]
    corners = mesh.positions[faces.reshape(-1)].astype(np.float64)
    box = corners.min(axis=0), corners.max(axis=0)
    hovering = surface_points(mesh, 1, np.random.default_rng(4))[0]
    places = (
        [*(centre[:2] + 0.013 * size), high[2] + 0.2 * size],
        centre + extent * [0.71, 0.29, 0.0] + 0.0017 * size,
        low + extent * [0.31, 0.62, 0.52],
        box[0] + (box[1] - box[0]) * [0.47, 0.56, 0.61],
        hovering + np.array([0.0, 0.0, 0.001 * size]),
    )
    places = np.array(places) + mesh.grid.origin_m
    return [f"point:{','.join(map(repr, place))}" for place in places.tolist()]


def lights_of(prepared: Prepared) -> list[Light]:
    """Return twenty lights."""
    return [parse_light(spec) for spec in (*SUNS, *lamps(prepared))]


def clamped(prepared: Prepared, lights: list[Light], costs: ClampCosts | None = None) -> ClampTable:
    return clamp_lights(prepared.mesh, prepared.components, prepared.scene, lights, costs)


@pytest.mark.parametrize("path", FILES, ids=label)
def test_no_point_is_outside_the_segments_of_its_casters(path: Path, is_long: bool) -> None:
    outcome = build(path)
    assert not isinstance(outcome, str), outcome
    prepared = outcome.prepared
    table = clamped(prepared, lights_of(prepared))
    assert len(table) == 20
    rays = CasterRays(prepared.mesh, prepared.components)
    rng = np.random.default_rng(7)
    found = 0
    for i, light in enumerate(table.lights):
        points = surface_points(prepared.mesh, POINTS_OF_LONG if is_long else POINTS, rng)
        pairs = rays.between(points, light)
        assert pairs.n_cut_off == 0
        found += len(pairs.point)
        early = segments_before_caster(table, i, prepared.mesh, prepared.components)
        assert not len(early), f"{table.specs[i]}: segments {early[:3]}"
        wrong = np.flatnonzero(outside_segments(table, i, points, pairs))
        assert not len(wrong), (
            f"{table.specs[i]}: {len(wrong)} of {len(pairs.point)} pairs; the first: point "
            f"{points[pairs.point[wrong[0]]].tolist()}, face {pairs.face[wrong[0]]}"
        )
    assert (found == 0) == (label(path) in FLAT), f"{found} pairs"


def ground_under_a_box() -> Prepared:
    """Return a ground of 20 m x 20 m, and a box of 4 m x 4 m x 1 m that hangs 5 m above it."""
    x, y = np.indices((21, 21)).reshape(2, -1)
    a = (np.arange(20)[:, None] * 21 + np.arange(20)).reshape(-1)
    faces = np.vstack((np.column_stack((a, a + 21, a + 22)), np.column_stack((a, a + 22, a + 1))))
    ground = source_mesh(np.column_stack((x, y, 0 * x)), faces)
    box = cube(4.0)
    flat = replace(box, positions=box.positions * [1.0, 1.0, 0.25])
    return prepare(side_by_side(ground, moved(flat, (8.0, 8.0, 5.0))), BuildConfig())


def test_flat_ground_under_a_vertical_sun() -> None:
    prepared = ground_under_a_box()
    down = prepared.mesh.grid.origin_m
    steps = np.arange(0.0, 20.0, 0.5)
    x, y = np.meshgrid(steps + 0.13, steps + 0.29)
    points = np.column_stack((x.reshape(-1), y.reshape(-1), np.zeros(x.size))) - down
    sun = [parse_light("dir:0,90")]
    rays = CasterRays(prepared.mesh, prepared.components)
    pairs = rays.between(points, np.array([0, 0, 1, 0], np.float32))
    # 8 x 8 points are under the box, each under its floor and its roof; no ground is over any.
    assert len(pairs.point) == 128
    assert len(np.unique(pairs.point)) == 64
    assert set(pairs.component.tolist()) == {1}
    assert np.allclose(np.unique(pairs.distance_m), [5.0, 6.0], atol=1e-5)
    # By the usual costs a gap of 5 m is worth no caps; without a cost of vertices it is.
    for costs, n_segments in ((ClampCosts(), 1), (ClampCosts(vertex=0.0), 2)):
        table = clamped(prepared, sun, costs)
        assert np.diff(table.segment_start[0]).tolist() == [1, n_segments]
        assert not outside_segments(table, 0, points, pairs).any()
        assert (table.slopes == 0).all()
    z = down[2] - table.depths.astype(np.float64)
    # Depth runs down: the box's own segment from its roof to its floor, then the ground's.
    # The ground's own has no depth, since nothing lies below it.
    assert np.abs(z - [[0.0, 0.0], [6.0, 5.0], [0.0, 0.0]]).max() < 0.002
    assert (z[:, 0] > [0.0, 6.0, 0.0]).all()
    assert (z[:, 1] < [0.0, 5.0, 0.0]).all()


@pytest.fixture(scope="module")
def city() -> tuple[Prepared, ClampTable]:
    """Yield the small city and its segments for a low sun, in many pieces."""
    outcome = build(CITY)
    assert not isinstance(outcome, str), outcome
    sun = [parse_light("dir:135,30")]
    return outcome.prepared, clamped(outcome.prepared, sun, ClampCosts(vertex=0.0))


def without(table: ClampTable, is_dropped: np.ndarray) -> ClampTable:
    """Return a table of one light without some segments."""
    kept_before = np.concatenate(([0], np.cumsum(~is_dropped)))
    return replace(
        table,
        light_start=kept_before[table.light_start],
        segment_start=kept_before[table.segment_start].astype(np.uint32),
        depths=table.depths[~is_dropped],
        slopes=table.slopes[~is_dropped],
    )


def test_the_check_finds_what_is_clamped_away(city: tuple[Prepared, ClampTable]) -> None:
    prepared, table = city
    points = surface_points(prepared.mesh, 4_000, np.random.default_rng(0))
    pairs = casters_between(prepared.mesh, prepared.components, points, table.lights[0])
    assert len(pairs.point) > 2_000

    def outside(other: ClampTable) -> np.ndarray:
        return np.flatnonzero(outside_segments(other, 0, points, pairs))

    assert not len(outside(table))
    nearer = table.depths - np.array([0.0, 0.25], np.float32)
    assert len(outside(replace(table, depths=nearer))) > 20
    # The last segment of every caster that has several; then that of a single one.
    start = table.segment_start[0].astype(np.int64)
    is_dropped = np.zeros(len(table.depths), np.bool_)
    is_dropped[start[1:][np.diff(start) > 1] - 1] = True
    missing = outside(without(table, is_dropped))
    assert len(missing) > 20
    caster = pairs.component[missing[0]]
    last = start[caster + 1] - 1
    one = outside(without(table, np.arange(len(table.depths)) == last))
    assert np.array_equal(one, missing[pairs.component[missing] == caster])
    # And that one, ended where it begins.
    depths = table.depths.copy()
    depths[last, 1] = depths[last, 0]
    assert np.array_equal(outside(replace(table, depths=depths)), one)


def test_the_check_says_how_many_rays_it_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    prepared = ground_under_a_box()
    under = np.array([[10.3, 9.6, 0.0], [1.3, 1.6, 0.0]]) - prepared.mesh.grid.origin_m
    up = np.array([0, 0, 1, 0], np.float32)
    rays = CasterRays(prepared.mesh, prepared.components)
    assert rays.between(under, up).n_cut_off == 0
    monkeypatch.setattr(casters, "MOST_HITS", 2)
    pairs = rays.between(under, up)
    # The first ray had its two hits: whether there are more is not known.
    assert (pairs.point.tolist(), pairs.n_cut_off) == ([0, 0], 1)
