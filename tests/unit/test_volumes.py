"""Lists of what shadow volumes are drawn from, against the rules said plainly."""

from __future__ import annotations

from collections import Counter, defaultdict

import numpy as np
import pytest

from svprep.light import parse_light
from svprep.model import NO_INDEX, ComponentFlag, Prepared
from svprep.pipeline import BuildConfig, prepare
from svprep_runtime.volumes import (
    ENDLESS,
    SIGN_BIT,
    CastersOf,
    Segments,
    casters_of,
    edge_vertices,
    face_entries,
    face_neighbours,
    segments_of,
    volume_lists,
)
from tests.property.meshes import (
    SMALL_SUITE,
    cube,
    open_shell,
    side_by_side,
    source_mesh,
    strip_of_one_side,
)
from tests.unit.cache_samples import nothing, strip_and_tetrahedron
from tests.unit.hours_scenes import box, city, level

SUN = np.array([0.48, -0.36, 0.8, 0.0], np.float32)
SUITE = [name for name in SMALL_SUITE if name != "nothing"]


def lamp(x: float, y: float, z: float) -> np.ndarray:
    return np.array([x, y, z, 1.0], np.float32)


def suite_city(name: str) -> Prepared:
    return prepare(SMALL_SUITE[name](), BuildConfig())


def pairs(entries: np.ndarray) -> Counter[tuple[int, int]]:
    assert entries.dtype == np.uint32
    assert entries.shape[1] == 2
    return Counter(map(tuple, entries.tolist()))


def all_caps(lists: object) -> list[np.ndarray]:
    kinds = ("light_caps", "near_caps", "far_caps", "endless_caps")
    return [entries for kind in kinds for entries in getattr(lists, kind)]


# Facing, multiplicities, closed and robust -------------------------------------------------------


@pytest.mark.parametrize("light", [SUN, lamp(0.3, 9.7, 5.1), lamp(0.5, 0.25, 0.75)], ids=str)
@pytest.mark.parametrize("name", SUITE)
def test_sides_are_those_of_the_faces_that_count(name: str, light: np.ndarray) -> None:
    """Per directed line between two vertices, sides are as many as faces leave over."""
    prepared = suite_city(name)
    casters = casters_of(prepared, light)
    lists = volume_lists(casters, segments_of(prepared, light, clamped=False))
    expected: defaultdict[tuple[int, int], int] = defaultdict(int)
    for face in np.flatnonzero(casters.counts).tolist():
        corners = prepared.mesh.faces[face].tolist()
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            sign = int(casters.facing[face]) * (1 if a < b else -1)
            expected[min(a, b), max(a, b)] += sign
    found: defaultdict[tuple[int, int], int] = defaultdict(int)
    is_sun = light[3] == 0.0
    sides, none = (lists.sides_to_point, lists.sides) if is_sun else (
        lists.sides, lists.sides_to_point
    )  # fmt: skip
    assert not len(none)
    for entry, _ in sides.tolist():
        low, high = prepared.edges.rows[entry & 0x7FFFFFFF, :2].tolist()
        found[low, high] += 1 if entry & SIGN_BIT else -1
    assert {k: v for k, v in found.items() if v} == {k: v for k, v in expected.items() if v}


def test_a_fold_takes_its_side_twice() -> None:
    #   two faces that wind alike across the ridge, one lit from its front, one from its back
    vertices = np.array([[0, 0, 0], [0, 4, 0], [2, 2, 4], [3, 2, 1]])
    prepared = prepare(source_mesh(vertices, np.array([[0, 1, 2], [1, 0, 3]])), BuildConfig())
    origin = prepared.mesh.grid.origin_m
    found = set()
    for x in range(-9, 10):
        for z in range(-9, 10):
            light = np.array([*(np.array([x + 0.3, 2.0, z + 0.4]) - origin), 1.0], np.float32)
            casters = casters_of(prepared, light)
            lists = volume_lists(casters, segments_of(prepared, light, clamped=False))
            times = pairs(lists.sides)
            for edge, m in zip(casters.edge.tolist(), casters.multiplicity.tolist(), strict=True):
                key = edge | (int(SIGN_BIT) if m > 0 else 0)
                assert times[key, 0] == abs(m)
                found.add(m)
            assert sum(times.values()) == np.abs(casters.multiplicity.astype(int)).sum()
    assert found == {-2, -1, 1, 2}


