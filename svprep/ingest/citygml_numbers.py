"""From the text of rings to coordinates, many rings at a time."""

from __future__ import annotations

import re
import warnings
from array import array
from collections.abc import Callable

import numpy as np

from svprep.errors import InputError
from svprep.ingest.parsed import count_of, shown
from svprep.model import F64, I64

RING_END = " nan "
"""Stands between rings: no coordinate may be it."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)

Where = Callable[[int], str]
"""Says which ring, counted from the first one of those given, a message is about."""


def parse_rings(
    texts: list[str], n_positions: array[int], dimensions: array[int], where: Where
) -> tuple[F64, I64]:
    """Return the corners of rings and how many each has.

    Parameters
    ----------
    texts
        Their coordinates in pieces, and `RING_END` behind each ring.
    n_positions
        Of each ring: how many positions (``gml:pos``) it was given in; 0: one list.
    dimensions
        Of each ring: numbers a position as stated for lists; 0: not stated, so 3.

    Returns
    -------
    points : (n, 3) float64
        z is 0 where two numbers make a position.
    sizes : (n_rings,) int64

    Raises
    ------
    InputError
        For what is no finite number, or does not make whole positions.
    """
    values = parse_numbers("".join(texts))
    if values is None or np.isinf(values).any():
        raise _bad_number(texts, where)
    is_end = np.isnan(values)
    if np.count_nonzero(is_end) != len(dimensions):
        raise _bad_number(texts, where)
    ends = np.flatnonzero(is_end)
    counts = np.diff(ends, prepend=-1) - 1
    values = values[~is_end]
    stated = np.array(dimensions, np.int64)
    given = np.array(n_positions, np.int64)
    width = np.where(stated == 0, 3, stated)
    width = np.where(given > 0, counts // np.maximum(given, 1), width)
    is_wrong = ((width != 2) & (width != 3)) | (counts % np.maximum(width, 1) != 0)
    is_wrong |= (given > 0) & (counts != given * width)
    is_wrong &= counts > 0
    if is_wrong.any():
        raise _wrong_count(int(np.argmax(is_wrong)), counts, given, stated, where)
    sizes = counts // np.maximum(width, 2)
    if (width == 3).all():
        return values.reshape(-1, 3), sizes
    points = np.zeros((int(sizes.sum()), 3))
    is_solid = np.repeat(width, sizes) == 3
    is_solid_value = np.repeat(width, counts) == 3
    points[is_solid] = values[is_solid_value].reshape(-1, 3)
    points[~is_solid, :2] = values[~is_solid_value].reshape(-1, 2)
    return points, sizes


def parse_numbers(text: str) -> F64 | None:
    """Return the numbers of a text, NaN and infinities among them, or None if it holds others."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)
            values = np.fromstring(text, sep=" ")
    except (ValueError, DeprecationWarning):
        return None
    # Of "1.2.3", NumPy makes two numbers.
    return values if values.size == len(text.split()) else None


def _bad_number(texts: list[str], where: Where) -> InputError:
    """Say which token of which ring is no finite number."""
    ring = 0
    pieces: list[str] = []
    for piece in texts:
        if piece is not RING_END:
            pieces.append(piece)
            continue
        for token in "".join(pieces).split():
            if not _NUMBER.fullmatch(token) or not np.isfinite(float(token)):
                return InputError(
                    f'{where(ring)}: "{shown(token)[:40]}" is not a finite number; '
                    "remove or repair it."
                )
        ring += 1
        pieces.clear()
    return InputError(f"{where(0)}: coordinates that cannot be read; repair them.")


def _wrong_count(ring: int, counts: I64, given: I64, stated: I64, where: Where) -> InputError:
    """Say why the numbers of a ring make no positions."""
    found = count_of(int(counts[ring]), "number")
    if given[ring] > 0:
        of = f"in {count_of(int(given[ring]), 'position')} (pos), which need 3 each"
    else:
        of = f"in a list (posList), {int(stated[ring]) or 3} are needed for each position"
    return InputError(f"{where(ring)}: {found} {of}; the file is damaged.")
