"""Twin of clamping: every caster against every cluster, one after the other.

No tree is walked and nothing is compiled. The formulas are those that `kernels.clamping`
and `kernels.point_clamping` document, worked out in float64 from vertices that are
rounded to float32 where the tables round them, so that a receiver that only just
overlaps, or a gap that only just pays, is decided alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from svprep.model import F32, F64, I64, Components, Mesh, SceneTree

MOST_SEGMENTS: Final = 8
MOST_LAMP_SEGMENTS: Final = 3
_LEAST_PAD_M: Final = 0.0005
_LEAST_SINK: Final = 0.02
_MOST_SLOPE: Final = 60.0
_SLOPE_UNIT: Final = 512.0
_PIECE: Final = 16
_LOG_PAD: Final = 1e-6
_WORTH_CUTTING: Final = 1000.0
_MOST_CUTS: Final = 32

Box = tuple[float, float, float, float, float, float]
"""``u0, u1, v0, v1, t0, t1``"""
Segment = tuple[float, float, float, float]
"""``near, far, slope_u, slope_v``"""


@dataclass(frozen=True, slots=True)
class TwinSegments:
    """The segments of one light."""

    counts: I64
    """``(n_casters,)``"""
    depths: F64
    """``(n_segments, 2)``: near and far, not rounded and not widened."""
    slopes: F64
    """``(n_segments, 2)``: multiples of 1 / 512."""
    areas: F64
    """``(3,)`` [m^2]: surfaces unclamped, of each caster's box alone, and clamped."""


def clamp_by_scan(
    mesh: Mesh,
    components: Components,
    scene: SceneTree,
    light: F32,
    vertex_cost: float,
    area_cost: float,
) -> TwinSegments:
    """Return the segments of all casters for one light ``(4,)`` of the cache frame.

    O(casters * clusters), in Python: for hundreds of faces.
    """
    pad = max(_LEAST_PAD_M, 1e-6 * math.sqrt(3.0) * float(np.abs(mesh.positions).max()))
    corners = mesh.positions[mesh.faces].astype(np.float64)
    start = components.face_start.tolist()
    casters = [np.arange(a, b) for a, b in pairwise(start)]
    cuts = scene.cluster_start.tolist()
    clusters = [scene.faces[a:b].astype(np.int64) for a, b in pairwise(cuts)]
    found = (
        _of_lamp(corners, casters, clusters, light.astype(np.float64), pad, vertex_cost, area_cost)
        if light[3] != 0.0
        else _of_sun(
            mesh.positions, mesh.faces, casters, clusters, light, pad, vertex_cost, area_cost
        )
    )
    segments: list[Segment] = []
    counts = []
    areas = np.zeros(3)
    for of_caster, surfaces in found:
        segments += of_caster
        counts.append(len(of_caster))
        areas += surfaces
    table = np.array(segments, np.float64).reshape(-1, 4)
    return TwinSegments(np.array(counts, np.int64), table[:, :2], table[:, 2:], areas)


# The sun -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Receiver:
    """A cluster as the sun sees it: a box, and a slab ``lo <= t - su u - sv v <= hi``."""

    box: Box
    su: float
    sv: float
    lo: float
    hi: float
    corners: F64
    """``(n, 3, 3)``: of its faces, in light coordinates."""
    pad: float


def _sun_axes(light: F32) -> F64:
    t = -light[:3].astype(np.float64)
    t /= np.linalg.norm(t)
    length = math.hypot(t[0], t[1])
    u = np.array([-t[1], t[0], 0.0]) / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.stack([u, np.cross(t, u), t])


