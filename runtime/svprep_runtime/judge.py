r"""Which pixels of a view are in shadow, by rays alone: the judge of rendered masks.

    eye .               . light
         \            /
          \         /        the shadow ray starts at X', which is X displaced
           \      /          by the offset along f's normal, to the eye's side
            \  X'
    _________\_X_________ face f

**Definition.** The visible point X of a pixel lies on face f. It is lit iff the eye and the
light are strictly on the same side of f's plane and the open segment from X, displaced to
the eye's side, to the light meets no face. On which side the light is, `svprep.facing` says,
of f's plane record; on which the eye is, f's own plane, whose normal is exact in float64.

**What is seen.** Rays start at the near plane: what lies before it is not seen, and casts
shadows all the same. Embree finds the face, which for a pixel's centre is decided in float64
(`judge_primary`); X is where the float64 ray meets its plane. A ray has no point, and so no
shadow, where it meets nothing; one beside the centre has none either where its face is
edge-on to the eye, and where that plane meets it before the near plane.

**Decidable** is a surface pixel whose shadow is the same for all of: its centre; eight points
around it; a ten times larger displacement of X, and the least that float32 allows; eight
lights turned a little (`judge_constants`). A point around it that has no shadow, such as sky,
disagrees. A lamp is turned as seen from X, at its distance, and its side of f's plane is
decided anew each time; its segments end the offset before it.

A point is not asked further once it disagrees, which changes nothing but the time. What
threads do depends on their pixels only. `validate --shadows` and the tests use it; the plain
twin is in ``tests/unit/test_judge.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.facing import checked_light, facing
from svprep.model import BOOL, F32, F64, I8, I32, I64, U8, U32, Mesh, PlaneTable
from svprep.rays import RAYS_AT_ONCE, Scene, for_batches, offset_m, require_embree
from svprep_runtime.camera import Camera
from svprep_runtime.judge_constants import (
    CENTRE_ULPS,
    FAR_OFFSET,
    JUDGE_CONSTANTS,
    LEAST_OFFSET_M,
    LIGHT_JITTER_RAD,
    N_LIGHT_JITTERS,
    OFFSET_ULPS,
    PIXEL_JITTER_PX,
    PIXEL_JITTERS,
)
from svprep_runtime.judge_overlaps import Fan, Shapes, overlaps_by_name
from svprep_runtime.judge_primary import Sight, first_in_place
from svprep_runtime.judge_report import (
    Comparison,
    Overlap,
    Truth,
    compare,
    difference_picture,
    load_truth,
    save_truth,
)

__all__ = [
    "JUDGE_CONSTANTS",
    "Comparison",
    "Judge",
    "Overlap",
    "Truth",
    "compare",
    "difference_picture",
    "load_truth",
    "save_truth",
]

Step = Callable[[str, int, int], None]
"""Told what is being done, and how far it is: ``(what, done, of)``."""

_LIT: Final = np.uint8(0)
_SHADOW: Final = np.uint8(1)
_NONE: Final = np.uint8(2)
"""Of a ray that sees no point. It equals no state of a pixel that is asked further."""


class Judge:
    """All faces of a city, ready to be looked at.

    Parameters
    ----------
    mesh, planes
        Of a cache or of a prepared city.
    object_names : sequence of str
        ``(n_objects,)``: how overlaps are listed.

    Raises
    ------
    EnvironmentProblem
        The package embreex is missing.

    Notes
    -----
    Building takes about 5 us a face, most of it Embree's two hierarchies.
    """

    __slots__ = (
        "_fan",
        "_first_in_place",
        "_mesh",
        "_names",
        "_planes",
        "_scene",
        "_shapes",
        "nearest",
        "offset_m",
    )

    offset_m: float
    """[m]: how far a visible point is displaced."""
    nearest: float
    """Of the offset: as near to the surface as float32 can start a ray."""

    def __init__(self, mesh: Mesh, planes: PlaneTable, object_names: tuple[str, ...]) -> None:
        require_embree("judging shadows")
        self.offset_m = offset_m(mesh, LEAST_OFFSET_M, OFFSET_ULPS)
        self.nearest = offset_m(mesh, 0.0, CENTRE_ULPS) / self.offset_m
        self._mesh, self._planes, self._names = mesh, planes, tuple(object_names)
        self._scene = Scene(mesh.positions, mesh.faces)
        self._first_in_place = first_in_place(mesh.positions, mesh.faces)
        self._shapes = Shapes.of(mesh)
        self._fan = Fan(mesh, self._shapes, self.offset_m, self._scene.device)

    def truth(self, camera: Camera, light: F32, on_step: Step | None = None) -> Truth:
        """Return which pixels of `camera` are in shadow from `light`, and which can be told.

        Parameters
        ----------
        light : ndarray
            ``(4,) float32``, in the cache frame.
        on_step : callable, optional
            Told how many pixels are done: ``("judging", done, of)``.

        Raises
        ------
        InputError
            `light` is none.

        Notes
        -----
        27 rays a pixel that is decidable, fewer for others. The same for any number of
        threads.
        """
        width, height = camera.width_px, camera.height_px
        n = width * height
        view = self._view(camera, checked_light(light))
        first, is_cut = np.full(n, -1, np.int32), np.zeros(n, bool)
        face = np.full(n, -1, np.int32)
        in_shadow, is_decidable = np.zeros(n, bool), np.zeros(n, bool)
        met: dict[int, I64] = {}  # by where a batch begins

        def rays_of(begin: int, end: int) -> F64:
            row, column = np.divmod(np.arange(begin, end), width)
            return camera.directions(column.astype(np.float64) + 0.5, row + np.float64(0.5))

        def find(begin: int, end: int) -> None:
            first[begin:end], is_cut[begin:end] = view.sight.first(rays_of(begin, end))

        def judge(begin: int, end: int) -> None:
            rays = rays_of(begin, end)
            seen = _seen(view, rays, view.sight.shown(first, is_cut, width, begin, rays))
            face[begin:end] = seen.face
            state = _states(self._scene, view, seen)
            in_shadow[begin:end] = (seen.face >= 0) & (state != _LIT)
            asked = np.flatnonzero(state != _NONE)
            is_decidable[begin + self._agreeing(view, seen, rays, state, asked)] = True
            met[begin] = self._fan.met(rays[asked], seen.face[asked], seen.point[asked])

        for_batches(n, RAYS_AT_ONCE, find, lambda _: None)
        for_batches(
            n, RAYS_AT_ONCE, judge, lambda done: on_step("judging", done, n) if on_step else None
        )
        shape = (height, width)
        return Truth(
            in_shadow=in_shadow.reshape(shape),
            is_surface=(face >= 0).reshape(shape),
            is_decidable=is_decidable.reshape(shape),
            face=face.reshape(shape),
            overlaps=overlaps_by_name(met, self._names),
        )

    def _view(self, camera: Camera, light: F32) -> _View:
        """Return the view of a camera and a light."""
        shapes, planes = self._shapes, self._planes
        eye = camera.eye.astype(np.float64)
        height = np.einsum("ij,ij->i", shapes.normal, eye - shapes.corner)
        side = np.sign(height).astype(np.int8)
        lights = light[None] if light[3] != 0.0 else _turned_suns(light)
        is_facing = [facing(planes.planes, one)[planes.plane_of_face] == side for one in lights]
        first, right, down = camera.directions(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
        sight = Sight(
            scene=self._scene,
            first_in_place=self._first_in_place,
            positions=self._mesh.positions,
            corners=self._mesh.faces,
            planes=np.column_stack([shapes.normal, height, side * self.offset_m / shapes.length]),
            eye=eye,
            near_m=camera.near_m,
            right_px=right - first,
            down_px=down - first,
            step_m=self.offset_m,
        )
        return _View(
            sight=sight,
            lights=lights,
            is_facing_eye_side=np.array(is_facing).reshape(len(lights), -1),
            plane_of_face=planes.plane_of_face,
            planes=planes.planes,
            eye_side=side,
            offset_m=self.offset_m,
        )

    def _agreeing(self, view: _View, seen: _Seen, rays: F64, state: U8, asked: I64) -> I64:
        """Return the rows of `asked` for which nothing disagrees with `state`.

        Points around the pixel first: most undecidable pixels lie at edges in the picture.
        """
        for x, y in PIXEL_JITTERS:
            sight = view.sight
            around = rays[asked] + PIXEL_JITTER_PX * (x * sight.right_px + y * sight.down_px)
            states = _states(self._scene, view, _seen(view, around, sight.first(around)[0]))
            asked = asked[states == state[asked]]
        far = seen.at(asked)
        asked = asked[_states(self._scene, view, far, FAR_OFFSET) == state[asked]]
        near = seen.at(asked)
        asked = asked[_states(self._scene, view, near, self.nearest) == state[asked]]
        for nth in range(N_LIGHT_JITTERS):
            near = seen.at(asked)
            asked = asked[_states(self._scene, view, near, 1.0, nth + 1) == state[asked]]
        return asked


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """What every ray of a picture needs."""

    sight: Sight
    lights: F32
    """``(1 + N_LIGHT_JITTERS, 4)``: the light, and a sun's turned ones."""
    is_facing_eye_side: BOOL
    """``(n_lights, n_faces)``: whether each of those is on the eye's side, strictly so
    if the eye is: a face that is edge-on to it shows no point."""
    plane_of_face: U32
    planes: F64
    eye_side: I8
    """``(n_faces,)``: -1, 0, +1."""
    offset_m: float


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What rays of the camera meet."""

    face: I32
    """``(n,)``, -1 for none."""
    has_point: BOOL
    """``(n,)``"""
    point: F64
    """``(n, 3)`` [m]: X; anything where there is none."""
    lift: F64
    """``(n, 3)`` [m]: the offset along the unit normal, to the eye's side."""

    def at(self, rows: I64) -> _Seen:
        """Return those of `rows`."""
        return _Seen(self.face[rows], self.has_point[rows], self.point[rows], self.lift[rows])


