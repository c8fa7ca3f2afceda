"""Which side of a plane record a light is on: decided here, once, and nowhere else.

A shadow volume is closed for any single choice of facing per face; it leaks only
where two places decide differently. So everything that needs facing, uploaded to the
GPU too, reads the result of `facing`; silhouette queries, which decide it plane by plane
while they search, take it from the same kernel function.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from svprep.errors import InputError
from svprep.kernels.search import facing_of_planes
from svprep.model import F32, F64, I8


def checked_light(light: ArrayLike) -> F32:
    """Return ``(4,) float32``: `light`, or raise.

    Raises
    ------
    InputError
        It is not four finite numbers ``(x, y, z, 1)`` or ``(x, y, z, 0)``, or names no
        direction.
    """
    try:
        with np.errstate(over="ignore"):
            given = np.array(light, np.float32)
    except (TypeError, ValueError):
        given = np.zeros(0, np.float32)
    if given.shape != (4,) or not np.isfinite(given).all() or given[3] not in (0.0, 1.0):
        raise InputError(
            f"a light is four finite numbers (x, y, z, 1) or (x, y, z, 0), not {light!r} "
            '(of a text: svprep.light.parse_light("dir:135,35"))'
        )
    if not given.any():
        raise InputError("a light of (0, 0, 0, 0) names no direction")
    return given


def facing(planes: F64, light: ArrayLike) -> I8:
    """Return ``(n_planes,) int8``: +1 facing the light, -1 turned away, 0 edge-on.

    Parameters
    ----------
    planes : ndarray
        ``(n_planes, 4) float64``: records ``(nx, ny, nz, d)`` of a `PlaneTable`.
    light : array_like
        Four numbers, rounded to float32, in the cache frame: ``(x, y, z, 1)`` a
        point light [m], ``(x, y, z, 0)`` a direction towards the light.

    Raises
    ------
    InputError
        `light` is anything else.

    Notes
    -----
    ``s = sign(((nx x + ny y) + nz z) + d w)`` in float64, summed in this order, by
    `kernels.search._side`. Zero is a tie: the face is edge-on, casts nothing and is
    not lit.
    """
    x, y, z, w = (float(v) for v in checked_light(light))
    records = np.ascontiguousarray(planes, np.float64).view()
    records.flags.writeable = False
    s = np.empty(len(records), np.int8)
    facing_of_planes(records, x, y, z, w, s)
    return s
