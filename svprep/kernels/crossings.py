"""How often the edges of rings cross each other: a sweep along one axis.

Edges are sorted by where they begin along the axis; each is compared with those that begin
before it ends. The caller chooses the axis and knows beforehand how many pairs that makes.
"""

from __future__ import annotations

from numba import njit

_ROUNDING = 4e-16  # of the two products: Shewchuk 1997, *Adaptive Precision*, bound A

_helper = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_helper
def _side(au, av, bu, bv, cu, cv):
    """On which side of a -> b the point c certainly lies: 1, -1, or 0 where rounding decides."""
    left = (bu - au) * (cv - av)
    right = (bv - av) * (cu - au)
    area = left - right
    bound = _ROUNDING * (abs(left) + abs(right))
    return 1 if area > bound else -1 if area < -bound else 0


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def count_crossings(begin, end, last, most):
    """Return how many pairs of edges cross within both, counted no further than `most` + 1.

    Edges that only touch, or that overlap, do not count.

    Parameters
    ----------
    begin, end : (n_edges, 2) float64
        Sorted by the smaller first coordinate.
    last : (n_edges,) int64
        Behind the last edge that begins, along that coordinate, before edge i ends.
    most : int64
    """
    n = 0
    for i in range(len(begin)):
        au, av = begin[i, 0], begin[i, 1]
        bu, bv = end[i, 0], end[i, 1]
        low, high = min(av, bv), max(av, bv)
        for j in range(i + 1, last[i]):
            cv, dv = begin[j, 1], end[j, 1]
            if max(cv, dv) <= low or min(cv, dv) >= high:
                continue
            cu, du = begin[j, 0], end[j, 0]
            if (
                _side(au, av, bu, bv, cu, cv) * _side(au, av, bu, bv, du, dv) < 0
                and _side(cu, cv, du, dv, au, av) * _side(cu, cv, du, dv, bu, bv) < 0
            ):
                n += 1
                if n > most:
                    return n
    return n
