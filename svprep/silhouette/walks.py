"""Methods that look at everything: `brute`, `edge_buffer` and `elimination`."""

from __future__ import annotations

import numpy as np

from svprep.kernels.face_walks import eliminate_edges, fill_edge_buffer
from svprep.kernels.search import counted_facing
from svprep.model import F32, I8, I64, NO_INDEX, U32
from svprep.silhouette.result import Work
from svprep.silhouette.tables import SearchTables, ranges, read_only

Rows = tuple[U32, I8, I64, Work]
"""Edge ids, multiplicities, object offsets, work."""


def brute(tables: SearchTables, objects: I64, light: F32, floor: I8) -> Rows:
    """Compute the multiplicity of every edge record of `objects`, planar ones too."""
    s = _facing_of_faces(tables, objects, light, floor)
    edge_begin, edge_end = tables.object_edge[objects], tables.object_edge[objects + 1]
    edges = ranges(edge_begin, edge_end)
    sides = tables.edges.rows[:, 2:].take(edges, axis=0)
    m = s.take(np.where(sides == NO_INDEX, len(s) - 1, sides))
    return _not_zero(m[:, 0] - m[:, 1], edges, edge_end - edge_begin, len(edges))


def edge_buffer(tables: SearchTables, objects: I64, light: F32, floor: I8) -> Rows:
    """Walk over faces; each adds its facing to the buffer's entry of its three edges.

    Notes
    -----
    After Buchanan and Sousa (2000), *The edge buffer*. Theirs keeps two bits an
    edge, one for front faces and one for back faces, flipped by each face, and so
    is right for two faces an edge; here an entry is the sum itself.
    """
    edges, lengths, shift = _buffer(tables, objects)
    m = np.zeros(len(edges), np.int8)
    fill_edge_buffer(
        read_only(tables.mesh.faces),
        tables.record_of_sides,
        _facing_of_faces(tables, objects, light, floor),
        *_faces_of(tables, objects),
        shift,
        m,
    )
    return _not_zero(m, edges, lengths, len(edges))


def elimination(tables: SearchTables, objects: I64, light: F32, floor: I8) -> Rows:
    """Walk over faces; an edge met by two that agree is eliminated from a list.

    Notes
    -----
    Edge elimination, the method that Steiner (2006) chose. The list is unsorted, so
    it is sorted in the end.
    """
    edges, _, shift = _buffer(tables, objects)
    slot = np.full(len(edges), -1, np.int32)
    listed = np.empty((len(edges), 2), np.int64)
    values = np.empty(len(edges), np.int8)
    begin, end = _faces_of(tables, objects)
    s = _facing_of_faces(tables, objects, light, floor)
    n = eliminate_edges(
        read_only(tables.mesh.faces),
        tables.record_of_sides,
        s,
        begin,
        end,
        shift,
        slot,
        listed,
        values,
    )
    order = np.argsort(listed[:n, 0])
    found = listed[:n, 0][order]
    start = np.searchsorted(found, tables.object_edge[objects])
    return (
        found.astype(np.uint32),
        values[:n][order],
        np.append(start, n).astype(np.int64),
        Work(len(edges), 0),
    )


def _facing_of_faces(tables: SearchTables, objects: I64, light: F32, floor: I8) -> I8:
    """Return the counted facing of the faces of `objects`, ``(n_faces + 1,)``.

    Those of other objects are not set; the last, of a missing face, is 0.
    """
    s = np.empty(len(tables.planes), np.int8)
    begin, end = tables.plane_start[objects], tables.plane_start[objects + 1]
    x, y, z, w = (float(v) for v in light)
    counted_facing(
        tables.planes, tables.units, x, y, z, w, floor, read_only(begin), read_only(end), s
    )
    of_face = np.empty(len(tables.plane_of_face) + 1, np.int8)
    of_face[-1] = 0
    if len(objects) == tables.n_objects:
        s.take(tables.plane_of_face, out=of_face[:-1], mode="clip")
        return of_face
    faces = ranges(*_faces_of(tables, objects))
    of_face[faces] = s.take(tables.plane_of_face.take(faces))
    return of_face


def _faces_of(tables: SearchTables, objects: I64) -> tuple[I64, I64]:
    start = tables.mesh.object_face_start
    return start[objects], start[objects + 1]


def _buffer(tables: SearchTables, objects: I64) -> tuple[I64, I64, I64]:
    """Return the edges of `objects`, how many each has, and entry less edge of each."""
    begin, end = tables.object_edge[objects], tables.object_edge[objects + 1]
    lengths = end - begin
    return ranges(begin, end), lengths, np.cumsum(lengths) - lengths - begin


def _not_zero(m: I8, edges: I64, lengths: I64, n_looked_at: int) -> Rows:
    kept = np.flatnonzero(m)
    start = np.searchsorted(kept, np.concatenate(([0], np.cumsum(lengths))))
    return (
        edges.take(kept).astype(np.uint32),
        m.take(kept),
        start.astype(np.int64),
        Work(n_looked_at, 0),
    )
