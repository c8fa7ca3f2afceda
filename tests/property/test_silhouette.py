"""Silhouettes of random and of named meshes: every method against the float64 twin.

Here the smallest objects have trees, too, which elsewhere are scanned.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from svprep.errors import InputError
from svprep.model import EdgeFlag, EdgeKind, Prepared, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep.reference import (
    SilhouetteRows,
    SilhouetteTwin,
    build_hextree,
    edge_buffer,
    eliminate_edges,
    visit_hextree,
)
from svprep.silhouette import METHODS, VOLUMES, Silhouette, index, silhouette
from tests.dataset.lights import KINDS, hard_lights
from tests.property.meshes import (
    SUITE,
    any_mesh,
    arrays,
    cube,
    grid_meshes,
    joined,
    lights,
    moved,
    side_by_side,
    solids,
    source_mesh,
    sphere,
    voxel_meshes,
    voxels,
)

SMALLEST = float(np.float32(1e-45))
EXTREMES = [0.0, -0.0, 0.5, 1.0, 1e4, 1e7, 1e30, 3e38, SMALLEST, 1e-38, 2.0**-24]


@pytest.fixture(autouse=True, scope="module")
def trees_of_the_smallest() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(index, "FEWEST_PAIRS", 1)
        yield


def prepared_or_none(source: SourceMesh) -> Prepared | None:
    """Prepare a mesh; None where no face has area."""
    try:
        return prepare(source, BuildConfig())
    except InputError:
        return None


def in_cache_frame(prepared: Prepared, light: np.ndarray) -> np.ndarray:
    """Move a light of source coordinates to the cache frame."""
    at = light[:3].astype(np.float64) - light[3] * prepared.mesh.grid.origin_m
    return np.append(at, light[3]).astype(np.float32)


def bumpy_field(rng: np.random.Generator, n: int) -> SourceMesh:
    """Terrain: an open sheet of 2 n n triangles, each at its own slope."""
    x, y = np.indices((n + 1, n + 1)).reshape(2, -1)
    height = rng.integers(0, 1 + n // 2, len(x))
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    b, c, d = a + n + 1, a + n + 2, a + 1
    faces = np.vstack((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    return source_mesh(np.column_stack((x, y, height)), faces)


def bumpy_sphere(rng: np.random.Generator, n: int) -> SourceMesh:
    """A closed surface that may cross itself, of some 8 n n triangles."""
    mesh = sphere(2 * n, 2 * n, 64.0)
    bumps = rng.integers(-3, 4, mesh.positions.shape)
    return source_mesh(mesh.positions + bumps, mesh.faces)


def dense_soup(rng: np.random.Generator, n: int) -> SourceMesh:
    """Triangles without order on a coarse grid: edges of many faces."""
    places = np.indices((5, 5, 5)).reshape(3, -1).T
    return source_mesh(places, rng.integers(0, len(places), (12 * n, 3)))


def many_boxes(rng: np.random.Generator, n: int) -> SourceMesh:
    """Boxes that touch, cross and hold each other, in one object."""
    places = rng.integers(0, 2 * n, (2 * n, 3)).astype(float)
    return joined(*[cube(float(rng.integers(1, n)), tuple(at)) for at in places])


def sponge(rng: np.random.Generator, n: int) -> SourceMesh:
    """The surface of random cells: touching along edges and at corners."""
    return voxels(rng.random((3 + n // 4,) * 3) < 0.4)


LARGER = {f.__name__: f for f in (bumpy_field, bumpy_sphere, dense_soup, many_boxes, sponge)}


@cache
def larger(name: str, seed: int) -> Prepared:
    """Prepare an object of hundreds of pairs beside a smaller one: trees of several levels."""
    rng = np.random.default_rng(seed)
    make = LARGER[name]
    big, small = make(rng, int(rng.integers(8, 13))), make(rng, 3)
    return prepare(side_by_side(big, moved(small, (20.0, 0.0, 0.0))), BuildConfig())


@st.composite
def extreme_lights(draw: st.DrawFn) -> np.ndarray:
    """Coordinates in the cache frame from nothing to the end of float32, in any mixture."""
    size = st.sampled_from(EXTREMES) | st.floats(allow_nan=False, allow_infinity=False, width=32)
    signed = st.builds(lambda x, s: float(x * s), size, st.sampled_from([-1.0, 1.0]))
    xyz = draw(arrays(np.float64, 3, elements=signed), label="extreme")
    w = draw(st.sampled_from([0.0, 1.0]), label="w")
    if w == 0.0 and not xyz.any():
        xyz[0] = SMALLEST
    return np.array([*xyz, w], np.float32)


@st.composite
def tied_lights(draw: st.DrawFn, prepared: Prepared) -> np.ndarray:
    """A corner of a face, that and a multiple of a side of it, or the side's direction."""
    mesh = prepared.mesh
    face = draw(st.integers(0, len(mesh.faces) - 1), label="face")
    side = draw(st.integers(0, 2), label="side")
    start, end = mesh.positions[mesh.faces[face, [side, (side + 1) % 3]]].astype(np.float64)
    times = draw(st.integers(-3, 3), label="times")
    if draw(st.booleans(), label="direction"):
        return np.append((end - start) * (times or 1), 0.0).astype(np.float32)
    return np.append(start + (end - start) * times, 1.0).astype(np.float32)


