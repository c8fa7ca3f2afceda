"""Frames of glTF and 3D Tiles: z up, and whether positions are measured from Earth's centre."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from svprep.ingest.parsed import ParsedFile
from svprep.model import F64

EARTH_CENTRED: Final = "EPSG:4978"
"""WGS 84, x and y in the plane of the equator, z to the north pole [m]."""

Z_UP_FROM_Y_UP: Final = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])

_EQUATOR_M: Final = 6_378_137.0
_POLE_M: Final = 6_356_752.3
_NEAR_M: Final = 20_000.0
_NEAR_STATED_M: Final = 500_000.0


def shifted(frame: F64, offset: F64) -> F64:
    """Return the frame in which `offset` is added first, ``(4, 4)``."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return composed(frame, matrix)


def composed(frame: F64, matrix: F64) -> F64:
    """Return ``frame @ matrix``, which may not be finite: what it places is refused then."""
    with np.errstate(all="ignore"):
        return frame @ matrix


def is_on_earth(positions: F64, *, is_stated: bool = False) -> bool:
    """Return whether positions lie about the surface of the WGS 84 ellipsoid.

    The middle of their bounding box decides, 20 km more or less; 500 km if the file states
    that they do (a country's box bends away from its middle). Grid coordinates come that
    close only where a northing happens to be the radius of the Earth, with a height of a
    few kilometres. So, unless it is stated, earth-centred positions with |z| below 20 km
    (10 minutes of arc from the equator) are not recognised.
    """
    if len(positions) == 0:
        return False
    x, y, z = (positions.min(axis=0) / 2 + positions.max(axis=0) / 2).tolist()
    distance = math.hypot(x, y, z)
    near = _NEAR_STATED_M if is_stated else _NEAR_M
    if not 0 < distance < math.inf or (abs(z) < _NEAR_M and not is_stated):
        return False
    sine = z / distance
    squares = _POLE_M**2 * (1 - sine * sine) + (_EQUATOR_M * sine) ** 2
    return abs(distance - _EQUATOR_M * _POLE_M / math.sqrt(squares)) < near


def with_earth_frame(parsed: ParsedFile, *, is_stated: bool = False) -> ParsedFile:
    """Return `parsed` with its CRS, if it states none and its positions are earth-centred."""
    if parsed.crs:
        return parsed
    if is_on_earth(parsed.positions, is_stated=is_stated):
        note = "positions lie on the WGS 84 ellipsoid, so they are taken as earth-centred "
        return replace(parsed, crs=EARTH_CENTRED, notes=(*parsed.notes, f"{note}({EARTH_CENTRED})"))
    if is_stated:
        note = "its bounding volume is a region on Earth, but its positions do not lie there: "
        return replace(parsed, notes=(*parsed.notes, f"{note}no CRS is taken from it"))
    return parsed
