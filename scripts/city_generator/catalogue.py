"""What the city is made of: kinds, their shares, sizes, defects and ways of writing."""

from __future__ import annotations

from typing import Final

import numpy as np

from city_generator import buildings, street
from city_generator.mesh import F64, PolyMesh, merged, moved, rectangle
from city_generator.writer import Style

Rng = np.random.Generator

BUILDING_WEIGHTS: Final[dict[str, dict[str, float]]] = {
    "suburb": {"house": 0.12, "gabled": 0.34, "hipped": 0.26, "ell": 0.14, "row": 0.14},
    "dense": {
        "house": 0.28, "gabled": 0.14, "hipped": 0.1, "ell": 0.14, "row": 0.16,
        "rotunda": 0.03, "facade": 0.1, "tower": 0.05,
    },
    "large": {
        "court": 0.26, "horseshoe": 0.16, "ell": 0.1, "tower": 0.28, "office": 0.15,
        "rotunda": 0.05,
    },
}  # fmt: skip
STREET_WEIGHTS: Final[dict[str, float]] = {
    "tree": 0.42, "lamp": 0.2, "bollard": 0.13, "bench": 0.09, "planter": 0.07, "sign": 0.06,
    "kiosk": 0.03,
}  # fmt: skip
PARK_WEIGHTS: Final[dict[str, float]] = {
    "tree": 0.75, "bench": 0.12, "lamp": 0.07, "planter": 0.03, "sign": 0.03
}  # fmt: skip

COMMON_DEFECTS: Final = (
    "flipped_patch", "inside_out", "duplicate_faces", "opposite_faces", "zero_area_repeated",
    "zero_area_collinear", "tiny_face", "unwelded", "short_polygon",
)  # fmt: skip
HOUSE_DEFECTS: Final = (*COMMON_DEFECTS, "t_junction", "no_ground_face", "missing_wall")
OWN_DEFECTS: Final[dict[str, tuple[str, ...]]] = {
    "house": (*HOUSE_DEFECTS, "nested_solid", "nonplanar_polygon", "self_crossing_polygon"),
    "row": (*HOUSE_DEFECTS, "party_wall", "party_wall_recut", "partition_wall"),
    "tower": (*HOUSE_DEFECTS, "touching_solids"),
    "facade": (*HOUSE_DEFECTS, "near_coplanar"),
    "court": (*HOUSE_DEFECTS, "self_intersecting"),
    "planter": ("touching_boxes",),
    "sign": ("two_sided_sheet",),
    "sculpture": ("moebius",),
    "tree": ("leaf_soup",),
}
"""Defects by kind of object; kinds not named take `HOUSE_DEFECTS` or `COMMON_DEFECTS`."""

DIRTY_SHARE: Final[dict[str, float]] = {
    "terrain": 1.0, "tree": 1.0, "sculpture": 1.0, "sign": 0.7, "planter": 0.6,
    "lamp": 0.12, "bench": 0.12, "bollard": 0.12, "kiosk": 0.12,
}  # fmt: skip
"""Share of a kind's objects that get a defect."""
DIRTY_BUILDINGS: Final = 0.4
"""The same for every kind of building."""
ALSO_UNWELDED: Final = 0.15
"""Share of dirty buildings that are unwelded on top of their defect."""
KEEPS_WELDS: Final = frozenset({None, "unwelded", "zero_area_repeated", "short_polygon"})
"""Clean, unwelded already, or lost if corners became different vertices."""

CORNER_FORMS: Final[dict[str, float]] = {
    "v/vt/vn": 0.54, "v//vn": 0.18, "v/vt": 0.07, "v": 0.16, "-v": 0.03, "-v/vt/vn": 0.02
}  # fmt: skip
"""Shares of the ways of writing an object's corners."""
TREE_FORMS: Final[dict[str, float]] = {"v//vn": 0.5, "v": 0.35, "v/vt/vn": 0.1, "-v": 0.05}
"""The same for trees, of which few are textured."""

BUILDING_KINDS: Final = frozenset(k for kinds in BUILDING_WEIGHTS.values() for k in kinds)
"""Every kind of building."""


def defects_of(kind: str) -> tuple[str, ...]:
    """Return the kinds of defect that an object of `kind` may get."""
    return OWN_DEFECTS.get(kind, HOUSE_DEFECTS if kind in BUILDING_KINDS else COMMON_DEFECTS)


def weighted(weights: dict[str, float], rng: Rng) -> str:
    """Return one key of `weights`, drawn by its weight."""
    draw = float(rng.random()) * sum(weights.values())
    for kind, weight in weights.items():
        draw -= weight
        if draw < 0:
            return kind
    return kind


