"""Clamping again where a scene changed: only casters that may meet what did are computed.

    changed boxes --light--> rectangles --> casters that overlap one --> their rectangles
                                                                             |
    segments of all others are taken over       clusters that overlap these -+--> segments

A caster meets the clusters that overlap its rectangle in a light frame or view. One whose
rectangle overlaps no changed box, widened for rounding, meets the same ones as before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.clamp_views import ClampScene, LampView, Segments, SunView
from svprep.hilbert import BITS, hilbert_keys
from svprep.model import BOOL, F32, F64, I64, ClampTable, Components, SceneTree
from svprep.ranges import rows_of_runs
from svprep.scene_tree import LEAF
from svprep.silhouette.tables import read_only

_LEAST_PAD_M: Final = 0.0005
_MOST_GROUPS: Final = 32
"""Changed boxes are joined to as many, near ones together."""
_SLACK: Final = 8.0
"""Pads by which what changed is widened: more than boxes in a light's frame are."""


@dataclass(frozen=True, slots=True)
class PreviousClamp:
    """The clamped lights of an earlier state of a scene, on the same grid."""

    table: ClampTable
    caster_before: I64
    """``(n_casters,)``: the number of each caster in it, where its faces are the same, in the
    same order; -1 where not."""
    changed_boxes: F32
    """``(m, 6)`` [m]: boxes, as in `SceneTree`, of all objects that went or changed, as they
    were, and of those that came or changed, as they are. Inside out ones hold nothing."""
    scene_box: F32
    """``(6,)`` [m]: of the whole scene as it was, the last of its `cluster_nodes`."""


def pad_of(largest_m: float) -> float:
    """Return the pad [m] of a scene whose largest coordinate is `largest_m`."""
    return max(_LEAST_PAD_M, 1e-6 * largest_m * math.sqrt(3.0))


def segments_after(
    previous: PreviousClamp,
    view: SunView | LampView,
    vector: F32,
    prices: F64,
    components: Components,
    tree: SceneTree,
) -> Segments | None:
    """Return the segments of all casters, most of them taken over.

    None where that is no gain: the light was not clamped with these costs, or every
    interval, or those of half of the casters, may be others.
    """
    scene, table = view.scene, previous.table
    known = (table.lights == vector).all(axis=1) & (table.facts[:, :2] == prices).all(axis=1)
    # Every bound is widened by the pad, which the largest coordinate decides.
    is_same_pad = pad_of(float(np.abs(previous.scene_box).max())) == scene.pad_m
    if not known.any() or not is_same_pad:
        return None
    met = _met(view, _grouped(previous.changed_boxes), components, tree)
    again = np.flatnonzero(met.any(axis=1) | (previous.caster_before < 0))
    if 2 * len(again) > scene.n_casters:
        return None
    light = int(np.flatnonzero(known)[0])
    computed = _computed(view, tree, again, met[again], prices)
    return _merged(table, light, previous.caster_before, again, computed)


def _met(view: SunView | LampView, groups: F32, components: Components, tree: SceneTree) -> BOOL:
    """Return which casters may meet which groups of changed boxes: objects first."""
    met = np.zeros((view.scene.n_casters, len(groups)), np.bool_)
    rectangles = _rectangles(view, groups, _every(view))
    views = _not_empty(rectangles)
    has_faces = np.flatnonzero(tree.object_boxes[:, 0] <= tree.object_boxes[:, 3])
    objects = _rectangles(view, tree.object_boxes[has_faces], views, is_caster=True)
    is_near = _overlaps(objects, rectangles[views]).any(axis=1)
    casters, _ = rows_of_runs(components.object_start, has_faces[is_near])
    part = _seen(view, _part(view.scene, casters, np.zeros(0, np.int64)))
    met[casters] = _overlaps(_of_casters(part, views), rectangles[views])
    return met


