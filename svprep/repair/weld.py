"""Quantise and weld: from source triangles to triangles on the grid, per object.

Two vertices of one object at the same grid position become one; vertices of
different objects stay apart. Faces without area on the grid are left out here,
counted and listed, before any table can trip over them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svprep.defects import Code
from svprep.kernels.rows import (
    count_distinct_per_group,
    first_equal_row,
    pull_onto_leaders,
    weld_corners,
)
from svprep.model import BOOL, I32, I64, U32, FaceFindings, Grid, Mesh, SourceMesh
from svprep.repair.grid import choose_grid, to_grid


@dataclass(frozen=True, slots=True)
class WeldReport:
    """What welding decided."""

    source_triangles: U32
    """``(n_objects,)``: triangles before any was dropped."""
    welded_vertices: U32
    """``(n_objects,)``: source vertices merged into another one."""
    dropped: FaceFindings
    """Faces without area: `DEGENERATE_FACE` or `COLLAPSED_FACE`."""
    farthest_move_m: float
    """[m]: the largest shift by ``--weld-tolerance``; 0.0 without it."""


def weld(
    source: SourceMesh, weld_tolerance_m: float = 0.0, grid: Grid | None = None
) -> tuple[Mesh, WeldReport]:
    """Return the faces of `source` that have area, on the grid, welded per object.

    Parameters
    ----------
    source : SourceMesh
    weld_tolerance_m : float
        [m]. Vertices of one object within this distance of an earlier vertex
        that stayed in place move onto it, so none moves farther than this.
        0.0 (the default) moves nothing.
    grid : Grid, optional
        That of the whole input, where `source` is a part of it; by default that of `source`.

    Returns
    -------
    Mesh
        Vertices numbered by first use within each object.
    WeldReport

    Notes
    -----
    O(n) expected time, by hashing. Plain twin: `reference.weld`.
    """
    grid = grid or choose_grid(source)
    points, faces = to_grid(source.positions, grid), source.faces
    moved = 0.0
    if weld_tolerance_m > 0.0:
        points, moved = _pull_together(source, points[faces.reshape(-1)], grid, weld_tolerance_m)
        faces = np.arange(len(points), dtype=np.uint32).reshape(-1, 3)
    has_area = np.empty(len(faces), bool)
    welded = np.empty((len(faces), 3), np.uint32)
    places = np.empty((3 * len(faces), 3), np.int32)
    starts = np.empty((len(source.object_names) + 1, 2), np.int64)
    n_used = np.empty(len(source.object_names), np.int64)
    weld_corners(points, faces, source.object_face_start, has_area, welded, places, starts, n_used)
    if weld_tolerance_m > 0.0:
        _count_used(source, has_area, n_used)
    n_faces, n_vertices = starts[-1].tolist()
    source_face = source.source_face
    mesh = Mesh(
        grid=grid,
        positions=(places[:n_vertices] * grid.step_m).astype(np.float32),
        faces=welded[:n_faces],
        object_vertex_start=np.ascontiguousarray(starts[:, 1]),
        object_face_start=np.ascontiguousarray(starts[:, 0]),
        source_face=source_face if n_faces == len(faces) else source_face[has_area],
    )
    report = WeldReport(
        source_triangles=np.diff(source.object_face_start).astype(np.uint32),
        welded_vertices=(n_used - np.diff(starts[:, 1])).astype(np.uint32),
        dropped=_list_dropped(source, ~has_area),
        farthest_move_m=moved,
    )
    return mesh, report


def _count_used(source: SourceMesh, has_area: BOOL, n_used: I64) -> None:
    """Write to `n_used` how many source vertices the faces that stay use, per object."""
    kept = source.faces[has_area]
    start = np.concatenate(([0], np.cumsum(has_area)))[source.object_face_start]
    count_distinct_per_group(kept.reshape(-1), 3 * start, len(source.positions), n_used)


def _list_dropped(source: SourceMesh, is_flat: BOOL) -> FaceFindings:
    """List faces without area: degenerate in the source already, or collapsed by the grid."""
    flat = np.flatnonzero(is_flat)
    corners = source.positions[source.faces[flat]]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    with np.errstate(over="ignore", invalid="ignore"):
        twice_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        longest = np.max([np.linalg.norm(e, axis=1) for e in (b - a, c - b, a - c)], axis=0)
    # Zero in the source means: no higher than its own coordinates resolve.
    rounding = 8.0 * np.spacing(np.abs(corners).max(axis=(1, 2)))
    is_degenerate = twice_area <= rounding * longest
    owner = np.searchsorted(source.object_face_start, flat, side="right") - 1
    return FaceFindings(
        code=np.where(is_degenerate, Code.DEGENERATE_FACE, Code.COLLAPSED_FACE).astype(np.uint16),
        object_index=owner.astype(np.uint32),
        source_face=source.source_face[flat],
    )


def _pull_together(
    source: SourceMesh, corner_points: I32, grid: Grid, tolerance_m: float
) -> tuple[I32, float]:
    """Move vertices onto an earlier one of their object within the tolerance.

    A vertex that moved is never a target, so moves do not chain.
    """
    corner_start = 3 * source.object_face_start
    first = np.empty(len(corner_points), np.int32)
    first_equal_row(corner_points, corner_start, 0, len(corner_start) - 1, first)
    standing = np.flatnonzero(first == np.arange(len(first), dtype=np.int32))
    points = corner_points[standing]
    target = np.empty(len(points), np.int32)
    pull_onto_leaders(
        points, np.searchsorted(standing, corner_start), tolerance_m / grid.step_m, target
    )
    moved = np.linalg.norm((points[target] - points).astype(np.float64), axis=1)
    rank = np.empty(len(first), np.int32)
    rank[standing] = np.arange(len(standing), dtype=np.int32)
    return points[target][rank[first]], float(moved.max(initial=0.0) * grid.step_m)
