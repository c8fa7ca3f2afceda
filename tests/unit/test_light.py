"""Lights as users name them: where north is, what is exact, what is refused and how."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from svprep.errors import InputError
from svprep.light import (
    FARTHEST_M,
    FORMS,
    Light,
    Site,
    directional,
    parse_arc,
    parse_light,
    parse_lights,
    sunlight,
)
from svprep.model import Grid

ROOT = Path(__file__).resolve().parents[2]
HERE = Grid(2.0**-11, np.zeros(3))
FAR = Grid(2.0**-11, np.array([390_000.0, 5_820_000.0, 40.5]))
HALF = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("spec", "towards"),
    [
        ("dir:0,0", (0, 1, 0)),  # north
        ("dir:90,0", (1, 0, 0)),  # east
        ("dir:180,0", (0, -1, 0)),
        ("dir:270,0", (-1, 0, 0)),
        ("dir:0,90", (0, 0, 1)),  # the zenith
        ("dir:123,90", (0, 0, 1)),
        ("dir:77,-90", (0, 0, -1)),
        ("dir:-90,0", (-1, 0, 0)),
        ("dir:450,0", (1, 0, 0)),
        ("dir:3.6e12,0", (0, 1, 0)),
        ("dir:90,45", (HALF, 0, HALF)),
        ("dir:135,0", (HALF, -HALF, 0)),
        ("dir:225,0", (-HALF, -HALF, 0)),
        ("dir:30,0", (0.5, math.sqrt(0.75), 0)),
        ("dir:0,30", (0, math.sqrt(0.75), 0.5)),
        ("dir:0,-30", (0, math.sqrt(0.75), -0.5)),
        (" DIR : 9e1 , +0. ", (1, 0, 0)),
        ("dir:-0,-0", (0, 1, 0)),
    ],
)
def test_directions(spec: str, towards: tuple[float, float, float]) -> None:
    got = parse_light(spec).in_cache_frame(FAR)
    assert got.dtype == np.float32
    assert np.array_equal(got, np.array([*towards, 0.0], np.float32))  # zeros are exact
    assert not np.signbit(got[got == 0.0]).any()


def test_directions_have_unit_length_and_the_angles_asked_for() -> None:
    for azimuth in np.linspace(-720, 720, 97):
        for altitude in np.linspace(-90, 90, 37):
            light = directional(float(azimuth), float(altitude))
            assert light.x**2 + light.y**2 + light.z**2 == pytest.approx(1.0, abs=1e-15)
            assert math.degrees(math.asin(light.z)) == pytest.approx(altitude, abs=1e-5)
            if abs(altitude) < 89:
                got = math.degrees(math.atan2(light.x, light.y))
                assert abs(math.remainder(got - azimuth, 360)) < 1e-9


def test_a_point_is_moved_into_the_frame_before_it_is_rounded() -> None:
    light = parse_light("point:390012.25,5819990.5,41")
    assert (light.x, light.y, light.z, light.w) == (390_012.25, 5_819_990.5, 41.0, 1.0)
    # Rounded to float32 first, Y would be off by a quarter of a metre.
    assert light.in_cache_frame(FAR).tolist() == [12.25, -9.5, 0.5, 1.0]
    assert light.in_cache_frame(HERE)[1] == np.float32(5_819_990.5)
    assert parse_light("point:.5,-1.,1e2").in_cache_frame(HERE).tolist() == [0.5, -1, 100, 1]


def test_a_point_too_far_away_is_a_direction() -> None:
    near = parse_light(f"point:0,{FARTHEST_M / 2!r},0")
    assert near.in_cache_frame(HERE)[1] == FARTHEST_M / 2
    for y in (2 * FARTHEST_M, -1e39, 1.7e308):
        light = parse_light(f"point:0,{y!r},0")
        with pytest.raises(InputError, match=r"Y lies .* m from .*dir:AZIMUTH,ALTITUDE"):
            light.in_cache_frame(FAR)


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("", "none of dir:, point: and sun:"),
        ("135,40", "none of dir:, point: and sun:"),
        ("lamp:1,2,3", "none of dir:, point: and sun:"),
        ("dir", "AZIMUTH is missing"),
        ("dir:", "AZIMUTH is missing"),
        ("dir:,40", "AZIMUTH is missing"),
        ("dir:135", "ALTITUDE is missing"),
        ("dir:135,", "ALTITUDE is missing"),
        ("point:1,2", "Z is missing"),
        ("dir:135,40,1", "3 numbers instead of 2"),
        ("dir:135,5,40,0", "4 numbers instead of 2 (a comma parts numbers"),
        ("dir:135,90.0001", "ALTITUDE 90.0001 is not between -90 and 90"),
        ("dir:135,-91", "ALTITUDE -91 is not"),
        ("dir:south,40", 'AZIMUTH is "south", which is not a number'),
        ("dir:135°,40", 'AZIMUTH is "135°", which is not a number'),
        ("dir:1_0,40", 'AZIMUTH is "1_0", which is not a number'),
        ("dir:0x10,40", 'AZIMUTH is "0x10", which is not a number'),
        ("dir:\N{ARABIC-INDIC DIGIT THREE},40", "which is not a number"),
        ("dir:inf,40", 'AZIMUTH is "inf", which is not a finite number'),
        ("dir:135,nan", 'ALTITUDE is "nan", which is not a finite number'),
        ("point:0,-Infinity,0", 'Y is "-Infinity", which is not a finite number'),
        ("point:0,0,1e999", 'Z is "1e999", which is too large'),
    ],
)
def test_a_bad_spec_is_quoted_explained_and_answered_with_the_forms(spec: str, says: str) -> None:
    with pytest.raises(InputError) as error:
        parse_light(spec)
    text = str(error.value)
    assert text.startswith(f'light "{spec}": ')
    assert says in text
    assert text.endswith(FORMS)


def test_words_and_spec() -> None:
    assert parse_light("dir:495,40.50").words == "direction, azimuth 135, altitude 40.5"
    assert parse_light("dir:-1e-20,-3").words == (
        "direction, azimuth 0, altitude -3 (below the horizon)"
    )
    assert parse_light("point:390012.25,5,-1").words == "point (390012.25, 5, -1)"
    assert parse_light("dir:495,40.50").spec == "dir:495,40.50"
    again = parse_light(directional(12.5, 34.0).spec)
    assert again == directional(12.5, 34.0)


def test_a_light_is_a_value() -> None:
    light = parse_light("dir:135,40")
    assert {light: 1}[parse_light("dir:135,40")] == 1
    with pytest.raises(AttributeError):
        light.x = 1.0  # type: ignore[misc]
    assert "__slots__" in vars(Light)


def test_the_sun_is_one_light_in_the_directions_frame() -> None:
    light = parse_light("sun:48.2,16.37,2026-06-21T12:00+02:00")
    assert light.sun is not None
    as_angles = directional(light.sun.azimuth_deg, light.sun.altitude_deg)
    assert (light.x, light.y, light.z, light.w) == (as_angles.x, as_angles.y, as_angles.z, 0.0)
    assert light.spec == "sun:48.2,16.37,2026-06-21T12:00+02:00"
    assert light.words == (
        "sun at 48.2, 16.37 on 2026-06-21 12:00 +02:00, azimuth 150.73, altitude 62.84"
    )
    assert sunlight(light.sun) == light
    assert hash(light) == hash(parse_light(light.spec))
    assert parse_light("dir:135,40").sun is None
    assert parse_light("point:1,2,3").sun is None


def test_the_sun_on_a_grid_is_turned_by_the_convergence() -> None:
    site = Site("EPSG:32633", 700_000.0, 5_800_000.0)
    spec = "sun:52.3,17.9,2026-06-21T12:00+02:00"
    true, on_grid = parse_light(spec), parse_light(spec, site)
    assert true.sun is not None
    assert on_grid.sun is not None
    gamma = on_grid.sun.convergence_deg
    assert gamma is not None
    assert gamma > 2.0
    assert (true.sun.convergence_deg, true.z) == (None, on_grid.z)
    assert on_grid.sun.azimuth_deg == true.sun.azimuth_deg
    bearing = math.degrees(math.atan2(on_grid.x, on_grid.y)) % 360
    assert bearing == pytest.approx(true.sun.azimuth_deg - gamma, abs=1e-9)
    assert f"azimuth {true.sun.azimuth_deg:.2f} ({bearing:.2f} on the grid)" in on_grid.words
    # Lights of other kinds are on the grid already.
    assert parse_light("dir:135,40", site) == parse_light("dir:135,40")
    assert parse_light("dir:135,40", Site("nonsense", 0.0, 0.0)) == parse_light("dir:135,40")


def test_specs_become_lights_in_their_order() -> None:
    arc = "sun:48.2,16.37,2026-03-20/06:00/18:00/15m[Europe/Vienna]"
    lights = parse_lights(["dir:135,40", arc, "point:1,2,3", "dir:135,40"])
    assert len(lights) == 1 + 48 + 2
    assert lights[0] == lights[-1] == parse_light("dir:135,40")
    assert tuple(lights[1:-2]) == parse_arc(arc).lights
    assert parse_lights([]) == []
    with pytest.raises(InputError, match="STEP"):
        parse_lights(["dir:135,40", "sun:48,16,2026-03-20/06:00"])


def test_the_forms_name_every_kind() -> None:
    for form in ("dir:AZIMUTH,ALTITUDE", "point:X,Y,Z", "sun:LAT,LON,2026-06-21T12:00+02:00"):
        assert form in FORMS
    assert "sun:LAT,LON,2026-03-20/06:00/18:00/15m[Europe/Vienna]" in FORMS
    assert "\n" not in FORMS


def test_the_module_loads_without_heavy_packages() -> None:
    code = (
        "import sys, svprep.light; "
        "heavy = ('numba', 'scipy', 'h5py', 'pvlib', 'pandas', 'pyproj', 'zoneinfo', 'tzdata'); "
        "print([m for m in heavy if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
