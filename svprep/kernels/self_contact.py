"""Does a closed component cross or touch itself? Exact, on grid integers.

Two triangles that share no corner must not meet at all; two that share a
corner or an edge must meet nowhere else. Every sign is exact: a cross product
of grid differences fits int64, and its dot product with a third difference is
summed in two halves of 26 bits.

Functions take points, not tables with the row of one: Numba counts each table's users in and
out of a call, which took half of the time. A triangle is three points, a point three integers.

Plain twin: `svprep.reference.triangles_touch`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Called from kernels of this file only: without wrappers it compiles in half the time.
_helper = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_helper
def _side(a, b, c, x):
    """Sign of ``((b - a) x (c - a)) . (x - a)``, exact."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    dx, dy, dz = x[0] - a[0], x[1] - a[1], x[2] - a[2]
    nx = uy * wz - uz * wy
    ny = uz * wx - ux * wz
    nz = ux * wy - uy * wx
    low = (nx & 0x3FFFFFF) * dx + (ny & 0x3FFFFFF) * dy + (nz & 0x3FFFFFF) * dz
    high = (nx >> 26) * dx + (ny >> 26) * dy + (nz >> 26) * dz + (low >> 26)
    if high != 0:
        return 1 if high > 0 else -1
    return 1 if (low & 0x3FFFFFF) != 0 else 0


@_helper
def _apart_in_plane(i, j, s, t):
    """Whether a line along an edge of triangle `s` strictly parts it from `t`.

    Both lie in one plane and are seen along its dominant axis, so that axes
    i and j remain. `t` may be a segment (two equal corners). Touching is not
    parted.
    """
    for c in range(3):
        a = s[c]
        b = s[(c + 1) % 3]
        inside = s[(c + 2) % 3]
        ux = b[i] - a[i]
        uy = b[j] - a[j]
        if ux == 0 and uy == 0:
            continue
        own = ux * (inside[j] - a[j]) - uy * (inside[i] - a[i])
        least = np.int64(-1)
        most = np.int64(1)
        for k in range(3):
            d = ux * (t[k][j] - a[j]) - uy * (t[k][i] - a[i])
            if k == 0:
                least = d
                most = d
            least = min(least, d)
            most = max(most, d)
        # The line must have all of t strictly on the side where s is not.
        if (own >= 0 and most < 0) or (own <= 0 and least > 0):
            return True
    return False


@_helper
def _meet_in_plane(s, t):
    """Whether triangle `s` and coplanar triangle or segment `t` share a point."""
    a, b, c = s
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx = abs(uy * wz - uz * wy)
    ny = abs(uz * wx - ux * wz)
    nz = abs(ux * wy - uy * wx)
    i = 0
    j = 1
    if nx >= ny and nx >= nz:
        i = 1
        j = 2
    elif ny >= nz:
        i = 2
        j = 0
    return not (_apart_in_plane(i, j, s, t) or _apart_in_plane(i, j, t, s))


@_helper
def _boxes_apart(box, a, other, b):
    """Whether row a of ``box (n, 6)`` (lows, highs) shares no point with row b of `other`."""
    for axis in range(3):
        if box[a, axis] > other[b, axis + 3] or other[b, axis] > box[a, axis + 3]:
            return True
    return False


@_helper
def _edge_meets(a, b, s):
    """Whether the edge from a to b shares a point with triangle `s`, of another plane."""
    first = _side(s[0], s[1], s[2], a)
    last = _side(s[0], s[1], s[2], b)
    if first * last > 0:
        return False
    if first == 0 and last == 0:
        return _meet_in_plane(s, (a, b, b))
    has_left = False
    has_right = False
    for k in range(3):
        turn = _side(a, b, s[k], s[k + 1 if k < 2 else 0])
        has_left |= turn > 0
        has_right |= turn < 0
    return not (has_left and has_right)


@_helper
def _is_folded(s, t):
    """Whether coplanar triangles that share corners 0 and 1 lie on one side of that edge."""
    a, b, c = s
    same = 0.0
    for i in range(3):
        j = i + 1 if i < 2 else 0
        ui = b[i] - a[i]
        uj = b[j] - a[j]
        n = ui * (c[j] - a[j]) - uj * (c[i] - a[i])
        m = ui * (t[2][j] - a[j]) - uj * (t[2][i] - a[i])
        same += np.float64(n) * np.float64(m)
    return same > 0.0


@_helper
def _wedges_meet(s, t, normal):
    """Whether coplanar triangles that share corner 0 alone meet elsewhere, too.

    They do iff their wedges at that corner meet, so iff a ray that bounds one of these lies
    in the other. Seen along the dominant axis of their `normal`.
    """
    axis = 1 if abs(normal[1]) > abs(normal[0]) else 0
    if abs(normal[2]) > abs(normal[axis]):
        axis = 2
    i, j = (axis + 1) % 3, (axis + 2) % 3
    v = s[0]
    for k in range(2):
        wedge, other = (s, t) if k == 0 else (t, s)
        ai, aj = wedge[1][i] - v[i], wedge[1][j] - v[j]
        bi, bj = wedge[2][i] - v[i], wedge[2][j] - v[j]
        turn = 1 if ai * bj - aj * bi > 0 else -1
        for m in range(1, 3):
            xi, xj = other[m][i] - v[i], other[m][j] - v[j]
            if turn * (ai * xj - aj * xi) >= 0 and turn * (xi * bj - xj * bi) >= 0:
                return True
    return False


