"""``svprep view``: a cache in a window, from the first event to the last."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from svprep.cache.reader import open_cache
from svprep_runtime.camera import default_camera, parse_camera
from svprep_runtime.context import of_window
from svprep_runtime.frame import Settings, checked
from svprep_runtime.residency import DEFAULT_BUDGET_BYTES
from svprep_runtime.viewer.controls import Controls, eye_of
from svprep_runtime.viewer.core import Viewer
from svprep_runtime.viewer.lights import light_controls
from svprep_runtime.viewer.window import connect, open_window, run


@dataclass(frozen=True, slots=True)
class Stage:
    """What a caller may look at or drive between frames: for tests and scripts."""

    window: Any
    controls: Controls
    viewer: Viewer
    n_rounds: int


def view(
    cache_path: Path,
    lights: Sequence[str],
    size: tuple[int, int],
    settings: Settings | None = None,
    *,
    camera: str = "",
    budget_bytes: int = DEFAULT_BUDGET_BYTES,
    folder: Path | None = None,
    after_frame: Callable[[Stage], None] | None = None,
) -> None:
    """Show a cache in a window until it is closed.

    Parameters
    ----------
    cache_path : Path
    lights : sequence of str
        As `svprep.light.parse_light` takes them, or arcs of the sun; none: azimuth 135,
        altitude 40.
    size : tuple of int
        Width and height of the window [pixels of the screen].
    settings : Settings, optional
        To begin with; keys change them.
    camera : str
        As `svprep_runtime.camera.parse_camera` takes it; empty: all of the model.
    budget_bytes : int
        Of graphics memory.
    folder : Path, optional
        Where pictures are saved; the current one by default.
    after_frame : callable, optional
        Called after each round of the loop.

    Raises
    ------
    InputError, CacheError, EnvironmentProblem
        A light, camera or size is none, the cache cannot be used, no window can be opened.
    """
    settings = checked(settings or Settings())
    with open_cache(cache_path) as cache:
        positions = cache.mesh.positions
        width, height = size
        begin = (
            parse_camera(camera, cache.grid, width, height)
            if camera
            else default_camera(positions, width, height)
        )
        eye = eye_of(begin, positions)
        controls = Controls(
            eye,
            light_controls(lights, cache.site, cache.grid, eye.model_m),
            method=settings.method,
            clamp=settings.clamp,
            construction=settings.construction,
        )
        window = open_window(f"svprep view {cache_path.name}", width, height)
        try:
            viewer = Viewer(
                of_window(window.ctx),
                cache,
                controls,
                cache_path.name,
                window.buffer_size,
                samples=settings.samples,
                budget_bytes=budget_bytes,
            )
            try:
                connect(window, controls, viewer)

                def after(n: int) -> None:
                    if after_frame is not None:
                        after_frame(Stage(window, controls, viewer, n))

                run(window, controls, viewer, folder or Path.cwd(), after)
            finally:
                viewer.release()
        finally:
            window.close()
