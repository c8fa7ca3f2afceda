"""From a cache file to a finished picture, headless: what ``svprep render`` does.

cache --> context --> scene --> picture --> PNG, mask, statistics
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from svprep.cache.reader import Cache
from svprep.light import Light
from svprep.model import F32, Grid
from svprep_runtime.camera import Camera, default_camera, parse_camera
from svprep_runtime.context import Context, headless
from svprep_runtime.frame import Picture, Settings, render
from svprep_runtime.residency import DEFAULT_BUDGET_BYTES
from svprep_runtime.scene import Scene
from svprep_runtime.targets import Targets


@dataclass(frozen=True, slots=True)
class Request:
    """What to draw of a cache."""

    lights: tuple[Light, ...]
    camera: str | None
    """`svprep_runtime.camera.FORM`; None: all of the model."""
    width_px: int
    height_px: int
    settings: Settings = field(default_factory=Settings)
    budget_bytes: int = DEFAULT_BUDGET_BYTES
    with_figures: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A picture and what it took."""

    picture: Picture
    camera: Camera
    context: Context
    used_bytes: int
    """Of graphics memory, in buffers."""
    seconds: dict[str, float]
    """Of each step."""


@contextmanager
def scene_of(cache: Cache, budget_bytes: int = DEFAULT_BUDGET_BYTES) -> Iterator[Scene]:
    """Yield a cache in the graphics memory of a context without a window.

    Raises
    ------
    EnvironmentProblem
        There is no OpenGL, it lacks what is needed, or the budget is too small.
    CacheError
        The cache is damaged.
    """
    with headless() as context, Scene(context, cache, budget_bytes) as scene:
        yield scene


def draw_cache(cache: Cache, request: Request) -> Drawn:
    """Draw a cache once.

    Raises
    ------
    InputError, EnvironmentProblem, CacheError
        As `scene_of`, `parse_camera` and `render` say.
    """
    seconds: dict[str, float] = {}
    begun = time.perf_counter()

    def lap(name: str) -> None:
        nonlocal begun
        now = time.perf_counter()
        seconds[name] = now - begun
        begun = now

    camera = camera_of(cache, request)
    lights = [light.in_cache_frame(cache.grid) for light in request.lights]
    lap("read")
    with scene_of(cache, request.budget_bytes) as scene:
        lap("open OpenGL, upload")
        targets = Targets(scene.context, camera.width_px, camera.height_px, len(lights))
        try:
            picture = render(
                scene,
                targets,
                camera,
                lights,
                request.settings,
                with_figures=request.with_figures,
            )
        finally:
            targets.release()
        lap("draw")
        return Drawn(picture, camera, scene.context, scene.memory.used_bytes, seconds)


def camera_of(cache: Cache, request: Request) -> Camera:
    """Return the camera that a request names."""
    if request.camera is None:
        return default_camera(box_corners(cache), request.width_px, request.height_px)
    return parse_camera(request.camera, cache.grid, request.width_px, request.height_px)


def box_corners(cache: Cache) -> F32:
    """Return ``(8 n, 3)`` [m]: the corners of the boxes of objects, cache frame."""
    boxes = cache.scene.object_boxes
    boxes = boxes[boxes[:, 0] <= boxes[:, 3]]
    return np.concatenate([boxes[:, [i, j, k]] for i in (0, 3) for j in (1, 4) for k in (2, 5)])


def camera_text(camera: Camera, grid: Grid) -> str:
    """Return ``EX,EY,EZ,TX,TY,TZ,FOV`` in input coordinates, to within a millimetre."""
    eye = camera.eye.astype(np.float64) + grid.origin_m
    target = eye + 100.0 * camera.forward
    fov_deg = 2.0 * math.degrees(math.atan(1.0 / float(np.linalg.norm(camera.rows[1]))))
    return ",".join(f"{x:.3f}" for x in (*eye, *target)) + f",{fov_deg:.6g}"
