"""Silhouettes by walking over faces: the edge buffer, and edge elimination.

Both meet every side of every face once and add the face's facing to the edge
record of that side: +1 where the face traverses v0 -> v1, -1 where it runs back.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def record_of_sides(rows, faces, record):
    """Write the edge record of each side of each face.

    ``rows (n_edges, 4)``, ``faces (n_faces, 3) uint32``; ``record (3 n_faces,)
    uint32``: side ``3 f + i`` runs from corner i of face f to the next one.
    """
    for e in range(len(rows)):
        for side in range(2):
            f = rows[e, 2 + side]
            if f == np.uint32(0xFFFFFFFF):
                continue
            start = rows[e, side]
            for corner in range(3):
                if faces[f, corner] == start and faces[f, (corner + 1) % 3] == rows[e, 1 - side]:
                    record[3 * np.int64(f) + corner] = e


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def fill_edge_buffer(faces, record, facing_of_face, face_begin, face_end, shift, m):
    """Add each face's facing to the buffer's entry of each of its sides.

    ``m int8`` starts at 0; the entry of record e of object k is ``m[e + shift[k]]``;
    object k has the faces ``face_begin[k] .. face_end[k] - 1``.
    """
    for k in range(len(face_begin)):
        for f in range(face_begin[k], face_end[k]):
            s = facing_of_face[f]
            for corner in range(3):
                runs_up = faces[f, corner] < faces[f, (corner + 1) % 3]
                m[record[3 * f + corner] + shift[k]] += s if runs_up else -s


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def eliminate_edges(
    faces, record, facing_of_face, face_begin, face_end, shift, slot, listed, values
):
    """Return how many edges are left of those that faces brought in.

    A face that counts brings its three edges. One that is not in the list enters
    it; one that is changes by the face's facing, and is eliminated where nothing is
    left of it: the last of the list takes its place.

    ``slot int32`` starts at -1: where in the list each record is, indexed as the
    buffer of `fill_edge_buffer`. ``listed int64``, ``values int8``: the list.
    """
    n = 0
    for k in range(len(face_begin)):
        for f in range(face_begin[k], face_end[k]):
            s = facing_of_face[f]
            if s == 0:
                continue
            for corner in range(3):
                runs_up = faces[f, corner] < faces[f, (corner + 1) % 3]
                term = s if runs_up else -s
                e = np.int64(record[3 * f + corner])
                at = slot[e + shift[k]]
                if at < 0:
                    slot[e + shift[k]] = n
                    listed[n, 0] = e
                    listed[n, 1] = e + shift[k]
                    values[n] = term
                    n += 1
                elif values[at] + term != 0:
                    values[at] += term
                else:
                    slot[e + shift[k]] = -1
                    n -= 1
                    if at != n:
                        listed[at, 0] = listed[n, 0]
                        listed[at, 1] = listed[n, 1]
                        values[at] = values[n]
                        slot[listed[at, 1]] = at
    return n


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def scan_tables(rows, is_searched, plane_of_face, n_planes, object_edge, record, sides, begin):
    """Write what a flat scan reads of each record that may be a silhouette.

    Parameters
    ----------
    rows : ndarray
        ``(n_edges, 4) uint32``
    is_searched : ndarray
        ``(n_edges,) bool``: false for planar records, which never are.
    plane_of_face : ndarray
        ``(n_faces,) uint32``
    n_planes : int
        Stands for the plane of a missing face.
    object_edge : ndarray
        ``(n_objects + 1,) int64``: edge records of each object.
    record, sides : ndarray
        ``uint32``, ``uint64``, written: the record; the plane record on its left, and
        2^32 times that on its right.
    begin : ndarray
        ``(n_objects + 1,) int64``, written: where each object's begin.
    """
    n = 0
    n_faces = len(plane_of_face)
    for k in range(len(object_edge) - 1):
        begin[k] = n
        for e in range(object_edge[k], object_edge[k + 1]):
            if not is_searched[e]:
                continue
            f, g = np.int64(rows[e, 2]), np.int64(rows[e, 3])
            record[n] = e
            left = np.uint64(plane_of_face[f] if f < n_faces else n_planes)
            right = np.uint64(plane_of_face[g] if g < n_faces else n_planes)
            sides[n] = left | (right << np.uint64(32))
            n += 1
    begin[len(object_edge) - 1] = n