def draw_light(data: st.DataObject, prepared: Prepared) -> np.ndarray:
    """Draw a light in the cache frame: near, extreme, or in a face's plane."""
    kind = data.draw(st.sampled_from(["near", "extreme", "tied"]), label="kind")
    if kind == "near":
        return in_cache_frame(prepared, data.draw(lights()))
    return data.draw(extreme_lights() if kind == "extreme" else tied_lights(prepared))


def assert_equal(result: Silhouette, expected: SilhouetteRows) -> None:
    assert result.edge.tolist() == expected.edge.tolist(), result.method
    assert result.multiplicity.tolist() == expected.multiplicity.tolist(), result.method
    assert result.object_start.tolist() == expected.object_start.tolist(), result.method


def pairs(prepared: Prepared) -> np.ndarray:
    """Tell which edge records are pairs and not planar."""
    flags = prepared.edges.flags
    is_pair = flags & np.uint8(EdgeFlag.KIND_MASK) == EdgeKind.PAIR
    return is_pair & (flags & np.uint8(EdgeFlag.PLANAR) == 0)


def assert_twins_agree(prepared: Prepared, light: np.ndarray, volume: str) -> None:
    """Check every method, the walks over faces and the published tree against one another."""
    twin = SilhouetteTwin(prepared)
    expected = twin.rows(light, volume)
    for method in METHODS:
        assert_equal(silhouette(prepared, light, method, volume=volume), expected)
    face_counts = np.diff(prepared.components.face_start)
    is_closed = np.repeat(twin.is_closed(light, volume), face_counts)
    for walk in (eliminate_edges, edge_buffer):
        found = walk(prepared.edges.rows, twin.facing(light), is_closed)
        assert list(found) == expected.edge.tolist()
        assert list(found.values()) == expected.multiplicity.tolist()
    visited = visit_hextree(build_hextree(prepared), light).edge
    m = twin.multiplicity(light, volume)
    needed = np.flatnonzero(pairs(prepared) & (m != 0))
    assert visited[m[visited] != 0].tolist() == needed.tolist()


@given(mesh=any_mesh(), data=st.data())
@settings(max_examples=150)
def test_every_method_agrees_with_the_twins(mesh: SourceMesh, data: st.DataObject) -> None:
    prepared = prepared_or_none(mesh)
    assume(prepared is not None)
    volume = data.draw(st.sampled_from(VOLUMES), label="volume")
    for _ in range(3):
        assert_twins_agree(prepared, draw_light(data, prepared), volume)


@cache
def of_suite(name: str) -> Prepared:
    return prepare(SUITE[name](), BuildConfig())


@pytest.mark.parametrize("name", [name for name in SUITE if name != "nothing"])
def test_every_method_agrees_on_the_suite(name: str) -> None:
    prepared = of_suite(name)
    n = 1 if name == "sphere" else 3
    for light in hard_lights(prepared, n * len(KINDS), seed=2):
        for volume in VOLUMES:
            assert_twins_agree(prepared, light, volume)


