"""The two trees as a query reads them: `cones`, and the dual boxes of `hextree`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svprep.kernels.tree_build import write_leaves
from svprep.model import F32, I8, I16, I64, U32, SilhouetteTree
from svprep.parallel import for_ranges
from svprep.silhouette.tables import SearchTables, check_starts, contradiction, read_only

LEAF = 8
"""Edges in a leaf, and children of a node: the lanes of a block."""


def tree_starts(pair_start: I64) -> I64:
    """Return where each tree's pairs, blocks and leaves begin, ``(n_trees + 1, 4)``.

    The fourth column, of always-on records, is zero.
    """
    n_pairs = np.diff(pair_start)
    n_leaves = -(-n_pairs // LEAF)
    n_blocks = np.zeros(len(n_pairs), np.int64)
    level = n_leaves
    while True:
        level = -(-level // LEAF)
        n_blocks += level
        if (level <= 1).all():
            break
        level = np.where(level > 1, level, 0)
    starts = np.zeros((len(pair_start), 4), np.int64)
    starts[:, 0] = pair_start
    np.cumsum(n_blocks, out=starts[1:, 1])
    np.cumsum(n_leaves, out=starts[1:, 2])
    return starts


@dataclass(frozen=True, slots=True)
class TreeTables:
    """What `kernels.search.search_trees` reads of one kind of tree."""

    frames: F32
    starts: I64
    blocks: I16
    """``(64 * n_blocks,)``"""
    leaves: I16
    """``(64 * n_leaves,)``: the dual points of each leaf's edges."""
    order: U32
    refs: U32
    """``(n_pairs, 2)``: plane records left and right of each edge, in tree order."""
    always: U32
    always_refs: U32
    floor_of_tree: I8
    """``(n_trees,)``: -1 all robust, 0 all solid, 1 mixed."""


def tree_tables(tables: SearchTables, tree: SilhouetteTree) -> TreeTables:
    """Return the tables of one tree. O(n), once per cache and kind."""
    index = tables.index
    objects = index.objects.astype(np.int64)
    check_starts("index/pair_start", index.pair_start, len(tree.edge))
    starts = tree_starts(index.pair_start)
    _check_tree(tables, tree, starts)
    position_of_record = np.zeros(len(tables.edges.rows), np.uint32)
    position_of_record[tables.record] = np.arange(len(tables.record), dtype=np.uint32)
    position = position_of_record.take(tree.edge)
    refs = tables.sides_of(position)
    is_always = np.zeros(len(tables.record), np.bool_)
    for k in objects.tolist():
        is_always[tables.begin[k] : tables.begin[k + 1]] = True
    is_always[position] = False
    always = np.flatnonzero(is_always)
    starts[1:, 3] = np.searchsorted(always, tables.begin[objects + 1])
    always_refs = tables.sides_of(always)
    leaves = _on_lines(64 * int(starts[-1, 2]))
    leaves[...] = 0
    blocks = _on_lines(tree.blocks.size)
    blocks[...] = tree.blocks.reshape(-1)
    for_ranges(
        index.pair_start,
        lambda a, b: write_leaves(
            tables.planes, read_only(refs), read_only(index.frames), read_only(starts), a, b, leaves
        ),
    )
    floors = np.zeros(len(objects), np.int8)
    for i, k in enumerate(objects.tolist()):
        floors[i] = common_floor(tables.floor, tables.plane_start, k)
    return TreeTables(
        frames=read_only(index.frames),
        starts=read_only(starts),
        blocks=read_only(blocks),
        leaves=read_only(leaves),
        order=read_only(tree.edge),
        refs=read_only(refs),
        always=read_only(tables.record.take(always)),
        always_refs=read_only(always_refs),
        floor_of_tree=read_only(floors),
    )


def _check_tree(tables: SearchTables, tree: SilhouetteTree, starts: I64) -> None:
    """Raise `CacheError` where a search would read beyond an array or name a wrong edge."""
    index = tables.index
    objects, n_trees = index.objects.astype(np.int64), len(index.objects)
    is_whole = (
        len(starts) == n_trees + 1
        and len(index.frames) == n_trees
        and len(tree.expected_work) == n_trees
        and len(tree.blocks) == starts[-1, 1]
        and (np.diff(starts[:, 0]) > 0).all()
        and (np.diff(objects) > 0).all()
        and (n_trees == 0 or objects[-1] < tables.n_objects)
        and (index.frames[:, 3] > 0.0).all()
    )
    if not is_whole:
        raise contradiction("the silhouette trees do not fit their objects")
    first = starts[:-1, 0]
    low, high = (f.reduceat(tree.edge, first) for f in (np.minimum, np.maximum))
    if (low < tables.object_edge[objects]).any() or (high >= tables.object_edge[objects + 1]).any():
        raise contradiction("a silhouette tree holds edges of another object")
    if (tables.edges.flags.take(tree.edge) != 0).any():
        raise contradiction("a silhouette tree holds planar, border or split records")


def _on_lines(n: int) -> I16:
    """Return ``(n,) int16`` that begins where a line of the processor's cache does.

    A block then takes two lines and not three. Not `np.zeros`: NumPy asks for huge
    pages only where it does not ask for cleared ones.
    """
    room = np.empty(n + 32, np.int16)
    skipped = -room.ctypes.data % 64 // 2
    return room[skipped : skipped + n]


def common_floor(floor: I8, plane_start: I64, k: int) -> int:
    """Return the floor of all plane records of object k, or 1 where they differ."""
    own = floor[plane_start[k] : plane_start[k + 1]]
    low, high = int(own.min()), int(own.max())
    return low if low == high else 1
