"""Places along a Hilbert curve: near keys are near in space, and a key depends on its place alone.

Hilbert (1891); the steps from a cell's Morton code to its place on the curve follow Hamilton
and Rau-Chaplin (2008): a state is the corner at which the curve enters a cell and the axis
along which it leaves it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from svprep.model import I64, U64

BITS: Final = 21
"""Of each coordinate: three fill 63 bits."""
_LEVELS: Final = 3
"""Levels of cells that one look at the table goes down."""
_SPREADS: Final = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def hilbert_keys(cells: I64) -> U64:
    """Return the places on the curve of ``cells (n, 3)``, numbers of `BITS` bits. O(n)."""
    table = _table()
    code = (_spread(cells[:, 0]) << 2) | (_spread(cells[:, 1]) << 1) | _spread(cells[:, 2])
    key = np.zeros(len(code), np.int64)
    at = np.zeros(len(code), np.int64)
    n_bits = 3 * _LEVELS
    low = (1 << n_bits) - 1
    for shift in range(3 * BITS - n_bits, -1, -n_bits):
        at &= ~low  # the state
        at |= (code >> shift) & low
        at = table.take(at)
        key <<= n_bits
        key |= at & low
    return key.view(np.uint64)


def _spread(values: I64) -> I64:
    """Return numbers with two zeros between any two bits."""
    spread = values.astype(np.int64)
    for shift, mask in _SPREADS:
        spread |= spread << shift
        spread &= mask
    return spread


@lru_cache(maxsize=1)
def _table() -> I64:
    """Return by ``state << 9 | Morton code of three levels``: next state and key, likewise."""
    one_key, one_next = _one_level()
    codes = np.tile(np.arange(1 << (3 * _LEVELS)), 24)
    state = np.repeat(np.arange(24), 1 << (3 * _LEVELS))
    key = np.zeros(len(codes), np.int64)
    for level in range(_LEVELS - 1, -1, -1):
        octant = (codes >> (3 * level)) & 7
        key = (key << 3) | one_key[state, octant]
        state = one_next[state, octant]
    return (state << (3 * _LEVELS)) | key


def _one_level() -> tuple[I64, I64]:
    """Return the place of each octant, and the state in it: ``(24, 8)``, state = 8 axis + entry."""
    keys, states = np.empty((24, 8), np.int64), np.empty((24, 8), np.int64)
    for axis in range(3):
        for entry in range(8):
            for octant in range(8):
                gray = _turned(octant ^ entry, 2 - axis)
                w = gray ^ (gray >> 1) ^ (gray >> 2)
                into = 0 if w == 0 else _gray(2 * ((w - 1) // 2))
                along = 0 if w == 0 else _ones_at_end(w if w % 2 else w - 1) % 3
                new_entry = entry ^ _turned(into, axis + 1)
                keys[8 * axis + entry, octant] = w
                states[8 * axis + entry, octant] = 8 * ((axis + along + 1) % 3) + new_entry
    return keys, states


def _turned(bits: int, n: int) -> int:
    """Return three bits turned left by n."""
    n %= 3
    return ((bits << n) | (bits >> (3 - n))) & 7


def _gray(i: int) -> int:
    return i ^ (i >> 1)


def _ones_at_end(i: int) -> int:
    return (~i & (i + 1)).bit_length() - 1
