r"""Continuous clamping: where along the light a caster's shadow can be received.

    sun
      \ \ \ \   caster                         front to back along the light:
       \ \ \ +-----+                           the caster itself, with what lies
        \ \ \|     |                           close behind it: its own segment
              \ own \
               \- - -\                         a gap: nothing is there to be
                \ gap \                        seen in shadow
         - - - - \- - -\- - -  near
        ~~~~~~~~~~\~~~~~\~~~~~ ground          then the ground: between two planes
         - - - - - \- - -\- -  far             parallel to it

For each caster: the clusters that overlap its rectangle across the light and reach
behind its front are its receivers; each is worth an interval of depth, as far as
its box and its slab tell within the caster's rectangle. The intervals are merged
front to back; a gap stays where ``V < R``: two more caps cost less than the sides
across the gap (Lloyd et al. 2004; Steiner 2006). Then each run of intervals may end,
and every one but the first begin, on a slanted plane instead of at a depth: tried are the
horizontal one and the slab of the deepest receiver, kept is the smallest surface.

At last, where a segment is large, the receiver that its far end lies on is cut to the
rectangle, face by face, and so on with the next one, until the end lies on a face.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

MOST_SEGMENTS = 8
"""Of one caster and light."""
SLOPE_UNIT = 512.0
"""Slopes are int16, in units of 1 / 512."""
_MOST_SLOPE = 60.0
_STACK = 1024
_FAR = 1e300
_WORTH_CUTTING = 1000.0
"""[m^2]: surface of a segment from which on its receivers are cut."""
_MOST_CUTS = 32
_MOST_RECEIVERS = 2048
"""And two for each face of the caster: with more, it gets one segment, up to the last one.
Thousands of sheets above each other would take a time that grows with their square."""

# np.int64(0) where a counter goes to a helper: for a literal it would be compiled once more.
_helper = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_helper
def _receivers(blocks, level_start, n_levels, u0, u1, v0, v1, t0, most, stack, found):
    """Write the clusters whose boxes overlap the rectangle and reach behind t0; count them.

    The search ends soon after there are more than `most`.
    """
    n = 0
    stack[0] = level_start[n_levels - 1] * 32 + n_levels - 1
    depth = 1
    while depth > 0 and n <= most:
        depth -= 1
        level = stack[depth] % 32
        block = stack[depth] // 32
        bits = 0
        for k in range(8):
            inside = (
                (blocks[block, 0, k] <= u1)
                & (blocks[block, 1, k] >= u0)
                & (blocks[block, 2, k] <= v1)
                & (blocks[block, 3, k] >= v0)
                & (blocks[block, 4, k] >= t0)
            )
            bits |= np.int64(inside) << k
        if level == 0:
            first = 8 * block
            while bits:
                if bits & 1:
                    found[n] = first
                    n += 1
                bits >>= 1
                first += 1
        else:
            child = level_start[level - 1] + 8 * (block - level_start[level])
            while bits:
                if bits & 1:
                    stack[depth] = child * 32 + level - 1
                    depth += 1
                bits >>= 1
                child += 1
    return n


@_helper
def _last_depth(blocks, level_start, n_levels, u0, u1, v0, v1, t0, stack):
    """Return the depth behind which no box overlaps the rectangle, the deepest first."""
    best = t0
    stack[0] = level_start[n_levels - 1] * 32 + n_levels - 1
    depth = 1
    while depth > 0:
        depth -= 1
        level = stack[depth] % 32
        block = stack[depth] // 32
        child = level_start[level - 1] + 8 * (block - level_start[level]) if level > 0 else 0
        deepest, top = -np.inf, depth
        for k in range(8):
            if (
                (blocks[block, 0, k] > u1)
                | (blocks[block, 1, k] < u0)
                | (blocks[block, 2, k] > v1)
                | (blocks[block, 3, k] < v0)
                | (blocks[block, 4, k] <= best)
            ):
                continue
            if level == 0:
                best = blocks[block, 4, k]
                continue
            stack[depth] = (child + k) * 32 + level - 1
            if blocks[block, 4, k] > deepest:
                deepest, top = blocks[block, 4, k], depth
            depth += 1
        if depth > 0 and level > 0 and deepest > -np.inf:
            stack[top], stack[depth - 1] = stack[depth - 1], stack[top]
    return best


@_helper
def _overlap(blocks, slabs, j, rectangle, parts, row):
    """Write what a trial needs of cluster j to a row: its overlap with the rectangle, box and slab.

    ``u0, u1, v0, v1`` of the overlap, and the slab ``su, sv, lo, hi``, count from the
    rectangle's middle; then the box's least and most depth.
    """
    block, lane = j // 8, j % 8
    mid_u = 0.5 * (rectangle[0] + rectangle[1])
    mid_v = 0.5 * (rectangle[2] + rectangle[3])
    parts[row, 0] = max(rectangle[0], np.float64(blocks[block, 0, lane])) - mid_u
    parts[row, 1] = min(rectangle[1], np.float64(blocks[block, 1, lane])) - mid_u
    parts[row, 2] = max(rectangle[2], np.float64(blocks[block, 2, lane])) - mid_v
    parts[row, 3] = min(rectangle[3], np.float64(blocks[block, 3, lane])) - mid_v
    middle = slabs[j, 0] * mid_u + slabs[j, 1] * mid_v
    parts[row, 4], parts[row, 5] = slabs[j, 0], slabs[j, 1]
    parts[row, 6], parts[row, 7] = slabs[j, 2] + middle, slabs[j, 3] + middle
    parts[row, 8], parts[row, 9] = slabs[j, 4], np.float64(blocks[block, 4, lane])


@_helper
def _spread(parts, row, su, sv):
    """Return the least and most ``t - su u - sv v`` of a receiver within the rectangle.

    Of two bounds, by its slab and by its box, the narrower one holds.
    """
    u0, u1, v0, v1 = parts[row, 0], parts[row, 1], parts[row, 2], parts[row, 3]
    du, dv = parts[row, 4] - su, parts[row, 5] - sv
    low = parts[row, 6] + min(du * u0, du * u1) + min(dv * v0, dv * v1)
    high = parts[row, 7] + max(du * u0, du * u1) + max(dv * v0, dv * v1)
    least = parts[row, 8] - max(su * u0, su * u1) - max(sv * v0, sv * v1)
    most = parts[row, 9] - min(su * u0, su * u1) - min(sv * v0, sv * v1)
    return max(low, least), min(high, most)


@_helper
def _sort(near, far, found, n):
    """Sort the first n intervals by where they begin (Shell 1959: no recursion, no memory)."""
    gap = 1
    while gap < n // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, n):
            a, b, j = near[i], far[i], found[i]
            k = i
            while k >= gap and near[k - gap] > a:
                near[k], far[k], found[k] = near[k - gap], far[k - gap], found[k - gap]
                k -= gap
            near[k], far[k], found[k] = a, b, j
        gap //= 3


@_helper
def _slope(value):
    """Return a slope as it will be stored, int16 in units of 1 / 512, as a float."""
    return math.floor(min(max(value, -_MOST_SLOPE), _MOST_SLOPE) * SLOPE_UNIT + 0.5) / SLOPE_UNIT


@_helper
def _deepest(parts, found, begin, end):
    """Return the slab's slopes of the receiver that lies deepest nearest to the middle.

    Of several, the largest slopes: the outcome depends on no order of receivers.
    """
    best, su, sv = -_FAR, 0.0, 0.0
    for i in range(begin, end):
        row = found[i]
        u = min(max(0.0, parts[row, 0]), parts[row, 1])
        v = min(max(0.0, parts[row, 2]), parts[row, 3])
        tu, tv = parts[row, 4], parts[row, 5]
        at = min(parts[row, 7] + tu * u + tv * v, parts[row, 9])
        if at > best or (at == best and (tu > su or (tu == su and tv > sv))):
            best, su, sv = at, tu, tv
    return su, sv


@_helper
def _cut(polygon, n, other, i, sign, limit):
    """Write the part of a polygon where ``sign * coordinate i <= limit``; return its corners."""
    count = 0
    for k in range(n):
        j = k + 1 if k + 1 < n else 0
        here = limit - sign * polygon[k, i]
        there = limit - sign * polygon[j, i]
        if here >= 0.0:
            for d in range(3):
                other[count, d] = polygon[k, d]
            count += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            share = here / (here - there)
            for d in range(3):
                other[count, d] = polygon[k, d] + share * (polygon[j, d] - polygon[k, d])
            count += 1
    return count


@_helper
def _deepest_of_faces(
    placed, faces, order, cluster_start, cluster, rectangle, su, sv, pad, polygon, other
):
    """Return the most ``t - su u - sv v`` of a cluster's faces, cut to the rectangle.

    u and v count from its middle. `_spread` bounds it from above.
    """
    mid_u = 0.5 * (rectangle[0] + rectangle[1])
    mid_v = 0.5 * (rectangle[2] + rectangle[3])
    half_u, half_v = rectangle[1] - mid_u, rectangle[3] - mid_v
    most = -_FAR
    for f in range(cluster_start[cluster], cluster_start[cluster + 1]):
        beyond, outside = 15, 0
        for k in range(3):
            p = faces[order[f], k]
            u = np.float64(placed[p, 0]) - mid_u
            v = np.float64(placed[p, 1]) - mid_v
            polygon[k, 0], polygon[k, 1], polygon[k, 2] = u, v, np.float64(placed[p, 2])
            side = (u > half_u) | ((u < -half_u) << 1) | ((v > half_v) << 2) | ((v < -half_v) << 3)
            beyond &= side
            outside |= side
        if beyond:
            continue
        n = np.int64(3)
        if outside:
            n = _cut(polygon, n, other, np.int64(0), 1.0, half_u)
            n = _cut(other, n, polygon, np.int64(0), -1.0, half_u)
            n = _cut(polygon, n, other, np.int64(1), 1.0, half_v)
            n = _cut(other, n, polygon, np.int64(1), -1.0, half_v)
        for k in range(n):
            most = max(most, polygon[k, 2] - su * polygon[k, 0] - sv * polygon[k, 1])
    return most + pad * (1.0 + abs(su) + abs(sv))


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def clamp_casters(
    boxes, face_start, placed, faces, order, cluster_start, blocks, slabs, level_start, n_levels,
    horizon, pad, costs, first, last, counts, depths, slopes,
):  # fmt: skip
    """Write the segments of the casters ``first .. last - 1`` of a directional light.

    Parameters
    ----------
    boxes : ndarray
        ``(n_casters, 6) float64`` [m]: of casters in the light's frame.
    face_start : ndarray
        ``(n_casters + 1,) int64``
    placed, faces, order, cluster_start
        Vertices in the light's frame, and the faces of clusters (`kernels.light_boxes`);
        without an order nothing is cut.
    blocks, slabs, level_start, n_levels
        The tree over clusters (`kernels.light_boxes`).
    horizon : ndarray
        ``(2,) float64``: slopes of a horizontal plane, 0 where it would be too steep.
    pad : float
        [m]: what bounds were widened by.
    costs : ndarray
        ``(2,) float64``: of a vertex drawn, and of a square metre of side or cap.
    counts : ndarray
        ``(last - first,) uint32``: segments of each caster, to be written.
    depths, slopes : ndarray
        ``(m, 2) float32`` and ``(m, 2) int16``, m at least ``8 (last - first)``: near and
        far, and slopes along u and v, of all segments one after the other.

    Returns
    -------
    int
        Segments written.

    Notes
    -----
    A caster's segments depend on which clusters it meets, not on their order in the tree.
    """
    stack = np.empty(_STACK, np.int64)
    n_faces = 0
    for c in range(first, last):
        n_faces = max(n_faces, face_start[c + 1] - face_start[c])
    n_most = _MOST_RECEIVERS + 2 * n_faces + 8
    found = np.empty(n_most, np.int64)
    begin = np.empty(n_most, np.float64)
    end = np.empty(n_most, np.float64)
    parts = np.empty((n_most, 10), np.float64)
    cluster = np.empty(n_most, np.int64)
    bound = np.empty(n_most, np.float64)
    is_cut = np.empty(n_most, np.bool_)
    polygon = np.empty((10, 3), np.float64)
    other = np.empty((10, 3), np.float64)
    rectangle = np.empty(4, np.float64)
    n_written = 0
    for c in range(first, last):
        for k in range(4):
            rectangle[k] = boxes[c, k]
        front, back = boxes[c, 4], boxes[c, 5]
        width, height = rectangle[1] - rectangle[0], rectangle[3] - rectangle[2]
        mid_u, mid_v = rectangle[0] + 0.5 * width, rectangle[2] + 0.5 * height
        rim, cap = 2.0 * (width + height), width * height
        u0, u1 = np.float32(rectangle[0]), np.float32(rectangle[1])
        v0, v1 = np.float32(rectangle[2]), np.float32(rectangle[3])
        most = _MOST_RECEIVERS + 2 * (face_start[c + 1] - face_start[c])
        n_found = _receivers(
            blocks, level_start, n_levels, u0, u1, v0, v1, np.float32(front), most, stack, found
        )
        n = np.int64(0)
        if n_found > most:
            n_found = 0
            last_depth = _last_depth(
                blocks, level_start, n_levels, u0, u1, v0, v1, np.float32(front), stack
            )
            back = max(back, np.float64(last_depth))
        for i in range(n_found):
            _overlap(blocks, slabs, found[i], rectangle, parts, n)
            low, high = _spread(parts, n, 0.0, 0.0)
            if high >= front and low <= high:
                cluster[n] = found[i]
                begin[n], end[n], found[n] = low, high, n
                n += 1
        _sort(begin, end, found, n)
        cost_of_split = costs[0] * 6.0 * (face_start[c + 1] - face_start[c])
        n_segments, i, reach = 0, np.int64(0), back
        while True:
            start = i
            while i < n:
                gap = begin[i] - reach
                saved = costs[1] * (rim * gap - 2.0 * cap)
                # What rounding outward would close again is no gap.
                is_gap = gap > 1e-6 * (abs(begin[i]) + abs(reach))
                if is_gap and n_segments < MOST_SEGMENTS - 1 and cost_of_split < saved:
                    break
                reach = max(reach, end[i])
                i += 1
            near, far, slope_u, slope_v = front, reach, 0.0, 0.0
            if n_segments > 0:
                near = begin[start]
            surface = rim * (far - near) + 2.0 * cap
            for trial in range(2 if i > start else 0):
                su, sv = horizon[0], horizon[1]
                if trial == 1:
                    su, sv = _deepest(parts, found, start, i)
                su, sv = _slope(su), _slope(sv)
                low, high = _FAR, -_FAR
                for k in range(start, i):
                    a, b = _spread(parts, found[k], su, sv)
                    low, high = min(low, a), max(high, b)
                slanted = cap * math.sqrt(1.0 + su * su + sv * sv)
                if n_segments == 0:
                    tried = rim * (high - front) + cap + slanted
                else:
                    tried = rim * (high - low) + 2.0 * slanted
                if n_segments > 0:
                    # A near plane that leads past the caster somewhere would shade what is lit.
                    lowest = low - 0.5 * (abs(su) * width + abs(sv) * height)
                    if lowest < back:
                        continue
                if tried < surface:
                    surface, far, slope_u, slope_v = tried, high, su, sv
                    near = front if n_segments == 0 else low
            if i > start and surface > _WORTH_CUTTING and len(order) > 0:
                # Receivers are cut, the deepest one first, until none that is not could be.
                for k in range(start, i):
                    _, bound[k] = _spread(parts, found[k], slope_u, slope_v)
                    is_cut[k] = False
                for _ in range(_MOST_CUTS):
                    at = start
                    for k in range(start + 1, i):
                        if bound[k] > bound[at]:
                            at = k
                    if is_cut[at]:
                        break
                    exact = _deepest_of_faces(
                        placed, faces, order, cluster_start, cluster[found[at]], rectangle,
                        slope_u, slope_v, pad, polygon, other,
                    )  # fmt: skip
                    bound[at] = min(bound[at], exact)
                    is_cut[at] = True
                deepest = bound[start]
                for k in range(start + 1, i):
                    deepest = max(deepest, bound[k])
                far = max(deepest, near)
            shift = slope_u * mid_u + slope_v * mid_v
            if n_segments == 0:
                # Parallel to its end, and nowhere behind the caster's front.
                near = front - 0.5 * (abs(slope_u) * width + abs(slope_v) * height)
            near, far = near - shift, far - shift
            depths[n_written, 0] = near - 1.2e-7 * abs(near)
            depths[n_written, 1] = far + 1.2e-7 * abs(far)
            slopes[n_written, 0] = np.int16(slope_u * SLOPE_UNIT)
            slopes[n_written, 1] = np.int16(slope_v * SLOPE_UNIT)
            n_written += 1
            n_segments += 1
            if i >= n:
                break
            reach = end[i]
        counts[c - first] = n_segments
    return n_written
