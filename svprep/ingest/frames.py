"""Frames for shadows: which CRS is one, the local one where none is, and the way into it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from svprep.errors import InputError
from svprep.ingest.crs_names import horizontal, longitude_latitude
from svprep.model import F64

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

MOST_SCALE_ERROR: Final = 0.005
"""A map is a frame if a metre on it is one on the ground up to this: a shadow of 100 m is
then 0.5 m off at most. The grids of countries stay within a fifth of it."""

ELLIPSOID: Final = "the ellipsoid of "
"""How `level_of` begins where heights count from one."""
_PROBE_M: Final = 10.0


@dataclass(frozen=True, slots=True)
class Frame:
    """A plane in metres that all positions are brought to."""

    name: str
    """What `Place.crs` holds."""
    words: str
    flat: CRS
    """Without heights."""
    near: tuple[float, float] | None
    """Longitude and latitude of the middle of what decides it, in degrees."""
    is_local: bool


def local_frame(flat: CRS, boxes: F64) -> Frame:
    """Return the transverse Mercator about the middle of ``(n, 2, 3)`` boxes."""
    from pyproj.crs import ProjectedCRS
    from pyproj.crs.coordinate_operation import TransverseMercatorConversion

    base = geographic(flat)
    to_base, _ = best_transformer(flat, base)
    x, y, z = middle_of(flat, boxes)
    middle = to_base.transform(x, y, z) if flat.is_geocentric else to_base.transform(x, y)
    unit_deg = degrees_in_unit(base)
    longitude, latitude = (round(float(part) * unit_deg, 3) + 0.0 for part in middle[:2])
    crs = ProjectedCRS(
        TransverseMercatorConversion(latitude, longitude, 0.0, 0.0, 1.0),
        name=f"local frame at {latitude:.3f}, {longitude:.3f}",
        geodetic_crs=base.to_2d(),
    )
    words = f"a transverse Mercator frame about {latitude:.3f}, {longitude:.3f} ({base.name})"
    near = longitude_latitude(flat, middle_of(flat, boxes))
    return Frame(crs.to_wkt(), words, crs, near, is_local=True)


def middle_of(flat: CRS, boxes: F64) -> list[float]:
    """Return the middle of ``(n, 2, 3)`` boxes in the units of `flat`."""
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    if flat.is_geographic:
        turn = 360.0 / degrees_in_unit(flat)
        if high[0] - low[0] > turn / 2:  # the antimeridian runs through the data
            eastward = np.where(boxes[..., 0] < 0.0, boxes[..., 0] + turn, boxes[..., 0])
            low[0], high[0] = eastward.min(), eastward.max()
    return (low / 2 + high / 2).tolist()  # the sum may overflow


def degrees_in_unit(crs: CRS) -> float:
    """Return what one unit of longitude or latitude is: some CRS count in grads."""
    return float(np.degrees(crs.axis_info[0].unit_conversion_factor))


def plane_problem(flat: CRS, box: F64) -> str:
    """Return why x and y there are not metres on the ground to the east and the north, or ``""``.

    Within `MOST_SCALE_ERROR`, and within 45 degrees: the rest is meridian convergence.
    """
    if not flat.is_projected:
        return "earth-centred" if flat.is_geocentric else "degrees"
    unit = flat.axis_info[0]
    if unit.unit_conversion_factor != 1.0:
        return f"in {unit.unit_name}"
    ground = _ground_axes(flat, *middle_of(flat, box[None])[:2])
    stretch = np.linalg.svd(ground, compute_uv=False) if np.isfinite(ground).all() else np.zeros(2)
    if not (abs(stretch - 1.0) < MOST_SCALE_ERROR).all():
        return f"its metre is {stretch[0]:.4g} m on the ground"
    # To the north more than to either side, and x to the right of that.
    if np.linalg.det(ground) < 0.0 or not ground[1, 1] > abs(ground[0, 1]):
        return "its axes do not lead east and north"
    return ""


def _ground_axes(flat: CRS, x: float, y: float) -> F64:
    """Return ``(2, 2)``: where a step along x and one along y lead on the ground [m / unit].

    Columns are the steps, rows east and north. Over some metres to either side, along
    geodesics: whatever the projection, its unit and its axes.
    """
    geodetic = geographic(flat)
    to_ground, _ = best_transformer(flat, geodetic.to_2d())
    step = _PROBE_M / flat.axis_info[0].unit_conversion_factor
    xs, ys = [x - step, x + step, x, x], [y, y, y - step, y + step]
    lon, lat = (
        np.asarray(values) * degrees_in_unit(geodetic) for values in to_ground.transform(xs, ys)
    )
    if not (np.isfinite(lon).all() and np.isfinite(lat).all()):
        return np.full((2, 2), np.nan)
    geod = geodetic.get_geod()
    assert geod is not None  # it has longitudes
    azimuth, _, length = geod.inv(lon[::2], lat[::2], lon[1::2], lat[1::2])
    angle = np.radians(azimuth)
    return np.stack([np.sin(angle), np.cos(angle)]) * length / (2.0 * step)


@lru_cache(maxsize=64)
def geographic(crs: CRS) -> CRS:
    """Return the longitudes and latitudes on the datum of `crs`; of an earth-centred one 3D."""
    from pyproj.crs import GeographicCRS

    geodetic = crs.geodetic_crs
    if geodetic is None:
        raise InputError(f'the CRS "{crs.name}" has no longitudes and latitudes beneath it')
    if geodetic.is_geographic:
        return geodetic.to_2d()
    plain = GeographicCRS(name=geodetic.name, datum=geodetic.datum)
    return plain.to_3d()


def is_same_plane(flat: CRS, crs: CRS) -> bool:
    """Whether x and y mean the same, whatever the order in which the register lists them."""
    other = horizontal(crs)
    if flat.equals(other, ignore_axis_order=True):
        return True
    if not (flat.is_projected and other.is_projected) or _axes(flat) != _axes(other):
        return False
    return bool(
        flat.coordinate_operation == other.coordinate_operation
        and flat.geodetic_crs == other.geodetic_crs
    )


def _axes(crs: CRS) -> list[tuple[str, float]]:
    return sorted((axis.direction, axis.unit_conversion_factor) for axis in crs.axis_info)


@lru_cache(maxsize=64)
def best_transformer(
    source: CRS, target: CRS, near: tuple[float, float] | None = None
) -> tuple[Transformer, str]:
    """Return the operation that is best without missing files, and the note on its accuracy.

    One for all points: PROJ would choose anew for each, and tear a city where two choices
    meet. The note is ``""`` on a single datum.

    Parameters
    ----------
    near : tuple of float, optional
        Longitude and latitude [degrees] where it is to be the best.
    """
    from pyproj.exceptions import ProjError
    from pyproj.transformer import AreaOfInterest, TransformerGroup

    area = None
    if near is not None and abs(near[0]) < 179.0 and abs(near[1]) < 89.0:
        area = AreaOfInterest(near[0] - 0.1, near[1] - 0.1, near[0] + 0.1, near[1] + 0.1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of missing grids: told in the note
            group = TransformerGroup(source, target, always_xy=True, area_of_interest=area)
    except ProjError:
        group = None
    if group is None or not group.transformers:
        raise InputError(f'no way is known from the CRS "{source.name}" to "{target.name}"')
    best = group.transformers[0]
    if best.accuracy == 0.0:
        return best, ""
    accuracy = f"good to {best.accuracy:g} m" if best.accuracy > 0.0 else "of unknown accuracy"
    better = "" if group.best_available else "; a better one needs grid files that PROJ lacks here"
    return best, f"; the change of datum is {best.description}, {accuracy}{better}"


def level_of(crs: CRS) -> str:
    """Return from what heights count, ``""`` if the CRS has none."""
    if crs.is_compound:
        return crs.sub_crs_list[1].name
    has_heights = crs.is_geocentric or len(crs.axis_info) == 3
    geodetic = crs.geodetic_crs
    return f"{ELLIPSOID}{geodetic.name}" if has_heights and geodetic is not None else ""


def height_factor(crs: CRS) -> float:
    """Return metres in a unit of height, less than 0 if it counts down.

    Of a plane CRS without heights the unit of the plane: a city in feet is feet high.
    """
    if crs.is_geocentric:
        return 1.0
    axes = crs.axis_info
    if len(axes) == 3:
        up = axes[2]
        return float(up.unit_conversion_factor) * (-1.0 if up.direction == "down" else 1.0)
    return float(axes[0].unit_conversion_factor) if crs.is_projected else 1.0


def name_of(crs: CRS) -> str:
    """Return its code, or else its WKT."""
    code = crs.to_epsg(min_confidence=100)
    return f"EPSG:{code}" if code else str(crs.to_wkt())
