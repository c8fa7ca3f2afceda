"""Does a closed component cross or touch itself? Exact, on grid integers.

Two triangles that share no corner must not meet at all; two that share a
corner or an edge must meet nowhere else. Every sign is exact: a cross product
of grid differences fits int64, and its dot product with a third difference is
summed in two halves of 26 bits.

Plain twin: `svprep.reference.triangles_touch`.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _side(p, a, b, c, x):
    """Sign of ``((b - a) x (c - a)) . (x - a)`` for rows of `p`, exact."""
    ux = p[b, 0] - p[a, 0]
    uy = p[b, 1] - p[a, 1]
    uz = p[b, 2] - p[a, 2]
    wx = p[c, 0] - p[a, 0]
    wy = p[c, 1] - p[a, 1]
    wz = p[c, 2] - p[a, 2]
    dx = p[x, 0] - p[a, 0]
    dy = p[x, 1] - p[a, 1]
    dz = p[x, 2] - p[a, 2]
    nx = uy * wz - uz * wy
    ny = uz * wx - ux * wz
    nz = ux * wy - uy * wx
    low = (nx & 0x3FFFFFF) * dx + (ny & 0x3FFFFFF) * dy + (nz & 0x3FFFFFF) * dz
    high = (nx >> 26) * dx + (ny >> 26) * dy + (nz >> 26) * dz + (low >> 26)
    if high != 0:
        return 1 if high > 0 else -1
    return 1 if (low & 0x3FFFFFF) != 0 else 0


@njit(cache=True, nogil=True)
def _apart_in_plane(p, i, j, s, t):
    """Whether a line along an edge of triangle ``s`` strictly parts it from ``t``.

    Both lie in one plane and are seen along its dominant axis, so that axes
    i and j remain. `t` may be a segment (two equal corners). Touching is not
    parted.
    """
    for c in range(3):
        a = s[c]
        b = s[(c + 1) % 3]
        inside = s[(c + 2) % 3]
        ux = p[b, i] - p[a, i]
        uy = p[b, j] - p[a, j]
        if ux == 0 and uy == 0:
            continue
        own = ux * (p[inside, j] - p[a, j]) - uy * (p[inside, i] - p[a, i])
        least = np.int64(-1)
        most = np.int64(1)
        for k in range(3):
            d = ux * (p[t[k], j] - p[a, j]) - uy * (p[t[k], i] - p[a, i])
            if k == 0:
                least = d
                most = d
            least = min(least, d)
            most = max(most, d)
        # The line must have all of t strictly on the side where s is not.
        if (own >= 0 and most < 0) or (own <= 0 and least > 0):
            return True
    return False


@njit(cache=True, nogil=True)
def _meet_in_plane(p, s, t):
    """Whether triangle `s` and coplanar triangle or segment `t` share a point."""
    ux = p[s[1], 0] - p[s[0], 0]
    uy = p[s[1], 1] - p[s[0], 1]
    uz = p[s[1], 2] - p[s[0], 2]
    wx = p[s[2], 0] - p[s[0], 0]
    wy = p[s[2], 1] - p[s[0], 1]
    wz = p[s[2], 2] - p[s[0], 2]
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
    return not (_apart_in_plane(p, i, j, s, t) or _apart_in_plane(p, i, j, t, s))


@njit(cache=True, nogil=True)
def _edge_meets(p, s, a, b, t):
    """Whether segment a-b shares a point with triangle `s`. `t` is scratch (3,)."""
    side_a = _side(p, s[0], s[1], s[2], a)
    side_b = _side(p, s[0], s[1], s[2], b)
    if side_a * side_b > 0:
        return False
    if side_a == 0 and side_b == 0:
        t[0] = a
        t[1] = b
        t[2] = b
        return _meet_in_plane(p, s, t)
    first = _side(p, a, b, s[0], s[1])
    second = _side(p, a, b, s[1], s[2])
    third = _side(p, a, b, s[2], s[0])
    return (first >= 0 and second >= 0 and third >= 0) or (
        first <= 0 and second <= 0 and third <= 0
    )


@njit(cache=True, nogil=True)
def _triangles_touch(p, s, t, scratch):
    """Whether two triangles meet elsewhere than in the corners they share.

    Rows `s`, `t` index `p`; they are rotated in place so that shared corners
    come first.
    """
    shared = 0
    for a in range(3):
        for b in range(shared, 3):
            if s[a] == t[b]:
                s[a], s[shared] = s[shared], s[a]
                t[b], t[shared] = t[shared], t[b]
                shared += 1
                break
    if shared == 3:
        return True
    if shared == 2:
        if _side(p, s[0], s[1], s[2], t[2]) != 0:
            return False
        # Coplanar: folded over each other iff both lie on one side of the edge.
        same = 0.0
        ux = p[s[1], 0] - p[s[0], 0]
        uy = p[s[1], 1] - p[s[0], 1]
        uz = p[s[1], 2] - p[s[0], 2]
        ax = p[s[2], 0] - p[s[0], 0]
        ay = p[s[2], 1] - p[s[0], 1]
        az = p[s[2], 2] - p[s[0], 2]
        bx = p[t[2], 0] - p[s[0], 0]
        by = p[t[2], 1] - p[s[0], 1]
        bz = p[t[2], 2] - p[s[0], 2]
        same += np.float64(uy * az - uz * ay) * np.float64(uy * bz - uz * by)
        same += np.float64(uz * ax - ux * az) * np.float64(uz * bx - ux * bz)
        same += np.float64(ux * ay - uy * ax) * np.float64(ux * by - uy * bx)
        return same > 0.0
    if shared == 1:
        return _edge_meets(p, s, t[1], t[2], scratch) or _edge_meets(p, t, s[1], s[2], scratch)
    for c in range(3):
        if _edge_meets(p, s, t[c], t[(c + 1) % 3], scratch):
            return True
        if _edge_meets(p, t, s[c], s[(c + 1) % 3], scratch):
            return True
    return False


@njit(cache=True, nogil=True)
def touches_itself(points, faces, face_start, candidates, begin, end, touching):
    """Set ``touching[k]`` for each candidate component that meets itself.

    ``points (n_vertices, 3) int64`` grid positions; component i owns faces
    ``[face_start[i], face_start[i + 1])``; `candidates` lists the components to
    look at, of which ``[begin, end)`` are done.

    Faces are bucketed in a median-split tree of bounding boxes, leaves of up to
    eight, and the tree is met with itself: O(n log n) for real surfaces.
    """
    most = 0
    for k in range(begin, end):
        i = candidates[k]
        most = max(most, face_start[i + 1] - face_start[i])
    index = np.empty(most, np.int64)
    box = np.empty((most, 6), np.int64)
    node_box = np.empty((most + 1, 6), np.int64)
    node_range = np.empty((most + 1, 2), np.int64)
    node_child = np.empty(most + 1, np.int64)
    stack = np.empty((most + 64, 2), np.int64)
    s = np.empty(3, np.int64)
    t = np.empty(3, np.int64)
    scratch = np.empty(3, np.int64)
    for k in range(begin, end):
        first_face = face_start[candidates[k]]
        n = face_start[candidates[k] + 1] - first_face
        for i in range(n):
            index[i] = i
            for axis in range(3):
                x = points[faces[first_face + i, 0], axis]
                y = points[faces[first_face + i, 1], axis]
                z = points[faces[first_face + i, 2], axis]
                box[i, axis] = min(x, y, z)
                box[i, axis + 3] = max(x, y, z)
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
        # Meet the tree with itself.
        found = False
        stack[0, 0] = 0
        stack[0, 1] = 0
        depth = 1
        while depth > 0 and not found:
            depth -= 1
            a = stack[depth, 0]
            b = stack[depth, 1]
            if a != b:
                apart = False
                for axis in range(3):
                    if (
                        node_box[a, axis] > node_box[b, axis + 3]
                        or node_box[b, axis] > node_box[a, axis + 3]
                    ):
                        apart = True
                        break
                if apart:
                    continue
            if node_child[a] < 0 and node_child[b] < 0:
                for i in range(node_range[a, 0], node_range[a, 1]):
                    f = index[i]
                    for j in range(i + 1 if a == b else node_range[b, 0], node_range[b, 1]):
                        g = index[j]
                        if (
                            box[f, 0] > box[g, 3]
                            or box[g, 0] > box[f, 3]
                            or box[f, 1] > box[g, 4]
                            or box[g, 1] > box[f, 4]
                            or box[f, 2] > box[g, 5]
                            or box[g, 2] > box[f, 5]
                        ):
                            continue
                        for c in range(3):
                            s[c] = faces[first_face + f, c]
                            t[c] = faces[first_face + g, c]
                        if _triangles_touch(points, s, t, scratch):
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
        touching[k] = found
