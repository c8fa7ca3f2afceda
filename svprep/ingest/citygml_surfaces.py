"""The corners of the polygons that are used: gathered, placed, turned, merged."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from svprep.errors import InputError
from svprep.ingest.citygml_links import NO_PLACEMENT, Uses
from svprep.ingest.citygml_log import CityLog, column
from svprep.ingest.citygml_places import is_mirroring, matrices, place, reference_points
from svprep.ingest.crs_given import crs_in_use
from svprep.ingest.crs_names import crs_of, has_pyproj, is_north_first, needs_swap, normalised_crs
from svprep.ingest.parsed import count_of, refuse_non_finite, shown
from svprep.model import BOOL, F64, I64, U32, U64

_MULTIPLIERS: Final = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)


@dataclass(frozen=True, slots=True)
class Polygons:
    """What `svprep.ingest.holes.triangulate_rings` takes, polygon by polygon of `Uses`."""

    positions: F64
    """``(n_vertices, 3)``: x = east, y = north, z = up in units of the CRS."""
    corners: U32
    ring_start: I64
    polygon_start: I64
    crs: str
    """As the file states it."""
    notes: tuple[str, ...]


def gather(log: CityLog, uses: Uses, path: Path, given_crs: str = "") -> Polygons:
    """Return the polygons that are used, at their places.

    `given_crs` counts where the file states no CRS that is known.

    Raises
    ------
    InputError
        They state different coordinate reference systems, or their places cannot be read.

    Notes
    -----
    O(n log n), to merge corners at the same position.
    """
    points = np.concatenate(log.points) if log.points else np.empty((0, 3))
    size = np.concatenate(log.ring_sizes) if log.ring_sizes else np.empty(0, np.int64)
    start = np.cumsum(size) - size
    n_rings = column(log.polygon_rings)
    first_ring = np.cumsum(n_rings) - n_rings

    is_closed = size >= 2
    ends = start[is_closed] + size[is_closed] - 1
    is_closed[is_closed] = (points[start[is_closed]] == points[ends]).all(axis=1)
    found = matrices(log.placements, path)
    is_placed = uses.placement != NO_PLACEMENT
    is_reversed = uses.is_reversed.copy()
    is_reversed[is_placed] ^= is_mirroring(found)[uses.placement[is_placed]]

    rings_of_use = n_rings[uses.polygon]
    ring = _ragged(first_ring[uses.polygon], rings_of_use)
    kept = size[ring] - is_closed[ring]
    rows = _ragged(start[ring], kept, np.repeat(is_reversed, rings_of_use))
    points = points[rows]
    placement = np.repeat(np.repeat(uses.placement, rings_of_use), kept)
    crs = _only_crs(log, uses, path)
    in_use = crs_in_use(crs, given_crs)
    points, notes = _at_their_places(log, points, placement, found, in_use, path)
    refuse_non_finite(points, path, "implicit geometry, placed")
    n_open = int(np.count_nonzero(~is_closed[ring] & (size[ring] >= 3)))
    if n_open:
        notes.append(f"{count_of(n_open, 'ring')} without its first corner at the end: closed")
    positions, corners = _merged(points)
    return Polygons(
        positions,
        corners,
        np.concatenate([[0], np.cumsum(kept)]).astype(np.int64),
        np.concatenate([[0], np.cumsum(rings_of_use)]).astype(np.int64),
        crs,
        tuple(notes),
    )


def _ragged(start: I64, counts: I64, is_backward: BOOL | None = None) -> I64:
    """Return ``start[i], start[i] + 1, ...``, counts[i] of them, for each i in turn."""
    n = int(counts.sum())
    within = np.arange(n) - np.repeat(np.cumsum(counts) - counts, counts)
    if is_backward is not None and is_backward.any():
        last = np.repeat(counts - 1, counts)
        within = np.where(np.repeat(is_backward, counts), last - within, within)
    return np.repeat(start, counts) + within


def _only_crs(log: CityLog, uses: Uses, path: Path) -> str:
    """Return the coordinate reference system of all that is used, as it is stated first."""
    srs = column(log.polygon_srs)[uses.polygon]
    of_placement = np.array([placement.srs for placement in log.placements], np.int64)
    is_placed = uses.placement != NO_PLACEMENT
    srs[is_placed] = of_placement[uses.placement[is_placed]]
    names = list(log.srs)
    stated = [names[i] for i in np.unique(srs).tolist() if names[i].strip()]
    for other in stated[1:]:
        if not _is_same(stated[0], other):
            raise InputError(
                f'{path}: its surfaces are in two coordinate reference systems, "'
                f'{shown(stated[0])}" and "{shown(other)}"; convert the file to one of them.'
            )
    return stated[0].strip() if stated else ""


def _is_same(one: str, other: str) -> bool:
    """Whether positions of two CRS may stand side by side; heights are not compared."""
    planes = [normalised_crs(name).partition("+")[0] for name in (one, other)]
    return planes[0] == planes[1] and is_north_first(one) == is_north_first(other)


def _at_their_places(
    log: CityLog, points: F64, placement: I64, found: F64, crs: str, path: Path
) -> tuple[F64, list[str]]:
    """Place the corners of templates and turn all to x = east, y = north."""
    notes = []
    is_placed = placement != NO_PLACEMENT
    at, n_without = reference_points(log.placements, path)
    if crs:
        known = points if not is_placed.any() else points[~is_placed]
        known = known if len(known) else at
        bounds = np.stack([known.min(axis=0), known.max(axis=0)])
        if len(known) and needs_swap(crs, bounds):
            notes.append(f"{shown(crs)} puts north first: (north, east, z) -> (east, north, z)")
            points[~is_placed] = points[~is_placed][:, [1, 0, 2]]
            at = at[:, [1, 0, 2]]
    if is_placed.any():
        known_crs = crs_of(crs) if crs and has_pyproj() else None
        in_degrees = known_crs is not None and known_crs.is_geographic
        points[is_placed] = place(
            points[is_placed], placement[is_placed], found, at, in_degrees=in_degrees
        )
        if n_without:
            n = count_of(n_without, "implicit geometry", "implicit geometries")
            notes.append(f"{n} without a referencePoint, placed by the matrix alone")
    return points, notes


def _merged(points: F64) -> tuple[F64, U32]:
    """Return the different positions in the order of first use, and which one each corner is."""
    points = points + 0.0  # -0.0 is 0.0
    bits: U64 = points.view(np.uint64)
    keys = np.zeros(len(points), np.uint64)
    for axis, multiplier in enumerate(_MULTIPLIERS):
        keys ^= bits[:, axis] * np.uint64(multiplier)
        keys ^= keys >> np.uint64(29)
        keys *= np.uint64(_MULTIPLIERS[0])
    order = np.argsort(keys, kind="stable")
    is_new = np.ones(len(points), np.bool_)
    is_new[1:] = (bits[order[1:]] != bits[order[:-1]]).any(axis=1)
    # Rows with equal keys may differ, and then come mixed: one position becomes two vertices,
    # which weld like any others.
    leader = order[is_new]
    rank = np.empty(len(leader), np.int64)
    rank[np.argsort(leader, kind="stable")] = np.arange(len(leader))
    corners = np.empty(len(points), np.uint32)
    corners[order] = rank[np.cumsum(is_new) - 1]
    return np.ascontiguousarray(points[np.sort(leader)]), corners
