"""The ground: a sum of long waves, cut into tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from city_generator.mesh import F64, Polygon, PolyMesh

SPACING_M = 10.0
"""Between the ground's vertices [m]."""
TILE_CELLS = 20
"""Cells along a tile's side."""
TILE_M = SPACING_M * TILE_CELLS
"""A tile's side [m]."""
SLAB_M = 30.0
"""How far below zero the closed tile of a clean city reaches [m]."""


@dataclass(frozen=True, slots=True)
class Relief:
    """Waves whose sum is the ground's height."""

    wave_per_m: F64
    """``(n, 2)`` [rad/m]."""
    phase_rad: F64
    """``(n,)``"""
    amplitude_m: F64
    """``(n,)``"""

    @staticmethod
    def random(rng: np.random.Generator) -> Relief:
        """Return hills of 250 m to 2.6 km length, gentler than five percent each."""
        length_m = np.array([250.0, 420.0, 730.0, 1300.0, 2600.0])
        heading = rng.random(5) * 2 * np.pi
        k = 2 * np.pi / length_m
        wave = np.column_stack([k * np.cos(heading), k * np.sin(heading)])
        return Relief(wave, rng.random(5) * 2 * np.pi, length_m * (0.002 + 0.002 * rng.random(5)))

    def height(self, xy_m: F64) -> F64:
        """Return the ground's height [m] at ``(n, 2)`` points, before the city is turned."""
        angle = xy_m[:, None, 0] * self.wave_per_m[:, 0] + xy_m[:, None, 1] * self.wave_per_m[:, 1]
        waves = self.amplitude_m * np.sin(angle + self.phase_rad)
        total: F64 = waves[:, 0] + waves[:, 1] + waves[:, 2] + waves[:, 3] + waves[:, 4]
        return total


def tile(relief: Relief, column: int, row: int, *, closed: bool) -> PolyMesh:
    """Return tile (column, row) as quads: an open sheet, or with `closed` a slab.

    Neighbouring tiles agree in every coordinate along their common border.
    """
    n = TILE_CELLS + 1
    x = (column * TILE_CELLS + np.arange(n)) * SPACING_M
    y = (row * TILE_CELLS + np.arange(n)) * SPACING_M
    xy = np.column_stack([np.tile(x, n), np.repeat(y, n)])
    vertices = np.column_stack([xy, relief.height(xy)])
    low = (np.arange(TILE_CELLS)[:, None] * n + np.arange(TILE_CELLS)).ravel()
    polygons: list[Polygon] = np.column_stack([low, low + 1, low + n + 1, low + n]).tolist()
    if not closed:
        return PolyMesh(vertices, polygons)
    steps = [(0, 1), (TILE_CELLS, n), (n * n - 1, -1), (n * TILE_CELLS, -n)]
    border = [start + step * i for start, step in steps for i in range(TILE_CELLS)]
    base = n * n
    floor = vertices[border] * [1.0, 1.0, 0.0] - [0.0, 0.0, SLAB_M]
    middle = [[*xy.mean(axis=0), -SLAB_M]]
    for i, top in enumerate(border):
        j = (i + 1) % len(border)
        polygons.append([base + i, base + j, border[j], top])
        polygons.append([base + len(border), base + j, base + i])
    return PolyMesh(np.concatenate([vertices, floor, middle]), polygons)
