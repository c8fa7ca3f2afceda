"""The figures as Markdown, for the terminal and for a file."""

from __future__ import annotations

import statistics
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from clamp_benchmark.report_tight import city_tight, cost_rows, models
from clamp_benchmark.speed import DAY, ColdStart, Command, LightRow, Times
from clamp_benchmark.tight import ALTITUDES_DEG, AZIMUTH_DEG, Tight
from clamp_benchmark.views import EYE_M, OPENING_DEG, VIEWS
from silhouette_benchmark.report import table

SHARE_TARGET = 0.6
LIGHT_TARGET_S, DAY_TARGET_S = 0.25, 8.0
BYTES_TARGET = 40.0
PUBLISHED_S = 45 * 60.0
"""Steiner (2006): clamping for one light; 17,420 objects, 1,033,002 triangles."""


@dataclass(frozen=True, slots=True)
class Model:
    """A dataset, and how tight its shadows are clamped."""

    name: str
    objects: int
    casters: int
    triangles: int
    tight: list[Tight]
    """One an altitude."""


@dataclass(frozen=True, slots=True)
class Speed:
    """How long clamping one dataset takes."""

    name: str
    objects: int
    casters: int
    triangles: int
    lights: list[LightRow]
    setup: Times
    day: Times | None
    one_light: list[Command]
    whole_day: list[Command]


@dataclass(frozen=True, slots=True)
class Report:
    """All figures of one run."""

    machine: str
    threads: int
    load: str
    """Of the machine when the run began and when it ended, in words."""
    columns: int
    rows: int
    city: Model
    models: list[Model]
    speed: Speed
    large: Speed | None
    cold: list[ColdStart]


def markdown(report: Report) -> str:
    """Return the whole report."""
    lines = [
        "# Clamp benchmark",
        "",
        "Made by `python3 scripts/benchmark_clamp.py --work FOLDER -o tests/benchmarks/clamp.md`.",
        f"{report.machine}; {report.threads} threads. The machine is shared: {report.load} "
        'Wall seconds are medians with their range; "CPU" is what all threads of the process '
        "were given together, which other work disturbs less.",
        "",
        "## Targets",
        "",
        *_targets(report),
        "",
        "## Tight",
        "",
        *_explained(report),
        "",
        *city_tight(report.city.name, report.city.tight),
    ]
    if report.models:
        listed = [report.city, *report.models]
        lines += [
            "",
            "### Other models",
            "",
            *models(listed, len(VIEWS) * report.columns * report.rows),
        ]
    lines += ["", "## Segments and costs", "", *cost_rows(report.city.tight)]
    lines += ["", "## Speed", "", *_speed(report.speed)]
    if report.large:
        lines += ["", *_large(report.speed, report.large)]
    if report.cold:
        lines += ["", "### First run", "", *_cold(report.cold)]
    return "\n".join(map(_wrapped, lines)) + "\n"


def _targets(report: Report) -> Iterator[str]:
    """Yield what was aimed at and what was reached."""
    rows = []
    for tight in report.city.tight:
        share = tight.share_of_own_box
        rows.append(
            (
                f"gain over that of own boxes, sun at {tight.altitude_deg:g} degrees",
                f"{SHARE_TARGET:.2f}", f"{share:.2f}", _verdict(share, SHARE_TARGET, True),
            )
        )  # fmt: skip
    speed = report.speed
    for label, start in (("light, of all", ""), ("sun", "sun"), ("lamp", "lamp")):
        found = [row for row in speed.lights if row.name.startswith(start)]
        wall = statistics.median(s for row in found for s in row.times.wall_s)
        slowest = max(row.times.median_s for row in found)
        rows.append(
            (
                f"one {label}, scene setup included [s]", f"{LIGHT_TARGET_S}",
                f"{wall:.2f}; slowest {slowest:.2f}", _verdict(wall, LIGHT_TARGET_S),
            )
        )  # fmt: skip
    for row in speed.lights:
        if row.n_bytes > BYTES_TARGET:
            rows.append(
                (
                    f"bytes a caster, {row.name}", f"{BYTES_TARGET:.0f}", f"{row.n_bytes:.0f}",
                    _verdict(row.n_bytes, BYTES_TARGET),
                )
            )  # fmt: skip
    within = [row.n_bytes for row in speed.lights if row.n_bytes <= BYTES_TARGET]
    if within:
        rows.append(
            (
                f"bytes a caster, {len(within)} of the {len(speed.lights)} lights",
                f"{BYTES_TARGET:.0f}", f"{min(within):.0f}-{max(within):.0f}", "met",
            )
        )  # fmt: skip
    if speed.day:
        day = speed.day.median_s
        rows.append(
            ("a day of 48 suns [s]", f"{DAY_TARGET_S:g}", f"{day:.1f}", _verdict(day, DAY_TARGET_S))
        )
    if report.large:
        ratio = _linear(report.speed, report.large)
        rows.append(
            (
                "seconds a caster, ten times the city over the city", "near 1", f"{ratio:.2f}",
                f"{ratio - 1.0:+.0%}",
            )
        )  # fmt: skip
    yield from table(["", "target", "measured", "verdict"], rows)


