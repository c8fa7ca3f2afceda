"""Tables that grow block by block, in memory or in files that take its place.

A `Column` is appended to, and then is one array. With a `Spill` its rows go to a raw file,
which is mapped at the end: the system keeps in memory what of it is used, and `release`
says that a part is not used now. Results are the same either way.
"""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from svprep.errors import EnvironmentProblem

Array = NDArray[Any]

BLOCK_ROWS: Final = 1 << 18
"""Rows that are worked on at a time where an array may be a mapped file."""
_MARGIN: Final = 1.05


@dataclass(frozen=True, slots=True)
class Spill:
    """Where tables go that are not to be held in memory, and how much of that there is."""

    folder: Path
    """Of the caller, who removes it. On POSIX it stays empty: files lose their names when
    they are made, and so are gone with the arrays, however the process ends."""
    memory_bytes: int
    """[B]: what a file may take that can only be read whole, before a remark says so."""
    remarks: list[str] = field(default_factory=list)
    """One line each on what took more. They are no notes of the model, which is the same."""
    _sizes: list[int] = field(default_factory=list)

    def count(self, n_bytes: int) -> None:
        """Count bytes that are written, or room that is taken to be; on any thread."""
        self._sizes.append(n_bytes)

    def n_bytes(self) -> int:
        """Return how many there have been."""
        return sum(self._sizes)


class Column:
    """A table of `width` numbers a row (0: of numbers) that grows at its end.

    In memory it is copied as it grows, unless the share of all rows that is there can be
    told; room that is not written to costs nothing.
    """

    def __init__(self, dtype: DTypeLike, width: int, spill: Spill | None) -> None:
        self._file: BinaryIO | None = None
        self._dtype = np.dtype(dtype)
        self._width = width
        self._spill = spill
        self._file = None if spill is None else _new_file(spill)
        self._rows: Array = np.empty(self._shape(0), dtype)
        self._n = 0

    def __del__(self) -> None:
        """Give the file up, also where an error came before the last row."""
        if self._file is not None:
            self._file.close()

    def __len__(self) -> int:
        return self._n

    def append(self, rows: Array, share: float = 0.0) -> None:
        """Append rows; `share` of all will then be there, 0 if that is not known."""
        n = self._n + len(rows)
        if self._spill is not None and self._file is not None:
            _write(self._file, np.ascontiguousarray(rows, self._dtype), self._spill)
        else:
            if n > len(self._rows):
                capacity = max(int(_MARGIN * n / share) if share else 0, n + n // 2)
                grown = np.empty(self._shape(capacity), self._dtype)
                grown[: self._n] = self._rows[: self._n]
                self._rows = grown
            self._rows[self._n : n] = rows
        self._n = n

    def table(self) -> Array:
        """Return all rows. Nothing can be appended any more."""
        if self._file is None:
            return self._rows[: self._n]
        with self._file:
            return _mapped(self._file, self._dtype, self._shape(self._n))

    def _shape(self, n: int) -> tuple[int, ...]:
        return (n, self._width) if self._width else (n,)


def empty_table(dtype: DTypeLike, shape: tuple[int, ...], spill: Spill | None) -> Array:
    """Return a table to be filled in any order: in memory, or a mapped file."""
    if spill is None:
        return np.empty(shape, dtype)
    with _new_file(spill) as file:
        n_bytes = int(np.prod(shape)) * np.dtype(dtype).itemsize
        try:
            file.truncate(n_bytes)
            if n_bytes and hasattr(os, "posix_fallocate"):
                # On a full disk, storing into a hole of a mapped file would kill the process.
                os.posix_fallocate(file.fileno(), 0, n_bytes)
        except OSError as error:
            raise _no_room(spill, error) from None
        spill.count(n_bytes)
        return _mapped(file, np.dtype(dtype), shape)


def is_spilled(array: Array) -> bool:
    """Whether an array is a mapped file, or has nothing that could be one."""
    return array.size == 0 or _mapping_of(array) is not None


def spilled(array: Array, spill: Spill | None) -> Array:
    """Return an array as a mapped file, if there is a `spill`."""
    if spill is None or is_spilled(array):
        return array
    column = Column(array.dtype, array.shape[1] if array.ndim > 1 else 0, spill)
    column.append(array)
    return column.table()


def release(array: Array) -> None:
    """Let the system take back the memory behind a mapped file; it is read again if used.

    What was written to the array stays. Nothing happens to an array in memory, or where the
    system cannot do that.
    """
    mapping = _mapping_of(array)
    if mapping is None or not array.flags.c_contiguous or not hasattr(mmap, "MADV_DONTNEED"):
        return
    offset = array.ctypes.data - np.frombuffer(mapping, np.uint8, 1).ctypes.data
    begin = offset // mmap.PAGESIZE * mmap.PAGESIZE
    mapping.madvise(mmap.MADV_DONTNEED, begin, offset + array.nbytes - begin)


def row_blocks(*arrays: Array, rows: int = BLOCK_ROWS) -> Iterator[tuple[Array, ...]]:
    """Yield the same rows of each array, block by block, and release those that are done."""
    for begin in range(0, len(arrays[0]), rows):
        block = tuple(array[begin : begin + rows] for array in arrays)
        yield block
        for part in block:
            release(part)


def _mapping_of(array: Array) -> mmap.mmap | None:
    """Return the mapping that an array, or the one it is a view of, lies in."""
    base: object = array
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, memoryview):
        base = base.obj
    return base if isinstance(base, mmap.mmap) else None


def _new_file(spill: Spill) -> BinaryIO:
    """Return a new file, which on POSIX nobody else can find."""
    try:
        descriptor, name = tempfile.mkstemp(".rows", dir=spill.folder)
        if os.name == "posix":
            os.unlink(name)
    except OSError as error:
        raise _no_room(spill, error) from None
    return open(descriptor, "r+b", buffering=0)


def _write(file: BinaryIO, rows: Array, spill: Spill) -> None:
    spill.count(rows.nbytes)
    left = rows.reshape(-1).view(np.uint8).data
    try:
        while left:
            left = left[file.write(left) :]
    except OSError as error:
        raise _no_room(spill, error) from None


def _mapped(file: BinaryIO, dtype: np.dtype[Any], shape: tuple[int, ...]) -> Array:
    if not np.prod(shape):
        return np.empty(shape, dtype)  # an empty file cannot be mapped
    return np.frombuffer(mmap.mmap(file.fileno(), 0), dtype).reshape(shape)


def _no_room(spill: Spill, error: OSError) -> EnvironmentProblem:
    return EnvironmentProblem(
        f"{spill.folder}: tables that do not fit into memory cannot be written there: "
        f"{error.strerror or error}. Set TMPDIR to a folder with more room, or allow more memory."
    )
