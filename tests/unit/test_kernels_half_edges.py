"""Half-edges grouped, paired and written, against plain twins."""

from __future__ import annotations

from itertools import product

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svprep import reference
from svprep.kernels.half_edges import (
    group_half_edges,
    pair_half_edges,
    rebuild_faces,
    write_edge_rows,
)
from svprep.repair.split import EdgeGroups, doubles, join, loose_faces
from tests.property.meshes import arrays


def different_corners(draw: st.DrawFn, n_faces: int, n_vertices: int) -> np.ndarray:
    """Draw faces whose three corners differ; edges of many faces are common."""
    element = st.tuples(
        st.integers(0, n_vertices - 1), st.integers(1, n_vertices - 1), st.integers(0, 1)
    )
    faces = []
    for a, step, side in draw(st.lists(element, min_size=n_faces, max_size=n_faces)):
        b = (a + step) % n_vertices
        rest = [v for v in range(n_vertices) if v not in (a, b)]
        faces.append([a, b, rest[(step + 3 * side) % len(rest)]])
    return np.array(faces, np.uint32).reshape(-1, 3)


@st.composite
def face_sets(draw: st.DrawFn) -> np.ndarray:
    return different_corners(draw, draw(st.integers(0, 25)), draw(st.integers(3, 6)))


