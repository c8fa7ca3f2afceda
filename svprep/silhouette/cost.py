"""The cost model by which `auto` chooses between an object's tree and the flat scan.

Costs are in units of one scanned record; ARCHITECTURE.md says how they were measured.
"""

from __future__ import annotations

import numpy as np

from svprep.model import BOOL, F64, SilhouetteIndex
from svprep.silhouette.tables import SearchTables

PLANE = 0.4
"""Of facing a plane record."""
TREE, NODE, EDGE, ALWAYS = 500.0, 8.0, 9.0, 30.0
"""Of a search: per object, node tested, edge tested, always-on record."""
GAIN = 0.8
"""A tree is searched only if it is expected to take less than this share of a scan."""


def tree_costs(tables: SearchTables, index: SilhouetteIndex) -> F64:
    """Return the expected cost of searching each tree of dual boxes, ``(n_trees,)``."""
    objects = index.objects.astype(np.int64)
    n_always = np.diff(tables.begin)[objects] - np.diff(index.pair_start)
    n_edges, n_nodes = index.hextree.expected_work.astype(np.float64).T
    return np.asarray(TREE + NODE * n_nodes + EDGE * n_edges + ALWAYS * n_always, np.float64)


def is_tree_cheaper(tables: SearchTables, index: SilhouetteIndex, cost_of_tree: F64) -> BOOL:
    """Return ``(n_trees,)``: whether a tree is expected to beat the scan of its object.

    ``cost_of_tree (n_trees,)`` as `tree_costs` returns it.
    """
    objects = index.objects.astype(np.int64)
    n_planes = np.diff(tables.plane_start)[objects]
    scan = PLANE * n_planes + np.diff(tables.begin)[objects]
    return np.asarray(cost_of_tree < GAIN * scan)
