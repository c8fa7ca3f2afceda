"""Panels of text in graphics memory, each drawn anew only when its words change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from svprep_runtime.context import Context
from svprep_runtime.passes.overlay import draw_panel
from svprep_runtime.programs import Programs
from svprep_runtime.viewer.hud import Row, panel

if TYPE_CHECKING:
    import moderngl

Corner = Literal["top left", "top right", "bottom left", "bottom right", "bottom", "middle"]
_MARGIN_PX = 10


@dataclass(slots=True)
class Panels:
    """The textures of panels, by name. Release them."""

    context: Context
    _made: dict[str, tuple[tuple[object, ...], moderngl.Texture]] = field(default_factory=dict)
    _top_left: tuple[int, int] = (0, 0)
    """Where the panel drawn there last ends."""

    def draw(
        self,
        programs: Programs,
        name: str,
        rows: Sequence[Row],
        corner: Corner,
        size_px: tuple[int, int],
        scale: float,
        numbers_right: bool = False,
    ) -> None:
        """Lay a panel over the bound picture of `size_px`; nothing without rows.

        One at the top right goes below one at the top left that leaves it no room.
        """
        if not rows:
            if corner == "top left":
                self._top_left = (0, 0)
            return
        key = (*rows, scale, size_px[0])
        if name not in self._made or self._made[name][0] != key:
            most_px = max(size_px[0] - 2 * _MARGIN_PX, 16)
            pixels = panel(rows, scale=scale, most_px=most_px, numbers_right=numbers_right)
            self.forget(name)
            height, width, _ = pixels.shape
            texture = self.context.ctx.texture((width, height), 4, pixels.tobytes())
            self._made[name] = key, texture
        texture = self._made[name][1]
        across, along = size_px[0] - texture.width, size_px[1] - texture.height
        margin = round(_MARGIN_PX * scale)
        left = {"left": margin, "right": across - margin}.get(corner.split()[-1], across // 2)
        top = {"top": margin, "bottom": along - margin}.get(corner.split()[0], along // 2)
        if corner == "top left":
            self._top_left = left + texture.width, top + texture.height
        elif corner == "top right" and left < self._top_left[0]:
            top += self._top_left[1]
        draw_panel(programs, texture, (left, top), size_px)

    def forget(self, name: str) -> None:
        """Give one back, if it is there."""
        if name in self._made:
            self._made.pop(name)[1].release()

    def release(self) -> None:
        """Give all back."""
        for name in list(self._made):
            self.forget(name)
