"""Whether the bounds of the silhouette trees hold what they stand for.

Written from FORMAT.md, section Silhouette trees, and sharing no code with the
kernels that make the bounds: a tree that passes over a silhouette edge is found
here, whatever made it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from svprep.cache.checks import Problem, problem_at
from svprep.cache.codec import BLOCK, face_normals
from svprep.cache.tables import Tables, owner_of_rows
from svprep.model import BOOL, F64, I64, U32

LEAF = 8
"""Edges of a leaf, nodes of a block."""
UNIT = 32000.0
"""Whole numbers of a stored 1."""
OPEN_SINE = 32000
"""The stored sine of a cone, and its sphere, that bound nothing."""

BOUND_NEEDS = (
    "edges/half_edges",
    "index/frame",
    "index/object",
    "index/pair_start",
    "mesh/face_corners",
    "mesh/positions",
    "objects/face_start",
    "planes/d",
    "planes/face",
    "planes/plane_of_face",
)
"""What both checks of bounds read beside the tree itself."""
CONE_NEEDS = (*BOUND_NEEDS, "cones/blocks", "cones/edge")


@dataclass(frozen=True, slots=True)
class Level:
    """The nodes of one level of all trees that are so high; level 0 is the leaves."""

    tree: I64
    """``(n_nodes,)``"""
    number: I64
    """``(n_nodes,)``: of each node in its level of its tree."""
    slot: I64
    """``(n_nodes,)``: where its bounds are, ``8 * block + lane``."""


def levels(pair_start: U32) -> tuple[list[Level], int]:
    """Return the levels of all trees, leaves first, and how many blocks they take.

    ``pair_start (n_trees + 1,)``. Every level is bounded by a block per 8 nodes; a
    tree ends with the level that fits one block. O(nodes).
    """
    start = pair_start.astype(np.int64)
    n_edges = start[1:] - start[:-1]
    n_nodes: list[I64] = [-(-n_edges // LEAF)]
    n_blocks: list[I64] = [-(-n_nodes[0] // LEAF)]
    while (n_blocks[-1] > 1).any():
        n_nodes.append(np.where(n_blocks[-1] > 1, n_blocks[-1], 0))
        n_blocks.append(-(-n_nodes[-1] // LEAF))
    own = np.stack(n_blocks)
    end_of_tree = np.cumsum(own.sum(axis=0))
    # The top comes first, so the leaves' blocks are a tree's last.
    first_block = end_of_tree - np.cumsum(own, axis=0)
    found = []
    for nodes, first in zip(n_nodes, first_block, strict=True):
        tree = np.repeat(np.arange(len(nodes)), nodes)
        number = np.arange(len(tree)) - np.repeat(np.cumsum(nodes) - nodes, nodes)
        found.append(Level(tree, number, LEAF * first[tree] + number))
    return found, int(end_of_tree[-1]) if len(end_of_tree) else 0


def box_problems(t: Tables) -> list[Problem]:
    """Return the blocks whose boxes miss a dual point of an edge below them (V412).

    O(edges + nodes), vectorised level by level: the bounds of a node's edges are
    those of its children's.
    """
    all_levels, n_blocks = levels(t["index/pair_start"])
    slots = _slots(t["hextree/blocks"])
    dual, order = _dual_points(t), t["hextree/edge"]
    low = np.empty((len(all_levels[0].tree), 4))
    high = np.empty_like(low)
    for leaves, edges, begin in _leaf_ranges(all_levels[0], t["index/pair_start"]):
        records = _records_beside(t, order[edges])
        left, right = (dual.take(records[:, side], axis=0) for side in range(2))
        low[leaves] = np.minimum.reduceat(np.minimum(left, right), begin)
        high[leaves] = np.maximum.reduceat(np.maximum(left, right), begin)
    in_units = np.array([UNIT, UNIT, UNIT, UNIT / 2.0])
    low *= in_units
    high *= in_units
    is_wrong = np.zeros(LEAF * n_blocks, np.bool_)
    for below, level in zip([None, *all_levels], all_levels, strict=False):
        if below is not None:
            kept, begin = _children(below, level)
            low = np.minimum.reduceat(low[kept], begin)
            high = np.maximum.reduceat(high[kept], begin)
        centre, half = np.split(slots.take(level.slot, axis=0), 2, axis=1)
        is_wrong[level.slot] = ~((centre - half <= low) & (high <= centre + half)).all(axis=1)
    message = "boxes without a dual point of an edge below them, in blocks"
    return _wrong_blocks("hextree/blocks", message, is_wrong)


def cone_problems(t: Tables) -> list[Problem]:
    """Return the blocks whose spheres or cones miss an edge below them (V412).

    O(edges x levels): a sphere and a cone do not follow from those below.
    """
    all_levels, n_blocks = levels(t["index/pair_start"])
    slots = _slots(t["cones/blocks"])
    is_open: BOOL = np.asarray(slots[:, 7] == OPEN_SINE)
    slots /= UNIT
    with np.errstate(invalid="ignore"):  # an axis of zero: allowed where the cone is open
        slots[:, 4:7] /= np.sqrt((slots[:, 4:7] ** 2).sum(axis=1))[:, None]
    dual, order = _dual_points(t), t["cones/edge"]
    frames = t["index/frame"].astype(np.float64)
    lowest = all_levels[0]
    slot_of_leaf = list(_slots_above(all_levels, t["index/pair_start"]))
    is_wrong = np.zeros(LEAF * n_blocks, np.bool_)
    for leaves, edges, begin in _leaf_ranges(lowest, t["index/pair_start"]):
        leaf_of_edge = np.repeat(np.arange(len(begin)), np.diff(begin, append=len(order[edges])))
        frame = frames.take(lowest.tree[leaves].take(leaf_of_edge), axis=0)
        middles = (_middles(t, order[edges]) - frame[:, :3]) / frame[:, 3:]
        room = t.tolerance_m / frame[:, 3]
        records = _records_beside(t, order[edges])
        normals = [dual.take(records[:, side], axis=0)[:, :3] for side in range(2)]
        for slot, has_level in slot_of_leaf:
            holds = np.ones(len(middles), np.bool_)
            bound = slots.take(slot[leaves].take(leaf_of_edge), axis=0)
            away = _length(middles - bound[:, :3])
            holds &= away + room <= bound[:, 3]
            for normal in normals:
                holds &= _dot(normal, bound[:, 4:7]) > 0.0
                holds &= _length(_cross(normal, bound[:, 4:7])) <= bound[:, 7]
            wrong_leaf = np.logical_or.reduceat(~holds, begin) & has_level[leaves]
            is_wrong[slot[leaves][wrong_leaf]] = True
    message = "spheres or cones without an edge below them, in blocks"
    is_wrong &= ~is_open
    return _wrong_blocks("cones/blocks", message, is_wrong)


def _wrong_blocks(where: str, message: str, is_wrong: BOOL) -> list[Problem]:
    bad: BOOL = np.logical_or.reduce(is_wrong.reshape(-1, LEAF), axis=1)
    return problem_at("V412", where, message, bad)


def _slots(blocks: np.ndarray) -> F64:
    """Return ``(8 * n_blocks, 8)``: the numbers of each lane together."""
    return blocks.transpose(0, 2, 1).reshape(-1, LEAF).astype(np.float64)


def _dual_points(t: Tables) -> F64:
    """Return ``(n_planes, 4)``: each record's dual point in its object's frame.

    NaN, which no bound holds, for records of objects without trees.
    """
    tree_of_object = np.full(len(t["objects/face_start"]) - 1, -1)
    tree_of_object[t["index/object"]] = np.arange(len(t["index/object"]))
    tree = tree_of_object[owner_of_rows(t["objects/face_start"])].take(t["planes/face"])
    faces = t["mesh/face_corners"].reshape(-1, 3)
    frames = t["index/frame"].astype(np.float64)
    dual = np.full((len(tree), 4), np.nan)
    has_tree = np.flatnonzero(tree >= 0)
    for start in range(0, len(has_tree), BLOCK):
        chosen = has_tree[start : start + BLOCK]
        frame = frames.take(tree[chosen], axis=0)
        corners = faces.take(t["planes/face"].take(chosen), axis=0)
        n = face_normals(t["mesh/positions"], corners)
        length = _length(n)
        dual[chosen, :3] = n / length[:, None]
        height = t["planes/d"].take(chosen) + _dot(n, frame[:, :3])
        dual[chosen, 3] = height / (frame[:, 3] * length)
    return dual


def _leaf_ranges(leaves: Level, pair_start: U32) -> Iterator[tuple[slice, slice, I64]]:
    """Yield ranges of leaves, their edges, and where each one's begin among those."""
    end = int(pair_start[-1])
    begin = np.append(pair_start.astype(np.int64)[leaves.tree] + LEAF * leaves.number, end)
    step = BLOCK // LEAF
    for first in range(0, len(leaves.tree), step):
        last = min(first + step, len(leaves.tree))
        edges = slice(int(begin[first]), int(begin[last]))
        yield slice(first, last), edges, begin[first:last] - begin[first]


