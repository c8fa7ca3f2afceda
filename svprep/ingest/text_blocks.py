"""A text in blocks of whole statements, each in a buffer that is used again."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from svprep.ingest.file_bytes import Text
from svprep.model import U8

IN_FLIGHT: Final = 8
"""Blocks that wait for a thread, at most."""
_MOST_LOOKS: Final = 1000
_BLANKS: Final = b" \t\v\f\r\n"
_BACKSLASH: Final = 0x5C
_LINE_FEEDS: Final = 2  # one for the last line, one behind it

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Block:
    """Whole lines of a text."""

    data: U8
    """Room, of which the first bytes are the lines, and a line feed behind them."""
    n_bytes: int
    """Of the lines; the last one of the text gets a line feed."""
    share: float
    """Of the file that is read once this block is, 0 to 1."""


class Buffers:
    """Room for blocks: what is given back is handed out again."""

    def __init__(self) -> None:
        self._spare: queue.SimpleQueue[U8] = queue.SimpleQueue()

    def take(self, n_bytes: int) -> U8:
        """Return room for at least so many bytes."""
        try:
            spare = self._spare.get_nowait()
        except queue.Empty:
            return np.empty(n_bytes, np.uint8)
        return spare if spare.size >= n_bytes else np.empty(n_bytes, np.uint8)

    def give_back(self, room: U8) -> None:
        """Take back what no block uses any more."""
        self._spare.put(room)


def text_blocks(text: Text, block_bytes: int, buffers: Buffers) -> Iterator[Block]:
    """Cut a text into blocks that end behind a line end, which no continued line crosses.

    Of `block_bytes`, or as many as a longer statement takes. The same for every reading.
    """
    with text.stream() as stream:
        data = buffers.take(block_bytes + _LINE_FEEDS)
        held, wanted = 0, block_bytes
        while True:
            if data.size < wanted + _LINE_FEEDS:
                more = np.empty(wanted + _LINE_FEEDS - held, np.uint8)
                data = np.concatenate([data[:held], more])
            size = held + stream.fill(data[held:wanted])
            is_last = size < wanted
            end = size if is_last else _last_statement_end(data[:size])
            if end == 0 and size > 0:  # a statement is longer than the block
                held, wanted = size, 2 * wanted
                continue
            held = size - end
            following = buffers.take(max(block_bytes, held) + _LINE_FEEDS)
            following[:held] = data[end:size]
            data[end : end + _LINE_FEEDS] = 0x0A
            if end:
                yield Block(data, end + int(is_last), stream.share())
            if is_last:
                return
            data, wanted = following, max(block_bytes, 2 * held)


def _last_statement_end(data: U8) -> int:
    """Return where the last statement that is whole ends; 0 if none is.

    A carriage return at the very end may be half a line end.
    """
    end = data.size - int(data[-1] == 0x0D)
    for _ in range(_MOST_LOOKS):  # continued lines: it is quicker to read on
        end = _line_end_before(data, end)
        if end == 0:
            return 0
        before = _before_blanks(data, end)
        if before == 0 or data[before - 1] != _BACKSLASH:
            return end
        end = before
    return 0


def _line_end_before(data: U8, end: int) -> int:
    """Return the first byte behind the last line end in ``data[:end]``; 0 if there is none."""
    window = 256
    while end > 0:
        begin = max(0, end - window)
        part = data[begin:end].tobytes()
        found = max(part.rfind(b"\n"), part.rfind(b"\r"))
        if found >= 0:
            return begin + found + 1
        end, window = begin, 4 * window
    return 0


def _before_blanks(data: U8, end: int) -> int:
    """Return the first byte of the blanks and line ends that ``data[:end]`` ends with."""
    window = 64
    while end > 0:
        begin = max(0, end - window)
        left = len(data[begin:end].tobytes().rstrip(_BLANKS))
        if left:
            return begin + left
        end, window = begin, 4 * window
    return 0


def in_order(pool: Executor, do: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Yield ``do(item)`` in the order of items, of which few are asked for ahead."""
    waiting: deque[Future[R]] = deque()
    for item in items:
        waiting.append(pool.submit(do, item))
        if len(waiting) > IN_FLIGHT:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
