"""What is exported: the mesh of a cache in source coordinates, with all it is called."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from svprep.model import (
    BOOL,
    F32,
    F64,
    I32,
    I64,
    U8,
    U32,
    ComponentFlag,
    FaceFindings,
    Grid,
    Prepared,
    SourceFile,
    SourceMesh,
)
from svprep.repair.grid import choose_grid

if TYPE_CHECKING:
    from svprep.cache.reader import Cache


@dataclass(frozen=True, slots=True, eq=False)
class City:
    """The repaired mesh of a cache; vertices and faces grouped by object."""

    grid: Grid
    positions: F32
    """``(n_vertices, 3)`` [m] in the cache frame."""
    faces: U32
    """``(n_faces, 3)``"""
    object_vertex_start: I64
    object_face_start: I64
    """``(n_objects + 1,)``"""
    names: tuple[str, ...]
    types: tuple[str, ...]
    parents: tuple[str, ...]
    source_of: U32
    """``(n_objects,)``: index into `sources`."""
    is_solid: BOOL
    """``(n_objects,)``: one component, and this one a solid."""
    surface_names: tuple[str, ...]
    surface_of_face: U8
    sources: tuple[SourceFile, ...]
    crs: str
    digest: str
    """The cache's content digest."""

    @property
    def steps(self) -> I32:
        """``(n_vertices, 3)``: positions in grid steps from the origin, exact."""
        return np.rint(self.positions.astype(np.float64) / self.grid.step_m).astype(np.int32)

    @property
    def source_positions(self) -> F64:
        """``(n_vertices, 3)`` [m] in source coordinates, exact."""
        return self.grid.origin_m + self.positions

    @property
    def is_used(self) -> BOOL:
        """``(n_vertices,)``: whether a face uses the vertex."""
        used = np.zeros(len(self.positions), bool)
        used[self.faces.reshape(-1)] = True
        return used

    @property
    def has_faces(self) -> BOOL:
        """``(n_objects,)``."""
        return np.diff(self.object_face_start) > 0


def city_of(cache: Cache | Prepared, digest: str = "") -> City:
    """Return what is exported of `cache`, whose content has this digest. O(n)."""
    mesh, parts, labels = cache.mesh, cache.components, cache.labels
    n_components = np.diff(parts.object_start)
    is_solid = n_components == 1
    first = parts.object_start[:-1][is_solid]
    is_solid[is_solid] = parts.flags[first] & ComponentFlag.SOLID != 0
    return City(
        grid=mesh.grid,
        positions=mesh.positions,
        faces=mesh.faces,
        object_vertex_start=mesh.object_vertex_start,
        object_face_start=mesh.object_face_start,
        names=cache.object_names,
        types=labels.object_types,
        parents=labels.object_parents,
        source_of=cache.object_source,
        is_solid=is_solid,
        surface_names=labels.surface_names,
        surface_of_face=labels.surface_of_face,
        sources=cache.sources,
        crs=cache.place.crs,
        digest=digest,
    )


def has_grid_of_a_build(city: City) -> bool:
    """Whether a build of the exported mesh chooses the grid that it lies on.

    It does, save where the cache's build saw more: a face without area that reached
    farther out than all that stayed, or a position that was not on the grid yet.
    """
    used = city.positions[city.is_used]
    if len(used) == 0:
        return True
    corners = city.grid.origin_m + np.stack([used.min(axis=0), used.max(axis=0)])
    nothing = np.empty(0, np.uint32)
    box = SourceMesh(
        positions=corners,
        faces=np.array([[0, 1, 0]], np.uint32),
        object_face_start=np.array([0, 1], np.int64),
        source_face=np.zeros(1, np.uint32),
        object_names=("the whole",),
        object_source=np.zeros(1, np.uint32),
        sources=city.sources[:1],
        face_findings=FaceFindings(nothing.astype(np.uint16), nothing, nothing),
        notes=(),
    )
    again = choose_grid(box)
    return again.step_m == city.grid.step_m and np.array_equal(again.origin_m, city.grid.origin_m)


def distinct(names: list[str]) -> list[str]:
    """Return names that are all different: the first of equal ones stays, others get ``~2``."""
    taken = set(names)
    seen: set[str] = set()
    unique = []
    for name in names:
        candidate, n = name, 2
        while candidate in seen or (candidate != name and candidate in taken):
            candidate, n = f"{name}~{n}", n + 1
        seen.add(candidate)
        unique.append(candidate)
    return unique
