"""Boxes of clusters and casters as a light sees them, and the tree over the clusters.

A light frame has two axes across the light, u and v, and the depth t along it, away
from the light. Clusters are the leaves of a tree of eight children a node, breadth
first and without pointers, of which only the bounds change from light to light:

    level 2                  [block]                    a block: 8 boxes, lane by lane
    level 1      [block][block] ... [block]                 0 1 ... 7
    level 0   [block][block] ........... [block]        u0  . .     .
                                                        u1  . .     .
    lane k of block b bounds block 8 b + k of the       v0  . .     .
    level below; at level 0 it bounds cluster           v1  . .     .
    8 b + k. Levels are stored from 0 up.               t1  . .     .

A cluster of faces that lie in one direction (a roof, the ground) is flat: besides its
box it has a slab, ``lo <= t - su u - sv v <= hi``. At a low sun the box of a strip of
ground is as deep as the strip is long, its slab is as thin as the ground is even.

All bounds are widened by what float32 rounds.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

_INF = np.float32(np.inf)
_LEAST = (0, 2)
"""Which numbers of a box are least ones; the others are most ones."""
_EMPTY_BOX = np.array([[_INF], [-_INF], [_INF], [-_INF], [-_INF]], np.float32)
_LEAST_TILT = 0.02
"""A face steeper to the light than this sine (1.1 degrees) gives no slab: slopes stay below 50."""


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def place_vertices(positions, frame, first, last, placed):
    """Write the vertices ``first .. last - 1`` in the light's frame.

    Parameters
    ----------
    positions, placed : ndarray
        ``(n_vertices, 3) float32`` [m]: (x, y, z), and (u, v, t) to be written.
    frame : ndarray
        ``(3, 3) float64``: the axes u, v, t.
    """
    for i in range(first, last):
        x = np.float64(positions[i, 0])
        y = np.float64(positions[i, 1])
        z = np.float64(positions[i, 2])
        for k in range(3):
            placed[i, k] = np.float32(frame[k, 0] * x + frame[k, 1] * y + frame[k, 2] * z)


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def choose_normals(positions, faces, order, start, first, last, normals):
    """Write the unit normal of the largest face, the first if several are, of clusters.

    Parameters
    ----------
    positions : ndarray
        ``(n_vertices, 3) float32`` [m]
    faces, order : ndarray
        ``(n_faces, 3) uint32`` and ``(n,) uint32``: faces in the order of clusters.
    start : ndarray
        ``(n_clusters + 1,) int64``
    normals : ndarray
        ``(n_clusters, 3) float32``: rows ``first .. last - 1`` are written.
    """
    for i in range(first, last):
        largest = 0.0
        for f in range(start[i], start[i + 1]):
            g = order[f]
            a, b, c = faces[g, 0], faces[g, 1], faces[g, 2]
            ux = np.float64(positions[b, 0]) - np.float64(positions[a, 0])
            uy = np.float64(positions[b, 1]) - np.float64(positions[a, 1])
            uz = np.float64(positions[b, 2]) - np.float64(positions[a, 2])
            vx = np.float64(positions[c, 0]) - np.float64(positions[a, 0])
            vy = np.float64(positions[c, 1]) - np.float64(positions[a, 1])
            vz = np.float64(positions[c, 2]) - np.float64(positions[a, 2])
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            area2 = nx * nx + ny * ny + nz * nz
            if area2 > largest:
                largest = area2
                scale = 1.0 / math.sqrt(area2)
                normals[i, 0], normals[i, 1], normals[i, 2] = nx * scale, ny * scale, nz * scale


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def bound_clusters(placed, faces, order, start, normals, frame, pad, first, last, blocks, slabs):
    """Write the boxes and slabs of the clusters ``first .. last - 1``.

    Parameters
    ----------
    placed : ndarray
        ``(n_vertices, 3) float32`` [m], in the light's frame.
    faces, order : ndarray
        ``(n_faces, 3) uint32`` and ``(n,) uint32``: faces in the order of clusters.
    start : ndarray
        ``(n_clusters + 1,) int64``: where each cluster's faces begin.
    normals : ndarray
        ``(n_clusters, 3) float32``: the unit normal of a face of each.
    frame : ndarray
        ``(3, 3) float64``
    pad : float
        [m]: bounds are widened by it.
    blocks : ndarray
        ``(n_blocks, 5, 8) float32``: level 0 is written.
    slabs : ndarray
        ``(n_clusters, 5) float64``: ``su, sv, lo, hi, t0``; t0 is the box's least depth.
    """
    for i in range(first, last):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        across = nx * frame[2, 0] + ny * frame[2, 1] + nz * frame[2, 2]
        su, sv = 0.0, 0.0
        if abs(across) > _LEAST_TILT:
            su = -(nx * frame[0, 0] + ny * frame[0, 1] + nz * frame[0, 2]) / across
            sv = -(nx * frame[1, 0] + ny * frame[1, 1] + nz * frame[1, 2]) / across
        u0, v0, t0, low = np.inf, np.inf, np.inf, np.inf
        u1, v1, t1, high = -np.inf, -np.inf, -np.inf, -np.inf
        for f in range(start[i], start[i + 1]):
            for k in range(3):
                p = faces[order[f], k]
                u = np.float64(placed[p, 0])
                v = np.float64(placed[p, 1])
                t = np.float64(placed[p, 2])
                s = t - su * u - sv * v
                u0, u1 = min(u0, u), max(u1, u)
                v0, v1 = min(v0, v), max(v1, v)
                t0, t1 = min(t0, t), max(t1, t)
                low, high = min(low, s), max(high, s)
        block, lane = i // 8, i % 8
        blocks[block, 0, lane] = u0 - pad
        blocks[block, 1, lane] = u1 + pad
        blocks[block, 2, lane] = v0 - pad
        blocks[block, 3, lane] = v1 + pad
        blocks[block, 4, lane] = t1 + pad
        reach = pad * (1.0 + abs(su) + abs(sv))
        slabs[i, 0], slabs[i, 1] = su, sv
        slabs[i, 2], slabs[i, 3] = low - reach, high + reach
        slabs[i, 4] = t0 - pad


def raise_levels(
    level_start: NDArray[np.int64], n_levels: int, n_clusters: int, blocks: NDArray[np.float32]
) -> None:
    """Empty the unused lanes of level 0 and write the levels above it.

    Parameters
    ----------
    level_start : ndarray
        ``(n_levels + 1,) int64``: where each level's blocks begin.
    blocks : ndarray
        ``(n_blocks, 5, 8) float32``: level 0 is read.

    Notes
    -----
    NumPy does it in half a millisecond for a city, and needs no compiling.
    """
    last = level_start[1] - 1
    blocks[last, :, n_clusters - 8 * last :] = _EMPTY_BOX
    for level in range(1, n_levels):
        below = blocks[level_start[level - 1] : level_start[level]]
        own = blocks[level_start[level] : level_start[level + 1]]
        for i in range(5):
            lanes = np.full(8 * len(own), _EMPTY_BOX[i, 0])
            extreme = np.minimum if i in _LEAST else np.maximum
            bounds = extreme(below[:, i, :4], below[:, i, 4:])
            bounds = extreme(bounds[:, :2], bounds[:, 2:])
            lanes[: len(below)] = extreme(bounds[:, 0], bounds[:, 1])
            own[:, i] = lanes.reshape(-1, 8)


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def bound_casters(placed, corners, start, pad, first, last, boxes):
    """Write the boxes of the casters ``first .. last - 1``.

    Parameters
    ----------
    placed : ndarray
        ``(n_vertices, 3) float32`` [m], in the light's frame.
    corners : ndarray
        ``(n_faces, 3) uint32``: of faces in the mesh's own order.
    start : ndarray
        ``(n_casters + 1,) int64``: where each caster's faces begin.
    pad : float
        [m]: bounds are widened by it.
    boxes : ndarray
        ``(n_casters, 6) float64``: ``u0, u1, v0, v1, t0, t1`` to be written.
    """
    for i in range(first, last):
        u0, v0, t0 = _INF, _INF, _INF
        u1, v1, t1 = -_INF, -_INF, -_INF
        for f in range(start[i], start[i + 1]):
            for k in range(3):
                p = corners[f, k]
                u, v, t = placed[p, 0], placed[p, 1], placed[p, 2]
                u0, u1 = min(u0, u), max(u1, u)
                v0, v1 = min(v0, v), max(v1, v)
                t0, t1 = min(t0, t), max(t1, t)
        boxes[i, 0], boxes[i, 1] = u0 - pad, u1 + pad
        boxes[i, 2], boxes[i, 3] = v0 - pad, v1 + pad
        boxes[i, 4], boxes[i, 5] = t0 - pad, t1 + pad
