r"""Where the sun stands, and where true north is on a model's grid.

true north   grid north (+y)
     \       |                convergence: from true north to grid north, clockwise,
      \  c   |  sun           here positive (east of the central meridian of a northern zone)
       \-----|  /             azimuth on the grid = true azimuth - convergence
        \    | /
         \   |/

Reda, I. and Andreas, A. (2004), "Solar position algorithm for solar radiation
applications", Solar Energy 76(5), 577-589 (NREL/TP-560-34302), as pvlib computes it:
within 0.0003 degrees from the year -2000 to 6000.
"""

from __future__ import annotations

import math
import sys
import warnings
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from types import ModuleType
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from svprep.errors import EnvironmentProblem, InputError, require_extra
from svprep.model import F64, Place

if TYPE_CHECKING:
    from pyproj import CRS

FIRST_YEAR: Final = -2000
LAST_YEAR: Final = 6000
"""Years, both included, for which the algorithm is published."""

_BLOCK: Final = 64
_MERIDIAN_STEP: Final = 1e-4
"""In units of the CRS's own longitudes and latitudes: some 10 m along the meridian."""
_CLOSES: Final = 0.1
"""In units of the CRS: how far a point may come back from where it was."""


@dataclass(frozen=True, slots=True)
class Site:
    """Where a model stands: its azimuths are corrected there, and it is the default place."""

    crs: str
    """What pyproj understands: ``"EPSG:28992"``, or its WKT; ``""`` when unknown."""
    x_m: float
    y_m: float
    """A point of the model in source coordinates [m] (the origin of the grid)."""
    latitude_deg: float | None = None
    """Where that is in WGS 84, as the build found it. None: to be computed from `crs`."""
    longitude_deg: float | None = None
    convergence_deg: float | None = None
    """There, from true north to grid north (+y), clockwise."""

    @classmethod
    def of(cls, place: Place, x_m: float, y_m: float) -> Site:
        """Return the site of a model, with all that is stored of its place."""
        return cls(
            place.crs, x_m, y_m, place.latitude_deg, place.longitude_deg, place.convergence_deg
        )


@dataclass(frozen=True, slots=True)
class SunMoment:
    """The sun as seen from one place at one time."""

    latitude_deg: float
    """North is positive."""
    longitude_deg: float
    """East is positive."""
    time: datetime
    """Aware, with a fixed offset."""
    azimuth_deg: float
    """Clockwise from true north."""
    altitude_deg: float
    """Of the centre of the disc, as refraction shows it."""
    convergence_deg: float | None
    """Taken from `azimuth_deg` for the model's grid; None: no CRS is known, and grid
    north is taken for true north."""


