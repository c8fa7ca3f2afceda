"""What is to be written: every dataset, in blocks that are made when they are written."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from svprep.cache.runs import PER_OBJECT, Joined, Piece

Raw = NDArray[Any]

BLOCK_BYTES: Final = 1 << 24
"""Of a block at most, but for a tile's rows that are more."""

_JOINED: Final = frozenset(spec.path for spec in PER_OBJECT)


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive rows of a dataset, made when they are written, on any thread."""

    n_rows: int
    n_bytes: int
    make: Callable[[], Raw]
    let_go: Callable[[], None]
    """To be called when they are written."""


class Contents(Protocol):
    """The stored arrays of all datasets."""

    def shape(self, path: str) -> tuple[int, ...]:
        """Return the shape of a dataset."""

    def blocks(self, path: str) -> Iterator[Block]:
        """Yield the rows of a dataset, in order."""

    def whole(self, path: str) -> Raw:
        """Return a dataset."""


class InMemory:
    """Arrays that are all there."""

    def __init__(self, arrays: Mapping[str, Raw]) -> None:
        self._arrays = arrays

    def shape(self, path: str) -> tuple[int, ...]:
        """Return the shape of a dataset."""
        return self._arrays[path].shape

    def blocks(self, path: str) -> Iterator[Block]:
        """Yield a dataset, in one block."""
        array = self._arrays[path]
        yield Block(len(array), array.nbytes, lambda: array, _nothing)

    def whole(self, path: str) -> Raw:
        """Return a dataset."""
        return self._arrays[path]


class OfRuns:
    """Runs of objects, put one behind the other while they are written, and the rest."""

    def __init__(self, joined: Joined, others: Mapping[str, Raw]) -> None:
        self._joined = joined
        self._others = InMemory(others)

    def shape(self, path: str) -> tuple[int, ...]:
        """Return the shape of a dataset."""
        return self._joined.shape(path) if path in _JOINED else self._others.shape(path)

    def blocks(self, path: str) -> Iterator[Block]:
        """Yield the rows of a dataset, those of small runs together."""
        if path not in _JOINED:
            yield from self._others.blocks(path)
            return
        held: list[Piece] = []
        n_bytes = 0
        for piece in self._joined.pieces(path):
            if held and n_bytes + piece.rows.nbytes > BLOCK_BYTES:
                yield self._block(held, n_bytes)
                held, n_bytes = [], 0
            held.append(piece)
            n_bytes += piece.rows.nbytes
        if held:
            yield self._block(held, n_bytes)

    def whole(self, path: str) -> Raw:
        """Return a dataset."""
        return self._joined.array(path) if path in _JOINED else self._others.whole(path)

    def _block(self, pieces: list[Piece], n_bytes: int) -> Block:
        def make() -> Raw:
            rows = [piece.counted_on() for piece in pieces]
            return rows[0] if len(rows) == 1 else np.concatenate(rows)

        def let_go() -> None:
            for piece in pieces:
                self._joined.release(piece.rows)

        return Block(sum(len(piece.rows) for piece in pieces), n_bytes, make, let_go)


def _nothing() -> None:
    pass
