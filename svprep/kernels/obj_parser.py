"""The byte parser of Wavefront OBJ text: one pass over one chunk of whole lines.

A chunk is parsed without knowledge of the chunks before it, so that chunks can run
in parallel: line numbers count from 1 inside the chunk, and a relative index is kept
relative to the chunk (see `RELATIVE`) until `svprep.ingest.obj` knows how many
vertices come before it.

Numbers are correctly rounded. A decimal number with an integer significand of at most
2**53 and a power of ten of at most 22 is one exact product or quotient of two doubles,
rounded once (Clinger 1990, *How to Read Floating Point Numbers Accurately*); every
other one is left to Python's ``float()``, by a row of `deferred`.

First use compiles, and each function and expression costs compile time: hence the
table of byte classes, flat arrays, and a line end behind the last byte, which spares
every look at the next byte its bounds check.

Plain twin: `tests/property/test_obj_reader.py`.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit


class ChunkCounts(NamedTuple):
    """What `parse_obj` returns, in this order."""

    n_vertices: int
    n_corners: int
    n_polygons: int
    n_statements: int
    n_deferred: int
    n_lines: int
    only_triangles: int
    """1 if every polygon has three corners."""
    status: int
    """0, or what stopped the parser: one of the next five."""
    stop_line: int
    stop_byte: int
    """First byte of the token that stopped it (`FEW_NUMBERS`: how many there were)."""


BAD_NUMBER: Final = 1
FEW_NUMBERS: Final = 2
BAD_INDEX: Final = 3
ZERO_INDEX: Final = 4
AT_CORNER: Final = 5

STATEMENT_COLUMNS: Final = 5
DEFERRED_COLUMNS: Final = 4

RELATIVE: Final = 1 << 30
"""A corner below zero is ``local vertex - RELATIVE``: a relative index, resolved against
the vertices that the chunk itself defined before it (negative: in earlier chunks)."""
PAST_END: Final = (1 << 31) - 1
"""A corner whose written index is greater than any that an int32 holds."""

# Classes of bytes. Those from _BLANK on end a token, those from _HASH on a statement.
_DIGIT, _BLANK, _BACKSLASH, _HASH, _LINE_END = 1, 2, 3, 4, 5
_CLASS = np.zeros(256, np.uint8)
_CLASS[48:58] = _DIGIT
_CLASS[[9, 11, 12, 32]] = _BLANK
_CLASS[92] = _BACKSLASH
_CLASS[35] = _HASH
_CLASS[[10, 13]] = _LINE_END

_POW10 = 10.0 ** np.arange(23)
_EXACT = 1 << 53
_ROOM = 10**17  # a mantissa below it takes one more digit
# Called by `parse_obj` only, which carries them in its cache: no wrappers to compile.
_helper = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)

_VERTEX, _FACE, _NAME, _OTHER = 1, 2, 3, 4


@_helper
def _next_token(data, pos, end, line):
    """Return the start of the next token, or of what ends the statement, and its line.

    Skips blanks and continuations: a backslash that only blanks separate from the end
    of the line.
    """
    while True:
        while _CLASS[data[pos]] == _BLANK:
            pos += 1
        if data[pos] != 92:
            return pos, line
        after = pos + 1
        while _CLASS[data[after]] == _BLANK:
            after += 1
        if _CLASS[data[after]] != _LINE_END:
            return pos, line
        if data[after] == 13 and after + 1 < end and data[after + 1] == 10:
            after += 1
        if after + 1 >= end:
            return after, line
        pos = after + 1
        line += 1


@_helper
def _parse_number(data, pos):
    """Return (value, end of the token, status): 0 exact, 1 left to float(), 2 malformed."""
    sign = 1.0
    if data[pos] == 45:
        sign = -1.0
    pos += (data[pos] == 45) | (data[pos] == 43)
    mantissa = 0
    exponent = 0
    status = 2  # until there is a digit
    cut = 0  # what did not fit into the mantissa
    step = 0  # -1 behind the decimal point
    while True:
        digit = np.int64(data[pos]) - 48
        if 0 <= digit <= 9:
            status = 0
            if mantissa < _ROOM:
                mantissa = mantissa * 10 + digit
                exponent += step
            else:
                cut |= digit
                exponent += 1 + step
        elif digit == -2 and step == 0:  # .
            step = -1
        else:
            break
        pos += 1
    if data[pos] | 32 == 101 and status == 0:  # e, E
        pos += 1
        is_minus = data[pos] == 45
        pos += is_minus | (data[pos] == 43)
        status = 2
        written = 0
        while _CLASS[data[pos]] == _DIGIT:
            status = 0
            if written < 100_000:
                written = written * 10 + np.int64(data[pos]) - 48
            pos += 1
        exponent += -written if is_minus else written
    if _CLASS[data[pos]] < _BLANK:
        status = 2
    while mantissa > _EXACT and mantissa % 10 == 0:
        mantissa //= 10
        exponent += 1
    value = sign * np.float64(mantissa)
    if mantissa != 0:
        if cut != 0 or mantissa > _EXACT or abs(exponent) > 22:
            status |= 1
        elif exponent < 0:
            value /= _POW10[-exponent]
        else:
            value *= _POW10[exponent]
    return value, pos, status


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def parse_obj(data, begin, end, stop_corner, xyz, corners, polygon_size, statements, deferred):
    """Parse the whole lines in ``data[begin:end]`` into the arrays; return `ChunkCounts`.

    Parameters
    ----------
    data : (n_bytes,) uint8
        A file, and behind it a line feed.
    begin, end : int
        The chunk, n bytes. It begins at the start of a line, ends behind a line end, and
        no continued line crosses its end.
    stop_corner : int
        Stop at this corner of the chunk with status `AT_CORNER`, its line and its byte;
        -1: never. That an index is past the end is known only after all is read; a
        second visit finds out where it stands.
    xyz : (3 * (n // 8 + 1),) float64
        Positions as written. Where they end, so do those arrays that a file of shortest
        statements would fill.
    corners : (n // 2 + 1,) int32
        0-based vertices, or below zero (see `RELATIVE`), or `PAST_END`.
    polygon_size : (n // 2 + 1,) int32
        Corners of each ``f`` statement.
    statements : (STATEMENT_COLUMNS * (n // 2 + 1),) int64
        Rows ``[key, first byte, end byte, polygons before it, line]`` of every statement
        but v, vt, vn, vp, f and s. The key is a hash of the keyword. The bytes are those
        of the name for ``o`` and ``g``, else those of the keyword.
    deferred : (DEFERRED_COLUMNS * (n // 5 + 1),) int64
        Rows ``[slot in xyz, first byte, end byte, line]`` of numbers left to ``float()``.

    Notes
    -----
    Each byte is visited once, nothing is allocated.
    """
    n_coordinates = n_corners = n_polygons = n_statements = n_deferred = 0
    only_triangles = 1
    status = stop_line = stop_byte = 0
    pos = begin
    line = np.int64(1)  # not a literal: _next_token would be compiled for it, too
    while pos < end and status == 0:
        pos, line = _next_token(data, pos, end, line)
        first = pos
        key = 0
        while _CLASS[data[pos]] < _BLANK:
            key = key * 257 + np.int64(data[pos])
            pos += 1
        if first < pos and data[first] == 0:
            key = -1  # a NUL adds nothing to the hash: it would hide in front of a keyword
        mode = 0
        n_tokens = 0
        if key == 118:  # v
            mode = _VERTEX
        elif key == 102:  # f
            mode = _FACE
        elif key == 111 or key == 103:  # o, g
            mode = _NAME
            first = pos
        # vt, vn, vp and s may be many, and say nothing of the shape.
        elif key != 30442 and key != 30436 and key != 30438 and key != 115 and key != 0:
            mode = _OTHER
        first_line = line
        end_byte = pos
        while mode == _VERTEX or mode == _FACE:
            pos, line = _next_token(data, pos, end, line)
            if _CLASS[data[pos]] >= _HASH:
                break
            first = pos
            if mode == _VERTEX:
                value, pos, problem = _parse_number(data, pos)
                xyz[n_coordinates] = value
                if problem == 1:
                    deferred[n_deferred] = n_coordinates
                    deferred[n_deferred + 1] = first
                    deferred[n_deferred + 2] = pos
                    deferred[n_deferred + 3] = line
                    n_deferred += DEFERRED_COLUMNS
                elif problem == 2:
                    status = BAD_NUMBER
                    break
                n_coordinates += 1
                n_tokens += 1
                if n_tokens == 3:  # what follows is a weight or a colour
                    break
            else:
                if n_corners == stop_corner:
                    status = AT_CORNER
                    break
                is_minus = data[pos] == 45
                pos += is_minus | (data[pos] == 43)
                index = 0
                status = BAD_INDEX  # until there is a digit
                while _CLASS[data[pos]] == _DIGIT:
                    status = 0
                    if index < PAST_END:
                        index = index * 10 + np.int64(data[pos]) - 48
                    pos += 1
                if data[pos] == 47:  # texture and normal are not looked at
                    while 43 <= data[pos] <= 57:
                        pos += 1
                if _CLASS[data[pos]] < _BLANK:
                    status = BAD_INDEX
                elif index == 0 and status == 0:
                    status = ZERO_INDEX
                if status != 0:
                    break
                index -= 1
                if is_minus:
                    if index >= RELATIVE:
                        index = RELATIVE - 1
                    index = n_coordinates // 3 - index - 1 - RELATIVE
                elif index > PAST_END:
                    index = PAST_END
                corners[n_corners] = index
                n_corners += 1
                n_tokens += 1
        if mode == _FACE:
            polygon_size[n_polygons] = n_tokens
            n_polygons += 1
            if n_tokens != 3:
                only_triangles = 0
        elif mode == _VERTEX and n_tokens < 3 and status == 0:
            status = FEW_NUMBERS
            first = n_tokens
        if status != 0:
            stop_line = line
            stop_byte = first
        # The rest of the line, and of those that continue it. A comment is not continued
        # ("# C:\models\"), and a name may hold a "#".
        is_comment = False
        while pos < end:
            kind = _CLASS[data[pos]]
            if kind == _LINE_END:
                before = pos - 1
                while _CLASS[data[before]] == _BLANK:
                    before -= 1
                if mode == _NAME:
                    end_byte = pos
                if data[pos] == 13 and pos + 1 < end and data[pos + 1] == 10:
                    pos += 1
                pos += 1
                line += 1
                if data[before] != 92 or is_comment:
                    break
            else:
                is_comment |= kind == _HASH and mode != _NAME
                pos += 1
        if mode >= _NAME:
            statements[n_statements] = key
            statements[n_statements + 1] = first
            statements[n_statements + 2] = end_byte
            statements[n_statements + 3] = n_polygons
            statements[n_statements + 4] = first_line
            n_statements += STATEMENT_COLUMNS
    return (
        n_coordinates // 3,
        n_corners,
        n_polygons,
        n_statements // STATEMENT_COLUMNS,
        n_deferred // DEFERRED_COLUMNS,
        line - 1,
        only_triangles,
        status,
        stop_line,
        stop_byte,
    )
