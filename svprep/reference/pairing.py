"""Twin of the pairing of half-edges: exact angles, arbitrary-precision integers."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cmp_to_key
from itertools import groupby
from typing import NamedTuple

import numpy as np

from svprep.reference.tables import group_edges

Vector = tuple[int, int, int]


class _Spoke(NamedTuple):
    """A half-edge seen along its edge, from its tail, first by position, to its head."""

    half_edge: int
    opens: bool
    """Whether its face traverses head -> tail: going round counter-clockwise,
    material begins at it."""
    normal: Vector
    """``(head - tail) x (third - tail)``: turns with the face, by the same angle."""
    third: Vector


def pair_edges(points: np.ndarray, faces: np.ndarray, flips: np.ndarray) -> list[int]:
    """Return the half-edge that each half-edge is paired with, or -1.

    Two faces at an edge are a pair iff they traverse it in opposite directions.
    More are sorted by angle around it; at equal angles those that close a wedge
    of material go before those that open one, then by the third vertex's
    position; then openers and closers are matched like parentheses on a circle,
    first among faces that do not hang on a border, then among what is left.
    Where openers or closers are in excess, those inside the material of others
    are left out.

    Parameters
    ----------
    points : ndarray
        ``(n_vertices, 3)``: integer grid coordinates.
    faces : ndarray
        ``(n_faces, 3)``
    flips : ndarray
        ``(n_faces,) bool``: faces to be read turned.

    Notes
    -----
    Angles are compared by half-plane and determinant, so no two different
    directions are ever taken for one. After Steiner (2006), A.2.
    """
    mate = [-1] * (3 * len(faces))
    groups = group_edges(faces)
    loose = _loose_faces(groups.values(), len(faces))
    for edge, half_edges in groups.items():
        tail, head = sorted(edge, key=lambda v: _point(points, v))
        axis = _minus(_point(points, head), _point(points, tail))
        spokes = []
        for h in half_edges:
            f, c = h // 3, h % 3
            third = _point(points, int(faces[f, (c + 2) % 3]))
            is_forward = (int(faces[f, c]) == tail) != bool(flips[f])
            normal = _cross(axis, _minus(third, _point(points, tail)))
            spokes.append(_Spoke(h, not is_forward, normal, third))
        if len(spokes) == 2:
            pairs = [(spokes[0], spokes[1])] if spokes[0].opens != spokes[1].opens else []
        else:
            spokes = _sort_round(axis, spokes)
            pairs = _match(_without_inner([s for s in spokes if s.half_edge // 3 not in loose]))
            taken = {spoke for pair in pairs for spoke in pair}
            pairs += _match(_without_inner([s for s in spokes if s not in taken]))
        for a, b in pairs:
            mate[a.half_edge] = b.half_edge
            mate[b.half_edge] = a.half_edge
    return mate


def _sort_round(axis: Vector, spokes: list[_Spoke]) -> list[_Spoke]:
    """Sort counter-clockwise around `axis`, from the first opener or closer by position."""
    zero = min(spokes, key=lambda s: (s.opens, s.third, s.half_edge)).normal

    def half(n: Vector) -> int:
        sine, cosine = _dot(axis, _cross(zero, n)), _dot(zero, n)
        return 0 if sine > 0 or (sine == 0 and cosine > 0) else 1

    def compare(a: _Spoke, b: _Spoke) -> int:
        turn = half(a.normal) - half(b.normal) or -_dot(axis, _cross(a.normal, b.normal))
        if turn:
            return turn
        x = (a.opens, a.third, a.half_edge)
        y = (b.opens, b.third, b.half_edge)
        return (x > y) - (x < y)

    return sorted(spokes, key=cmp_to_key(compare))


def _loose_faces(groups: Iterable[list[int]], n_faces: int) -> set[int]:
    """Return the faces that hang on an edge of one face, over edges of two faces."""
    neighbours: list[list[int]] = [[] for _ in range(n_faces)]
    waiting = []
    for half_edges in groups:
        touching = [h // 3 for h in half_edges]
        if len(touching) == 1:
            waiting += touching
        elif len(touching) == 2:
            neighbours[touching[0]].append(touching[1])
            neighbours[touching[1]].append(touching[0])
    loose: set[int] = set()
    while waiting:
        face = waiting.pop()
        if face not in loose:
            loose.add(face)
            waiting += neighbours[face]
    return loose


def _without_inner(spokes: list[_Spoke]) -> list[_Spoke]:
    """Leave out spokes until as many open as close: those inside the material of others.

    Read from an opener that follows a closer, spokes fall into runs of openers
    with the closers behind them. Of too many closers the first in their run are
    inner, of too many openers the last. Unless the first opener and the last
    closer are one direction, with nothing between them: then one of those goes.
    """
    if len({s.opens for s in spokes}) < 2:
        return []
    start = next(i for i in range(len(spokes)) if spokes[i].opens and not spokes[i - 1].opens)
    spokes = spokes[start:] + spokes[:start]
    excess = sum(1 if s.opens else -1 for s in spokes)
    kept: list[_Spoke] = []
    runs = [list(run) for _, run in groupby(spokes, key=lambda s: s.opens)]
    for openers, closers in zip(runs[::2], runs[1::2], strict=True):
        surplus = len(openers) - len(closers)
        one_direction = _is_one_direction(openers[0].normal, closers[-1].normal)
        if one_direction and surplus > 0 and excess > 0:
            openers.pop(0)
            surplus, excess = surplus - 1, excess - 1
        elif one_direction and surplus < 0 and excess < 0:
            closers.pop()
            surplus, excess = surplus + 1, excess + 1
        while surplus > 0 and excess > 0:
            openers.pop()
            surplus, excess = surplus - 1, excess - 1
        while surplus < 0 and excess < 0:
            closers.pop(0)
            surplus, excess = surplus + 1, excess + 1
        kept += openers + closers
    return kept


def _is_one_direction(a: Vector, b: Vector) -> bool:
    return _cross(a, b) == (0, 0, 0) and _dot(a, b) > 0


def _match(spokes: list[_Spoke]) -> list[tuple[_Spoke, _Spoke]]:
    """Match openers with closers like parentheses on a circle.

    Neighbours "(" ")" are taken out again and again; the end meets the start.
    """
    rest = list(spokes)
    pairs: list[tuple[_Spoke, _Spoke]] = []
    while len(rest) > 1:
        found = next(
            (i for i in range(len(rest)) if rest[i - 1].opens and not rest[i].opens),
            None,
        )
        if found is None:
            break
        pairs.append((rest[found - 1], rest[found]))
        taken = {found, (found - 1) % len(rest)}
        rest = [spoke for i, spoke in enumerate(rest) if i not in taken]
    return pairs


def _point(points: np.ndarray, vertex: int) -> Vector:
    x, y, z = points[vertex].tolist()
    return x, y, z


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def _dot(a: Vector, b: Vector) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
