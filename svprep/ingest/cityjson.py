"""The reader of CityJSON 0.x, 1.0, 1.1 and 2.0, and of CityJSONSeq (one feature per line).

One object per CityObject with a surface at the chosen level of detail
(`svprep.ingest.lod`), in the order of the file, named by its id. Its type and its parent are
those that the file states (`CityObjectGroup` is nobody's parent). Surfaces keep the name of
their semantics.

`source_face` counts the polygons of the chosen geometries, from 0, in the order of the file:
object by object, in each its geometries, in each its surfaces as the boundaries list them,
those that are too short to be a surface included. Geometries of other levels do not count.

The vertices are read straight from the text, and objects a megabyte at a time, so that the
memory used beside the text is that of the flat arrays, whatever the attributes and textures
(`svprep.ingest.cityjson_text`).

Positions: ``vertex * scale + translate``. x is to the east, as all writers of CityJSON have
it in projected coordinates; where the numbers fit the area of the CRS only the other way
round, as of PLATEAU's latitudes, they are swapped and a note says so.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from svprep.errors import InputError, first_few
from svprep.ingest.cityjson_axes import is_north_first
from svprep.ingest.cityjson_geometry import NO_SURFACE, MalformedError
from svprep.ingest.cityjson_objects import Objects, lod_of
from svprep.ingest.cityjson_polygons import Polygons, chosen_polygons
from svprep.ingest.cityjson_text import Span, Text
from svprep.ingest.crs_given import crs_in_use
from svprep.ingest.crs_names import proportional
from svprep.ingest.holes import triangulate_rings
from svprep.ingest.lod import choose_lods
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile, Report, count_of, encodable, shown
from svprep.model import F64, I64, U8, FaceFindings

_WHOLE: Final = ("CityJSON", "CityModel")  # CityModel: version 0.1
_FEATURE: Final = "CityJSONFeature"
_LAST_VERSION: Final = 2
_SHOWN: Final = 3


def read_cityjson(
    data: U8, path: Path, stem: str, report: Report, options: ReadOptions
) -> ParsedFile:
    """Read a CityJSON file, or a sequence of features behind one.

    Parameters
    ----------
    data : (n_bytes + 1,) uint8
        The text and a line feed behind it.
    path, stem
        For messages.
    report
        Told the fraction that is done.
    options
        `lod` and `crs` are honoured; types and surfaces are filtered by `svprep.ingest.filters`.

    Raises
    ------
    InputError
        One line, with the object's id where there is one.

    Notes
    -----
    O(n). Beside the text: 24 bytes per vertex, 4 per corner, and the trees of a megabyte of
    objects.
    """
    reading = _Reading(Text(data, path), Objects(path, data.size))
    with (
        _without_collector(),
        np.errstate(over="ignore", invalid="ignore"),
    ):  # what is not finite is refused
        reading.read(report)
        positions = reading.positions()
        parsed = _parsed(reading, positions, options)
    report(1.0)
    return parsed


@contextmanager
def _without_collector() -> Iterator[None]:
    """Let Python's collector of cycles rest.

    JSON makes millions of lists and no cycle: it would walk them all, again and again, and
    take as long as the parser does.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class _Reading:
    """One file while it is read."""

    def __init__(self, text: Text, objects: Objects) -> None:
        self.text = text
        self.path = text.path
        self.objects = objects
        self.vertices: list[F64] = []
        self.first_vertex: list[int] = [0]  # by document, and the total
        self.first_corner: list[int] = [0]
        self.transform: tuple[F64, F64] | None = None
        self.crs = ""
        self.notes: list[str] = []

    def read(self, report: Report) -> None:
        """Read all documents of the file."""
        text = self.text
        pos = text.skip_blanks(text.begin())
        n_documents = 0
        while pos < text.data.size:
            what = "feature " + str(n_documents) if n_documents else "CityJSON"
            spans, end = text.members(pos, text.data.size, what)
            members = text.by_name(spans, what)
            if n_documents == 0:
                self._read_header(members)
            else:
                self._check_feature(members, what)
            self._read_document(members, what)
            n_documents += 1
            pos = text.skip_blanks(end)
            report(0.9 * pos / text.data.size)
        if n_documents == 0:
            raise InputError(f"{self.path}: there is nothing but white space in this file.")

    def positions(self) -> F64:
        """Return the vertices of all documents."""
        return self.vertices[0] if len(self.vertices) == 1 else np.concatenate(self.vertices)

    def _read_header(self, members: dict[str, Span]) -> None:
        """Read what all documents share, of the first one."""
        text = self.text
        kind = text.tree(members["type"], "type") if "type" in members else None
        if kind == _FEATURE:
            raise InputError(
                f"{self.path}: a CityJSONFeature comes first; the first line of a sequence is a "
                '"CityJSON" with the transform of all.'
            )
        if kind not in _WHOLE:
            found = f'its "type" is {shown(repr(kind))}' if kind else 'it has no "type"'
            raise InputError(f'{self.path}: not CityJSON: {found}; that of CityJSON is "CityJSON".')
        version = text.tree(members["version"], "version") if "version" in members else ""
        major = str(version).rpartition("/")[2].partition(".")[0]
        if major.isdecimal() and int(major) > _LAST_VERSION:
            self.notes.append(
                f"version {shown(version)} is newer than those that are known (up to 2.0)"
            )
        metadata = text.tree(members["metadata"], "metadata") if "metadata" in members else None
        self.crs = _crs_of(metadata)
        if "geometry-templates" in members:
            self._read_templates(members["geometry-templates"])

    def _check_feature(self, members: dict[str, Span], what: str) -> None:
        """Raise `InputError` for a document behind the first that is no feature."""
        kind = self.text.tree(members["type"], what) if "type" in members else None
        if kind != _FEATURE:
            raise InputError(
                f'{self.path}: {what}: its "type" is {shown(repr(kind))}; behind the first object '
                f'of a file stand only those of type "{_FEATURE}".'
            )

    def _read_templates(self, span: Span) -> None:
        """Read the geometry templates."""
        text, what = self.text, "geometry-templates"
        members = text.by_name(text.members(*span, what)[0], what)
        templates = self.objects.templates
        if "vertices-templates" in members:
            templates.vertices = text.vertices(members["vertices-templates"], "vertices-templates")
        listed = text.tree(members["templates"], what) if "templates" in members else []
        for i, template in enumerate(listed if isinstance(listed, list) else [listed]):
            try:
                if not isinstance(template, dict):
                    raise MalformedError("it is no geometry")
                templates.add(template, lod_of(template), self.objects.surface_names)
            except MalformedError as problem:
                raise InputError(f"{self.path}: geometry template {i}: {problem}.") from None
        templates.check(self.path)

    def _read_document(self, members: dict[str, Span], what: str) -> None:
        """Read the vertices and objects of the whole file, or of one feature."""
        text = self.text
        if "transform" in members:
            self.transform = _transform_of(text.tree(members["transform"], "transform"), self.path)
        vertices = np.zeros((0, 3))
        if "vertices" in members:
            where = "vertices" if what == "CityJSON" else f"{what}, vertices"
            vertices = text.vertices(members["vertices"], where)
        if self.transform is not None:
            scale, translate = self.transform
            vertices *= scale
            vertices += translate
        if not np.isfinite(vertices).all():
            bad = int(np.argmin(np.isfinite(vertices).all(axis=1)))
            raise InputError(
                f"{self.path}: {what}: vertex {bad} is too large to be a position once it is "
                "transformed; repair it or the transform."
            )
        if "CityObjects" in members:
            spans, _ = text.members(*members["CityObjects"], "CityObjects")
            batches = (batch for batch, _ in text.objects(spans, "object"))
            self.objects.add(batches, self.first_vertex[-1], len(vertices))
        self.vertices.append(vertices)
        self.first_vertex.append(self.first_vertex[-1] + len(vertices))
        self.first_corner.append(len(self.objects.surfaces.corners))
        if self.first_vertex[-1] >= 1 << 32:
            raise InputError(f"{self.path}: more than 2**32 - 1 vertices; split the file.")


