"""Polygons with holes: every ring edge on one triangle, the right area, or a finding."""

from __future__ import annotations

import time
import warnings
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from svprep.defects import Code
from svprep.ingest import holes
from svprep.ingest.holes import triangulate_rings
from svprep.ingest.triangulation import triangulate

CROSSING = Code.SELF_CROSSING_POLYGON
SQUARE = [(0, 0), (8, 0), (8, 8), (0, 8)]


def run(*polygons, lift=(0.0, 0.0), roll=0):
    """Triangulate polygons, each a list of rings of (x, y); return the result and the points."""
    points = np.array([p for rings in polygons for ring in rings for p in ring], float)
    points = points.reshape(-1, 2)
    points = np.roll(np.column_stack([points, points @ np.array(lift)]), roll, axis=1)
    ring_start = np.cumsum([0] + [len(ring) for rings in polygons for ring in rings])
    polygon_start = np.cumsum([0] + [len(rings) for rings in polygons])
    corners = np.arange(len(points), dtype=np.uint32)
    return triangulate_rings(points, corners, ring_start, polygon_start), points


def areas2(points, triangles):
    a, b, c = points[triangles].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def ring_edges_once(rings, triangles):
    """Each edge of a ring is on one triangle, every other edge on two, one each way."""
    edges = [(int(t[k]), int(t[k - 2])) for t in triangles for k in range(3)]
    first, ends = 0, set()
    for ring in rings:
        n = len(ring)
        ends |= {frozenset([first + i, first + (i + 1) % n]) for i in range(n)}
        first += n
    count = {}
    for a, b in edges:
        count.setdefault(frozenset([a, b]), []).append((a, b))
    return all(len(count.get(end, [])) == 1 for end in ends) and all(
        len(c) == 2 and c[0] == c[1][::-1] for e, c in count.items() if e not in ends
    )


def ends_at_rings(rings, triangles):
    """Edges of rings, one way or the other, are all that is left when opposite edges cancel."""
    net = Counter()
    for t in triangles.tolist():
        for a, b in zip(t, t[1:] + t[:1], strict=True):
            net[min(a, b), max(a, b)] += (a < b) - (a > b)
    first, ends = 0, set()
    for ring in rings:
        n = len(ring)
        ends |= {tuple(sorted([first + i, first + (i + 1) % n])) for i in range(n)}
        first += n
    return all(abs(net[end]) == 1 for end in ends) and not any(
        n for edge, n in net.items() if edge not in ends
    )


def hole(x, y, size=1):
    return [(x, y), (x, y + size), (x + size, y + size), (x + size, y)]


GOOD = {
    "one hole": ([SQUARE, hole(2, 2, 4)], 64 - 16),
    "one hole wound as the outline": ([SQUARE, hole(2, 2, 4)[::-1]], 48),
    "outline clockwise": ([SQUARE[::-1], hole(2, 2, 4)], 48),
    "two holes side by side": ([SQUARE, hole(1, 1), hole(3, 1)], 62),
    "corners on straight edges": (
        [
            [(0, 0), (1, 0), (4, 0), (8, 0), (8, 3), (8, 8), (0, 8), (0, 5)],
            [(2, 2), (2, 3), (2, 6), (6, 6), (6, 2), (5, 2), (3, 2)],
        ],
        48,
    ),
    "repeated corners": ([[*SQUARE, (0, 8)], [*hole(2, 2, 4), (6, 2), (6, 2)]], 48),
    "a triangle in a triangle": ([[(0, 0), (9, 0), (0, 9)], [(1, 1), (1, 2), (2, 1)]], 40),
    "a comb of windows": ([SQUARE, *(hole(x, y) for x in (1, 3, 5) for y in (1, 3, 5))], 55),
}


@pytest.mark.parametrize("roll", [0, 1, 2])
@pytest.mark.parametrize("name", GOOD)
def test_good_polygons(name, roll):
    rings, area = GOOD[name]
    result, points = run(rings, lift=(0.5, -2), roll=roll)
    n = len(points)
    assert result.finding.tolist() == [0]
    assert len(result.triangles) == n + 2 * (len(rings) - 1) - 2
    assert ring_edges_once(rings, result.triangles)
    scale = np.sqrt(1 + 0.25 + 4)
    assert np.isclose(areas2(points, result.triangles).sum(), 2 * area * scale, rtol=1e-12)


