"""Programs from the files in ``glsl/``.

A file may hold lines ``#include "name.glsl"``; options become ``#define`` lines. What a
driver says of an error names lines of the joined text: it is told with file and line.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from importlib import resources
from typing import TYPE_CHECKING, Any, Final

from svprep.errors import InternalError
from svprep_runtime.context import Context

if TYPE_CHECKING:
    import moderngl

_HEAD: Final = "#version 450 core\n"
_INCLUDE: Final = re.compile(r'^#include "([a-z_]+\.glsl)"$')
_LINE_OF_ERROR: Final = re.compile(r"\b0[:(](\d+)")


@dataclass(frozen=True, slots=True)
class Source:
    """A joined shader, and where each of its lines comes from."""

    text: str
    origin: tuple[str, ...]
    """``"sides.vert:12"`` of each line."""


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A linked program that takes its vertices from storage buffers."""

    program: moderngl.Program
    vertices: moderngl.VertexArray

    def set(self, uniforms: dict[str, Any]) -> None:
        """Set those of `uniforms` that the program has."""
        for name, value in uniforms.items():
            if name in self.program:
                self.program[name] = value

    def draw(self, mode: int, n_vertices: int, n_instances: int = 1) -> None:
        """Draw vertices 0 to `n_vertices`; nothing for none."""
        if n_vertices:
            self.vertices.render(mode, vertices=n_vertices, instances=n_instances)


@dataclass(slots=True)
class Programs:
    """The programs of one context, each made when first asked for, released together."""

    context: Context
    _made: dict[tuple[str, ...], Program] = field(default_factory=dict)

    def get(
        self, vertex: str, fragment: str, geometry: str | None = None, options: tuple[str, ...] = ()
    ) -> Program:
        """Return the program of these files, with each of `options` defined.

        Raises
        ------
        InternalError
            The driver refuses one: file, line and what it says.
        """
        key = (vertex, fragment, geometry or "", *options)
        if key not in self._made:
            files = [name for name in (vertex, fragment, geometry) if name is not None]
            sources = [joined(name, options) for name in files]
            try:
                program = self.context.ctx.program(
                    vertex_shader=sources[0].text,
                    fragment_shader=sources[1].text,
                    geometry_shader=sources[2].text if geometry else None,
                )
            except Exception as error:
                raise InternalError(_told(str(error), files, sources)) from error
            vertices = self.context.ctx.vertex_array(program, [])
            self._made[key] = Program(program, vertices)
        return self._made[key]

    def release(self) -> None:
        """Give all of them back."""
        for program in self._made.values():
            program.vertices.release()
            program.program.release()
        self._made.clear()


def joined(name: str, options: tuple[str, ...] = ()) -> Source:
    """Return the file `name` of ``glsl/`` with its includes in place."""
    lines = [(_HEAD.rstrip(), name)]
    lines += [(f"#define {option} 1", "option") for option in options]
    seen: set[str] = set()

    def add(file: str) -> None:
        if file in seen:
            return
        seen.add(file)
        text = resources.files("svprep_runtime").joinpath("glsl", file).read_text("utf-8")
        for number, line in enumerate(text.splitlines(), 1):
            if found := _INCLUDE.match(line):
                add(found[1])
            else:
                lines.append((line, f"{file}:{number}"))

    add(name)
    return Source("\n".join(text for text, _ in lines) + "\n", tuple(at for _, at in lines))


def _told(message: str, files: list[str], sources: list[Source]) -> str:
    stage = next((i for i, n in enumerate(("vertex", "fragment", "geometry")) if n in message), 0)
    source = sources[min(stage, len(sources) - 1)]
    found = _LINE_OF_ERROR.search(message)
    at = int(found[1]) - 1 if found else -1
    where = source.origin[at] if 0 <= at < len(source.origin) else ", ".join(files)
    return f"{where}: the driver refuses this shader: {' '.join(message.split())}"
