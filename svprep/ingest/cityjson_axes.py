"""Which way the axes of a CityJSON file run, and in which unit."""

from __future__ import annotations

import numpy as np

from svprep.ingest.crs_names import crs_of, has_pyproj, needs_swap, normalised_crs
from svprep.model import F64


def is_in_degrees(crs: str) -> bool:
    """Whether the CRS is one of longitudes and latitudes."""
    known = crs_of(crs) if crs and has_pyproj() else None
    return known is not None and bool(known.is_geographic)


def is_north_first(positions: F64, crs: str) -> bool:
    """Whether positions in a CRS, at least one, have x to the north."""
    if not crs or not has_pyproj() or crs_of(crs) is None:
        return False
    # Of projected coordinates the name decides nothing: writers put the easting first.
    name = crs if is_in_degrees(crs) else normalised_crs(crs)
    return needs_swap(name, np.stack([positions.min(axis=0), positions.max(axis=0)]))
