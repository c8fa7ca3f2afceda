"""Names of coordinate reference systems, axis order, and one metric frame for all inputs."""

from __future__ import annotations

import gzip
import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Geod, Transformer

from svprep.cache.reader import open_cache
from svprep.errors import EnvironmentProblem, InputError
from svprep.ingest.crs_names import crs_of
from svprep.ingest.georeference import (
    in_one_frame,
    is_north_first,
    needs_swap,
    normalised_crs,
    proportional,
)
from svprep.ingest.parsed import ParsedFile
from svprep.ingest.triangulation import triangulate
from svprep.light import parse_lights
from svprep.model import F64, Place
from svprep.pipeline import BuildConfig, build, prepare
from svprep.sun import Site, meridian_convergence_deg, place_of
from tests.property.meshes import source_mesh
from tests.unit.placed_boxes import CORNERS, box, parsed

ROOT = Path(__file__).resolve().parents[2]
CITIES = ROOT.parent / "shared" / "data" / "cities"
FILES = [Path("a.gml"), Path("b.gml"), Path("c.gml")]


def framed(*files: ParsedFile) -> tuple[list[ParsedFile], Place]:
    return in_one_frame(files, FILES[: len(files)])


def refusal(*files: ParsedFile) -> str:
    with pytest.raises(InputError) as error:
        framed(*files)
    text = str(error.value)
    assert "\n" not in text
    return text


