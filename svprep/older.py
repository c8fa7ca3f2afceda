"""What a build takes over from the cache that it is about to replace.

    digests of the objects   ->  which of them the older cache holds already
    runs of those            ->  rows of its tables, counted on
    all others               ->  tiles

An object is taken over if the older cache was made by the same code, on the same grid and
with the same welding, from an object with the same digest (`svprep.content`); which number
or name it had does not matter.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from svprep.cache.codec import decode_components, decode_mesh
from svprep.cache.reader import Cache, open_cache
from svprep.cache.runs import PER_OBJECT, Run, rows_of_objects
from svprep.cache.stage_code import stage_code
from svprep.clamp import check_tables
from svprep.defects import LEFT_OUT
from svprep.errors import CacheError
from svprep.model import (
    I64,
    NO_INDEX,
    ClampTable,
    Components,
    Grid,
    Mesh,
    SceneTree,
    SourceMesh,
)
from svprep.silhouette.tables import check_starts

Raw = NDArray[Any]
MOST_RUNS: Final = 1024
"""Runs of objects that are taken over at most."""
U64 = NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class Older:
    """An older cache that tables may be taken over from."""

    arrays: Mapping[str, Raw]
    """Its datasets of `PER_OBJECT`."""
    weld_tolerance_m: float
    mesh: Mesh
    components: Components
    scene: SceneTree
    clamp: ClampTable

    @property
    def n_objects(self) -> int:
        """Objects."""
        return len(self.arrays["repair/source_digest"])


class OfNoUse(Exception):
    """Nothing is taken over from an older cache; the text says why."""


def read_older(path: Path) -> Older:
    """Return what can be taken over from the cache `path`.

    Everything that may be needed is read, and its digests are checked, and whether the tables
    contradict each other.

    Raises
    ------
    OfNoUse
        It is damaged, of another schema, or was made by other code.
    """
    try:
        with open_cache(path) as cache:
            if cache.tables_by != stage_code() or not cache.n_objects:
                raise OfNoUse("another svprep made it")
            return _read(cache)
    except CacheError:
        raise OfNoUse("it is damaged, or not of this svprep's schema") from None


def _read(cache: Cache) -> Older:
    tolerance = cache.config.get("weld_tolerance_m")
    if not isinstance(tolerance, int | float):
        raise OfNoUse("it does not say how it was welded")
    arrays = {spec.path: cache.raw(spec.path) for spec in PER_OBJECT}
    older = Older(
        arrays=arrays,
        weld_tolerance_m=float(tolerance),
        mesh=decode_mesh(arrays.__getitem__, cache.grid),
        components=decode_components(arrays.__getitem__),
        scene=cache.scene,
        clamp=cache.clamp,
    )
    check_tables(older.mesh, older.components, older.scene)
    check_starts("objects/vertex_start", older.mesh.object_vertex_start, len(older.mesh.positions))
    check_starts("lights/segment_start", older.clamp.light_start, len(older.clamp.depths))
    for start, size in zip(
        older.clamp.segment_start, np.diff(older.clamp.light_start).tolist(), strict=True
    ):
        check_starts("clamp/segment_start", start.astype(np.int64), size)
    return older


def objects_before(older: Older, digests: U64, grid: Grid, weld_tolerance_m: float) -> I64:
    """Return which object of the older cache each object is, each at most once; -1 for none.

    Parameters
    ----------
    older : Older
    digests : ndarray
        ``(n_objects, 2) uint64``
    grid, weld_tolerance_m
        Of this build.

    Returns
    -------
    ndarray
        ``(n_objects,) int64``

    Raises
    ------
    OfNoUse
        It is welded or quantised in another way, or holds less than half of the objects.
    """
    if older.weld_tolerance_m != weld_tolerance_m:
        raise OfNoUse("it was welded with another tolerance")
    before = older.mesh.grid
    if before.step_m != grid.step_m or not np.array_equal(before.origin_m, grid.origin_m):
        raise OfNoUse("the model's outermost box changed, and with it the grid")
    theirs = older.arrays["repair/source_digest"]
    n = min(len(theirs), len(digests))
    found = np.full(len(digests), -1, np.int64)
    same = (theirs[:n] == digests[:n]).all(axis=1)
    found[:n][same] = np.flatnonzero(same)
    others = np.flatnonzero(found < 0)
    if len(others):  # inserted, removed or in another order
        order = np.lexsort((theirs[:, 1], theirs[:, 0]))
        at = np.searchsorted(theirs[order, 0], digests[others, 0])
        candidate = order[np.minimum(at, len(order) - 1)]
        # Two with one first half are as good as never met, and are built again.
        is_same = (theirs[candidate] == digests[others]).all(axis=1)
        found[others[is_same]] = candidate[is_same]
        kept, first = np.unique(found, return_index=True)
        is_first = np.zeros(len(found), np.bool_)
        is_first[first[kept >= 0]] = True
        found[~is_first] = -1  # an object that is there twice was there once: one is built
    _keep_longest_runs(found)
    # To fit half of a city together takes as long as to build it.
    if 2 * np.count_nonzero(found >= 0) < len(found):
        raise OfNoUse("it holds less than half of the objects unchanged, or in runs too short")
    return found


def _keep_longest_runs(found: I64) -> None:
    """Give up objects in short runs where there are more than `MOST_RUNS`, in place.

    Each run takes as long to put in its place as some hundred triangles to build.
    """
    goes_on = (found[1:] >= 0) & (found[1:] == found[:-1] + 1) & (found[:-1] >= 0)
    run = np.cumsum(np.concatenate(([True], ~goes_on))) - 1
    lengths = np.bincount(run, weights=found >= 0).astype(np.int64)
    if np.count_nonzero(lengths) > MOST_RUNS:
        shortest = np.argsort(-lengths, kind="stable")[MOST_RUNS:]
        found[np.isin(run, shortest)] = -1


def runs_taken_over(older: Older, source: SourceMesh, before: I64) -> Iterator[tuple[int, Run]]:
    """Yield ``(object, run)``: runs of taken-over objects, and the first one's number now.

    Objects are one run as long as they follow each other in both and their polygons are
    counted on by the same number.
    """
    kept = np.flatnonzero(before >= 0)
    shift = _source_face_shift(older, source, kept, before[kept])
    goes_on = (np.diff(kept) == 1) & (np.diff(before[kept]) == 1) & (shift[1:] == shift[:-1])
    first = np.flatnonzero(np.concatenate(([True], ~goes_on)))
    last = np.concatenate((first[1:], [len(kept)])) - 1
    begin = rows_of_objects(older.arrays, before[kept[first]])
    end = rows_of_objects(older.arrays, before[kept[last]] + 1)
    for i, k in enumerate(kept[first].tolist()):
        yield (
            k,
            Run(
                older.arrays,
                {symbol: int(rows[i]) for symbol, rows in begin.items()},
                {symbol: int(rows[i]) for symbol, rows in end.items()},
                int(shift[first[i]]),
            ),
        )


def _source_face_shift(older: Older, source: SourceMesh, kept: I64, before: I64) -> I64:
    """Return by how much the polygons of each kept object are counted on.

    The lowest polygon of its triangles says it; an object without any is not counted on.
    """
    now = _lowest(source.source_face, source.object_face_start)[kept]
    then = _lowest(older.mesh.source_face, older.mesh.object_face_start)
    # A triangle is in the mesh, or among the findings as one that was left out.
    is_left_out = np.isin(older.arrays["repair/finding_code"], LEFT_OUT)
    owner = older.arrays["repair/finding_object"][is_left_out].astype(np.int64)
    face = older.arrays["repair/finding_source_face"][is_left_out].astype(np.int64)
    np.minimum.at(then, owner, face)
    return np.where(now < NO_INDEX, now - then[before], 0)


def _lowest(values: Raw, start: I64) -> I64:
    """Return the lowest value of each range of `start`, `NO_INDEX` for an empty one."""
    lowest = np.full(len(start) - 1, NO_INDEX, np.int64)
    has_any = start[1:] > start[:-1]
    if has_any.any():
        lowest[has_any] = np.minimum.reduceat(values, start[:-1][has_any])
    return lowest
