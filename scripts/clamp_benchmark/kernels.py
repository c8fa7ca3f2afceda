"""Kernels of the clamp benchmark. Numba infers their types itself."""

# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from numba import njit

MARGIN_M = 0.01
"""Points this close to the side or the front of a caster's prism are not asked whether a
segment holds them: they are rounded by a ray tracer in float32."""


@njit(cache=True, nogil=True, error_model="numpy")
def count_updates(
    origins, directions, seen, hidden_start, hidden, boxes, start, depths, slopes, first, last,
    updates, floor, left_out,
):  # fmt: skip
    """Write what the pixels ``first .. last - 1`` cost, for several tables of segments.

    A segment is the part of the caster's rectangle across the light between its near and its
    far plane: a convex prism, entered once and left once by a ray. Each of the two that lies
    behind the visible surface is a fragment that fails the depth test: one update. What lies
    behind the eye is not drawn.

        eye . . . . . . [surface] . . . entry . . . exit . . .     2 updates
        eye . . . entry . [surface] . . exit . . . . . . . . .     1, in shadow perhaps
        eye . . . entry . . exit . [surface] . . . . . . . . .     0

    Parameters
    ----------
    origins, directions : ndarray
        ``(n_pixels, 3) float64``: rays in the light's frame, directions of length 1.
    seen : ndarray
        ``(n_pixels,) float64`` [m]: how far the visible surface is, infinite for the sky.
    hidden_start, hidden : ndarray
        ``(n_pixels + 1,) int64`` and ``(n,) float64`` [m]: how far the surfaces behind the
        visible one are.
    boxes : ndarray
        ``(n_casters, 6) float64`` [m]: ``u0, u1, v0, v1, t0, t1`` in the light's frame.
    start : ndarray
        ``(n_tables, n_casters + 1) int64``: where each table's segments of a caster begin.
    depths, slopes : ndarray
        ``(n_segments, 2) float64``: near and far [m], and slopes along u and v, of all
        tables, as `svprep.model.ClampTable` defines them. A caster's first segment
        begins at its own front, across the light.
    updates : ndarray
        ``(n_pixels, n_tables) int64``: to be written.
    floor : ndarray
        ``(n_pixels, 2) int64``: to be written. The casters in whose rectangle, behind whose
        front, the visible point lies; and those that do not hold it, but a point of a
        surface behind it. What clamps for any view holds both: the former are left at least
        once behind the visible surface, the latter also entered there.
    left_out : ndarray
        ``(n_pixels, n_tables) int64``: of the former, those none of whose segments holds
        the point. To be written; a table that may be drawn has none.
    """
    n_tables = len(start)
    for r in range(first, last):
        floor[r, 0], floor[r, 1] = 0, 0
        for table in range(n_tables):
            updates[r, table], left_out[r, table] = 0, 0
        surface = seen[r]
        if surface == np.inf:
            continue
        ou, ov, ot = origins[r, 0], origins[r, 1], origins[r, 2]
        du, dv, dt = directions[r, 0], directions[r, 1], directions[r, 2]
        over_u, over_v = 1.0 / du, 1.0 / dv
        u, v, t = ou + surface * du, ov + surface * dv, ot + surface * dt
        for i in range(len(boxes)):
            a, b = (boxes[i, 0] - ou) * over_u, (boxes[i, 1] - ou) * over_u
            begin, end = min(a, b), max(a, b)
            a, b = (boxes[i, 2] - ov) * over_v, (boxes[i, 3] - ov) * over_v
            begin, end = max(begin, min(a, b)), min(end, max(a, b))
            if end <= begin or end <= surface:
                continue
            front = boxes[i, 4]
            if begin <= surface and t >= front:
                floor[r, 0] += 1
            else:
                for k in range(hidden_start[r], hidden_start[r + 1]):
                    if hidden[k] >= begin and hidden[k] <= end and ot + hidden[k] * dt >= front:
                        floor[r, 1] += 1
                        break
            is_within = (
                (u >= boxes[i, 0] + MARGIN_M)
                & (u <= boxes[i, 1] - MARGIN_M)
                & (v >= boxes[i, 2] + MARGIN_M)
                & (v <= boxes[i, 3] - MARGIN_M)
                & (t >= front + MARGIN_M)
            )
            for table in range(n_tables):
                is_held = False
                for k in range(start[table, i], start[table, i + 1]):
                    su, sv = slopes[k, 0], slopes[k, 1]
                    at, per = ot - su * ou - sv * ov, dt - su * du - sv * dv
                    into, out = begin, end
                    cut = (depths[k, 1] - at) / per
                    if per > 0.0:
                        out = min(out, cut)
                    else:
                        into = max(into, cut)
                    here = at + surface * per
                    is_before = here <= depths[k, 1]
                    near = depths[k, 0]
                    if k == start[table, i]:
                        at, per, near, here = ot, dt, front, t
                    cut = (near - at) / per
                    if per > 0.0:
                        into = max(into, cut)
                    else:
                        out = min(out, cut)
                    is_held |= is_before & (here >= near)
                    if out > into and out > 0.0:
                        updates[r, table] += np.int64(out > surface) + np.int64(into > surface)
                left_out[r, table] += is_within and not is_held


