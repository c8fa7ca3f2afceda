"""What files call coordinate reference systems, and which axis they write first.

    urn:ogc:def:crs:EPSG::28992                            EPSG:28992
    http://www.opengis.net/def/crs/EPSG/0/28992            EPSG:28992
    http://www.opengis.net/gml/srs/epsg.xml#28992          EPSG:28992
    urn:ogc:def:crs,crs:EPSG::28992,crs:EPSG::5709         EPSG:28992+5709
    urn:adv:crs:DE_DHDN_3GK4*DE_DHHN92_NH                  EPSG:31468+5783

Axis order. A URN or URL promises the order that the register gives (GML 3.1.1 on: latitude
before longitude in EPSG:4326). ``EPSG:28992``, ``...#28992`` and ``urn:adv:crs:...`` are
older than that rule: whoever writes them writes the easting or longitude first. Files
break both rules, so the positions have a say: when only one of the two readings lies in the
area for which the CRS is meant, that one is right. Where both do, the name decides.

Text in, text out: only what asks for axes or areas imports pyproj.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Final
from urllib.parse import parse_qsl, urlsplit

import numpy as np
from numpy.typing import ArrayLike

from svprep.errors import require_extra
from svprep.model import F64

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

AREA_SLACK_DEG: Final = 1.0
"""Cities at a border lie a little outside of the area that the register gives."""

_LONGEST: Final = 20_000
"""Characters: a long WKT has 8,000; a text of megabytes is not one."""
# What makes PROJ open a file of the text's choosing.
_OPENS_FILES: Final = ("grids", "init=", "file")
_EARTH_M: Final = 6_371_000.0
_CLOSES_M: Final = 1.0
_FARTHEST_UP_M: Final = 100_000.0

_URN = re.compile(r"(?:urn:(?:x-)?ogc:def:)?crs:([a-z][a-z0-9_]*):(?:[0-9.]*:)?([a-z0-9_]+)", re.I)
_OLD_URN = re.compile(r"urn:EPSG:[a-z]+:([0-9]+)", re.I)
_URL = re.compile(
    r"https?://(?:www\.)?opengis\.net/def/crs/([a-z][a-z0-9_]*)/[0-9.]+/([a-z0-9_]+)/?", re.I
)
_OTHER_URL = re.compile(
    r"https?://(?:www\.)?(?:opengis\.net/gml/srs/epsg\.xml#|epsg\.io/|"
    r"spatialreference\.org/ref/epsg/)([0-9]+)/?",
    re.I,
)
_CODE = re.compile(r"(?:EPSG)?[:\s/]*([0-9]{4,6})(?:\s*\+\s*(?:EPSG:)?([0-9]{4,6}))?", re.I)
_PROMISES_ORDER = re.compile(r"urn:(x-)?ogc:|https?://(www\.)?opengis\.net/def/", re.I)

_ADV = "urn:adv:crs:"
_ADV_PLANE = (
    (re.compile(r"ETRS89_UTM(3[1-4])"), 25800),
    (re.compile(r"DE_DHDN_3GK([2-5])(?:_\w+)?"), 31464),
    (re.compile(r"DE_RD[-/]83_3GK([45])"), 3394),
    (re.compile(r"DE_PD[-/]83_3GK([34])"), 3393),
    (re.compile(r"DE_42[-/]83_3GK([345])"), 2394),
)
_ADV_OTHER = {"ETRS89_Lat-Lon": 4258, "ETRS89_Lat-Lon-h": 4937, "ETRS89_X-Y-Z": 4936}
_ADV_HEIGHT = {
    "DE_DHHN92_NH": 5783,
    "DE_DHN92_NH": 5783,  # as Bavaria writes it
    "DE_DHHN2016_NH": 7837,
    "DE_DHHN85_NOH": 5784,
    "DE_DHHN12_NOH": 7699,
    "DE_SNN76_NH": 5785,
}

_NORTH_FIRST_CODES: Final = frozenset(("4326", "4979", "4258", "4937", "6697", "6668"))
_EAST_FIRST_CODES: Final = frozenset(
    ("28992", "7415", "2154", "3857", "27700", "5514", "2056", "21781", "4978", "4936")
    + tuple(str(code) for zone in range(1, 61) for code in (32600 + zone, 32700 + zone))
    + tuple(str(code) for code in range(25828, 25839))
)
"""Of the commonest CRS, for machines without pyproj."""


def normalised_crs(text: str) -> str:
    """Return the name of a CRS as pyproj understands it; an unknown text as it is.

    Parameters
    ----------
    text : str
        Of ``srsName`` or ``referenceSystem``: a URN, a URL, ``EPSG:28992``, a number, WKT.

    Returns
    -------
    str
        ``"EPSG:28992"``, ``"EPSG:28992+5709"`` (with heights), ``"OGC:CRS84"``, or `text`
        without white space around it. Whether there is such a CRS is another question.
    """
    text = text.strip()
    if len(text) > _LONGEST:
        return text
    parts = _compound_parts(text)
    if parts:
        names = [normalised_crs(part) for part in parts[:2]]
        if len(names) == 2 and all(name.startswith("EPSG:") for name in names):
            return f"{names[0]}+{names[1].removeprefix('EPSG:')}"
        return names[0] or text
    if text[: len(_ADV)].lower() == _ADV:
        return _of_adv(text[len(_ADV) :]) or text
    for pattern in (_URN, _URL):
        if match := pattern.fullmatch(text):
            return _authority_name(match[1], match[2])
    if match := _OLD_URN.fullmatch(text) or _OTHER_URL.fullmatch(text):
        return f"EPSG:{int(match[1])}"
    if match := _CODE.fullmatch(text):
        return f"EPSG:{int(match[1])}" + (f"+{int(match[2])}" if match[2] else "")
    if text.upper() in ("CRS84", "CRS:84", "OGC:CRS84"):
        return "OGC:CRS84"
    return text


def _compound_parts(text: str) -> list[str]:
    """Return the CRS that a URN or URL of a compound one names; none of any other text."""
    lower = text.lower()
    if lower.startswith(("urn:ogc:def:crs,", "urn:x-ogc:def:crs,")):
        return text.split(",")[1:]
    if lower.count("/def/crs-compound?") != 1:
        return []
    try:
        pairs = dict(parse_qsl(urlsplit(text).query, max_num_fields=8))
    except ValueError:
        return []
    return [pairs[key] for key in ("1", "2") if key in pairs]


def _authority_name(authority: str, code: str) -> str:
    if authority.upper() in ("OGC", "CRS") and code.upper() in ("CRS84", "84", "CRS84H"):
        return "OGC:CRS84h" if code.upper().endswith("H") else "OGC:CRS84"
    return f"{authority.upper()}:{code}"


def _of_adv(name: str) -> str:
    """Return the name of a CRS of the German surveys, ``""`` if it is none of the known."""
    plane, _, height = name.partition("*")
    code = _ADV_OTHER.get(plane, 0)
    for pattern, base in _ADV_PLANE:
        if match := pattern.fullmatch(plane):
            code = base + int(match[1])
    if not code:
        return ""
    of_height = _ADV_HEIGHT.get(height.partition("*")[0])
    return f"EPSG:{code}" + (f"+{of_height}" if of_height else "")


def is_north_first(text: str) -> bool:
    """Whether a CRS named like this promises northings or latitudes before the others.

    Parameters
    ----------
    text : str
        As the file states it: the form of the name matters, see the module.

    Raises
    ------
    EnvironmentProblem
        It is a URN or URL of none of the commonest CRS, and pyproj is missing: a wrong
        guess would mirror the city.
    """
    text = text.strip()
    if not _PROMISES_ORDER.match(text):
        return text[: len(_ADV)].lower() == _ADV and "Lat-Lon" in text
    name = normalised_crs(text).partition("+")[0]
    code = name.removeprefix("EPSG:")
    if code in _NORTH_FIRST_CODES or code in _EAST_FIRST_CODES or name.startswith("OGC:"):
        return code in _NORTH_FIRST_CODES
    if not has_pyproj():
        raise require_extra("pyproj", "formats", f'the axis order of the CRS "{text[:80]}"')
    crs = crs_of(text)
    return crs is not None and has_north_axis_first(crs)


def needs_swap(text: str, bounds: ArrayLike) -> bool:
    """Whether the first two numbers of each position are to be swapped, to be x and y.

    Parameters
    ----------
    text : str
        The CRS as the file states it.
    bounds : array_like
        ``(2, 2)`` or ``(2, 3)``: lowest and highest position, numbers as the file orders
        them, before any swap.

    Raises
    ------
    EnvironmentProblem
        As `is_north_first` does.

    Notes
    -----
    The middle is tried in both orders. If one of them alone lies in the area of use of the
    CRS (give or take `AREA_SLACK_DEG`), that one is right; if both or none, `is_north_first`.
    """
    halves = np.asarray(bounds, np.float64)[:, :2] / 2
    first, second = (halves[0] + halves[1]).tolist()
    crs = crs_of(text) if has_pyproj() else None
    if crs is not None:
        fits = _is_in_area(crs, first, second), _is_in_area(crs, second, first)
        if fits[0] != fits[1]:
            return fits[1]
    return is_north_first(text)


def proportional(positions: F64, text: str) -> F64:
    """Return positions with about the same unit along all axes, to triangulate polygons in.

    Degrees beside metres make a roof with a centimetre of noise look like a wall, and it is
    triangulated on edge: across itself.

    Parameters
    ----------
    positions : ndarray
        ``(n, 3) float64``: x, y, z in the units of the CRS.
    text : str
        The CRS as the file states it.

    Returns
    -------
    ndarray
        ``(n, 3) float64``: metres of a sphere for a CRS of longitudes and latitudes, moved
        to the first of them; otherwise, and without pyproj, `positions` themselves.
    """
    crs = crs_of(text) if text.strip() and has_pyproj() else None
    if crs is None or not crs.is_geographic or not len(positions):
        return positions
    unit_rad = horizontal(crs).axis_info[0].unit_conversion_factor
    latitude = float(positions[:, 1].min() / 2 + positions[:, 1].max() / 2) * unit_rad
    unit_m = _EARTH_M * unit_rad
    return (positions - positions[0]) * (unit_m * max(math.cos(latitude), 0.01), unit_m, 1.0)


def has_north_axis_first(crs: CRS) -> bool:
    """Whether the register lists the northing or latitude first.

    The same question that PROJ asks before it puts x first, and the same answer.
    """
    axes = horizontal(crs).axis_info
    if len(axes) < 2:
        return False
    directions = axes[0].direction, axes[1].direction
    names = axes[0].name.lower(), axes[1].name.lower()
    is_polar = directions in (("north", "north"), ("south", "south"))
    return directions == ("north", "east") or (
        is_polar and names[0].startswith("northing") and names[1].startswith("easting")
    )


@lru_cache(maxsize=64)
def crs_of(text: str) -> CRS | None:
    """Return the CRS that a file names, or None if pyproj knows none of this name.

    A compound one whose heights are unknown is its horizontal part. Names like
    ``"WGS 84 / UTM zone 33N"`` are taken literally: PROJ would guess. No CRS is taken that
    would make PROJ read a file.

    Raises
    ------
    ImportError
        pyproj is missing.
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError
    from pyproj.network import set_network_enabled  # type: ignore[attr-defined]

    set_network_enabled(False)
    name = normalised_crs(text)
    is_unsafe = any(word in name.lower() for word in _OPENS_FILES) or not name.isprintable()
    if not name or len(name) > _LONGEST or is_unsafe:
        return None
    plane, plus, _ = name.partition("+")
    is_code = re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*:[A-Za-z0-9_.]+", plane) is not None
    for candidate in (name, plane) if is_code and plus else (name,):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                crs = CRS.from_user_input(candidate)
        except (CRSError, ValueError):
            continue
        is_spelt_out = is_code or any(c in candidate for c in "[{=")
        return crs if is_spelt_out or crs.name.casefold() == name.casefold() else None
    return None


