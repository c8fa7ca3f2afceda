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
from typing import Final

import numpy as np

from svprep.errors import InputError, first_few
from svprep.kernels.clamping import MOST_SEGMENTS, clamp_casters
from svprep.kernels.light_boxes import (
    bound_casters,
    bound_clusters,
    choose_normals,
    place_vertices,
    raise_levels,
)
from svprep.kernels.point_clamping import bound_clusters_in_views, clamp_casters_in_views
from svprep.light import Light
from svprep.model import F32, F64, I16, I64, U32, ClampTable, Components, Grid, Mesh, SceneTree
from svprep.parallel import for_each, for_shares
from svprep.scene_tree import level_starts
from svprep.silhouette.tables import check_mesh, check_starts, contradiction, read_only

LightHook = Callable[[int, int], None]
"""Called with how many lights are done, and of how many."""

_LEAST_PAD_M: Final = 0.0005
_LEAST_SINK: Final = 0.02
"""Sine of the sun's altitude below which no horizontal plane is tried: slopes stay below 50."""
_CHUNK: Final = 4096
"""Casters that a thread takes at a time; sums are taken chunk by chunk, whatever the threads."""


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


@dataclass(frozen=True, slots=True)
class _Scene:
    """What is the same for every light."""

    positions: F32
    faces: U32
    face_start: I64
    """``(n_casters + 1,)``"""
    corners: U32
    """``(n_faces, 3)``: in the order of clusters."""
    cluster_start: I64
    normals: F32
    """``(n_clusters, 3)``: the unit normal of each cluster's largest face."""
    levels: I64
    pad_m: float
    """What float32 rounds in a light frame, and what an edge may be off in a ray tracer."""

    @property
    def n_casters(self) -> int:
        return len(self.face_start) - 1

    @property
    def n_clusters(self) -> int:
        return len(self.cluster_start) - 1


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
    costs = costs or ClampCosts()
    if lights:
        _check_tables(mesh, components, scene)
    vectors = [read_only(light.in_cache_frame(mesh.grid)) for light in lights]
    for light, vector in zip(lights, vectors, strict=True):
        _check_off_vertices(light, vector, mesh)
    shared = _scene(mesh, components, scene) if lights else None
    clamped = []
    for i, vector in enumerate(vectors):
        assert shared is not None
        is_point = vector[3] != 0.0
        clamped.append((_clamp_point if is_point else _clamp_sun)(shared, vector, costs))
        if on_light is not None:
            on_light(i + 1, len(vectors))
    n = len(lights)
    sizes = [len(one.depths) for one in clamped]
    return ClampTable(
        specs=tuple(light.spec for light in lights),
        lights=np.array(vectors, np.float32).reshape(n, 4),
        frames=np.array([one.frame for one in clamped], np.float64).reshape(n, 3, 3),
        facts=np.array([one.facts for one in clamped], np.float64).reshape(n, 5),
        light_start=np.concatenate(([0], np.cumsum(sizes, dtype=np.int64))),
        segment_start=np.array([one.start for one in clamped], np.uint32).reshape(
            n, len(components.flags) + 1
        ),
        depths=np.concatenate([np.empty((0, 2), np.float32), *(one.depths for one in clamped)]),
        slopes=np.concatenate([np.empty((0, 2), np.int16), *(one.slopes for one in clamped)]),
    )


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
    begin, end = table.light_start[chosen], table.light_start[chosen + 1]
    rows = [np.arange(a, b) for a, b in zip(begin.tolist(), end.tolist(), strict=True)]
    segments = np.concatenate([np.empty(0, np.int64), *rows])
    return ClampTable(
        specs=tuple(table.specs[i] for i in lights),
        lights=table.lights[chosen],
        frames=table.frames[chosen],
        facts=table.facts[chosen],
        light_start=np.concatenate(([0], np.cumsum(end - begin))),
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


@dataclass(frozen=True, slots=True)
class _Clamped:
    """One light's part of a `ClampTable`."""

    frame: F64
    facts: F64
    start: U32
    depths: F32
    slopes: I16


def _scene(mesh: Mesh, components: Components, scene: SceneTree) -> _Scene:
    # Read-only, from a build as from a cache: Numba compiles anew for another kind.
    positions, start = read_only(mesh.positions), read_only(scene.cluster_start)
    corners = mesh.faces.take(scene.faces, axis=0)
    normals = np.zeros((len(start) - 1, 3), np.float32)
    for_shares(len(normals), lambda a, b: choose_normals(positions, corners, start, a, b, normals))
    reach = float(np.abs(positions).max()) * math.sqrt(3.0)
    return _Scene(
        positions=positions,
        faces=read_only(mesh.faces),
        face_start=read_only(components.face_start),
        corners=corners,
        cluster_start=start,
        normals=normals,
        levels=level_starts(len(start) - 1),
        pad_m=max(_LEAST_PAD_M, 1e-6 * reach),
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


def _clamp_sun(scene: _Scene, vector: F32, costs: ClampCosts) -> _Clamped:
    """Return the segments of a directional light."""
    frame = light_frame(vector)
    start, pad, levels = scene.face_start, scene.pad_m, scene.levels
    placed = np.empty(scene.positions.shape, np.float32)
    for_shares(len(placed), lambda a, b: place_vertices(scene.positions, frame, a, b, placed))
    blocks = np.empty((int(levels[-1]), 5, 8), np.float32)
    slabs = np.empty((scene.n_clusters, 5), np.float64)
    boxes = np.empty((scene.n_casters, 6), np.float64)

    def bound(a: int, b: int) -> None:
        bound_clusters(
            placed, scene.corners, scene.cluster_start, scene.normals, frame, pad, a, b, blocks,
            slabs,
        )  # fmt: skip

    for_shares(scene.n_clusters, bound)
    raise_levels(levels, len(levels) - 1, scene.n_clusters, blocks)
    for_shares(
        scene.n_casters, lambda a, b: bound_casters(placed, scene.faces, start, pad, a, b, boxes)
    )
    sink = frame[2, 2]
    horizon = -frame[:2, 2] / sink if abs(sink) > _LEAST_SINK else np.zeros(2)
    exit_depth = float(blocks[-1, 4].max())
    prices = np.array([costs.vertex, costs.area])

    def work(a: int, b: int, counts: U32, depths: F32, slopes: I16, areas: F64) -> int:
        return int(
            clamp_casters(
                boxes, start, placed, scene.corners, scene.cluster_start, blocks, slabs, levels,
                len(levels) - 1, horizon, pad, prices, exit_depth, a, b, counts, depths, slopes,
                areas,
            )
        )  # fmt: skip

    return _segments(scene.n_casters, frame, prices, work)


def _clamp_point(scene: _Scene, vector: F32, costs: ClampCosts) -> _Clamped:
    """Return the segments of a point light."""
    positions, pad, levels = scene.positions, scene.pad_m, scene.levels
    blocks = np.empty((6, int(levels[-1]), 5, 8), np.float32)
    nearest = np.empty((6, scene.n_clusters), np.float32)

    def bound(a: int, b: int) -> None:
        bound_clusters_in_views(
            positions, scene.corners, scene.cluster_start, vector, pad, a, b, blocks, nearest
        )

    for_shares(scene.n_clusters, bound)
    for view in blocks:
        raise_levels(levels, len(levels) - 1, scene.n_clusters, view)
    low, high = positions.min(axis=0), positions.max(axis=0)
    away = np.abs(np.stack([low, high]) - vector[:3].astype(np.float64)).max(axis=0)
    exit_distance = float(np.linalg.norm(away))
    prices = np.array([costs.vertex, costs.area])

    def work(a: int, b: int, counts: U32, depths: F32, slopes: I16, areas: F64) -> int:
        return int(
            clamp_casters_in_views(
                positions, scene.faces, scene.face_start, vector, blocks, nearest, levels,
                len(levels) - 1, pad, prices, exit_distance, a, b, counts, depths, slopes, areas,
            )
        )  # fmt: skip

    return _segments(scene.n_casters, light_frame(vector), prices, work)


_Work = Callable[[int, int, U32, F32, I16, F64], int]


def _segments(n_casters: int, frame: F64, prices: F64, work: _Work) -> _Clamped:
    """Return what `work` writes for all casters, chunk by chunk on all threads."""
    cuts = [*range(0, n_casters, _CHUNK), n_casters]
    parts: list[tuple[U32, F32, I16, F64]] = [None] * (len(cuts) - 1)  # type: ignore[list-item]

    def do(chunk: int) -> None:
        a, b = cuts[chunk], cuts[chunk + 1]
        counts = np.empty(b - a, np.uint32)
        depths = np.empty((MOST_SEGMENTS * (b - a), 2), np.float32)
        slopes = np.empty((MOST_SEGMENTS * (b - a), 2), np.int16)
        areas = np.zeros(3)
        n = work(a, b, counts, depths, slopes, areas)
        parts[chunk] = counts, depths[:n].copy(), slopes[:n].copy(), areas

    for_each(len(parts), do)
    areas = np.zeros(3)
    for part in parts:  # in this order, whatever the threads
        areas += part[3]
    counts = np.concatenate([np.zeros(1, np.uint32), *(part[0] for part in parts)])
    return _Clamped(
        frame=frame,
        facts=np.concatenate((prices, areas)),
        start=np.cumsum(counts, dtype=np.uint32),
        depths=np.concatenate([part[1] for part in parts]),
        slopes=np.concatenate([part[2] for part in parts]),
    )
