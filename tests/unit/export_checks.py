"""Round trips: a cache, exported, built again, and what must be the same."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from svprep import cli_export
from svprep.cache.codec import half_edges_of_rows
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


def is_numbered_by_use(prepared: Prepared) -> bool:
    """Whether vertices have the numbers that a build of the repaired mesh gives them."""
    corners = prepared.mesh.faces.reshape(-1)
    highest = np.maximum.accumulate(np.concatenate(([-1], corners.astype(np.int64))))
    return bool((corners <= highest[:-1] + 1).all())


def turned_outward_apart(prepared: Prepared) -> np.ndarray:
    """Return the flags of components but for one: what was turned outward needs it no more."""
    return prepared.components.flags & np.uint8(255 - ComponentFlag.INVERTED)


def surface_names(prepared: Prepared) -> list[str]:
    """Return what each face is: the numbers of these names may differ."""
    labels = prepared.labels
    return [labels.surface_names[i] for i in labels.surface_of_face.tolist()]


def unnumbered(prepared: Prepared) -> dict[str, np.ndarray]:
    """Return what of the tables does not depend on the numbers of vertices."""
    mesh, edges = prepared.mesh, prepared.edges
    half = np.sort(half_edges_of_rows(mesh.faces.reshape(-1), edges.rows), axis=1)
    order = np.lexsort(half.T)
    return {
        "corners": mesh.positions[mesh.faces],
        "half edges": half[order],
        "edge flags": edges.flags[order],
    }


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

    `differs` names what else may differ than what the format has no place for.
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
    if is_numbered_by_use(first):
        assert found == set(), form
    else:
        numbered = {"mesh.positions", "mesh.faces", "edges.rows", "edges.flags"}
        # Trees over edges follow the order of edges, which is that of vertices.
        assert {name for name in found if not name.startswith("index.")} <= numbered, form
        before, after = unnumbered(first), unnumbered(again)
        assert all(np.array_equal(before[name], after[name]) for name in before), form
        # From now on, nothing changes at all.
        third = built(write_export(city_of(again), folder / f"again_{number}.{form}"))
        assert differing(again, third) == set(), form
    assert has_grid_of_a_build(city)
    assert not again.repair.flipped_faces.size
    return again
