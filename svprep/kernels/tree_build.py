"""Building the two silhouette trees: an order of edges, then bounds over it.

The order comes from halving: the widest of several numbers per edge decides, and
every cut falls on a multiple of eight leaves of eight edges, or of eight times as
many, so that the tree needs no pointers. The bounds go bottom-up in the blocks
that `kernels.search` describes.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_LEAF = 8
UNIT = 32000.0
"""`kernels.search.UNIT`: blocks hold int16."""
_PAD = 4e-7
"""Above what float32 rounds of a dual point (|p| <= 2) and float64 lost before."""

_helper = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_helper
def _select(keys, ids, begin, end, middle, axis):
    """Reorder rows so that none before `middle` is above any behind it, along `axis`."""
    low, high = begin, end - 1
    while low < high:
        a, b, c = keys[low, axis], keys[(low + high) // 2, axis], keys[high, axis]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while keys[i, axis] < pivot:
                i += 1
            while keys[j, axis] > pivot:
                j -= 1
            if i <= j:
                for d in range(keys.shape[1]):
                    keys[i, d], keys[j, d] = keys[j, d], keys[i, d]
                ids[i], ids[j] = ids[j], ids[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def order_pairs(keys, ids, start, first, last):
    """Reorder the edges of trees ``first .. last - 1`` so that near ones are together.

    Parameters
    ----------
    keys : ndarray
        ``(n, d) float32``: what makes edges alike; reordered too.
    ids : ndarray
        ``(n,) uint32``
    start : ndarray
        ``(n_trees + 1,) int64``

    Notes
    -----
    O(n log n). Hoare's selection; each part is cut where its keys spread most.
    """
    dims = keys.shape[1]
    stack = np.empty((128, 2), np.int64)
    low = np.empty(dims, np.float32)
    high = np.empty(dims, np.float32)
    for t in range(first, last):
        stack[0, 0] = start[t]
        stack[0, 1] = start[t + 1]
        depth = 1
        while depth > 0:
            depth -= 1
            begin, end = stack[depth, 0], stack[depth, 1]
            while end - begin > _LEAF:
                n_leaves = (end - begin + _LEAF - 1) // _LEAF
                whole = 1
                while whole * 8 < n_leaves:
                    whole *= 8
                n_parts = (n_leaves + whole - 1) // whole
                middle = begin + (n_parts + 1) // 2 * whole * _LEAF
                for d in range(dims):
                    low[d] = keys[begin, d]
                    high[d] = keys[begin, d]
                for i in range(begin + 1, end):
                    for d in range(dims):
                        low[d] = min(low[d], keys[i, d])
                        high[d] = max(high[d], keys[i, d])
                axis = np.int64(0)  # for a literal `_select` would be compiled once more
                for d in range(1, dims):
                    if high[d] - low[d] > high[axis] - low[axis]:
                        axis = d
                _select(keys, ids, begin, end, middle, axis)
                stack[depth, 0] = middle
                stack[depth, 1] = end
                depth += 1
                end = middle


@_helper
def _dual(planes, p, frames, t):
    """Return the dual point of plane record p about the centre and radius of tree t.

    ``(n / |n|, (d + n . c) / (r |n|))``
    """
    nx, ny, nz = planes[p, 0], planes[p, 1], planes[p, 2]
    scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    height = planes[p, 3] + nx * frames[t, 0] + ny * frames[t, 1] + nz * frames[t, 2]
    return nx * scale, ny * scale, nz * scale, height * scale / frames[t, 3]


@_helper
def _middle(positions, ends, i, frames, t):
    """Return the middle of edge i in the frame of tree t."""
    a, b = ends[i, 0], ends[i, 1]
    scale = 0.5 / np.float64(frames[t, 3])
    x = (np.float64(positions[a, 0]) + np.float64(positions[b, 0])) - 2.0 * frames[t, 0]
    y = (np.float64(positions[a, 1]) + np.float64(positions[b, 1])) - 2.0 * frames[t, 1]
    z = (np.float64(positions[a, 2]) + np.float64(positions[b, 2])) - 2.0 * frames[t, 2]
    return x * scale, y * scale, z * scale


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def write_keys(planes, refs, ends, positions, frames, start, first, last, box_keys, cone_keys):
    """Write what makes edges alike: for dual boxes, and for spheres with cones.

    Parameters
    ----------
    planes : ndarray
        ``(n_planes, 4) float64``
    refs, ends : ndarray
        ``(n, 2) uint32``: plane records and vertices of each edge.
    positions : ndarray
        ``(n_vertices, 3) float32``
    frames : ndarray
        ``(n_trees, 4) float32``: centre and radius.
    start : ndarray
        ``(n_trees + 1,) int64``
    box_keys : ndarray
        ``(n, 4) float32``, written: the middle of the dual segment.
    cone_keys : ndarray
        ``(n, 6) float32``, written: the middle of the edge, and of its normals.
    """
    for t in range(first, last):
        for i in range(start[t], start[t + 1]):
            ax, ay, az, ad = _dual(planes, refs[i, 0], frames, t)
            bx, by, bz, bd = _dual(planes, refs[i, 1], frames, t)
            x, y, z = 0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz)
            box_keys[i, 0] = x
            box_keys[i, 1] = y
            box_keys[i, 2] = z
            cone_keys[i, 3] = x
            cone_keys[i, 4] = y
            cone_keys[i, 5] = z
            box_keys[i, 3] = 0.5 * (ad + bd)
            x, y, z = _middle(positions, ends, i, frames, t)
            cone_keys[i, 0] = x
            cone_keys[i, 1] = y
            cone_keys[i, 2] = z


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def write_leaves(planes, refs, frames, starts, first, last, leaves):
    """Write the dual points of eight edges a block: left plane, then right plane.

    ``refs (n, 2)`` in the order of the tree, ``starts (n_trees + 1, 4)`` as
    `search.search_trees` takes them, ``leaves (64 * n_leaves,) int16``.
    """
    for t in range(first, last):
        for i in range(starts[t, 0], starts[t + 1, 0]):
            n = i - starts[t, 0]
            base = (starts[t, 2] + n // _LEAF) * 64 + n % _LEAF
            for side in range(2):
                x, y, z, d = _dual(planes, refs[i, side], frames, t)
                leaves[base + 32 * side] = np.int16(np.rint(UNIT * x))
                leaves[base + 32 * side + 8] = np.int16(np.rint(UNIT * y))
                leaves[base + 32 * side + 16] = np.int16(np.rint(UNIT * z))
                leaves[base + 32 * side + 24] = np.int16(np.rint(0.5 * UNIT * d))


@_helper
def _widen(low, high, leaf, x, y, z, d):
    low[leaf, 0] = min(low[leaf, 0], x)
    low[leaf, 1] = min(low[leaf, 1], y)
    low[leaf, 2] = min(low[leaf, 2], z)
    low[leaf, 3] = min(low[leaf, 3], d)
    high[leaf, 0] = max(high[leaf, 0], x)
    high[leaf, 1] = max(high[leaf, 1], y)
    high[leaf, 2] = max(high[leaf, 2], z)
    high[leaf, 3] = max(high[leaf, 3], d)


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def write_boxes(planes, refs, frames, starts, first, last, low, high, blocks):
    """Write the 4D boxes of trees ``first .. last - 1``: centres and half extents.

    Parameters as `write_leaves`; ``low``, ``high (n_leaves, 4) float64``: scratch that
    begins at +inf and -inf. ``blocks (64 * n_blocks,) int16``, zero where no box is.
    """
    for t in range(first, last):
        leaf = starts[t, 2]
        for i in range(starts[t, 0], starts[t + 1, 0]):
            for side in range(2):
                x, y, z, d = _dual(planes, refs[i, side], frames, t)
                _widen(low, high, leaf + (i - starts[t, 0]) // _LEAF, x, y, z, d)
        n = starts[t + 1, 2] - leaf
        level_begin = starts[t + 1, 1]
        while True:
            n_above = (n + _LEAF - 1) // _LEAF
            level_begin -= n_above
            for i in range(n):
                base = (level_begin + i // _LEAF) * 64 + i % _LEAF
                for d in range(4):
                    per_unit = UNIT if d < 3 else 0.5 * UNIT
                    lowest = (low[leaf + i, d] - _PAD) * per_unit
                    highest = (high[leaf + i, d] + _PAD) * per_unit
                    centre = np.rint(0.5 * (lowest + highest))
                    half = np.ceil(max(highest - centre, centre - lowest))
                    blocks[base + 8 * d] = np.int16(centre)
                    blocks[base + 32 + 8 * d] = np.int16(half)
            if n <= _LEAF:
                break
            for i in range(n):
                for d in range(4):
                    if i % _LEAF == 0:
                        low[leaf + i // _LEAF, d] = low[leaf + i, d]
                        high[leaf + i // _LEAF, d] = high[leaf + i, d]
                    else:
                        at = leaf + i // _LEAF
                        low[at, d] = min(low[at, d], low[leaf + i, d])
                        high[at, d] = max(high[at, d], high[leaf + i, d])
            n = n_above


@_helper
def _write_cone(planes, refs, ends, positions, frames, t, begin, end, tolerance, blocks, base):
    """Write the sphere and the cone of the edges ``begin .. end - 1``."""
    x0, y0, z0 = _middle(positions, ends, begin, frames, t)
    x1, y1, z1 = x0, y0, z0
    nx, ny, nz = 0.0, 0.0, 0.0
    for i in range(begin, end):
        x, y, z = _middle(positions, ends, i, frames, t)
        x0, y0, z0 = min(x0, x), min(y0, y), min(z0, z)
        x1, y1, z1 = max(x1, x), max(y1, y), max(z1, z)
        for side in range(2):
            x, y, z, _ = _dual(planes, refs[i, side], frames, t)
            nx, ny, nz = nx + x, ny + y, nz + z
    # Both as they are stored, so that radius and angle need no more room.
    cx = np.rint(0.5 * UNIT * (x0 + x1)) / UNIT
    cy = np.rint(0.5 * UNIT * (y0 + y1)) / UNIT
    cz = np.rint(0.5 * UNIT * (z0 + z1)) / UNIT
    length = max(math.sqrt(nx * nx + ny * ny + nz * nz), 1e-300)
    nx = np.rint(UNIT * nx / length) / UNIT
    ny = np.rint(UNIT * ny / length) / UNIT
    nz = np.rint(UNIT * nz / length) / UNIT
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    is_open = length == 0.0
    radius2, sine2 = 0.0, 0.0
    for i in range(begin, end):
        x, y, z = _middle(positions, ends, i, frames, t)
        x, y, z = x - cx, y - cy, z - cz
        radius2 = max(radius2, x * x + y * y + z * z)
        for side in range(2):
            x, y, z, _ = _dual(planes, refs[i, side], frames, t)
            a, b, c = ny * z - nz * y, nz * x - nx * z, nx * y - ny * x
            sine2 = max(sine2, a * a + b * b + c * c)
            is_open |= nx * x + ny * y + nz * z <= 0.0
    radius = np.ceil(UNIT * (math.sqrt(radius2) + tolerance / frames[t, 3] + _PAD))
    # A sine of 1 decides nothing. So does one beside a sphere too large to be stored.
    is_open |= radius > UNIT
    sine = np.ceil(UNIT * (math.sqrt(sine2) / max(length, 1e-300) + _PAD))
    blocks[base] = np.int16(np.rint(UNIT * cx))
    blocks[base + 8] = np.int16(np.rint(UNIT * cy))
    blocks[base + 16] = np.int16(np.rint(UNIT * cz))
    blocks[base + 24] = np.int16(min(radius, UNIT))
    blocks[base + 32] = np.int16(np.rint(UNIT * nx))
    blocks[base + 40] = np.int16(np.rint(UNIT * ny))
    blocks[base + 48] = np.int16(np.rint(UNIT * nz))
    blocks[base + 56] = np.int16(UNIT if is_open else min(sine, UNIT))


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def write_cones(planes, refs, ends, positions, frames, starts, tolerance, first, last, blocks):
    """Write the spheres and normal cones of trees ``first .. last - 1``.

    A sphere holds the middles of its edges, widened by `tolerance` [m]: as far as
    they may lie from a plane record. A cone holds the normals of all records.
    Sander et al. (2000) and Hertzmann and Zorin (2000) search such hierarchies.

    Parameters as `write_boxes`; ``refs``, ``ends`` in the order of this tree.
    """
    for t in range(first, last):
        n = starts[t + 1, 2] - starts[t, 2]
        level_begin = starts[t + 1, 1]
        n_edges = _LEAF
        while True:
            level_begin -= (n + _LEAF - 1) // _LEAF
            for i in range(n):
                begin = starts[t, 0] + i * n_edges
                end = min(begin + n_edges, starts[t + 1, 0])
                base = (level_begin + i // _LEAF) * 64 + i % _LEAF
                _write_cone(
                    planes, refs, ends, positions, frames, t, begin, end, tolerance, blocks, base
                )
            if n <= _LEAF:
                break
            n = (n + _LEAF - 1) // _LEAF
            n_edges *= _LEAF
