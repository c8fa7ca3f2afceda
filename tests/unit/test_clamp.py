"""The clamping stage: its tables, and lights in places that are easy to get wrong."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from svprep.clamp import ClampCosts, clamp_lights, joined, light_frame, selected
from svprep.errors import InputError
from svprep.light import Light, parse_light
from svprep.model import ClampTable, Prepared, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep.reference import (
    CasterRays,
    outside_segments,
    segments_before_caster,
    surface_points,
)
from tests.property.meshes import cube, moved, side_by_side, source_mesh
from tests.unit.cache_samples import assert_same

ANY_GAP = ClampCosts(vertex=0.0)


def ground(size: int = 60) -> Prepared:
    """Return three boxes over a level ground of 2 m x 2 m squares; the ground is object 0."""
    n = size // 2
    x, y = 2 * np.indices((n + 1, n + 1)).reshape(2, -1) - n
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    faces = np.vstack(
        (np.column_stack((a, a + n + 1, a + n + 2)), np.column_stack((a, a + n + 2, a + 1)))
    )
    flat = source_mesh(np.column_stack((x, y, 0 * x)), faces)
    boxes = [
        moved(cube(6.0), (-12.0, -3.0, 0.0)),
        moved(cube(4.0), (6.0, 5.0, 9.0)),
        moved(cube(3.0), (8.0, -14.0, 0.0)),
    ]
    return prepare(side_by_side(flat, *boxes), BuildConfig())


@pytest.fixture(scope="module")
def town() -> Prepared:
    return ground()


def clamped(
    prepared: Prepared, specs: list[str], costs: ClampCosts | None = None, **options: object
) -> ClampTable:
    lights = [parse_light(spec) for spec in specs]
    return clamp_lights(
        prepared.mesh, prepared.components, prepared.scene, lights, costs, **options
    )


def assert_conservative(prepared: Prepared, table: ClampTable, n: int = 3_000) -> int:
    """Check every segment with rays; return the pairs of points and casters that were found."""
    rays = CasterRays(prepared.mesh, prepared.components)
    rng = np.random.default_rng(2)
    found = 0
    for i, light in enumerate(table.lights):
        points = surface_points(prepared.mesh, n, rng)
        pairs = rays.between(points, light)
        assert not outside_segments(table, i, points, pairs).any(), table.specs[i]
        assert pairs.n_cut_off == 0
        assert not len(segments_before_caster(table, i, prepared.mesh, prepared.components))
        found += len(pairs.point)
    return found


def counts(table: ClampTable) -> list[list[int]]:
    """Return the segments of each caster, for each light."""
    return np.diff(table.segment_start.astype(np.int64), axis=1).tolist()


def assert_sound(prepared: Prepared, table: ClampTable) -> None:
    """Check what every table keeps to, whatever the light."""
    assert np.isfinite(table.depths[:, 0]).all()
    assert (table.depths[:, 1] >= table.depths[:, 0]).all()
    assert np.isfinite(table.facts).all()
    assert (table.facts >= 0.0).all()
    n = np.array(counts(table))
    assert n.shape == (len(table), len(prepared.components.flags))
    assert ((n >= 1) & (n <= 8)).all()
    assert np.array_equal(np.diff(table.light_start), n.sum(axis=1))
    is_point = np.repeat(table.lights[:, 3] != 0.0, np.diff(table.light_start))
    assert not table.slopes[is_point].any()
    assert (table.depths[is_point, 0] >= 0.0).all()


SUNS = {
    "at its zenith": "dir:0,90",
    "level, along an axis": "dir:90,0",
    "level, aslant": "dir:33,0",
    "below the ground": "dir:120,-35",
    "straight from below": "dir:0,-90",
    "very low": "dir:200,0.5",
    "along diagonals of faces": "dir:45,35.26438968",
}


@pytest.mark.parametrize("where", SUNS)
@pytest.mark.parametrize("costs", [ClampCosts(), ANY_GAP], ids=["usual costs", "any gap"])
def test_suns(where: str, costs: ClampCosts, town: Prepared) -> None:
    table = clamped(town, [SUNS[where]], costs)
    assert_sound(town, table)
    assert assert_conservative(town, table) > 100


LAMPS = {
    "above": "point:1.3,2.1,40",
    "beside": "point:45,3.3,2.7",
    "far beside": "point:100000,50000,30000",
    "among the boxes": "point:0.3,1.1,4.2",
    "inside a box": "point:-9.1,0.2,3.3",
    "in the middle of a box": "point:-9,0,3",
    "in the plane of the ground": "point:40,0.7,0",
    "in the plane of a roof": "point:20,3,6",
    "on the ground": "point:0.7,0.4,0",
    "on an edge of the ground": "point:1,0,0",
    "on a wall": "point:-6,1,2",
    "on an edge of a box": "point:-6,-3,2.5",
    "on a diagonal of a wall": "point:-6,0,3",
    "a millimetre from a corner": "point:-5.999,3,6",
    "below the ground": "point:2,3,-8",
    "just below the ground": "point:2.2,3.1,-0.001",
}


@pytest.mark.parametrize("where", LAMPS)
@pytest.mark.parametrize("costs", [ClampCosts(), ANY_GAP], ids=["usual costs", "any gap"])
def test_lamps(where: str, costs: ClampCosts, town: Prepared) -> None:
    table = clamped(town, [LAMPS[where]], costs)
    assert_sound(town, table)
    assert assert_conservative(town, table) > 100


def test_a_light_inside_a_box_reaches_all_around(town: Prepared) -> None:
    table = clamped(town, [LAMPS["in the middle of a box"]])
    # The ground below the box is 3 m away from the light, its corners 40 m and more.
    first = table.depths[int(table.segment_start[0, 1])]
    assert first[0] <= 1.0
    assert first[1] > 5.0


def test_a_light_on_a_vertex_is_refused(town: Prepared) -> None:
    positions = town.mesh.positions + town.mesh.grid.origin_m
    vertex = np.flatnonzero((positions == [10.0, 5.0, 13.0]).all(axis=1))
    spec = "point:10,5,13"
    with pytest.raises(InputError) as caught:
        clamped(town, ["dir:0,90", spec])
    assert str(caught.value) == (
        f'light "{spec}" lies exactly on a vertex (vertices {vertex[0]}, objects 2), where a '
        "shadow has no direction. Move it by a millimetre or more"
    )


def test_a_light_on_the_vertices_of_two_objects_names_both() -> None:
    touching = prepare(side_by_side(cube(), moved(cube(), (1.0, 0.0, 0.0))), BuildConfig())
    with pytest.raises(InputError, match=r"\(vertices \d+, \d+, objects 0, 1\)"):
        clamped(touching, ["point:1,1,1"])


def test_a_light_that_is_too_far_away_is_refused(town: Prepared) -> None:
    with pytest.raises(InputError, match="1e\\+39") as caught:
        clamped(town, ["point:0,1e39,0"])
    assert "\n" not in str(caught.value)


def test_a_far_lamp_is_like_the_sun(town: Prepared) -> None:
    far = 1e6
    x, y, z, _ = parse_light("dir:60,40").in_cache_frame(town.mesh.grid).astype(float).tolist()
    lamp = f"point:{far * x!r},{far * y!r},{far * z!r}"
    table = clamped(town, ["dir:60,40", lamp], ANY_GAP)
    assert_sound(town, table)
    assert_conservative(town, table)
    # Factors from so far away are depths over the distance: of at most 100 m of 1000 km.
    lamp_depths = table.depths[table.light_start[1] :]
    assert np.abs(lamp_depths - 1.0).max() < 100.0 / far


def test_no_lights(town: Prepared) -> None:
    told: list[tuple[int, int]] = []
    table = clamped(town, [], on_light=lambda *done: told.append(done))
    assert len(table) == 0
    assert told == []
    shapes = {f.name: getattr(table, f.name) for f in fields(table) if f.name != "specs"}
    assert {name: (a.shape, a.dtype.str[1:]) for name, a in shapes.items()} == {
        "lights": ((0, 4), "f4"),
        "frames": ((0, 3, 3), "f8"),
        "facts": ((0, 5), "f8"),
        "light_start": ((1,), "i8"),
        "segment_start": ((0, 5), "u4"),
        "depths": ((0, 2), "f4"),
        "slopes": ((0, 2), "i2"),
    }


def test_one_face() -> None:
    face = source_mesh(np.array([[0, 0, 1], [2, 0, 1], [0, 3, 1]]), np.array([[0, 1, 2]]))
    prepared = prepare(face, BuildConfig())
    suns = ["dir:0,90", "dir:0,0", "dir:77,20"]
    table = clamped(prepared, [*suns, "point:0.5,0.5,9", "point:0.5,0.5,1", "point:9,9,1"], ANY_GAP)
    assert_sound(prepared, table)
    assert counts(table) == [[1]] * 6
    assert_conservative(prepared, table, 200)  # there is no pair; nor is there any error
    # From its zenith the sun sees the face at one depth.
    z = prepared.mesh.grid.origin_m[2] - table.depths[0]
    assert np.abs(z - 1.0).max() < 0.002


def test_forty_eight_lights_are_forty_eight_times_one(town: Prepared) -> None:
    specs = [f"dir:{7.5 * i},{5 + 1.5 * i}" for i in range(40)]
    specs += [f"point:{i - 4}.3,{3 * i}.7,{15 + i}" for i in range(8)]
    told: list[tuple[int, int]] = []
    table = clamped(town, specs, ANY_GAP, on_light=lambda *done: told.append(done))
    assert told == [(i + 1, 48) for i in range(48)]
    assert table.specs == tuple(specs)
    assert_sound(town, table)
    for i in (0, 7, 39, 40, 47):
        assert_same(selected(table, [i]), clamped(town, [specs[i]], ANY_GAP))


def test_joined_and_selected_are_inverse(town: Prepared) -> None:
    table = clamped(town, ["dir:10,20", "point:1,2,30", "dir:0,90"], ANY_GAP)
    assert_same(joined(selected(table, [0]), selected(table, [1, 2])), table)
    assert_same(joined(selected(table, []), table), table)
    assert_same(joined(table, selected(table, [])), table)
    assert_same(selected(table, range(3)), table)
    turned = selected(table, [2, 0, 1])
    assert turned.specs == ("dir:0,90", "dir:10,20", "point:1,2,30")
    assert_sound(town, turned)
    assert_conservative(town, turned, 500)
    assert_same(selected(turned, [1, 2, 0]), table)
    none = selected(table, [])
    assert_same(none, clamped(town, []))


def test_no_gaps_without_a_cost_of_area(town: Prepared) -> None:
    specs = ["dir:135,40", "dir:0,90", "point:1,2,30"]
    without = clamped(town, specs, ClampCosts(area=0.0))
    assert counts(without) == [[1, 1, 1, 1]] * 3
    assert_conservative(town, without, 500)
    many = clamped(town, specs, ANY_GAP)
    assert max(max(n) for n in counts(many)) > 1
    # Only the ratio of the costs matters.
    ten_times = clamped(town, specs, ClampCosts(vertex=1.0, area=10.0))
    assert_same(ten_times.depths, clamped(town, specs, ClampCosts(vertex=0.1, area=1.0)).depths)


def test_more_receivers_than_are_kept_apart() -> None:
    """A plate over 6,000 leaves, each an object at a height of its own: more gaps than are kept."""
    n = 6_000
    x, y = np.divmod(np.arange(n), 78)
    at = np.column_stack((2.0 * x, 2.0 * y, 0.5 * np.random.default_rng(3).permutation(n)))
    leaf = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0]])
    plate = np.array([[0, 0, 3100], [160, 0, 3100], [160, 160, 3100], [0, 160, 3100]])
    faces = np.vstack(([[0, 1, 2], [0, 2, 3]], 4 + np.arange(3 * n).reshape(-1, 3)))
    vertices = np.vstack((plate, (at[:, None] + leaf).reshape(-1, 3)))
    prepared = prepare(source_mesh(vertices, faces, [0, *range(2, n + 3)]), BuildConfig())
    table = clamped(prepared, ["point:80.3,80.7,6200"], ANY_GAP)
    assert_sound(prepared, table)
    assert assert_conservative(prepared, table) > 500


def test_clamping_saves_surface(town: Prepared) -> None:
    table = clamped(town, ["dir:135,40", "point:1,2,30"])
    for vertex, area, unclamped, _, surface in table.facts.tolist():
        assert (vertex, area) == (4.0, 1.0)
        assert 0.0 < surface < unclamped


@pytest.mark.parametrize("name", ["vertex", "area"])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_costs_that_are_none(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"cost of a clamp's {name} is a number of at least 0"):
        ClampCosts(**{name: value})


@pytest.mark.parametrize("azimuth", [0.0, 17.3, 90.0, 251.9])
@pytest.mark.parametrize("altitude", [-90.0, -20.0, 0.0, 1e-7, 40.0, 89.9999, 90.0])
def test_light_frames(azimuth: float, altitude: float) -> None:
    light = parse_light(f"dir:{azimuth},{altitude}")
    u, v, t = frame = light_frame(np.array([light.x, light.y, light.z, 0.0], np.float32))
    assert np.abs(frame @ frame.T - np.eye(3)).max() < 1e-12
    assert np.allclose(np.cross(u, v), t, atol=1e-12)
    assert np.allclose(t, [-light.x, -light.y, -light.z], atol=1e-7)
    assert u[2] == 0.0
    assert v[2] >= -1e-7


def test_the_frame_of_a_lamp() -> None:
    assert np.array_equal(light_frame(np.array([3, 4, 5, 1], np.float32)), np.eye(3))


def test_a_light_without_a_spec_is_clamped_as_well(town: Prepared) -> None:
    light = Light("", "made by hand", 0.0, 0.6, 0.8, 0.0)
    table = clamp_lights(town.mesh, town.components, town.scene, [light])
    assert table.specs == ("",)
    assert_conservative(town, table, 500)


def sheet(x: float, y0: float, y1: float, z: float) -> SourceMesh:
    """Return a level rectangle, -x to x by y0 to y1."""
    corners = [(-x, y0, z), (x, y0, z), (x, y1, z), (-x, y1, z)]
    return source_mesh(np.array(corners), np.array([(0, 1, 2), (0, 2, 3)]))


def test_no_later_segment_begins_before_its_caster() -> None:
    # The sun stands in the south. Two decks lie north of a tower, in its shadow, and level
    # planes just above and below them would pass the tower on the sunlit side, by a deck there.
    tower = cube(1.0)
    tower = replace(tower, positions=(tower.positions - 0.5) * [10, 10, 50] + [0, 0, 25])
    decks = [sheet(20, 40, 80, 30), sheet(20, 40, 80, 30.5), sheet(20, -75, -45, 30.25)]
    city = prepare(side_by_side(tower, *decks), BuildConfig())
    table = clamped(city, ["dir:180,20", "dir:180,25", "dir:170,20"], ANY_GAP)
    assert counts(table)[0][0] > 1
    assert assert_conservative(city, table) > 100
    # The check can fail: with the planes that were chosen before, it does.
    spoilt = replace(table, depths=table.depths.copy())
    second = int(table.segment_start[0, 0]) + 1
    spoilt.depths[second, 0] = -1e6
    found = segments_before_caster(spoilt, 0, city.mesh, city.components)
    assert found.tolist() == [second]


def test_thousands_of_receivers_take_one_segment_each() -> None:
    # Sheets above each other, more than a caster may have receivers.
    n = 20_000
    z = np.repeat(np.arange(n) * 0.5, 3)
    corners = np.tile([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], (n, 1))
    faces = np.arange(3 * n).reshape(-1, 3)
    city = prepare(source_mesh(np.column_stack((corners, z)), faces), BuildConfig())
    table = clamped(city, ["dir:0,90"])
    starts = table.segment_start[0].astype(np.int64)
    highest = np.argmax(city.mesh.positions[city.mesh.faces[:, 0], 2])
    component = int(np.searchsorted(city.components.face_start, highest, side="right")) - 1
    near, far = table.depths[starts[component]].tolist()
    low, high = (float(end) for end in (-z.max() / 2, z.max() / 2))
    assert starts[component + 1] - starts[component] == 1
    assert near <= low + 0.01
    assert far >= high


def test_a_lamp_far_away_has_no_gap_that_rounding_closes() -> None:
    places = [(0.0, 0.0, 0.0), (0.3, 0.2, 7.0), (-0.2, 0.1, 15.0), (0.1, -0.1, 31.0)]
    city = prepare(side_by_side(*(moved(cube(2.0), at) for at in places)), BuildConfig())
    table = clamped(city, ["point:1,2,4810354", "point:0,1,900000"], ANY_GAP)
    for i in range(len(table)):
        rows = table.light_start[i] + table.segment_start[i].astype(np.int64)
        for begin, end in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True):
            near, far = table.depths[begin:end].T
            assert (near[1:] >= far[:-1]).all()
