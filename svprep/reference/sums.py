"""The multiplicity of every edge, from triangles and again from edge records.

For face f with facing s_f and edge e = (lo, hi): ``t_ef = +1`` if f traverses
lo -> hi, else -1; ``m_e = sum_f t_ef s_f`` says how often, and which way round,
the side of a shadow volume is needed at e. It does not depend on winding: a
face that is turned changes the sign of both factors. So triangles as they were
read and records after repair must give the same numbers, for any choice of s.
"""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction

import numpy as np

from svprep.errors import CacheError, first_few
from svprep.model import I32, I64, NO_INDEX, U32


def facing(plane: np.ndarray, light: np.ndarray) -> int:
    """Return the exact sign of ``plane . light``, both ``(4,)``: +1, 0 or -1.

    `svprep.facing.facing` decides the same in float64; the two can differ only
    where that sum is no larger than its own rounding.
    """
    value = sum(
        (Fraction(float(p)) * Fraction(float(x)) for p, x in zip(plane, light, strict=True)),
        Fraction(0),
    )
    return (value > 0) - (value < 0)


def edge_multiplicity(faces: np.ndarray, facing: np.ndarray) -> dict[tuple[int, int], int]:
    """Return ``{(lo, hi): m_e}`` of every edge, straight from the triangles.

    ``faces (n, 3)``, ``facing (n,)`` in {-1, 0, +1}.
    """
    m: defaultdict[tuple[int, int], int] = defaultdict(int)
    for corners, s in zip(faces.tolist(), facing.tolist(), strict=True):
        for c in range(3):
            a, b = corners[c], corners[(c + 1) % 3]
            m[min(a, b), max(a, b)] += s if a < b else -s
    return dict(m)


def multiplicity_of_rows(rows: np.ndarray, facing: np.ndarray) -> dict[tuple[int, int], int]:
    """Return ``{(lo, hi): m_e}`` summed over edge records ``[v0, v1, left, right]``."""
    m: defaultdict[tuple[int, int], int] = defaultdict(int)
    s = facing.tolist()
    for lo, hi, left, right in rows.tolist():
        m[lo, hi] += s[left] if left != NO_INDEX else 0
        m[lo, hi] -= s[right] if right != NO_INDEX else 0
    return dict(m)


class EdgeSums:
    """The same two sums for many lights: edges are numbered once, then NumPy adds.

    Parameters
    ----------
    faces : ndarray
        ``(n_faces, 3) uint32``

    Notes
    -----
    O(n log n) once, O(n) per light. Edges are numbered in ascending (lo, hi).
    """

    __slots__ = ("_face", "_key", "_sign", "_start")

    def __init__(self, faces: U32) -> None:
        following = faces[:, [1, 2, 0]]
        key = _keys(np.minimum(faces, following), np.maximum(faces, following)).reshape(-1)
        order = np.argsort(key, kind="stable")
        key = key[order]
        self._start: I64 = np.flatnonzero(np.diff(key, prepend=~key[:1]))
        self._key = key[self._start]
        self._face: I64 = order // 3
        runs_up = (faces < following).reshape(-1)[order]
        self._sign: I32 = np.where(runs_up, 1, -1).astype(np.int32)

    @property
    def edges(self) -> U32:
        """``(n_edges, 2)``: the vertices (lo, hi) of every edge."""
        lo = self._key >> np.uint64(32)
        return np.column_stack((lo, self._key & np.uint64(NO_INDEX))).astype(np.uint32)

    @property
    def n_edges(self) -> int:
        """How many undirected edges the triangles have."""
        return len(self._key)

    def of_triangles(self, facing_of_face: np.ndarray) -> I32:
        """Return ``(n_edges,)``: m_e from the triangles; ``facing_of_face (n_faces,)``."""
        if not len(self._key):
            return np.zeros(0, np.int32)
        terms = self._sign * facing_of_face[self._face].astype(np.int32)
        sums: I32 = np.add.reduceat(terms, self._start, dtype=np.int32)
        return sums

    def edge_of_rows(self, rows: U32) -> I64:
        """Return ``(n_rows,)``: the edge that each record lies on.

        Raises
        ------
        CacheError
            A record lies on an edge that no triangle has.
        """
        key = _keys(rows[:, 0], rows[:, 1])
        edge = np.searchsorted(self._key, key)
        known = edge < len(self._key)
        known[known] = self._key[edge[known]] == key[known]
        if not known.all():
            raise CacheError(
                f"edge records {first_few(np.flatnonzero(~known).tolist())} lie on edges that "
                "no triangle has; expected every record on one"
            )
        return edge.astype(np.int64)

    def of_rows(
        self, rows: U32, facing_of_face: np.ndarray, edge_of_rows: I64 | None = None
    ) -> I32:
        """Return ``(n_edges,)``: m_e from edge records, on the same numbering.

        Parameters
        ----------
        rows : ndarray
            ``(n_rows, 4) uint32``: ``[v0, v1, left, right]``.
        facing_of_face : ndarray
            ``(n_faces,)`` in {-1, 0, +1}.
        edge_of_rows : ndarray, optional
            What `edge_of_rows` returned for these rows, where many lights ask.
        """
        edge = self.edge_of_rows(rows) if edge_of_rows is None else edge_of_rows
        # One more entry, 0, which NO_INDEX reads.
        s = np.append(facing_of_face, 0).astype(np.int32)
        none = len(s) - 1
        left = np.minimum(rows[:, 2], none)
        right = np.minimum(rows[:, 3], none)
        sums = np.bincount(edge, weights=s[left] - s[right], minlength=len(self._key))
        return sums.astype(np.int32)


def _keys(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    return (lo.astype(np.uint64) << np.uint64(32)) | hi.astype(np.uint64)
