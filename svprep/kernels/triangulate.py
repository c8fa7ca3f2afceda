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


@_helper
def _unlink(i, blocker, first, before, after):
    """Let corner i no longer wait for the corner that forbids its ear."""
    q = blocker[i]
    if q < 0:
        return
    if before[i] < 0:
        first[q] = after[i]
    else:
        after[before[i]] = after[i]
    if after[i] >= 0:
        before[after[i]] = before[i]
    blocker[i] = -1


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def clip_large_ring(u, v, along, across, order, slack, previous, following, most_steps, ears):
    """Clip the ears of one ring, any before the best; say whether all but a fan are ears.

    Corners stand in a queue. One whose ear is forbidden waits until the corner that forbids
    it, or a neighbour, is clipped. Those that might forbid it are looked for along one axis.
    Where no ear is left, or work enough was done, what remains of the ring is fanned.

    Parameters
    ----------
    u, v : (n,) float64
        Counter-clockwise.
    along, across : (n,) float64
        Coordinates along the axis, and across it.
    order : (n,) int64
        Corners, sorted by `along`. Changed.
    slack : float
        Rounding of both.
    previous, following : (n,) int64
        The ring as a linked list. Changed.
    most_steps : int64
        Corners that are looked at, O(1) each.
    ears : (n - 2, 3) int64
        Filled.
    """
    n = len(u)
    sorted_along = along[order]
    sorted_across = across[order]  # read one after the other: far quicker than by corner
    n_sorted = n
    is_clipped = np.zeros(n, np.bool_)
    queue = np.arange(n)
    front = 0
    n_queued = n
    is_queued = np.ones(n, np.bool_)
    is_delayed = np.zeros(n, np.bool_)  # a neighbour was clipped: others first, or slivers result
    blocker = np.full(n, -1, np.int64)
    first = np.full(n, -1, np.int64)  # of those that wait for a corner: a linked list
    before = np.full(n, -1, np.int64)
    after = np.full(n, -1, np.int64)
    head = np.int64(0)
    n_left = n
    n_left_at_last_try = n + 1
    steps = 0
    while n_left > 3 and steps < most_steps:
        if n_queued == 0:
            # Edges at a corner that coincides with an ear's may have turned.
            if n_left == n_left_at_last_try:
                break
            n_left_at_last_try = n_left
            i = head
            for _ in range(n_left):
                _unlink(i, blocker, first, before, after)
                queue[(front + n_queued) % n] = i
                is_queued[i] = True
                n_queued += 1
                i = following[i]
        i = queue[front]
        front = (front + 1) % n
        n_queued -= 1
        steps += 1
        if is_delayed[i]:
            is_delayed[i] = False
            queue[(front + n_queued) % n] = i
            n_queued += 1
            continue
        is_queued[i] = False
        a = previous[i]
        c = following[i]
        rank = _rank(u, v, a, i, c)
        if rank <= 0.0:
            continue
        if rank != _COINCIDENT:
            low = min(across[a], across[i], across[c]) - slack
            high = max(across[a], across[i], across[c]) + slack
            end = max(along[a], along[i], along[c]) + slack
            j = np.searchsorted(sorted_along[:n_sorted], min(along[a], along[i], along[c]) - slack)
            q = np.int64(-1)
            while j < n_sorted and sorted_along[j] <= end:
                steps += 1
                if (
                    low <= sorted_across[j] <= high
                    and not is_clipped[order[j]]
                    and _forbids(u, v, previous, following, i, order[j])
                ):
                    q = order[j]
                    break
                j += 1
            if q >= 0:
                blocker[i] = q
                before[i] = -1
                after[i] = first[q]
                if first[q] >= 0:
                    before[first[q]] = i
                first[q] = i
                continue
        ears[n - n_left, 0] = a
        ears[n - n_left, 1] = i
        ears[n - n_left, 2] = c
        n_left -= 1
        following[a] = c
        previous[c] = a
        is_clipped[i] = True
        head = a
        while first[i] >= 0:
            k = first[i]
            _unlink(k, blocker, first, before, after)
            queue[(front + n_queued) % n] = k
            is_queued[k] = True
            n_queued += 1
        for k in (a, c):
            if is_queued[k]:
                is_delayed[k] = True
                continue
            _unlink(k, blocker, first, before, after)
            queue[(front + n_queued) % n] = k
            is_queued[k] = True
            n_queued += 1
        if 2 * n_left < n_sorted:
            n_kept = 0
            for j in range(n_sorted):
                if not is_clipped[order[j]]:
                    order[n_kept] = order[j]
                    sorted_along[n_kept] = sorted_along[j]
                    sorted_across[n_kept] = sorted_across[j]
                    n_kept += 1
            n_sorted = n_kept
    is_whole = n_left == 3
    i = following[head]
    while n_left > 2:
        ears[n - n_left, 0] = head
        ears[n - n_left, 1] = i
        ears[n - n_left, 2] = following[i]
        i = following[i]
        n_left -= 1
    return is_whole
