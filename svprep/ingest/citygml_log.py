"""What a CityGML file says, as columns: the result of reading its XML.

Nothing is resolved or chosen yet: polygons of all levels of detail stand in the order of
the file, references are names.
"""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from svprep.model import F64, I64

NO_LOD: Final = -1
"""Of a polygon that no property with a level of detail holds: used by reference only."""
TEMPLATE_LOD: Final = -2
"""Of a polygon of an implicit geometry: used by its placements only."""
NO_OBJECT: Final = -1
# What `CityLog.left_out` counts, besides names of properties.
REPEATED_ID: Final = "repeated id"
LOOSE_RING: Final = "ring outside of a polygon"
FAR_TEMPLATE: Final = "implicit geometry in a file of its own"
LOOSE_TEMPLATE: Final = "implicit geometry without a level of detail"


@dataclass(frozen=True, slots=True)
class Reference:
    """A property that names a geometry: ``xlink:href="#id"``."""

    target: str
    object_index: int
    lod: int
    """Index into `CityLog.lods`, or `NO_LOD`, `TEMPLATE_LOD`."""
    surface: int
    """Index into `CityLog.surfaces`."""
    is_reversed: bool
    before: int
    """How many polygons stand before it."""


@dataclass(frozen=True, slots=True)
class Placement:
    """An implicit geometry: a template with its place."""

    object_index: int
    lod: int
    surface: int
    srs: int
    matrix: str
    """Sixteen numbers as text, row by row; empty: none is stated."""
    reference_point: str
    """Three numbers as text; empty: none is stated."""
    polygons: range
    """Those that stand inside it."""
    references: range
    """Those that stand inside it."""
    line: int


@dataclass(frozen=True, slots=True)
class Span:
    """What a geometry with an id holds."""

    polygons: range
    references: range
    is_reversed: bool
    """Whether all that it holds runs backwards because of what it stands in."""


@dataclass(slots=True)
class CityLog:
    """The columns; filled while the file is read.

    A geometry's id leads to `spans`, a polygon's to the polygon.
    """

    object_types: list[str] = field(default_factory=list)
    object_ids: list[str] = field(default_factory=list)
    """``""`` where none is stated."""
    object_parents: array[int] = field(default_factory=lambda: array("q"))
    """The enclosing city object, or `NO_OBJECT`."""
    object_ends: array[int] = field(default_factory=lambda: array("q"))
    """The objects inside object i are ``i + 1 .. end - 1``."""
    lods: dict[str, int] = field(default_factory=dict)
    surfaces: dict[str, int] = field(default_factory=lambda: {"": 0})
    srs: dict[str, int] = field(default_factory=lambda: {"": 0})

    polygon_object: array[int] = field(default_factory=lambda: array("q"))
    polygon_lod: array[int] = field(default_factory=lambda: array("q"))
    polygon_surface: array[int] = field(default_factory=lambda: array("q"))
    polygon_srs: array[int] = field(default_factory=lambda: array("q"))
    polygon_is_reversed: array[int] = field(default_factory=lambda: array("b"))
    polygon_rings: array[int] = field(default_factory=lambda: array("q"))
    """How many rings each polygon has."""
    n_odd_outlines: int = 0
    """Polygons whose first ring is an interior one."""

    polygon_of_id: dict[str, int] = field(default_factory=dict)
    span_of_id: dict[str, Span] = field(default_factory=dict)
    references: list[Reference] = field(default_factory=list)
    placements: list[Placement] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)

    points: list[F64] = field(default_factory=list)
    """``(n, 3)`` each: the corners of all rings, one behind the other."""
    ring_sizes: list[I64] = field(default_factory=list)
    """How many of them each ring has, as the file writes it (its first one twice)."""

    def n_polygons(self) -> int:
        """Return how many polygons were read."""
        return len(self.polygon_rings)

    def number(self, table: dict[str, int], name: str) -> int:
        """Return the number of a name in one of the tables of names."""
        return table.setdefault(name, len(table))


def column(values: array[int]) -> I64:
    """Return a column as int64."""
    return np.array(values, np.int64)
