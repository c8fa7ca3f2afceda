"""Where things stand in a JSON text, and the numbers of an array of vertices.

The tree that a JSON parser makes of a city takes ten times the memory of its text. These
two passes find the members of the objects that matter, so that `svprep.ingest` can have
them parsed a few at a time, and read the longest array, the vertices, without a tree.

What is inside a member is only skipped: strings and nested brackets, whichever kind. Who
parses the member finds out what is wrong in it.

Numbers are correctly rounded, as in `svprep.kernels.obj_parser`: what takes more than one
rounding (Clinger 1990) is left to Python's ``float()``, by a row of `deferred`.

Plain twin: Python's ``json``, in `tests/property/test_cityjson_reader.py`.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

CUT_OFF: Final = 1
"""The text ends inside of the object or array."""
UNEXPECTED: Final = 2
"""This byte cannot stand here."""

_POW10 = 10.0 ** np.arange(23)
_EXACT = 1 << 53
_ROOM = 10**17  # a mantissa below it takes one more digit

_helper = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_helper
def _skip_blanks(data, pos, end):
    while pos < end and (data[pos] == 32 or data[pos] == 10 or data[pos] == 13 or data[pos] == 9):
        pos += 1
    return pos


@_helper
def _value_end(data, pos, end):
    """Return the byte behind the value at `pos`, or -1 where the text ends in it.

    `pos` itself where no value begins.
    """
    depth = 0
    while pos < end:
        byte = data[pos]
        if byte == 34:
            pos += 1
            while pos < end and data[pos] != 34:
                pos += 2 if data[pos] == 92 else 1
            if pos >= end:
                return -1
            pos += 1
            if depth == 0:
                return pos
            continue
        if byte == 91 or byte == 123:
            depth += 1
        elif byte == 93 or byte == 125:
            if depth == 0:
                return pos
            depth -= 1
            if depth == 0:
                return pos + 1
        elif depth == 0 and (
            byte == 44 or byte == 58 or byte == 32 or byte == 10 or byte == 13 or byte == 9
        ):
            return pos
        pos += 1
    return pos if depth == 0 else -1


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def object_members(data, begin, end):
    """Find the members of the JSON object that begins at `begin`, white space before it aside.

    Parameters
    ----------
    data : (n,) uint8
    begin, end : int
        Nothing from `end` on is looked at.

    Returns
    -------
    spans : (n_members, 4) int64
        Where its key begins (at the quote) and ends, where its value begins and ends.
    status : int
        0, `CUT_OFF` or `UNEXPECTED`.
    pos : int
        The byte behind the object, or the one that is the matter.
    """
    spans = np.empty((16, 4), np.int64)
    n = 0
    pos = _skip_blanks(data, begin, end)
    if pos >= end:
        return spans[:0], CUT_OFF, pos
    if data[pos] != 123:
        return spans[:0], UNEXPECTED, pos
    pos = _skip_blanks(data, pos + 1, end)
    if pos < end and data[pos] == 125:
        return spans[:0], 0, pos + 1
    while True:
        if pos >= end:
            return spans[:n], CUT_OFF, pos
        if data[pos] != 34:
            return spans[:n], UNEXPECTED, pos
        if n == len(spans):
            wider = np.empty((2 * n, 4), np.int64)
            wider[:n] = spans
            spans = wider
        spans[n, 0] = pos
        pos = _value_end(data, pos, end)
        if pos < 0:
            return spans[:n], CUT_OFF, end
        spans[n, 1] = pos
        pos = _skip_blanks(data, pos, end)
        if pos < end and data[pos] != 58:
            return spans[:n], UNEXPECTED, pos
        pos = _skip_blanks(data, pos + 1, end)
        spans[n, 2] = pos
        value_end = _value_end(data, pos, end)
        if value_end < 0 or pos >= end:
            return spans[:n], CUT_OFF, end
        if value_end == pos:
            return spans[:n], UNEXPECTED, pos
        spans[n, 3] = value_end
        n += 1
        pos = _skip_blanks(data, value_end, end)
        if pos < end and data[pos] == 125:
            return spans[:n], 0, pos + 1
        if pos < end and data[pos] != 44:
            return spans[:n], UNEXPECTED, pos
        pos = _skip_blanks(data, pos + 1, end)


@_helper
def _is_named(data, begin, end, names):
    """Whether the bytes from `begin` to `end` are one of `names`."""
    for row in range(len(names)):
        if names[row, 0] == end - begin:
            i = 0
            while i < end - begin and names[row, 1 + i] == data[begin + i]:
                i += 1
            if i == end - begin:
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def without_members(data, begin, end, names, out):
    """Copy members of an object, with ``null`` for what nobody reads of the values.

    Which is: members of the values, and of objects in arrays that are members of the
    values, with one of the `names`.

    Parameters
    ----------
    data : (n,) uint8
    begin, end : int
        The first member's key to the last one's value.
    names : (n_names, m) uint8
        The length of each, and its bytes.
    out : (end - begin,) uint8
        Filled.

    Returns
    -------
    int
        The number of bytes in `out`.
    """
    n = 0
    depth = 0
    pos = begin
    while pos < end:
        byte = data[pos]
        if byte == 34:
            start = pos
            pos = _value_end(data, pos, end)
            if pos < 0:
                pos = end
            for i in range(start, pos):
                out[n] = data[i]
                n += 1
            if (depth == 1 or depth == 3) and _is_named(data, start + 1, pos - 1, names):
                after = _skip_blanks(data, pos, end)
                if after < end and data[after] == 58:
                    after = _skip_blanks(data, after + 1, end)
                    value_end = _value_end(data, after, end)
                    if value_end - after >= 4:  # otherwise null is longer
                        out[n] = 58
                        out[n + 1] = 110
                        out[n + 2] = 117
                        out[n + 3] = 108
                        out[n + 4] = 108
                        n += 5
                        pos = value_end
            continue
        if byte == 91 or byte == 123:
            depth += 1
        elif byte == 93 or byte == 125:
            depth -= 1
        out[n] = byte
        n += 1
        pos += 1
    return n


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def parse_vertices(data, begin, end, xyz):
    """Read an array of vertices: ``[[x, y, z], [x, y, z], ...]``.

    Parameters
    ----------
    data : (n,) uint8
    begin, end : int
        Nothing from `end` on is looked at.
    xyz : (m,) float64
        Filled; room for 3 numbers per 7 bytes.

    Returns
    -------
    n_numbers : int
        Three to a vertex.
    deferred : (n_deferred, 3) int64
        Slot of `xyz`, begin and end of a number that is left to ``float()``: it is not
        exact in one step, or not certainly a number.
    status : int
        0, `CUT_OFF` or `UNEXPECTED`.
    pos : int
        The byte behind the array, or the one that is the matter.
    """
    deferred = np.empty((16, 3), np.int64)
    n_deferred = 0
    n = 0
    pos = _skip_blanks(data, begin, end)
    if pos < end and data[pos] != 91:
        return n, deferred[:0], UNEXPECTED, pos
    pos = _skip_blanks(data, pos + 1, end)
    if pos < end and data[pos] == 93:
        return n, deferred[:0], 0, pos + 1
    while pos < end:
        if data[pos] != 91:
            return n, deferred[:n_deferred], UNEXPECTED, pos
        pos = _skip_blanks(data, pos + 1, end)
        for axis in range(3):
            start = pos
            mantissa = 0
            exponent = 0
            n_digits = 0
            n_points = 0
            is_negative = pos < end and data[pos] == 45
            if is_negative:
                pos += 1
            while pos < end:
                digit = np.int64(data[pos]) - 48
                if 0 <= digit <= 9:
                    mantissa = 10 * mantissa + digit if mantissa < _ROOM else _EXACT + 1
                    exponent -= n_points
                    n_digits += 1
                elif digit == -2:
                    n_points += 1
                else:
                    break
                pos += 1
            is_simple = n_digits > 0 and n_points < 2 and mantissa <= _EXACT and exponent >= -22
            # (Leading zeros and a bare point, which JSON does not allow, are read.)
            if pos < end and data[pos] != 44 and data[pos] != 93 and data[pos] > 32:
                is_simple = False
                while pos < end and data[pos] != 44 and data[pos] != 93 and data[pos] > 32:
                    pos += 1
            if pos == start:
                return n, deferred[:n_deferred], UNEXPECTED if pos < end else CUT_OFF, pos
            if is_simple:
                value = mantissa / _POW10[-exponent]
                xyz[n] = -value if is_negative else value
            else:
                if n_deferred == len(deferred):
                    wider = np.empty((2 * n_deferred, 3), np.int64)
                    wider[:n_deferred] = deferred
                    deferred = wider
                deferred[n_deferred, 0] = n
                deferred[n_deferred, 1] = start
                deferred[n_deferred, 2] = pos
                n_deferred += 1
                xyz[n] = 0.0
            n += 1
            pos = _skip_blanks(data, pos, end)
            if pos < end and data[pos] != (93 if axis == 2 else 44):
                return n, deferred[:n_deferred], UNEXPECTED, pos
            pos = _skip_blanks(data, pos + 1, end)
        if pos < end and data[pos] == 93:
            return n, deferred[:n_deferred], 0, pos + 1
        if pos < end and data[pos] != 44:
            return n, deferred[:n_deferred], UNEXPECTED, pos
        pos = _skip_blanks(data, pos + 1, end)
    return n, deferred[:n_deferred], CUT_OFF, end
