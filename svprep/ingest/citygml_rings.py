"""Rings while the XML is read: their text is collected, and converted a chunk at a time."""

from __future__ import annotations

from array import array
from pathlib import Path

from svprep.errors import InputError
from svprep.ingest.citygml_log import LOOSE_RING, NO_OBJECT, CityLog
from svprep.ingest.citygml_names import local_name
from svprep.ingest.citygml_numbers import RING_END, parse_rings
from svprep.ingest.citygml_xml import new_parser
from svprep.ingest.parsed import shown

Attributes = dict[str, str]


class RingReader:
    """What stands in polygons: rings of ``gml:pos``, ``gml:posList``, ``gml:coordinates``.

    Also the texts that stand elsewhere. Text is collected between the start and the end of
    an element that holds it, and nowhere else.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.log = CityLog()
        self.parser = new_parser(path)
        self.object = NO_OBJECT
        self.dimension = 0  # as the nearest geometry states it; 0: none does
        self.n_rings = -1  # of the open polygon; -1: none is open
        self.in_ring, self.is_interior = False, False
        self.n_positions, self.ring_dimension, self.has_list = 0, 0, False
        self.list_separators = ".", ",", " "
        self.is_place = False  # inside the reference point of an implicit geometry
        self.reference_point = ""
        self.captured: list[str] = []
        # Rings that are read and not yet converted.
        self.texts: list[str] = []
        self.n_whole_texts = 0
        self.positions_of_ring, self.dimension_of_ring = array("q"), array("q")
        self.polygon_of_ring = array("q")

    def start_ring(self, name: str, attributes: Attributes) -> None:
        """Open a ring, if a polygon is open."""
        if self.in_ring:
            self.fail(f"<{local_name(name)}> inside a ring")
        if self.n_rings < 0:
            self.log.left_out[LOOSE_RING] += 1
            return
        self.in_ring = True
        self.n_positions = 0
        self.has_list = False
        self.ring_dimension = self.stated_dimension(attributes) if attributes else self.dimension

    def end_ring(self, name: str) -> None:
        """Close it."""
        if not self.in_ring:
            return
        self.in_ring = False
        self.texts.append(RING_END)
        self.positions_of_ring.append(0 if self.has_list else self.n_positions)
        self.dimension_of_ring.append(self.ring_dimension)
        self.polygon_of_ring.append(self.log.n_polygons())
        self.n_whole_texts = len(self.texts)
        if self.is_interior and self.n_rings == 0:
            self.log.n_odd_outlines += 1
        self.is_interior = False
        self.n_rings += 1

    def start_pos(self, name: str, attributes: Attributes) -> None:
        """Collect a position of a ring or of a reference point."""
        if self.in_ring:
            self.parser.CharacterDataHandler = self.texts.append
        elif self.is_place:
            self.start_text(name, attributes)

    def end_pos(self, name: str) -> None:
        """Keep it."""
        if self.in_ring:
            self.parser.CharacterDataHandler = None
            self.texts.append(" ")
            self.n_positions += 1
        elif self.is_place:
            self.reference_point = self.end_text()

    def start_list(self, name: str, attributes: Attributes) -> None:
        """Collect a list of positions."""
        self.start_pos(name, attributes)
        self.has_list = True
        if self.in_ring and "srsDimension" in attributes:
            self.ring_dimension = self.stated_dimension(attributes)

    def end_list(self, name: str) -> None:
        """Keep it."""
        self.end_pos(name)

    def start_coordinates(self, name: str, attributes: Attributes) -> None:
        """Collect a list as GML 2 writes it: ``x,y,z x,y,z``."""
        if self.in_ring or self.is_place:
            decimal, cs, ts = (attributes.get(key) for key in ("decimal", "cs", "ts"))
            self.list_separators = decimal or ".", cs or ",", ts or " "
            self.start_text(name, attributes)

    def end_coordinates(self, name: str) -> None:
        """Keep it, with blanks for its separators."""
        if not (self.in_ring or self.is_place):
            return
        text = self.end_text()
        decimal, cs, ts = self.list_separators
        tuples = text.replace(ts, " ").split() if ts != " " else text.split()
        width = tuples[0].count(cs) + 1 if tuples and len(cs) == 1 else 0
        text = " ".join(tuples).replace(cs, " ")
        if decimal != ".":
            text = text.replace(decimal, ".")
        if self.is_place and not self.in_ring:
            self.reference_point = text
            return
        self.texts.append(f" {text} ")
        self.has_list = True
        self.ring_dimension = width

    def convert_rings(self) -> None:
        """Turn the text of whole rings into numbers; that of an open ring waits."""
        n = self.n_whole_texts
        if n == 0:
            return
        self.n_whole_texts = 0
        points, sizes = parse_rings(
            self.texts[:n], self.positions_of_ring, self.dimension_of_ring, self._where
        )
        self.log.points.append(points)
        self.log.ring_sizes.append(sizes)
        del self.texts[:n]
        for values in (self.positions_of_ring, self.dimension_of_ring, self.polygon_of_ring):
            del values[:]

    def _where(self, ring: int) -> str:
        """Say where a ring that waits to be converted stands."""
        log = self.log
        polygon = self.polygon_of_ring[ring] if ring < len(self.polygon_of_ring) else -1
        name = next((k for k, v in log.polygon_of_id.items() if v == polygon), "")
        what = f'polygon "{shown(name)}"' if name else f"polygon {polygon}, counted from 0"
        is_whole = 0 <= polygon < log.n_polygons()
        owner = log.polygon_object[polygon] if is_whole else self.object
        if owner != NO_OBJECT:
            called = log.object_ids[owner]
            what += f", in {log.object_types[owner]}" + (f' "{shown(called)}"' if called else "")
        return f"{self.path}: {what}"

    def start_text(self, name: str, attributes: Attributes) -> None:
        """Collect the text of an element."""
        self.captured = []
        self.parser.CharacterDataHandler = self.captured.append

    def end_text(self) -> str:
        """Return that text."""
        self.parser.CharacterDataHandler = None
        text = "".join(self.captured).strip()
        self.captured = []
        return text

    def stated_dimension(self, attributes: Attributes) -> int:
        """Return how many numbers make a position: as stated here, or as around here."""
        text = attributes.get("srsDimension")
        if text is None:
            return self.dimension
        if text.strip() not in ("2", "3"):
            self.fail(f'srsDimension="{shown(text)}", not 2 or 3')
        return int(text)

    def fail(self, what: str) -> None:
        """Raise `InputError` with the line that is read."""
        raise InputError(
            f"{self.path}: line {self.parser.CurrentLineNumber}: {what}; the file is damaged."
        )
