"""Twins of welding, of the half-edge tables and of the plane records."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np

from svprep.model import (
    F32,
    F64,
    I64,
    NO_INDEX,
    U8,
    U32,
    EdgeFlag,
    EdgeKind,
    Grid,
    Mesh,
    SourceMesh,
)

_MOST_STEPS = 1 << 25  # a grid is at most this many steps wide
_FINEST = -60
_FLOAT64_BITS = 52


def first_equal_row(rows: np.ndarray, group_start: I64) -> list[int]:
    """Return, for every row, the lowest row of its group that equals it.

    ``rows (n, k)`` integers; group g owns rows ``[group_start[g], group_start[g + 1])``.
    """
    first: list[int] = []
    for begin, end in itertools.pairwise(group_start.tolist()):
        seen: dict[tuple[int, ...], int] = {}
        first += [seen.setdefault(tuple(rows[i].tolist()), i) for i in range(begin, end)]
    return first


def group_edges(faces: np.ndarray) -> dict[tuple[int, int], list[int]]:
    """Return the half-edges of every undirected edge ``(lo, hi)``, ascending.

    Half-edge ``3 f + c`` runs from corner c of face f to corner (c + 1) % 3.
    """
    groups: dict[tuple[int, int], list[int]] = {}
    for f, corners in enumerate(faces.tolist()):
        for c in range(3):
            a, b = corners[c], corners[(c + 1) % 3]
            groups.setdefault((min(a, b), max(a, b)), []).append(3 * f + c)
    return {edge: groups[edge] for edge in sorted(groups)}


def components(mate: np.ndarray) -> list[int]:
    """Return each face's component, connected over paired half-edges.

    ``mate (3 n_faces,)``: the half-edge each one is paired with, or -1.
    Components are numbered by their lowest face.
    """
    mates = mate.tolist()
    component = [-1] * (len(mates) // 3)
    n = 0
    for seed in range(len(component)):
        if component[seed] >= 0:
            continue
        component[seed] = n
        stack = [seed]
        while stack:
            f = stack.pop()
            for other in mates[3 * f : 3 * f + 3]:
                if other >= 0 and component[other // 3] < 0:
                    component[other // 3] = n
                    stack.append(other // 3)
        n += 1
    return component


def edge_rows(
    faces: np.ndarray, mate: np.ndarray, component: np.ndarray, plane_of_face: np.ndarray
) -> tuple[U32, U8]:
    """Return every edge record and its flags; see `svprep.model.EdgeTable`.

    Rows are sorted by (component, v0, v1, left, right). Components are taken
    to be numbered by object, as `components` numbers them on grouped faces.
    """
    records: list[tuple[int, int, int, int, int, int]] = []
    for (lo, hi), half_edges in group_edges(faces).items():
        for h in half_edges:
            f, other = h // 3, int(mate[h])
            runs_up = int(faces[f, h % 3]) == lo
            if not runs_up and other >= 0:
                continue  # told by its mate
            left = f if runs_up else NO_INDEX
            right = f if not runs_up else other // 3 if other >= 0 else NO_INDEX
            kind = EdgeKind.SPLIT if len(half_edges) > 2 else EdgeKind.BORDER
            if other >= 0 and len(half_edges) == 2:
                kind = EdgeKind.PAIR
            is_planar = other >= 0 and plane_of_face[left] == plane_of_face[right]
            flags = int(kind) | (int(EdgeFlag.PLANAR) if is_planar else 0)
            records.append((int(component[f]), lo, hi, left, right, flags))
    table = np.array(sorted(records), np.int64).reshape(-1, 6)
    return table[:, 1:5].astype(np.uint32), table[:, 5].astype(np.uint8)


def _choose_grid(source: SourceMesh) -> Grid:
    used = sorted(set(source.faces.reshape(-1).tolist()))
    if not used:
        return Grid(step_m=2.0**-24, origin_m=np.zeros(3))
    exact = [[Fraction(x) for x in source.positions[v].tolist()] for v in used]
    low = [min(p[axis] for p in exact) for axis in range(3)]
    high = [max(p[axis] for p in exact) for axis in range(3)]
    magnitude = max(abs(x) for x in low + high)
    extent = Fraction(max(float(end - begin) for begin, end in zip(low, high, strict=True)))
    step = Fraction(2) ** _FINEST
    while (
        extent > _MOST_STEPS * step
        or magnitude > 2**_FLOAT64_BITS * step
        or max(_round(h / step) - _round(b / step) for b, h in zip(low, high, strict=True))
        > _MOST_STEPS
    ):
        step *= 2
    origin = []
    for axis in range(3):
        begin, end = _round(low[axis] / step), _round(high[axis] / step)
        origin.append(float((begin + (end - begin) // 2) * step))
    return Grid(step_m=float(step), origin_m=np.array(origin))


def _round(x: Fraction) -> int:
    """Round to the nearest integer, halves up."""
    return math.floor(x + Fraction(1, 2))


def weld(source: SourceMesh) -> tuple[Mesh, list[int], list[int]]:
    """Return the welded mesh, the triangles without area, and the vertices merged per object.

    Every coordinate goes to the nearest grid position, halves up; vertices of
    one object at one position are one, numbered by first use; a triangle whose
    corners lie on a line there is left out. Positions are rational numbers.

    Returns
    -------
    Mesh
    list of int
        Source triangles left out.
    list of int
        Per object: how many source vertices of the triangles that stay became
        the same as another.
    """
    grid = _choose_grid(source)
    step = Fraction(grid.step_m)
    origin = [Fraction(x) for x in grid.origin_m.tolist()]

    def place(vertex: int) -> tuple[int, int, int]:
        x, y, z = (
            _round(Fraction(p) / step) - int(o / step)
            for p, o in zip(source.positions[vertex].tolist(), origin, strict=True)
        )
        return x, y, z

    points: list[tuple[int, int, int]] = []
    faces: list[list[int]] = []
    kept: list[int] = []
    vertex_start, face_start = [0], [0]
    dropped: list[int] = []
    merged: list[int] = []
    starts = source.object_face_start.tolist()
    for begin, end in itertools.pairwise(starts):
        number_of: dict[tuple[int, int, int], int] = {}
        used: set[int] = set()
        for f in range(begin, end):
            corners = [place(v) for v in source.faces[f].tolist()]
            if not _has_area(corners):
                dropped.append(f)
                continue
            used.update(source.faces[f].tolist())
            kept.append(f)
            faces.append([number_of.setdefault(p, len(points) + len(number_of)) for p in corners])
        points += number_of
        merged.append(len(used) - len(number_of))
        vertex_start.append(len(points))
        face_start.append(len(faces))
    mesh = Mesh(
        grid=grid,
        positions=(np.array(points, np.float64).reshape(-1, 3) * grid.step_m).astype(np.float32),
        faces=np.array(faces, np.uint32).reshape(-1, 3),
        object_vertex_start=np.array(vertex_start, np.int64),
        object_face_start=np.array(face_start, np.int64),
        source_face=source.source_face[kept],
    )
    return mesh, dropped, merged


def _has_area(corners: list[tuple[int, int, int]]) -> bool:
    a, b, c = corners
    u = [y - x for x, y in zip(a, b, strict=True)]
    w = [y - x for x, y in zip(a, c, strict=True)]
    return any(u[i] * w[j] != u[j] * w[i] for i, j in ((1, 2), (2, 0), (0, 1)))


def check_planes(positions: F32, faces: U32, planes: F64, plane_of_face: U32) -> F64:
    """Return ``(n_faces,)`` [m]: how far each face's corners lie from its plane record.

    None may lie farther than `PlaneTable.tolerance_m`. Vectorised, float64.
    """
    record = planes[plane_of_face]
    normal, d = record[:, :3], record[:, 3]
    corners = positions[faces].astype(np.float64)
    distance = np.abs(np.einsum("fca,fa->fc", corners, normal) + d[:, None])
    worst: F64 = distance.max(axis=1) / np.linalg.norm(normal, axis=1)
    return worst
