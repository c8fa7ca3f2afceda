"""CityJSON 2.0: a CityObject per object, with its id, type, parents and surfaces.

The transform's scale is the grid's step and its translation the grid's origin, so vertices
are the integers that positions are multiples by, and equal ones are written once. An object
of one solid component is a Solid, any other a MultiSurface, of triangles. A parent that has
no faces is a CityObject without geometry. Ids are unique in a file: the second object of a
name gets ``~2``. What CityJSON has no type for becomes a GenericCityObject, and its type an
attribute; what has no type becomes one too, without that attribute.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from svprep.export.city import City, distinct
from svprep.model import I32, I64

HEAD: Final = b'{"type":"CityJSON","version":"2.0","metadata":{"title":"svprep export'
_EPSG: Final = re.compile(r"EPSG:([0-9]+)(?:\+([0-9]+))?", re.IGNORECASE)
_CRS_URL: Final = "https://www.opengis.net/def/crs"
_GENERIC: Final = "GenericCityObject"
_ROOTS: Final = ("Building", "Bridge", "Tunnel")
_BELOW: Final = {
    "Building": (
        "BuildingPart BuildingInstallation BuildingConstructiveElement BuildingFurniture "
        "BuildingStorey BuildingRoom BuildingUnit"
    ),
    "Bridge": (
        "BridgePart BridgeInstallation BridgeConstructiveElement BridgeRoom BridgeFurniture"
    ),
    "Tunnel": (
        "TunnelPart TunnelInstallation TunnelConstructiveElement TunnelHollowSpace TunnelFurniture"
    ),
}
_PARENT_TYPE: Final = {part: root for root, parts in _BELOW.items() for part in parts.split()}
_NO_SOLID: Final = frozenset(
    ["LandUse", "PlantCover", "Railway", "Road", "TINRelief", "TransportSquare", "Waterway"]
)
TYPES: Final = frozenset(
    [
        *_ROOTS,
        *_PARENT_TYPE,
        *_NO_SOLID,
        "CityFurniture",
        "CityObjectGroup",
        _GENERIC,
        "OtherConstruction",
        "SolitaryVegetationObject",
        "WaterBody",
    ]
)
"""Of CityJSON 2.0."""
_LOD: Final = "2"


@dataclass(frozen=True, slots=True)
class Family:
    """Ids of objects, and who is a part of whom."""

    ids: list[str]
    """``(n_objects,)``, all different."""
    parent_of: dict[str, str]
    """By id."""
    children_of: dict[str, list[str]]
    without_faces: dict[str, str]
    """Parents that are no objects here: type by id, in the order of their first child."""


def family_of(city: City) -> Family:
    """Return the ids of objects and of parents, an object of its own source going first."""
    ids = distinct(list(city.names))
    taken = set(ids)
    id_of: dict[tuple[int, str], str] = {}
    for source, name, own in zip(city.source_of.tolist(), city.names, ids, strict=True):
        id_of.setdefault((source, name), own)
    parent_of: dict[str, str] = {}
    children_of: dict[str, list[str]] = {}
    without_faces: dict[str, str] = {}
    for i, (source, parent) in enumerate(zip(city.source_of.tolist(), city.parents, strict=True)):
        if not parent:
            continue
        if (source, parent) not in id_of:
            own, n = parent, 2
            while own in taken:
                own, n = f"{parent}~{n}", n + 1
            taken.add(own)
            id_of[source, parent] = own
            without_faces[own] = _PARENT_TYPE.get(city.types[i], _GENERIC)
        own = id_of[source, parent]
        parent_of[ids[i]] = own
        children_of.setdefault(own, []).append(ids[i])
    return Family(ids, parent_of, children_of, without_faces)


def n_retyped(city: City) -> int:
    """Return how many objects have a type that CityJSON does not."""
    return sum(bool(kind) and not _is_known(kind) for kind in city.types)


def n_untyped(city: City) -> int:
    """Return how many objects have no type; in CityJSON each has one."""
    return city.types.count("")


def reference_system(crs: str) -> str:
    """Return the URL of a CRS, ``""`` for one that has none: WKT, a local frame.

    A compound one, ``"EPSG:31468+5783"``, is ``.../crs-compound?1=...&2=...``, unescaped as
    OGC writes it; `svprep.ingest.crs_names` reads both.
    """
    found = _EPSG.fullmatch(crs)
    if not found:
        return ""
    plane, height = (code and f"{_CRS_URL}/EPSG/0/{code}" for code in found.groups())
    return f"{_CRS_URL}-compound?1={plane}&2={height}" if height else plane


def _is_known(kind: str) -> bool:
    return kind in TYPES or kind.startswith("+")


def cityjson_parts(city: City) -> Iterator[bytes]:
    """Yield the file, a line per object. About 1.5 us a face, O(n log n)."""
    family = family_of(city)
    steps, number_of = _distinct_rows(city.steps)
    yield (
        HEAD
        + f' of a repaired mesh"{_metadata(city)}}},"transform":{_transform(city)},'.encode()
        + b'"CityObjects":{\n'
    )
    corners = number_of[city.faces]
    before = ""
    for own, kind in family.without_faces.items():
        yield f"{before}{_dump(own)}:{_dump(_object(family, own, kind))}".encode()
        before = ",\n"
    start = city.object_face_start.tolist()
    for i, own in enumerate(family.ids):
        begin, end = start[i], start[i + 1]
        tree = _object(family, own, city.types[i])
        head = _dump(tree)[:-1]
        geometry = "]" if begin == end else f"{_geometry(city, i, corners[begin:end], begin)}]"
        yield f'{before}{_dump(own)}:{head},"geometry":[{geometry}}}'.encode()
        before = ",\n"
    yield b'\n},"vertices":[\n'
    for begin in range(0, len(steps), 1 << 16):
        rows = steps[begin : begin + (1 << 16)]
        text = ",[%d,%d,%d]" * len(rows) % tuple(rows.reshape(-1).tolist())
        yield (text if begin else text[1:]).encode()
    yield b"\n]}\n"


def _distinct_rows(rows: I32) -> tuple[I32, I64]:
    """Return the different rows, sorted, and the number of each row among them."""
    order = np.lexsort(rows.T[::-1])
    ranked = rows[order]
    is_new = np.ones(len(rows), bool)
    is_new[1:] = (ranked[1:] != ranked[:-1]).any(axis=1)
    number_of = np.empty(len(rows), np.int64)
    number_of[order] = np.cumsum(is_new) - 1
    return ranked[is_new], number_of


def _dump(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))


def _metadata(city: City) -> str:
    """Return the members behind the title, with a comma before each."""
    members = ""
    if url := reference_system(city.crs):
        members += f',"referenceSystem":{_dump(url)}'
    if len(city.positions):
        points = city.source_positions
        extent = [*points.min(axis=0).tolist(), *points.max(axis=0).tolist()]
        members += f',"geographicalExtent":{_dump(extent)}'
    return members


def _transform(city: City) -> str:
    scale, translate = [city.grid.step_m] * 3, city.grid.origin_m.tolist()
    return _dump({"scale": scale, "translate": translate})


def _object(family: Family, own: str, kind: str) -> dict[str, Any]:
    """Return a CityObject without its geometry."""
    known = kind if _is_known(kind) else _GENERIC
    tree: dict[str, Any] = {"type": known}
    if kind and known != kind:
        tree["attributes"] = {"type": kind}
    if own in family.parent_of:
        tree["parents"] = [family.parent_of[own]]
    if own in family.children_of:
        tree["children"] = family.children_of[own]
    return tree


def _geometry(city: City, i: int, corners: Any, begin: int) -> str:
    """Return the only geometry of object i, whose first face is `begin`."""
    n = len(corners)
    shell = ("," + "[[%d,%d,%d]]") * n % tuple(corners.reshape(-1).tolist())
    boundaries = f"[{shell[1:]}]"
    surface = city.surface_of_face[begin : begin + n]
    used = np.unique(surface[surface != 0])
    values = ""
    if len(used):
        number = np.full(256, -1)
        number[used] = np.arange(len(used))
        listed = [None if k < 0 else k for k in number[surface].tolist()]
        values = _dump(listed)
    kind = city.types[i]
    form = "CompositeSurface" if kind == "TINRelief" else "MultiSurface"
    if city.is_solid[i] and kind not in _NO_SOLID:
        form, boundaries, values = "Solid", f"[{boundaries}]", values and f"[{values}]"
    text = f'{{"type":"{form}","lod":"{_LOD}","boundaries":{boundaries}'
    if values:
        surfaces = [{"type": city.surface_names[k]} for k in used.tolist()]
        text += f',"semantics":{{"surfaces":{_dump(surfaces)},"values":{values}}}'
    return text + "}"
