"""The pictures that passes draw into, each format for a reason.

depth    32-bit float + 8 stencil    reversed depth of one relative precision everywhere
seen     R32UI     1 + face, highest bit: its front     one visible face a pixel, resolved
                                                        once for all lights
count    R32F      signed, exact to 2**24; one add counts |m| and never wraps; before that,
                   the depth of what is seen, to be read
displaced RGBA32UI  where each pixel's point is counted: see displace.frag
radiance RGBA32F   sums over lights and samples
votes    R32F      samples in shadow, one a light
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svprep.errors import EnvironmentProblem, InputError
from svprep.model import F32, U8, U32
from svprep_runtime import gl_raw as g
from svprep_runtime.context import Context


@dataclass(slots=True)
class Targets:
    """Textures and framebuffers of one size. Release them."""

    context: Context
    width_px: int
    height_px: int
    n_lights: int
    depth: int = 0
    seen: int = 0
    count: int = 0
    displaced: int = 0
    radiance: int = 0
    votes: list[int] = field(default_factory=list)
    see_into: int = 0
    """Framebuffer: seen and count, with depth."""
    see_again_into: int = 0
    """Framebuffer: seen, with depth."""
    count_into: int = 0
    """Framebuffer: count, with depth and stencil."""
    displace_into: int = 0
    """Framebuffer: depth alone."""
    light_into: list[int] = field(default_factory=list)
    """Framebuffers: radiance and the votes of each light; without depth."""
    ambient_into: int = 0
    """Framebuffer: radiance."""
    _textures: list[int] = field(default_factory=list)
    _framebuffers: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        most = self.context.most_pixels_a_side
        if not (1 <= self.width_px <= most and 1 <= self.height_px <= most):
            raise InputError(
                f"a picture of {self.width_px}x{self.height_px} pixels cannot be drawn: "
                f"1 to {most} each way with this driver"
            )
        try:
            self._make()
        except BaseException:
            self.release()
            raise

    def _make(self) -> None:
        gl = self.context.gl
        while gl.glGetError():
            pass
        self.depth = self._texture(g.GL_DEPTH32F_STENCIL8)
        gl.glTextureParameteri(self.depth, g.GL_DEPTH_STENCIL_TEXTURE_MODE, g.GL_STENCIL_INDEX)
        self.seen = self._texture(g.GL_R32UI)
        self.count = self._texture(g.GL_R32F)
        self.displaced = self._texture(g.GL_RGBA32UI)
        self.radiance = self._texture(g.GL_RGBA32F)
        self.votes = [self._texture(g.GL_R32F) for _ in range(self.n_lights)]
        if gl.glGetError():
            raise self._no_memory()
        self.see_into = self._framebuffer([self.seen, self.count], with_depth=True)
        self.see_again_into = self._framebuffer([self.seen], with_depth=True)
        self.count_into = self._framebuffer([self.count], with_depth=True)
        self.displace_into = self._framebuffer([], with_depth=True)
        self.light_into = [
            self._framebuffer([self.radiance, votes], with_depth=False) for votes in self.votes
        ]
        self.ambient_into = self._framebuffer([self.radiance], with_depth=False)
        if gl.glGetError():
            raise self._no_memory()

    def _no_memory(self) -> EnvironmentProblem:
        return EnvironmentProblem(
            f"no graphics memory for a picture of {self.width_px}x{self.height_px}; "
            "a smaller one: --size"
        )

    def _texture(self, format_: int) -> int:
        gl = self.context.gl
        name = gl.create(lambda n, at: gl.glCreateTextures(g.GL_TEXTURE_2D, n, at))
        self._textures.append(name)
        gl.glTextureStorage2D(name, 1, format_, self.width_px, self.height_px)
        for which in (g.GL_TEXTURE_MIN_FILTER, g.GL_TEXTURE_MAG_FILTER):
            gl.glTextureParameteri(name, which, g.GL_NEAREST)
        return name

    def _framebuffer(self, colours: list[int], *, with_depth: bool) -> int:
        gl = self.context.gl
        name = gl.create(gl.glCreateFramebuffers)
        self._framebuffers.append(name)
        for i, texture in enumerate(colours):
            gl.glNamedFramebufferTexture(name, g.GL_COLOR_ATTACHMENT0 + i, texture, 0)
        if with_depth:
            gl.glNamedFramebufferTexture(name, g.GL_DEPTH_STENCIL_ATTACHMENT, self.depth, 0)
        attachments = (g._U * len(colours))(
            *(g.GL_COLOR_ATTACHMENT0 + i for i in range(len(colours)))
        )
        gl.glNamedFramebufferDrawBuffers(name, len(colours), attachments)
        status = gl.glCheckNamedFramebufferStatus(name, g.GL_FRAMEBUFFER)
        if status != g.GL_FRAMEBUFFER_COMPLETE:
            raise EnvironmentProblem(
                f"{self.context.renderer} cannot draw into the formats that exact shadows "
                f"need (32-bit float depth with stencil, float colour): status {status:#x}. "
                "Update the driver"
            )
        return name

    def bind(self, framebuffer: int) -> None:
        """Draw into `framebuffer`, all of it."""
        gl = self.context.gl
        gl.glBindFramebuffer(g.GL_FRAMEBUFFER, framebuffer)
        gl.glViewport(0, 0, self.width_px, self.height_px)

    def bind_displaced(self) -> None:
        """Let shaders read and write `displaced` as an image, after what wrote it before."""
        gl = self.context.gl
        gl.glMemoryBarrier(g.GL_ALL_BARRIER_BITS)
        gl.glBindImageTexture(0, self.displaced, 0, False, 0, g.GL_READ_WRITE, g.GL_RGBA32UI)

    def clear_sums(self) -> None:
        """Begin the sums over lights and samples at nothing."""
        gl = self.context.gl
        nothing = (g._F * 4)()
        gl.glColorMask(True, True, True, True)
        gl.glClearNamedFramebufferfv(self.ambient_into, g.GL_COLOR, 0, nothing)
        for framebuffer in self.light_into:
            gl.glClearNamedFramebufferfv(framebuffer, g.GL_COLOR, 1, nothing)

    def clear_count(self, begin: int, counter: str) -> None:
        """Begin to count at `begin`; depth stays."""
        gl = self.context.gl
        if counter == "stencil":
            for side in (g.GL_FRONT, g.GL_BACK):
                gl.glStencilMaskSeparate(side, 0xFF)
            value = (g._I * 1)(begin & 0xFF)
            gl.glClearNamedFramebufferiv(self.count_into, g.GL_STENCIL, 0, value)
        else:
            gl.glColorMask(True, True, True, True)
            first = (g._F * 4)(float(begin))
            gl.glClearNamedFramebufferfv(self.count_into, g.GL_COLOR, 0, first)

    def read_radiance(self) -> F32:
        """Return ``(height, width, 3)``."""
        return self.read(self.radiance, g.GL_RGBA, g.GL_FLOAT, np.float32, 4)[..., :3]

    def read_votes(self, light: int) -> F32:
        """Return ``(height, width)``: samples in shadow of a light."""
        return self.read(self.votes[light], g.GL_RED, g.GL_FLOAT, np.float32)

    def read_count(self) -> F32:
        """Return ``(height, width)``: the count that was made last, by the float counter."""
        return self.read(self.count, g.GL_RED, g.GL_FLOAT, np.float32)

    def read_seen(self) -> U32:
        """Return ``(height, width)``: 1 + the visible face, the highest bit its front."""
        return self.read(self.seen, g.GL_RED_INTEGER, g.GL_UNSIGNED_INT, np.uint32)

    def read_stencil(self) -> U8:
        """Return ``(height, width)``: the count that was made last, by the stencil."""
        return self.read(self.depth, g.GL_STENCIL_INDEX, g.GL_UNSIGNED_BYTE, np.uint8)

    def read(self, texture: int, format_: int, type_: int, dtype: type, n: int = 1) -> NDArray[Any]:
        """Return a texture as ``(height, width[, n])``, the top row first."""
        gl = self.context.gl
        shape = (self.height_px, self.width_px) + ((n,) if n > 1 else ())
        pixels: NDArray[Any] = np.empty(shape, dtype)
        gl.glPixelStorei(g.GL_PACK_ALIGNMENT, 1)
        gl.glGetTextureImage(texture, 0, format_, type_, pixels.nbytes, pixels.ctypes.data)
        return np.ascontiguousarray(pixels[::-1])

    def release(self) -> None:
        """Give textures and framebuffers back."""
        gl = self.context.gl
        for name in self._framebuffers:
            gl.delete(gl.glDeleteFramebuffers, name)
        for name in self._textures:
            gl.delete(gl.glDeleteTextures, name)
        self._framebuffers.clear()
        self._textures.clear()
