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

The text is read in blocks of about `CHUNK_BYTES`, cut at line ends, which threads parse
(`svprep.kernels.obj_parser`) and then, once all vertices are known, triangulate: the
result does not depend on their number. With a `Spill` no table of the file's size is held
in memory: only blocks, and what is said of objects.
"""

from __future__ import annotations

import re
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from svprep.errors import InputError
from svprep.ingest.file_bytes import Text
from svprep.ingest.obj_chunks import Chunk, Rooms, find_corner, parse_chunk
from svprep.ingest.obj_statements import Objects, Statements, keyword_notes, objects_of
from svprep.ingest.own_header import OwnHeader, parse_header
from svprep.ingest.parsed import ParsedFile, Report, count_of
from svprep.ingest.spill import Column, Spill, empty_table, release, row_blocks
from svprep.ingest.text_blocks import Block, Buffers, in_order, text_blocks
from svprep.ingest.triangulation import Triangulation, triangulate
from svprep.kernels import obj_parser
from svprep.model import F64, I32, I64, U32, FaceFindings

CHUNK_BYTES = 2 << 20
_MOST_CORNERS: Final = 1 << 19  # that are triangulated at a time
_PROBE_BYTES: Final = 4096
_OWN_MARK: Final = b"# svprep export "
_NO_COMMENT: Final = re.compile(rb"[\r\n](?!#)")


class _Part(NamedTuple):
    """Where a chunk lies in the file, and what is in it."""

    vertex: int
    """The first vertex, corner, polygon and line."""
    corner: int
    polygon: int
    line: int
    n_corners: int
    n_polygons: int
    only_triangles: bool
    highest: int
    """The greatest vertex of a corner."""


@dataclass(frozen=True, slots=True)
class _Shapes:
    """A whole parsed file, before triangulation."""

    positions: F64
    """``(n_vertices, 3)``"""
    corners: U32
    polygon_size: I32
    parts: list[_Part]
    statements: Statements


def read_obj(
    text: Text, stem: str, pool: Executor, report: Report, spill: Spill | None = None
) -> ParsedFile:
    """Read the text of an OBJ file.

    Parameters
    ----------
    text
        The file.
    stem
        Names an object without a name.
    pool
        Parses chunks.
    report
        Told the fraction that is done.
    spill
        Where tables go; memory if not given.

    Raises
    ------
    InputError
        With file and line, at the first statement that cannot be read.

    Notes
    -----
    About 3 ns per byte in all, on two threads.
    """
    path = text.path
    head = _head(text)
    _refuse_binary(head, path)
    shapes = _parsed(text, pool, report, spill)
    n_polygons = len(shapes.polygon_size)
    objects = objects_of(shapes.statements, n_polygons, stem)
    notes = keyword_notes(shapes.statements) + objects.notes
    if n_polygons == 0:
        raise InputError(
            f"{path}: no face (f) in this file, so nothing that casts a shadow"
            + (f" ({'; '.join(notes)})." if notes else ".")
        )
    parsed = _triangulated(shapes, objects, notes, pool, spill)
    if len(parsed.faces) == 0:
        raise InputError(
            f"{path}: none of the {count_of(n_polygons, 'face')} has three different "
            "corners, so nothing casts a shadow."
        )
    report(1.0)
    header = parse_header(_head_comments(text), path) if head.startswith(_OWN_MARK) else None
    return parsed if header is None else _labelled(parsed, header)


def _head(text: Text) -> bytes:
    """Return the first bytes of a text."""
    room = np.empty(_PROBE_BYTES, np.uint8)
    with text.stream() as stream:
        return room[: stream.fill(room)].tobytes()


def _head_comments(text: Text) -> list[str]:
    """Return the comment lines that an export of svprep begins with, without their marks."""
    head = b""
    end = None
    for block in text_blocks(text, CHUNK_BYTES, Buffers()):
        head += block.data[: block.n_bytes].tobytes()
        # The first byte of a line that is no comment ends them.
        end = _NO_COMMENT.search(head)
        if end and end.end() < len(head):
            break
    head = head[: end.start() + 1] if end else head
    return [line[2:] for line in head.decode(errors="replace").splitlines()]


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


def _refuse_binary(head: bytes, path: Path) -> None:
    """Raise `InputError` for what is not text in any encoding that OBJ files use."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: this is UTF-16 text; save it as UTF-8.")
    if b"\0" in head:
        raise InputError(
            f"{path}: this is a binary file, not OBJ text; give it the suffix of its format."
        )


