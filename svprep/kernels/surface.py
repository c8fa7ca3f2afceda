"""Normals, signed volumes and the growing of shared planes, on grid integers.

A grid coordinate has at most 25 bits and a sign, so a difference of two fits
26 bits, a cross product 53: exact in float64 and int64 alike.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def face_normals(grid_positions, faces, normals):
    """Write ``n = (b - a) x (c - a)`` of every face, exact, in steps squared.

    ``grid_positions (n_vertices, 3) int32``, ``faces (n_faces, 3) uint32``,
    ``normals (n_faces, 3) float64``.
    """
    for f in range(len(faces)):
        a = grid_positions[faces[f, 0]]
        b = grid_positions[faces[f, 1]]
        c = grid_positions[faces[f, 2]]
        ux = np.int64(b[0]) - np.int64(a[0])
        uy = np.int64(b[1]) - np.int64(a[1])
        uz = np.int64(b[2]) - np.int64(a[2])
        wx = np.int64(c[0]) - np.int64(a[0])
        wy = np.int64(c[1]) - np.int64(a[1])
        wz = np.int64(c[2]) - np.int64(a[2])
        normals[f, 0] = uy * wz - uz * wy
        normals[f, 1] = uz * wx - ux * wz
        normals[f, 2] = ux * wy - uy * wx


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def component_volumes(grid_positions, faces, normals, flips, component, reference, volume, scale):
    """Add up six times the signed volume of each component, and its scale.

    The volume is taken about a vertex of the component's face
    ``reference[component]``; ``scale`` sums the magnitudes before cancellation:
    a volume below 1e-14 of it is zero for float64.
    """
    for f in range(len(faces)):
        i = component[f]
        a = grid_positions[faces[f, 0]]
        r = grid_positions[faces[reference[i], 0]]
        x = np.float64(a[0]) - np.float64(r[0])
        y = np.float64(a[1]) - np.float64(r[1])
        z = np.float64(a[2]) - np.float64(r[2])
        n = normals[f]
        term = x * n[0] + y * n[1] + z * n[2]
        volume[i] += -term if flips[f] else term
        scale[i] += math.sqrt((x * x + y * y + z * z) * (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]))


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def shape_hashes(grid_positions, faces, face_start, hashes):
    """Write 32 bits per face that depend on its shape and place, not its number.

    The upper 20 bits are kept by translation, by a turn of 90 degrees about z,
    by renumbering and by flipping: heights above the object's lowest vertex and
    the distance to the axis of its bounding box. The lower 12 bits tell apart
    what is left, by position within the box.
    """
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    for i in range(len(face_start) - 1):
        if face_start[i] == face_start[i + 1]:
            continue
        for axis in range(3):
            low[axis] = grid_positions[faces[face_start[i], 0], axis]
            high[axis] = low[axis]
        for f in range(face_start[i], face_start[i + 1]):
            for c in range(3):
                for axis in range(3):
                    x = np.int64(grid_positions[faces[f, c], axis])
                    low[axis] = min(low[axis], x)
                    high[axis] = max(high[axis], x)
        for f in range(face_start[i], face_start[i + 1]):
            x = np.int64(0)
            y = np.int64(0)
            z = np.int64(0)
            for c in range(3):
                x += grid_positions[faces[f, c], 0]
                y += grid_positions[faces[f, c], 1]
                z += grid_positions[faces[f, c], 2]
            dx = 2 * x - 3 * (low[0] + high[0])
            dy = 2 * y - 3 * (low[1] + high[1])
            kept = np.uint64(dx * dx + dy * dy) * np.uint64(0x9E3779B97F4A7C15)
            kept = (kept ^ np.uint64(z - 3 * low[2])) * np.uint64(0xC2B2AE3D27D4EB4F)
            place = np.uint64(x - 3 * low[0]) * np.uint64(0x165667B19E3779F9)
            place = (place ^ np.uint64(y - 3 * low[1])) * np.uint64(0x9E3779B97F4A7C15)
            hashes[f] = np.uint32(
                ((kept >> np.uint64(44)) << np.uint64(12)) | (place >> np.uint64(52))
            )


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def grow_planes(
    grid_positions, faces, normals, mate, seeds, tolerance_steps, most_tilt_rad, seed_of_face
):
    """Give every face the seed whose plane it shares.

    Seeds are tried in the given order. From a seed the plane spreads over
    paired half-edges to faces that are tilted by no more than `most_tilt_rad` and
    whose corners lie within the tolerance of the *seed's* plane, so it cannot
    drift. (Without the first a sliver at an eave, however steep, would face
    where its roof faces, and its volume would subtract.)

    ``seed_of_face (n_faces,) int32`` starts at -1. O(n_faces).
    """
    stack = np.empty(len(faces), np.int32)
    for k in range(len(seeds)):
        seed = seeds[k]
        if seed_of_face[seed] >= 0:
            continue
        nx, ny, nz = normals[seed, 0], normals[seed, 1], normals[seed, 2]
        a = faces[seed, 0]
        ax, ay, az = grid_positions[a, 0], grid_positions[a, 1], grid_positions[a, 2]
        length2 = nx * nx + ny * ny + nz * nz
        limit = tolerance_steps * math.sqrt(length2)
        sine = math.sin(most_tilt_rad)
        tilt2 = sine * sine * length2  # a power would be compiled as a loop
        seed_of_face[seed] = seed
        stack[0] = seed
        depth = 1
        while depth > 0:
            depth -= 1
            f = stack[depth]
            for c in range(3):
                other = mate[3 * f + c]
                if other < 0:
                    continue
                g = other // 3
                if seed_of_face[g] >= 0:
                    continue
                mx, my, mz = normals[g, 0], normals[g, 1], normals[g, 2]
                x = ny * mz - nz * my
                y = nz * mx - nx * mz
                z = nx * my - ny * mx
                if nx * mx + ny * my + nz * mz <= 0.0 or (
                    x * x + y * y + z * z > tilt2 * (mx * mx + my * my + mz * mz)
                ):
                    continue
                apex = faces[g, (other % 3 + 2) % 3]
                distance = (
                    nx * (np.float64(grid_positions[apex, 0]) - np.float64(ax))
                    + ny * (np.float64(grid_positions[apex, 1]) - np.float64(ay))
                    + nz * (np.float64(grid_positions[apex, 2]) - np.float64(az))
                )
                if abs(distance) <= limit:
                    seed_of_face[g] = seed
                    stack[depth] = g
                    depth += 1
