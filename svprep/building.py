"""What a build goes through between its inputs and its cache; `svprep.pipeline` is the outline.

inputs --> SourceMesh, grid, digests --> Plan --> tiles, runs taken over --> Parts --> Contents
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from svprep.cache.codec import (
    city_attributes,
    clamp_datasets,
    decode_components,
    decode_mesh,
    label_datasets,
    scene_datasets,
)
from svprep.cache.contents import Contents, OfRuns
from svprep.cache.runs import Joined, Run
from svprep.cache.schema import SPEC_OF_PATH
from svprep.clamp import ClampCosts, clamp_changed, clamp_lights
from svprep.clamp_changes import PreviousClamp, SceneParts
from svprep.content import source_digests
from svprep.errors import EnvironmentProblem, InputError
from svprep.ingest import read
from svprep.ingest.spill import Spill, empty_table, release
from svprep.light import Light, Site
from svprep.model import (
    I64,
    U8,
    U32,
    ClampTable,
    Components,
    Grid,
    Labels,
    Mesh,
    SceneTree,
    SourceMesh,
)
from svprep.older import OfNoUse, Older, objects_before, read_older, runs_taken_over
from svprep.parallel import map_ordered, thread_count
from svprep.planes import default_planar_tolerance_m
from svprep.process_memory import return_free_memory
from svprep.ranges import rows_of_runs
from svprep.repair.grid import choose_grid, notes_on_step
from svprep.scene_tree import (
    EarlierScene,
    LocalClusters,
    build_scene_tree,
    join_clusters,
    scene_tree,
    updated_scene_tree,
)
from svprep.stage_clock import StageClock
from svprep.tile_store import InMemory, OnDisk
from svprep.tiles import (
    BYTES_PER_FACE,
    FACES,
    SHARES,
    TILE_STAGES,
    TileTables,
    cut,
    faces_of_a_tile,
    prepare_tile,
    selected_objects,
    tile_of,
)

if TYPE_CHECKING:
    from svprep.pipeline import BuildConfig

Raw = NDArray[Any]

_TILES_SHARE: Final = 0.25
"""Of the memory that a build may hold, for the tiles that are prepared at a time."""


@dataclass(frozen=True, slots=True)
class Room:
    """How a build gets by with little memory."""

    spill: Spill
    faces_per_tile: int


@contextlib.contextmanager
def room_for(memory_bytes: int | None) -> Iterator[Room | None]:
    """Give a build a folder for what it may not hold in memory; None if it may hold all."""
    if memory_bytes is None:
        yield None
        return
    asked = os.environ.get("TMPDIR", "")
    if asked and not (os.path.isdir(asked) and os.access(asked, os.W_OK | os.X_OK)):
        what = "takes no new files" if os.path.isdir(asked) else "is no folder"
        raise EnvironmentProblem(
            f'TMPDIR is "{asked}", which {what}: --memory needs one for what is not held. '
            "Make it, or name another"
        )
    try:
        temporary = tempfile.gettempdir()
    except FileNotFoundError as error:
        raise EnvironmentProblem(
            f"--memory needs a folder for what is not held, and none takes new files ({error}). "
            "Name one with TMPDIR"
        ) from None
    faces = int(_TILES_SHARE * memory_bytes / (BYTES_PER_FACE * thread_count()))
    place: contextlib.AbstractContextManager[str]
    if os.name == "posix":  # the files have no names, and need no folder of their own
        place = contextlib.nullcontext(temporary)
    else:
        place = tempfile.TemporaryDirectory(prefix="svprep-")
    with place as folder:
        yield Room(Spill(Path(folder), memory_bytes), max(1, min(faces, FACES)))


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be built, and what of it there is already."""

    source: SourceMesh
    grid: Grid
    weld_tolerance_m: float
    older: Older | None
    before: I64 | None
    """``(n_objects,)``: the object of `older` that each one was, or -1."""
    most_faces: int
    """Of a tile."""
    room: Room | None
    of_no_use: str = ""
    """Why nothing is taken over from an older cache that is there."""

    @property
    def n_triangles(self) -> int:
        """Triangles that were read."""
        return len(self.source.faces)

    @property
    def n_objects(self) -> int:
        """Objects."""
        return len(self.source.object_names)

    @property
    def n_reused(self) -> int:
        """Objects whose tables are taken over."""
        return 0 if self.before is None else int(np.count_nonzero(self.before >= 0))

    @property
    def remarks(self) -> tuple[str, ...]:
        """One line each on how this build goes."""
        remarks = []
        if self.of_no_use:
            remarks.append(f"nothing is taken over from the older cache: {self.of_no_use}")
        if self.room is not None:
            remarks += [*self.room.spill.remarks, *self._prepared_alone()]
        return tuple(remarks)

    def _prepared_alone(self) -> list[str]:
        """Return a line for each object that is more than a tile may be."""
        sizes = np.diff(self.source.object_face_start)
        return [
            f"{self.source.sources[self.source.object_source[k]].path}, object "
            f'"{self.source.object_names[k]}": its {sizes[k]:,} triangles are prepared alone, '
            f"which takes about {sizes[k] * BYTES_PER_FACE / 1e6:,.0f} MB; a tile within "
            f"--memory has at most {self.most_faces:,}"
            for k in np.flatnonzero(sizes > self.most_faces).tolist()
        ]

    def lights_left_behind(self, clamp: ClampTable) -> tuple[str, ...]:
        """Return a remark on lights that the older cache holds and this build was not asked for."""
        if self.older is None or self.before is None:
            return ()
        asked = {light.tobytes() for light in clamp.lights}
        n = sum(light.tobytes() not in asked for light in self.older.clamp.lights)
        if not n:
            return ()
        lights, them = ("light", "it") if n == 1 else ("lights", "them")
        return (
            f"{n} {lights} of the older cache not taken over: name {them} with --light, here or "
            "for svprep clamp",
        )

    @property
    def site(self) -> Site:
        """Where the model stands, as its cache will say it."""
        x_m, y_m, _ = self.grid.origin_m.tolist()
        return Site.of(self.source.place, x_m, y_m)


