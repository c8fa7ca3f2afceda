"""Time reading city files of each format against a bare parser of the same text, in one run.

    python3 scripts/benchmark_formats.py                  the models beside the checkout
    python3 scripts/benchmark_formats.py city.gml.gz city.city.json --rounds 3

A round is, for each file, in fresh processes: `svprep build`, our reader alone, and a floor:
`json.loads`, expat without handlers, or trimesh's load. Seconds of a reader or a floor are
wall seconds without starting Python; megabytes are those of the unpacked text.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmark_build import ROOT, median_spread, run

CITIES = ROOT.parent / "shared" / "data" / "cities"
_TIMED = """
import gzip, json, sys, time
from pathlib import Path
path = Path(sys.argv[1])
{prepare}
begun = time.perf_counter(), time.process_time()
{work}
print(json.dumps([time.perf_counter() - begun[0], time.process_time() - begun[1]]))
"""
_TEXT = "text = path.read_bytes(); text = gzip.decompress(text) if path.suffix == '.gz' else text"
READER = _TIMED.format(
    prepare="from svprep.ingest import read\nfor _ in range(2): read([path])",  # kernels are loaded
    work="read([path])",
)
FLOORS = {
    "json.loads": _TIMED.format(prepare=_TEXT, work="json.loads(text)"),
    "expat": _TIMED.format(
        prepare=_TEXT + "\nfrom xml.parsers import expat",
        work="expat.ParserCreate().Parse(text, True)",
    ),
    "trimesh": _TIMED.format(
        prepare="import trimesh\ntrimesh.load(path, process=False)",
        work="trimesh.load(path, process=False)",
    ),
}
_FLOOR_OF = {".json": "json.loads", ".gml": "expat", ".xml": "expat", ".glb": "trimesh"}


def main() -> int:
    """Time every file, print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("files", nargs="*", type=Path, help="default: ../shared/data/cities")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.md", help="also write the table")
    options = parser.parse_args()
    files = options.files or sorted(p for p in CITIES.glob("*") if _floor_of(p))
    if not files:
        parser.error(f"no city file in {CITIES}; name some")
    lines = [
        f"{platform.machine()}, {len(os.sched_getaffinity(0))} cores, Python "
        f"{platform.python_version()}, medians of {options.rounds} with their range.",
        "",
        "| file | MB | build, wall s | CPU s | peak MB | read, s | MB/s | floor, s | to floor |",
        "|---|---|---|---|---|---|---|---|---|",
        *(_row(path, options.rounds) for path in files),
    ]
    print("\n".join(lines))
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


def _floor_of(path: Path) -> str | None:
    return _FLOOR_OF.get(Path(path.name.lower().removesuffix(".gz")).suffix)


def _row(path: Path, rounds: int) -> str:
    """Return the table's row of one file."""
    floor = _floor_of(path)
    builds, reading, floors = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder) / "city.svp.h5"
        build = [sys.executable, "-m", "svprep", "build", str(path), "-o", str(cache)]
        run(build)  # kernels are compiled
        for _ in range(rounds):
            builds.append(run(build))
            reading.append(_seconds(READER, path)[0])
            if floor:
                floors.append(_seconds(FLOORS[floor], path)[0])
    if builds[0].exit_status:
        return f"| {path.name} | gave up: {builds[0].last_words} |"
    mb = _unpacked_bytes(path) / 1e6
    ratios = [ours / bare for ours, bare in zip(reading, floors, strict=True)] if floors else []
    cells = [
        path.name,
        f"{mb:.1f}",
        median_spread([one.wall_s for one in builds]),
        f"{statistics.median(one.cpu_s for one in builds):.2f}",
        f"{max(one.peak_mb for one in builds):.0f}",
        median_spread(reading),
        f"{mb / statistics.median(reading):.0f}",
        f"{floor}, {median_spread(floors)}" if floors else "",
        median_spread(ratios) if ratios else "",
    ]
    return f"| {' | '.join(cells)} |"


def _seconds(code: str, path: Path) -> tuple[float, float]:
    """Return the wall and processor seconds that a fresh process says it took."""
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, check=True, text=True
    )
    wall_s, cpu_s = json.loads(done.stdout.splitlines()[-1])
    return wall_s, cpu_s


def _unpacked_bytes(path: Path) -> int:
    import gzip

    return len(gzip.decompress(path.read_bytes())) if path.suffix == ".gz" else path.stat().st_size


if __name__ == "__main__":
    sys.exit(main())