def _of_sun(
    positions: F32,
    faces: np.ndarray,
    casters: list[I64],
    clusters: list[I64],
    light: F32,
    pad: float,
    vertex_cost: float,
    area_cost: float,
) -> Iterator[tuple[list[Segment], F64]]:
    """Yield the segments and surfaces of each caster."""
    axes = _sun_axes(light)
    x, y, z = positions.astype(np.float64).T
    placed = np.stack([(a * x + b * y) + c * z for a, b, c in axes.tolist()], axis=1)
    corners = placed.astype(np.float32).astype(np.float64)[faces]
    receivers = [_receiver(positions[faces[f]], corners[f], axes, pad) for f in clusters]
    end = max(one.box[5] for one in receivers)
    sink = float(axes[2, 2])
    level = (0.0, 0.0)
    if abs(sink) > _LEAST_SINK:
        level = (-float(axes[0, 2]) / sink, -float(axes[1, 2]) / sink)
    for caster in casters:
        low, high = corners[caster].min(axis=(0, 1)), corners[caster].max(axis=(0, 1))
        u0, v0, t0 = (low - pad).tolist()
        u1, v1, t1 = (high + pad).tolist()
        box = (u0, u1, v0, v1, t0, t1)
        split_cost = vertex_cost * 6.0 * len(caster)
        yield _sun_segments(box, receivers, level, end, split_cost, area_cost)


def _receiver(points: F32, corners: F64, axes: F64, pad: float) -> _Receiver:
    """Return a cluster's box and slab, from its faces' corners in both frames."""
    exact = points.astype(np.float64)
    normals = np.cross(exact[:, 1] - exact[:, 0], exact[:, 2] - exact[:, 0])
    x, y, z = normals.T
    area2 = x * x + y * y + z * z
    chosen = int(area2.argmax())
    scale = 1.0 / math.sqrt(area2[chosen])
    nx, ny, nz = (normals[chosen] * scale).astype(np.float32).astype(np.float64).tolist()
    along = [nx * a + ny * b + nz * c for a, b, c in axes.tolist()]
    su, sv = 0.0, 0.0
    if abs(along[2]) > _LEAST_SINK:
        su, sv = -along[0] / along[2], -along[1] / along[2]
    u, v, t = corners.reshape(-1, 3).T
    slab = t - su * u - sv * v
    reach = pad * (1.0 + abs(su) + abs(sv))
    sides = [u.min() - pad, u.max() + pad, v.min() - pad, v.max() + pad]
    u0, u1, v0, v1 = (float(np.float32(side)) for side in sides)
    box = (u0, u1, v0, v1, float(t.min() - pad), float(np.float32(t.max() + pad)))
    low, high = float(slab.min() - reach), float(slab.max() + reach)
    return _Receiver(box, su, sv, low, high, corners, pad)


def _is_met(caster: Box, receiver: Box) -> bool:
    """Whether a receiver overlaps a caster's rectangle and reaches behind its front."""
    u0, u1, v0, v1, t0, _ = _rounded(caster)
    return (
        receiver[0] <= u1
        and receiver[1] >= u0
        and receiver[2] <= v1
        and receiver[3] >= v0
        and receiver[5] >= t0
    )


