"""Defects: functions that damage a clean mesh, and what each of them is called.

`PLANTED` names every kind that the city plants, with the codes that ``svprep``
gives it. Kinds that are a shape's own (party walls, open terrain) are planted
by the shape's function; the rest are functions ``(mesh, rng) -> mesh`` here.
None of them moves a surface by more than a millimetre, except those that say so.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from city_generator.mesh import Polygon, PolyMesh, merged, turned_over

PLANTED: Final[dict[str, tuple[str, ...]]] = {
    "terrain_border": ("OPEN_SHELL",),
    "leaf_soup": ("OPEN_SHELL",),
    "partition_wall": ("NONMANIFOLD_EDGE",),
    "party_wall": ("OPPOSITE_FACE", "NONMANIFOLD_EDGE"),
    "party_wall_recut": ("NONMANIFOLD_EDGE",),
    "touching_solids": ("OPPOSITE_FACE", "NONMANIFOLD_EDGE"),
    "touching_boxes": ("OPPOSITE_FACE", "NONMANIFOLD_EDGE"),
    "two_sided_sheet": ("OPPOSITE_FACE", "FLAT_COMPONENT"),
    "moebius": ("CUT_EDGE", "OPEN_SHELL"),
    "self_intersecting": ("SELF_INTERSECTION",),
    "near_coplanar": (),
    "nested_solid": (),
    "t_junction": ("OPEN_SHELL",),
    "no_ground_face": ("OPEN_SHELL",),
    "missing_wall": ("OPEN_SHELL",),
    "flipped_patch": ("FLIPPED_FACE",),
    "inside_out": ("FLIPPED_FACE", "INVERTED_COMPONENT"),
    "duplicate_faces": ("DUPLICATE_FACE",),
    "opposite_faces": ("OPPOSITE_FACE", "NONMANIFOLD_EDGE"),
    "zero_area_repeated": ("SHORT_POLYGON",),
    "zero_area_collinear": ("DEGENERATE_FACE",),
    "tiny_face": ("COLLAPSED_FACE",),
    "unwelded": ("UNWELDED_VERTEX",),
    "short_polygon": ("SHORT_POLYGON",),
    "nonplanar_polygon": ("NONPLANAR_POLYGON",),
    "self_crossing_polygon": ("SELF_CROSSING_POLYGON",),
}
"""Kind of defect -> names of the codes that it causes; none where a mesh is only unusual."""

Damage = Callable[[PolyMesh, np.random.Generator], PolyMesh]


def near_coplanar(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Push every vertex by 0.1 to 1 mm in x and y: facades no longer quite flat."""
    shape = (len(mesh.vertices), 2)
    push = rng.uniform(1e-4, 1e-3, shape) * rng.choice([-1.0, 1.0], shape)
    return PolyMesh(mesh.vertices + np.column_stack([push, np.zeros(shape[0])]), mesh.polygons)


