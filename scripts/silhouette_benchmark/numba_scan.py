"""Baseline (b): a flat scan in compiled code on several threads, apart from the product's.

Where there are many objects, a thread takes some and faces their planes just before
it scans their records, which then lie in its own cache. A mesh of one object is done
in two steps instead: all planes, then all records.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from silhouette_benchmark.flat_tables import FlatTables, Found
from silhouette_benchmark.numba_kernels import (
    face_and_scan,
    face_planes,
    scan_branching,
    scan_free,
    solids_around,
)
from svprep.model import F32, F64, I8, I64, U32

RECORDS_PER_THREAD = 50_000
"""Below this a second thread costs more than it brings."""
RECORDS_AT_ONCE = 8_192
"""Of whole objects, between facing and scanning."""


class NumbaScan:
    """The flat scan on up to `threads` threads, the calling one among them.

    `branching`: with a branch per record, faster where few are silhouette.
    """

    def __init__(self, tables: FlatTables, threads: int, branching: bool) -> None:
        n = len(tables.edge)
        self._tables = tables
        self.threads = max(1, min(threads, n // RECORDS_PER_THREAD))
        self._pool = ThreadPoolExecutor(max(1, self.threads - 1))
        self._facing = np.zeros(tables.n_planes + 1, np.int8)
        self._scratch = [(np.empty(n, np.uint32), np.empty(n, np.int8)) for _ in self._others()]
        self._inside = np.empty(len(tables.solid_low) + 1, np.int64)
        shares = np.arange(self.threads + 1) / self.threads
        self._record_cuts = (shares * n).astype(np.int64)
        self._plane_cuts = (shares * tables.n_planes).astype(np.int64)
        largest = int(np.diff(tables.object_start).max())
        self.by_object = largest < n // (2 * self.threads)
        self._object_cuts = self._cut_objects() if self.by_object else []
        self.branching = branching

    def __call__(self, light: F32) -> Found:
        """Return the silhouette for a light."""
        n = len(self._tables.edge)
        at = light.astype(np.float64)
        floor = self._floor(light)
        # One more: a scan without branches writes before it knows whether to keep.
        edge, multiplicity = np.empty(n + 1, np.uint32), np.empty(n + 1, np.int8)
        start = np.empty(len(self._tables.object_start), np.int64)
        places = [(edge, multiplicity), *self._scratch]
        if self.by_object:
            ends = self._all(lambda j: self._face_and_scan(j, at, floor, *places[j], start))
        else:
            self._all(lambda j: self._face(j, at, floor))
            ends = self._all(lambda j: self._scan(j, *places[j], start))
        first = np.cumsum([0, *ends])
        self._all(lambda j: self._join(j, first, edge, multiplicity))
        for j in self._others():
            start[self._first_object(j) : self._first_object(j + 1)] += first[j]
        k = int(first[-1])
        # No record begins these: objects after the last record, and the end itself.
        start[self._first_object(self.threads) :] = k
        return Found(edge[:k], multiplicity[:k], start)

    def describe(self) -> str:
        """Return how it goes about it, in words."""
        order = "planes then records" if not self.by_object else "object by object"
        loop = "with" if self.branching else "without"
        return f"{order}, {loop} a branch per record"

    def _others(self) -> range:
        """Return the parts that other threads do."""
        return range(1, self.threads)

    def _all(self, work: Callable[[int], int]) -> list[int]:
        """Do every part, the first one here; return what each gave."""
        futures: list[Future[int]] = [self._pool.submit(work, j) for j in self._others()]
        return [work(0), *(future.result() for future in futures)]

    def _join(self, slice_: int, first: I64, edge: U32, multiplicity: I8) -> int:
        """Copy one slice of every other part's find behind the first part's."""
        for j in self._others():
            low, high = (int((first[j + 1] - first[j]) * s / self.threads)
                         for s in (slice_, slice_ + 1))  # fmt: skip
            part, part_m = self._scratch[j - 1]
            edge[first[j] + low : first[j] + high] = part[low:high]
            multiplicity[first[j] + low : first[j] + high] = part_m[low:high]
        return 0

    def _first_object(self, part: int) -> int:
        """Return the first object that starts in a part."""
        return int(np.searchsorted(self._tables.object_start, self._record_cuts[part]))

    def _cut_objects(self) -> list[I64]:
        """Return for each part the object numbers between which it faces, then scans.

        Moves the parts' borders to the next object's first record.
        """
        start = self._tables.object_start
        n_objects = len(start) - 1
        borders = np.searchsorted(start, self._record_cuts)
        borders[0], borders[-1] = 0, n_objects
        cuts = []
        for low, high in itertools.pairwise(borders.tolist()):
            steps = np.arange(start[low], start[high], RECORDS_AT_ONCE)
            inner = np.searchsorted(start, steps)
            cuts.append(np.unique(np.concatenate([[low], np.clip(inner, low, high), [high]])))
        self._record_cuts = start[borders]
        return cuts

    def _face(self, part: int, light: F64, floor: I8) -> int:
        begin, end = self._plane_cuts[part], self._plane_cuts[part + 1]
        face_planes(*self._tables.planes, floor, light, begin, end, self._facing)
        return 0

    def _scan(self, part: int, edge: U32, multiplicity: I8, start: I64) -> int:
        t, scan = self._tables, scan_branching if self.branching else scan_free
        begin, end = self._record_cuts[part], self._record_cuts[part + 1]
        return int(
            scan(t.object_start, begin, end, t.left, t.right, t.edge, self._facing,
                 0, edge, multiplicity, start)
        )  # fmt: skip

    def _face_and_scan(
        self, part: int, light: F64, floor: I8,
        edge: U32, multiplicity: I8, start: I64,
    ) -> int:  # fmt: skip
        t = self._tables
        return int(
            face_and_scan(
                t.planes, floor, light, t.object_start, t.object_plane_start,
                self._object_cuts[part], self.branching,
                t.left, t.right, t.edge, self._facing, 0, edge, multiplicity, start,
            )
        )  # fmt: skip

    def _floor(self, light: F32) -> I8:
        """Return the floor per plane: a solid with the light within its bounds is robust."""
        t = self._tables
        if light[3] == 0.0:
            return t.floor
        k = solids_around(light, t.solid_low, t.solid_high, self._inside)
        if k == 0:
            return t.floor
        floor = t.floor.copy()
        for begin, end in t.solid_plane_start[self._inside[:k]].tolist():
            floor[begin:end] = -1
        return floor


def fastest_scan(tables: FlatTables, threads: int, trial_lights: Sequence[F32]) -> NumbaScan:
    """Return the scan with the loop of the lowest median time over some lights."""
    scans = [NumbaScan(tables, threads, branching) for branching in (False, True)]
    for scan in scans:
        scan(trial_lights[0])  # compiles
    seconds = np.empty((len(trial_lights), len(scans)))
    for row, light in enumerate(trial_lights):
        for column, scan in enumerate(scans):
            begun = time.perf_counter()
            scan(light)
            seconds[row, column] = time.perf_counter() - begun
    medians = np.median(seconds, axis=0)
    return scans[int(medians.argmin())]
