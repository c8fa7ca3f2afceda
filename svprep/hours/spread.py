"""Points spread evenly over a triangle: the n-th point, for any n.

The two-dimensional low-discrepancy sequence of the plastic number (Roberts 2018, "The
Unreasonable Effectiveness of Quasirandom Sequences": R2), mapped to the triangle with equal
areas and little stretching (Heitz 2019, "A Low-Distortion Map Between Triangle and Square").
"""

from __future__ import annotations

from typing import Final

import numpy as np

from svprep.model import F64, I64, U32, Mesh

_PLASTIC: Final = 1.3247179572447460260
"""The real root of x^3 = x + 1."""


def points_in_faces(mesh: Mesh, faces: I64 | U32, number: I64) -> F64:
    """Return ``(n, 3) float64`` [m]: the point of each number in each face, cache frame.

    Parameters
    ----------
    faces : ndarray
        ``(n,)``
    number : ndarray
        ``(n,)``: from 0 on. Points of numbers that follow each other are far apart.
    """
    a, b, c = np.moveaxis(mesh.positions[mesh.faces[faces]].astype(np.float64), 1, 0)
    u, v = (0.5 + number / _PLASTIC) % 1.0, (0.5 + number / _PLASTIC**2) % 1.0
    less = np.minimum(u, v) / 2.0
    return a + (u - less)[:, None] * (b - a) + (v - less)[:, None] * (c - a)
