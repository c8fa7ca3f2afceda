"""What each face is - roof, wall, ground, underside - and which of its sides counts.

A face has two sides; sun is counted on one.

    component    face                            side that counts
    ---------    ----------------------------    ----------------------------------------
    closed       any                             outward: that of its stored winding
    other        steep (|nz| < 0.5)              that of its stored winding
                 level (|nz| >= 0.5)             the upper one, however it is wound: a
                                                 sheet of ground or roof is seen from above
                 level, wound to look down,      the lower one: the bottom plate or the
                 mostly under its own object;    soffit of a shell that is not closed
                 or named a GroundSurface

Every solid is closed; a closed component that cuts itself has been turned outward too. n is
the unit normal of the side that counts: |nz| < 0.5 is steeper than 60 degrees.

    wall         |nz| < 0.5
    underside    nz <= -0.5: bottom plates, soffits; none of the other three
    ground       nz >= 0.5, and its component
                   - has next to no walls: at most 0.1 m2 of wall to 1 m2 that looks up,
                   - and lies on nothing: vertically under most of its area, from 0.5 m
                     below it on, there is no face, save that one stands in a solid
                     there (a building sunk in the ground: no air is beneath). Or it is a
                     closed block on which at least half of the other objects stand: seen
                     from above they lie within its bounds.
    roof         every other face that looks up: roofs, canopies, decks, balconies

A file that says what its surfaces are (RoofSurface, WallSurface, GroundSurface) is believed
before these rules: see `svprep.hours.semantics`. Faces of which it says nothing follow them.

Geometry alone cannot tell everything. A roof that is a sheet of its own, in a model without
ground or bottom plates, is taken for ground; ground that is one connected sheet with
buildings is taken for roof; a deck or a bridge is a roof; a wall sheet that is wound
wrongly counts its other side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.cache.reader import Cache
from svprep.hours.kinds import LEVEL, Kind
from svprep.hours.scene import component_of_faces
from svprep.hours.semantics import UNSTATED, doubted_walls, is_bottom, stated_kinds
from svprep.hours.spread import points_in_faces
from svprep.model import BOOL, F64, I8, I64, U8, ComponentFlag, Mesh, Prepared
from svprep.rays import RAYS_AT_ONCE, Scene, displaced, for_batches

MOST_WALL: Final = 0.1
"""Square metres of wall to a square metre that looks up: at most so much has ground."""
BENEATH_M: Final = 0.5
"""[m]: what lies no deeper under a face is a layer of it: paving, a slab's own bottom."""
_RAY_M2: Final = 100.0
_MOST_RAYS: Final = 64
"""Vertical rays of a face: one per so many square metres, and no more than so many."""
_LARGEST_BLOCKS: Final = 16
"""Half of all objects stand on one of the few largest blocks, or on none."""
_MOST_LAYERS: Final = 8
"""Faces that a ray up from a bottom plate passes in search of one of its own object."""

RULES: Final = (
    "wall: steeper than 60 degrees; underside: looks down; ground: looks up, its component has at "
    f"most {MOST_WALL:g} m2 of wall to 1 m2 looking up and nothing more than {BENEATH_M:g} m "
    "beneath most of it (or is a closed block that half of the objects stand on); roof: else"
)
"""The rules of geometry in one line; those of names are `svprep.hours.semantics`."""
SIDES: Final = (
    "closed components: outward; else walls as wound, level faces the upper side (the lower one if "
    "wound to look down under faces of their own object, or named GroundSurface)"
)
"""Which side counts, in one line."""


@dataclass(frozen=True, slots=True)
class Surfaces:
    """The faces of a city as receivers of sun."""

    normal: F64
    """``(n_faces, 3)``: unit normal of the side that counts."""
    side: I8
    """``(n_faces,)``: +1 where that is the side of the stored winding, else -1."""
    kind: U8
    """``(n_faces,)``: `Kind`."""
    is_stated: BOOL
    """``(n_faces,)``: whether the kind follows from what the file says, not from geometry."""
    area_m2: F64
    """``(n_faces,)`` [m2]."""
    object: I64
    """``(n_faces,)``: of each face."""
    is_solid: BOOL
    """``(n_faces,)``: whether its component is SOLID."""


@dataclass(frozen=True, slots=True)
class _Shape:
    """What the rules need of each face and of each component."""

    mesh: Mesh
    scene: Scene
    offset_m: float
    unit: F64
    """``(n_faces, 3)``: normals of the stored winding."""
    area_m2: F64
    object: I64
    component: I64
    n_components: int
    is_closed: BOOL
    is_solid: BOOL


