"""The build as an outline: which stage runs when, and why in that order."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING

from svprep.cache.files import resolve_target
from svprep.edges import build_edges
from svprep.errors import InputError
from svprep.ingest import read
from svprep.model import Prepared, SourceMesh
from svprep.planes import build_planes
from svprep.repair.stage import record, repair
from svprep.repair.weld import weld
from svprep.silhouette.index import build_index

if TYPE_CHECKING:
    from svprep.cache.writer import CacheSummary

StageHook = Callable[[str], None]
"""Called with a stage's name when it starts: ``"load"``, ``"weld"``, ..."""

STAGES = ("load", "weld", "repair", "planes", "edges", "silhouettes", "write")
CACHE_SUFFIX = ".svp.h5"


@dataclass(frozen=True, slots=True)
class BuildConfig:
    """What a build is asked for. The same sources and config give the same tables."""

    weld_tolerance_m: float = 0.0
    """[m]: pull vertices of one object within this distance together; 0 is exact."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.weld_tolerance_m < float("inf"):
            raise InputError(
                f"the weld tolerance is a distance in metres, 0 or more, "
                f"not {self.weld_tolerance_m}"
            )


@dataclass(frozen=True, slots=True)
class BuildResult:
    """What `build` made."""

    cache: CacheSummary
    prepared: Prepared
    seconds: dict[str, float]
    """Wall seconds of each stage."""


def build(
    inputs: Sequence[str | PathLike[str]],
    output: str | PathLike[str] | None = None,
    config: BuildConfig | None = None,
    on_stage: StageHook | None = None,
) -> BuildResult:
    """Build the cache of one or more model files.

    Parameters
    ----------
    inputs : sequence of path
        OBJ, PLY, STL, OFF, GLB or glTF files, gzipped or not.
    output : path, optional
        The cache to write; by default `default_cache_path` of the only input.
    config : BuildConfig, optional
    on_stage : callable, optional
        Told the name of each stage as it starts.

    Raises
    ------
    InputError
        A file cannot be read, or holds no face. No cache is written.
    CacheError, EnvironmentProblem
        The cache cannot be written. An older cache of that name stays whole.
    """
    if not inputs:
        raise InputError("nothing to build: name at least one model file")
    # Text, because a Path would drop the slash of a folder's name.
    path = fspath(default_cache_path(inputs) if output is None else output)
    resolve_target(path)  # a slip of -o is told before any work, not after
    timer = _StageTimer(on_stage)
    timer.start("load")
    source = read([Path(p) for p in inputs])
    prepared = prepare(source, config or BuildConfig(), timer.start)
    timer.start("write")
    from svprep.cache.writer import write_cache

    summary = write_cache(prepared, path)
    return BuildResult(cache=summary, prepared=prepared, seconds=timer.stop())


def prepare(source: SourceMesh, config: BuildConfig, on_stage: StageHook | None = None) -> Prepared:
    """Return the whole prepared city: every table that a cache holds.

    The order is forced. Welding comes first, because faces meet only where
    they share vertices. Repair needs them to meet, and decides winding before
    it splits edges, since pairs are pairs of faces that wind alike. Planes
    spread over pairs. The edge table marks edges within a plane, which the
    silhouette trees leave out; so they come last.
    """
    stage = on_stage or (lambda name: None)
    stage("weld")
    welded, weld_report = weld(source, config.weld_tolerance_m)
    if len(welded.faces) == 0:
        blame = "the model's units and coordinates"
        if config.weld_tolerance_m > 0.0:
            blame = f"--weld-tolerance ({config.weld_tolerance_m:g} m) first, then {blame}"
        raise InputError(
            f"{source.sources[0].path}: none of its {len(source.faces)} faces has any area "
            f"on a grid of {welded.grid.step_m:g} m, so nothing can cast a shadow. Check {blame}."
        )
    stage("repair")
    repaired, repair_report = repair(welded)
    stage("planes")
    planes = build_planes(repaired)
    stage("edges")
    edges, components = build_edges(repaired, planes)
    stage("silhouettes")
    index = build_index(repaired.mesh, components, planes, edges)
    return Prepared(
        sources=source.sources,
        object_names=source.object_names,
        object_source=source.object_source,
        mesh=repaired.mesh,
        components=components,
        planes=planes,
        edges=edges,
        index=index,
        repair=record(source, weld_report, repair_report),
        config=asdict(config),
        notes=source.notes,
    )


def default_cache_path(inputs: Sequence[str | PathLike[str]]) -> Path:
    """Return ``STEM.svp.h5`` in the current folder: ``city.obj.gz`` -> ``city.svp.h5``."""
    if len(inputs) != 1:
        raise InputError(f"{len(inputs)} inputs make one cache: name it with -o CACHE")
    name = Path(fspath(inputs[0])).name
    stem = Path(name.removesuffix(".gz")).stem
    return Path((stem or name) + CACHE_SUFFIX)


class _StageTimer:
    """Wall time between one stage's start and the next."""

    def __init__(self, on_stage: StageHook | None) -> None:
        self._tell = on_stage or (lambda name: None)
        self._starts: list[tuple[str, float]] = []

    def start(self, name: str) -> None:
        self._starts.append((name, time.perf_counter()))
        self._tell(name)

    def stop(self) -> dict[str, float]:
        starts = [*self._starts, ("", time.perf_counter())]
        return {
            name: following[1] - begun
            for (name, begun), following in zip(self._starts, starts[1:], strict=True)
        }
