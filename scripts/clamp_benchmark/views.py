"""Six views of a scene, and how far they see: the same for any model, by its bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from svprep.model import BOOL, F32, F64, I64, U32
from svprep.rays import Scene

EYE_M: Final = 1.7
"""[m]: of a person above the ground."""
OPENING_DEG: Final = 60.0
"""Of a view from its lower edge to its upper one."""
_MOST_SURFACES: Final = 1000
_BEHIND_M: Final = 1e-3
_PROBES: Final = 12
"""Rays down to a side, of which the one that falls lowest has met a street."""
_PROBED: Final = 0.04
"""Half the side of the square that is probed, in units of the scene's half diagonal."""


class _View(NamedTuple):
    """Where a view is, in units of half the bounds from their middle, and where it looks."""

    name: str
    x: float
    y: float
    height: float
    """Above the ground, in units of the scene's half diagonal; 0: a person's eye in a street."""
    azimuth_deg: float
    pitch_deg: float


VIEWS: Final = (
    _View("street 1", 0.06, 0.03, 0.0, 20.0, 2.0),
    _View("street 2", -0.23, 0.18, 0.0, 200.0, 2.0),
    _View("oblique 1", -0.35, -0.35, 0.025, 40.0, -12.0),
    _View("oblique 2", 0.30, -0.12, 0.05, 300.0, -25.0),
    _View("bird's eye 1", 0.0, 0.0, 0.20, 0.0, -60.0),
    _View("bird's eye 2", -0.50, 0.30, 0.36, 120.0, -89.0),
)


@dataclass(frozen=True, slots=True)
class Views:
    """Rays of all pixels of all views, view after view."""

    n_pixels: int
    """Of a view."""
    eyes: F64
    """``(n_views, 3)`` [m], in the cache frame."""
    origins: F64
    """``(n_rays, 3)`` [m]"""
    directions: F64
    """``(n_rays, 3)``, of length 1."""
    seen: F64
    """``(n_rays,)`` [m]: how far the visible surface is, infinite for the sky."""
    hidden_start: I64
    """``(n_rays + 1,)``: where each ray's part of `hidden` begins."""
    hidden: F64
    """``(n,)`` [m]: how far the surfaces behind the visible one are, ascending."""

    @property
    def is_surface(self) -> BOOL:
        """``(n_views, n_pixels) bool``: what is not sky."""
        return np.isfinite(self.seen).reshape(len(self.eyes), self.n_pixels)


def look(positions: F32, faces: U32, columns: int, rows: int) -> Views:
    """Return what the six views of a scene see.

    Two stand in a street (the lowest of `_PROBES`^2 rays down around a place), two look
    down obliquely and two are high above, by parts of the scene's horizontal half diagonal
    above the ground. Where no ray down meets anything, the ground is the scene's lowest point.
    """
    scene = Scene(positions, faces)
    low, high = positions.min(axis=0).astype(float), positions.max(axis=0).astype(float)
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    diagonal = float(np.hypot(half[0], half[1]))
    eyes, directions = [], []
    for view in VIEWS:
        x, y = middle[0] + view.x * half[0], middle[1] + view.y * half[1]
        reach = _PROBED * diagonal
        x, y, ground = _street(scene, x, y, reach, float(low[2]), float(high[2]))
        above = view.height * diagonal if view.height else EYE_M
        eyes.append((x, y, ground + above))
        directions.append(_directions(view.azimuth_deg, view.pitch_deg, columns, rows))
    origins = np.repeat(np.array(eyes), columns * rows, axis=0)
    toward = np.concatenate(directions)
    return Views(columns * rows, np.array(eyes), origins, toward, *surfaces(scene, origins, toward))


def surfaces(scene: Scene, origins: F64, directions: F64) -> tuple[F64, I64, F64]:
    """Return ``seen``, ``hidden_start`` and ``hidden`` of `Views`.

    A ray goes on a millimetre behind each surface that it meets; what is closer together is
    one surface.
    """
    n = len(origins)
    seen = np.full(n, np.inf)
    rays, away = np.arange(n), np.zeros(n)
    found_ray, found_m = [], []
    for step in range(_MOST_SURFACES):
        starts = (origins[rays] + away[rays, None] * directions[rays]).astype(np.float32)
        face, distance = scene.first_hit(starts, directions[rays].astype(np.float32))
        is_met = face >= 0
        rays = rays[is_met]
        if len(rays) == 0:
            break
        met_m = away[rays] + distance[is_met]
        if step == 0:
            seen[rays] = met_m
        else:
            found_ray.append(rays)
            found_m.append(met_m)
        away[rays] = met_m + _BEHIND_M
    ray = np.concatenate([np.empty(0, np.int64), *found_ray])
    order = np.argsort(ray, kind="stable")  # steps are in order
    hidden_start = np.concatenate(([0], np.cumsum(np.bincount(ray, minlength=n))))
    return seen, hidden_start, np.concatenate([np.empty(0), *found_m])[order]


def _street(
    scene: Scene, x: float, y: float, reach: float, lowest: float, highest: float
) -> tuple[float, float, float]:
    """Return the place of the ray down that falls lowest of a square of them, and its ground."""
    steps = (np.arange(_PROBES) + 0.5) / _PROBES * 2.0 - 1.0
    xs, ys = np.meshgrid(x + reach * steps, y + reach * steps)
    top = highest + 1.0
    starts = np.column_stack([xs.ravel(), ys.ravel(), np.full(xs.size, top)]).astype(np.float32)
    face, distance = scene.vertical(starts, -1.0)
    if not (face >= 0).any():
        return x, y, lowest
    best = int(np.argmax(np.where(face >= 0, distance, -np.inf)))
    return float(starts[best, 0]), float(starts[best, 1]), float(starts[best, 2] - distance[best])


def _directions(azimuth_deg: float, pitch_deg: float, columns: int, rows: int) -> F64:
    """Return the unit vectors through the middles of pixels, row by row, ``(n, 3)``."""
    a, p = math.radians(azimuth_deg), math.radians(pitch_deg)
    ahead = np.array([math.sin(a) * math.cos(p), math.cos(a) * math.cos(p), math.sin(p)])
    right = np.array([math.cos(a), -math.sin(a), 0.0])
    up = np.cross(right, ahead)
    half = math.tan(math.radians(OPENING_DEG / 2.0))
    xs = ((np.arange(columns) + 0.5) / columns * 2.0 - 1.0) * half * columns / rows
    ys = ((np.arange(rows) + 0.5) / rows * 2.0 - 1.0) * half
    across, along = (grid.ravel()[:, None] for grid in np.meshgrid(xs, ys))
    rays = ahead + across * right + along * up
    return rays / np.linalg.norm(rays, axis=1)[:, None]
