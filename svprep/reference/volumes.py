r"""How many faces shade a point: from triangles, and from shadow volumes.

`volume_count` looks from the point to the light. `robust_count` and
`closed_count` look the other way, in any direction: they build the volume as it
is drawn and count how often a ray leaves it.

          light              light cap   the faces that count, towards the light
            |  \             side        semi-infinite, from every edge record with
          __v__              m = s_left - s_right != 0, m times, by its sign
         | cap |\            dark cap    the light cap's faces at infinity, seen
    side |     | side        outward; a point for a directional light
         | x-------> ray
         :     :             leaving counts +1, entering -1
        dark cap

All three are vectorised float64 and say of each point whether a margin of 1e-9
(relative) kept every decision away from a corner, an edge or a plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from svprep.model import BOOL, F64, I32, NO_INDEX

_MARGIN = 1e-9
"""A decision closer to zero than this share of its terms is not counted as one."""


class Counts(NamedTuple):
    """Counts at points, and whether each is beyond doubt."""

    value: I32
    """``(n_points,)``"""
    is_decidable: BOOL
    """``(n_points,)``: no ray came within the margin of a corner, edge or plane."""


def volume_count(
    positions: np.ndarray, faces: np.ndarray, facing: np.ndarray, light: np.ndarray, x: np.ndarray
) -> Counts:
    """Return how many faces lie strictly between each point and the light.

    Parameters
    ----------
    positions : ndarray
        ``(n_vertices, 3)`` [m]
    faces : ndarray
        ``(n_faces, 3)``
    facing : ndarray
        ``(n_faces,)``: +1 towards the light, -1 away, 0 edge-on (shades nothing).
    light : ndarray
        ``(4,)``: ``(x, y, z, 1)`` a point light, ``(x, y, z, 0)`` a direction to it.
    x : ndarray
        ``(n_points, 3)`` [m]

    Notes
    -----
    A face is between iff the point lies on the side that the light does not
    see, and the line to the light passes through it. O(points * faces).
    """
    light = np.asarray(light, np.float64)
    towards = light[:3] - light[3] * x
    corners, s = _corners(positions, faces[facing != 0]), facing[facing != 0]
    behind, through, sure = _line_meets(corners, x, towards)
    return _counts(through * (behind == -s), sure)


def robust_count(
    positions: np.ndarray,
    faces: np.ndarray,
    rows: np.ndarray,
    facing: np.ndarray,
    light: np.ndarray,
    x: np.ndarray,
    ray: np.ndarray,
) -> Counts:
    """Return the count at each point that the robust volume of edge records gives.

    Every face is turned towards the light and extruded. ``rows (n_rows, 4)``:
    ``[v0, v1, left, right]``, of one component or many; ``faces`` those that
    they name, all of them; ``ray (3,)`` any direction in general position. The
    other parameters are those of `volume_count`, whose count it must equal.

    Notes
    -----
    After Stich, Waechter, Keller (2007). O(points * (faces + rows)).
    """
    return _exits(positions, faces, rows, facing, np.abs(facing), light, x, ray)


def closed_count(
    positions: np.ndarray,
    faces: np.ndarray,
    rows: np.ndarray,
    facing: np.ndarray,
    light: np.ndarray,
    x: np.ndarray,
    ray: np.ndarray,
) -> Counts:
    """Return the count at each point that the closed volume of edge records gives.

    As `robust_count`, but only faces that see the light count. For a solid and
    a light outside it, the count is positive exactly where the robust one is.
    """
    s = np.maximum(facing, 0)
    return _exits(positions, faces, rows, s, s, light, x, ray)


def _exits(
    positions: np.ndarray,
    faces: np.ndarray,
    rows: np.ndarray,
    s: np.ndarray,
    n_caps: np.ndarray,
    light: np.ndarray,
    x: np.ndarray,
    ray: np.ndarray,
) -> Counts:
    """Count how often rays from `x` leave the volume, less how often they enter it."""
    light = np.asarray(light, np.float64)
    counts = n_caps != 0
    corners = _corners(positions, faces[counts])
    towards = np.broadcast_to(np.asarray(ray, np.float64), x.shape)

    side, through, sure = _line_meets(corners, x, towards)
    outward = s[counts] * np.sign(_normals(corners) @ ray).astype(np.int32)
    ahead = side == -np.sign(_normals(corners) @ ray)
    total = _counts(through * ahead * outward, sure)
    parts = [total, _side_exits(positions, rows, s, light, x, ray)]
    if light[3] != 0.0:  # the dark cap: the ray's far end, seen from the light
        source = light[None, :3]
        side, through, sure = _line_meets(corners, source, towards[:1])
        ahead = side == -np.sign(_normals(corners) @ ray)
        parts.append(_counts(through * ahead, sure))
    value = np.zeros(len(x), np.int32)
    is_decidable = np.ones(len(x), bool)
    for part in parts:
        value += part.value
        is_decidable &= part.is_decidable
    return Counts(value=value, is_decidable=is_decidable)


def _side_exits(
    positions: np.ndarray,
    rows: np.ndarray,
    s: np.ndarray,
    light: F64,
    x: np.ndarray,
    ray: np.ndarray,
) -> Counts:
    """Count exits through the sides of silhouette records.

    The side of a face that traverses a -> b is (b, a, a', b'), where a' is a
    at infinity: its outward normal is v x u, with u from lo to hi and v away
    from the light.
    """
    padded = np.append(s, 0).astype(np.int32)
    none = len(s)
    m = padded[np.where(rows[:, 2] == NO_INDEX, none, rows[:, 2])]
    m = m - padded[np.where(rows[:, 3] == NO_INDEX, none, rows[:, 3])]
    rows, m = rows[m != 0], m[m != 0]
    lo, hi = (positions[rows[:, c]].astype(np.float64) for c in (0, 1))
    u = hi - lo
    v = lo * light[3] - light[:3]
    normal = np.cross(v, u)
    area = np.linalg.norm(normal, axis=1)
    real = area > _MARGIN * np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    # A side without area (its edge points at the light) is crossed by nothing.
    lo, u, v, normal, m = lo[real], u[real], v[real], normal[real] / area[real, None], m[real]
    slope = normal @ ray
    is_level = np.abs(slope) <= _MARGIN * np.linalg.norm(ray)
    offset = ((lo[None] - x[:, None]) * normal).sum(axis=2)
    t = offset / np.where(is_level, 1.0, slope)
    hit = x[:, None] + t[..., None] * ray
    # hit = lo + along * u + away * v, in the side's own plane.
    w = hit - lo
    along = _share(w, u, np.cross(normal, v))
    away = _share(w, v, np.cross(normal, u))
    # A point light's side widens with distance: u grows by 1 + away.
    width = 1.0 + light[3] * away
    inside = (t > 0) & (away > 0) & (along > 0) & (along < width)
    near = (t > -_MARGIN) & (away > -_MARGIN) & (along > -_MARGIN) & (along < width + _MARGIN)
    far = (t > _MARGIN) & (away > _MARGIN) & (along > _MARGIN) & (along < width - _MARGIN)
    sure = (near == far) & ~is_level
    return _counts(inside * m * np.sign(slope).astype(np.int32), sure)


def _share(w: F64, axis: F64, across: F64) -> F64:
    """Return the coordinate of `w` along `axis`, with `across` normal to the other axis."""
    share: F64 = (w * across).sum(axis=2) / (axis * across).sum(axis=1)
    return share


def _corners(positions: np.ndarray, faces: np.ndarray) -> F64:
    corners: F64 = positions[faces].astype(np.float64)
    return corners


def _normals(corners: F64) -> F64:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _line_meets(corners: F64, x: np.ndarray, towards: np.ndarray) -> tuple[I32, BOOL, BOOL]:
    """Say which side of each face each point is on, and whether its line meets the face.

    Returns ``(n_points, n_faces)``: side (+1 the normal's), whether the whole
    line through the point passes through the face, and whether both are sure.
    """
    normal = _normals(corners)
    relative = corners[None] - x[:, None, None]
    height = -(relative[:, :, 0] * normal).sum(axis=2)
    span = np.linalg.norm(relative, axis=3)
    sure = np.abs(height) > _MARGIN * span[:, :, 0] * np.linalg.norm(normal, axis=1)
    turns = np.empty((*height.shape, 3))
    for c in range(3):
        a, b = relative[:, :, c], relative[:, :, (c + 1) % 3]
        turns[:, :, c] = (np.cross(a, b) * towards[:, None]).sum(axis=2)
        size = span[:, :, c] * span[:, :, (c + 1) % 3]
        doubtful = (
            np.abs(turns[:, :, c]) <= _MARGIN * size * np.linalg.norm(towards, axis=1)[:, None]
        )
        turns[:, :, c][doubtful] = 0.0
    inside = np.logical_or(np.all(turns > 0, axis=2), np.all(turns < 0, axis=2))
    # A line that surely passes outside one edge passes outside, whatever the others.
    outside = (turns > 0).any(axis=2) & (turns < 0).any(axis=2)
    return np.sign(height).astype(np.int32), inside, (inside & sure) | outside


def _counts(terms: np.ndarray, sure: np.ndarray) -> Counts:
    is_decidable: BOOL = np.all(sure, axis=1)
    return Counts(value=terms.sum(axis=1).astype(np.int32), is_decidable=is_decidable)