@given(data=st.data())
@settings(max_examples=100)
def test_every_method_agrees_on_larger_objects(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(LARGER)), label="mesh")
    prepared = larger(name, data.draw(st.integers(0, 3), label="seed"))
    twin, tree = SilhouetteTwin(prepared), build_hextree(prepared)
    lights = [draw_light(data, prepared) for _ in range(4)]
    seed = data.draw(st.integers(0, 99), label="seed of lights")
    for light in [*lights, *hard_lights(prepared, len(KINDS), seed)]:
        for volume in VOLUMES:
            expected = twin.rows(light, volume)
            for method in METHODS:
                assert_equal(silhouette(prepared, light, method, volume=volume), expected)
        m = twin.multiplicity(light, "robust")
        visited = visit_hextree(tree, light).edge
        needed = np.flatnonzero(pairs(prepared) & (m != 0))
        assert np.array_equal(visited[m[visited] != 0], needed)


@pytest.mark.parametrize("name", sorted(LARGER))
@pytest.mark.parametrize("w", [0.0, 1.0], ids=["directions", "points"])
def test_lights_that_graze_the_faces(name: str, w: float) -> None:
    """Anywhere in the planes of faces, but for float32's rounding: where bounds are tight."""
    prepared = larger(name, 0)
    twin, mesh = SilhouetteTwin(prepared), prepared.mesh
    rng = np.random.default_rng(3)
    a, b, c = mesh.positions[mesh.faces[rng.integers(len(mesh.faces), size=300)].T].astype(float)
    u, v = rng.normal(size=(2, 300, 1)) * 10.0 ** rng.uniform(-1, 3, (300, 1))
    xyz = w * a + u * (b - a) + v * (c - a)
    for light in np.column_stack((xyz, np.full(300, w))).astype(np.float32):
        expected = twin.rows(light)
        for method in ("flat", "cones", "hextree"):
            assert_equal(silhouette(prepared, light, method), expected)


@pytest.mark.parametrize("name", ["soup", "Klein bottle", "nested", "two objects"])
def test_lights_of_extreme_numbers(name: str) -> None:
    """Every mixture of a few extremes, where Hypothesis finds only some."""
    prepared = of_suite(name)
    twin = SilhouetteTwin(prepared)
    numbers = [0.0, 1.0, -1e30, 3e38, -SMALLEST]
    for xyz in np.stack(np.meshgrid(numbers, numbers, numbers), axis=-1).reshape(-1, 3):
        for w in (0.0, 1.0):
            if w == 0.0 and not xyz.any():
                continue
            light = np.append(xyz, w).astype(np.float32)
            expected = twin.rows(light)
            for method in METHODS:
                assert_equal(silhouette(prepared, light, method), expected)


@given(mesh=any_mesh(), data=st.data())
@settings(max_examples=60)
def test_the_opposite_direction_turns_the_robust_silhouette_round(
    mesh: SourceMesh, data: st.DataObject
) -> None:
    """Facing changes its sign at every plane, so m does: on the same edges, as often.

    Where no face is edge-on, solids may take the closed volume, too: for the two
    faces of an edge, [s < 0] = 1 - [s > 0], and so the difference changes its sign.
    """
    prepared = prepared_or_none(mesh)
    assume(prepared is not None)
    light = draw_light(data, prepared)
    assume(light[:3].any())
    light[3] = 0.0
    opposite = np.append(-light[:3], light[3])
    has_ties = not SilhouetteTwin(prepared).facing(light).all()
    for method in METHODS:
        for volume in ("robust",) if has_ties else ("robust", "auto"):
            there = silhouette(prepared, light, method, volume=volume)
            back = silhouette(prepared, opposite, method, volume=volume)
            assert np.array_equal(there.edge, back.edge)
            assert np.array_equal(there.multiplicity, -back.multiplicity)


@given(mesh=any_mesh(), light=lights(), exponent=st.integers(-40, 40))
@settings(max_examples=40)
def test_the_length_of_a_direction_means_nothing(
    mesh: SourceMesh, light: np.ndarray, exponent: int
) -> None:
    """Powers of two scale every sum without rounding, so ties stay ties."""
    prepared = prepared_or_none(mesh)
    assume(prepared is not None)
    assume(np.abs(light[:3][light[:3] != 0]).min(initial=1.0) > 1e-20 and light[:3].any())
    light[3] = 0.0
    for method in METHODS:
        short = silhouette(prepared, light, method)
        long = silhouette(prepared, light * np.float32(2.0**exponent), method)
        assert np.array_equal(short.edge, long.edge)
        assert np.array_equal(short.multiplicity, long.multiplicity)


