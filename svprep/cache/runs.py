"""Stored tables of runs of objects, put one behind the other.

    a tile's tables           an older cache              the whole
    [objects 0 .. 511]        [.. 17 18 19 20 ..]    ->   [run | run | run ...]

What depends on single objects alone is stored per object, in their order, and points to
vertices, faces, edges, planes by number. So the rows of consecutive objects can be cut out
of any set of such tables and put behind others: only what each number is counted from
changes, and the schema says of every dataset what its numbers count. That is all that
joining tiles takes, and all that it takes to keep what an older cache already holds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from svprep.cache.schema import (
    DATASETS,
    SPEC_OF_PATH,
    B,
    C,
    DatasetSpec,
    Dim,
    E,
    F,
    I,
    O,
    P,
    T,
    V,
)
from svprep.model import I64, NO_INDEX
from svprep.silhouette.trees import tree_starts

Raw = NDArray[Any]

_GROUPS: Final = ("mesh", "components", "planes", "edges", "index", "cones", "hextree", "repair")
_STARTS: Final = ("objects/vertex_start", "objects/face_start", "objects/component_start")
PER_OBJECT: Final = tuple(
    spec
    for spec in DATASETS
    if spec.path in _STARTS or (spec.path.split("/")[0] in _GROUPS and spec.path != "mesh/surface")
)
"""Datasets that depend on single objects alone."""
_OF_SOURCE_FACES: Final = ("mesh/source_face", "repair/finding_source_face")
_LISTS: Final = {
    "n_counts": "repair/count_object",
    "n_findings": "repair/finding_object",
    "n_trees": "index/object",
}
"""Lengths of lists that name their objects, ascending."""


@dataclass(frozen=True, slots=True)
class Run:
    """Consecutive objects of some set of stored tables."""

    arrays: Mapping[str, Raw]
    """The set, by path: at least `PER_OBJECT`."""
    begin: Mapping[str, int]
    """Per symbol of the schema, the first row of these objects."""
    end: Mapping[str, int]
    source_face_shift: int = 0
    """What source polygons are counted on by."""

    def n(self, symbol: str) -> int:
        """Return how many rows of a length are theirs."""
        return self.end[symbol] - self.begin[symbol]


def whole_run(arrays: Mapping[str, Raw]) -> Run:
    """Return all objects of a set of tables as one run."""
    end: dict[str, int] = {}
    for spec in PER_OBJECT:
        dim = spec.shape[0]
        assert isinstance(dim, Dim)
        solved = dim.solve(len(arrays[spec.path]))
        assert solved is not None
        end.setdefault(dim.symbol, solved)
    return Run(arrays, dict.fromkeys(end, 0), end)


def runs_of_objects(arrays: Mapping[str, Raw], numbers: I64) -> Iterator[tuple[int, Run]]:
    """Yield ``(number, run)`` for a set of tables whose objects have these numbers now.

    ``numbers (n_objects,)``, ascending: a run goes on as long as they follow each other.
    """
    first = np.flatnonzero(np.concatenate(([True], np.diff(numbers) != 1)))
    bounds = np.concatenate((first, [len(numbers)]))
    rows = rows_of_objects(arrays, bounds)
    for i, k in enumerate(first.tolist()):
        begin = {symbol: int(at[i]) for symbol, at in rows.items()}
        end = {symbol: int(at[i + 1]) for symbol, at in rows.items()}
        yield int(numbers[k]), Run(arrays, begin, end)


def rows_of_objects(arrays: Mapping[str, Raw], objects: I64) -> dict[str, I64]:
    """Return the first row of every length that belongs to each of some objects.

    Parameters
    ----------
    arrays
        `PER_OBJECT` tables of at least one object.
    objects : ndarray
        ``(n,) int64``, 0 to the number of objects: one behind the last is allowed.
    """
    face = arrays["objects/face_start"][objects].astype(np.int64)
    component = arrays["objects/component_start"][objects].astype(np.int64)
    n_faces, n_planes = len(arrays["planes/plane_of_face"]), len(arrays["planes/d"])
    # Records are numbered by their lowest face: an object's first is that of its first face.
    plane = np.full(len(objects), n_planes, np.int64)
    plane[face < n_faces] = arrays["planes/plane_of_face"][face[face < n_faces]]
    rows = {
        O.symbol: objects,
        V.symbol: arrays["objects/vertex_start"][objects].astype(np.int64),
        F.symbol: face,
        C.symbol: component,
        P.symbol: plane,
        E.symbol: arrays["components/edge_start"][component].astype(np.int64),
        "n_flipped": np.searchsorted(arrays["repair/flipped_faces"], face),
    }
    for symbol, path in _LISTS.items():
        rows[symbol] = np.searchsorted(arrays[path], objects)
    starts = tree_starts(arrays["index/pair_start"].astype(np.int64))
    rows[I.symbol] = starts[rows[T.symbol], 0]
    rows[B.symbol] = starts[rows[T.symbol], 1]
    return rows


def _keep(rows: Raw) -> None:
    pass


@dataclass(slots=True)
class Joined:
    """Runs, one behind the other, as one set of tables: each made when it is asked for."""

    runs: Sequence[Run]
    release: Callable[[Raw], None] = _keep
    """Told of rows of a run that have been copied."""
    _bases: dict[str, I64] = field(default_factory=dict)

    def base(self, symbol: str) -> I64:
        """Return ``(n_runs + 1,)``: where each run's rows of a length begin."""
        if symbol not in self._bases:
            sizes = [0, *(run.n(symbol) for run in self.runs)]
            self._bases[symbol] = np.cumsum(sizes, dtype=np.int64)
        return self._bases[symbol]

    def size(self, symbol: str) -> int:
        """Return how many rows there are of a length."""
        return int(self.base(symbol)[-1])

    def array(self, path: str, into: Raw | None = None) -> Raw:
        """Return one dataset, whole: in an array of its shape if one is given."""
        spec = SPEC_OF_PATH[path]
        dim = _first(spec)
        whole = np.empty(self.shape(path), spec.in_memory) if into is None else into
        at = 0
        for piece in self.pieces(path):
            whole[at : at + len(piece.rows)] = piece.counted_on()
            at += len(piece.rows)
            self.release(piece.rows)
        assert at == len(whole) == dim.times * self.size(dim.symbol) + dim.plus
        return whole

    def points_of_faces(self, faces: I64) -> Raw:
        """Return the corners of ``(n,)`` faces, ``(3 n, 3)`` [m], without joining any table."""
        base = self.base(F.symbol)
        owner = np.searchsorted(base, faces, side="right") - 1
        # Of numbers of 16 bits a stable sort takes O(n); there are at most some thousand runs.
        order = np.argsort(owner.astype(np.min_scalar_type(len(self.runs))), kind="stable")
        points = np.empty((len(faces), 3, 3), SPEC_OF_PATH["mesh/positions"].in_memory)
        for rows in np.split(order, np.flatnonzero(np.diff(owner[order])) + 1):
            if len(rows):
                i = int(owner[rows[0]])
                run = self.runs[i]
                corners = run.arrays["mesh/face_corners"].reshape(-1, 3)
                own = corners[faces[rows] + (run.begin[F.symbol] - base[i])]
                points[rows] = run.arrays["mesh/positions"][own]
        return points.reshape(-1, 3)

    def shape(self, path: str) -> tuple[int, ...]:
        """Return the shape of one dataset."""
        spec = SPEC_OF_PATH[path]
        dim = _first(spec)
        inner = tuple(n for n in spec.shape[1:] if isinstance(n, int))
        return (dim.times * self.size(dim.symbol) + dim.plus, *inner)

    def pieces(self, path: str) -> Iterator[Piece]:
        """Yield a dataset's rows, run by run, and what closes its offsets."""
        spec = SPEC_OF_PATH[path]
        dim = _first(spec)
        for i, run in enumerate(self.runs):
            begin, end = dim.times * run.begin[dim.symbol], dim.times * run.end[dim.symbol]
            if begin < end:
                rows = run.arrays[path][begin:end]
                yield Piece(rows, spec, self._shift(spec, i))
        if dim.plus:
            assert spec.refers is not None
            total = np.array([self.size(spec.refers.symbol)], spec.in_memory)
            yield Piece(total, spec, 0)

    def _shift(self, spec: DatasetSpec, i: int) -> int:
        """Return what the numbers of run i are counted on by."""
        run = self.runs[i]
        if spec.path in _OF_SOURCE_FACES:
            return run.source_face_shift
        if spec.refers is None:
            return 0
        symbol = spec.refers.symbol
        return spec.refers.times * (int(self.base(symbol)[i]) - run.begin[symbol])


@dataclass(frozen=True, slots=True)
class Piece:
    """Rows of one run of a dataset, and what their numbers are counted on by."""

    rows: Raw
    spec: DatasetSpec
    shift: int

    def counted_on(self) -> Raw:
        """Return the rows with their numbers as they are in the whole."""
        if self.shift == 0:
            return self.rows
        # Modulo 2**32, which a shift down needs.
        moved = self.rows + np.asarray(self.shift % (1 << 32), self.rows.dtype)
        if self.spec.role == "index_or_none":
            moved[self.rows == NO_INDEX] = NO_INDEX
        return moved


def _first(spec: DatasetSpec) -> Dim:
    dim = spec.shape[0]
    assert isinstance(dim, Dim)
    return dim
