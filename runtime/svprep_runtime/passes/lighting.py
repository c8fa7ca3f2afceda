"""The last passes: light from the sky, then each light where nothing stands before it."""

from __future__ import annotations

from typing import Any, Final

from svprep_runtime import gl_raw as g
from svprep_runtime.passes.counting import Counter
from svprep_runtime.programs import Programs
from svprep_runtime.state import PassState, apply
from svprep_runtime.targets import Targets

STATE: Final = PassState(depth_test=None, blend="add")


def add_ambient(programs: Programs, targets: Targets, uniforms: dict[str, Any]) -> None:
    """Add light from the sky to every visible face, and the colour of the sky elsewhere."""
    _draw(programs, targets, targets.ambient_into, "ambient.frag", (), uniforms)


def add_light(
    programs: Programs, targets: Targets, light: int, uniforms: dict[str, Any], counter: Counter
) -> None:
    """Add one light where it reaches, and a vote for shadow where it does not."""
    gl = programs.context.gl
    options = ("IN_STENCIL",) if counter == "stencil" else ()
    gl.glBindTextureUnit(1, targets.depth if counter == "stencil" else targets.count)
    _draw(programs, targets, targets.light_into[light], "light.frag", options, uniforms)


def _draw(
    programs: Programs,
    targets: Targets,
    framebuffer: int,
    fragment: str,
    options: tuple[str, ...],
    uniforms: dict[str, Any],
) -> None:
    gl = programs.context.gl
    targets.bind(framebuffer)
    apply(gl, STATE)
    gl.glBindTextureUnit(0, targets.seen)
    program = programs.get("whole.vert", fragment, options=options)
    program.set(uniforms)
    program.draw(g.GL_TRIANGLES, 3)
