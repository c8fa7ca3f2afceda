"""Reading CityGML as a stream: expat's events fill a `svprep.ingest.citygml_log.CityLog`.

expat is a parser in C that comes with Python. A Python function is called for every
element, so each of them does little: names are looked up once, text is collected only
inside coordinates, and turned into numbers a megabyte at a time.

A city file is untrusted input: no entity is ever expanded and nothing else is opened.
"""

from __future__ import annotations

import pyexpat
from collections.abc import Callable
from pathlib import Path
from typing import Final

from svprep.errors import InputError
from svprep.ingest.citygml_log import (
    FAR_TEMPLATE,
    LOOSE_TEMPLATE,
    NO_LOD,
    NO_OBJECT,
    REPEATED_ID,
    TEMPLATE_LOD,
    CityLog,
    Placement,
    Reference,
    Span,
)
from svprep.ingest.citygml_names import (
    HREF,
    LEVEL,
    ROOTS,
    Role,
    id_of,
    level_of,
    local_name,
    role_of,
)
from svprep.ingest.citygml_rings import Attributes, RingReader
from svprep.ingest.citygml_xml import xml_error
from svprep.ingest.parsed import Report, shown
from svprep.model import U8

_CHUNK_BYTES: Final = 1 << 20

_Call = Callable[..., None]
"""Takes the name of an element and, at its start, the attributes."""


def read_events(data: U8, path: Path, report: Report) -> CityLog:
    """Read the XML of a file.

    Parameters
    ----------
    data : (n_bytes,) uint8

    Raises
    ------
    InputError
        It is no well-formed XML, or not CityGML; it declares entities; a number in a ring
        cannot be read.

    Notes
    -----
    O(n) time; memory in proportion to the geometry, and a chunk of text.
    """
    recorder = _Recorder(path)
    parser = recorder.parser
    try:
        for begin in range(0, data.size, _CHUNK_BYTES):
            parser.Parse(data[begin : begin + _CHUNK_BYTES].tobytes(), False)
            recorder.convert_rings()
            report(min(begin + _CHUNK_BYTES, data.size) / data.size)
        parser.Parse(b"", True)
    except (pyexpat.ExpatError, LookupError, ValueError) as error:
        raise xml_error(path, error) from None
    recorder.convert_rings()
    return recorder.log


class _Calls(dict[str, "_Call | None"]):
    """What to call at an element, by its full name; found out when it first occurs."""

    def __init__(self, call_of_role: dict[Role, _Call]) -> None:
        super().__init__()
        self.call_of_role = call_of_role

    def __missing__(self, name: str) -> _Call | None:
        call = self[name] = self.call_of_role.get(role_of(name))
        return call


