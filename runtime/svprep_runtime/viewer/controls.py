"""Where the eye is and how it gets elsewhere; what is switched on. No OpenGL, no window.

Everything that takes time is a closed form of the seconds that passed, so that one step of
0.1 s and ten of 0.01 s end at the same place, whatever the frame rate.

    velocity   v(t) = wanted + (v0 - wanted) exp(-t / EASE_S)
    way        x(t) = x0 + wanted t + (v0 - wanted) EASE_S (1 - exp(-t / EASE_S))
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Final, Literal, get_args

import numpy as np

from svprep.model import F32, F64
from svprep_runtime.camera import Camera, look_at
from svprep_runtime.frame import METHODS, Settings
from svprep_runtime.scene import Construction
from svprep_runtime.viewer.keys import ACTION_OF_KEY, HELD
from svprep_runtime.viewer.lights import LightControl

EASE_S: Final = 0.12
LONGEST_STEP_S: Final = 0.25
"""A frame that took longer moves no farther: nobody steers blindly."""
SECONDS_ACROSS: Final = 15.0
"""To fly along the diagonal of the model."""
FASTER: Final = 4.0
STEEPEST_RAD: Final = math.radians(89.9)
TURN_RAD: Final = math.radians(150.0)
"""For a drag along the height of the window."""
ZOOM_A_NOTCH: Final = 0.18
NEAREST_M: Final = 0.2
TAP_S: Final = 0.35
"""Keys of the light held longer than this go on by themselves."""

Mode = Literal["orbit", "fly"]
OVERLAYS: Final = (
    "volumes", "silhouettes", "ends", "counts", "statistics", "names", "texts", "help",
)  # fmt: skip
_WAYS: Final = {
    "forward": (0.0, 1.0, 0.0),
    "back": (0.0, -1.0, 0.0),
    "right": (1.0, 0.0, 0.0),
    "left": (-1.0, 0.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}
_LIGHT_STEPS: Final = {
    "later": (1.0, 0.0),
    "earlier": (-1.0, 0.0),
    "day_later": (0.0, 1.0),
    "day_earlier": (0.0, -1.0),
}


@dataclass(slots=True, eq=False)
class Eye:
    """A camera that flies, looks and turns about points; never rolled."""

    at: F64
    """``(3,)`` [m], cache frame"""
    azimuth_rad: float
    """Of what it looks at, clockwise from north."""
    pitch_rad: float
    """Upwards."""
    fov_deg: float
    model_m: float
    """Diagonal of the model: scales speeds."""
    pace: float = 1.0
    """That the user chose."""
    velocity: F64 = field(default_factory=lambda: np.zeros(3))
    _zoom_left: float = 0.0
    _zoom_point: F64 = field(default_factory=lambda: np.zeros(3))

    @property
    def forward(self) -> F64:
        """``(3,)``, unit."""
        level = math.cos(self.pitch_rad)
        return np.array(
            [
                level * math.sin(self.azimuth_rad),
                level * math.cos(self.azimuth_rad),
                math.sin(self.pitch_rad),
            ]
        )

    @property
    def right(self) -> F64:
        """``(3,)``, unit, level."""
        return np.array([math.cos(self.azimuth_rad), -math.sin(self.azimuth_rad), 0.0])

    @property
    def speed_m_s(self) -> float:
        """Of flight."""
        return self.pace * self.model_m / SECONDS_ACROSS

    def camera(self, width_px: int, height_px: int) -> Camera:
        """Return the camera there. Its target is far, so that rounding it turns nothing."""
        far = max(self.model_m, float(np.abs(self.at).max()), 1.0)
        return look_at(
            self.at, self.at + far * self.forward, width_px, height_px, fov_deg=self.fov_deg
        )

    def look(self, dx: float, dy: float) -> None:
        """Turn the head by a drag, in heights of the window; y grows downwards."""
        self.azimuth_rad = math.remainder(self.azimuth_rad + TURN_RAD * dx, math.tau)
        self.pitch_rad = _clipped(self.pitch_rad - TURN_RAD * dy)

    def turn_about(self, point: F64, dx: float, dy: float) -> None:
        """Go round `point` by a drag; it stays where it is on the screen."""
        begin = self.azimuth_rad, self.pitch_rad
        right, forward, up = _axes(*begin)
        offset = point - self.at
        seen = np.array([offset @ right, offset @ forward, offset @ up])
        self.look(dx, dy)
        right, forward, up = _axes(self.azimuth_rad, self.pitch_rad)
        self.at = point - (seen[0] * right + seen[1] * forward + seen[2] * up)

    def slide(self, dx: float, dy: float, distance_m: float) -> None:
        """Move across by a drag, so that what is `distance_m` away follows it."""
        right, _, up = _axes(self.azimuth_rad, self.pitch_rad)
        height_m = 2.0 * distance_m * math.tan(math.radians(self.fov_deg) / 2.0)
        self.at = self.at + height_m * (dy * up - dx * right)

    def zoom(self, notches: float, point: F64) -> None:
        """Begin to go nearer to `point`, or farther from it."""
        if self._zoom_left * notches < 0.0:
            self._zoom_left = 0.0
        self._zoom_left += ZOOM_A_NOTCH * notches
        self._zoom_point = np.array(point, np.float64)

    def step(self, seconds: float, ways: Collection[str], *, is_fast: bool) -> bool:
        """Move for `seconds`, flying the `ways` that are held; return whether it moved."""
        begin = self.at
        right, up = self.right, np.array([0.0, 0.0, 1.0])
        way = sum((np.array(_WAYS[name]) for name in ways if name in _WAYS), np.zeros(3))
        wanted = way[0] * right + way[1] * self.forward + way[2] * up
        length = float(np.linalg.norm(wanted))
        if length > 1e-9:
            wanted *= self.speed_m_s * (FASTER if is_fast else 1.0) / length
        left = math.exp(-seconds / EASE_S)
        lag = self.velocity - wanted
        self.at = self.at + wanted * seconds + lag * (EASE_S * (1.0 - left))
        self.velocity = wanted + lag * left
        if not ways and float(np.linalg.norm(self.velocity)) < 1e-4 * self.speed_m_s:
            self.velocity = np.zeros(3)
        self._step_zoom(left)
        return bool((self.at != begin).any())

    def _step_zoom(self, left: float) -> None:
        if self._zoom_left == 0.0:
            return
        now = self._zoom_left * (1.0 - left)
        if abs(self._zoom_left) < 1e-3:
            now = self._zoom_left
        self._zoom_left -= now
        offset = self._zoom_point - self.at
        distance = float(np.linalg.norm(offset))
        if distance > 0.0:
            wanted = max(distance * math.exp(-now), min(NEAREST_M, distance))
            self.at = self._zoom_point - offset * (wanted / distance)


def _clipped(pitch_rad: float) -> float:
    return min(max(pitch_rad, -STEEPEST_RAD), STEEPEST_RAD)


def _axes(azimuth_rad: float, pitch_rad: float) -> tuple[F64, F64, F64]:
    """Return right, forward and up."""
    sin_a, cos_a = math.sin(azimuth_rad), math.cos(azimuth_rad)
    sin_p, cos_p = math.sin(pitch_rad), math.cos(pitch_rad)
    right = np.array([cos_a, -sin_a, 0.0])
    forward = np.array([cos_p * sin_a, cos_p * cos_a, sin_p])
    return right, forward, np.cross(right, forward)


def eye_of(camera: Camera, positions: F32) -> Eye:
    """Return the eye of `camera`, for a model of `positions` ``(n, 3)`` [m]."""
    x, y, z = camera.forward.tolist()
    size = positions.max(axis=0) - positions.min(axis=0) if len(positions) else np.ones(3)
    fov_rad = 2.0 * math.atan(1.0 / float(np.linalg.norm(camera.rows[1].astype(np.float64))))
    return Eye(
        at=camera.eye.astype(np.float64),
        azimuth_rad=math.atan2(x, y),
        pitch_rad=_clipped(math.atan2(z, math.hypot(x, y))),
        fov_deg=math.degrees(fov_rad),
        model_m=max(float(np.linalg.norm(size)), 1.0),
    )


@dataclass(slots=True, eq=False)
class Controls:
    """All that keys and mouse can change."""

    eye: Eye
    lights: list[LightControl]
    method: str = "auto"
    clamp: bool = True
    construction: str = "vertex"
    mode: Mode = "orbit"
    selected: int = 0
    shown: set[str] = field(default_factory=lambda: {"names", "texts"})
    """Of `OVERLAYS`."""
    is_running: bool = False
    is_done: bool = False
    wants_screenshot: bool = False
    has_acted: bool = False
    """Whether any key or drag was taken: until then the short help is shown."""
    pivot: F64 | None = None
    """What a left drag turns about, and a middle drag moves with, while one goes on."""
    message: str = ""
    held: dict[str, float] = field(default_factory=dict)
    """Actions whose keys are down, and for how long [s]."""
    _drag_axis: str = ""
    _drag_way: tuple[float, float] = (0.0, 0.0)
    _home: Eye | None = None

    def __post_init__(self) -> None:
        self._home = self._copy()

    @property
    def light(self) -> LightControl:
        """The one that keys and drags change."""
        return self.lights[self.selected]

    def settings(self, samples: int = 1) -> Settings:
        """Return how to draw."""
        method = next(m for m in METHODS if m == self.method)
        construction = next(c for c in get_args(Construction) if c == self.construction)
        return Settings(method, self.clamp, construction, "float", samples)

    def key_down(self, key: str, *, is_fast: bool = False) -> str:
        """Take a key press; return the action, empty if it has none."""
        action = ACTION_OF_KEY.get(key, "")
        self.has_acted |= bool(action)
        if action in HELD:
            self.held.setdefault(action, 0.0)
        if action in _LIGHT_STEPS:
            self._step_light(*_LIGHT_STEPS[action], is_fast=is_fast)
        elif action and action not in HELD:
            self.act(action)
        return action

    def key_up(self, key: str) -> None:
        """Take a key's release."""
        self.held.pop(ACTION_OF_KEY.get(key, ""), None)

    def release_all(self) -> None:
        """Forget what is held: the window lost the keyboard."""
        self.held.clear()
        self.end_drag()

    def act(self, action: str) -> None:
        """Do what a key stands for, once."""
        match action:
            case "auto" | "zpass" | "zfail" | "zp+":
                self.method = action
            case "clamp":
                self.clamp = not self.clamp
            case "construction":
                names = get_args(Construction)
                self.construction = names[(names.index(self.construction) + 1) % len(names)]
            case "mode":
                self.mode = "fly" if self.mode == "orbit" else "orbit"
                self.message = (
                    "left drag looks about, the wheel sets the speed of flight"
                    if self.mode == "fly"
                    else "left drag turns around the point under the cursor"
                )
            case "home":
                home = self._home
                assert home is not None
                self.eye, self._home = home, None
                self._home = self._copy()
            case "run":
                self.is_running = not self.is_running
            case "by_time":
                self.message = self.light.switch()
            case "next_light":
                self.selected = (self.selected + 1) % len(self.lights)
            case "screenshot":
                self.wants_screenshot = True
            case "quit":
                self.is_done = True
            case _ if action in OVERLAYS:
                self.shown ^= {action}

    def tick(self, seconds: float, *, is_fast: bool = False) -> bool:
        """Let time pass; return whether anything moved."""
        seconds = min(max(seconds, 0.0), LONGEST_STEP_S)
        moved = self.eye.step(seconds, [a for a in self.held if a in _WAYS], is_fast=is_fast)
        for action in self.held:
            before = self.held[action]
            self.held[action] = before + seconds
            by_itself = max(0.0, before + seconds - TAP_S) - max(0.0, before - TAP_S)
            if action in _LIGHT_STEPS and by_itself > 0.0:
                along, across = _LIGHT_STEPS[action]
                many = 8.0 * by_itself
                self._step_light(many * along, many * across, is_fast=is_fast)
                moved = True
        if self.is_running:
            self._step_light(3.0 * seconds, 0.0, is_fast=is_fast)
            moved = True
        return moved

    def drag(self, button: str, dx: float, dy: float) -> None:
        """Take a drag, in heights of the window; y grows downwards."""
        self.has_acted = True
        if button == "right":
            self._drag_light(dx, dy)
        elif button == "middle" and self.pivot is not None:
            depth = float((self.pivot - self.eye.at) @ self.eye.forward)
            self.eye.slide(dx, dy, max(depth, NEAREST_M))
        elif button == "left" and self.mode == "orbit" and self.pivot is not None:
            self.eye.turn_about(self.pivot, dx, dy)
        elif button == "left":
            self.eye.look(dx, dy)

    def end_drag(self) -> None:
        """Let go of what is dragged."""
        self.pivot = None
        self._drag_axis, self._drag_way = "", (0.0, 0.0)

    def wheel(self, notches: float, point: F64) -> None:
        """Take turns of the wheel, the cursor on `point`."""
        if self.mode == "orbit":
            self.eye.zoom(notches, point)
        else:
            self.eye.pace = min(max(self.eye.pace * 1.25**notches, 1e-3), 1e2)
            self.message = f"speed of flight {self.eye.speed_m_s:.3g} m/s"

    def _drag_light(self, dx: float, dy: float) -> None:
        """Move the light along the first axis of a drag only: hour and date stay apart."""
        if self.light.keeps_axes_apart and not self._drag_axis:
            x, y = self._drag_way[0] + dx, self._drag_way[1] + dy
            self._drag_way = x, y
            if max(abs(x), abs(y)) < 0.008:
                return
            self._drag_axis = "x" if abs(x) >= abs(y) else "y"
            dx, dy = x, y
        self.light.drag(
            0.0 if self._drag_axis == "y" else dx,
            0.0 if self._drag_axis == "x" else dy,
            self.eye.right,
        )

    def _step_light(self, along: float, across: float, *, is_fast: bool) -> None:
        factor = FASTER if is_fast else 1.0
        self.light.step(factor * along, factor * across, self.eye.right)

    def _copy(self) -> Eye:
        e = self.eye
        return Eye(e.at.copy(), e.azimuth_rad, e.pitch_rad, e.fov_deg, e.model_m)
