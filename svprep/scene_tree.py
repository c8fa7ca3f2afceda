"""The stage that sorts objects, and clusters of faces, into trees of boxes.

    faces of an object --halving--> clusters      of each object alone: `local_clusters`
    clusters of all objects --Hilbert curve--> leaves --eights--> nodes      `scene_tree`

A leaf's place on the curve depends on its own box and the grid's step, on nothing else. So
a tile of a city can find its clusters by itself, and where some objects change, all other
leaves keep their order: `updated_scene_tree`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.hilbert import BITS, hilbert_keys
from svprep.kernels.light_boxes import bound_casters
from svprep.kernels.tree_build import order_pairs
from svprep.model import BOOL, F32, I64, U32, U64, Mesh, SceneTree
from svprep.parallel import for_ranges, for_shares
from svprep.ranges import rows_of_runs
from svprep.silhouette.tables import read_only

LEAF: Final = 8
"""Children of a node, and faces of a cluster. `kernels.tree_build` cuts at multiples of it."""
_PROBES: Final = 1024
_MOST_PROBES: Final = 63
"""Of a step of a search: in all, and for one thing that is searched."""
_NOWHERE: Final = np.uint64(2**64 - 1)
"""The key of an object without faces: behind all others."""


@dataclass(frozen=True, slots=True)
class LocalClusters:
    """What the objects of a mesh, or of a tile of one, give to the scene tree."""

    faces: U32
    """``(n_faces,)``: faces of the mesh, object by object, in the order of clusters."""
    cluster_start: I64
    """``(n_clusters + 1,)``: cluster i has ``faces[start[i]:start[i + 1]]``."""
    boxes: F32
    """``(n_clusters, 6)`` [m]: as in `SceneTree`."""
    keys: U64
    """``(n_clusters,)``: places of the middles of `boxes` on the Hilbert curve."""
    object_boxes: F32
    """``(n_objects, 6)`` [m]"""
    object_keys: U64
    """``(n_objects,)``: 2**64 - 1 for one without faces."""


_NOTHING: Final = LocalClusters(
    faces=np.zeros(0, np.uint32),
    cluster_start=np.zeros(1, np.int64),
    boxes=np.zeros((0, 6), np.float32),
    keys=np.zeros(0, np.uint64),
    object_boxes=np.zeros((0, 6), np.float32),
    object_keys=np.zeros(0, np.uint64),
)


def build_scene_tree(mesh: Mesh) -> SceneTree:
    """Return the tree over objects and the one over clusters of faces."""
    return scene_tree(local_clusters(mesh))


def local_clusters(mesh: Mesh) -> LocalClusters:
    """Return the clusters of each object: a function of the object and the grid's step alone.

    Notes
    -----
    O(n log n); the halving of `kernels.tree_build`, by the middles of faces.
    """
    positions, face_start = read_only(mesh.positions), mesh.object_face_start
    first = np.concatenate(([0], np.cumsum(-(-np.diff(face_start) // LEAF))))
    start = _cluster_starts(face_start, first)
    faces = np.empty(len(mesh.faces), np.uint32)
    boxes = np.empty((len(start) - 1, 6), np.float32)

    def work(a: int, b: int) -> None:
        begin, end = int(face_start[a]), int(face_start[b])
        corners = mesh.faces[begin:end]
        own = np.arange(end - begin, dtype=np.uint32)
        middles = positions.take(corners[:, 0], axis=0)
        middles += positions.take(corners[:, 1], axis=0)
        middles += positions.take(corners[:, 2], axis=0)
        order_pairs(middles, own, face_start[a : b + 1] - begin, 0, b - a)
        i, j = int(first[a]), int(first[b])
        boxes[i:j] = _bounds(positions, corners.take(own, axis=0), start[i : j + 1] - begin)
        np.add(own, begin, out=faces[begin:end], casting="unsafe")

    for_ranges(face_start, work)
    object_boxes = _joined(boxes, first)
    step_m = mesh.grid.step_m
    return LocalClusters(
        faces=faces,
        cluster_start=start,
        boxes=boxes,
        keys=_keys(boxes, step_m),
        object_boxes=object_boxes,
        object_keys=_keys(object_boxes, step_m),
    )


def join_clusters(parts: Sequence[LocalClusters]) -> LocalClusters:
    """Return the clusters of tiles that follow each other, as those of the whole mesh."""
    if not parts:
        return _NOTHING
    n_faces = [len(part.faces) for part in parts]
    before = np.cumsum([0, *n_faces[:-1]])
    starts = [part.cluster_start[:-1] + n for part, n in zip(parts, before, strict=True)]
    return LocalClusters(
        faces=np.concatenate(
            [part.faces + np.uint32(n) for part, n in zip(parts, before, strict=True)]
        ),
        cluster_start=np.concatenate([*starts, [sum(n_faces)]]),
        boxes=np.concatenate([part.boxes for part in parts]),
        keys=np.concatenate([part.keys for part in parts]),
        object_boxes=np.concatenate([part.object_boxes for part in parts]),
        object_keys=np.concatenate([part.object_keys for part in parts]),
    )


def scene_tree(local: LocalClusters) -> SceneTree:
    """Return both trees over the whole.

    Notes
    -----
    O(n log n), one stable sort of keys. Leaves follow each other by place, not by object:
    runs of one object's clusters took twice as many tests in a city. Along the curve of
    Hilbert a clamp takes up to 8 % longer than in a tree by halving, whose order would be
    another one wherever any object changes.
    """
    order = np.argsort(local.keys, kind="stable")
    faces, start = _in_order(local.faces, local.cluster_start, order)
    objects, nodes = _objects(local.object_boxes, local.object_keys)
    return SceneTree(
        objects=objects,
        object_boxes=local.object_boxes,
        object_nodes=nodes,
        faces=faces,
        cluster_start=start,
        cluster_nodes=node_boxes(local.boxes.take(order, axis=0)),
    )


@dataclass(frozen=True, slots=True)
class EarlierScene:
    """A scene as it was, on a grid of the same origin and step."""

    mesh: Mesh
    tree: SceneTree
    object_before: I64
    """``(n_objects,)``: the number of each object as it is now, where both are the same but
    for where their faces and vertices begin; -1 where not. No number occurs twice."""


def updated_scene_tree(
    earlier: EarlierScene, face_start: I64, fresh: LocalClusters
) -> SceneTree | None:
    """Return what `build_scene_tree` returns of a mesh, from the tree of an earlier one.

    None where kept objects follow each other in another order, or half of all faces are new.

    Parameters
    ----------
    earlier : EarlierScene
    face_start : ndarray
        ``(n_objects + 1,) int64``: `object_face_start` of the mesh.
    fresh : LocalClusters
        Of a mesh of the objects that are new, alone.

    Notes
    -----
    Leaves that stay keep their order, so what is stored of them is copied run by run, and so
    are the nodes in which all eight leaves are one's before:

        leaves before | kept .... |gone| kept .. | kept ........ |
        leaves now    | kept .... | kept .. |new | kept ........ |
        nodes now     [   ][   ][made ][   ][made ][   ][   ][   ]

    O(n) with a small factor, and O(m log n) for m clusters that are new.
    """
    tree, before = earlier.tree, earlier.object_before
    kept, new = np.flatnonzero(before >= 0), np.flatnonzero(before < 0)
    is_shuffled = len(kept) > 1 and (np.diff(before[kept]) <= 0).any()
    if is_shuffled or 2 * len(fresh.faces) > face_start[-1] or not len(tree.faces):
        return None
    now = np.full(len(earlier.mesh.object_face_start) - 1, -1)
    now[before[kept]] = kept
    object_boxes = np.empty((len(before), 6), np.float32)
    object_boxes[kept] = tree.object_boxes[before[kept]]
    object_boxes[new] = fresh.object_boxes
    objects, object_nodes = _objects(object_boxes, _keys(object_boxes, earlier.mesh.grid.step_m))
    leaves = _leaves_now(earlier, now, fresh, new, face_start)
    numbers, _ = rows_of_runs(face_start, new)
    fresh_faces = numbers[fresh.faces].astype(np.uint32)
    old_faces = _renumbered(earlier, now, face_start)
    faces, start = leaves.joined(
        (old_faces, tree.cluster_start), (fresh_faces, fresh.cluster_start)
    )
    return SceneTree(
        objects=objects,
        object_boxes=object_boxes,
        object_nodes=object_nodes,
        faces=faces,
        cluster_start=start,
        cluster_nodes=_with_nodes_above(_lowest_nodes(earlier, leaves, fresh.boxes)),
    )


@dataclass(frozen=True, slots=True)
class _Leaves:
    """The leaves of a tree, as runs of clusters that were its leaves before, and of new ones."""

    first: I64
    """``(n_runs,)``: the first cluster of each run; new ones are numbered behind all before."""
    begin: I64
    """``(n_runs + 1,)``: where each run's leaves begin."""
    n_before: int

    @classmethod
    def of(cls, kept: I64, at: I64, new: I64, n_before: int) -> _Leaves:
        """Return kept clusters, with each new one before the leaf ``at``, ascending."""
        clusters = np.insert(kept, at, n_before + new)
        cuts = np.flatnonzero((np.diff(clusters) != 1) | (clusters[1:] == n_before)) + 1
        begin = np.concatenate(([0], cuts, [len(clusters)]))
        return cls(clusters[begin[:-1]], begin, n_before)

    def __len__(self) -> int:
        """Return the number of leaves."""
        return int(self.begin[-1])

    def clusters(self, leaves: I64) -> I64:
        """Return which clusters some leaves are."""
        run = np.searchsorted(self.begin, leaves, side="right") - 1
        return self.first[run] + leaves - self.begin[run]

    def joined(self, old: tuple[U32, I64], new: tuple[U32, I64]) -> tuple[U32, I64]:
        """Return the faces of all leaves, and where each one's begin, from those of clusters."""
        faces, starts, at = [np.zeros(0, np.uint32)], [], 0
        for a, n in zip(self.first.tolist(), np.diff(self.begin).tolist(), strict=True):
            values, start = old
            if a >= self.n_before:
                values, start, a = *new, a - self.n_before
            ends = start[a : a + n + 1]
            faces.append(values[ends[0] : ends[-1]])
            starts.append(ends[:-1] + (at - ends[0]))
            at += len(faces[-1])
        return np.concatenate(faces), np.concatenate([*starts, [at]])


