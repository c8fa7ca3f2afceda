"""Quantise and weld: from source triangles to triangles on the grid, per object.

Two vertices of one object at the same grid position become one; vertices of
different objects stay apart. Faces without area on the grid are left out here,
counted and listed, before any table can trip over them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svprep.defects import Code
from svprep.kernels.rows import count_distinct_per_group, first_equal_row, pull_onto_leaders
from svprep.kernels.surface import face_normals
from svprep.model import BOOL, I32, I64, U32, FaceFindings, Grid, Mesh, SourceMesh
from svprep.parallel import for_ranges
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


def weld(source: SourceMesh, weld_tolerance_m: float = 0.0) -> tuple[Mesh, WeldReport]:
    """Return the faces of `source` that have area, on the grid, welded per object.

    Parameters
    ----------
    source : SourceMesh
    weld_tolerance_m : float
        [m]. Vertices of one object within this distance of an earlier vertex
        that stayed in place move onto it, so none moves farther than this.
        0.0 (the default) moves nothing.

    Returns
    -------
    Mesh
        Vertices numbered by first use within each object.
    WeldReport

    Notes
    -----
    O(n) expected time, by hashing. Plain twin: `reference.weld`.
    """
    grid = choose_grid(source)
    points = to_grid(source.positions, grid)
    n_objects = len(source.object_names)
    n_distinct = np.zeros(n_objects, np.int64)
    count_distinct_per_group(
        source.faces.reshape(-1), 3 * source.object_face_start, len(points), n_distinct
    )
    moved = 0.0
    corner_points = np.take(points, source.faces.reshape(-1), axis=0)
    if weld_tolerance_m > 0.0:
        corner_points, moved = _pull_together(source, corner_points, grid, weld_tolerance_m)

    normals = np.empty((len(source.faces), 3))
    corners = np.arange(len(corner_points), dtype=np.uint32).reshape(-1, 3)
    face_normals(corner_points, corners, normals)
    has_area: BOOL = np.any(normals, axis=1)
    dropped = _list_dropped(source, ~has_area)
    face_start = source.object_face_start
    source_face = source.source_face
    if not has_area.all():
        corner_points = corner_points.reshape(-1, 9)[has_area].reshape(-1, 3)
        source_face = source_face[has_area]
        kept_before = np.concatenate(([0], np.cumsum(has_area)))
        face_start = kept_before[face_start]

    corner_start = 3 * face_start
    first = _first_at_each_position(corner_points, corner_start)
    is_new = first == np.arange(len(first), dtype=np.int32)
    vertex_before = np.zeros(len(first) + 1, np.int64)
    np.cumsum(is_new, out=vertex_before[1:])
    faces = vertex_before[first].astype(np.uint32).reshape(-1, 3)
    object_vertex_start = vertex_before[corner_start]
    mesh = Mesh(
        grid=grid,
        positions=(corner_points[is_new] * grid.step_m).astype(np.float32),
        faces=faces,
        object_vertex_start=object_vertex_start,
        object_face_start=np.ascontiguousarray(face_start, np.int64),
        source_face=source_face,
    )
    report = WeldReport(
        source_triangles=np.diff(source.object_face_start).astype(np.uint32),
        welded_vertices=_welded(n_distinct, object_vertex_start, source, has_area),
        dropped=dropped,
        farthest_move_m=moved,
    )
    return mesh, report


def _welded(n_distinct: I64, object_vertex_start: I64, source: SourceMesh, has_area: BOOL) -> U32:
    """Count source vertices merged away, over the faces that stayed."""
    if not has_area.all():
        kept = np.ascontiguousarray(source.faces[has_area])
        start = np.concatenate(([0], np.cumsum(has_area)))[source.object_face_start]
        n_distinct = np.zeros(len(n_distinct), np.int64)
        count_distinct_per_group(kept.reshape(-1), 3 * start, len(source.positions), n_distinct)
    return (n_distinct - np.diff(object_vertex_start)).astype(np.uint32)


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
    first = _first_at_each_position(corner_points, corner_start)
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


def _first_at_each_position(corner_points: I32, corner_start: I64) -> I32:
    """Return, per corner, the first corner of its object at the same position."""
    first = np.empty(len(corner_points), np.int32)

    def work(begin: int, end: int) -> None:
        first_equal_row(corner_points, corner_start, begin, end, first)

    for_ranges(corner_start, work)
    return first
