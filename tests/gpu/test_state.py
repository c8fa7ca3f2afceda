"""Each outcome of the stencil and depth tests, exact to the pixel, and states that stay whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pytest

from svprep_runtime import gl_raw as g
from svprep_runtime.context import Context
from svprep_runtime.passes.counting import counting_state
from svprep_runtime.state import PassState, StencilFace, apply, two_sided
from svprep_runtime.targets import Targets

if TYPE_CHECKING:
    import moderngl

N = 64
LEFT, RIGHT, TOP, BOTTOM = 5, 41, 7, 50
"""Of the rectangle that is drawn: columns and rows of the picture, ends excluded."""
INSIDE = np.zeros((N, N), bool)
INSIDE[TOP:BOTTOM, LEFT:RIGHT] = True

VERTEX = """#version 450 core
uniform vec4 bounds;   // left, bottom, right, top
uniform vec4 depths;   // of left bottom, right bottom, right top, left top
uniform bool is_back;
void main() {
    int corner = int[6](0, 1, 2, 0, 2, 3)[is_back ? 5 - gl_VertexID : gl_VertexID];
    float x = corner == 0 || corner == 3 ? bounds.x : bounds.z;
    float y = corner < 2 ? bounds.y : bounds.w;
    gl_Position = vec4(x, y, depths[corner], 1.0);
}
"""
FRAGMENT = """#version 450 core
uniform float value;
layout(location = 0) out vec4 colour;
void main() { colour = vec4(value, 0.0, 0.0, 0.5); }
"""


@dataclass
class Canvas:
    """64 x 64 pixels of float colour, depth and stencil, and a rectangle to draw on them."""

    context: Context
    targets: Targets
    program: moderngl.Program
    vertices: moderngl.VertexArray

    def clear(self, *, stencil: int = 0, depth: float = 0.5, colour: float = 0.0) -> None:
        # Clearing honours masks: what is tested here is left to do so by no state.
        apply(self.context.gl, PassState(depth_write=True, stencil=two_sided("keep", "keep")))
        self.targets.bind(self.targets.count_into)
        gl, into = self.context.gl, self.targets.count_into
        gl.glClearNamedFramebufferfv(into, g.GL_COLOR, 0, (g._F * 4)(colour))
        gl.glClearNamedFramebufferfi(into, g.GL_DEPTH_STENCIL, 0, depth, stencil)

    def draw(
        self,
        state: PassState,
        depth: float | tuple[float, float, float, float] = 0.75,
        *,
        value: float = 1.0,
        is_back: bool = False,
    ) -> None:
        apply(self.context.gl, state)
        self.rectangle(depth, value=value, is_back=is_back)

    def rectangle(
        self,
        depth: float | tuple[float, float, float, float],
        *,
        value: float = 1.0,
        is_back: bool = False,
    ) -> None:
        self.targets.bind(self.targets.count_into)
        x0, x1 = (2.0 * c / N - 1.0 for c in (LEFT, RIGHT))
        y0, y1 = (1.0 - 2.0 * r / N for r in (BOTTOM, TOP))
        self.program["bounds"].value = (x0, y0, x1, y1)
        self.program["depths"].value = depth if isinstance(depth, tuple) else (depth,) * 4
        self.program["is_back"].value = is_back
        self.program["value"].value = value
        self.vertices.render(g.GL_TRIANGLES, vertices=6)

    @property
    def stencil(self) -> np.ndarray:
        return self.targets.read_stencil()

    @property
    def colour(self) -> np.ndarray:
        return self.targets.read_count()

    @property
    def depth(self) -> np.ndarray:
        return self.targets.read(self.targets.depth, g.GL_DEPTH_COMPONENT, g.GL_FLOAT, np.float32)


@pytest.fixture
def canvas(context: Context) -> Iterator[Canvas]:
    targets = Targets(context, N, N, 1)
    program = context.ctx.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
    vertices = context.ctx.vertex_array(program, [])
    yield Canvas(context, targets, program, vertices)
    vertices.release()
    program.release()
    targets.release()


# The stencil -------------------------------------------------------------------------------------

REFERENCE = 0x35
OPS: dict[str, Callable[[int], int]] = {
    "keep": lambda v: v,
    "zero": lambda v: 0,
    "replace": lambda v: REFERENCE,
    "incr": lambda v: min(v + 1, 255),
    "decr": lambda v: max(v - 1, 0),
    "invert": lambda v: v ^ 0xFF,
    "incr_wrap": lambda v: (v + 1) % 256,
    "decr_wrap": lambda v: (v - 1) % 256,
}
STORED = (0, 1, 0x35, 254, 255)


@pytest.mark.parametrize("op", OPS)
@pytest.mark.parametrize("outcome", ["stencil_fail", "depth_fail", "depth_pass"])
@pytest.mark.parametrize("is_back", [False, True], ids=["front", "back"])
def test_each_outcome_does_its_own_operation(
    canvas: Canvas, is_back: bool, outcome: str, op: str
) -> None:
    # Whatever else happened would be seen: every other operation gives another number.
    other = "invert" if op != "invert" else "incr_wrap"
    ops = {"stencil_fail": other, "depth_fail": other, "depth_pass": other, outcome: op}
    tested = StencilFace(
        compare="never" if outcome == "stencil_fail" else "always", reference=REFERENCE, **ops
    )
    untested = StencilFace(stencil_fail=other, depth_fail=other, depth_pass=other)
    state = PassState(stencil=(untested, tested) if is_back else (tested, untested))
    for stored in STORED:
        canvas.clear(stencil=stored)
        canvas.draw(state, 0.75 if outcome != "depth_fail" else 0.25, is_back=is_back)
        np.testing.assert_array_equal(
            canvas.stencil, np.where(INSIDE, OPS[op](stored), stored), err_msg=f"{stored}"
        )
        is_drawn = INSIDE & (outcome == "depth_pass")
        np.testing.assert_array_equal(canvas.colour, is_drawn.astype(float))
        assert (canvas.depth == 0.5).all()


def test_wrapping_counts_come_back_from_beyond_both_ends(canvas: Canvas) -> None:
    up, down = (PassState(stencil=two_sided(op, op)) for op in ("incr_wrap", "decr_wrap"))
    for begin, there, back in ((255, up, down), (0, down, up)):
        canvas.clear(stencil=begin)
        for state in (there, there, there, back, back, back):
            canvas.draw(state)
        assert (canvas.stencil == begin).all()
    canvas.clear(stencil=3)
    for _ in range(256):
        canvas.draw(up)
    assert (canvas.stencil == 3).all()


@pytest.mark.parametrize(
    ("compare", "passes"),
    [
        ("never", []),
        ("less", [0x36]),
        ("equal", [0x35, 0xF5]),
        ("lequal", [0x35, 0x36, 0xF5]),
        ("greater", [0x34]),
        ("notequal", [0x34, 0x36]),
        ("gequal", [0x34, 0x35, 0xF5]),
        ("always", [0x34, 0x35, 0x36, 0xF5]),
    ],
)
def test_reference_and_stored_are_compared_under_the_mask(
    canvas: Canvas, compare: str, passes: list[int]
) -> None:
    face = StencilFace(
        compare=compare, reference=0x65, mask=0x0F, stencil_fail="zero", depth_pass="invert"
    )
    for stored in (0x34, 0x35, 0x36, 0xF5):
        canvas.clear(stencil=stored)
        canvas.draw(PassState(stencil=(face, face)))
        expected = stored ^ 0xFF if stored in passes else 0
        assert (canvas.stencil == np.where(INSIDE, expected, stored)).all(), hex(stored)


def test_front_and_back_faces_count_apart_in_one_draw(canvas: Canvas) -> None:
    state = PassState(stencil=two_sided("incr_wrap", "decr_wrap"))
    canvas.clear(stencil=10)
    for is_back in (False, False, False, True):
        canvas.draw(state, is_back=is_back)
    np.testing.assert_array_equal(canvas.stencil, np.where(INSIDE, 12, 10))


# Depth -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_back", [False, True])
def test_before_and_behind_are_exact_complements(canvas: Canvas, is_back: bool) -> None:
    half = np.float32(0.5)
    for depth in (0.0, 0.25, np.nextafter(half, np.float32(0)), half,
                  np.nextafter(half, np.float32(1)), 0.75, 1.0):  # fmt: skip
        for compare, passes in (("greater", depth > half), ("lequal", depth <= half)):
            canvas.clear()
            canvas.draw(PassState(depth_test=compare), float(depth), is_back=is_back)
            np.testing.assert_array_equal(canvas.colour, (INSIDE & passes).astype(float))


def test_what_has_the_depth_of_the_scene_is_behind_it(canvas: Canvas) -> None:
    slanted = (0.1, 0.837, 0.52, 0.3)
    canvas.clear(depth=0.0)
    canvas.draw(PassState(depth_test="greater", depth_write=True), slanted)
    scene = canvas.depth.copy()
    assert len(np.unique(scene[INSIDE])) > 500
    for compare, n in (("greater", 0), ("lequal", 1), ("equal", 1)):
        canvas.draw(PassState(depth_test=compare, blend="add"), slanted, value=1.0)
        assert (canvas.colour[INSIDE] == 1 + n).all(), compare
        canvas.draw(PassState(depth_test="always"), slanted)
    assert (canvas.depth == scene).all()


def test_each_fragment_is_either_before_or_behind(canvas: Canvas) -> None:
    canvas.clear(depth=0.0)
    canvas.draw(PassState(depth_write=True), (0.1, 0.9, 0.5, 0.3), value=0.0)
    canvas.draw(PassState(depth_test="greater", blend="add"), (0.9, 0.1, 0.4, 0.6), value=1.0)
    canvas.draw(PassState(depth_test="lequal", blend="add"), (0.9, 0.1, 0.4, 0.6), value=100.0)
    assert set(np.unique(canvas.colour[INSIDE])) == {1.0, 100.0}


def test_depth_clamp_keeps_what_is_nearer_than_near(canvas: Canvas) -> None:
    for clamp, expected in ((True, 1.0), (False, 0.5)):
        canvas.clear()
        canvas.draw(PassState(depth_write=True, depth_clamp=clamp), 1.5)
        np.testing.assert_array_equal(canvas.colour, (INSIDE & clamp).astype(float))
        assert (canvas.depth == np.where(INSIDE, expected, 0.5)).all()
    # Across the near plane: the left half of the rectangle is beyond it.
    halves = (0.5, 1.5, 1.5, 0.5)
    columns = np.broadcast_to(np.arange(N) < (LEFT + RIGHT) // 2, (N, N))
    for clamp in (True, False):
        canvas.clear(depth=0.25)
        canvas.draw(PassState(depth_clamp=clamp), halves)
        np.testing.assert_array_equal(canvas.colour, (INSIDE & (columns | clamp)).astype(float))


def test_depth_clamp_keeps_what_is_beyond_far(canvas: Canvas) -> None:
    canvas.clear(depth=0.5)
    canvas.draw(PassState(depth_test="lequal", depth_write=True), -0.5)
    assert (canvas.depth == np.where(INSIDE, 0.0, 0.5)).all()


@pytest.mark.parametrize("counter", ["float", "stencil"])
def test_what_counts_before_x_and_what_behind_it_add_up(canvas: Canvas, counter: str) -> None:
    """At any depth, one draw before and one behind give the volume's front or back, once."""
    for depth in (0.25, 0.5, 0.75):
        for is_back, orientation in product((False, True), (1, -1)):
            found = []
            for when in ("before", "behind"):
                canvas.clear(stencil=100, colour=100.0)
                sign = 1 if (orientation > 0) == (when == "before") else -1
                canvas.draw(
                    counting_state(counter, when, orientation),
                    depth,
                    value=float(-sign if is_back else sign),  # as `count.frag` does
                    is_back=is_back,
                )
                counted = canvas.colour if counter == "float" else canvas.stencil
                found.append(counted.astype(int) - 100)
                assert (canvas.depth == 0.5).all()
            expected = -orientation if is_back else orientation
            assert (found[0] == np.where(INSIDE & (depth > 0.5), expected, 0)).all()
            assert (found[1] == np.where(INSIDE & (depth <= 0.5), -expected, 0)).all()


