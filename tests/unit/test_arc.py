"""Moments and arcs of the sun as users write them: places, clocks, zones, and bad ones."""

from __future__ import annotations

import re
import zoneinfo
from datetime import UTC, date, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svprep import light_spec
from svprep.arc import Arc, parse_arc
from svprep.errors import EnvironmentProblem, InputError
from svprep.light import Light, Site, SunMoment, parse_light, parse_lights
from svprep.light_spec import SUN_FORMS

VIENNA = "48.2,16.37"
DELFT = Site("EPSG:28992", 85_000.0, 447_000.0)


def sun(spec: str, site: Site | None = None) -> SunMoment:
    found = parse_light(spec, site).sun
    assert found is not None
    return found


def at(*parts: int) -> datetime:
    return datetime(*parts, tzinfo=UTC)  # type: ignore[arg-type,misc]


@pytest.mark.parametrize(
    ("when", "utc"),
    [
        ("2026-06-21T12:00+02:00", at(2026, 6, 21, 10)),
        ("2026-06-21T12:00Z", at(2026, 6, 21, 12)),
        ("2026-06-21t12:00z", at(2026, 6, 21, 12)),
        ("2026-06-21T12:00[UTC]", at(2026, 6, 21, 12)),
        ("2026-06-21T12:00[Z]", at(2026, 6, 21, 12)),
        ("2026-06-21T12:00 [ Europe/Vienna ]", at(2026, 6, 21, 10)),
        ("2026-02-21T12:00[Europe/Vienna]", at(2026, 2, 21, 11)),
        ("2026-06-21T12:00+02:00[Europe/Vienna]", at(2026, 6, 21, 10)),
        ("2026-06-21T12:00[+02:00]", at(2026, 6, 21, 10)),
        ("2026-06-21T12:00[-01]", at(2026, 6, 21, 13)),
        ("2026-06-21 12:00 +0530", at(2026, 6, 21, 6, 30)),
        ("2026-06-21T12:00:30Z", at(2026, 6, 21, 12, 0, 30)),
        ("2026-06-21T12:00:30.25Z", at(2026, 6, 21, 12, 0, 30, 250_000)),
        ("1890-06-21T12:00[Europe/Vienna]", at(1890, 6, 21, 10, 54, 39)),  # its own mean time
        ("2026-06-21T18:00[Asia/Kolkata]", at(2026, 6, 21, 12, 30)),
        ("2028-02-29T12:00Z", at(2028, 2, 29, 12)),
    ],
)
def test_times_of_moments(when: str, utc: datetime) -> None:
    found = sun(f"sun:{VIENNA},{when}")
    assert found.time.astimezone(UTC) == utc
    assert (found.latitude_deg, found.longitude_deg) == (48.2, 16.37)
    assert found == sun(f" SUN : 48.20 , +1.637e1 , {when}")


def test_a_place_that_is_left_out_is_the_models() -> None:
    light = parse_light("sun:2026-06-21T12:00+02:00", DELFT)
    assert light.sun is not None
    # The Dutch grid's own test of its transformation is not needed here: 10 m are plenty.
    assert light.sun.latitude_deg == pytest.approx(52.00695, abs=1e-4)
    assert light.sun.longitude_deg == pytest.approx(4.36768, abs=1e-4)
    assert light.sun.convergence_deg == pytest.approx(-0.8044, abs=1e-3)
    arc = parse_arc("sun:2026-06-21/08:00/20:00/1h[Europe/Amsterdam]", DELFT)
    assert (arc.latitude_deg, arc.longitude_deg) == (
        light.sun.latitude_deg,
        light.sun.longitude_deg,
    )
    assert arc.convergence_deg == light.sun.convergence_deg
    assert arc.lights[4].sun == light.sun
    assert parse_light(arc.lights[4].spec, DELFT) == arc.lights[4]