# --- names


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("urn:ogc:def:crs:EPSG::28992", "EPSG:28992"),
        ("urn:ogc:def:crs:EPSG:6.9:28992", "EPSG:28992"),
        ("urn:ogc:def:crs:EPSG:28992", "EPSG:28992"),
        ("urn:x-ogc:def:crs:EPSG:6.9:4326", "EPSG:4326"),
        ("urn:EPSG:geographicCRS:4326", "EPSG:4326"),
        ("http://www.opengis.net/def/crs/EPSG/0/28992", "EPSG:28992"),
        ("https://www.opengis.net/def/crs/EPSG/0/7415", "EPSG:7415"),
        ("http://www.opengis.net/gml/srs/epsg.xml#28992", "EPSG:28992"),
        ("https://epsg.io/28992", "EPSG:28992"),
        ("http://spatialreference.org/ref/epsg/28992/", "EPSG:28992"),
        ("urn:ogc:def:crs,crs:EPSG::28992,crs:EPSG::5109", "EPSG:28992+5109"),
        ("urn:ogc:def:crs,crs:EPSG:6.12:3068,crs:EPSG:6.12:5783", "EPSG:3068+5783"),
        (
            "https://www.opengis.net/def/crs-compound?1=http://www.opengis.net/def/crs/EPSG/0/"
            "28992&2=http://www.opengis.net/def/crs/EPSG/0/5709",
            "EPSG:28992+5709",
        ),
        ("EPSG:7415", "EPSG:7415"),
        (" epsg:28992\n", "EPSG:28992"),
        ("28992", "EPSG:28992"),
        ("EPSG::28992", "EPSG:28992"),
        ("EPSG:28992+5709", "EPSG:28992+5709"),
        ("EPSG:28992+EPSG:5709", "EPSG:28992+5709"),
        ("urn:adv:crs:ETRS89_UTM32", "EPSG:25832"),
        ("urn:adv:crs:ETRS89_UTM33*DE_DHHN2016_NH", "EPSG:25833+7837"),
        ("urn:adv:crs:DE_DHDN_3GK4*DE_DHN92_NH", "EPSG:31468+5783"),
        ("urn:adv:crs:DE_DHDN_3GK2_NW101*DE_DHHN92_NH", "EPSG:31466+5783"),
        ("urn:adv:crs:DE_DHDN_3GK3*DE_OF_A_CITY", "EPSG:31467"),
        ("urn:adv:crs:DE_RD-83_3GK5", "EPSG:3399"),
        ("urn:adv:crs:ETRS89_Lat-Lon", "EPSG:4258"),
        ("urn:ogc:def:crs:OGC:1.3:CRS84", "OGC:CRS84"),
        ("http://www.opengis.net/def/crs/OGC/1.3/CRS84", "OGC:CRS84"),
        ("CRS84", "OGC:CRS84"),
        ("", ""),
    ],
)
def test_names_that_files_write(text: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert normalised_crs(normalised_crs(text)) == name
    monkeypatch.setitem(sys.modules, "pyproj", None)
    assert normalised_crs(text) == name


@pytest.mark.parametrize(
    "text",
    [
        "the city's own",
        "urn:adv:crs:DE_SOMETHING",
        "urn:ogc:def:crs,",
        "EPSG:",
        "12",
        'PROJCRS["x"]',
        "https://www.opengis.net/def/crs-compound?1=" * 900,
        "9" * 1_000_000,
    ],
)
def test_unknown_names_stay_as_they_are(text: str) -> None:
    assert normalised_crs(text) == text
    assert crs_of(text) is None


def test_german_names_are_of_the_systems_that_they_name() -> None:
    for text, part in [
        ("ETRS89_UTM31", "UTM zone 31N"),
        ("DE_DHDN_3GK2", "DHDN / 3-degree Gauss-Kruger zone 2"),
        ("DE_DHDN_3GK5", "DHDN / 3-degree Gauss-Kruger zone 5"),
        ("DE_RD/83_3GK4", "RD/83 / 3-degree Gauss-Kruger zone 4"),
        ("DE_PD/83_3GK3", "PD/83 / 3-degree Gauss-Kruger zone 3"),
        ("DE_42/83_3GK5", "Pulkovo 1942(83) / 3-degree Gauss-Kruger zone 5"),
        ("ETRS89_UTM32*DE_DHHN92_NH", "DHHN92 height"),
        ("ETRS89_UTM32*DE_DHHN2016_NH", "DHHN2016 height"),
        ("ETRS89_UTM32*DE_DHHN85_NOH", "DHHN85 height"),
        ("ETRS89_UTM32*DE_DHHN12_NOH", "DHHN12 height"),
        ("ETRS89_UTM32*DE_SNN76_NH", "SNN76 height"),
        ("ETRS89_Lat-Lon-h", "ETRS89"),
    ]:
        crs = crs_of("urn:adv:crs:" + text)
        assert crs is not None
        assert part in crs.name


def test_no_name_is_guessed_and_no_file_is_opened() -> None:
    assert crs_of("WGS 84 / UTM zone 33N") == CRS.from_epsg(32633)
    assert crs_of("UTM zone 33N") is None
    assert crs_of("EPSG:28992+5109") == CRS.from_epsg(28992)
    assert crs_of("+proj=tmerc +lat_0=52 +lon_0=4") is not None
    assert crs_of("+proj=longlat +nadgrids=/dev/zero") is None
    assert crs_of("+init=/etc/hostname:1") is None
    assert crs_of("EPSG:28992\0") is None


# --- the order of axes


@pytest.mark.parametrize(
    ("text", "is_first"),
    [
        ("urn:ogc:def:crs:EPSG::28992", False),
        ("urn:ogc:def:crs:EPSG::31468", True),
        ("EPSG:31468", False),
        ("http://www.opengis.net/gml/srs/epsg.xml#31468", False),
        ("urn:adv:crs:DE_DHDN_3GK4*DE_DHHN92_NH", False),
        ("urn:adv:crs:ETRS89_Lat-Lon", True),
        ("http://www.opengis.net/def/crs/EPSG/0/6697", True),
        ("EPSG:6697", False),
        ("urn:ogc:def:crs:EPSG::4326", True),
        ("urn:ogc:def:crs:OGC:1.3:CRS84", False),
        ("urn:ogc:def:crs,crs:EPSG::31468,crs:EPSG::5783", True),
        ("urn:ogc:def:crs:EPSG::25832", False),
        ("urn:ogc:def:crs:EPSG::32661", True),
        ("urn:ogc:def:crs:EPSG::4978", False),
        ("urn:ogc:def:crs:EPSG::1234", False),
        ("", False),
    ],
)
def test_the_order_that_a_name_promises(text: str, is_first: bool) -> None:
    assert is_north_first(text) == is_first


def test_the_order_is_that_of_pyproj() -> None:
    # `always_xy` swaps the first two numbers, or does not.
    for code in (28992, 31468, 2193, 3006, 2443, 4326, 5513, 5514, 2053, 32661, 32761, 3031, 3044):
        crs = CRS.from_epsg(code)
        plain = Transformer.from_crs(crs, crs.geodetic_crs)
        as_xy = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)
        at = (48.0, 12.0) if crs.is_geographic else (4_500_000.0, 5_400_000.0)
        is_swapped = bool(np.allclose(plain.transform(*at)[:2], as_xy.transform(*at[::-1])[::-1]))
        assert is_north_first(f"urn:ogc:def:crs:EPSG::{code}") == is_swapped, code


