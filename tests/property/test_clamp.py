"""Clamping of random and of named meshes: conservative by brute force, and equal to its twin."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from svprep.clamp import ClampCosts, clamp_lights
from svprep.errors import InputError
from svprep.light import Light
from svprep.model import ClampTable, Mesh, Prepared, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep.reference import Between, clamp_by_scan, outside_segments
from tests.property.meshes import (
    SUITE,
    any_mesh,
    cube,
    lights,
    moved,
    side_by_side,
    source_mesh,
    sphere,
    tetrahedron,
)

VERTEX_COSTS = (0.0, 0.01, 0.3, 4.0)


def prepared_or_none(source: SourceMesh) -> Prepared | None:
    """Prepare a mesh; None where no face has area."""
    try:
        return prepare(source, BuildConfig())
    except InputError:
        return None


def light_of(vector: np.ndarray) -> Light:
    """Return the light at ``(x, y, z, w)`` of source coordinates; a direction of any length."""
    x, y, z, w = vector.astype(np.float64).tolist()
    length = 1.0 if w else float(np.linalg.norm([x, y, z]))
    return Light("test", "test", x / length, y / length, z / length, w)


def clamped(prepared: Prepared, light: Light, costs: ClampCosts) -> ClampTable:
    return clamp_lights(prepared.mesh, prepared.components, prepared.scene, [light], costs)


def clamped_or_none(prepared: Prepared, light: Light, costs: ClampCosts) -> ClampTable | None:
    """Clamp; None for a light on a vertex."""
    vector = light.in_cache_frame(prepared.mesh.grid)
    if vector[3] and (prepared.mesh.positions == vector[:3]).all(axis=1).any():
        with pytest.raises(InputError, match="exactly on a vertex"):
            clamped(prepared, light, costs)
        return None
    return clamped(prepared, light, costs)


def brute_pairs(mesh: Mesh, component_of_face: np.ndarray, light: np.ndarray) -> tuple:
    """Return points of all faces and the faces between each and the light.

    Every face against every ray in float64; hits on the outermost 1e-6 of a face are none, and
    neither are those next to the point or to the light.
    """
    corners = mesh.positions[mesh.faces].astype(np.float64)
    shares = np.array([[6, 1, 1], [1, 6, 1], [1, 1, 6], [3, 3, 2], [11, 10, 3], [1, 9, 14]], float)
    shares /= shares.sum(axis=1, keepdims=True)
    points = np.einsum("sk,fkd->fsd", shares, corners).reshape(-1, 3)
    vector = light.astype(np.float64)
    if vector[3] != 0.0:
        towards = vector[:3] - points
        length = np.linalg.norm(towards, axis=1)
        towards = towards / np.where(length > 0.0, length, 1.0)[:, None]
    else:
        towards = np.broadcast_to(vector[:3] / np.linalg.norm(vector[:3]), points.shape)
        length = np.full(len(points), np.inf)
    a = corners[:, 0]
    side1, side2 = corners[:, 1] - a, corners[:, 2] - a
    # Moeller and Trumbore 1997, for all rays (rows) and faces (columns).
    p = np.cross(towards[:, None], side2[None])
    determinant = (p * side1).sum(axis=2)
    area = np.linalg.norm(np.cross(side1, side2), axis=1)
    is_crossed = np.abs(determinant) > 1e-6 * area
    inverse = 1.0 / np.where(is_crossed, determinant, 1.0)
    from_a = points[:, None] - a[None]
    u = (from_a * p).sum(axis=2) * inverse
    q = np.cross(from_a, side1[None])
    v = (towards[:, None] * q).sum(axis=2) * inverse
    distance = (q * side2).sum(axis=2) * inverse
    gap = 1e-4
    is_hit = is_crossed & (u > 1e-6) & (v > 1e-6) & (u + v < 1.0 - 1e-6)
    is_hit &= (distance > gap) & (distance < length[:, None] - gap)
    point, face = np.nonzero(is_hit)
    return points, Between(point, face, component_of_face[face], distance[point, face], 0)


def assert_conservative(prepared: Prepared, table: ClampTable) -> int:
    """Check the only light of a table against brute force; return the pairs that were found."""
    components = prepared.components
    component_of_face = np.repeat(np.arange(len(components.flags)), np.diff(components.face_start))
    points, pairs = brute_pairs(prepared.mesh, component_of_face, table.lights[0])
    wrong = np.flatnonzero(outside_segments(table, 0, points, pairs))
    assert not len(wrong), (
        f"{len(wrong)} of {len(pairs.point)} pairs: point {points[pairs.point[wrong[0]]]}, "
        f"face {pairs.face[wrong[0]]}"
    )
    return len(pairs.point)


def counts(table: ClampTable) -> np.ndarray:
    """Return the segments of each caster of the only light."""
    return np.diff(table.segment_start[0].astype(np.int64))


def assert_in_order(table: ClampTable) -> None:
    """Check that each caster's segments are disjoint and follow each other."""
    assert ((counts(table) >= 1) & (counts(table) <= 8)).all()
    near, far = table.depths.astype(np.float64).T
    assert (near <= far).all()
    is_first = np.zeros(len(near), np.bool_)
    is_first[table.segment_start[0][:-1]] = True
    after = np.flatnonzero(~is_first)
    alike = after[(table.slopes[after] == table.slopes[after - 1]).all(axis=1)]
    assert (near[alike] >= far[alike - 1]).all()