def _sun_segments(
    box: Box,
    receivers: list[_Receiver],
    level: tuple[float, float],
    end: float,
    split_cost: float,
    area_cost: float,
) -> tuple[list[Segment], F64]:
    u0, u1, v0, v1, front, back = box
    width, height = u1 - u0, v1 - v0
    rim, cap = 2.0 * (width + height), width * height
    middle = u0 + 0.5 * width, v0 + 0.5 * height
    met = []
    for receiver in receivers:
        if _is_met(box, receiver.box):
            low, high = _spread(receiver, box, 0.0, 0.0)
            if high >= front and low <= high:
                met.append((low, high, receiver))
    met.sort(key=lambda one: one[0])
    segments: list[Segment] = []
    clamped = 0.0
    for nth, run in enumerate(_runs(met, back, rim, cap, split_cost, area_cost)):
        far = max([back if nth == 0 else -math.inf, *(high for _, high, _ in run)])
        near = front if nth == 0 else run[0][0]
        best: Segment = (near, far, 0.0, 0.0)
        surface = rim * (far - near) + 2.0 * cap
        for su, sv in [level, _deepest([one[2] for one in run], box)] if run else []:
            su, sv = _stored_slope(su), _stored_slope(sv)
            spreads = [_spread(one[2], box, su, sv) for one in run]
            low, high = min(s[0] for s in spreads), max(s[1] for s in spreads)
            slanted = cap * math.sqrt(1.0 + su * su + sv * sv)
            tried = rim * (high - low) + 2.0 * slanted
            if nth == 0:
                low = front
                tried = rim * (high - front) + cap + slanted
            elif low - 0.5 * (abs(su) * width + abs(sv) * height) < back:
                continue
            if tried < surface:
                surface, best = tried, (low, high, su, sv)
        near, far, su, sv = best
        if run and surface > _WORTH_CUTTING:
            cut = max(near, _end_on_faces([one[2] for one in run], box, su, sv))
            surface -= rim * (far - cut)
            far = cut
        clamped += surface
        # Depths so far count from the rectangle's middle; the table's from the origin.
        at = su * middle[0] + sv * middle[1]
        if nth == 0:
            near = front - 0.5 * (abs(su) * width + abs(sv) * height)
        segments.append((near - at, far - at, su, sv))
    surfaces = [rim * (end - front) + 2.0 * cap, rim * (back - front) + 2.0 * cap, clamped]
    return segments, np.array(surfaces)


def _end_on_faces(run: list[_Receiver], box: Box, su: float, sv: float) -> float:
    """Return the far end of a segment, the deepest receivers cut to the rectangle."""
    bounds = [_spread(one, box, su, sv)[1] for one in run]
    is_cut = [False] * len(run)
    for _ in range(_MOST_CUTS):
        at = bounds.index(max(bounds))
        if is_cut[at]:
            break
        reach = run[at].pad * (1.0 + abs(su) + abs(sv))
        depths = [
            t - su * u - sv * v
            for face in run[at].corners.tolist()
            for u, v, t in _within(face, box)
        ]
        bounds[at] = min(bounds[at], max(depths, default=-1e300) + reach)
        is_cut[at] = True
    return max(bounds)


def _within(face: list[list[float]], box: Box) -> list[list[float]]:
    """Return the corners of a triangle's part in the rectangle, from its middle."""
    mid_u, mid_v = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
    polygon = [[u - mid_u, v - mid_v, t] for u, v, t in face]
    for axis, most in ((0, box[1] - mid_u), (1, box[3] - mid_v)):
        for sign in (1.0, -1.0):
            kept: list[list[float]] = []
            for here, there in zip(polygon, polygon[1:] + polygon[:1], strict=True):
                a, b = most - sign * here[axis], most - sign * there[axis]
                if a >= 0.0:
                    kept.append(here)
                if a * b < 0.0:
                    share = a / (a - b)
                    kept.append([x + share * (y - x) for x, y in zip(here, there, strict=True)])
            polygon = kept
    return polygon


_Met = tuple[float, float, _Receiver]


def _runs(
    met: list[_Met], back: float, rim: float, cap: float, split_cost: float, area_cost: float
) -> list[list[_Met]]:
    """Cut sorted intervals at the gaps that pay; the first run begins at the caster."""
    runs: list[list[_Met]] = [[]]
    reach = back
    for one in met:
        gap = one[0] - reach
        pays = gap > 1e-6 * (abs(one[0]) + abs(reach)) and split_cost < area_cost * (
            rim * gap - 2.0 * cap
        )
        if pays and len(runs) < MOST_SEGMENTS:
            runs.append([])
            reach = one[1]
        runs[-1].append(one)
        reach = max(reach, one[1])
    return runs


def _overlap(receiver: _Receiver, box: Box) -> tuple[float, float, float, float]:
    """Return the rectangle that both share, from the middle of the caster's."""
    mid_u, mid_v = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
    return (
        max(box[0], receiver.box[0]) - mid_u,
        min(box[1], receiver.box[1]) - mid_u,
        max(box[2], receiver.box[2]) - mid_v,
        min(box[3], receiver.box[3]) - mid_v,
    )


