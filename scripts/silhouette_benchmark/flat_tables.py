"""What both flat baselines read: the searched records, contiguous and ready.

Made once per dataset, outside all timing, as the product's own tables are. The
closed volume costs a flat scan nothing: clamping the facing of a solid's planes to
0 or more makes ``left - right`` its multiplicity, so a floor per plane (0 closed,
-1 robust) is all a scan needs to know. It changes only for a solid that the light
is inside of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from svprep.cache.reader import Cache
from svprep.model import F32, F64, I8, I64, U32, ComponentFlag, EdgeFlag
from svprep.silhouette.volumes import component_bounds


class Found(NamedTuple):
    """A baseline's answer; equal to the fields of the same name of a `Silhouette`."""

    edge: U32
    multiplicity: I8
    object_start: I64


@dataclass(frozen=True, slots=True)
class FlatTables:
    """The records that can be a silhouette, each with the planes of its two faces."""

    planes: tuple[F64, F64, F64, F64]
    """nx, ny, nz, d, ``(n_planes,)`` each: a directional light never reads d."""
    floor: I8
    """``(n_planes,)``: the least facing that counts, 0 on solids, -1 elsewhere."""
    left: U32
    """``(n,)``: plane of the left face; n_planes, whose facing is 0, for none."""
    right: U32
    """``(n,)``: the same for the right face."""
    edge: U32
    """``(n,)``: the record's id, ascending."""
    object_start: I64
    """``(n_objects + 1,)``: first record of each object."""
    object_plane_start: I64
    """``(n_objects + 1,)``: first plane of each object."""
    solid_low: F32
    """``(n_solids, 3)`` [m]"""
    solid_high: F32
    """``(n_solids, 3)`` [m]"""
    solid_plane_start: I64
    """``(n_solids, 2)``: planes of each solid, first and one past the last."""
    n_records: int
    """All edge records, planar ones included."""
    n_single: int
    """Searched records with one face."""

    @property
    def n_planes(self) -> int:
        """Plane records."""
        return len(self.floor)

    @property
    def bytes_read(self) -> int:
        """What any flat scan must read: 32 B a plane, 4 B per face of a searched record."""
        return 32 * self.n_planes + 4 * (2 * len(self.edge) - self.n_single)


def flat_tables(cache: Cache) -> FlatTables:
    """Return the tables of a cache."""
    components, rows = cache.components, cache.edges.rows
    n_planes, n_faces = cache.n_planes, cache.n_faces
    searched = np.flatnonzero((cache.edges.flags & np.uint8(EdgeFlag.PLANAR)) == 0)
    plane_of_face = np.append(cache.planes.plane_of_face, np.uint32(n_planes))
    left, right = (plane_of_face[np.minimum(rows[searched, column], n_faces)] for column in (2, 3))
    plane_start = _plane_start(cache)
    is_solid = (components.flags & np.uint8(ComponentFlag.SOLID)) != 0
    solids = np.flatnonzero(is_solid)
    low, high = component_bounds(cache.mesh, components)
    first_record = components.edge_start[components.object_start]
    return FlatTables(
        planes=_columns(cache.planes.planes),
        floor=np.repeat(np.where(is_solid, 0, -1).astype(np.int8), np.diff(plane_start)),
        left=left,
        right=right,
        edge=searched.astype(np.uint32),
        object_start=np.searchsorted(searched, first_record).astype(np.int64),
        object_plane_start=plane_start[components.object_start],
        solid_low=low[solids],
        solid_high=high[solids],
        solid_plane_start=np.stack([plane_start[solids], plane_start[solids + 1]], axis=1),
        n_records=len(rows),
        n_single=int(np.count_nonzero((left == n_planes) | (right == n_planes))),
    )


def _columns(planes: F64) -> tuple[F64, F64, F64, F64]:
    """Return nx, ny, nz and d, each contiguous."""
    x, y, z, d = (np.ascontiguousarray(planes[:, column]) for column in range(4))
    return x, y, z, d


def _plane_start(cache: Cache) -> I64:
    """Return ``(n_components + 1,)``: first plane of each component.

    Planes are numbered by their lowest face and spread over paired edges only, so
    each belongs to one component, and they are grouped by it.
    """
    component_of_face = np.repeat(
        np.arange(cache.n_components), np.diff(cache.components.face_start)
    )
    component = np.empty(cache.n_planes, np.int64)
    component[cache.planes.plane_of_face] = component_of_face
    assert (component[cache.planes.plane_of_face] == component_of_face).all()
    assert (np.diff(component) >= 0).all()
    return np.searchsorted(component, np.arange(cache.n_components + 1)).astype(np.int64)
