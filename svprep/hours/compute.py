"""Sun hours from beginning to end: surfaces, samples, what is buried, rays, runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from svprep.cache.reader import Cache
from svprep.errors import InputError
from svprep.hours.buried import Burial, burial_of
from svprep.hours.result import PointHours, SunHours
from svprep.hours.sampling import check_spacing, place_samples, plan_samples
from svprep.hours.scene import RayStarts
from svprep.hours.surfaces import Surfaces, surfaces_of
from svprep.hours.tracing import Suns, lit_bits, runs
from svprep.model import F64, U32, Prepared
from svprep.path_names import told_apart
from svprep.rays import Scene, displaced, offset_m, require_embree
from svprep.silhouette.tables import check_mesh, check_plane_of_face

if TYPE_CHECKING:
    from svprep.light import Arc

Progress = Callable[[str, int, int], None]
"""Told what is being done, and how far it is: ``(what, done, of)``."""


def sun_hours(
    cache: Cache | Prepared,
    arc: Arc,
    *,
    spacing_m: float = 1.0,
    on_progress: Progress | None = None,
) -> SunHours:
    """Return how long the sun of `arc` shines on samples of all surfaces of `cache`.

    Parameters
    ----------
    cache : Cache or Prepared
    arc : Arc
        From `svprep.light.parse_arc`.
    spacing_m : float
        [m]: one sample per ``spacing_m**2`` of each object's surfaces of a kind, and at
        least one.
    on_progress : callable, optional
        Told what is being done: ``(what, done, of)``.

    Raises
    ------
    InputError
        `spacing_m` is not a distance above 0, or makes more than 100 million samples;
        steps do not fill the arc.
    EnvironmentProblem
        The package embreex is missing.

    Notes
    -----
    The same input gives the same arrays, whatever the number of threads. About a third of a
    microsecond a ray, a core; 100 bytes a sample, and a bit a sample and step.
    """
    tell = on_progress or (lambda what, done, of: None)
    check_spacing(spacing_m)
    _check_steps(arc)
    receivers = _receivers(cache, tell)
    mesh, surfaces = cache.mesh, receivers.surfaces
    groups = plan_samples(mesh, surfaces, spacing_m)
    n = int(groups.sample_start[-1])
    position, face = place_samples(
        mesh, surfaces, groups, lambda done: tell("samples", done, max(n, 1))
    )
    count = np.diff(groups.sample_start)
    return SunHours(
        arc=arc,
        spacing_m=spacing_m,
        offset_m=receivers.offset_m,
        digest=cache.content_digest if isinstance(cache, Cache) else "",
        object_names=cache.object_names,
        object_types=cache.labels.object_types,
        object_parents=cache.labels.object_parents,
        object_sources=_source_names(cache),
        groups=groups,
        position=position,
        face=face,
        face_normal=surfaces.normal,
        object=np.repeat(groups.object, count),
        kind=np.repeat(groups.kind, count),
        is_on_solid=surfaces.is_solid[face],
        is_stated=surfaces.is_stated[face],
        points=_points(cache, arc, receivers, position, face, tell),
    )


def _source_names(cache: Cache | Prepared) -> tuple[str, ...]:
    """Return the name of the file of each object, by which files can be told apart."""
    names = told_apart([source.path for source in cache.sources])
    return tuple(names[i] for i in cache.object_source.tolist())


def trace_points(
    cache: Cache | Prepared,
    arc: Arc,
    positions: ArrayLike,
    faces: ArrayLike,
    *,
    on_progress: Progress | None = None,
) -> PointHours:
    """Return how long the sun of `arc` shines on given points.

    Parameters
    ----------
    positions : array_like
        ``(n, 3)`` [m] in the cache frame (source coordinates less ``grid.origin_m``).
    faces : array_like
        ``(n,)``: the face of the mesh that each lies on.

    Raises
    ------
    InputError
        A position is not finite, a face does not exist, or they are not as many.
    EnvironmentProblem
        The package embreex is missing.
    """
    position = np.ascontiguousarray(positions, np.float64).reshape(-1, 3)
    given = np.asarray(faces).reshape(-1)
    if len(given) != len(position):
        raise InputError(f"{len(position)} positions, but {len(given)} faces of points")
    if not np.isfinite(position).all():
        raise InputError("a position of a point is not finite")
    n_faces = len(cache.mesh.faces)
    if len(given) and (int(given.min()) < 0 or int(given.max()) >= n_faces):
        raise InputError(f"a point lies on a face that is not there; there are {n_faces:,}")
    tell = on_progress or (lambda what, done, of: None)
    receivers = _receivers(cache, tell)
    return _points(cache, arc, receivers, position, given.astype(np.uint32), tell)


def _check_steps(arc: Arc) -> None:
    """Raise unless the steps fill the arc: each one counts as a whole."""
    # Of time that passes: the difference of two clocks of one zone would be of what they show.
    minutes = (arc.end.timestamp() - arc.begin.timestamp()) / 60.0
    if abs(arc.n_steps * arc.step_minutes - minutes) > 1e-6:
        raise InputError(
            f'light "{arc.spec}": steps of {arc.step_minutes:g} minutes do not fill the '
            f"{minutes:g} minutes from begin to end evenly, so the last one would count too much. "
            "Choose a step that does"
        )


@dataclass(frozen=True, slots=True)
class _Receivers:
    """What every point of a city needs."""

    scene: Scene
    surfaces: Surfaces
    offset_m: float


def _receivers(cache: Cache | Prepared, tell: Progress) -> _Receivers:
    """Return the rays' scene, what each face is, and how far before it rays start."""
    require_embree("svprep hours")
    tell("reading", 0, 2)
    mesh = cache.mesh
    check_mesh(mesh, cache.components)
    check_plane_of_face(cache.planes, len(mesh.faces))
    tell("ray scene", 1, 2)
    scene, offset = Scene(mesh.positions, mesh.faces), offset_m(mesh)
    tell("surfaces", 2, 2)
    return _Receivers(scene, surfaces_of(cache, scene, offset), offset)


def _points(
    cache: Cache | Prepared,
    arc: Arc,
    receivers: _Receivers,
    position: F64,
    face: U32,
    tell: Progress,
) -> PointHours:
    """Return the sun at points on faces whose sides that count are known."""
    grid, scene, surfaces = cache.mesh.grid, receivers.scene, receivers.surfaces
    lights = np.array([light.in_cache_frame(grid) for light in arc.lights], np.float32)
    suns = Suns(lights.reshape(-1, 4), arc.step_of_light, arc.n_steps)
    starts = RayStarts(displaced(position, surfaces.normal[face], receivers.offset_m), face)

    def telling(what: str) -> Callable[[int], None]:
        return lambda done: tell(what, done, len(face))

    burial = burial_of(cache, scene, surfaces, starts, telling("what is buried"))
    is_buried = burial != np.uint8(Burial.NONE)
    started = time.perf_counter()
    bits, n_rays = lit_bits(
        scene, cache.planes, surfaces.side, suns, starts, is_buried, telling("sun rays")
    )
    seconds = time.perf_counter() - started
    total, longest = runs(bits, arc.n_steps)
    return PointHours(
        burial=burial,
        total_steps=total,
        longest_steps=longest,
        bits=bits,
        n_steps=arc.n_steps,
        step_minutes=arc.step_minutes,
        n_suns=len(arc.lights),
        n_rays=n_rays,
        trace_seconds=seconds,
    )