def _parsed(text: Text, pool: Executor, report: Report, spill: Spill | None) -> _Shapes:
    """Parse all chunks; raise at the first statement that cannot be read."""
    buffers, rooms = Buffers(), Rooms()

    def parse(numbered: tuple[int, Block]) -> tuple[Chunk, float]:
        i, block = numbered
        chunk = parse_chunk(block, i == 0, rooms)
        buffers.give_back(block.data)
        return chunk, block.share

    positions = Column(np.float64, 3, spill)
    corners = Column(np.int32, 0, spill)
    sizes = Column(np.int32, 0, spill)
    statements, parts = Statements(), list[_Part]()
    line = 0
    blocks = enumerate(text_blocks(text, CHUNK_BYTES, buffers))
    for chunk, share in in_order(pool, parse, blocks):
        if chunk.problem is not None:
            raise InputError(f"{text.path}, line {line + chunk.problem[0]}: {chunk.problem[1]}")
        found = _resolved(chunk.corners, len(positions))
        part = _Part(
            vertex=len(positions),
            corner=len(corners),
            polygon=len(sizes),
            line=line,
            n_corners=len(found),
            n_polygons=len(chunk.polygon_size),
            only_triangles=bool(chunk.counts.only_triangles),
            highest=int(found.max(initial=-1)),
        )
        parts.append(part)
        statements.add(chunk.statements, part.polygon, line)
        positions.append(chunk.xyz, share)
        corners.append(found, share)
        sizes.append(chunk.polygon_size, share)
        line += chunk.counts.n_lines
        report(share)
    n_vertices = len(positions)
    if n_vertices >= obj_parser.RELATIVE:
        raise InputError(
            f"{text.path}: {n_vertices} vertices; one file may hold {obj_parser.RELATIVE - 1}. "
            "Split it."
        )
    shapes = _Shapes(
        positions.table(), corners.table().view(np.uint32), sizes.table(), parts, statements
    )
    bad = next((i for i, part in enumerate(parts) if part.highest >= n_vertices), None)
    if bad is not None:
        raise _index_error(text, shapes, bad)
    return shapes


def _resolved(corners: I32, first_vertex: int) -> I32:
    """Return corners of a chunk with relative indices turned into vertices of the file."""
    if corners.size and corners.min() < 0:
        is_relative = corners < 0
        absolute = corners[is_relative].astype(np.int64) + obj_parser.RELATIVE + first_vertex
        corners[is_relative] = np.where(absolute < 0, obj_parser.PAST_END, absolute)
    return corners


def _index_error(text: Text, shapes: _Shapes, bad: int) -> InputError:
    """Say where the first index of a part stands that no vertex has."""
    part, total = shapes.parts[bad], len(shapes.positions)
    corners = shapes.corners[part.corner : part.corner + part.n_corners]
    blocks = text_blocks(text, CHUNK_BYTES, Buffers())
    block = next(block for i, block in enumerate(blocks) if i == bad)
    line, n_vertices, token = find_corner(block, bad == 0, int(np.argmax(corners >= total)))
    if token.startswith("-"):
        scope = f"only {count_of(part.vertex + n_vertices, 'vertex', 'vertices')} are "
        scope += "defined before it"
    else:
        scope = f"only {count_of(total, 'vertex', 'vertices')} are defined in the file"
    scope = scope.replace("1 vertex are", "1 vertex is")
    return InputError(
        f"{text.path}, line {part.line + line}: face refers to vertex {token}, but {scope}."
    )


