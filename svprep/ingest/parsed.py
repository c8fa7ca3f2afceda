"""What one reader makes of one file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from svprep.errors import InputError
from svprep.ingest.spill import Spill, row_blocks, spilled
from svprep.model import BOOL, F64, I64, U8, U32, FaceFindings

Report = Callable[[float], None]
"""Told the fraction of a file that is read, 0 to 1."""

SHOWN_LENGTH: Final = 200
_UNENCODABLE: Final = re.compile("[\0\ud800-\udfff]")
_CONTROL: Final = re.compile(r"[\x01-\x08\x0e-\x1b\x7f]")


@dataclass(frozen=True, slots=True)
class ParsedFile:
    """`svprep.model.SourceMesh` of a single file; its fields have the same meaning."""

    positions: F64
    faces: U32
    object_face_start: I64
    source_face: U32
    object_names: tuple[str, ...]
    face_findings: FaceFindings
    notes: tuple[str, ...]
    """Without the file's name."""
    beside: tuple[bytes, ...] = ()
    """What was read from files beside this one, which its digest covers too; of 3D Tiles,
    which may be gigabytes, the SHA-256 of each file instead of its bytes."""
    object_types: tuple[str, ...] = ()
    object_parents: tuple[str, ...] = ()
    surface_names: tuple[str, ...] = ("",)
    surface_of_polygon: U8 = field(default_factory=lambda: np.zeros(0, np.uint8))
    """``(n_polygons,)``, or empty where the file states none."""
    crs: str = ""
    """As the file states it; positions are in its units, x to the east, y to the north."""


def in_files(parsed: ParsedFile, spill: Spill | None) -> ParsedFile:
    """Return a file with its tables in mapped files, if there is a `spill`."""
    if spill is None:
        return parsed
    return replace(
        parsed,
        positions=spilled(parsed.positions, spill),
        faces=spilled(parsed.faces, spill),
        source_face=spilled(parsed.source_face, spill),
        surface_of_polygon=spilled(parsed.surface_of_polygon, spill),
    )


def bytes_of_tables(parsed: ParsedFile) -> int:
    """Return what the tables that grow with polygons take in memory."""
    tables = parsed.positions, parsed.faces, parsed.source_face, parsed.surface_of_polygon
    return sum(table.nbytes for table in tables)


def no_findings() -> FaceFindings:
    """Return an empty list of findings."""
    return FaceFindings(np.empty(0, np.uint16), np.empty(0, np.uint32), np.empty(0, np.uint32))


def is_used(parsed: ParsedFile) -> BOOL:
    """Return ``(n_vertices,)``: whether each is the corner of a face."""
    found = np.zeros(len(parsed.positions), bool)
    for (faces,) in row_blocks(parsed.faces):
        found[faces.ravel()] = True
    return found


def box_of_faces(parsed: ParsedFile) -> F64 | None:
    """Return ``(2, 3)``, the lowest and highest position of a face's corner; None without faces."""
    if not len(parsed.faces):
        return None
    found = is_used(parsed)
    boxes = [
        np.stack([points.min(axis=0), points.max(axis=0)])
        for positions, is_corner in row_blocks(parsed.positions, found)
        if len(points := positions if is_corner.all() else positions[is_corner])
    ]
    return np.stack([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]])


def count_of(n: int, singular: str, plural: str = "") -> str:
    """Return ``"1 face"``, ``"12 faces"``."""
    return f"{n} {singular}" if n == 1 else f"{n} {plural or singular + 's'}"


def encodable(name: str) -> str:
    """Return a name that UTF-8 and HDF5 can hold: U+FFFD for lone surrogates and NUL."""
    return _UNENCODABLE.sub("\ufffd", name)


def all_encodable(names: Iterable[str]) -> tuple[str, ...]:
    """Return `encodable` of each name; of ASCII ones all at once."""
    names = tuple(names)
    together = "".join(names)
    if together.isascii() and "\0" not in together:
        return names
    return tuple(map(encodable, names))


def shown(value: object) -> str:
    """Return a name or a value for a note or a message: one line, not very long."""
    text = " ".join(_CONTROL.sub("\ufffd", encodable(str(value))).split())
    return text if len(text) <= SHOWN_LENGTH else text[: SHOWN_LENGTH - 3] + "..."


def refuse_non_finite(positions: F64, path: Path, what: str) -> None:
    """Raise `InputError` at the first vertex that is not finite."""
    is_bad = ~np.isfinite(positions).all(axis=1)
    if is_bad.any():
        vertex = int(np.argmax(is_bad))
        shown = ", ".join(f"{c:g}" for c in positions[vertex])
        raise InputError(
            f"{path}: {what}: vertex {vertex} is ({shown}), not a finite position "
            f"({count_of(int(is_bad.sum()), 'such vertex', 'such vertices')}); remove or repair it."
        )


def polygons_as_object(
    positions: F64,
    corners: U32,
    polygon_start: I64,
    path: Path,
    name: str,
    notes: Sequence[str] = (),
) -> ParsedFile:
    """Triangulate polygons and return them as one object.

    Raises
    ------
    InputError
        If none of them is a surface.
    """
    from svprep.ingest.triangulation import triangulate

    faces, source_face, finding = triangulate(positions, corners, polygon_start)
    if len(faces) == 0:
        raise InputError(
            f"{path}: no face with three different corners, so nothing that casts a shadow."
        )
    found = np.flatnonzero(finding)
    findings = FaceFindings(
        finding[found], np.zeros(found.size, np.uint32), found.astype(np.uint32)
    )
    return ParsedFile(
        positions,
        np.ascontiguousarray(faces),
        np.array([0, len(faces)], np.int64),
        source_face,
        (name,),
        findings,
        tuple(notes),
    )
