"""How many shadow volumes hold the eye: where z-pass begins to count.

Depth clamp keeps what lies between the eye and the near plane, so z-pass counts from
the eye itself, one number for the whole picture: the faces between eye and light, each
as often as segments of its component hold the eye. Decided in float64 by one line:

    light  <- - - - - / - - - - - - / - - - o eye          2 faces: the count begins at 2
                    face          face

A component whose volume has a boundary within `close_m` of the eye is told apart: drawn
from there its sides fill the picture and cannot be trusted; z-fail counts it, since what
touches the eye is never behind anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from svprep.model import F32, F64, I64, Prepared
from svprep_runtime.camera import Camera
from svprep_runtime.volumes import CastersOf, Segments

if TYPE_CHECKING:
    from svprep.cache.reader import Cache

LEAST_CLOSE_M: Final = 1e-3
CLOSE_ULPS: Final = 64.0
REACH: Final = 0.02
"""By what share segments of point lights are drawn longer; as in ``extrude.glsl``."""


@dataclass(frozen=True, slots=True, eq=False)
class EyeCount:
    """Where z-pass begins."""

    n_around: int
    """Volumes that hold the eye, those of `close` left out."""
    close: I64
    """Components, ascending, with a boundary within `close_m` of the eye."""


def close_m(positions: F32, eye: F32) -> float:
    """Return the distance [m] below which a side is too close to the eye for z-pass."""
    largest = max(float(np.abs(positions).max(initial=0.0)), float(np.abs(eye).max()))
    return max(LEAST_CLOSE_M, CLOSE_ULPS * float(np.spacing(np.float32(largest))))


def is_cut_at_near(cache: Cache | Prepared, camera: Camera) -> bool:
    """Return whether anything may lie between the eye and the near plane, and be seen."""
    reach = float(np.linalg.norm(camera.near_corners() - camera.eye, axis=1).max())
    scene = cache.scene
    n_nodes = -(-(len(scene.cluster_start) - 1) // 8)
    boxes = scene.cluster_nodes[:n_nodes]
    gap = np.maximum(boxes[:, :3] - camera.eye, camera.eye - boxes[:, 3:]).max(axis=1)
    return bool((gap <= 1.001 * reach).any())


def eye_count(
    cache: Cache | Prepared,
    casters: CastersOf,
    segments: Segments,
    eye: F32,
    reach_m: float = 0.0,
) -> EyeCount:
    """Return how many volumes hold `eye` ``(3,)`` [m], cache frame.

    `reach_m` [m]: how much longer segments are drawn than they are.

    O(nodes of the scene tree's lowest level + faces near the line to the light).
    """
    mesh = cache.mesh
    e, light = eye.astype(np.float64), casters.light.astype(np.float64)
    tolerance = close_m(mesh.positions, eye)
    face = _faces_near_line(cache, e, light, tolerance)
    face = face[casters.counts[face]]
    if not len(face):
        return EyeCount(0, np.zeros(0, np.int64))
    corners = mesh.positions[mesh.faces[face]].astype(np.float64)
    is_between, is_close = _line_meets(
        corners, mesh.faces[face], casters.facing[face], e, light, tolerance
    )
    component = casters.component_of_face[face]
    holds, at_end = _segments_around(segments, component, corners, e, light, tolerance, reach_m)
    close = np.unique(component[is_close | (is_between & at_end)])
    counted = np.where(is_between, holds, 0)
    return EyeCount(
        n_around=int(counted[~np.isin(component, close)].sum()),
        close=close,
    )


def _faces_near_line(cache: Cache | Prepared, eye: F64, light: F64, tolerance: float) -> I64:
    """Return the faces of clusters whose boxes the line from eye to light comes near."""
    scene = cache.scene
    n_clusters = len(scene.cluster_start) - 1
    n_nodes = -(-n_clusters // 8)
    boxes = scene.cluster_nodes[:n_nodes].astype(np.float64)
    towards = light[:3] - light[3] * eye
    begin = np.zeros(n_nodes)
    end = np.full(n_nodes, 1.0 if light[3] != 0.0 else np.inf)
    is_near = np.ones(n_nodes, bool)
    for axis in range(3):
        low, high = boxes[:, axis] - tolerance, boxes[:, axis + 3] + tolerance
        if towards[axis] == 0.0:
            is_near &= (low <= eye[axis]) & (eye[axis] <= high)
            continue
        a, b = ((bound - eye[axis]) / towards[axis] for bound in (low, high))
        begin = np.maximum(begin, np.minimum(a, b))
        end = np.minimum(end, np.maximum(a, b))
    slack = 1e-9 * (1.0 + np.abs(begin))
    nodes = np.flatnonzero(is_near & (begin <= end + slack))
    if not len(nodes):
        return np.zeros(0, np.int64)
    first = scene.cluster_start[8 * nodes]
    last = scene.cluster_start[np.minimum(8 * nodes + 8, n_clusters)]
    lengths = last - first
    rows = np.repeat(first - (np.cumsum(lengths) - lengths), lengths) + np.arange(lengths.sum())
    return scene.faces[rows].astype(np.int64)


def _line_meets(
    corners: F64, vertices: np.ndarray, s: np.ndarray, eye: F64, light: F64, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Say which faces lie between eye and light, and which have a side or cap near the eye.

    A line through an edge meets exactly one of the two faces beside it: a tie is decided
    by the order of the edge's vertices.
    """
    towards = light[:3] - light[3] * eye
    unit = towards / np.linalg.norm(towards)
    relative = corners - eye
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    height = -(relative[:, 0] * normal).sum(axis=1)  # > 0: the eye is on the normal's side
    turns, away = [], []
    for k in range(3):
        a, b = relative[:, k], relative[:, (k + 1) % 3]
        is_forward = vertices[:, k] < vertices[:, (k + 1) % 3]
        first, second = (np.where(is_forward[:, None], x, y) for x, y in ((a, b), (b, a)))
        turn = np.cross(first, second) @ unit
        turn = np.where(turn == 0.0, 1.0, turn)
        turns.append(np.where(is_forward, turn, -turn) > 0.0)
        away.append(_distance_to_line(a, b, unit))
    through = (turns[0] == turns[1]) & (turns[1] == turns[2])
    is_behind = np.sign(height) == -s
    length = np.linalg.norm(normal, axis=1)
    on_cap = np.abs(height) <= tolerance * length
    is_close = (np.min(away, axis=0) <= tolerance) | (through & on_cap)
    if light[3] != 0.0:  # a face behind the lamp is not between
        other = -((corners[:, 0] - light[:3]) * normal).sum(axis=1)
        is_behind &= np.sign(other) == s
    return through & is_behind, is_close


def _distance_to_line(a: F64, b: F64, unit: F64) -> F64:
    """Return how far each edge a b passes from the line through the origin along `unit`."""
    flat_a, flat_b = (x - (x @ unit)[:, None] * unit for x in (a, b))
    along = flat_b - flat_a
    length = (along**2).sum(axis=1)
    share = np.clip(-(flat_a * along).sum(axis=1) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
    distance: F64 = np.linalg.norm(flat_a + share[:, None] * along, axis=1)
    return distance


def _segments_around(
    segments: Segments,
    component: I64,
    corners: F64,
    eye: F64,
    light: F64,
    tolerance: float,
    reach_m: float,
) -> tuple[I64, np.ndarray]:
    """Return how many segments of each face's component hold the eye, and if one ends near."""
    if not segments.is_clamped:
        return np.ones(len(component), np.int64), np.zeros(len(component), bool)
    if light[3] != 0.0:
        # The point of the face on the line: eye = L + k (x - L).
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        from_light = ((corners[:, 0] - light[:3]) * normal).sum(axis=1)
        to_eye = normal @ (eye - light[:3])
        depth = np.divide(to_eye, from_light, out=np.zeros(len(component)), where=from_light != 0.0)
        across = np.zeros(2)
        near_end = tolerance * np.abs(depth) / max(float(np.linalg.norm(eye - light[:3])), 1e-30)
    else:
        u, v, t = segments.frame.astype(np.float64) @ eye
        depth, across = np.full(len(component), t), np.array([u, v])
        near_end = np.full(len(component), tolerance)
    holds, at_end = np.zeros(len(component), np.int64), np.zeros(len(component), bool)
    first, end = segments.start[component], segments.start[component + 1]
    for nth in range(int((end - first).max(initial=0))):
        rows = np.flatnonzero(first + nth < end)
        near, far, p, q = segments.table[first[rows] + nth].astype(np.float64).T
        value = depth[rows] - p * across[0] - q * across[1]
        steep = np.sqrt(1.0 + p * p + q * q)
        slack = near_end[rows] * steep
        before, longer = (REACH * near, REACH * far) if light[3] else (reach_m * steep,) * 2
        holds[rows] += (near <= value) & (value <= far + longer)
        # Where a segment's beginning is drawn depends on how near its caster is.
        begins = (near - before - slack <= value) & (value <= near + slack)
        at_end[rows] |= begins | (np.abs(value - far - longer) <= slack)
    return holds, at_end
