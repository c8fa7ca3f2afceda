"""Where things stand: blocks between streets, lots in blocks, items along kerbs.

+---+---+---+---+   <- kerb: trees and furniture, 1.5 m outside the block
| o | o | o | o |
+---+---+---+---+   a block of 96 m x 72 m: twelve lots, or two large ones,
| o | o | o | o |   or a park
+---+---+---+---+
| o | o | o | o |
+---+---+---+---+
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, exp, sqrt

import numpy as np

BLOCK_M = (96.0, 72.0)
STREET_M = 18.0
PITCH_M = (BLOCK_M[0] + STREET_M, BLOCK_M[1] + STREET_M)
OBJECTS_PER_BLOCK = 24
KERB_M = 1.5
"""Trees and lamps stand this far outside a block [m]."""


@dataclass(frozen=True, slots=True)
class Lot:
    """A rectangle on which one building may stand."""

    x_m: float
    y_m: float
    width_m: float
    depth_m: float


@dataclass(frozen=True, slots=True)
class Spot:
    """A place for a tree or a piece of furniture; `yaw_rad` turns its +x to the street."""

    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class Block:
    """One block of the plan and how many objects it holds."""

    index: int
    use: str
    """``"park"``, ``"dense"``, ``"large"`` or ``"suburb"``."""
    centrality: float
    """1 in the middle of the city, falling towards 0."""
    lots: tuple[Lot, ...]
    spots: tuple[Spot, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """The whole city's plan."""

    tiles: tuple[tuple[int, int], ...]
    """(column, row) of each terrain tile."""
    columns: int
    rows: int
    quotas: tuple[int, ...]
    """Objects of each block, in the order of `order`."""
    order: tuple[tuple[int, int], ...]
    """(column, row) of each block, from the middle outward."""


def plan_city(n_objects: int, tile_m: float) -> Plan:
    """Return a plan of exactly `n_objects` objects, terrain tiles included."""
    n_blocks = max(ceil(n_objects / (OBJECTS_PER_BLOCK * 1.02)), 1)
    columns = max(round(sqrt(n_blocks * PITCH_M[1] / PITCH_M[0])), 1)
    rows = ceil(n_blocks / columns)
    reach = (columns * PITCH_M[0] + STREET_M, rows * PITCH_M[1] + STREET_M)
    half = [ceil(r / 2 / tile_m) for r in reach]
    tiles = [(c, r) for r in range(-half[1], half[1]) for c in range(-half[0], half[0])]
    tiles = tiles[: max(n_objects - 1, 1)]
    cells = [(c, r) for r in range(rows) for c in range(columns)]
    cells.sort(key=lambda cell: (_squared_distance_m2(cell, columns, rows), cell))
    left = n_objects - len(tiles)
    n_blocks = min(n_blocks, left)
    quotas = [left // n_blocks + (i < left % n_blocks) for i in range(n_blocks)] if left else []
    return Plan(tuple(tiles), columns, rows, tuple(quotas), tuple(cells[: len(quotas)]))


def _squared_distance_m2(cell: tuple[int, int], columns: int, rows: int) -> float:
    x = (cell[0] - (columns - 1) / 2) * PITCH_M[0]
    y = (cell[1] - (rows - 1) / 2) * PITCH_M[1]
    return x * x + y * y


def lay_out_block(plan: Plan, index: int, rng: np.random.Generator) -> Block:
    """Return block `index` of the plan with as many lots and spots as its quota."""
    cell = plan.order[index]
    x = (cell[0] - (plan.columns - 1) / 2) * PITCH_M[0]
    y = (cell[1] - (plan.rows - 1) / 2) * PITCH_M[1]
    reach_m = 0.25 * sqrt(len(plan.order) * PITCH_M[0] * PITCH_M[1])
    centrality = exp(-(x * x + y * y) / (reach_m * reach_m))
    use = _use(index, centrality, rng)
    lots = _lots(use, x, y)
    quota = plan.quotas[index]
    if len(lots) > quota // 2:
        keep = sorted(rng.choice(len(lots), size=quota - quota // 2, replace=False).tolist())
        lots = [lots[i] for i in keep]
    n_spots = quota - len(lots)
    spots = _park(x, y, n_spots, rng) if use == "park" else _kerb(x, y, n_spots, rng)
    return Block(index, use, centrality, tuple(lots), tuple(spots))


def _use(index: int, centrality: float, rng: np.random.Generator) -> str:
    """Return what a block is for; the middle of the city is a park."""
    draw = float(rng.random())
    if index == 0 or draw < 0.05:
        return "park"
    if index == 1:
        return "large"
    if draw < 0.12 + 0.25 * centrality:
        return "large"
    return "dense" if rng.random() < 0.25 + 0.7 * centrality else "suburb"


def _lots(use: str, x: float, y: float) -> list[Lot]:
    """Return the lots of a block around (x, y)."""
    if use == "park":
        return []
    if use == "large":
        columns, rows = 2, 1
    else:
        columns, rows = 4, 3
    width, depth = BLOCK_M[0] / columns, BLOCK_M[1] / rows
    return [
        Lot(
            x + (c + 0.5) * width - BLOCK_M[0] / 2,
            y + (r + 0.5) * depth - BLOCK_M[1] / 2,
            width,
            depth,
        )
        for r in range(rows)
        for c in range(columns)
    ]


def _kerb(x: float, y: float, n: int, rng: np.random.Generator) -> list[Spot]:
    """Return `n` spots around the block at even distances, shifted a little."""
    w, d = BLOCK_M[0] / 2 + KERB_M, BLOCK_M[1] / 2 + KERB_M
    around = 4 * (w + d)
    step = around / max(n, 1)
    spots = []
    for i in range(n):
        t = ((i + 0.5 + float(rng.uniform(-0.2, 0.2))) * step) % around
        if t < 2 * w:
            spots.append(Spot(x - w + t, y - d, -np.pi / 2))
        elif t < 2 * (w + d):
            spots.append(Spot(x + w, y - d + t - 2 * w, 0.0))
        elif t < 4 * w + 2 * d:
            spots.append(Spot(x + w - (t - 2 * (w + d)), y + d, np.pi / 2))
        else:
            spots.append(Spot(x - w, y + d - (t - 4 * w - 2 * d), np.pi))
    return spots


def _park(x: float, y: float, n: int, rng: np.random.Generator) -> list[Spot]:
    """Return `n` spots on a shifted lattice inside the block."""
    columns = max(ceil(sqrt(n * BLOCK_M[0] / BLOCK_M[1])), 1)
    rows = ceil(n / columns)
    width, depth = BLOCK_M[0] / columns, BLOCK_M[1] / max(rows, 1)
    spots = []
    for i in range(n):
        shift = rng.uniform(-0.25, 0.25, 2)
        spots.append(
            Spot(
                x - BLOCK_M[0] / 2 + (i % columns + 0.5 + float(shift[0])) * width,
                y - BLOCK_M[1] / 2 + (i // columns + 0.5 + float(shift[1])) * depth,
                float(rng.uniform(0, 2 * np.pi)),
            )
        )
    return spots
