"""A kernel that digests what the sources say of each object's shape."""

from __future__ import annotations

import numpy as np
from numba import njit

_K1 = np.uint64(0x9E3779B97F4A7C15)
_K2 = np.uint64(0xC2B2AE3D27D4EB4F)
_S1 = np.uint64(29)
_S2 = np.uint64(32)


@njit(cache=True, nogil=True, no_cfunc_wrapper=True)
def digest_objects(words, faces, face_start, source_face, begin, end, digest):
    """Write 128 bits of the triangles of objects ``begin .. end - 1`` into `digest`.

    Parameters
    ----------
    words : (n_vertices, 3) uint64
        The bits of float64 positions.
    faces : (n_faces, 3) uint32
    face_start : (n_objects + 1,) int64
    source_face : (n_faces,) uint32
    begin, end : int
    digest : (n_objects, 2) uint64

    Notes
    -----
    Taken in order are the positions of each face's corners, its vertices counted from the
    object's lowest one, and its polygon counted from the object's lowest one. Each word is
    mixed into two running numbers by exclusive or, multiplication and shift, one each: every
    step can be undone, so two objects that differ in one word only never agree. O(n).
    """
    for k in range(begin, end):
        low = np.uint32(0xFFFFFFFF)
        first = np.uint32(0xFFFFFFFF)
        for f in range(face_start[k], face_start[k + 1]):
            first = min(first, source_face[f])
            for c in range(3):
                low = min(low, faces[f, c])
        h = np.uint64(face_start[k + 1] - face_start[k])
        g = ~h
        for f in range(face_start[k], face_start[k + 1]):
            word = np.uint64(source_face[f] - first)
            h = (h ^ word) * _K1
            h ^= h >> _S1
            g = (g ^ word) * _K2
            g ^= g >> _S2
            for c in range(3):
                vertex = faces[f, c]
                word = np.uint64(vertex - low)
                h = (h ^ word) * _K1
                h ^= h >> _S1
                g = (g ^ word) * _K2
                g ^= g >> _S2
                for i in range(3):
                    word = words[vertex, i]
                    h = (h ^ word) * _K1
                    h ^= h >> _S1
                    g = (g ^ word) * _K2
                    g ^= g >> _S2
        digest[k, 0] = h
        digest[k, 1] = g