def is_place_on_earth(text: str) -> bool:
    """Whether a text names a CRS that says where on Earth something is.

    Raises
    ------
    EnvironmentProblem
        pyproj is missing.
    """
    if not has_pyproj():
        raise require_extra("pyproj", "formats", f'the CRS "{text[:80]}"')
    crs = crs_of(text)
    return crs is not None and (crs.is_projected or crs.is_geographic or crs.is_geocentric)


@lru_cache(maxsize=64)
def horizontal(crs: CRS) -> CRS:
    """Return `crs` without heights."""
    if crs.is_geocentric:
        return crs
    flat = crs.to_2d()
    return flat.sub_crs_list[0] if flat.is_compound else flat


def has_pyproj() -> bool:
    """Whether pyproj is installed."""
    try:
        import pyproj  # noqa: F401
    except ImportError:
        return False
    return True


def longitude_latitude(crs: CRS, at: Sequence[float]) -> tuple[float, float] | None:
    """Return where a point in the units of `crs` lies in WGS 84 [degrees], or None.

    None where the CRS does not reach: its formulas give no number there, or one that does
    not lead back.

    Parameters
    ----------
    at : sequence of float
        x, y; of an earth-centred CRS x, y, z, which must lie near the ground.
    """
    from pyproj.exceptions import ProjError

    flat = horizontal(crs)
    point = [float(part) for part in at[: 3 if flat.is_geocentric else 2]]
    try:
        to_wgs84 = _to_wgs84(flat)
        found = _transformed(to_wgs84, point, "FORWARD")
        back = _transformed(to_wgs84, found, "INVERSE")
    except (ProjError, ValueError):
        return None
    if not all(map(math.isfinite, (*found, *back))):
        return None
    if flat.is_geocentric and abs(found[2]) > _FARTHEST_UP_M:
        return None
    unit = flat.axis_info[0].unit_conversion_factor
    closes = _CLOSES_M / _EARTH_M if flat.is_geographic else _CLOSES_M
    if flat.is_geographic:  # 181 degrees come back as -179
        turn = 2.0 * math.pi / unit
        back = [point[0] + math.remainder(back[0] - point[0], turn), back[1]]
    return (found[0], found[1]) if math.dist(back, point) * unit < closes else None


