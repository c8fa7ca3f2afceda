"""Points that lie inside a solid or under the ground, and can never see the sun.

Ground under a building, a wall against its neighbour, a wall that reaches down into the
terrain: a median over them would say nothing. A point is tested where its rays start,
displaced before its face: a party wall pressed against the next house lies inside that
house there.

**Inside a solid.** A solid is closed, wound outward and free of self-intersection, so one
ray tells:

    inside C   <=>   the first face *of C* that a ray in any direction meets
                     is met from behind

       X ----> |  C's back face: inside         X ----> |:::  C's front face: outside

The ray follows the normal of X's side. Among the faces of all bodies, a first hit from
behind on a solid settles it (inside), and so does no hit at all (outside). Any other first
hit is ambiguous: a face of something that itself stands in C, a front face that coincides
with C's back face, a face of no solid. Then X is tested against each solid whose bounds hold
it, among the faces of that solid alone. A shell that is not closed has no inside: its floor
and the ground beneath it count, with the little sun that they get.

**Under the ground.** The first face straight above X is ground of another object, which
counts its upper side: a sheet has no inside, but nothing stands in the open under it.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

import numpy as np

from svprep.cache.reader import Cache
from svprep.hours.kinds import Kind
from svprep.hours.scene import RayStarts
from svprep.hours.surfaces import Surfaces
from svprep.model import BOOL, F32, I32, I64, U8, ComponentFlag, Prepared
from svprep.rays import RAYS_AT_ONCE, Scene, for_batches

_RAYS_OF_A_SOLID = 1 << 20


class Burial(IntEnum):
    """Why a point can never be lit. The numbers stand in PLY files."""

    NONE = 0
    IN_SOLID = 1
    UNDER_GROUND = 2


def burial_of(
    cache: Cache | Prepared,
    scene: Scene,
    surfaces: Surfaces,
    starts: RayStarts,
    on_done: Callable[[int], None],
) -> U8:
    """Return ``(n,) uint8``: the `Burial` of each point.

    Parameters
    ----------
    scene : Scene
        Of all faces of `cache`.
    starts : RayStarts
        The points, displaced to the sides that count.

    Notes
    -----
    Two rays a point, and one a point and solid for the ambiguous ones.
    """
    n = len(starts.face)
    is_inside, is_open = np.zeros(n, bool), np.zeros(n, bool)
    is_under = np.zeros(n, bool)

    def look(begin: int, end: int) -> None:
        start, face = starts.origin[begin:end], starts.face[begin:end]
        towards = surfaces.normal[face].astype(np.float32)
        hit, _ = scene.first_hit(start, towards)
        met = hit >= 0
        is_inside[begin:end] = met & surfaces.is_solid[hit] & _from_behind(surfaces, hit, towards)
        is_open[begin:end] = met & ~is_inside[begin:end]
        above, _ = scene.vertical(start, 1.0)
        is_other = surfaces.object[above] != surfaces.object[face]
        is_under[begin:end] = (above >= 0) & (surfaces.kind[above] == Kind.GROUND) & is_other

    for_batches(n, RAYS_AT_ONCE, look, on_done)
    _settle(cache, scene.device, surfaces, starts, np.flatnonzero(is_open), is_inside)
    burial = np.where(is_under, np.uint8(Burial.UNDER_GROUND), np.uint8(Burial.NONE))
    burial[is_inside] = Burial.IN_SOLID
    return burial


def _from_behind(surfaces: Surfaces, hit: I32 | I64, towards: F32) -> BOOL:
    """Whether a ray meets the face `hit` of a solid from the side of its interior."""
    outward = surfaces.normal[hit]  # of a solid, the outward side is the one that counts
    return np.asarray((outward * towards).sum(axis=1) > 0.0)


def _settle(
    cache: Cache | Prepared,
    device: object,
    surfaces: Surfaces,
    starts: RayStarts,
    points: I64,
    is_inside: BOOL,
) -> None:
    """Test `points` against each solid whose bounds hold them; note those inside."""
    mesh, components = cache.mesh, cache.components
    solids = np.flatnonzero(components.flags & np.uint8(ComponentFlag.SOLID))
    points = points[np.argsort(starts.origin[points, 0], kind="stable")]
    origin, towards = starts.origin[points], surfaces.normal[starts.face[points]].astype(np.float32)
    x = np.ascontiguousarray(origin[:, 0])
    for solid in solids.tolist():
        begin, end = components.face_start[solid], components.face_start[solid + 1]
        used, local = np.unique(mesh.faces[begin:end], return_inverse=True)
        corners = mesh.positions[used]
        low, high = corners.min(axis=0), corners.max(axis=0)
        first, last = np.searchsorted(x, low[0]), np.searchsorted(x, high[0], side="right")
        at = origin[first:last]
        near = first + np.flatnonzero(((at > low) & (at < high)).all(axis=1))
        near = near[~is_inside[points[near]]]
        if len(near) == 0:
            continue
        body = Scene(corners, local.reshape(-1, 3), device)
        for some in np.array_split(near, -(-len(near) // _RAYS_OF_A_SOLID)):
            hit, _ = body.first_hit(origin[some], towards[some])
            behind = _from_behind(surfaces, np.where(hit >= 0, hit + begin, 0), towards[some])
            is_inside[points[some[(hit >= 0) & behind]]] = True
