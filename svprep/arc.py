"""The sun at one moment, and its way over a part of a day: an arc.

BEGIN   +STEP   +STEP                            END
  |-------|-------|---- ... ----|-------|---------|
  0       1       2             n-2     n-1
  one light for each step by day, at the beginning of the step

Steps are of time that passes, not of what clocks show: on the day that clocks are put
forward there are 23 hours from 00:00 to 24:00.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta, timezone
from typing import TYPE_CHECKING, Final, NoReturn

import numpy as np

from svprep.errors import EnvironmentProblem, InputError
from svprep.light_spec import (
    SUN_FORMS,
    SunSpec,
    clock_text,
    date_of,
    is_sun,
    moment_of,
    moment_text,
    refuse,
    split_sun,
    step_of,
    time_of,
)
from svprep.model import F64
from svprep.sun import Site, SunMoment, meridian_convergence_deg, place_of, sun_angles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from svprep.light import Light

MOST_STEPS: Final = 100_000

# Any other place may be asked for on purpose.
_NEAR_DEG: Final = 2.0
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class Arc:
    """The sun's way over a part of a day, a light for each step by day."""

    spec: str
    """What the user wrote."""
    latitude_deg: float
    longitude_deg: float
    zone: str
    """``"Europe/Vienna"``, ``"UTC"`` or ``"+02:00"``."""
    date: date
    begin: datetime
    end: datetime
    """Aware, in the zone. No step begins at the end or later."""
    step_minutes: float
    n_steps: int
    """By day and by night; the last one may pass the end."""
    n_night: int
    """Steps at whose beginning the sun is not above the horizon."""
    step_of_light: tuple[int, ...]
    """``step_of_light[i]`` in 0..n_steps - 1, ascending: the step that light i stands for."""
    times: tuple[datetime, ...]
    """Aware, in the zone: when the step of each light begins."""
    lights: tuple[Light, ...]
    """At least one. Each spec is that of a moment, from which `parse_light` makes exactly
    this light, given the same site."""
    convergence_deg: float | None
    """From true north to grid north, clockwise, as it was applied. None: no CRS is known,
    and grid north is taken for true north."""


def sun_moment(spec: str, site: Site | None = None) -> SunMoment:
    """Return the sun at the moment that `spec` names.

    Parameters
    ----------
    spec : str
        ``sun:LAT,LON,2026-06-21T12:00+02:00``; the offset may be Z, or a zone in
        brackets, or both. Seconds may follow. LAT,LON may be left out if `site` has a CRS.
    site : Site, optional
        Where the model stands.

    Raises
    ------
    InputError
        It is anything else, an arc, or a moment at which the centre of the sun, with
        refraction, is not above the horizon.
    """
    text = split_sun(spec)
    if text.is_arc:
        refuse(
            spec,
            "it is an arc, many lights, where one is asked for; one moment is written "
            "sun:LAT,LON,2026-03-20T12:00[Europe/Vienna]",
        )
    when = moment_of(text)
    (sun,) = _suns(*_place(text, site), [when])
    if not sun.altitude_deg > 0.0:
        refuse(
            spec,
            f"the sun is {-sun.altitude_deg:.2f} degrees below the horizon at "
            f"{sun.latitude_deg:.10g}, {sun.longitude_deg:.10g} on "
            f"{' '.join(moment_text(sun.time, ' '))}: it lights nothing",
        )
    return sun


def leaves_out_place(spec: str) -> bool:
    """Whether `spec` is of the sun and leaves its place to the model, its times well written.

    Raises
    ------
    InputError
        It is of the sun, and its place, its times or its zone cannot be understood.
    """
    if not is_sun(spec):
        return False
    text = split_sun(spec)
    if text.place is not None:
        return False
    if text.is_arc:
        _ends_and_step(text)
    else:
        moment_of(text)
    return True


def parse_arc(spec: str, site: Site | None = None) -> Arc:
    """Return the arc that `spec` names.

    Parameters
    ----------
    spec : str
        ``sun:LAT,LON,2026-03-20/06:00/18:00/15m[Europe/Vienna]``. The zone is an IANA
        name, UTC, Z or an offset; a time that its clocks skip or show twice is refused
        unless it has an offset: ``02:30+02:00``. The end may be 24:00. The step is
        written as ``15m``, ``1h``, ``30s`` or ``1h30m``. LAT,LON may be left out if
        `site` has a CRS.
    site : Site, optional
        Where the model stands.

    Returns
    -------
    Arc
        A light at BEGIN, BEGIN + STEP, ... before END, where the sun is above the horizon;
        each stands for the step that begins with it.

    Raises
    ------
    InputError
        It is anything else, has more than `MOST_STEPS` steps, or never sees the sun.

    Notes
    -----
    O(n_steps), some 30 us each.
    """
    # Only `svprep.light` knows what a light is, and it gives out this module's names too.
    from svprep.light import sunlight

    if not is_sun(spec):
        refuse(spec, "it is not an arc of the sun", SUN_FORMS)
    text = split_sun(spec)
    begin, end, step, n_steps = _ends_and_step(text)
    zone = begin.tzinfo
    first = begin.astimezone(UTC)
    times = [(first + k * step).astimezone(zone) for k in range(n_steps)]
    latitude_deg, longitude_deg, convergence_deg = _place(text, site)
    suns = _suns(latitude_deg, longitude_deg, convergence_deg, times)
    day = [k for k, sun in enumerate(suns) if sun.altitude_deg > 0.0]
    if not day:
        _refuse_night(text, suns)
    return Arc(
        spec=spec,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        zone=text.zone.name if text.zone else "",
        date=begin.date(),
        begin=begin,
        end=end,
        step_minutes=step / timedelta(minutes=1),
        n_steps=n_steps,
        n_night=n_steps - len(day),
        step_of_light=tuple(day),
        times=tuple(times[k] for k in day),
        lights=tuple(sunlight(suns[k]) for k in day),
        convergence_deg=convergence_deg,
    )