def _seen(view: _View, rays: F64, face: I32) -> _Seen:
    """Return what is seen of `face` ``(n,)`` along rays ``(n, 3)`` of view depth 1."""
    depth, record = view.sight.depth(rays, face)
    has_point = (face >= 0) & (depth >= view.sight.near_m) & np.isfinite(depth)
    depth[~has_point] = view.sight.near_m
    point = rays * depth[:, None]
    point += view.sight.eye
    return _Seen(face, has_point, point, record[:, :3] * record[:, 4:])


def _states(
    scene: Scene, view: _View, seen: _Seen, n_offsets: float = 1.0, nth_light: int = 0
) -> U8:
    """Return ``(n,) uint8``: lit, in shadow or none, of what is seen, under the n-th light.

    Light 0 is the light itself, those from 1 on are turned.
    """
    state = np.where(seen.has_point, _SHADOW, _NONE)
    if not len(view.eye_side):
        return state
    lamp = view.lights[0, 3] != 0.0
    at: F64 | None = None
    if lamp and nth_light:
        at = _turned_lamps(view.lights[0, :3].astype(np.float64), seen.point, nth_light - 1)
        same_side = _sides(view, seen.face, at) == view.eye_side.take(seen.face, mode="wrap")
    else:
        same_side = view.is_facing_eye_side[nth_light].take(seen.face, mode="wrap")
    asked = np.flatnonzero(seen.has_point & same_side)
    starts = (seen.point[asked] + n_offsets * seen.lift[asked]).astype(np.float32)
    if lamp:
        ends = view.lights[0, :3].astype(np.float64) if at is None else at[asked]
        # Ended as far before the lamp as it starts from the surface: the least displacement
        # finds what stands right before the lamp, and then the pixel cannot be told.
        is_blocked = _is_blocked_before(scene, starts, ends, min(n_offsets, 1.0) * view.offset_m)
    else:
        is_blocked = scene.is_blocked(starts, view.lights[nth_light, :3])
    state[asked[~is_blocked]] = _LIT
    return state


