"""Coordinates from anywhere, in anything that calls itself a CRS."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pyproj import Geod, Transformer

from svprep.errors import InputError
from svprep.ingest.crs_names import crs_of
from svprep.ingest.georeference import in_one_frame, is_north_first, needs_swap, normalised_crs
from svprep.model import Place
from tests.unit.placed_boxes import CORNERS, box, parsed

FILE = [Path("city.gml")]
PIECES = (
    "urn:ogc:def:crs:", "urn:ogc:def:crs,", "urn:x-ogc:def:crs:", "crs:", "urn:adv:crs:",
    "http://www.opengis.net/def/crs/", "https://www.opengis.net/def/crs-compound?", "1=", "&2=",
    "http://www.opengis.net/gml/srs/epsg.xml#", "EPSG", "OGC", "ESRI", "IAU_2015", ":", "::", "/0/",
    "+", "*", ",", "ETRS89_UTM32", "DE_DHDN_3GK4", "DE_DHHN92_NH", "CRS84", "+proj=", "utm",
    "longlat", "+zone=33", "+lat_0=1e9", "+k=0", "+R=1e-9", "+nadgrids=/dev/zero", "+pm=nan",
    'PROJCS["', 'GEOGCS["', '"]', "{", '"type"', "28992", "7415", "4978", "4979", "5703", "1234",
    "104905", "99999999999999999999", "%", "\x00", "\ud800", "ä", " ", "\n",
)  # fmt: skip
TEXTS = st.one_of(
    st.text(max_size=30),
    st.lists(st.sampled_from(PIECES), max_size=7).map("".join),
    st.integers(1000, 33_000).map("EPSG:{}".format),
    st.tuples(st.integers(2000, 33_000), st.integers(5600, 9999)).map(
        lambda codes: f"EPSG:{codes[0]}+{codes[1]}"
    ),
)
NUMBERS = st.one_of(
    st.sampled_from([0.0, 1e-300, 90.0, 180.0, 4e5, 5.3e6, 1e12, 1e300, -1e300]),
    st.floats(-1e7, 1e7),
    st.floats(-180.0, 180.0),
    st.floats(allow_nan=False, allow_infinity=False),
)


@settings(max_examples=50)
@given(text=TEXTS, x=NUMBERS, y=NUMBERS, size=st.sampled_from([0.0, 1e-4, 10.0, 1e6]))
@example(text="EPSG:28992", x=85_000.0, y=447_000.0, size=10.0)
@example(text="EPSG:6697", x=139.7, y=35.7, size=1e-4)
@example(text="EPSG:4979", x=-180.0, y=90.0, size=0.0)
@example(text="+proj=utm+zone=33", x=4e5, y=5.3e6, size=10.0)
@example(text='{"type"', x=0.0, y=0.0, size=10.0)
def test_any_text_is_a_frame_a_note_or_a_clear_refusal(
    text: str, x: float, y: float, size: float
) -> None:
    name = normalised_crs(text)
    assert normalised_crs(name) == name
    bounds = [[x, y, 0.0], [x + size, y + size, 9.0]]
    assert needs_swap(text, bounds) in (False, True)
    assert is_north_first(text) in (False, True)
    file = box(text, x, y, size)
    try:
        (out,), place = in_one_frame([file], FILE)
    except InputError as error:
        says = str(error)
        assert says.startswith("city.gml")
        assert "\n" not in says
        assert len(says) < 900
        return
    assert np.isfinite(out.positions).all()
    if out.positions is not file.positions:
        assert out.notes
    if place != Place():
        crs = crs_of(place.crs)
        assert crs is not None
        assert crs.is_projected or crs.is_compound
        assert place.latitude_deg is not None
        assert abs(place.latitude_deg) <= 90.0
        assert math.isfinite(place.convergence_deg or 0.0)
    else:
        assert out.notes or not text.strip()


@settings(max_examples=12)
@given(
    longitude=st.floats(-180.0, 180.0),
    latitude=st.floats(-85.0, 85.0),
    azimuth=st.floats(0.0, 360.0),
    length=st.floats(1.0, 2_000.0),
    crs=st.sampled_from(["EPSG:4326", "EPSG:3857", "EPSG:4978", "OGC:CRS84", "EPSG:4979"]),
)
def test_a_city_anywhere_keeps_its_lengths_and_directions(
    longitude: float, latitude: float, azimuth: float, length: float, crs: str
) -> None:
    # A box whose corners 0 and 1 (and 4 and 5 above them) are the ends of a geodesic.
    end = Geod(ellps="WGS84").fwd(longitude, latitude, azimuth, length)[:2]
    ground = np.where(CORNERS[:, :1] == 0.0, [[longitude, latitude]], [end])
    points = np.column_stack([ground, 50.0 * CORNERS[:, 2]])
    if crs in ("EPSG:3857", "EPSG:4978"):
        to_crs = Transformer.from_crs("EPSG:4979", crs, always_xy=True)
        points = np.column_stack(to_crs.transform(*points.T))
    (out,), place = in_one_frame([parsed(crs, points)], FILE)
    a, b = out.positions[:2]
    east, north, _ = b - a
    assert abs(math.hypot(east, north) - length) < 1e-6 * length
    # In the frame true north turns by the meridians' convergence alone: sin(latitude) times
    # how far east of the middle, here a kilometre at the most, and half a rounding step.
    off = math.remainder(math.degrees(math.atan2(east, north)) - azimuth, 360.0)
    assert abs(off) < math.degrees(2_100.0 / 6.35e6 * abs(math.tan(math.radians(latitude)))) + 1e-3
    assert np.abs(out.positions[:4, :2] - out.positions[4:, :2]).max() < 1e-7
    assert np.allclose(out.positions[4:, 2] - out.positions[:4, 2], 50.0, atol=1e-7)
    assert abs((place.latitude_deg or 0.0) - latitude) < 0.02
