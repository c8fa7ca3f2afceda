"""The polygons of the chosen geometries, those of template instances put in their places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svprep.ingest.cityjson_objects import Objects
from svprep.ingest.cityjson_templates import Instance
from svprep.ingest.lod import LodChoice, number_of
from svprep.model import BOOL, F64, I64, U8, U32


@dataclass(frozen=True, slots=True)
class Polygons:
    """Polygons with holes, grouped by object, in the order of the file."""

    corners: U32
    ring_start: I64
    """``(n_rings + 1,)``"""
    polygon_start: I64
    """``(n_polygons + 1,)``: rings of each."""
    object: I64
    """``(n_polygons,)``, ascending."""
    name: U8
    """``(n_polygons,)``: number of its surface's name."""


def chosen_polygons(
    objects: Objects,
    choice: LodChoice,
    crs: str,
    positions: F64,
    first_vertex: I64,
    first_corner: I64,
) -> tuple[F64, Polygons]:
    """Return the positions with those of instances behind them, and the polygons to build.

    Parameters
    ----------
    crs
        Of the positions.
    positions : (n_vertices, 3) float64
    first_vertex, first_corner : (n_documents + 1,) int64
        Corners of a document count from its first vertex.
    """
    surfaces = objects.surfaces
    corners = np.array(surfaces.corners, np.uint32)
    if len(first_vertex) > 2:
        corners += np.repeat(first_vertex[:-1], np.diff(first_corner)).astype(np.uint32)
    ring_size = np.array(surfaces.ring_size, np.int64)
    n_rings = np.array(surfaces.n_rings, np.int64)
    name = np.frombuffer(bytes(surfaces.name), np.uint8)
    n_geometries = len(objects.geometry_lod)
    geometry = np.repeat(np.arange(n_geometries), np.diff(objects.geometry_start))
    is_chosen = _is_chosen(objects, choice)

    placed: list[Instance] = [i for i in objects.instances if is_chosen[i.geometry]]
    if placed:
        more = objects.templates.placed(placed, positions, crs, objects.n_bytes, objects.path)
        corners = np.concatenate([corners, more.corners + np.uint32(len(positions))])
        positions = np.concatenate([positions, more.positions])
        ring_size = np.concatenate([ring_size, more.ring_size])
        n_rings = np.concatenate([n_rings, more.n_rings])
        name = np.concatenate([name, more.name])
        geometry = np.concatenate([geometry, more.geometry])
    order = np.flatnonzero(is_chosen[geometry])
    if placed:
        order = order[np.argsort(geometry[order], kind="stable")]
    if placed or order.size < geometry.size:
        rings = _ranges(np.cumsum(n_rings) - n_rings, n_rings, order)
        corners = corners[_ranges(np.cumsum(ring_size) - ring_size, ring_size, rings)]
        ring_size, n_rings = ring_size[rings], n_rings[order]
    return positions, Polygons(
        corners,
        np.concatenate([[0], np.cumsum(ring_size)]),
        np.concatenate([[0], np.cumsum(n_rings)]),
        np.array(objects.geometry_object, np.int64)[geometry[order]],
        np.ascontiguousarray(name[order]),
    )


def _is_chosen(objects: Objects, choice: LodChoice) -> BOOL:
    """Return of each geometry whether it is of the level that its object contributes."""
    numbers = {lod: number_of(lod) for lod in {*objects.geometry_lod}}
    wanted = [None if lod is None else numbers[lod] for lod in choice.lods]
    return np.array(
        [
            numbers[lod] == wanted[i]
            for lod, i in zip(objects.geometry_lod, objects.geometry_object, strict=True)
        ],
        np.bool_,
    )


def _ranges(start: I64, size: I64, chosen: I64) -> I64:
    """Return the numbers ``start[i] .. start[i] + size[i] - 1`` of each chosen i."""
    sizes = size[chosen]
    before = np.cumsum(sizes) - sizes
    found: I64 = np.repeat(start[chosen] - before, sizes) + np.arange(int(sizes.sum()))
    return found
