r"""Continuous clamping for a point light, inside the scene or out of it.

The space around the light is six pyramids, the views of a cube map. In a view whose
axis is m, (u, v) = (a / m, b / m) say which ray a point lies on, and ln m how far along it:
a shadow that grows k times from its caster is ln k farther, on any ray. So a view is a
light frame like the sun's, with a logarithmic depth, and an interval of k is a
difference of two depths (homothety: x -> L + k (x - L)).

         \   m   /        A triangle is cut along the pyramids' sides and bounded in each
          \  |  /         view that it reaches. One that holds the light has no least
           \ | /          depth: its shadow fills its views, and is never clamped there.
      _ _ _ \|/ _ _ _
            /L\
           /   \
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_PIECE = 16
"""Faces of a caster that are bounded together: the nearer and farther ones of a large
caster are clamped apart."""
_STACK = 1024
_KEPT_AT_FIRST = 4096
_INF = np.inf

# np.int64(1) where a counter goes to a helper: for a literal it would be compiled once more.
_helper = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_helper
def _cut(polygon, n, other, i, sign):
    """Write the part of a polygon where ``m >= sign * coordinate i``; return its corners."""
    count = 0
    for k in range(n):
        j = k + 1 if k + 1 < n else 0
        here = polygon[k, 2] - sign * polygon[k, i]
        there = polygon[j, 2] - sign * polygon[j, i]
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


@_helper
def _add_face(positions, corners, f, light, polygon, other, bounds):
    """Widen each view's ``bounds`` (u0, u1, v0, v1, least m, most m) by its part of face f."""
    # Most faces lie in one view: that of each corner's largest coordinate.
    first_view, views = -1, 0
    for k in range(3):
        p = corners[f, k]
        best, view = -1.0, 0
        for d in range(3):
            x = np.float64(positions[p, d]) - np.float64(light[d])
            other[k, d] = x
            if abs(x) > best:
                best, view = abs(x), 2 * d + (x < 0.0)
        views |= 1 << view
        first_view = view
    is_within = views == 1 << first_view
    for view in range(6):
        if is_within and view != first_view:
            continue
        axis, sign = view // 2, 1.0 - 2.0 * (view % 2)
        # Sides that all three corners are beyond: bit 0 to 3.
        beyond = 15
        for k in range(3):
            a, b = other[k, (axis + 1) % 3], other[k, (axis + 2) % 3]
            m = sign * other[k, axis]
            polygon[k, 0], polygon[k, 1], polygon[k, 2] = a, b, m
            beyond &= (a > m) | ((a < -m) << 1) | ((b > m) << 2) | ((b < -m) << 3)
        if beyond:
            continue
        n = np.int64(3)
        if not is_within:
            n = _cut(polygon, n, other[3:], np.int64(0), 1.0)
            n = _cut(other[3:], n, polygon, np.int64(0), -1.0)
            n = _cut(polygon, n, other[3:], np.int64(1), 1.0)
            n = _cut(other[3:], n, polygon, np.int64(1), -1.0)
        for k in range(n):
            m = polygon[k, 2]
            bounds[view, 4], bounds[view, 5] = min(bounds[view, 4], m), max(bounds[view, 5], m)
            if m > 0.0:
                u, v = polygon[k, 0] / m, polygon[k, 1] / m
                bounds[view, 0], bounds[view, 1] = min(bounds[view, 0], u), max(bounds[view, 1], u)
                bounds[view, 2], bounds[view, 3] = min(bounds[view, 2], v), max(bounds[view, 3], v)


@_helper
def _begin(bounds):
    """Empty the bounds of all views."""
    for view in range(6):
        bounds[view, 0], bounds[view, 2], bounds[view, 4] = _INF, _INF, _INF
        bounds[view, 1], bounds[view, 3], bounds[view, 5] = -_INF, -_INF, -_INF


