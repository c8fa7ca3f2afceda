"""One light's work in clamping: segments of casters, and the surface of their volumes.

Either is a function of casters and of what they meet: `svprep.clamp_changes` calls them
with a few casters and the clusters about them, and gets the same segments. Surfaces are
whole numbers of a small unit, so their sum is exact: that of some casters can be taken from
it, and that of others added, and it is what it would be if all were added up.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from svprep.kernels.clamping import MOST_SEGMENTS, SLOPE_UNIT, clamp_casters
from svprep.kernels.light_boxes import (
    bound_casters,
    bound_clusters,
    choose_normals,
    place_vertices,
    raise_levels,
)
from svprep.model import F32, F64, I16, I64, U32
from svprep.parallel import for_each, for_shares
from svprep.scene_tree import level_starts
from svprep.silhouette.tables import read_only

_LEAST_SINK = 0.02
"""Sine of the sun's altitude below which no horizontal plane is tried: slopes stay below 50."""
_CHUNK = 4096
"""Casters that a thread takes at a time; sums are taken chunk by chunk, whatever the threads."""
_UNIT_BITS = 40
"""Of surfaces: a square as wide as the scene's largest coordinate has 2**38 to 2**40 units."""
_LEAST_PAD_M = 0.0005


@dataclass(frozen=True)
class ClampScene:
    """Casters, and clusters that may receive their shadows: the same for every light.

    Arrays are read-only, from a build as from a cache: Numba compiles anew for another kind.
    """

    positions: F32
    faces: U32
    face_start: I64
    """``(n_casters + 1,)``: casters have the first faces, in their own order."""
    order: U32
    """Faces in the order of clusters."""
    cluster_start: I64
    largest_m: float
    """[m]: the largest coordinate, of either sign, of the whole scene that this is a part of."""

    @property
    def pad_m(self) -> float:
        """What float32 rounds in a light frame, and what an edge may be off in a ray tracer."""
        return max(_LEAST_PAD_M, 1e-6 * self.largest_m * math.sqrt(3.0))

    @property
    def unit_m2(self) -> float:
        """Of which surfaces are counted: a power of two."""
        return math.ldexp(1.0, 2 * math.frexp(self.largest_m)[1] - _UNIT_BITS)

    @property
    def n_casters(self) -> int:
        """Components."""
        return len(self.face_start) - 1

    @property
    def n_clusters(self) -> int:
        """Receivers."""
        return len(self.cluster_start) - 1

    @cached_property
    def levels(self) -> I64:
        """Where the levels of a tree over the clusters begin."""
        return level_starts(self.n_clusters)

    @cached_property
    def normals(self) -> F32:
        """``(n_clusters, 3)``: the unit normal of each cluster's largest face."""
        normals = np.zeros((self.n_clusters, 3), np.float32)
        tables = self.positions, self.faces, self.order, self.cluster_start
        for_shares(len(normals), lambda a, b: choose_normals(*tables, a, b, normals))
        return normals


@dataclass(frozen=True, slots=True)
class Segments:
    """Of one light, caster by caster."""

    counts: U32
    """``(n_casters,)``"""
    depths: F32
    slopes: I16


