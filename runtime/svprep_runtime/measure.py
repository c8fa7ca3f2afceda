"""What each pass of a frame cost: time, triangles, samples that it updated."""

from __future__ import annotations

import contextlib
import ctypes
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from svprep_runtime import gl_raw as g
from svprep_runtime.context import Context

_ASKED: Final = (g.GL_TIME_ELAPSED, g.GL_PRIMITIVES_GENERATED, g.GL_SAMPLES_PASSED)


@dataclass(frozen=True, slots=True)
class PassFigures:
    """One pass."""

    name: str
    light: int | None
    """Index of the light that it is about."""
    ms: float
    """By timer query. A software driver's counts only part of its work."""
    wall_ms: float
    """By the clock, from when nothing was left to draw to when nothing is again."""
    n_primitives: int
    """That the vertex and geometry shaders made."""
    n_samples: int
    """That passed its tests: pixels drawn, or updates of the count."""


@dataclass(slots=True)
class Meter:
    """Measures passes if it is on; costs nothing otherwise."""

    context: Context
    is_on: bool
    _found: list[PassFigures] = field(default_factory=list)

    @contextlib.contextmanager
    def measure(self, name: str, light: int | None = None) -> Iterator[None]:
        """Measure what is drawn inside; one pass at a time."""
        if not self.is_on:
            yield
            return
        gl = self.context.gl
        queries = [gl.create(partial(gl.glCreateQueries, what)) for what in _ASKED]
        try:
            gl.glFinish()
            begun = time.perf_counter()
            for what, query in zip(_ASKED, queries, strict=True):
                gl.glBeginQuery(what, query)
            try:
                yield
                gl.glFinish()
            finally:
                for what in _ASKED:
                    gl.glEndQuery(what)
            wall_ms = 1e3 * (time.perf_counter() - begun)
            ns, n_primitives, n_samples = (self._result(query) for query in queries)
        finally:
            for query in queries:
                gl.delete(gl.glDeleteQueries, query)
        self._found.append(PassFigures(name, light, ns / 1e6, wall_ms, n_primitives, n_samples))

    def _result(self, query: int) -> int:
        value = ctypes.c_uint64()
        self.context.gl.glGetQueryObjectui64v(query, g.GL_QUERY_RESULT, ctypes.byref(value))
        return int(value.value)

    def figures(self) -> tuple[PassFigures, ...]:
        """Return what was measured since the last call, in order."""
        figures = tuple(self._found)
        self._found.clear()
        return figures
