"""What casters, receivers and changes cover in a light: rectangles ``(n_views, n, 5)``.

    u0, u1, v0, v1, and a depth behind which is nothing

Of casters the fifth number is the front, of receivers it is minus the back. They are
widened for rounding, so that what overlaps in a light's frame or view overlaps here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from svprep.clamp_views import LampView, SunView
from svprep.hilbert import BITS, hilbert_keys
from svprep.model import BOOL, F32, F64

_MOST_GROUPS: Final = 32
"""Changed boxes are joined to as many, near ones together."""
_SLACK: Final = 8.0
"""Pads by which what changed is widened: more than boxes in a light's frame are."""


def grouped(boxes: F32) -> F32:
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


def overlaps(ones: F64, others: F64) -> BOOL:
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


def around(rectangles: F64) -> F64:
    """Return what holds all of ``(n_views, n, 5)``: ``(n_views, 5)``."""
    low, high = rectangles.min(axis=1), rectangles.max(axis=1)
    return np.column_stack([low[:, 0], high[:, 1], low[:, 2], high[:, 3], low[:, 4]])


def every_view(view: SunView | LampView) -> list[int]:
    """Return all views of a light."""
    return [0] if isinstance(view, SunView) else list(range(6))


def not_empty(rectangles: F64) -> list[int]:
    """Return the views in which there is anything."""
    return np.flatnonzero((rectangles[:, :, 0] <= rectangles[:, :, 1]).any(axis=1)).tolist()


def of_casters(view: SunView | LampView, views: Sequence[int]) -> F64:
    """Return the rectangles of all casters of a scene, with their fronts."""
    boxes = view.boxes(0, view.scene.n_casters)
    if isinstance(view, SunView):
        return boxes[None, :, :5][views]
    return _in_views(boxes[:, 0::2], boxes[:, 1::2], view.scene.pad_m, views, is_caster=True)


def rectangles_of(
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
    between ``min(a0 / m0, a0 / m1)`` and ``max(a1 / m0, a1 / m1)``. A view sees no more of it
    than where m is at least as large as the two other coordinates.
    """
    # The least that each coordinate is, to either side.
    aside = np.maximum(np.maximum(low, -high), 0.0) * (1.0 - 1e-5) - _SLACK * pad
    found = np.zeros((len(views), len(low), 5))
    for of_view, view in zip(found, views, strict=True):
        axis, is_negative = divmod(view, 2)
        m0, m1 = (-high[:, axis], -low[:, axis]) if is_negative else (low[:, axis], high[:, axis])
        m0 = np.maximum(m0, np.maximum(aside[:, (axis + 1) % 3], aside[:, (axis + 2) % 3]))
        depth = m0 if is_caster else -m1
        of_view[:, 4] = depth - _SLACK * pad - 1e-5 * np.abs(depth)
        is_near = m0 <= 4.0 * _SLACK * pad
        least = np.where(is_near, 1.0, m0)
        wider = _SLACK * pad / least
        is_behind = (m1 < -_SLACK * pad) | (m0 > m1 + _SLACK * pad + 1e-5 * np.abs(m1))
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