def test_an_arc_of_a_day() -> None:
    spec = f"sun:{VIENNA},2026-03-20/06:00/18:00/15m[Europe/Vienna]"
    arc = parse_arc(spec)
    assert (arc.spec, arc.zone, arc.date) == (spec, "Europe/Vienna", date(2026, 3, 20))
    assert (arc.latitude_deg, arc.longitude_deg, arc.convergence_deg) == (48.2, 16.37, None)
    assert (arc.n_steps, arc.n_night, arc.step_minutes) == (48, 0, 15.0)
    assert arc.step_of_light == tuple(range(48))
    assert arc.begin.isoformat() == "2026-03-20T06:00:00+01:00"
    assert arc.end.isoformat() == "2026-03-20T18:00:00+01:00"
    assert [t.isoformat() for t in (arc.times[0], arc.times[1], arc.times[-1])] == [
        "2026-03-20T06:00:00+01:00",
        "2026-03-20T06:15:00+01:00",
        "2026-03-20T17:45:00+01:00",
    ]
    assert arc.lights[0].spec == "sun:48.2,16.37,2026-03-20T06:00+01:00"
    altitudes = [light.sun.altitude_deg for light in arc.lights if light.sun]
    assert len(altitudes) == 48
    assert 40.0 < max(altitudes) < 42.0


def test_steps_at_night_have_no_light() -> None:
    arc = parse_arc(f"sun:{VIENNA},2026-06-21/00:00/24:00/30m[Europe/Vienna]")
    assert (arc.n_steps, len(arc.lights), arc.n_night) == (48, 32, 16)
    assert arc.step_of_light == tuple(range(10, 42))  # 05:00 to 20:30 in summer time
    assert len(arc.times) == len(arc.lights)
    for k, when, light in zip(arc.step_of_light, arc.times, arc.lights, strict=True):
        assert when.astimezone(UTC) == arc.begin.astimezone(UTC) + k * timedelta(minutes=30)
        assert light.sun is not None
        assert light.sun.time == when
        assert light.sun.altitude_deg > 0.0
        assert light.z > 0.0


@pytest.mark.parametrize(
    ("arc", "n_steps", "step_minutes"),
    [
        ("2026-03-29/00:00/24:00/1h[Europe/Vienna]", 23, 60.0),  # clocks go forward
        ("2026-10-25/00:00/24:00/1h[Europe/Vienna]", 25, 60.0),  # and back
        ("2026-10-25/00:00/24:00/1h[+01:00]", 24, 60.0),
        ("2026-10-25/02:30+02:00/24:00/1h[Europe/Vienna]", 23, 60.0),
        ("2026-10-25/02:30+01:00/24:00/1h[Europe/Vienna]", 22, 60.0),
        ("2026-10-25/00:00/02:30+01:00/1h[Europe/Vienna]", 4, 60.0),
        ("2026-10-04/00:00/24:00/1h[Australia/Sydney]", 23, 60.0),
        ("2026-04-05/00:00/24:00/1h[Australia/Sydney]", 25, 60.0),
        ("2026-10-04/00:00/24:00/30m[Australia/Lord_Howe]", 47, 30.0),  # half an hour forward
        ("2026-06-21/00:00/24:00/1h[Asia/Kathmandu]", 24, 60.0),
        ("2026-06-21/12:00/13:00/1h[UTC]", 1, 60.0),
        ("2026-06-21/12:00/13:00/7m[UTC]", 9, 7.0),  # the last step passes the end
        ("2026-06-21/12:00/13:00/1h30m[UTC]", 0, 0.0),
        ("2026-06-21/10:00/13:00/1h30m[UTC]", 2, 90.0),
        ("2026-06-21/12:00/12:10/30s[UTC]", 20, 0.5),
        ("2026-06-21/12:00:10/12:00:20.5/1.5s[UTC]", 7, 0.025),
        ("2026-06-21/12:00/13:00/0.25h[-00:00]", 4, 15.0),
        ("2026-06-21 / 12:00 / 13:00 / 15m [UTC]", 4, 15.0),
    ],
)
def test_steps_are_of_time_that_passes(arc: str, n_steps: int, step_minutes: float) -> None:
    if not n_steps:
        with pytest.raises(InputError, match="longer than the arc"):
            parse_arc(f"sun:{VIENNA},{arc}")
        return
    # Around the globe for a sun at any of these hours.
    for longitude in (16.37, -163.63):
        try:
            found = parse_arc(f"sun:48.2,{longitude},{arc}")
        except InputError as error:
            assert "below the horizon" in str(error)  # noqa: PT017
            continue
        assert (found.n_steps, found.step_minutes) == (n_steps, step_minutes)
        assert found.n_steps == found.n_night + len(found.lights)