def _crs_of(metadata: Any) -> str:
    """Return the CRS that the metadata state, "" for none."""
    listed = metadata if isinstance(metadata, list) else [metadata]
    for entry in listed:
        if not isinstance(entry, dict):
            continue
        stated = entry.get("referenceSystem")
        if isinstance(stated, str) and stated.strip():
            return encodable(stated.strip())
        old = entry.get("crs")
        if isinstance(old, dict) and type(old.get("epsg")) is int:
            return f"EPSG:{old['epsg']}"
    return ""


def _transform_of(stated: Any, path: Path) -> tuple[F64, F64]:
    """Return scale and translation."""
    vectors = []
    for key in ("scale", "translate"):
        numbers = stated.get(key) if isinstance(stated, dict) else None
        if (
            not isinstance(numbers, list)
            or len(numbers) != 3
            or not set(map(type, numbers)) <= {int, float}
        ):
            raise InputError(f'{path}: the "{key}" of its transform is not three numbers.')
        vectors.append(np.array([float(n) if abs(n) < 1e300 else np.nan for n in numbers]))
    if not (np.isfinite(vectors).all() and vectors[0].all()):
        raise InputError(f"{path}: its transform is not finite, or scales by 0.")
    return vectors[0], vectors[1]


def _parsed(reading: _Reading, positions: F64, options: ReadOptions) -> ParsedFile:
    """Choose levels, triangulate, and put the parsed file together."""
    objects, path = reading.objects, reading.path
    choice = choose_lods(objects.parent, objects.types, objects.lods, options.lod, path)
    notes = [*reading.notes, *_notes(objects), *choice.notes(objects.names, options.lod)]
    crs = crs_in_use(reading.crs, options.crs)
    positions, polygons = chosen_polygons(
        objects,
        choice,
        crs,
        positions,
        np.array(reading.first_vertex, np.int64),
        np.array(reading.first_corner, np.int64),
    )
    if polygons.object.size == 0:
        n = count_of(len(objects.names), "object")
        raise InputError(
            f"{path}: no surface in {n}, so nothing that casts a shadow"
            + (f" ({'; '.join(notes)})." if notes else ".")
        )
    positions, swapped = _east_first(positions, polygons, crs)
    faces, source_face, finding = triangulate_rings(
        proportional(positions, crs),
        polygons.corners,
        polygons.ring_start,
        polygons.polygon_start,
    )
    if len(faces) == 0:
        n = count_of(polygons.object.size, "surface")
        raise InputError(
            f"{path}: none of the {n} has three different corners, so nothing casts a shadow."
        )
    kept, index = np.unique(polygons.object, return_inverse=True)
    return ParsedFile(
        positions,
        np.ascontiguousarray(faces),
        np.searchsorted(index[source_face], np.arange(kept.size + 1)),
        source_face,
        tuple(objects.names[i] for i in kept.tolist()),
        _findings(finding, index),
        tuple([*notes, *swapped]),
        object_types=tuple(objects.types[i] for i in kept.tolist()),
        object_parents=tuple(objects.parent_name[i] for i in kept.tolist()),
        surface_names=objects.surface_names.names(),
        surface_of_polygon=polygons.name,
        crs=reading.crs,
    )


