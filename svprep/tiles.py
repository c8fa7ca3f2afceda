"""Tiles: runs of whole objects, each prepared by itself.

    source --cut--> tile, tile, tile --prepare_tile--> stored tables --> `cache.runs`

What a tile becomes depends on nothing but the tile, the grid and the configuration. So
tiles may be prepared in any order, on threads or elsewhere, a few at a time where memory
is short, and not at all where an older cache holds what they would become.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from svprep.cache.codec import object_datasets
from svprep.content import source_digests
from svprep.edges import build_edges
from svprep.model import I64, FaceFindings, Grid, ObjectTables, SourceMesh
from svprep.parallel import thread_count
from svprep.planes import build_planes
from svprep.ranges import rows_of_runs
from svprep.repair.stage import record, repair
from svprep.repair.weld import weld
from svprep.scene_tree import LocalClusters, local_clusters
from svprep.silhouette.index import build_index

StageHook = Callable[[str], None]
"""Called with a stage's name when it starts: ``"load"``, ``"weld"``, ..."""

TILE_STAGES: Final = ("weld", "repair", "planes", "edges", "silhouettes")
SHARES: Final = ("scene tree", "write")
"""Later stages of which a tile does a share: its clusters, and the form that is stored."""
FACES: Final = 1 << 15
"""Of a tile, if its objects are smaller: what it is made of fits the processor's cache."""
MOST_FACES: Final = 1 << 16
"""Where each thread has several tiles all the same: there are fewer calls for a face."""
_TILES_PER_THREAD: Final = 4
BYTES_PER_FACE: Final = 700
"""What preparing a tile holds at its peak."""


@dataclass(frozen=True, slots=True)
class Tile:
    """Whole objects of an input, and all else that their tables depend on."""

    source: SourceMesh
    """Of these objects alone, with vertices of their own."""
    digest: NDArray[np.uint64]
    """``(n_objects, 2)``: `svprep.content.source_digests` of them, in the whole input."""
    grid: Grid
    """Of the whole input."""
    weld_tolerance_m: float


@dataclass(frozen=True, slots=True)
class TileTables:
    """What a tile became."""

    arrays: dict[str, NDArray[Any]]
    """The stored datasets of `svprep.cache.runs.PER_OBJECT`."""
    clusters: LocalClusters
    seconds: dict[str, float]
    """Wall seconds of each of `TILE_STAGES`, and of `SHARES`."""


def faces_of_a_tile(n_faces: int) -> int:
    """Return how many faces a tile may have, of so many in all. The tables are the same."""
    share = n_faces // (_TILES_PER_THREAD * thread_count())
    return min(max(share, FACES), MOST_FACES)


def cut(face_start: I64, most_faces: int = FACES) -> list[tuple[int, int]]:
    """Return all objects as runs of at most `most_faces` triangles.

    ``face_start (n_objects + 1,)``. An object with more is a run by itself.
    """
    runs: list[tuple[int, int]] = []
    begin, n_objects = 0, len(face_start) - 1
    while begin < n_objects:
        fit = int(np.searchsorted(face_start, face_start[begin] + most_faces, side="right")) - 1
        stop = max(fit, begin + 1)
        runs.append((begin, stop))
        begin = stop
    return runs


def selected_objects(source: SourceMesh, objects: I64) -> SourceMesh:
    """Return some objects of a mesh, ascending, over all of its vertices."""
    rows, new_start = rows_of_runs(source.object_face_start, objects)
    found = source.face_findings
    at = np.searchsorted(objects, found.object_index)
    own = np.flatnonzero(np.isin(found.object_index, objects))
    return replace(
        source,
        faces=source.faces[rows],
        object_face_start=new_start,
        source_face=source.source_face[rows],
        object_names=tuple(source.object_names[k] for k in objects.tolist()),
        object_source=source.object_source[objects],
        face_findings=FaceFindings(
            code=found.code[own],
            object_index=at[own].astype(np.uint32),
            source_face=found.source_face[own],
        ),
    )


