"""The reader of Wavefront OBJ.

Read: ``v`` (weights and colours after x y z are ignored), ``f`` in all forms with any
number of corners, ``o`` and ``g``. Continued lines, any line end, any blanks, comments.
Counted and reported: points, lines, curves and free-form surfaces, keywords that OBJ
does not have. Everything else (texture, normals, materials, smoothing) is skipped.

What the objects are: if a file has two or more different ``o`` names, those are the
objects, and faces before the first ``o`` belong to an object named by the file's stem.
With a single ``o`` name O it is the same, except where there are two or more different
groups: the objects are then the groups, named ``O/G`` (``O`` outside of any group, and
the stem in place of O before the ``o``), so that no name is lost. A file without ``o``
names is split by its groups, if it has ``g`` statements. Otherwise it is one object, named
by its stem.

The whole text after ``o`` or ``g`` is the name, ``default`` where there is none: with an
``o`` the group ``default`` is no group, and ``o`` statements without any name are none.
A name that comes back continues its object. Objects are ordered by first face.

An export of svprep begins with comments (`svprep.ingest.own_header`), which tell types,
parents, the CRS, and names that ``o`` cannot say.

The text is cut at line ends into chunks of fixed size, which threads parse
(`svprep.kernels.obj_parser`): the result does not depend on their number.
"""

from __future__ import annotations

import queue
import re
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from svprep.errors import InputError
from svprep.ingest.obj_statements import decode, keyword_notes, objects_of
from svprep.ingest.own_header import OwnHeader, parse_header
from svprep.ingest.parsed import ParsedFile, Report, count_of
from svprep.ingest.triangulation import Triangulation, triangulate
from svprep.kernels import obj_parser
from svprep.kernels.obj_parser import ChunkCounts
from svprep.model import F64, I32, I64, U8, U32, FaceFindings

CHUNK_BYTES = 2 << 20
_BINARY_PROBE_BYTES = 4096
_OWN_MARK = b"# svprep export "
_NO_COMMENT = re.compile(rb"[\r\n](?!#)")

_TOKEN = re.compile(rb"[^ \t\v\f\r\n\\#]*")


class _Room(NamedTuple):
    """Where a chunk is parsed to; see `svprep.kernels.obj_parser.parse_obj`."""

    xyz: F64
    corners: I32
    polygon_size: I32
    statements: I64
    deferred: I64


@dataclass(frozen=True, slots=True)
class _Chunk:
    """A parsed chunk; arrays as `svprep.kernels.obj_parser.parse_obj` fills them."""

    begin: int
    end: int
    counts: ChunkCounts
    xyz: F64
    corners: I32
    polygon_size: I32
    statements: I64
    """``(n, 5)``"""
    deferred: I64
    """``(n, 4)``"""


@dataclass(frozen=True, slots=True)
class _Text:
    """A whole parsed file, before triangulation."""

    positions: F64
    """``(n_vertices, 3)``"""
    corners: U32
    polygon_start: I64
    statements: I64
    """``(n, 5)``; polygons and lines count from the start of the file."""


def read_obj(data: U8, path: Path, stem: str, pool: Executor, report: Report) -> ParsedFile:
    """Read the text of an OBJ file.

    Parameters
    ----------
    data : (n_bytes + 1,) uint8
        The text and a line feed behind it.
    path, stem
        For messages, and for an object without a name.
    pool
        Parses chunks.
    report
        Told the fraction that is done.

    Raises
    ------
    InputError
        With file and line, at the first statement that cannot be read.

    Notes
    -----
    About 3 ns per byte in all, on two threads.
    """
    _refuse_binary(data, path)
    chunks = _parse(data, path, pool, report)
    text = _join(data, chunks, path)
    names, object_of_polygon, group_notes = objects_of(
        data, text.statements, text.polygon_start.size - 1, stem
    )
    notes = keyword_notes(data, text.statements) + group_notes
    if len(object_of_polygon) == 0:
        raise InputError(
            f"{path}: no face (f) in this file, so nothing that casts a shadow"
            + (f" ({'; '.join(notes)})." if notes else ".")
        )
    triangulation = triangulate(text.positions, text.corners, text.polygon_start)
    if len(triangulation.triangles) == 0:
        raise InputError(
            f"{path}: none of the {count_of(len(object_of_polygon), 'face')} has three different "
            "corners, so nothing casts a shadow."
        )
    report(1.0)
    parsed = _group(text.positions, triangulation, names, object_of_polygon, notes)
    header = parse_header(_head_comments(data), path)
    return parsed if header is None else _labelled(parsed, header)


def _head_comments(data: U8) -> list[str]:
    """Return the comment lines that an export of svprep begins with, without their marks."""
    if data[: len(_OWN_MARK)].tobytes() != _OWN_MARK:
        return []
    # The first byte of a line that is no comment ends them.
    text = data.tobytes()
    end = _NO_COMMENT.search(text)
    head = text[: end.start() + 1 if end else len(text)].decode(errors="replace")
    return [line[2:] for line in head.splitlines()]


