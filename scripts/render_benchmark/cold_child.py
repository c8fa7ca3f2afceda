"""One cold start, in a process of its own: from nothing to the first picture.

    python3 cold_child.py CACHE LIGHT WIDTHxHEIGHT     prints one JSON object

The product draws; its steps are timed from outside, each without the steps inside it.
"""

from __future__ import annotations

import functools
import importlib
import json
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class Laps:
    """Seconds of steps, each without those of the steps inside it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.cpu_seconds: dict[str, float] = {}
        self.first_draw: float | None = None
        self._inside: list[tuple[float, float]] = []

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Time what is done inside."""
        self._inside.append((0.0, 0.0))
        begun, begun_cpu = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            took, cpu = time.perf_counter() - begun, time.process_time() - begun_cpu
            inside, inside_cpu = self._inside.pop()
            self.seconds[name] = self.seconds.get(name, 0.0) + took - inside
            self.cpu_seconds[name] = self.cpu_seconds.get(name, 0.0) + cpu - inside_cpu
            if self._inside:
                inside, inside_cpu = self._inside[-1]
                self._inside[-1] = (inside + took, inside_cpu + cpu)

    def wrapped(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return `function`, timed."""

        @functools.wraps(function)
        def timed(*args: Any, **options: Any) -> Any:
            with self.step(name):
                return function(*args, **options)

        return timed

    def watch(self, owner: Any, name: str, *functions: str) -> None:
        """Time functions of a module or class."""
        for function in functions:
            setattr(owner, function, self.wrapped(name, getattr(owner, function)))


def main() -> None:
    """Draw once and say what it took."""
    path, spec, size = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
    width_px, height_px = map(int, size.split("x"))
    laps = Laps()
    with laps.step("import"):
        from svprep.cache.reader import open_cache
        from svprep.light import parse_light
        from svprep_runtime.drawing import Request, draw_cache
    _watch_all(laps)
    light = parse_light(spec)
    begun = time.perf_counter()
    with laps.step("open"):
        cache = open_cache(path)
    with laps.step("rest"), cache:
        drawn = draw_cache(cache, Request((light,), None, width_px, height_px))
    whole = time.perf_counter() - begun
    print(
        json.dumps(
            {
                "seconds": laps.seconds,
                "cpu_seconds": laps.cpu_seconds,
                "first_draw_s": (laps.first_draw or time.perf_counter()) - begun,
                "first_picture_s": whole,
                "peak_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
                "buffer_bytes": drawn.used_bytes,
                "n_segments": drawn.picture.tallies[0].n_clamped_segments,
            }
        )
    )


WATCHED = (
    ("svprep.cache.reader:Cache", "read", "raw"),
    ("svprep_runtime.drawing", "camera", "default_camera"),
    ("svprep_runtime.drawing", "first frame", "render"),
    ("svprep_runtime.volumes", "facing", "facing"),
    ("svprep_runtime.volumes", "silhouette query", "silhouette"),
    ("numba.core.base:BaseContext", "start Numba", "refresh"),
    ("numba.core.typing.context:BaseContext", "start Numba", "refresh"),
    ("svprep_runtime.scene", "lists", "casters_of", "segments_of", "volume_lists"),
    ("svprep_runtime.scene", "lists", "face_entries", "edge_vertices"),
    ("svprep_runtime.residency:Memory", "upload", "upload"),
    ("svprep_runtime.programs:Programs", "shader compile", "get"),
    ("svprep_runtime.frame", "eye", "eye_count", "is_cut_at_near"),
    ("svprep_runtime.targets:Targets", "first frame", "__post_init__"),
)
"""Where, the step, and functions as they are called there."""


def owner_of(place: str) -> Any:
    """Return the module or class that ``"module"`` or ``"module:Class"`` names."""
    module, _, name = place.partition(":")
    found = importlib.import_module(module)
    return getattr(found, name) if name else found


def _watch_all(laps: Laps) -> None:
    for place, step, *functions in WATCHED:
        laps.watch(owner_of(place), step, *functions)
    for table in vars(owner_of("svprep.cache.reader:Cache")).values():
        if isinstance(table, functools.cached_property):
            table.func = laps.wrapped("read", table.func)
    drawing = owner_of("svprep_runtime.drawing")
    program = owner_of("svprep_runtime.programs:Program")

    headless = drawing.headless

    @contextmanager
    def timed_headless() -> Iterator[Any]:
        manager = headless()
        with laps.step("context"):
            context = manager.__enter__()
        try:
            yield context
        finally:
            manager.__exit__(None, None, None)

    drawing.headless = timed_headless
    draw = program.draw

    def noted(*args: Any, **options: Any) -> None:
        if laps.first_draw is None:
            laps.first_draw = time.perf_counter()
        draw(*args, **options)

    program.draw = noted


if __name__ == "__main__":
    main()
