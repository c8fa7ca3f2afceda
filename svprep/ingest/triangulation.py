"""Triangulation of polygon rings that keeps every corner.

A ring of n corners gives n - 2 triangles, and each of its edges is an edge of exactly
one of them. A triangulation that leaves out corners on straight edges, as common ear
clippers do, would put T-junctions between neighbouring faces and so open closed solids.

    triangle                 as it is
    strictly convex ring     a fan from its first corner (NumPy)
    any other ring           ear clipping, best shape first (compiled when first needed)
    more than LARGE_RING     mapbox-earcut
    more than MOST_EARCUT    ear clipping, any ear first, and no more work than is in proportion

All of it happens relative to the ring's first corner and in the coordinate plane that
the ring's Newell normal (Sutherland, Sproull, Schumacker 1974) is steepest to:
dropping a coordinate rounds nothing, so on a grid every orientation is exact, and a
translation by grid steps changes no triangle.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from svprep.defects import Code
from svprep.kernels.triangulate import clip_large_ring, clip_rings
from svprep.model import BOOL, F64, I64, U32

_SHORT: Final = int(Code.SHORT_POLYGON)
_NONPLANAR: Final = int(Code.NONPLANAR_POLYGON)
_CROSSING: Final = int(Code.SELF_CROSSING_POLYGON)

LARGE_RING: Final = 2000
"""Rings of more corners go to mapbox-earcut: clipping the best ears costs O(n^2)."""
MOST_EARCUT: Final = 5000
"""Of more it may take O(n^3): a minute for a ring of 20,000 corners that winds or crosses
itself."""
_STEPS_PER_CORNER: Final = 8_000
_AXES: Final = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, -1.0))
_BATCH: Final = 1 << 16  # corners that are classified at a time

_FLATNESS = 1e-3  # of the diameter: farther from the plane is D106
_NO_AREA = 1e-13  # of the diameter squared: rounding in the area of a line
_ON_LINE = 1e-9  # of the diameter squared: twice the area that three corners of a line span
_TURN_SQUARED = 1e-12  # squared sine of the least turn of a strictly convex corner


class Triangulation(NamedTuple):
    """What `triangulate` returns."""

    triangles: U32
    """``(n_triangles, 3)``, indices into the positions, grouped by polygon in order."""
    polygon_of_triangle: U32
    """``(n_triangles,)``, ascending."""
    finding: NDArray[np.uint16]
    """``(n_polygons,)``: a `Code`, or 0. `SHORT_POLYGON` has no triangles; of the other
    two, `SELF_CROSSING_POLYGON` goes first."""


@np.errstate(over="ignore", invalid="ignore")  # so large a polygon is fanned; no grid fits it
def triangulate(positions: F64, corners: U32, polygon_start: I64) -> Triangulation:
    """Triangulate polygons; every corner of a ring stays a corner of a triangle.

    Parameters
    ----------
    positions : (n_vertices, 3) float64
        Finite.
    corners : (n_corners,) uint32
        Indices into `positions`, ring after ring.
    polygon_start : (n_polygons + 1,) int64
        Polygon i has the corners ``[start[i], start[i + 1])``, any number of them.

    Returns
    -------
    Triangulation

    Notes
    -----
    A corner that repeats its neighbour's index is left out first. A ring that crosses or
    touches itself has no unique inside: it gives n - 2 triangles all the same, some of
    which overlap. A ring without area is fanned.

    O(n) for convex rings, O(n^2) for others of up to `LARGE_RING` corners, O(n^3) at worst up
    to `MOST_EARCUT`. Of larger ones each corner may cost 8,000 steps: an outline of 100,000
    corners takes about a second, and ten at worst. Where that is not enough, or the ring
    crosses itself, what remains of it is fanned:
    `SELF_CROSSING_POLYGON`.
    """
    size = np.diff(polygon_start)
    finding = np.zeros(size.size, np.uint16)
    if size.size and size.min() == size.max() == 3:
        a, b, c = corners.reshape(-1, 3).T
        finding[(a == b) | (b == c) | (c == a)] = _SHORT
        kept = np.flatnonzero(finding == 0)
        triangles = corners.reshape(-1, 3)
        if kept.size < size.size:
            triangles = triangles[kept]
        return Triangulation(triangles, kept.astype(np.uint32), finding)
    is_triangle = size == 3
    if is_triangle.any():
        return _triangles_apart(positions, corners, size, is_triangle)

    ring, start, is_short = _rings(corners, size)
    finding[is_short] = _SHORT
    ring_size = np.diff(start)
    n_rows = np.where(is_short, 0, ring_size - 2)
    first_row = np.cumsum(n_rows) - n_rows
    polygon_of_triangle = np.repeat(np.arange(size.size, dtype=np.uint32), n_rows)
    first = np.repeat(start[:-1], n_rows)
    second = first + np.arange(first.size) - np.repeat(first_row, n_rows) + 1
    triangles = np.stack([ring[first], ring[second], ring[second + 1]], axis=1)

    clipped, planes = [np.empty(0, np.int64)], [np.empty((2, 0))]
    for n in np.unique(ring_size[~is_short & (ring_size > 3)]).tolist():
        of_size = np.flatnonzero(~is_short & (ring_size == n))
        for batch in np.array_split(of_size, -(-of_size.size * n // _BATCH)):
            corner = ring[start[batch] + np.arange(n)[:, None]]
            points = np.stack([positions[:, axis][corner] for axis in range(3)])
            points -= points[:, :1]
            is_fan, finding[batch], axes = _classify(points)
            other = np.flatnonzero(~is_fan)
            plane = np.stack([points[axes[other, k], :, other] for k in (0, 1)])
            if n <= LARGE_RING:
                clipped.append(batch[other])
                planes.append(plane.reshape(2, -1))
                continue
            for polygon, u, v in zip(batch[other], *plane, strict=True):
                large, code = _triangulate_large(np.stack([u, v], axis=1))
                rows = slice(first_row[polygon], first_row[polygon] + n - 2)
                triangles[rows] = ring[start[polygon] + large]
                finding[polygon] = code or finding[polygon]
    polygons = np.concatenate(clipped)
    if polygons.size:
        u, v = np.concatenate(planes, axis=1)
        ears, is_crossing = _clip(u, v, ring_size[polygons])
        n_rows = n_rows[polygons]
        within = np.arange(len(ears)) - np.repeat(np.cumsum(n_rows) - n_rows, n_rows)
        rows = np.repeat(first_row[polygons], n_rows) + within
        triangles[rows] = ring[ears + np.repeat(start[polygons], n_rows)[:, None]]
        finding[polygons[is_crossing]] = _CROSSING
    return Triangulation(triangles, polygon_of_triangle, finding)


def _triangles_apart(positions: F64, corners: U32, size: I64, is_triangle: BOOL) -> Triangulation:
    """Triangulate polygons of which some are triangles, which most of a city's are."""
    is_of_triangle = np.repeat(is_triangle, size)
    apart = []
    for is_one, of_one in ((is_triangle, is_of_triangle), (~is_triangle, ~is_of_triangle)):
        start = np.concatenate([[0], np.cumsum(size[is_one])])
        apart.append(triangulate(positions, corners[of_one], start))
    finding = np.empty(size.size, np.uint16)
    n_rows = np.empty(size.size, np.int64)
    for is_one, found in zip((is_triangle, ~is_triangle), apart, strict=True):
        finding[is_one] = found.finding
        n_rows[is_one] = np.bincount(found.polygon_of_triangle, minlength=len(found.finding))
    is_row = np.repeat(is_triangle, n_rows)
    triangles = np.empty((is_row.size, 3), np.uint32)
    triangles[is_row], triangles[~is_row] = apart[0].triangles, apart[1].triangles
    polygon_of_triangle = np.repeat(np.arange(size.size, dtype=np.uint32), n_rows)
    return Triangulation(triangles, polygon_of_triangle, finding)