def _leaves_now(
    earlier: EarlierScene, now: I64, fresh: LocalClusters, new: I64, face_start: I64
) -> _Leaves:
    """Return the leaves, which are ordered by key, and by object where keys are the same."""
    mesh, tree = earlier.mesh, earlier.tree
    n_before, old_start = len(tree.cluster_start) - 1, mesh.object_face_start
    is_gone = np.repeat(now < 0, np.diff(old_start))
    kept = np.flatnonzero(~is_gone[tree.faces[tree.cluster_start[:-1]]])
    order = np.argsort(fresh.keys, kind="stable")
    n_clusters = -(-np.diff(face_start)[new] // LEAF)
    keys, owner = fresh.keys[order], np.repeat(new, n_clusters)[order]

    def is_before(places: I64, which: I64) -> BOOL:
        corners, start = _in_order(tree.faces, tree.cluster_start, kept[places])
        boxes = _bounds(mesh.positions, mesh.faces[corners], start)
        first = corners[start[:-1]].astype(np.int64)
        theirs = now[np.searchsorted(old_start, first, side="right") - 1]
        key = _keys(boxes, mesh.grid.step_m)
        return (key < keys[which]) | ((key == keys[which]) & (theirs < owner[which]))

    return _Leaves.of(kept, _places(len(kept), len(order), is_before), order, n_before)


def _places(n: int, n_items: int, is_before: Callable[[I64, I64], BOOL]) -> I64:
    """Return how many of n, in order, come before each of some items.

    ``is_before(places, items)`` says it of some of the n and of as many items. A few items
    are compared with many places at a time. O(n_items log n).
    """
    low, high = np.zeros(n_items, np.int64), np.full(n_items, n)
    n_probes = min(_MOST_PROBES, max(1, _PROBES // max(n_items, 1)))
    shares = np.arange(1, n_probes + 1)
    while len(item := np.flatnonzero(low < high)):
        width = high[item] - low[item]
        places = low[item, None] + width[:, None] * shares // (n_probes + 1)
        is_less = is_before(places.reshape(-1), np.repeat(item, n_probes)).reshape(places.shape)
        n_less = is_less.sum(axis=1)
        row = np.arange(len(item))
        has_less, has_more = n_less > 0, n_less < n_probes
        low[item[has_less]] = places[row, n_less - 1][has_less] + 1
        high[item[has_more]] = places[row, np.minimum(n_less, n_probes - 1)][has_more]
    return low


def _renumbered(earlier: EarlierScene, now: I64, face_start: I64) -> U32:
    """Return the faces of the earlier tree as they are numbered now, those that are gone anyhow."""
    old_start = earlier.mesh.object_face_start
    shift = np.where(now >= 0, face_start[now] - old_start[:-1], 0)
    if not shift.any():
        return earlier.tree.faces
    shift_of_face = np.repeat(shift.astype(np.uint32), np.diff(old_start))  # modulo 2**32
    return earlier.tree.faces + shift_of_face.take(earlier.tree.faces)


def _lowest_nodes(earlier: EarlierScene, leaves: _Leaves, fresh_boxes: F32) -> F32:
    """Return the boxes of nodes: taken over where all eight leaves were one's before."""
    tree, mesh, n_before = earlier.tree, earlier.mesh, leaves.n_before
    boxes = np.empty((int(level_starts(len(leaves))[1]), 6), np.float32)
    is_new = np.ones(len(boxes), np.bool_)
    begin, end = -(-leaves.begin[:-1] // LEAF), leaves.begin[1:] // LEAF
    shift, moved_by = np.divmod(leaves.first - leaves.begin[:-1], LEAF)
    is_alike = (leaves.first < n_before) & (moved_by == 0) & (begin < end)
    for a, b, n in zip(*(x[is_alike].tolist() for x in (begin, end, shift)), strict=True):
        boxes[a:b] = tree.cluster_nodes[a + n : b + n]
        is_new[a:b] = False
    new = np.flatnonzero(is_new)
    positions = read_only(mesh.positions)

    def bound(a: int, b: int) -> None:
        inside = LEAF * new[a:b, None] + np.arange(LEAF)
        clusters = leaves.clusters(inside[inside < len(leaves)])
        is_old = clusters < n_before
        corners, start = _in_order(tree.faces, tree.cluster_start, clusters[is_old])
        of_leaves = np.empty((len(clusters), 6), np.float32)
        of_leaves[is_old] = _bounds(positions, mesh.faces[corners], start)
        of_leaves[~is_old] = fresh_boxes[clusters[~is_old] - n_before]
        boxes[new[a:b]] = _eights(of_leaves)

    for_shares(len(new), bound)
    return boxes


def level_starts(n_leaves: int) -> I64:
    """Return where the nodes of each level begin, ``(n_levels + 1,)``: at least one level."""
    starts = [0, -(-n_leaves // LEAF)]
    while starts[-1] - starts[-2] > 1:
        starts.append(starts[-1] + -(-(starts[-1] - starts[-2]) // LEAF))
    return np.array(starts, np.int64)


def node_boxes(leaf_boxes: F32) -> F32:
    """Return the boxes of all nodes over leaves with `leaf_boxes`, from level 0 up."""
    return _with_nodes_above(_eights(leaf_boxes))


def _with_nodes_above(lowest: F32) -> F32:
    """Return the boxes of level 0 and of all levels above it."""
    boxes = [lowest]
    while len(boxes[-1]) > 1:
        boxes.append(_eights(boxes[-1]))
    return np.concatenate(boxes)


def _eights(boxes: F32) -> F32:
    """Return the boxes around every eight boxes."""
    return _joined(boxes, np.append(np.arange(0, len(boxes), LEAF), len(boxes)))


def _objects(boxes: F32, keys: U64) -> tuple[U32, F32]:
    """Return the order of objects, and the nodes over them."""
    order = np.argsort(keys, kind="stable").astype(np.uint32)
    return order, node_boxes(boxes.take(order, axis=0))


def _in_order(values: U32, start: I64, order: I64) -> tuple[U32, I64]:
    """Return the runs of `values` that `start` tells, in another order, and their starts."""
    sizes = start[1:][order] - start[:-1][order]
    new_start = np.concatenate(([0], np.cumsum(sizes)))
    ordered = np.empty(int(new_start[-1]), np.uint32)

    def copy(a: int, b: int) -> None:
        begin, end = int(new_start[a]), int(new_start[b])
        rows = np.repeat(start[order[a:b]] - new_start[a:b], sizes[a:b])
        rows += np.arange(begin, end)
        values.take(rows, out=ordered[begin:end], mode="clip")  # "raise" would make a copy

    for_shares(len(order), copy)
    return ordered, new_start


def _cluster_starts(face_start: I64, first: I64) -> I64:
    """Return where clusters begin when each object's faces are cut into eights."""
    n_clusters = np.diff(first)
    start = LEAF * np.arange(int(first[-1]) + 1)
    start[:-1] += np.repeat(face_start[:-1] - LEAF * first[:-1], n_clusters)
    start[-1] = face_start[-1]
    return start


def _bounds(positions: F32, corners: U32, start: I64) -> F32:
    """Return the exact boxes of runs of faces: `corners` of ``start[i] .. start[i + 1] - 1``."""
    boxes = np.empty((len(start) - 1, 6))
    # Numba compiles anew for arrays that may be written: `svprep.clamp` passes such ones too.
    points, faces, runs = read_only(positions), read_only(corners), read_only(start)
    bound_casters(points, faces, runs, 0.0, 0, len(boxes), boxes)
    return boxes[:, [0, 2, 4, 1, 3, 5]].astype(np.float32)


def _keys(boxes: F32, step_m: float) -> U64:
    """Return the places of boxes' middles on the curve.

    A middle counts sixteen steps of the grid, all of which fills 21 bits: 2 mm in a city.
    """
    keys = np.full(len(boxes), _NOWHERE)
    has_any = boxes[:, 0] <= boxes[:, 3]
    some = boxes if has_any.all() else boxes[has_any]
    twice = (some[:, :3].astype(np.float64) + some[:, 3:]) / (32.0 * step_m)
    cells = np.floor(twice).astype(np.int64) + (1 << (BITS - 1))
    keys[has_any] = hilbert_keys(np.clip(cells, 0, (1 << BITS) - 1))
    return keys


def _joined(boxes: F32, start: I64) -> F32:
    """Return the box around each run of `boxes`; an empty run's is inside out."""
    joined = np.empty((len(start) - 1, 6), np.float32)
    joined[:, :3], joined[:, 3:] = np.inf, -np.inf
    has_any = start[:-1] < start[1:]
    first = start[:-1][has_any]
    if len(first):
        joined[has_any, :3] = np.minimum.reduceat(boxes[:, :3], first, axis=0)
        joined[has_any, 3:] = np.maximum.reduceat(boxes[:, 3:], first, axis=0)
    return joined
