"""Frames of one view, drawn every way by turns."""

from __future__ import annotations

import gc
import itertools
import math
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from svprep.model import BOOL, F32
from svprep_runtime.camera import Camera
from svprep_runtime.eye import is_cut_at_near
from svprep_runtime.frame import Method, Settings, camera_uniforms, draw, lift_uniforms
from svprep_runtime.measure import Meter, PassFigures
from svprep_runtime.passes.counting import Counter
from svprep_runtime.passes.lighting import add_ambient, add_light
from svprep_runtime.passes.visible import Faces, see
from svprep_runtime.scene import Construction, Scene
from svprep_runtime.targets import Targets

PLAIN: Final = "without shadows"
MAP: Final = "shadow map"
VOLUMES: Final[dict[str, tuple[Construction, bool]]] = {
    "each triangle": ("triangles", False),
    "silhouettes": ("vertex", False),
    "silhouettes, geometry shader": ("geometry", False),
    "silhouettes, clamped": ("vertex", True),
}
"""How volumes are made: construction, clamped."""
_COUNTING: Final = ("z-pass", "z-fail", "map")
"""Passes that only shadows need, and whose triangles and samples are reported."""


@dataclass(frozen=True, slots=True)
class Way:
    """One way to draw a frame."""

    volumes: str
    """Of `VOLUMES`, or `PLAIN` or `MAP`."""
    method: Method = "zpass"
    counter: Counter = "float"

    def __str__(self) -> str:
        method = f", {self.method}, {self.counter}" if self.is_counted else ""
        return f"{self.volumes}{method}"

    @property
    def is_counted(self) -> bool:
        """Whether it draws shadow volumes."""
        return self.volumes in VOLUMES


@dataclass(slots=True)
class WayFigures:
    """What frames of one way cost."""

    way: Way
    first_ms: float = math.nan
    """Of the first frame, which compiles and uploads."""
    frame_ms: list[float] = field(default_factory=list)
    """By the clock, of the later ones; of the first, if it was the only one."""
    count_ms: list[float] = field(default_factory=list)
    """Of the same frames: the passes that count."""
    n_triangles: int = 0
    n_updates: int = 0
    n_negative: int = 0
    n_differing: int = 0
    """Surface pixels whose shadow is not that of the view's first way with shadows."""
    passes: list[str] = field(default_factory=list)

    @property
    def median_ms(self) -> float:
        """Of a frame."""
        return statistics.median(self.frame_ms)

    @property
    def median_count_ms(self) -> float:
        """Of the passes that count."""
        return statistics.median(self.count_ms)


@dataclass(slots=True)
class ViewFigures:
    """All ways of one view."""

    name: str
    n_surface: int
    """Pixels that are not sky."""
    ways: list[WayFigures]
    map_texel_m: float = math.nan

    @property
    def plain(self) -> WayFigures:
        """Of the frame without shadows."""
        return self.ways[0]


Drawer = Callable[[Meter], int]
"""Draws a frame, returns its negative pixels."""


def ways_of(methods: Sequence[Method], counters: Sequence[Counter], *, with_map: bool) -> list[Way]:
    """Return every way, that without shadows first."""
    counted = [Way(v, m, c) for v, m, c in itertools.product(VOLUMES, methods, counters)]
    return [Way(PLAIN), *([Way(MAP)] if with_map else []), *counted]


