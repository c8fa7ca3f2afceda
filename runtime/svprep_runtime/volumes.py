"""Which triangles make up the shadow volumes of one light: lists of entries, no geometry.

A volume is drawn from *entries*, two uint32 each, that shaders turn into triangles:

    side    (edge record, highest bit where m > 0; segment)      |m| times
    cap     (face; segment)                                      each face that counts

A *segment* is a part of a volume between two planes (`svprep.model.ClampTable`), or, of a
light that is not clamped, the whole of it: from the caster itself to infinity.

              near cap: as it is (first segment), or projected
             +--------+
        side |        | side
             +--------+
              far cap: projected, or at infinity (a point for directional lights)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from svprep.facing import facing
from svprep.model import BOOL, F32, I8, I64, NO_INDEX, U32, EdgeTable, Mesh, Prepared
from svprep.silhouette.query import silhouette
from svprep.silhouette.volumes import closed_volume_allowed, component_bounds

if TYPE_CHECKING:
    from collections.abc import Callable

    from svprep.cache.reader import Cache

ENDLESS: Final = np.float32(1e38)
"""Stands for infinity in segments; -ENDLESS at the near end: at the caster itself."""
SIGN_BIT: Final = np.uint32(0x80000000)
_SLOPE_UNIT: Final = 1.0 / 512.0
_WHOLE: Final = (-ENDLESS, ENDLESS, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class CastersOf:
    """What one light makes of the faces and edges of a cache."""

    light: F32
    """``(4,)``: cache frame."""
    facing: I8
    """``(n_faces,)``: +1, -1 or 0, of each face's plane record."""
    is_closed: BOOL
    """``(n_components,)``: takes the closed volume."""
    counts: BOOL
    """``(n_faces,)``: casts: all but edge-on faces, in closed volumes only lit ones."""
    edge: U32
    """``(n,)``: silhouette records, ascending."""
    multiplicity: I8
    """``(n,)``"""
    component_of_edge: I64
    """``(n,)``: of each silhouette record."""
    component_of_face: I64
    """``(n_faces,)``"""


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """The segments of every component for one light."""

    start: I64
    """``(n_components + 1,)``"""
    table: F32
    """``(n_segments + 1, 4)``: near, far (`ENDLESS` for none), slopes along u and v; the
    last row is the whole of any volume."""
    frame: F32
    """``(3, 3)``: rows u, v, t of the light frame; zero where nothing is clamped."""
    is_clamped: bool

    @property
    def whole(self) -> int:
        """The segment that is the whole of a volume."""
        return len(self.table) - 1


@dataclass(frozen=True, slots=True, eq=False)
class VolumeLists:
    """Entries of the volumes of some components, by how they are drawn.

    Caps come as (of faces turned to the light, of faces turned away): the second are
    drawn with the other orientation.
    """

    sides_to_point: U32
    """``(n, 2)``: sides to the common point at infinity of a directional light."""
    sides: U32
    """``(n, 2)``: quads"""
    light_caps: tuple[U32, U32]
    """Of first segments: the faces themselves."""
    near_caps: tuple[U32, U32]
    """Of later segments."""
    far_caps: tuple[U32, U32]
    """Of segments with an end."""
    endless_caps: tuple[U32, U32]
    """Of segments without one; none for a directional light, whose are one point."""

    @property
    def n_triangles(self) -> int:
        """All that may be drawn."""
        caps = (*self.light_caps, *self.near_caps, *self.far_caps, *self.endless_caps)
        return len(self.sides_to_point) + 2 * len(self.sides) + sum(map(len, caps))


def casters_of(cache: Cache | Prepared, light: F32) -> CastersOf:
    """Return which faces and edges cast, and by which volume. O(faces + edges)."""
    parts, planes = cache.components, cache.planes
    of_plane = facing(planes.planes, light)
    of_face = of_plane[planes.plane_of_face]
    bounds = (light[:0], light[:0]) if light[3] == 0.0 else component_bounds(cache.mesh, parts)
    is_closed = closed_volume_allowed(parts, bounds, light)
    component_of_face = np.repeat(np.arange(len(parts.flags)), np.diff(parts.face_start))
    found = silhouette(cache, light)
    return CastersOf(
        light=light,
        facing=of_face,
        is_closed=is_closed,
        counts=(of_face > 0) | ((of_face < 0) & ~is_closed[component_of_face]),
        edge=found.edge,
        multiplicity=found.multiplicity,
        component_of_edge=np.searchsorted(parts.edge_start, found.edge, "right") - 1,
        component_of_face=component_of_face,
    )