# Masks and colour --------------------------------------------------------------------------------


def test_write_masks_hold_each_of_the_three_back(canvas: Canvas) -> None:
    canvas.clear(colour=7.0, stencil=0x5A)
    canvas.draw(PassState(color_write=False), value=1.0)
    assert (canvas.colour == 7.0).all()
    canvas.draw(PassState(depth_write=False))
    assert (canvas.depth == 0.5).all()
    assert (canvas.colour == np.where(INSIDE, 1.0, 7.0)).all()
    canvas.draw(PassState(depth_test=None, depth_write=True))
    assert (canvas.depth == 0.5).all()
    assert (canvas.stencil == 0x5A).all()  # no stencil: nothing is written
    face = StencilFace(depth_pass="invert", write_mask=0x0F)
    canvas.draw(PassState(stencil=(face, StencilFace(depth_pass="zero"))))
    assert (canvas.stencil == np.where(INSIDE, 0x55, 0x5A)).all()
    canvas.draw(PassState(depth_write=True))
    assert (canvas.depth == np.where(INSIDE, 0.75, 0.5)).all()


def test_floats_add_up_with_their_signs(canvas: Canvas) -> None:
    canvas.clear(colour=-2.0)
    for value in (5.0, -9.0, 0.5, -1.0):
        canvas.draw(PassState(blend="add"), value=value)
    assert (canvas.colour == np.where(INSIDE, -6.5, -2.0)).all()
    canvas.clear(colour=2.0**24 - 1)
    canvas.draw(PassState(blend="add"), value=1.0)
    canvas.draw(PassState(blend="add"), value=-(2.0**24))
    assert (canvas.colour == np.where(INSIDE, 0.0, 2.0**24 - 1)).all()