def _clip(u: F64, v: F64, size: I64) -> tuple[I64, BOOL]:
    """Clip the ears of rings: ``(n, 3)`` corners, counted from 0 in each ring; is it crossing."""
    start = np.concatenate([[0], np.cumsum(size)])
    following = np.arange(1, u.size + 1)
    following[start[1:] - 1] = start[:-1]
    previous = np.empty_like(following)
    previous[following] = np.arange(u.size)
    ears = np.empty(3 * (u.size - 2 * size.size), np.int64)
    is_crossing = np.zeros(size.size, np.bool_)
    searched = np.zeros(u.size, np.int64)
    clip_rings(u, v, start, previous, following, searched, np.empty(u.size), ears, is_crossing)
    return ears.reshape(-1, 3) - np.repeat(start[:-1], size - 2)[:, None], is_crossing


def _rings(corners: U32, size: I64) -> tuple[U32, I64, BOOL]:
    """Leave out corners that repeat their neighbour's index.

    Returns
    -------
    ring : (n_kept,) uint32
    start : (n_polygons + 1,) int64
    is_short : (n_polygons,) bool
        Fewer than three different corners.
    """
    start = np.concatenate([[0], np.cumsum(size)])
    following = np.arange(1, corners.size + 1)
    following[start[1:][size > 0] - 1] = start[:-1][size > 0]
    is_kept = corners != corners[following]
    polygon = np.repeat(np.arange(size.size), size)[is_kept]
    ring = corners[is_kept]
    start = np.concatenate([[0], np.cumsum(np.bincount(polygon, minlength=size.size))])
    # The first two are different, if there are two: is there a third?
    one, two = start[polygon], np.minimum(start[polygon] + 1, ring.size - 1)
    is_third = (ring != ring[one]) & (ring != ring[two])
    return ring, start, np.bincount(polygon[is_third], minlength=size.size) == 0


