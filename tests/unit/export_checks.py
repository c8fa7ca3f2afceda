"""Round trips: a cache, exported, built again, and what must be the same."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from svprep import cli_export
from svprep.cache.writer import write_cache
from svprep.export.city import city_of, has_grid_of_a_build
from svprep.export.cityjson import TYPES
from svprep.export.output import write_export
from svprep.ingest import read
from svprep.model import ComponentFlag, Prepared
from svprep.pipeline import BuildConfig, prepare

FORMS = ("obj", "ply", "glb", "city.json")
NOT_HELD = frozenset(
    ["sources", "object_source", "repair", "config", "notes", "clamp", "place", "mesh.source_face"]
)
"""What no export holds; see `svprep.export`."""
SURFACES = frozenset(["labels.surface_names", "labels.surface_of_face"])
"""Compared by name."""


def exported(prepared: Prepared, folder: Path, form: str) -> tuple[Path, dict[str, Any]]:
    """Return the file that an export writes, and its summary."""
    number = len(list(folder.iterdir()))  # an export never replaces its own source
    cache, output = folder / f"{number}.svp.h5", folder / f"out_{number}.{form}"
    write_cache(prepared, cache)
    summary = cli_export.run(cache, str(output))
    assert cli_export.summary_lines(summary)
    return output, summary


def built(path: Path) -> Prepared:
    return prepare(read([path]), BuildConfig())


def differing(a: Any, b: Any, prefix: str = "") -> set[str]:
    """Return the names of the fields in which two dataclasses differ."""
    found: set[str] = set()
    for field in fields(a):
        x, y, name = getattr(a, field.name), getattr(b, field.name), prefix + field.name
        if name in NOT_HELD:
            continue
        if is_dataclass(x):
            found |= differing(x, y, name + ".")
        elif isinstance(x, np.ndarray):
            same = x.dtype == y.dtype and np.array_equal(x, y)
            found |= set() if same else {name}
        elif x != y:
            found.add(name)
    return found


def turned_outward_apart(prepared: Prepared) -> np.ndarray:
    """Return the flags of components but for one: what was turned outward needs it no more."""
    return prepared.components.flags & np.uint8(255 - ComponentFlag.INVERTED)


def surface_names(prepared: Prepared) -> list[str]:
    """Return what each face is: the numbers of these names may differ."""
    labels = prepared.labels
    return [labels.surface_names[i] for i in labels.surface_of_face.tolist()]


def not_told(prepared: Prepared, form: str) -> frozenset[str]:
    """Return the labels that a format has no place for."""
    if form == "city.json":
        types, names = prepared.labels.object_types, prepared.object_names
        lost = [] if set(types) <= TYPES else ["labels.object_types"]
        lost += [] if len(set(names)) == len(names) else ["object_names"]
        return frozenset(lost)
    return frozenset()


def assert_round_trip(
    first: Prepared, folder: Path, form: str, differs: frozenset[str] = frozenset()
) -> Prepared:
    """Export `first`, build it, compare, and return what was built.

    The first trip already gives the same tables, vertex by vertex: repair numbers vertices
    as welding does. `differs` names what else may differ than what the format has no place for.
    """
    differs |= not_told(first, form)
    city = city_of(first)
    number = len(list(folder.iterdir()))
    again = built(write_export(city, folder / f"first_{number}.{form}"))
    found = differing(first, again) - differs
    assert np.array_equal(turned_outward_apart(first), turned_outward_apart(again))
    found -= {"components.flags"} | SURFACES
    if form != "obj":
        assert surface_names(first) == surface_names(again)
    assert found == set(), form
    assert has_grid_of_a_build(city)
    assert not again.repair.flipped_faces.size
    return again