class _Recorder(RingReader):
    """The state of the reading.

    Elements that change what is current push it, and restore it at their end; XML is
    well-formed, so every end finds what its start pushed.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.surface, self.lod, self.srs = 0, NO_LOD, 0
        self.features: list[tuple[int, int, int, int]] = []
        self.levels: list[int] = []  # of the open objects, as they state it in an element
        self.lod_of_name: dict[str, int] = {}
        self.is_reversed = 0
        self.geometries: list[tuple[int, int, int, str, int, int] | None] = []
        self.matrix, self.has_library = "", False
        self.placements: list[tuple[str, str, int, int, int, bool]] = []
        self.skipped_depth = 0
        self.starts = _Calls(self._start_calls())
        self.ends = _Calls(self._end_calls())
        self.parser.StartElementHandler = self._start_root
        self.parser.EndElementHandler = self._end

    def _start_calls(self) -> dict[Role, _Call]:
        return {
            Role.SKIPPED: self._start_skipping,
            Role.NO_SURFACE: self._start_no_surface,
            Role.OBJECT: self._start_object,
            Role.SURFACE: self._start_surface,
            Role.LOD_PROPERTY: self._start_lod,
            Role.PLAIN_PROPERTY: self._start_plain,
            Role.LEVEL: self.start_text,
            Role.AGGREGATE: self._start_aggregate,
            Role.ORIENTABLE: self._start_aggregate,
            Role.POLYGON: self._start_polygon,
            Role.RING: self.start_ring,
            Role.INTERIOR: self._start_interior,
            Role.LINK: self._refer,
            Role.POS: self.start_pos,
            Role.POS_LIST: self.start_list,
            Role.COORDINATES: self.start_coordinates,
            Role.LINE: self._start_line,
            Role.ENVELOPE: self._start_envelope,
            Role.IMPLICIT: self._start_placement,
            Role.TEMPLATE: self._start_template,
            Role.MATRIX: self.start_text,
            Role.REFERENCE_POINT: self._start_place,
            Role.LIBRARY: self._start_library,
        }

    def _end_calls(self) -> dict[Role, _Call]:
        return {
            Role.OBJECT: self._end_object,
            Role.SURFACE: self._end_surface,
            Role.LOD_PROPERTY: self._end_lod,
            Role.PLAIN_PROPERTY: self._end_lod,
            Role.LEVEL: self._end_level,
            Role.AGGREGATE: self._end_aggregate,
            Role.ORIENTABLE: self._end_aggregate,
            Role.POLYGON: self._end_polygon,
            Role.RING: self.end_ring,
            Role.POS: self.end_pos,
            Role.POS_LIST: self.end_list,
            Role.COORDINATES: self.end_coordinates,
            Role.IMPLICIT: self._end_placement,
            Role.MATRIX: self._end_matrix,
            Role.REFERENCE_POINT: self._end_place,
        }

    # Every element.

    def _start_root(self, name: str, attributes: Attributes) -> None:
        local = local_name(name)
        if local not in ROOTS and "citygml" not in name.lower():
            raise InputError(
                f"{self.path}: not CityGML: it begins with <{shown(local)}>, not with <CityModel>."
            )
        self.parser.StartElementHandler = self._start
        self._start(name, attributes)

    def _start(self, name: str, attributes: Attributes) -> None:
        call = self.starts[name]
        if call is not None:
            call(name, attributes)

    def _end(self, name: str) -> None:
        call = self.ends[name]
        if call is not None:
            call(name)

    # What is not looked into.

    def _start_skipping(self, name: str, attributes: Attributes) -> None:
        self.skipped_depth = 1
        self.parser.StartElementHandler = self._start_skipped
        self.parser.EndElementHandler = self._end_skipped

    def _start_no_surface(self, name: str, attributes: Attributes) -> None:
        self.log.left_out[local_name(name)] += 1
        self._start_skipping(name, attributes)

    def _start_skipped(self, name: str, attributes: Attributes) -> None:
        self.skipped_depth += 1

    def _end_skipped(self, name: str) -> None:
        self.skipped_depth -= 1
        if self.skipped_depth == 0:
            self.parser.StartElementHandler = self._start
            self.parser.EndElementHandler = self._end

    # City objects and what their surfaces are.

    def _start_object(self, name: str, attributes: Attributes) -> None:
        self.features.append((self.object, self.surface, self.lod, self.srs))
        log = self.log
        log.object_types.append(local_name(name))
        log.object_ids.append(id_of(attributes))
        log.object_parents.append(self.object)
        log.object_ends.append(0)
        self.object = len(log.object_types) - 1
        self.surface, self.lod = 0, NO_LOD
        self.levels.append(NO_LOD)

    def _end_object(self, name: str) -> None:
        self.log.object_ends[self.object] = len(self.log.object_types)
        self.levels.pop()
        self.object, self.surface, self.lod, self.srs = self.features.pop()

    def _start_surface(self, name: str, attributes: Attributes) -> None:
        if self.object == NO_OBJECT:
            self._start_object(name, attributes)
            return
        self.features.append((self.object, self.surface, self.lod, self.srs))
        self.surface = self.log.number(self.log.surfaces, local_name(name))
        self.lod = NO_LOD

    def _end_surface(self, name: str) -> None:
        if self.features[-1][0] == NO_OBJECT:
            self._end_object(name)
        else:
            self.object, self.surface, self.lod, self.srs = self.features.pop()

    def _start_lod(self, name: str, attributes: Attributes) -> None:
        self.features.append((self.object, self.surface, self.lod, self.srs))
        if self.lod != TEMPLATE_LOD:
            lod = self.lod_of_name.get(name)
            if lod is None:
                lod = self.lod_of_name[name] = self.log.number(self.log.lods, level_of(name))
            self.lod = lod
        if attributes:
            self._refer(name, attributes)

    def _start_plain(self, name: str, attributes: Attributes) -> None:
        self.features.append((self.object, self.surface, self.lod, self.srs))
        if self.object != NO_OBJECT:
            level = self.levels[-1]
            self.lod = level if level >= 0 else self.log.number(self.log.lods, "")
        self._refer(name, attributes)

    def _end_lod(self, name: str) -> None:
        self.object, self.surface, self.lod, self.srs = self.features.pop()

    def _end_level(self, name: str) -> None:
        text = self.end_text()
        if self.levels and LEVEL.fullmatch(text):
            self.levels[-1] = self.log.number(self.log.lods, f"{float(text):g}")

    def _start_envelope(self, name: str, attributes: Attributes) -> None:
        if "srsName" in attributes:
            self.srs = self.log.number(self.log.srs, attributes["srsName"])

    # Geometry.

    def _start_aggregate(self, name: str, attributes: Attributes) -> None:
        if not attributes:
            self.geometries.append(None)
            return
        log = self.log
        here = log.n_polygons(), len(log.references)
        self.geometries.append(
            (self.srs, self.dimension, self.is_reversed, id_of(attributes), *here)
        )
        if "srsName" in attributes:
            self.srs = log.number(log.srs, attributes["srsName"])
        if "srsDimension" in attributes:
            self.dimension = self.stated_dimension(attributes)
        if attributes.get("orientation") == "-":
            self.is_reversed ^= 1

    def _end_aggregate(self, name: str) -> None:
        before = self.geometries.pop()
        if before is None:
            return
        self.srs, self.dimension, self.is_reversed, name, polygon, reference = before
        if name:
            log = self.log
            span = Span(
                range(polygon, log.n_polygons()),
                range(reference, len(log.references)),
                bool(self.is_reversed),
            )
            if log.span_of_id.setdefault(name, span) is not span or name in log.polygon_of_id:
                log.left_out[REPEATED_ID] += 1

    def _start_polygon(self, name: str, attributes: Attributes) -> None:
        if self.n_rings >= 0:
            self.fail(f"<{local_name(name)}> inside a polygon")
        self.geometries.append((self.srs, self.dimension, 0, "", 0, 0))
        if attributes:
            log = self.log
            number = log.n_polygons()
            name = id_of(attributes)
            if name and log.polygon_of_id.setdefault(name, number) != number:
                log.left_out[REPEATED_ID] += 1
            if "srsName" in attributes:
                self.srs = log.number(log.srs, attributes["srsName"])
            if "srsDimension" in attributes:
                self.dimension = self.stated_dimension(attributes)
        self.n_rings = 0
        self.is_interior = False

    def _end_polygon(self, name: str) -> None:
        log = self.log
        log.polygon_object.append(self.object)
        log.polygon_lod.append(self.lod)
        log.polygon_surface.append(self.surface)
        log.polygon_srs.append(self.srs)
        log.polygon_is_reversed.append(self.is_reversed)
        log.polygon_rings.append(self.n_rings)
        self.n_rings = -1
        before = self.geometries.pop()
        assert before is not None
        self.srs, self.dimension = before[:2]

    def _start_interior(self, name: str, attributes: Attributes) -> None:
        self.is_interior = True
        if attributes:
            self._refer(name, attributes)

    def _refer(self, name: str, attributes: Attributes) -> None:
        if not attributes:
            return
        target = attributes.get(HREF)
        if target is not None:
            log = self.log
            log.references.append(
                Reference(
                    target.removeprefix("#"),
                    self.object,
                    self.lod,
                    self.surface,
                    bool(self.is_reversed),
                    log.n_polygons(),
                )
            )

    def _start_line(self, name: str, attributes: Attributes) -> None:
        if self.n_rings < 0 and self.lod != NO_LOD:
            self.log.left_out["line"] += 1

    # Implicit geometry.

    def _start_placement(self, name: str, attributes: Attributes) -> None:
        log = self.log
        self.placements.append(
            (
                self.matrix,
                self.reference_point,
                self.lod,
                log.n_polygons(),
                len(log.references),
                self.has_library,
            )
        )
        self.matrix, self.reference_point, self.has_library = "", "", False

    def _start_template(self, name: str, attributes: Attributes) -> None:
        if self.placements:
            self.lod = TEMPLATE_LOD
        self._refer(name, attributes)

    def _end_matrix(self, name: str) -> None:
        self.matrix = self.end_text()

    def _start_place(self, name: str, attributes: Attributes) -> None:
        self.is_place = bool(self.placements)

    def _end_place(self, name: str) -> None:
        self.is_place = False

    def _start_library(self, name: str, attributes: Attributes) -> None:
        self.has_library = True

    def _end_placement(self, name: str) -> None:
        log = self.log
        matrix, point, lod, polygon, reference, had_library = self.placements.pop()
        polygons = range(polygon, log.n_polygons())
        references = range(reference, len(log.references))
        if self.has_library and not polygons and not references:
            log.left_out[FAR_TEMPLATE] += 1
        elif lod >= 0 and self.object != NO_OBJECT:
            log.placements.append(
                Placement(
                    self.object,
                    lod,
                    self.surface,
                    self.srs,
                    self.matrix,
                    self.reference_point,
                    polygons,
                    references,
                    self.parser.CurrentLineNumber,
                )
            )
        else:
            log.left_out[LOOSE_TEMPLATE] += 1
        self.lod = lod
        self.matrix, self.reference_point, self.has_library = matrix, point, had_library
