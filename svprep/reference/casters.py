"""Which faces lie between points of surfaces and a light, found with rays.

    X . - - - - - o - - - - - o - - - - > light
    a point       a pair      a pair
    of a surface  (X, face)   (X, face)

Clamping is conservative iff for every such pair X lies in a segment of the face's
component. Rays know nothing of boxes, clusters and slabs, so they share no mistake with
what they judge. They are Embree's (package embreex, in its robust mode), in float32; what
clamping is padded by is more than these round.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.errors import require_extra
from svprep.model import BOOL, F32, F64, I64, ClampTable, Components, Mesh

MOST_HITS: Final = 512
"""Of one ray, each as often as it is met; rays that are not at their end by then are counted
in `Between.n_cut_off`."""
LEAST_OFFSET_M: Final = 1e-3
OFFSET_ULPS: Final = 4.0
"""Of float32, at the model's farthest coordinate."""
_SLOPE_UNIT: Final = 1.0 / 512.0


@dataclass(frozen=True, slots=True)
class Between:
    """Pairs of a point and a face between it and the light, sorted by (point, distance).

    Each pair is there once.
    """

    point: I64
    """``(n,)``: row of the point."""
    face: I64
    """``(n,)``"""
    component: I64
    """``(n,)``: the face's component, the caster."""
    distance_m: F64
    """``(n,)`` [m]: from the point to the face, along the ray."""
    n_cut_off: int
    """Rays that had `MOST_HITS` hits and may have more: 0, or some pairs are missing."""


class CasterRays:
    """The faces of one mesh, ready for rays.

    Parameters
    ----------
    mesh, components
        Of a prepared city.

    Raises
    ------
    EnvironmentProblem
        The package embreex is missing.
    """

    __slots__ = ("_component_of_face", "_scene", "offset_m")

    offset_m: float
    """[m]: how far from its point a ray starts, behind each hit it goes on, and from a point
    light it ends; what lies within is not found. A ray in the plane of a face meets it again
    and again: each time it is met at once, the step doubles."""

    def __init__(self, mesh: Mesh, components: Components) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError:
            raise require_extra("embreex", "judge", "tracing rays to the light") from None
        self._scene = EmbreeScene(robust=True)
        if len(mesh.faces):
            TriangleMesh(self._scene, mesh.positions.take(mesh.faces, axis=0))
        self._component_of_face = np.repeat(
            np.arange(len(components.flags)), np.diff(components.face_start)
        )
        farthest = float(np.abs(mesh.positions).max(initial=0.0))
        self.offset_m = max(LEAST_OFFSET_M, OFFSET_ULPS * float(np.spacing(np.float32(farthest))))

    def between(self, points: F64, light: F32) -> Between:
        """Return every face between each of `points` ``(n, 3) [m]`` and a light ``(4,)``.

        Both are in the cache frame. Points need not lie on faces. O((n + hits) log faces).
        """
        towards, length = _towards(points, light)
        active = np.flatnonzero(length > 2.0 * self.offset_m)
        if not len(self._component_of_face):
            active = active[:0]
        at = np.full(len(points), self.offset_m)
        step = at.copy()
        found: list[tuple[I64, I64, F64]] = []
        for _ in range(MOST_HITS):
            if not len(active):
                break
            starts = points[active] + towards[active] * at[active, None]
            hits = self._scene.run(
                np.ascontiguousarray(starts, np.float32),
                np.ascontiguousarray(towards[active], np.float32),
                dists=np.full(len(active), 1e30, np.float32),
                query="INTERSECT",
                output=True,
            )
            ahead = hits["tfar"].astype(np.float64)
            step[active] = np.where(ahead < self.offset_m, 2.0 * step[active], self.offset_m)
            distance = at[active] + ahead
            is_between = (hits["primID"] >= 0) & (distance < length[active] - self.offset_m)
            active, distance = active[is_between], distance[is_between]
            found.append((active, hits["primID"][is_between].astype(np.int64), distance))
            at[active] = distance + step[active]
        none = np.zeros(0, np.int64)
        point = np.concatenate([none, *(pairs[0] for pairs in found)])
        face = np.concatenate([none, *(pairs[1] for pairs in found)])
        distance_m = np.concatenate([np.zeros(0), *(pairs[2] for pairs in found)])
        _, first = np.unique(point * len(self._component_of_face) + face, return_index=True)
        chosen = first[np.lexsort((distance_m[first], point[first]))]
        return Between(
            point=point[chosen],
            face=face[chosen],
            component=self._component_of_face[face[chosen]],
            distance_m=distance_m[chosen],
            n_cut_off=len(active),
        )


