"""Which components zp+ may draw clamped, and which cast onto the near plane.

zp+ counts from the near plane: each face between light and near rectangle adds 1 there
(Hornus et al. 2005). That is right for a volume that reaches the rectangle whole. So, per
component, with its segments:

    rectangle in one segment           clamped, and its faces are projected
    rectangle outside all of them      clamped, nothing is projected
    a segment ends at the rectangle    whole, and its faces are projected

Of point lights every volume is drawn whole: where a segment ends depends on the face.

A light in the near plane, or parallel to it, projects nothing onto it: zp+ does not exist
there, and z-pass counts instead.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from svprep.model import BOOL, F32
from svprep_runtime.camera import Camera
from svprep_runtime.volumes import CastersOf, Segments

_LEAST_SLOPE: Final = 1e-3


def is_projected(light: F32, camera: Camera) -> bool:
    """Return whether a light casts onto the near plane of a camera at all."""
    forward = camera.forward
    towards = light[:3].astype(np.float64)
    if light[3] == 0.0:
        return abs(float(towards @ forward)) > _LEAST_SLOPE * float(np.linalg.norm(towards))
    away = towards - camera.eye
    reach = float(away @ forward) - camera.near_m
    return abs(reach) > _LEAST_SLOPE * float(np.linalg.norm(away))


def sort_components(
    casters: CastersOf, segments: Segments, camera: Camera, reach_m: float
) -> tuple[BOOL, BOOL, BOOL]:
    """Return ``(n_components,)`` masks: inside, outside, ends at the rectangle.

    `reach_m` [m]: how much longer segments are drawn than they are.
    """
    n = len(segments.start) - 1
    if not segments.is_clamped:
        return np.ones(n, bool), np.zeros(n, bool), np.zeros(n, bool)
    if casters.light[3] != 0.0:
        return np.zeros(n, bool), np.zeros(n, bool), np.ones(n, bool)
    frame = segments.frame.astype(np.float64)
    u, v, t = frame @ camera.near_corners().T
    near, far, p, q = segments.table[:-1].astype(np.float64).T
    value = t[:, None] - p * u[:, None] - q * v[:, None]
    low, high = value.min(axis=0), value.max(axis=0)
    component = np.repeat(np.arange(n), np.diff(segments.start))
    holds = (near < low) & (high < far)
    reach = reach_m * np.sqrt(1.0 + p * p + q * q)
    meets = (near - reach <= high) & (low <= far + reach)
    inside, touched = (np.zeros(n, bool) for _ in range(2))
    inside[component[holds]] = True
    touched[component[meets & ~holds]] = True
    return inside & ~touched, ~inside & ~touched, touched