def _spread(receiver: _Receiver, box: Box, su: float, sv: float) -> tuple[float, float]:
    """Return the least and most ``t - su u - sv v`` of a receiver within the rectangle."""
    mid_u, mid_v = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
    u0, u1, v0, v1 = _overlap(receiver, box)
    places = [(u, v) for u in (u0, u1) for v in (v0, v1)]
    shift = receiver.su * mid_u + receiver.sv * mid_v
    tilts = [(receiver.su - su) * u + (receiver.sv - sv) * v for u, v in places]
    rises = [su * u + sv * v for u, v in places]
    low = max(receiver.lo + shift + min(tilts), receiver.box[4] - max(rises))
    high = min(receiver.hi + shift + max(tilts), receiver.box[5] - min(rises))
    return low, high


def _deepest(run: list[_Receiver], box: Box) -> tuple[float, float]:
    """Return the slopes of the slab that lies deepest where it is nearest to the middle.

    Of several, the largest slopes.
    """
    mid_u, mid_v = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
    deepest = []
    for receiver in run:
        u0, u1, v0, v1 = _overlap(receiver, box)
        u, v = min(max(0.0, u0), u1), min(max(0.0, v0), v1)
        hi = receiver.hi + (receiver.su * mid_u + receiver.sv * mid_v)
        at = min(hi + receiver.su * u + receiver.sv * v, receiver.box[5])
        deepest.append((at, receiver.su, receiver.sv))
    return max(deepest)[1:]


def _stored_slope(value: float) -> float:
    return math.floor(min(max(value, -_MOST_SLOPE), _MOST_SLOPE) * _SLOPE_UNIT + 0.5) / _SLOPE_UNIT


# A point light -----------------------------------------------------------------------------------


def _of_lamp(
    corners: F64,
    casters: list[I64],
    clusters: list[I64],
    light: F64,
    pad: float,
    vertex_cost: float,
    area_cost: float,
) -> Iterator[tuple[list[Segment], F64]]:
    """Yield the segments and surfaces of each caster."""
    seen = corners - light[:3]
    away = np.abs(seen).max(axis=(0, 1))
    end = float(np.linalg.norm(away))
    receivers = [
        {view: _rounded(box) for view, box in _views(seen[f], pad).items()} for f in clusters
    ]
    for caster in casters:
        intervals = [(0.0, 0.0)]
        for i in range(0, len(caster), _PIECE):
            pieces = _views(seen[caster[i : i + _PIECE]], pad)
            for receiver in receivers:
                for view in pieces.keys() & receiver.keys():
                    mine, its = pieces[view], receiver[view]
                    if _is_in_view(mine, its):
                        low, high = its[4] - mine[5] - _LOG_PAD, its[5] - mine[4] + _LOG_PAD
                        if high >= 0.0:
                            intervals.append((low, high))
        points = seen[caster].reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        radius = float(np.linalg.norm(0.5 * (high - low))) + pad
        distance = max(float(np.linalg.norm(0.5 * (low + high))), radius)
        split_cost = vertex_cost * 6.0 * len(caster)
        yield _lamp_segments(intervals, radius, distance, end, split_cost, area_cost)


