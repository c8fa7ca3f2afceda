"""Time `svprep build`: against peers, for the first time, over an older cache, ten times as large.

    python3 scripts/benchmark_build.py --work ~/svprep-bench -o build.md --json build.json
    python3 scripts/benchmark_build.py --objects 500 --rounds 2
    python3 scripts/benchmark_build.py --only build --input city.obj
    python3 scripts/benchmark_build.py --region --work ~/svprep-bench
    python3 scripts/benchmark_build.py --remake build.json -o build.md

Each command runs in a fresh process, in turn, so that a slow spell of a shared machine hits
all of them; ratios are taken round by round. Peers that are not installed are named and left
out (pip install pymeshlab meshlib trimesh). --region adds a city of ten times the objects,
which takes 1.1 GB of disk and some minutes to make, once; --work FOLDER keeps it.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from build_benchmark.models import Building, find_building, make_city
from build_benchmark.processes import ROOT, CommandFailed, Run, load, machine, run
from build_benchmark.report import Figures, markdown
from build_benchmark.rounds import (
    BUILD,
    FIRST,
    HELP,
    INCREMENTAL,
    REGION,
    REGION_FACTOR,
    Bench,
    Inconsistent,
)
from build_benchmark.series import spread as median_spread

__all__ = ["ROOT", "Run", "main", "median_spread", "run"]  # benchmark_formats takes these

PARTS = (BUILD, FIRST, HELP, INCREMENTAL)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    options = _options(argv)
    try:
        if options.remake:
            figures = Figures.of(json.loads(options.remake.read_text(encoding="utf-8")))
        else:
            with tempfile.TemporaryDirectory() as folder:
                work = options.work or Path(folder)
                work.mkdir(parents=True, exist_ok=True)
                figures = _measure(options, work)
    except (CommandFailed, Inconsistent, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    text = markdown(figures)
    print(text, end="")
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    if options.json:
        options.json.write_text(json.dumps(asdict(figures), indent=1) + "\n", encoding="utf-8")
    return 0


def _measure(options: argparse.Namespace, work: Path) -> Figures:
    """Return all figures."""
    parts = {*(options.only or PARTS), *([REGION] if options.region else [])}
    began = load()
    city = options.input or make_city(options.objects, work / f"city_{options.objects}.obj")
    building = find_building(city) if INCREMENTAL in parts else None  # a slip is told early
    n_objects = REGION_FACTOR * options.objects
    bench = Bench(city, work, options.rounds)
    try:
        imports_numpy = _run_parts(bench, parts, n_objects, building)
    finally:
        bench.clean()
    region = work / f"city_{n_objects}.obj"
    return Figures(
        command=_command(options),
        machine=machine(),
        load=f"Load average {began} when the run began, {load()} when it ended.",
        model=city.name if options.input else "Generated city",
        n_bytes=city.stat().st_size,
        region_bytes=region.stat().st_size if REGION in parts else None,
        imports_numpy=imports_numpy,
        left_out=bench.left_out,
        rows=bench.rows,
    )


def _run_parts(
    bench: Bench, parts: set[str], n_objects: int, building: Building | None
) -> bool | None:
    """Run the parts; return whether ``svprep --help`` imports NumPy, None if that is not asked."""
    imports_numpy = None
    if HELP in parts:
        bench.helps()
        imports_numpy = bench.imports_numpy()
    if BUILD in parts:
        bench.compare()
    if building is not None:
        bench.incremental(building)
    if FIRST in parts:
        bench.first_builds()
    if REGION in parts:
        bench.region(n_objects)
    return imports_numpy


def _command(options: argparse.Namespace) -> str:
    """Return the command line, without the names of this machine's folders."""
    model = f"--input {options.input.name}" if options.input else f"--objects {options.objects}"
    words = ["python3 scripts/benchmark_build.py", model, f"--rounds {options.rounds}"]
    words += [f"--only {part}" for part in options.only or ()]
    words += ["--region"] if options.region else []
    words += ["--work FOLDER"] if options.work else []
    words += ["-o FILE.md"] if options.output else []
    return " ".join(words)


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--objects", type=_count, default=17420, metavar="N", help="default 17420")
    parser.add_argument("--rounds", type=_count, default=5, metavar="N", help="default 5")
    parser.add_argument("--input", type=Path, metavar="OBJ", help="your own instead of the city")
    parser.add_argument(
        "--only",
        action="append",
        choices=(*PARTS, REGION),
        metavar="PART",
        help=f"run this part; may be repeated: {', '.join((*PARTS, REGION))}",
    )
    parser.add_argument("--region", action="store_true", help="also ten times the city; minutes")
    parser.add_argument("--work", type=Path, metavar="FOLDER", help="keep and reuse cities here")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.md", help="write the report")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every process's figures")
    parser.add_argument(
        "--remake", type=Path, metavar="FILE", help="run nothing: report what --json wrote"
    )
    options = parser.parse_args(argv)
    if options.input and (options.region or REGION in (options.only or ())):
        parser.error("the region is ten times the generated city, so it goes without --input")
    return options


def _count(text: str) -> int:
    """Parse a number of at least 1."""
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {value}")
    return value


if __name__ == "__main__":
    sys.exit(main())