@njit(cache=True, nogil=True, error_model="numpy")
def _cut(polygon, n, other, axis, sign, bound):
    """Write the part of a polygon where ``sign * (coordinate - bound) >= 0``; count corners."""
    count = 0
    for k in range(n):
        j = k + 1 if k + 1 < n else 0
        here = sign * (polygon[k, axis] - bound)
        there = sign * (polygon[j, axis] - bound)
        if here >= 0.0:
            for d in range(3):
                other[count, d] = polygon[k, d]
            count += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            part = here / (here - there)
            for d in range(3):
                other[count, d] = polygon[k, d] + part * (polygon[j, d] - polygon[k, d])
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def cut_ends(boxes, blocks, level_start, triangles, horizon, first, last, ends):
    """Write how deep the faces within the rectangles of casters ``first .. last - 1`` reach.

    Each face that may is cut to the rectangle and to what lies behind the caster's front
    (Sutherland, Hodgman 1974).

    Parameters
    ----------
    boxes : ndarray
        ``(n_casters, 6) float64`` [m]: of the casters, in the light's frame.
    blocks, level_start
        The tree over faces (`svprep.kernels.light_boxes`).
    triangles : ndarray
        ``(n_faces, 3, 3) float32`` [m]: corners in the light's frame, in the tree's order.
    horizon : ndarray
        ``(2,) float64``: slopes of a horizontal plane.
    ends : ndarray
        ``(n_casters, 2) float64`` [m]: the most t, at least the caster's own, and the most
        ``t - su u - sv v``. To be written.
    """
    stack = np.empty(1024, np.int64)
    polygon, other = np.empty((10, 3)), np.empty((10, 3))
    top = len(level_start) - 2
    for c in range(first, last):
        u0, u1, v0, v1, front = boxes[c, 0], boxes[c, 1], boxes[c, 2], boxes[c, 3], boxes[c, 4]
        ends[c, 0], ends[c, 1] = boxes[c, 5], -np.inf
        stack[0], depth = level_start[top] * 32 + top, 1
        while depth > 0:
            depth -= 1
            level, block = stack[depth] % 32, stack[depth] // 32
            for lane in range(8):
                if not (
                    (blocks[block, 0, lane] <= u1)
                    & (blocks[block, 1, lane] >= u0)
                    & (blocks[block, 2, lane] <= v1)
                    & (blocks[block, 3, lane] >= v0)
                    & (blocks[block, 4, lane] >= front)
                ):
                    continue
                if level > 0:
                    child = level_start[level - 1] + 8 * (block - level_start[level]) + lane
                    stack[depth] = child * 32 + level - 1
                    depth += 1
                    continue
                for k in range(3):
                    for d in range(3):
                        polygon[k, d] = triangles[8 * block + lane, k, d]
                n = _cut(polygon, 3, other, 0, 1.0, u0)
                n = _cut(other, n, polygon, 0, -1.0, u1)
                n = _cut(polygon, n, other, 1, 1.0, v0)
                n = _cut(other, n, polygon, 1, -1.0, v1)
                n = _cut(polygon, n, other, 2, 1.0, front)
                for k in range(n):
                    u, v, t = other[k, 0], other[k, 1], other[k, 2]
                    ends[c, 0] = max(ends[c, 0], t)
                    ends[c, 1] = max(ends[c, 1], t - horizon[0] * u - horizon[1] * v)