@dataclass(frozen=True, slots=True)
class SunView:
    """A scene as a sun sees it."""

    scene: ClampScene
    frame: F64
    placed: F32
    """``(n_vertices, 3)`` [m]: in the light's frame."""

    @classmethod
    def of(cls, scene: ClampScene, frame: F64) -> SunView:
        """Return a scene with its vertices in a light's frame."""
        placed = np.empty(scene.positions.shape, np.float32)
        for_shares(len(placed), lambda a, b: place_vertices(scene.positions, frame, a, b, placed))
        return cls(scene, frame, placed)

    def boxes(self, a: int, b: int) -> F64:
        """Return those of some casters, ``u0, u1, v0, v1, t0, t1`` [m]."""
        return _boxes_of(self.scene, self.placed, self.scene.pad_m, a, b)

    def segments(self, prices: F64) -> Segments:
        """Return the segments of all casters."""
        scene, placed, frame, levels = self.scene, self.placed, self.frame, self.scene.levels
        blocks = np.empty((int(levels[-1]), 5, 8), np.float32)
        slabs = np.empty((scene.n_clusters, 5), np.float64)
        tables = placed, scene.faces, scene.order, scene.cluster_start
        normals, pad = scene.normals, scene.pad_m
        for_shares(
            scene.n_clusters,
            lambda a, b: bound_clusters(*tables, normals, frame, pad, a, b, blocks, slabs),
        )
        raise_levels(levels, len(levels) - 1, scene.n_clusters, blocks)
        sink = frame[2, 2]
        horizon = -frame[:2, 2] / sink if abs(sink) > _LEAST_SINK else np.zeros(2)

        def work(a: int, b: int, counts: U32, depths: F32, slopes: I16) -> int:
            boxes, start = self.boxes(a, b), scene.face_start[a : b + 1]
            return int(
                clamp_casters(
                    boxes, start, *tables, blocks, slabs, levels, len(levels) - 1, horizon, pad,
                    prices, 0, b - a, counts, depths, slopes,
                )
            )  # fmt: skip

        return _chunk_by_chunk(scene.n_casters, work)

    def end(self) -> float:
        """Return the depth [m] at which the scene ends, and an unclamped volume is counted to."""
        return float(self.placed[:, 2].max()) + self.scene.pad_m

    def surfaces(self, segments: Segments, end: float) -> F64:
        """Return the surface of all volumes, in units: see `ClampTable.facts`."""

        def measure(a: int, b: int, part: Segments) -> tuple[F64, F64, F64]:
            u0, u1, v0, v1, front, back = self.boxes(a, b).T
            width, height = u1 - u0, v1 - v0
            rim, cap = 2.0 * (width + height), width * height
            of = np.repeat(np.arange(b - a), part.counts)
            is_first = np.append(True, of[1:] != of[:-1])
            su, sv = part.slopes[:, 0] / SLOPE_UNIT, part.slopes[:, 1] / SLOPE_UNIT
            shift = su * (u0 + 0.5 * width)[of] + sv * (v0 + 0.5 * height)[of]
            stored = part.depths.astype(np.float64)
            stored += [1.2e-7, -1.2e-7] * np.abs(stored)  # what rounding outward added
            near = np.where(is_first, front[of], stored[:, 0] + shift)
            far = stored[:, 1] + shift
            slant = np.sqrt(1.0 + su * su + sv * sv)
            caps = cap[of] * (slant + np.where(is_first, 1.0, slant))
            return (
                rim * (end - front) + 2.0 * cap,
                rim * (back - front) + 2.0 * cap,
                rim[of] * (far - near) + caps,
            )

        return _units_of_chunks(segments, measure, self.scene.unit_m2)


@dataclass(frozen=True, slots=True)
class LampView:
    """A scene as a point light sees it."""

    scene: ClampScene
    light: F32

    def segments(self, prices: F64) -> Segments:
        """Return the segments of all casters."""
        # Loaded for lamps only: most builds have none.
        from svprep.kernels.point_clamping import bound_clusters_in_views, clamp_casters_in_views

        scene, light, levels, pad = self.scene, self.light, self.scene.levels, self.scene.pad_m
        blocks = np.empty((6, int(levels[-1]), 5, 8), np.float32)
        nearest = np.empty((6, scene.n_clusters), np.float32)
        tables = scene.positions, scene.faces, scene.order, scene.cluster_start
        for_shares(
            scene.n_clusters,
            lambda a, b: bound_clusters_in_views(*tables, light, pad, a, b, blocks, nearest),
        )
        for view in blocks:
            raise_levels(levels, len(levels) - 1, scene.n_clusters, view)

        def work(a: int, b: int, counts: U32, depths: F32, slopes: I16) -> int:
            return int(
                clamp_casters_in_views(
                    scene.positions, scene.faces, scene.face_start, light, blocks, nearest,
                    levels, len(levels) - 1, pad, prices, a, b, counts, depths, slopes,
                )
            )  # fmt: skip

        return _chunk_by_chunk(scene.n_casters, work)

    def boxes(self, a: int, b: int) -> F64:
        """Return those of some casters, ``x0, x1, y0, y1, z0, z1`` [m] from the light."""
        at = np.repeat(self.light[:3].astype(np.float64), 2)
        return _boxes_of(self.scene, self.scene.positions, 0.0, a, b) - at

    def end(self) -> float:
        """Return the distance [m] of the scene's farthest corner."""
        columns = self.scene.positions.T  # one after the other: ten times as fast as by rows
        ends = [[one.min() for one in columns], [one.max() for one in columns]]
        return self.end_of_box(np.array(ends))

    def end_of_box(self, ends: F32) -> float:
        """Return that of a scene that fills a box, ``(2, 3)`` [m]."""
        away = np.abs(ends - self.light[:3].astype(np.float64)).max(axis=0)
        return float(np.linalg.norm(away))

    def surfaces(self, segments: Segments, end: float) -> F64:
        """Return the surface of all volumes, in units; a caster counts as its bounding sphere."""
        pad_m = self.scene.pad_m

        def measure(a: int, b: int, part: Segments) -> tuple[F64, F64, F64]:
            boxes = self.boxes(a, b)
            middle, half = boxes[:, 0::2] + boxes[:, 1::2], boxes[:, 1::2] - boxes[:, 0::2]
            radius = 0.5 * np.sqrt((half**2).sum(axis=1)) + pad_m
            distance = np.maximum(0.5 * np.sqrt((middle**2).sum(axis=1)), radius)
            disc, band = math.pi * radius * radius, math.pi * radius * distance
            own, last = 1.0 + 2.0 * radius / distance, np.maximum(end / distance, 1.0)
            of = np.repeat(np.arange(b - a), part.counts)
            k0, k1 = part.depths.astype(np.float64).T * (1.0 + 2e-7 * np.array([[1.0], [-1.0]]))
            k1 = np.minimum(k1, np.maximum(last[of], k0))
            return (
                band * (last * last - 1.0) + disc * (last * last + 1.0),
                band * (own * own - 1.0) + disc * (own * own + 1.0),
                band[of] * (k1 * k1 - k0 * k0) + disc[of] * (k1 * k1 + k0 * k0),
            )

        return _units_of_chunks(segments, measure, self.scene.unit_m2)