def _is_blocked_before(scene: Scene, starts: F32, lamps: F64, offset: float) -> BOOL:
    """Return whether faces lie between `starts` and lamps, the last `offset` [m] excepted.

    A start that is no farther from its lamp than that has nothing between them.
    """
    away = lamps - starts
    length = np.linalg.norm(away, axis=1)
    rows = np.flatnonzero(length > offset)
    is_blocked = np.zeros(len(starts), bool)
    far = (1.0 - offset / length[rows]).astype(np.float32)
    is_blocked[rows] = scene.is_blocked(starts[rows], away[rows].astype(np.float32), far)
    return is_blocked


def _sides(view: _View, face: I32, lamps: F64) -> I8:
    """Return `svprep.facing.facing` of each face's record and a lamp of its own ``(n, 3)``."""
    plane = view.planes.take(view.plane_of_face.take(face, mode="wrap"), axis=0)
    value = plane[:, 0] * lamps[:, 0] + plane[:, 1] * lamps[:, 1] + plane[:, 2] * lamps[:, 2]
    return np.sign(value + plane[:, 3]).astype(np.int8)


def _turned_suns(light: F32) -> F32:
    """Return ``(1 + n, 4)``: a directional light, and the same turned n ways."""
    towards = light[None, :3].astype(np.float64)
    turned = [_turned(towards, nth) for nth in range(N_LIGHT_JITTERS)]
    suns = np.zeros((1 + N_LIGHT_JITTERS, 4), np.float32)
    suns[0] = light
    suns[1:, :3] = np.concatenate(turned)
    return suns


def _turned_lamps(lamp: F64, points: F64, nth: int) -> F64:
    """Return ``(n, 3)`` [m]: a lamp ``(3,)`` turned about each of `points`."""
    return points + _turned(lamp - points, nth)


def _turned(towards: F64, nth: int) -> F64:
    """Return vectors ``(n, 3)`` turned by `LIGHT_JITTER_RAD` the n-th way, of the same length.

    Two axes across each one after Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
    """
    length = np.linalg.norm(towards, axis=1)
    x, y, z = towards.T / np.where(length > 0.0, length, 1.0)
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    angle = 2.0 * math.pi * nth / N_LIGHT_JITTERS
    u, v = math.cos(angle), math.sin(angle)
    across = np.stack(
        [
            u * (1.0 + sign * x * x * a) + v * b,
            u * sign * b + v * (sign + y * y * a),
            -u * sign * x - v * y,
        ],
        axis=1,
    )
    across *= (math.sin(LIGHT_JITTER_RAD) * length)[:, None]
    across += math.cos(LIGHT_JITTER_RAD) * towards
    return across