def _computed(
    view: SunView | LampView, tree: SceneTree, again: I64, met: BOOL, prices: F64
) -> Segments:
    """Return the segments of some casters; ``met`` says near which groups each one is."""
    scene = view.scene
    if not len(again):
        return Segments(
            np.zeros(0, np.uint32), np.zeros((0, 2), np.float32), np.zeros((0, 2), np.int16)
        )
    mine = _of_casters(_seen(view, _part(scene, again, np.zeros(0, np.int64))), _every(view))
    groups = [*met.T, ~met.any(axis=1)]
    around = np.stack([_around(mine[:, group]) for group in groups if group.any()], axis=1)
    views = _not_empty(around)
    n_nodes = -(-scene.n_clusters // LEAF)
    nodes = _rectangles(view, tree.cluster_nodes[:n_nodes], views)
    is_near = _overlaps(nodes, around[views]).any(axis=1)
    leaves = LEAF * np.flatnonzero(is_near)[:, None] + np.arange(LEAF)
    clusters = leaves[leaves < scene.n_clusters]
    return _seen(view, _part(scene, again, clusters)).segments(prices)


def _seen(view: SunView | LampView, scene: ClampScene) -> SunView | LampView:
    """Return another scene in the same light."""
    if isinstance(view, SunView):
        return SunView.of(scene, view.frame)
    return LampView(scene, view.light)


def _part(scene: ClampScene, casters: I64, clusters: I64) -> ClampScene:
    """Return some casters and clusters, in their order, each face with its own corners."""
    of_casters, start = rows_of_runs(scene.face_start, casters)
    rows, cluster_start = rows_of_runs(scene.cluster_start, clusters)
    faces = np.concatenate([of_casters, scene.order[rows].astype(np.int64)])
    order = np.arange(len(of_casters), len(faces), dtype=np.uint32)
    return ClampScene(
        positions=read_only(scene.positions[scene.faces[faces].reshape(-1)]),
        faces=read_only(np.arange(3 * len(faces), dtype=np.uint32).reshape(-1, 3)),
        face_start=read_only(start),
        order=read_only(order),
        cluster_start=read_only(cluster_start),
        pad_m=scene.pad_m,
    )


def _merged(
    table: ClampTable, light: int, caster_before: I64, again: I64, computed: Segments
) -> Segments:
    """Return the segments of all casters: from the table, and those that were computed."""
    first, end = table.light_start[light : light + 2].tolist()
    before = table.segment_start[light].astype(np.int64)
    starts = np.concatenate([before, end - first + np.cumsum(computed.counts, dtype=np.int64)])
    source = caster_before.copy()
    source[again] = len(before) - 1 + np.arange(len(again))
    rows, start = rows_of_runs(starts, source)
    return Segments(
        counts=np.diff(start).astype(np.uint32),
        depths=np.concatenate([table.depths[first:end], computed.depths]).take(rows, axis=0),
        slopes=np.concatenate([table.slopes[first:end], computed.slopes]).take(rows, axis=0),
    )


def _grouped(boxes: F32) -> F32:
    """Return boxes that hold all of `boxes`, at most `_MOST_GROUPS`."""
    boxes = boxes[boxes[:, 0] <= boxes[:, 3]]
    if len(boxes) <= _MOST_GROUPS:
        return boxes
    middles = boxes[:, :3].astype(np.float64) + boxes[:, 3:]
    low = middles.min(axis=0)
    extent = max(float((middles.max(axis=0) - low).max()), 1e-300)
    order = np.argsort(
        hilbert_keys(((middles - low) / extent * ((1 << BITS) - 1)).astype(np.int64))
    )
    first = np.arange(_MOST_GROUPS) * len(boxes) // _MOST_GROUPS
    ordered = boxes[order]
    low = np.minimum.reduceat(ordered[:, :3], first, axis=0)
    return np.hstack([low, np.maximum.reduceat(ordered[:, 3:], first, axis=0)])


# Rectangles ``(n_views, n, 5)``: u0, u1, v0, v1, and a depth behind which is nothing ----------


def _overlaps(ones: F64, others: F64) -> BOOL:
    """Return which of the first, in any view, overlap which of the others and reach so far.

    ``ones (n_views, n, 5)``, ``others (n_views, m, 5)`` -> ``(n, m)``. The fifth number of a
    caster is its front, or of a receiver minus its back: one of each kind overlaps if their
    sum is at most 0.
    """
    n, m = ones.shape[1], others.shape[1]
    met = np.zeros((n, m), np.bool_)
    for one, other in zip(ones, others, strict=True):
        for j in range(m):
            u0, u1, v0, v1, t = other[j].tolist()
            is_met = (one[:, 0] <= u1) & (one[:, 1] >= u0) & (one[:, 2] <= v1)
            is_met &= (one[:, 3] >= v0) & (one[:, 4] + t <= 0.0)
            met[:, j] |= is_met
    return met


def _around(rectangles: F64) -> F64:
    """Return what holds all of ``(n_views, n, 5)``: ``(n_views, 5)``."""
    low, high = rectangles.min(axis=1), rectangles.max(axis=1)
    return np.column_stack([low[:, 0], high[:, 1], low[:, 2], high[:, 3], low[:, 4]])


def _every(view: SunView | LampView) -> list[int]:
    """Return all views of a light."""
    return [0] if isinstance(view, SunView) else list(range(6))


def _not_empty(rectangles: F64) -> list[int]:
    """Return the views in which there is anything."""
    return np.flatnonzero((rectangles[:, :, 0] <= rectangles[:, :, 1]).any(axis=1)).tolist()


def _of_casters(view: SunView | LampView, views: Sequence[int]) -> F64:
    """Return the rectangles of all casters of a scene, with their fronts."""
    boxes = view.boxes(0, view.scene.n_casters)
    if isinstance(view, SunView):
        return boxes[None, :, :5][views]
    return _in_views(boxes[:, 0::2], boxes[:, 1::2], view.scene.pad_m, views, is_caster=True)


def _rectangles(
    view: SunView | LampView, boxes: F32, views: Sequence[int], is_caster: bool = False
) -> F64:
    """Return widened rectangles of what is in boxes, with fronts of casters or minus backs."""
    low, high = boxes[:, :3].astype(np.float64), boxes[:, 3:].astype(np.float64)
    pad = view.scene.pad_m
    if isinstance(view, LampView):
        at = view.light[:3].astype(np.float64)
        return _in_views(low - at, high - at, pad, views, is_caster)
    middle = 0.5 * (low + high) @ view.frame.T
    reach = 0.5 * (high - low) @ np.abs(view.frame).T + _SLACK * pad
    near, far = middle - reach, middle + reach
    depth = near[:, 2] if is_caster else -far[:, 2]
    return np.column_stack([near[:, 0], far[:, 0], near[:, 1], far[:, 1], depth])[None][views]


def _in_views(low: F64, high: F64, pad: float, views: Sequence[int], is_caster: bool) -> F64:
    """Return the rectangles of boxes from a lamp in some views, widened; depths are m.

    In a view whose axis is m, a box with ``a0 <= a <= a1`` and ``0 < m0 <= m <= m1`` lies
    between ``min(a0 / m0, a0 / m1)`` and ``max(a1 / m0, a1 / m1)``.
    """
    found = np.zeros((len(views), len(low), 5))
    for of_view, view in zip(found, views, strict=True):
        axis, is_negative = divmod(view, 2)
        m0, m1 = (-high[:, axis], -low[:, axis]) if is_negative else (low[:, axis], high[:, axis])
        depth = m0 if is_caster else -m1
        of_view[:, 4] = depth - _SLACK * pad - 1e-5 * np.abs(depth)
        is_near = m0 <= 4.0 * _SLACK * pad
        least = np.where(is_near, 1.0, m0)
        wider = _SLACK * pad / least
        is_behind = m1 < -_SLACK * pad
        for k in range(2):
            a0, a1 = low[:, (axis + 1 + k) % 3], high[:, (axis + 1 + k) % 3]
            most = np.maximum(m1, least)
            first = np.minimum(a0 / least, a0 / most) - wider
            last = np.maximum(a1 / least, a1 / most) + wider
            # Within a view are -1 to 1; what lies beyond is not seen in it.
            is_behind |= ~is_near & ((first > 1.0 + wider) | (last < -1.0 - wider))
            of_view[:, 2 * k] = np.where(is_near, -2.0, first)
            of_view[:, 2 * k + 1] = np.where(is_near, 2.0, last)
        of_view[is_behind, 0], of_view[is_behind, 1] = np.inf, -np.inf
    return found
