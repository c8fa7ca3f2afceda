"""What every query reads, derived once from a cache: plain arrays, read-only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from svprep.errors import CacheError
from svprep.kernels.face_walks import record_of_sides, scan_tables
from svprep.model import (
    F32,
    F64,
    I8,
    I64,
    NO_INDEX,
    U32,
    U64,
    ComponentFlag,
    Components,
    EdgeFlag,
    Mesh,
    PlaneTable,
    Prepared,
)
from svprep.silhouette.volumes import component_bounds

if TYPE_CHECKING:
    from svprep.cache.reader import Cache


def contradiction(what: str) -> CacheError:
    """Return the error for tables that no build makes: kernels would go astray on them."""
    return CacheError(
        f"the tables of the cache contradict each other: {what}. Look closer with "
        "svprep validate CACHE, and build it again"
    )


def check_starts(name: str, start: I64, end: int) -> None:
    """Raise `CacheError` unless offsets rise from 0 to `end`."""
    if not len(start) or start[0] != 0 or start[-1] != end or (np.diff(start) < 0).any():
        raise contradiction(f"{name} does not rise from 0 to {end}")


def check_mesh(mesh: Mesh, components: Components) -> None:
    """Raise `CacheError` where a loop over faces of components would go astray. O(n)."""
    n_faces = len(mesh.faces)
    check_starts("objects/component_start", components.object_start, len(components.flags))
    check_starts("objects/face_start", mesh.object_face_start, n_faces)
    check_starts("components/face_start", components.face_start, n_faces)
    if (np.diff(components.face_start) == 0).any():
        raise contradiction("a component has no face")
    if n_faces and int(mesh.faces.max()) >= len(mesh.positions):
        raise contradiction("a face has a corner that is not there")
    if not np.isfinite(mesh.positions).all():
        raise contradiction("a position is not finite")


def check_plane_of_face(planes: PlaneTable, n_faces: int) -> None:
    """Raise `CacheError` unless every face has a plane record."""
    plane_of_face = planes.plane_of_face
    if len(plane_of_face) != n_faces or (
        n_faces and int(plane_of_face.max()) >= len(planes.planes)
    ):
        raise contradiction("a face has a plane record that is not there")


def _check_offsets(source: Cache | Prepared) -> None:
    """Raise `CacheError` where a kernel would read or write beyond an array. O(n)."""
    parts, mesh, n_edges = source.components, source.mesh, len(source.edges.rows)
    n_faces = len(mesh.faces)
    check_starts("objects/component_start", parts.object_start, len(parts.flags))
    check_starts("objects/face_start", mesh.object_face_start, n_faces)
    check_starts("components/face_start", parts.face_start, n_faces)
    check_starts("components/edge_start", parts.edge_start, n_edges)
    if (np.diff(parts.face_start) == 0).any():
        raise contradiction("a component has no face")
    check_plane_of_face(source.planes, n_faces)
    if len(source.edges.flags) != n_edges:
        raise contradiction("there are more edge records than flags, or fewer")


BLOCK = 1 << 15
"""Rows per step of loops over planes: keeps their scratch in the CPU's cache."""


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view: kernels are compiled for such, and for no other."""
    view = array.view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, slots=True)
class Solids:
    """The components that may take the closed volume, and their bounds."""

    object_start: I64
    """``(n_objects + 1,)``: solids of each object."""
    plane_begin: I64
    """``(n_solids,)``: each one's plane records."""
    plane_end: I64
    low: F32
    """``(3, n_solids)`` [m]: lowest coordinates."""
    high: F32


