"""Half-edges grouped by edge and paired; components connected through pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svprep.kernels.half_edges import group_half_edges, pair_half_edges
from svprep.kernels.rows import counting_order
from svprep.kernels.union_find import union_with_parity
from svprep.model import BOOL, I32, I64, U32
from svprep.parallel import for_ranges


@dataclass(frozen=True, slots=True)
class EdgeGroups:
    """Half-edges sorted by undirected edge. Half-edge h is corner h % 3 of face h // 3."""

    order: I32
    """``(3 n_faces,)``: half-edges by (object, lo vertex, hi vertex, h)."""
    start: I64
    """``(n_edges + 1,)``: edge e owns ``order[start[e]:start[e + 1]]``."""

    @property
    def n_faces_of_edge(self) -> I64:
        """``(n_edges,)``: how many faces meet at each edge."""
        return np.diff(self.start)


def group_edges(faces: U32, face_start: I64, vertex_begin: I64, vertex_end: I64) -> EdgeGroups:
    """Return the half-edges of `faces` grouped by undirected edge.

    ``face_start (n_objects + 1,)``; object i uses vertices
    ``[vertex_begin[i], vertex_end[i])``. O(n). Plain twin: `reference.group_edges`.
    """
    order = np.empty(3 * len(faces), np.int32)
    is_first = np.empty(3 * len(faces), bool)

    def work(begin: int, end: int) -> None:
        group_half_edges(faces, face_start, vertex_begin, vertex_end, begin, end, order, is_first)

    for_ranges(face_start, work)
    start = np.concatenate((np.flatnonzero(is_first), [len(order)])).astype(np.int64)
    return EdgeGroups(order=order, start=start)


def pair_edges(points: I32, faces: U32, flips: BOOL, groups: EdgeGroups, is_loose: BOOL) -> I32:
    """Return ``(3 n_faces,) int32``: the half-edge each one is paired with, or -1.

    Two faces that wind consistently are a pair; two that do not are cut; more
    than two are matched by angle (see `kernels.half_edges.pair_half_edges`,
    after Steiner 2006, A.2). ``flips (n_faces,)`` marks faces to be read turned,
    `is_loose` those that `loose_faces` finds.
    Plain twin: `reference.pair_edges`.
    """
    mate = np.empty(3 * len(faces), np.int32)
    most = int(groups.n_faces_of_edge.max(initial=1))

    def work(begin: int, end: int) -> None:
        pair_half_edges(
            points, faces, flips, is_loose, groups.order, groups.start, begin, end, most, mate
        )

    for_ranges(groups.start, work)
    return mate


def doubles(groups: EdgeGroups) -> tuple[I32, I32]:
    """Return the two half-edges of each edge that has two."""
    first = groups.start[:-1][groups.n_faces_of_edge == 2]
    return groups.order[first], groups.order[first + 1]


def loose_faces(patch: I32, groups: EdgeGroups) -> BOOL:
    """Return ``(n_faces,)``: faces that hang on a border edge over edges of two faces.

    They can be part of no closed surface, so where more than two faces meet
    they must not take a place that another face needs. Only asked there:
    without such an edge no face is called loose. ``patch (n_faces,)``: the
    lowest face that each hangs together with over edges of two.
    """
    size = groups.n_faces_of_edge
    is_loose = np.zeros(len(patch), bool)
    if not (size > 2).any():
        return is_loose
    is_loose[patch[groups.order[groups.start[:-1][size == 1]] // 3]] = True
    return is_loose[patch]


def join(a: I32, b: I32, root: I32) -> I32:
    """Return the lowest face that each face hangs together with over pairs (a, b) of faces.

    ``root (n_faces,)``: the lowest that each is known to hang together with already.
    """
    root = root.copy()
    nowhere = np.zeros(len(a), bool)
    union_with_parity(a, b, nowhere, root, np.zeros(len(root), bool), np.empty(len(a), bool))
    return root


def connect(mate: I32, patch: I32, groups: EdgeGroups) -> I32:
    """Return the lowest face of each face's component, which hangs together over pairs.

    ``patch (n_faces,)``: the lowest face that each hangs together with over pairs at
    edges of two faces.
    """
    is_crowded = groups.n_faces_of_edge > 2
    if not is_crowded.any():
        return patch
    among = groups.order[np.repeat(is_crowded, groups.n_faces_of_edge)]
    first = among[mate[among] > among]
    return join(first // np.int32(3), mate[first] // np.int32(3), patch)


def sort_stably(keys: I32, n_keys: int) -> tuple[I32, I64]:
    """Return the stable order that sorts `keys`, and the start of each key's run."""
    order = np.empty(len(keys), np.int32)
    start = np.empty(n_keys + 1, np.int64)
    counting_order(keys, n_keys, order, start)
    return order, start
