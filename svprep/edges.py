"""The edge table: a record for every pair of faces and every single one."""

from __future__ import annotations

import numpy as np

from svprep.kernels.half_edges import write_edge_rows
from svprep.model import Components, EdgeTable, PlaneTable
from svprep.repair.stage import Repaired


def build_edges(repaired: Repaired, planes: PlaneTable) -> tuple[EdgeTable, Components]:
    """Return every edge record of the mesh, and the components with their ranges.

    Row layout ``[v0, v1, f_left, f_right]``: ``v0 < v1``; ``f_left`` traverses
    v0 -> v1, ``f_right`` the other way; a record of one face holds ``NO_INDEX``.
    An edge of k > 2 faces takes one row per consistently wound pair and one per
    face left over, all of kind ``SPLIT``; an edge whose two faces run the same
    way takes two rows of kind ``BORDER``. None is dropped, so every side of
    every face stands in exactly one row.

    A row is planar iff its two faces share a plane record: sharing goes only
    over pairs, which wind consistently.

    Returns
    -------
    EdgeTable
        Rows sorted by (object, component, v0, v1, f_left).
    Components

    Notes
    -----
    O(n). Edge duplication after Steiner (2006), A.2.
    Plain twin: `reference.edge_rows`.
    """
    mesh, groups = repaired.mesh, repaired.groups
    n_components = len(repaired.component_flags)
    component_of_face = np.repeat(
        np.arange(n_components, dtype=np.int32), np.diff(repaired.component_face_start)
    )
    singles = component_of_face[np.flatnonzero(repaired.mate < 0) // 3]
    # A record for each single half-edge, and one for each two that are paired.
    n_sides = 3 * np.diff(repaired.component_face_start)
    n_rows = (n_sides + np.bincount(singles, minlength=n_components)) // 2
    edge_start = np.concatenate(([0], np.cumsum(n_rows)))
    rows = np.empty((int(edge_start[-1]), 4), np.uint32)
    flags = np.empty(len(rows), np.uint8)
    write_edge_rows(
        mesh.faces,
        groups.order,
        groups.start,
        repaired.mate,
        component_of_face,
        edge_start[:-1].copy(),
        planes.plane_of_face,
        rows,
        flags,
    )
    components = Components(
        object_start=repaired.component_start,
        face_start=repaired.component_face_start,
        edge_start=edge_start,
        flags=repaired.component_flags,
    )
    return EdgeTable(rows=rows, flags=flags), components
