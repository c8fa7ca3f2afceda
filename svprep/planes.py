"""Plane records, shared by connected faces that are coplanar within a tolerance."""

from __future__ import annotations

import numpy as np

from svprep.kernels.surface import face_normals, grow_planes, shape_hashes
from svprep.model import F64, I32, MOST_TILT_RAD, Grid, Mesh, PlaneTable
from svprep.repair.stage import Repaired


def default_planar_tolerance_m(grid: Grid) -> float:
    """Return the default tolerance [m]: 16 grid steps, at most 1 mm, at least 4 steps.

    Rounding to the grid alone bends a flat quad by up to 3.5 steps.
    """
    return max(4.0 * grid.step_m, min(1e-3, 16.0 * grid.step_m))


def build_planes(
    repaired: Repaired, tolerance_m: float | None = None, most_tilt_rad: float = MOST_TILT_RAD
) -> PlaneTable:
    """Return a plane record for every face, shared where connected faces are coplanar.

    The record is the plane of one face (the seed), taken in order of falling
    area; it spreads over paired edges to faces that are tilted against it by no
    more than `most_tilt_rad` and whose corners lie within the tolerance of the
    seed's own plane, so it cannot drift. Ties in area are broken by shape and
    place, so that records do not depend on the order of faces.

    Parameters
    ----------
    repaired : Repaired
    tolerance_m : float, optional
        [m]; `default_planar_tolerance_m` of the grid if None.
    most_tilt_rad : float
        [rad]; a cache is built with the default.

    Notes
    -----
    O(n log n). Records are numbered by their lowest face.
    Plain twin: `reference.check_planes`.
    """
    mesh = repaired.mesh
    tolerance_m = default_planar_tolerance_m(mesh.grid) if tolerance_m is None else tolerance_m
    points = repaired.points
    normals = np.empty((len(mesh.faces), 3))
    face_normals(points, mesh.faces, normals)
    seed_of_face = np.full(len(mesh.faces), -1, np.int32)
    grow_planes(
        points,
        mesh.faces,
        normals,
        repaired.mate,
        _seed_order(mesh, points, normals),
        tolerance_m / mesh.grid.step_m,
        most_tilt_rad,
        seed_of_face,
    )
    lowest = np.full(len(mesh.faces), len(mesh.faces), np.int32)
    numbers = np.arange(len(mesh.faces), dtype=np.int32)
    lowest[seed_of_face[::-1]] = numbers[::-1]  # the last write, the lowest face, stays
    is_lowest = lowest[seed_of_face] == numbers
    record_of_seed = np.empty(len(mesh.faces), np.uint32)
    seeds = seed_of_face[is_lowest]
    record_of_seed[seeds] = np.arange(len(seeds), dtype=np.uint32)
    return PlaneTable(
        planes=_records(mesh, normals[seeds], seeds),
        plane_of_face=record_of_seed[seed_of_face],
        tolerance_m=tolerance_m,
    )


def _seed_order(mesh: Mesh, points: I32, normals: F64) -> I32:
    """Order faces by falling area, ties by shape and place."""
    hashes = np.empty(len(mesh.faces), np.uint32)
    shape_hashes(points, mesh.faces, mesh.object_face_start, hashes)
    # x and y first: a turn by 90 degrees about z swaps them and changes nothing.
    area2 = (normals[:, 0] ** 2 + normals[:, 1] ** 2 + normals[:, 2] ** 2).astype(np.float32)
    key = (~area2.view(np.uint32)).astype(np.uint64) << np.uint64(32)
    key |= hashes
    return np.argsort(key, kind="stable").astype(np.int32)


def _records(mesh: Mesh, normals: F64, seeds: I32) -> F64:
    """Return ``(n, 4)``: ``(n, -n . a)`` in metres, of the seed faces."""
    planes = np.empty((len(seeds), 4))
    planes[:, :3] = normals * (mesh.grid.step_m * mesh.grid.step_m)
    a = mesh.positions[mesh.faces[seeds, 0]].astype(np.float64)
    planes[:, 3] = -(planes[:, 0] * a[:, 0] + planes[:, 1] * a[:, 1] + planes[:, 2] * a[:, 2])
    return planes
