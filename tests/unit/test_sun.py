"""The sun's position against published values, and true north on grids against geodesics."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

from svprep.errors import EnvironmentProblem, InputError
from svprep.model import F64, Place
from svprep.sun import Site, grid_azimuth_deg, meridian_convergence_deg, place_of, sun_angles


def unix(text: str) -> F64:
    """Return ``(1,)``: the time of a text in UTC."""
    return np.array([np.datetime64(text, "s").astype(np.int64)], np.float64)


def test_the_published_case_of_the_algorithm() -> None:
    # Reda and Andreas (2004), NREL/TP-560-34302, section A.5: October 17, 2003, 12:30:30 in
    # time zone -7. Topocentric zenith angle 50.11162, azimuth 194.34024.
    azimuth_deg, altitude_deg = sun_angles(
        unix("2003-10-17T19:30:30"),
        39.742476,
        -105.1786,
        elevation_m=1830.14,
        pressure_mbar=820.0,
        temperature_c=11.0,
        refraction_deg=0.5667,
        delta_t_s=67.0,
    )
    assert azimuth_deg[0] == pytest.approx(194.34024, abs=1e-5)
    assert 90.0 - altitude_deg[0] == pytest.approx(50.11162, abs=1e-5)


@pytest.mark.parametrize(
    ("latitude", "rises", "sets"),
    [
        (35.0, "1994-01-02T07:08:12", "1994-01-02T16:59:55"),
        (-35.0, "1996-07-05T07:08:15", "1996-07-05T17:01:04"),
        (-35.0, "2004-12-04T04:38:57", "2004-12-04T19:02:02"),
    ],
)
def test_published_times_of_sunrise_and_sunset(latitude: float, rises: str, sets: str) -> None:
    # Table in NREL/TP-560-34302 (sunrise and sunset on the meridian of Greenwich), which
    # agrees with the Astronomical Almanac: the centre stands 0.8333 degrees (refraction and
    # radius) below an airless horizon then. The tables neglect parallax, up to 0.0025 degrees.
    for text, side in ((rises, 90.0), (sets, 270.0)):
        airless = sun_angles(unix(text), latitude, 0.0, pressure_mbar=0.0)
        assert airless[1][0] == pytest.approx(-0.8333, abs=0.006)
        assert abs(airless[0][0] - side) < 35.0
        # Day, here, begins when the centre is seen on the horizon: a few minutes later.
        assert sun_angles(unix(text), latitude, 0.0)[1][0] < 0.0
        later = sun_angles(unix(text) + (300 if side == 90.0 else -300), latitude, 0.0)[1][0]
        assert later > 0.0


@pytest.mark.parametrize(
    ("text", "declination"),
    [
        # U.S. Naval Observatory, Earth's Seasons: equinoxes and solstices of 2020 to the
        # minute. The obliquity of the ecliptic is 23.4364 degrees by the Astronomical
        # Almanac for 2020.
        ("2020-03-20T03:50", 0.0),
        ("2020-06-20T21:44", 23.4364),
        ("2020-09-22T13:31", 0.0),
        ("2020-12-21T10:02", -23.4364),
    ],
)
def test_equinoxes_and_solstices_seen_from_the_poles(text: str, declination: float) -> None:
    # From a pole the sun's altitude is its declination, less parallax (0.0024 degrees).
    north = sun_angles(unix(text), 90.0, 0.0, pressure_mbar=0.0)[1][0]
    south = sun_angles(unix(text), -90.0, 0.0, pressure_mbar=0.0)[1][0]
    parallax = 0.0024 * math.cos(math.radians(declination))
    assert north == pytest.approx(declination - parallax, abs=0.0035)
    assert south == pytest.approx(-declination - parallax, abs=0.0035)


@pytest.mark.parametrize(
    ("latitude", "longitude", "noon", "bears", "altitude"),
    [
        # Noon altitude is 90 - |latitude - declination|; noon is at 12:00 - longitude / 15
        # less the equation of time: -1.8 minutes at the solstice of June, +1.7 at that of
        # December, +16.4 on November 3 (Meeus, Astronomical Algorithms, chapter 28).
        (48.2082, 16.3738, "2026-06-21T10:56:18", 180.0, 90 - 48.2082 + 23.436),
        (48.2082, 16.3738, "2026-12-21T10:52:48", 180.0, 90 - 48.2082 - 23.436),
        (-33.8688, 151.2093, "2026-06-21T01:56:58", 0.0, 90 - 33.8688 - 23.436),
        (-33.8688, 151.2093, "2026-12-22T01:53:40", 0.0, 90 - 33.8688 + 23.436),
        (40.7128, -74.0060, "2026-06-21T16:57:50", 180.0, 90 - 40.7128 + 23.436),
        (0.0, -180.0, "2026-11-03T23:43:36", 180.0, 90 - 15.2),
        (0.0, 180.0, "2026-11-02T23:43:36", 180.0, 90 - 14.9),
    ],
)
def test_noon_north_and_south_east_and_west(
    latitude: float, longitude: float, noon: str, bears: float, altitude: float
) -> None:
    azimuth_deg, altitude_deg = sun_angles(unix(noon), latitude, longitude, pressure_mbar=0.0)
    assert abs(math.remainder(azimuth_deg[0] - bears, 360.0)) < 0.25
    assert altitude_deg[0] == pytest.approx(altitude, abs=0.15 if latitude == 0.0 else 0.01)


@pytest.mark.parametrize("latitude", [-50.0, -20.0, 0.0, 30.0, 60.0])
def test_at_the_equinox_the_sun_rises_due_east_and_sets_due_west(latitude: float) -> None:
    day = unix("2026-03-20T00:00") + np.arange(0, 86400, 60)
    azimuth_deg, altitude_deg = sun_angles(day, latitude, 0.0, pressure_mbar=0.0)
    up = altitude_deg > 0.0
    rise, down = np.flatnonzero(np.diff(up.astype(np.int8)))
    assert azimuth_deg[rise] == pytest.approx(90.0, abs=0.8)
    assert azimuth_deg[down] == pytest.approx(270.0, abs=0.8)
    assert (down - rise) == pytest.approx(720, abs=3)
    assert altitude_deg.max() == pytest.approx(90 - abs(latitude), abs=0.2)


def test_polar_day_and_polar_night() -> None:
    around_the_clock = np.arange(0, 86400, 600)
    june = sun_angles(unix("2026-06-21T00:00") + around_the_clock, 78.22, 15.65)[1]
    december = sun_angles(unix("2026-12-21T00:00") + around_the_clock, 78.22, 15.65)[1]
    assert june.min() > 11.0
    assert december.max() < -11.0
    # The other pole, the other way round.
    assert sun_angles(unix("2026-06-21T00:00") + around_the_clock, -77.85, 166.67)[1].max() < -11.0


def test_refraction_lifts_the_horizon_and_nothing_else() -> None:
    day = unix("2026-03-20T00:00") + np.arange(0, 86400, 60)
    azimuth, apparent = sun_angles(day, 48.0, 0.0)
    airless_azimuth, airless = sun_angles(day, 48.0, 0.0, pressure_mbar=0.0)
    lift = apparent - airless
    assert np.array_equal(azimuth, airless_azimuth)
    assert (lift >= 0.0).all()
    assert lift[airless < -0.84].max() == 0.0
    assert lift[np.abs(airless) < 0.1] == pytest.approx(0.48, abs=0.03)  # 29 arc minutes
    assert lift[airless > 40.0].max() < 0.021


def test_a_time_has_the_same_sun_alone_and_among_others() -> None:
    # A new year is in the middle: the difference of time scales changes with the month.
    times = unix("2026-12-31T20:00") + np.arange(0, 8 * 3600, 97.25)
    azimuth_deg, altitude_deg = sun_angles(times, -33.8688, 151.2093)
    for k in (0, 1, 63, 64, 100, 200, len(times) - 1):
        alone = sun_angles(times[k], -33.8688, 151.2093)
        assert (alone[0][0], alone[1][0]) == (azimuth_deg[k], altitude_deg[k])


def test_years_at_the_ends_of_the_algorithm() -> None:
    for year in ("-2000", "0002", "2999", "3500", "6000"):
        azimuth_deg, altitude_deg = sun_angles(unix(f"{year}-06-21T12:00"), 48.0, 0.0)
        assert 60.0 < azimuth_deg[0] < 300.0
        assert 50.0 < altitude_deg[0] < 70.0
    for year in ("-2001", "6001"):
        with pytest.raises(InputError, match="years -2000 to 6000"):
            sun_angles(unix(f"{year}-06-21T12:00"), 48.0, 0.0)
    with pytest.raises(InputError, match="years"):
        sun_angles(math.nan, 48.0, 0.0)
    assert [a.shape for a in sun_angles([], 48.0, 0.0)] == [(0,), (0,)]


# A Gauss-Krueger zone, UTM on both sides of its meridian and south of the equator, Dutch RD
# (oblique stereographic; with heights as a compound), Krovak, feet, a pole, axes to the south.
GRIDS = [
    Site("EPSG:32633", 300_000.0, 5_340_000.0),
    Site("EPSG:32633", 700_000.0, 5_340_000.0),
    Site("EPSG:32733", 300_000.0, 6_200_000.0),
    Site("EPSG:32733", 700_000.0, 6_200_000.0),
    Site("EPSG:28992", 20_000.0, 380_000.0),
    Site("EPSG:28992", 250_000.0, 580_000.0),
    Site("EPSG:7415", 85_000.0, 447_000.0),
    Site("EPSG:31256", 2_000.0, 340_000.0),
    Site("EPSG:5514", -740_000.0, -1_040_000.0),
    Site("EPSG:2263", 300_000.0, 60_000.0),
    Site("EPSG:3031", 1_000_000.0, 1_000_000.0),
    Site("EPSG:2053", -50_000.0, 3_000_000.0),
]


@pytest.mark.parametrize("site", GRIDS, ids=lambda s: f"{s.crs}@{s.x_m:.0f}")
def test_a_walk_along_a_true_azimuth_has_the_grid_azimuth(site: Site) -> None:
    # Independent of how the convergence is found: geodesics on the ellipsoid, projected.
    pyproj = pytest.importorskip("pyproj")
    crs = pyproj.CRS(site.crs).to_2d()
    to_grid = pyproj.Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True)
    unit_m = crs.axis_info[0].unit_conversion_factor
    start = site.x_m / unit_m, site.y_m / unit_m
    longitude, latitude = to_grid.transform(*start, direction="INVERSE")
    gamma = meridian_convergence_deg(site)
    for azimuth in (0.0, 37.0, 154.0, 250.0):
        lon, lat, _ = crs.get_geod().fwd(longitude, latitude, azimuth, 100.0)
        x, y = to_grid.transform(lon, lat)
        bearing = math.degrees(math.atan2(x - start[0], y - start[1]))
        assert abs(math.remainder(bearing - grid_azimuth_deg(azimuth, gamma), 360.0)) < 2e-3
    place = place_of(site)
    assert place == pytest.approx((latitude, longitude), abs=0.01)  # another datum


def test_the_sign_of_the_convergence() -> None:
    # Snyder (1987), Map Projections, 8-9: tan c = tan(dlon) sin(lat) on the sphere; grid
    # north is east of true north where the zone is east of its meridian, if north.
    signs = [math.copysign(1.0, meridian_convergence_deg(site)) for site in GRIDS[:6]]
    assert signs == [-1.0, 1.0, 1.0, -1.0, -1.0, 1.0]
    for site in GRIDS[:4]:
        latitude, longitude = place_of(site)
        turn = math.tan(math.radians(longitude - 15.0)) * math.sin(math.radians(latitude))
        gamma = meridian_convergence_deg(site)
        assert gamma == pytest.approx(math.degrees(math.atan(turn)), abs=2e-3)
    assert grid_azimuth_deg(180.0, 2.5) == 177.5
    assert grid_azimuth_deg(180.0, None) == 180.0


@pytest.mark.parametrize(
    ("site", "says"),
    [
        (Site("EPSG:4326", 16.4, 48.2), "degrees for coordinates"),
        (Site("EPSG:4979", 16.4, 48.2), "degrees for coordinates"),
        (Site("EPSG:4978", 4e6, 1e6), "not a projected one"),
        (Site("EPSG:5703", 0.0, 0.0), "not a projected one"),
        (Site("EPSG:999999", 0.0, 0.0), "none that pyproj knows"),
        (Site("the city's own", 0.0, 0.0), 'CRS "the city\'s own" of the model is none'),
        (Site("EPSG:" + "9" * 5000, 0.0, 0.0), "9..."),
        (Site("EPSG:28992", 1e12, 1e12), "does not reach the model, at (1e+12, 1e+12)"),
        (Site("EPSG:32633", math.inf, 0.0), "does not reach the model"),
        (Site("EPSG:5513", 1_040_000.0, 740_000.0), "mirrors the ground"),
    ],
)
def test_a_crs_that_does_not_tell_true_north_is_refused(site: Site, says: str) -> None:
    for ask in (meridian_convergence_deg, place_of):
        with pytest.raises(InputError) as error:
            ask(site)
        text = str(error.value)
        assert says in text
        assert text.endswith("dir:AZIMUTH,ALTITUDE")
        assert "\n" not in text
        assert len(text) < 300


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(EnvironmentProblem, match=r"svprep\[formats\]"):
        meridian_convergence_deg(Site("EPSG:32633", 412_345.0, 5_340_000.0))
    monkeypatch.setitem(sys.modules, "pvlib", None)
    with pytest.raises(EnvironmentProblem, match="pip install pvlib"):
        sun_angles(0.0, 48.0, 16.0)


def test_what_a_build_has_stored_is_taken_without_pyproj(monkeypatch: pytest.MonkeyPatch) -> None:
    site = Site("EPSG:28992", 85_000.0, 447_000.0)
    place = Place(site.crs, *place_of(site), meridian_convergence_deg(site))
    stored = Site.of(place, site.x_m, site.y_m)
    monkeypatch.setitem(sys.modules, "pyproj", None)
    assert place_of(stored) == (place.latitude_deg, place.longitude_deg)
    assert meridian_convergence_deg(stored) == place.convergence_deg
    # Without the numbers, as a build without pyproj stores it, the CRS has to be asked.
    with pytest.raises(EnvironmentProblem, match=r"svprep\[formats\]"):
        meridian_convergence_deg(Site.of(Place("EPSG:28992"), site.x_m, 447_001.0))
