"""Measure what a frame with exact shadows costs, and how soon the first one is there.

    python3 scripts/benchmark_render.py --work ~/svprep-bench -o tests/benchmarks/render.md
    python3 scripts/benchmark_render.py --cache city.svp.h5 --size 640x512 --rounds 3
    python3 scripts/benchmark_render.py --quick

Frames: one view and light, drawn without shadows, with volumes of each triangle, of
silhouettes, of clamped silhouettes, by z-pass and z-fail, counted in floats and in the
stencil, all by turns in one process; on a graphics card against a shadow map, too. Cold
starts: fresh processes, from opening the cache to the first picture, step by step. On a
software renderer volumes of each triangle take minutes a frame: --seconds bounds how long
one way is drawn again, --size, --method, --counter and --volumes what is drawn at all.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
for place in (ROOT / "runtime", ROOT):
    if str(place) not in sys.path:
        sys.path.insert(1, str(place))  # the svprep beside this script, installed or not

from clamp_benchmark.views import VIEWS, look  # noqa: E402
from render_benchmark.cold import Cold, ColdFailed, cold_start  # noqa: E402
from render_benchmark.frames import VOLUMES, ViewFigures, measure_view, ways_of  # noqa: E402
from render_benchmark.report import LightFigures, Report, markdown  # noqa: E402
from render_benchmark.shadow_map import shadow_map  # noqa: E402
from silhouette_benchmark.datasets import BuildFailed, provide  # noqa: E402
from silhouette_benchmark.report import machine  # noqa: E402
from svprep.cache.reader import Cache, open_cache  # noqa: E402
from svprep.errors import SvprepError  # noqa: E402
from svprep.light import parse_light  # noqa: E402
from svprep.model import F32  # noqa: E402
from svprep.pipeline import add_lights  # noqa: E402
from svprep_runtime.camera import Camera, check_size, look_at  # noqa: E402
from svprep_runtime.context import headless  # noqa: E402
from svprep_runtime.drawing import camera_text  # noqa: E402
from svprep_runtime.scene import Scene  # noqa: E402
from svprep_runtime.targets import Targets  # noqa: E402

CITY, SAMPLE = "city:17420", "small_city"
LOOKS = {"street": "street 1", "bird": "bird's eye 1"}
SUN = "dir:135,40"
MAP_PX = 4096
SOFTWARE = ("llvmpipe", "softpipe", "swrast", "SwiftShader")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    options = _options(argv)
    with tempfile.TemporaryDirectory() as folder:
        work = options.work or Path(folder)
        work.mkdir(parents=True, exist_ok=True)
        try:
            report = _run(options, work)
        except (BuildFailed, ColdFailed, SvprepError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
    text = markdown(report)
    print(text, end="")
    for path in options.output:
        figures = json.dumps(asdict(report), indent=1) + "\n"
        path.write_text(figures if path.suffix == ".json" else text, encoding="utf-8")
    return 0


def _run(options: argparse.Namespace, work: Path) -> Report:
    """Return all figures. Cold starts come first, while nothing else is in memory."""
    began = _load()
    sample = with_light(provide(SAMPLE, work).cache, options.light, work)
    if options.quick:
        city = sample
    else:
        city = with_light(options.cache or provide(CITY, work).cache, options.light, work)
    caches = {"sample city": sample} if options.quick else {"sample city": sample, "city": city}
    cold = [_cold(name, path, options) for name, path in caches.items() if options.processes]
    with open_cache(city) as cache, headless() as context, Scene(context, cache) as scene:
        views = list(_views(options, cache, scene))
        light = parse_light(options.light).in_cache_frame(cache.grid)
        facts = _light_figures(scene, light)
        return Report(
            machine=machine(),
            renderer=context.renderer,
            load=f"load average {began} when the run began, {_load()} when it ended",
            model="sample city" if options.quick else "generated city",
            objects=cache.n_objects,
            triangles=cache.n_faces,
            light=options.light,
            size="x".join(map(str, options.size)),
            lit=facts,
            cameras={v.name: camera_text(c, cache.grid) for v, c in views},
            views=[v for v, _ in views],
            map_px=options.map_px,
            cold=cold,
            peak_bytes=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
            buffer_bytes=scene.memory.used_bytes,
        )


def _views(
    options: argparse.Namespace, cache: Cache, scene: Scene
) -> Iterator[tuple[ViewFigures, Camera]]:
    """Yield the figures of each view that is asked for."""
    context = scene.context
    width_px, height_px = options.size
    light = parse_light(options.light).in_cache_frame(cache.grid)
    is_software = any(name in context.renderer for name in SOFTWARE)
    with_map = options.shadow_map or not is_software
    ways = [
        way
        for way in ways_of(options.method, options.counter, with_map=with_map)
        if not way.is_counted or way.volumes in options.volumes
    ]
    targets = Targets(context, width_px, height_px, 1)
    try:
        for name, camera in cameras(cache, width_px, height_px).items():
            if name not in options.view:
                continue
            arguments = (name, scene, targets, camera, light, ways, options.rounds, options.seconds)
            if not with_map:
                yield measure_view(*arguments), camera
                continue
            with shadow_map(scene, light, options.map_px) as drawn:
                found = measure_view(
                    *arguments, lambda meter, c=camera: drawn.draw(targets, c, light, meter)
                )
                found.map_texel_m = drawn.texel_m
                yield found, camera
    finally:
        targets.release()


def cameras(cache: Cache, width_px: int, height_px: int) -> dict[str, Camera]:
    """Return a person's eye in a street, and a bird's: two of the views of `benchmark_clamp`."""
    eyes = look(cache.mesh.positions, cache.mesh.faces, 2, 2)
    found = {}
    for name, called in LOOKS.items():
        i = next(i for i, view in enumerate(VIEWS) if view.name == called)
        # The four rays of 2 x 2 pixels add up to the middle of the picture.
        ahead = eyes.directions[i * eyes.n_pixels : (i + 1) * eyes.n_pixels].sum(axis=0)
        found[name] = look_at(eyes.eyes[i], eyes.eyes[i] + 10.0 * ahead, width_px, height_px)
    return found


def with_light(cache: Path, spec: str, work: Path) -> Path:
    """Return a cache that holds the clamped segments of a light: itself, or a copy in `work`."""
    with open_cache(cache) as opened:
        light = parse_light(spec).in_cache_frame(opened.grid)
        if (opened.clamp.lights == light).all(axis=1).any():
            return cache
    copy = work / f"lit_{cache.name}"
    if copy.exists():
        copy.unlink()
    shutil.copy(cache, copy)
    add_lights(copy, [spec])
    return copy


def _light_figures(scene: Scene, light: F32) -> LightFigures:
    lit = scene.lit_by(light, clamped=True)
    return LightFigures(
        n_silhouette=len(lit.casters.edge),
        n_casting_faces=int(lit.casters.counts.sum()),
        n_closed=int(lit.casters.is_closed.sum()),
        n_components=len(lit.casters.is_closed),
        n_segments=len(lit.segments.table) - 1 if lit.segments.is_clamped else 0,
    )


def _cold(name: str, path: Path, options: argparse.Namespace) -> Cold:
    """Return cold starts with one cache, after one that fills the caches of the system."""
    _tell(f"cold starts, {name}")
    size = "x".join(map(str, options.size))
    with open_cache(path) as cache:
        triangles = cache.n_faces
    first_ever = None
    if name == "sample city" and not options.quick:
        first_ever = cold_start(path, options.light, size, first_ever=True)
    cold_start(path, options.light, size)
    starts = [cold_start(path, options.light, size) for _ in range(options.processes)]
    return Cold(name, triangles, starts, first_ever)


def _load() -> str:
    """Return how many processes have wanted a core in the last minute."""
    return f"{os.getloadavg()[0]:.1f}"


def _tell(what: str) -> None:
    print(f"{what} ...", file=sys.stderr, flush=True)


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    add = parser.add_argument
    add("--work", type=Path, metavar="FOLDER", help="keep and reuse caches here")
    add("--cache", type=Path, metavar="CACHE", help="instead of the generated city's")
    add("--quick", action="store_true", help="the sample city, one round, one cold start")
    add("--light", default=SUN, metavar="SPEC", help=f"directional; default {SUN}")
    add("--size", type=_size, default=(1280, 1024), metavar="WxH", help="default 1280x1024")
    add("--rounds", type=_count, default=5, metavar="N", help="default 5")
    add(
        "--seconds", type=float, default=60.0, metavar="S",
        help="a way whose frames took so long is drawn no more; default 60",
    )  # fmt: skip
    add("--processes", type=int, default=5, metavar="N", help="cold starts; default 5, 0: none")
    add("--shadow-map", action="store_true", help="on a software renderer, too")
    add("--map-px", type=_count, default=MAP_PX, metavar="N", help=f"its side; default {MAP_PX}")
    for name, choices in (
        ("view", tuple(LOOKS)),
        ("method", ("zpass", "zfail")),
        ("counter", ("float", "stencil")),
        ("volumes", tuple(VOLUMES)),
    ):
        add(f"--{name}", nargs="+", choices=choices, default=choices, help="default all")
    add(
        "-o", "--output", type=Path, action="append", default=[], metavar="FILE",
        help="also write the report, .md or .json; may be repeated",
    )  # fmt: skip
    options = parser.parse_args(argv)
    if options.quick:
        options.rounds, options.processes = 1, min(options.processes, 1)
    return options


def _size(text: str) -> tuple[int, int]:
    """Parse ``WxH``."""
    try:
        width_px, height_px = map(int, text.split("x"))
        check_size(width_px, height_px)
    except (ValueError, SvprepError):
        raise argparse.ArgumentTypeError(f"not a size like 1280x1024: {text}") from None
    return width_px, height_px


def _count(text: str) -> int:
    """Parse a number of at least 1."""
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {value}")
    return value


if __name__ == "__main__":
    sys.exit(main())