def test_positions_decide_where_only_one_order_is_in_the_area() -> None:
    munich = [[4424648.79, 5482614.69, 310.0], [4424852.33, 5482813.83, 330.0]]
    swapped = [[y, x, z] for x, y, z in munich]
    for form in ("EPSG:31468", "urn:ogc:def:crs:EPSG::31468", "urn:adv:crs:DE_DHDN_3GK4"):
        assert not needs_swap(form, munich)
        assert needs_swap(form, swapped)
    tokyo = [[35.60, 139.70, 0.0], [35.61, 139.71, 90.0]]
    for form in ("http://www.opengis.net/def/crs/EPSG/0/6697", "EPSG:6697"):
        assert needs_swap(form, tokyo)
        assert not needs_swap(form, [[139.70, 35.60, 0.0], [139.71, 35.61, 90.0]])
    # Both orders are somewhere on Earth, so the name decides.
    vienna = [[48.2, 16.4], [48.3, 16.5]]
    assert needs_swap("urn:ogc:def:crs:EPSG::4326", vienna)
    assert not needs_swap("EPSG:4326", vienna)
    # So it does where neither order fits: a model that is not in the CRS at all.
    assert not needs_swap("EPSG:31468", [[0.0, 0.0], [10.0, 10.0]])
    assert needs_swap("urn:ogc:def:crs:EPSG::31468", [[0.0, 0.0], [10.0, 10.0]])
    assert not needs_swap("urn:ogc:def:crs:EPSG::4978", [[4e6, 1e6, 5e6], [4e6, 1e6, 5e6]])


@pytest.mark.parametrize(
    "name", ["munich_lod2.gml", "denhaag_01.gml.gz", "ingolstadt_lod3/4018133.xml.gz"]
)
def test_real_files_write_the_easting_first(name: str) -> None:
    path = CITIES / name
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    raw = path.read_bytes()
    text = (gzip.decompress(raw) if name.endswith(".gz") else raw).decode("utf-8", "replace")
    crs = re.search(r'srsName="([^"]+)"', text)
    corners = [re.search(rf"{corner}Corner[^>]*>([^<]+)<", text) for corner in ("lower", "upper")]
    assert crs is not None
    bounds = [[float(x) for x in corner[1].split()] for corner in corners if corner is not None]
    assert not needs_swap(crs[1], bounds)
    assert needs_swap(crs[1], [[y, x, z] for x, y, z in bounds])


def test_without_pyproj_an_order_that_is_not_known_is_not_guessed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    assert needs_swap("http://www.opengis.net/def/crs/EPSG/0/6697", [[35.0, 139.0], [36.0, 140.0]])
    assert not needs_swap("urn:ogc:def:crs:EPSG::28992", [[8e4, 4e5], [9e4, 5e5]])
    assert not needs_swap("EPSG:31468", [[4e6, 5e6], [4e6, 5e6]])
    with pytest.raises(EnvironmentProblem, match=r"svprep\[formats\]"):
        needs_swap("urn:ogc:def:crs:EPSG::31468", [[4e6, 5e6], [4e6, 5e6]])


# --- frames that files state


@pytest.mark.parametrize(
    ("stated", "x", "y", "name"),
    [
        ("EPSG:28992", 85_000.0, 447_000.0, "EPSG:28992"),
        ("https://www.opengis.net/def/crs/EPSG/0/7415", 85_000.0, 447_000.0, "EPSG:7415"),
        ("urn:ogc:def:crs,crs:EPSG::28992,crs:EPSG::5109", 85_000.0, 447_000.0, "EPSG:28992"),
        ("urn:adv:crs:DE_DHDN_3GK4*DE_DHN92_NH", 4_424_648.0, 5_482_614.0, "EPSG:31468+5783"),
        ("urn:adv:crs:ETRS89_UTM32*DE_DHHN2016_NH", 700_000.0, 5.3e6, "EPSG:25832+7837"),
        ("EPSG:2154", 652_000.0, 6_862_000.0, "EPSG:2154"),
        ("EPSG:5514", -740_000.0, -1_040_000.0, "EPSG:5514"),
        ("EPSG:32734", 300_000.0, 6_200_000.0, "EPSG:32734"),
        ("WGS 84 / UTM zone 33N", 412_345.0, 5_340_000.0, "EPSG:32633"),
    ],
)
def test_a_metric_plane_is_the_frame_and_positions_stay(
    stated: str, x: float, y: float, name: str
) -> None:
    file = box(stated, x, y)
    (out,), place = framed(file)
    assert out is file
    assert place.crs == name
    # What the cache's own site would compute without the stored numbers.
    site = Site(name, x + 5.0, y + 5.0)
    assert (place.latitude_deg, place.longitude_deg) == place_of(site)
    assert place.convergence_deg == meridian_convergence_deg(site)


def test_a_plane_of_its_own_definition_is_named_by_it() -> None:
    wkt = CRS.from_proj4("+proj=tmerc +lat_0=52 +lon_0=4 +k=1 +ellps=GRS80 +units=m").to_wkt()
    (out,), place = framed(box(wkt, 5.0, 5.0))
    assert out.notes == ()
    assert CRS.from_user_input(place.crs) == CRS.from_wkt(wkt)
    assert place.latitude_deg == pytest.approx(52.0, abs=0.01)