def read_and_compare(
    inputs: Sequence[str | PathLike[str]],
    config: BuildConfig,
    older: Path | None,
    room: Room | None,
) -> Plan:
    """Read the inputs, choose the grid, and see what the cache `older` holds of them.

    All that depends on the whole input is decided here, before any tile is cut.

    Raises
    ------
    InputError
        A file cannot be read, or holds no face, or does not fit the grid.
    """
    with ThreadPoolExecutor(1) as pool:
        reading = None
        if older is not None and older.exists():
            reading = pool.submit(read_older, older)
        spill = None if room is None else room.spill
        source = read([os.fspath(p) for p in inputs], options=config.reading, spill=spill)
        grid = choose_grid(source)
        for array in (source.positions, source.faces):
            release(array)
        if room is not None:
            return_free_memory()
        found, before, of_no_use = None, None, ""
        try:
            if reading is not None:
                found = reading.result()
                digests = source_digests(source)
                before = objects_before(found, digests, grid, config.weld_tolerance_m)
        except OfNoUse as why:
            found, of_no_use = None, str(why)  # its tables are held no longer
    most_faces = faces_of_a_tile(len(source.faces)) if room is None else room.faces_per_tile
    tolerance_m = config.weld_tolerance_m
    return Plan(source, grid, tolerance_m, found, before, most_faces, room, of_no_use)


def prepare_tiles(plan: Plan, clock: StageClock) -> Parts:
    """Return the tables of all objects: taken over, or tile by tile on all threads.

    Raises
    ------
    InputError
        No face has any area.
    """
    clock.start("weld")
    runs, work, numbers = dict(_taken_over(plan)), plan.source, np.arange(plan.n_objects)
    if plan.before is not None:
        numbers = np.flatnonzero(plan.before < 0)
        work = selected_objects(plan.source, numbers)

    def do(objects: tuple[int, int]) -> TileTables:
        tile = tile_of(work, *objects, plan.grid, plan.weld_tolerance_m)
        made = prepare_tile(tile)
        rows = slice(*work.object_face_start[list(objects)].tolist())
        for array in (tile.source.positions, tile.source.source_face, work.faces[rows]):
            release(array)  # the input's, where it is mapped
        return made

    store = InMemory() if plan.room is None else OnDisk(plan.room.spill)
    clusters: list[LocalClusters] = []
    seconds = dict.fromkeys((*TILE_STAGES, *SHARES), 0.0)
    most_ahead = thread_count() * (2 if plan.room is None else 1)
    for group in _groups(work.object_face_start, plan):
        for objects, made in zip(group, map_ordered(do, group, most_ahead), strict=True):
            store.add(numbers[slice(*objects)], made.arrays)
            clusters.append(made.clusters)
            for name, spent in made.seconds.items():
                seconds[name] += spent
            clock.tell_tiles(TILE_STAGES)
    clock.share(seconds)
    if plan.room is not None:
        return_free_memory()
    runs.update(store.runs())
    parts = Parts(plan, Joined([runs[k] for k in sorted(runs)], release), clusters)
    if not parts.joined.size("n_faces"):
        raise no_area(plan.source, plan.grid, plan.weld_tolerance_m)
    return parts


