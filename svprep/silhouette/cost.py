"""The cost model by which `auto` chooses between an object's tree and the flat scan.

Costs are in units of one scanned record; ARCHITECTURE.md says how they were measured.
"""

from __future__ import annotations

import numpy as np

from svprep.model import F64, SilhouetteIndex
from svprep.silhouette.tables import SearchTables

PLANE = 0.4
"""Of facing a plane record."""
TREE, NODE, EDGE, ALWAYS = 600.0, 3.0, 4.0, 12.0
"""Of a tree: per object, node tested, edge tested, always-on record."""


def scan_costs(tables: SearchTables, index: SilhouetteIndex) -> F64:
    """Return the cost of scanning each object that has a tree, ``(n_trees,)``."""
    objects = index.objects.astype(np.int64)
    n_planes = np.diff(tables.plane_start)[objects]
    return np.asarray(PLANE * n_planes + np.diff(tables.begin)[objects], np.float64)


def tree_costs(tables: SearchTables, index: SilhouetteIndex) -> F64:
    """Return the expected cost of searching each tree of dual boxes, ``(n_trees,)``."""
    objects = index.objects.astype(np.int64)
    n_always = np.diff(tables.begin)[objects] - np.diff(index.pair_start)
    n_edges, n_nodes = index.hextree.expected_work.astype(np.float64).T
    return np.asarray(TREE + NODE * n_nodes + EDGE * n_edges + ALWAYS * n_always, np.float64)
