"""Triangulation of polygons with holes that keeps every corner.

A polygon of n corners in 1 + h rings gives n + 2 h - 2 triangles, and each edge of its
rings is an edge of exactly one of them, so that closed solids stay closed.

    no hole          `svprep.ingest.triangulation`, all together
    holes            mapbox-earcut in the polygon's own plane; corners on straight edges,
                     which it leaves out, are put back
    where that does  each hole is joined to its outline by a bridge, there and back, and the
    not fit, or may  one ring that results is triangulated like any other
    take minutes

The result is judged, not trusted: its triangles must meet edge to edge, end at the rings
alone, and have together the area of the outline less that of the holes.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from svprep.defects import Code
from svprep.ingest.triangulation import MOST_EARCUT, Triangulation, triangulate
from svprep.model import F64, I64, U32

_SHORT: Final = int(Code.SHORT_POLYGON)
_NONPLANAR: Final = int(Code.NONPLANAR_POLYGON)
_CROSSING: Final = int(Code.SELF_CROSSING_POLYGON)

_FLATNESS: Final = 1e-3  # of the diameter: farther from the plane is D106
_NO_AREA: Final = 1e-12  # of a ring's extent squared: rounding in the area of a line
_AREA_TOLERANCE: Final = 1e-9  # of the outline's area
_MOST_PAIRS: Final = 1 << 20  # of corners that are measured for a bridge
_MOST_BRIDGES: Final = 32  # that are tried, the shortest first
_MOST_SEARCHES: Final = 1 << 20
"""Holes times corners: each bridge is looked for among all corners. With more, the rings
are fanned from the first corner, wherever that leads."""
_SLIVER: Final = 1e-12  # of the longest side squared: twice the area of a triangle without any


@np.errstate(over="ignore", invalid="ignore")  # so large a polygon is fanned; no grid fits it
def triangulate_rings(
    positions: F64, corners: U32, ring_start: I64, polygon_start: I64
) -> Triangulation:
    """Triangulate polygons with holes; every corner of every ring stays a corner.

    Parameters
    ----------
    positions : (n_vertices, 3) float64
        Finite.
    corners : (n_corners,) uint32
        Indices into `positions`, ring after ring; the first corner is not repeated at the
        end of its ring.
    ring_start : (n_rings + 1,) int64
        Ring j has the corners ``[start[j], start[j + 1])``.
    polygon_start : (n_polygons + 1,) int64
        Polygon i has the rings ``[start[i], start[i + 1])``: the first is its outline, the
        others are holes, wound either way.

    Returns
    -------
    Triangulation
        As of `svprep.ingest.triangulation.triangulate`, by polygon. Triangles run as their
        outline does.

    Notes
    -----
    `SELF_CROSSING_POLYGON` says that the rings of a polygon cross or touch themselves or
    each other, that a hole lies outside its outline, or that a hole has fewer than three
    different corners (only such a hole is left out). The polygon is kept in any case.

    O(n log n) as a rule for a polygon with holes, a loop over polygons; without holes as
    `triangulate`. Bridged at once, and so bounded like a ring: a polygon with a ring of more
    than `MOST_EARCUT` corners, or with more corners in all and few enough holes.
    """
    start = ring_start[polygon_start]
    n_rings = np.diff(polygon_start)
    holed = np.flatnonzero(n_rings > 1)
    if holed.size == 0:
        return triangulate(positions, corners, start)
    size = np.diff(start)
    is_plain = n_rings < 2
    plain_start = np.concatenate([[0], np.cumsum(np.where(is_plain, size, 0))])
    plain = triangulate(positions, corners[np.repeat(is_plain, size)], plain_start)
    finding = plain.finding
    triangles, owners = [plain.triangles], [plain.polygon_of_triangle]
    for polygon in holed.tolist():
        rings = [
            corners[ring_start[j] : ring_start[j + 1]]
            for j in range(polygon_start[polygon], polygon_start[polygon + 1])
        ]
        rows, finding[polygon] = _triangulate_holed(positions, rings)
        triangles.append(rows)
        owners.append(np.full(len(rows), polygon, np.uint32))
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return Triangulation(np.concatenate(triangles)[order], owner[order], finding)


def _triangulate_holed(positions: F64, rings: list[U32]) -> tuple[U32, int]:
    """Return the triangles of one polygon and its finding."""
    rings = [ring[ring != np.roll(ring, -1)] for ring in rings]
    if _n_different(rings[0]) < 3:
        return np.empty((0, 3), np.uint32), _SHORT
    kept = rings[:1] + [ring for ring in rings[1:] if _n_different(ring) >= 3]
    corners = np.concatenate(kept)
    ring_start = np.cumsum([0] + [ring.size for ring in kept])
    points = positions[corners] - positions[corners[0]]
    plane, is_bent = _in_its_plane(points, ring_start[1])

    local, is_right = np.empty((0, 3), np.int64), False
    is_finite = bool(np.isfinite(_signed_areas(plane, ring_start)).all())
    if is_finite and not _is_slow(ring_start):
        local, is_right = _by_earcut(plane, ring_start)
    if not is_right or _has_sliver(plane, local):
        bridged, is_covered = _by_bridges(plane, ring_start, is_finite=is_finite)
        if is_covered or not is_right:
            local, is_right = bridged, is_covered
    is_odd = (
        not is_right
        or len(kept) < len(rings)
        or _has_flat_ring(plane, ring_start)
        or _is_touching(points, ring_start, local)
    )
    return corners[local], _CROSSING if is_odd else _NONPLANAR if is_bent else 0


def _is_slow(ring_start: I64) -> bool:
    """Return whether mapbox-earcut may take minutes. Of very many small holes it is the best."""
    n = int(ring_start[-1])
    return n > MOST_EARCUT and (
        int(np.diff(ring_start).max()) > MOST_EARCUT or (len(ring_start) - 2) * n <= _MOST_SEARCHES
    )


def _n_different(ring: U32) -> int:
    """Return the number of different corners, counted no further than 3."""
    if ring.size < 3:
        return int(ring.size)
    return 3 if ((ring != ring[0]) & (ring != ring[1])).any() else 2


def _in_its_plane(points: F64, n_outline: int) -> tuple[F64, bool]:
    """Return the corners in the coordinate plane in which the outline has its largest area.

    Parameters
    ----------
    points : (n, 3) float64
        Relative to the first corner; the outline's `n_outline` first.

    Returns
    -------
    plane : (n, 2) float64
        The outline runs counter-clockwise in it.
    is_bent : bool
        Some corner lies too far from the plane of the outline.
    """
    outline = points[:n_outline]
    normal = np.cross(outline, np.roll(outline, -1, axis=0)).sum(axis=0)
    steep = int(np.argmax(np.abs(normal)))
    axes = [(steep + 1) % 3, (steep + 2) % 3]
    if normal[steep] < 0:
        axes.reverse()
    heights = points @ normal
    heights -= heights.mean()
    diameter = float(np.linalg.norm(outline.max(axis=0) - outline.min(axis=0)))
    limit = _FLATNESS * diameter * float(np.linalg.norm(normal))
    return np.ascontiguousarray(points[:, axes]), bool(np.abs(heights).max() > limit)


def _signed_areas(plane: F64, ring_start: I64) -> F64:
    """Return twice the area of each ring, positive if counter-clockwise."""
    areas = np.empty(len(ring_start) - 1)
    for i, (begin, end) in enumerate(pairwise(ring_start)):
        u, v = (plane[begin:end] - plane[begin]).T
        areas[i] = (u * np.roll(v, -1) - v * np.roll(u, -1)).sum()
    return areas


def _has_flat_ring(plane: F64, ring_start: I64) -> bool:
    """Return whether a ring has no area, or two halves that cancel."""
    sizes = [np.ptp(plane[begin:end], axis=0).max() for begin, end in pairwise(ring_start)]
    flat = np.abs(_signed_areas(plane, ring_start)) <= _NO_AREA * np.array(sizes) ** 2
    return bool(flat.any())


def _triangle_areas(plane: F64, triangles: I64) -> F64:
    """Return twice the signed area of each triangle."""
    a, b, c = plane[triangles.T]
    (abu, abv), (acu, acv) = (b - a).T, (c - a).T
    return abu * acv - abv * acu


def _has_sliver(plane: F64, triangles: I64) -> bool:
    """Return whether a triangle has no area: dropped, it would leave its neighbours open."""
    a, b, c = plane[triangles.T]
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return bool((np.abs(_triangle_areas(plane, triangles)) <= _SLIVER * longest).any())


def _is_covered(plane: F64, ring_start: I64, triangles: I64) -> bool:
    """Return whether triangles have together the area of the outline less that of the holes."""
    outline, *holes = np.abs(_signed_areas(plane, ring_start)).tolist()
    found = float(np.abs(_triangle_areas(plane, triangles)).sum())
    return abs(found - (outline - sum(holes))) <= _AREA_TOLERANCE * outline


def _by_earcut(plane: F64, ring_start: I64) -> tuple[I64, bool]:
    """Triangulate by mapbox-earcut; say whether the result fits the rings."""
    from mapbox_earcut import triangulate_float64

    flat = triangulate_float64(plane, ring_start[1:].astype(np.uint32))
    ears: I64 = flat.reshape(-1, 3).astype(np.int64)
    areas = _triangle_areas(plane, ears)
    ears[areas < 0] = ears[areas < 0][:, ::-1]
    following = _following_corners(_signed_areas(plane, ring_start), ring_start)
    triangles = _put_back(ears, following)
    n_expected = len(plane) + 2 * (len(ring_start) - 2) - 2
    is_right = (
        len(triangles) == n_expected
        and _ends_at_rings(triangles, following)
        and _is_covered(plane, ring_start, triangles)
    )
    return triangles, is_right


def _following_corners(areas: F64, ring_start: I64) -> list[int]:
    """Return at each corner the next one that a triangle's edge leads to.

    Along the outline; against a hole that is wound as the outline is.
    """
    following: list[int] = []
    for i, (begin, end) in enumerate(pairwise(ring_start)):
        step = -1 if i and areas[i] > 0 else 1
        following += np.roll(np.arange(begin, end), -step).tolist()
    return following


def _put_back(ears: I64, following: list[int]) -> I64:
    """Split triangles so that the corners which no triangle uses come back.

    A run of them lies on the edge of a triangle between the two used corners at its ends;
    empty where there is no such edge, or where a ring has fewer than two used corners.
    """
    is_used = np.zeros(len(following), np.bool_)
    is_used[ears.ravel()] = True
    if is_used.all():
        return ears
    rows = {row: (a, b, c) for row, (a, b, c) in enumerate(ears.tolist())}
    row_of_edge: dict[tuple[int, int], int] = {}
    for row, (a, b, c) in rows.items():
        row_of_edge.update({(a, b): row, (b, c): row, (c, a): row})
    n_used = int(is_used.sum())
    n_walked = 0
    for a in np.flatnonzero(is_used).tolist():
        run = [a, following[a]]
        while not is_used[run[-1]]:
            run.append(following[run[-1]])
        n_walked += len(run) - 1
        b = run[-1]
        if len(run) == 2:
            continue
        row = row_of_edge.get((a, b), -1)
        if row < 0:
            return np.empty((0, 3), np.int64)
        apex = sum(rows.pop(row)) - a - b
        new_row = len(ears) + a  # free: one run begins at a, and takes no more rows than corners
        new_rows = [new_row] + [len(ears) + corner for corner in run[1:-1]]
        row_of_edge[apex, a] = new_rows[0]
        for piece, (p, q) in zip(new_rows, pairwise(run), strict=True):
            rows[piece] = (p, q, apex)
        row_of_edge[b, apex] = new_rows[-1]
    if n_walked != len(following) or n_used == 0:
        return np.empty((0, 3), np.int64)
    return np.array(list(rows.values()), np.int64).reshape(-1, 3)


def _ends_at_rings(triangles: I64, following: list[int]) -> bool:
    """Return whether triangles meet edge to edge, and where they end there is a ring's edge."""
    n = len(following)
    here, there = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    edges = np.sort(here * n + there)
    ring = np.arange(n) * n + np.array(following)
    inner = np.setdiff1d(edges, ring, assume_unique=True)
    return bool(
        (edges[1:] != edges[:-1]).all()
        and edges.size == inner.size + n
        and np.array_equal(inner, np.sort(inner % n * n + inner // n))
    )


def _by_bridges(plane: F64, ring_start: I64, *, is_finite: bool) -> tuple[I64, bool]:
    """Triangulate the one ring that bridges to the holes make; say whether it covers them.

    Whatever the rings, triangles end at their edges alone. They are fanned where there are too
    many to search, or areas overflow.
    """
    areas = _signed_areas(plane, ring_start)
    following = np.array(_following_corners(areas, ring_start))
    ring = np.arange(ring_start[1])
    holes = [np.arange(a, b) for a, b in pairwise(ring_start[1:])]
    holes = [h[::-1] if area > 0 else h for h, area in zip(holes, areas[1:], strict=True)]
    if not is_finite or len(holes) * len(plane) > _MOST_SEARCHES:
        ring = np.concatenate([ring, *(np.r_[0, hole, hole[0]] for hole in holes)])
        return np.column_stack([0 * ring[2:], ring[1:-1], ring[2:]]), False
    holes.sort(key=lambda hole: -float(plane[hole, 0].max()))
    for hole in holes:
        i, j = _bridge(plane, following, hole, ring)
        ring = np.concatenate([ring[: j + 1], hole[i:], hole[: i + 1], ring[j:]])
    flat = np.column_stack([plane, np.zeros(len(plane))])
    bridged = triangulate(flat, ring.astype(np.uint32), np.array([0, ring.size]))
    triangles = bridged.triangles.astype(np.int64)
    return triangles, _is_covered(plane, ring_start, triangles)


def _bridge(plane: F64, following: I64, hole: I64, ring: I64) -> tuple[int, int]:
    """Return the ends, in `hole` and in `ring`, of a short bridge that crosses no edge.

    The shortest one where all that are tried cross some.
    """
    tried = np.arange(hole.size)
    if hole.size * ring.size > _MOST_PAIRS:
        tried = tried[[int(np.argmax(plane[hole, 0]))]]
    offsets = plane[hole[tried]][:, None] - plane[ring]
    squares = (offsets**2).sum(axis=2).ravel()
    n = min(_MOST_BRIDGES, squares.size)
    nearest = np.argpartition(squares, n - 1)[:n]
    nearest = nearest[np.lexsort((nearest, squares[nearest]))]
    for k in nearest.tolist():
        i, j = int(tried[k // ring.size]), k % ring.size
        if _is_inward(plane, hole, i, ring, j) and _is_clear(
            plane[hole[i]], plane[ring[j]], plane, plane[following]
        ):
            return i, j
    return int(tried[nearest[0] // ring.size]), int(nearest[0] % ring.size)


def _is_inward(plane: F64, hole: I64, i: int, ring: I64, j: int) -> bool:
    """Return whether a bridge leaves corner j of `ring` to the ring's left.

    The ring passes twice where a bridge ends already; only one of the passages is right.
    """
    at = plane[ring[j]]
    to = plane[hole[i]] - at
    if not to.any():
        to = plane[hole[(i + 1) % hole.size]] - at
    before, behind = plane[ring[j - 1]] - at, plane[ring[(j + 1) % ring.size]] - at

    def is_left(a: F64, b: F64) -> bool:
        return bool(a[0] * b[1] - a[1] * b[0] > 0)

    if is_left(behind, before):
        return is_left(behind, to) and is_left(to, before)
    return is_left(to, before) or is_left(behind, to)


def _is_clear(p: F64, q: F64, begin: F64, end: F64) -> bool:
    """Return whether the segment (p, q) meets no edge but those that end at p or q."""

    def side(a: F64, b: F64, c: F64) -> F64:
        u, v = (b - a).T, (c - a).T
        sides: F64 = u[0] * v[1] - u[1] * v[0]
        return sides

    is_apart = (side(p, q, begin) * side(p, q, end) > 0) | (
        side(begin, end, p) * side(begin, end, q) > 0
    )
    for corner in (begin, end):
        is_apart |= (corner == p).all(axis=1) | (corner == q).all(axis=1)
    return bool(is_apart.all())


def _is_touching(points: F64, ring_start: I64, triangles: I64) -> bool:
    """Return whether rings of a covered polygon touch each other.

    At a corner; or a corner lies on an edge, which leaves a triangle without area.
    """
    a, b, c = points[triangles.T]
    is_flat = (np.cross(b - a, c - a) == 0).all(axis=1)
    if (is_flat & (a != b).any(axis=1) & (b != c).any(axis=1) & (c != a).any(axis=1)).any():
        return True
    ring = np.repeat(np.arange(len(ring_start) - 1), np.diff(ring_start))
    seen: dict[tuple[float, ...], int] = {}
    rows = map(tuple, points.tolist())
    return any(seen.setdefault(p, i) != i for p, i in zip(rows, ring.tolist(), strict=True))
