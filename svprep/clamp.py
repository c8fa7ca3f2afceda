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

from svprep.clamp_changes import PreviousClamp, pad_of, segments_after
from svprep.clamp_views import ClampScene, LampView, SunView
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


def clamp_lights(
    mesh: Mesh,
    components: Components,
    scene: SceneTree,
    lights: Sequence[Light],
    costs: ClampCosts | None = None,
    on_light: LightHook | None = None,
    previous: PreviousClamp | None = None,
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
    previous : PreviousClamp, optional
        Of an earlier state of the scene: casters that meet nothing that changed take over
        what it holds. The outcome is the same without.

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
    costs = costs or ClampCosts()
    if lights:
        _check_tables(mesh, components, scene)
    vectors = [read_only(light.in_cache_frame(mesh.grid)) for light in lights]
    for light, vector in zip(lights, vectors, strict=True):
        _check_off_vertices(light, vector, mesh)
    shared = _scene(mesh, components, scene) if lights else None
    prices = np.array([costs.vertex, costs.area])
    clamped, facts = [], []
    for i, vector in enumerate(vectors):
        assert shared is not None
        view = _view(shared, vector)
        segments = None
        if previous is not None:
            segments = segments_after(previous, view, vector, prices, components, scene)
        clamped.append(segments or view.segments(prices))
        facts.append([*prices, *view.surfaces(clamped[-1])])
        if on_light is not None:
            on_light(i + 1, len(vectors))
    n, n_casters = len(lights), len(components.flags)
    starts = np.zeros((n, n_casters + 1), np.uint32)
    for i, one in enumerate(clamped):
        np.cumsum(one.counts, out=starts[i, 1:])
    sizes = [len(one.depths) for one in clamped]
    return ClampTable(
        specs=tuple(light.spec for light in lights),
        lights=np.array(vectors, np.float32).reshape(n, 4),
        frames=np.array([light_frame(vector) for vector in vectors], np.float64).reshape(n, 3, 3),
        facts=np.array(facts, np.float64).reshape(n, 5),
        light_start=np.concatenate(([0], np.cumsum(sizes, dtype=np.int64))),
        segment_start=starts,
        depths=np.concatenate([np.empty((0, 2), np.float32), *(one.depths for one in clamped)]),
        slopes=np.concatenate([np.empty((0, 2), np.int16), *(one.slopes for one in clamped)]),
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


def _scene(mesh: Mesh, components: Components, scene: SceneTree) -> ClampScene:
    return ClampScene(
        positions=read_only(mesh.positions),
        faces=read_only(mesh.faces),
        face_start=read_only(components.face_start),
        order=read_only(scene.faces),
        cluster_start=read_only(scene.cluster_start),
        pad_m=pad_of(max(float(mesh.positions.max()), -float(mesh.positions.min()))),
    )


def _check_tables(mesh: Mesh, components: Components, scene: SceneTree) -> None:
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
