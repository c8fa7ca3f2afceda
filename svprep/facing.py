"""Which side of a plane record a light is on: decided here, once, and nowhere else.

A shadow volume is closed for any single choice of facing per face; it leaks only
where two places decide differently. So everything that needs facing, on the CPU
or uploaded to the GPU, reads the result of `facing`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svprep.errors import InputError
from svprep.model import F64


def facing(planes: F64, light: ArrayLike) -> NDArray[np.int8]:
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
    ``s = sign(((nx x + ny y) + nz z) + d w)`` in float64, summed in this order.
    Zero is a tie: the face is edge-on, casts nothing and is not lit.
    """
    given = np.asarray(light, np.float32)
    if given.shape != (4,) or not np.isfinite(given).all() or given[3] not in (0.0, 1.0):
        raise InputError(
            f"a light is four finite numbers (x, y, z, 1) or (x, y, z, 0), not {light!r}"
        )
    x, y, z, w = given.astype(np.float64)
    value = planes[:, 0] * x + planes[:, 1] * y + planes[:, 2] * z
    if w != 0.0:
        value += planes[:, 3]
    return np.sign(value).astype(np.int8)
