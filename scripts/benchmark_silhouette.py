"""Time silhouette queries against flat scans in NumPy and Numba, and the machine's memory.

    python3 scripts/benchmark_silhouette.py --work ~/svprep-bench -o silhouette.md
    python3 scripts/benchmark_silhouette.py --datasets smooth:50000 city.obj --methods auto flat
    python3 scripts/benchmark_silhouette.py --quick

Each query has a light of its own, the same ones for all methods, which are timed each on
its own and in turns, so that a slow spell of a shared machine hits all alike. Tables of
the baselines are made once beforehand, as the product's are by the build. Every answer is
compared with the others; a difference ends the run. Caches are built once into --work;
empty it after a change to the build.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(1, str(ROOT))  # the svprep beside this script, installed or not

from silhouette_benchmark.datasets import (  # noqa: E402
    DEFAULT,
    QUICK,
    BuildFailed,
    Dataset,
    MissingDataset,
    provide,
)
from silhouette_benchmark.facts import (  # noqa: E402
    Published,
    bound,
    count,
    first_query,
    index_bytes,
    published_hextree,
)
from silhouette_benchmark.flat_tables import FlatTables, flat_tables  # noqa: E402
from silhouette_benchmark.lights import random_lights  # noqa: E402
from silhouette_benchmark.measure import (  # noqa: E402
    Disagreement,
    Subject,
    measure,
    measure_alone,
    measure_coherent,
    measure_subsets,
    ratio,
)
from silhouette_benchmark.memory import Bandwidth, measure_bandwidth  # noqa: E402
from silhouette_benchmark.numba_scan import NumbaScan, fastest_scan  # noqa: E402
from silhouette_benchmark.numpy_scan import NumpyScan  # noqa: E402
from silhouette_benchmark.report import (  # noqa: E402
    FLAT,
    NUMPY,
    DatasetReport,
    Report,
    machine,
    markdown,
    numba_name,
)
from svprep.cache.reader import Cache, open_cache  # noqa: E402
from svprep.model import F32  # noqa: E402
from svprep.parallel import thread_count  # noqa: E402
from svprep.silhouette import METHODS, Method, silhouette  # noqa: E402

LARGE_BYTES, QUICK_LARGE_BYTES = 512 << 20, 64 << 20
WARM_LIGHTS = 4
SUBSET_LIGHTS = 10
COHERENT = ("auto", FLAT, "cones", "hextree")
"""What is asked for an hour of sun, beside baseline (b)."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    options = _options(argv)
    if options.threads:
        os.environ["SVPREP_THREADS"] = str(options.threads)
    n_lights = options.lights or (5 if options.quick else 40)
    memory = measure_bandwidth(QUICK_LARGE_BYTES if options.quick else LARGE_BYTES, thread_count())
    report = Report(machine(), thread_count(), options.seed, memory, [])
    with tempfile.TemporaryDirectory() as folder:
        work = options.work or Path(folder)
        work.mkdir(parents=True, exist_ok=True)
        for name in options.datasets or (QUICK if options.quick else DEFAULT):
            print(f"{name} ...", file=sys.stderr, flush=True)
            try:
                dataset = provide(name, work)
                done = benchmark(dataset, options.methods, n_lights, options.seed, memory)
            except MissingDataset as missing:
                print(f"left out: {missing}", file=sys.stderr)
                continue
            except (BuildFailed, Disagreement) as error:
                print(f"error: {name}: {error}", file=sys.stderr)
                return 1
            report.datasets.append(done)
    text = markdown(report)
    print(text, end="")
    for path in options.output:
        figures = json.dumps(asdict(report), indent=1) + "\n"
        path.write_text(figures if path.suffix == ".json" else text, encoding="utf-8")
    return 0


def benchmark(
    dataset: Dataset, methods: Sequence[Method], n_lights: int, seed: int, memory: Bandwidth
) -> DatasetReport:
    """Return all figures of one dataset."""
    with open_cache(dataset.cache) as cache:
        tables = flat_tables(cache)
        warm = random_lights(cache.mesh.positions, WARM_LIGHTS, seed + 1)
        lights = random_lights(cache.mesh.positions, n_lights, seed)
        compiled = _compiled_scans(tables, random_lights(cache.mesh.positions, 12, seed + 3))
        subjects: dict[str, Subject] = {method: _query(cache, method) for method in methods}
        subjects |= {NUMPY: NumpyScan(tables), **compiled}
        timings = measure(subjects, len(tables.edge), lights, warm)
        alone = measure_alone(subjects, lights)
        flats = [name for name in (FLAT, *compiled) if name in timings]
        baseline = min(flats, key=lambda name: alone[name].median_ms)
        cached = measure_bandwidth(tables.bytes_read, thread_count())
        return DatasetReport(
            name=dataset.name,
            source=dataset.source,
            counts=count(cache),
            lights=[light.tolist() for light in lights],
            timings=timings,
            alone=alone,
            baseline=baseline,
            ratios={
                name: ratio(timing, timings[baseline], lights)
                for name, timing in timings.items()
                if name != baseline
            },
            compiled={name: scan.describe() for name, scan in compiled.items()},
            bandwidth=cached,
            bound=bound(tables, timings[NUMPY].found, cached, memory),
            index_bytes=index_bytes(cache),
            build_seconds=dataset.build["seconds"],
            published=_published(cache, len(tables.edge), lights),
            first_query=first_query(dataset.cache),
            coherent=measure_coherent(
                {n: s for n, s in subjects.items() if n in (*COHERENT, *compiled)}
            ),
            subsets=measure_subsets(
                cache,
                [method for method in methods if method in ("auto", FLAT)],
                random_lights(cache.mesh.positions, min(n_lights, SUBSET_LIGHTS), seed + 2),
                seed,
            ),
        )


def _compiled_scans(tables: FlatTables, trial_lights: Sequence[F32]) -> dict[str, NumbaScan]:
    """Return baseline (b) on one thread and on all, where the dataset is worth more."""
    scans = {}
    for threads in (1, thread_count()):
        scan = fastest_scan(tables, threads, trial_lights)
        scans[numba_name(scan.threads)] = scan
    return scans


def _query(cache: Cache, method: Method) -> Subject:
    """Return the product's query by one method."""
    return lambda light: silhouette(cache, light, method)


def _published(cache: Cache, searched: int, lights: Sequence[F32]) -> Published | None:
    """Return what the published hextree visits, or say why not."""
    try:
        return published_hextree(cache, searched, lights)
    except ImportError as error:
        print(f"left out: the published hextree ({error})", file=sys.stderr)
        return None


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--datasets", nargs="+", metavar="NAME",
        help="small_city, ogre, largest, city:OBJECTS, smooth:TRIANGLES, or a model's path; "
        f"default {' '.join(DEFAULT)}",
    )  # fmt: skip
    parser.add_argument(
        "--methods", nargs="+", choices=METHODS, default=list(METHODS), metavar="METHOD",
        help=f"of {', '.join(METHODS)}; default all",
    )  # fmt: skip
    parser.add_argument("--lights", type=_count, metavar="N", help="default 40, with --quick 5")
    parser.add_argument("--threads", type=_count, metavar="N", help="default all cores")
    parser.add_argument("--seed", type=int, default=1, help="of the lights; default 1")
    parser.add_argument("--work", type=Path, metavar="FOLDER", help="keep and reuse caches here")
    parser.add_argument("--quick", action="store_true", help=f"{' '.join(QUICK)}, 5 lights")
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