def _children(below: Level, level: Level) -> tuple[BOOL, I64]:
    """Return which nodes below have a node above them, and where each one's begin."""
    has_node = np.zeros(int(below.tree.max()) + 1, np.bool_)
    has_node[level.tree] = True
    kept = has_node[below.tree]
    return kept, np.flatnonzero(below.number[kept] % LEAF == 0)


def _slots_above(all_levels: list[Level], pair_start: U32) -> Iterator[tuple[I64, BOOL]]:
    """Yield, per level, the slot of the node above each leaf, and whether there is one."""
    leaves = all_levels[0]
    n_trees = len(pair_start) - 1
    for height, level in enumerate(all_levels):
        first_slot = np.full(n_trees, -1)
        is_first = level.number == 0
        first_slot[level.tree[is_first]] = level.slot[is_first]
        has_level = first_slot[leaves.tree] >= 0
        slot = first_slot[leaves.tree] + leaves.number // LEAF**height
        yield np.where(has_level, slot, 0), has_level


def _records_beside(t: Tables, edges: U32) -> U32:
    """Return ``(k, 2)``: the plane records left and right of edge records of two faces."""
    return t["planes/plane_of_face"].take(t["edges/half_edges"].take(edges, axis=0) // 3)


def _middles(t: Tables, edges: U32) -> F64:
    """Return ``(k, 3)`` [m]: the middles of edge records of two faces.

    The left half-edge begins at one end, the right one at the other.
    """
    ends = t["mesh/face_corners"].take(t["edges/half_edges"].take(edges, axis=0))
    first, last = (t["mesh/positions"].take(ends[:, i], axis=0) for i in range(2))
    return (first.astype(np.float64) + last) / 2.0


def _dot(a: F64, b: F64) -> F64:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def _length(a: F64) -> F64:
    return np.sqrt(_dot(a, a))


def _cross(a: F64, b: F64) -> F64:
    product = np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        product[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return product
