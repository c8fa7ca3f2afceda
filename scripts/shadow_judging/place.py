"""A model as somebody who stands in it finds it: which way is up, where the middle is.

    level frame     east, north, up: of the model's own ground, which is the x-y plane unless
                    the model lies on its side or was cut from a globe
    middle          the median of its surface, or where more of it is, if that is sparse
    reach           how far around the middle views look: `REACH_M`, or half a smaller model

All lengths scale down with models smaller than a street, so that a cube of one metre has
views, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.model import BOOL, F32, F64, I32, Mesh
from svprep.rays import Scene

EYE_M: Final = 1.7
REACH_M: Final = 120.0
_EYE_OF_EXTENT: Final = 0.08
"""An eye is no higher above the ground than this part of the model's largest extent."""
_FLAT: Final = 0.5
"""A model whose thinnest axis is thinner than this, in units of the next one, lies along it."""
_UPRIGHT: Final = math.cos(math.radians(20.0))


@dataclass(frozen=True, slots=True)
class Place:
    """A model's rays, and its level frame."""

    scene: Scene
    normals: F64
    """``(n_faces, 3)``, unit; any where a face has no area."""
    axes: F64
    """``(3, 3)``: east, north and up, rows; of the cache frame."""
    middle: F64
    """``(3,)`` [m], level frame; on the ground."""
    low: F64
    """``(3,)`` [m], level frame: the model's bounds."""
    high: F64
    eye_m: float
    """Of a person above the ground."""
    reach_m: float

    @classmethod
    def of(cls, mesh: Mesh) -> Place:
        """Return the place that a mesh is."""
        corners = mesh.positions.astype(np.float64)[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normals, axis=1)
        centres = corners.mean(axis=1)
        axes = _axes(centres, area)
        level = mesh.positions[np.unique(mesh.faces)].astype(np.float64) @ axes.T
        low, high = level.min(axis=0), level.max(axis=0)
        extent = float((high - low).max())
        half = float(np.hypot(*(high - low)[:2])) / 2.0
        reach_m = min(REACH_M, max(half, 0.5 * extent))
        x, y = _middle((centres @ axes.T)[:, :2], area, reach_m)
        near = np.hypot(level[:, 0] - x, level[:, 1] - y) < reach_m
        ground = float(np.quantile(level[near, 2], 0.02)) if near.any() else float(low[2])
        return cls(
            scene=Scene(mesh.positions, mesh.faces),
            normals=normals / np.where(area > 0.0, area, 1.0)[:, None],
            axes=axes,
            middle=np.array([x, y, ground]),
            low=low,
            high=high,
            eye_m=min(EYE_M, _EYE_OF_EXTENT * extent),
            reach_m=reach_m,
        )

    def in_cache_frame(self, level: F64) -> F64:
        """Return points or vectors ``(..., 3)`` of the level frame in that of the cache."""
        return level @ self.axes

    def hits(self, starts: F64, towards: F64) -> tuple[I32, F64]:
        """Return the first face on each ray, -1 for none, and how far it is, infinite for none.

        `starts` and `towards` are ``(n, 3)``, level frame; distances in lengths of `towards`.
        """
        origins = np.ascontiguousarray(self.in_cache_frame(starts), np.float32)
        directions = np.ascontiguousarray(self.in_cache_frame(towards), np.float32)
        face, distance = self.scene.first_hit(origins, directions)
        return face, np.where(face >= 0, distance, np.inf).astype(np.float64)

    def is_in_shadow(self, points: F64, light: F32) -> BOOL:
        """Return whether anything lies between each of `points` (level frame) and a light."""
        origins = np.ascontiguousarray(self.in_cache_frame(points), np.float32)
        if light[3] == 0.0:
            return self.scene.is_blocked(origins, light[:3])
        far = np.full(len(origins), 1.0 - 1e-4, np.float32)
        return self.scene.is_blocked(origins, light[:3] - origins, far)

    def grounds(self, x: F64, y: F64) -> F64:
        """Return how high the topmost surface is at places; the ground's height if none is."""
        top = self.high[2] + self.eye_m
        starts = np.column_stack([x, y, np.full(len(x), top)])
        _, distance = self.hits(starts, np.broadcast_to([0.0, 0.0, -1.0], starts.shape))
        return np.where(np.isfinite(distance), top - distance, self.middle[2])

    def around(self, part: float, n: int) -> tuple[F64, F64]:
        """Return n x n places in a square of `part` of the reach either way of the middle."""
        steps = ((np.arange(n) + 0.5) / n * 2.0 - 1.0) * part * self.reach_m
        x, y = np.meshgrid(self.middle[0] + steps, self.middle[1] + steps)
        return x.ravel(), y.ravel()


