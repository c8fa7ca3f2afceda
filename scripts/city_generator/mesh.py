"""Polygon meshes and the few shapes from which everything in the city is made.

All shapes are closed and wound outward (counter-clockwise seen from outside)
unless a docstring says otherwise. Coordinates are metres, +z up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]
Polygon = list[int]


@dataclass(frozen=True, slots=True)
class PolyMesh:
    """Vertices and polygons of one object."""

    vertices: F64
    """``(n, 3)`` [m]."""
    polygons: list[Polygon]
    """Corners of each polygon, 0-based."""

    @property
    def n_triangles(self) -> int:
        """Triangles after fan triangulation; polygons of two corners have none."""
        return sum(max(len(p) - 2, 0) for p in self.polygons)


def turned_over(polygon: Polygon) -> Polygon:
    """Return `polygon` reversed from its first corner on, so that both fans match."""
    return polygon[:1] + polygon[:0:-1]


def merged(meshes: Iterable[PolyMesh]) -> PolyMesh:
    """Return the meshes side by side in one object; nothing is welded."""
    vertices: list[F64] = []
    polygons: list[Polygon] = []
    start = 0
    for mesh in meshes:
        vertices.append(mesh.vertices)
        polygons.extend([start + c for c in p] for p in mesh.polygons)
        start += len(mesh.vertices)
    return PolyMesh(np.concatenate(vertices), polygons)


def moved(mesh: PolyMesh, yaw_rad: float, offset_m: ArrayLike) -> PolyMesh:
    """Return `mesh` turned about +z by `yaw_rad`, then moved by `offset_m`."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = mesh.vertices.T
    turned = np.column_stack([c * x - s * y, s * x + c * y, z])
    return PolyMesh(turned + np.asarray(offset_m, dtype=np.float64), mesh.polygons)


def rectangle(width_m: float, depth_m: float, x: float = 0.0, y: float = 0.0) -> F64:
    """Return a ``(4, 2)`` rectangle centred on (x, y), counter-clockwise."""
    w, d = width_m / 2, depth_m / 2
    return np.array([[x - w, y - d], [x + w, y - d], [x + w, y + d], [x - w, y + d]])


def circle(radius_m: float, sides: int, x: float = 0.0, y: float = 0.0) -> F64:
    """Return a ``(sides, 2)`` regular polygon around (x, y), counter-clockwise."""
    angle = np.arange(sides) * (2 * np.pi / sides)
    return np.column_stack([x + radius_m * np.cos(angle), y + radius_m * np.sin(angle)])


def loft(
    footprints: Sequence[F64],
    heights_m: Sequence[float],
    *,
    apex_m: float | None = None,
    nadir_m: float | None = None,
) -> PolyMesh:
    """Return one closed shell through a stack of footprints of equal corner count.

    Each end is one polygon, or a fan to the point at `apex_m` (top) or
    `nadir_m` (bottom) above the footprint's mean. Two rings at one height make
    a ledge.

        apex --- ring k --- ... --- ring 1 --- ring 0 --- floor
    """
    n = len(footprints[0])
    rings = [
        np.column_stack([f, np.full(n, h)]) for f, h in zip(footprints, heights_m, strict=True)
    ]
    polygons: list[Polygon] = []
    for r in range(len(rings) - 1):
        a, b = r * n, (r + 1) * n
        polygons += [[a + i, a + (i + 1) % n, b + (i + 1) % n, b + i] for i in range(n)]
    top, end = (len(rings) - 1) * n, len(rings) * n
    if nadir_m is None:
        polygons.append(list(range(n - 1, -1, -1)))
    else:
        rings.append(np.array([[*footprints[0].mean(axis=0), nadir_m]]))
        polygons += [[end, (i + 1) % n, i] for i in range(n)]
        end += 1
    if apex_m is None:
        polygons.append(list(range(top, top + n)))
    else:
        rings.append(np.array([[*footprints[-1].mean(axis=0), apex_m]]))
        polygons += [[top + i, top + (i + 1) % n, end] for i in range(n)]
    return PolyMesh(np.concatenate(rings), polygons)


def prism(footprint: F64, bottom_m: float, top_m: float) -> PolyMesh:
    """Return the closed prism over `footprint` (any simple polygon, its caps one n-gon)."""
    return loft([footprint, footprint], [bottom_m, top_m])


def box(
    size_m: tuple[float, float, float], at_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> PolyMesh:
    """Return a closed box of six quads; `at_m` is the middle of its floor."""
    return prism(rectangle(size_m[0], size_m[1], at_m[0], at_m[1]), at_m[2], at_m[2] + size_m[2])


def triangulated(mesh: PolyMesh) -> PolyMesh:
    """Return `mesh` in triangles: quads fanned, larger polygons by ear clipping."""
    out: list[Polygon] = []
    for p in mesh.polygons:
        if len(p) <= 3:
            out.append(p)
        elif len(p) == 4:
            out += [[p[0], p[1], p[2]], [p[0], p[2], p[3]]]
        else:
            out += [[p[i] for i in ear] for ear in _clip_ears(mesh.vertices[p])]
    return PolyMesh(mesh.vertices, out)


def _clip_ears(corners: F64) -> list[list[int]]:
    """Triangulate one simple polygon, ``(n, 3)``; a fan where it is convex. O(n^3)."""
    after = np.roll(corners, -1, axis=0)
    normal = np.cross(corners, after).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(corners, axis, axis=1)
    if (normal[axis] < 0) != (axis == 1):
        flat = flat[:, ::-1]
    points: list[list[float]] = flat.tolist()

    def turn(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = points[a], points[b], points[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    n = len(points)
    if all(turn(i - 1, i, (i + 1) % n) > 0 for i in range(n)):
        return [[0, i, i + 1] for i in range(1, n - 1)]
    left = list(range(n))
    ears: list[list[int]] = []
    while len(left) > 3:
        for k, b in enumerate(left):
            a, c = left[k - 1], left[(k + 1) % len(left)]
            others = [q for q in left if q not in (a, b, c)]
            if turn(a, b, c) > 1e-9 and not any(
                turn(a, b, q) >= 0 and turn(b, c, q) >= 0 and turn(c, a, q) >= 0 for q in others
            ):
                break
        else:
            raise ValueError(f"no ear left in a polygon of {n} corners: {points}")
        ears.append([a, b, c])
        del left[k]
    return [*ears, left]