def _labelled(parsed: ParsedFile, header: OwnHeader) -> ParsedFile:
    """Return an export of svprep with what its header says of the objects."""
    told = {found.written: found for found in header.objects}
    of = [told.get(name) for name in parsed.object_names]
    return replace(
        parsed,
        object_names=tuple(
            found.name if found else name
            for found, name in zip(of, parsed.object_names, strict=True)
        ),
        object_types=tuple(found.type if found else "" for found in of),
        object_parents=tuple(found.parent if found else "" for found in of),
        crs=header.crs,
    )


def _refuse_binary(data: U8, path: Path) -> None:
    """Raise `InputError` for what is not text in any encoding that OBJ files use."""
    head = data[:_BINARY_PROBE_BYTES].tobytes()
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: this is UTF-16 text; save it as UTF-8.")
    if b"\0" in head:
        raise InputError(
            f"{path}: this is a binary file, not OBJ text; give it the suffix of its format."
        )


def _parse(data: U8, path: Path, pool: Executor, report: Report) -> list[_Chunk]:
    """Parse all chunks; raise at the first statement that cannot be read."""
    begin = 3 if data[:3].tobytes() == b"\xef\xbb\xbf" else 0
    bounds = _chunk_bounds(data, begin)
    room = max(end - begin for begin, end in bounds)
    rooms: queue.SimpleQueue[_Room] = queue.SimpleQueue()

    def parse(bound: tuple[int, int]) -> _Chunk:
        try:
            arrays = rooms.get_nowait()
        except queue.Empty:
            arrays = _room(room)
        chunk = _parse_chunk(data, *bound, -1, arrays)
        rooms.put(arrays)
        return chunk

    chunks = []
    for chunk in pool.map(parse, bounds):
        chunks.append(chunk)
        if chunk.counts.status:
            raise _statement_error(data, chunks, path)
        report(chunk.end / data.size)
    return chunks


def _chunk_bounds(data: U8, begin: int) -> list[tuple[int, int]]:
    """Cut the text into chunks of whole statements."""
    bounds = []
    while begin < data.size:
        end = _statement_end(data, begin + CHUNK_BYTES)
        bounds.append((begin, end))
        begin = end
    return bounds


def _statement_end(data: U8, pos: int) -> int:
    """Return the first byte behind a line that ends at `pos` or later and is not continued."""
    window = 4096
    while pos < data.size:
        part = data[pos : pos + window]
        ends = np.flatnonzero((part == 0x0A) | (part == 0x0D))
        if ends.size == 0:
            pos += part.size
            window *= 2
            continue
        last = before = pos + int(ends[0])
        if data[last : last + 2].tobytes() == b"\r\n":
            last += 1
        while before > 0 and data[before] in b" \t\v\f\r\n":
            before -= 1
        pos = last + 1
        if data[before] != 0x5C:
            return pos
    return int(data.size)


