"""How lights are written: numbers, places, dates, clocks, zones, and what is said of bad ones.

sun:LAT,LON,2026-06-21T12:00+02:00                      a moment
sun:LAT,LON,2026-03-20/06:00/18:00/15m[Europe/Vienna]   an arc: DATE/BEGIN/END/STEP[ZONE]

A time is written with an offset from UTC, with a zone in brackets, or with both. ZONE is an
IANA name, UTC, Z or an offset. A time that the clocks of a zone skip or show twice needs its
offset.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta, timezone, tzinfo
from difflib import get_close_matches
from fractions import Fraction
from functools import lru_cache
from typing import Final, NoReturn

from svprep.errors import EnvironmentProblem, InputError
from svprep.sun import LAST_YEAR

SUN_FORMS: Final = (
    "sun:LAT,LON,2026-06-21T12:00+02:00 (degrees north and east; a moment and its zone), or, for "
    "the sun's way, sun:LAT,LON,2026-03-20/06:00/18:00/15m[Europe/Vienna] (date, begin, end, step)"
)
"""The forms of a moment and of an arc, for messages and help."""

FORMS: Final = (
    "dir:AZIMUTH,ALTITUDE (degrees; clockwise from north, above the horizon), "
    f"point:X,Y,Z (metres, input coordinates) or {SUN_FORMS}"
)
"""The forms of a light, for messages and help."""

# Python's calendar begins with the year 1; no offset may lead before it.
_FIRST_YEAR: Final = 2

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[+-]?(inf|infinity|nan)", re.IGNORECASE)
_CLOCK = r"([0-9]{1,2}):([0-9]{2})(?::([0-9]{2})(?:\.([0-9]{1,6}))?)?"
_OFFSET = r"([Zz]|[+-][0-9]{2}(?::?[0-9]{2}(?::?[0-9]{2})?)?)"
_DATE = re.compile(r"([+-]?[0-9]{4,6})-([0-9]{2})-([0-9]{2})")
_MOMENT = re.compile(r"([0-9+-]+)(?:[Tt]|\s+)(.+)")
_TIME = re.compile(rf"{_CLOCK}\s*{_OFFSET}?")
_STEP = re.compile(
    r"(?:(?P<h>[0-9]{1,6}(?:\.[0-9]{1,9})?)h)?\s*(?:(?P<m>[0-9]{1,6}(?:\.[0-9]{1,9})?)m)?\s*"
    r"(?:(?P<s>[0-9]{1,6}(?:\.[0-9]{1,9})?)s)?"
)
_ZONE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_+-]*(/[A-Za-z0-9_+-]+)*")
# Of the machine, of no place, or with leap seconds, which no other time here counts.
_NO_ZONES = re.compile(r"(posix/|right/).*|localtime|posixrules|Factory")


def refuse(spec: str, problem: str, forms: str = "") -> NoReturn:
    """Raise the error that quotes `spec`, says what is wrong, and shows the forms."""
    raise InputError(f'light "{spec}": {problem}' + (f". A light is {forms}" if forms else ""))


def numbers(spec: str, text: str, names: tuple[str, ...], forms: str) -> list[float]:
    """Return the finite numbers of `text`, one for each of `names`."""
    parts = [part.strip() for part in text.split(",")] if text.strip() else []
    if len(parts) < len(names):
        refuse(spec, f"{names[len(parts)]} is missing", forms)
    if len(parts) > len(names):
        refuse(
            spec,
            f"{len(parts)} numbers instead of {len(names)} "
            "(a comma parts numbers, decimals take a point)",
            forms,
        )
    values = []
    for name, part in zip(names, parts, strict=True):
        if not part:
            refuse(spec, f"{name} is missing", forms)
        is_number = _NUMBER.fullmatch(part) is not None
        if not is_number and not _NOT_FINITE.fullmatch(part):
            refuse(spec, f'{name} is "{part}", which is not a number', forms)
        value = float(part)
        if not math.isfinite(value):
            why = "too large for a number" if is_number else "not a finite number"
            refuse(spec, f'{name} is "{part}", which is {why}', forms)
        values.append(value + 0.0)
    return values


@dataclass(frozen=True, slots=True)
class Zone:
    """Where clocks are read."""

    name: str
    """``"Europe/Vienna"``, ``"UTC"`` or ``"+02:00"``."""
    tz: tzinfo


@dataclass(frozen=True, slots=True)
class SunSpec:
    """The parts of ``sun:[LAT,LON,]WHEN[ZONE]``."""

    spec: str
    place: tuple[float, float] | None
    """Latitude and longitude [degrees]; None: left out."""
    when: str
    """What names the times, without its zone in brackets."""
    zone: Zone | None
    """None: there are no brackets."""

    @property
    def is_arc(self) -> bool:
        """Whether several times are named."""
        return "/" in self.when


def is_sun(spec: str) -> bool:
    """Whether `spec` is meant to be the sun, at a moment or on an arc."""
    return spec.partition(":")[0].strip().lower() == "sun"


def is_arc(spec: str) -> bool:
    """Whether `spec` is meant to be an arc of the sun, well written or not."""
    return is_sun(spec) and "/" in spec.partition("[")[0]


def split_sun(spec: str) -> SunSpec:
    """Return the parts of a spec of the sun, its place and zone understood."""
    text, bracket, zone_text = spec.partition(":")[2].strip().partition("[")
    zone = None
    if bracket:
        if not zone_text.endswith("]") or any(c in zone_text[:-1] for c in "[]"):
            refuse(spec, "the zone in brackets comes last, and once", SUN_FORMS)
        zone = zone_of(spec, zone_text[:-1].strip())
    place_text, comma, when = text.rpartition(",")
    when = when.strip()
    if not when or _NUMBER.fullmatch(when):
        refuse(spec, "the date and time are missing", SUN_FORMS)
    if not comma:
        return SunSpec(spec, None, when, zone)
    latitude, longitude = numbers(spec, place_text, ("LAT", "LON"), SUN_FORMS)
    if not -90.0 <= latitude <= 90.0:
        swapped = -90.0 <= longitude <= 90.0 and -180.0 <= latitude <= 180.0
        hint = f" (LAT comes first: sun:{longitude:.10g},{latitude:.10g},... ?)"
        problem = f"LAT {latitude:.10g} is not between -90 and 90 degrees"
        refuse(spec, problem + (hint if swapped else ""), SUN_FORMS)
    if not -180.0 <= longitude <= 180.0:
        problem = f"LON {longitude:.10g} is not between -180 and 180 degrees (west is negative)"
        refuse(spec, problem, SUN_FORMS)
    return SunSpec(spec, (latitude, longitude), when, zone)


def zone_of(spec: str, name: str) -> Zone:
    """Return the zone that stands in brackets: an IANA name, UTC, Z or an offset."""
    if re.fullmatch(_OFFSET, name) or name.upper() == "UTC":
        offset = _offset(spec, name) if name[0] in "+-" else timedelta(0)
        # At a moment between: any of this offset shows how it is written.
        return Zone(_offset_text(offset) if offset else "UTC", timezone(offset) if offset else UTC)
    from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

    if _ZONE_NAME.fullmatch(name) and not _NO_ZONES.fullmatch(name):
        try:
            return Zone(name, ZoneInfo(name))
        except (ZoneInfoNotFoundError, ValueError, OSError):
            pass
    known = _known_zones()
    if not known:
        raise EnvironmentProblem(
            f'light "{spec}": this machine knows no time zones. '
            "Run: python3 -m pip install tzdata; or write an offset from UTC, such as +02:00"
        )
    problem = f'the zone "{name}" is unknown' if name else "the brackets hold no zone"
    close = _close_zones(name, known)
    hint = f"close to it: {', '.join(close)}" if close else "a name is like Europe/Vienna"
    refuse(spec, f"{problem}; {hint}; an offset is like +02:00", SUN_FORMS)


@lru_cache(maxsize=1)
def _known_zones() -> list[str]:
    from zoneinfo import available_timezones

    return sorted(zone for zone in available_timezones() if not _NO_ZONES.fullmatch(zone))


def _close_zones(name: str, known: list[str]) -> list[str]:
    """Return names like `name`, or whose last part, the city, is."""
    of_folded = {zone.casefold(): zone for zone in known}
    of_city = {zone.casefold().rpartition("/")[2]: zone for zone in known if "/" in zone}
    folded = re.sub(r"\s+", "_", name.casefold())[:40]
    found = [of_folded[folded]] if folded in of_folded else []
    for table, sought in ((of_folded, folded), (of_city, folded.rpartition("/")[2])):
        found += [table[key] for key in get_close_matches(sought, table, n=3, cutoff=0.75)]
    return list(dict.fromkeys(found))[:3]


def moment_of(text: SunSpec) -> datetime:
    """Return the time of a spec that names one: aware."""
    match = _MOMENT.fullmatch(text.when)
    if match is None:
        if _DATE.fullmatch(text.when):
            refuse(text.spec, f"the time of day after {text.when} is missing", SUN_FORMS)
        problem = f'"{text.when}" is not a date and time like 2026-06-21T12:00'
        refuse(text.spec, problem, SUN_FORMS)
    return time_of(text.spec, date_of(text.spec, match[1]), match[2].strip(), text.zone)


def date_of(spec: str, text: str) -> date:
    """Return a date written as 2026-03-20."""
    match = _DATE.fullmatch(text)
    if match is None:
        refuse(spec, f'"{text}" is not a date like 2026-03-20', SUN_FORMS)
    year, month, day = (int(part) for part in match.groups())
    if not _FIRST_YEAR <= year <= LAST_YEAR:
        refuse(spec, f"the year {year} is not between {_FIRST_YEAR} and {LAST_YEAR}", SUN_FORMS)
    try:
        return date(year, month, day)
    except ValueError:
        refuse(spec, f"there is no date {text}", SUN_FORMS)


def time_of(spec: str, on: date, text: str, zone: Zone | None, *, is_end: bool = False) -> datetime:
    """Return the time of a date that clocks show as `text`, which may hold an offset.

    Parameters
    ----------
    zone : Zone, optional
        Needed if `text` has no offset; the offset must be that of the zone, if both are
        there.
    is_end : bool
        24:00 may be written.

    Returns
    -------
    datetime
        Aware, in the zone.
    """
    match = _TIME.fullmatch(text)
    if match is None:
        refuse(spec, f'"{text}" is not a time of day like 06:00', SUN_FORMS)
    hour, minute, second = (int(part or 0) for part in match.group(1, 2, 3))
    microsecond = int((match[4] or "0").ljust(6, "0"))
    if is_end and (hour, minute, second, microsecond) == (24, 0, 0, 0):
        on, hour = on + timedelta(days=1), 0
    if hour > 23 or minute > 59 or second > 59:
        hint = " (24:00 is for the end of an arc)" if hour == 24 else ""
        refuse(spec, f'there is no time of day "{text}"{hint}', SUN_FORMS)
    wall = datetime(on.year, on.month, on.day, hour, minute, second, microsecond)
    if match[5] is None:
        if zone is None:
            problem = f"{text} has no zone: end with Z, +02:00 or [Europe/Vienna]"
            refuse(spec, problem, SUN_FORMS)
        return _only_time(spec, wall, zone)
    offset = _offset(spec, match[5])
    if zone is None:
        return wall.replace(tzinfo=timezone(offset))
    there = wall.replace(tzinfo=timezone(offset)).astimezone(zone.tz)
    if there.utcoffset() != offset:
        meant = _offset_text(there.utcoffset() or timedelta(0))
        problem = f"{text} on {on} has not the offset of {zone.name}, which is {meant} then"
        refuse(spec, problem)
    return there


def _only_time(spec: str, wall: datetime, zone: Zone) -> datetime:
    """Return the one time at which the clocks of `zone` show `wall`."""
    first, second = (wall.replace(tzinfo=zone.tz, fold=fold) for fold in (0, 1))
    before, after = (t.utcoffset() or timedelta(0) for t in (first, second))
    if before == after:
        return first
    clock = clock_text(wall)
    where = f"{clock} on {wall.date()} in {zone.name}"
    earlier, later = (f"{clock}{_offset_text(offset)}" for offset in (before, after))
    whole = f"or, for an arc, give the offset instead of the zone: [{_offset_text(before)}]"
    if before > after:
        refuse(spec, f"it is {where} twice: write {earlier} or {later}, {whole}")
    skipped_to = clock_text(wall + (after - before))
    refuse(spec, f"it is never {where}: clocks skip it. Write {skipped_to}, {whole}")


def step_of(spec: str, text: str) -> timedelta:
    """Return a step written as 15m, 1h, 30s or 1h30m."""
    match = _STEP.fullmatch(text)
    if match is None or not text:
        refuse(spec, f'"{text}" is not a step like 15m, 1h30m or 30s', SUN_FORMS)
    seconds = sum(
        (Fraction(match[unit] or 0) * size for unit, size in (("h", 3600), ("m", 60), ("s", 1))),
        Fraction(0),
    )
    microseconds = seconds * 1_000_000
    if microseconds.denominator != 1:
        refuse(spec, f"the step {text} is not a whole number of microseconds", SUN_FORMS)
    if not microseconds:
        refuse(spec, f"the step {text} is none", SUN_FORMS)
    return timedelta(microseconds=int(microseconds))


def clock_text(when: datetime) -> str:
    """Return the time of day as far as it is not zero: ``12:00``, ``12:00:30.5``."""
    if when.microsecond:
        return f"{when:%H:%M:%S}.{when.microsecond:06d}".rstrip("0")
    return f"{when:%H:%M:%S}" if when.second else f"{when:%H:%M}"


def moment_text(when: datetime, gap: str) -> tuple[str, str]:
    """Return date and time with `gap` between them, and the offset."""
    offset = when.utcoffset()
    assert offset is not None
    return f"{when.date().isoformat()}{gap}{clock_text(when)}", _offset_text(offset)


def _offset(spec: str, text: str) -> timedelta:
    if text in "Zz":
        return timedelta(0)
    digits = text[1:].replace(":", "")
    hours, minutes, seconds = (int(digits[i : i + 2] or 0) for i in (0, 2, 4))
    if hours > 23 or minutes > 59 or seconds > 59:
        refuse(spec, f"no place is {text} from UTC", SUN_FORMS)
    offset = timedelta(hours=hours, minutes=minutes, seconds=seconds)
    return -offset if text[0] == "-" else offset


def _offset_text(offset: timedelta) -> str:
    seconds = round(offset.total_seconds())
    sign, seconds = ("-" if seconds < 0 else "+"), abs(seconds)
    tail = f":{seconds % 60:02d}" if seconds % 60 else ""
    return f"{sign}{seconds // 3600:02d}:{seconds // 60 % 60:02d}{tail}"
