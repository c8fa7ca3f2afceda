"""Raw OpenGL: the functions that moderngl does not offer, loaded by name, and nothing else.

    gl = RawGL(load)          load(name) -> address, of the context's own library
    gl.glDepthFunc(GL_GREATER)

All of them need the context to be current.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, Final

from svprep.errors import EnvironmentProblem

GL_ZERO: Final = 0
GL_ONE: Final = 1
GL_POINTS: Final = 0x0000
GL_TRIANGLES: Final = 0x0004
GL_NEVER: Final = 0x0200
GL_LESS: Final = 0x0201
GL_EQUAL: Final = 0x0202
GL_LEQUAL: Final = 0x0203
GL_GREATER: Final = 0x0204
GL_NOTEQUAL: Final = 0x0205
GL_GEQUAL: Final = 0x0206
GL_ALWAYS: Final = 0x0207
GL_SRC_ALPHA: Final = 0x0302
GL_ONE_MINUS_SRC_ALPHA: Final = 0x0303
GL_FRONT: Final = 0x0404
GL_BACK: Final = 0x0405
GL_FRONT_AND_BACK: Final = 0x0408
GL_CCW: Final = 0x0901
GL_CULL_FACE: Final = 0x0B44
GL_DEPTH_TEST: Final = 0x0B71
GL_STENCIL_TEST: Final = 0x0B90
GL_BLEND: Final = 0x0BE2
GL_COLOR_LOGIC_OP: Final = 0x0BF2
GL_SCISSOR_TEST: Final = 0x0C11
GL_ALL_BARRIER_BITS: Final = 0xFFFFFFFF
GL_MAX_TEXTURE_SIZE: Final = 0x0D33
GL_SUBPIXEL_BITS: Final = 0x0D50
GL_TEXTURE_2D: Final = 0x0DE1
GL_UNSIGNED_BYTE: Final = 0x1401
GL_UNSIGNED_INT: Final = 0x1405
GL_FLOAT: Final = 0x1406
GL_INVERT: Final = 0x150A
GL_COLOR: Final = 0x1800
GL_STENCIL: Final = 0x1802
GL_STENCIL_INDEX: Final = 0x1901
GL_DEPTH_COMPONENT: Final = 0x1902
GL_RED: Final = 0x1903
GL_RGBA: Final = 0x1908
GL_KEEP: Final = 0x1E00
GL_REPLACE: Final = 0x1E01
GL_INCR: Final = 0x1E02
GL_DECR: Final = 0x1E03
GL_PACK_ALIGNMENT: Final = 0x0D05
GL_NEAREST: Final = 0x2600
GL_TEXTURE_MAG_FILTER: Final = 0x2800
GL_TEXTURE_MIN_FILTER: Final = 0x2801
GL_POLYGON_OFFSET_FILL: Final = 0x8037
GL_FUNC_ADD: Final = 0x8006
GL_FILL: Final = 0x1B02
GL_RASTERIZER_DISCARD: Final = 0x8C89
GL_TIME_ELAPSED: Final = 0x88BF
GL_SAMPLES_PASSED: Final = 0x8914
GL_PRIMITIVES_GENERATED: Final = 0x8C87
GL_QUERY_RESULT: Final = 0x8866
GL_RGBA8: Final = 0x8058
GL_DEPTH_STENCIL: Final = 0x84F9
GL_INCR_WRAP: Final = 0x8507
GL_DECR_WRAP: Final = 0x8508
GL_RGBA32F: Final = 0x8814
GL_READ_WRITE: Final = 0x88BA
GL_R32F: Final = 0x822E
GL_R32UI: Final = 0x8236
GL_RGBA32UI: Final = 0x8D70
GL_RED_INTEGER: Final = 0x8D94
GL_RGBA_INTEGER: Final = 0x8D99
GL_DEPTH_CLAMP: Final = 0x864F
GL_DEPTH32F_STENCIL8: Final = 0x8CAD
GL_DEPTH_STENCIL_TEXTURE_MODE: Final = 0x90EA
GL_LOWER_LEFT: Final = 0x8CA1
GL_NEGATIVE_ONE_TO_ONE: Final = 0x935E
GL_ZERO_TO_ONE: Final = 0x935F
GL_CLIP_DISTANCE0: Final = 0x3000
GL_CLIP_DEPTH_MODE: Final = 0x935D
GL_FRAMEBUFFER: Final = 0x8D40
GL_FRAMEBUFFER_COMPLETE: Final = 0x8CD5
GL_COLOR_ATTACHMENT0: Final = 0x8CE0
GL_DEPTH_STENCIL_ATTACHMENT: Final = 0x821A
GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS: Final = 0x90D6
GL_MAX_GEOMETRY_SHADER_STORAGE_BLOCKS: Final = 0x90D7
GL_MAX_SHADER_STORAGE_BLOCK_SIZE: Final = 0x90DE
GL_OUT_OF_MEMORY: Final = 0x0505
GL_DEPTH_ATTACHMENT: Final = 0x8D00
GL_STENCIL_ATTACHMENT: Final = 0x8D20
GL_FRAMEBUFFER_ATTACHMENT_DEPTH_SIZE: Final = 0x8216
GL_FRAMEBUFFER_ATTACHMENT_STENCIL_SIZE: Final = 0x8217

_I, _U, _F = ctypes.c_int, ctypes.c_uint, ctypes.c_float
_P, _UP, _IP, _FP = (
    ctypes.c_void_p,
    ctypes.POINTER(_U),
    ctypes.POINTER(_I),
    ctypes.POINTER(_F),
)

_FUNCTIONS: Final[dict[str, tuple[Any, tuple[Any, ...]]]] = {
    "glBindFramebuffer": (None, (_U, _U)),
    "glBindImageTexture": (None, (_U, _U, _I, ctypes.c_ubyte, _I, _U, _U)),
    "glBindTextureUnit": (None, (_U, _U)),
    "glBeginQuery": (None, (_U, _U)),
    "glBlendEquation": (None, (_U,)),
    "glBlendFunc": (None, (_U, _U)),
    "glCheckNamedFramebufferStatus": (_U, (_U, _U)),
    "glClearNamedFramebufferfi": (None, (_U, _U, _I, _F, _I)),
    "glClearNamedFramebufferfv": (None, (_U, _U, _I, _FP)),
    "glClearNamedFramebufferiv": (None, (_U, _U, _I, _IP)),
    "glClearNamedFramebufferuiv": (None, (_U, _U, _I, _UP)),
    "glClipControl": (None, (_U, _U)),
    "glColorMask": (None, (ctypes.c_ubyte,) * 4),
    "glCreateFramebuffers": (None, (_I, _UP)),
    "glCreateQueries": (None, (_U, _I, _UP)),
    "glCreateTextures": (None, (_U, _I, _UP)),
    "glCullFace": (None, (_U,)),
    "glDeleteFramebuffers": (None, (_I, _UP)),
    "glDeleteQueries": (None, (_I, _UP)),
    "glDeleteTextures": (None, (_I, _UP)),
    "glDepthFunc": (None, (_U,)),
    "glDepthMask": (None, (ctypes.c_ubyte,)),
    "glDisable": (None, (_U,)),
    "glEnable": (None, (_U,)),
    "glEndQuery": (None, (_U,)),
    "glFinish": (None, ()),
    "glFrontFace": (None, (_U,)),
    "glGetError": (_U, ()),
    "glGetIntegerv": (None, (_U, _IP)),
    "glGetNamedFramebufferAttachmentParameteriv": (None, (_U, _U, _U, _IP)),
    "glGetQueryObjectui64v": (None, (_U, _U, ctypes.POINTER(ctypes.c_uint64))),
    "glGetTextureImage": (None, (_U, _I, _U, _U, _I, _P)),
    "glIsEnabled": (ctypes.c_ubyte, (_U,)),
    "glIsBuffer": (ctypes.c_ubyte, (_U,)),
    "glIsFramebuffer": (ctypes.c_ubyte, (_U,)),
    "glIsProgram": (ctypes.c_ubyte, (_U,)),
    "glIsQuery": (ctypes.c_ubyte, (_U,)),
    "glIsTexture": (ctypes.c_ubyte, (_U,)),
    "glIsVertexArray": (ctypes.c_ubyte, (_U,)),
    "glLineWidth": (None, (_F,)),
    "glMemoryBarrier": (None, (_U,)),
    "glNamedFramebufferDrawBuffers": (None, (_U, _I, _UP)),
    "glNamedFramebufferTexture": (None, (_U, _U, _U, _I)),
    "glPixelStorei": (None, (_U, _I)),
    "glPolygonMode": (None, (_U, _U)),
    "glPolygonOffset": (None, (_F, _F)),
    "glReadBuffer": (None, (_U,)),
    "glReadPixels": (None, (_I, _I, _I, _I, _U, _U, _P)),
    "glScissor": (None, (_I, _I, _I, _I)),
    "glStencilFuncSeparate": (None, (_U, _U, _I, _U)),
    "glStencilMaskSeparate": (None, (_U, _U)),
    "glStencilOpSeparate": (None, (_U, _U, _U, _U)),
    "glTextureParameteri": (None, (_U, _U, _I)),
    "glTextureStorage2D": (None, (_U, _I, _U, _I, _I)),
    "glViewport": (None, (_I, _I, _I, _I)),
}


class RawGL:
    """The loaded functions, each an attribute of its own name.

    Parameters
    ----------
    load : callable
        Takes a name, returns the function's address, 0 if the context lacks it.

    Raises
    ------
    EnvironmentProblem
        The context lacks one: names it.
    """

    def __init__(self, load: Callable[[str], int]) -> None:
        missing = []
        for name, (result, arguments) in _FUNCTIONS.items():
            address = load(name)
            if not address:
                missing.append(name)
                continue
            setattr(self, name, ctypes.CFUNCTYPE(result, *arguments)(address))
        if missing:
            raise EnvironmentProblem(
                f"this OpenGL lacks {', '.join(missing[:3])}"
                + (f" and {len(missing) - 3} more functions" if len(missing) > 3 else "")
                + ": version 4.5 is needed. Update the graphics driver; svprep doctor says more"
            )

    def __getattr__(self, name: str) -> Any:  # for static checkers: all names are set above
        raise AttributeError(name)

    def integer(self, what: int) -> int:
        """Return ``glGetIntegerv(what)``, the first number of it."""
        value = (_I * 4)()
        self.glGetIntegerv(what, value)
        return int(value[0])

    def create(self, make: Callable[[int, Any], None]) -> int:
        """Return the name of one new object: ``create(gl.glCreateFramebuffers)``."""
        name = _U()
        make(1, ctypes.byref(name))
        return int(name.value)

    def delete(self, remove: Callable[[int, Any], None], name: int) -> None:
        """Delete one object: ``delete(gl.glDeleteTextures, name)``."""
        remove(1, ctypes.byref(_U(name)))
