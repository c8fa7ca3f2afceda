"""A real window and its events. The only module that knows moderngl-window."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from svprep.errors import EnvironmentProblem, require_extra
from svprep.model import U8
from svprep_runtime.camera import check_size
from svprep_runtime.context import VERSION
from svprep_runtime.viewer.controls import Controls

if TYPE_CHECKING:
    from svprep_runtime.viewer.core import Viewer

_BUTTONS: Final = {1: "left", 2: "right", 3: "middle"}
_IDLE_S: Final = 0.008
_HIDDEN_S: Final = 0.1


def open_window(title: str, width_px: int, height_px: int) -> Any:
    """Return a window with an OpenGL 4.5 context.

    Raises
    ------
    EnvironmentProblem
        moderngl-window is missing, or no window can be opened.
    """
    check_size(width_px, height_px)
    try:
        import moderngl_window
    except ImportError as error:
        raise require_extra("moderngl-window", "view", "svprep view") from error
    try:
        window_class = moderngl_window.get_local_window_cls("pyglet")
        window = window_class(
            title=title,
            gl_version=(VERSION // 100, VERSION // 10 % 10),
            size=(width_px, height_px),
            resizable=True,
            vsync=True,
        )
    except Exception as error:
        raise EnvironmentProblem(_no_window(error)) from error
    # Closing belongs to the loop: graphics memory is given back while the context lives.
    window.exit_key = None
    return window


def _no_window(error: Exception) -> str:
    display = os.environ.get("DISPLAY", "")
    said = " ".join(str(error).split()) or type(error).__name__
    where = f' on DISPLAY "{display}"' if display else ""
    why = f"{said}"
    if not display and sys.platform.startswith("linux"):
        why = "DISPLAY is not set: there is no screen here"
    return (
        f"no window can be opened{where} ({why}). "
        "Without a screen: svprep render CACHE -o IMAGE draws the same picture into a file"
    )


def connect(window: Any, controls: Controls, viewer: Viewer) -> None:
    """Lead the window's events to the controls."""
    keys = {
        getattr(window.keys, name): name for name in dir(window.keys) if not name.startswith("_")
    }

    def ratio() -> float:
        return float(window.buffer_size[0]) / max(int(window.size[0]), 1)

    def on_key(key: Any, action: Any, modifiers: Any) -> None:
        name = keys.get(key, "")
        if action == window.keys.ACTION_PRESS:
            controls.message = ""
            controls.key_down(name, is_fast=bool(modifiers.shift))
        else:
            controls.key_up(name)

    def on_text(text: str) -> None:
        if text == "?":
            controls.act("help")

    def at(x: float, y: float) -> tuple[float, float]:
        return x * ratio(), y * ratio()

    def on_move(x: int, y: int, dx: int, dy: int) -> None:
        viewer.cursor_px = at(x, y)

    def on_drag(x: int, y: int, dx: int, dy: int) -> None:
        viewer.cursor_px = at(x, y)
        states = window.mouse_states
        pressed = [name for name in _BUTTONS.values() if getattr(states, name)]
        height = max(int(window.size[1]), 1)
        for button in pressed[:1]:
            controls.drag(button, dx / height, dy / height)

    def on_press(x: int, y: int, button: int) -> None:
        controls.message = ""
        if _BUTTONS.get(button) in ("left", "middle"):
            controls.pivot = viewer.point_under(*at(x, y))

    def on_release(x: int, y: int, button: int) -> None:
        if not window.mouse_states.any:
            controls.end_drag()

    def on_wheel(dx: float, dy: float) -> None:
        where = viewer.cursor_px or (viewer.size_px[0] / 2, viewer.size_px[1] / 2)
        controls.wheel(dy, viewer.point_under(*where))

    def on_resize(width: int, height: int) -> None:
        viewer.text_scale = max(ratio(), 1.0)
        viewer.resize(int(width), int(height))

    def on_hide(is_hidden: bool) -> None:
        controls.release_all()

    window.key_event_func = on_key
    window.unicode_char_entered_func = on_text
    window.mouse_position_event_func = on_move
    window.mouse_drag_event_func = on_drag
    window.mouse_press_event_func = on_press
    window.mouse_release_event_func = on_release
    window.mouse_scroll_event_func = on_wheel
    window.resize_func = on_resize
    window.iconify_func = on_hide
    on_resize(*window.buffer_size)


def run(
    window: Any,
    controls: Controls,
    viewer: Viewer,
    folder: Path,
    after_frame: Callable[[int], None] | None = None,
) -> None:
    """Draw until the window is closed. `after_frame` is called with how many rounds were."""
    before = time.perf_counter()
    n = 0
    while not (window.is_closing or controls.is_done):
        now = time.perf_counter()
        is_fast = bool(window.modifiers.shift)
        is_moving = controls.tick(now - before, is_fast=is_fast)
        is_moving = is_moving or bool(window.mouse_states.any)
        before = now
        is_new = False
        if window.visible:
            is_new = viewer.draw(0, is_moving=is_moving)
        if controls.wants_screenshot:
            controls.wants_screenshot = False
            picture = viewer.screenshot()
            if picture is not None:
                controls.message = f"saved {save_numbered(picture, folder, viewer.name)}"
        window.swap_buffers()
        n += 1
        if after_frame is not None:
            after_frame(n)
        if not window.visible:
            time.sleep(_HIDDEN_S)
        elif not is_new:
            time.sleep(_IDLE_S)


def save_numbered(picture: U8, folder: Path, name: str) -> Path:
    """Write a PNG under the next number that is free; nothing is ever overwritten.

    Raises
    ------
    EnvironmentProblem
        The folder cannot be written to.
    """
    from PIL import Image

    stem = name.removesuffix(".h5").removesuffix(".svp")
    for number in range(1, 100_000):
        path = folder / f"{stem}-{number:03d}.png"
        try:
            with path.open("xb") as file:
                Image.fromarray(picture).save(file, "PNG")
        except FileExistsError:
            continue
        except OSError as error:
            raise EnvironmentProblem(
                f"{path}: the picture cannot be written: {error.strerror or error}"
            ) from error
        return path
    raise EnvironmentProblem(f"{folder}: all numbers up to {stem}-99999.png are taken")
