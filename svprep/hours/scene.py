"""What sun hours ask of a city besides rays, which are `svprep.rays`' own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svprep.model import F32, I64, U32


@dataclass(frozen=True, slots=True)
class RayStarts:
    """Where the rays of points start: displaced to the sides that count."""

    origin: F32
    """``(n, 3)`` [m], cache frame."""
    face: U32
    """``(n,)``: the face that each point lies on."""


def component_of_faces(face_start: I64) -> I64:
    """Return ``(n_faces,)``: the component of each face."""
    return np.repeat(np.arange(len(face_start) - 1), np.diff(face_start))