@lru_cache(maxsize=64)
def _to_wgs84(flat: CRS) -> Transformer:
    from pyproj import Transformer

    target = "EPSG:4979" if flat.is_geocentric else "EPSG:4326"
    return Transformer.from_crs(flat, target, always_xy=True)


def _transformed(transformer: Transformer, point: list[float], direction: str) -> list[float]:
    if len(point) == 3:
        return list(transformer.transform(point[0], point[1], point[2], direction=direction))
    return list(transformer.transform(point[0], point[1], direction=direction))


def degrees_outside(crs: CRS, longitude: float, latitude: float) -> float:
    """Return how far a point lies outside of the area that `crs` is meant for [degrees].

    0 inside, and where the register gives no area.
    """
    area = horizontal(crs).area_of_use
    if area is None:
        return 0.0
    west, south, east, north = area.bounds
    # A box may cross the antimeridian: then its west is greater than its east.
    width, along = (east - west) % 360.0, (longitude - west) % 360.0
    if east - west >= 360.0 or along <= width:
        beside = 0.0
    else:
        beside = min(along - width, 360.0 - along)
    return max(beside, south - latitude, latitude - north, 0.0)


def _is_in_area(crs: CRS, x: float, y: float) -> bool:
    if crs.is_geocentric or horizontal(crs).area_of_use is None:
        return True
    at = longitude_latitude(crs, (x, y))
    return at is not None and degrees_outside(crs, *at) <= AREA_SLACK_DEG