def test_a_local_frame_is_a_frame_again() -> None:
    # What is exported from a cache names the frame by its WKT, and is built from once more.
    (out,), place = framed(box("EPSG:6697", 139.7671, 35.6812, 1e-4))
    (again,), same = framed(replace(out, crs=place.crs, notes=()))
    assert again.positions is out.positions
    assert again.notes == ()
    assert same == place
    far = out.positions + (3e4, 0.0, 0.0)
    (beside,), _ = framed(replace(out, crs=place.crs, positions=far, notes=()))
    assert beside.notes == ()


def test_heights_in_feet_on_a_metric_plane_become_metres() -> None:
    file = box("EPSG:26918+6360", 583_000.0, 4_507_000.0, height=30.0)
    (out,), place = framed(file)
    assert place.crs == "EPSG:26918"
    assert np.array_equal(out.positions[:, :2], file.positions[:, :2])
    assert np.ptp(out.positions[:, 2]) == pytest.approx(30.0 * 1200 / 3937, rel=1e-12)
    assert "heights are turned into metres" in out.notes[0]
    assert np.ptp(file.positions[:, 2]) == 30.0


def test_depths_are_turned_around() -> None:
    (out,), _ = framed(box("EPSG:32639+5706", 400_000.0, 4_500_000.0, z=3.0))
    assert out.positions[:, 2].tolist() == [-3.0] * 4 + [-11.0] * 4


# --- local frames

PLACES = [
    # CRS, longitude, latitude, height in metres of a unit of height
    ("EPSG:6697", 139.7671, 35.6812, 1.0),
    ("EPSG:4326", -70.6693, -33.4489, 1.0),
    ("EPSG:4807", 2.3522, 48.8566, 1.0),
    ("EPSG:2263", -74.0060, 40.7128, 1200 / 3937),
    ("EPSG:2263+6360", -74.0060, 40.7128, 1200 / 3937),
    ("EPSG:4978", 5.6604, 51.9701, 1.0),
    ("EPSG:4936", 11.5755, 48.1374, 1.0),
    ("EPSG:3857", 16.3738, 48.2082, 1.0),
    ("EPSG:3857", -78.4678, -0.1807, 1.0),
    ("EPSG:5513", 14.4378, 50.0755, 1.0),
    ("EPSG:2053", 28.9, -29.8, 1.0),
    ("EPSG:3031", 166.67, -77.85, 1.0),
    ("EPSG:4326", 179.99999, -16.5, 1.0),
]
SIZE_M = 100.0


def ground_box(crs_name: str, longitude: float, latitude: float, unit_m: float) -> ParsedFile:
    """Return a box of 100 by 100 m along the geodesics from a corner, in a CRS."""
    crs = CRS.from_user_input(crs_name)
    geod = crs.get_geod() or Geod(ellps="WGS84")
    azimuth = np.degrees(np.arctan2(CORNERS[:, 0], CORNERS[:, 1]))
    length = SIZE_M * np.hypot(CORNERS[:, 0], CORNERS[:, 1])
    flat = crs if crs.is_geocentric else crs.to_2d()
    flat = flat.sub_crs_list[0] if flat.is_compound else flat
    # Degrees from Greenwich on the CRS's own datum, so that no change of datum is tested here.
    own = flat.geodetic_crs
    start = (
        latitude,
        longitude
        - math.degrees(own.prime_meridian.longitude * math.pi / 180.0)
        * (own.prime_meridian.unit_conversion_factor / (math.pi / 180.0)),
    )
    lon, lat, _ = geod.fwd([start[1]] * 8, [start[0]] * 8, azimuth, length)
    lon, lat = np.asarray(lon), np.asarray(lat)
    height = CORNERS[:, 2] * 30.0
    if flat.is_geocentric:
        upper = CRS.from_epsg({4978: 4979, 4936: 4937}[own.to_epsg()])
        xyz = Transformer.from_crs(upper, flat, always_xy=True).transform(lon, lat, height)
        return parsed(crs_name, np.column_stack(xyz))
    if flat.is_geographic:
        to_unit = math.radians(1.0) / flat.axis_info[0].unit_conversion_factor
        return parsed(crs_name, np.column_stack([lon * to_unit, lat * to_unit, height]))
    base = own.to_2d()
    x, y = Transformer.from_crs(base, flat, always_xy=True).transform(lon, lat)
    return parsed(crs_name, np.column_stack([x, y, height / unit_m]))


