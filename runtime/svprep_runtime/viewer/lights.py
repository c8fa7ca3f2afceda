"""Lights that can be moved: the sun by hour and date, a direction by angles, a lamp.

    H J, right drag sideways       hour        azimuth     along the view
    N M, right drag up and down    date        altitude    up (keys), away (drag)

The sun is asked for minute by minute; when it is down there is no light to draw.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta, timezone, tzinfo
from typing import Final, Protocol
from zoneinfo import ZoneInfo

import numpy as np

from svprep.errors import InputError, SvprepError
from svprep.light import Light, Site, directional, is_arc, is_sun, parse_arc, parse_light
from svprep.model import F32, F64, Grid

DEFAULT_SPEC: Final = "dir:135,40"
STEP_MINUTES: Final = 10.0
STEP_DEG: Final = 1.0
DRAG_HOURS: Final = 12.0
"""For a drag along the height of the window."""
DRAG_DAYS: Final = 180.0
DRAG_DEG: Final = 120.0
FIRST: Final = datetime(1600, 1, 1, tzinfo=UTC)
LAST: Final = datetime(2999, 12, 31, tzinfo=UTC)


class _Way(Protocol):
    """How one light is moved."""

    def vector(self) -> F32 | None:
        """Return ``(4,) float32`` in the cache frame; None: it is night."""

    def words(self) -> list[str]:
        """Return what the screen says of it."""

    def step(self, along: float, across: float, right: F64) -> None:
        """Move by steps of keys."""

    def drag(self, dx: float, dy: float, right: F64) -> None:
        """Move by a drag, in heights of the window; y grows downwards."""


class SunWay:
    """The sun at a place, by its local time."""

    def __init__(
        self, when: datetime, zone: tzinfo, zone_words: str, place: str, site: Site, grid: Grid
    ) -> None:
        self.when = when.astimezone(UTC)
        self.zone, self.zone_words = zone, zone_words
        self.place, self.site, self.grid = place, site, grid
        self._asked: datetime | None = None
        self._light: Light | None = None
        self._days = 0.0

    def begin_with(self, light: Light) -> None:
        """Take `light` for the first minute, to the second that was asked for."""
        self._asked, self._light = _minute(self.when), light

    def light(self) -> Light | None:
        """Return the sun at this minute; None: it is not above the horizon."""
        minute = _minute(self.when)
        if minute != self._asked:
            self._asked = minute
            try:
                self._light = parse_light(f"sun:{self.place}{minute:%Y-%m-%dT%H:%M}Z", self.site)
            except InputError:
                # The place and the form were accepted before: it can only be the night.
                self._light = None
        return self._light

    def vector(self) -> F32 | None:
        """Return the light at this minute; None: night."""
        light = self.light()
        return None if light is None else light.in_cache_frame(self.grid)

    def words(self) -> list[str]:
        """Return date, hour and where the sun stands."""
        local = self.when.astimezone(self.zone)
        head = f"Sun  {local:%Y-%m-%d  %H:%M}  {self.zone_words}{_offset(local)}"
        light = self.light()
        if light is None or light.sun is None:
            return [head, "night: the sun is below the horizon; only the sky lights"]
        return [
            head,
            f"azimuth {light.sun.azimuth_deg:.1f}°, altitude {light.sun.altitude_deg:.1f}°",
        ]

    def step(self, along: float, across: float, right: F64) -> None:
        """Move by hours and days."""
        self._move(along * STEP_MINUTES, across)

    def drag(self, dx: float, dy: float, right: F64) -> None:
        """Move by hours and days."""
        self._move(60.0 * DRAG_HOURS * dx, -DRAG_DAYS * dy)

    def _move(self, minutes: float, days: float) -> None:
        self.when = min(max(self.when + timedelta(minutes=minutes), FIRST), LAST)
        self._days += days
        whole = int(self._days)
        self._days -= whole
        if whole:
            # The clock keeps its time from day to day, also when it is put forward.
            local = self.when.astimezone(self.zone).replace(tzinfo=None) + timedelta(days=whole)
            there = local.replace(tzinfo=self.zone).astimezone(UTC)
            self.when = min(max(there, FIRST), LAST)


def _offset(local: datetime) -> str:
    return local.isoformat(timespec="minutes")[len("2026-06-21T12:00") :]


def _minute(when: datetime) -> datetime:
    return when.replace(second=0, microsecond=0)


class AngleWay:
    """A direction, by azimuth and altitude on the grid."""

    def __init__(self, first: F32, grid: Grid) -> None:
        x, y, z = first[:3].astype(np.float64).tolist()
        self.azimuth_deg = round(math.degrees(math.atan2(x, y)), 5) % 360.0
        self.altitude_deg = round(math.degrees(math.atan2(z, math.hypot(x, y))), 5)
        self.grid = grid
        self._first: F32 | None = first

    def vector(self) -> F32 | None:
        """Return the direction."""
        if self._first is not None:
            return self._first
        # A tenth of a degree at a time: less is not seen, and each step costs a search.
        light = directional(round(self.azimuth_deg, 1), round(self.altitude_deg, 1))
        return light.in_cache_frame(self.grid)

    def words(self) -> list[str]:
        """Return the angles."""
        below = " (below the horizon: it shines from beneath)" if self.altitude_deg < 0.0 else ""
        return [
            f"Direction  azimuth {self.azimuth_deg % 360.0:.1f}°, "
            f"altitude {self.altitude_deg + 0.0:.1f}°{below}"
        ]

    def step(self, along: float, across: float, right: F64) -> None:
        """Turn by degrees."""
        self._turn(STEP_DEG * along, STEP_DEG * across)

    def drag(self, dx: float, dy: float, right: F64) -> None:
        """Turn by degrees."""
        self._turn(DRAG_DEG * dx, -DRAG_DEG * dy)

    def _turn(self, azimuth: float, altitude: float) -> None:
        self._first = None
        self.azimuth_deg = (self.azimuth_deg + azimuth) % 360.0
        self.altitude_deg = min(max(self.altitude_deg + altitude, -90.0), 90.0)


class LampWay:
    """A point light."""

    def __init__(self, at: F32, grid: Grid, model_m: float) -> None:
        self.at = at[:3].astype(np.float64)
        self.grid, self.model_m = grid, model_m

    def vector(self) -> F32 | None:
        """Return the place."""
        return np.array([*self.at, 1.0], np.float32)

    def words(self) -> list[str]:
        """Return the place in input coordinates."""
        x, y, z = (self.at + self.grid.origin_m).tolist()
        return [f"Point light  {x:.2f}, {y:.2f}, {z:.2f}"]

    def step(self, along: float, across: float, right: F64) -> None:
        """Move aside and up."""
        size = self.model_m / 400.0
        self.at = self.at + size * (along * right + np.array([0.0, 0.0, across]))

    def drag(self, dx: float, dy: float, right: F64) -> None:
        """Move level: aside and away."""
        ahead = np.array([-right[1], right[0], 0.0])
        self.at = self.at + 0.5 * self.model_m * (dx * right - dy * ahead)


class LightControl:
    """One light of the viewer. `switch` goes between a sun by time and one by angles."""

    def __init__(self, way: _Way, grid: Grid, site: Site, today: date | None = None) -> None:
        self.way, self._grid, self._site = way, grid, site
        self._today = today or date.today()
        self._other: _Way | None = None

    @property
    def keeps_axes_apart(self) -> bool:
        """Whether a drag changes one thing only: the hour, or the date."""
        return isinstance(self.way, SunWay)

    def vector(self) -> F32 | None:
        """Return ``(4,) float32`` in the cache frame; None: night."""
        return self.way.vector()

    def words(self) -> list[str]:
        """Return what the screen says of it."""
        return self.way.words()

    def step(self, along: float, across: float, right: F64) -> None:
        """Move by steps of keys: hour and date, azimuth and altitude, aside and up."""
        self.way.step(along, across, right)

    def drag(self, dx: float, dy: float, right: F64) -> None:
        """Move by a drag, in heights of the window."""
        self.way.drag(dx, dy, right)

    def switch(self) -> str:
        """Take the sun by angles where it was by time, or the reverse; return what to say."""
        if isinstance(self.way, LampWay):
            return "a point light has no hour"
        if isinstance(self.way, SunWay):
            vector = self.way.vector()
            if vector is None:
                return "the sun is below the horizon: it has no direction to begin with"
            self._other, self.way = self.way, AngleWay(vector, self._grid)
            return ""
        if self._other is None:
            if not self._site.crs:
                return "no place is known: start with --light sun:LAT,LON,TIME to have hours"
            try:
                self._other = _sun_at(self._site, self._grid, self._today)
            except SvprepError as error:
                return str(error)
        self._other, self.way = self.way, self._other
        return ""


def _sun_at(site: Site, grid: Grid, on: date) -> SunWay:
    """Return the sun at noon in the zone that the longitude of `site` suggests."""
    longitude = None
    for hour in (12, 4, 20):  # at an equinox one of them is day everywhere
        try:
            found = parse_light(f"sun:{on.year}-03-20T{hour:02d}:00Z", site).sun
        except InputError:
            if hour == 20:
                raise
            continue
        longitude = found.longitude_deg if found else 0.0
        break
    offset = timedelta(hours=round((longitude or 0.0) / 15.0))
    zone = timezone(offset)
    noon = datetime(on.year, on.month, on.day, 12, tzinfo=zone)
    return SunWay(noon, zone, "zone by longitude: UTC", "", site, grid)


def light_control(
    spec: str, site: Site, grid: Grid, model_m: float, today: date | None = None
) -> LightControl:
    """Return the light that `spec` names, ready to be moved; an arc of the sun: its middle.

    Raises
    ------
    InputError, EnvironmentProblem
        As `svprep.light.parse_light` says.
    """
    way: _Way
    if is_arc(spec):
        lights = parse_arc(spec, site).lights
        light = lights[len(lights) // 2]
    else:
        light = parse_light(spec, site)
    vector = light.in_cache_frame(grid)
    if light.w != 0.0:
        way = LampWay(vector, grid, model_m)
    elif light.sun is not None and is_sun(spec):
        zone, words = _zone_of(spec, light.sun.time)
        place = f"{light.sun.latitude_deg!r},{light.sun.longitude_deg!r},"
        way = SunWay(light.sun.time, zone, words, place, site, grid)
        way.begin_with(light)
    else:
        way = AngleWay(vector, grid)
    return LightControl(way, grid, site, today)


def _zone_of(spec: str, when: datetime) -> tuple[tzinfo, str]:
    """Return the zone in brackets of an accepted spec, or else the offset it was given."""
    name = spec.partition("[")[2].rstrip("] ").strip()
    if name and name[0] not in "+-" and name.upper() not in ("UTC", "Z"):
        return ZoneInfo(name), f"{name}, UTC"
    zone = when.tzinfo
    assert zone is not None
    return zone, "UTC"


def light_controls(
    specs: Sequence[str], site: Site, grid: Grid, model_m: float, today: date | None = None
) -> list[LightControl]:
    """Return the lights that `specs` name; `DEFAULT_SPEC` for none."""
    return [light_control(s, site, grid, model_m, today) for s in specs or [DEFAULT_SPEC]]
