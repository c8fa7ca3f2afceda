"""The first pass: depth, and which face each pixel sees."""

from __future__ import annotations

from typing import Any, Final

from svprep_runtime import gl_raw as g
from svprep_runtime.programs import Programs
from svprep_runtime.state import PassState, apply
from svprep_runtime.targets import Targets

STATE: Final = PassState(depth_test="greater", depth_write=True)
"""Strictly nearer wins, so of coincident faces the first one of the file."""


def see(
    programs: Programs,
    targets: Targets,
    uniforms: dict[str, Any],
    n_faces: int,
    *,
    cut_at_near: bool,
    by_geometry_shader: bool = False,
) -> None:
    """Draw all faces in their own order; far is 0, and nothing seen is 0.

    `cut_at_near`: leave out what is nearer than the near plane; only worth its cost
    where something is.
    """
    gl = programs.context.gl
    targets.bind(targets.see_into)
    apply(gl, STATE)
    for side in (g.GL_FRONT, g.GL_BACK):
        gl.glStencilMaskSeparate(side, 0xFF)
    gl.glClearNamedFramebufferuiv(targets.see_into, g.GL_COLOR, 0, (g._U * 4)())
    gl.glClearNamedFramebufferfi(targets.see_into, g.GL_DEPTH_STENCIL, 0, 0.0, 0)
    options = ("CUT_AT_NEAR",) if cut_at_near else ()
    if by_geometry_shader:
        program = programs.get("nothing.vert", "visible.frag", "visible.geom", options)
    else:
        program = programs.get("visible.vert", "visible.frag", options=options)
    program.set(uniforms)
    program.draw(g.GL_TRIANGLES, 3 * n_faces)


DISPLACE: Final = PassState(depth_test="always", depth_write=True, color_write=False)


def displace(programs: Programs, targets: Targets, uniforms: dict[str, Any]) -> None:
    """Move the visible point of every pixel a little to the eye's side of its face.

    A point is lit by definition if the segment from X, displaced to the eye's side, meets
    nothing. Without that, a volume that begins on the very surface that is seen, or whose
    side lies in it, is before or behind X as its rounding falls.
    """
    gl = programs.context.gl
    targets.bind(targets.displace_into)
    apply(gl, DISPLACE)
    gl.glBindTextureUnit(0, targets.seen)
    program = programs.get("whole.vert", "displace.frag")
    program.set(uniforms)
    program.draw(g.GL_TRIANGLES, 3)
