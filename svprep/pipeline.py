"""The build as an outline: which stage runs when, and why in that order."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from pathlib import Path

import numpy as np

from svprep.arc import leaves_out_place
from svprep.cache.codec import Raw, clamp_datasets
from svprep.cache.files import resolve_target
from svprep.cache.reader import Cache, open_cache
from svprep.cache.writer import CacheSummary, rewrite_cache, write_cache
from svprep.clamp import ClampCosts, LightHook, clamp_lights, distinct, joined, selected
from svprep.edges import build_edges
from svprep.errors import InputError
from svprep.ingest import read
from svprep.ingest.inputs import expanded, stem_of
from svprep.ingest.options import ReadOptions
from svprep.light import Light, Site, parse_lights
from svprep.model import ClampTable, Labels, Mesh, Prepared, SourceMesh
from svprep.planes import build_planes
from svprep.repair.grid import choose_grid, notes_on_step
from svprep.repair.stage import record, repair
from svprep.repair.weld import weld
from svprep.scene_tree import build_scene_tree
from svprep.silhouette.index import build_index

StageHook = Callable[[str], None]
"""Called with a stage's name when it starts: ``"load"``, ``"weld"``, ..."""

STAGES = (
    "load",
    "weld",
    "repair",
    "planes",
    "edges",
    "silhouettes",
    "scene tree",
    "clamp",
    "write",
)
CACHE_SUFFIX = ".svp.h5"


@dataclass(frozen=True, slots=True)
class BuildConfig:
    """What a build is asked for. The same sources and config give the same tables."""

    weld_tolerance_m: float = 0.0
    """[m]: pull vertices of one object within this distance together; 0 is exact."""
    reading: ReadOptions = field(default_factory=ReadOptions)
    """What of the inputs is wanted."""

    def as_json(self) -> dict[str, object]:
        """Return the tolerance, and what else differs from the defaults."""
        return {"weld_tolerance_m": self.weld_tolerance_m, **self.reading.as_config()}

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
    *,
    lights: Sequence[str] = (),
    costs: ClampCosts | None = None,
) -> BuildResult:
    """Build the cache of one or more model files.

    Parameters
    ----------
    inputs : sequence of path
        Files of the formats that `svprep.ingest` reads, gzipped or not, folders of them,
        3D Tiles folders, patterns.
    output : path, optional
        The cache to write; by default `default_cache_path` of the only input.
    config : BuildConfig, optional
    on_stage : callable, optional
        Told the name of each stage as it starts.
    lights : sequence of str
        Specs of lights to clamp shadows for; an arc is one per step by day. A sun without
        LAT,LON stands where the inputs say that the model does.
    costs : ClampCosts, optional
        What clamping weighs.

    Raises
    ------
    InputError
        A file cannot be read, or holds no face; a light is not one. No cache is written.
    CacheError, EnvironmentProblem
        The cache cannot be written. An older cache of that name stays whole.
    """
    if not inputs:
        raise InputError("nothing to build: name at least one model file")
    config = config or BuildConfig()
    # Text, because a Path would drop the slash of a folder's name.
    path = fspath(default_cache_path(inputs) if output is None else output)
    resolve_target(path)  # a slip of -o is told before any work, not after
    # So is a slip in a light. Only a sun that leaves its place to the model has to wait.
    parse_lights([spec for spec in lights if not leaves_out_place(spec)])
    timer = _StageTimer(on_stage)
    timer.start("load")
    source = read([fspath(p) for p in inputs], options=config.reading)
    parsed = parse_lights(lights, _site(source)) if lights else []
    prepared = prepare(source, config, timer.start, parsed, costs)
    timer.start("write")
    summary = write_cache(prepared, path)
    return BuildResult(cache=summary, prepared=prepared, seconds=timer.stop())


def _site(source: SourceMesh) -> Site:
    """Return where the model stands, as its cache will say it."""
    x_m, y_m, _ = choose_grid(source).origin_m.tolist()
    return Site.of(source.place, x_m, y_m)