def _room(n_bytes: int) -> _Room:
    """Return arrays that hold whatever a chunk may contain. Untouched pages cost nothing."""
    return _Room(
        np.empty(3 * (n_bytes // 8 + 1), np.float64),
        np.empty(n_bytes // 2 + 1, np.int32),
        np.empty(n_bytes // 2 + 1, np.int32),
        np.empty(obj_parser.STATEMENT_COLUMNS * (n_bytes // 2 + 1), np.int64),
        np.empty(obj_parser.DEFERRED_COLUMNS * (n_bytes // 5 + 1), np.int64),
    )


def _parse_chunk(data: U8, begin: int, end: int, stop_corner: int, room: _Room) -> _Chunk:
    """Parse one chunk and copy what was found out of the `room`."""
    counts = ChunkCounts(*obj_parser.parse_obj(data, begin, end, stop_corner, *room))
    n, m = obj_parser.STATEMENT_COLUMNS, obj_parser.DEFERRED_COLUMNS
    return _Chunk(
        begin,
        end,
        counts,
        room.xyz[: 3 * counts.n_vertices].copy(),
        room.corners[: counts.n_corners].copy(),
        room.polygon_size[: counts.n_polygons].copy(),
        room.statements[: n * counts.n_statements].reshape(-1, n).copy(),
        room.deferred[: m * counts.n_deferred].reshape(-1, m).copy(),
    )


def _token_at(data: U8, pos: int) -> str:
    """Return the token at a byte, shortened for a message."""
    match = _TOKEN.match(data[pos : pos + 200].tobytes())
    token = decode(match.group()) if match else ""
    return token if len(token) <= 40 else token[:37] + "..."


def _statement_error(data: U8, chunks: list[_Chunk], path: Path) -> InputError:
    """Say what stopped the parser in the last of `chunks`."""
    counts = chunks[-1].counts
    line = counts.stop_line + sum(chunk.counts.n_lines for chunk in chunks[:-1])
    where = f"{path}, line {line}: "
    if counts.status == obj_parser.FEW_NUMBERS:
        found = count_of(counts.stop_byte, "number")
        return InputError(f"{where}a vertex (v) with {found}; x, y and z are needed.")
    token = _token_at(data, counts.stop_byte)
    if counts.status == obj_parser.ZERO_INDEX:
        return InputError(f"{where}face refers to vertex 0, but OBJ counts vertices from 1.")
    if counts.status == obj_parser.BAD_INDEX:
        return InputError(f'{where}"{token}" in a face (f) is not a vertex index.')
    if re.fullmatch(r"[+-]?(nan|inf|infinity|[0-9.]*#.*)(\(.*)?", token, re.IGNORECASE):
        return _not_finite(where, token)
    hint = " (decimals take a point, not a comma)" if "," in token else ""
    return InputError(f'{where}"{token}" in a vertex (v) is not a number{hint}.')


def _not_finite(where: str, token: str) -> InputError:
    return InputError(
        f'{where}"{token}" in a vertex (v) is not a finite coordinate; remove or repair it.'
    )


def _join(data: U8, chunks: list[_Chunk], path: Path) -> _Text:
    """Put the chunks together: numbers left to ``float()``, relative indices, line numbers."""
    n_vertices = np.array([chunk.counts.n_vertices for chunk in chunks])
    first_vertex = np.cumsum(n_vertices) - n_vertices
    n_total = int(n_vertices.sum())
    if n_total >= obj_parser.RELATIVE:
        raise InputError(
            f"{path}: {n_total} vertices; one file may hold {obj_parser.RELATIVE - 1}. Split it."
        )
    first_line = first_polygon = 0
    statements = []
    for i, chunk in enumerate(chunks):
        for slot, begin, end, line in chunk.deferred.tolist():
            value = float(data[begin:end].tobytes())
            if value - value != 0.0:
                where = f"{path}, line {first_line + line}: "
                raise _not_finite(where, _token_at(data, begin))
            chunk.xyz[slot] = value
        corners = chunk.corners
        is_relative = corners < 0
        if is_relative.any():
            absolute = corners[is_relative].astype(np.int64) + obj_parser.RELATIVE
            absolute += first_vertex[i]
            corners[is_relative] = np.where(absolute < 0, obj_parser.PAST_END, absolute)
        if corners.size and corners.max() >= n_total:
            bad = int(np.argmax(corners >= n_total))
            raise _index_error(data, chunk, bad, first_line, int(first_vertex[i]), n_total, path)
        chunk.statements[:, 3] += first_polygon
        chunk.statements[:, 4] += first_line
        statements.append(chunk.statements)
        first_polygon += chunk.counts.n_polygons
        first_line += chunk.counts.n_lines
    if all(chunk.counts.only_triangles for chunk in chunks):
        polygon_start = np.arange(0, 3 * first_polygon + 1, 3)
    else:
        sizes = np.concatenate([chunk.polygon_size for chunk in chunks])
        polygon_start = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
    return _Text(
        np.concatenate([chunk.xyz for chunk in chunks]).reshape(-1, 3),
        np.concatenate([chunk.corners for chunk in chunks]).view(np.uint32),
        polygon_start,
        np.concatenate(statements),
    )


def _index_error(
    data: U8, chunk: _Chunk, corner: int, first_line: int, first_vertex: int, total: int, path: Path
) -> InputError:
    """Say where the index of a corner stands that no vertex has."""
    room = _room(chunk.end - chunk.begin)
    found = _parse_chunk(data, chunk.begin, chunk.end, corner, room).counts
    token = _token_at(data, found.stop_byte).split("/")[0]
    if token.startswith("-"):
        scope = f"only {count_of(first_vertex + found.n_vertices, 'vertex', 'vertices')} are "
        scope += "defined before it"
    else:
        scope = f"only {count_of(total, 'vertex', 'vertices')} are defined in the file"
    scope = scope.replace("1 vertex are", "1 vertex is")
    return InputError(
        f"{path}, line {first_line + found.stop_line}: face refers to vertex {token}, but {scope}."
    )


def _group(
    positions: F64,
    triangulation: Triangulation,
    names: tuple[str, ...],
    object_of_polygon: I64,
    notes: list[str],
) -> ParsedFile:
    """Gather the triangles of each object, in file order."""
    faces, source_face, finding = triangulation
    object_of_face = object_of_polygon[source_face]
    if (object_of_face[1:] < object_of_face[:-1]).any():
        order = np.argsort(object_of_face, kind="stable")
        faces, source_face = faces[order], source_face[order]
    counts = np.bincount(object_of_face, minlength=len(names))
    found = np.flatnonzero(finding)
    findings = FaceFindings(
        finding[found], object_of_polygon[found].astype(np.uint32), found.astype(np.uint32)
    )
    return ParsedFile(
        positions,
        np.ascontiguousarray(faces),
        np.concatenate([[0], np.cumsum(counts)]),
        source_face,
        names,
        findings,
        tuple(notes),
    )
