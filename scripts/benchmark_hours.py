"""Time sun hours: samples, suns, samples x suns a second, stages, memory; and a peer.

    python3 scripts/benchmark_hours.py
    python3 scripts/benchmark_hours.py city.svp.h5 --spacing 2 --repeats 5 --threads 1
    python3 scripts/benchmark_hours.py city.svp.h5 --peer --json figures.json

Without a cache it builds the sample city's. Every run is checked to give the same bits as
the first. The peer is trimesh with the same Embree: ``intersects_any`` for the same rays of
a few suns, with the same facing, so that it does the same work.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(1, str(ROOT))  # the svprep beside this script, installed or not

import numpy as np  # noqa: E402

from svprep.cache.reader import Cache, open_cache  # noqa: E402
from svprep.facing import facing  # noqa: E402
from svprep.hours import SunHours, sun_hours  # noqa: E402
from svprep.hours.summary import kind_totals, rows_of  # noqa: E402
from svprep.hours.surfaces import surfaces_of  # noqa: E402
from svprep.light import Arc, Site, parse_arc  # noqa: E402
from svprep.parallel import thread_count  # noqa: E402
from svprep.pipeline import build  # noqa: E402
from svprep.rays import Scene, displaced  # noqa: E402

DAY = "sun:48.2,16.37,2026-06-21/05:00/21:00/15m[Europe/Vienna]"
SAMPLE = ROOT / "data" / "small_city.obj.gz"
PEER_SUNS = 4


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    parser = argparse.ArgumentParser(description="Time sun hours.")
    parser.add_argument("caches", nargs="*", type=Path, metavar="CACHE")
    parser.add_argument("--light", default=DAY, metavar="ARC", help=f"default {DAY}")
    parser.add_argument("--spacing", type=float, default=1.0, metavar="M", help="default 1")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="default 3")
    parser.add_argument("--threads", type=int, metavar="N", help="default: all cores")
    parser.add_argument("--peer", action="store_true", help="compare with trimesh's rays")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures, too")
    options = parser.parse_args(argv)
    if options.threads:
        os.environ["SVPREP_THREADS"] = str(options.threads)
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        caches = options.caches
        if not caches:
            caches = [Path(folder) / "small_city.svp.h5"]
            build([SAMPLE], str(caches[0]))
        for path in caches:
            with open_cache(path) as cache:
                x_m, y_m, _ = cache.grid.origin_m.tolist()
                arc = parse_arc(options.light, Site(cache.crs, x_m, y_m))
                found = measure(cache, arc, options.spacing, max(options.repeats, 1), options.peer)
            figures.append(found)
            print("\n".join(lines_of(found)), flush=True)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return 0


def measure(cache: Cache, arc: Arc, spacing_m: float, repeats: int, peer: bool) -> dict[str, Any]:
    """Return all figures of one cache."""
    runs: list[dict[str, float]] = []
    hours: SunHours | None = None
    for _ in range(repeats):
        stages = _Stages()
        again = sun_hours(cache, arc, spacing_m=spacing_m, on_progress=stages)
        seconds = stages.done()
        seconds["rays"] = again.points.trace_seconds
        before = time.perf_counter()
        rows_of(again), kind_totals(again)
        seconds["tables"] = time.perf_counter() - before
        runs.append(seconds)
        if hours is not None and not np.array_equal(hours.points.bits, again.points.bits):
            raise SystemExit("error: two runs differ")
        hours = again
    assert hours is not None
    points = hours.points
    rays_s = [run["rays"] for run in runs]
    middle_s = max(statistics.median(rays_s), 1e-9)
    left = hours.n_samples - int(np.count_nonzero(hours.is_buried))
    found: dict[str, Any] = {
        "cache": cache.path.name,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}",
        "threads": thread_count(),
        "faces": len(cache.mesh.faces),
        "objects": cache.n_objects,
        "spacing_m": spacing_m,
        "samples": hours.n_samples,
        "buried": hours.n_samples - left,
        "suns": points.n_suns,
        "rays": points.n_rays,
        "repeats": repeats,
        "seconds": {name: statistics.median(run[name] for run in runs) for name in runs[0]},
        "rays_seconds_spread": [min(rays_s), max(rays_s)],
        "samples_times_suns_per_second": left * points.n_suns / middle_s,
        "rays_per_second": points.n_rays / middle_s,
        "peak_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
        "bytes_per_sample": _bytes_of(hours) / max(hours.n_samples, 1),
    }
    if peer:
        found["peer"] = _against_trimesh(cache, hours)
    return found


class _Stages:
    """Takes what `sun_hours` tells of its progress, and how long each stage lasted."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._at = ("surfaces", time.perf_counter())
        self._began = self._at[1]

    def __call__(self, what: str, done: int, of: int) -> None:
        """Note that `what` is being done."""
        if what != self._at[0]:
            self._close()
            self._at = (what, time.perf_counter())

    def done(self) -> dict[str, float]:
        """Return the seconds of each stage, and of all."""
        self._close()
        return {**self._seconds, "all": time.perf_counter() - self._began}

    def _close(self) -> None:
        what, since = self._at
        self._seconds[what] = self._seconds.get(what, 0.0) + time.perf_counter() - since


