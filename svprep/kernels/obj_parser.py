"""The byte parser of Wavefront OBJ text: one pass, one chunk of whole lines at a time.

A chunk is parsed without knowledge of the chunks before it, so that chunks can run
in parallel: line numbers count from 1 inside the chunk, and a relative index is kept
relative to the chunk (see `RELATIVE`) until `svprep.ingest.obj` knows how many
vertices come before it.

Numbers are correctly rounded. A decimal number with an integer significand of at most
2**53 and a power of ten of at most 22 is one exact product or quotient of two doubles,
rounded once (Clinger 1990, *How to Read Floating Point Numbers Accurately*); every
other one is left to Python's ``float()``, by a row of `deferred`.

Plain twin: `tests/property/test_obj_reader.py`.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

# Slots of `counts`, the parser's result.
N_VERTICES: Final = 0
N_CORNERS: Final = 1
N_POLYGONS: Final = 2
N_STATEMENTS: Final = 3
N_DEFERRED: Final = 4
N_LINES: Final = 5
STATUS: Final = 6
"""0, or what stopped the parser: one of the next five."""
STOP_LINE: Final = 7
STOP_BYTE: Final = 8
"""First byte of the token that stopped it."""
ONLY_TRIANGLES: Final = 9
COUNTS_SIZE: Final = 10

BAD_NUMBER: Final = 1
FEW_NUMBERS: Final = 2
BAD_INDEX: Final = 3
ZERO_INDEX: Final = 4
STOP_CORNER: Final = 5

RELATIVE: Final = 1 << 30
"""A corner below zero is ``local vertex - RELATIVE``: a relative index, resolved against
the vertices that the chunk itself defined before it (negative for earlier chunks)."""
PAST_END: Final = (1 << 31) - 1

_POW10 = 10.0 ** np.arange(23)
_TAB, _LF, _VT, _FF, _CR, _BLANK, _HASH, _BACKSLASH = 9, 10, 11, 12, 13, 32, 35, 92
_PLUS, _MINUS, _DOT, _SLASH, _ZERO, _NINE = 43, 45, 46, 47, 48, 57


@njit(cache=True, nogil=True)
def _next_token(data, pos, end, line):
    """Return the start of the next token (or the line's end), and its line number.

    Skips blanks and continuations: a backslash that only blanks separate from the end
    of the line.
    """
    while pos < end:
        c = data[pos]
        if c == _BLANK or c == _TAB or c == _VT or c == _FF:
            pos += 1
        elif c == _BACKSLASH:
            q = pos + 1
            while q < end and (data[q] == _BLANK or data[q] == _TAB):
                q += 1
            if q < end:
                if data[q] != _LF and data[q] != _CR:
                    break
                q += 2 if data[q] == _CR and q + 1 < end and data[q + 1] == _LF else 1
                line += 1
            pos = q
        else:
            break
    return pos, line


@njit(cache=True, nogil=True)
def _parse_number(data, pos, end):
    """Return (value, end of the token, status): 0 exact, 1 left to float(), 2 malformed."""
    negative = data[pos] == _MINUS
    if negative or data[pos] == _PLUS:
        pos += 1
    mantissa = np.int64(0)
    exponent = np.int64(0)
    has_digits = False
    is_fraction = False
    is_cut = False  # a nonzero digit did not fit into the mantissa
    while pos < end:
        c = np.int64(data[pos])
        if c >= _ZERO and c <= _NINE:
            has_digits = True
            if mantissa < 100_000_000_000_000_000:
                mantissa = mantissa * 10 + (c - _ZERO)
                if is_fraction:
                    exponent -= 1
            else:
                is_cut |= c != _ZERO
                if not is_fraction:
                    exponent += 1
        elif c == _DOT and not is_fraction:
            is_fraction = True
        else:
            break
        pos += 1
    if not has_digits:
        return 0.0, pos, 2
    if pos < end and (data[pos] | 32) == 101:  # e, E
        pos += 1
        is_minus = pos < end and data[pos] == _MINUS
        if pos < end and (data[pos] == _PLUS or data[pos] == _MINUS):
            pos += 1
        if pos == end or data[pos] < _ZERO or data[pos] > _NINE:
            return 0.0, pos, 2
        written = np.int64(0)
        while pos < end and data[pos] >= _ZERO and data[pos] <= _NINE:
            if written < 100_000:
                written = written * 10 + (np.int64(data[pos]) - _ZERO)
            pos += 1
        exponent += -written if is_minus else written
    if pos < end and data[pos] > _BLANK and data[pos] != _HASH and data[pos] != _BACKSLASH:
        return 0.0, pos, 2
    while mantissa > 9_007_199_254_740_992 and mantissa % 10 == 0:
        mantissa //= 10
        exponent += 1
    value = np.float64(mantissa)
    if mantissa == 0:
        pass
    elif is_cut or mantissa > 9_007_199_254_740_992 or exponent > 22 or exponent < -22:
        return 0.0, pos, 1
    elif exponent < 0:
        value /= _POW10[-exponent]
    else:
        value *= _POW10[exponent]
    return (-value if negative else value), pos, 0


@njit(cache=True, nogil=True)
def parse_obj(  # noqa: C901
    data, begin, end, stop_corner, xyz, corners, polygon_size, statements, deferred, counts
):
    """Parse the whole lines in ``data[begin:end]``; fill the arrays and `counts`.

    Parameters
    ----------
    data : (n_bytes,) uint8
    begin, end : int
        The chunk. It begins at the start of a line, and no continued line crosses its end.
    stop_corner : int
        Stop at this corner of the chunk with status `STOP_CORNER`, its line and its byte;
        -1: never. An index is known to be past the end only after all is read; the
        second visit finds out where it stands.
    xyz : (>= n // 8 + 1, 3) float64
        Positions as written; n = ``end - begin``.
    corners : (>= n // 2 + 1,) int32
        0-based vertices, or below zero (see `RELATIVE`), or `PAST_END`.
    polygon_size : (>= n // 2 + 1,) int32
        Corners of each ``f`` statement.
    statements : (>= n // 2 + 1, 5) int64
        Every statement but v, vt, vn, vp, f and s: ``[key, first byte, end byte, polygons
        before it, line]``. The key is a hash of the keyword. For ``o`` and ``g`` the bytes
        are those of the name, for others those of the keyword.
    deferred : (>= n // 5 + 1, 4) int64
        Numbers left to ``float()``: ``[coordinate slot, first byte, end byte, line]``.
    counts : (COUNTS_SIZE,) int64
        What was found; see the slots above.

    Notes
    -----
    One visit of each byte, no allocation.
    """
    n_vertices = n_corners = n_polygons = n_statements = n_deferred = 0
    only_triangles = 1
    status = stop_line = stop_byte = 0
    pos = begin
    line = 1
    while pos < end and status == 0:
        pos, line = _next_token(data, pos, end, line)
        if pos == end:
            break
        c = data[pos]
        following = data[pos + 1] if pos + 1 < end else _LF
        is_short = following <= _BLANK or following == _BACKSLASH
        is_comment = c == _HASH
        is_name = False
        if c == 118 and is_short:  # v
            pos += 1
            for axis in range(3):
                pos, line = _next_token(data, pos, end, line)
                if pos == end or data[pos] == _LF or data[pos] == _CR or data[pos] == _HASH:
                    status, stop_line, stop_byte = FEW_NUMBERS, line, axis
                    break
                value, token_end, how = _parse_number(data, pos, end)
                if how == 2:
                    status, stop_line, stop_byte = BAD_NUMBER, line, pos
                    break
                if how == 1:
                    deferred[n_deferred, 0] = 3 * n_vertices + axis
                    deferred[n_deferred, 1] = pos
                    deferred[n_deferred, 2] = token_end
                    deferred[n_deferred, 3] = line
                    n_deferred += 1
                xyz[n_vertices, axis] = value
                pos = token_end
            n_vertices += 1
        elif c == 102 and is_short:  # f
            pos += 1
            first_corner = n_corners
            while True:
                pos, line = _next_token(data, pos, end, line)
                if pos == end or data[pos] == _LF or data[pos] == _CR or data[pos] == _HASH:
                    break
                token = pos
                if n_corners == stop_corner:
                    status, stop_line, stop_byte = STOP_CORNER, line, token
                    break
                negative = data[pos] == _MINUS
                if negative or data[pos] == _PLUS:
                    pos += 1
                digits = pos
                index = np.int64(0)
                while pos < end and data[pos] >= _ZERO and data[pos] <= _NINE:
                    if index < PAST_END:
                        index = index * 10 + (np.int64(data[pos]) - _ZERO)
                    pos += 1
                is_bad = pos == digits
                if pos < end and data[pos] == _SLASH:  # texture and normal: not looked at
                    while pos < end and data[pos] >= _PLUS and data[pos] <= _NINE:
                        pos += 1
                if pos < end and data[pos] > _BLANK and data[pos] != _HASH:
                    is_bad |= data[pos] != _BACKSLASH
                if is_bad or index == 0:
                    status = BAD_INDEX if is_bad else ZERO_INDEX
                    stop_line, stop_byte = line, token
                    break
                if negative:
                    corners[n_corners] = max(n_vertices - min(index, RELATIVE), 1 - RELATIVE)
                    corners[n_corners] -= RELATIVE
                else:
                    corners[n_corners] = min(index - 1, PAST_END)
                n_corners += 1
            polygon_size[n_polygons] = n_corners - first_corner
            if n_corners - first_corner != 3:
                only_triangles = 0
            n_polygons += 1
        elif c > _BLANK and not is_comment:
            key = np.int64(0)
            keyword = pos
            while pos < end and data[pos] > _BLANK and data[pos] != _BACKSLASH:
                key = key * 257 + np.int64(data[pos])
                pos += 1
            # vt, vn, vp and s may be many, and say nothing of the shape.
            is_vt = pos - keyword == 2 and c == 118
            is_vt = is_vt and (following == 116 or following == 110 or following == 112)
            if not is_vt and key != 115:
                is_name = key == 111 or key == 103  # o, g
                statements[n_statements, 0] = key
                statements[n_statements, 1] = pos if is_name else keyword
                statements[n_statements, 2] = pos
                statements[n_statements, 3] = n_polygons
                statements[n_statements, 4] = line
                n_statements += 1
        # The rest of the line, and of those that continue it. A comment is not continued
        # ("# C:\models\"), and a name may hold a "#".
        while pos < end:
            c = data[pos]
            if c == _LF or c == _CR:
                q = pos - 1
                while q > begin and (data[q] == _BLANK or data[q] == _TAB):
                    q -= 1
                is_continued = q >= begin and data[q] == _BACKSLASH and not is_comment
                if is_name and not is_continued:
                    statements[n_statements - 1, 2] = pos
                pos += 2 if c == _CR and pos + 1 < end and data[pos + 1] == _LF else 1
                line += 1
                if not is_continued:
                    is_name = False
                    break
            else:
                is_comment |= c == _HASH and not is_name
                pos += 1
        if is_name:  # the text ends without a line end
            statements[n_statements - 1, 2] = pos
    counts[N_VERTICES] = n_vertices
    counts[N_CORNERS] = n_corners
    counts[N_POLYGONS] = n_polygons
    counts[N_STATEMENTS] = n_statements
    counts[N_DEFERRED] = n_deferred
    counts[N_LINES] = line - 1
    counts[STATUS] = status
    counts[STOP_LINE] = stop_line
    counts[STOP_BYTE] = stop_byte
    counts[ONLY_TRIANGLES] = only_triangles
