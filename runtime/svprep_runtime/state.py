"""The complete state of a pass, as one value.

A pass sets everything that decides what it draws and assumes nothing of what was set
before. `apply` is the only place that changes such state.

    fragment --> stencil test --fail--> op `stencil_fail`
                     | pass
                 depth test ----fail--> op `depth_fail`
                     | pass
                 op `depth_pass`, colour blended, depth written
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from svprep_runtime import gl_raw as g

Compare = Literal["never", "less", "equal", "lequal", "greater", "notequal", "gequal", "always"]
Op = Literal["keep", "zero", "replace", "incr", "decr", "invert", "incr_wrap", "decr_wrap"]
Blend = Literal["off", "add", "alpha"]

_COMPARE: Final[dict[Compare, int]] = {
    "never": g.GL_NEVER,
    "less": g.GL_LESS,
    "equal": g.GL_EQUAL,
    "lequal": g.GL_LEQUAL,
    "greater": g.GL_GREATER,
    "notequal": g.GL_NOTEQUAL,
    "gequal": g.GL_GEQUAL,
    "always": g.GL_ALWAYS,
}
_OP: Final[dict[Op, int]] = {
    "keep": g.GL_KEEP,
    "zero": g.GL_ZERO,
    "replace": g.GL_REPLACE,
    "incr": g.GL_INCR,
    "decr": g.GL_DECR,
    "invert": g.GL_INVERT,
    "incr_wrap": g.GL_INCR_WRAP,
    "decr_wrap": g.GL_DECR_WRAP,
}
_BLEND: Final[dict[Blend, tuple[int, int]]] = {
    "off": (g.GL_ONE, g.GL_ZERO),
    "add": (g.GL_ONE, g.GL_ONE),
    "alpha": (g.GL_SRC_ALPHA, g.GL_ONE_MINUS_SRC_ALPHA),
}


@dataclass(frozen=True, slots=True)
class StencilFace:
    """What the stencil test does with fragments of one side, front or back."""

    compare: Compare = "always"
    """``(reference & mask) compare (stored & mask)``"""
    reference: int = 0
    mask: int = 0xFF
    stencil_fail: Op = "keep"
    depth_fail: Op = "keep"
    depth_pass: Op = "keep"
    write_mask: int = 0xFF


@dataclass(frozen=True, slots=True)
class PassState:
    """All that decides which fragments of a pass change what. Depth is reversed: 1 is near."""

    depth_test: Compare | None = "greater"
    """None: no test, and nothing is written to depth either."""
    depth_write: bool = False
    color_write: bool = True
    blend: Blend = "off"
    stencil: tuple[StencilFace, StencilFace] | None = None
    """Of front and of back faces; None: no test, nothing is written."""
    offset: tuple[float, float] = (0.0, 0.0)
    """Polygon offset, (factor, units); negative is away from the eye."""
    depth_clamp: bool = True
    """Off: what is nearer than the near plane is cut away."""
    clip_planes: int = 0
    """How many clip distances of the vertex shader cut, 0 or 1."""
    line_width_px: float = 1.0


def two_sided(front: Op, back: Op) -> tuple[StencilFace, StencilFace]:
    """Return a stencil that counts what passes the depth test, front and back apart."""
    return StencilFace(depth_pass=front), StencilFace(depth_pass=back)


def apply(gl: g.RawGL, state: PassState) -> None:
    """Make `state` the current one, whatever was set before."""
    gl.glClipControl(g.GL_LOWER_LEFT, g.GL_ZERO_TO_ONE)
    gl.glFrontFace(g.GL_CCW)
    _enable(gl, g.GL_DEPTH_CLAMP, state.depth_clamp)
    _enable(gl, g.GL_CLIP_DISTANCE0, state.clip_planes > 0)
    gl.glPolygonMode(g.GL_FRONT_AND_BACK, g.GL_FILL)
    for unused in (
        g.GL_CULL_FACE,
        g.GL_SCISSOR_TEST,
        g.GL_COLOR_LOGIC_OP,
        g.GL_RASTERIZER_DISCARD,
    ):
        gl.glDisable(unused)
    _enable(gl, g.GL_DEPTH_TEST, state.depth_test is not None)
    gl.glDepthFunc(_COMPARE[state.depth_test or "always"])
    gl.glDepthMask(state.depth_write)
    gl.glColorMask(*(state.color_write,) * 4)
    _enable(gl, g.GL_BLEND, state.blend != "off")
    gl.glBlendEquation(g.GL_FUNC_ADD)
    gl.glBlendFunc(*_BLEND[state.blend])
    _enable(gl, g.GL_POLYGON_OFFSET_FILL, state.offset != (0.0, 0.0))
    gl.glPolygonOffset(*state.offset)
    gl.glLineWidth(state.line_width_px)
    _enable(gl, g.GL_STENCIL_TEST, state.stencil is not None)
    sides = state.stencil or (StencilFace(write_mask=0), StencilFace(write_mask=0))
    for side, face in zip((g.GL_FRONT, g.GL_BACK), sides, strict=True):
        gl.glStencilFuncSeparate(side, _COMPARE[face.compare], face.reference, face.mask)
        gl.glStencilOpSeparate(
            side, _OP[face.stencil_fail], _OP[face.depth_fail], _OP[face.depth_pass]
        )
        gl.glStencilMaskSeparate(side, face.write_mask)


def _enable(gl: g.RawGL, what: int, is_on: bool) -> None:
    (gl.glEnable if is_on else gl.glDisable)(what)
