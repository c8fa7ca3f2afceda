"""A light as the user names it, and as every other part of svprep takes it.

dir:AZIMUTH,ALTITUDE    a direction                     degrees, on the model's grid
point:X,Y,Z             a lamp                          input coordinates [m]
sun:LAT,LON,TIME        the sun, at a place and time    degrees north and east
sun:LAT,LON,DATE/BEGIN/END/STEP[ZONE]    an arc of the sun: one light per step by day

altitude 90 is the zenith        north 0 (+y)
         |   / light               |   / azimuth, clockwise
         |  /                      |  /
         | /) altitude    270 -----+----- 90 (+x, east)
---------+---------                |
      horizon                     180
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from svprep.arc import Arc, parse_arc, sun_moment
from svprep.errors import InputError
from svprep.light_spec import FORMS, is_arc, is_sun, moment_text, numbers, refuse
from svprep.model import F32, Grid
from svprep.sun import Site, SunMoment, grid_azimuth_deg

__all__ = [
    "FARTHEST_M",
    "FORMS",
    "Arc",
    "Light",
    "Site",
    "SunMoment",
    "directional",
    "is_arc",
    "is_sun",
    "parse_arc",
    "parse_light",
    "parse_lights",
    "sunlight",
]

FARTHEST_M: Final = 2.0**40
"""[m]: a point light this far from the model (seven times as far as the sun) is an error;
the squares of greater distances soon leave float32, in which shaders compute."""


@dataclass(frozen=True, slots=True)
class Light:
    """One light, in source coordinates: ``(x, y, z, w)``."""

    spec: str
    """What the user wrote, or would write: ``"dir:135,40"``."""
    words: str
    """For people: ``"direction, azimuth 135, altitude 40"``."""
    x: float
    y: float
    z: float
    """w = 1: [m], where the light is. w = 0: the unit vector towards the light."""
    w: float
    """1.0 for a point light, 0.0 for a directional one."""
    sun: SunMoment | None = None
    """Where and when the sun stands there, if it is the sun."""

    def in_cache_frame(self, grid: Grid) -> F32:
        """Return ``(4,) float32``: the light that every query, shader and judge uses.

        Parameters
        ----------
        grid : Grid
            Of the cache: a point's source coordinates lose ``grid.origin_m``.

        Raises
        ------
        InputError
            A point light is farther than `FARTHEST_M` from the model along an axis.

        Notes
        -----
        The difference is taken in float64 and rounded once, so a point light near
        the model is as exact as a vertex. Directions are the same in both frames.
        """
        at = np.array([self.x, self.y, self.z])
        if self.w != 0.0:
            with np.errstate(over="ignore"):
                at -= grid.origin_m
            if not (np.abs(at) < FARTHEST_M).all():
                axis = int(np.argmax(np.abs(at)))
                raise InputError(
                    f'light "{self.spec}": {"XYZ"[axis]} lies {abs(at[axis]):g} m from the '
                    f"middle of the model; at most {FARTHEST_M:.2g} m can be computed with. "
                    "A light that far away is a direction: dir:AZIMUTH,ALTITUDE"
                )
        return np.array([*at, self.w], np.float32)


def parse_light(spec: str, site: Site | None = None) -> Light:
    """Return the light that `spec` names.

    Parameters
    ----------
    spec : str
        ``dir:AZIMUTH,ALTITUDE`` in degrees: azimuth clockwise from grid north (+y;
        east is +x), any finite number; altitude above the horizon, -90 to 90.
        ``point:X,Y,Z`` in input coordinates [m].
        ``sun:LAT,LON,2026-06-21T12:00+02:00``: see `svprep.arc.sun_moment`.
    site : Site, optional
        Where the model stands. With a CRS it turns the sun's azimuth from true north to
        the grid's, and is the place of a sun that is written without LAT,LON.

    Raises
    ------
    InputError
        Anything else: quotes the spec, says what is wrong with which number, and
        shows the forms. An arc, a sun that is not above the horizon, a CRS of `site` that
        does not tell true north.
    EnvironmentProblem
        For the sun: pvlib is missing, or, if the site has a CRS, pyproj.
    """
    kind, _, rest = spec.partition(":")
    match kind.strip().lower():
        case "dir":
            azimuth_deg, altitude_deg = numbers(spec, rest, ("AZIMUTH", "ALTITUDE"), FORMS)
            if not -90.0 <= altitude_deg <= 90.0:
                swapped = -90.0 <= azimuth_deg <= 90.0
                hint = f" (AZIMUTH comes first: dir:{altitude_deg:g},{azimuth_deg:g}?)"
                refuse(
                    spec,
                    f"ALTITUDE {altitude_deg:g} is not between -90 and 90 degrees"
                    + (hint if swapped else ""),
                    FORMS,
                )
            return directional(azimuth_deg, altitude_deg, spec)
        case "point":
            x, y, z = numbers(spec, rest, ("X", "Y", "Z"), FORMS)
            shown = ", ".join(repr(value).removesuffix(".0") for value in (x, y, z))
            return Light(spec, f"point ({shown})", x, y, z, 1.0)
        case "sun":
            return sunlight(sun_moment(spec, site), spec)
    refuse(spec, "it begins with none of dir:, point: and sun:", FORMS)


def parse_lights(specs: Sequence[str], site: Site | None = None) -> list[Light]:
    """Return the lights that `specs` name, in their order, each arc one light per step by day.

    A light that is named twice is there twice. Raises what `parse_light` and
    `svprep.arc.parse_arc` raise.
    """
    lights: list[Light] = []
    for spec in specs:
        if is_arc(spec):
            lights += parse_arc(spec, site).lights
        else:
            lights.append(parse_light(spec, site))
    return lights


def directional(azimuth_deg: float, altitude_deg: float, spec: str = "") -> Light:
    """Return the directional light at finite angles, measured as `parse_light` says.

    Quarter turns are exact: ``dir:90,0`` is (1, 0, 0, 0), so that a face that looks
    north is edge-on to it, not turned away by a rounding error.
    """
    east, north = _sin_cos_deg(azimuth_deg)
    up, level = _sin_cos_deg(altitude_deg)
    azimuth = math.fmod(azimuth_deg, 360.0)
    shown = f"{azimuth + 360.0 if azimuth < 0.0 else azimuth:.10g}"
    below = " (below the horizon)" if altitude_deg < 0.0 else ""
    return Light(
        spec=spec or f"dir:{azimuth_deg!r},{altitude_deg!r}",
        words=f"direction, azimuth {'0' if shown == '360' else shown}, "
        f"altitude {altitude_deg + 0.0:.10g}{below}",
        # + 0.0 turns -0.0 into 0.0.
        x=level * east + 0.0,
        y=level * north + 0.0,
        z=up + 0.0,
        w=0.0,
    )


def sunlight(sun: SunMoment, spec: str = "") -> Light:
    """Return the sun's direction on the model's grid.

    `spec`, if there is none, is one from which `parse_light` makes exactly this light,
    given the same site.
    """
    place = f"{sun.latitude_deg:.10g}, {sun.longitude_deg:.10g}"
    grid_azimuth = grid_azimuth_deg(sun.azimuth_deg, sun.convergence_deg)
    on_grid = "" if sun.convergence_deg is None else f" ({_two_decimals(grid_azimuth)} on the grid)"
    if not spec:
        lat, lon = (repr(x).removesuffix(".0") for x in (sun.latitude_deg, sun.longitude_deg))
        spec = f"sun:{lat},{lon},{''.join(moment_text(sun.time, 'T'))}"
    return replace(
        directional(grid_azimuth, sun.altitude_deg, spec),
        words=f"sun at {place} on {' '.join(moment_text(sun.time, ' '))}, "
        f"azimuth {_two_decimals(sun.azimuth_deg)}{on_grid}, altitude {sun.altitude_deg:.2f}",
        sun=sun,
    )


def _two_decimals(azimuth_deg: float) -> str:
    shown = f"{azimuth_deg % 360.0:.2f}"
    return "0.00" if shown == "360.00" else shown


def _sin_cos_deg(angle_deg: float) -> tuple[float, float]:
    """Return sine and cosine of degrees, exact at multiples of 90."""
    within_turn = math.remainder(angle_deg, 360.0)  # exact, as is the next subtraction
    quarter = round(within_turn / 90.0)
    rest = math.radians(within_turn - 90.0 * quarter)
    sin, cos = math.sin(rest), math.cos(rest)
    return ((sin, cos), (cos, -sin), (-sin, -cos), (-cos, sin))[quarter % 4]
