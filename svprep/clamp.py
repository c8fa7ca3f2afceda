"""The stage that clamps casters' shadows, light by light.

    vertices --> light frame --> boxes of clusters --> tree --+
                      |                                       +--> segments of each caster
                      +--------> boxes of casters ------------+

Casters are components, receivers are clusters of up to eight faces, so that what lies
between two houses is not in the way of a shadow because a house's box is. (Steiner 2006
took whole objects for both, and gained 8 to 10 %.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from svprep.clamp_changes import PreviousClamp, TakenOver, taken_over
from svprep.clamp_views import ClampScene, LampView, Segments, SunView
from svprep.errors import InputError, first_few
from svprep.light import Light
from svprep.model import F32, F64, ClampTable, Components, Grid, Mesh, SceneTree
from svprep.ranges import rows_of_runs
from svprep.silhouette.tables import check_mesh, check_starts, contradiction, read_only

LightHook = Callable[[int, int], None]
"""Called with how many lights are done, and of how many."""


@dataclass(frozen=True, slots=True)
class ClampCosts:
    """What drawing costs, for the rule that leaves a gap: ``V < R`` (Lloyd et al. 2004).

    V is `vertex` times the vertices of the two more caps; R is `area` times the square metres
    of sides across the gap less those of the caps. Only their ratio matters.
    """

    vertex: float = 4.0
    """Of a vertex drawn: as much as four square metres, some thirty pixels at 200 m."""
    area: float = 1.0
    """Of a square metre of side or cap. 0: no gaps."""

    def __post_init__(self) -> None:
        for name in ("vertex", "area"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise InputError(f"the cost of a clamp's {name} is a number of at least 0: {value}")

    @property
    def prices(self) -> F64:
        """Both, as kernels take them."""
        return np.array([self.vertex, self.area])


def clamp_lights(
    mesh: Mesh,
    components: Components,
    scene: SceneTree,
    lights: Sequence[Light],
    costs: ClampCosts | None = None,
    on_light: LightHook | None = None,
) -> ClampTable:
    """Return the segments of every caster for every light, in the order of `lights`.

    Parameters
    ----------
    mesh, components, scene
        The finished tables.
    lights : sequence of Light
        Any; also none.
    costs : ClampCosts, optional
    on_light : callable, optional
        Called as each light is done.

    Raises
    ------
    InputError
        A point light lies exactly on a vertex, or is too far away.
    CacheError
        The tables, of a cache, contradict each other.

    Notes
    -----
    O((n + h) log n) for each light, h the pairs of casters and receivers that overlap.
    Continuous clamping after Lloyd et al. (2004); precomputed after Steiner (2006).
    """
    prices = (costs or ClampCosts()).prices
    vectors = _vectors(lights, mesh.grid)
    clamped: list[_Clamped] = []
    shared = _checked(mesh, components, scene, lights, vectors) if lights else None
    for vector in vectors:
        assert shared is not None
        view = _view(shared, vector)
        clamped.append(_with_facts(view, view.segments(prices), prices))
        if on_light is not None:
            on_light(len(clamped), len(vectors))
    return _table(lights, vectors, clamped, len(components.flags))


def clamp_changed(
    previous: PreviousClamp,
    whole: Callable[[], tuple[Mesh, Components]],
    grid: Grid,
    lights: Sequence[Light],
    costs: ClampCosts | None = None,
) -> ClampTable:
    """Return what `clamp_lights` returns of a scene, from what it was of an earlier state.

    Casters that meet nothing that changed take over what they had.

    Parameters
    ----------
    previous : PreviousClamp
    whole : callable
        Gives the mesh and the components of the scene as it is: called where a light cannot
        be taken over.
    grid
        Of the mesh.
    lights, costs
        As for `clamp_lights`, which names the errors.
    """
    prices = (costs or ClampCosts()).prices
    vectors = _vectors(lights, grid)
    found = [_from_before(previous, vector, prices) for vector in vectors]
    again = [i for i, one in enumerate(found) if one is None]
    shared = None
    if again or any(one is not None and one.units is None for one in found):
        chosen = [lights[i] for i in again], [vectors[i] for i in again]
        shared = _checked(*whole(), previous.now.tree, *chosen)
    clamped: list[_Clamped] = []
    for one, vector in zip(found, vectors, strict=True):
        if one is not None and one.units is not None:
            facts_m2 = one.units * previous.now.part().unit_m2
            clamped.append(_Clamped(one.segments, [*prices, *facts_m2]))
            continue
        assert shared is not None
        view = _view(shared, vector)
        segments = view.segments(prices) if one is None else one.segments
        clamped.append(_with_facts(view, segments, prices))
    return _table(lights, vectors, clamped, previous.now.n_casters)


def _from_before(previous: PreviousClamp, vector: F32, prices: F64) -> TakenOver | None:
    """Return what becomes of a light; None if it is to be clamped anew, or is an error."""
    light = previous.light_of(vector, prices)
    if light is None or (vector[3] != 0.0 and previous.now.has_vertex_at(vector[:3])):
        return None
    return taken_over(previous, _view(previous.now.part(), vector), prices, light)


@dataclass(frozen=True, slots=True)
class _Clamped:
    """What a table holds of a light."""

    segments: Segments
    facts: list[float]


def _with_facts(view: SunView | LampView, segments: Segments, prices: F64) -> _Clamped:
    surfaces_m2 = view.surfaces(segments, view.end()) * view.scene.unit_m2
    return _Clamped(segments, [*prices, *surfaces_m2])


def _vectors(lights: Sequence[Light], grid: Grid) -> list[F32]:
    return [read_only(light.in_cache_frame(grid)) for light in lights]


def _checked(
    mesh: Mesh,
    components: Components,
    scene: SceneTree,
    lights: Sequence[Light],
    vectors: Sequence[F32],
) -> ClampScene:
    """Return the scene, its tables and the lights checked."""
    check_tables(mesh, components, scene)
    for light, vector in zip(lights, vectors, strict=True):
        _check_off_vertices(light, vector, mesh)
    return ClampScene(
        positions=read_only(mesh.positions),
        faces=read_only(mesh.faces),
        face_start=read_only(components.face_start),
        order=read_only(scene.faces),
        cluster_start=read_only(scene.cluster_start),
        largest_m=max(float(mesh.positions.max()), -float(mesh.positions.min())),
    )


def _table(
    lights: Sequence[Light], vectors: Sequence[F32], clamped: Sequence[_Clamped], n_casters: int
) -> ClampTable:
    n = len(lights)
    starts = np.zeros((n, n_casters + 1), np.uint32)
    for i, one in enumerate(clamped):
        np.cumsum(one.segments.counts, out=starts[i, 1:])
    segments = [one.segments for one in clamped]
    sizes = [len(one.depths) for one in segments]
    return ClampTable(
        specs=tuple(light.spec for light in lights),
        lights=np.array(vectors, np.float32).reshape(n, 4),
        frames=np.array([light_frame(vector) for vector in vectors], np.float64).reshape(n, 3, 3),
        facts=np.array([one.facts for one in clamped], np.float64).reshape(n, 5),
        light_start=np.concatenate(([0], np.cumsum(sizes, dtype=np.int64))),
        segment_start=starts,
        depths=np.concatenate([np.empty((0, 2), np.float32), *(one.depths for one in segments)]),
        slopes=np.concatenate([np.empty((0, 2), np.int16), *(one.slopes for one in segments)]),
    )


def _view(scene: ClampScene, vector: F32) -> SunView | LampView:
    if vector[3] != 0.0:
        return LampView(scene, vector)
    return SunView.of(scene, light_frame(vector))


def distinct(lights: Sequence[Light], grid: Grid) -> dict[bytes, Light]:
    """Return each light once, by its four numbers in the cache frame, in order."""
    found: dict[bytes, Light] = {}
    for light in lights:
        found.setdefault(light.in_cache_frame(grid).tobytes(), light)
    return found


def joined(first: ClampTable, second: ClampTable) -> ClampTable:
    """Return the lights of `first`, then those of `second`: tables of the same casters."""
    return ClampTable(
        specs=first.specs + second.specs,
        lights=np.concatenate([first.lights, second.lights]),
        frames=np.concatenate([first.frames, second.frames]),
        facts=np.concatenate([first.facts, second.facts]),
        light_start=np.concatenate(
            [first.light_start, first.light_start[-1] + second.light_start[1:]]
        ),
        segment_start=np.concatenate([first.segment_start, second.segment_start]),
        depths=np.concatenate([first.depths, second.depths]),
        slopes=np.concatenate([first.slopes, second.slopes]),
    )


def selected(table: ClampTable, lights: Sequence[int]) -> ClampTable:
    """Return only some lights of a table, in the order given."""
    check_starts("lights/segment_start", table.light_start, len(table.depths))
    chosen = np.array(lights, np.int64)
    segments, light_start = rows_of_runs(table.light_start, chosen)
    return ClampTable(
        specs=tuple(table.specs[i] for i in lights),
        lights=table.lights[chosen],
        frames=table.frames[chosen],
        facts=table.facts[chosen],
        light_start=light_start,
        segment_start=table.segment_start[chosen],
        depths=table.depths[segments],
        slopes=table.slopes[segments],
    )


def light_frame(vector: F32) -> F64:
    """Return the axes u, v and t of a light, ``(3, 3) float64``.

    For the sun, t leads away from it, u is level, and v rises; (u, v, t) is right-handed.
    For a point light, they are x, y and z.
    """
    if vector[3] != 0.0:
        return np.eye(3)
    t = -vector[:3].astype(np.float64)
    t /= np.linalg.norm(t)
    level = np.array([-t[1], t[0], 0.0])
    length = np.linalg.norm(level)
    u = level / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.stack([u, np.cross(t, u), t])


def check_tables(mesh: Mesh, components: Components, scene: SceneTree) -> None:
    """Raise `CacheError` where a kernel would read beyond an array. O(n)."""
    check_mesh(mesh, components)
    n_faces = len(mesh.faces)
    check_starts("scene/cluster_start", scene.cluster_start, n_faces)
    if len(scene.faces) != n_faces or (n_faces and int(scene.faces.max()) >= n_faces):
        raise contradiction("a cluster has a face that is not there")


def _check_off_vertices(light: Light, vector: F32, mesh: Mesh) -> None:
    if vector[3] == 0.0:
        return
    near = np.flatnonzero(mesh.positions[:, 0] == vector[0])
    at = near[(mesh.positions[near] == vector[:3]).all(axis=1)]
    if len(at):
        objects = np.searchsorted(mesh.object_vertex_start, at, side="right") - 1
        raise InputError(
            f'light "{light.spec}" lies exactly on a vertex (vertices {first_few(at)}, objects '
            f"{first_few(np.unique(objects))}), where a shadow has no direction. Move it by a "
            "millimetre or more"
        )
