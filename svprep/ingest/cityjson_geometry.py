"""Boundaries and semantics of CityJSON geometries, as flat arrays.

    MultiSurface, CompositeSurface         surfaces [ rings [ corners ]]
    Solid                           shells [ surfaces [ rings [ corners ]]]
    MultiSolid, CompositeSolid  solids [ shells [ surfaces [ rings [ corners ]]]]

Semantics nest like the shells: a number of `surfaces` per surface, null for one, a shell or
a solid that has none. Version 0.1 writes names in place of numbers, and "Roof" for
"RoofSurface".
"""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Final

from svprep.ingest.parsed import encodable, shown
from svprep.ingest.surface_names import SurfaceNames

DEPTH: Final = {
    "MultiSurface": 0,
    "CompositeSurface": 0,
    "Solid": 1,
    "MultiSolid": 2,
    "CompositeSolid": 2,
}
"""Of the list of surfaces in the boundaries of each type of geometry."""
NO_SURFACE: Final = {"MultiPoint": "points", "MultiLineString": "lines"}

_OLD_NAMES: Final = {
    name: f"{name}Surface"
    for name in (
        "Roof", "Wall", "Ground", "Closure", "OuterCeiling", "OuterFloor", "Ceiling", "Floor",
        "InteriorWall",
    )
}  # fmt: skip


class MalformedError(Exception):
    """What is wrong with a geometry, without the file and the object."""


def type_of(geometry: dict[str, Any]) -> str:
    """Return the type of a geometry, "" where it states none."""
    kind = geometry.get("type")
    return kind if isinstance(kind, str) else ""


def unknown_type(geometry: dict[str, Any]) -> MalformedError:
    """Return the error for a geometry of a type that CityJSON does not have."""
    return MalformedError(f"there is no geometry of type {shown(repr(geometry.get('type')))}")


@dataclass(slots=True)
class Surfaces:
    """Polygons one behind the other, as many geometries as there are."""

    corners: array[int] = field(default_factory=lambda: array("I"))
    """Indices of vertices, ring after ring."""
    ring_size: array[int] = field(default_factory=lambda: array("I"))
    n_rings: array[int] = field(default_factory=lambda: array("I"))
    """By polygon."""
    name: bytearray = field(default_factory=bytearray)
    """By polygon: number of its surface's name."""
    left_out: Counter[str] = field(default_factory=Counter)
    """Semantics that do not fit their geometry."""

    def __len__(self) -> int:
        """Return the number of polygons."""
        return len(self.n_rings)

    def add(self, geometry: dict[str, Any], kind: str, names: SurfaceNames) -> None:
        """Take the polygons of one geometry.

        Raises
        ------
        MalformedError
        """
        boundaries: Any = geometry.get("boundaries")
        surfaces: Any = boundaries
        for _ in range(DEPTH[kind]):
            surfaces = _joined(surfaces, kind)
        rings = _joined(surfaces, kind)
        corners = _joined(rings, kind)
        if not set(map(type, corners)) <= {int}:
            bad = next(c for c in corners if type(c) is not int)
            if isinstance(bad, list):
                raise MalformedError(f"the boundaries of its {kind} are nested too deeply")
            raise MalformedError(f"{shown(repr(bad))} in its boundaries is not a vertex index")
        try:
            self.corners.extend(corners)
        except OverflowError:
            bad = next(c for c in corners if not 0 <= c < 1 << 32)
            raise MalformedError(f"vertex {shown(bad)} in its boundaries does not exist") from None
        self.ring_size.extend(map(len, rings))
        self.n_rings.extend(map(len, surfaces))
        self.name += self._names(geometry.get("semantics"), boundaries, DEPTH[kind], names)

    def _names(
        self, semantics: object, boundaries: list[Any], depth: int, names: SurfaceNames
    ) -> bytes:
        """Return the number of the name of each surface."""
        n = _n_surfaces(boundaries, depth)
        if semantics is None:
            return bytes(n)
        try:
            if isinstance(semantics, dict):
                listed = semantics.get("surfaces") or []
                of_index: dict[object, int] = {None: 0}
                of_index.update((i, _number(s.get("type"), names)) for i, s in enumerate(listed))
                values = _values(semantics.get("values"), boundaries, depth)
                return bytes([of_index[value] for value in values])
            values = _values(semantics, boundaries, depth)
            return bytes([_number(value, names) for value in values])
        except (AttributeError, KeyError, TypeError, ValueError):
            self.left_out["semantics"] += 1
            return bytes(n)


def _number(name: object, names: SurfaceNames) -> int:
    """Return the number of a surface's name, 0 of what is none."""
    if not isinstance(name, str):
        return 0
    return names.number_of(encodable(_OLD_NAMES.get(name, name)))


def _joined(lists: Any, kind: str) -> list[Any]:
    """Return the elements of all lists in a list."""
    if type(lists) is not list or not set(map(type, lists)) <= {list}:
        raise MalformedError(f"the boundaries of its {kind} are not nested deeply enough")
    return list(chain.from_iterable(lists))


def _n_surfaces(boundaries: list[Any], depth: int) -> int:
    """Return the number of surfaces in boundaries."""
    return sum(_n_surfaces(b, depth - 1) for b in boundaries) if depth else len(boundaries)


def _values(values: Any, boundaries: list[Any], depth: int) -> list[Any]:
    """Return the value of each surface; raise `ValueError` where they do not fit."""
    if values is None:
        return [None] * _n_surfaces(boundaries, depth)
    if not isinstance(values, list) or len(values) != len(boundaries):
        raise ValueError("values do not fit the boundaries")
    if depth == 0:
        return values
    return [
        value
        for part, boundary in zip(values, boundaries, strict=True)
        for value in _values(part, boundary, depth - 1)
    ]