def assert_like_the_twin(prepared: Prepared, table: ClampTable) -> None:
    """Compare the only light of a table with the twin that looks at every cluster."""
    vertex, area = table.facts[0, :2].tolist()
    twin = clamp_by_scan(
        prepared.mesh, prepared.components, prepared.scene, table.lights[0], vertex, area
    )
    assert counts(table).tolist() == twin.counts.tolist()
    assert (table.slopes / 512.0).tolist() == twin.slopes.tolist()
    # Widened by what float32 rounds, and no more.
    near, far = table.depths.astype(np.float64).T
    scale = np.maximum(np.abs(np.where(np.isfinite(twin.depths), twin.depths, 1.0)), 1e-3)
    tolerance = 4e-7 * scale
    assert (near <= twin.depths[:, 0] + 1e-12 * scale[:, 0]).all()
    assert (near >= twin.depths[:, 0] - tolerance[:, 0]).all()
    assert np.array_equal(np.isinf(far), np.isinf(twin.depths[:, 1]))
    is_finite = np.isfinite(far)
    assert (far >= twin.depths[:, 1] - 1e-12 * scale[:, 1])[is_finite].all()
    assert (far <= twin.depths[:, 1] + tolerance[:, 1])[is_finite].all()
    assert np.allclose(table.facts[0, 2:], twin.areas, rtol=1e-6, atol=1e-9)


@given(mesh=any_mesh(), vector=lights(), vertex=st.sampled_from(VERTEX_COSTS))
@settings(max_examples=80)
def test_random_meshes(mesh: SourceMesh, vector: np.ndarray, vertex: float) -> None:
    prepared = prepared_or_none(mesh)
    assume(prepared is not None)
    table = clamped_or_none(prepared, light_of(vector), ClampCosts(vertex=vertex))
    assume(table is not None)
    assert_in_order(table)
    assert_conservative(prepared, table)
    assert_like_the_twin(prepared, table)


@cache
def of_suite(name: str) -> Prepared:
    return prepare(SUITE[name](), BuildConfig())


SUITE_LIGHTS = np.array(
    [
        [0.3, -0.5, 0.8, 0],
        [0, 0, 1, 0],
        [1, 0, 0, 0],
        [1, 1, 1, 0],
        [0.2, 0.9, -0.4, 0],
        [0.37, 0.41, 2.2, 1],
        [0.5, 0.5, 0.5, 1],
        [9.1, -4.2, 3.3, 1],
        [1.5, 0.31, 0, 1],
    ]
)


@pytest.mark.parametrize("name", [name for name in SUITE if name not in ("nothing", "sphere")])
def test_named_meshes(name: str) -> None:
    prepared = of_suite(name)
    size = float(np.ptp(prepared.mesh.positions, axis=0).max())
    for vector in SUITE_LIGHTS:
        light = light_of(vector * ([1, 1, 1, 1] if size < 100.0 else [size, size, size, 1]))
        table = clamped_or_none(prepared, light, ClampCosts(vertex=0.0))
        if table is None:
            continue
        assert_in_order(table)
        assert_conservative(prepared, table)
        assert_like_the_twin(prepared, table)