@pytest.mark.parametrize(("crs", "longitude", "latitude", "unit_m"), PLACES)
def test_what_is_no_metric_plane_comes_to_a_local_frame(
    crs: str, longitude: float, latitude: float, unit_m: float
) -> None:
    file = ground_box(crs, longitude, latitude, unit_m)
    before = file.positions.copy()
    (out,), place = framed(file)
    assert np.array_equal(file.positions, before)
    assert out.crs == crs
    frame = CRS.from_user_input(place.crs)
    assert frame.is_projected
    assert frame.name.startswith("local frame at ")
    # Lengths are those of geodesics, to a micrometre.
    grown = out.positions - out.positions[0]
    lengths = np.hypot(grown[1:4, 0], grown[1:4, 1])
    assert lengths == pytest.approx(SIZE_M * np.hypot(*CORNERS[1:4, :2].T), abs=1e-6)
    assert grown[:, 2] == pytest.approx(30.0 * CORNERS[:, 2], abs=1e-8)
    # x leads east and y north; the middle is rounded, and meridians converge to it.
    assert np.abs(grown[:3, :2] - SIZE_M * CORNERS[:3, :2]).max() < 4e-3
    # Walls stay vertical, bit for bit but for positions about the Earth's centre.
    slant = np.abs(out.positions[:4, :2] - out.positions[4:, :2]).max()
    assert slant < 1e-8
    assert slant == 0.0 or crs in ("EPSG:4978", "EPSG:4936")
    assert place.latitude_deg == pytest.approx(latitude, abs=0.01)
    assert abs(math.remainder((place.longitude_deg or 0.0) - longitude, 360.0)) < 0.01
    assert abs(place.convergence_deg or 0.0) < 0.002
    assert f"positions converted from {crs} (" in out.notes[0]
    assert "lengths off by at most" in out.notes[0]


def back(place: Place, crs_name: str, positions: F64) -> F64:
    """Return positions of the frame in a CRS without heights, by another road: via WKT."""
    crs = CRS.from_user_input(crs_name).to_2d()
    crs = crs.sub_crs_list[0] if crs.is_compound else crs
    transformer = Transformer.from_crs(CRS.from_wkt(place.crs), crs, always_xy=True)
    return np.column_stack(transformer.transform(*positions[:, :2].T))


@pytest.mark.parametrize(
    ("crs", "longitude", "latitude", "unit_m"),
    [p for p in PLACES if p[0] not in ("EPSG:4978", "EPSG:4936")],
)
def test_a_round_trip_is_below_a_micrometre(
    crs: str, longitude: float, latitude: float, unit_m: float
) -> None:
    file = ground_box(crs, longitude, latitude, unit_m)
    (out,), place = framed(file)
    again = back(place, crs, out.positions)
    per_m = 1e-5 if CRS.from_user_input(crs).is_geographic else 1.0
    gap = again - file.positions[:, :2]
    turn = 360.0 if per_m < 1.0 else np.inf
    gap[:, 0] = [math.remainder(g, turn) for g in gap[:, 0]]
    assert np.abs(gap).max() < 1e-6 * per_m


def test_the_scale_of_a_map_decides() -> None:
    # Web Mercator shows Vienna half as large again, and a shadow there too.
    (out,), _ = framed(box("EPSG:3857", 1_822_000.0, 6_141_000.0, 150.0))
    assert np.ptp(out.positions[:, 0]) == pytest.approx(100.0, abs=1.0)
    assert "(its metre is 0.6677 m on the ground)" in out.notes[0]
    # At the equator it is 0.7 % too narrow one way only, and still no plane to build on.
    assert framed(box("EPSG:3857", -8_735_000.0, -20_000.0))[1].crs.startswith("PROJCRS")
    # Europe's equal-area map is true in its middle, and not in Lisbon.
    assert framed(box("EPSG:3035", 4_321_000.0, 3_210_000.0))[1].crs == "EPSG:3035"
    assert framed(box("EPSG:3035", 2_660_000.0, 1_950_000.0))[1].crs.startswith("PROJCRS")


def test_equal_data_have_equal_frames() -> None:
    a, b = (framed(box("EPSG:6697", 139.7671, 35.6812, 1e-4)) for _ in range(2))
    assert a[1] == b[1]
    assert a[0][0].positions.tobytes() == b[0][0].positions.tobytes()
    # The middle is rounded, so what is added close by leaves it where it is.
    more = framed(
        box("EPSG:6697", 139.7671, 35.6812, 1e-4), box("EPSG:6697", 139.7672, 35.6813, 1e-4)
    )
    assert more[1].crs == a[1].crs
    assert more[0][0].positions.tobytes() == a[0][0].positions.tobytes()
    # Vertices that no face uses have no say.
    file = box("EPSG:6697", 139.7671, 35.6812, 1e-4)
    stray = replace(file, positions=np.vstack([file.positions, [[10.0, 10.0, 0.0]]]))
    assert framed(stray)[1] == a[1]


