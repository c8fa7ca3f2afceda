"""Boxes that stand somewhere on Earth, for tests of coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from svprep.ingest.parsed import ParsedFile, no_findings
from svprep.model import F64

CORNERS = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], np.float64)
"""``(8, 3)``: corners k and k + 4 stand above each other."""
QUADS = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))


def parsed(crs: str, positions: ArrayLike) -> ParsedFile:
    """Return a file with the eight corners of a box."""
    points: F64 = np.array(positions, np.float64)
    faces = [[a, b, c] for q in QUADS for a, b, c in (q[:3], (q[0], *q[2:]))]
    return ParsedFile(
        positions=points,
        faces=np.array(faces, np.uint32),
        object_face_start=np.array([0, len(faces)], np.int64),
        source_face=np.repeat(np.arange(6, dtype=np.uint32), 2),
        object_names=("box",),
        face_findings=no_findings(),
        notes=(),
        crs=crs,
    )


def box(
    crs: str, x: float, y: float, size: float = 10.0, *, z: float = 0.0, height: float = 8.0
) -> ParsedFile:
    """Return a box on a square in the units of `crs`."""
    return parsed(crs, CORNERS * (size, size, height) + (x, y, z))
