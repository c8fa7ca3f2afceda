"""Clamping again where a scene changed: only casters that may meet what did are computed.

    changed boxes --light--> rectangles --> casters that overlap one --> their rectangles
                                                                             |
    segments of all others are taken over       clusters that overlap these -+--> segments

A caster meets the clusters that overlap its rectangle in a light frame or view. One whose
rectangle overlaps no changed box, widened for rounding, meets the same ones as before.

Of the scene as a whole its trees and lists are read, of its faces only those that are near.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from svprep.clamp_rectangles import (
    around,
    every_view,
    grouped,
    not_empty,
    of_casters,
    overlaps,
    rectangles_of,
)
from svprep.clamp_views import ClampScene, LampView, Segments, SunView
from svprep.model import BOOL, F32, F64, I64, ClampTable, SceneTree
from svprep.ranges import rows_of_runs
from svprep.scene_tree import LEAF, level_starts
from svprep.silhouette.tables import read_only

_MOST_UNITS: Final = float(1 << 52)
"""Of a surface that is taken over: half of what float64 counts to."""
_FIRST_DEEPEST: Final = 8
_MOST_DEEPEST: Final = 1024
"""Nodes that are looked into for the end of a scene, first and at most."""
_MOST_SLICES: Final = 1024
"""Runs that are copied one by one; if there are more, it goes row by row."""
_NONE: Final[I64] = np.zeros(0, np.int64)
_NO_SEGMENTS: Final = Segments(
    np.zeros(0, np.uint32), np.zeros((0, 2), np.float32), np.zeros((0, 2), np.int16)
)


@dataclass(frozen=True, slots=True)
class SceneParts:
    """A scene of which any faces can be had."""

    tree: SceneTree
    object_start: I64
    """``(n_objects + 1,)``: casters of each object."""
    face_start: I64
    """``(n_casters + 1,)``"""
    points_of: Callable[[I64], F32]
    """Gives the corners of ``(n,)`` faces, ``(3 n, 3)`` [m]."""

    @property
    def n_casters(self) -> int:
        """Components."""
        return len(self.face_start) - 1

    @property
    def lowest_nodes(self) -> F32:
        """The boxes around every eight clusters."""
        n_clusters = len(self.tree.cluster_start) - 1
        return self.tree.cluster_nodes[: int(level_starts(n_clusters)[1])]

    def part(self, casters: I64 = _NONE, nodes: I64 = _NONE) -> ClampScene:
        """Return some casters, and the clusters of some of `lowest_nodes`, in their order.

        Each face has its own corners.
        """
        clusters = (LEAF * nodes[:, None] + np.arange(LEAF)).reshape(-1)
        clusters = clusters[clusters < len(self.tree.cluster_start) - 1]
        own, start = rows_of_runs(self.face_start, casters)
        rows, cluster_start = rows_of_runs(self.tree.cluster_start, clusters)
        faces = np.concatenate([own, self.tree.faces[rows].astype(np.int64)])
        return ClampScene(
            positions=read_only(self.points_of(faces)),
            faces=read_only(np.arange(3 * len(faces), dtype=np.uint32).reshape(-1, 3)),
            face_start=read_only(start),
            order=read_only(np.arange(len(own), len(faces), dtype=np.uint32)),
            cluster_start=read_only(cluster_start),
            largest_m=float(np.abs(self.tree.cluster_nodes[-1]).max()),
        )

    def has_vertex_at(self, point: F32) -> bool:
        """Whether a face has a corner there, ``(3,)`` [m]."""
        boxes = self.lowest_nodes
        is_near = ((boxes[:, :3] <= point) & (boxes[:, 3:] >= point)).all(axis=1)
        near = self.part(nodes=np.flatnonzero(is_near))
        return bool((near.positions == point).all(axis=1).any())


@dataclass(frozen=True, slots=True)
class PreviousClamp:
    """The clamped lights of an earlier state of a scene, on the same grid."""

    table: ClampTable
    then: SceneParts
    """That state."""
    now: SceneParts
    caster_before: I64
    """``(n_casters,)``: the number of each caster in it, where its faces are the same, in the
    same order; -1 where not. None occurs twice."""
    casters_gone: I64
    """Ascending: those that do not occur."""
    changed_boxes: F32
    """``(m, 6)`` [m]: boxes, as in `SceneTree`, of all objects that went or changed, as they
    were, and of those that came or changed, as they are. Inside out ones hold nothing."""

    def light_of(self, vector: F32, prices: F64) -> int | None:
        """Return the number of a light in the table; None if it was not clamped at this price."""
        lights, prices_then = self.table.lights, self.table.facts[:, :2]
        known = (lights == vector).all(axis=1) & (prices_then == prices).all(axis=1)
        return int(np.flatnonzero(known)[0]) if known.any() else None


@dataclass(frozen=True, slots=True)
class TakenOver:
    """A light of all casters, most of which are as they were."""

    segments: Segments
    units: F64 | None
    """``(3,)``: what `SunView.surfaces` returns; None where only summing up again tells."""


def taken_over(
    previous: PreviousClamp, view: SunView | LampView, prices: F64, light: int
) -> TakenOver | None:
    """Return what becomes of a light.

    None where that is no gain: every interval, or those of half of the casters, may be others.

    Parameters
    ----------
    previous : PreviousClamp
    view : SunView or LampView
        Any part of the scene as it is now, in this light.
    prices : ndarray
        ``(2,)``: of a vertex and of an area.
    light : int
        The number of the light in the earlier table.
    """
    now = previous.now
    # Every bound is widened by the pad, which the largest coordinate decides.
    if previous.then.part().pad_m != view.scene.pad_m:
        return None
    near, met = _met(view, grouped(previous.changed_boxes), now)
    is_again = previous.caster_before < 0
    is_again[near[met.any(axis=1)]] = True
    again = np.flatnonzero(is_again)
    if 2 * len(again) > now.n_casters:
        return None
    groups_of_again = np.zeros((len(again), met.shape[1]), np.bool_)
    groups_of_again[np.searchsorted(again, near[is_again[near]])] = met[is_again[near]]
    alone = _seen(view, now.part(again, _near_nodes(view, now, again, groups_of_again)))
    computed = alone.segments(prices) if len(again) else _NO_SEGMENTS
    return TakenOver(
        segments=_merged(previous, light, again, computed),
        units=_surfaces(previous, alone, light, again, computed),
    )


def _met(view: SunView | LampView, groups: F32, now: SceneParts) -> tuple[I64, BOOL]:
    """Return casters, and which of them may meet which groups of changed boxes: objects first.

    ``(n,)``, ascending, and ``(n, n_groups)``. No other one meets any.
    """
    rectangles = rectangles_of(view, groups, every_view(view))
    views, boxes = not_empty(rectangles), now.tree.object_boxes
    has_faces = np.flatnonzero(boxes[:, 0] <= boxes[:, 3])
    objects = rectangles_of(view, boxes[has_faces], views, is_caster=True)
    is_near = overlaps(objects, rectangles[views]).any(axis=1)
    casters, _ = rows_of_runs(now.object_start, has_faces[is_near])
    part = _seen(view, now.part(casters))
    return casters, overlaps(of_casters(part, views), rectangles[views])


def _near_nodes(view: SunView | LampView, now: SceneParts, casters: I64, met: BOOL) -> I64:
    """Return the lowest nodes that casters may meet; ``met`` says near which groups they are."""
    if not len(casters):
        return _NONE
    mine = of_casters(_seen(view, now.part(casters)), every_view(view))
    groups = [*met.T, ~met.any(axis=1)]
    reached = np.stack([around(mine[:, group]) for group in groups if group.any()], axis=1)
    views = not_empty(reached)
    nodes = rectangles_of(view, now.lowest_nodes, views)
    return np.flatnonzero(overlaps(nodes, reached[views]).any(axis=1))


def _seen(view: SunView | LampView, scene: ClampScene) -> SunView | LampView:
    """Return another scene in the same light."""
    if isinstance(view, SunView):
        return SunView.of(scene, view.frame)
    return LampView(scene, view.light)


def _merged(previous: PreviousClamp, light: int, again: I64, computed: Segments) -> Segments:
    """Return the segments of all casters: from the table, and those that were computed."""
    table = previous.table
    first, end = table.light_start[light : light + 2].tolist()
    before = table.segment_start[light].astype(np.int64)
    starts = np.concatenate([before, end - first + np.cumsum(computed.counts, dtype=np.int64)])
    source = previous.caster_before.copy()
    source[again] = len(before) - 1 + np.arange(len(again))
    counts, rows = _rows(starts, source)
    return Segments(
        counts=counts,
        depths=_taken([table.depths[first:end], computed.depths], rows),
        slopes=_taken([table.slopes[first:end], computed.slopes], rows),
    )


def _rows(starts: I64, source: I64) -> tuple[NDArray[np.uint32], I64 | list[slice]]:
    """Return the segments of each of some casters, and which rows, or slices, these are."""
    cuts = np.flatnonzero(np.diff(source) != 1) + 1
    if len(cuts) > _MOST_SLICES:
        rows, start = rows_of_runs(starts, source)
        return np.diff(start).astype(np.uint32), rows
    bounds = [0, *cuts.tolist(), len(source)]
    begin = source[bounds[:-1]]
    end = begin + np.diff(bounds)
    runs = list(zip(begin.tolist(), end.tolist(), strict=True))
    counts = [np.diff(starts[a : b + 1]) for a, b in runs]
    slices = [slice(starts[a], starts[b]) for a, b in runs]
    return np.concatenate(counts).astype(np.uint32), slices


def _taken(parts: list[NDArray[Any]], rows: I64 | list[slice]) -> NDArray[Any]:
    whole = np.concatenate(parts)
    if isinstance(rows, list):
        return np.concatenate([whole[run] for run in rows])
    return whole.take(rows, axis=0)


def _surfaces(
    previous: PreviousClamp, alone: SunView | LampView, light: int, again: I64, computed: Segments
) -> F64 | None:
    """Return the surface of all volumes, in units, from what it was.

    Parameters
    ----------
    alone : SunView or LampView
        The casters that were computed.

    Notes
    -----
    Whole numbers, so nothing is lost by taking some away and adding others. Where a scene
    ends decides the surface of every volume.
    """
    table, then, unit_m2 = previous.table, previous.then, alone.scene.unit_m2
    units = table.facts[light, 2:] / unit_m2
    # Lights may have been added by another svprep, which counts them in another way.
    if (units != np.rint(units)).any() or (units > _MOST_UNITS).any():
        return None
    if not len(again) and not len(previous.casters_gone):
        return units
    end = _end(alone, previous.now)
    if end is None or end != _end(alone, then) or then.part().unit_m2 != unit_m2:
        return None
    before = previous.caster_before[again]
    old = np.sort(np.concatenate([previous.casters_gone, before[before >= 0]]))
    rows, start = rows_of_runs(table.segment_start[light].astype(np.int64), old)
    rows += table.light_start[light]
    counts = np.diff(start).astype(np.uint32)
    went = Segments(counts, table.depths[rows], table.slopes[rows])
    units -= _seen(alone, then.part(old)).surfaces(went, end)
    units += alone.surfaces(computed, end)
    return None if (units > _MOST_UNITS).any() else units


def _end(view: SunView | LampView, scene: SceneParts) -> float | None:
    """Return what `end` of a view of the whole scene returns; None where that takes too long."""
    if isinstance(view, LampView):
        return view.end_of_box(scene.tree.cluster_nodes[-1].reshape(2, 3))
    boxes, away = scene.lowest_nodes, view.frame[2]
    x, y, z = (boxes[:, k + 3 * int(away[k] > 0.0)].astype(np.float64) for k in range(3))
    # As `place_vertices` computes it, and rounding keeps order: no vertex of a box is deeper.
    deepest = (away[0] * x + away[1] * y + away[2] * z).astype(np.float32)
    n_first = min(_FIRST_DEEPEST, len(deepest))
    nodes = np.argpartition(deepest, -n_first)[-n_first:]
    end = _seen(view, scene.part(nodes=nodes)).end()
    nodes = np.flatnonzero(deepest.astype(np.float64) + view.scene.pad_m > end)
    if len(nodes) > _MOST_DEEPEST:
        return None
    return max(end, _seen(view, scene.part(nodes=nodes)).end()) if len(nodes) else end