def _verdict(value: float, target: float, is_least: bool = False) -> str:
    """Return whether a target is met, and by which factor it is missed."""
    factor = target / value if is_least else value / target
    return "met" if factor <= 1.0 else f"missed, {factor:.2f} times"


def _explained(report: Report) -> Iterator[str]:
    """Yield the definitions behind the figures of tightness."""
    yield (
        f"Six views of {report.columns} x {report.rows} pixels, {OPENING_DEG:g} degrees high: two "
        f"at {EYE_M} m above a street, two that look down obliquely and two bird's eyes "
        f"(`clamp_benchmark/views.py`: {', '.join(view.name for view in VIEWS)}; by the bounds of "
        f"the scene and the ground that rays down meet). Suns of azimuth {AZIMUTH_DEG:g} degrees, "
        f"altitudes {', '.join(f'{a:g}' for a in ALTITUDES_DEG)}. How far each pixel sees is "
        "Embree's answer; the sky is left out."
    )
    yield ""
    yield (
        "A segment counts as the caster's rectangle across the light, between its near and its "
        "far plane; the first one begins at the caster's front. Where a pixel's ray enters it or "
        "leaves it behind the visible surface, a fragment fails the depth test: one stencil "
        "update of z-fail. Nothing behind the eye counts. Casters are components."
    )
    yield ""
    yield (
        "Gain: updates of unclamped volumes over those of clamped ones, of all views together. "
        "Own box alone: each volume ends with the caster's own box, and so misses nearly every "
        "shadow; its gain cannot be had by any right clamping and is only the bound. Whole "
        "objects: intervals from the boxes of whole objects in the light's frame, ends across the "
        "light, merged by the same rule (Steiner 2006). Cut faces: each face is cut to the "
        "caster's rectangle, exactly, and the volume ends at the deepest point, across the light "
        "or horizontally; it has no gaps."
    )
    yield ""
    yield (
        "Floor: what any clamping of the same rectangles costs at least. Where the visible point "
        "lies in a caster's rectangle behind its front, a right volume holds it, and is left "
        "behind it: one update (a pair of `visible points`). Where only a hidden surface behind "
        "it has such a point on the ray, a volume that is right for other views, too, is entered "
        "and left behind the visible point: two. That no visible point was left out by any table "
        "that may be drawn is checked in every run."
    )


def _speed(speed: Speed) -> Iterator[str]:
    """Yield how long one dataset takes."""
    yield (
        f"`{speed.name}`: {speed.objects:,} objects, {speed.triangles:,} triangles, "
        f"{speed.casters:,} casters. Each light alone, tables in memory, scene setup included "
        f"(which takes {_seconds(speed.setup)}), {len(speed.setup.wall_s)} times in turns."
    )
    yield ""
    yield from _light_table(speed)
    yield ""
    middle = statistics.median(s for row in speed.lights for s in row.times.wall_s)
    yield (
        f"Published, for one light: 45 minutes (Steiner 2006: 17,420 objects, 1,033,002 triangles, "
        f"another machine). Here the median of all lights is {middle:.2f} s, "
        f"{PUBLISHED_S / middle:,.0f} times less."
    )
    yield ""
    if speed.day:
        yield (
            f"- A day of 48 suns (`{DAY}`), computed: {_seconds(speed.day)}, "
            f"{len(speed.day.wall_s)} times."
        )
    for name, commands in (
        ("one sun (altitude 30)", speed.one_light),
        ("the day", speed.whole_day),
    ):
        if commands:
            yield f"- `svprep clamp` whole, {name}: {_commands(commands)}."