def compass(n: int, pitch_deg: float = 0.0) -> F64:
    """Return n unit vectors ``(n, 3)`` evenly around the horizon, the first one north."""
    azimuth = 2.0 * math.pi * np.arange(n) / n
    pitch = math.radians(pitch_deg)
    return np.column_stack(
        [
            np.sin(azimuth) * math.cos(pitch),
            np.cos(azimuth) * math.cos(pitch),
            np.full(n, math.sin(pitch)),
        ]
    )


def all_around() -> F64:
    """Return 26 unit vectors: towards the sides, edges and corners of a cube."""
    steps = np.array([-1.0, 0.0, 1.0])
    cube = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    cube = cube[np.abs(cube).sum(axis=1) > 0]
    return cube / np.linalg.norm(cube, axis=1)[:, None]


def _axes(centres: F64, area: F64) -> F64:
    """Return east, north and up of a model's own ground, rows.

    Up is +z unless the model is flat along another axis. Then it is that axis, in the sense
    in which the surface thins out: roofs and towers are above, and most walls begin below.
    """
    upright = np.eye(3)
    if len(centres) < 16 or not area.any():
        return upright
    weight = area / area.sum()
    away = centres - weight @ centres
    spread, vectors = np.linalg.eigh((away * weight[:, None]).T @ away)
    up = vectors[:, 0]
    if spread[0] > _FLAT**2 * spread[1] or abs(up[2]) > _UPRIGHT:
        return upright
    if float(weight @ (away @ up) ** 3) < 0.0:
        up = -up
    least = upright[int(np.argmin(np.abs(up)))]
    east = np.cross(least, up)
    east /= np.linalg.norm(east)
    return np.array([east, np.cross(up, east), up])


def _middle(centres: F64, area: F64, reach_m: float) -> tuple[float, float]:
    """Return the median of faces ``(n, 2)``, if there is something to see within reach of it.

    Else that of the nearest square of three times the reach that holds half as much surface as any.
    """
    median = np.array([_median(centres[:, i], area) for i in range(2)])
    cell = np.floor((centres - median) / reach_m + 0.5).astype(np.int64)
    low, high = cell.min(axis=0) - 1, cell.max(axis=0) + 1
    held = np.zeros(high - low + 1)
    np.add.at(held, tuple((cell - low).T), area)
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    # Nothing comes in from the other end: the outermost cells are empty.
    around = np.sum([np.roll(held, step, axis=(0, 1)) for step in steps], axis=0)
    rows = np.argwhere(around >= 0.5 * around.max()) + low
    nearest = rows[np.argmin((rows**2).sum(axis=1))]
    if not nearest.any():
        return float(median[0]), float(median[1])
    is_there = (np.abs(cell - nearest) <= 1).all(axis=1)
    x, y = (_median(centres[is_there, i], area[is_there]) for i in range(2))
    return x, y


def _median(values: F64, weights: F64) -> float:
    """Return the weighted median."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    if not total[-1] > 0.0:
        return float(np.median(values))
    return float(values[order][np.searchsorted(total, total[-1] / 2.0)])
