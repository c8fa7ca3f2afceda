"""Notes on inputs that can be read, but are hardly meant so."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from svprep.ingest.inputs import TILESET
from svprep.ingest.parsed import ParsedFile, box_of_faces
from svprep.model import F64

FAR_M: Final = 10_000.0
"""A gap in a city that nothing bridges is not wider than this."""
_TILES: Final = ("glb", "gltf", "b3dm")
_LEVELS: Final = 2
"""Folders above that of a tile in which its tileset is looked for."""


def on_lonely_tile(path: Path, format_name: str) -> tuple[str, ...]:
    """Return a note if a tileset above a model may place it, which is read without it."""
    tileset = _tileset_above(str(path.parent)) if format_name in _TILES else ""
    if not tileset:
        return ()
    return (f"read where it stands by itself; {tileset} places tiles: build that folder instead",)


def _tileset_above(folder: str) -> str:
    """Return the nearest tileset in a folder or above it, "" for none."""
    for n in range(_LEVELS + 1):
        tileset = os.path.normpath(os.path.join(folder, *([os.pardir] * n), TILESET))
        if os.path.isfile(tileset):
            return tileset
    return ""


def on_distance(parsed: Sequence[ParsedFile], names: Sequence[str]) -> tuple[str, ...]:
    """Return a note if the files, all in one frame, are two groups far from each other.

    The gap is looked for along x and along y: O(n log n), and a city of tiles that cover
    hundreds of kilometres has none.
    """
    if len(parsed) < 2:
        return ()
    listed = [(box_of_faces(p), name) for p, name in zip(parsed, names, strict=True)]
    found = [(box[:, :2], name) for box, name in listed if box is not None]
    if len(found) < 2:
        return ()
    boxes = np.stack([box for box, _ in found])
    pairs = [_across_widest_gap(boxes, axis) for axis in (0, 1)]
    distance_m, one, other = max(pairs)
    if not distance_m > FAR_M:
        return ()
    return (
        f"{found[one][1]} and {found[other][1]} lie {distance_m / 1e3:,.0f} km apart, with nothing "
        "between them: is one of them in another CRS?",
    )


def _across_widest_gap(boxes: F64, axis: int) -> tuple[float, int, int]:
    """Return how far apart the boxes on either side of the widest gap are [m], and which two."""
    order = np.argsort(boxes[:, 0, axis], kind="stable")
    low, high = boxes[order, 0, axis], boxes[order, 1, axis]
    reach = np.maximum.accumulate(high)[:-1]
    gap = int(np.argmax(low[1:] - reach))
    one = int(order[np.argmax(high[: gap + 1])])
    other = int(order[gap + 1])
    apart = np.maximum(boxes[other, 0] - boxes[one, 1], boxes[one, 0] - boxes[other, 1])
    return float(np.linalg.norm(np.maximum(apart, 0.0))), min(one, other), max(one, other)