@_helper
def _swapped(s, a, b):
    """Return three things with those at a and b in each other's place."""
    x, y = s[a], s[b]
    first = y if a == 0 else x if b == 0 else s[0]
    second = y if a == 1 else x if b == 1 else s[1]
    third = y if a == 2 else x if b == 2 else s[2]
    return first, second, third


@_helper
def _shared_first(s, t):
    """Return the corners of two triangles, those that they share first, and how many these are."""
    n = 0
    for a in range(3):
        for b in range(n, 3):
            if s[a] == t[b]:
                s = _swapped(s, a, n)
                t = _swapped(t, b, n)
                n += 1
                break
    return s, t, n


@_helper
def _point(p, i):
    """Return row i of ``p (n, 3)``: a point, or the corners of a face."""
    return p[i, 0], p[i, 1], p[i, 2]


@_helper
def _triangle(p, corners):
    """Return the points of a face."""
    a, b, c = corners
    return _point(p, a), _point(p, b), _point(p, c)


@_helper
def _triangles_touch(s, t, n_shared, is_flat, normal):
    """Whether two triangles meet elsewhere than in the corners they share, which come first.

    `is_flat`: they lie in one plane, of that `normal`.
    """
    if n_shared == 3:
        return True
    if n_shared == 2:
        return is_flat and _is_folded(s, t)
    if n_shared == 1 and is_flat:
        return _wedges_meet(s, t, normal)
    # With one corner shared, only the edges opposite to it tell.
    for k in range(n_shared, 6, 3 if n_shared == 1 else 1):
        triangle, other = (s, t) if k < 3 else (t, s)
        if _edge_meets(triangle[k % 3], triangle[(k + 1) % 3], other):
            return True
    return False


