"""Twin of the self-contact test: where two triangles meet, in rational numbers."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import numpy as np

Number = int | Fraction
Point = tuple[Number, Number, Number]
Triangle = tuple[Point, Point, Point]


def triangles_touch(p: np.ndarray, q: np.ndarray) -> bool:
    """Whether two triangles meet anywhere else than in the corners they share.

    ``p (3, 3)``, ``q (3, 3)``: corners with integer coordinates; neither
    triangle has zero area. Corners are shared if they lie at one position; an
    edge between two shared corners is shared, too.

    Notes
    -----
    The triangles' intersection is convex, so it is the hull of its extreme
    points, which are corners of one inside the other, crossings of an edge with
    the other's plane, or, in one plane, crossings of two edges. It lies within
    what the triangles share iff every extreme point is a shared corner and not
    all three are.
    """
    a, b = _triangle(p), _triangle(q)
    shared = set(a) & set(b)
    return len(shared) == 3 or any(x not in shared for x in _extreme_points(a, b))


def _triangle(corners: np.ndarray) -> Triangle:
    a, b, c = (tuple(int(x) for x in row) for row in corners.tolist())
    return a, b, c  # type: ignore[return-value]


def _extreme_points(a: Triangle, b: Triangle) -> Iterator[Point]:
    for s, t in ((a, b), (b, a)):
        normal = _cross(_minus(t[1], t[0]), _minus(t[2], t[0]))
        height = [_dot(normal, _minus(x, t[0])) for x in s]
        for c in range(3):
            if height[c] == 0 and _holds(t, s[c]):
                yield s[c]
            h, g = height[c], height[(c + 1) % 3]
            if h * g < 0:
                x = _between(s[c], s[(c + 1) % 3], Fraction(h, h - g))
                if _holds(t, x):
                    yield x
        if not any(height):
            for c in range(3):
                for d in range(3):
                    yield from _crossing(normal, s[c], s[(c + 1) % 3], t[d], t[(d + 1) % 3])


def _crossing(normal: Point, a: Point, b: Point, c: Point, d: Point) -> Iterator[Point]:
    """Yield the point where a-b crosses c-d in their common plane, unless parallel."""
    inward = _cross(normal, _minus(d, c))
    h, g = _dot(inward, _minus(a, c)), _dot(inward, _minus(b, c))
    if h * g < 0:
        x = _between(a, b, Fraction(h, h - g))
        along = _dot(_minus(d, c), _minus(x, c))
        if 0 <= along <= _dot(_minus(d, c), _minus(d, c)):
            yield x


def _holds(t: Triangle, x: Point) -> bool:
    """Whether `x`, a point of t's plane, lies in triangle `t`, border included."""
    normal = _cross(_minus(t[1], t[0]), _minus(t[2], t[0]))
    return all(
        _dot(normal, _cross(_minus(t[(c + 1) % 3], t[c]), _minus(x, t[c]))) >= 0 for c in range(3)
    )


def _between(a: Point, b: Point, share: Fraction) -> Point:
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
    )


def _minus(a: Point, b: Point) -> Point:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _cross(a: Point, b: Point) -> Point:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def _dot(a: Point, b: Point) -> Number:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
