"""Buildings: one function per shape.

Each returns a mesh around (0, 0) whose ground level is z = 0 and whose floor
lies `SUNK_M` below it. Functions that know a defect of their own shape take a
flag for it; without the flag the mesh is closed, outward and clean.
"""

from __future__ import annotations

import numpy as np

from city_generator.mesh import F64, Polygon, PolyMesh, circle, loft, prism, rectangle, turned_over

SUNK_M = 0.6
"""How deep a building's floor lies below the lowest ground at its footprint [m]."""


def flat_roof(width_m: float, depth_m: float, height_m: float) -> PolyMesh:
    """Return a plain box."""
    return prism(rectangle(width_m, depth_m), -SUNK_M, height_m)


def row(
    width_m: float,
    depth_m: float,
    eaves_m: float,
    rise_m: float,
    units: int = 1,
    inner_walls: int = 0,
    walls_match: bool = True,
) -> PolyMesh:
    r"""Return `units` houses in a row, gabled if ``rise_m > 0``.

    ridge          one profile per station, units between stations
     /\
    /  \ eaves     inner_walls = 0: one shell
    |  |           inner_walls = 1: single partitions, three faces on their edges
    |__|           inner_walls = 2: each house closed, party walls twice, opposite,
                   cut into the same triangles if walls_match
    """
    d = depth_m / 2
    profile = [[d, -SUNK_M], [d, eaves_m], [-d, eaves_m], [-d, -SUNK_M]]
    if rise_m > 0:
        profile.insert(2, [0.0, eaves_m + rise_m])
    k = len(profile)
    stations = np.linspace(-width_m / 2, width_m / 2, units + 1)
    vertices = np.array([[x, y, z] for x in stations for y, z in profile])
    polygons: list[Polygon] = []
    for u in range(units):
        a, b = u * k, (u + 1) * k
        polygons += [[a + i, a + (i + 1) % k, b + (i + 1) % k, b + i] for i in range(k)]
    for u in range(units + 1):
        looks_on = list(range(u * k, u * k + k))
        looks_back = turned_over(looks_on) if walls_match else looks_on[::-1]
        if u == 0:
            polygons.append(looks_back)
        elif u == units:
            polygons.append(looks_on)
        else:
            polygons += [looks_on, looks_back][:inner_walls]
    return PolyMesh(vertices, polygons)


def hipped(width_m: float, depth_m: float, eaves_m: float, rise_m: float) -> PolyMesh:
    """Return a house with a hipped roof, or a pyramid where it is square."""
    shell = prism(rectangle(width_m, depth_m), -SUNK_M, eaves_m)
    half_ridge = max((width_m - depth_m) / 2, 0.0)
    top = eaves_m + rise_m
    walls = shell.polygons[:-1]
    if half_ridge < 0.5:
        vertices = np.vstack([shell.vertices, [0.0, 0.0, top]])
        return PolyMesh(vertices, [*walls, *([4 + i, 4 + (i + 1) % 4, 8] for i in range(4))])
    vertices = np.vstack([shell.vertices, [-half_ridge, 0.0, top], [half_ridge, 0.0, top]])
    roof = [[4, 5, 9, 8], [5, 6, 9], [6, 7, 8, 9], [7, 4, 8]]
    return PolyMesh(vertices, [*walls, *roof])


def l_shape(width_m: float, depth_m: float, height_m: float, wing_m: float) -> PolyMesh:
    """Return an L-shaped prism; floor and roof are concave hexagons."""
    w, d = width_m / 2, depth_m / 2
    footprint = [[-w, -d], [w, -d], [w, wing_m - d], [wing_m - w, wing_m - d]]
    return prism(np.array([*footprint, [wing_m - w, d], [-w, d]]), -SUNK_M, height_m)


def u_shape(width_m: float, depth_m: float, height_m: float, wing_m: float) -> PolyMesh:
    """Return a U-shaped prism; floor and roof are concave octagons."""
    w, d = width_m / 2, depth_m / 2
    inner = [[w - wing_m, wing_m - d], [wing_m - w, wing_m - d]]
    footprint = [[-w, -d], [w, -d], [w, d], [w - wing_m, d], *inner, [wing_m - w, d], [-w, d]]
    return prism(np.array(footprint), -SUNK_M, height_m)


