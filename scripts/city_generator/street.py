"""Trees, street furniture and sculptures: one function per thing.

Each returns a mesh around (0, 0) with its ground level at z = 0.
"""

from __future__ import annotations

import numpy as np

from city_generator.mesh import F64, Polygon, PolyMesh, box, circle, loft, merged, prism, rectangle

FOOT_M = -0.3
"""How deep posts and trunks reach into the ground [m]."""


def trunk(rng: np.random.Generator, height_m: float, radius_m: float) -> PolyMesh:
    """Return a closed, tapering trunk of six or eight sides."""
    sides = int(rng.choice([6, 8]))
    lean = rng.uniform(-0.03, 0.03, 2) * height_m
    top = circle(radius_m * 0.5, sides) + lean
    return loft([circle(radius_m, sides), top], [FOOT_M, height_m])


def tree(rng: np.random.Generator, *, leafy: bool) -> PolyMesh:
    """Return a tree; its crown is loose leaves, or one closed shell if not `leafy`."""
    crown_m = np.array([1.0, 1.0, rng.uniform(0.9, 1.6)]) * rng.uniform(1.4, 2.6)
    stem_m = rng.uniform(1.8, 3.2)
    stem = trunk(rng, stem_m + crown_m[2], rng.uniform(0.12, 0.28))
    middle = np.array([0.0, 0.0, stem_m + crown_m[2]])
    return merged([stem, _leaves(rng, middle, crown_m) if leafy else _crown(middle, crown_m)])