@st.composite
def towns(draw: st.DrawFn) -> SourceMesh:
    """Solids of a few metres, here and there over a ground of squares and up to 40 m above it."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1), label="seed"))
    n = draw(st.integers(1, 14), label="solids")
    side = 6
    x, y = np.indices((side + 1, side + 1)).reshape(2, -1)
    a = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1)
    b, c, d = a + side + 1, a + side + 2, a + 1
    faces = np.vstack((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    slope = rng.integers(0, 3)
    heights = np.array([0 * x, 0.5 * x, np.round(2 * rng.random(len(x)), 2)][slope])
    parts = [source_mesh(np.column_stack((10.0 * x, 10.0 * y, heights)), faces)]
    for _ in range(n):
        at = tuple(np.round(rng.random(3) * [56, 56, 40], 2).tolist())
        size = float(np.round(1 + 5 * rng.random(), 2))
        solid = cube(size) if rng.random() < 0.6 else tetrahedron()
        parts.append(moved(solid, at))
    return side_by_side(*parts)


@st.composite
def town_lights(draw: st.DrawFn) -> np.ndarray:
    """A sun at any altitude, or a lamp in or around the town; few lie along the grid."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1), label="seed"))
    if draw(st.booleans(), label="sun"):
        azimuth = 2 * np.pi * rng.random()
        altitude = np.radians(draw(st.sampled_from([-30, 0, 0.5, 3, 10, 40, 70, 90])))
        level = np.cos(altitude)
        return np.array([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(altitude), 0])
    far = draw(st.sampled_from([0.5, 1.0, 10.0, 1000.0]), label="far")
    return np.append(np.array([30, 30, 20]) + (rng.random(3) - 0.5) * 80 * far, 1.0)


@given(mesh=towns(), vector=town_lights(), vertex=st.sampled_from(VERTEX_COSTS))
@settings(max_examples=30)
def test_towns(mesh: SourceMesh, vector: np.ndarray, vertex: float) -> None:
    prepared = prepare(mesh, BuildConfig())
    table = clamped(prepared, light_of(vector), ClampCosts(vertex=vertex))
    assert_in_order(table)
    assert_conservative(prepared, table)
    assert_like_the_twin(prepared, table)


@pytest.mark.parametrize("vector", [(0.4, 0.2, 0.7, 0), (0.4, 0.1, 0.02, 0), (60, 50, 90, 1)])
def test_a_tree_of_three_levels(vector: tuple[float, ...]) -> None:
    """1,472 faces and 24 cubes about them: 232 clusters, 29 nodes over them, 4, and one."""
    places = [(90.0 * np.cos(i), 90.0 * np.sin(i), 7.0 * i - 80.0) for i in range(24)]
    cubes = [moved(cube(8.0), tuple(np.round(at, 1).tolist())) for at in places]
    prepared = prepare(side_by_side(sphere(24, 32, 50.0), *cubes), BuildConfig())
    for vertex in VERTEX_COSTS:
        table = clamped(prepared, light_of(np.array(vector)), ClampCosts(vertex=vertex))
        assert_in_order(table)
        assert_like_the_twin(prepared, table)
    assert len(prepared.scene.cluster_nodes) == 29 + 4 + 1


@given(mesh=towns(), vector=town_lights())
@settings(max_examples=12)
def test_the_rule_of_costs(mesh: SourceMesh, vector: np.ndarray) -> None:
    """V < R: without R there is no gap; a lower V never closes one."""
    prepared = prepare(mesh, BuildConfig())
    light = light_of(vector)
    none = clamped(prepared, light, ClampCosts(vertex=0.0, area=0.0))
    assert counts(none).tolist() == [1] * len(prepared.components.flags)
    assert_conservative(prepared, none)
    before = counts(none)
    for vertex in sorted(VERTEX_COSTS, reverse=True):
        table = clamped(prepared, light, ClampCosts(vertex=vertex))
        assert (counts(table) >= before).all()
        assert_in_order(table)
        before = counts(table)


def bytes_of(table: ClampTable) -> list[bytes]:
    names = ("lights", "frames", "facts", "light_start", "segment_start", "depths", "slopes")
    return [getattr(table, name).tobytes() for name in names]


