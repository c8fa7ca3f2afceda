"""The repair stage: wind, drop duplicates, split edges, find components and solids."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from svprep.defects import DEFECTS, Code
from svprep.kernels.half_edges import rebuild_faces
from svprep.model import (
    I32,
    I64,
    U8,
    U32,
    ComponentFlag,
    FaceFindings,
    Mesh,
    RepairRecord,
    SourceMesh,
)
from svprep.repair.grid import grid_coordinates
from svprep.repair.solid import find_self_contact
from svprep.repair.split import EdgeGroups, group_edges, sort_stably
from svprep.repair.weld import WeldReport
from svprep.repair.winding import Winding, wind


@dataclass(frozen=True, slots=True)
class Repaired:
    """A repaired mesh and how its faces hang together."""

    mesh: Mesh
    """Wound alike, without duplicates, faces sorted by (object, component)."""
    points: I32
    """``(n_vertices, 3)``: grid coordinates of its vertices."""
    groups: EdgeGroups
    mate: I32
    """``(3 n_faces,)``: the half-edge that each half-edge is paired with, or -1."""
    component_start: I64
    """``(n_objects + 1,)``: components of each object."""
    component_face_start: I64
    """``(n_components + 1,)``"""
    component_flags: U8
    """``(n_components,)``: `ComponentFlag` bits."""


@dataclass(frozen=True, slots=True)
class RepairReport:
    """What the repair decided; `record` turns it into the cache's tables."""

    duplicates: FaceFindings
    flipped_faces: U32
    """Faces of the repaired mesh wound against their source, ascending."""
    counts: dict[Code, U32]
    """Per defect found here: ``(n_objects,)`` counts."""
    n_passes: int


def repair(mesh: Mesh) -> tuple[Repaired, RepairReport]:
    """Return `mesh` wound alike, split into components, without duplicates.

    No face with area is moved or removed, save exact duplicates, so no shadow
    changes. Repairing a repaired mesh changes nothing.

    Notes
    -----
    Near-linear in faces and in components. Winding and edge duplication after
    Steiner (2006), appendix A.2; see `winding` and `split`.
    """
    winding = wind(mesh, grid_coordinates(mesh.positions, mesh.grid))
    order, component_face_start, lowest = _sorted_by_component(winding)
    duplicates = _list_duplicates(mesh, ~winding.is_kept)
    mesh, mate = _rebuilt(mesh, winding, order)
    points = grid_coordinates(mesh.positions, mesh.grid)
    begin, end = mesh.object_vertex_start[:-1], mesh.object_vertex_start[1:]
    groups = group_edges(mesh.faces, mesh.object_face_start, begin, end)

    is_flipped = winding.is_flipped[order]
    flags, is_touching, is_flat = _judge_components(
        mesh, points, winding, lowest, component_face_start, is_flipped
    )
    component_start = np.searchsorted(component_face_start[:-1], mesh.object_face_start)
    repaired = Repaired(
        mesh=mesh,
        points=points,
        groups=groups,
        mate=mate,
        component_start=component_start.astype(np.int64),
        component_face_start=component_face_start,
        component_flags=flags,
    )
    inverted = (flags & np.uint8(ComponentFlag.INVERTED)) != 0
    counts = _count_edges(mesh, groups, mate)
    counts[Code.OPPOSITE_FACE] = winding.n_opposite.astype(np.uint32)
    counts[Code.FLIPPED_FACE] = _per_range(is_flipped, mesh.object_face_start)
    counts[Code.INVERTED_COMPONENT] = _per_range(inverted, component_start)
    counts[Code.SELF_INTERSECTION] = _per_range(is_touching, component_start)
    counts[Code.FLAT_COMPONENT] = _per_range(is_flat, component_start)
    return repaired, RepairReport(
        duplicates=duplicates,
        flipped_faces=np.flatnonzero(is_flipped).astype(np.uint32),
        counts=counts,
        n_passes=winding.n_passes,
    )


def record(
    source: SourceMesh, weld: WeldReport, report: RepairReport, digest: NDArray[np.uint64]
) -> RepairRecord:
    """Gather every decision of reader, weld and repair per object and source face.

    ``digest (n_objects, 2)``: what `svprep.content` makes of `source`.
    """
    n_objects = len(source.object_names)
    tables = (source.face_findings, weld.dropped, report.duplicates)
    code = np.concatenate([t.code for t in tables])
    owner = np.concatenate([t.object_index for t in tables])
    source_face = np.concatenate([t.source_face for t in tables])
    order = np.lexsort((source_face, code, owner))
    counts = np.zeros((n_objects, len(DEFECTS)), np.uint32)
    for column, defect in enumerate(DEFECTS):
        found = owner[code == defect]
        counts[:, column] = np.bincount(found, minlength=n_objects)
        if defect in report.counts:
            counts[:, column] += report.counts[defect]
    counts[:, list(DEFECTS).index(Code.UNWELDED_VERTEX)] = weld.welded_vertices
    return RepairRecord(
        defect_counts=counts,
        source_triangles=weld.source_triangles,
        source_digest=digest,
        face_findings=FaceFindings(
            code=code[order], object_index=owner[order], source_face=source_face[order]
        ),
        flipped_faces=report.flipped_faces,
    )