def _taken_over(plan: Plan) -> Iterator[tuple[int, Run]]:
    if plan.older is not None and plan.before is not None:
        yield from runs_taken_over(plan.older, plan.source, plan.before)


def _groups(start: I64, plan: Plan) -> Iterator[list[tuple[int, int]]]:
    """Yield the tiles that run side by side; some large ones run alone.

    These are the one that is most of all the work, which then is shared among the threads,
    and where memory is short those of a single object that is more than a tile may be.
    """
    tiles = cut(start, plan.most_faces)
    sizes = [int(start[end] - start[begin]) for begin, end in tiles]
    most = sum(sizes) // 2
    if plan.room is not None:
        most = min(most, plan.most_faces)
    group: list[tuple[int, int]] = []
    for tile, size in zip(tiles, sizes, strict=True):
        if size > most and group:
            yield group
            group = []
        group.append(tile)
        if size > most:
            yield group
            group = []
    if group:
        yield group


@dataclass(slots=True)
class Parts:
    """The tables of all objects, and what is made of the whole."""

    plan: Plan
    joined: Joined
    clusters: list[LocalClusters]
    """Of the tiles that were prepared, in order."""
    _mesh: Mesh | None = None
    _components: Components | None = None
    _labels: Labels | None = None

    @property
    def mesh(self) -> Mesh:
        """The whole mesh."""
        if self._mesh is None:
            self._mesh = decode_mesh(self._whole, self.plan.grid)
        return self._mesh

    def _whole(self, path: str) -> Raw:
        """Return one dataset: in a file that is mapped, where memory is short."""
        if self.plan.room is None:
            return self.joined.array(path)
        kind = SPEC_OF_PATH[path].in_memory
        array = empty_table(kind, self.joined.shape(path), self.plan.room.spill)
        self.joined.array(path, array)
        release(array)
        return array

    @property
    def components(self) -> Components:
        """The components of all objects."""
        if self._components is None:
            self._components = decode_components(self.joined.array)
        return self._components

    def scene_tree(self) -> SceneTree:
        """Return the trees over all objects and faces."""
        local = join_clusters(self.clusters)
        self.clusters.clear()  # held once, where memory is short
        older, before = self.plan.older, self.plan.before
        if older is None or before is None:
            tree = scene_tree(local)
            del local
            self._return_free_memory()
            return tree
        earlier = EarlierScene(older.mesh, older.scene, before)
        face_start = self._starts("objects/face_start")
        return updated_scene_tree(earlier, face_start, local) or build_scene_tree(self.mesh)

    def clamp(
        self, scene: SceneTree, lights: Sequence[Light], costs: ClampCosts | None
    ) -> ClampTable:
        """Return the segments of every caster for every light."""
        previous = self._previous_clamp(scene) if lights else None
        if previous is not None:
            return clamp_changed(
                previous, lambda: (self.mesh, self.components), self.plan.grid, lights, costs
            )
        mesh, components = self.mesh, self.components
        self._return_free_memory()
        table = clamp_lights(mesh, components, scene, lights, costs)
        self._return_free_memory()
        return table

    def _return_free_memory(self) -> None:
        """Hold no more than what is needed later, where memory is short."""
        if self.plan.room is not None:
            for array in (self.mesh.positions, self.mesh.faces, self.mesh.source_face):
                release(array)
            return_free_memory()

    def _starts(self, path: str) -> I64:
        return self.joined.array(path).astype(np.int64)

    def _previous_clamp(self, scene: SceneTree) -> PreviousClamp | None:
        """Return what the older cache holds of lights, and where the scene is another now."""
        older, before = self.plan.older, self.plan.before
        if older is None or before is None or not len(older.clamp):
            return None
        then = SceneParts(
            tree=older.scene,
            object_start=older.components.object_start,
            face_start=older.components.face_start,
            points_of=lambda faces: older.mesh.positions[older.mesh.faces[faces].reshape(-1)],
        )
        now = SceneParts(
            tree=scene,
            object_start=self._starts("objects/component_start"),
            face_start=self._starts("components/face_start"),
            points_of=self.joined.points_of_faces,
        )
        is_gone = np.ones(older.n_objects, np.bool_)
        is_gone[before[before >= 0]] = False
        casters_gone, _ = rows_of_runs(then.object_start, np.flatnonzero(is_gone))
        shift = np.where(before >= 0, then.object_start[before] - now.object_start[:-1], 0)
        counts = np.diff(now.object_start)
        caster_before = np.arange(now.n_casters) + np.repeat(shift, counts)
        caster_before[np.repeat(before < 0, counts)] = -1
        return PreviousClamp(
            table=older.clamp,
            then=then,
            now=now,
            caster_before=caster_before,
            casters_gone=casters_gone,
            changed_boxes=np.concatenate(
                [older.scene.object_boxes[is_gone], scene.object_boxes[before < 0]]
            ),
        )

    @property
    def labels(self) -> Labels:
        """What the sources say of objects, and of the faces that are left."""
        if self._labels is None:
            face_start = self._starts("objects/face_start")
            self._labels = labels_of(self.plan.source, face_start, self._source_face)
        return self._labels

    def _source_face(self) -> U32:
        if self._mesh is not None:
            return self._mesh.source_face
        return self._whole("mesh/source_face")

    def contents(self, scene: SceneTree, clamp: ClampTable) -> Contents:
        """Return all that the cache will hold."""
        source = self.plan.source
        others = {
            **label_datasets(source.object_names, source.object_source, self.labels),
            **scene_datasets(scene),
            **clamp_datasets(clamp),
        }
        return OfRuns(self.joined, others)

    def attributes(self, config: Mapping[str, object]) -> dict[str, bytes | Raw]:
        """Return the cache's attributes."""
        source, grid = self.plan.source, self.plan.grid
        return city_attributes(
            sources=source.sources,
            labels=self.labels,
            place=source.place,
            grid=grid,
            planar_tolerance_m=default_planar_tolerance_m(grid),
            config=config,
            notes=(*source.notes, *notes_on_step(grid, lambda: self.mesh.positions)),
        )