def _findings(finding: Any, object_of_polygon: I64) -> FaceFindings:
    """Return the findings of polygons as a list."""
    found = np.flatnonzero(finding)
    return FaceFindings(
        finding[found], object_of_polygon[found].astype(np.uint32), found.astype(np.uint32)
    )


def _east_first(positions: F64, polygons: Polygons, crs: str) -> tuple[F64, tuple[str, ...]]:
    """Return positions whose x is to the east, and a note if they had to be swapped."""
    is_used = np.zeros(len(positions), np.bool_)
    is_used[polygons.corners] = True
    if not is_north_first(positions[is_used], crs):
        return positions, ()
    return np.ascontiguousarray(positions[:, [1, 0, 2]]), (
        f"the first two coordinates were swapped, so that x is to the east ({shown(crs)})",
    )


def _notes(objects: Objects) -> list[str]:
    """Return a line on each thing that is no surface or does not fit."""
    notes = [
        f"{count_of(n, f'{kind} geometry', f'{kind} geometries')} ({NO_SURFACE[kind]}) left out"
        for kind, n in sorted(objects.left_out.items())
    ]
    n = objects.surfaces.left_out["semantics"] + objects.templates.surfaces.left_out["semantics"]
    if n:
        notes.append(
            f"{count_of(n, 'geometry', 'geometries')} with semantics that do not fit the "
            "boundaries: its surfaces have no names"
        )
    seen: set[str] = set()
    repeated = [name for name in objects.names if name in seen or seen.add(name)]  # type: ignore[func-returns-value]
    if repeated:
        n_ids = count_of(len(repeated), "object")
        notes.append(
            f"{n_ids} with the id of an earlier one, kept: "
            f"{first_few((shown(name) for name in repeated), _SHOWN)}"
        )
    return notes
