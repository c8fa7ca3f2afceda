"""Twin of the silhouette indices: the hextree as it was published.

*Geometry of Real Time Shadows* searches silhouettes in dual space, after Hertzmann
and Zorin (2000) and Pop et al. (2001):

    plane n . x + d = 0   ->  the point (n/|n|, (d + n . c) / (r |n|)) of [-1, 1]^4
    light (L, w)          ->  the hyperplane through 0 normal to ((L - w c) / r, w)
    edge of two faces     ->  the segment between their planes' points

with c and r the centre and radius of the edge's object, because dual points of far
planes crowd at a pole. A face is lit iff its point lies on the light's positive side;
so an edge is silhouette iff the hyperplane meets its segment. The cube is divided
into 16 children, again and again, to a fixed depth; a segment lies in the smallest
cell that holds both its ends; a cell can hold silhouettes only if the hyperplane
separates the two of its corners that lie farthest along the light and against it,
which the signs of the light's four numbers name.

Rounding: facing is a sign in float64, and the cell test is made of other float64
sums. So cells are passed over only where the hyperplane misses them by more than
all those roundings together (`_margins`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from svprep.model import F64, I64, U32, EdgeFlag, EdgeKind, Mesh
from svprep.reference.silhouettes import Tables

DEPTH: Final = 4
"""How often the cube is divided: 5 levels, the smallest cells 1/8 wide."""

_ROUNDINGS: Final = 64 * np.finfo(np.float64).eps
"""More than the relative roundings, some 25 of 2**-53, in a facing and a cell test."""


@dataclass(frozen=True, slots=True)
class HextreeLevel:
    """All cells of one size, of all objects, sorted by object and address."""

    object_index: I64
    """``(n_cells,)``"""
    address: I64
    """``(n_cells, 4)``: place in the grid of ``2**level`` cells a side."""
    parent: I64
    """``(n_cells,)``: index into the level above; 0 for the roots."""
    edge_start: I64
    """``(n_cells + 1,)``: range of each cell in `edge`."""
    edge: I64
    """Ids of the edge records whose smallest cell is one of these."""


@dataclass(frozen=True, slots=True)
class Hextree:
    """A hextree per object, all of one depth, stored level by level."""

    centre: F64
    """``(n_objects, 3)`` [m]"""
    radius: F64
    """``(n_objects,)`` [m]: no plane of the object is farther from its centre."""
    levels: tuple[HextreeLevel, ...]

    @property
    def n_edges(self) -> int:
        """How many edge records are in the trees."""
        return sum(len(level.edge) for level in self.levels)


class HextreeVisit(NamedTuple):
    """What a light finds in the trees."""

    edge: U32
    """``(n_visited,)``, ascending: every silhouette pair, and others. An exact test
    of each must follow."""
    n_cells: int
    """Cells whose corners were tested: all roots, and the children of those met."""


def build_hextree(tables: Tables, depth: int = DEPTH) -> Hextree:
    """Return the hextrees of a city: of its pairs, planar ones aside.

    Border and split records are nearly always silhouette, and planar ones never:
    none of those is in the tree.

    Notes
    -----
    O(depth n log n), vectorised over all objects.
    """
    rows, flags = tables.edges.rows, tables.edges.flags
    is_pair = flags & np.uint8(EdgeFlag.KIND_MASK) == EdgeKind.PAIR
    edge = np.flatnonzero(is_pair & (flags & np.uint8(EdgeFlag.PLANAR) == 0))
    components = tables.components
    first_edge = components.edge_start[components.object_start]
    object_index = np.repeat(np.arange(len(first_edge) - 1), np.diff(first_edge))[edge]

    centre, radius = object_spheres(tables.mesh, tables.planes.tolerance_m)
    dual = dual_planes(tables, centre, radius)
    # Addresses are those of the smallest cells; shifted right, of the larger ones.
    n_across = 2**depth
    address = np.clip((dual + 1.0) * (n_across / 2), 0, n_across - 1).astype(np.int64)
    ends = address[tables.planes.plane_of_face[rows[edge, 2:]]]
    apart = np.bitwise_or.reduce(ends[:, 0] ^ ends[:, 1], axis=1)
    level_of_edge = depth - np.frexp(apart)[1]  # frexp gives the bit length

    levels: list[HextreeLevel] = []
    keys = np.zeros(0, np.int64)
    for level in range(depth + 1):
        within = np.flatnonzero(level_of_edge >= level)
        cells = ends[within, 0] >> (depth - level)
        above = keys
        key = _keys(object_index[within], cells, level)
        keys, sample, cell = np.unique(key, return_index=True, return_inverse=True)
        up = _keys(object_index[within][sample], cells[sample] >> 1, level - 1)
        here = level_of_edge[within] == level
        order = np.argsort(cell[here], kind="stable")
        levels.append(
            HextreeLevel(
                object_index=object_index[within][sample],
                address=cells[sample],
                parent=np.searchsorted(above, up) if level else np.zeros(len(up), np.int64),
                edge_start=np.searchsorted(cell[here][order], np.arange(len(keys) + 1)),
                edge=edge[within[here][order]],
            )
        )
    return Hextree(centre, radius, tuple(levels))


def object_spheres(mesh: Mesh, tolerance_m: float) -> tuple[F64, F64]:
    """Return each object's centre ``(n_objects, 3)`` and radius ``(n_objects,)`` [m].

    The radius holds every vertex, and every plane record of the object, which may
    pass its faces' corners at `tolerance_m`. Without vertices it is 1.
    """
    n = len(mesh.object_vertex_start) - 1
    of_vertex = np.repeat(np.arange(n), np.diff(mesh.object_vertex_start))
    points = mesh.positions.astype(np.float64)
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(low, of_vertex, points)
    np.maximum.at(high, of_vertex, points)
    is_empty = np.diff(mesh.object_vertex_start) == 0
    low[is_empty], high[is_empty] = 0.0, 0.0
    centre = (low + high) / 2.0
    radius = np.where(is_empty, 1.0, 0.0)
    np.maximum.at(radius, of_vertex, np.linalg.norm(points - centre[of_vertex], axis=1))
    # Twice the tolerance: the rounding of d and of distances is far below one more.
    return centre, radius + 2.0 * tolerance_m


def dual_planes(tables: Tables, centre: F64, radius: F64) -> F64:
    """Return ``(n_planes, 4)``: each record's point of [-1, 1]^4, about its object's centre."""
    mesh, planes = tables.mesh, tables.planes.planes
    object_of_face = np.repeat(np.arange(len(centre)), np.diff(mesh.object_face_start))
    of_plane = np.zeros(len(planes), np.int64)
    of_plane[tables.planes.plane_of_face] = object_of_face  # records lie within objects
    normal, d = planes[:, :3], planes[:, 3]
    length = np.sqrt((normal * normal).sum(axis=1))
    height = d + (normal * centre[of_plane]).sum(axis=1)
    return np.column_stack((normal / length[:, None], height / (radius[of_plane] * length)))


def visit_hextree(tree: Hextree, light: np.ndarray) -> HextreeVisit:
    """Return the edges in all cells that the light's hyperplane meets.

    ``light (4,)``: ``(x, y, z, w)`` in the cache frame, rounded to float32. Every
    pair whose two facings differ is among them.
    """
    light = np.asarray(light, np.float32).astype(np.float64)
    dual = _dual_lights(tree, light)
    margin = _margins(tree, light)
    n_cells, found = 0, [np.zeros(0, np.int64)]
    is_met_above = np.ones(1, bool)
    for number, level in enumerate(tree.levels):
        tested = np.flatnonzero(is_met_above[level.parent])
        n_cells += len(tested)
        of = level.object_index[tested]
        ahead, behind = _extreme_corners(level.address[tested], number, dual[of])
        is_met_above = np.zeros(len(level.parent), bool)
        is_met_above[tested] = ((ahead * dual[of]).sum(axis=1) >= -margin[of]) & (
            (behind * dual[of]).sum(axis=1) <= margin[of]
        )
        found.append(level.edge[np.repeat(is_met_above, np.diff(level.edge_start))])
    return HextreeVisit(np.sort(np.concatenate(found)).astype(np.uint32), n_cells)


def _keys(object_index: I64, address: I64, level: int) -> I64:
    """Number cells of a level: by object, then by the four numbers of the address."""
    key = object_index
    for axis in range(4):
        key = (key << max(level, 0)) | address[:, axis]
    return key


def _dual_lights(tree: Hextree, light: F64) -> F64:
    """Return ``(n_objects, 4)``: the light as each object's hyperplane."""
    towards = (light[:3] - light[3] * tree.centre) / tree.radius[:, None]
    return np.column_stack((towards, np.full(len(towards), light[3])))


def _extreme_corners(address: I64, level: int, dual: F64) -> tuple[F64, F64]:
    """Return the corners ``(n, 4)`` farthest along and against each light: by its signs."""
    width = 2.0 ** (1 - level)
    low = address * width - 1.0  # exact: few bits
    mask = dual >= 0.0
    return np.where(mask, low + width, low), np.where(mask, low, low + width)


def _margins(tree: Hextree, light: F64) -> F64:
    """Return ``(n_objects,)``: how far all roundings can move a face across a hyperplane.

    A facing's sum ``n . L + d w`` is off by its relative rounding times
    ``|n| |L| + |d| w``, with ``|d| / |n| <= |c| + r``; the dual point and light, the
    address and the corner's sum by no more than that, divided like them by r |n|.
    """
    from_origin = np.linalg.norm(tree.centre, axis=1)
    size = np.linalg.norm(light[:3]) + light[3] * (2.0 * from_origin + tree.radius)
    return _ROUNDINGS * size / tree.radius
