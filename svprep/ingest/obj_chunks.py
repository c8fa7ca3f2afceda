"""One block of OBJ text, parsed without knowledge of the others, on any thread."""

from __future__ import annotations

import queue
import re
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from svprep.ingest.obj_statements import Statements, decode, statements_of
from svprep.ingest.parsed import count_of
from svprep.ingest.text_blocks import Block
from svprep.kernels import obj_parser
from svprep.kernels.obj_parser import ChunkCounts
from svprep.model import F64, I32, I64, U8

_TOKEN: Final = re.compile(rb"[^ \t\v\f\r\n\\#]*")
_NOT_FINITE: Final = re.compile(r"[+-]?(nan|inf|infinity|[0-9.]*#.*)(\(.*)?", re.IGNORECASE)
_TOKEN_BYTES: Final = 200
_MARK: Final = b"\xef\xbb\xbf"


class _Room(NamedTuple):
    """Where a chunk is parsed to; see `svprep.kernels.obj_parser.parse_obj`."""

    xyz: F64
    corners: I32
    polygon_size: I32
    statements: I64
    deferred: I64


class Rooms:
    """Rooms for chunks, each used again by the next chunk of a thread."""

    def __init__(self) -> None:
        self._spare: queue.SimpleQueue[_Room] = queue.SimpleQueue()

    def take(self, n_bytes: int) -> _Room:
        """Return arrays that hold whatever so much text may. Untouched pages cost nothing."""
        try:
            spare = self._spare.get_nowait()
        except queue.Empty:
            return _room(n_bytes)
        return spare if len(spare.corners) > n_bytes // 2 else _room(n_bytes)

    def give_back(self, room: _Room) -> None:
        """Take back what no chunk uses any more."""
        self._spare.put(room)


@dataclass(frozen=True, slots=True)
class Chunk:
    """A parsed chunk. It counts lines, vertices and polygons from its own start."""

    counts: ChunkCounts
    xyz: F64
    """``(n_vertices, 3)``"""
    corners: I32
    """As the parser leaves them: relative indices below zero."""
    polygon_size: I32
    statements: Statements
    problem: tuple[int, str] | None
    """The line of the first statement that cannot be read, and why."""


def parse_chunk(block: Block, is_first: bool, rooms: Rooms) -> Chunk:
    """Parse a block of text; `is_first` may begin with a byte order mark."""
    data = block.data
    room = rooms.take(block.n_bytes)
    begin = _begin(data, is_first)
    counts = ChunkCounts(*obj_parser.parse_obj(data, begin, block.n_bytes, -1, *room))
    n, m = obj_parser.STATEMENT_COLUMNS, obj_parser.DEFERRED_COLUMNS
    problem = _defer(data, room.deferred[: m * counts.n_deferred].reshape(-1, m), room.xyz)
    if problem is None and counts.status:
        problem = counts.stop_line, _problem(data, counts)
    chunk = Chunk(
        counts,
        room.xyz[: 3 * counts.n_vertices].reshape(-1, 3).copy(),
        room.corners[: counts.n_corners].copy(),
        room.polygon_size[: counts.n_polygons].copy(),
        statements_of(data, room.statements[: n * counts.n_statements].reshape(-1, n)),
        problem,
    )
    rooms.give_back(room)
    return chunk


def find_corner(block: Block, is_first: bool, corner: int) -> tuple[int, int, str]:
    """Return the line of a corner of a chunk, the vertices before it, and its index as written."""
    room = _room(block.n_bytes)
    begin = _begin(block.data, is_first)
    counts = ChunkCounts(*obj_parser.parse_obj(block.data, begin, block.n_bytes, corner, *room))
    token = _token_at(block.data, counts.stop_byte).split("/")[0]
    return counts.stop_line, counts.n_vertices, token


def _begin(data: U8, is_first: bool) -> int:
    return len(_MARK) if is_first and data[: len(_MARK)].tobytes() == _MARK else 0


def _room(n_bytes: int) -> _Room:
    return _Room(
        np.empty(3 * (n_bytes // 8 + 1), np.float64),
        np.empty(n_bytes // 2 + 1, np.int32),
        np.empty(n_bytes // 2 + 1, np.int32),
        np.empty(obj_parser.STATEMENT_COLUMNS * (n_bytes // 2 + 1), np.int64),
        np.empty(obj_parser.DEFERRED_COLUMNS * (n_bytes // 5 + 1), np.int64),
    )


def _defer(data: U8, deferred: I64, xyz: F64) -> tuple[int, str] | None:
    """Fill in the numbers left to ``float()``; return what is wrong with the first bad one."""
    text = data.data
    for slot, begin, end, line in deferred.tolist():
        value = float(bytes(text[begin:end]))
        if value - value != 0.0:
            return line, _not_finite(_token_at(data, begin))
        xyz[slot] = value
    return None


def _problem(data: U8, counts: ChunkCounts) -> str:
    """Say what stopped the parser."""
    if counts.status == obj_parser.FEW_NUMBERS:
        found = count_of(counts.stop_byte, "number")
        return f"a vertex (v) with {found}; x, y and z are needed."
    token = _token_at(data, counts.stop_byte)
    if counts.status == obj_parser.ZERO_INDEX:
        return "face refers to vertex 0, but OBJ counts vertices from 1."
    if counts.status == obj_parser.BAD_INDEX:
        return f'"{token}" in a face (f) is not a vertex index.'
    if _NOT_FINITE.fullmatch(token):
        return _not_finite(token)
    hint = " (decimals take a point, not a comma)" if "," in token else ""
    return f'"{token}" in a vertex (v) is not a number{hint}.'


def _not_finite(token: str) -> str:
    return f'"{token}" in a vertex (v) is not a finite coordinate; remove or repair it.'


def _token_at(data: U8, pos: int) -> str:
    """Return the token at a byte, shortened for a message."""
    match = _TOKEN.match(data[pos : pos + _TOKEN_BYTES].tobytes())
    token = decode(match.group()) if match else ""
    return token if len(token) <= 40 else token[:37] + "..."