def test_solids_take_half_unless_the_light_is_inside() -> None:
    prepared = city(cube(4.0), open_shell())
    solid, shell = prepared.components.flags & np.uint8(ComponentFlag.SOLID)
    assert solid
    assert not shell
    origin = prepared.mesh.grid.origin_m
    casters = casters_of(prepared, SUN)
    assert casters.is_closed.tolist() == [True, False]
    of_cube = casters.component_of_face == 0
    assert (casters.counts[of_cube] == (casters.facing[of_cube] > 0)).all()
    assert (casters.counts[~of_cube] == (casters.facing[~of_cube] != 0)).all()
    assert casters.counts[of_cube].sum() == 6
    for at, is_closed in (
        ((2.1, 1.3, 2.7), False), ((4.5, 1.3, 2.7), True), ((2.0, 2.0, 4.0), False),
    ):  # fmt: skip
        casters = casters_of(prepared, lamp(*(np.array(at) - origin)))
        assert casters.is_closed.tolist() == [is_closed, False], at
        expected = casters.facing > 0 if is_closed else casters.facing != 0
        assert (casters.counts[of_cube] == expected[of_cube]).all()


def test_edge_on_faces_cast_nothing() -> None:
    prepared = city(open_shell())
    east = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
    casters = casters_of(prepared, east)
    assert (casters.facing == 0).sum() > 5
    assert not casters.counts[casters.facing == 0].any()
    towards, away = face_entries(casters, segments_of(prepared, east, clamped=False))
    assert sorted([*towards[:, 0], *away[:, 0]]) == np.flatnonzero(casters.facing).tolist()


def test_of_a_city_of_nothing_there_is_nothing() -> None:
    prepared = nothing()
    for light in (SUN, lamp(1, 2, 3)):
        casters = casters_of(prepared, light)
        lists = volume_lists(casters, segments_of(prepared, light, clamped=True))
        assert lists.n_triangles == 0
    assert face_neighbours(prepared.mesh, prepared.edges).shape == (0, 3)


# Segments ----------------------------------------------------------------------------------------


def by_hand(is_directional: bool) -> tuple[Prepared, CastersOf, Segments]:
    """Return three casters with two segments, none, and one without an end."""
    prepared = city(cube(2.0), open_shell(), strip_of_one_side(9))
    light = SUN if is_directional else lamp(3.1, 17.3, 9.9)
    table = [
        [-ENDLESS, 2.0, 0.0, 0.0],
        [3.0, 4.0, 0.5, 0.25],
        [-ENDLESS, ENDLESS, 0.0, 0.0],
        [-ENDLESS, ENDLESS, 0.0, 0.0],
    ]
    segments = Segments(
        start=np.array([0, 2, 2, 3]),
        table=np.array(table, np.float32),
        frame=np.eye(3, dtype=np.float32),
        is_clamped=True,
    )
    return prepared, casters_of(prepared, light), segments


@pytest.mark.parametrize("is_directional", [True, False])
def test_each_caster_is_drawn_once_a_segment(is_directional: bool) -> None:
    _, casters, segments = by_hand(is_directional)
    lists = volume_lists(casters, segments)
    component = casters.component_of_edge
    times = np.abs(casters.multiplicity.astype(int))
    edge = casters.edge.astype(int) | np.where(casters.multiplicity > 0, int(SIGN_BIT), 0)
    ending, endless = Counter(), Counter()
    for e, c, n in zip(edge.tolist(), component.tolist(), times.tolist(), strict=True):
        if c == 0:
            ending[e, 0] += n
            ending[e, 1] += n
        if c == 2:
            endless[e, 2] += n
    assert pairs(lists.sides) == (ending if is_directional else ending + endless)
    assert pairs(lists.sides_to_point) == (endless if is_directional else Counter())
    for i, s in enumerate((1, -1)):
        chosen = casters.counts & (casters.facing == s)
        of = [np.flatnonzero(chosen & (casters.component_of_face == c)).tolist() for c in range(3)]
        first = Counter((f, 0) for f in of[0])
        second = Counter((f, 1) for f in of[0])
        last = Counter((f, 2) for f in of[2])
        assert pairs(lists.light_caps[i]) == first + last
        assert pairs(lists.near_caps[i]) == second
        assert pairs(lists.far_caps[i]) == first + second
        assert pairs(lists.endless_caps[i]) == (Counter() if is_directional else last)
    caps = sum(map(len, all_caps(lists)))
    assert lists.n_triangles == len(lists.sides_to_point) + 2 * len(lists.sides) + caps
    assert len(lists.light_caps[1]) > 0  # the strip has faces turned away