@st.composite
def rows_of_objects(draw: st.DrawFn) -> tuple[list[SourceMesh], list[int]]:
    """Two to five objects within one box, and another order of them."""
    part = st.one_of(solids(), grid_meshes(8), voxel_meshes())
    parts = draw(st.lists(part, min_size=2, max_size=5), label="objects")
    parts = [moved(p, (5.0 * i, 0.0, 0.0)) for i, p in enumerate(parts)]
    return parts, draw(st.permutations(range(len(parts))), label="order")


@given(drawn=rows_of_objects(), data=st.data())
@settings(max_examples=60)
def test_objects_are_chosen_and_ordered_freely(
    drawn: tuple[list[SourceMesh], list[int]], data: st.DataObject
) -> None:
    """Asking for some objects, in any order, gives their parts of the whole silhouette."""
    parts, order = drawn
    prepared = prepared_or_none(side_by_side(*parts))
    assume(prepared is not None)
    light = draw_light(data, prepared)
    volume = data.draw(st.sampled_from(VOLUMES), label="volume")
    chosen = data.draw(st.sets(st.sampled_from(order)), label="chosen")
    asked = [i for i in order if i in chosen]
    expected = SilhouetteTwin(prepared).rows(light, volume, sorted(chosen))
    for method in METHODS:
        whole = silhouette(prepared, light, method, volume=volume)
        some = silhouette(prepared, light, method, volume=volume, objects=asked)
        assert_equal(some, expected)
        assert some.objects.tolist() == sorted(chosen)
        start = whole.object_start
        rows = [np.arange(start[i], start[i + 1]) for i in sorted(chosen)]
        rows = np.concatenate([np.zeros(0, np.int64), *rows])
        assert np.array_equal(some.edge, whole.edge[rows])
        assert np.array_equal(some.multiplicity, whole.multiplicity[rows])


@given(drawn=rows_of_objects(), data=st.data())
@settings(max_examples=40)
def test_the_order_of_objects_in_the_model_means_nothing(
    drawn: tuple[list[SourceMesh], list[int]], data: st.DataObject
) -> None:
    parts, order = drawn
    prepared = prepared_or_none(side_by_side(*parts))
    assume(prepared is not None)
    shuffled = prepare(side_by_side(*[parts[i] for i in order]), BuildConfig())
    assert np.array_equal(prepared.mesh.grid.origin_m, shuffled.mesh.grid.origin_m)
    light = draw_light(data, prepared)
    for method in METHODS:
        a, b = silhouette(prepared, light, method), silhouette(shuffled, light, method)
        for new, old in enumerate(order):
            assert local_rows(prepared, a, old) == local_rows(shuffled, b, new)


def local_rows(prepared: Prepared, result: Silhouette, i: int) -> tuple[list[int], list[int]]:
    """Return one object's silhouette, its edges numbered from its first."""
    start, components = result.object_start, prepared.components
    rows = slice(start[i], start[i + 1])
    first = components.edge_start[components.object_start[i]]
    edges = (result.edge[rows].astype(np.int64) - first).tolist()
    return edges, result.multiplicity[rows].tolist()


@given(mesh=any_mesh(), data=st.data())
@settings(max_examples=60)
def test_the_work_told_is_possible_and_repeats(mesh: SourceMesh, data: st.DataObject) -> None:
    """No edge is found that was not looked at; border and split records aside."""
    prepared = prepared_or_none(mesh)
    assume(prepared is not None)
    light = draw_light(data, prepared)
    for method in METHODS:
        result = silhouette(prepared, light, method)
        assert result.work.n_edges >= pairs(prepared)[result.edge].sum()
        assert result.work.n_nodes >= 0
        assert silhouette(prepared, light, method).work == result.work


def test_the_published_hextree_passes_over_most_of_a_sphere() -> None:
    """Its dual segments are short, so most lie in small cells: the index does its work."""
    prepared = prepare(sphere(), BuildConfig())
    tree = build_hextree(prepared)
    assert tree.n_edges > 1_000
    light = np.array([0.3, -0.5, 0.8, 0.0], np.float32)
    visit = visit_hextree(tree, light)
    assert len(visit.edge) < tree.n_edges / 2
    assert 0 < visit.n_cells <= sum(len(level.parent) for level in tree.levels)
