"""A frame: what is seen, then per light what shadows it, then the light.

    see      faces --> depth, and the visible face of each pixel
    count    per light: volumes against that depth --> how many hold each visible point
    light    lit = nothing counted, and the side seen is the side that faces the light

The order is forced: volumes are counted against the depth of what is seen, and light
asks for the count. Everything that decides facing was uploaded; no shader decides it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np

from svprep.errors import InputError
from svprep.model import BOOL, F32, U8
from svprep_runtime.camera import Camera
from svprep_runtime.eye import eye_count, is_cut_at_near
from svprep_runtime.measure import Meter, PassFigures
from svprep_runtime.near_plane import is_projected, sort_components
from svprep_runtime.passes.counting import Counter, When, count, count_near_plane
from svprep_runtime.passes.lighting import add_ambient, add_light
from svprep_runtime.passes.visible import Faces, displace, see, see_again, settle
from svprep_runtime.scene import Construction, LitScene, Scene
from svprep_runtime.state import PassState, apply
from svprep_runtime.targets import Targets

Method = Literal["auto", "zpass", "zfail", "zp+"]
METHODS: Final[tuple[Method, ...]] = get_args(Method)
BRIGHTNESS: Final = 0.68
"""Of all lights together, on a surface that faces them: with the sky's, just below white."""
SAMPLE_RADIUS_PX: Final = 0.35
LIFT_PX: Final = 1.0 / 512.0
"""How far X is displaced along the normal of its face, in pixels at its depth,"""
LIFT_ULPS: Final = 8.0
"""and at least so many float32 ulps of the model's largest coordinate."""
MOST_LIFT_M: Final = 0.01
"""and at most this: what stands 2 cm above a surface shades it, however far away it is seen."""
MOST_SLANT: Final = 4.0
"""Where X moves along its ray: at most so many times farther than along the normal."""
MOST_SHIFT_PX: Final = 0.25
"""X' lies no farther beside its pixel's centre: of what is metres away it may lie a pixel beside,
and all triangles are drawn wider by as much as any X' lies beside,"""
ROUNDING_PX: Final = 1.0 / 64.0
"""and by this, more than a rasteriser moves corners."""


_ONE_APART: Final = np.array([0.0, 1.0])
_LEVEL: Final = np.array([0.0, 0.0])


@dataclass(frozen=True, slots=True)
class Settings:
    """How to draw: zp+ and the stencil counter are there to compare with.

    All else gives the same shadows, save where the rasteriser's rounding shows through
    (ARCHITECTURE.md, "Pictures").
    """

    method: Method = "auto"
    """``"auto"``: z-pass, which never draws more than z-fail does. Volumes that end at the
    eye, where no rasteriser can be trusted, are counted by z-fail in either."""
    clamp: bool = True
    """Draw clamped volumes for lights whose segments the cache holds."""
    construction: Construction = "vertex"
    counter: Counter = "float"
    """``"stencil"`` counts in 8 bits: 256 layers look like none, and a negative count cannot
    be told from a high one."""
    samples: int = 1
    """Of a pixel, odd: what most of them say is its shadow. 1: its centre."""


@dataclass(frozen=True, slots=True, eq=False)
class Tally:
    """What a frame counted for one light."""

    n_negative: int
    """Pixels (samples, if several) with a count below 0, which is impossible for a volume
    that is closed: the rasteriser took a sliver in the wrong order. They are lit."""
    highest_count: int
    n_clamped_segments: int
    """0 where whole volumes were drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A finished frame. Row 0 is the top."""

    radiance: F32
    """``(height, width, 3)``: linear; see `to_srgb`."""
    is_surface: BOOL
    """``(height, width)``: what is no sky, by the last sample."""
    in_shadow: tuple[BOOL, ...]
    """Per light ``(height, width)``: a surface that it does not reach."""
    tallies: tuple[Tally, ...]
    """Per light."""
    figures: tuple[PassFigures, ...]
    """Of every pass, in their order; empty unless asked for."""

    @property
    def mask(self) -> U8:
        """``(height, width)``: 255 where a surface is reached by no light, else 0."""
        return np.where(np.logical_and.reduce(self.in_shadow), 255, 0).astype(np.uint8)


def render(
    scene: Scene,
    targets: Targets,
    camera: Camera,
    lights: Sequence[F32],
    settings: Settings | None = None,
    *,
    with_figures: bool = False,
) -> Picture:
    """Return the picture of a scene under one or more `lights`, each ``(4,) float32``.

    Parameters
    ----------
    targets : Targets
        Of the camera's size, with as many votes as there are lights.
    lights : sequence of ndarray
        In the cache frame, from `svprep.light.Light.in_cache_frame`.

    Raises
    ------
    InputError
        The settings name something that there is not, a point light lies on a vertex.
    EnvironmentProblem
        The budget of graphics memory is too small.
    """
    if not lights:
        raise InputError("a picture needs at least one light")
    settings = settings or Settings()
    meter = Meter(scene.context, is_on=with_figures)
    tallies = draw(scene, targets, camera, lights, settings, meter)
    return Picture(
        radiance=targets.read_radiance() / np.float32(settings.samples),
        is_surface=targets.read_seen() != 0,
        in_shadow=tuple(2.0 * targets.read_votes(i) > settings.samples for i in range(len(lights))),
        tallies=tallies,
        figures=meter.figures(),
    )


