"""The viewer without a window: a frame, what lies over it, and the texts, into a framebuffer.

    draw     frame --> picture with overlays        only if something changed
             picture, panels --> shown --> window

While things move on a slow machine a frame is drawn coarsely, each of its pixels over
several of the window; on a very slow one, or with a very large model, the eye moves
without shadows. As soon as things rest all is drawn again in full.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from svprep.errors import SvprepError
from svprep.model import F32, F64, U8, Prepared
from svprep_runtime import frame
from svprep_runtime import residency as r
from svprep_runtime.camera import Camera
from svprep_runtime.context import Context
from svprep_runtime.measure import Meter, PassFigures
from svprep_runtime.passes import overlay
from svprep_runtime.scene import LitScene, Scene
from svprep_runtime.viewer import overlays as o
from svprep_runtime.viewer.canvas import Canvas, Layers, bind, face_at, layers
from svprep_runtime.viewer.controls import Controls
from svprep_runtime.viewer.hud import WHITE, Row
from svprep_runtime.viewer.panels import Corner, Panels

if TYPE_CHECKING:
    from svprep.cache.reader import Cache

SLOW_S: Final = 0.12
"""A full frame that takes longer is drawn coarsely while things move."""
COARSEST: Final = 4
TOO_SLOW_S: Final = 0.6
"""A coarse frame that takes longer leaves shadows out while the eye moves."""
NIGHT_SKY: Final = (0.60, 0.70, 0.79)
"""Taken from the sky's colour at night."""
NAME_S: Final = 0.05
"""How long the cursor may have moved before what lies under it is asked for again."""


@dataclass(frozen=True, slots=True)
class Under:
    """What lies under a point of the window."""

    face: int
    name: str
    """Of its object."""
    point: F64
    """``(3,)`` [m], cache frame"""