def surfaces_of(cache: Cache | Prepared, scene: Scene, offset_m: float) -> Surfaces:
    """Return what each face of `cache` is, after the rules at the top of this file.

    Parameters
    ----------
    cache : Cache or Prepared
    scene : Scene
        Of all its faces.
    offset_m : float
        [m]: how far before their faces rays start.

    Notes
    -----
    One vertical ray per 100 m2 of what is level, at least one a face; O(n) else.
    """
    mesh, components = cache.mesh, cache.components
    corners = mesh.positions[mesh.faces].astype(np.float64)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    length = np.sqrt((normal**2).sum(axis=1))
    component = component_of_faces(components.face_start)
    closed = (components.flags & np.uint8(ComponentFlag.CLOSED)) != 0
    solid = (components.flags & np.uint8(ComponentFlag.SOLID)) != 0
    shape = _Shape(
        mesh=mesh,
        scene=scene,
        offset_m=offset_m,
        unit=normal / length[:, None],
        area_m2=length / 2.0,
        object=component_of_faces(mesh.object_face_start),
        component=component,
        n_components=len(components.flags),
        is_closed=closed[component],
        is_solid=solid[component],
    )
    side = _sides(shape, is_bottom(cache.labels))
    counted = shape.unit * side[:, None]
    stated = stated_kinds(cache.labels, shape.object, counted[:, 2])
    source = cache.object_source[shape.object]
    stated[doubted_walls(cache.labels, source, counted[:, 2])] = UNSTATED
    is_stated = stated != UNSTATED
    return Surfaces(
        normal=counted,
        side=side,
        kind=np.where(is_stated, stated, _kinds(shape, counted[:, 2])),
        is_stated=is_stated,
        area_m2=shape.area_m2,
        object=shape.object,
        is_solid=shape.is_solid,
    )


def _sides(shape: _Shape, is_bottom: BOOL) -> I8:
    """Return ``(n_faces,)``: +1 where the side of the stored winding counts, else -1.

    `is_bottom`: the faces that their file names a bottom plate or soffit.
    """
    side = np.ones(len(shape.unit), np.int8)
    is_open = ~shape.is_closed & (np.abs(shape.unit[:, 2]) >= LEVEL)
    side[is_open & is_bottom & (shape.unit[:, 2] > 0.0)] = -1
    down = np.flatnonzero(is_open & ~is_bottom & (shape.unit[:, 2] < 0.0))
    side[down] = np.where(_is_under_its_own(shape, down), 1, -1)
    return side


def _is_under_its_own(shape: _Shape, faces: I64) -> BOOL:
    """Whether most rays up from each face meet another face of its object."""
    rays = _Rays.of(shape, faces)
    is_under, own = np.zeros(len(rays.face), bool), shape.object[rays.face]

    def look(begin: int, end: int) -> None:
        active = np.arange(begin, end)
        origins = displaced(rays.position[active], -shape.unit[rays.face[active]], shape.offset_m)
        for _ in range(_MOST_LAYERS):
            hit, far_m = shape.scene.vertical(origins, 1.0)
            met = hit >= 0
            is_own = met & (shape.object[hit] == own[active])
            is_under[active[is_own]] = True
            on = met & ~is_own
            origins = origins[on]
            origins[:, 2] += far_m[on] + np.float32(shape.offset_m)
            active = active[on]
            if len(active) == 0:
                return

    for_batches(len(rays.face), RAYS_AT_ONCE, look, lambda done: None)
    return rays.is_most(is_under)


@dataclass(frozen=True, slots=True)
class _Rays:
    """Vertical rays from points spread over faces."""

    face: I64
    """``(n_rays,)``"""
    position: F64
    """``(n_rays, 3)`` [m]"""
    start: I64
    """``(n_asked,)``: where the rays of each face that is asked about begin."""

    @classmethod
    def of(cls, shape: _Shape, faces: I64) -> _Rays:
        count = np.clip(np.ceil(shape.area_m2[faces] / _RAY_M2), 1, _MOST_RAYS).astype(np.int64)
        start = np.cumsum(count) - count
        face = np.repeat(faces, count)
        number = np.arange(len(face)) - np.repeat(start, count)
        return cls(face, points_in_faces(shape.mesh, face, number), start)

    def is_most(self, met: BOOL) -> BOOL:
        """Whether more than half of the rays of each face, ``(n_asked,)``, are in `met`."""
        if len(self.start) == 0:
            return np.zeros(0, bool)
        count = np.diff(self.start, append=len(self.face))
        return np.asarray(2 * np.add.reduceat(met.astype(np.int64), self.start) > count)