def _crown(middle_m: F64, radii_m: F64) -> PolyMesh:
    """Return a closed ellipsoid of 80 triangles."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, 6)[1:-1]
    footprints = [circle(float(radii_m[0] * np.cos(a)), 10) for a in angles]
    heights = [float(middle_m[2] + radii_m[2] * np.sin(a)) for a in angles]
    ends = (float(middle_m[2] + radii_m[2]), float(middle_m[2] - radii_m[2]))
    return loft(footprints, heights, apex_m=ends[0], nadir_m=ends[1])


def _leaves(rng: np.random.Generator, middle_m: F64, radii_m: F64) -> PolyMesh:
    """Return loose leaf cards, each with vertices of its own: quads, or triangles."""
    n = int(rng.integers(18, 58))
    sides = 4 if rng.random() < 0.85 else 3
    direction = rng.normal(size=(n, 3))
    direction /= np.sqrt((direction**2).sum(axis=1))[:, None]
    depth = 0.35 + 0.65 * np.sqrt(rng.random((n, 1)))
    centre = middle_m + direction * depth * radii_m
    u = rng.normal(size=(n, 3)) * rng.uniform(0.25, 0.4)
    v = np.cross(u, rng.normal(size=(n, 3)))
    v *= 0.7 * np.sqrt((u**2).sum(axis=1) / (v**2).sum(axis=1))[:, None]
    card = [centre - u - v, centre + u - v, centre + u + v, centre - u + v]
    if sides == 3:
        card = [centre - u - v, centre + u - v, centre + v]
    vertices = np.stack(card, axis=1).reshape(-1, 3)
    return PolyMesh(vertices, np.arange(n * sides).reshape(n, sides).tolist())


def lamp(rng: np.random.Generator) -> PolyMesh:
    """Return a street lamp: pole, arm and head, three closed solids."""
    height = float(rng.choice([4.5, 6.0, 8.0]))
    pole = loft([circle(0.09, 8), circle(0.05, 8)], [FOOT_M, height])
    arm = box((1.2, 0.06, 0.06), (0.6, 0.0, height - 0.1))
    head = box((0.6, 0.25, 0.12), (1.3, 0.0, height - 0.2))
    return merged([pole, arm, head])


def bench(rng: np.random.Generator) -> PolyMesh:
    """Return a bench: seat, back and two legs, closed solids that rest on each other."""
    length = rng.uniform(1.4, 2.0)
    legs = [box((0.08, 0.4, 0.75), (s * length * 0.4, 0.0, FOOT_M)) for s in (-1, 1)]
    seat = box((length, 0.45, 0.05), (0.0, 0.0, 0.45))
    back = box((length * 0.96, 0.05, 0.4), (0.0, 0.19, 0.5))
    return merged([*legs, seat, back])


def bollard(rng: np.random.Generator) -> PolyMesh:
    """Return a round bollard, pointed or flat."""
    foot = circle(0.12, int(rng.choice([6, 8, 12])))
    cap = 1.0 if rng.random() < 0.5 else None
    return loft([foot, foot], [FOOT_M, 0.9], apex_m=cap)


def planter(rng: np.random.Generator, *, touching: bool) -> PolyMesh:
    """Return two tubs side by side as one box, or as two that share a wall.

    5---4---3     `touching` adds the middle wall from both sides.
    |   |   |
    0---1---2
    """
    w, d = rng.uniform(0.6, 1.2), rng.uniform(0.5, 0.8)
    outline = np.array([[-w, -d], [0.0, -d], [w, -d], [w, d], [0.0, d], [-w, d]]) / 2
    vertices = prism(outline, FOOT_M, 0.6).vertices
    walls = [[i, (i + 1) % 6, 6 + (i + 1) % 6, 6 + i] for i in range(6)]
    roofs: list[Polygon] = [[6, 7, 10, 11], [7, 8, 9, 10]]
    floors: list[Polygon] = [[5, 4, 1, 0], [4, 3, 2, 1]]
    middle: list[Polygon] = [[1, 4, 10, 7], [1, 7, 10, 4]] if touching else []
    return PolyMesh(vertices, [*walls, *roofs, *floors, *middle])


def kiosk(rng: np.random.Generator) -> PolyMesh:
    """Return a small round kiosk with an overhanging roof, one shell."""
    sides = int(rng.choice([6, 8, 10]))
    r = rng.uniform(0.9, 1.5)
    rings = [circle(r, sides), circle(r, sides), circle(r * 1.25, sides)]
    return loft(rings, [FOOT_M, 2.4, 2.4], apex_m=3.3)


def sign(rng: np.random.Generator, *, flat: bool) -> PolyMesh:
    """Return a sign on a post; its board is a box, or with `flat` a two-sided sheet."""
    width, height = rng.uniform(0.6, 1.6), rng.uniform(0.5, 1.0)
    post = prism(circle(0.04, 6), FOOT_M, 2.2)
    board = box((width, 0.04, height), (0.0, -0.1, 1.3))
    if flat:
        front: Polygon = [0, 1, 5, 4]
        board = PolyMesh(board.vertices, [front, [front[i] for i in (0, 3, 2, 1)]])
        used = board.vertices[front]
        board = PolyMesh(used, [[0, 1, 2, 3], [0, 3, 2, 1]])
    return merged([post, board])


def sculpture(rng: np.random.Generator, *, solid: bool) -> PolyMesh:
    """Return a Moebius band on edge, as a sheet, or with `solid` as a thick band.

    The sheet has one side only. The thick band has an outside: its section of
    four corners returns turned by half a circle.
    """
    n = int(rng.integers(24, 41))
    radius, half, thick = rng.uniform(1.2, 2.2), rng.uniform(0.35, 0.6), 0.04
    angle = np.arange(n) * (2 * np.pi / n)
    out = np.column_stack([np.cos(angle), np.zeros(n), np.sin(angle)])
    across = np.cos(angle / 2)[:, None] * [0.0, 1.0, 0.0] + np.sin(angle / 2)[:, None] * out
    along = np.column_stack([-np.sin(angle), np.zeros(n), np.cos(angle)])
    normal = np.cross(along, across)
    centre = radius * out + [0.0, 0.0, radius + half + 0.2]
    if not solid:
        vertices = np.stack([centre - half * across, centre + half * across], axis=1)
        strip = [[2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1] for i in range(n - 1)]
        return PolyMesh(vertices.reshape(-1, 3), [*strip, [2 * n - 2, 1, 0, 2 * n - 1]])
    a, b = half * across, thick * normal
    section = np.stack([centre - a - b, centre + a - b, centre + a + b, centre - a + b], axis=1)
    polygons: list[Polygon] = []
    for i in range(n):
        j, turn = (i + 1) % n, 2 * (i == n - 1)
        for c in range(4):
            d = (c + 1) % 4
            after = [4 * j + (c + turn) % 4, 4 * j + (d + turn) % 4]
            polygons.append([4 * i + c, 4 * i + d, after[1], after[0]])
    return PolyMesh(section.reshape(-1, 3), polygons)


def plinth(size_m: float) -> PolyMesh:
    """Return the block under a sculpture."""
    return prism(rectangle(size_m, size_m), FOOT_M, 0.15)