@given(mesh=towns(), vector=town_lights())
@settings(max_examples=8)
def test_threads_change_nothing(mesh: SourceMesh, vector: np.ndarray) -> None:
    # Chunks of a few casters, so that several threads have some.
    prepared = prepare(mesh, BuildConfig())
    light, costs = light_of(vector), ClampCosts(vertex=0.01)
    with patch("svprep.clamp_views._CHUNK", 3):
        tables = []
        for n in (1, 2, 3):
            with patch.dict("os.environ", {"SVPREP_THREADS": str(n)}):
                tables.append(bytes_of(clamped(prepared, light, costs)))
    assert tables[1] == tables[0]
    assert tables[2] == tables[0]


@given(
    mesh=towns(),
    vector=town_lights(),
    steps=st.tuples(*[st.integers(-(2**20), 2**20)] * 3),
)
@settings(max_examples=12)
def test_a_town_elsewhere_is_the_same(
    mesh: SourceMesh, vector: np.ndarray, steps: tuple[int, int, int]
) -> None:
    """Moved by whole steps of the grid, with its lamps: to the byte."""
    at_first = prepare(mesh, BuildConfig())
    step = at_first.mesh.grid.step_m
    on_grid = replace(mesh, positions=np.floor(mesh.positions / step + 0.5) * step)
    here = prepare(on_grid, BuildConfig())
    shift = np.array(steps) * step
    there = prepare(replace(on_grid, positions=on_grid.positions + shift), BuildConfig())
    assert there.mesh.grid.step_m == here.mesh.grid.step_m
    costs = ClampCosts(vertex=0.01)
    light = light_of(vector)
    if light.w:  # as far as float64 goes, the same place among the houses
        x, y, z = np.round(np.array([light.x, light.y, light.z]) / step) * step
        light = replace(light, x=x, y=y, z=z)
        x, y, z = np.array([x, y, z]) + shift
        moved_light = replace(light, x=x, y=y, z=z)
    else:
        moved_light = light
    table = clamped(there, moved_light, costs)
    assert bytes_of(table) == bytes_of(clamped(here, light, costs))
    assert_conservative(there, table)


def turned_once(mesh: SourceMesh) -> SourceMesh:
    """Turn by 90 degrees about z."""
    x, y, z = mesh.positions.T
    return replace(mesh, positions=np.column_stack((-y, x, z)))


@given(mesh=towns(), vector=town_lights(), vertex=st.sampled_from(VERTEX_COSTS))
@settings(max_examples=12)
def test_a_turned_town_is_conservative(mesh: SourceMesh, vector: np.ndarray, vertex: float) -> None:
    x, y, z, w = vector
    prepared = prepare(turned_once(mesh), BuildConfig())
    table = clamped(prepared, light_of(np.array([-y, x, z, w])), ClampCosts(vertex=vertex))
    assert_in_order(table)
    assert_conservative(prepared, table)
    assert_like_the_twin(prepared, table)


@given(seed=st.integers(0, 2**32 - 1), altitude=st.sampled_from([8.0, 25.0, 60.0]))
@settings(max_examples=12)
def test_turned_objects_of_one_cluster_each_have_as_many_segments(
    seed: int, altitude: float
) -> None:
    """Four faces are one cluster whichever way they are sorted, so nothing else can differ.

    In a town it can: clusters are cut along x, y or z, and which comes first may turn.
    """
    rng = np.random.default_rng(seed)
    solid = tetrahedron()
    parts = []
    for _ in range(40):
        # Sides of different lengths: no two faces are equally large.
        stretched = solid.positions * np.round(0.7 + rng.random(3), 3)
        parts.append(replace(solid, positions=stretched + np.round(rng.random(3) * 60.0, 2)))
    mesh = side_by_side(*parts)
    azimuth = 2 * np.pi * rng.random()
    flat, up = np.cos(np.radians(altitude)), np.sin(np.radians(altitude))
    x, y = flat * np.sin(azimuth), flat * np.cos(azimuth)
    costs = ClampCosts(vertex=0.0)
    here = clamped(prepare(mesh, BuildConfig()), light_of(np.array([x, y, up, 0])), costs)
    turned = prepare(turned_once(mesh), BuildConfig())
    there = clamped(turned, light_of(np.array([-y, x, up, 0])), costs)
    assert counts(there).tolist() == counts(here).tolist()
    assert counts(here).max() > 1
    # The origin, and with it where u, v and t begin, is turned but for a step of the grid.
    assert np.allclose(there.facts, here.facts, rtol=1e-4)
    assert_conservative(turned, there)
