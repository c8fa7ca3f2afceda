"""Equal rows of integers by hashing, group by group.

Open addressing with linear probing; a group's table holds at least twice its
rows. Welding asks for equal grid positions, repair for equal triangles.
Plain twin: `svprep.reference.first_equal_row`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def first_equal_row(rows, group_start, group_begin, group_end, first):
    """Write to ``first[i]`` the lowest row of i's group that equals row i.

    ``rows (n, 3) int32``; group g owns ``[group_start[g], group_start[g + 1])``;
    groups ``[group_begin, group_end)`` are done, so that ranges of groups can
    run on several threads. ``first (n,) int32``. O(n) expected.
    """
    largest = 0
    for g in range(group_begin, group_end):
        largest = max(largest, group_start[g + 1] - group_start[g])
    capacity = 2
    while capacity < 2 * largest:
        capacity *= 2
    table = np.empty(capacity, np.int32)
    for g in range(group_begin, group_end):
        begin = group_start[g]
        end = group_start[g + 1]
        size = 2
        while size < 2 * (end - begin):
            size *= 2
        mask = np.uint64(size - 1)
        for slot in range(size):
            table[slot] = -1
        for i in range(begin, end):
            x = rows[i, 0]
            y = rows[i, 1]
            z = rows[i, 2]
            h = np.uint64(x) * np.uint64(0x9E3779B97F4A7C15)
            h = (h ^ (h >> np.uint64(32)) ^ np.uint64(y)) * np.uint64(0xC2B2AE3D27D4EB4F)
            h = (h ^ (h >> np.uint64(32)) ^ np.uint64(z)) * np.uint64(0x165667B19E3779F9)
            slot = np.int64((h >> np.uint64(31)) & mask)
            while True:
                j = table[slot]
                if j < 0:
                    table[slot] = i
                    first[i] = i
                    break
                if rows[j, 0] == x and rows[j, 1] == y and rows[j, 2] == z:
                    first[i] = j
                    break
                slot = (slot + 1) & np.int64(mask)


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def weld_corners(points, faces, face_start, has_area, welded, places, starts, n_used):
    """Number the places of each group's corners in the order of their use, flat faces left out.

    Parameters
    ----------
    points : ndarray
        ``(n_points, 3) int32``: grid positions.
    faces : ndarray
        ``(n_faces, 3) uint32``: rows of `points`.
    face_start : ndarray
        ``(n_groups + 1,) int64``: faces of each group. Groups share no number.
    has_area : ndarray
        ``(n_faces,) bool``, written: false where the corners lie on a line. Such faces have
        no part in anything else.
    welded : ndarray
        ``(n_faces, 3) uint32``, written from the front: the other faces, rows of `places`.
    places : ndarray
        ``(3 n_faces, 3) int32`` or as many as needed, written from the front.
    starts : ndarray
        ``(n_groups + 1, 2) int64``, written: where each group's `welded` and `places` begin.
    n_used : ndarray
        ``(n_groups,) int64``, written: how many rows of `points` its faces use.

    O(n_points + n_faces) expected, by hashing. Plain twin: `reference.weld`.
    """
    largest = 0
    for g in range(len(face_start) - 1):
        largest = max(largest, 3 * (face_start[g + 1] - face_start[g]))
    capacity = 2
    while capacity < 2 * min(largest, len(points)):
        capacity *= 2
    table = np.empty(capacity, np.uint32)
    last_group = np.empty(len(points), np.int32)
    number = np.empty(len(points), np.uint32)
    last_group[:] = -1
    n_kept = 0
    n_places = 0
    for g in range(len(face_start) - 1):
        starts[g, 0] = n_kept
        starts[g, 1] = n_places
        n_used[g] = 0
        size = 2
        while size < 2 * min(3 * (face_start[g + 1] - face_start[g]), len(points)):
            size *= 2
        for slot in range(size):
            table[slot] = 0xFFFFFFFF
        for f in range(face_start[g], face_start[g + 1]):
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            ux = np.int64(points[b, 0]) - np.int64(points[a, 0])
            uy = np.int64(points[b, 1]) - np.int64(points[a, 1])
            uz = np.int64(points[b, 2]) - np.int64(points[a, 2])
            wx = np.int64(points[c, 0]) - np.int64(points[a, 0])
            wy = np.int64(points[c, 1]) - np.int64(points[a, 1])
            wz = np.int64(points[c, 2]) - np.int64(points[a, 2])
            has_area[f] = uy * wz != uz * wy or uz * wx != ux * wz or ux * wy != uy * wx
            if not has_area[f]:
                continue
            for corner in range(3):
                v = faces[f, corner]
                if last_group[v] != g:
                    last_group[v] = g
                    n_used[g] += 1
                    x = points[v, 0]
                    y = points[v, 1]
                    z = points[v, 2]
                    h = np.uint64(x) * np.uint64(0x9E3779B97F4A7C15)
                    h = (h ^ (h >> np.uint64(32)) ^ np.uint64(y)) * np.uint64(0xC2B2AE3D27D4EB4F)
                    h = (h ^ (h >> np.uint64(32)) ^ np.uint64(z)) * np.uint64(0x165667B19E3779F9)
                    slot = np.int64((h >> np.uint64(31)) & np.uint64(size - 1))
                    while True:
                        j = table[slot]
                        if j == 0xFFFFFFFF:
                            places[n_places, 0] = x
                            places[n_places, 1] = y
                            places[n_places, 2] = z
                            table[slot] = n_places
                            number[v] = n_places
                            n_places += 1
                            break
                        if places[j, 0] == x and places[j, 1] == y and places[j, 2] == z:
                            number[v] = j
                            break
                        slot = (slot + 1) & (size - 1)
                welded[n_kept, corner] = number[v]
            n_kept += 1
    starts[len(face_start) - 1, 0] = n_kept
    starts[len(face_start) - 1, 1] = n_places


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def count_distinct_per_group(values, group_start, n_values, counts):
    """Write to ``counts[g]`` how many different values group g holds.

    ``values (n,) uint32``, each below `n_values`. O(n + n_values).
    """
    stamp = np.empty(n_values, np.int32)
    for v in range(n_values):
        stamp[v] = -1
    for g in range(len(group_start) - 1):
        n = 0
        for i in range(group_start[g], group_start[g + 1]):
            v = values[i]
            if stamp[v] != g:
                stamp[v] = g
                n += 1
        counts[g] = n


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def counting_order(keys, n_keys, order, key_start):
    """Write the stable order that sorts `keys`, and where each key's run begins.

    ``keys (n,) int32`` in ``[0, n_keys)``; ``order (n,) int32``;
    ``key_start (n_keys + 1,) int64``. O(n + n_keys), stable.
    """
    for k in range(n_keys + 1):
        key_start[k] = 0
    for i in range(len(keys)):
        key_start[keys[i] + 1] += 1
    for k in range(n_keys):
        key_start[k + 1] += key_start[k]
    for i in range(len(keys)):
        k = keys[i]
        order[key_start[k]] = i
        key_start[k] += 1
    for k in range(n_keys, 0, -1):
        key_start[k] = key_start[k - 1]
    key_start[0] = 0


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def pull_onto_leaders(points, group_start, tolerance, target):
    """Write to ``target[i]`` the point that point i moves onto, itself if it stays.

    In order, within each group: a point moves onto the first point that stays
    within `tolerance` of it, else it stays. So points that stay are farther
    apart than the tolerance, and no move chains.

    ``points (n, 3) int32``; group g owns ``[group_start[g], group_start[g + 1])``;
    ``target (n,) int32``. O(n): points that stay are kept in cells of the
    tolerance's size, of which the 27 around a point hold a bounded number.
    """
    largest = 0
    for g in range(len(group_start) - 1):
        largest = max(largest, group_start[g + 1] - group_start[g])
    capacity = 2
    while capacity < 2 * largest:
        capacity *= 2
    head = np.empty(capacity, np.int32)
    behind = np.empty(len(points), np.int32)
    cells = np.empty((len(points), 3), np.int64)
    size = max(tolerance, 1.0)
    for g in range(len(group_start) - 1):
        begin = group_start[g]
        end = group_start[g + 1]
        used = 2
        while used < 2 * (end - begin):
            used *= 2
        for slot in range(used):
            head[slot] = -1
        for i in range(begin, end):
            for axis in range(3):
                cells[i, axis] = np.int64(math.floor(points[i, axis] / size))
            best = i
            for around in range(28):  # the 27 cells, and last its own again, to stay in
                x = cells[i, 0]
                y = cells[i, 1]
                z = cells[i, 2]
                if around < 27:
                    x += around % 3 - 1
                    y += (around // 3) % 3 - 1
                    z += around // 9 - 1
                elif best != i:
                    break
                h = np.uint64(x) * np.uint64(0x9E3779B97F4A7C15)
                h = (h ^ (h >> np.uint64(32)) ^ np.uint64(y)) * np.uint64(0xC2B2AE3D27D4EB4F)
                h = (h ^ (h >> np.uint64(32)) ^ np.uint64(z)) * np.uint64(0x165667B19E3779F9)
                slot = np.int64((h >> np.uint64(31)) & np.uint64(used - 1))
                while head[slot] >= 0:
                    j = head[slot]
                    if cells[j, 0] == x and cells[j, 1] == y and cells[j, 2] == z:
                        break
                    slot = (slot + 1) & (used - 1)
                j = head[slot]
                if around == 27:
                    behind[i] = j
                    head[slot] = i
                    break
                while j >= 0:
                    dx = np.float64(points[i, 0]) - np.float64(points[j, 0])
                    dy = np.float64(points[i, 1]) - np.float64(points[j, 1])
                    dz = np.float64(points[i, 2]) - np.float64(points[j, 2])
                    if j < best and dx * dx + dy * dy + dz * dz <= tolerance * tolerance:
                        best = j
                    j = behind[j]
            target[i] = best
