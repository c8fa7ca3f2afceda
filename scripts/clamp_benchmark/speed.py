"""How long clamping takes, light by light and as a command, and from a cold start."""

from __future__ import annotations

import gc
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from silhouette_benchmark.datasets import environment
from svprep.cache.reader import Cache
from svprep.clamp import clamp_lights
from svprep.light import Light, parse_light, parse_lights
from svprep.model import ClampTable, Prepared

DAY: Final = "sun:48.2,16.37,2026-06-21/05:00/21:00/20m[Europe/Vienna]"
DAY_LIGHTS: Final = 48
ALTITUDES_DEG: Final = (3.0, 10.0, 30.0, 60.0, 90.0)


class CommandFailed(Exception):
    """``svprep clamp`` did not end well."""


@dataclass(frozen=True, slots=True)
class Times:
    """Of the same work, several times."""

    wall_s: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)
    """Of all threads: what another process takes from a core is not in it."""

    @property
    def median_s(self) -> float:
        """Of the wall seconds."""
        return statistics.median(self.wall_s)

    @property
    def median_cpu_s(self) -> float:
        """Of the processor's seconds."""
        return statistics.median(self.cpu_s)


@dataclass(frozen=True, slots=True)
class LightRow:
    """One light of a scene whose tables are in memory."""

    name: str
    times: Times
    """Setup of the scene included."""
    segments: float
    """Of a caster, mean."""
    n_bytes: float
    """Of a caster in the cache."""
    gain: float
    """Surface of the unclamped volumes over that of the clamped ones."""
    gain_own: float


@dataclass(frozen=True, slots=True)
class Command:
    """A process of ``svprep clamp``, whole: start, reading, computing, writing."""

    wall_s: float
    cpu_s: float
    peak_bytes: int
    n_lights: int
    """That it computed and wrote."""


@dataclass(frozen=True, slots=True)
class ColdStart:
    """``svprep clamp`` with no compiled kernel, and again with what that left."""

    light: str
    cold: Command
    warm: Command


def some_lights(cache: Cache, street: Sequence[float]) -> dict[str, Light]:
    """Return the suns and three lamps that are timed, by what a report calls them.

    Parameters
    ----------
    street : sequence of float
        ``(x, y, z)`` [m], in the cache frame: a person's eye in a street.
    """
    lights = {
        f"sun, altitude {altitude:g}": parse_light(f"dir:135,{altitude:g}")
        for altitude in ALTITUDES_DEG
    }
    low, high = cache.mesh.positions.min(axis=0), cache.mesh.positions.max(axis=0)
    middle, size = (low + high) / 2.0, high - low
    above = float(size[2]) / 2.0
    lamps = {
        "lamp in a street, 5 m up": (street[0], street[1], street[2] + 3.3),
        "lamp above the middle": (middle[0], middle[1], high[2] + above),
        "lamp outside": (high[0] + size[0], middle[1], high[2] + float(size[0])),
    }
    for name, at in lamps.items():
        x, y, z = (float(p) + float(o) for p, o in zip(at, cache.mesh.grid.origin_m, strict=True))
        lights[name] = parse_light(f"point:{x:.3f},{y:.3f},{z:.3f}")
    return lights


def time_lights(
    cache: Cache | Prepared, lights: dict[str, Light], rounds: int
) -> tuple[list[LightRow], Times]:
    """Time every light, one at a time and in turns; and the setup of the scene alone.

    The setup is what a light takes longer when it is the first of two same ones.
    """
    rows = {name: Times() for name in lights}
    tables: dict[str, ClampTable] = {}
    setup = Times()
    for light in lights.values():
        _clamped(cache, [light], Times())  # loads kernels and tables
    for _ in range(rounds):
        for name, light in lights.items():
            tables[name] = _clamped(cache, [light], rows[name])
        first = next(iter(lights.values()))
        both = Times()
        _clamped(cache, [first, first], both)
        setup.wall_s.append(max(both.wall_s[0] - both.wall_s[1], 0.0))
        setup.cpu_s.append(max(both.cpu_s[0] - both.cpu_s[1], 0.0))
    return [_row(name, times, tables[name]) for name, times in rows.items()], setup


def time_day(cache: Cache | Prepared, rounds: int) -> Times:
    """Time computing a day of `DAY_LIGHTS` suns, setup included."""
    lights = parse_lights([DAY])
    if len(lights) != DAY_LIGHTS:
        raise ValueError(f"{DAY}: expected {DAY_LIGHTS} lights by day, got {len(lights)}")
    whole = Times()
    for _ in range(rounds):
        each = Times()
        _clamped(cache, lights, each)
        whole.wall_s.append(sum(each.wall_s))
        whole.cpu_s.append(sum(each.cpu_s))
    return whole


def time_command(cache: Path, specs: Sequence[str], rounds: int) -> list[Command]:
    """Run ``svprep clamp`` on copies of a cache, which are removed again."""
    done = []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory(dir=cache.parent) as folder:
            copy = Path(shutil.copy(cache, folder))
            done.append(_run(copy, specs, {}))
    return done


def cold_start(cache: Path, spec: str, other: str) -> ColdStart:
    """Run ``svprep clamp`` with an empty folder for compiled kernels, then once more.

    Parameters
    ----------
    spec, other : str
        Two lights of one kind, so that the second run computes, too.
    """
    with tempfile.TemporaryDirectory(dir=cache.parent) as folder:
        copy = Path(shutil.copy(cache, folder))
        kernels = {"NUMBA_CACHE_DIR": str(Path(folder) / "kernels")}
        return ColdStart(spec, _run(copy, [spec], kernels), _run(copy, [other], kernels))


def _clamped(cache: Cache | Prepared, lights: Sequence[Light], times: Times) -> ClampTable:
    """Clamp and note how long each light took, the first one with the setup."""
    mesh, components, scene = cache.mesh, cache.components, cache.scene
    gc.collect()
    at = (time.perf_counter(), time.process_time())

    def note(done: int, of: int) -> None:
        nonlocal at
        now = (time.perf_counter(), time.process_time())
        times.wall_s.append(now[0] - at[0])
        times.cpu_s.append(now[1] - at[1])
        at = now

    return clamp_lights(mesh, components, scene, lights, on_light=note)


def _row(name: str, times: Times, table: ClampTable) -> LightRow:
    n_casters = table.segment_start.shape[1] - 1
    n_bytes = table.segment_start[0].nbytes + table.depths.nbytes + table.slopes.nbytes
    _, _, unclamped_m2, own_m2, clamped_m2 = table.facts[0].tolist()
    return LightRow(
        name, times, len(table.depths) / n_casters, n_bytes / n_casters, unclamped_m2 / clamped_m2,
        unclamped_m2 / own_m2,
    )  # fmt: skip


def _run(cache: Path, specs: Sequence[str], variables: dict[str, str]) -> Command:
    """Run the command to its end; raise its last words if it fails."""
    lights = [part for spec in specs for part in ("--light", spec)]
    arguments = [sys.executable, "-m", "svprep", "clamp", str(cache), *lights, "--json"]
    begun = time.perf_counter()
    with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as words:
        process = subprocess.Popen(
            arguments, env=environment() | variables, stdout=said, stderr=words
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall_s = time.perf_counter() - begun
        if process.returncode:
            words.seek(0)
            raise CommandFailed(f"svprep clamp: {words.read().decode().strip()[-500:]}")
        said.seek(0)
        added = json.loads(said.read())["added"]
    return Command(wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024, added)
