"""The edge table: a record for every pair of faces and every single one."""

from __future__ import annotations

import numpy as np

from svprep.kernels.half_edges import count_edge_rows, write_edge_rows
from svprep.model import Components, EdgeTable, PlaneTable
from svprep.repair.split import sort_stably
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
    row_start = np.empty(len(groups.start), np.int64)
    count_edge_rows(mesh.faces, groups.order, groups.start, repaired.mate, row_start)
    rows = np.empty((int(row_start[-1]), 4), np.uint32)
    flags = np.empty(len(rows), np.uint8)
    write_edge_rows(
        mesh.faces,
        groups.order,
        groups.start,
        repaired.mate,
        row_start,
        planes.plane_of_face,
        rows,
        flags,
    )
    n_components = len(repaired.component_flags)
    component_of_face = np.repeat(
        np.arange(n_components, dtype=np.int32), np.diff(repaired.component_face_start)
    )
    # NO_INDEX is the highest uint32, so the lower face is always a real one.
    component_of_row = component_of_face[np.minimum(rows[:, 2], rows[:, 3])]
    order, edge_start = sort_stably(component_of_row, n_components)
    if not (order[1:] > order[:-1]).all():
        rows, flags = rows[order], flags[order]
    components = Components(
        object_start=repaired.component_start,
        face_start=repaired.component_face_start,
        edge_start=edge_start,
        flags=repaired.component_flags,
    )
    return EdgeTable(rows=rows, flags=flags), components
