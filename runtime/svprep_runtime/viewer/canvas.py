"""Pictures that the viewer draws into: a frame with its overlays, and what the window shows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from svprep.errors import EnvironmentProblem
from svprep.model import U8
from svprep_runtime import gl_raw as g
from svprep_runtime.context import Context
from svprep_runtime.targets import Targets


@dataclass(slots=True)
class Canvas:
    """An 8-bit picture and its framebuffer. Release it."""

    context: Context
    width_px: int
    height_px: int
    depth: int = 0
    """A texture of the same size, which passes test against; 0: none."""
    picture: int = field(default=0, init=False)
    into: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        gl = self.context.gl
        self.picture = gl.create(lambda n, at: gl.glCreateTextures(g.GL_TEXTURE_2D, n, at))
        gl.glTextureStorage2D(self.picture, 1, g.GL_RGBA8, self.width_px, self.height_px)
        for which in (g.GL_TEXTURE_MIN_FILTER, g.GL_TEXTURE_MAG_FILTER):
            gl.glTextureParameteri(self.picture, which, g.GL_NEAREST)
        self.into = gl.create(gl.glCreateFramebuffers)
        gl.glNamedFramebufferTexture(self.into, g.GL_COLOR_ATTACHMENT0, self.picture, 0)
        if self.depth:
            gl.glNamedFramebufferTexture(self.into, g.GL_DEPTH_STENCIL_ATTACHMENT, self.depth, 0)
        status = gl.glCheckNamedFramebufferStatus(self.into, g.GL_FRAMEBUFFER)
        if status != g.GL_FRAMEBUFFER_COMPLETE:
            self.release()
            raise EnvironmentProblem(
                f"no graphics memory for a window of {self.width_px}x{self.height_px}; "
                "a smaller one: --size"
            )

    def bind(self) -> None:
        """Draw into it, all of it."""
        bind(self.context, self.into, self.width_px, self.height_px)

    def read(self) -> U8:
        """Return ``(height, width, 3) uint8``, the top row first."""
        gl = self.context.gl
        pixels = np.empty((self.height_px, self.width_px, 4), np.uint8)
        gl.glPixelStorei(g.GL_PACK_ALIGNMENT, 1)
        gl.glGetTextureImage(
            self.picture, 0, g.GL_RGBA, g.GL_UNSIGNED_BYTE, pixels.nbytes, pixels.ctypes.data
        )
        return np.ascontiguousarray(pixels[::-1, :, :3])

    def release(self) -> None:
        """Give it back."""
        gl = self.context.gl
        gl.delete(gl.glDeleteFramebuffers, self.into)
        gl.delete(gl.glDeleteTextures, self.picture)
        self.into = self.picture = 0


@dataclass(slots=True)
class Layers:
    """A frame's targets and the picture with overlays over it, of one size. Release them."""

    targets: Targets
    canvas: Canvas

    def release(self) -> None:
        """Give both back."""
        self.canvas.release()
        self.targets.release()


def layers(context: Context, width_px: int, height_px: int, n_lights: int) -> Layers:
    """Return new layers."""
    targets = Targets(context, width_px, height_px, max(n_lights, 1))
    try:
        return Layers(targets, Canvas(context, width_px, height_px, targets.depth))
    except BaseException:
        targets.release()
        raise


def bind(context: Context, framebuffer: int, width_px: int, height_px: int) -> None:
    """Draw into `framebuffer`, which has that size; 0 is the window."""
    context.gl.glBindFramebuffer(g.GL_FRAMEBUFFER, framebuffer)
    context.gl.glViewport(0, 0, width_px, height_px)


def face_at(context: Context, targets: Targets, column: int, row_from_below: int) -> int | None:
    """Return the face that a pixel of `targets` sees; None: the sky. Waits for the card."""
    gl = context.gl
    seen = (g._U * 1)()
    gl.glBindFramebuffer(g.GL_FRAMEBUFFER, targets.see_into)
    gl.glReadBuffer(g.GL_COLOR_ATTACHMENT0)
    gl.glPixelStorei(g.GL_PACK_ALIGNMENT, 1)
    gl.glReadPixels(column, row_from_below, 1, 1, g.GL_RED_INTEGER, g.GL_UNSIGNED_INT, seen)
    face = (int(seen[0]) & 0x7FFFFFFF) - 1
    return face if face >= 0 else None