def test_roofs_in_degrees_are_triangulated_as_in_metres() -> None:
    # Nearly flat, with a centimetre of noise: in degrees beside metres it would stand on edge.
    rng = np.random.default_rng(0)
    corners, start = np.arange(12, dtype=np.uint32), np.array([0, 12])
    n_wrong = 0
    for _ in range(50):
        angle, radius = np.sort(rng.uniform(0.0, 2.0 * np.pi, 12)), rng.uniform(3.0, 12.0, 12)
        noise = rng.normal(0.0, 0.01, 12)
        metres = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), noise])
        degrees = metres * (1 / 90_500, 1 / 111_000, 1.0) + (139.7, 35.6, 0.0)
        area = surface(metres, triangulate(metres, corners, start)[0])
        assert proportional(metres, "EPSG:28992") is metres
        good = triangulate(proportional(degrees, "EPSG:6697"), corners, start)[0]
        assert surface(metres, good) == pytest.approx(area, rel=1e-4)
        n_wrong += surface(metres, triangulate(degrees, corners, start)[0]) > 1.01 * area
    assert n_wrong > 25  # what `proportional` is for


def surface(points: F64, faces: np.ndarray) -> float:
    a, b, c = points[faces].transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2


def test_neighbouring_tiles_meet() -> None:
    west, east = box("EPSG:6697", 139.76, 35.68, 1e-3), box("EPSG:6697", 139.761, 35.68, 1e-3)
    east.positions[[0, 2, 4, 6], 0] = west.positions[[1, 3, 5, 7], 0]
    (a, b), _ = framed(west, east)
    assert a.positions[[1, 3, 5, 7]].tobytes() == b.positions[[0, 2, 4, 6]].tobytes()


# --- several inputs


def test_other_files_come_to_the_frame_of_the_first() -> None:
    first = box("EPSG:25832", 750_000.0, 5_300_000.0)
    to_33 = Transformer.from_crs("EPSG:25832", "EPSG:25833", always_xy=True)
    x, y = to_33.transform(*first.positions[:, :2].T)
    second = parsed("EPSG:25833", np.column_stack([x, y, first.positions[:, 2]]))
    (a, b), place = framed(first, second)
    assert a is first
    assert place.crs == "EPSG:25832"
    assert np.abs(b.positions - first.positions).max() < 1e-6
    assert b.notes == ("positions converted from EPSG:25833 to EPSG:25832; heights kept",)


def test_another_datum_is_told_with_its_accuracy() -> None:
    first = box("EPSG:25832", 700_000.0, 5_300_000.0)
    (_, b), _ = framed(first, box("EPSG:31468", 4_480_000.0, 5_300_000.0))
    assert re.search(r"the change of datum is .*DHDN to ETRS89.*, good to \d+ m", b.notes[0])
    west, north = b.positions[0, :2]
    expected = Transformer.from_crs("EPSG:31468", "EPSG:25832", always_xy=True).transform(
        4_480_000.0, 5_300_000.0
    )
    assert math.hypot(west - expected[0], north - expected[1]) < 5.0


def test_tiles_about_the_centre_of_the_earth_beside_a_national_grid() -> None:
    to_earth = Transformer.from_crs("EPSG:28992", "EPSG:4326", always_xy=True)
    lon, lat = to_earth.transform(174_000.0, 441_000.0)
    centred = ground_box("EPSG:4978", lon, lat, 1.0)
    (a, b), place = framed(box("EPSG:7415", 174_000.0, 441_000.0), centred)
    assert place.crs == "EPSG:7415"
    assert np.abs(b.positions[0] - a.positions[0]).max() < 1.0
    assert b.notes[0] == (
        "warning: heights are not brought together: these count from the ellipsoid of WGS 84, "
        "those of a.gml from NAP height, which may differ by tens of metres"
    )
    assert "heights above the ellipsoid" in b.notes[1]
    (a, b), place = framed(centred, box("EPSG:7415", 174_000.0, 441_000.0))
    assert place.crs.startswith("PROJCRS")
    assert np.abs(b.positions[0, :2] - a.positions[0, :2]).max() < 1.0


def test_the_same_plane_needs_nothing() -> None:
    files = [
        box("EPSG:28992", 85_000.0, 447_000.0),
        box("EPSG:7415", 85_100.0, 447_000.0),
        box("urn:ogc:def:crs:EPSG::28992", 85_200.0, 447_000.0),
    ]
    out, place = framed(*files)
    assert all(a is b for a, b in zip(out, files, strict=True))
    assert place.crs == "EPSG:28992"
    # Northings first or not: positions have x first in any case.
    pair = [box("EPSG:25832", 7e5, 5.3e6), box("EPSG:3044", 7e5 + 50.0, 5.3e6)]
    assert framed(*pair)[0][1] is pair[1]