def group(faces: np.ndarray, n_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    order, is_first = np.empty(3 * len(faces), np.int32), np.empty(3 * len(faces), bool)
    face_start = np.array([0, len(faces)], np.int64)
    begin, end = np.array([0], np.int64), np.array([n_vertices], np.int64)
    group_half_edges(faces, face_start, begin, end, 0, 1, order, is_first)
    return order, np.append(np.flatnonzero(is_first), len(order)).astype(np.int64)


def pair(points: np.ndarray, faces: np.ndarray, flips: np.ndarray) -> np.ndarray:
    order, start = group(faces, len(points))
    mate = np.full(3 * len(faces), -7, np.int32)
    most = int(np.diff(start).max(initial=1))
    points = points.astype(np.int32)
    groups = EdgeGroups(order=order, start=start)
    h, g = doubles(groups)
    loose = loose_faces(join(h // 3, g // 3, np.arange(len(faces), dtype=np.int32)), groups)
    middle = len(start) // 2  # in two ranges, as threads would
    for begin, end in ((middle, len(start) - 1), (0, middle)):
        pair_half_edges(points, faces, flips, loose, order, start, begin, end, most, mate)
    return mate


@given(st.lists(face_sets(), min_size=1, max_size=4))
def test_group_half_edges(objects: list[np.ndarray]) -> None:
    counts = [int(f.max()) + 1 if len(f) else 0 for f in objects]
    begin = np.cumsum([0, *counts])
    faces = np.vstack([f + np.uint32(b) for f, b in zip(objects, begin[:-1], strict=True)])
    face_start = np.cumsum([0, *map(len, objects)])
    order = np.full(3 * len(faces), -7, np.int32)
    is_first = np.zeros(3 * len(faces), bool)
    for i in reversed(range(len(objects))):
        group_half_edges(faces, face_start, begin[:-1], begin[1:], i, i + 1, order, is_first)
    groups = list(reference.group_edges(faces).values())
    assert order.tolist() == [h for members in groups for h in members]
    firsts = np.cumsum([0, *map(len, groups)])[:-1] if groups else []
    np.testing.assert_array_equal(np.flatnonzero(is_first), firsts)


def check_pairs(points: np.ndarray, faces: np.ndarray, flips: np.ndarray) -> None:
    assert pair(points, faces, flips).tolist() == reference.pair_edges(points, faces, flips)


@given(face_sets(), st.data())
@settings(max_examples=200)
def test_pair_half_edges(faces: np.ndarray, data: st.DataObject) -> None:
    """Vertices in general position, few enough that edges are crowded."""
    points = np.array([[0, 0, 0], [7, 1, 2], [1, 8, 3], [-2, 3, 9], [-5, -7, 1], [3, -4, -8]])
    flips = data.draw(arrays(bool, len(faces)), label="flips")
    check_pairs(points, faces, flips)


@st.composite
def fans(draw: st.DrawFn, reach: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces around one edge; thirds on few rays, so that directions coincide."""
    axis = draw(st.sampled_from([(0, 0, 1), (0, 0, 3), (1, 2, 2), (-1, 3, 5)]), label="axis")
    element = st.tuples(*[st.integers(-reach, reach)] * 3).filter(lambda p: any(np.cross(p, axis)))
    thirds = draw(st.lists(element, min_size=3, max_size=14), label="thirds")
    points = np.array([(0, 0, 0), axis, *thirds])
    turn = draw(st.integers(0, 2 ** len(thirds) - 1), label="turn")
    faces = [[0, 1, 2 + i] if turn >> i & 1 else [2 + i, 1, 0] for i in range(len(thirds))]
    flips = draw(hnp.arrays(bool, len(thirds), fill=st.just(False)), label="flips")
    return points, np.array(faces, np.uint32), flips


@given(fans(1))
@settings(max_examples=300)
def test_pair_half_edges_with_equal_directions(
    fan: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    check_pairs(*fan)


@given(fans(2**24))
@settings(max_examples=100)
def test_pair_half_edges_far_out(fan: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    check_pairs(*fan)


@st.composite
def spokes(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces around one edge on three rays, near and far: in float64 the angles of one
    ray differ in the last bit, and the tie rule must hold all the same."""
    axis = np.array(draw(st.sampled_from([(1, 2, 2), (-1, 3, 5), (7, -3, 1)]), label="axis"))
    rays = np.array([(5, 1, -2), (-3, 4, 7), (1, -6, 2)])
    element = st.tuples(st.integers(0, 2), st.integers(1, 40), st.integers(-2, 2), st.booleans())
    drawn = draw(st.lists(element, min_size=4, max_size=12), label="spokes")
    thirds = [rays[ray] * k + axis * j for ray, k, j, _ in drawn]
    faces = [[0, 1, 2 + i] if turn else [1, 0, 2 + i] for i, (*_, turn) in enumerate(drawn)]
    points = np.vstack(([0, 0, 0], axis, thirds))
    return points, np.array(faces, np.uint32), np.zeros(len(faces), bool)


@given(spokes())
@settings(max_examples=200)
def test_pair_half_edges_on_rays(case: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    check_pairs(*case)


def test_pair_half_edges_of_many_faces() -> None:
    """Every direction of a square ring, at two distances, each both ways round."""
    ring = np.array([p for p in product(range(-6, 7), repeat=2) if max(map(abs, p)) == 6])
    thirds = np.vstack((ring, 2 * ring, ring))
    rng = np.random.default_rng(4)
    thirds = np.column_stack((thirds, rng.integers(-3, 4, len(thirds))))[
        rng.permutation(len(thirds))
    ]
    points = np.vstack(([[0, 0, 0], [0, 0, 5]], thirds))
    faces = np.array([[0, 1, 2 + i] if rng.random() < 0.5 else [1, 0, 2 + i] for i in range(144)])
    for seed in range(5):
        flips = np.random.default_rng(seed).random(144) < 0.3
        check_pairs(points, faces.astype(np.uint32), flips)


@pytest.mark.parametrize("opens", range(16))
def test_directions_too_close_to_tell_still_pair_consistently(opens: int) -> None:
    """Two rays 1.8e-15 rad apart count as one: faces pair all the same, and only in
    opposite directions. (The exact twin may pair them otherwise.)"""
    m = 2**24
    thirds = [(m, m - 1, 0), (m - 1, m - 2, 0), (m - 2, m - 3, 0), (-m, 3, 1)]
    points = np.array([(0, 0, 0), (0, 0, 1), *thirds])
    faces = [[0, 1, 2 + i] if opens >> i & 1 else [1, 0, 2 + i] for i in range(4)]
    faces = np.array(faces, np.uint32)
    mate = pair(points, faces, np.zeros(4, bool))
    n_up = opens.bit_count()
    assert (mate >= 0).sum() == 2 * min(n_up, 4 - n_up)
    for h, other in enumerate(mate.tolist()):
        if other >= 0:
            assert mate[other] == h
            assert (opens >> h // 3 & 1) != (opens >> other // 3 & 1)


def test_touching_wedges_keep_their_own_pairs() -> None:
    """Four faces around an edge, two wedges of material that share it.

         2
      ###|          seen along lo -> hi (out of the page), material in # and *
    3 ---+--- 5     3 closes what 2 opened, 5 what 4 opened
         |***
         4
    """
    points = np.array([(0, 0, 0), (0, 0, 1), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (1, 0, 0)])
    faces = np.array([[1, 0, 2], [0, 1, 3], [1, 0, 4], [0, 1, 5]], np.uint32)
    mate = pair(points, faces, np.zeros(4, bool))
    assert [mate[3 * f] // 3 for f in range(4)] == [1, 0, 3, 2]
    # Turned inside out, the empty wedges are material, and pairs change over.
    mate = pair(points, faces, np.ones(4, bool))
    assert [mate[3 * f] // 3 for f in range(4)] == [3, 2, 1, 0]


@given(face_sets(), st.data())
def test_edge_rows(faces: np.ndarray, data: st.DataObject) -> None:
    """Records of any pairing, not only of the one that pairing would choose."""
    points = np.array([[0, 0, 0], [7, 1, 2], [1, 8, 3], [-2, 3, 9], [-5, -7, 1], [3, -4, -8]])
    mate = pair(points, faces, np.zeros(len(faces), bool))
    cut = data.draw(hnp.arrays(bool, len(mate), fill=st.just(False)), label="cut")
    cut |= np.where(mate >= 0, cut[mate], False)
    mate[cut] = -1
    plane_of_face = data.draw(
        arrays(np.uint32, len(faces), elements=st.integers(0, 2)), label="planes"
    )
    component = data.draw(arrays(np.int32, len(faces), elements=st.integers(0, 2)))
    for h in np.flatnonzero(mate >= 0).tolist() * 3:  # what is paired lies in one
        component[h // 3] = component[mate[h] // 3] = min(component[[h // 3, mate[h] // 3]])
    expected_rows, expected_flags = reference.edge_rows(faces, mate, component, plane_of_face)
    order, start = group(faces, 6)
    left = np.where(expected_rows[:, 2] < len(faces), expected_rows[:, 2], expected_rows[:, 3])
    begin = np.searchsorted(component[left], np.arange(3))
    rows = np.empty((len(expected_rows), 4), np.uint32)
    flags = np.empty(len(rows), np.uint8)
    write_edge_rows(faces, order, start, mate, component, begin, plane_of_face, rows, flags)
    np.testing.assert_array_equal(rows, expected_rows)
    np.testing.assert_array_equal(flags, expected_flags)


@given(face_sets(), st.data())
def test_rebuild_faces(faces: np.ndarray, data: st.DataObject) -> None:
    """Every side keeps its mate, its place and, turned if its face is, its direction."""
    points = np.array([[0, 0, 0], [7, 1, 2], [1, 8, 3], [-2, 3, 9], [-5, -7, 1], [3, -4, -8]])
    mate = pair(points, faces, np.zeros(len(faces), bool))
    is_flipped = data.draw(arrays(bool, len(faces)), label="flips")
    kept = data.draw(st.permutations(range(len(faces))), label="order")
    kept = kept[: data.draw(st.integers(0, len(faces)), label="how many stay")]
    mate[~np.isin(mate // 3, kept)] = -1  # no mate is left out
    order = np.array(kept, np.int32)
    rebuilt = np.empty((len(order), 3), np.uint32)
    rebuilt_mate = np.empty(3 * len(order), np.int32)
    old_vertex = np.empty(6, np.uint32)
    n_vertices = rebuild_faces(faces, is_flipped, mate, order, rebuilt, rebuilt_mate, old_vertex)

    expected = [faces[f, [0, 2, 1]] if is_flipped[f] else faces[f] for f in kept]
    assert old_vertex[rebuilt].tolist() == [corners.tolist() for corners in expected]
    used = list(dict.fromkeys(np.array(expected, int).reshape(-1).tolist()))
    assert old_vertex[:n_vertices].tolist() == used, "vertices not in the order of their use"

    def half_edge(h: int) -> int:
        f, side = divmod(h, 3)
        return 3 * kept.index(f) + (2 - side if is_flipped[f] else side)

    for h, other in enumerate(mate.tolist()):
        if h // 3 in kept:
            assert rebuilt_mate[half_edge(h)] == (half_edge(other) if other >= 0 else -1)
