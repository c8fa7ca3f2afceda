"""What ``svprep hours`` does with its options: trace, sum up, write, say it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer

from svprep.cache.reader import Cache, open_cache
from svprep.hours.compute import sun_hours
from svprep.hours.facts import facts_of
from svprep.hours.output import HOURS, write_hours
from svprep.hours.result import SunHours
from svprep.hours.summary import kind_totals
from svprep.light import is_arc, parse_arc
from svprep.rays import require_embree

ARC_FORM = "sun:LAT,LON,2026-03-20/06:00/18:00/15m[Europe/Vienna]"


_UP_DEG = 0.5
"""An arc that begins or ends with the sun higher than this cuts a part of the day."""


@dataclass(frozen=True, slots=True)
class Query:
    """The options of one call, each already known to be of its kind."""

    cache: Path
    arc_spec: str
    spacing_m: float
    outputs: tuple[str, ...]


def query_of(cache: Path, lights: Sequence[str], spacing_m: float, outputs: Sequence[str]) -> Query:
    """Return the options as a query.

    Raises
    ------
    typer.BadParameter
        A usage error: no arc or several, no distance, an unknown suffix.
    """
    if not lights:
        raise typer.BadParameter(f"name the sun's arc with --light ARC: {ARC_FORM}")
    if len(lights) > 1:
        raise typer.BadParameter(f"sun hours are of one arc; {len(lights)} --light were given")
    if not is_arc(lights[0]):
        raise typer.BadParameter(
            f'sun hours are of an arc of the sun, and "{lights[0]}" is none; one is {ARC_FORM}'
        )
    if not (math.isfinite(spacing_m) and spacing_m > 0.0):
        raise typer.BadParameter(f"--spacing is a distance in metres above 0, not {spacing_m:g}")
    for output in outputs:
        if not HOURS.has_suffix(output):
            raise typer.BadParameter(f"{output}: sun hours are written as .csv or .ply; name it so")
    return Query(cache, lights[0], spacing_m, tuple(outputs))


def answer(query: Query, on_progress: Callable[[str, int, int], None]) -> dict[str, Any]:
    """Return the summary of sun hours, their files written where they were asked for.

    Raises
    ------
    InputError, CacheError, EnvironmentProblem
        No arc, too many samples, a bad cache, a missing package, or an output that
        cannot be written (told before the rays).
    """
    _check_outputs(query, [])
    require_embree("svprep hours")
    started = time.perf_counter()
    with open_cache(query.cache) as cache:
        _check_outputs(query, [source.path for source in cache.sources])
        arc = parse_arc(query.arc_spec, cache.site)
        hours = sun_hours(cache, arc, spacing_m=query.spacing_m, on_progress=on_progress)
        summary = _summary(query, cache, hours)
        for output in query.outputs:
            on_progress("writing", 0, 1)
            write_hours(hours, cache, output)
    summary["seconds"] = round(time.perf_counter() - started, 4)
    return summary


def _check_outputs(query: Query, sources: Sequence[str]) -> None:
    """Raise unless every output can be written without harm to the cache and each other."""
    for i, output in enumerate(query.outputs):
        HOURS.checked_path(output, [query.cache, *sources, *query.outputs[:i]])


def _summary(query: Query, cache: Cache, hours: SunHours) -> dict[str, Any]:
    points = hours.points
    traced_s = max(points.trace_seconds, 1e-9)
    n_left = hours.n_samples - int(np.count_nonzero(hours.is_buried))
    return {
        "cache": str(query.cache),
        "facts": facts_of(hours, cache),
        "suns": points.n_suns,
        "rows": len(hours.groups.kind),
        "kinds": [
            {
                "kind": found.kind.name.lower(),
                "area_m2": round(found.area_m2, 4),
                "samples": found.samples,
                "buried": found.buried,
                "total_mean": _number(found.total_mean),
                **{f"total_{name}": _number(value) for name, value in found.total.items()},
                **{f"longest_{name}": _number(value) for name, value in found.longest.items()},
            }
            for found in kind_totals(hours)
        ],
        "rays": points.n_rays,
        "trace_seconds": round(points.trace_seconds, 4),
        "rays_per_second": round(points.n_rays / traced_s),
        "samples_times_suns_per_second": round(n_left * points.n_suns / traced_s),
        "outputs": list(query.outputs),
    }


def _number(minutes: float) -> float | None:
    return None if math.isnan(minutes) else round(minutes, 4)


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """Return a summary as the lines that people read."""
    facts = summary["facts"]
    north = facts["meridian convergence degrees"]
    if not isinstance(north, str):
        north = f"grid north is {abs(north):.3f} degrees {'west' if north < 0 else 'east'} of true"
    n_night = facts["night steps skipped"]
    x, y, z = facts["model extent x y z metres"]
    lines = [
        f"model    {x:,.1f} x {y:,.1f} x {z:,.1f} m (east, north, up)",
        f"sun      {facts['latitude']:.10g}, {facts['longitude']:.10g} on {facts['date']}, "
        f"{_clock(facts['begin'])} to {_end_clock(facts)} {facts['zone']}; {north}",
        f"steps    {facts['steps']:,} of {facts['step minutes']:g} min, {n_night:,} at night",
        *_cut_day(facts),
        f"samples  {facts['samples']:,}, one per {facts['sample spacing metres']:g} m squared; "
        f"{facts['samples buried in solids']:,} buried in solids and "
        f"{facts['samples buried under the ground']:,} under the ground left out; "
        f"{facts['samples on surfaces that are not solid']:,} on surfaces that are not solid",
        *_stated(facts),
    ]
    for kind in summary["kinds"]:
        lines.append(f"surface  {kind['kind']:<9} {_kind_text(kind)}")
    lines.append(
        f"time     {summary['seconds']:.2f} seconds, {summary['trace_seconds']:.2f} of them for "
        f"{summary['rays']:,} rays; {summary['samples_times_suns_per_second'] / 1e6:.2f} million "
        "samples x suns per second"
    )
    lines += [f"written  {output}" for output in summary["outputs"]]
    return lines


def _clock(moment: str) -> str:
    return moment.partition("T")[2][:5]


def _end_clock(facts: dict[str, Any]) -> str:
    """Return when the arc ends, midnight as 24:00."""
    is_next_day = facts["end"].partition("T")[0] > facts["date"]
    return "24:00" if is_next_day and _clock(facts["end"]) == "00:00" else _clock(facts["end"])


def _stated(facts: dict[str, Any]) -> list[str]:
    """Return a line on where kinds of surface come from, if files state any."""
    n = facts["samples whose kind the files state"]
    if not n:
        return []
    n_doubted = facts["samples on level faces of files that call every face a wall, by geometry"]
    doubted = f", {n_doubted:,} of them level though named walls, as all is" if n_doubted else ""
    return [
        f"kinds    of {n:,} samples as the files name their surfaces, of "
        f"{facts['samples'] - n:,} by geometry{doubted}"
    ]


def _cut_day(facts: dict[str, Any]) -> list[str]:
    """Return a line if the sun is up before the arc begins, or after it ends."""
    up = [
        f"{altitude:.1f} degrees high when the arc {when}"
        for when, altitude in zip(
            ("begins", "ends"), facts["sun's altitude at begin and end degrees"], strict=True
        )
        if altitude > _UP_DEG
    ]
    if not up:
        return []
    return [f"note     the sun stands {' and '.join(up)}: what lies outside is not counted"]


def _kind_text(kind: dict[str, Any]) -> str:
    area_m2 = kind["area_m2"]
    area = f"{area_m2:>12,.{0 if area_m2 >= 100.0 else 2}f} m2"
    if kind["total_median"] is None:
        return f"{area}  all buried"
    return (
        f"{area}  median {_hours(kind['total_median'])} of sun, "
        f"{_hours(kind['total_p10'])} to {_hours(kind['total_p90'])} on the middle 80 %; "
        f"median of the longest run {_hours(kind['longest_median'])}"
    )


def _hours(minutes: float) -> str:
    """Return minutes as ``"13 h 45"``."""
    whole = round(minutes)
    return f"{whole // 60:d} h {whole % 60:02d}"