def segments_of(cache: Cache | Prepared, light: F32, *, clamped: bool) -> Segments:
    """Return the cached segments of a light; whole volumes if there are none for it.

    A light is known by its four numbers, rounded to float32.
    """
    n_components = len(cache.components.flags)
    found = np.flatnonzero((cache.clamp.lights == light).all(axis=1))
    if not clamped or not len(found):
        return Segments(
            start=np.arange(n_components + 1),
            table=np.array([_WHOLE], np.float32),
            frame=np.zeros((3, 3), np.float32),
            is_clamped=False,
        )
    table, i = cache.clamp, int(found[0])
    rows = slice(int(table.light_start[i]), int(table.light_start[i + 1]))
    start = table.segment_start[i].astype(np.int64)
    segments = np.empty((rows.stop - rows.start + 1, 4), np.float32)
    segments[:-1, :2] = np.clip(table.depths[rows], -ENDLESS, ENDLESS)
    segments[:-1, 2:] = table.slopes[rows] * np.float32(_SLOPE_UNIT)
    segments[-1] = _WHOLE
    segments[start[:-1][np.diff(start) > 0], 0] = -ENDLESS
    return Segments(
        start=start, table=segments, frame=table.frames[i].astype(np.float32), is_clamped=True
    )


def volume_lists(
    casters: CastersOf, segments: Segments, chosen: BOOL | None = None, *, whole: bool = False
) -> VolumeLists:
    """Return the entries of the volumes of the components that are `chosen` (all if None).

    `whole`: as if nothing were clamped.
    """
    is_directional = casters.light[3] == 0.0
    is_side = slice(None) if chosen is None else chosen[casters.component_of_edge]
    m = casters.multiplicity[is_side]
    edge = casters.edge[is_side] | np.where(m > 0, SIGN_BIT, np.uint32(0))
    times = np.abs(m).astype(np.int64)
    sides = _entries(
        np.repeat(edge, times),
        np.repeat(casters.component_of_edge[is_side], times),
        segments,
        whole=whole,
    )
    is_endless = segments.table[:, 1] >= ENDLESS
    to_point = is_endless[sides[:, 1]] & is_directional
    caps = face_entries(casters, segments, chosen, whole=whole)
    is_first = segments.table[:, 0] <= -ENDLESS
    none = np.zeros((0, 2), np.uint32)
    return VolumeLists(
        sides_to_point=sides[to_point],
        sides=sides[~to_point],
        light_caps=_both(caps, lambda c: is_first[c[:, 1]]),
        near_caps=_both(caps, lambda c: ~is_first[c[:, 1]]),
        far_caps=_both(caps, lambda c: ~is_endless[c[:, 1]]),
        endless_caps=(none, none) if is_directional else _both(caps, lambda c: is_endless[c[:, 1]]),
    )


def face_entries(
    casters: CastersOf, segments: Segments, chosen: BOOL | None = None, *, whole: bool = False
) -> tuple[U32, U32]:
    """Return each face that counts with its segments: faces turned to the light, then away."""
    casts = casters.counts if chosen is None else casters.counts & chosen[casters.component_of_face]
    towards, away = (
        np.flatnonzero(casts & (casters.facing == sign)).astype(np.uint32) for sign in (1, -1)
    )
    return (
        _entries(towards, casters.component_of_face[towards], segments, whole=whole),
        _entries(away, casters.component_of_face[away], segments, whole=whole),
    )


def _both(caps: tuple[U32, U32], belongs: Callable[[U32], BOOL]) -> tuple[U32, U32]:
    return caps[0][belongs(caps[0])], caps[1][belongs(caps[1])]


def _entries(item: U32, component: I64, segments: Segments, *, whole: bool) -> U32:
    """Return ``(n, 2)``: each item with each segment of its component."""
    if whole or not segments.is_clamped:
        return np.stack([item, np.full(len(item), segments.whole, np.uint32)], axis=1)
    count = np.diff(segments.start)[component]
    first = segments.start[component]
    n = int(count.sum())
    nth = np.arange(n) - np.repeat(np.cumsum(count) - count, count)
    return np.stack(
        [np.repeat(item, count), (np.repeat(first, count) + nth).astype(np.uint32)], axis=1
    )


def edge_vertices(edges: EdgeTable) -> U32:
    """Return ``(n_edges, 2) uint32``: the vertices of edge records, for upload."""
    return np.ascontiguousarray(edges.rows[:, :2])


def face_neighbours(mesh: Mesh, edges: EdgeTable) -> U32:
    """Return ``(n_faces, 3) uint32``: the face beyond side k, corner k to k + 1, of each face.

    Beyond: the other face of the edge record, `NO_INDEX` where it has none. O(edges).
    """
    beyond = np.full((len(mesh.faces), 3), NO_INDEX, np.uint32)
    low, high, left, right = edges.rows.T
    for face, other, begin, end in ((left, right, low, high), (right, left, high, low)):
        there = np.flatnonzero(face != NO_INDEX)
        corners = mesh.faces[face[there]]
        for k in range(3):
            is_side = (corners[:, k] == begin[there]) & (corners[:, (k + 1) % 3] == end[there])
            rows = there[is_side]
            beyond[face[rows], k] = other[rows]
    return beyond
