"""The reader of CityGML 1.0, 2.0 and 3.0, and of the cells of IndoorGML.

    events     XML to columns                          `svprep.ingest.citygml_events`
    links      references followed, templates placed   `svprep.ingest.citygml_links`
    levels     one level of detail per building        `svprep.ingest.lod`
    surfaces   rings to triangles                      `svprep.ingest.holes`

An object is a city object with surfaces of its own, under its ``gml:id``; one without is
``TYPE_K``, the K-th of its type in the file. The surfaces below ``boundedBy`` belong to the
city object around them and keep their names. Left out, and counted in the notes: curves,
points and rasters, what lies in other files, what no level of detail holds.

Axes. ``srsName`` is inherited from the nearest geometry, feature or the model that states
one. Positions are turned to x = east, y = north where the CRS and the positions themselves
say that the file has it the other way around (`svprep.ingest.crs_names.needs_swap`). The
axes of an implicit geometry's template are east, north and up, whatever the CRS.

Corners at the same position are one vertex: CityGML has no indices.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Final

import numpy as np

from svprep.errors import InputError, first_few
from svprep.ingest.citygml_events import read_events
from svprep.ingest.citygml_links import Uses, resolve
from svprep.ingest.citygml_log import FAR_TEMPLATE, LOOSE_RING, LOOSE_TEMPLATE, REPEATED_ID, CityLog
from svprep.ingest.citygml_names import LINE_RELIEF
from svprep.ingest.citygml_surfaces import Polygons, gather
from svprep.ingest.crs_given import crs_in_use
from svprep.ingest.crs_names import proportional
from svprep.ingest.holes import triangulate_rings
from svprep.ingest.lod import choose_lods, number_of
from svprep.ingest.options import HIGHEST, ReadOptions
from svprep.ingest.parsed import ParsedFile, Report, count_of, shown
from svprep.ingest.surface_names import SurfaceNames
from svprep.ingest.triangulation import Triangulation
from svprep.model import BOOL, F64, I64, U8, FaceFindings

_PLURALS: Final = {
    LOOSE_RING: "rings outside of polygons",
    FAR_TEMPLATE: "implicit geometries in files of their own",
    LOOSE_TEMPLATE: "implicit geometries without a level of detail",
}
_READING: Final = 0.8  # of the progress


def read_citygml(
    data: U8, path: Path, stem: str, report: Report, options: ReadOptions
) -> ParsedFile:
    """Read a CityGML file.

    Parameters
    ----------
    data : (n_bytes + 1,) uint8
        The text and a line feed behind it.
    path, stem
        For messages, and for objects without an id.
    report
        Told the fraction that is done.
    options
        Of which `lod` and `crs` are used.

    Raises
    ------
    InputError
        No well-formed XML, not CityGML, entities declared, numbers that are none, several
        coordinate reference systems, no surface at all.
    """
    log = read_events(data[:-1], path, lambda fraction: report(_READING * fraction))
    names = _names(log)
    uses = resolve(log, path)
    notes = [*_left_out(log), *uses.notes]
    if uses.polygon.size:
        uses, lod_notes = _choose(log, uses, names, options.lod, path)
        notes += lod_notes
    if uses.polygon.size == 0:
        detail = f" ({'; '.join(notes)})" if notes else ""
        raise InputError(
            f"{path}: no surface of any of {count_of(len(names), 'city object')}, so "
            f"nothing that casts a shadow{detail}."
        )
    polygons = gather(log, uses, path, options.crs)
    surfaces = triangulate_rings(
        proportional(polygons.positions, crs_in_use(polygons.crs, options.crs)),
        polygons.corners,
        polygons.ring_start,
        polygons.polygon_start,
    )
    if len(surfaces.triangles) == 0:
        raise InputError(
            f"{path}: none of {count_of(uses.polygon.size, 'polygon')} has three different "
            "corners, so nothing casts a shadow."
        )
    return _parsed(log, uses, polygons, surfaces, names, [*polygons.notes, *notes])


def _names(log: CityLog) -> list[str]:
    """Return the name of every city object: its id, or type and number."""
    numbers: dict[str, int] = {}
    names = []
    for kind, name in zip(log.object_types, log.object_ids, strict=True):
        numbers[kind] = numbers.get(kind, 0) + 1
        names.append(name or f"{kind}_{numbers[kind]}")
    return names


def _choose(
    log: CityLog, uses: Uses, names: list[str], lod: str, path: Path
) -> tuple[Uses, tuple[str, ...]]:
    """Leave out all but the level of detail that each object contributes."""
    levels = list(log.lods)
    of_object: list[list[str]] = [[] for _ in names]
    pairs = np.unique(uses.object_index * len(levels) + uses.lod)
    for pair in pairs.tolist():
        of_object[pair // len(levels)].append(levels[pair % len(levels)])
    choice = choose_lods(log.object_parents, log.object_types, of_object, lod, path)
    chosen = np.array([-1 if name is None else log.lods[name] for name in choice.lods], np.int64)
    is_taken = uses.lod == chosen[uses.object_index]
    notes = choice.notes(names, lod)
    if lod == HIGHEST and len(levels) > 1:
        is_added = _of_lacking_kinds(uses, chosen, np.array([number_of(name) for name in levels]))
        if is_added.any():
            n = count_of(int(is_added.sum()), "polygon")
            owners = np.unique(uses.object_index[is_added]).tolist()
            some = first_few((shown(names[i]) for i in owners), 3)
            notes += (
                f"{n} of a lower LoD taken for {count_of(len(owners), 'object')} without surfaces "
                f"of their kind at the highest: {some}",
            )
            is_taken |= is_added
    return _taken(uses, is_taken), notes


def _of_lacking_kinds(uses: Uses, chosen: I64, level: F64) -> BOOL:
    """Return the uses that their object needs besides those of its chosen level.

    Each surface of a building has levels of its own: windows at LoD 3 may stand in walls at
    LoD 2. A kind of surface that an object lacks at its level, which names all its surfaces,
    is taken from its highest lower level.

    Parameters
    ----------
    chosen : (n_objects,) int64
        Index of each object's level, -1 for none.
    level : (n_levels,) float64
        Each level as a number.
    """
    n_kinds = int(uses.surface.max()) + 1
    key = uses.object_index * n_kinds + uses.surface
    own = chosen[uses.object_index]
    is_own = uses.lod == own
    is_unnamed = np.zeros(len(chosen), bool)
    is_unnamed[uses.object_index[is_own & (uses.surface == 0)]] = True
    of_use = level[uses.lod]
    is_wanted = (own >= 0) & (uses.surface != 0) & (of_use >= 1) & (of_use < level[own])
    is_wanted &= ~is_unnamed[uses.object_index] & ~np.isin(key, key[is_own])
    highest = np.zeros(len(chosen) * n_kinds)
    np.maximum.at(highest, key[is_wanted], of_use[is_wanted])
    return is_wanted & (of_use == highest[key])


def _taken(uses: Uses, is_kept: BOOL) -> Uses:
    """Return some of the uses."""
    if is_kept.all():
        return uses
    return Uses(
        uses.polygon[is_kept],
        uses.object_index[is_kept],
        uses.lod[is_kept],
        uses.surface[is_kept],
        uses.placement[is_kept],
        uses.is_reversed[is_kept],
        uses.notes,
    )


def _left_out(log: CityLog) -> list[str]:
    """Return a note on each kind of thing that is no surface."""
    reliefs = Counter(kind for kind in log.object_types if kind in LINE_RELIEF)
    notes = [f"{n} {kind} left out: points, lines or rasters" for kind, n in reliefs.items()]
    for kind, n in sorted(log.left_out.items()):
        if kind.startswith("lod"):
            notes.append(f"{n} {shown(kind)} left out: curves or points")
        elif kind == REPEATED_ID:
            notes.append(f"{count_of(n, kind)} of geometry: references lead to the first")
        else:
            notes.append(f"{count_of(n, kind, _PLURALS.get(kind, ''))} left out")
    if log.n_odd_outlines:
        odd = count_of(log.n_odd_outlines, "polygon")
        notes.append(f"{odd} whose first ring is an interior one: it was taken for the outline")
    return notes


def _parsed(
    log: CityLog,
    uses: Uses,
    polygons: Polygons,
    surfaces: Triangulation,
    names: list[str],
    notes: list[str],
) -> ParsedFile:
    """Gather the triangles of each object, in file order."""
    objects, object_of_polygon = np.unique(uses.object_index, return_inverse=True)
    faces, source_face = surfaces.triangles, surfaces.polygon_of_triangle
    object_of_face = object_of_polygon[source_face]
    if (object_of_face[1:] < object_of_face[:-1]).any():
        order = np.argsort(object_of_face, kind="stable")
        faces, source_face = faces[order], source_face[order]
    counts = np.bincount(object_of_face, minlength=len(objects))
    found = np.flatnonzero(surfaces.finding)
    listed = objects.tolist()
    parents = log.object_parents
    surface_names = SurfaceNames()
    number = np.array([surface_names.number_of(name) for name in log.surfaces], np.uint8)
    return ParsedFile(
        polygons.positions,
        np.ascontiguousarray(faces),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        source_face,
        tuple(names[i] for i in listed),
        FaceFindings(
            surfaces.finding[found],
            object_of_polygon[found].astype(np.uint32),
            found.astype(np.uint32),
        ),
        tuple(notes),
        object_types=tuple(log.object_types[i] for i in listed),
        object_parents=tuple("" if parents[i] < 0 else names[parents[i]] for i in listed),
        surface_names=surface_names.names(),
        surface_of_polygon=number[uses.surface],
        crs=polygons.crs,
    )