def casters_between(mesh: Mesh, components: Components, points: F64, light: F32) -> Between:
    """Return every face between each of `points` and a light; `CasterRays` for many lights.

    Parameters
    ----------
    points : ndarray
        ``(n, 3) float64`` [m], in the cache frame.
    light : ndarray
        ``(4,) float32``, in the cache frame.
    """
    return CasterRays(mesh, components).between(points, light)


def outside_segments(table: ClampTable, light_index: int, points: F64, between: Between) -> BOOL:
    """Return which pairs lie in none of their caster's segments: ``(n_pairs,) bool``.

    Straight from the definition of `ClampTable`, in float64 and without any tolerance.

    Parameters
    ----------
    points : ndarray
        ``(n, 3) float64`` [m]: those that `between` was found for.
    """
    light = table.lights[light_index].astype(np.float64)
    x = points[between.point]
    if light[3] != 0.0:
        length = np.linalg.norm(light[:3] - x, axis=1)
        across = np.zeros((len(x), 2))
        depth = length / (length - between.distance_m)
    else:
        placed = x @ table.frames[light_index].T
        across, depth = placed[:, :2], placed[:, 2]
    start = table.segment_start[light_index].astype(np.int64) + table.light_start[light_index]
    first, end = start[between.component], start[between.component + 1]
    is_outside = np.ones(len(x), np.bool_)
    for nth in range(int((end - first).max(initial=0))):
        rows = np.flatnonzero(first + nth < end)
        segment = first[rows] + nth
        slopes = table.slopes[segment].astype(np.float64) * _SLOPE_UNIT
        value = depth[rows] - (slopes * across[rows]).sum(axis=1)
        near, far = table.depths[segment].astype(np.float64).T
        # The first segment begins at the caster itself, and the point lies behind that.
        is_in = (value <= far) & ((value >= near) | (nth == 0))
        is_outside[rows[is_in]] = False
    return is_outside


def segments_before_caster(
    table: ClampTable, light_index: int, mesh: Mesh, components: Components
) -> I64:
    """Return the segments of a light, but first ones, that begin before their caster.

    Their cap towards the light would lie between the caster and the light somewhere. Rows
    count from the light's first segment. Straight from the definition of `ClampTable`.
    """
    start = table.segment_start[light_index].astype(np.int64)
    first, last = table.light_start[light_index], table.light_start[light_index + 1]
    depths = table.depths[first:last].astype(np.float64)
    later = np.ones(len(depths), np.bool_)
    later[start[:-1]] = False
    rows = np.flatnonzero(later)
    if table.lights[light_index, 3] != 0.0:
        return rows[depths[rows, 0] < 1.0]
    owner = np.repeat(np.arange(len(start) - 1), np.diff(start))[rows]
    n_faces = np.diff(components.face_start)[owner]
    begin = np.repeat(components.face_start[owner] - (np.cumsum(n_faces) - n_faces), n_faces)
    row = np.repeat(np.arange(len(rows)), n_faces)
    corners = mesh.positions[mesh.faces[begin + np.arange(len(row))]].astype(np.float64)
    u, v, t = np.moveaxis(corners @ table.frames[light_index].T, 2, 0)
    slopes = table.slopes[first:last][rows].astype(np.float64) * _SLOPE_UNIT
    depth = t - slopes[row, :1] * u - slopes[row, 1:] * v
    is_early = (depth > depths[rows[row], :1]).any(axis=1)
    return rows[np.unique(row[is_early])]


def surface_points(mesh: Mesh, n: int, rng: np.random.Generator) -> F64:
    """Return n random points of faces, evenly by area: ``(n, 3) float64`` [m], cache frame."""
    if not len(mesh.faces):
        return np.zeros((0, 3))
    corners = mesh.positions.take(mesh.faces, axis=0).astype(np.float64)
    sides = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    face = rng.choice(len(area), n, p=area / area.sum())
    share = rng.random((n, 2))
    share = np.where(share.sum(axis=1, keepdims=True) > 1.0, 1.0 - share, share)
    return corners[face, 0] + np.einsum("ij,ijk->ik", share, sides[face])


def _towards(points: F64, light: F32) -> tuple[F64, F64]:
    """Return unit vectors from points to a light, and how far away it is (infinity)."""
    vector = light.astype(np.float64)
    if vector[3] == 0.0:
        towards = np.broadcast_to(vector[:3] / np.linalg.norm(vector[:3]), points.shape)
        return towards, np.full(len(points), np.inf)
    away = vector[:3] - points
    length = np.linalg.norm(away, axis=1)
    return away / np.where(length > 0.0, length, 1.0)[:, None], length