def test_heights_of_two_levels_are_noted_and_kept() -> None:
    files = [box("EPSG:25832+5783", 7e5, 5.3e6), box("EPSG:25832+7837", 7e5, 5.3e6)]
    (a, b), place = framed(*files)
    assert a is files[0]
    assert place.crs == "EPSG:25832+5783"
    assert b.positions is files[1].positions
    assert b.notes == (
        "warning: heights are not brought together: these count from DHHN2016 height, those of "
        "a.gml from DHHN92 height",
    )


def test_a_file_without_a_crs_beside_one_with() -> None:
    plain, stated = box("", 85_050.0, 447_000.0), box("EPSG:28992", 85_000.0, 447_000.0)
    (a, b), place = framed(plain, stated)
    assert a.positions is plain.positions
    assert a.notes == ("no CRS is stated; taken to be in EPSG:28992, as b.gml is",)
    assert b is stated
    assert place.crs == "EPSG:28992"
    text = refusal(box("", 0.0, 0.0), box("EPSG:6697", 139.7, 35.7, 1e-4))
    assert text.startswith("a.gml states no CRS, so it has no place beside b.gml")


def test_files_without_any_crs_stay_as_they_are() -> None:
    files = [box("", 0.0, 0.0), box("  ", 10.0, 10.0)]
    out, place = framed(*files)
    assert all(a is b for a, b in zip(out, files, strict=True))
    assert place == Place()


# --- what cannot be


def test_a_crs_that_nobody_knows_is_noted() -> None:
    for stated, says in [
        ("EPSG:1234", 'the CRS "EPSG:1234" is none that pyproj knows'),
        ("EPSG:5703", "does not say where on Earth the model lies"),
        ("EPSG:28992", 'the CRS "EPSG:28992" does not reach these positions, which are near 0, 0'),
    ]:
        file = box(stated, 0.0, 0.0)
        (out,), place = framed(file)
        assert out.positions is file.positions
        assert says in out.notes[0]
        assert "true north is unknown" in out.notes[0]
        assert place == Place()
    same = [box("EPSG:1234", 0.0, 0.0), box("urn:ogc:def:crs:EPSG::1234", 9.0, 0.0), box("", 1, 1)]
    assert framed(*same)[1] == Place()
    assert 'beside a.gml, in "EPSG:1234"' in refusal(same[0], box("EPSG:1235", 0.0, 0.0))
    text = refusal(box("EPSG:28992", 85_000.0, 447_000.0), same[0])
    assert text.startswith('b.gml: its CRS "EPSG:1234" is none that pyproj knows')


@pytest.mark.parametrize(
    ("file", "says"),
    [
        (box("EPSG:4326", 85_000.0, 447_000.0), "counts in degrees, but positions reach (85010"),
        (box("EPSG:28992", 4.3, 52.1, 1e-3), "(4.3005, 52.1005) look like degrees"),
        (box("EPSG:28992", 1e12, 447_000.0), "does not reach its positions, such as (1e+12"),
        (box("EPSG:25832", 5_334_000.0, 690_000.0), "with its axes in their order"),
        (box("EPSG:28992", 4_424_648.0, 5_482_614.0), "does not reach"),
        (box("EPSG:4978", 1_000.0, 1_000.0), "does not reach its positions, such as (1005, 1005"),
        (box("EPSG:6697", 5.0, 52.0, 1e-4), "does not reach"),
        (box("IAU_2015:30100", 70.0, 50.0, 1e-3), "does not reach"),
        (box("EPSG:28992", 1e300, -1e300), "does not reach"),
    ],
)
def test_positions_out_of_reach_are_refused(file: ParsedFile, says: str) -> None:
    text = refusal(file)
    assert text.startswith(f'a.gml: the CRS "{file.crs}" ')
    assert says in text


def test_a_vertex_out_of_reach_is_named() -> None:
    file = box("EPSG:3857", 1_822_000.0, 6_141_000.0)
    far = np.vstack([file.positions, [[0.0, 1e12, 0.0]]])
    assert np.isfinite(framed(replace(file, positions=far))[0][0].positions).all()
    assert "EPSG:1" not in refusal(replace(file, positions=far, faces=file.faces + 1))


def test_a_model_beside_the_area_of_its_crs_is_noted() -> None:
    (out,), place = framed(box("EPSG:28992", 500_000.0, 447_000.0))
    assert "degrees outside of the area that the CRS" in out.notes[0]
    assert place.latitude_deg is not None


# --- without pyproj