class SearchTables:
    """What queries on one cache share. All arrays are read-only.

    Attributes
    ----------
    planes : ndarray
        ``(n_planes, 4) float64``
    plane_start : ndarray
        ``(n_objects + 1,) int64``: each object's plane records follow each other.
    floor : ndarray
        ``(n_planes + 1,) int8``: 0 for records of solids, else -1. With
        ``s = max(facing, floor)`` a record's multiplicity is ``s_left - s_right``
        in either volume. The last stands for a missing face.
    units : ndarray
        ``(4, n_planes) float32``: the planes, divided by their normals' lengths.
    record, sides : ndarray
        ``(n,) uint32``, ``(n,) uint64``: records that are not planar, ascending; the
        plane record on the left and, times 2^32, that on the right (``n_planes``
        for a missing face).
    begin : ndarray
        ``(n_objects + 1,) int64``: where each object's begin in `record`.
    """

    def __init__(self, source: Cache | Prepared) -> None:
        parts, edges = source.components, source.edges
        self.mesh, self.components, self.edges = source.mesh, parts, edges
        _check_offsets(source)
        self.index = source.index
        self.plane_of_face: U32 = read_only(source.planes.plane_of_face)
        self.planes: F64 = read_only(source.planes.planes)
        self.object_edge: I64 = read_only(parts.edge_start[parts.object_start])
        n_planes = len(self.planes)
        # Plane records are numbered by their lowest face, faces sorted by component.
        component_plane = np.append(self.plane_of_face.take(parts.face_start[:-1]), n_planes)
        component_plane = component_plane.astype(np.int64)
        if component_plane[0] != 0 or (np.diff(component_plane) <= 0).any():
            raise contradiction("plane records are not numbered by their lowest face")
        self.plane_start: I64 = read_only(component_plane[parts.object_start])
        self._component_plane = component_plane
        is_solid = (parts.flags & np.uint8(ComponentFlag.SOLID)) != 0
        floor = np.repeat(is_solid.astype(np.int8) - np.int8(1), np.diff(component_plane))
        self.floor: I8 = read_only(np.append(floor, np.int8(-1)))
        self.units: F32 = read_only(_unit_planes(self.planes))
        self._flat_tables()

    def sides_of(self, position: NDArray[Any]) -> U32:
        """Return ``(k, 2)``: the plane records beside the records at `position`."""
        sides = self.sides.take(position)
        return np.stack([sides & np.uint64(0xFFFFFFFF), sides >> np.uint64(32)], axis=1).astype(
            np.uint32
        )

    def _flat_tables(self) -> None:
        is_searched = (self.edges.flags & np.uint8(EdgeFlag.PLANAR)) == 0
        n = int(np.count_nonzero(is_searched))
        record, sides = np.empty(n, np.uint32), np.empty(n, np.uint64)
        begin = np.empty(len(self.object_edge), np.int64)
        scan_tables(
            read_only(self.edges.rows),
            read_only(is_searched),
            self.plane_of_face,
            len(self.planes),
            self.object_edge,
            record,
            sides,
            begin,
        )
        self.record: U32 = read_only(record)
        self.sides: U64 = read_only(sides)
        self.begin: I64 = read_only(begin)

    @property
    def n_objects(self) -> int:
        """Objects."""
        return len(self.object_edge) - 1

    @cached_property
    def solids(self) -> Solids:
        """Bounds of solids: only point lights ask for them."""
        parts = self.components
        chosen = np.flatnonzero(parts.flags & np.uint8(ComponentFlag.SOLID))
        low, high = component_bounds(self.mesh, parts)
        return Solids(
            object_start=np.searchsorted(chosen, parts.object_start),
            plane_begin=self._component_plane[chosen],
            plane_end=self._component_plane[chosen + 1],
            low=np.ascontiguousarray(low[chosen].T),
            high=np.ascontiguousarray(high[chosen].T),
        )

    @cached_property
    def record_of_sides(self) -> U32:
        """``(3 n_faces,)``: the edge record of each side of each face."""
        record = np.empty(3 * len(self.mesh.faces), np.uint32)
        record[:] = NO_INDEX
        record_of_sides(read_only(self.edges.rows), read_only(self.mesh.faces), record)
        n_sides = 3 * np.diff(self.mesh.object_face_start)
        low, high = (np.repeat(self.object_edge[k:][: len(n_sides)], n_sides) for k in (0, 1))
        if ((record < low) | (record >= high)).any():
            raise contradiction("a side of a face is in no edge record of its object")
        return read_only(record)

    def solids_around(self, light: F32, objects: I64 | None) -> I64:
        """Return the solids whose bounds hold a point light: they cast robust volumes."""
        s = self.solids
        if objects is None:
            among: Any = slice(None)
            numbers = None
        else:
            numbers = ranges(s.object_start[objects], s.object_start[objects + 1])
            among = numbers
        inside = np.True_
        for axis in range(3):
            inside = inside & (s.low[axis][among] <= light[axis])
            inside &= light[axis] <= s.high[axis][among]
        found = np.flatnonzero(inside)
        return found if numbers is None else numbers[found]


def _unit_planes(planes: F64) -> F32:
    units = np.empty((4, len(planes)), np.float32)
    for start in range(0, len(planes), BLOCK):
        block = planes[start : start + BLOCK].T
        length = np.sqrt(block[0] ** 2 + block[1] ** 2 + block[2] ** 2)
        np.divide(block, length, out=units[:, start : start + BLOCK], casting="same_kind")
    return units


def ranges(begin: I64, end: I64) -> I64:
    """Return the numbers of all ranges ``begin[i] .. end[i] - 1``, one after another."""
    lengths = end - begin
    first = np.cumsum(lengths) - lengths
    return np.repeat(begin - first, lengths) + np.arange(int(lengths.sum()))
