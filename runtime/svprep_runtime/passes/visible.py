"""The first passes: which face each pixel sees, and where volumes are counted for it.

see         faces --> the nearest float32 depth, and the first face of the file that has it
displace    X --> X', a little to the eye's side of that face
see again   faces --> of all that have that depth, the one that float64 says is nearest;
            and whether one of them hides X' from the eye
settle      X' where that says otherwise --> depth
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from svprep_runtime import gl_raw as g
from svprep_runtime.programs import Programs
from svprep_runtime.state import PassState, apply
from svprep_runtime.targets import Targets

STATE: Final = PassState(depth_test="greater", depth_write=True)
"""Strictly nearer wins, so of faces at one depth the first one of the file."""
DISPLACE: Final = PassState(depth_test=None, color_write=False)
SETTLE: Final = PassState(depth_test="always", depth_write=True, color_write=False)


@dataclass(frozen=True, slots=True)
class Faces:
    """All faces of the scene that is bound, and how they are drawn."""

    n: int
    cut_at_near: bool
    """Leave out what is nearer than the near plane; only worth its cost where something is."""
    by_geometry_shader: bool = False

    def draw(self, programs: Programs, uniforms: dict[str, Any], *options: str) -> None:
        """Draw them in their own order."""
        if self.cut_at_near:
            options += ("CUT_AT_NEAR",)
        if self.by_geometry_shader:
            program = programs.get("nothing.vert", "visible.frag", "visible.geom", options)
        else:
            program = programs.get("visible.vert", "visible.frag", options=options)
        program.set(uniforms)
        program.draw(g.GL_TRIANGLES, 3 * self.n)


def see(programs: Programs, targets: Targets, uniforms: dict[str, Any], faces: Faces) -> None:
    """Draw all faces; far is 0, and nothing seen is 0."""
    gl = programs.context.gl
    targets.bind(targets.see_into)
    apply(gl, STATE)
    for side in (g.GL_FRONT, g.GL_BACK):
        gl.glStencilMaskSeparate(side, 0xFF)
    gl.glClearNamedFramebufferuiv(targets.see_into, g.GL_COLOR, 0, (g._U * 4)())
    gl.glClearNamedFramebufferfv(targets.see_into, g.GL_COLOR, 1, (g._F * 4)())
    gl.glClearNamedFramebufferfi(targets.see_into, g.GL_DEPTH_STENCIL, 0, 0.0, 0)
    faces.draw(programs, uniforms)


def see_again(programs: Programs, targets: Targets, uniforms: dict[str, Any], faces: Faces) -> None:
    """Draw all faces once more, against what `see` and `displace` found.

    Two walls a few micrometres apart have one float32 depth at a hundred metres. What is
    left in the depth buffer is no depth: `settle` writes it.
    """
    gl = programs.context.gl
    targets.bind(targets.see_again_into)
    targets.bind_displaced()
    apply(gl, STATE)
    gl.glClearNamedFramebufferfi(targets.see_again_into, g.GL_DEPTH_STENCIL, 0, 0.0, 0)
    gl.glBindTextureUnit(1, targets.count)
    faces.draw(programs, uniforms, "AGAIN")


def displace(programs: Programs, targets: Targets, uniforms: dict[str, Any]) -> None:
    """Move the visible point of every pixel a little to the eye's side of its face.

    A point is lit by definition if the segment from X, displaced to the eye's side, meets
    nothing. Without that, a volume that begins on the very surface that is seen, or whose
    side lies in it, is before or behind X as its rounding falls.
    """
    _over_picture(programs, targets, uniforms, DISPLACE, ())


def settle(programs: Programs, targets: Targets, uniforms: dict[str, Any]) -> None:
    """Write the depth that volumes are counted against, that of X'."""
    _over_picture(programs, targets, uniforms, SETTLE, ("AGAIN",))
    programs.context.gl.glMemoryBarrier(g.GL_ALL_BARRIER_BITS)


def _over_picture(
    programs: Programs,
    targets: Targets,
    uniforms: dict[str, Any],
    state: PassState,
    options: tuple[str, ...],
) -> None:
    gl = programs.context.gl
    targets.bind(targets.displace_into)
    targets.bind_displaced()
    apply(gl, state)
    gl.glBindTextureUnit(0, targets.seen)
    program = programs.get("whole.vert", "displace.frag", options=options)
    program.set(uniforms)
    program.draw(g.GL_TRIANGLES, 3)
