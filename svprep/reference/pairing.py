"""Twin of the pairing of half-edges: exact angles, arbitrary-precision integers."""

from __future__ import annotations

from functools import cmp_to_key
from typing import NamedTuple

import numpy as np

from svprep.reference.tables import group_edges

Vector = tuple[int, int, int]


class _Spoke(NamedTuple):
    """A half-edge seen along its edge, lo towards hi."""

    half_edge: int
    opens: bool
    """Whether its face traverses hi -> lo: going round counter-clockwise,
    material begins at it."""
    normal: Vector
    """``(hi - lo) x (third - lo)``: turns with the face, by the same angle."""
    third: Vector


def pair_edges(points: np.ndarray, faces: np.ndarray, flips: np.ndarray) -> list[int]:
    """Return the half-edge that each half-edge is paired with, or -1.

    Two faces at an edge are a pair iff they traverse it in opposite directions.
    More are sorted by angle around it; at equal angles those that close a wedge
    of material go before those that open one, then by the third vertex's
    position; then openers and closers are matched like parentheses on a circle.

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
    for (lo, hi), half_edges in group_edges(faces).items():
        axis = _minus(_point(points, hi), _point(points, lo))
        spokes = []
        for h in half_edges:
            f, c = h // 3, h % 3
            third = _point(points, int(faces[f, (c + 2) % 3]))
            runs_up = (int(faces[f, c]) == lo) != bool(flips[f])
            normal = _cross(axis, _minus(third, _point(points, lo)))
            spokes.append(_Spoke(h, not runs_up, normal, third))
        if len(spokes) == 2:
            pairs = [(spokes[0], spokes[1])] if spokes[0].opens != spokes[1].opens else []
        else:
            pairs = _match(_sort_round(axis, spokes))
        for a, b in pairs:
            mate[a.half_edge] = b.half_edge
            mate[b.half_edge] = a.half_edge
    return mate


def _sort_round(axis: Vector, spokes: list[_Spoke]) -> list[_Spoke]:
    """Sort counter-clockwise around `axis`, from the direction of the first spoke."""
    zero = spokes[0].normal

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
