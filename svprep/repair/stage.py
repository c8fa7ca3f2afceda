"""The repair stage: wind, drop duplicates, split edges, find components and solids."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svprep.defects import DEFECTS, Code
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
from svprep.repair.split import EdgeGroups, connect, group_edges, pair_edges, sort_stably
from svprep.repair.weld import WeldReport
from svprep.repair.winding import is_closed, opposite_faces, signed_volumes, wind


@dataclass(frozen=True, slots=True)
class Repaired:
    """A repaired mesh and how its faces hang together."""

    mesh: Mesh
    """Wound alike, without duplicates, faces sorted by (object, component)."""
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
    points = grid_coordinates(mesh.positions, mesh.grid)
    winding = wind(mesh, points)
    is_flipped = winding.is_flipped[winding.is_kept]
    duplicates = _list_duplicates(mesh, ~winding.is_kept)
    mesh = _turn_and_drop(mesh, winding.is_kept, is_flipped)
    if is_flipped.any() or not winding.is_kept.all():
        mesh, points = _numbered_by_first_use(mesh)

    groups, mate = _pair_all(mesh, points)
    component, lowest = connect(mate, len(mesh.faces))
    order, component_face_start = sort_stably(component, len(lowest))
    if not (order[1:] > order[:-1]).all():
        mesh = replace(mesh, faces=mesh.faces[order], source_face=mesh.source_face[order])
        is_flipped = is_flipped[order]
        component = component[order]
        mesh, points = _numbered_by_first_use(mesh)
        groups, mate = _pair_all(mesh, points)
    lowest = component_face_start[:-1].astype(np.int32)

    flags, is_touching, is_flat = _judge_components(
        mesh, points, mate, component, component_face_start, is_flipped
    )
    component_start = np.searchsorted(lowest, mesh.object_face_start)
    repaired = Repaired(
        mesh=mesh,
        groups=groups,
        mate=mate,
        component_start=component_start.astype(np.int64),
        component_face_start=component_face_start,
        component_flags=flags,
    )
    inverted = (flags & np.uint8(ComponentFlag.INVERTED)) != 0
    counts = _count_edges(mesh, groups, mate)
    is_opposite = np.zeros(len(mesh.faces), bool)
    is_opposite[opposite_faces(mesh)] = True
    counts[Code.OPPOSITE_FACE] = _per_range(is_opposite, mesh.object_face_start)
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


def record(source: SourceMesh, weld: WeldReport, report: RepairReport) -> RepairRecord:
    """Gather every decision of reader, weld and repair per object and source face."""
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
        face_findings=FaceFindings(
            code=code[order], object_index=owner[order], source_face=source_face[order]
        ),
        flipped_faces=report.flipped_faces,
    )


def _numbered_by_first_use(mesh: Mesh) -> tuple[Mesh, I32]:
    """Return `mesh` with its vertices in the order in which its faces use them, and their points.

    As welding numbers them, so that a build of the repaired mesh gives the same mesh. An
    object keeps all its vertices: what is dropped has a double that stays. O(n).
    """
    corners = mesh.faces.reshape(-1)
    places = np.arange(len(corners))
    first = np.full(len(mesh.positions), len(corners))
    first[corners[::-1]] = places[::-1]  # the last write, the first use, stays
    old = corners[first[corners] == places]
    new = np.empty(len(mesh.positions), np.uint32)
    new[old] = np.arange(len(old), dtype=np.uint32)
    mesh = replace(mesh, positions=mesh.positions[old], faces=new[mesh.faces])
    return mesh, grid_coordinates(mesh.positions, mesh.grid)


def _pair_all(mesh: Mesh, points: I32) -> tuple[EdgeGroups, I32]:
    begin, end = mesh.object_vertex_start[:-1], mesh.object_vertex_start[1:]
    groups = group_edges(mesh.faces, mesh.object_face_start, begin, end)
    return groups, pair_edges(points, mesh.faces, np.zeros(len(mesh.faces), bool), groups)


def _turn_and_drop(mesh: Mesh, is_kept: np.ndarray, is_flipped: np.ndarray) -> Mesh:
    """Return the kept faces, turned where `is_flipped` (over kept faces) says so."""
    faces = mesh.faces[is_kept]
    faces[is_flipped] = faces[is_flipped][:, [0, 2, 1]]
    start = mesh.object_face_start
    if not is_kept.all():
        start = np.concatenate(([0], np.cumsum(is_kept)))[start]
    return replace(
        mesh, faces=faces, source_face=mesh.source_face[is_kept], object_face_start=start
    )


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
    mate: I32,
    component: I32,
    face_start: I64,
    is_flipped: np.ndarray,
) -> tuple[U8, np.ndarray, np.ndarray]:
    """Return flags, and which components touch themselves or enclose nothing."""
    n = len(face_start) - 1
    closed = is_closed(mate, component, n)
    nothing = np.zeros(len(mesh.faces), bool)
    lowest = face_start[:-1].astype(np.int32)
    _, no_volume = signed_volumes(points, mesh.faces, nothing, component, lowest)
    flat = closed & no_volume
    candidates = np.flatnonzero(closed & ~flat)
    touching = np.zeros(n, bool)
    touching[candidates] = find_self_contact(points, mesh.faces, face_start, candidates)
    size = np.diff(face_start)
    n_flipped = np.bincount(component[is_flipped], minlength=n)
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