@_helper
def _finish(bounds, view, pad):
    """Widen a view's bounds by `pad` and make depths of m; whether there is anything."""
    least, most = bounds[view, 4], bounds[view, 5]
    if least > most:
        return False
    bounds[view, 5] = math.log(most + pad)
    if least <= 8.0 * pad:
        bounds[view, 0], bounds[view, 1] = -1.0, 1.0
        bounds[view, 2], bounds[view, 3] = -1.0, 1.0
        bounds[view, 4] = -_INF
        return True
    wider = 2.0 * pad / least
    bounds[view, 0] -= wider
    bounds[view, 1] += wider
    bounds[view, 2] -= wider
    bounds[view, 3] += wider
    bounds[view, 4] = math.log(least - pad)
    return True


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def bound_clusters_in_views(
    positions, faces, order, start, light, pad, first, last, blocks, nearest
):
    """Write the boxes of the clusters ``first .. last - 1`` in the six views.

    Parameters
    ----------
    positions : ndarray
        ``(n_vertices, 3) float32`` [m]
    faces, order : ndarray
        ``(n_faces, 3) uint32`` and ``(n,) uint32``: faces in the order of clusters.
    start : ndarray
        ``(n_clusters + 1,) int64``
    light : ndarray
        ``(4,) float32``: where it is, in the cache frame.
    pad : float
        [m]: bounds are widened by it.
    blocks : ndarray
        ``(6, n_blocks, 5, 8) float32``: level 0 is written, as in `kernels.light_boxes`;
        views are +x, -x, +y, -y, +z, -z. A cluster that does not reach a view has an
        empty box there.
    nearest : ndarray
        ``(6, n_clusters) float32``: ln m of the nearest point.
    """
    polygon = np.empty((10, 3), np.float64)
    other = np.empty((13, 3), np.float64)
    bounds = np.empty((6, 6), np.float64)
    for i in range(first, last):
        _begin(bounds)
        for f in range(start[i], start[i + 1]):
            _add_face(positions, faces, np.int64(order[f]), light, polygon, other, bounds)
        for view in range(6):
            _finish(bounds, view, pad)
            for r in range(4):
                blocks[view, i // 8, r, i % 8] = bounds[view, r]
            blocks[view, i // 8, 4, i % 8] = bounds[view, 5]
            nearest[view, i] = bounds[view, 4]


@_helper
def _sort(near, far, n):
    """Sort the first n intervals by where they begin (Shell 1959)."""
    gap = 1
    while gap < n // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, n):
            a, b = near[i], far[i]
            k = i
            while k >= gap and near[k - gap] > a:
                near[k], far[k] = near[k - gap], far[k - gap]
                k -= gap
            near[k], far[k] = a, b
        gap //= 3


@_helper
def _merge(near, far, n):
    """Sort intervals and join those that meet; count them."""
    _sort(near, far, n)
    kept = 0
    for i in range(1, n):
        if near[i] <= far[kept]:
            far[kept] = max(far[kept], far[i])
        else:
            kept += 1
            near[kept], far[kept] = near[i], far[i]
    return kept + 1


@_helper
def _add_receivers(blocks, nearest, level_start, n_levels, bounds, stack, near, far, n):
    """Add the intervals of ln k of a piece's receivers in one view.

    Returns all of them, ``near, far``, and how many: the arrays grow where they must.
    Interval 0 begins at the caster. What it holds already is passed over, whole branches
    at once, and what touches it only makes it longer. So the union of all depends on no
    order of receivers.
    """
    u0, u1 = np.float32(bounds[0]), np.float32(bounds[1])
    v0, v1 = np.float32(bounds[2]), np.float32(bounds[3])
    stack[0] = level_start[n_levels - 1] * 32 + n_levels - 1
    depth = 1
    while depth > 0:
        depth -= 1
        level = stack[depth] % 32
        block = stack[depth] // 32
        t0 = np.float32(bounds[4] + far[0] - 2e-6)  # all such lie within interval 0
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
        for k in range(8):
            if not (bits >> k) & 1:
                continue
            if level > 0:
                child = level_start[level - 1] + 8 * (block - level_start[level]) + k
                stack[depth] = child * 32 + level - 1
                depth += 1
                continue
            # Of pieces and clusters that hold the light, -inf: then from 1, or without end.
            low = np.float64(nearest[8 * block + k]) - bounds[5] - 1e-6
            high = np.float64(blocks[block, 4, k]) - bounds[4] + 1e-6
            if low <= far[0]:
                far[0] = max(far[0], high)
                continue
            if n == len(near):
                n = _merge(near, far, n)
                if 2 * n > len(near):
                    near = np.concatenate((near, np.empty_like(near)))
                    far = np.concatenate((far, np.empty_like(far)))
            near[n], far[n] = low, high
            n += 1
    return near, far, n


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def clamp_casters_in_views(
    positions, corners, face_start, light, blocks, nearest, level_start, n_levels, pad, costs,
    first, last, counts, depths, slopes,
):  # fmt: skip
    """Write the segments of the casters ``first .. last - 1`` of a point light.

    Parameters
    ----------
    positions, light, pad
        As in `bound_clusters_in_views`.
    corners : ndarray
        ``(n_faces, 3) uint32``: of faces in the mesh's own order.
    face_start : ndarray
        ``(n_casters + 1,) int64``
    blocks, nearest, level_start, n_levels
        The tree over clusters in each view, its levels raised.
    costs : ndarray
        ``(2,) float64``: of a vertex drawn, and of a square metre of side or cap.
    counts, depths, slopes
        As in `kernels.clamping.clamp_casters`; depths are k, slopes 0. A caster counts
        as its bounding sphere.

    Returns
    -------
    int
        Segments written.
    """
    polygon = np.empty((10, 3), np.float64)
    other = np.empty((13, 3), np.float64)
    bounds = np.empty((6, 6), np.float64)
    low = np.empty(3, np.float64)
    high = np.empty(3, np.float64)
    near = np.empty(_KEPT_AT_FIRST, np.float64)
    far = np.empty(_KEPT_AT_FIRST, np.float64)
    stack = np.empty(_STACK, np.int64)
    n_written = 0
    for c in range(first, last):
        begin, end = face_start[c], face_start[c + 1]
        for d in range(3):
            low[d], high[d] = _INF, -_INF
            for f in range(begin, end):
                for k in range(3):
                    x = np.float64(positions[corners[f, k], d]) - np.float64(light[d])
                    low[d], high[d] = min(low[d], x), max(high[d], x)
        distance2, radius2 = 0.0, 0.0
        for d in range(3):
            distance2 += (0.5 * (low[d] + high[d])) ** 2
            radius2 += (0.5 * (high[d] - low[d])) ** 2
        radius = math.sqrt(radius2) + pad
        distance = max(math.sqrt(distance2), radius)
        # The first interval: the caster itself.
        near[0], far[0] = 0.0, 0.0
        n = np.int64(1)
        for piece in range(begin, end, _PIECE):
            _begin(bounds)
            for f in range(piece, min(piece + _PIECE, end)):
                _add_face(positions, corners, f, light, polygon, other, bounds)
            for view in range(6):
                if _finish(bounds, view, pad):
                    near, far, n = _add_receivers(
                        blocks[view], nearest[view], level_start, n_levels, bounds[view], stack,
                        near, far, n,
                    )  # fmt: skip
        n = _merge(near, far, n)
        disc = math.pi * radius * radius
        band = math.pi * radius * distance
        # Of the gaps with V < R, the two stay that save most. Shadows grow with k, and so does
        # what any gap saves: without a bound nearly all would stay, and take too much memory.
        most, second = 0.0, 0.0
        split, other_split = n, n
        for i in range(1, n if distance > radius else 1):
            k0, k1 = math.exp(far[i - 1]), math.exp(near[i])
            saved = band * (k1 * k1 - k0 * k0) - disc * (k1 * k1 + k0 * k0)
            # What rounding outward would close again is no gap.
            if costs[0] * 6.0 * (end - begin) >= costs[1] * saved or k1 <= k0 * (1.0 + 1e-6):
                continue
            if saved > most:
                second, other_split = most, split
                most, split = saved, i
            elif saved > second:
                second, other_split = saved, i
        n_segments, i = 0, 0
        while i < n:
            start = i
            i += 1
            while i < n and i != split and i != other_split:
                i += 1
            k0, k1 = math.exp(near[start]), math.exp(far[i - 1])
            depths[n_written, 0] = k0 - 2e-7 * k0
            depths[n_written, 1] = k1 + 2e-7 * k1
            slopes[n_written, 0] = 0
            slopes[n_written, 1] = 0
            n_written += 1
            n_segments += 1
        counts[c - first] = n_segments
    return n_written
