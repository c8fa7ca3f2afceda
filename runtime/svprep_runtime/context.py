"""An OpenGL context to draw with: headless through EGL, or that of a window.

Checked on the way: the packages and libraries that are needed, version 4.5, reversed
32-bit depth (clip control, 32F depth with 8 bits of stencil), storage buffers in vertex
and geometry shaders. What is missing is said in one line, with the install command.
"""

from __future__ import annotations

import contextlib
import ctypes.util
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from svprep.errors import EnvironmentProblem, require_extra
from svprep_runtime import gl_raw as g

if TYPE_CHECKING:
    import moderngl

VERSION: Final = 450
APT: Final = "apt-get install libegl1 libgl1 libgl1-mesa-dri"
LEAST_STORAGE_BLOCKS: Final = 8
_LEAST_TO_ASK: Final = 330


@dataclass(slots=True)
class Context:
    """A current context: moderngl's for programs, buffers and queries, raw GL beside it."""

    ctx: moderngl.Context
    gl: g.RawGL
    renderer: str
    """``"llvmpipe (LLVM 15.0.6, 256 bits)"``"""
    version: str
    """As the driver states it."""
    subpixel_bits: int
    most_pixels_a_side: int
    most_buffer_bytes: int
    """Of one storage buffer."""


@contextlib.contextmanager
def headless() -> Iterator[Context]:
    """Yield a context without a window; released afterwards.

    Raises
    ------
    EnvironmentProblem
        A package or library is missing, no driver was found, or it lacks what is needed.
    """
    moderngl, glcontext = _packages("drawing")
    for library, name in (("GL", "libGL"), ("EGL", "libEGL")):
        if ctypes.util.find_library(library) is None:
            raise EnvironmentProblem(f"drawing needs the library {name}. Run: {APT}")
    make = glcontext.get_backend_by_name("egl")
    try:
        native = make(mode="standalone", glversion=VERSION)
    except Exception as error:
        if older := _older(moderngl, make):
            raise _too_old(older) from error
        raise EnvironmentProblem(
            f"no OpenGL {VERSION // 100}.{VERSION // 10 % 10} context could be made without a "
            f"window (EGL: {error}). Without a graphics card: {APT}"
        ) from error
    ctx = None
    try:
        ctx = moderngl.create_context(context=native)
        yield checked(ctx, native.load)
    finally:
        (ctx or native).release()


def of_window(ctx: moderngl.Context) -> Context:
    """Return the context of a window that moderngl has found."""
    _, glcontext = _packages("a window")
    return checked(ctx, glcontext.default_backend()(mode="detect", glversion=VERSION).load)


def checked(ctx: moderngl.Context, load: Any) -> Context:
    """Return the context with raw GL beside it.

    Raises
    ------
    EnvironmentProblem
        It lacks something that shadows need.
    """
    info = ctx.info
    renderer, version = str(info["GL_RENDERER"]), str(info["GL_VERSION"])
    found = f"{renderer}, OpenGL {version}"
    if ctx.version_code < VERSION:
        raise _too_old(found)
    gl = g.RawGL(load)
    for what, name in (
        (g.GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS, "vertex"),
        (g.GL_MAX_GEOMETRY_SHADER_STORAGE_BLOCKS, "geometry"),
    ):
        if (n := gl.integer(what)) < LEAST_STORAGE_BLOCKS:
            raise EnvironmentProblem(
                f"{LEAST_STORAGE_BLOCKS} storage buffers in {name} shaders are needed; "
                f"{found} has {n}"
            )
    gl.glClipControl(g.GL_LOWER_LEFT, g.GL_ZERO_TO_ONE)
    if gl.integer(g.GL_CLIP_DEPTH_MODE) != g.GL_ZERO_TO_ONE:
        raise EnvironmentProblem(f"glClipControl is needed for exact depth; {found} ignores it")
    return Context(
        ctx=ctx,
        gl=gl,
        renderer=renderer,
        version=version,
        subpixel_bits=gl.integer(g.GL_SUBPIXEL_BITS),
        most_pixels_a_side=gl.integer(g.GL_MAX_TEXTURE_SIZE),
        most_buffer_bytes=gl.integer(g.GL_MAX_SHADER_STORAGE_BLOCK_SIZE),
    )


def _older(moderngl: Any, make: Any) -> str:
    """Return what OpenGL there is where none is new enough, ``""`` for none at all."""
    with contextlib.suppress(Exception):
        native = make(mode="standalone", glversion=_LEAST_TO_ASK)
        info = moderngl.create_context(context=native, require=_LEAST_TO_ASK).info
        native.release()
        return f"{info['GL_RENDERER']}, OpenGL {info['GL_VERSION']}"
    return ""


def _too_old(found: str) -> EnvironmentProblem:
    return EnvironmentProblem(f"OpenGL 4.5 is needed; found {found}. Update the driver, or {APT}")


def _packages(purpose: str) -> tuple[Any, Any]:
    try:
        import glcontext
        import moderngl
    except ImportError as error:
        raise require_extra(error.name or "moderngl", "view", purpose) from None
    return moderngl, glcontext