def prepare(
    source: SourceMesh,
    config: BuildConfig,
    on_stage: StageHook | None = None,
    lights: Sequence[Light] = (),
    costs: ClampCosts | None = None,
) -> Prepared:
    """Return the whole prepared city: every table that a cache holds.

    The order is forced. Welding comes first, because faces meet only where
    they share vertices. Repair needs them to meet, and decides winding before
    it splits edges, since pairs are pairs of faces that wind alike. Planes
    spread over pairs. The edge table marks edges within a plane, which the
    silhouette trees leave out; so they come after it. Clamping needs the tree of
    receivers, and components for casters.
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
    stage("scene tree")
    scene = build_scene_tree(repaired.mesh)
    stage("clamp")
    once = list(distinct(lights, repaired.mesh.grid).values())
    clamp = clamp_lights(repaired.mesh, components, scene, once, costs)
    return Prepared(
        sources=source.sources,
        object_names=source.object_names,
        object_source=source.object_source,
        labels=_labels(source, repaired.mesh),
        place=source.place,
        mesh=repaired.mesh,
        components=components,
        planes=planes,
        edges=edges,
        index=index,
        scene=scene,
        clamp=clamp,
        repair=record(source, weld_report, repair_report),
        config=config.as_json(),
        notes=(*source.notes, *notes_on_step(repaired.mesh)),
    )


def _labels(source: SourceMesh, mesh: Mesh) -> Labels:
    """Return what the sources say of objects, and of the faces that are left."""
    labels = Labels.none(len(source.object_names), len(mesh.faces))
    surface = labels.surface_of_face
    if len(source.surface_of_polygon):
        source_of_face = np.repeat(source.object_source, np.diff(mesh.object_face_start))
        is_stated = np.diff(source.polygon_start)[source_of_face] > 0
        first = source.polygon_start[source_of_face[is_stated]]
        surface[is_stated] = source.surface_of_polygon[first + mesh.source_face[is_stated]]
    return Labels(
        object_types=source.object_types or labels.object_types,
        object_parents=source.object_parents or labels.object_parents,
        surface_names=source.surface_names,
        surface_of_face=surface,
    )


@dataclass(frozen=True, slots=True)
class LightsAdded:
    """What `add_lights` did."""

    cache: CacheSummary | None
    """What was written; None if the cache held all the lights already."""
    clamp: ClampTable
    """Every light of the cache now."""
    added: tuple[int, ...]
    """Lights of `clamp` that were computed."""
    n_replaced: int
    """Lights of before that were computed again, with other costs."""
    n_present: int
    """Lights asked for that the cache held already, or that were named twice."""


def add_lights(
    path: str | PathLike[str],
    specs: Sequence[str],
    costs: ClampCosts | None = None,
    on_light: LightHook | None = None,
) -> LightsAdded:
    """Clamp the shadows of more lights and add them to a cache, all else kept as it is.

    Parameters
    ----------
    path : path-like
        A cache. It is replaced whole or not at all; open readers keep the old content.
    specs : sequence of str
        Lights; an arc is one per step by day. The sun's azimuth is turned to the
        cache's grid if its CRS is known.
    costs : ClampCosts, optional
    on_light : callable, optional
        Called as each light is done.

    Raises
    ------
    InputError
        A light is not one, or lies on a vertex.
    CacheError
        The cache is missing, damaged or of another schema, or another process writes it.
    EnvironmentProblem
        It cannot be written.
    """
    costs = costs or ClampCosts()
    done: list[LightsAdded] = []

    def change(cache: Cache) -> dict[str, Raw]:
        table = cache.clamp
        wanted, kept = _lights_to_add(cache, parse_lights(specs, cache.site), costs)
        new = clamp_lights(cache.mesh, cache.components, cache.scene, wanted, costs, on_light)
        whole = joined(selected(table, kept), new)
        done.append(
            LightsAdded(
                cache=None,
                clamp=whole,
                added=tuple(range(len(kept), len(whole))),
                n_replaced=len(table) - len(kept),
                n_present=0,
            )
        )
        return clamp_datasets(whole)

    with open_cache(path) as cache:
        lights = parse_lights(specs, cache.site)
        wanted, _ = _lights_to_add(cache, lights, costs)
        if not wanted:
            return LightsAdded(None, cache.clamp, (), 0, len(lights))
    summary = rewrite_cache(path, change)
    return replace(done[-1], cache=summary, n_present=len(lights) - len(done[-1].added))


def _lights_to_add(
    cache: Cache, lights: Sequence[Light], costs: ClampCosts
) -> tuple[list[Light], list[int]]:
    """Return the lights that the cache lacks, each once, and its own that stay.

    A light is the same if its four numbers are. One that the cache holds with other costs
    is computed again, and does not stay.
    """
    table = cache.clamp
    held = {table.lights[i].tobytes(): i for i in range(len(table))}
    wanted: dict[bytes, Light] = {}
    dropped: set[int] = set()
    for key, light in distinct(lights, cache.grid).items():
        if (i := held.get(key)) is not None:
            if table.facts[i, :2].tolist() == [costs.vertex, costs.area]:
                continue
            dropped.add(i)
        wanted[key] = light
    return list(wanted.values()), [i for i in range(len(table)) if i not in dropped]


def default_cache_path(inputs: Sequence[str | PathLike[str]]) -> Path:
    """Return ``STEM.svp.h5`` in the current folder: ``city.obj.gz`` -> ``city.svp.h5``.

    The stem is of the only file, or of the only folder that was named.
    """
    if len(inputs) == 1 and not os.path.isdir(inputs[0]):
        inputs = expanded(inputs).paths  # a pattern may match one file or several
    if len(inputs) != 1:
        raise InputError(f"{len(inputs)} inputs make one cache: name it with -o CACHE")
    return Path(stem_of(inputs[0]) + CACHE_SUFFIX)


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
