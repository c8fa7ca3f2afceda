"""Measure how tight shadows are clamped, and how fast.

    python3 scripts/benchmark_clamp.py --work ~/svprep-bench -o clamp.md
    python3 scripts/benchmark_clamp.py --work ~/svprep-bench --skip-large
    python3 scripts/benchmark_clamp.py --quick

Tight: the stencil updates that six fixed views cost, unclamped, clamped, with each caster
clamped to its own box alone, and with whole objects as receivers, the published way. Fast:
lights one at a time, a day of suns, the command whole, ten times the city, and a first run
with no compiled kernels. Caches are built once into --work (the large one takes five
minutes, 4 GB of memory and 2 GB of disk); empty it after a change to the build.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(1, str(ROOT))  # the svprep beside this script, installed or not

from clamp_benchmark.report import Model, Report, Speed, markdown  # noqa: E402
from clamp_benchmark.speed import (  # noqa: E402
    DAY,
    ColdStart,
    CommandFailed,
    cold_start,
    some_lights,
    time_command,
    time_day,
    time_lights,
)
from clamp_benchmark.tight import ALTITUDES_DEG, Inconsistent, measure_tight  # noqa: E402
from clamp_benchmark.views import look  # noqa: E402
from silhouette_benchmark.datasets import (  # noqa: E402
    SHARED,
    SUFFIXES,
    BuildFailed,
    Dataset,
    MissingDataset,
    provide,
)
from silhouette_benchmark.report import machine  # noqa: E402
from svprep.cache.reader import open_cache  # noqa: E402
from svprep.errors import SvprepError  # noqa: E402
from svprep.parallel import thread_count  # noqa: E402

CITY, LARGE, SAMPLE = "city:17420", "city:174200", "small_city"
PIXELS, QUICK_PIXELS = (32, 24), (12, 9)
CITIES = SHARED / "cities"
SUN, LAMP = ("dir:135,30", "dir:135,40"), ("point:0,0,60", "point:10,0,60")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    options = _options(argv)
    with tempfile.TemporaryDirectory() as folder:
        work = options.work or Path(folder)
        work.mkdir(parents=True, exist_ok=True)
        try:
            report = _run(options, work)
        except (BuildFailed, CommandFailed, Inconsistent, SvprepError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
    text = markdown(report)
    print(text, end="")
    for path in options.output:
        figures = json.dumps(asdict(report), indent=1) + "\n"
        path.write_text(figures if path.suffix == ".json" else text, encoding="utf-8")
    return 0


def _run(options: argparse.Namespace, work: Path) -> Report:
    """Return all figures. Times come first, while nothing else is in memory."""
    quick, pixels = options.quick, QUICK_PIXELS if options.quick else PIXELS
    name = SAMPLE if quick else CITY
    began = _load()
    city = provide(name, work)
    speed = _speed(city, pixels, rounds=1 if quick else options.rounds, day=True)
    large = None
    if not quick and not options.skip_large:
        large = _speed(provide(LARGE, work), pixels, rounds=3, day=False)
    cold: list[ColdStart] = []
    if not quick:
        sample = provide(SAMPLE, work)
        _tell("first run")
        cold = [cold_start(sample.cache, *lights) for lights in (SUN, LAMP)]
    return Report(
        machine=machine(),
        threads=thread_count(),
        columns=pixels[0],
        rows=pixels[1],
        city=_model(city, city.source, pixels),
        models=[] if quick else list(_models(work, pixels)),
        speed=speed,
        large=large,
        cold=cold,
        load=f"load average {began} when the run began, {_load()} when it ended.",
    )


def _models(work: Path, pixels: tuple[int, int]) -> Iterator[Model]:
    """Yield the sample city and every model beside the checkout that can be read."""
    found = [path for path in CITIES.rglob("*") if path.name.removesuffix(".gz").endswith(SUFFIXES)]
    for path in [None, *sorted(found)]:
        try:
            dataset = provide(SAMPLE if path is None else str(path), work)
        except (MissingDataset, BuildFailed) as error:
            _tell(f"left out: {error}")
            continue
        shown = dataset.source if path is None else path.relative_to(CITIES).as_posix()
        yield _model(dataset, shown, pixels)


def _model(dataset: Dataset, name: str, pixels: tuple[int, int]) -> Model:
    """Return how tight the shadows of one dataset are clamped."""
    with open_cache(dataset.cache) as cache:
        views = look(cache.mesh.positions, cache.mesh.faces, *pixels)
        tight = []
        for altitude_deg in ALTITUDES_DEG:
            _tell(f"{name}, sun at {altitude_deg:g} degrees")
            tight.append(measure_tight(cache, views, altitude_deg))
        return Model(name, cache.n_objects, cache.n_components, cache.n_faces, tight)


def _speed(dataset: Dataset, pixels: tuple[int, int], rounds: int, day: bool) -> Speed:
    """Return how long clamping one dataset takes."""
    _tell(f"{dataset.source}: times")
    with open_cache(dataset.cache) as cache:
        street = look(cache.mesh.positions, cache.mesh.faces, *pixels).eyes[0].tolist()
        lights, setup = time_lights(cache, some_lights(cache, street), rounds)
        whole = time_day(cache, min(rounds, 3)) if day else None
        counts = cache.n_objects, cache.n_components, cache.n_faces
    return Speed(
        dataset.source,
        *counts,
        lights,
        setup,
        whole,
        one_light=time_command(dataset.cache, [SUN[0]], min(rounds, 3)),
        whole_day=time_command(dataset.cache, [DAY], min(rounds, 2)) if day else [],
    )


def _load() -> str:
    """Return how many processes have wanted a core in the last minute."""
    return f"{os.getloadavg()[0]:.1f}"


def _tell(what: str) -> None:
    print(f"{what} ...", file=sys.stderr, flush=True)


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--work", type=Path, metavar="FOLDER", help="keep and reuse caches here")
    parser.add_argument(
        "--quick", action="store_true", help="the sample city, few pixels, one round"
    )
    parser.add_argument("--skip-large", action="store_true", help="without ten times the city")
    parser.add_argument("--rounds", type=_count, default=7, metavar="N", help="default 7")
    parser.add_argument(
        "-o", "--output", type=Path, action="append", default=[], metavar="FILE",
        help="also write the report, .md or .json; may be repeated",
    )  # fmt: skip
    return parser.parse_args(argv)


def _count(text: str) -> int:
    """Parse a number of at least 1."""
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {value}")
    return value


if __name__ == "__main__":
    sys.exit(main())
