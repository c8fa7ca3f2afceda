"""Ear clipping that keeps every corner of a ring.

After Meisters 1975, *Polygons Have Ears*: a ring that does not touch itself always has an
ear of positive area whose closed triangle holds no other corner, also where corners lie
on straight edges, and clipping it leaves such a ring again. Common ear clippers leave out
corners on straight edges; that would put T-junctions between neighbouring faces and so
open closed solids.

`svprep.ingest.triangulation` decides which rings come here, and makes them plane.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_COINCIDENT = 9.0  # rank of an ear without area, clipped at once; shapes rank below 1

# Called by `clip_rings` only, which carries them in its cache: no wrappers to compile.
_helper = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_helper
def _cross(u, v, a, b, c):
    """Twice the signed area of the triangle (a, b, c)."""
    return (u[b] - u[a]) * (v[c] - v[a]) - (v[b] - v[a]) * (u[c] - u[a])


@_helper
def _dot(u, v, a, b, c):
    """The product of the vectors a -> b and a -> c."""
    return (u[b] - u[a]) * (u[c] - u[a]) + (v[b] - v[a]) * (v[c] - v[a])


@_helper
def _is_apart(u, v, a, b, c, d):
    """Whether the segments (a, b) and (c, d) share no point."""
    side_c = _cross(u, v, a, b, c)
    side_d = _cross(u, v, a, b, d)
    if side_c == 0.0 and side_d == 0.0:
        along_c = _dot(u, v, a, b, c)
        along_d = _dot(u, v, a, b, d)
        whole = _dot(u, v, a, b, b)
        return (along_c < 0.0 and along_d < 0.0) or (along_c > whole and along_d > whole)
    if side_c * side_d > 0.0:
        return True
    return _cross(u, v, c, d, a) * _cross(u, v, c, d, b) > 0.0


@_helper
def _touches_itself(u, v, following, head):
    """Whether two edges of the linked ring share more than their common corner. O(n^2)."""
    a = head
    while True:
        b = following[a]
        c = following[b]
        # Does the next edge fold back onto this one?
        if _cross(u, v, a, b, c) == 0.0 and _dot(u, v, b, a, c) > 0.0:
            return True
        while c != head and following[c] != a:
            d = following[c]
            if not _is_apart(u, v, a, b, c, d):
                return True
            c = d
        a = b
        if a == head:
            return False


@_helper
def _rank(u, v, a, b, c):
    """Rank of the ear (a, b, c): its least height over its longest edge, or `_COINCIDENT`.

    Zero or less where it is no ear.
    """
    ab = _dot(u, v, a, b, b)
    bc = _dot(u, v, b, c, c)
    ca = _dot(u, v, c, a, a)
    if ab == 0.0 or bc == 0.0 or ca == 0.0:
        return _COINCIDENT
    if bc > ab:
        ab = bc
    if ca > ab:
        ab = ca
    return _cross(u, v, a, b, c) / ab


@_helper
def _is_in_corner(u, v, previous, following, left, at, right, q):
    """Whether an edge of q, which coincides with `at`, leaves into the angle right-at-left."""
    x = previous[q]
    y = following[q]
    return (_cross(u, v, at, right, x) > 0.0 and _cross(u, v, left, at, x) > 0.0) or (
        _cross(u, v, at, right, y) > 0.0 and _cross(u, v, left, at, y) > 0.0
    )


@_helper
def _forbids(u, v, previous, following, b, q):
    """Whether corner q forbids the ear at b: it lies in the closed triangle.

    A corner that coincides with one of the triangle's (the ring touches itself there)
    forbids it only if one of q's own edges leaves into the triangle.
    """
    a = previous[b]
    c = following[b]
    if q == a or q == b or q == c:
        return False
    if _cross(u, v, a, b, q) < 0.0 or _cross(u, v, b, c, q) < 0.0 or _cross(u, v, c, a, q) < 0.0:
        return False
    if _dot(u, v, a, q, q) == 0.0:
        return _is_in_corner(u, v, previous, following, c, a, b, q)
    if _dot(u, v, b, q, q) == 0.0:
        return _is_in_corner(u, v, previous, following, a, b, c, q)
    if _dot(u, v, c, q, q) == 0.0:
        return _is_in_corner(u, v, previous, following, b, c, a, q)
    return True


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def clip_rings(u, v, start, previous, following, searched, rank, ears, is_crossing):
    """Clip the ears of each ring; a ring of n corners gives n - 2.

    Each corner keeps how far the search for a corner that forbids its ear has come. Its
    ear stays the same until a neighbour is clipped, and corners only disappear, so the
    search never goes back: O(n) for each of at most 3 n ears, O(n^2) in all.

    Parameters
    ----------
    u, v : (n_corners,) float64
        Ring after ring, each counter-clockwise.
    start : (n_rings + 1,) int64
    previous, following : (n_corners,) int64
        The rings as linked lists. Changed.
    searched : (n_corners,) int64
        Zeros. Changed: the corners of the ring that are known not to forbid the ear, or
        -1 for a corner that is clipped.
    rank : (n_corners,) float64
        Room.
    ears : (3 * n_corners - 6 * n_rings,) int64
        Filled with the corners of each triangle.
    is_crossing : (n_rings,) bool
        Filled: the ring crosses or touches itself.
    """
    written = 0
    for ring in range(len(start) - 1):
        begin = start[ring]
        n = start[ring + 1] - begin
        head = begin
        is_checked = False
        for i in range(begin, begin + n):
            rank[i] = _rank(u, v, previous[i], i, following[i])
        for _ in range(n - 2):
            best = np.int64(-1)
            best_rank = 0.0
            fallback = head
            i = head
            while True:
                if rank[i] > best_rank:
                    j = searched[i]
                    if rank[i] == _COINCIDENT:
                        j = n
                    while j < n and (
                        searched[begin + j] < 0
                        or not _forbids(u, v, previous, following, i, begin + j)
                    ):
                        j += 1
                    searched[i] = j
                    if j == n:
                        best = i
                        best_rank = rank[i]
                if rank[i] > rank[fallback]:
                    fallback = i
                i = following[i]
                if i == head:
                    break
            if not is_checked and best_rank != _COINCIDENT:
                # Corners that repeat their neighbour's position are clipped by now.
                is_checked = True
                is_crossing[ring] |= _touches_itself(u, v, following, head)
            if best < 0:
                is_crossing[ring] = True
                best = fallback
            head = previous[best]
            i = following[best]
            if _dot(u, v, head, best, best) > 0.0 and _dot(u, v, head, i, i) == 0.0:
                is_crossing[ring] = True  # a spike, there and back
            ears[written] = head
            ears[written + 1] = best
            ears[written + 2] = i
            written += 3
            following[head] = i
            previous[i] = head
            searched[best] = -1
            searched[head] = 0
            searched[i] = 0
            rank[head] = _rank(u, v, previous[head], head, i)
            rank[i] = _rank(u, v, head, i, following[i])
