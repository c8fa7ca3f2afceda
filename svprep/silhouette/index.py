"""The stage that builds the silhouette trees of objects large enough for one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svprep.kernels.tree_build import UNIT, order_pairs, write_boxes, write_cones, write_keys
from svprep.model import (
    F32,
    I16,
    I64,
    U32,
    Components,
    EdgeTable,
    Mesh,
    PlaneTable,
    SilhouetteIndex,
    SilhouetteTree,
)
from svprep.parallel import for_ranges, run_together
from svprep.ranges import rows_of_runs
from svprep.silhouette.trees import LEAF, tree_starts

FEWEST_PAIRS = 512
"""Below this many searched edges a flat scan is always faster: no tree is built."""


def build_index(
    mesh: Mesh, components: Components, planes: PlaneTable, edges: EdgeTable
) -> SilhouetteIndex:
    """Return both trees over the searched edges of every object that has enough.

    Parameters
    ----------
    mesh, components, planes, edges
        The finished tables.

    Notes
    -----
    O(n log n). Dual points after Hertzmann and Zorin (2000); the published tree of
    them is the hextree ("Geometry of Real Time Shadows"), which is kept as
    `reference.hextree`. Normal cones after Sander et al. (2000).
    """
    object_edge = components.edge_start[components.object_start]
    is_searched = edges.flags == 0
    counts = np.add.reduceat(np.append(is_searched, False), object_edge[:-1], dtype=np.int64)
    counts[object_edge[:-1] == object_edge[1:]] = 0
    objects = np.flatnonzero(counts >= FEWEST_PAIRS)
    pair_start = np.concatenate(([0], np.cumsum(counts[objects])))
    pairs = searched_pairs(is_searched, object_edge, objects)
    made = _Maker(
        mesh=mesh,
        planes=planes,
        frames=_frames(mesh, objects, planes.tolerance_m),
        pairs=pairs,
        pair_start=pair_start,
        refs=planes.plane_of_face[edges.rows[pairs, 2:]],
        ends=np.ascontiguousarray(edges.rows[pairs, :2]),
    )
    hextree, cones = made.trees() if len(objects) else (_no_tree(), _no_tree())
    return SilhouetteIndex(
        objects=objects.astype(np.uint32),
        frames=made.frames,
        pair_start=pair_start,
        hextree=hextree,
        cones=cones,
    )


@dataclass(frozen=True, slots=True)
class _Maker:
    """What both trees are made of."""

    mesh: Mesh
    planes: PlaneTable
    frames: F32
    pairs: U32
    """``(n,)``: the searched records, per object."""
    pair_start: I64
    refs: U32
    """``(n, 2)``: their plane records, and their vertices."""
    ends: U32

    def trees(self) -> tuple[SilhouetteTree, SilhouetteTree]:
        """Return the tree of dual boxes, and that of cones."""
        box_keys = np.empty((len(self.pairs), 4), np.float32)
        cone_keys = np.empty((len(self.pairs), 6), np.float32)
        planes, points, frames, start = (
            self.planes.planes,
            self.mesh.positions,
            self.frames,
            self.pair_start,
        )
        for_ranges(
            start,
            lambda a, b: write_keys(
                planes, self.refs, self.ends, points, frames, start, a, b, box_keys, cone_keys
            ),
        )
        boxes, cones = run_together(
            [lambda: self._tree(box_keys, False), lambda: self._tree(cone_keys, True)]
        )
        return boxes, cones

    def _tree(self, keys: F32, is_cones: bool) -> SilhouetteTree:
        """Order the edges by their keys and bound them."""
        start, frames, planes = self.pair_start, self.frames, self.planes.planes
        order = np.arange(len(self.pairs), dtype=np.uint32)
        for_ranges(start, lambda a, b: order_pairs(keys, order, start, a, b))
        refs, ends = self.refs[order], self.ends[order]
        starts = tree_starts(start)
        blocks = np.zeros(64 * int(starts[-1, 1]), np.int16)
        extents = np.empty((2, 0 if is_cones else int(starts[-1, 2]), 4))
        extents[0], extents[1] = np.inf, -np.inf
        points, tolerance_m = self.mesh.positions, self.planes.tolerance_m

        def bound(a: int, b: int) -> None:
            if is_cones:
                write_cones(planes, refs, ends, points, frames, starts, tolerance_m, a, b, blocks)
            else:
                write_boxes(planes, refs, frames, starts, a, b, extents[0], extents[1], blocks)

        for_ranges(start, bound)
        bounds = blocks.reshape(-1, 8, 8)
        return SilhouetteTree(self.pairs[order], bounds, expected_work(is_cones, bounds, starts))


def _no_tree() -> SilhouetteTree:
    return SilhouetteTree(
        edge=np.zeros(0, np.uint32),
        blocks=np.zeros((0, 8, 8), np.int16),
        expected_work=np.zeros((0, 2), np.float32),
    )


def searched_pairs(is_searched: np.ndarray, object_edge: I64, objects: I64) -> U32:
    """Return the ids of the searched records of `objects`, ascending per object."""
    chosen = np.zeros(len(object_edge) - 1, np.bool_)
    chosen[objects] = True
    of_object = np.repeat(chosen, np.diff(object_edge))
    return np.flatnonzero(is_searched & of_object).astype(np.uint32)


def _frames(mesh: Mesh, objects: I64, tolerance_m: float) -> F32:
    """Return the centre of each object's box and its radius, ``(n, 4) float32`` [m]."""
    frames = np.empty((len(objects), 4), np.float32)
    if not len(objects):
        return frames
    rows, start = rows_of_runs(mesh.object_vertex_start, objects)
    points, first = mesh.positions.take(rows, axis=0), start[:-1]
    low = np.minimum.reduceat(points, first, axis=0).astype(np.float64)
    frames[:, :3] = (low + np.maximum.reduceat(points, first, axis=0)) / 2.0
    away = points - np.repeat(frames[:, :3].astype(np.float64), np.diff(start), axis=0)
    radius = np.sqrt(np.maximum.reduceat((away**2).sum(axis=1), first))
    least = max(2.0 * tolerance_m, mesh.grid.step_m)
    frames[:, 3] = np.maximum(radius, least) * (1.0 + 1e-6)
    return frames


