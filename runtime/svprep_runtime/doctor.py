"""What of this machine's OpenGL is as shadows need it: asked, tried, and said line by line."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

from svprep.errors import EnvironmentProblem
from svprep_runtime import gl_raw as g
from svprep_runtime.context import LEAST_STORAGE_BLOCKS, Context, headless
from svprep_runtime.targets import Targets


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at."""

    name: str
    is_good: bool
    found: str
    remedy: str = ""
    """What to do, where it is not good."""


def findings() -> list[Finding]:
    """Return what drawing without a window finds; the first failure ends the list."""
    found: list[Finding] = []
    try:
        with headless() as context:
            found += _of_context(context)
            found += _of_targets(context)
    except EnvironmentProblem as problem:
        found.append(Finding("OpenGL", False, str(problem)))
    return found


def _of_context(context: Context) -> list[Finding]:
    gl = context.gl
    return [
        Finding("OpenGL", True, f"{context.version}, {context.renderer}"),
        Finding("clip control", True, "depth from 0 to 1"),
        Finding("sub-pixel bits", context.subpixel_bits >= 8, str(context.subpixel_bits)),
        Finding(
            "storage buffers",
            True,
            f"{gl.integer(g.GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS)} in vertex shaders "
            f"(needed: {LEAST_STORAGE_BLOCKS}), {context.most_buffer_bytes:,} bytes each",
        ),
        Finding("largest picture", True, f"{context.most_pixels_a_side} pixels a side"),
    ]


def _of_targets(context: Context) -> list[Finding]:
    """Draw nothing into what shadows are counted in, and read it back."""
    gl = context.gl
    targets = Targets(context, 8, 8, 1)
    try:
        bits = {}
        for name, what in (
            ("depth", g.GL_FRAMEBUFFER_ATTACHMENT_DEPTH_SIZE),
            ("stencil", g.GL_FRAMEBUFFER_ATTACHMENT_STENCIL_SIZE),
        ):
            value = ctypes.c_int()
            gl.glGetNamedFramebufferAttachmentParameteriv(
                targets.count_into,
                g.GL_DEPTH_ATTACHMENT if name == "depth" else g.GL_STENCIL_ATTACHMENT,
                what,
                ctypes.byref(value),
            )
            bits[name] = value.value
        targets.clear_count(300, "float")
        counted = targets.read_count()
        targets.clear_count(300, "stencil")
        wrapped = targets.read_stencil()
    finally:
        targets.release()
    is_exact = bool(np.all(counted == 300.0) and np.all(wrapped == 300 - 256))
    return [
        Finding("depth bits", bits["depth"] == 32, f"{bits['depth']}, floating-point"),
        Finding("stencil bits", bits["stencil"] == 8, str(bits["stencil"])),
        Finding(
            "counting",
            is_exact,
            "a float target holds 300 layers, a stencil their remainder"
            if is_exact
            else f"300 layers are read as {counted[0, 0]:g} and {wrapped[0, 0]}",
            "update the graphics driver",
        ),
    ]
