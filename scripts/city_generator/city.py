"""The outline: plan, shape, damage, place and write one object after another."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TextIO

import numpy as np

from city_generator import catalogue, defects, terrain
from city_generator.catalogue import Rng
from city_generator.layout import Block, Lot, Spot, lay_out_block, plan_city
from city_generator.mesh import F64, PolyMesh, moved, rectangle, triangulated
from city_generator.writer import ObjWriter, Style


@dataclass(slots=True)
class Summary:
    """What has been written so far."""

    objects: Counter[str] = field(default_factory=Counter)
    """By kind."""
    defects: Counter[str] = field(default_factory=Counter)
    """By kind of defect: how many objects have it."""
    corner_forms: Counter[str] = field(default_factory=Counter)
    vertices: int = 0
    polygons: int = 0
    triangles: int = 0

    def as_dict(self) -> dict[str, object]:
        """Return JSON values, each table sorted by name."""
        return {
            "objects": sum(self.objects.values()),
            "vertices": self.vertices,
            "polygons": self.polygons,
            "triangles": self.triangles,
            "objects_by_kind": dict(sorted(self.objects.items())),
            "defects_planted": {k: self.defects[k] for k in defects.PLANTED},
            "corner_forms": dict(sorted(self.corner_forms.items())),
        }


@dataclass(frozen=True, slots=True)
class Choices:
    """The random streams of one object: apart, so that a clean city is the same city."""

    shape: Rng
    damage: Rng
    style: Rng

    @staticmethod
    def of(seed: int, serial: int) -> Choices:
        """Return the streams of the object with this serial number."""
        a, b, c = (np.random.Generator(np.random.PCG64([seed, serial, k])) for k in range(3))
        return Choices(a, b, c)


class City:
    """One city being written: its relief, its turn, and the running summary."""

    def __init__(self, seed: int, *, clean: bool, writer: ObjWriter) -> None:
        rng = np.random.Generator(np.random.PCG64([seed]))
        self._seed, self._clean, self._writer = seed, clean, writer
        self._relief = terrain.Relief.random(rng)
        self._turn_rad = float(rng.uniform(0.1, 0.45))
        self._serial = 0
        self.summary = Summary()

    def choices(self) -> Choices:
        """Return the next object's streams."""
        self._serial += 1
        return Choices.of(self._seed, self._serial)

    def pick_defect(self, kind: str, own: tuple[str, ...], rng: Rng) -> str | None:
        """Return the defect for the next object of `kind`, the rarest so far first."""
        share = catalogue.DIRTY_SHARE.get(kind, catalogue.DIRTY_BUILDINGS)
        dirty = rng.random() < share or (share >= 0.4 and self.summary.objects[kind] == 0)
        if self._clean or not dirty:
            return None
        count = self.summary.defects
        unseen = [d for d in own if count[d] == 0 and d not in catalogue.HOUSE_DEFECTS]
        few = min(count[d] for d in own)
        return str(rng.choice(unseen or [d for d in own if count[d] == few]))

    def add_terrain(self, column: int, row: int) -> None:
        """Write one terrain tile."""
        ch = self.choices()
        mesh = triangulated(terrain.tile(self._relief, column, row, closed=self._clean))
        defect = None if self._clean else "terrain_border"
        style = Style(3, bool(ch.style.random() < 0.6), bool(ch.style.random() < 0.4), False)
        self._put(f"terrain_{column}_{row}", "terrain", mesh, 0.0, np.zeros(3), style, defect)

    def add_building(self, block: Block, lot: Lot) -> None:
        """Write the building of one lot."""
        ch = self.choices()
        kind = catalogue.weighted(catalogue.BUILDING_WEIGHTS[block.use], ch.shape)
        defect = self.pick_defect(kind, catalogue.defects_of(kind), ch.damage)
        width = lot.width_m - 4.0 - float(ch.shape.uniform(0, 0.25)) * lot.width_m
        depth = lot.depth_m - 4.0 - float(ch.shape.uniform(0, 0.25)) * lot.depth_m
        mesh = catalogue.building(kind, width, depth, block.centrality, ch.shape, defect)
        turn = 0.0 if ch.shape.random() < 0.8 else np.pi
        x, y, _ = mesh.vertices.T
        reach = rectangle(float(np.ptp(x)), float(np.ptp(y)), lot.x_m, lot.y_m)
        ground = float(self._relief.height(reach).min())
        self._finish(kind, mesh, turn, (lot.x_m, lot.y_m, ground), ch, defect)

    def add_street_item(self, block: Block, spot: Spot, *, first: bool) -> None:
        """Write the tree or thing of one spot; some parks begin with a sculpture."""
        ch = self.choices()
        weights = catalogue.PARK_WEIGHTS if block.use == "park" else catalogue.STREET_WEIGHTS
        kind = catalogue.weighted(weights, ch.shape)
        if first and block.use == "park" and (block.index == 0 or ch.shape.random() < 0.5):
            kind = "sculpture"
        defect = self.pick_defect(kind, catalogue.defects_of(kind), ch.damage)
        mesh = catalogue.street_item(kind, ch.shape, defect)
        ground = float(self._relief.height(np.array([[spot.x_m, spot.y_m]]))[0])
        self._finish(kind, mesh, spot.yaw_rad, (spot.x_m, spot.y_m, ground), ch, defect)

    def _finish(
        self,
        kind: str,
        mesh: PolyMesh,
        yaw_rad: float,
        at_m: tuple[float, float, float],
        ch: Choices,
        defect: str | None,
    ) -> None:
        """Damage, triangulate, place and write one object."""
        style, in_triangles = catalogue.style(kind, ch.style)
        if defect in defects.NEEDS_POLYGONS:
            in_triangles = False
        if defect in defects.NEEDS_SIX_DECIMALS:
            style = Style(6, style.with_uv, style.with_normals, style.relative)
        if defect in defects.ON_POLYGONS:
            mesh = defects.ON_POLYGONS[defect](mesh, ch.damage)
        if in_triangles:
            mesh = triangulated(mesh)
        if defect in defects.ON_FACES:
            mesh = defects.ON_FACES[defect](mesh, ch.damage)
        extra = None
        may_tear = kind in catalogue.BUILDING_KINDS and defect not in catalogue.KEEPS_WELDS
        if may_tear and ch.damage.random() < catalogue.ALSO_UNWELDED:
            mesh, extra = defects.unwelded(mesh, ch.damage), "unwelded"
        name = f"{kind}_{self.summary.objects[kind]:04d}"
        self._put(name, kind, mesh, yaw_rad, np.array(at_m), style, defect, extra)

    def _put(
        self,
        name: str,
        kind: str,
        mesh: PolyMesh,
        yaw_rad: float,
        at_m: F64,
        style: Style,
        *planted: str | None,
    ) -> None:
        """Write one object and count it."""
        placed = moved(moved(mesh, yaw_rad, at_m), self._turn_rad, (0.0, 0.0, 0.0))
        self._writer.write(name, placed, style)
        s = self.summary
        s.objects[kind] += 1
        s.defects.update(d for d in planted if d is not None)
        s.corner_forms[style.label] += 1
        s.vertices += len(mesh.vertices)
        s.polygons += len(mesh.polygons)
        s.triangles += mesh.n_triangles


def write_city(
    stream: TextIO,
    n_objects: int,
    seed: int,
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    clean: bool = False,
) -> Summary:
    """Write a city of `n_objects` objects as OBJ and return what it holds.

    The same arguments give the same bytes. Memory does not grow with the city,
    save for the plan (some tens of bytes per block).
    """
    writer = ObjWriter(stream, origin_m)
    writer.comment("A generated city in metres, z up. Made by make_city.py, MIT licence.")
    state = "clean" if clean else "dirty"
    writer.comment(
        f"objects {n_objects}, seed {seed}, {state}, origin %.15g %.15g %.15g" % origin_m
    )
    city = City(seed, clean=clean, writer=writer)
    plan = plan_city(n_objects, terrain.TILE_M)
    for column, row in plan.tiles:
        city.add_terrain(column, row)
    for index in range(len(plan.order)):
        block = lay_out_block(
            plan, index, np.random.Generator(np.random.PCG64([seed, index + 1, 9]))
        )
        for lot in block.lots:
            city.add_building(block, lot)
        for i, spot in enumerate(block.spots):
            city.add_street_item(block, spot, first=i == 0)
    return city.summary