def _sorted_by_component(winding: Winding) -> tuple[I32, I64, I32]:
    """Return the kept faces by component, where each one's begin, and its lowest face.

    Components are numbered by their lowest face, so they stay grouped by object.
    """
    n_faces = len(winding.root)
    is_lowest = winding.is_kept & (winding.root == np.arange(n_faces, dtype=np.int32))
    component = (np.cumsum(is_lowest, dtype=np.int32) - np.int32(1))[winding.root]
    lowest = np.flatnonzero(is_lowest).astype(np.int32)
    if winding.is_kept.all():
        return (*sort_stably(component, len(lowest)), lowest)
    kept = np.flatnonzero(winding.is_kept).astype(np.int32)
    order, start = sort_stably(component[kept], len(lowest))
    return kept[order], start, lowest


def _rebuilt(mesh: Mesh, winding: Winding, order: I32) -> tuple[Mesh, I32]:
    """Return the faces of `order`, turned where they are to be, and the mates of their half-edges.

    Vertices are numbered in the order in which these faces use them, as welding does, so that
    a build of the repaired mesh gives the same mesh. An object keeps all its vertices: what
    is dropped has a double that stays. A mesh that stays as it is keeps its numbers. O(n).
    """
    is_same = len(order) == len(mesh.faces) and bool((order[1:] > order[:-1]).all())
    if is_same and not winding.is_flipped.any():
        return mesh, winding.mate
    faces = np.empty((len(order), 3), np.uint32)
    mate = np.empty(3 * len(order), np.int32)
    old_vertex = np.empty(len(mesh.positions), np.uint32)
    n_vertices = rebuild_faces(
        mesh.faces, winding.is_flipped, winding.mate, order, faces, mate, old_vertex
    )
    start = mesh.object_face_start
    if len(order) < len(mesh.faces):
        start = np.concatenate(([0], np.cumsum(winding.is_kept)))[start]
    rebuilt = replace(
        mesh,
        positions=mesh.positions[old_vertex[:n_vertices]],
        faces=faces,
        source_face=mesh.source_face[order],
        object_face_start=start,
    )
    return rebuilt, mate


def _list_duplicates(mesh: Mesh, is_dropped: np.ndarray) -> FaceFindings:
    dropped = np.flatnonzero(is_dropped)
    owner = np.searchsorted(mesh.object_face_start, dropped, side="right") - 1
    return FaceFindings(
        code=np.full(len(dropped), Code.DUPLICATE_FACE, np.uint16),
        object_index=owner.astype(np.uint32),
        source_face=mesh.source_face[dropped],
    )


def _judge_components(
    mesh: Mesh,
    points: I32,
    winding: Winding,
    lowest: I32,
    face_start: I64,
    is_flipped: np.ndarray,
) -> tuple[U8, np.ndarray, np.ndarray]:
    """Return flags, and which components touch themselves or enclose nothing.

    ``lowest (n_components,)``: the faces that `winding` knows them by.
    """
    n = len(lowest)
    closed = winding.is_closed[lowest]
    flat = closed & winding.is_flat[lowest]
    candidates = np.flatnonzero(closed & ~flat)
    touching = np.zeros(n, bool)
    touching[candidates] = find_self_contact(points, mesh.faces, face_start, candidates)
    size = np.diff(face_start)
    flipped = np.searchsorted(face_start, np.flatnonzero(is_flipped), side="right") - 1
    n_flipped = np.bincount(flipped, minlength=n)
    is_solid = closed & ~flat & ~touching
    is_inverted = closed & (2 * n_flipped > size)
    flags = (
        closed * np.uint8(ComponentFlag.CLOSED)
        | is_solid * np.uint8(ComponentFlag.SOLID)
        | is_inverted * np.uint8(ComponentFlag.INVERTED)
    )
    return flags, touching, flat


def _count_edges(mesh: Mesh, groups: EdgeGroups, mate: I32) -> dict[Code, U32]:
    """Count border, cut and non-manifold edges per object."""
    first = groups.order[groups.start[:-1]]
    size = groups.n_faces_of_edge
    kinds = {
        Code.OPEN_SHELL: size == 1,
        Code.CUT_EDGE: (size == 2) & (mate[first] < 0),
        Code.NONMANIFOLD_EDGE: size > 2,
    }
    edge_start = np.searchsorted(groups.start[:-1], 3 * mesh.object_face_start)
    return {code: _per_range(found, edge_start) for code, found in kinds.items()}


def _per_range(is_found: np.ndarray, start: I64) -> U32:
    """Count the true values within each range of `start`."""
    before = np.concatenate(([0], np.cumsum(is_found)))
    return np.diff(before[start]).astype(np.uint32)