def _bytes_of(hours: SunHours) -> int:
    """Return what is kept of all samples."""
    points = hours.points
    arrays = (hours.position, hours.face, hours.object, hours.kind, hours.is_on_solid)
    more = (points.is_buried, points.total_steps, points.longest_steps, points.bits)
    return sum(array.nbytes for array in (*arrays, *more))


def _against_trimesh(cache: Cache, hours: SunHours) -> dict[str, Any]:
    """Return the speed of trimesh's rays for a few suns, ours, and how often they differ."""
    import trimesh
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    mesh = trimesh.Trimesh(cache.mesh.positions, cache.mesh.faces.astype(np.int64), process=False)
    peer = RayMeshIntersector(mesh)
    scene = Scene(cache.mesh.positions, cache.mesh.faces)
    surfaces = surfaces_of(cache, scene, hours.offset_m)
    left = np.flatnonzero(~hours.is_buried)
    face = hours.face[left]
    starts = displaced(hours.position[left], surfaces.normal[face], hours.offset_m)
    lights = hours.arc.lights[:: max(len(hours.arc.lights) // PEER_SUNS, 1)]
    peer_s = own_s = 0.0
    n_rays = n_other = 0
    for light in lights:
        sun = light.in_cache_frame(cache.grid)
        side = facing(cache.planes.planes, sun)[cache.planes.plane_of_face]
        turned = np.flatnonzero(side[face] == surfaces.side[face])
        origin = starts[turned]
        before = time.perf_counter()
        theirs = peer.intersects_any(origin, np.tile(sun[:3], (len(origin), 1)))
        between = time.perf_counter()
        ours = scene.is_blocked(origin, sun[:3])
        own_s += time.perf_counter() - between
        peer_s += between - before
        n_rays += len(origin)
        n_other += int(np.count_nonzero(theirs != ours))
    return {
        "peer": f"trimesh {trimesh.__version__}, intersects_any",
        "suns": len(lights),
        "rays": n_rays,
        "peer_rays_per_second": n_rays / max(peer_s, 1e-9),
        "own_rays_per_second_one_thread": n_rays / max(own_s, 1e-9),
        "rays_answered_otherwise": n_other,
    }


def lines_of(found: dict[str, Any]) -> list[str]:
    """Return the figures of one cache as lines."""
    seconds = ", ".join(f"{name} {s:.2f}" for name, s in found["seconds"].items())
    low, high = found["rays_seconds_spread"]
    lines = [
        f"{found['cache']}: {found['objects']:,} objects, {found['faces']:,} faces; "
        f"{found['machine']}; {found['threads']} threads",
        f"  samples   {found['samples']:,} at {found['spacing_m']:g} m, {found['buried']:,} of "
        f"them buried; {found['suns']} suns; {found['rays']:,} rays",
        f"  seconds   {seconds} (medians of {found['repeats']}; rays {low:.2f} to {high:.2f})",
        f"  speed     {found['samples_times_suns_per_second'] / 1e6:.2f} million samples x suns a "
        f"second, {found['rays_per_second'] / 1e6:.2f} million rays a second",
        f"  memory    {found['peak_bytes'] / 1e9:.2f} GB at most, {found['bytes_per_sample']:.0f} "
        "bytes kept a sample",
    ]
    if peer := found.get("peer"):
        lines.append(
            f"  peer      {peer['peer']}: {peer['peer_rays_per_second'] / 1e6:.2f} million rays a "
            f"second; ours on one thread {peer['own_rays_per_second_one_thread'] / 1e6:.2f}; "
            f"{peer['rays_answered_otherwise']:,} of {peer['rays']:,} answered otherwise"
        )
    return lines


if __name__ == "__main__":
    sys.exit(main())
