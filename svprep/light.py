"""A light as the user names it, and as every other part of svprep takes it.

dir:AZIMUTH,ALTITUDE    a direction, like the sun's   degrees
point:X,Y,Z             a lamp                        input coordinates [m]

altitude 90 is the zenith        north 0 (+y)
         |   / light               |   / azimuth, clockwise
         |  /                      |  /
         | /) altitude    270 -----+----- 90 (+x, east)
---------+---------                |
      horizon                     180
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final, NoReturn

import numpy as np

from svprep.errors import InputError
from svprep.model import F32, Grid

FORMS: Final = (
    "dir:AZIMUTH,ALTITUDE (degrees; clockwise from north, above the horizon) or "
    "point:X,Y,Z (metres, input coordinates)"
)
"""The forms of SPEC that `parse_light` understands, for messages and help."""

FARTHEST_M: Final = 2.0**40
"""[m]: a point light this far from the model (seven times as far as the sun) is an error;
the squares of greater distances soon leave float32, in which shaders compute."""

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[+-]?(inf|infinity|nan)", re.IGNORECASE)


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


def parse_light(spec: str) -> Light:
    """Return the light that `spec` names.

    Parameters
    ----------
    spec : str
        ``dir:AZIMUTH,ALTITUDE`` in degrees: azimuth clockwise from grid north (+y;
        east is +x), any finite number; altitude above the horizon, -90 to 90.
        ``point:X,Y,Z`` in input coordinates [m].

    Raises
    ------
    InputError
        Anything else: quotes the spec, says what is wrong with which number, and
        shows the forms.
    """
    kind, _, rest = spec.partition(":")
    match kind.strip().lower():
        case "dir":
            azimuth_deg, altitude_deg = _numbers(spec, rest, ("AZIMUTH", "ALTITUDE"))
            if not -90.0 <= altitude_deg <= 90.0:
                swapped = -90.0 <= azimuth_deg <= 90.0
                hint = f" (AZIMUTH comes first: dir:{altitude_deg:g},{azimuth_deg:g}?)"
                _refuse(
                    spec,
                    f"ALTITUDE {altitude_deg:g} is not between -90 and 90 degrees"
                    + (hint if swapped else ""),
                )
            return directional(azimuth_deg, altitude_deg, spec)
        case "point":
            x, y, z = _numbers(spec, rest, ("X", "Y", "Z"))
            shown = ", ".join(repr(value).removesuffix(".0") for value in (x, y, z))
            return Light(spec, f"point ({shown})", x, y, z, 1.0)
        case "sun":
            _refuse(spec, "the sun at a place and time is not understood yet")
    _refuse(spec, "it begins with neither dir: nor point:")


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


def _sin_cos_deg(angle_deg: float) -> tuple[float, float]:
    """Return sine and cosine of degrees, exact at multiples of 90."""
    within_turn = math.remainder(angle_deg, 360.0)  # exact, as is the next subtraction
    quarter = round(within_turn / 90.0)
    rest = math.radians(within_turn - 90.0 * quarter)
    sin, cos = math.sin(rest), math.cos(rest)
    return ((sin, cos), (cos, -sin), (-sin, -cos), (-cos, sin))[quarter % 4]


def _numbers(spec: str, text: str, names: tuple[str, ...]) -> list[float]:
    """Return the finite numbers of `text`, one for each of `names`."""
    parts = [part.strip() for part in text.split(",")] if text.strip() else []
    if len(parts) < len(names):
        _refuse(spec, f"{names[len(parts)]} is missing")
    if len(parts) > len(names):
        _refuse(
            spec,
            f"{len(parts)} numbers instead of {len(names)} "
            "(a comma parts numbers, decimals take a point)",
        )
    values = []
    for name, part in zip(names, parts, strict=True):
        if not part:
            _refuse(spec, f"{name} is missing")
        is_number = _NUMBER.fullmatch(part) is not None
        if not is_number and not _NOT_FINITE.fullmatch(part):
            _refuse(spec, f'{name} is "{part}", which is not a number')
        value = float(part)
        if not math.isfinite(value):
            why = "too large for a number" if is_number else "not a finite number"
            _refuse(spec, f'{name} is "{part}", which is {why}')
        values.append(value + 0.0)
    return values


def _refuse(spec: str, problem: str) -> NoReturn:
    raise InputError(f'light "{spec}": {problem}. A light is {FORMS}')