def _views(corners: F64, pad: float) -> dict[int, Box]:
    """Return the bounds of faces in each of the six views that they reach: u, v, ln m."""
    views: dict[int, Box] = {}
    # A face is in one view alone if each corner's largest coordinate, the first of equal ones,
    # says so; where it then touches another view, it has no width there.
    largest = np.abs(corners).argmax(axis=2)
    view_of_corner = 2 * largest + (
        np.take_along_axis(corners, largest[:, :, None], axis=2)[:, :, 0] < 0.0
    )
    is_within = (view_of_corner == view_of_corner[:, :1]).all(axis=1)
    for view in range(6):
        axis, sign = divmod(view, 2)
        chosen = corners[~is_within | (view_of_corner[:, 0] == view)]
        turned = chosen[:, :, [(axis + 1) % 3, (axis + 2) % 3, axis]]
        turned[:, :, 2] *= 1.0 - 2.0 * sign
        inside = [p for face in turned for p in _clipped(face.tolist())]
        if not inside:
            continue
        least, most = min(p[2] for p in inside), max(p[2] for p in inside)
        if least <= 8.0 * pad:
            views[view] = (-1.0, 1.0, -1.0, 1.0, -math.inf, math.log(most + pad))
            continue
        u, v = [p[0] / p[2] for p in inside], [p[1] / p[2] for p in inside]
        wider = 2.0 * pad / least
        views[view] = (
            min(u) - wider,
            max(u) + wider,
            min(v) - wider,
            max(v) + wider,
            math.log(least - pad),
            math.log(most + pad),
        )
    return views


def _rounded(box: Box) -> Box:
    """Return the box as a table of float32 holds it."""
    u0, u1, v0, v1, t0, t1 = (float(np.float32(x)) for x in box)
    return u0, u1, v0, v1, t0, t1


def _clipped(polygon: list[list[float]]) -> list[list[float]]:
    """Return the part of a polygon of points (a, b, m) where ``|a| <= m`` and ``|b| <= m``."""
    for i, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        heights = [p[2] - sign * p[i] for p in polygon]
        kept = []
        for k, (p, here) in enumerate(zip(polygon, heights, strict=True)):
            q, there = polygon[(k + 1) % len(polygon)], heights[(k + 1) % len(polygon)]
            if here >= 0.0:
                kept.append(p)
            if here * there < 0.0:
                part = here / (here - there)
                kept.append([a + part * (b - a) for a, b in zip(p, q, strict=True)])
        polygon = kept
    return polygon


def _is_in_view(caster: Box, receiver: Box) -> bool:
    u0, u1, v0, v1, _, _ = _rounded(caster)
    return receiver[0] <= u1 and receiver[1] >= u0 and receiver[2] <= v1 and receiver[3] >= v0


def _lamp_segments(
    intervals: list[tuple[float, float]],
    radius: float,
    distance: float,
    end: float,
    split_cost: float,
    area_cost: float,
) -> tuple[list[Segment], F64]:
    """Return segments of factors k from intervals of ln k; a caster counts as its sphere."""
    # What overlaps the caster's own makes it longer; nothing begins before it.
    merged: list[list[float]] = []
    for low, high in sorted((max(low, 0.0), high) for low, high in intervals):
        if merged and low <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], high)
        else:
            merged.append([low, high])
    disc, band = math.pi * radius * radius, math.pi * radius * distance
    paying: list[tuple[float, int]] = []
    for i, (before, after) in enumerate(pairwise(merged)):
        k0, k1 = math.exp(before[1]), math.exp(after[0])
        saved = band * (k1 * k1 - k0 * k0) - disc * (k1 * k1 + k0 * k0)
        if distance > radius and split_cost < area_cost * saved and k1 > k0 * (1.0 + 1e-6):
            paying.append((-saved, i + 1))
    # Of the gaps that pay, those stay that save most.
    splits = sorted(i for _, i in sorted(paying)[: MOST_LAMP_SEGMENTS - 1])
    runs = [
        [merged[begin][0], merged[end - 1][1]] for begin, end in pairwise([0, *splits, len(merged)])
    ]

    def surface(k0: float, k1: float) -> float:
        return band * (k1 * k1 - k0 * k0) + disc * (k1 * k1 + k0 * k0)

    own, away = 1.0 + 2.0 * radius / distance, max(end / distance, 1.0)
    segments: list[Segment] = [(math.exp(a), math.exp(b), 0.0, 0.0) for a, b in runs]
    clamped = sum(surface(k0, min(k1, max(away, k0))) for k0, k1, _, _ in segments)
    return segments, np.array([surface(1.0, away), surface(1.0, own), clamped])