def nested_solid(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Put a copy of half the size inside; the mesh must be convex."""
    middle = mesh.vertices.mean(axis=0)
    return merged([mesh, PolyMesh(middle + (mesh.vertices - middle) * 0.5, mesh.polygons)])


def t_junction(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Split one quad across, leaving its neighbours' edges whole."""
    quads = [i for i, p in enumerate(mesh.polygons) if len(p) == 4]
    i = int(rng.choice(quads))
    a, b, c, d = mesh.polygons[i]
    v, n = mesh.vertices, len(mesh.vertices)
    vertices = np.vstack([v, (v[b] + v[c]) / 2, (v[d] + v[a]) / 2])
    halves: list[Polygon] = [[a, b, n, n + 1], [n + 1, n, c, d]]
    return PolyMesh(vertices, [*mesh.polygons[:i], *halves, *mesh.polygons[i + 1 :]])


def no_ground_face(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Remove every polygon that lies on the lowest level."""
    floor = mesh.vertices[:, 2] <= mesh.vertices[:, 2].min() + 1e-6
    return PolyMesh(mesh.vertices, [p for p in mesh.polygons if not all(floor[c] for c in p)])


def missing_wall(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Remove one upright quad."""
    x, y, _ = mesh.vertices.T
    upright = [
        i
        for i, p in enumerate(mesh.polygons)
        if len(p) == 4 and len({(round(x[c], 6), round(y[c], 6)) for c in p}) == 2
    ]
    i = int(rng.choice(upright if upright else range(len(mesh.polygons))))
    return PolyMesh(mesh.vertices, mesh.polygons[:i] + mesh.polygons[i + 1 :])


def flipped_patch(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Reverse a connected minority of the polygons."""
    around: dict[frozenset[int], list[int]] = {}
    for i, p in enumerate(mesh.polygons):
        for j, c in enumerate(p):
            around.setdefault(frozenset((p[j - 1], c)), []).append(i)
    n = len(mesh.polygons)
    size = int(rng.integers(1, max(n // 4, 1) + 1))
    patch = [int(rng.integers(n))]
    for i in patch:
        p = mesh.polygons[i]
        for j, c in enumerate(p):
            for other in around[frozenset((p[j - 1], c))]:
                if other not in patch and len(patch) < size:
                    patch.append(other)
    flip = set(patch)
    return PolyMesh(
        mesh.vertices, [p[::-1] if i in flip else p for i, p in enumerate(mesh.polygons)]
    )


def inside_out(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Reverse every polygon."""
    return PolyMesh(mesh.vertices, [p[::-1] for p in mesh.polygons])


def duplicate_faces(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Repeat some polygons; a triangle's first corner is moved on by one."""
    extra = [mesh.polygons[i] for i in _some(mesh, rng)]
    return PolyMesh(
        mesh.vertices, mesh.polygons + [p[1:] + p[:1] if len(p) == 3 else p for p in extra]
    )


def opposite_faces(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Repeat some polygons turned over."""
    extra = [mesh.polygons[i] for i in _some(mesh, rng)]
    return PolyMesh(mesh.vertices, mesh.polygons + [turned_over(p) for p in extra])


def zero_area_repeated(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Add triangles that name one corner twice."""
    extra = [[p[0], p[1], p[1]] for p in (mesh.polygons[i] for i in _some(mesh, rng))]
    return PolyMesh(mesh.vertices, mesh.polygons + extra)


def zero_area_collinear(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Add a triangle whose third corner lies on an upright edge.

    Upright edges stay exactly straight in decimals; the middle of any other
    edge would be rounded off it.
    """
    v = mesh.vertices
    upright = [
        (p[j - 1], c)
        for p in mesh.polygons
        for j, c in enumerate(p)
        if v[p[j - 1], 0] == v[c, 0] and v[p[j - 1], 1] == v[c, 1] and p[j - 1] != c
    ]
    a, b = upright[int(rng.integers(len(upright)))] if upright else mesh.polygons[0][:2]
    vertices = np.vstack([v, (v[a] + v[b]) / 2])
    return PolyMesh(vertices, [*mesh.polygons, [a, len(v), b]])


def tiny_face(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Add a triangle of 0.004 mm at a vertex: area in the source, none on a grid."""
    at = mesh.vertices[int(rng.integers(len(mesh.vertices)))]
    n = len(mesh.vertices)
    near = at + np.array([[0.0, 0.0, 0.0], [4e-6, 0.0, 0.0], [0.0, 4e-6, 0.0]])
    return PolyMesh(np.vstack([mesh.vertices, near]), [*mesh.polygons, [n, n + 1, n + 2]])


def unwelded(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Give every polygon vertices of its own."""
    corners = [c for p in mesh.polygons for c in p]
    polygons: list[Polygon] = []
    start = 0
    for p in mesh.polygons:
        polygons.append(list(range(start, start + len(p))))
        start += len(p)
    return PolyMesh(mesh.vertices[corners], polygons)


def short_polygon(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Add a polygon of two corners."""
    return PolyMesh(mesh.vertices, [*mesh.polygons, mesh.polygons[0][:2]])


def nonplanar_polygon(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Raise one corner of the roof, the last polygon, by 0.3 to 0.9 m."""
    vertices = mesh.vertices.copy()
    vertices[mesh.polygons[-1][0], 2] += rng.uniform(0.3, 0.9)
    return PolyMesh(vertices, mesh.polygons)


def self_crossing_polygon(mesh: PolyMesh, rng: np.random.Generator) -> PolyMesh:
    """Name two corners of the roof, the last polygon, in the wrong order: a bow tie."""
    a, b, c, *more = mesh.polygons[-1]
    return PolyMesh(mesh.vertices, [*mesh.polygons[:-1], [a, c, b, *more]])


def _some(mesh: PolyMesh, rng: np.random.Generator) -> list[int]:
    """Return one to four polygons, each once, in order."""
    n = len(mesh.polygons)
    return sorted(rng.choice(n, size=min(n, int(rng.integers(1, 5))), replace=False).tolist())


ON_POLYGONS: Final[dict[str, Damage]] = {
    "near_coplanar": near_coplanar,
    "nested_solid": nested_solid,
    "t_junction": t_junction,
    "no_ground_face": no_ground_face,
    "missing_wall": missing_wall,
    "nonplanar_polygon": nonplanar_polygon,
    "self_crossing_polygon": self_crossing_polygon,
}
"""Applied to a shape's own polygons, before they are cut into triangles."""

ON_FACES: Final[dict[str, Damage]] = {
    "flipped_patch": flipped_patch,
    "inside_out": inside_out,
    "duplicate_faces": duplicate_faces,
    "opposite_faces": opposite_faces,
    "zero_area_repeated": zero_area_repeated,
    "zero_area_collinear": zero_area_collinear,
    "tiny_face": tiny_face,
    "unwelded": unwelded,
    "short_polygon": short_polygon,
}
"""Applied to the polygons or triangles that are written."""

NEEDS_POLYGONS: Final = frozenset({"nonplanar_polygon", "self_crossing_polygon"})
"""Lost if the object is written in triangles."""

NEEDS_SIX_DECIMALS: Final = frozenset({"tiny_face"})
"""Lost if the object is written in millimetres."""