def test_without_pyproj(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    assert proportional(CORNERS, "EPSG:4326") is CORNERS
    files = [box("urn:ogc:def:crs:EPSG::28992", 85_000.0, 447_000.0), box("", 85_000.0, 447_000.0)]
    out, place = framed(*files)
    assert place == Place("EPSG:28992")
    assert [len(f.notes) for f in out] == [1, 0]
    assert "true north is unknown" in out[0].notes[0]
    for bad in (
        [box("EPSG:6697", 139.7, 35.7, 1e-4)],
        [box("EPSG:4978", 4e6, 1e6)],
        [box("the city's own", 16.3, 48.2, 1e-4)],
        [files[0], box("EPSG:7415", 85_000.0, 447_000.0)],
    ):
        with pytest.raises(EnvironmentProblem, match=r"svprep\[formats\]"):
            framed(*bad)
    assert framed(box("", 1.0, 1.0))[1] == Place()


def test_a_build_without_a_crs_pays_nothing(tmp_path: Path) -> None:
    (tmp_path / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    code = (
        "import sys; from svprep.ingest import read; read(['t.obj']); "
        "print(*[m for m in ('pyproj', 'svprep.ingest.georeference') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env={"PYTHONPATH": str(ROOT), "PATH": ""},
    )
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


# --- the grid of a large extent


@pytest.mark.parametrize(
    ("points", "says"),
    [
        ([[0.0, 0.0, 0.0], [3.2e4, 0.0, 0.0], [0.0, 9.0, 0.0]], ""),
        (
            [[0.0, 0.0, 0.0], [4e4, 0.0, 0.0], [0.0, 9.0, 0.0]],
            "the extent of 40 km allows a grid step of 2 mm; build parts of it apart for a finer "
            "one",
        ),
        (
            [[1e13, 0.0, 0.0], [1e13 + 9.0, 0.0, 0.0], [1e13, 9.0, 0.0]],
            "that far from the origin the grid step is 3.9 mm",
        ),
    ],
)
def test_a_coarse_grid_is_noted(points: list[list[float]], says: str) -> None:
    source = source_mesh(np.array(points), np.array([[0, 1, 2]]))
    prepared = prepare(source, BuildConfig())
    assert prepared.notes == ((says,) if says else ())


# --- lights


CITY = {
    "type": "CityJSON",
    "version": "1.1",
    "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/28992"},
    "transform": {"scale": [1.0, 1.0, 1.0], "translate": [85_000.0, 447_000.0, 0.0]},
    "vertices": [[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]],
    "CityObjects": {
        "roof": {
            "type": "Building",
            "geometry": [{"type": "MultiSurface", "lod": "2", "boundaries": [[[0, 1, 2, 3]]]}],
        }
    },
}


def test_a_sun_without_a_place_takes_that_of_the_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, cache_path = tmp_path / "roof.city.json", tmp_path / "roof.svp.h5"
    path.write_text(json.dumps(CITY))
    moment, arc = "2026-06-21T12:00+02:00", "2026-06-21/11:00/13:00/1h[+02:00]"
    specs = [f"sun:{moment}", f"sun:51.9,4.4,{moment}", f"sun:{arc}", "dir:135,40"]
    build([path], cache_path, lights=specs)
    # What is stored is enough from now on.
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with open_cache(cache_path) as cache:
        site, lights = cache.site, parse_lights(specs, cache.site)
        assert len(cache.clamp) == 4  # the arc's noon is the moment
        assert set(map(bytes, cache.clamp.lights)) == {
            light.in_cache_frame(cache.grid).tobytes() for light in lights
        }
    latitude, longitude = place_of(site)
    assert (latitude, longitude) == pytest.approx((52.007, 4.3677), abs=0.001)
    assert lights[0].sun is not None
    assert lights[0].sun.convergence_deg == meridian_convergence_deg(site)
    assert meridian_convergence_deg(site) == pytest.approx(-0.8, abs=0.05)
    monkeypatch.undo()
    plain = Site(site.crs, site.x_m, site.y_m)
    assert (latitude, longitude) == place_of(plain)
    assert meridian_convergence_deg(site) == pytest.approx(
        meridian_convergence_deg(plain), abs=1e-9
    )


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("sun:2026-06-31T12:00Z", "there is no date 2026-06-31"),
        ("sun:2026-06-21/06:00/05:00/1h[UTC]", "is not after the begin"),
        ("sun:2026-06-21/00:00/24:00/0.5s[UTC]", "172,800 steps"),
        ("sun:52,4,2026-06-21T00:00Z", "degrees below the horizon"),
        ("dir:135", "ALTITUDE is missing"),
    ],
)
def test_a_slip_in_a_light_is_told_before_any_work(spec: str, says: str) -> None:
    stages: list[str] = []
    with pytest.raises(InputError, match=says):
        build(["absent.obj"], "absent.svp.h5", on_stage=stages.append, lights=[spec])
    assert stages == []


def test_a_sun_without_a_place_needs_a_crs(tmp_path: Path) -> None:
    path = tmp_path / "t.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="only for a model with a CRS"):
        build([path], tmp_path / "t.svp.h5", lights=["sun:2026-06-21T12:00Z"])
    assert not (tmp_path / "t.svp.h5").exists()
