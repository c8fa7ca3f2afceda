"""What the elements of a CityGML file are to the reader, by their names.

The same local names serve CityGML 1.0, 2.0 and 3.0, application domain extensions and
IndoorGML (cells as objects); namespaces only tell GML's own elements apart.

GML alternates between objects (``bldg:WallSurface``, upper case) and their properties
(``bldg:boundedBy``, lower case). So whatever is upper case and not GML's is a feature: a
city object, or what its surfaces are.
"""

from __future__ import annotations

import re
from enum import Enum, auto
from typing import Final

_ID_NAMES: Final = (
    "http://www.opengis.net/gml id",
    "http://www.opengis.net/gml/3.2 id",
    "http://www.opengis.net/gml/3.3 id",
)
HREF: Final = "http://www.w3.org/1999/xlink href"
LEVEL: Final = re.compile(r"\d{1,3}(\.\d{1,3})?", re.ASCII)
"""The text of an element ``lod``."""
ROOTS: Final = frozenset(["CityModel", "IndoorFeatures", "FeatureCollection"])
"""Elements that a file may begin with, besides those in a namespace of CityGML."""


class Role(Enum):
    """What the reader does at an element."""

    NONE = auto()
    """Nothing: it looks at what is below."""
    SKIPPED = auto()
    """Nothing, nor at what is below."""
    NO_SURFACE = auto()
    """The same, with a note: a property that holds curves, points or rasters."""
    OBJECT = auto()
    SURFACE = auto()
    """What the polygons of the enclosing city object are: a roof, a wall, a window."""
    LOD_PROPERTY = auto()
    PLAIN_PROPERTY = auto()
    """Holds surfaces without a level of detail in its name."""
    LEVEL = auto()
    """The level of detail of a relief component, as text."""
    AGGREGATE = auto()
    ORIENTABLE = auto()
    POLYGON = auto()
    RING = auto()
    INTERIOR = auto()
    LINK = auto()
    """A property of a geometry, which may refer to a geometry elsewhere."""
    POS = auto()
    POS_LIST = auto()
    COORDINATES = auto()
    LINE = auto()
    ENVELOPE = auto()
    IMPLICIT = auto()
    TEMPLATE = auto()
    MATRIX = auto()
    REFERENCE_POINT = auto()
    LIBRARY = auto()


_ROLES: Final = {
    **dict.fromkeys(
        [
            "MultiSurface", "CompositeSurface", "Solid", "MultiSolid", "CompositeSolid", "Shell",
            "Surface", "PolyhedralSurface", "TriangulatedSurface", "Tin", "MultiGeometry",
            "GeometricComplex", "Geometry2D", "Geometry3D", "MultiPolygon",
        ],
        Role.AGGREGATE,
    ),
    **dict.fromkeys(["Polygon", "Triangle", "Rectangle", "PolygonPatch"], Role.POLYGON),
    **dict.fromkeys(["LinearRing", "Ring"], Role.RING),
    **dict.fromkeys(["interior", "innerBoundaryIs"], Role.INTERIOR),
    **dict.fromkeys(
        [
            "exterior", "surfaceMember", "solidMember", "geometryMember", "baseSurface", "shell",
            "element", "polygonMember",
        ],
        Role.LINK,
    ),
    **dict.fromkeys(["relativeGMLGeometry", "relativeGeometry"], Role.TEMPLATE),
    **dict.fromkeys(["tin", "cellSpaceGeometry"], Role.PLAIN_PROPERTY),
    **dict.fromkeys(["LineString", "Curve"], Role.LINE),
    **dict.fromkeys(
        [
            "appearance", "appearanceMember", "surfaceDataMember", "address", "extent",
            "metaDataProperty",
        ],
        Role.SKIPPED,
    ),
    # The parts of a group are objects of their own, wherever they stand.
    **dict.fromkeys(
        ["CityModel", "CityObjectGroup", "IndoorFeatures", "PrimalSpaceFeatures"], Role.NONE
    ),
    "controlPoint": Role.NO_SURFACE,
    "OrientableSurface": Role.ORIENTABLE,
    "pos": Role.POS,
    "posList": Role.POS_LIST,
    "coordinates": Role.COORDINATES,
    "Envelope": Role.ENVELOPE,
    "ImplicitGeometry": Role.IMPLICIT,
    "transformationMatrix": Role.MATRIX,
    "referencePoint": Role.REFERENCE_POINT,
    "libraryObject": Role.LIBRARY,
    "lod": Role.LEVEL,
}  # fmt: skip
_SURFACES: Final = frozenset(
    ["Window", "Door", "TrafficArea", "AuxiliaryTrafficArea", "HoleSurface", "Hole", "Marking"]
)
_LOD_PROPERTY: Final = re.compile(r"lod(\d{1,3}(?:[._]\d{1,3})?)([A-Z_].*)?", re.ASCII)
_NO_SURFACE: Final = re.compile(r"(?i)TerrainIntersection|Curve|Network|Point|Line|centerline")

LINE_RELIEF: Final = ("MassPointRelief", "BreaklineRelief", "RasterRelief")
"""City objects whose geometry is never a surface."""


def local_name(name: str) -> str:
    """Return ``"Building"`` of ``"http://www.opengis.net/citygml/building/2.0 Building"``."""
    return name.rpartition(" ")[2]


def role_of(name: str) -> Role:
    """Return what the reader does at an element.

    Parameters
    ----------
    name
        ``"NAMESPACE LOCAL"`` or ``"LOCAL"``.
    """
    namespace, _, local = name.rpartition(" ")
    if local in _ROLES:
        return _ROLES[local]
    match = _LOD_PROPERTY.fullmatch(local)
    if match:
        return Role.NO_SURFACE if _NO_SURFACE.search(match[2] or "") else Role.LOD_PROPERTY
    is_gml = namespace.startswith("http://www.opengis.net/gml")
    if is_gml or not local[:1].isupper() or local == "FeatureCollection":
        return Role.NONE
    is_surface = local in _SURFACES or local.endswith("Surface")
    return Role.SURFACE if is_surface else Role.OBJECT


def id_of(attributes: dict[str, str]) -> str:
    """Return an element's ``gml:id``, or ``""``."""
    for name in _ID_NAMES:
        if name in attributes:
            return attributes[name]
    return ""


def level_of(name: str) -> str:
    """Return ``"2"`` of an element ``lod2Solid``, ``"2.1"`` of ``lod2_1Solid``."""
    match = _LOD_PROPERTY.fullmatch(local_name(name))
    return match[1].replace("_", ".") if match else ""
