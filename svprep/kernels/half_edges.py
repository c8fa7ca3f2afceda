"""Half-edges: grouped by undirected edge, paired, and written as edge records.

Half-edge ``h = 3 f + c`` runs from corner c of face f to corner (c + 1) % 3.
"lo" and "hi" are the lower and the higher vertex index of its edge; a face is
*forward* at the edge if it traverses lo -> hi, counting its flip if it has one.

Plain twins: `svprep.reference.group_edges`, `svprep.reference.pair_edges`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_TIE_RAD = 1e-12  # angles closer than this are one direction; see pair_half_edges


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def group_half_edges(faces, face_start, vertex_begin, vertex_end, begin, end, order, is_first):
    """Sort half-edges by (object, lo, hi, h) and mark where each edge begins.

    ``faces (n_faces, 3) uint32``; object i owns faces
    ``[face_start[i], face_start[i + 1])`` and vertices
    ``[vertex_begin[i], vertex_end[i])``; objects ``[begin, end)`` are done.
    ``order (3 n_faces,) int32``, ``is_first (3 n_faces,) bool``.

    Two stable counting sorts, by hi and then by lo: O(faces + vertices).
    """
    most_half_edges = 0
    most_vertices = 0
    for i in range(begin, end):
        most_half_edges = max(most_half_edges, 3 * (face_start[i + 1] - face_start[i]))
        most_vertices = max(most_vertices, vertex_end[i] - vertex_begin[i])
    by_hi = np.empty(most_half_edges, np.int32)
    lo_of = np.empty(most_half_edges, np.int32)
    hi_of = np.empty(most_half_edges, np.int32)
    hi_count = np.empty(most_vertices + 1, np.int32)
    lo_count = np.empty(most_vertices + 1, np.int32)
    for i in range(begin, end):
        first_half_edge = 3 * face_start[i]
        n = 3 * face_start[i + 1] - first_half_edge
        v0 = vertex_begin[i]
        n_vertices = vertex_end[i] - v0
        for v in range(n_vertices + 1):
            hi_count[v] = 0
            lo_count[v] = 0
        k = 0
        for f in range(face_start[i], face_start[i + 1]):
            for c in range(3):
                a = np.int32(faces[f, c] - v0)
                b = np.int32(faces[f, c + 1 if c < 2 else 0] - v0)
                lo = min(a, b)
                hi = max(a, b)
                lo_of[k] = lo
                hi_of[k] = hi
                lo_count[lo + 1] += 1
                hi_count[hi + 1] += 1
                k += 1
        for v in range(n_vertices):
            lo_count[v + 1] += lo_count[v]
            hi_count[v + 1] += hi_count[v]
        for k in range(n):
            hi = hi_of[k]
            by_hi[hi_count[hi]] = k
            hi_count[hi] += 1
        for j in range(n):
            k = by_hi[j]
            lo = lo_of[k]
            order[first_half_edge + lo_count[lo]] = first_half_edge + k
            lo_count[lo] += 1
        previous_lo = -1
        previous_hi = -1
        for j in range(first_half_edge, first_half_edge + n):
            k = order[j] - first_half_edge
            is_first[j] = lo_of[k] != previous_lo or hi_of[k] != previous_hi
            previous_lo = lo_of[k]
            previous_hi = hi_of[k]


# Called from kernels of this file only: without wrappers it compiles in half the time.
# np.int64(0) where a counter goes to a helper: for a literal it would be compiled once more.
_helper = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_helper
def _lies_before(grid_positions, a, b):
    """Whether vertex a comes before vertex b by position: x, then y, then z."""
    for axis in range(3):
        if grid_positions[a, axis] != grid_positions[b, axis]:
            return grid_positions[a, axis] < grid_positions[b, axis]
    return False


@_helper
def _comes_before(i, j, key, opens, third, half_edge):
    """Order around an edge: key, closers before openers, third vertex, half-edge."""
    if key[i] != key[j]:
        return key[i] < key[j]
    if opens[i] != opens[j]:
        return not opens[i]
    for axis in range(3):
        if third[i, axis] != third[j, axis]:
            return third[i, axis] < third[j, axis]
    return half_edge[i] < half_edge[j]


@_helper
def _merge_sort(index, scratch, n, key, opens, third, half_edge):
    """Sort ``index[:n]`` by `_comes_before`, bottom up, O(n log n)."""
    width = 1
    while width < n:
        for left in range(0, n, 2 * width):
            middle = min(left + width, n)
            right = min(left + 2 * width, n)
            i = left
            j = middle
            for out in range(left, right):
                if i < middle and (
                    j >= right
                    or not _comes_before(index[j], index[i], key, opens, third, half_edge)
                ):
                    scratch[out] = index[i]
                    i += 1
                else:
                    scratch[out] = index[j]
                    j += 1
        for out in range(n):
            index[out] = scratch[out]
        width *= 2


@_helper
def _match_round(around, n, key, opens, half_edge, mate, kept, stack):
    """Match openers with closers among ``around[:n]``, sorted round an edge.

    Like parentheses on a circle. Where one kind is in excess, faces inside the
    material of others are left out first, so that an inner wall, whichever way
    it is wound, does not take the place of an outer one:

        ( ) )  a run of openers, then of closers: the first closers are inner
        ( ( )  the last openers are inner

    Unless the outer two are one direction (a sheet drawn from both sides): then
    nothing lies between them, and one of those is left out first.
    ``key (n,)`` numbers directions.
    `kept` and `stack` are scratch (n,).
    """
    n_open = 0
    start = -1
    for j in range(n):
        if opens[around[j]]:
            n_open += 1
            if start < 0 and not opens[around[j - 1 if j > 0 else n - 1]]:
                start = j
    if start < 0:  # all of one kind
        return
    excess = 2 * n_open - n
    n_kept = 0
    j = 0
    while j < n:
        q = 0
        while j + q < n and opens[around[(start + j + q) % n]]:
            q += 1
        r = 0
        while j + q + r < n and not opens[around[(start + j + q + r) % n]]:
            r += 1
        inner_openers = max(0, min(excess, q - r))
        inner_closers = max(0, min(-excess, r - q))
        excess += inner_closers - inner_openers
        one_direction = key[around[(start + j) % n]] == key[around[(start + j + q + r - 1) % n]]
        outer_opener = 1 if one_direction and inner_openers > 0 else 0
        outer_closer = 1 if one_direction and inner_closers > 0 else 0
        for t in range(outer_opener, q + r - outer_closer):
            if t < q - inner_openers + outer_opener or t >= q + inner_closers - outer_closer:
                kept[n_kept] = around[(start + j + t) % n]
                n_kept += 1
        j += q + r
    depth = 0
    for j in range(2 * n_kept):
        i = kept[j if j < n_kept else j - n_kept]
        if mate[half_edge[i]] >= 0:
            continue
        if opens[i]:
            if j < n_kept:
                stack[depth] = i
                depth += 1
        elif depth > 0:
            depth -= 1
            opener = stack[depth]
            mate[half_edge[i]] = half_edge[opener]
            mate[half_edge[opener]] = half_edge[i]


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def pair_half_edges(
    grid_positions, faces, flips, is_loose, order, edge_start, begin, end, most, mate
):
    """Pair the half-edges of edges ``[begin, end)``; ``mate[h]`` or -1 if single.

    Two faces: a pair iff they wind consistently. More: sorted by angle around
    the edge and matched like parentheses, so that each pair bounds a wedge of
    material and touching solids keep their own pairs (Steiner 2006, A.2).
    *Loose* faces hang on a border somewhere and can close nothing, so the
    others are matched first, and what is left after that.

    Here an edge runs from the end that comes first by position (its tail) to the
    other (its head), and a face is forward that traverses it so: repair numbers
    vertices anew once faces are paired, and must find the same pairs again. Seen
    from tail to head, the outward normal of a forward face points
    counter-clockwise, so its material lies clockwise of it: going round
    counter-clockwise, a backward face opens a wedge and a forward face closes
    it. At equal angles closers go first: there one solid ends and the next
    begins. Angles come from face normals, which are exact, and start at the
    face whose third vertex comes first by position, so that nothing depends on
    numbering; directions closer than 1e-12 rad count as equal (distinct grid
    directions that occur in practice lie far apart, and every pairing is
    right: it only decides which faces form a component).

    ``grid_positions (n_vertices, 3) int32``; ``flips (n_faces,) bool``;
    ``is_loose (n_faces,) bool``; edge e owns
    ``order[edge_start[e]:edge_start[e + 1]]``; no edge has more than `most`
    half-edges; ``mate (3 n_faces,) int32``.
    """
    n_turns = min(most, 2)  # always 2 where it counts; a constant would compile twice the code
    key = np.empty(most, np.float64)
    opens = np.empty(most, np.bool_)
    third = np.empty((most, 3), np.float64)  # grid integers; of the type of `normal`
    half_edge = np.empty(most, np.int32)
    index = np.empty(most, np.int64)
    around = np.empty(most, np.int64)
    scratch = np.empty(most, np.int64)
    stack = np.empty(most, np.int64)
    normal = np.empty((most, 3), np.float64)
    u = np.empty(3, np.float64)
    w = np.empty(3, np.float64)
    for e in range(begin, end):
        start = edge_start[e]
        k = edge_start[e + 1] - start
        for i in range(k):
            mate[order[start + i]] = -1
        if k == 1:
            continue
        f = order[start] // 3
        c = order[start] - 3 * f
        tail = faces[f, c]
        head = faces[f, c + 1 if c < 2 else 0]
        if k > 2 and _lies_before(grid_positions, head, tail):
            tail, head = head, tail
        for i in range(k):
            h = order[start + i]
            f = h // 3
            opens[i] = (faces[f, h - 3 * f] == tail) == flips[f]
            half_edge[i] = h
        if k == 2:
            if opens[0] != opens[1]:
                mate[half_edge[0]] = half_edge[1]
                mate[half_edge[1]] = half_edge[0]
            continue
        length = 0.0
        for axis in range(3):
            u[axis] = np.float64(grid_positions[head, axis]) - np.float64(
                grid_positions[tail, axis]
            )
            length += u[axis] * u[axis]
        length = math.sqrt(length)
        first = np.int64(0)
        for i in range(k):
            h = half_edge[i]
            apex = faces[h // 3, (h % 3 + 2) % 3]
            for axis in range(3):
                third[i, axis] = grid_positions[apex, axis]
                w[axis] = third[i, axis] - np.float64(grid_positions[tail, axis])
            normal[i, 0] = u[1] * w[2] - u[2] * w[1]
            normal[i, 1] = u[2] * w[0] - u[0] * w[2]
            normal[i, 2] = u[0] * w[1] - u[1] * w[0]
            index[i] = i
            key[i] = 0.0
            if _comes_before(i, first, key, opens, third, half_edge):
                first = i
        p = normal[first]
        for i in range(k):
            q = normal[i]
            cosine = p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
            sine = (
                u[0] * (p[1] * q[2] - p[2] * q[1])
                + u[1] * (p[2] * q[0] - p[0] * q[2])
                + u[2] * (p[0] * q[1] - p[1] * q[0])
            ) / length
            angle = math.atan2(sine, cosine)
            if angle < -_TIE_RAD:
                angle += 2.0 * math.pi
            key[i] = 0.0 if angle < _TIE_RAD or angle > 2.0 * math.pi - _TIE_RAD else angle
        for turn in range(n_turns):
            _merge_sort(index, scratch, k, key, opens, third, half_edge)
            if turn == 0:  # number the directions, then sort within each
                direction = 0.0
                previous = key[index[0]]
                for j in range(k):
                    angle = key[index[j]]
                    if angle - previous > _TIE_RAD:
                        direction += 1.0
                    previous = angle
                    key[index[j]] = direction
        for turn in range(n_turns):
            n = np.int64(0)
            for j in range(k):
                h = half_edge[index[j]]
                if mate[h] < 0 and (turn == 1 or not is_loose[h // 3]):
                    around[n] = index[j]
                    n += 1
            _match_round(around, n, key, opens, half_edge, mate, scratch, stack)


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def rebuild_faces(faces, is_flipped, mate, order, rebuilt, rebuilt_mate, old_vertex):
    """Write the faces of `order` anew, turned if flipped, with vertices numbered by first use.

    A turned face (a, b, c) is (a, c, b): its corners 1 and 2 change places, its sides
    0 and 2.

    Parameters
    ----------
    faces : ndarray
        ``(n_faces, 3) uint32``
    is_flipped : ndarray
        ``(n_faces,) bool``
    mate : ndarray
        ``(3 n_faces,) int32``: -1, or a half-edge of another face of `order`.
    order : ndarray
        ``(n,) int32``: different faces.
    rebuilt : ndarray
        ``(n, 3) uint32``, written.
    rebuilt_mate : ndarray
        ``(3 n,) int32``, written: `mate` in the new numbers.
    old_vertex : ndarray
        ``(n_vertices,) uint32``, written from the front: the old number of each vertex.

    Returns
    -------
    int
        How many vertices these faces use.
    """
    new_face = np.empty(len(faces), np.int32)
    for i in range(len(order)):
        new_face[order[i]] = i
    new_vertex = np.empty(len(old_vertex), np.uint32)  # np.full takes longer to compile
    for v in range(len(old_vertex)):
        new_vertex[v] = 0xFFFFFFFF
    n_vertices = 0
    for i in range(len(order)):
        f = order[i]
        turn = is_flipped[f]
        for c in range(3):
            v = faces[f, 3 - c if turn and c > 0 else c]
            if new_vertex[v] == 0xFFFFFFFF:
                new_vertex[v] = n_vertices
                old_vertex[n_vertices] = v
                n_vertices += 1
            rebuilt[i, c] = new_vertex[v]
            other = mate[3 * f + (2 - c if turn else c)]
            if other >= 0:
                g = other // 3
                side = other - 3 * g
                other = 3 * new_face[g] + (2 - side if is_flipped[g] else side)
            rebuilt_mate[3 * i + c] = other
    return n_vertices


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def write_edge_rows(
    faces, order, edge_start, mate, component_of_face, next_row, plane_of_face, rows, flags
):
    """Write the records of every edge: those with a left face first, by face.

    Half-edges come in the order of faces, so records do too and nothing needs
    sorting. ``rows (n_rows, 4) uint32``, ``flags (n_rows,) uint8``: kind in
    bits 0-1 (pair 0, border 1, split 2), planar in bit 2. ``component_of_face
    (n_faces,) int32``; ``next_row (n_components,) int64``: where each component's
    records begin; counted on as they are written.
    """
    for e in range(len(edge_start) - 1):
        start = edge_start[e]
        end = edge_start[e + 1]
        for forward in (True, False):
            for j in range(start, end):
                h = order[j]
                f = h // 3
                c = h - 3 * f
                a = faces[f, c]
                b = faces[f, c + 1 if c < 2 else 0]
                other = mate[h]
                if (a < b) != forward or (not forward and other >= 0):
                    continue
                row = next_row[component_of_face[f]]
                next_row[component_of_face[f]] = row + 1
                rows[row, 0] = min(a, b)
                rows[row, 1] = max(a, b)
                rows[row, 2] = f if forward else 0xFFFFFFFF
                rows[row, 3] = 0xFFFFFFFF if forward else f
                kind = 2 if end - start > 2 else 1
                if forward and other >= 0:
                    rows[row, 3] = other // 3
                    if end - start == 2:
                        kind = 0
                    if plane_of_face[f] == plane_of_face[other // 3]:
                        kind |= 4
                flags[row] = kind
