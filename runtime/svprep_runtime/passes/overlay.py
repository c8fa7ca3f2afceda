"""The passes of the viewer, over a finished frame: glass, lines, colours, texts.

radiance --present--> picture (with the frame's own depth) <-- volumes, ends, lines, counts
picture --copy--> shown <-- panels of text --copy--> window
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, Literal

from svprep_runtime import gl_raw as g
from svprep_runtime.passes.counting import Draw
from svprep_runtime.programs import Programs
from svprep_runtime.state import PassState, apply
from svprep_runtime.targets import Targets

if TYPE_CHECKING:
    import moderngl

Colour = tuple[float, float, float, float]

PLAIN: Final = PassState(depth_test=None)
OVER: Final = PassState(depth_test=None, blend="alpha")
BEFORE: Final = PassState(depth_test="greater", blend="alpha")
"""What is nearer than what the frame shows there."""
BEHIND: Final = PassState(depth_test="lequal", blend="alpha")

_GLASS: Final = "OF_VOLUME"
_SIDES: Final = ("sides", "sides_to_point")
End = Literal["near", "far"]


def present(
    programs: Programs, radiance: int, samples: int, sky_less: tuple[float, float, float]
) -> None:
    """Fill the bound picture with a frame's sums."""
    gl = programs.context.gl
    apply(gl, PLAIN)
    gl.glBindTextureUnit(0, radiance)
    program = programs.get("whole.vert", "present.frag")
    program.set({"share": 1.0 / samples, "sky_less": sky_less})
    program.draw(g.GL_TRIANGLES, 3)


def copy(programs: Programs, picture: int, enlarged: int = 1) -> None:
    """Fill the bound picture with another one, each of its pixels `enlarged`."""
    gl = programs.context.gl
    apply(gl, PLAIN)
    gl.glBindTextureUnit(0, picture)
    program = programs.get("whole.vert", "present_copy.frag")
    program.set({"enlarged": enlarged})
    program.draw(g.GL_TRIANGLES, 3)


def tint_counts(programs: Programs, targets: Targets, palette: list[Colour]) -> None:
    """Colour each point by how many volumes of the light that was counted last hold it."""
    gl = programs.context.gl
    apply(gl, OVER)
    gl.glBindTextureUnit(0, targets.seen)
    gl.glBindTextureUnit(1, targets.count)
    program = programs.get("whole.vert", "overlay_counts.frag")
    program.set({"palette": palette})
    program.draw(g.GL_TRIANGLES, 3)


def draw_volumes(
    programs: Programs,
    uniforms: dict[str, Any],
    draws: Sequence[Draw],
    front: Colour,
    back: Colour,
) -> None:
    """Lay the sides of volumes over the picture, as far as they are before what is seen."""
    apply(programs.context.gl, BEFORE)
    for draw in draws:
        if draw.kind in _SIDES and draw.n_entries:
            to_point = draw.kind == "sides_to_point"
            options = ("TO_A_POINT", _GLASS) if to_point else (_GLASS,)
            program = programs.get("sides.vert", "overlay_tint.frag", options=options)
            program.set(uniforms)
            program.set({"front": front, "back": back, "first_entry": draw.first_entry})
            program.draw(g.GL_TRIANGLES, (3 if to_point else 6) * draw.n_entries)


def draw_ends(
    programs: Programs, uniforms: dict[str, Any], draws: Sequence[Draw], near: Colour, far: Colour
) -> None:
    """Lay the caps at the ends of clamped segments over the picture, hidden ones faintly."""
    for state, share in ((BEHIND, 0.35), (BEFORE, 1.0)):
        apply(programs.context.gl, state)
        for draw in draws:
            if draw.kind == "caps" and draw.n_entries and not draw.is_own_cap:
                r, green, b, alpha = far if draw.is_far else near
                tint = (r, green, b, share * alpha)
                program = programs.get("caps.vert", "overlay_tint.frag", options=(_GLASS,))
                program.set(uniforms)
                program.set({"front": tint, "back": tint, "first_entry": draw.first_entry})
                program.set({"is_far": draw.is_far})
                program.draw(g.GL_TRIANGLES, 3 * draw.n_entries)


def draw_lines(
    programs: Programs,
    uniforms: dict[str, Any],
    draws: Sequence[Draw],
    end: End | None,
    colour: Colour,
    half_line: tuple[float, float],
    *,
    hidden_share: float = 0.0,
) -> None:
    """Draw the silhouette edges of volumes, or those edges where segments begin or end.

    `half_line`: half the width of a line, in clip units; `hidden_share` of its alpha is
    left to a line behind what is seen.
    """
    which = {None: 0, "near": 1, "far": 2}[end]
    program = programs.get("overlay_lines.vert", "overlay_tint.frag")
    program.set(uniforms)
    for state, share in ((BEHIND, hidden_share), (BEFORE, 1.0)):
        if share == 0.0:
            continue
        apply(programs.context.gl, state)
        tint = (*colour[:3], share * colour[3])
        program.set({"which": which, "half_line": half_line, "front": tint})
        for draw in draws:
            if draw.kind in _SIDES:
                program.set({"first_entry": draw.first_entry})
                program.draw(g.GL_TRIANGLES, 6 * draw.n_entries)


def draw_panel(
    programs: Programs,
    panel: moderngl.Texture,
    left_top_px: tuple[int, int],
    size_px: tuple[int, int],
) -> None:
    """Lay a panel of text over the bound picture of `size_px`."""
    gl = programs.context.gl
    apply(gl, OVER)
    gl.glBindTextureUnit(0, panel.glo)
    program = programs.get("hud_panel.vert", "hud_panel.frag")
    place = (*map(float, left_top_px), float(panel.width), float(panel.height))
    program.set({"place_px": place, "size_px": tuple(map(float, size_px))})
    program.draw(g.GL_TRIANGLES, 6)