def test_overlays_blend_by_their_alpha(canvas: Canvas) -> None:
    canvas.clear(colour=3.0)
    canvas.draw(PassState(blend="alpha"), value=1.0)
    assert (canvas.colour == np.where(INSIDE, 2.0, 3.0)).all()


def test_an_offset_moves_depth_away_or_near(canvas: Canvas) -> None:
    for offset, passes in (((-1.0, -8.0), False), ((0.0, 0.0), False), ((1.0, 8.0), True)):
        canvas.clear(depth=0.5)
        canvas.draw(PassState(offset=offset), 0.5)
        assert (canvas.colour == (INSIDE & passes)).all(), offset


# Nothing is assumed, nothing is left behind ------------------------------------------------------

STATES = (
    PassState(),
    PassState(depth_test=None, blend="add"),
    PassState(depth_write=True),
    PassState(depth_test="lequal", color_write=False, stencil=two_sided("incr_wrap", "decr_wrap")),
    PassState(depth_test="greater", blend="add", depth_clamp=False),
    PassState(depth_test="gequal", offset=(-1.0, -4.0), blend="alpha", line_width_px=2.0),
    PassState(
        stencil=(
            StencilFace("equal", 3, 0xF0, "zero", "invert", "replace", 0xFE),
            StencilFace("notequal", 4, 0x0F, "decr", "incr", "keep", 0x7F),
        )
    ),
)