def tile_of(source: SourceMesh, begin: int, end: int, grid: Grid, weld_tolerance_m: float) -> Tile:
    """Return some consecutive objects of a mesh as a tile."""
    digest = source_digests(source, begin, end)
    return Tile(_source_of(source, begin, end), digest, grid, weld_tolerance_m)


def _source_of(source: SourceMesh, begin: int, end: int) -> SourceMesh:
    """Return some consecutive objects of a mesh, with vertices and findings of their own."""
    first, last = int(source.object_face_start[begin]), int(source.object_face_start[end])
    faces = source.faces[first:last]
    low = int(faces.min(initial=len(source.positions)))
    n_spanned = int(faces.max(initial=0)) + 1 - low if len(faces) else 0
    if n_spanned <= 2 * faces.size:
        positions, faces = source.positions[low : low + n_spanned], faces - np.uint32(low)
    else:  # vertices from all over the file: in the same order, without the others
        used, inverse = np.unique(faces, return_inverse=True)
        positions = source.positions[used]
        faces = inverse.reshape(faces.shape).astype(np.uint32)
    found = source.face_findings
    own = slice(*np.searchsorted(found.object_index, [begin, end]).tolist())
    return replace(
        source,
        positions=np.ascontiguousarray(positions),
        faces=faces,
        object_face_start=source.object_face_start[begin : end + 1] - first,
        source_face=np.ascontiguousarray(source.source_face[first:last]),
        object_names=source.object_names[begin:end],
        object_source=source.object_source[begin:end],
        face_findings=FaceFindings(
            code=found.code[own],
            object_index=found.object_index[own] - np.uint32(begin),
            source_face=found.source_face[own],
        ),
    )


def prepare_objects(tile: Tile, on_stage: StageHook | None = None) -> ObjectTables:
    """Return the tables that depend on single objects alone.

    The order is forced. Welding comes first, because faces meet only where
    they share vertices. Repair needs them to meet, and decides winding before
    it splits edges, since pairs are pairs of faces that wind alike. Planes
    spread over pairs. The edge table marks edges within a plane, which the
    silhouette trees leave out; so they come after it.
    """
    stage = on_stage or (lambda name: None)
    stage("weld")
    welded, weld_report = weld(tile.source, tile.weld_tolerance_m, tile.grid)
    stage("repair")
    repaired, repair_report = repair(welded)
    stage("planes")
    planes = build_planes(repaired)
    stage("edges")
    edges, components = build_edges(repaired, planes)
    stage("silhouettes")
    index = build_index(repaired.mesh, components, planes, edges)
    return ObjectTables(
        mesh=repaired.mesh,
        components=components,
        planes=planes,
        edges=edges,
        index=index,
        repair=record(tile.source, weld_report, repair_report, tile.digest),
    )


def prepare_tile(tile: Tile, on_stage: StageHook | None = None) -> TileTables:
    """Return a tile's tables as they are stored. A pure function of the tile."""
    timer = StageTimer(on_stage)
    tables = prepare_objects(tile, timer.start)
    timer.start(SHARES[0])
    clusters = local_clusters(tables.mesh)
    timer.start(SHARES[1])
    arrays = object_datasets(tables)
    return TileTables(arrays=arrays, clusters=clusters, seconds=timer.stop())


class StageTimer:
    """Wall time between one stage's start and the next."""

    def __init__(self, on_stage: StageHook | None) -> None:
        self._tell = on_stage or (lambda name: None)
        self._starts: list[tuple[str, float]] = []

    def start(self, name: str) -> None:
        """Begin a stage, and end the one before it."""
        self._starts.append((name, time.perf_counter()))
        self._tell(name)

    def stop(self) -> dict[str, float]:
        """Return the seconds of each stage."""
        starts = [*self._starts, ("", time.perf_counter())]
        return {
            name: following[1] - begun
            for (name, begun), following in zip(self._starts, starts[1:], strict=True)
        }
