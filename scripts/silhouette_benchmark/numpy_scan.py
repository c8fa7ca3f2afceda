"""Baseline (a): the best flat scan that NumPy alone can do, on one core."""

from __future__ import annotations

import numpy as np

from silhouette_benchmark.flat_tables import FlatTables, Found
from svprep.model import F32, I8

PLANES_AT_ONCE = 1 << 13
"""Their sums, 64 KiB, stay in a core's own cache between the passes over them."""
RECORDS_AT_ONCE = 1 << 15


class NumpyScan:
    """Facing once per plane, two look-ups per record, compression; all into buffers.

    Indices are ``intp``, the only ones that `take` does not convert first; with
    ``mode="clip"`` it writes to `out` without a buffer of its own.
    """

    def __init__(self, tables: FlatTables) -> None:
        n = len(tables.edge)
        self._tables = tables
        self._left = tables.left.astype(np.intp)
        self._right = tables.right.astype(np.intp)
        self._facing = np.zeros(tables.n_planes + 1, np.int8)
        self._sum, self._term = np.empty((2, PLANES_AT_ONCE))
        self._above, self._below = np.empty((2, PLANES_AT_ONCE), bool)
        self._other, self._hit = np.empty(RECORDS_AT_ONCE, np.int8), np.empty(RECORDS_AT_ONCE, bool)
        self._multiplicity = np.empty(n, np.int8)
        self._found = np.empty(n, np.intp)

    def __call__(self, light: F32) -> Found:
        """Return the silhouette for a light."""
        self._face(light)
        tables, k = self._tables, 0
        for begin in range(0, len(tables.edge), RECORDS_AT_ONCE):
            m = self._multiplicity[begin : begin + RECORDS_AT_ONCE]
            end = begin + len(m)
            other, hit = self._other[: len(m)], self._hit[: len(m)]
            self._facing.take(self._left[begin:end], out=m, mode="clip")
            self._facing.take(self._right[begin:end], out=other, mode="clip")
            np.subtract(m, other, out=m)
            np.not_equal(m, 0, out=hit)
            found = np.flatnonzero(hit)
            np.add(found, begin, out=self._found[k : k + len(found)])
            k += len(found)
        found = self._found[:k]
        return Found(
            edge=tables.edge.take(found),
            multiplicity=self._multiplicity.take(found),
            object_start=found.searchsorted(tables.object_start),
        )

    def _face(self, light: F32) -> None:
        """Write each plane's facing, clamped to its floor, to `_facing`."""
        x, y, z, w = light.astype(np.float64).tolist()
        nx, ny, nz, d = self._tables.planes
        floor = self._floor(light)
        for begin in range(0, len(nx), PLANES_AT_ONCE):
            end = min(begin + PLANES_AT_ONCE, len(nx))
            value, term = self._sum[: end - begin], self._term[: end - begin]
            above, below = self._above[: end - begin], self._below[: end - begin]
            np.multiply(nx[begin:end], x, out=value)
            value += np.multiply(ny[begin:end], y, out=term)
            value += np.multiply(nz[begin:end], z, out=term)
            if w != 0.0:
                value += d[begin:end]
            np.greater(value, 0.0, out=above)
            np.less(value, 0.0, out=below)
            facing = self._facing[begin:end]
            np.subtract(above.view(np.int8), below.view(np.int8), out=facing)
            np.maximum(facing, floor[begin:end], out=facing)

    def _floor(self, light: F32) -> I8:
        """Return the floor per plane: a solid with the light within its bounds is robust."""
        tables = self._tables
        if light[3] == 0.0:
            return tables.floor
        at = light[:3]
        outside = ((at < tables.solid_low) | (at > tables.solid_high)).any(axis=1)
        inside = np.flatnonzero(~outside)
        if len(inside) == 0:
            return tables.floor
        floor = tables.floor.copy()
        for begin, end in tables.solid_plane_start[inside].tolist():
            floor[begin:end] = -1
        return floor