def _classify(p: F64) -> tuple[BOOL, NDArray[np.uint16], I64]:
    """Say of each ring of n corners whether its fan is right, and what is wrong with it.

    Parameters
    ----------
    p : (3, n, n_rings) float64
        Corners relative to the first one.

    Returns
    -------
    is_fan : (n_rings,) bool
        Strictly convex, or without area.
    finding : (n_rings,) uint16
        `NONPLANAR_POLYGON`; `SELF_CROSSING_POLYGON` where halves of opposite area cancel
        (a bow tie); or 0.
    axes : (n_rings, 2) int64
        The two coordinates in which the ring runs counter-clockwise.
    """
    if p.shape[2] == 1:
        # NumPy adds up a single column in another order: no ring may depend on the others.
        is_fan, finding, axes = _classify(np.repeat(p, 2, axis=2))
        return is_fan[:1], finding[:1], axes[:1]
    ring = np.arange(p.shape[2])
    x, y, z = p
    following_x, following_y, following_z = (_following(c) for c in p)
    normal = np.stack(
        [
            (y * following_z - z * following_y).sum(axis=0),
            (z * following_x - x * following_z).sum(axis=0),
            (x * following_y - y * following_x).sum(axis=0),
        ]
    )
    length = np.sqrt((normal**2).sum(axis=0))
    diameter = np.sqrt(((p.max(axis=1) - p.min(axis=1)) ** 2).sum(axis=0))
    has_area = length > _NO_AREA * diameter**2

    heights = x * normal[0] + y * normal[1] + z * normal[2]
    heights -= heights.mean(axis=0)
    is_bent = has_area & (np.abs(heights).max(axis=0) > _FLATNESS * diameter * length)
    finding = np.where(is_bent, _NONPLANAR, 0).astype(np.uint16)
    for i in np.flatnonzero(~has_area):
        corners = p[:, :, i].T
        far = corners[np.argmax((corners**2).sum(axis=1))]
        if np.abs(np.cross(far, corners)).max() > _ON_LINE * diameter[i] ** 2:
            finding[i] = _CROSSING

    steep = np.argmax(np.abs(normal), axis=0)
    axes = np.stack([(steep + 1) % 3, (steep + 2) % 3])
    axes = np.where(normal[steep, ring] < 0, axes[::-1], axes)
    u, v = p[axes[0], :, ring].T, p[axes[1], :, ring].T
    du, dv = _following(u) - u, _following(v) - v
    next_du, next_dv = _following(du), _following(dv)
    turn = du * next_dv - dv * next_du
    squares = (du**2 + dv**2) * (next_du**2 + next_dv**2)
    is_turn = (turn > 0) & (turn**2 > _TURN_SQUARED * squares)
    fan = u[1:-1] * v[2:] - v[1:-1] * u[2:]
    return ~has_area | (is_turn.all(axis=0) & (fan > 0).all(axis=0)), finding, axes.T


def _following(values: F64) -> F64:
    """Return at each corner (row) the value of the next one."""
    return np.concatenate([values[1:], values[:1]])