def courtyard(
    width_m: float, depth_m: float, height_m: float, wing_m: float, slip_m: float = 0.0
) -> PolyMesh:
    """Return a ring around a court; `slip_m` > `wing_m` pushes the court through a wall."""
    outer = rectangle(width_m, depth_m)
    inner = rectangle(width_m - 2 * wing_m, depth_m - 2 * wing_m, slip_m, 0.0)
    levels = [(outer, -SUNK_M), (outer, height_m), (inner, height_m), (inner, -SUNK_M)]
    vertices = np.concatenate([np.column_stack([f, np.full(4, z)]) for f, z in levels])
    polygons = [
        [4 * r + i, 4 * r + (i + 1) % 4, 4 * s + (i + 1) % 4, 4 * s + i]
        for r, s in ((0, 1), (1, 2), (2, 3), (3, 0))
        for i in range(4)
    ]
    return PolyMesh(vertices, polygons)


def stacked(footprints: list[F64], tops_m: list[float], *, touching: bool = False) -> PolyMesh:
    """Return storeys set back on each other, as one shell.

    With `touching` each storey is a closed solid of its own: the roof under it
    and its floor are opposite faces, with four faces on each edge around them.
    """
    rings, heights = [footprints[0]], [-SUNK_M]
    for footprint, top in zip(footprints, tops_m, strict=True):
        if len(rings) > 1:
            rings.append(footprint)
            heights.append(heights[-1])
        rings.append(footprint)
        heights.append(top)
    shell = loft(rings, heights)
    if not touching:
        return shell
    n = len(footprints[0])
    walls: list[Polygon] = []
    for storey in range(1, len(footprints)):
        roof_below = list(range(2 * storey * n, (2 * storey + 1) * n))
        walls += [roof_below, turned_over(roof_below)]
    return PolyMesh(shell.vertices, shell.polygons + walls)


def rotunda(radius_m: float, height_m: float, sides: int, dome_rings: int) -> PolyMesh:
    """Return a round building: flat (``dome_rings == 0``), or under a dome."""
    if dome_rings == 0:
        return prism(circle(radius_m, sides), -SUNK_M, height_m)
    angles = np.arange(dome_rings) * (np.pi / 2 / dome_rings)
    footprints = [circle(radius_m, sides)]
    footprints += [circle(float(radius_m * np.cos(a)), sides) for a in angles]
    heights = [-SUNK_M] + [float(height_m + radius_m * np.sin(a)) for a in angles]
    return loft(footprints, heights, apex_m=height_m + radius_m)


def gridded(
    width_m: float, depth_m: float, height_m: float, cell_m: float, *, windows: bool
) -> PolyMesh:
    """Return a box with walls of cells, each a quad or a window set back 0.25 m.

    Floor and roof are fans about a middle vertex, so that no triangle is
    degenerate however the outline is subdivided.
    """
    corners = rectangle(width_m, depth_m)
    outline: list[F64] = []
    inward: list[F64] = []
    for i in range(4):
        a, b = corners[i], corners[(i + 1) % 4]
        length = float(abs(b - a).sum())
        n = max(int(length / cell_m), 1)
        outline += [a + (b - a) * (j / n) for j in range(n)]
        inward += [np.array([a[1] - b[1], b[0] - a[0]]) / length] * n
    columns, rows = len(outline), max(int(height_m / 3.2), 1)
    levels = np.concatenate([[-SUNK_M], np.linspace(0.0, height_m, rows + 1)[1:]])
    vertices = [[*p, z] for z in levels.tolist() for p in outline]
    polygons: list[Polygon] = []
    for r in range(rows):
        for c in range(columns):
            d = (c + 1) % columns
            cell = [i * columns + j for i, j in ((r, c), (r, d), (r + 1, d), (r + 1, c))]
            if windows and r > 0:
                polygons += _window(vertices, cell, inward[c])
            else:
                polygons.append(cell)
    middle, top = len(vertices), rows * columns
    vertices += [[0.0, 0.0, -SUNK_M], [0.0, 0.0, height_m]]
    for c in range(columns):
        d = (c + 1) % columns
        polygons += [[middle, d, c], [middle + 1, top + c, top + d]]
    return PolyMesh(np.array(vertices, dtype=np.float64), polygons)


def _window(vertices: list[list[float]], cell: Polygon, inward: F64) -> list[Polygon]:
    """Append the window's eight vertices; return frame, reveal and pane."""
    at = np.array([vertices[i] for i in cell])
    opening = at.mean(axis=0) + (at - at.mean(axis=0)) * [0.55, 0.55, 0.5]
    start = len(vertices)
    vertices += opening.tolist()
    vertices += (opening + [*(0.25 * inward), 0.0]).tolist()
    polygons: list[Polygon] = []
    for i in range(4):
        j = (i + 1) % 4
        polygons.append([cell[i], cell[j], start + j, start + i])
        polygons.append([start + i, start + j, start + 4 + j, start + 4 + i])
    return [*polygons, [start + 4, start + 5, start + 6, start + 7]]