BAD = {
    "a hole outside": [SQUARE, hole(20, 20)],
    "a hole around the outline": [SQUARE, hole(-2, -2, 20)],
    "a hole across the outline": [SQUARE, hole(6, 6, 4)],
    "two holes that overlap": [SQUARE, hole(1, 1, 4), hole(3, 3, 4)],
    "a hole in a hole": [SQUARE, hole(1, 1, 6), hole(3, 3, 1)],
    "a doubled hole": [SQUARE, hole(2, 2, 4), hole(2, 2, 4)],
    "a hole at a corner": [SQUARE, [(0, 0), (2, 4), (4, 2)]],
    "a hole at an edge": [SQUARE, [(4, 0), (2, 4), (6, 4)]],
    "a hole along an edge": [SQUARE, [(2, 0), (2, 4), (6, 4), (6, 0)]],
    "holes that touch": [SQUARE, hole(1, 1, 2), hole(3, 3, 2)],
    "a bow tie as a hole": [SQUARE, [(2, 2), (6, 6), (6, 2), (2, 6)]],
    "a bow tie as an outline": [[(0, 0), (8, 8), (8, 0), (0, 8)], hole(6, 4)],
    "a hole on a line": [SQUARE, [(2, 2), (4, 4), (6, 6)]],
    "an outline on a line": [[(0, 0), (4, 0), (8, 0)], hole(2, 2)],
    "a hole as large as its outline": [SQUARE, SQUARE[::-1]],
}


@pytest.mark.parametrize("name", BAD)
def test_bad_polygons_are_kept_and_found(name):
    rings = BAD[name]
    result, points = run(rings)
    assert result.finding.tolist() == [CROSSING]
    assert len(result.triangles) == len(points) + 2 * (len(rings) - 1) - 2
    assert ends_at_rings(rings, result.triangles)


@pytest.mark.parametrize("ring", [[], [(2, 2)], [(2, 2), (3, 3)]])
def test_a_hole_of_fewer_than_three_corners(ring):
    result, _ = run([SQUARE, ring])
    assert result.finding.tolist() == [CROSSING]
    assert len(result.triangles) == 2


def test_an_outline_of_two_corners_is_short():
    result, _ = run([SQUARE[:2], hole(2, 2)], [SQUARE, hole(2, 2)])
    assert result.finding.tolist() == [Code.SHORT_POLYGON, 0]
    assert set(result.polygon_of_triangle.tolist()) == {1}


def test_slightly_bent_and_bent():
    for lift, finding in ((1e-3, 0), (1.0, Code.NONPLANAR_POLYGON)):
        points = np.array([(*p, 0.0) for p in [*SQUARE, *hole(2, 2, 4)]])
        points[[2, 6], 2] = lift
        result = triangulate_rings(
            points, np.arange(8, dtype=np.uint32), np.array([0, 4, 8]), np.array([0, 2])
        )
        assert result.finding.tolist() == [finding]
        assert len(result.triangles) == 8
        assert ring_edges_once([SQUARE, SQUARE], result.triangles)


def test_shared_indices_are_no_repeated_corners():
    points = np.array([(*p, 0.0) for p in [*SQUARE, (2, 4), (4, 2)]])
    corners = np.array([0, 1, 2, 2, 3, 0, 4, 5], np.uint32)  # a hole at corner 0
    result = triangulate_rings(points, corners, np.array([0, 5, 8]), np.array([0, 2]))
    assert result.finding.tolist() == [CROSSING]
    assert len(result.triangles) == 7
    assert areas2(points, result.triangles).sum() == 2 * (64 - 6)


def test_mixed_polygons_stay_in_order():
    tri = [(0, 0), (1, 0), (0, 1)]
    polygons = [[tri], [SQUARE, hole(2, 2)], [], [tri[:2]], [SQUARE], [SQUARE, hole(5, 5)]]
    result, points = run(*polygons)
    counts = np.bincount(result.polygon_of_triangle, minlength=6).tolist()
    assert counts == [1, 8, 0, 0, 2, 8]
    assert (np.diff(result.polygon_of_triangle.astype(int)) >= 0).all()
    assert result.finding.tolist() == [0, 0, Code.SHORT_POLYGON, Code.SHORT_POLYGON, 0, 0]
    assert areas2(points, result.triangles).sum() == 1 + 2 * (63 + 64 + 63)


def test_without_holes_it_is_triangulate():
    points = np.array([(*p, 0.0) for p in SQUARE])
    corners, start = np.array([0, 1, 2, 3, 0, 1, 2], np.uint32), np.array([0, 4, 7])
    plain = triangulate(points, corners, start)
    rings = triangulate_rings(points, corners, start, np.array([0, 1, 2]))
    assert rings.triangles.tolist() == plain.triangles.tolist()