@pytest.mark.parametrize(
    ("spec", "zone"),
    [
        ("sun:-33.87,151.21,2026-12-21/08:00/16:00/1h[Australia/Sydney]", "Australia/Sydney"),
        ("sun:40.7128,-74.006,2026-06-21/08:00/16:00/1h[America/New_York]", "America/New_York"),
        ("sun:27.7172,85.324,2026-06-21/08:00/16:00/20m[Asia/Kathmandu]", "Asia/Kathmandu"),
        ("sun:48.2,16.37,2026-06-21/08:00/16:00/100s[+0200]", "+02:00"),
        ("sun:48.2,16.37,2026-06-21/08:00/16:00/1h[Z]", "UTC"),
        ("sun:48.2,16.37,2026-06-21/08:00/09:00/0.7s[UTC]", "UTC"),
        ("sun:1e-7,-0.0,2026-10-25/08:00/16:00/13m[UTC]", "UTC"),
        ("sun:-77.85,166.67,2026-12-31/00:00/24:00/1h[Antarctica/McMurdo]", "Antarctica/McMurdo"),
        ("sun:48.2,16.37,1890-06-21/08:00/16:00/1h[Europe/Vienna]", "Europe/Vienna"),
    ],
)
@pytest.mark.parametrize("site", [None, DELFT])
def test_each_light_of_an_arc_is_that_moments_light(
    spec: str, zone: str, site: Site | None
) -> None:
    arc = parse_arc(spec, site)
    some = {0, 1, len(arc.lights) // 2, len(arc.lights) - 2, len(arc.lights) - 1}
    for k in sorted(some) if len(arc.lights) > 100 else range(len(arc.lights)):
        light = arc.lights[k]
        alone = parse_light(light.spec, site)
        assert alone == light  # to the last bit, words and all
        assert hash(alone) == hash(light)
        assert alone.sun is not None
        assert alone.sun.time == arc.times[k]
    assert parse_lights([spec], site) == list(arc.lights)
    assert arc.zone == zone


def test_polar_day_is_an_arc_without_night() -> None:
    arc = parse_arc("sun:69.65,18.96,2026-06-21/00:00/24:00/1h[Europe/Oslo]")
    assert (arc.n_steps, arc.n_night) == (24, 0)
    north = min(arc.lights, key=lambda light: light.z)
    assert north.y > 0.9


BAD = "2026-06-21/06:00/18:00/15m[Europe/Vienna]"
FORM_ERRORS = [
    ("", "date and time are missing"),
    (VIENNA, "date and time are missing"),
    (f"{VIENNA},", "date and time are missing"),
    (f"{VIENNA},noon", '"noon" is not a date and time'),
    (f"{VIENNA},2026-06-21", "the time of day after 2026-06-21 is missing"),
    (f"{VIENNA},2026-06-21[Europe/Vienna]", "the time of day after"),
    (f"{VIENNA},2026-06-21T", "not a date and time"),
    (f"{VIENNA},2026-06-21Tnoon", '"noon" is not a time of day'),
    (f"{VIENNA},2026-06-21T12", '"12" is not a time of day'),
    (f"{VIENNA},2026-06-21T12:00", "12:00 has no zone: end with Z"),
    (f"{VIENNA},2026-06-21T25:00Z", 'there is no time of day "25:00Z"'),
    (f"{VIENNA},2026-06-21T24:00Z", "(24:00 is for the end of an arc)"),
    (f"{VIENNA},2026-06-21T12:60Z", 'there is no time of day "12:60Z"'),
    (f"{VIENNA},2026-06-21T12:00:60Z", "there is no time of day"),
    (f"{VIENNA},2026-06-21T12:00+25:00", "no place is +25:00 from UTC"),
    (f"{VIENNA},2026-06-21T12:00+02:99", "no place is +02:99 from UTC"),
    (f"{VIENNA},2026-06-21T12:00[Europe/Vienna", "the zone in brackets comes last"),
    (f"{VIENNA},2026-06-21T12:00[UTC][UTC]", "the zone in brackets comes last"),
    (f"{VIENNA},[UTC]2026-06-21T12:00", "the zone in brackets comes last"),
    (f"{VIENNA},2026-06-21T12:00[]", "the brackets hold no zone"),
    (f"{VIENNA},2026-06-21T12:00[Europe/Wien]", 'the zone "Europe/Wien" is unknown'),
    (f"{VIENNA},2026-06-21T12:00[europe/vienna]", "close to it: Europe/Vienna"),
    (f"{VIENNA},2026-06-21T12:00[Vienna]", "close to it: Europe/Vienna"),
    (f"{VIENNA},2026-06-21T12:00[New York]", "America/New_York"),
    (f"{VIENNA},2026-06-21T12:00[Europe]", "is unknown"),
    (f"{VIENNA},2026-06-21T12:00[Europe/../Europe/Vienna]", "is unknown"),
    (f"{VIENNA},2026-06-21T12:00[/etc/localtime]", "is unknown"),
    (f"{VIENNA},2026-06-21T12:00[localtime]", "is unknown"),
    (f"{VIENNA},2026-06-21T12:00[right/Europe/Vienna]", "close to it: Europe/Vienna"),
    (f"{VIENNA},2026-06-21T12:00[\0]", "is unknown"),
    (f"{VIENNA},2026-02-30T12:00Z", "there is no date 2026-02-30"),
    (f"{VIENNA},2026-02-29/06:00/18:00/15m[UTC]", "there is no date 2026-02-29"),
    (f"{VIENNA},2026-13-01T12:00Z", "there is no date 2026-13-01"),
    (f"{VIENNA},2026-6-21T12:00Z", '"2026-6-21" is not a date like 2026-03-20'),
    (f"{VIENNA},21.06.2026T12:00Z", "is not a date and time"),
    (f"{VIENNA},0001-01-01T12:00Z", "the year 1 is not between 2 and 6000"),
    (f"{VIENNA},0000-01-01T12:00Z", "the year 0 is not"),
    (f"{VIENNA},-0044-03-15T12:00Z", "the year -44 is not"),
    (f"{VIENNA},6001-03-15T12:00Z", "the year 6001 is not"),
    (f"91,16.37,{BAD}", "LAT 91 is not between -90 and 90 degrees (LAT comes first: sun:16.37,91"),
    (f"1e9,16.37,{BAD}", "LAT 1000000000 is not between -90 and 90 degrees. A"),
    (f"-90.5,200,{BAD}", "LAT -90.5 is not between -90 and 90 degrees. A"),
    (f"151.2,-33.9,{BAD}", "(LAT comes first: sun:-33.9,151.2,... ?)"),
    (f"48.2,181,{BAD}", "LON 181 is not between -180 and 180"),
    (f"48.2,-180.01,{BAD}", "LON -180.01 is not"),
    (f"nan,16.37,{BAD}", 'LAT is "nan", which is not a finite number'),
    (f"48.2,inf,{BAD}", 'LON is "inf", which is not a finite number'),
    (f"48.2,,{BAD}", "LON is missing"),
    (f"48.2,{BAD}", "LON is missing"),
    (f"48,2,16,4,{BAD}", "4 numbers instead of 2 (a comma parts numbers"),
    (f"48.2N,16.4E,{BAD}", 'LAT is "48.2N", which is not a number'),
    ("2026-06-21T12:00Z", "LAT,LON may be left out only for a model with a CRS"),
    (BAD, "LAT,LON may be left out only for a model with a CRS"),
    (f"{VIENNA},2026-06-21/06:00/18:00/15m", "the zone is missing"),
    (f"{VIENNA},2026-06-21/06:00/18:00[UTC]", "DATE/BEGIN/END/STEP, not 3"),
    (f"{VIENNA},2026-06-21/06:00/18:00/15m/1[UTC]", "DATE/BEGIN/END/STEP, not 5"),
    (f"{VIENNA},2026-06-21/18:00/06:00/15m[UTC]", "the end, 06:00, is not after the begin, 18:00"),
    (f"{VIENNA},2026-06-21/06:00/06:00/15m[UTC]", "is not after the begin"),
    (f"{VIENNA},2026-06-21/06:00/00:00/15m[UTC]", "(midnight at the end of a day is 24:00)"),
    (f"{VIENNA},2026-06-21/24:00/24:00/15m[UTC]", "(24:00 is for the end of an arc)"),
    (f"{VIENNA},2026-06-21/06:00/24:01/15m[UTC]", 'there is no time of day "24:01"'),
    (f"{VIENNA},2026-06-21/06:00/18:00/0m[UTC]", "the step 0m is none"),
    (f"{VIENNA},2026-06-21/06:00/18:00/[UTC]", '"" is not a step like 15m'),
    (f"{VIENNA},2026-06-21/06:00/18:00/15[UTC]", '"15" is not a step like 15m'),
    (f"{VIENNA},2026-06-21/06:00/18:00/-15m[UTC]", '"-15m" is not a step'),
    (f"{VIENNA},2026-06-21/06:00/18:00/15min[UTC]", '"15min" is not a step'),
    (f"{VIENNA},2026-06-21/06:00/18:00/0.0000001s[UTC]", "not a whole number of microseconds"),
    (f"{VIENNA},2026-06-21/06:00/18:00/13h[UTC]", "the step 13h is longer than the arc"),
    (f"{VIENNA},2026-06-21//18:00/13h[UTC]", '"" is not a time of day'),
]


@pytest.mark.parametrize(("rest", "says"), FORM_ERRORS)
def test_a_bad_spec_is_quoted_explained_and_answered_with_the_forms(rest: str, says: str) -> None:
    with pytest.raises(InputError) as error:
        parse_lights([f"sun:{rest}"])
    text = str(error.value)
    assert text.startswith(f'light "sun:{rest}": ')
    assert says in text
    assert text.endswith(f". A light is {SUN_FORMS}")


@pytest.mark.parametrize(
    ("rest", "says"),
    [
        # Clocks skip 02:00 to 03:00, and show 02:00 to 03:00 twice.
        ("2026-03-29T02:30[Europe/Vienna]", r"never 02:30 .* Write 03:30, or"),
        ("2026-10-25T02:30[Europe/Vienna]", r"twice: write 02:30\+02:00 or 02:30\+01:00,"),
        ("2026-03-29/02:00/24:00/1h[Europe/Vienna]", r"never 02:00.* Write 03:00.* \[\+01:00\]"),
        ("2026-03-29/00:00/02:59/1h[Europe/Vienna]", r"never 02:59"),
        ("2026-10-25/02:00/24:00/1h[Europe/Vienna]", r"02:00 .* twice.*\[\+02:00\]"),
        ("2026-10-25/00:00/02:59/1h[Europe/Vienna]", r"02:59 .* twice"),
        ("2026-04-24/00:00/12:00/1h[Africa/Cairo]", r"never 00:00 .* Write 01:00"),
        ("2026-04-23/06:00/24:00/1h[Africa/Cairo]", r"never 00:00 on 2026-04-24"),
        ("2026-10-04T02:15[Australia/Lord_Howe]", r"never 02:15 .* Write 02:45"),
        ("2026-03-29T02:30+01:00[Europe/Vienna]", r"Europe/Vienna, which is \+02:00 then"),
        ("2026-06-21T12:00+01:00[Europe/Vienna]", r"Europe/Vienna, which is \+02:00 then"),
        (
            "2026-06-21T00:00Z",
            r"is 16\.95 degrees below the horizon at 48\.2, 16\.37 on 2026-06-21",
        ),
        ("2026-06-21/22:00/23:00/15m[+02:00]", r"stays below .*at best it is .* below, at 22:00"),
        ("2026-06-21/00:00/24:00/0.5s[UTC]", r"172,800 steps; at most 100,000"),
    ],
)
def test_a_time_that_cannot_be_used(rest: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as error:
        parse_lights([f"sun:{VIENNA},{rest}"])
    text = str(error.value)
    assert text.startswith(f'light "sun:{VIENNA},{rest}": ')
    assert "polar" not in text
    assert "\n" not in text


def test_the_way_out_that_a_message_names_works() -> None:
    assert sun("sun:30,31,2026-10-25T12:00[Africa/Cairo]").altitude_deg > 0.0
    first, second = (
        sun(f"sun:0,180,2026-10-25T02:30{offset}[Europe/Vienna]") for offset in ("+02:00", "+01:00")
    )
    assert second.time.astimezone(UTC) - first.time.astimezone(UTC) == timedelta(hours=1)
    assert second.time.isoformat() == "2026-10-25T02:30:00+01:00"


def test_polar_night_is_told_apart() -> None:
    with pytest.raises(InputError, match=r"polar night.*3\.\d\d degrees below, at 1[12]:00"):
        parse_arc("sun:69.65,18.96,2026-12-21/08:00/16:00/1h[Europe/Oslo]")
    with pytest.raises(InputError, match=r"is \d\.\d\d degrees below the horizon"):
        parse_light("sun:69.65,18.96,2026-12-21T12:00[Europe/Oslo]")


def test_one_light_is_no_arc_and_an_arc_is_no_one_light() -> None:
    with pytest.raises(InputError, match=r"it is an arc.*sun:LAT,LON,2026-03-20T12:00\["):
        parse_light(f"sun:{VIENNA},{BAD}")
    with pytest.raises(InputError, match="it is an arc"):
        parse_light(f"sun:{BAD}", DELFT)
    with pytest.raises(InputError, match="it is one moment, not an arc"):
        parse_arc(f"sun:{VIENNA},2026-06-21T12:00Z")
    for spec in ("dir:135,40", "point:1,2,3", "", "lamp"):
        with pytest.raises(InputError, match="it is not an arc of the sun") as error:
            parse_arc(spec)
        assert str(error.value).endswith(SUN_FORMS)


def test_a_bad_crs_or_a_swapped_place_is_told_with_the_spec() -> None:
    spec = f"sun:{VIENNA},2026-06-21T12:00Z"
    for site in (Site("EPSG:4326", 16.0, 48.0), Site("of the city", 0.0, 0.0)):
        with pytest.raises(InputError, match=re.escape(f'light "{spec}": the CRS "{site.crs}"')):
            parse_light(spec, site)
    assert parse_light(spec, Site("", 0.0, 0.0)) == parse_light(spec)
    with pytest.raises(InputError, match=r"LAT comes first: the model is at 52\.0069, 4\.36768"):
        parse_light("sun:4.37,52,2026-06-21T12:00Z", DELFT)
    assert parse_light("sun:52,4.37,2026-06-21T12:00Z", DELFT).sun is not None
    assert parse_light("sun:48.2,16.37,2026-06-21T12:00Z", DELFT).sun is not None  # on purpose


def test_a_machine_without_zones_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def none_here(key: str) -> zoneinfo.ZoneInfo:
        raise zoneinfo.ZoneInfoNotFoundError(key)

    monkeypatch.setattr(zoneinfo, "ZoneInfo", none_here)
    monkeypatch.setattr(zoneinfo, "available_timezones", set)
    light_spec._known_zones.cache_clear()
    with pytest.raises(EnvironmentProblem, match="pip install tzdata"):
        parse_light(f"sun:{VIENNA},2026-06-21T12:00[Europe/Vienna]")
    light_spec._known_zones.cache_clear()
    assert isinstance(parse_light(f"sun:{VIENNA},2026-06-21T12:00[+02:00]"), Light)


def test_the_calendars_ends() -> None:
    for when in ("0002-01-01T00:00+23:59", "0002-01-01T12:00[Europe/Vienna]", "6000-12-31T23:59Z"):
        assert sun_or_night(f"sun:0,0,{when}")
        assert sun_or_night(f"sun:0,180,{when}")
    assert isinstance(parse_arc("sun:48,16,6000-06-21/00:00/24:00/1h[Europe/Vienna]"), Arc)


def sun_or_night(spec: str) -> bool:
    try:
        return parse_light(spec).w == 0.0
    except InputError as error:
        return "below the horizon" in str(error)


PIECES = st.sampled_from(
    [
        *"0123456789,.:/+-[]TZhms eE",
        "2026-06-21", "2026-10-25", "T12:00", "/06:00/18:00/", "15m", "[Europe/Vienna]",
        "[+02:00]", "48.2,16.37,", "nan", "24:00", "9999", "99999999999999999999",
    ]
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(st.one_of(st.text(max_size=40), st.lists(PIECES, max_size=10).map("".join)))
def test_any_text_is_a_light_or_an_input_error(rest: str) -> None:
    for parse in (parse_light, parse_arc):
        try:
            parse(f"sun:{rest}")
        except InputError as error:
            assert f'"sun:{rest}"' in str(error)  # noqa: PT017
