"""The city objects of CityJSON, as they are read: who they are, and their geometries."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from svprep.errors import InputError
from svprep.ingest.cityjson_geometry import (
    DEPTH,
    NO_SURFACE,
    MalformedError,
    Surfaces,
    type_of,
    unknown_type,
)
from svprep.ingest.cityjson_templates import Instance, Templates
from svprep.ingest.parsed import shown
from svprep.ingest.surface_names import SurfaceNames

_CHILDREN: Final = (
    "children",
    "Parts",
    "parts",
    "BuildingParts",
    "BridgeParts",
    "TunnelParts",
    "Installations",
    "BuildingInstallations",
    "installations",
)
"""Where parents name what is a part of them; all but the first in 0.x."""
_RELATIONS: Final = frozenset(("parents", "parent", *_CHILDREN))
_GROUP: Final = "CityObjectGroup"


def lod_of(geometry: dict[str, Any]) -> str:
    """Return the level of detail that a geometry states, "" for none."""
    lod = geometry.get("lod")
    if isinstance(lod, float):
        return f"{lod:g}"
    return str(lod) if type(lod) in (int, str) else ""


@dataclass(slots=True)
class Objects:
    """Every object and geometry so far, in the order of the file."""

    path: Path
    n_bytes: int
    """Of the file."""
    templates: Templates = field(default_factory=Templates)
    surface_names: SurfaceNames = field(default_factory=SurfaceNames)
    surfaces: Surfaces = field(default_factory=Surfaces)
    instances: list[Instance] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)
    """Geometries without surfaces, by type."""

    names: list[str] = field(default_factory=list)
    types: list[str] = field(default_factory=list)
    lods: list[tuple[str, ...]] = field(default_factory=list)
    """By object: the levels of its geometries with surfaces."""
    parent: list[int] = field(default_factory=list)
    """By object: index of the object that it is a part of, or -1."""
    parent_name: list[str] = field(default_factory=list)

    geometry_lod: list[str] = field(default_factory=list)
    geometry_object: list[int] = field(default_factory=list)
    geometry_start: list[int] = field(default_factory=lambda: [0])
    """Geometry i has the polygons ``[start[i], start[i + 1])``; none if it is an instance."""
    corner_start: list[int] = field(default_factory=lambda: [0])
    """And these corners."""

    def add(
        self, batches: Iterable[list[tuple[str, Any]]], first_vertex: int, n_vertices: int
    ) -> None:
        """Take the objects of one document, whose vertices begin at `first_vertex`.

        Raises
        ------
        InputError
            Naming the object.
        """
        first_object, first_corner = len(self.names), len(self.surfaces.corners)
        stated: dict[int, list[str]] = {}
        by_child: dict[str, str] = {}
        for batch in batches:
            for name, described in batch:
                i = len(self.names)
                try:
                    self._add_object(name, described, first_vertex, n_vertices)
                    if described.keys().isdisjoint(_RELATIONS):
                        continue
                    stated[i] = _parents_of(described)
                    for child in _children_of(described):
                        by_child.setdefault(child, name)
                except MalformedError as problem:
                    raise InputError(f'{self.path}: object "{shown(name)}": {problem}.') from None
        self._check_corners(first_corner, n_vertices)
        self._link(first_object, stated, by_child)

    def _add_object(self, name: str, described: Any, first_vertex: int, n_vertices: int) -> None:
        """Take one object and its geometries."""
        if not isinstance(described, dict):
            raise MalformedError(f"it is {shown(repr(described))}, not an object with a type")
        kind = described.get("type")
        geometries = described.get("geometry") or []
        if not isinstance(geometries, list) or not set(map(type, geometries)) <= {dict}:
            raise MalformedError("its geometry is not a list of geometries")
        lods = []
        for geometry in geometries:
            if self._add_geometry(geometry, first_vertex, n_vertices):
                lods.append(self.geometry_lod[-1])
        self.names.append(name)
        self.types.append(kind if isinstance(kind, str) else "")
        self.lods.append(tuple(lods))

    def _add_geometry(self, geometry: dict[str, Any], first_vertex: int, n_vertices: int) -> bool:
        """Take one geometry; say whether it has surfaces."""
        kind = type_of(geometry)
        if kind in DEPTH:
            self.surfaces.add(geometry, kind, self.surface_names)
            lod = lod_of(geometry)
        elif kind == "GeometryInstance":
            number = len(self.geometry_lod)
            found = self.templates.instance(geometry, number, n_vertices)
            self.instances.append(found._replace(vertex=first_vertex + found.vertex))
            lod = self.templates.lods[found.template]
        elif kind in NO_SURFACE:
            self.left_out[kind] += 1
            return False
        else:
            raise unknown_type(geometry)
        self.geometry_lod.append(lod)
        self.geometry_object.append(len(self.names))
        self.geometry_start.append(len(self.surfaces))
        self.corner_start.append(len(self.surfaces.corners))
        return True

    def _check_corners(self, first_corner: int, n_vertices: int) -> None:
        """Raise `InputError` at the first corner of a document that no vertex has."""
        corners = np.array(self.surfaces.corners[first_corner:], np.uint32)
        if corners.size == 0 or corners.max() < n_vertices:
            return
        bad = int(np.argmax(corners >= n_vertices))
        geometry = bisect_right(self.corner_start, first_corner + bad) - 1
        name = self.names[self.geometry_object[geometry]]
        raise InputError(
            f'{self.path}: object "{shown(name)}": its boundaries refer to vertex {corners[bad]}, '
            f"but there are {n_vertices} vertices, counted from 0."
        )

    def _link(
        self, first_object: int, stated: dict[int, list[str]], by_child: dict[str, str]
    ) -> None:
        """Find the parents of the objects from `first_object` on, which is one document."""
        index = {name: i for i, name in enumerate(self.names[first_object:], first_object)}
        for i in range(first_object, len(self.names)):
            parents = stated.get(i, [])
            if not parents and self.names[i] in by_child:
                parents = [by_child[self.names[i]]]
            # A group is a selection, not a whole.
            parents = [p for p in parents if p not in index or self.types[index[p]] != _GROUP]
            self.parent_name.append(parents[0] if parents else "")
            self.parent.append(index.get(parents[0], -1) if parents else -1)


def _parents_of(described: dict[str, Any]) -> list[str]:
    """Return the names of the parents that an object states."""
    parents = described.get("parents") or described.get("parent") or []
    return _texts([parents] if isinstance(parents, str) else parents)


def _children_of(described: dict[str, Any]) -> list[str]:
    """Return the names of the parts that an object states."""
    if described.get("type") == _GROUP:
        return []
    return [child for key in _CHILDREN if key in described for child in _texts(described[key])]


def _texts(values: Any) -> list[str]:
    """Return the texts of a list; none of what is no list."""
    return [v for v in values if isinstance(v, str)] if isinstance(values, list) else []