def _light_table(speed: Speed) -> Iterator[str]:
    head = ["light", "wall s", "range", "CPU s", "us/caster", "segments", "bytes/caster",
            "gain, area", "own box"]  # fmt: skip
    rows = [
        (
            row.name, f"{row.times.median_s:.3f}", _range(row.times.wall_s),
            f"{row.times.median_cpu_s:.3f}", f"{1e6 * row.times.median_s / speed.casters:.2f}",
            f"{row.segments:.2f}", f"{row.n_bytes:.1f}", f"{row.gain:.1f}", f"{row.gain_own:.1f}",
        )
        for row in speed.lights
    ]  # fmt: skip
    yield from table(head, rows)


def _large(city: Speed, large: Speed) -> Iterator[str]:
    """Yield how the time grows with the size."""
    yield "### Ten times the city"
    yield ""
    yield (
        f"`{large.name}`: {large.objects:,} objects, {large.triangles:,} triangles, "
        f"{large.casters:,} casters, {large.casters / city.casters:.1f} times as many. Setup "
        f"{_seconds(large.setup)}, {len(large.setup.wall_s)} times in turns."
    )
    yield ""
    yield from _light_table(large)
    yield ""
    both = {row.name: row for row in city.lights}
    parts = [
        f"{row.name} {_per_caster(row, large) / _per_caster(both[row.name], city):.2f}"
        for row in large.lights
    ]
    cpu = statistics.median(
        (row.times.median_cpu_s / large.casters)
        / (both[row.name].times.median_cpu_s / city.casters)
        for row in large.lights
    )
    setup = (large.setup.median_s / large.casters) / (city.setup.median_s / city.casters)
    yield (
        f"Seconds a caster over the city's: median {_linear(city, large):.2f} (CPU {cpu:.2f}); "
        f"{'; '.join(parts)}. The setup alone {setup:.2f}; lights without it, median "
        f"{_linear(city, large, without_setup=True):.2f}."
    )
    if large.one_light:
        yield ""
        yield f"`svprep clamp` whole, one sun (altitude 30): {_commands(large.one_light)}."


def _per_caster(row: LightRow, speed: Speed, without_setup: bool = False) -> float:
    """Return the median seconds of a light over the casters."""
    setup_s = speed.setup.median_s if without_setup else 0.0
    return (row.times.median_s - setup_s) / speed.casters


def _linear(city: Speed, large: Speed, without_setup: bool = False) -> float:
    """Return the median over lights of the seconds a caster, large over city."""
    both = {row.name: row for row in city.lights}
    return statistics.median(
        _per_caster(row, large, without_setup) / _per_caster(both[row.name], city, without_setup)
        for row in large.lights
    )


def _cold(starts: Sequence[ColdStart]) -> Iterator[str]:
    """Yield what compiling takes."""
    yield (
        "`svprep clamp` of a light on the sample city with no compiled kernels "
        "(`NUMBA_CACHE_DIR` an empty folder), and again, of another light, with what that left."
    )
    yield ""
    rows = [
        (
            f"`{start.light}`", f"{start.cold.wall_s:.1f}", f"{start.cold.cpu_s:.1f}",
            f"{start.warm.wall_s:.1f}", f"{start.warm.cpu_s:.1f}",
        )
        for start in starts
    ]  # fmt: skip
    yield from table(["light", "first, wall s", "CPU s", "again, wall s", "CPU s"], rows)


def _seconds(times: Times) -> str:
    return f"{times.median_s:.2f} s ({_range(times.wall_s)}; CPU {times.median_cpu_s:.2f})"


def _commands(commands: Sequence[Command]) -> str:
    walls = [command.wall_s for command in commands]
    cpu = statistics.median(command.cpu_s for command in commands)
    peak = max(command.peak_bytes for command in commands)
    return (
        f"{statistics.median(walls):.1f} s ({_range(walls)}; CPU {cpu:.1f}), peak "
        f"{peak / 1e6:,.0f} MB, {len(walls)} times"
    )


def _range(values: Sequence[float]) -> str:
    return f"{min(values):.2f}-{max(values):.2f}"


def _wrapped(line: str) -> str:
    """Break a long line of text; a table's row stays whole."""
    if line.startswith("|"):
        return line
    indent = "  " if line.startswith("- ") else ""
    return textwrap.fill(
        line, 100, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
