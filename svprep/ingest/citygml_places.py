"""Where the templates of implicit geometries stand.

A template p stands at ``reference point + M p``: M is the affine transformationMatrix, row
by row, and its axes are east, north and up in metres (CityGML 2.0, 8.2). Around a
reference point in degrees the metres become degrees of the ellipsoid there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from svprep.errors import InputError
from svprep.ingest.citygml_log import Placement
from svprep.ingest.citygml_numbers import parse_numbers
from svprep.model import BOOL, F64, I64

_BATCH: Final = 1 << 18  # corners at a time
_SEMI_MAJOR_M: Final = 6378137.0  # GRS 80
_ECCENTRICITY_SQUARED: Final = 0.00669438002290


def reference_points(placements: list[Placement], path: Path) -> tuple[F64, int]:
    """Return the reference points, ``(n, 3)`` as the file orders their numbers.

    And how many placements state none: theirs is the origin.
    """
    points = np.zeros((len(placements), 3))
    n_without = 0
    for row, placement in zip(points, placements, strict=True):
        if placement.reference_point:
            row[:] = _numbers(placement.reference_point, 3, placement, "referencePoint", path)
        else:
            n_without += 1
    return points, n_without


def matrices(placements: list[Placement], path: Path) -> F64:
    """Return the transformations, ``(n, 3, 4)``; the identity where none is stated."""
    found = np.tile(np.eye(4), (len(placements), 1, 1))
    for matrix, placement in zip(found, placements, strict=True):
        if placement.matrix:
            name = "transformationMatrix"
            matrix[:] = _numbers(placement.matrix, 16, placement, name, path).reshape(4, 4)
            if matrix[3, :3].any() or matrix[3, 3] == 0.0:
                raise InputError(
                    f"{path}: line {placement.line}: the last row of the transformationMatrix "
                    "is not 0 0 0 1; the file is damaged."
                )
            with np.errstate(all="ignore"):  # what is not finite is refused later
                matrix /= matrix[3, 3]
    return found[:, :3]


def is_mirroring(found: F64) -> BOOL:
    """Return which transformations ``(n, 3, 4)`` turn left into right."""
    with np.errstate(all="ignore"):
        return np.linalg.det(found[:, :, :3]) < 0


def place(points: F64, placement: I64, found: F64, at: F64, *, in_degrees: bool) -> F64:
    """Return the corners of templates where they stand.

    Parameters
    ----------
    points : (n, 3) float64
        Of the templates.
    placement : (n,) int64
        Which one each corner belongs to.
    found : (n_placements, 3, 4) float64
    at : (n_placements, 3) float64
        Reference points: x, y, z.
    in_degrees
        Whether those are longitudes and latitudes.
    """
    placed = np.empty_like(points)
    with np.errstate(all="ignore"):
        for begin in range(0, len(points), _BATCH):
            rows = slice(begin, begin + _BATCH)
            matrix = found[placement[rows]]
            local = np.einsum("nij,nj->ni", matrix[:, :, :3], points[rows]) + matrix[:, :, 3]
            around = at[placement[rows]]
            if in_degrees:
                local[:, :2] *= _degrees_per_m(around[:, 1])
            placed[rows] = around + local
    return placed


def _degrees_per_m(latitude_deg: F64) -> F64:
    """Return ``(n, 2)``: degrees of longitude and of latitude in a metre."""
    latitude = np.radians(latitude_deg)
    w = np.sqrt(1.0 - _ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    across = _SEMI_MAJOR_M / w * np.cos(latitude)
    along = _SEMI_MAJOR_M * (1.0 - _ECCENTRICITY_SQUARED) / w**3
    return np.degrees(np.stack([1.0 / across, 1.0 / along], axis=1))


def _numbers(text: str, n: int, placement: Placement, what: str, path: Path) -> F64:
    values = parse_numbers(text)
    if values is None or values.size != n or not np.isfinite(values).all():
        raise InputError(
            f"{path}: line {placement.line}: the {what} of an implicit geometry does not hold "
            f"{n} finite numbers; the file is damaged."
        )
    return values