@pytest.mark.parametrize("name", GOOD)
def test_bridges_serve_where_earcut_does_not(name, monkeypatch):
    monkeypatch.setattr(holes, "_by_earcut", lambda plane, start: (None, False))
    rings, area = GOOD[name]
    result, points = run(rings)
    assert ring_edges_once(rings, result.triangles)
    assert np.isclose(areas2(points, result.triangles).sum(), 2 * area, rtol=1e-12)
    assert result.finding.tolist() == [0]


@st.composite
def walls_with_windows(draw):
    """A star-shaped outline on a grid, and holes in cells of its middle."""
    n = draw(st.integers(4, 12))
    angles = (np.arange(n) + 0.5) * 2 * np.pi / n
    radii = np.array(draw(st.lists(st.integers(200, 400), min_size=n, max_size=n)))
    outline = np.rint(np.stack([radii * np.cos(angles), radii * np.sin(angles)], 1))
    points = []
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        points += [a * 8] + ([4 * (a + b)] if draw(st.booleans()) else [])
    cells = draw(st.lists(st.integers(0, 15), min_size=1, max_size=6, unique=True))
    rings = [[tuple(p) for p in points]]
    for cell in cells:
        x, y = 100 * (cell % 4) - 200, 100 * (cell // 4) - 200
        dx, dy = draw(st.integers(5, 30)), draw(st.integers(5, 30))
        ring = [(x + dx, y + dy), (x + 90, y + dy), (x + 90, y + 90), (x + dx, y + 90)]
        if draw(st.booleans()):
            ring.insert(1, (x + 60, y + dy))
        rings.append(ring[:: draw(st.sampled_from([1, -1]))])
    return rings


@given(walls_with_windows(), st.integers(0, 2))
def test_walls_with_windows(rings, roll):
    result, points = run(rings, lift=(1, -2), roll=roll)
    assert result.finding.tolist() == [0]
    assert ring_edges_once(rings, result.triangles)
    assert (areas2(points, result.triangles) > 0).all()


@given(
    st.lists(
        st.lists(st.tuples(*[st.integers(0, 4)] * 2), min_size=0, max_size=7),
        min_size=1,
        max_size=4,
    )
)
def test_any_rings_are_kept_or_found(rings):
    result, points = run(rings)
    kept = [len(set(ring)) >= 3 for ring in rings]
    if result.finding[0] == Code.SHORT_POLYGON:
        assert len(rings[0]) < 3
        return
    if not all(kept) and len(rings) > 1:
        assert result.finding.tolist() == [CROSSING]
    if all(len(ring) >= 3 for ring in rings):
        assert len(result.triangles) == len(points) + 2 * (len(rings) - 1) - 2
        assert ends_at_rings(rings, result.triangles)


@pytest.mark.parametrize("is_wild", [False, True])
def test_a_hundred_thousand_corners_take_seconds(is_wild):
    n = 100_000
    rng = np.random.default_rng(3)
    angles = np.arange(n) * 2 * np.pi / n
    radii = rng.uniform(900, 1000, n)
    outline = np.stack([radii * np.cos(angles), radii * np.sin(angles)], 1)
    if is_wild:
        outline = rng.uniform(-1000, 1000, (3000, 2))
    rings = [outline.tolist(), *(hole(80 * i - 400, 0) for i in range(10))]
    begin = time.perf_counter()
    result, points = run(rings)
    assert time.perf_counter() - begin < 30
    assert len(result.triangles) == len(points) + 2 * 10 - 2
    assert result.finding.tolist() == [CROSSING if is_wild else 0]


def test_very_many_holes_take_seconds():
    n = 60
    outline = [(-1, -1), (3 * n, -1), (3 * n, 3 * n), (-1, 3 * n)]
    rings = [outline, *(hole(3 * x, 3 * y) for x in range(n) for y in range(n))]
    begin = time.perf_counter()
    result, points = run(rings)
    assert time.perf_counter() - begin < 30
    assert len(result.triangles) == len(points) + 2 * n * n - 2
    assert ends_at_rings(rings, result.triangles)


def test_a_hole_in_a_ring_that_crosses_takes_no_minutes():
    wild = np.random.default_rng(1).uniform(-1000, 1000, (20_000, 2))
    result, points = run([wild.tolist(), hole(0, 0)])
    assert result.finding.tolist() == [CROSSING]
    assert len(result.triangles) == len(points)


def test_rings_too_large_to_measure_warn_of_nothing():
    outline = [(-1e308, -1e308), (1e308, -1e308), (1e308, 1e308), (0, 5e307), (-1e308, 1e308)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result, points = run([outline, hole(0, 0)])
    assert result.finding.tolist() == [CROSSING]
    assert len(result.triangles) == len(points)
