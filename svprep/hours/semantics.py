"""What files say their surfaces are, as kinds of sun hours.

    the file's word                              kind
    -----------------------------------------    ------------------------------------------
    RoofSurface, OuterFloorSurface               roof; underside where it looks down (|nz| >= 0.5)
    WallSurface                                  wall, however level; but of a file that calls
                                                 every face so, level ones by geometry
    GroundSurface, OuterCeilingSurface           underside; of an open shell the lower side
                                                 counts. One of a closed shell that looks up:
                                                 by geometry
    Window, Door (WindowSurface, DoorSurface)    wall; a level one that looks up (a roof window)
                                                 roof, down underside
    any face of terrain, road, railway, water,   ground where it looks up at all, however steep;
    or land (by the object's type), or of a      else by geometry
    traffic or water surface
    anything else, such as ClosureSurface        by geometry: see `svprep.hours.surfaces`

A GroundSurface is a building's bottom plate, not the ground around it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from svprep.hours.kinds import LEVEL, Kind
from svprep.model import BOOL, F64, I64, U8, U32, Labels

UNSTATED: Final = 255
"""In place of a `Kind`: geometry decides."""
_UPWARD: Final = 0.05
"""A face looks up at all from this nz on: 87 degrees of slope; sides of blocks do not."""

_ROOFS: Final = frozenset({"roofsurface", "outerfloorsurface"})
_WALLS: Final = frozenset({"wallsurface"})
_BOTTOMS: Final = frozenset({"groundsurface", "outerceilingsurface"})
_OPENINGS: Final = frozenset({"window", "door", "windowsurface", "doorsurface"})
_LAND_SURFACES: Final = frozenset(
    {"trafficarea", "auxiliarytrafficarea", "trafficspace", "auxiliarytrafficspace", "watersurface"}
)
_LAND_TYPES: Final = frozenset(
    {
        "tinrelief",
        "relieffeature",
        "rasterrelief",
        "terrain",
        "landuse",
        "road",
        "railway",
        "square",
        "track",
        "transportsquare",
        "transportationcomplex",
        "waterbody",
        "waterway",
    }
)

STATED_RULES: Final = (
    "RoofSurface and OuterFloorSurface: roof; WallSurface: wall, but level ones by "
    "geometry in a file that calls every face so; GroundSurface and "
    "OuterCeilingSurface: underside; Window and Door: wall, level ones roof; objects that are "
    "terrain, roads, water or land: ground where they look up; others: by geometry"
)
"""The rules in one line."""


def stated_kinds(labels: Labels, object_of_face: I64, nz: F64) -> U8:
    """Return ``(n_faces,)``: the `Kind` that the file's words give each face, or `UNSTATED`.

    Parameters
    ----------
    object_of_face : (n_faces,) int64
    nz : (n_faces,) float64
        Of the unit normal of the side that counts.
    """
    kind = np.full(len(nz), UNSTATED, np.uint8)
    is_up, is_down = nz >= LEVEL, nz <= -LEVEL
    kind[_named(labels, _ROOFS) & ~is_down] = Kind.ROOF
    kind[_named(labels, _ROOFS) & is_down] = Kind.UNDERSIDE
    kind[_named(labels, _WALLS)] = Kind.WALL
    kind[is_bottom(labels) & (nz < _UPWARD)] = Kind.UNDERSIDE
    is_opening = _named(labels, _OPENINGS)
    kind[is_opening] = Kind.WALL
    kind[is_opening & is_up] = Kind.ROOF
    kind[is_opening & is_down] = Kind.UNDERSIDE
    is_land_type = np.array([t.casefold() in _LAND_TYPES for t in labels.object_types], bool)
    is_land = _named(labels, _LAND_SURFACES)
    if is_land_type.any():
        is_land |= is_land_type[object_of_face]
    kind[is_land & (kind == UNSTATED) & (nz > _UPWARD)] = Kind.GROUND
    return kind


def doubted_walls(labels: Labels, source_of_face: U32, nz: F64) -> BOOL:
    """Return ``(n_faces,)``: whether each is level, in a file that calls every face a wall.

    Such a file (early converters wrote them) says nothing by it.

    Parameters
    ----------
    source_of_face : (n_faces,) uint32
        Number of the file.
    nz : (n_faces,) float64
        Of the unit normal of the side that counts.
    """
    is_wall = _named(labels, _WALLS)
    if not is_wall.any():
        return is_wall
    is_all = np.bincount(source_of_face[is_wall], minlength=1 + source_of_face.max())
    is_all = is_all == np.bincount(source_of_face)
    return np.asarray(is_all[source_of_face] & (np.abs(nz) >= LEVEL))


def is_bottom(labels: Labels) -> BOOL:
    """Return ``(n_faces,)``: whether each is named as the bottom plate or soffit of a building."""
    return _named(labels, _BOTTOMS)


def _named(labels: Labels, names: frozenset[str]) -> BOOL:
    """Return ``(n_faces,)``: whether each face bears one of these names."""
    is_one = np.array([name.casefold() in names for name in labels.surface_names], bool)
    if not is_one.any():
        return np.zeros(len(labels.surface_of_face), bool)
    return np.asarray(is_one[labels.surface_of_face])