@_helper
def _contact(p, corners, normal, is_small, f, g):
    """Tell where face g meets the plane of face f, corners they share aside.

    0: nowhere; 1: in one corner only, and none is shared; 3: g lies in the plane; 2: else.
    ``corners (n, 3)``: rows of `p`; ``normal (n, 3)``: ``(b - a) x (c - a)``; signs are
    exact as in `_side`. `is_small`: coordinates differ by less than 2**20, and one int64
    holds each product and their sum.
    """
    s0, s1, s2 = corners[f, 0], corners[f, 1], corners[f, 2]
    nx, ny, nz = normal[f, 0], normal[f, 1], normal[f, 2]
    n_shared = 0
    n_above = 0
    n_below = 0
    for c in range(3):
        x = corners[g, c]
        is_shared = (x == s0) | (x == s1) | (x == s2)
        n_shared += is_shared
        dx = p[x, 0] - p[s0, 0]
        dy = p[x, 1] - p[s0, 1]
        dz = p[x, 2] - p[s0, 2]
        low = 0
        if is_small:
            high = nx * dx + ny * dy + nz * dz
        else:
            low = (nx & 0x3FFFFFF) * dx + (ny & 0x3FFFFFF) * dy + (nz & 0x3FFFFFF) * dz
            high = (nx >> 26) * dx + (ny >> 26) * dy + (nz >> 26) * dz + (low >> 26)
            low &= 0x3FFFFFF
        n_below += high < 0
        n_above += (high > 0) | ((high == 0) & (low != 0))
    if n_above + n_below == 0:
        return 3
    if n_above > 0 and n_below > 0:
        return 2
    n_on = 3 - n_shared - n_above - n_below
    return 0 if n_on == 0 else 1 if n_on == 1 and n_shared == 0 else 2


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def touches_itself(points, faces, face_start, candidates, begin, end, touching):
    """Set ``touching[k]`` for each candidate component that meets itself.

    ``points (n_vertices, 3) int64`` grid positions; component i owns faces
    ``[face_start[i], face_start[i + 1])``; `candidates` lists the components to
    look at, of which ``[begin, end)`` are done.

    Faces are bucketed in a median-split tree of bounding boxes, leaves of up to
    eight, and the tree is met with itself: O(n log n) for real surfaces, at most
    some 200 pairs of faces per face. A component that needs more than
    4,000,000 + 512 n pairs (long slivers side by side) is taken to meet itself:
    whoever is in doubt uses the robust volume.
    """
    most = 0
    for k in range(begin, end):
        i = candidates[k]
        most = max(most, face_start[i + 1] - face_start[i])
    index = np.empty(most, np.int64)
    box = np.empty((most, 6), np.int64)
    corners = np.empty((most, 3), np.int64)
    normal = np.empty((most, 3), np.int64)
    node_box = np.empty((most + 1, 6), np.int64)
    node_range = np.empty((most + 1, 2), np.int64)
    node_child = np.empty(most + 1, np.int64)
    stack = np.empty((most + 64, 2), np.int64)
    for k in range(begin, end):
        first_face = face_start[candidates[k]]
        n = face_start[candidates[k] + 1] - first_face
        for i in range(n):
            index[i] = i
            for c in range(3):
                corners[i, c] = faces[first_face + i, c]
            a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
            for axis in range(3):
                box[i, axis] = min(points[a, axis], points[b, axis], points[c, axis])
                box[i, axis + 3] = max(points[a, axis], points[b, axis], points[c, axis])
                y, z = (axis + 1) % 3, (axis + 2) % 3
                uy, wy = points[b, y] - points[a, y], points[c, y] - points[a, y]
                uz, wz = points[b, z] - points[a, z], points[c, z] - points[a, z]
                normal[i, axis] = uy * wz - uz * wy
        # Build: node 0 is the root, children are neighbours.
        node_range[0, 0] = 0
        node_range[0, 1] = n
        n_nodes = 1
        node = 0
        while node < n_nodes:
            lo = node_range[node, 0]
            hi = node_range[node, 1]
            for axis in range(3):
                least = box[index[lo], axis]
                most_high = box[index[lo], axis + 3]
                for i in range(lo + 1, hi):
                    least = min(least, box[index[i], axis])
                    most_high = max(most_high, box[index[i], axis + 3])
                node_box[node, axis] = least
                node_box[node, axis + 3] = most_high
            node_child[node] = -1
            if hi - lo > 8:
                axis = 0
                widest = node_box[node, 3] - node_box[node, 0]
                for d in range(1, 3):
                    if node_box[node, 3 + d] - node_box[node, d] > widest:
                        widest = node_box[node, 3 + d] - node_box[node, d]
                        axis = d
                # Quickselect of the median centre along the widest axis.
                middle = (lo + hi) // 2
                left = lo
                right = hi - 1
                while left < right:
                    m = index[(left + right) // 2]
                    pivot = box[m, axis] + box[m, axis + 3]
                    i = left
                    j = right
                    while i <= j:
                        while box[index[i], axis] + box[index[i], axis + 3] < pivot:
                            i += 1
                        while box[index[j], axis] + box[index[j], axis + 3] > pivot:
                            j -= 1
                        if i <= j:
                            index[i], index[j] = index[j], index[i]
                            i += 1
                            j -= 1
                    if middle <= j:
                        right = j
                    elif middle >= i:
                        left = i
                    else:
                        break
                node_child[node] = n_nodes
                node_range[n_nodes, 0] = lo
                node_range[n_nodes, 1] = middle
                node_range[n_nodes + 1, 0] = middle
                node_range[n_nodes + 1, 1] = hi
                n_nodes += 2
            node += 1
        is_small = True
        for axis in range(3):
            is_small &= node_box[0, axis + 3] - node_box[0, axis] < 0x100000
        # Meet the tree with itself.
        found = False
        pairs_left = 4_000_000 + 512 * n
        stack[0, 0] = 0
        stack[0, 1] = 0
        depth = 1
        while depth > 0 and not found:
            depth -= 1
            a = stack[depth, 0]
            b = stack[depth, 1]
            pairs_left -= 1
            if a != b and _boxes_apart(node_box, a, node_box, b):
                continue
            if node_child[a] < 0 and node_child[b] < 0:
                for i in range(node_range[a, 0], node_range[a, 1]):
                    f = index[i]
                    first = i + 1 if a == b else node_range[b, 0]
                    pairs_left -= node_range[b, 1] - first
                    if a != b and _boxes_apart(box, f, node_box, b):
                        continue
                    for j in range(first, node_range[b, 1]):
                        g = index[j]
                        if _boxes_apart(box, f, box, g):
                            continue
                        contact = _contact(points, corners, normal, is_small, f, g)
                        if contact == 0:
                            continue
                        back = contact
                        if contact != 3:
                            back = _contact(points, corners, normal, is_small, g, f)
                        # Two single corners are two places: one place were a shared corner.
                        if back == 0 or (contact == 1 and back == 1):
                            continue
                        at_s, at_t, n_shared = _shared_first(_point(corners, f), _point(corners, g))
                        s, t = _triangle(points, at_s), _triangle(points, at_t)
                        if _triangles_touch(s, t, n_shared, contact == 3, _point(normal, f)):
                            found = True
                            break
                    if found:
                        break
            elif a == b:
                child = node_child[a]
                stack[depth, 0] = child
                stack[depth, 1] = child
                stack[depth + 1, 0] = child + 1
                stack[depth + 1, 1] = child + 1
                stack[depth + 2, 0] = child
                stack[depth + 2, 1] = child + 1
                depth += 3
            else:
                # Descend into the node with more faces.
                if node_child[b] < 0 or (
                    node_child[a] >= 0
                    and node_range[a, 1] - node_range[a, 0] >= node_range[b, 1] - node_range[b, 0]
                ):
                    a, b = b, a
                child = node_child[b]
                stack[depth, 0] = a
                stack[depth, 1] = child
                stack[depth + 1, 0] = a
                stack[depth + 1, 1] = child + 1
                depth += 2
            if pairs_left < 0:
                found = True
        touching[k] = found