def draw(
    scene: Scene,
    targets: Targets,
    camera: Camera,
    lights: Sequence[F32],
    settings: Settings,
    meter: Meter,
) -> tuple[Tally, ...]:
    """Draw what `render` returns, and leave it in `targets`; return each light's tally.

    Without any light, there is that of the sky.
    """
    checked(settings)
    fits = (camera.width_px, camera.height_px) == (targets.width_px, targets.height_px)
    if not fits or len(lights) > targets.n_lights:
        raise InputError(
            f"these targets are for {targets.width_px}x{targets.height_px} pixels and "
            f"{targets.n_lights} lights, not {camera.width_px}x{camera.height_px} and {len(lights)}"
        )
    apply(scene.context.gl, PassState())  # clearing obeys the scissor and the masks
    lit: list[LitScene] = []
    cut_at_near = is_cut_at_near(scene.cache, camera)
    lift = lift_uniforms(scene, camera)
    if settings.method == "zp+":  # its faces on the near plane are counted at pixels' centres
        lift["most_shift_px"] = 0.0
    negative, highest = [0] * len(lights), [0] * len(lights)
    scene.bind()
    targets.clear_sums()
    for offset in sample_offsets(settings.samples):
        uniforms = {**camera_uniforms(camera, offset), **lift}
        uniforms |= _find_visible(scene, targets, uniforms, settings, meter, cut_at_near)
        with meter.measure("ambient"):
            add_ambient(scene.programs, targets, uniforms)
        # Only now: silhouettes are looked for while the driver draws what is seen.
        lit = lit or [scene.lit_by(light, clamped=settings.clamp) for light in lights]
        for i, lit_scene in enumerate(lit):
            of_light = {**uniforms, **lit_scene.uniforms, "brightness": BRIGHTNESS / len(lit)}
            scene.bind_light(lit_scene)
            _count(scene, targets, camera, lit_scene, settings, of_light, meter, i, cut_at_near)
            scene.tally.write(bytes(16))
            with meter.measure("light", i):
                add_light(scene.programs, targets, i, of_light, settings.counter)
            below, most = scene.read_tally()
            negative[i] += below
            highest[i] = max(highest[i], most)
    return tuple(
        Tally(n, most, len(x.segments.table) - 1 if x.segments.is_clamped else 0)
        for n, most, x in zip(negative, highest, lit, strict=True)
    )


def _find_visible(
    scene: Scene,
    targets: Targets,
    uniforms: dict[str, Any],
    settings: Settings,
    meter: Meter,
    cut_at_near: bool,
) -> dict[str, float]:
    """Find each pixel's visible face, and where volumes are counted for it; say how wide."""
    faces = Faces(scene.n_faces, cut_at_near, settings.construction != "vertex")
    with meter.measure("see"):
        see(scene.programs, targets, uniforms, faces)
    scene.tally.write(bytes(16))
    with meter.measure("displace"):
        displace(scene.programs, targets, uniforms)
    shift_px = scene.read_shift_px()
    wide = {"most_shift_px": shift_px, "wider_px": shift_px + ROUNDING_PX}
    with meter.measure("see again"):
        see_again(scene.programs, targets, uniforms | wide, faces)
    with meter.measure("settle"):
        settle(scene.programs, targets, uniforms | wide)
    return wide