def expected_work(is_cones: bool, blocks: I16, starts: I64) -> F32:
    """Return the edges and nodes that a query tests on average, ``(n_trees, 2)``.

    Notes
    -----
    For a random direction l, the cosine of a unit normal with it is uniform in
    -1..1, so a box of normals with half extents e is open with the probability
    ``E |e . l| = (ex + ey + ez) / 2``, and a cone with about the sine of its
    half-angle. A point light adds the extent of d, or the radius, over its distance:
    taken is half as many points as directions, at three radii.
    """
    numbers = blocks.astype(np.int64)
    # In sixths of a unit: whole numbers, the same sums on any machine.
    if is_cones:
        chance = 6 * numbers[:, 7] + numbers[:, 3]
    else:
        chance = 3 * numbers[:, 4:7].sum(axis=1) + 2 * numbers[:, 7]
    certain = 6 * int(UNIT)
    open_lanes = np.minimum(chance, certain).sum(axis=1)
    n_leaves = np.diff(starts[:, 2])
    work = np.empty((len(n_leaves), 2), np.float32)
    total = np.concatenate(([0], np.cumsum(open_lanes))) / certain
    first_leaf_block = starts[1:, 1] - -(-n_leaves // LEAF)
    work[:, 0] = LEAF * (total[starts[1:, 1]] - total[first_leaf_block])
    work[:, 1] = LEAF * (1.0 + total[first_leaf_block] - total[starts[:-1, 1]])
    return work
