"""The flat scan: the multiplicity of one record after another, then those not zero.

Two passes, so that threads need not wait for each other's counts and each row is
written once, in its place: `multiplicities` streams the records and counts,
`compress` writes ids and multiplicities of those that are left.

Indices are unsigned: signed ones could count from the end, which costs a test each.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_STEP = np.uint64(4096)
_LOW = np.uint64(0xFFFFFFFF)


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def multiplicities(sides, s, begin, end, to, m):
    """Write ``m = s[left] - s[right]`` of ranges of records; return how many are not 0.

    Parameters
    ----------
    sides : ndarray
        ``(n,) uint64``: the plane record on the left, and 2^32 times that on the
        right; of a missing face, one with s = 0.
    s : ndarray
        ``(n_planes + 1,) int8``: counted facing.
    begin, end, to : ndarray
        ``(k,) int64``: ranges of records, and where in `m` they go.
    m : ndarray
        ``int8``
    """
    n = np.int64(0)
    for k in range(len(begin)):
        shift = np.uint64(to[k] - begin[k])
        for first in range(np.uint64(begin[k]), np.uint64(end[k]), _STEP):
            last = min(np.uint64(end[k]), first + _STEP)
            for r in range(first, last):
                both = sides[r]
                m[r + shift] = s[both & _LOW] - s[both >> np.uint64(32)]
            # Apart, because this loop does many at a time.
            for r in range(first + shift, last + shift):
                n += m[r] != 0
    return n


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def compress(
    record, m, begin, end, to, keys, key_begin, key_end, first, last, begin_at, end_at,
    at, n_rows, edge, multiplicity, start,
):  # fmt: skip
    """Write the silhouette of a chunk of objects into its place.

    The chunk is the objects ``first .. last - 1``, of which the first may begin late, at
    record `begin_at`, and the last end early, at `end_at`: threads share one large
    object. An object has records to scan, or keys that a search left: one of the two is
    empty.

    Parameters
    ----------
    record : ndarray
        ``(n,) uint32``: ids of the records.
    m : ndarray
        ``int8``: what `multiplicities` wrote.
    begin, end, to : ndarray
        ``(k,) int64``: each object's records, and where in `m` they are.
    first, last, begin_at, end_at : int
        The chunk.
    keys : ndarray
        ``uint64``: ``8 * record + m + 2``, sorted.
    key_begin, key_end : ndarray
        ``(k,) int64``
    at, n_rows : int
        Where the chunk's first row goes, and how many rows it has.
    edge, multiplicity : ndarray
        ``uint32``, ``int8``: written from row `at` on, `n_rows` of them.
    start : ndarray
        ``(k,) int64``: the first row of each object that begins here, written.
    """
    n = np.uint64(at)
    n_end = np.uint64(at + n_rows)
    for k in range(first, last):
        r = np.uint64(begin_at if k == first else begin[k])
        stop = np.uint64(end_at if k == last - 1 else end[k])
        shift = np.uint64(to[k] - begin[k])
        if r == np.uint64(begin[k]):
            start[k] = n
        n_left = n_end - n
        if n_left > stop - r:
            # Without a branch: a zero is written too, and overwritten by the next row,
            # which there is.
            while r < stop:
                value = m[r + shift]
                edge[n] = record[r]
                multiplicity[n] = value
                n += np.uint64(value != 0)
                r += np.uint64(1)
        elif np.uint64(8) * n_left < stop - r:
            # Few are left of many: eight zeros at a time.
            while n < n_end and r < stop:
                while r + np.uint64(8) <= stop:
                    i = r + shift
                    some = m[i] | m[i + np.uint64(1)] | m[i + np.uint64(2)] | m[i + np.uint64(3)]
                    some |= m[i + np.uint64(4)] | m[i + np.uint64(5)]
                    some |= m[i + np.uint64(6)] | m[i + np.uint64(7)]
                    if some != 0:
                        break
                    r += np.uint64(8)
                block_end = min(stop, r + np.uint64(8))
                while r < block_end and n < n_end:
                    value = m[r + shift]
                    edge[n] = record[r]
                    multiplicity[n] = value
                    n += np.uint64(value != 0)
                    r += np.uint64(1)
        else:
            while n < n_end and r < stop:
                value = m[r + shift]
                edge[n] = record[r]
                multiplicity[n] = value
                n += np.uint64(value != 0)
                r += np.uint64(1)
        for i in range(np.uint64(key_begin[k]), np.uint64(key_end[k])):
            edge[n] = np.uint32(keys[i] >> np.uint64(3))
            multiplicity[n] = np.int8(np.int64(keys[i] & np.uint64(7)) - 2)
            n += np.uint64(1)