def _count(
    scene: Scene,
    targets: Targets,
    camera: Camera,
    lit: LitScene,
    settings: Settings,
    uniforms: dict[str, Any],
    meter: Meter,
    light: int,
    cut_at_near: bool,
) -> None:
    """Fill the count: how many volumes of a light hold the visible point of each pixel."""
    targets.bind(targets.count_into)
    scene.context.gl.glBindTextureUnit(2, targets.displaced)

    def draw(
        when: When, chosen: BOOL | None, *, own_caps: bool, whole: bool = False, name: str
    ) -> None:
        batch = scene.batch(lit, settings.construction, chosen, whole=whole)
        scene.bind_batch(batch)
        with meter.measure(name, light):
            count(
                scene.programs,
                uniforms,
                batch.draws,
                settings.counter,
                when,
                with_own_caps=own_caps,
            )

    method = settings.method
    if method == "zp+" and not is_projected(lit.casters.light, camera):
        method = "zpass"
    match method:
        case "zfail":
            targets.clear_count(0, settings.counter)
            draw("behind", None, own_caps=True, name="z-fail")
        case "zpass" | "auto":
            reach_m = uniforms["reach_m"]
            around = eye_count(scene.cache, lit.casters, lit.segments, camera.eye, reach_m)
            chosen = None
            if len(around.close):
                chosen = np.ones(len(lit.casters.is_closed), bool)
                chosen[around.close] = False
            targets.clear_count(around.n_around, settings.counter)
            # Own caps lie before what is seen only where faces were cut away at the near plane.
            draw("before", chosen, own_caps=cut_at_near, name="z-pass")
            if chosen is not None:
                draw("behind", ~chosen, own_caps=True, name="z-fail")
        case "zp+":
            targets.clear_count(0, settings.counter)
            inside, outside, ending = sort_components(
                lit.casters, lit.segments, camera, uniforms["reach_m"]
            )
            caster = scene.batch(lit, "vertex", inside | ending, near_plane=True)
            scene.bind_batch(caster)
            with meter.measure("near plane", light):
                count_near_plane(scene.programs, uniforms, caster.draws, settings.counter)
            draw("before, cut at near", inside | outside, own_caps=False, name="zp+")
            if ending.any():
                draw("before, cut at near", ending, own_caps=False, whole=True, name="zp+, whole")


def checked(settings: Settings) -> Settings:
    """Return `settings`, or raise `InputError` where they name nothing that there is."""
    if settings.method not in METHODS:
        raise InputError(f"there is no method {settings.method!r}; there are: {', '.join(METHODS)}")
    if settings.construction not in get_args(Construction):
        raise InputError(
            f"there is no construction {settings.construction!r}; there are: "
            f"{', '.join(get_args(Construction))}"
        )
    if settings.counter not in get_args(Counter):
        raise InputError(f"there is no counter {settings.counter!r}; there are: float, stencil")
    if settings.samples < 1 or settings.samples % 2 == 0:
        raise InputError(f"{settings.samples} samples have no majority; an odd number has")
    return settings


def camera_uniforms(camera: Camera, offset_px: tuple[float, float] = (0.0, 0.0)) -> dict[str, Any]:
    """Return what shaders ask of the camera; `offset_px` of the sample from the centre."""
    right, up, forward = (tuple(row.tolist()) for row in camera.rows)
    below = float(camera.height_px)
    ray, ray_beside, ray_above = camera.directions(
        np.array([0.0, 1.0, 0.0]), np.array([below, below, below - 1.0])
    )
    return {
        "ray_corner": tuple(ray.tolist()),
        "ray_right": tuple((ray_beside - ray).tolist()),
        "ray_up": tuple((ray_above - ray).tolist()),
        "offset_px": offset_px,
        "size_px": (float(camera.width_px), float(camera.height_px)),
        "eye": tuple(camera.eye.tolist()),
        "row_right": right,
        "row_up": up,
        "row_forward": forward,
        "near_m": float(np.float32(camera.near_m)),
        "jitter": (
            2.0 * offset_px[0] / camera.width_px,
            2.0 * offset_px[1] / camera.height_px,
        ),
    }


def lift_uniforms(scene: Scene, camera: Camera) -> dict[str, float]:
    """Return how far X is displaced, and by how much segments and triangles are larger for it."""
    least_m = LIFT_ULPS * scene.ulp_m
    a_pixel = float(np.linalg.norm(np.diff(camera.directions(_ONE_APART, _LEVEL), axis=0)))
    farthest = float(((scene.corners - camera.eye) @ camera.forward).max())
    most_m = max(MOST_LIFT_M, least_m)
    reached_m = min(max(LIFT_PX * a_pixel * farthest, least_m), most_m)
    return {
        "lift_px": LIFT_PX,
        "least_lift_m": least_m,
        "most_slant": MOST_SLANT,
        "most_shift_px": MOST_SHIFT_PX,
        "wider_px": ROUNDING_PX,
        "most_lift_m": most_m,
        "reach_m": MOST_SLANT * reached_m,
    }


def sample_offsets(n: int) -> list[tuple[float, float]]:
    """Return where n samples of a pixel lie, from its centre [pixels].

    A regular polygon: no line meets more than two of its corners, so that with five or
    more what most of them say cannot be misled by anything as thin as a line: a strip
    that holds three of five is at least 0.24 pixels wide.
    """
    if n == 1:
        return [(0.0, 0.0)]
    angles = [2.0 * math.pi * (k + 0.13) / n for k in range(n)]
    return [(SAMPLE_RADIUS_PX * math.sin(a), SAMPLE_RADIUS_PX * math.cos(a)) for a in angles]


def to_srgb(radiance: F32) -> U8:
    """Return ``(height, width, 3) uint8``: gamma-encoded, clipped."""
    value = np.clip(radiance, 0.0, 1.0)
    curve = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1.0 / 2.4) - 0.055)
    return np.rint(255.0 * curve).astype(np.uint8)