def _triangulated(
    shapes: _Shapes, objects: Objects, notes: list[str], pool: Executor, spill: Spill | None
) -> ParsedFile:
    """Triangulate part by part, and gather the triangles of each object, in file order."""

    def work(part: _Part) -> tuple[_Part, Triangulation]:
        corners = shapes.corners[part.corner : part.corner + part.n_corners]
        sizes = shapes.polygon_size[part.polygon : part.polygon + part.n_polygons]
        start = (
            np.arange(0, part.n_corners + 1, 3)
            if part.only_triangles
            else np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
        )
        return part, triangulate(shapes.positions, corners, start)

    faces, polygons = Column(np.uint32, 3, spill), Column(np.uint32, 0, spill)
    counts = np.zeros(len(objects.names), np.int64)
    codes, found_objects, found_polygons = [], [], []
    n_polygons = len(shapes.polygon_size)
    for part, (triangles, polygon, finding) in in_order(pool, work, _larger(shapes.parts)):
        share = (part.polygon + part.n_polygons) / n_polygons
        polygon += np.uint32(part.polygon)
        faces.append(triangles, share)
        polygons.append(polygon, share)
        runs, first = _runs_of(objects, part.polygon, part.n_polygons)
        np.add.at(counts, objects.object_of_run[runs], _counts(polygon, first))
        found = np.flatnonzero(finding)
        run = runs.start + np.searchsorted(first, found + part.polygon, "right") - 1
        codes.append(finding[found])
        found_objects.append(objects.object_of_run[run].astype(np.uint32))
        found_polygons.append((found + part.polygon).astype(np.uint32))
        for used in (shapes.positions, shapes.corners, shapes.polygon_size):
            release(used)
    start = np.concatenate([[0], np.cumsum(counts)])
    grouped = _grouped(faces.table(), polygons.table(), objects, start, spill)
    findings = FaceFindings(*map(np.concatenate, (codes, found_objects, found_polygons)))
    return ParsedFile(
        shapes.positions, grouped[0], start, grouped[1], objects.names, findings, tuple(notes)
    )


def _larger(parts: list[_Part]) -> list[_Part]:
    """Return parts with neighbours joined: NumPy takes its time for a call. None is empty."""
    joined: list[_Part] = []
    for part in parts:
        last = joined[-1] if joined else None
        if last is not None and last.n_corners + part.n_corners <= _MOST_CORNERS:
            joined[-1] = last._replace(
                n_corners=last.n_corners + part.n_corners,
                n_polygons=last.n_polygons + part.n_polygons,
                only_triangles=last.only_triangles and part.only_triangles,
            )
        elif part.n_polygons:
            joined.append(part)
    return joined


def _runs_of(objects: Objects, polygon: int, n: int) -> tuple[slice, I64]:
    """Return the runs that n polygons belong to, and where each of them begins."""
    starts = objects.run_start
    begin = int(np.searchsorted(starts, polygon, "right")) - 1
    end = int(np.searchsorted(starts, polygon + n, "left"))
    runs = slice(begin, max(begin, min(end, len(starts) - 1)))
    return runs, starts[runs]


def _counts(polygon_of_triangle: U32, first: I64) -> I64:
    """Return how many triangles each run has; polygons ascend, before all but the first run."""
    at = np.searchsorted(polygon_of_triangle, first[1:].astype(np.uint32))
    return np.diff(np.concatenate([[0], at, [len(polygon_of_triangle)]])[: len(first) + 1])


def _grouped(
    faces: U32, polygons: U32, objects: Objects, start: I64, spill: Spill | None
) -> tuple[U32, U32]:
    """Return triangles and their polygons grouped by object, each object's in file order."""
    owner = objects.object_of_run
    if not (owner[1:] < owner[:-1]).any():
        return faces, polygons
    new_faces = empty_table(np.uint32, faces.shape, spill)
    new_polygons = empty_table(np.uint32, polygons.shape, spill)
    following = start[:-1].copy()
    for some_faces, some_polygons in row_blocks(faces, polygons):
        run = np.searchsorted(objects.run_start, some_polygons, "right") - 1
        of = owner[run]
        order = np.argsort(of, kind="stable")
        present, first, n = np.unique(of[order], return_index=True, return_counts=True)
        place = np.repeat(following[present] - first, n) + np.arange(len(order))
        new_faces[place], new_polygons[place] = some_faces[order], some_polygons[order]
        following[present] += n
        release(new_faces)
        release(new_polygons)
    return new_faces, new_polygons