_clean: list[list[np.ndarray]] = []


def drawn(canvas: Canvas, state: PassState, foreign: Callable[[], None]) -> list[np.ndarray]:
    canvas.clear(stencil=5, depth=0.5, colour=2.0)
    foreign()
    apply(canvas.context.gl, state)
    for depth, is_back in ((0.75, False), (0.25, True), (0.5, False), ((0.2, 1.4, 0.9, -1), True)):
        canvas.rectangle(depth, value=4.0, is_back=is_back)
    return [canvas.stencil.copy(), canvas.depth.copy(), canvas.colour.copy()]


def foreign_raw(canvas: Canvas) -> None:
    gl = canvas.context.gl
    for what in (g.GL_CULL_FACE, g.GL_SCISSOR_TEST, g.GL_BLEND, g.GL_STENCIL_TEST,
                 g.GL_POLYGON_OFFSET_FILL, g.GL_CLIP_DISTANCE0, g.GL_COLOR_LOGIC_OP):  # fmt: skip
        gl.glEnable(what)
    gl.glDisable(g.GL_DEPTH_TEST)
    gl.glDisable(g.GL_DEPTH_CLAMP)
    gl.glCullFace(g.GL_FRONT)
    gl.glFrontFace(0x0900)
    gl.glScissor(3, 3, 9, 9)
    gl.glDepthFunc(g.GL_NEVER)
    gl.glDepthMask(False)
    gl.glColorMask(False, True, False, True)
    gl.glBlendFunc(g.GL_ZERO, g.GL_ZERO)
    gl.glBlendEquation(0x800A)  # subtract
    gl.glPolygonOffset(7.0, 700.0)
    gl.glClipControl(0x8CA2, g.GL_NEGATIVE_ONE_TO_ONE)  # upper left
    for side in (g.GL_FRONT, g.GL_BACK):
        gl.glStencilFuncSeparate(side, g.GL_NEVER, 9, 0x11)
        gl.glStencilOpSeparate(side, g.GL_ZERO, g.GL_INVERT, g.GL_ZERO)
        gl.glStencilMaskSeparate(side, 0)


