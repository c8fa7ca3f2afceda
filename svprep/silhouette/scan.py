"""The flat scan and the trees, object by object, on all threads.

The methods `flat`, `cones`, `hextree` and `auto` differ in the plan alone:

    trees searched, planes faced, multiplicities counted     each thread a chunk
    rows, written once, in their place                       each thread its chunk
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svprep.kernels.flat_scan import compress, multiplicities
from svprep.kernels.search import counted_facing, search_trees
from svprep.model import F32, F64, I8, I64, U32
from svprep.parallel import run_together, thread_count
from svprep.silhouette.result import Work
from svprep.silhouette.tables import SearchTables, read_only
from svprep.silhouette.trees import TreeTables

_SHARE = 250_000
"""Scanned records that are worth a thread: waking one takes as long as scanning these."""
_WORTH_CUTTING = 1_000_000
"""Records of an object that is worth cutting, which takes one more turn of all threads."""

Ranges = tuple[I64, I64]
"""Begins and ends."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """One thread's share: objects ``first .. last - 1`` of a plan."""

    first: int
    last: int
    begin_at: int
    """Where in the first object's records it begins, and in the last one's it ends."""
    end_at: int
    runs: tuple[I64, I64, I64]
    """Ranges of records to scan, and where their multiplicities go."""
    planes: Ranges
    """Plane records to face."""
    trees: I64
    """Trees to search, and where in the plan their objects are."""
    tree_at: I64
    keys: tuple[int, int]
    """Room for what the search finds."""
    largest: int
    """The most records that a searched object has."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Which objects are scanned and which searched, and how threads share them."""

    objects: I64
    """``(k,)``, ascending."""
    begin: I64
    """``(k,)``: each one's records to scan; none where its tree is searched."""
    end: I64
    to: I64
    """``(k,)``: where their multiplicities go."""
    n_scanned: int
    n_keys: int
    no_keys: I64
    """``(k,)`` zeros."""
    chunks: tuple[Chunk, ...]
    is_cut: bool
    """Whether a large object lies in several chunks: its records then wait until
    all its planes are faced."""


def make_plan(
    tables: SearchTables,
    objects: I64,
    tree_of_object: I64,
    trees: TreeTables | None,
    cost_of_tree: F64,
) -> Plan:
    """Return the plan for `objects`; O(k).

    ``tree_of_object (k,)``: -1 to scan it. ``cost_of_tree (n_trees,)``: of a search,
    in scanned records.
    """
    is_scanned = tree_of_object < 0
    begin = np.where(is_scanned, tables.begin[objects], 0)
    end = np.where(is_scanned, tables.begin[objects + 1], 0)
    length = end - begin
    to = np.cumsum(length) - length
    work = length.astype(np.float64)
    room = np.zeros(len(objects), np.int64)
    if trees is not None:
        searched = tree_of_object[~is_scanned]
        work[~is_scanned] = cost_of_tree[searched]
        room[~is_scanned] = (trees.starts[searched + 1] - trees.starts[searched])[:, [0, 3]].sum(1)
    key = np.concatenate(([0], np.cumsum(room)))
    cuts = _cuts(work, length)
    is_cut = any(skipped for _, skipped in cuts)
    chunks = []
    for i, ((first, skipped), (last, more)) in enumerate(pairwise(cuts)):
        stop = last + (more > 0)
        begin_at = int(begin[first]) + skipped
        end_at = int(begin[last]) + more if more else int(end[stop - 1])
        at = first + np.flatnonzero(~is_scanned[first:stop])
        chosen = objects if is_cut else objects[first:stop]
        chosen = chosen[is_scanned if is_cut else is_scanned[first:stop]]
        planes = _joined(tables.plane_start[chosen], tables.plane_start[chosen + 1])
        chunks.append(
            Chunk(
                first=first,
                last=stop,
                begin_at=begin_at,
                end_at=end_at,
                runs=_runs(begin[first:stop], end[first:stop], to[first:stop], begin_at, end_at),
                planes=_share(planes, i, len(cuts) - 1) if is_cut else planes,
                trees=read_only(tree_of_object[at]),
                tree_at=read_only(at),
                keys=(int(key[first]), int(key[stop])),
                largest=int(room[first:stop].max()),
            )
        )
    return Plan(
        objects=objects,
        begin=read_only(begin),
        end=read_only(end),
        to=read_only(to),
        n_scanned=int(length.sum()),
        n_keys=int(key[-1]),
        no_keys=read_only(np.zeros(len(objects), np.int64)),
        chunks=tuple(chunks),
        is_cut=is_cut,
    )


