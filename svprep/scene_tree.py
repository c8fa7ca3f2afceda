"""The stage that sorts objects, and clusters of faces, into trees of boxes.

    faces of an object --halving--> clusters      of each object alone: `local_clusters`
    clusters of all objects --Hilbert curve--> leaves --eights--> nodes      `scene_tree`

A leaf's place on the curve depends on its own box and the grid's step, on nothing else. So
a tile of a city can find its clusters by itself, and where some objects change, all other
leaves keep their order: `updated_scene_tree`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.hilbert import BITS, hilbert_keys
from svprep.kernels.light_boxes import bound_casters
from svprep.kernels.tree_build import order_pairs
from svprep.model import F32, I64, U32, U64, Mesh, SceneTree
from svprep.parallel import for_ranges, for_shares
from svprep.ranges import rows_of_runs
from svprep.silhouette.tables import read_only

LEAF: Final = 8
"""Children of a node, and faces of a cluster. `kernels.tree_build` cuts at multiples of it."""
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


def updated_scene_tree(
    mesh: Mesh, previous: SceneTree, previous_face_start: I64, object_before: I64
) -> SceneTree:
    """Return what `build_scene_tree` returns of `mesh`, from the tree of an earlier one.

    Parameters
    ----------
    mesh : Mesh
        On a grid of the same origin and step.
    previous : SceneTree
        Of the earlier mesh.
    previous_face_start : ndarray
        ``(n_objects_before + 1,) int64``: its `object_face_start`.
    object_before : ndarray
        ``(n_objects,) int64``: the number of each object in it, where both are the same but
        for where their faces and vertices begin; -1 where not. No number occurs twice.

    Notes
    -----
    O(n) with a small factor, and O(m log n) for m clusters that are new. Where kept objects
    follow each other in another order, or half of all faces are new, the tree is built.
    """
    kept, new = np.flatnonzero(object_before >= 0), np.flatnonzero(object_before < 0)
    sizes = np.diff(mesh.object_face_start)
    is_shuffled = len(kept) > 1 and (np.diff(object_before[kept]) <= 0).any()
    if is_shuffled or 2 * int(sizes[new].sum()) > len(mesh.faces) or not len(previous.faces):
        return build_scene_tree(mesh)
    numbers, changed = _objects_alone(mesh, new)
    fresh = local_clusters(changed)
    object_boxes = np.empty((len(sizes), 6), np.float32)
    object_boxes[kept] = previous.object_boxes[object_before[kept]]
    object_boxes[new] = fresh.object_boxes
    objects, object_nodes = _objects(object_boxes, _keys(object_boxes, mesh.grid.step_m))
    # Faces of before, as they are numbered now. Those of objects that are gone have no number.
    before = object_before[kept]
    is_gone = np.ones(len(previous_face_start) - 1, np.bool_)
    is_gone[before] = False
    shift = np.zeros(len(is_gone), np.int64)
    shift[before] = mesh.object_face_start[kept] - previous_face_start[before]
    counts = np.diff(previous_face_start)
    old_start = previous.cluster_start
    leaves = np.flatnonzero(~np.repeat(is_gone, counts)[previous.faces[old_start[:-1]]])
    shift_of_face = np.repeat(shift.astype(np.uint32), counts)  # modulo 2**32
    pool = previous.faces + shift_of_face.take(previous.faces)
    order, at = np.argsort(fresh.keys, kind="stable"), np.zeros(0, np.int64)
    if len(order):
        search = _LeafSearch(mesh, pool, old_start, leaves)
        of_cluster = np.repeat(new, -(-sizes[new] // LEAF))
        at = search.places(fresh.keys[order], of_cluster[order])
    order = np.insert(leaves, at, order + len(old_start) - 1)
    pool = np.concatenate([pool, numbers[fresh.faces]])
    starts = np.concatenate([old_start, old_start[-1] + fresh.cluster_start[1:]])
    faces, start = _in_order(pool, starts, order)
    return SceneTree(
        objects=objects,
        object_boxes=object_boxes,
        object_nodes=object_nodes,
        faces=faces,
        cluster_start=start,
        cluster_nodes=_updated_nodes(mesh, previous, faces, start, order),
    )


@dataclass(frozen=True, slots=True)
class _LeafSearch:
    """Places among leaves in the order of (key, object), whose keys are not at hand."""

    mesh: Mesh
    faces: U32
    start: I64
    leaves: I64
    """Which clusters of `start`, in the order of the tree."""

    def places(self, keys: U64, objects: I64) -> I64:
        """Return how many leaves come before each of (key, object). O(m log n)."""
        low, high = np.zeros(len(keys), np.int64), np.full(len(keys), len(self.leaves))
        while (low < high).any():
            middle = np.minimum((low + high) // 2, len(self.leaves) - 1)
            leaf = self.leaves[middle]
            first = self.faces[self.start[leaf]].astype(np.int64)
            owner = np.searchsorted(self.mesh.object_face_start, first, side="right") - 1
            corners, start = _in_order(self.faces, self.start, leaf)
            boxes = _bounds(self.mesh.positions, self.mesh.faces[corners], start)
            key = _keys(boxes, self.mesh.grid.step_m)
            is_before = (key < keys) | ((key == keys) & (owner < objects))
            is_open = low < high
            low = np.where(is_open & is_before, middle + 1, low)
            high = np.where(is_open & ~is_before, middle, high)
        return low


def _updated_nodes(mesh: Mesh, previous: SceneTree, faces: U32, start: I64, order: I64) -> F32:
    """Return the boxes of nodes: taken over where all eight leaves were one's before."""
    n_full, n_before = len(order) // LEAF, len(previous.cluster_start) - 1
    levels = level_starts(len(order))
    boxes = np.empty((int(levels[1]), 6), np.float32)
    eights = order[: LEAF * n_full].reshape(n_full, LEAF)
    # Kept leaves are in order: eight of which the last is seven after the first are whole.
    is_kept = (eights[:, 0] % LEAF == 0) & (eights < n_before).all(axis=1)
    is_kept &= eights[:, 7] - eights[:, 0] == LEAF - 1
    is_new = np.ones(len(boxes), np.bool_)
    is_new[:n_full] = ~is_kept
    boxes[:n_full][is_kept] = previous.cluster_nodes[eights[is_kept, 0] // LEAF]
    new = np.flatnonzero(is_new)
    ends = start[np.minimum(LEAF * np.arange(len(boxes) + 1), len(order))]
    positions = read_only(mesh.positions)

    def bound(a: int, b: int) -> None:
        rows, runs = _in_order(faces, ends, new[a:b])
        boxes[new[a:b]] = _bounds(positions, mesh.faces[rows], runs)

    for_shares(len(new), bound)
    return _with_nodes_above(boxes)


def _objects_alone(mesh: Mesh, objects: I64) -> tuple[U32, Mesh]:
    """Return the numbers of some objects' faces, and a mesh of them over all vertices."""
    rows, new_start = rows_of_runs(mesh.object_face_start, objects)
    alone = Mesh(
        grid=mesh.grid,
        positions=mesh.positions,
        faces=mesh.faces[rows],
        object_vertex_start=np.zeros(len(objects) + 1, np.int64),
        object_face_start=new_start,
        source_face=mesh.source_face[rows],
    )
    return rows.astype(np.uint32), alone


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
