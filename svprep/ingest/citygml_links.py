"""Which polygons each city object has: its own, those it refers to, and placed templates.

A polygon is used once per object and level of detail, however often it is referred to:

    Building                       the polygon stands below the wall; the solid refers to it:
      lod2Solid ... href="#p"      one surface, a wall
      boundedBy WallSurface
        lod2MultiSurface  p

Nor is it used again by an object that encloses its owner or lies inside it (a building's
solid that refers to the surfaces of its installations). Objects that stand side by side and
share a wall have it each: both are closed.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from svprep.errors import InputError
from svprep.ingest.citygml_log import NO_LOD, NO_OBJECT, TEMPLATE_LOD, CityLog, Reference, column
from svprep.ingest.parsed import count_of, shown
from svprep.model import BOOL, I64

# More than that is no city: references repeat few surfaces, placements many of a template.
_MOST_FOLLOWED: Final = 1_000_000
_MOST_FOLLOWED_EACH: Final = 10  # and as many more for every polygon of the file
_MOST_PLACED: Final = 5_000_000
NO_PLACEMENT: Final = -1


@dataclass(frozen=True, slots=True)
class Uses:
    """Every polygon of every object at every level, in file order."""

    polygon: I64
    """``(n,)``: index into the polygons of the file."""
    object_index: I64
    lod: I64
    """Index into `CityLog.lods`."""
    surface: I64
    """Index into `CityLog.surfaces`."""
    placement: I64
    """Index into `CityLog.placements`, or `NO_PLACEMENT`."""
    is_reversed: BOOL
    notes: tuple[str, ...]


def resolve(log: CityLog, path: Path) -> Uses:
    """Follow all references and place all templates.

    Raises
    ------
    InputError
        References that multiply each other to more than anyone models.

    Notes
    -----
    O(n) in the polygons and in what references lead to, which is bounded.
    """
    return _Resolver(log, path).uses()


class _Resolver:
    def __init__(self, log: CityLog, path: Path) -> None:
        self.log = log
        self.path = path
        self.n_steps = 0
        self.most_steps = _MOST_FOLLOWED + _MOST_FOLLOWED_EACH * log.n_polygons()
        self.unresolved: list[str] = []
        self.surface = column(log.polygon_surface)

    def uses(self) -> Uses:
        log = self.log
        owner, lod = column(log.polygon_object), column(log.polygon_lod)
        # Uses besides those where polygons stand: the columns of `Uses`, and before which
        # polygon of the file they belong.
        followed = self._followed()
        added = [np.concatenate(pair) for pair in zip(followed, self._placed(), strict=True)]
        own = np.flatnonzero((owner != NO_OBJECT) & (lod >= 0))
        columns = [
            own,
            owner[own],
            lod[own],
            self.surface[own],
            np.full(own.size, NO_PLACEMENT),
            np.array(log.polygon_is_reversed, np.int64)[own],
            own,
        ]
        if added[0].size:
            columns = [np.concatenate(pair) for pair in zip(columns, added, strict=True)]
            # Those that are added before a polygon stand in front of it.
            is_own = np.arange(columns[0].size) < own.size
            order = np.lexsort((is_own, columns[6]))
            columns = [values[order] for values in columns]
        polygon, owners, lods, surface, placement, is_reversed, _ = columns
        notes = tuple(self._notes(lod, owner, added[0]))
        return Uses(polygon, owners, lods, surface, placement, is_reversed.astype(np.bool_), notes)

    def _followed(self) -> list[I64]:
        """Return the uses that references make, outside of templates."""
        log = self.log
        added = [array("q") for _ in range(7)]
        seen: set[tuple[int, int, int]] = set()
        for reference in log.references:
            if reference.lod < 0 or reference.object_index == NO_OBJECT:
                if reference.lod == NO_LOD and not self._is_known(reference.target):
                    self.unresolved.append(reference.target)
                continue
            owner, lod = reference.object_index, reference.lod
            for polygon, is_reversed in self._targets([reference]):
                if self._is_counted(polygon, owner, lod):
                    if self.surface[polygon] == 0:
                        self.surface[polygon] = reference.surface
                    continue
                key = (owner, lod, polygon)
                if key in seen:
                    continue
                seen.add(key)
                surface = reference.surface or int(self.surface[polygon])
                row = polygon, owner, lod, surface, NO_PLACEMENT, is_reversed, reference.before
                for values, value in zip(added, row, strict=True):
                    values.append(value)
        return [column(values) for values in added]

    def _is_counted(self, polygon: int, owner: int, lod: int) -> bool:
        """Whether a polygon stands in this object, or one around or inside it, at this level."""
        log = self.log
        other = log.polygon_object[polygon]
        if log.polygon_lod[polygon] != lod or other == NO_OBJECT:
            return False
        return other <= owner < log.object_ends[other] or owner <= other < log.object_ends[owner]

    def _placed(self) -> list[I64]:
        """Return the uses that implicit geometries make."""
        log = self.log
        polygons, turns = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
        rows = []
        templates: dict[tuple[str, bool], tuple[I64, I64]] = {}
        self.n_steps, self.most_steps = 0, _MOST_PLACED
        for number, placement in enumerate(log.placements):
            references = [log.references[r] for r in placement.references]
            if len(references) == 1 and not placement.polygons:
                key = references[0].target, references[0].is_reversed
                if key not in templates:
                    templates[key] = self._template(range(0), references)
                of_template = templates[key]
                self._count(len(of_template[0]))
            else:
                of_template = self._template(placement.polygons, references)
            polygons.append(of_template[0])
            turns.append(of_template[1])
            rows.append(
                (
                    placement.object_index,
                    placement.lod,
                    placement.surface,
                    number,
                    placement.polygons.start,
                    len(of_template[0]),
                )
            )
        table = np.array(rows, np.int64).reshape(-1, 6)
        owners, lods, surfaces, numbers, before_all = np.repeat(table[:, :5], table[:, 5], axis=0).T
        polygon = np.concatenate(polygons)
        surfaces = np.where(surfaces == 0, self.surface[polygon], surfaces)
        return [polygon, owners, lods, surfaces, numbers, np.concatenate(turns), before_all]

    def _template(self, inside: range, references: list[Reference]) -> tuple[I64, I64]:
        """Return the polygons of a template, and whether each is turned."""
        self._count(len(inside))
        targets = {p: bool(self.log.polygon_is_reversed[p]) for p in inside}
        for polygon, is_reversed in self._targets(references):
            targets.setdefault(polygon, is_reversed)
        return np.array(list(targets), np.int64), np.array(list(targets.values()), np.int64)

    def _is_known(self, target: str) -> bool:
        return target in self.log.polygon_of_id or target in self.log.span_of_id

    def _targets(self, references: Iterable[Reference]) -> list[tuple[int, bool]]:
        """Return the polygons that references lead to, each once, and whether it is turned."""
        log = self.log
        found: dict[int, bool] = {}
        visited: set[str] = set()
        waiting = [(r.target, r.is_reversed) for r in references]
        waiting.reverse()
        while waiting:
            target, is_reversed = waiting.pop()
            self._count(1)
            polygon = log.polygon_of_id.get(target)
            if polygon is not None:
                found.setdefault(polygon, is_reversed)
                continue
            span = log.span_of_id.get(target)
            if span is None:
                self.unresolved.append(target)
                continue
            if target in visited:
                continue
            visited.add(target)
            self._count(len(span.polygons) + len(span.references))
            turn = is_reversed != span.is_reversed
            for polygon in span.polygons:
                found.setdefault(polygon, turn != bool(log.polygon_is_reversed[polygon]))
            for number in reversed(span.references):
                reference = log.references[number]
                waiting.append((reference.target, turn != reference.is_reversed))
        return list(found.items())

    def _count(self, n: int) -> None:
        self.n_steps += n
        if self.n_steps > self.most_steps:
            raise InputError(
                f"{self.path}: its references (xlink:href) and implicit geometries repeat "
                f"more than {self.most_steps} surfaces, which no city model does; the file is "
                "damaged, or a bomb."
            )

    def _notes(self, lod: I64, owner: I64, added: I64) -> list[str]:
        notes = []
        if self.unresolved:
            n = count_of(len(self.unresolved), "reference")
            notes.append(
                f"{n} to geometry that is not in the file left out "
                f'(first "{shown(self.unresolved[0])}")'
            )
        outside = np.flatnonzero((lod == NO_LOD) | ((owner == NO_OBJECT) & (lod != TEMPLATE_LOD)))
        n_outside = np.setdiff1d(outside, added).size
        if n_outside:
            notes.append(
                f"{count_of(n_outside, 'polygon')} left out that no property with a level of "
                "detail (lod2...) of a city object holds"
            )
        return notes