def building(
    kind: str, width_m: float, depth_m: float, centrality: float, rng: Rng, defect: str | None
) -> PolyMesh:
    """Return a building of `kind` that fits a width by a depth, higher near the centre."""
    floors = 2 + int(rng.integers(0, 3)) + round(centrality * float(rng.uniform(1, 5)))
    height = floors * 3.2 + 0.5
    small = min(width_m, depth_m)
    if kind == "house":
        return buildings.flat_roof(width_m, depth_m, height)
    if kind == "gabled":
        return buildings.row(width_m, depth_m * 0.75, min(height, 9.5), 0.3 * depth_m)
    if kind == "hipped":
        width = width_m if rng.random() < 0.7 else depth_m * 0.75
        return buildings.hipped(width, depth_m * 0.75, min(height, 9.5), 0.25 * depth_m)
    if kind == "ell":
        return buildings.l_shape(width_m, depth_m, height, small * float(rng.uniform(0.35, 0.5)))
    if kind == "horseshoe":
        return buildings.u_shape(width_m, depth_m, height, small * float(rng.uniform(0.22, 0.3)))
    if kind == "row":
        rise = 0.28 * depth_m if rng.random() < 0.6 else 0.0
        inner_walls = {"party_wall": 2, "party_wall_recut": 2, "partition_wall": 1}
        units = int(rng.integers(2, 6))
        eaves = min(height, 12.5)
        return buildings.row(
            width_m,
            depth_m * 0.7,
            eaves,
            rise,
            units,
            inner_walls.get(str(defect), 0),
            walls_match=defect != "party_wall_recut",
        )
    if kind == "rotunda":
        large = small > 30.0
        sides = int(rng.choice([48, 64])) if large else int(rng.choice([16, 24, 32]))
        rings = int(rng.integers(8, 17)) if large else int(rng.choice([0, 0, 4, 6]))
        return buildings.rotunda(small * 0.42, min(height, 16.0), sides, rings)
    if kind == "facade":
        return buildings.gridded(width_m, depth_m, height, 3.0, windows=False)
    if kind == "office":
        return buildings.gridded(width_m, depth_m, height * 1.3, 3.0, windows=True)
    if kind == "court":
        wing = small * float(rng.uniform(0.2, 0.28))
        slip = wing * 1.4 if defect == "self_intersecting" else 0.0
        return buildings.courtyard(width_m, depth_m, height, wing, slip)
    return _tower(width_m, depth_m, height, centrality, rng, touching=defect == "touching_solids")


def _tower(
    width_m: float, depth_m: float, podium_m: float, centrality: float, rng: Rng, *, touching: bool
) -> PolyMesh:
    """Return a podium with one to three storeys set back on it."""
    footprints: list[F64] = [rectangle(width_m, depth_m)]
    tops = [min(podium_m, 12.0)]
    scale = 1.0
    for _ in range(int(rng.integers(1, 4))):
        scale *= float(rng.uniform(0.6, 0.85))
        footprints.append(rectangle(width_m * scale, depth_m * scale))
        slender = max(int(0.5 * scale * min(width_m, depth_m)), 2)
        floors = int(rng.integers(3, 7 + int(12 * centrality)))
        tops.append(tops[-1] + 3.2 * min(floors, slender))
    return buildings.stacked(footprints, tops, touching=touching)


def street_item(kind: str, rng: Rng, defect: str | None) -> PolyMesh:
    """Return a tree, a sculpture or a piece of furniture."""
    if kind == "tree":
        return street.tree(rng, leafy=defect == "leaf_soup")
    if kind == "sculpture":
        base = street.plinth(1.2)
        return merged([base, street.sculpture(rng, solid=defect != "moebius")])
    if kind == "planter":
        return street.planter(rng, touching=defect == "touching_boxes")
    if kind == "sign":
        return street.sign(rng, flat=defect == "two_sided_sheet")
    shapes = {"lamp": street.lamp, "bench": street.bench, "bollard": street.bollard}
    mesh = shapes.get(kind, street.kiosk)(rng)
    return moved(mesh, np.pi / 2, (0.0, 0.0, 0.0)) if kind == "bench" else mesh


def style(kind: str, rng: Rng) -> tuple[Style, bool]:
    """Return how an object is written, and whether in triangles.

    Small and twisted things are always triangles: in millimetres their quads
    would no longer be flat.
    """
    form = weighted(TREE_FORMS if kind == "tree" else CORNER_FORMS, rng)
    decimals = int(rng.choice([3, 4, 5, 6], p=[0.2, 0.4, 0.05, 0.35]))
    in_triangles = bool(rng.random() < 0.7) or kind not in BUILDING_KINDS or kind == "office"
    made = Style(decimals, "/vt" in form, form.endswith("vn"), form.startswith("-"))
    return made, in_triangles