def _boxes_of(scene: ClampScene, points: F32, pad_m: float, a: int, b: int) -> F64:
    boxes = np.empty((b - a, 6), np.float64)
    start = scene.face_start[a : b + 1]
    bound_casters(read_only(points), scene.faces, start, pad_m, 0, b - a, boxes)
    return boxes


def _chunks(n_casters: int) -> list[int]:
    return [*range(0, n_casters, _CHUNK), n_casters]


def _each_chunk(n_casters: int, work: Callable[[int, int], object]) -> None:
    """Call ``work(begin, end)`` on all casters, chunk by chunk on all threads."""
    cuts = _chunks(n_casters)
    for_each(len(cuts) - 1, lambda i: work(cuts[i], cuts[i + 1]))


def _chunk_by_chunk(n_casters: int, work: Callable[[int, int, U32, F32, I16], int]) -> Segments:
    """Return what `work` writes for all casters."""
    parts: dict[int, Segments] = {}

    def do(a: int, b: int) -> None:
        counts = np.empty(b - a, np.uint32)
        depths = np.empty((MOST_SEGMENTS * (b - a), 2), np.float32)
        slopes = np.empty((MOST_SEGMENTS * (b - a), 2), np.int16)
        n = work(a, b, counts, depths, slopes)
        parts[a] = Segments(counts, depths[:n].copy(), slopes[:n].copy())

    _each_chunk(n_casters, do)
    ordered = [parts[a] for a in _chunks(n_casters)[:-1]]
    return Segments(
        counts=np.concatenate([np.zeros(0, np.uint32), *(part.counts for part in ordered)]),
        depths=np.concatenate([np.zeros((0, 2), np.float32), *(part.depths for part in ordered)]),
        slopes=np.concatenate([np.zeros((0, 2), np.int16), *(part.slopes for part in ordered)]),
    )


def _units_of_chunks(
    segments: Segments,
    measure: Callable[[int, int, Segments], tuple[F64, F64, F64]],
    unit_m2: float,
) -> F64:
    """Return the sums of what `measure` says of casters, each rounded to whole units, ``(3,)``.

    A float64 holds every sum below 2**53 exactly, whatever the order. Beyond, the order is
    that of the casters, whatever the threads.
    """
    n_casters = len(segments.counts)
    start = np.concatenate(([0], np.cumsum(segments.counts, dtype=np.int64)))
    sums: dict[int, F64] = {}

    def do(a: int, b: int) -> None:
        rows = slice(int(start[a]), int(start[b]))
        part = Segments(segments.counts[a:b], segments.depths[rows], segments.slopes[rows])
        areas = (np.rint(areas_m2 / unit_m2) for areas_m2 in measure(a, b, part))
        # Less than none, by rounding, would make a sum of some more than the sum of all.
        sums[a] = np.array([np.maximum(units, 0.0).sum() for units in areas])

    _each_chunk(n_casters, do)
    total = np.zeros(3)
    for a in _chunks(n_casters)[:-1]:
        total += sums[a]
    return total
