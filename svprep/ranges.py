"""Rows of some of many runs that lie one behind the other."""

from __future__ import annotations

import numpy as np

from svprep.model import I64


def rows_of_runs(start: I64, chosen: I64) -> tuple[I64, I64]:
    """Return the rows ``start[i] .. start[i + 1] - 1`` of chosen i, and where each i's begin.

    ``start (n + 1,)``, ``chosen (m,)`` in any order -> ``(n_rows,)``, ``(m + 1,)``. O(n_rows).
    """
    sizes = start[chosen + 1] - start[chosen]
    new_start = np.concatenate(([0], np.cumsum(sizes)))
    rows = np.repeat(start[chosen] - new_start[:-1], sizes)
    rows += np.arange(len(rows))
    return rows, new_start
