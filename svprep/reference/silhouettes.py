"""Twin of the silhouette query: every edge record looked at, in plain float64.

Facing, bounds and the choice of the volume are computed here once more, straight
from the cached tables, so that nothing is shared with what is judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from svprep.errors import InternalError
from svprep.model import (
    BOOL,
    F64,
    I8,
    I64,
    NO_INDEX,
    U32,
    ComponentFlag,
    Components,
    EdgeTable,
    Mesh,
    PlaneTable,
)


class Tables(Protocol):
    """The tables that decide a silhouette: of a prepared city or of a cache."""

    @property
    def mesh(self) -> Mesh:
        """Vertices and faces."""

    @property
    def components(self) -> Components:
        """Connected components and their flags."""

    @property
    def planes(self) -> PlaneTable:
        """Plane records."""

    @property
    def edges(self) -> EdgeTable:
        """Edge records."""


class SilhouetteRows(NamedTuple):
    """The edge records of some objects whose multiplicity is not zero."""

    edge: U32
    """``(n,)``: ids of edge records, ascending."""
    multiplicity: I8
    """``(n,)``"""
    object_start: I64
    """``(k + 1,)``: the i-th object asked for has the rows ``start[i]`` to
    ``start[i + 1] - 1``."""


class SilhouetteTwin:
    """The silhouettes of one city for any light, volume and objects.

    Parameters
    ----------
    tables : Tables
        A `Prepared`, or an open cache.

    Notes
    -----
    O(n_faces) once, O(n_planes + n_faces + n_edges) per light.
    """

    __slots__ = ("_bounds", "_left", "_planes", "_right", "_tables")

    def __init__(self, tables: Tables) -> None:
        self._tables = tables
        self._planes = np.ascontiguousarray(tables.planes.planes.T)
        faces = tables.edges.rows[:, 2:].T
        # A missing face is the one after the last.
        self._left, self._right = np.where(faces == NO_INDEX, len(tables.mesh.faces), faces)
        self._bounds = component_bounds(tables.mesh, tables.components)

    def facing(self, light: np.ndarray) -> I8:
        """Return ``(n_faces,)``: +1 lit, -1 turned away, 0 edge-on; by plane record.

        ``light (4,)``: ``(x, y, z, w)`` in the cache frame, rounded to float32.
        """
        x, y, z, w = _rounded(light)
        nx, ny, nz, d = self._planes
        value = ((nx * x + ny * y) + nz * z) + d * w
        sign = (value > 0).astype(np.int8) - (value < 0)
        facing: I8 = sign[self._tables.planes.plane_of_face]
        return facing

    def is_closed(self, light: np.ndarray, volume: str = "auto") -> BOOL:
        """Return ``(n_components,)``: whether each component takes the closed volume.

        ``volume``: ``"closed"`` or ``"robust"`` for all, or ``"auto"``: closed for
        solids, unless the light is a point within their bounds, border included.
        """
        flags = self._tables.components.flags
        if volume in ("closed", "robust"):
            return np.full(len(flags), volume == "closed")
        if volume != "auto":
            raise InternalError(f'no volume "{volume}"; expected auto, closed or robust')
        *point, w = _rounded(light)
        is_solid = (flags & np.uint8(ComponentFlag.SOLID)) > 0
        if w == 0.0:
            return is_solid
        low, high = self._bounds
        is_inside = np.all((low <= point) & (point <= high), axis=1)
        return is_solid & ~is_inside

    def multiplicity(self, light: np.ndarray, volume: str = "auto") -> I8:
        """Return ``(n_edges,)``: m of every edge record, -2 to 2."""
        s = np.append(self.facing(light), np.int8(0))
        left, right = s[self._left], s[self._right]
        robust = left - right
        closed = (left == 1).astype(np.int8) - (right == 1)
        sizes = np.diff(self._tables.components.edge_start)
        is_closed = np.repeat(self.is_closed(light, volume), sizes)
        m: I8 = np.where(is_closed, closed, robust).astype(np.int8)
        return m

    def rows(
        self, light: np.ndarray, volume: str = "auto", objects: Sequence[int] | None = None
    ) -> SilhouetteRows:
        """Return the silhouette of `objects`, of all by default, in ascending order."""
        m = self.multiplicity(light, volume)
        components = self._tables.components
        first_edge = components.edge_start[components.object_start]
        n_objects = len(first_edge) - 1
        wanted = np.zeros(n_objects, bool)
        wanted[np.arange(n_objects) if objects is None else np.array(objects, np.int64)] = True
        is_row = (m != 0) & np.repeat(wanted, np.diff(first_edge))
        before = np.concatenate(([0], np.cumsum(is_row)))
        sizes = np.diff(before[first_edge])[wanted]
        return SilhouetteRows(
            edge=np.flatnonzero(is_row).astype(np.uint32),
            multiplicity=m[is_row],
            object_start=np.concatenate(([0], np.cumsum(sizes))).astype(np.int64),
        )


def component_bounds(mesh: Mesh, components: Components) -> tuple[F64, F64]:
    """Return the lowest and highest corner of each component, ``(n_components, 3)`` [m]."""
    n = len(components.flags)
    of_corner = np.repeat(np.arange(n), 3 * np.diff(components.face_start))
    corners = mesh.positions[mesh.faces.reshape(-1)].astype(np.float64)
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    for axis in range(3):
        np.minimum.at(low[:, axis], of_corner, corners[:, axis])
        np.maximum.at(high[:, axis], of_corner, corners[:, axis])
    return low, high


def _rounded(light: np.ndarray) -> list[float]:
    numbers: list[float] = np.asarray(light, np.float32).astype(np.float64).tolist()
    return numbers
