"""Union-find with parity: which faces hang together, and which are turned.

The root of a set is its lowest element, so the result does not depend on the
order of the relations as long as they do not contradict each other.
"""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def union_with_parity(a, b, differ, parent, parity, conflict):
    """Join ``a[e]`` and ``b[e]``, equal or (``differ[e]``) opposite, in order.

    ``parent (n,) int32`` starts as ``arange``, ``parity (n,) bool`` as zero; on
    return ``parent[i]`` is the root of i and ``parity[i]`` whether i is opposite
    to it. ``conflict[e]`` is set where relation e contradicts those before it.
    Path compression, O(n log n) worst case, near-linear in practice.
    """
    for e in range(len(a)):
        x = a[e]
        px = False
        while parent[x] != x:
            px ^= parity[x]
            x = parent[x]
        y = b[e]
        py = False
        while parent[y] != y:
            py ^= parity[y]
            y = parent[y]
        for side in range(2):
            i = a[e] if side == 0 else b[e]
            p = px if side == 0 else py
            root = x if side == 0 else y
            while parent[i] != root and i != root:
                following = parent[i]
                through = parity[i]
                parent[i] = root
                parity[i] = p
                p ^= through
                i = following
        if x == y:
            conflict[e] = (px ^ py) != differ[e]
        else:
            conflict[e] = False
            joined = px ^ py ^ differ[e]
            if x < y:
                parent[y] = x
                parity[y] = joined
            else:
                parent[x] = y
                parity[x] = joined
    # A parent is always lower than its child, so one ascending sweep ends at roots.
    for i in range(len(parent)):
        p = parent[i]
        if p != i:
            parity[i] ^= parity[p]
            parent[i] = parent[p]
