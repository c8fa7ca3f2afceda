"""A plain shadow map, to compare with: one map of the whole scene, one look a pixel."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from render_benchmark.frames import see_ambient
from svprep.errors import EnvironmentProblem
from svprep.model import F32, F64
from svprep_runtime import gl_raw as g
from svprep_runtime.camera import Camera
from svprep_runtime.measure import Meter
from svprep_runtime.passes.lighting import STATE as ADD
from svprep_runtime.scene import Scene
from svprep_runtime.state import PassState, apply
from svprep_runtime.targets import Targets

if TYPE_CHECKING:
    import moderngl

FOLDER = Path(__file__).parent
BIAS_TEXELS = 1.0
"""[texels of the map] along the light, where a surface slopes by 45 degrees half of it."""
_DEPTH = PassState(depth_test="less", depth_write=True, color_write=False)


@dataclass(slots=True)
class ShadowMap:
    """A square map of a whole scene for one directional light."""

    scene: Scene
    side_px: int
    map_from_world: F64
    """``(4, 4)``: to -1..1 across the light, 0..1 along it."""
    texel_m: float
    depth_m: float
    texture: int
    framebuffer: int
    render: Any
    look: Any

    def draw(self, targets: Targets, camera: Camera, light: F32, meter: Meter) -> int:
        """Draw a frame with its shadows."""
        uniforms = see_ambient(self.scene, targets, camera, meter)
        lit = self.scene.lit_by(light, clamped=False)
        self.scene.bind_light(lit)
        gl = self.scene.context.gl
        matrix = tuple(self.map_from_world.T.astype(np.float32).ravel().tolist())
        with meter.measure("map", 0):
            gl.glBindFramebuffer(g.GL_FRAMEBUFFER, self.framebuffer)
            gl.glViewport(0, 0, self.side_px, self.side_px)
            apply(gl, _DEPTH)
            gl.glClearNamedFramebufferfi(self.framebuffer, g.GL_DEPTH_STENCIL, 0, 1.0, 0)
            _draw(self.render, {"map_from_world": matrix}, 3 * self.scene.n_faces)
        with meter.measure("light", 0):
            targets.bind(targets.light_into[0])
            apply(gl, ADD)
            gl.glBindTextureUnit(0, targets.seen)
            gl.glBindTextureUnit(1, self.texture)
            bias = BIAS_TEXELS * self.texel_m / self.depth_m
            of_light = {"map_from_world": matrix, "brightness": 0.8, "bias": bias}
            _draw(self.look, {**uniforms, **lit.uniforms, **of_light}, 3)
        return 0


@contextmanager
def shadow_map(scene: Scene, light: F32, side_px: int) -> Iterator[ShadowMap]:
    """Yield a map for a directional light, fitted to the scene's box."""
    context, gl = scene.context, scene.context.gl
    matrix, width_m, depth_m = fitted(scene.corners, light)
    texture = gl.create(lambda n, at: gl.glCreateTextures(g.GL_TEXTURE_2D, n, at))
    framebuffer = gl.create(gl.glCreateFramebuffers)
    programs: list[moderngl.Program] = []
    try:
        gl.glTextureStorage2D(texture, 1, g.GL_DEPTH32F_STENCIL8, side_px, side_px)
        for which in (g.GL_TEXTURE_MIN_FILTER, g.GL_TEXTURE_MAG_FILTER):
            gl.glTextureParameteri(texture, which, g.GL_NEAREST)
        gl.glNamedFramebufferTexture(framebuffer, g.GL_DEPTH_STENCIL_ATTACHMENT, texture, 0)
        gl.glNamedFramebufferDrawBuffers(framebuffer, 0, (g._U * 1)())
        status = gl.glCheckNamedFramebufferStatus(framebuffer, g.GL_FRAMEBUFFER)
        if status != g.GL_FRAMEBUFFER_COMPLETE:
            raise EnvironmentProblem(f"no shadow map of {side_px} pixels: status {status:#x}")
        for vertex, fragment in (
            ("map_depth.vert", "map_depth.frag"),
            ("map_whole.vert", "map_light.frag"),
        ):
            texts = ((FOLDER / name).read_text(encoding="utf-8") for name in (vertex, fragment))
            made = context.ctx.program(vertex_shader=next(texts), fragment_shader=next(texts))
            programs.append(made)
        render, look = ((made, context.ctx.vertex_array(made, [])) for made in programs)
        yield ShadowMap(
            scene, side_px, matrix, width_m / side_px, depth_m, texture, framebuffer, render, look
        )
    finally:
        gl.delete(gl.glDeleteFramebuffers, framebuffer)
        gl.delete(gl.glDeleteTextures, texture)
        for program in programs:
            program.release()


def fitted(corners: F64, light: F32) -> tuple[F64, float, float]:
    """Return the matrix of a map that holds `corners`, its width and its depth [m]."""
    back = light[:3].astype(np.float64) / np.linalg.norm(light[:3].astype(np.float64))
    side = np.cross((0.0, 1.0, 0.0) if abs(back[2]) > 0.999 else (0.0, 0.0, 1.0), back)
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(back, side), -back])
    along = corners @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    size = np.maximum(high - low, 1e-3) * 1.001
    middle = (low + high) / 2.0
    scale = np.array([2.0, 2.0, 1.0]) / size
    matrix = np.eye(4)
    matrix[:3, :3] = axes * scale[:, None]
    matrix[:3, 3] = -middle * scale + (0.0, 0.0, 0.5)
    return matrix, float(size[:2].max()), float(size[2])


def _draw(made: tuple[Any, Any], uniforms: dict[str, Any], n_vertices: int) -> None:
    program, vertices = made
    for name, value in uniforms.items():
        if name in program:
            program[name].value = value
    vertices.render(g.GL_TRIANGLES, vertices=n_vertices)
