"""The build as an outline: which stage runs when, and why in that order."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from pathlib import Path

from svprep.arc import leaves_out_place
from svprep.building import (
    labels_of,
    no_area,
    prepare_tiles,
    read_and_compare,
    room_for,
)
from svprep.cache.codec import Raw, clamp_datasets
from svprep.cache.files import resolve_target
from svprep.cache.reader import Cache, open_cache
from svprep.cache.writer import CacheSummary, rewrite_cache, write_contents
from svprep.clamp import ClampCosts, LightHook, clamp_lights, distinct, joined, selected
from svprep.content import source_digests
from svprep.errors import InputError
from svprep.ingest.inputs import expanded, stem_of
from svprep.ingest.options import ReadOptions
from svprep.light import Light, parse_lights
from svprep.model import ClampTable, Prepared, SourceMesh
from svprep.repair.grid import choose_grid, notes_on_step
from svprep.scene_tree import build_scene_tree
from svprep.stage_clock import StageClock, StageRow
from svprep.tiles import TILE_STAGES, StageHook, Tile, prepare_objects

STAGES = (
    "load",
    *TILE_STAGES,
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
    stages: tuple[StageRow, ...]
    reused: int
    """Objects whose tables were taken over from the older cache."""
    remarks: tuple[str, ...] = ()
    """One line each on how this build went; nothing that the cache depends on."""

    @property
    def seconds(self) -> dict[str, float]:
        """Wall seconds of each stage."""
        return {row.name: row.seconds for row in self.stages}

    @property
    def prepared(self) -> Prepared:
        """Everything, read from the cache that was written."""
        with open_cache(self.cache.path, check_digests=False) as cache:
            return cache.prepared()


def build(
    inputs: Sequence[str | PathLike[str]],
    output: str | PathLike[str] | None = None,
    config: BuildConfig | None = None,
    on_stage: StageHook | None = None,
    *,
    lights: Sequence[str] = (),
    costs: ClampCosts | None = None,
    memory_bytes: int | None = None,
    is_full: bool = False,
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
    memory_bytes : int, optional
        [B]: about what the process may hold. Tables that need more go to files in the
        temporary folder (``TMPDIR``). The cache is the same.
    is_full : bool
        Build all objects, also those that the older cache of that name holds already. The
        cache is the same. So it is with `memory_bytes`.

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
    target = resolve_target(path)  # a slip of -o is told before any work, not after
    # So is a slip in a light. Only a sun that leaves its place to the model has to wait.
    parse_lights([spec for spec in lights if not leaves_out_place(spec)])
    with room_for(memory_bytes) as room:
        clock = StageClock(on_stage)
        if room is not None:
            clock.n_spilled = room.spill.n_bytes
        clock.start("load")
        use_older = not is_full and room is None
        plan = read_and_compare(inputs, config, target if use_older else None, room)
        parsed = parse_lights(lights, plan.site) if lights else []
        parts = prepare_tiles(plan, clock)
        clock.start("scene tree")
        scene = parts.scene_tree()
        clock.start("clamp")
        clamp = parts.clamp(scene, list(distinct(parsed, plan.grid).values()), costs)
        clock.start("write")
        summary = write_contents(
            parts.contents(scene, clamp), parts.attributes(config.as_json()), path
        )
        clock.wrote(summary.n_bytes)
    return BuildResult(
        cache=summary,
        stages=clock.stop(plan.n_triangles),
        reused=plan.n_reused,
        remarks=(*plan.remarks, *plan.lights_left_behind(clamp)),
    )


def prepare(
    source: SourceMesh,
    config: BuildConfig,
    on_stage: StageHook | None = None,
    lights: Sequence[Light] = (),
    costs: ClampCosts | None = None,
) -> Prepared:
    """Return the whole prepared city, in memory: every table that a cache holds.

    What `build` makes tile by tile, this makes at once. The order of the first five stages
    is that of `svprep.tiles.prepare_objects`. Clamping needs the tree of receivers, and
    components for casters.
    """
    stage = on_stage or (lambda name: None)
    grid = choose_grid(source)
    tile = Tile(source, source_digests(source), grid, config.weld_tolerance_m)
    tables = prepare_objects(tile, stage)
    mesh = tables.mesh
    if not len(mesh.faces):
        raise no_area(source, grid, config.weld_tolerance_m)
    stage("scene tree")
    scene = build_scene_tree(mesh)
    stage("clamp")
    once = list(distinct(lights, mesh.grid).values())
    clamp = clamp_lights(mesh, tables.components, scene, once, costs)
    return Prepared(
        sources=source.sources,
        object_names=source.object_names,
        object_source=source.object_source,
        labels=labels_of(source, mesh.object_face_start, lambda: mesh.source_face),
        place=source.place,
        mesh=mesh,
        components=tables.components,
        planes=tables.planes,
        edges=tables.edges,
        index=tables.index,
        scene=scene,
        clamp=clamp,
        repair=tables.repair,
        config=config.as_json(),
        notes=(*source.notes, *notes_on_step(mesh.grid, lambda: mesh.positions)),
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