def measure_view(
    name: str,
    scene: Scene,
    targets: Targets,
    camera: Camera,
    light: F32,
    ways: Sequence[Way],
    rounds: int,
    most_s: float,
    draw_map: Drawer | None = None,
) -> ViewFigures:
    """Draw a view every way, `rounds` times by turns.

    A way whose frames took `most_s` together is drawn no more: volumes of each triangle
    can take minutes. Before its measured frames every way draws one that is not.
    """
    figures = [WayFigures(way) for way in ways]
    spent_s = [0.0] * len(ways)
    shadows: list[BOOL] = []
    is_surface = np.zeros((targets.height_px, targets.width_px), bool)
    for turn in range(rounds + 1):
        for i, found in enumerate(figures):
            if spent_s[i] > most_s and found.frame_ms:
                continue
            drawer = _drawer(found.way, scene, targets, camera, light, draw_map)
            took_ms, passes, n_negative = _timed(scene, drawer)
            spent_s[i] += took_ms / 1e3
            counting = [p for p in passes if p.name in _COUNTING]
            if turn == 0:
                found.first_ms = took_ms
                found.n_triangles = sum(p.n_primitives for p in counting)
                found.n_updates = sum(p.n_samples for p in counting)
                found.n_negative = n_negative
                found.passes = [p.name for p in counting]
                is_surface = targets.read_seen() != 0
                shadows.append((targets.read_votes(0) > 0.5) & is_surface)
            is_only = turn == 0 and (rounds == 0 or spent_s[i] > most_s)
            if turn > 0 or is_only:
                found.frame_ms.append(took_ms)
                found.count_ms.append(sum(p.wall_ms for p in counting))
            print(f"{name}, {found.way}: {took_ms:.0f} ms", file=sys.stderr, flush=True)
    exact = next((i for i, way in enumerate(ways) if way.is_counted), 0)
    for found, shadow in zip(figures, shadows, strict=True):
        found.n_differing = int((shadow != shadows[exact]).sum())
    return ViewFigures(name, int(is_surface.sum()), figures)


def _timed(scene: Scene, drawer: Drawer) -> tuple[float, tuple[PassFigures, ...], int]:
    """Draw once; return the milliseconds, the passes, and how many pixels are negative."""
    gc.collect()
    meter = Meter(scene.context, is_on=True)
    scene.context.gl.glFinish()
    begun = time.perf_counter()
    n_negative = drawer(meter)
    scene.context.gl.glFinish()
    took_ms = 1e3 * (time.perf_counter() - begun)
    return took_ms, meter.figures(), n_negative


def _drawer(
    way: Way,
    scene: Scene,
    targets: Targets,
    camera: Camera,
    light: F32,
    draw_map: Drawer | None,
) -> Drawer:
    """Return what draws a frame in one way."""
    if way.volumes == PLAIN:
        return lambda meter: draw_plain(scene, targets, camera, light, meter)
    if way.volumes == MAP:
        if draw_map is None:
            raise ValueError("a shadow map is asked for, and nothing that draws one is given")
        return draw_map
    construction, is_clamped = VOLUMES[way.volumes]
    settings = Settings(way.method, is_clamped, construction, way.counter)
    return lambda meter: draw(scene, targets, camera, [light], settings, meter)[0].n_negative


def see_ambient(scene: Scene, targets: Targets, camera: Camera, meter: Meter) -> dict[str, object]:
    """Draw what a frame has before its shadows; return the uniforms."""
    scene.bind()
    targets.clear_sums()
    uniforms = {**camera_uniforms(camera), **lift_uniforms(scene, camera)}
    with meter.measure("see"):
        faces = Faces(scene.n_faces, is_cut_at_near(scene.cache, camera))
        see(scene.programs, targets, uniforms, faces)
    with meter.measure("ambient"):
        add_ambient(scene.programs, targets, uniforms)
    return uniforms


def draw_plain(scene: Scene, targets: Targets, camera: Camera, light: F32, meter: Meter) -> int:
    """Draw a frame whose light reaches all that faces it."""
    uniforms = see_ambient(scene, targets, camera, meter)
    lit = scene.lit_by(light, clamped=False)
    scene.bind_light(lit)
    targets.clear_count(0, "float")
    with meter.measure("light", 0):
        of_light = {**uniforms, **lit.uniforms, "brightness": 0.8}
        add_light(scene.programs, targets, 0, of_light, "float")
    return 0