def labels_of(source: SourceMesh, object_face_start: I64, source_face: Callable[[], U32]) -> Labels:
    """Return what the sources say of objects, and of the faces that are left.

    `source_face` gives that of `Mesh`, and is called only if the sources say something of faces.
    """
    labels = Labels.none(len(source.object_names), int(object_face_start[-1]))
    surface: U8 = labels.surface_of_face
    if len(source.surface_of_polygon):
        source_of_face = np.repeat(source.object_source, np.diff(object_face_start))
        is_stated = np.diff(source.polygon_start)[source_of_face] > 0
        first = source.polygon_start[source_of_face[is_stated]]
        surface[is_stated] = source.surface_of_polygon[first + source_face()[is_stated]]
    return Labels(
        object_types=source.object_types or labels.object_types,
        object_parents=source.object_parents or labels.object_parents,
        surface_names=source.surface_names,
        surface_of_face=surface,
    )


def no_area(source: SourceMesh, grid: Grid, weld_tolerance_m: float) -> InputError:
    """Return the error that nothing of an input can cast a shadow."""
    blame = "the model's units and coordinates"
    if weld_tolerance_m > 0.0:
        blame = f"--weld-tolerance ({weld_tolerance_m:g} m) first, then {blame}"
    return InputError(
        f"{source.sources[0].path}: none of its {len(source.faces)} faces has any area "
        f"on a grid of {grid.step_m:g} m, so nothing can cast a shadow. Check {blame}."
    )
