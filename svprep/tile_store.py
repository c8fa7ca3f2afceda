"""Where the tables of tiles are kept until they are written behind each other."""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from svprep.cache.runs import Run, runs_of_objects, whole_run
from svprep.ingest.spill import Column, Spill
from svprep.model import I64

Raw = NDArray[Any]


class InMemory:
    """Tables of tiles, as they are."""

    def __init__(self) -> None:
        self._runs: dict[int, Run] = {}

    def add(self, numbers: I64, arrays: dict[str, Raw]) -> None:
        """Keep a tile's tables, of objects with these numbers."""
        if len(numbers) == 1 + numbers[-1] - numbers[0]:
            self._runs[int(numbers[0])] = whole_run(arrays)
        else:  # objects that changed, others between them
            self._runs.update(runs_of_objects(arrays, numbers))

    def runs(self) -> dict[int, Run]:
        """Return runs of consecutive objects, by the first one's number."""
        return self._runs


class OnDisk:
    """Tables of tiles, in one file per dataset."""

    def __init__(self, spill: Spill) -> None:
        self._spill = spill
        self._columns: dict[str, Column] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._rows: dict[int, dict[str, tuple[int, int]]] = {}

    def add(self, numbers: I64, arrays: dict[str, Raw]) -> None:
        """Write a tile's tables, of consecutive objects, behind those of the tiles before."""
        rows: dict[str, tuple[int, int]] = {}
        for path, array in arrays.items():
            width = math.prod(array.shape[1:]) if array.ndim > 1 else 0
            flat = array.reshape(len(array), width) if width else array
            if path not in self._columns:
                self._columns[path] = Column(array.dtype, width, self._spill)
                self._shapes[path] = array.shape[1:]
            column = self._columns[path]
            rows[path] = len(column), len(column) + len(array)
            column.append(flat)
        self._rows[int(numbers[0])] = rows

    def runs(self) -> dict[int, Run]:
        """Return each tile's objects as a run of mapped files, by the first one's number."""
        tables = {path: column.table() for path, column in self._columns.items()}
        return {
            first: whole_run(
                {
                    path: tables[path][a:b].reshape(b - a, *self._shapes[path])
                    for path, (a, b) in rows.items()
                }
            )
            for first, rows in self._rows.items()
        }
