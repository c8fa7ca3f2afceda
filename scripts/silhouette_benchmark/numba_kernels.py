"""Kernels of baseline (b) and of the memory test. Numba infers their types itself."""

# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from numba import njit

# Unsigned indices throughout: Numba then leaves out the test for a negative one,
# which would keep loops from becoming vector code.


@njit(cache=True, nogil=True, error_model="numpy")
def face_planes(nx, ny, nz, d, floor, light, begin, end, facing):
    """Write the facing of planes ``[begin, end)``, clamped to their floor."""
    x, y, z = light[0], light[1], light[2]
    if light[3] == 0.0:
        for p in range(np.uint64(begin), np.uint64(end)):
            value = nx[p] * x + ny[p] * y + nz[p] * z
            facing[p] = max(np.int8(np.int8(value > 0.0) - np.int8(value < 0.0)), floor[p])
    else:
        for p in range(np.uint64(begin), np.uint64(end)):
            value = nx[p] * x + ny[p] * y + nz[p] * z + d[p]
            facing[p] = max(np.int8(np.int8(value > 0.0) - np.int8(value < 0.0)), floor[p])


@njit(cache=True, nogil=True, error_model="numpy")
def scan_free(object_start, begin, end, left, right, edge, facing, first, out, out_m, out_start):
    """Write the silhouette among records ``[begin, end)``, without a branch per record.

    To ``out`` and ``out_m`` from place ``first`` on; ``out_start[o]`` is where the
    first record of object o came to lie, for objects that start in the range.
    Returns one past the last place. Every record is written, and overwritten by the
    next unless it counts; ids are looked up afterwards, for those that do.
    """
    one = np.uint64(1)
    k = np.uint64(first)
    o = np.uint64(np.searchsorted(object_start, begin))
    r = np.uint64(begin)
    stop = np.uint64(end)
    n_objects = np.uint64(len(object_start) - 1)
    while r < stop:
        while o < n_objects and np.uint64(object_start[o]) == r:
            out_start[o] = k
            o += one
        until = min(stop, np.uint64(object_start[o]))
        for i in range(r, until):
            m = facing[left[i]] - facing[right[i]]
            out[k] = i
            out_m[k] = m
            k += np.uint64(m != 0)
        r = until
    for j in range(np.uint64(first), k):
        out[j] = edge[out[j]]
    return np.int64(k)


@njit(cache=True, nogil=True, error_model="numpy")
def scan_branching(
    object_start, begin, end, left, right, edge, facing, first, out, out_m, out_start
):
    """Do the same as `scan_free` with a branch: faster where almost no record counts."""
    one = np.uint64(1)
    k = np.uint64(first)
    o = np.uint64(np.searchsorted(object_start, begin))
    r = np.uint64(begin)
    stop = np.uint64(end)
    n_objects = np.uint64(len(object_start) - 1)
    while r < stop:
        while o < n_objects and np.uint64(object_start[o]) == r:
            out_start[o] = k
            o += one
        until = min(stop, np.uint64(object_start[o]))
        for i in range(r, until):
            m = facing[left[i]] - facing[right[i]]
            if m != 0:
                out[k] = edge[i]
                out_m[k] = m
                k += one
        r = until
    return np.int64(k)


@njit(cache=True, nogil=True, error_model="numpy")
def face_and_scan(
    planes, floor, light, object_start, object_plane_start, cuts, branching,
    left, right, edge, facing, first, out, out_m, out_start,
):  # fmt: skip
    """Face the planes of a few objects and scan their records while those are at hand.

    ``cuts``: object numbers between which to do so. Returns one past the last place.
    """
    nx, ny, nz, d = planes
    k = np.int64(first)
    for g in range(len(cuts) - 1):
        low, high = cuts[g], cuts[g + 1]
        face_planes(
            nx, ny, nz, d, floor, light,
            object_plane_start[low], object_plane_start[high], facing,
        )  # fmt: skip
        begin, end = object_start[low], object_start[high]
        if branching:
            k = scan_branching(
                object_start, begin, end, left, right, edge, facing, k, out, out_m, out_start
            )
        else:
            k = scan_free(
                object_start, begin, end, left, right, edge, facing, k, out, out_m, out_start
            )
    return k


@njit(cache=True, nogil=True, error_model="numpy")
def solids_around(light, low, high, inside):
    """Write the numbers of the boxes that hold the light to `inside`; return how many."""
    x, y, z = light[0], light[1], light[2]
    k = np.uint64(0)
    for i in range(np.uint64(len(low))):
        inside[k] = i
        k += np.uint64(
            (low[i, 0] <= x) & (x <= high[i, 0])
            & (low[i, 1] <= y) & (y <= high[i, 1])
            & (low[i, 2] <= z) & (z <= high[i, 2])
        )  # fmt: skip
    return np.int64(k)


@njit(cache=True, nogil=True, error_model="numpy")
def sum_integers(a, begin, end):
    """Return the sum of ``a[begin:end] uint64``, which may be done in any order: vectors."""
    total = np.uint64(0)
    for i in range(np.uint64(begin), np.uint64(end)):
        total += a[i]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def sum_floats(a, begin, end):
    """Return the sum of ``a[begin:end] float64``; a multiple of 8 numbers.

    Eight sums, because one waits for each addition: 4 GB/s where memory gives 25.
    """
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    for i in range(np.uint64(begin), np.uint64(end), np.uint64(8)):
        s0 += a[i]
        s1 += a[i + np.uint64(1)]
        s2 += a[i + np.uint64(2)]
        s3 += a[i + np.uint64(3)]
        s4 += a[i + np.uint64(4)]
        s5 += a[i + np.uint64(5)]
        s6 += a[i + np.uint64(6)]
        s7 += a[i + np.uint64(7)]
    return ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7))


@njit(cache=True, nogil=True, error_model="numpy")
def write_all(a, value, begin, end):
    """Fill ``a[begin:end]``."""
    for i in range(np.uint64(begin), np.uint64(end)):
        a[i] = value


@njit(cache=True, nogil=True, error_model="numpy")
def copy_all(a, b, begin, end):
    """Copy ``a[begin:end]`` to `b`."""
    for i in range(np.uint64(begin), np.uint64(end)):
        b[i] = a[i]