def foreign_moderngl(canvas: Canvas) -> None:
    ctx = canvas.context.ctx
    ctx.enable_only(ctx.CULL_FACE | ctx.BLEND)
    ctx.front_face = "cw"
    ctx.cull_face = "front"
    ctx.blend_func = ctx.SRC_ALPHA, ctx.ONE_MINUS_SRC_ALPHA, ctx.ZERO, ctx.ONE
    ctx.blend_equation = ctx.FUNC_REVERSE_SUBTRACT, ctx.MAX
    ctx.depth_func = "<"
    ctx.polygon_offset = 3.0, 30.0
    ctx.line_width = 1.0


def foreign_wireframe(canvas: Canvas) -> None:
    canvas.context.ctx.wireframe = True


def foreign_discard(canvas: Canvas) -> None:
    ctx = canvas.context.ctx
    ctx.enable_only(ctx.RASTERIZER_DISCARD | ctx.PROGRAM_POINT_SIZE)


def foreign_states(canvas: Canvas) -> None:
    for state in STATES:
        apply(canvas.context.gl, state)


@pytest.mark.parametrize(
    "foreign",
    [foreign_raw, foreign_moderngl, foreign_wireframe, foreign_discard, foreign_states],
    ids=lambda f: f.__name__.removeprefix("foreign_"),
)
def test_a_state_is_whole_whatever_was_set_before(
    canvas: Canvas, foreign: Callable[[Canvas], None]
) -> None:
    ctx = canvas.context.ctx
    # Before anything foreign was set: this must not leak from one case to the next either.
    if not _clean:
        _clean.extend(drawn(canvas, state, lambda: None) for state in STATES)
    try:
        for state, expected in zip(STATES, _clean, strict=True):
            found = drawn(canvas, state, lambda: foreign(canvas))
            for one, other in zip(expected, found, strict=True):
                np.testing.assert_array_equal(one, other, err_msg=str(state))
            assert canvas.context.gl.glGetError() == 0
    finally:
        ctx.wireframe = False
        ctx.enable_only(0)
        ctx.front_face, ctx.cull_face = "ccw", "back"