def _kinds(shape: _Shape, nz: F64) -> U8:
    """Return the `Kind` of each face, ``(n_faces,)``; `nz` is of the side that counts."""
    is_up, is_wall = nz >= LEVEL, np.abs(nz) < LEVEL
    kind = np.where(is_wall, np.uint8(Kind.WALL), np.uint8(Kind.UNDERSIDE))
    on_ground = _is_ground(shape, is_up, is_wall)[shape.component]
    kind[is_up] = np.where(on_ground[is_up], np.uint8(Kind.GROUND), np.uint8(Kind.ROOF))
    return kind


def _is_ground(shape: _Shape, is_up: BOOL, is_wall: BOOL) -> BOOL:
    """Return ``(n_components,)``: whether the faces of each that look up are ground."""

    def area_of(chosen: BOOL) -> F64:
        weight = np.where(chosen, shape.area_m2, 0.0)
        return np.bincount(shape.component, weight, shape.n_components).astype(np.float64)

    up_m2, wall_m2 = area_of(is_up), area_of(is_wall)
    is_flat = (up_m2 > 0.0) & (wall_m2 <= MOST_WALL * up_m2)
    asked = is_up & is_flat[shape.component]
    is_over = np.zeros(len(asked), bool)
    is_over[asked] = _has_air_beneath(shape, np.flatnonzero(asked))
    is_raised = area_of(is_over) > 0.5 * up_m2
    ground = is_flat & ~is_raised
    is_block = is_flat & is_raised
    is_block[shape.component[~shape.is_closed]] = False
    ground[_carrying(shape, np.flatnonzero(is_block))] = True
    return ground


def _has_air_beneath(shape: _Shape, faces: I64) -> BOOL:
    """Whether most rays down, from `BENEATH_M` below each face on, meet a face.

    One that they meet from within a solid other than the face's own does not count: what is
    beneath is then the inside of a body, not air.
    """
    rays = _Rays.of(shape, faces)
    met = np.zeros(len(rays.face), bool)

    def look(begin: int, end: int) -> None:
        own = rays.face[begin:end]
        start = rays.position[begin:end] - np.array([0.0, 0.0, BENEATH_M])
        hit, _ = shape.scene.vertical(start.astype(np.float32), -1.0)
        leaves = shape.is_solid[hit] & (shape.unit[hit, 2] < 0.0)
        is_own = shape.component[hit] == shape.component[own]
        met[begin:end] = (hit >= 0) & (is_own | ~leaves)

    for_batches(len(rays.face), RAYS_AT_ONCE, look, lambda done: None)
    return rays.is_most(met)


def _carrying(shape: _Shape, blocks: I64) -> I64:
    """Return those of `blocks` (components) on which half of the other objects stand."""
    mesh = shape.mesh
    if len(blocks) == 0 or len(mesh.object_face_start) < 3:
        return blocks[:0]
    low, high = _bounds(mesh, shape.object, len(mesh.object_face_start) - 1)
    block_low, block_high = _bounds(mesh, shape.component, shape.n_components)
    size = np.prod(block_high[blocks] - block_low[blocks], axis=1)
    carrying = []
    for block in blocks[np.argsort(-size, kind="stable")][:_LARGEST_BLOCKS].tolist():
        # NaN, of an object without faces, is on nothing.
        stands = ((low >= block_low[block]) & (high <= block_high[block])).all(axis=1)
        own = int(shape.object[np.searchsorted(shape.component, block)])
        stands[own] = False
        n_others = int(np.count_nonzero(np.isfinite(low[:, 0]))) - 1
        if n_others and 2 * int(np.count_nonzero(stands)) >= n_others:
            carrying.append(block)
    return np.array(carrying, np.int64)


def _bounds(mesh: Mesh, group: I64, n_groups: int) -> tuple[F64, F64]:
    """Return the lowest and highest x, y of each group of faces, NaN for one without."""
    low, high = np.full((n_groups, 2), np.nan), np.full((n_groups, 2), np.nan)
    if len(group) == 0:
        return low, high
    starts = np.flatnonzero(np.concatenate(([True], group[1:] != group[:-1])))
    corners = mesh.positions[mesh.faces][:, :, :2]
    low[group[starts]] = np.minimum.reduceat(corners.min(axis=1), starts)
    high[group[starts]] = np.maximum.reduceat(corners.max(axis=1), starts)
    return low, high