def _ends_and_step(text: SunSpec) -> tuple[datetime, datetime, timedelta, int]:
    """Return begin, end, step and number of steps of an arc, the times in its zone."""
    spec = text.spec
    if not text.is_arc:
        refuse(spec, "it is one moment, not an arc", SUN_FORMS)
    parts = [part.strip() for part in text.when.split("/")]
    if len(parts) != 4:
        problem = f"an arc has 4 parts between slashes, DATE/BEGIN/END/STEP, not {len(parts)}"
        refuse(spec, problem, SUN_FORMS)
    if text.zone is None:
        refuse(spec, "the zone is missing: end with [Europe/Vienna], [+02:00] or [UTC]", SUN_FORMS)
    on = date_of(spec, parts[0])
    begin = time_of(spec, on, parts[1], text.zone)
    end = time_of(spec, on, parts[2], text.zone, is_end=True)
    step = step_of(spec, parts[3])
    # Between times of one zone Python would subtract what clocks show.
    span = end.astimezone(UTC) - begin.astimezone(UTC)
    if span <= timedelta(0):
        hint = " (midnight at the end of a day is 24:00)" if parts[2].startswith("00:00") else ""
        refuse(spec, f"the end, {parts[2]}, is not after the begin, {parts[1]}{hint}", SUN_FORMS)
    if step > span:
        refuse(spec, f"the step {parts[3]} is longer than the arc", SUN_FORMS)
    n_steps = -(-span // step)
    if n_steps > MOST_STEPS:
        refuse(spec, f"it has {n_steps:,} steps; at most {MOST_STEPS:,} can be computed with")
    return begin, end, step, n_steps


def _place(text: SunSpec, site: Site | None) -> tuple[float, float, float | None]:
    """Return latitude, longitude and the convergence that is known, if one is."""
    known = site if site is not None and site.crs else None
    if text.place is None and known is None:
        refuse(
            text.spec,
            "LAT,LON may be left out only for a model with a CRS, and none is known here",
            SUN_FORMS,
        )
    try:
        convergence_deg = None if known is None else meridian_convergence_deg(known)
        own = None if known is None else place_of(known)
    except (InputError, EnvironmentProblem) as error:
        raise type(error)(f'light "{text.spec}": {error}') from None
    if text.place is None:
        assert own is not None
        return (*own, convergence_deg)
    latitude_deg, longitude_deg = text.place
    swapped = longitude_deg, latitude_deg
    if own is not None and _is_near(swapped, own) and not _is_near(text.place, own):
        problem = f"LAT comes first: the model is at {own[0]:.6g}, {own[1]:.6g}"
        refuse(text.spec, problem, SUN_FORMS)
    return latitude_deg, longitude_deg, convergence_deg


def _is_near(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return abs(a[0] - b[0]) < _NEAR_DEG and abs(a[1] - b[1]) < _NEAR_DEG


def _suns(
    latitude_deg: float,
    longitude_deg: float,
    convergence_deg: float | None,
    times: Sequence[datetime],
) -> list[SunMoment]:
    """Return the sun at each time, above the horizon or not."""
    azimuth_deg, altitude_deg = sun_angles(_unix_s(times), latitude_deg, longitude_deg)
    return [
        SunMoment(
            latitude_deg,
            longitude_deg,
            when.replace(tzinfo=timezone(when.utcoffset() or timedelta(0)), fold=0),
            azimuth,
            altitude,
            convergence_deg,
        )
        for when, azimuth, altitude in zip(
            times, azimuth_deg.tolist(), altitude_deg.tolist(), strict=True
        )
    ]


def _unix_s(times: Sequence[datetime]) -> F64:
    return np.array([(when - _EPOCH).total_seconds() for when in times])


def _refuse_night(text: SunSpec, suns: list[SunMoment]) -> NoReturn:
    """Refuse an arc without sun: say how far below the sun stays, and if it is polar night."""
    best = max(suns, key=lambda sun: sun.altitude_deg)
    noon = suns[0].time.replace(hour=12, minute=0, second=0, microsecond=0)
    around = _unix_s([noon + timedelta(minutes=10 * k) for k in range(-72, 73)])
    _, altitude_deg = sun_angles(around, best.latitude_deg, best.longitude_deg)
    polar = " (polar night: nor at any other time of that day)" if altitude_deg.max() <= 0.0 else ""
    refuse(
        text.spec,
        f"the sun stays below the horizon at {best.latitude_deg:.10g}, "
        f"{best.longitude_deg:.10g}{polar}; at best it is {-best.altitude_deg:.2f} degrees below, "
        f"at {clock_text(best.time)}",
    )