def _triangulate_large(plane: F64) -> tuple[I64, int]:
    """Return the n - 2 triangles of a ring of very many corners, and its finding.

    Parameters
    ----------
    plane : (n, 2) float64
        The ring, counter-clockwise.
    """
    following = np.roll(plane, -1, axis=0)
    area2 = (plane[:, 0] * following[:, 1] - plane[:, 1] * following[:, 0]).sum()
    n = len(plane)
    triangles, is_right = _by_earcut(plane) if n <= MOST_EARCUT else _by_any_ear(plane)
    if not is_right:
        return triangles, _CROSSING
    ab = plane[triangles[:, 1]] - plane[triangles[:, 0]]
    ac = plane[triangles[:, 2]] - plane[triangles[:, 0]]
    found = np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]).sum()
    return triangles, 0 if abs(found - area2) <= 1e-9 * area2 else _CROSSING


def _by_any_ear(plane: F64) -> tuple[I64, bool]:
    """Clip ears in whatever order is quick; say whether that came to an end.

    Corners are looked for along the one of four axes that edges extend least along.
    """
    n = len(plane)
    edges = np.roll(plane, -1, axis=0) - plane
    _, axis = min((float(np.abs(edges @ axis).sum()) / np.hypot(*axis), axis) for axis in _AXES)
    along = plane[:, 0] * axis[0] + plane[:, 1] * axis[1]
    across = plane[:, 1] * axis[0] - plane[:, 0] * axis[1]
    ears = np.empty((n - 2, 3), np.int64)
    corner = np.arange(n)
    is_whole = clip_large_ring(
        np.ascontiguousarray(plane[:, 0]),
        np.ascontiguousarray(plane[:, 1]),
        along,
        across,
        np.argsort(along, kind="stable"),
        1e-15 * float(np.abs(plane).max()),
        np.roll(corner, 1),
        np.roll(corner, -1),
        _STEPS_PER_CORNER * n,
        ears,
    )
    return ears, bool(is_whole)


def _by_earcut(plane: F64) -> tuple[I64, bool]:
    """Triangulate by mapbox-earcut; say whether the result fits the ring.

    mapbox-earcut leaves out corners on straight edges and repeated ones; they are put
    back by splitting the triangle on that edge. Where they do not fit it, it is fanned.
    """
    from mapbox_earcut import triangulate_float64

    n = len(plane)
    flat = triangulate_float64(np.ascontiguousarray(plane), np.array([n], np.uint32))
    ears: I64 = flat.reshape(-1, 3).astype(np.int64)
    ab = plane[ears[:, 1]] - plane[ears[:, 0]]
    ac = plane[ears[:, 2]] - plane[ears[:, 0]]
    ear_area2 = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    ears[ear_area2 < 0] = ears[ear_area2 < 0][:, ::-1]
    triangles = _put_back(ears, n)
    if len(triangles) != n - 2:
        order = np.arange(1, n - 1)
        return np.stack([np.zeros_like(order), order, order + 1], axis=1), False
    return triangles, True


def _put_back(ears: I64, n: int) -> I64:
    """Split triangles so that the corners of the ring which no triangle uses come back.

    Empty where a straight run of such corners lies on no triangle's edge.
    """
    used = np.unique(ears).tolist()
    rows = {row: (a, b, c) for row, (a, b, c) in enumerate(ears.tolist())}
    row_of_edge: dict[tuple[int, int], int] = {}
    for row, (a, b, c) in rows.items():
        row_of_edge.update({(a, b): row, (b, c): row, (c, a): row})
    for a, b in zip(used, used[1:] + used[:1], strict=True):
        n_steps = (b - a) % n
        if n_steps == 1:
            continue
        row = row_of_edge.get((a, b), -1)
        if row < 0:
            return np.empty((0, 3), np.int64)
        apex = sum(rows.pop(row)) - a - b
        new_row = len(ears) + a  # free: one run begins at a
        row_of_edge[apex, a] = new_row
        for step in range(n_steps):
            rows[new_row + step] = ((a + step) % n, (a + step + 1) % n, apex)
        row_of_edge[b, apex] = new_row + n_steps - 1
    return np.array(list(rows.values()), np.int64).reshape(-1, 3)