class Viewer:
    """A cache on the screen, as `controls` have it. Release it.

    Parameters
    ----------
    context : Context
        Current, and so for every later call.
    name : str
        Of the cache, for the screen.
    size_px : tuple of int
        Width and height of the window's buffer; 0 draws nothing.
    samples : int
        A pixel.

    Raises
    ------
    EnvironmentProblem, InputError, CacheError
        As `Scene` says.
    """

    def __init__(
        self,
        context: Context,
        cache: Cache | Prepared,
        controls: Controls,
        name: str,
        size_px: tuple[int, int],
        *,
        samples: int = 1,
        budget_bytes: int = r.DEFAULT_BUDGET_BYTES,
    ) -> None:
        self.context, self.cache, self.controls = context, cache, controls
        self.name, self.size_px, self.samples = name, size_px, samples
        self.text_scale = 1.0
        self.cursor_px: tuple[float, float] | None = None
        self.figures: tuple[PassFigures, ...] = ()
        self.tallies: tuple[frame.Tally, ...] = ()
        self.is_coarse = False
        self.n_frames = 0
        """Frames of the scene that were drawn, not copies of one."""
        self._layers: dict[int, Layers] = {}
        self._shown: Canvas | None = None
        self._panels = Panels(context)
        self._drawn: tuple[object, ...] = ()
        self._last: tuple[Camera, Layers, int] | None = None
        self._lights: dict[bytes, F32] = {}
        self._accepted: list[F32 | None] = []
        self._frame_s = 0.0
        self._full_s = 0.0
        self._coarse_s = 0.0
        self._under: Under | None = None
        self._asked_at = (-1.0, 0.0, 0.0)
        self._is_new = True
        self.scene = Scene(context, cache, budget_bytes)

    def resize(self, width_px: int, height_px: int) -> None:
        """Take a new size of the window's buffer."""
        if (width_px, height_px) != self.size_px:
            self.size_px = width_px, height_px
            self._release_pictures()

    def draw(self, framebuffer: int, *, is_moving: bool = False) -> bool:
        """Draw into `framebuffer` of the window's size; return whether the scene was drawn anew.

        Nothing is drawn into a window of no size. `is_moving`: more frames follow at once.
        """
        if min(self.size_px) < 1:
            return False
        scale = self._scale(is_moving=is_moving)
        vectors = self._vectors()
        are_same = self._drawn != () and _are_equal(vectors, self._accepted)
        without = scale > 1 and are_same and self._coarse_s > TOO_SLOW_S
        is_new = self._state(scale, without, vectors) != self._drawn
        if is_new:
            self._draw_scene(scale, vectors, without_lights=without)
            self._drawn = self._state(scale, without, vectors)
            self._is_new = True
        if self._shown is None:
            self._shown = Canvas(self.context, *self.size_px)
        self._compose(self._shown)
        bind(self.context, framebuffer, *self.size_px)
        overlay.copy(self.scene.programs, self._shown.picture)
        return is_new

    def screenshot(self) -> U8 | None:
        """Return ``(height, width, 3) uint8``: what was shown last; None if nothing was."""
        return None if self._shown is None else self._shown.read()

    def under(self, x_px: float, y_px: float) -> Under | None:
        """Return what lies under a point of the window, y downwards; None: only sky."""
        if self._last is None:
            return None
        camera, last, scale = self._last
        column, row = int(x_px) // scale, int(y_px) // scale
        if not (0 <= column < camera.width_px and 0 <= row < camera.height_px):
            return None
        face = face_at(self.context, last.targets, column, camera.height_px - 1 - row)
        if face is None:
            return None
        mesh = self.cache.mesh
        a, b, c = mesh.positions[mesh.faces[face]].astype(np.float64)
        eye = camera.eye.astype(np.float64)
        # At the centre of the pixel: elsewhere the ray may pass the face.
        ray = camera.directions(np.array([column + 0.5]), np.array([row + 0.5]))[0]
        normal = np.cross(b - a, c - a)
        depth = float((a - eye) @ normal) / float(ray @ normal)
        nth = int(np.searchsorted(mesh.object_face_start, face, "right")) - 1
        return Under(face, self.cache.object_names[nth], eye + depth * ray)

    def point_under(self, x_px: float, y_px: float) -> F64:
        """Return the point under a point of the window; where there is only sky, one ahead."""
        found = self.under(x_px, y_px)
        if found is not None:
            return found.point
        eye = self.controls.eye
        middle = self.under(self.size_px[0] / 2, self.size_px[1] / 2)
        if middle is not None:
            return middle.point
        positions = self.cache.mesh.positions
        if not len(positions):
            return eye.at + eye.forward
        box = (positions.min(axis=0).astype(np.float64) + positions.max(axis=0)) / 2.0
        ahead = float((box - eye.at) @ eye.forward)
        return eye.at + max(ahead, 0.05 * eye.model_m) * eye.forward

    def release(self) -> None:
        """Give all graphics memory back."""
        self._release_pictures()
        self._panels.release()
        self.scene.release()

    def _release_pictures(self) -> None:
        for each in self._layers.values():
            each.release()
        self._layers.clear()
        if self._shown is not None:
            self._shown.release()
        self._shown, self._last, self._drawn, self._under = None, None, (), None

    def _scale(self, *, is_moving: bool) -> int:
        if not is_moving or self._full_s <= SLOW_S:
            return 1
        # By area: what a frame costs are its pixels, mostly.
        return min(max(round((self._full_s / SLOW_S) ** 0.5), 2), COARSEST)

    def _state(
        self, scale: int, without_lights: bool, vectors: list[F32 | None]
    ) -> tuple[object, ...]:
        """Return all that a frame depends on."""
        c = self.controls
        eye = c.eye
        lights = tuple(None if v is None else v.tobytes() for v in vectors)
        over = tuple(sorted(c.shown & {"volumes", "silhouettes", "ends", "counts", "statistics"}))
        place = (*eye.at.tolist(), eye.azimuth_rad, eye.pitch_rad, eye.fov_deg)
        settings = c.settings(self.samples)
        return (self.size_px, scale, without_lights, place, lights, c.selected, settings, over)

    def _vectors(self) -> list[F32 | None]:
        """Return the lights as the controls have them; one that cannot be drawn as it was."""
        vectors: list[F32 | None] = []
        for i, light in enumerate(self.controls.lights):
            try:
                vector = light.vector()
            except SvprepError as error:
                self.controls.message = str(error)
                vector = self._accepted[i] if i < len(self._accepted) else None
            vectors.append(vector)
        return vectors

    def _draw_scene(self, scale: int, vectors: list[F32 | None], *, without_lights: bool) -> None:
        c = self.controls
        width, height = (max(-(-n // scale), 1) for n in self.size_px)
        if scale not in self._layers:
            self._layers[scale] = layers(self.context, width, height, len(c.lights))
        on = self._layers[scale]
        camera = c.eye.camera(width, height)
        # The count that is left over is that of the last light: the selected one.
        order = [i for i in range(len(vectors)) if i != c.selected] + [c.selected]
        lights = [v for i in order if (v := vectors[i]) is not None]
        self._forget_others(lights)
        begin = time.perf_counter()
        meter = Meter(self.context, is_on="statistics" in c.shown)
        settings = c.settings(self.samples)
        drawn = [] if without_lights else lights
        try:
            self.tallies = frame.draw(self.scene, on.targets, camera, drawn, settings, meter)
        except SvprepError as error:
            if not self._accepted or self._last is None:
                raise
            c.message = str(error)
            return
        self._accepted = vectors
        self.figures = meter.figures()
        try:
            self._over(on, camera, vectors[c.selected] if drawn else None, is_night=not lights)
        except SvprepError as error:  # an overlay that does not fit; the picture is there
            c.message = str(error)
        self.context.gl.glFinish()
        self._frame_s = time.perf_counter() - begin
        if scale == 1:
            self._full_s = self._frame_s
        elif not without_lights:
            self._coarse_s = self._frame_s
        self.is_coarse = scale > 1
        self._last = camera, on, scale
        self.n_frames += 1

    def _forget_others(self, lights: list[F32]) -> None:
        """Give back what was kept for lights that are drawn no more."""
        kept = {light.tobytes(): light for light in lights}
        for key, light in self._lights.items():
            if key not in kept:
                self.scene.forget(light)
        self._lights = kept

    def _over(self, on: Layers, camera: Camera, light: F32 | None, *, is_night: bool) -> None:
        """Show a frame as a picture, and lay the overlays of the selected light over it."""
        programs, shown = self.scene.programs, self.controls.shown
        on.canvas.bind()
        sky_less = NIGHT_SKY if is_night else (0.0, 0.0, 0.0)
        overlay.present(programs, on.targets.radiance, self.samples, sky_less)
        if light is None:
            return
        if "counts" in shown:
            overlay.tint_counts(programs, on.targets, o.palette())
        if not shown & {"volumes", "silhouettes", "ends"}:
            return
        lit = self.scene.lit_by(light, clamped=self.controls.clamp)
        self.scene.bind()
        self.scene.bind_light(lit)
        batch = self.scene.batch(lit, "vertex")
        self.scene.bind_batch(batch)
        uniforms = {
            **frame.camera_uniforms(camera),
            **frame.lift_uniforms(self.scene, camera),
            **lit.uniforms,
        }
        self._lay(uniforms, batch.draws, lit, camera)

    def _lay(self, uniforms: dict[str, Any], draws: Any, lit: LitScene, camera: Camera) -> None:
        programs, shown = self.scene.programs, self.controls.shown
        line_px = 0.9 * self.text_scale
        half_line = 2.0 * line_px / camera.width_px, 2.0 * line_px / camera.height_px
        if "volumes" in shown:
            overlay.draw_volumes(programs, uniforms, draws, (*o.FRONT, 0.11), (*o.BACK, 0.11))
        if "ends" in shown and lit.segments.is_clamped:
            near, far = o.NEAR_END, o.FAR_END
            overlay.draw_ends(programs, uniforms, draws, (*near, 0.30), (*far, 0.30))
            for end, colour in (("near", near), ("far", far)):
                tint = (*colour, 0.9)
                overlay.draw_lines(
                    programs,
                    uniforms,
                    draws,
                    "near" if end == "near" else "far",
                    tint,
                    half_line,
                    hidden_share=0.3,
                )
        if "silhouettes" in shown:
            overlay.draw_lines(programs, uniforms, draws, None, (*o.OUTLINE, 1.0), half_line)

    def _compose(self, shown: Canvas) -> None:
        """Put the picture and the panels of text together."""
        c = self.controls
        assert self._last is not None
        _, last, scale = self._last
        asks = {"texts", "names"} <= c.shown and self.cursor_px is not None
        name = self._name_rows() if asks else []  # reads pixels: before anything is bound
        shown.bind()
        overlay.copy(self.scene.programs, last.canvas.picture, scale)
        if "texts" not in c.shown:
            return
        self._panel("status", self._status(), "top left")
        if "statistics" in c.shown:
            self._panel("statistics", self._statistics(), "top right", numbers_right=True)
        highest = self.tallies[-1].highest_count if self.tallies else 0
        rows = o.legend(c.shown, has_segments=self._n_segments() > 0, highest=highest)
        self._panel("legend", rows, "bottom right")
        self._panel("name", name, "bottom left")
        if "help" in c.shown:
            self._panel("help", o.help_panel(), "middle")
        elif not c.has_acted:
            self._panel("short", o.short_help(), "bottom")

    def _panel(
        self, name: str, rows: list[Row], corner: Corner, *, numbers_right: bool = False
    ) -> None:
        scale = self.text_scale
        self._panels.draw(
            self.scene.programs, name, rows, corner, self.size_px, scale, numbers_right
        )

    def _n_segments(self) -> int:
        return self.tallies[-1].n_clamped_segments if self.tallies else 0

    def _status(self) -> list[Row]:
        c = self.controls
        n = self._n_segments()
        clamp = f"clamped, {n:,} segments" if n else "clamped: none for this light"
        words = [
            f"method {c.method}",
            clamp if c.clamp else "not clamped",
            f"volumes by {c.construction}",
            "left drag turns" if c.mode == "orbit" else "left drag looks",
        ]
        if self.is_coarse:
            words.append("coarse while it moves")
        lights = [light.words() for light in c.lights]
        return o.status(self.name, lights, c.selected, "   ".join(words), c.message)

    def _statistics(self) -> list[Row]:
        negative = sum(tally.n_negative for tally in self.tallies)
        return o.statistics(
            self.figures,
            1.0 / max(self._frame_s, 1e-6),
            1e3 * self._frame_s,
            negative,
            self.context.renderer,
        )

    def _name_rows(self) -> list[Row]:
        """Return the name of the object under the cursor."""
        assert self.cursor_px is not None
        now = time.perf_counter()
        asked = self._asked_at
        if self._is_new or (self.cursor_px != asked[1:] and now - asked[0] > NAME_S):
            self._under = self.under(*self.cursor_px)
            self._asked_at = (now, *self.cursor_px)
            self._is_new = False
        if self._under is None:
            return []
        x, y, z = (self._under.point + self.cache.mesh.grid.origin_m).tolist()
        at = f"face {self._under.face:,}   at {x:.2f}, {y:.2f}, {z:.2f}"
        return [Row((self._under.name or "(no name)",), WHITE), Row((at,))]


def _are_equal(some: list[F32 | None], others: list[F32 | None]) -> bool:
    """Whether lights are the same ones, night included."""
    pairs = zip(some, others, strict=False)
    return len(some) == len(others) and all(
        (a is None) == (b is None) and (a is None or b is None or bool((a == b).all()))
        for a, b in pairs
    )