def sun_angles(
    unix_s: ArrayLike,
    latitude_deg: float,
    longitude_deg: float,
    *,
    elevation_m: float = 0.0,
    pressure_mbar: float = 1013.25,
    temperature_c: float = 12.0,
    refraction_deg: float = 0.5667,
    delta_t_s: float | None = None,
) -> tuple[F64, F64]:
    """Return the sun's azimuths and apparent altitudes, for one place and many times.

    Parameters
    ----------
    unix_s : array_like
        ``(n,)``: seconds since 1970-01-01T00:00Z, without leap seconds.
    latitude_deg, longitude_deg : float
        Of the place: north and east are positive.
    elevation_m, pressure_mbar, temperature_c : float
        Of the place. The defaults are the standard atmosphere at sea level and an
        average temperature; 30 degrees more lower a sun at the horizon by 0.05 degrees.
    refraction_deg : float
        At sunrise and sunset: a sun lower than that and its radius is not refracted.
    delta_t_s : float, optional
        Terrestrial time minus universal time; by default after Espenak and Meeus (2006)
        for each month.

    Returns
    -------
    azimuth_deg, altitude_deg : ndarray
        ``(n,) float64`` each: azimuths clockwise from true north, 0 to 360; altitudes of
        the centre of the disc above the horizon, with refraction.

    Raises
    ------
    InputError
        A time outside of `FIRST_YEAR` to `LAST_YEAR`.
    EnvironmentProblem
        pvlib is missing.

    Notes
    -----
    O(n), about 3 us each. The first call imports pvlib, which takes about a second.
    Values do not depend on what other times are asked for in the same call.
    """
    spa = _pvlib_spa()
    unix = np.atleast_1d(np.asarray(unix_s, np.float64))
    limits = np.array([f"{FIRST_YEAR:05d}", f"{LAST_YEAR + 1:04d}"], "M8[Y]").astype("M8[s]")
    first, last = limits.astype(np.int64)
    if not ((unix >= first) & (unix < last)).all():
        raise InputError(
            f"the sun's position is known for the years {FIRST_YEAR} to {LAST_YEAR} only"
        )
    azimuth_deg, altitude_deg = np.empty_like(unix), np.empty_like(unix)
    month = np.floor(unix).astype(np.int64).astype("M8[s]").astype("M8[M]").astype(np.int64)
    for which in np.unique(month):
        rows = np.flatnonzero(month == which)
        # Whole blocks: the vectorised loops of NumPy may end in code that rounds otherwise,
        # and a moment of an arc must be the same as that moment alone.
        padded = np.pad(unix[rows], (0, -len(rows) % _BLOCK), mode="edge")
        delta_t = _delta_t_s(1970 + int(which) // 12, int(which) % 12 + 1)
        found = spa.solar_position(
            padded,
            latitude_deg,
            longitude_deg,
            elevation_m,
            pressure_mbar,
            temperature_c,
            delta_t if delta_t_s is None else delta_t_s,
            refraction_deg,
            numthreads=1,
        )
        altitude_deg[rows] = found[2][: len(rows)]
        azimuth_deg[rows] = found[4][: len(rows)]
    return azimuth_deg, altitude_deg


def _pvlib_spa() -> ModuleType:
    try:
        # About 0.9 s, mostly for pandas and SciPy: only those who ask for the sun wait.
        from pvlib import spa
    except ImportError:
        raise EnvironmentProblem(
            'the position of the sun needs the package "pvlib", which is not installed. '
            f"Run: {sys.executable or 'python3'} -m pip install pvlib"
        ) from None
    return spa


@lru_cache(maxsize=256)
def _delta_t_s(year: int, month: int) -> float:
    with warnings.catch_warnings():
        # After the year 3000 it is an extrapolation, and says so each time. An error of a
        # minute in it turns the sun by 0.00001 degrees: it moves among the stars, no more.
        warnings.simplefilter("ignore")
        return float(_pvlib_spa().calculate_deltat(year, month))


@lru_cache(maxsize=64)
def place_of(site: Site) -> tuple[float, float]:
    """Return latitude and longitude of `site` in WGS 84, to 6 decimals (0.1 m).

    What a build has stored is taken as it is, and needs no pyproj.

    Raises
    ------
    InputError
        The CRS cannot be read, has no plane coordinates, or does not reach the point.
    EnvironmentProblem
        pyproj is missing.
    """
    if site.latitude_deg is not None and site.longitude_deg is not None:
        return site.latitude_deg, site.longitude_deg
    crs, x, y = _projected(site)
    from pyproj import Transformer

    meridian_convergence_deg(site)  # raises where the CRS does not reach
    to_wgs84 = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    longitude_deg, latitude_deg = to_wgs84.transform(x, y)
    if not (math.isfinite(longitude_deg) and math.isfinite(latitude_deg)):
        raise _out_of_reach(site)
    return round(latitude_deg, 6) + 0.0, round(longitude_deg, 6) + 0.0


@lru_cache(maxsize=64)
def meridian_convergence_deg(site: Site) -> float:
    """Return the angle from true north to grid north (+y) at `site`, clockwise.

    What a build has stored is taken as it is, and needs no pyproj.

    Raises
    ------
    InputError
        The CRS cannot be read, has no plane coordinates, does not reach the point, or
        is a mirror image of the ground, as a map with x to the north is.
    EnvironmentProblem
        pyproj is missing.

    Notes
    -----
    The meridian and the parallel through the point are projected 10 m to either side of
    it, and measured: that holds for any projection, and for axes that run south or west.
    Where the projection is not conformal, only azimuths near the meridian are exact.
    """
    if site.convergence_deg is not None:
        return site.convergence_deg
    crs, x, y = _projected(site)
    from pyproj import Transformer

    geodetic = crs.geodetic_crs
    if geodetic is None:
        raise _unusable(site, "has no longitudes and latitudes beneath it")
    to_grid = Transformer.from_crs(geodetic, crs, always_xy=True)
    longitude, latitude = to_grid.transform(x, y, direction="INVERSE")
    h = _MERIDIAN_STEP
    xs, ys = to_grid.transform(
        [longitude, longitude, longitude, longitude - h, longitude + h],
        [latitude, latitude - h, latitude + h, latitude, latitude],
    )
    # Far outside of its area a projection's inverse is arbitrary, or missing.
    if not math.hypot(xs[0] - x, ys[0] - y) < _CLOSES:
        raise _out_of_reach(site)
    north_x, north_y = xs[2] - xs[1], ys[2] - ys[1]
    east_x, east_y = xs[4] - xs[3], ys[4] - ys[3]
    area = east_x * north_y - east_y * north_x
    if not area:
        raise _out_of_reach(site)
    if area < 0.0:
        raise _unusable(site, "mirrors the ground: its second axis is not 90 degrees left of +x")
    return -math.degrees(math.atan2(north_x, north_y)) + 0.0


def grid_azimuth_deg(azimuth_deg: float, convergence_deg: float | None) -> float:
    """Return the azimuth on the model's grid of a true azimuth."""
    return azimuth_deg if convergence_deg is None else azimuth_deg - convergence_deg


def _projected(site: Site) -> tuple[CRS, float, float]:
    """Return the CRS of `site` without heights, and its point in the units of that CRS."""
    try:
        from pyproj import CRS
        from pyproj.exceptions import CRSError
        from pyproj.network import set_network_enabled  # type: ignore[attr-defined]
    except ImportError:
        raise require_extra("pyproj", "formats", f'true north in the CRS "{site.crs}"') from None
    set_network_enabled(False)  # the same numbers with and without a network
    try:
        crs = CRS.from_user_input(site.crs).to_2d()
    except (CRSError, ValueError):
        raise _unusable(site, "is none that pyproj knows") from None
    if crs.is_compound:
        crs = crs.sub_crs_list[0]
    if crs.is_geographic:
        raise _unusable(site, "has degrees for coordinates, not metres on a plane")
    if not crs.is_projected:
        raise _unusable(site, "is not a projected one: nothing says where on Earth it lies")
    unit_m = crs.axis_info[0].unit_conversion_factor or 1.0
    return crs, site.x_m / unit_m, site.y_m / unit_m


def _unusable(site: Site, problem: str) -> InputError:
    shown = site.crs if len(site.crs) <= 60 else site.crs[:57] + "..."
    return InputError(
        f'the CRS "{shown}" of the model {problem}; so true north is unknown on its grid. '
        "A light by angles on the grid itself: dir:AZIMUTH,ALTITUDE"
    )


def _out_of_reach(site: Site) -> InputError:
    return _unusable(site, f"does not reach the model, at ({site.x_m:.10g}, {site.y_m:.10g})")