def _cuts(work: F64, length: I64) -> list[tuple[int, int]]:
    """Return the object, and the record in it, where each chunk begins, and the end."""
    total = np.cumsum(work)
    n_chunks = thread_count() if len(work) and total[-1] >= 2 * _SHARE else 1
    cuts = [(0, 0)]
    for i in range(1, n_chunks):
        target = i * total[-1] / n_chunks
        k = min(int(np.searchsorted(total, target, "right")), len(work) - 1)
        # Only a large object is worth cutting.
        skipped = int(target - (total[k] - work[k])) if length[k] >= _WORTH_CUTTING else 0
        cuts.append((k, min(skipped, int(length[k]))))
    # Two may fall into one small object: an empty chunk would take its share of planes along.
    return list(dict.fromkeys([*cuts, (len(work), 0)]))


def _joined(begin: I64, end: I64) -> Ranges:
    """Return the ranges that are not empty, those joined that touch."""
    some = end > begin
    begin, end = begin[some], end[some]
    is_first = np.ones(len(begin), np.bool_)
    is_first[1:] = begin[1:] != end[:-1]
    is_last = np.ones(len(begin), np.bool_)
    is_last[:-1] = is_first[1:]
    return read_only(begin[is_first]), read_only(end[is_last])


def _share(ranges: Ranges, i: int, n_shares: int) -> Ranges:
    """Return the i-th of `n_shares` equal parts of the numbers in `ranges`."""
    begin, end = ranges
    total = np.cumsum(end - begin)
    start, stop = (int(total[-1]) * k // n_shares for k in (i, i + 1))
    before = total - (end - begin)
    return _joined(
        np.clip(begin + (start - before), begin, end), np.clip(begin + (stop - before), begin, end)
    )


def _runs(begin: I64, end: I64, to: I64, begin_at: int, end_at: int) -> tuple[I64, I64, I64]:
    """Return the records of objects as ranges, those joined that follow each other."""
    begin, end, to = begin.copy(), end.copy(), to.copy()
    to[0] += begin_at - begin[0]
    begin[0], end[-1] = begin_at, end_at
    firsts, lasts = _joined(begin, end)
    some = end > begin
    return firsts, lasts, read_only(to[some][np.searchsorted(begin[some], firsts)])


class Scratch:
    """Memory that a query fills and the next one may use again.

    Fresh memory would cost more than the arithmetic: the system clears each page.
    """

    def __init__(self) -> None:
        self._kept: dict[str, NDArray[Any]] = {}

    def array(self, name: str, n: int, dtype: type[np.generic]) -> NDArray[Any]:
        """Return ``(n,)`` of undefined content."""
        kept = self._kept.get(name)
        if kept is None or len(kept) < n:
            kept = self._kept[name] = np.empty(n, dtype)
        return kept[:n]


class Run:
    """One query: what its threads read, and where they write."""

    def __init__(
        self,
        tables: SearchTables,
        plan: Plan,
        light: F32,
        floor: I8,
        trees: TreeTables | None,
        floor_of_tree: I8,
        is_cones: bool,
        scratch: Scratch,
    ) -> None:
        """Prepare a query.

        ``floor (n_planes + 1,)`` as `SearchTables.floor`, ``floor_of_tree (n_trees,)`` as
        `TreeTables.floor_of_tree`, both for this light.
        """
        self.tables, self.plan, self.trees, self.is_cones = tables, plan, trees, is_cones
        self.floor, self.floor_of_tree = floor, floor_of_tree
        self.light = tuple(float(v) for v in light)
        self.scratch = scratch
        self.s = scratch.array("facing", len(tables.planes) + 1, np.int8)
        self.s[-1] = 0
        self.m = scratch.array("multiplicity", plan.n_scanned, np.int8)
        self.keys = scratch.array("keys", plan.n_keys, np.uint64)
        # A scanned object has no keys; where all are scanned, the plan's zeros do.
        self.key_begin = plan.no_keys if plan.n_keys == 0 else plan.no_keys.copy()
        self.key_end = self.key_begin if plan.n_keys == 0 else plan.no_keys.copy()
        self.tested = np.zeros((len(plan.chunks), 2), np.int64)
        self.n_rows = [0] * len(plan.chunks)

    def rows(self) -> tuple[U32, I8, I64, Work]:
        """Return edge ids, multiplicities, object offsets and the work done."""
        plan = self.plan
        numbers = range(len(plan.chunks))
        if plan.is_cut:
            run_together([partial(self._look, i) for i in numbers])
            run_together([partial(self._count, i) for i in numbers])
        else:
            run_together([partial(self._look_and_count, i) for i in numbers])
        total = sum(self.n_rows)
        edge = np.empty(total, np.uint32)
        multiplicity = np.empty(total, np.int8)
        start = np.empty(len(plan.objects) + 1, np.int64)
        start[-1] = total
        run_together([partial(self._write, i, edge, multiplicity, start) for i in numbers])
        n_edges, n_nodes = self.tested.sum(axis=0).tolist()
        return edge, multiplicity, start, Work(plan.n_scanned + n_edges, n_nodes)

    def _look_and_count(self, i: int) -> None:
        self._look(i)
        self._count(i)

    def _look(self, i: int) -> None:
        """Search the trees of a chunk, and face its plane records."""
        chunk, tables, trees = self.plan.chunks[i], self.tables, self.trees
        if trees is not None and len(chunk.trees):
            first, last = chunk.keys
            ends = np.empty(len(chunk.trees), np.int64)
            search_trees(
                self.is_cones, chunk.trees, trees.frames, trees.starts, trees.blocks,
                trees.leaves, trees.order, trees.refs, trees.always, trees.always_refs,
                tables.planes, self.floor, self.floor_of_tree, *self.light,
                self.keys[first:last], self.scratch.array(f"other {i}", chunk.largest, np.uint64),
                self.scratch.array(f"open {i}", 2 * chunk.largest + 16, np.uint32).reshape(2, -1),
                ends, self.tested[i],
            )  # fmt: skip
            ends += first
            self.key_end[chunk.tree_at] = ends
            self.key_begin[chunk.tree_at[0]] = first
            self.key_begin[chunk.tree_at[1:]] = ends[:-1]
            self.n_rows[i] += int(ends[-1]) - first
        if len(chunk.planes[0]):
            counted_facing(
                tables.planes, tables.units, *self.light, self.floor, *chunk.planes, self.s
            )

    def _count(self, i: int) -> None:
        """Compute the multiplicities of a chunk's records."""
        runs = self.plan.chunks[i].runs
        if len(runs[0]):
            self.n_rows[i] += int(multiplicities(self.tables.sides, self.s, *runs, self.m))

    def _write(self, i: int, edge: U32, multiplicity: I8, start: I64) -> None:
        """Write a chunk's rows into their place."""
        plan, chunk = self.plan, self.plan.chunks[i]
        compress(
            self.tables.record, self.m, plan.begin, plan.end, plan.to,
            self.keys, read_only(self.key_begin), read_only(self.key_end),
            chunk.first, chunk.last, chunk.begin_at, chunk.end_at,
            sum(self.n_rows[:i]), self.n_rows[i], edge, multiplicity, start,
        )  # fmt: skip