@pytest.mark.parametrize("is_directional", [True, False])
def test_whole_volumes_forget_the_segments(is_directional: bool) -> None:
    prepared, casters, segments = by_hand(is_directional)
    whole = volume_lists(casters, segments, whole=True)
    unclamped = volume_lists(casters, segments_of(prepared, casters.light, clamped=False))
    assert segments.whole == 3
    for name in ("sides_to_point", "sides"):
        np.testing.assert_array_equal(getattr(whole, name)[:, 0], getattr(unclamped, name)[:, 0])
        assert (getattr(whole, name)[:, 1] == 3).all()
    for one, other in zip(all_caps(whole), all_caps(unclamped), strict=True):
        np.testing.assert_array_equal(one[:, 0], other[:, 0])
        assert (one[:, 1] == 3).all()
    assert sum(len(caps) for caps in (*whole.near_caps, *whole.far_caps)) == 0


@pytest.mark.parametrize("whole", [False, True])
def test_chosen_components_add_up_to_all(whole: bool) -> None:
    _, casters, segments = by_hand(False)
    chosen = np.array([True, False, False])
    parts = [volume_lists(casters, segments, c, whole=whole) for c in (chosen, ~chosen)]
    together = volume_lists(casters, segments, whole=whole)
    assert parts[0].n_triangles > 0
    assert parts[1].n_triangles > 0
    assert pairs(parts[0].sides) + pairs(parts[1].sides) == pairs(together.sides)
    for one, other, both in zip(*map(all_caps, (*parts, together)), strict=True):
        assert pairs(one) + pairs(other) == pairs(both)
    assert volume_lists(casters, segments, np.zeros(3, bool), whole=whole).n_triangles == 0


def test_cached_segments_are_found_by_the_light_itself() -> None:
    prepared = strip_and_tetrahedron()
    zenith, at = prepared.clamp.lights
    sun = segments_of(prepared, zenith, clamped=True)
    assert sun.is_clamped
    assert sun.start.tolist() == [0, 2, 3]
    np.testing.assert_array_equal(
        sun.table,
        np.array(
            [
                [-ENDLESS, -3.9, 0, 0],
                [-1.5, 0.5, -0.5, 1.0],
                [-ENDLESS, 0.1, 0, 0],
                [-ENDLESS, ENDLESS, 0, 0],
            ],
            np.float32,
        ),
    )
    np.testing.assert_array_equal(sun.frame, prepared.clamp.frames[0])
    light = segments_of(prepared, at, clamped=True)
    assert light.table[:, 1].tolist() == [np.float32(1.1), ENDLESS, np.float32(1.5), ENDLESS]
    assert light.table[:, 0].tolist() == [-ENDLESS, 1.25, -ENDLESS, -ENDLESS]
    for other, clamped in ((zenith, False), (SUN, True), (np.nextafter(at, np.float32(9)), True)):
        whole = segments_of(prepared, other, clamped=clamped)
        assert not whole.is_clamped
        assert whole.table.tolist() == [[-ENDLESS, ENDLESS, 0, 0]]
        assert whole.whole == 0


def test_a_light_that_was_clamped_gives_each_caster_its_segments() -> None:
    spec = parse_light("dir:127,38")
    source = side_by_side(level(-9, -9, 9, 9), box((-2, -2, 3), (2, 2, 4)), cube(1.0))
    prepared = prepare(source, BuildConfig(), lights=[spec])
    light = spec.in_cache_frame(prepared.mesh.grid)
    segments = segments_of(prepared, light, clamped=True)
    casters = casters_of(prepared, light)
    n = np.diff(segments.start)
    towards, away = face_entries(casters, segments)
    found = Counter(np.concatenate([towards, away])[:, 0].tolist())
    for face in range(len(prepared.mesh.faces)):
        expected = n[casters.component_of_face[face]] if casters.counts[face] else 0
        assert found[face] == expected


# Adjacency ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SUITE)
def test_neighbours_are_those_of_a_plain_double_loop(name: str) -> None:
    prepared = suite_city(name)
    faces, rows = prepared.mesh.faces.tolist(), prepared.edges.rows.tolist()
    found = face_neighbours(prepared.mesh, prepared.edges)
    assert found.dtype == np.uint32
    assert found.flags.c_contiguous
    for face, corners in enumerate(faces):
        for k in range(3):
            side = corners[k], corners[(k + 1) % 3]
            beyond = [right for a, b, left, right in rows if left == face and (a, b) == side]
            beyond += [left for a, b, left, right in rows if right == face and (b, a) == side]
            assert [found[face, k]] == beyond, (face, k)
            if beyond != [NO_INDEX]:  # and it is mutual
                assert face in found[beyond[0]].tolist()


def test_vertices_of_edges_are_laid_out_for_upload() -> None:
    prepared = suite_city("soup")
    found = edge_vertices(prepared.edges)
    assert found.flags.c_contiguous
    assert found.dtype == np.uint32
    np.testing.assert_array_equal(found, prepared.edges.rows[:, :2])
