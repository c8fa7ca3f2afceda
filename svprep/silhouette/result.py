"""What a silhouette query returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svprep.model import F32, I8, I64, U32


@dataclass(frozen=True, slots=True)
class Work:
    """What a query looked at: the same for the same cache, light and method."""

    n_edges: int
    """Edge records whose multiplicity was computed, on the way or for good."""
    n_nodes: int
    """Nodes of an index whose bounds were tested."""


@dataclass(frozen=True, slots=True, eq=False)
class Silhouette:
    """The edge records whose multiplicity is not zero, for one light.

    Rows are in ascending order of `edge`, so grouped by object and, within it,
    by component.
    """

    edge: U32
    """``(n,)``: ids of edge records, ascending."""
    multiplicity: I8
    """``(n,)``: m in -2..2, never 0: the side is needed ``|m|`` times. Where m > 0,
    the lit side lies left of v0 -> v1, and the side of the volume starts along
    v1 -> v0; where m < 0 the other way round."""
    objects: I64
    """``(k,)``: the objects that were asked for, ascending."""
    object_start: I64
    """``(k + 1,)``: the silhouette of ``objects[i]`` is the rows
    ``object_start[i]`` to ``object_start[i + 1] - 1``."""
    light: F32
    """``(4,)``: the light, in the cache frame."""
    method: str
    work: Work

    @property
    def orientation(self) -> I8:
        """``(n,)``: the sign of `multiplicity`, +1 or -1."""
        return np.sign(self.multiplicity)

    def __len__(self) -> int:
        return len(self.edge)
