"""Time `svprep build` against reading the same OBJ with its peers, in one run.

    python3 scripts/benchmark_build.py                    17,420 objects, 5 rounds
    python3 scripts/benchmark_build.py --objects 2000 --rounds 3
    python3 scripts/benchmark_build.py --input city.obj

Each command runs in a fresh process, in turn, so that a slow spell of a shared
machine hits all of them; ratios are taken round by round. Peers that are not
installed are named and left out (pip install pymeshlab meshlib trimesh).
A first build with an empty kernel cache is timed apart.
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
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

PEERS = {
    "read bytes": "import sys; open(sys.argv[1], 'rb').read()",
    "trimesh load": "import sys, trimesh; trimesh.load(sys.argv[1], process=False)",
    "pymeshlab load": "import sys, pymeshlab as p; p.MeshSet().load_new_mesh(sys.argv[1])",
    "pymeshlab load + repair": (
        "import sys, pymeshlab as p; m = p.MeshSet(); m.load_new_mesh(sys.argv[1]); "
        "m.meshing_remove_duplicate_vertices(); m.meshing_remove_duplicate_faces(); "
        "m.meshing_remove_null_faces(); m.meshing_repair_non_manifold_edges()"
    ),
    "MeshLib load": "import sys; from meshlib import mrmeshpy as m; m.loadMesh(sys.argv[1])",
}


@dataclass(frozen=True, slots=True)
class Run:
    """One finished process."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    exit_status: int
    last_words: str


def run(command: list[str], environment: dict[str, str] | None = None) -> Run:
    """Run a command to its end and account for it."""
    begun = time.perf_counter()
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            env={**os.environ, **(environment or {})},
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - begun
        process.returncode = os.waitstatus_to_exitcode(status)
        errors.seek(0)
        lines = errors.read().decode(errors="replace").strip().splitlines()
    return Run(
        wall_s=wall_s,
        cpu_s=usage.ru_utime + usage.ru_stime,
        peak_mb=usage.ru_maxrss / 1024,
        exit_status=process.returncode,
        last_words=lines[-1] if lines else "",
    )


def has_module(name: str) -> bool:
    """Whether this Python can import a peer."""
    return (
        subprocess.run(
            [sys.executable, "-c", f"import {name}"], capture_output=True, check=False
        ).returncode
        == 0
    )


def commands(source: Path, cache: Path) -> dict[str, list[str]]:
    """Return what is timed: svprep first, then the peers that are installed."""
    timed = {
        "svprep build": [sys.executable, "-m", "svprep", "build", str(source), "-o", str(cache)]
    }
    modules = {"trimesh": "trimesh", "pymeshlab": "pymeshlab", "MeshLib": "meshlib"}
    for name, code in PEERS.items():
        module = modules.get(name.split()[0])
        if module and not has_module(module):
            print(f"not installed, left out: {name}", file=sys.stderr)
            continue
        timed[name] = [sys.executable, "-c", code, str(source)]
    return timed


def median_spread(values: list[float]) -> str:
    """Return ``median (min-max)``."""
    return f"{statistics.median(values):.2f} ({min(values):.2f}-{max(values):.2f})"


def main() -> int:
    """Make the city, run everything in turn, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--objects", type=int, default=17420)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--input", type=Path, help="an OBJ of your own instead of the city")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        source = options.input or Path(folder) / "city.obj"
        if options.input is None:
            make = [sys.executable, str(ROOT / "scripts" / "make_city.py")]
            subprocess.run(
                [*make, "--objects", str(options.objects), "-o", str(source)],
                check=True,
                stderr=subprocess.DEVNULL,
            )
        cache = Path(folder) / "city.svp.h5"
        build = commands(source, cache)["svprep build"]
        first = run(build, {"NUMBA_CACHE_DIR": str(Path(folder) / "empty")})
        summary = json.loads(
            subprocess.run([*build, "--json"], capture_output=True, check=True).stdout
        )
        runs: dict[str, list[Run]] = {}
        for _ in range(options.rounds):
            for name, command in commands(source, cache).items():
                runs.setdefault(name, []).append(run(command))
        n_bytes = source.stat().st_size
        report(runs, first, summary, n_bytes)
        if options.json:
            write_json(options.json, runs, first, summary, n_bytes)
    return 0


def report(runs: dict[str, list[Run]], first: Run, summary: dict, n_bytes: int) -> None:
    """Print the table: wall seconds, ratio to svprep round by round, peak memory."""
    triangles = summary["triangles_in"]
    print(
        f"{platform.machine()}, {len(os.sched_getaffinity(0))} cores, Python "
        f"{platform.python_version()}; {summary['objects']:,} objects, {triangles:,} triangles, "
        f"OBJ {n_bytes / 1e6:.1f} MB, cache {summary['n_bytes'] / 1e6:.1f} MB "
        f"({summary['n_bytes'] / n_bytes:.2f} of the OBJ, "
        f"{summary['n_bytes'] / triangles:.0f} bytes/triangle)"
    )
    print(f"{'':26}{'wall s, median (range)':>26}{'x svprep build':>22}{'peak MB':>9}")
    ours = [r.wall_s for r in runs["svprep build"]]
    for name, done in runs.items():
        if any(r.exit_status for r in done):
            print(f"{name:26}  gave up: {done[0].last_words[:90]}")
            continue
        ratios = [r.wall_s / own for r, own in zip(done, ours, strict=True)]
        print(
            f"{name:26}{median_spread([r.wall_s for r in done]):>26}"
            f"{median_spread(ratios):>22}{max(r.peak_mb for r in done):>9.0f}"
        )
    print(f"{'first build, no kernels':26}{first.wall_s:>14.2f}{'':34}{first.peak_mb:>9.0f}")
    stages = ", ".join(f"{name} {s:.2f}" for name, s in summary["seconds"].items())
    rate = triangles / statistics.median(ours) / 1e6
    print(f"svprep stages, one run [s]: {stages}; {rate:.2f} Mtri/s for the whole process")


def write_json(
    path: Path, runs: dict[str, list[Run]], first: Run, summary: dict, n_bytes: int
) -> None:
    """Write every figure, for later comparison."""
    figures = {
        "source_bytes": n_bytes,
        "summary": summary,
        "first_build_wall_s": first.wall_s,
        "runs": {
            name: [{"wall_s": r.wall_s, "cpu_s": r.cpu_s, "peak_mb": r.peak_mb} for r in done]
            for name, done in runs.items()
        },
    }
    path.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
