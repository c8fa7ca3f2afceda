"""Geometry templates of CityJSON: a shape stored once and placed by a matrix each time.

An instance stands at ``matrix (x, y, z, 1) + vertex``: the template's vertices, in metres and
untransformed, turned, scaled and moved by the matrix, about one vertex of the file. Where that
vertex is in degrees, the metres become degrees of the ellipsoid there, as in CityGML.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from svprep.errors import InputError
from svprep.ingest.citygml_places import place
from svprep.ingest.cityjson_axes import is_in_degrees, is_north_first
from svprep.ingest.cityjson_geometry import (
    DEPTH,
    NO_SURFACE,
    MalformedError,
    Surfaces,
    type_of,
    unknown_type,
)
from svprep.ingest.parsed import refuse_non_finite, shown
from svprep.ingest.surface_names import SurfaceNames
from svprep.model import F64, I64, U8, U32

# Corners of all instances together: more is no city, but a small file that asks for gigabytes.
_ALWAYS_PLACED: Final = 5_000_000
_MOST_PER_BYTE: Final = 4  # as many more for every byte of the file; an instance takes a hundred
_MOST_PLACED: Final = 1 << 27


class Instance(NamedTuple):
    """One use of a template."""

    geometry: int
    """Index among the geometries of the file."""
    template: int
    vertex: int
    """Where it stands."""
    matrix: tuple[float, ...]
    """16 numbers, row by row."""


class PlacedSurfaces(NamedTuple):
    """Polygons of instances; corners count from the first of `positions`."""

    positions: F64
    corners: U32
    ring_size: U32
    n_rings: U32
    name: U8
    geometry: I64
    """``(n_polygons,)``"""


@dataclass(slots=True)
class Templates:
    """The templates of a file."""

    vertices: F64 = field(default_factory=lambda: np.zeros((0, 3)))
    surfaces: Surfaces = field(default_factory=Surfaces)
    lods: list[str] = field(default_factory=list)
    """By template."""
    start: list[int] = field(default_factory=lambda: [0])
    """Template i has the polygons ``[start[i], start[i + 1])``."""

    def add(self, template: Any, lod: str, names: SurfaceNames) -> None:
        """Take one template.

        Raises
        ------
        MalformedError
        """
        kind = type_of(template)
        if kind == "GeometryInstance":
            raise MalformedError("it is itself an instance of a template")
        if kind in DEPTH:
            self.surfaces.add(template, kind, names)
        elif kind not in NO_SURFACE:
            raise unknown_type(template)
        self.lods.append(lod)
        self.start.append(len(self.surfaces))

    def check(self, path: Path) -> None:
        """Raise `InputError` for an index past the end of the templates' vertices."""
        corners = np.array(self.surfaces.corners, np.uint32)
        if corners.size and corners.max() >= len(self.vertices):
            raise InputError(
                f"{path}: a geometry template refers to vertex {corners.max()}, but there are "
                f"{len(self.vertices)} in vertices-templates."
            )

    def instance(self, geometry: dict[str, Any], number: int, n_vertices: int) -> Instance:
        """Return what a geometry of type GeometryInstance says.

        Raises
        ------
        MalformedError
        """
        template, boundaries = geometry.get("template"), geometry.get("boundaries")
        if type(template) is not int or not 0 <= template < len(self.lods):
            raise MalformedError(
                f"it uses the geometry template {shown(template)}, but there are {len(self.lods)}"
            )
        vertex = boundaries[0] if isinstance(boundaries, list) and len(boundaries) == 1 else None
        if type(vertex) is not int or not 0 <= vertex < n_vertices:
            raise MalformedError(
                f"the boundaries of its GeometryInstance are {shown(boundaries)}, not one of the "
                f"{n_vertices} vertices"
            )
        matrix = geometry.get("transformationMatrix")
        if matrix is None:
            matrix = np.eye(4).ravel().tolist()
        is_matrix = (
            isinstance(matrix, list)
            and len(matrix) == 16
            and all(type(m) in (int, float) for m in matrix)
            and all(abs(m) < 1e300 for m in matrix)
        )
        if not is_matrix or matrix[12:15] != [0, 0, 0] or matrix[15] == 0:
            raise MalformedError(
                "its transformationMatrix is not 16 finite numbers, the last row 0 0 0 1"
            )
        return Instance(number, template, vertex, tuple(m / matrix[15] for m in matrix))

    def placed(
        self, instances: list[Instance], positions: F64, crs: str, n_bytes: int, path: Path
    ) -> PlacedSurfaces:
        """Return the polygons of instances, template by template.

        Parameters
        ----------
        instances
            Their vertices index `positions`.
        crs
            Of the positions.
        n_bytes
            Of the file.
        path
            For messages.

        Raises
        ------
        InputError
            More corners than a file of that size asks for.
        """
        n_corners = np.concatenate([[0], np.cumsum(np.array(self.surfaces.ring_size, np.int64))])
        ring_start = np.concatenate([[0], np.cumsum(np.array(self.surfaces.n_rings, np.int64))])
        corner_of_template = n_corners[ring_start[self.start]]
        by_template: dict[int, list[Instance]] = {}
        for instance in instances:
            by_template.setdefault(instance.template, []).append(instance)
        total = sum(
            len(uses) * int(np.diff(corner_of_template)[t]) for t, uses in by_template.items()
        )
        most = min(_ALWAYS_PLACED + _MOST_PER_BYTE * n_bytes, _MOST_PLACED)
        if total > most:
            raise InputError(
                f"{path}: {len(instances)} instances of geometry templates have {total} corners; "
                f"of a file of {n_bytes} bytes at most {most} are read. Split the file, or "
                "simplify its templates."
            )
        stands = positions[[instance.vertex for instance in instances]]
        xyz = [1, 0, 2] if is_north_first(stands, crs) else [0, 1, 2]
        in_degrees = is_in_degrees(crs)
        parts = []
        first_vertex = 0
        for t, uses in by_template.items():
            polygons = slice(self.start[t], self.start[t + 1])
            rings = slice(int(ring_start[polygons.start]), int(ring_start[polygons.stop]))
            corners = np.array(
                self.surfaces.corners[corner_of_template[t] : corner_of_template[t + 1]], np.int64
            )
            used, local = np.unique(corners, return_inverse=True)
            matrices = np.array([use.matrix for use in uses]).reshape(-1, 4, 4)
            points = place(
                np.tile(self.vertices[used], (len(uses), 1)),
                np.repeat(np.arange(len(uses)), used.size),
                matrices[:, :3],
                positions[[use.vertex for use in uses]][:, xyz],
                in_degrees=in_degrees,
            )
            first = first_vertex + np.arange(len(uses))[:, None] * used.size
            first_vertex += len(uses) * used.size
            n = len(uses)
            parts.append(
                PlacedSurfaces(
                    points[:, xyz],
                    (local.ravel() + first).ravel().astype(np.uint32),
                    np.tile(np.array(self.surfaces.ring_size[rings], np.uint32), n),
                    np.tile(np.array(self.surfaces.n_rings[polygons], np.uint32), n),
                    np.tile(np.frombuffer(bytes(self.surfaces.name[polygons]), np.uint8), n),
                    np.repeat([use.geometry for use in uses], polygons.stop - polygons.start),
                )
            )
        placed = PlacedSurfaces(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
        refuse_non_finite(placed.positions, path, "instances of geometry templates")
        return placed
