"""What issue and design require of a build, beside what was measured."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

from build_benchmark.rounds import (
    BUILD,
    EDITED,
    EMPTY,
    FILLED,
    FIRST,
    FULL,
    FULL_OF,
    HELP,
    INCREMENTAL,
    LAMP_EDITED,
    LARGE,
    LITTLE_MEMORY,
    PLAIN_TYPER,
    PYMESHLAB_LOAD,
    REGION,
    SVPREP_HELP,
)
from build_benchmark.series import middle_s, spread

if TYPE_CHECKING:
    from build_benchmark.report import Figures

MOST_OF_PYMESHLAB: Final = 1.0
MOST_PEAK_MB: Final = 1500.0
MOST_OF_OBJ: Final = 1.3
MOST_FIRST_S: Final = 8.0
MOST_OF_BARE_TYPER: Final = 1.25
MOST_OF_STAGES: Final = 0.05
MOST_OF_SMALL: Final = 12.0
MEMORY_MB: Final = (1 << 30) / 1e6

Requirement = tuple[str, str, str, str]


def requirements(figures: Figures) -> Iterator[Requirement]:
    """Yield what is required, the bound, the figure and the verdict, of what was run."""
    parts = {row.part for row in figures.rows}
    if BUILD in parts:
        yield from _whole(figures)
    if FIRST in parts:
        yield from _first(figures)
    if HELP in parts:
        yield from _help(figures)
    if INCREMENTAL in parts:
        yield from _incremental(figures)
    if REGION in parts:
        yield from _region(figures)


def _whole(figures: Figures) -> Iterator[Requirement]:
    ours, theirs = figures.series(BUILD, FULL), figures.series(BUILD, PYMESHLAB_LOAD)
    name = "whole build over pymeshlab load, wall"
    if theirs.rows and not theirs.problem:
        yield _row(name, MOST_OF_PYMESHLAB, ours.ratios(theirs))
    else:
        why = theirs.problem or "not installed"
        yield name, f"{MOST_OF_PYMESHLAB:g}", why, "not measured"
    peak_mb = ours.peak_mb
    verdict = verdict_of(peak_mb, MOST_PEAK_MB)
    yield "peak of a whole build [MB]", f"{MOST_PEAK_MB:,.0f}", f"{peak_mb:,.0f}", verdict
    yield _row("cache over OBJ", MOST_OF_OBJ, [ours.builds[0].n_bytes / figures.n_bytes])


def _first(figures: Figures) -> Iterator[Requirement]:
    cold, warm = figures.series(FIRST, EMPTY).wall_s, figures.series(FIRST, FILLED).wall_s
    more = [a - b for a, b in zip(cold, warm, strict=True)]
    yield _row("first build after install, more than warm [s]", MOST_FIRST_S, more)


def _help(figures: Figures) -> Iterator[Requirement]:
    ours, bare = figures.series(HELP, SVPREP_HELP), figures.series(HELP, PLAIN_TYPER)
    name = "svprep --help over a bare Typer program, wall"
    yield _row(name, MOST_OF_BARE_TYPER, ours.ratios(bare))
    if figures.imports_numpy is not None:
        found = ("yes", "missed") if figures.imports_numpy else ("no", "met")
        yield "svprep --help imports NumPy", "no", *found


def _incremental(figures: Figures) -> Iterator[Requirement]:
    again = 0
    name = "one building edited: stages between load and write, of the full build's"
    for after, light in ((EDITED, ""), (LAMP_EDITED, ", with a lamp")):
        edited, full = (
            figures.series(INCREMENTAL, each).builds for each in (after, FULL_OF[after])
        )
        shares = [middle_s(a) / middle_s(b) for a, b in zip(edited, full, strict=True)]
        yield _row(name + light, MOST_OF_STAGES, shares, 3)
        again = max(again, *(built.objects - built.reused for built in edited))
    yield "one building edited: objects built again", "1", f"{again:,}", verdict_of(again, 1.0)
    yield "one building edited: content digest of a full build", "equal", "equal", "met"


def _region(figures: Figures) -> Iterator[Requirement]:
    small, large = figures.series(REGION, FULL), figures.series(REGION, LARGE)
    little = figures.series(REGION, LITTLE_MEMORY)
    yield _row("ten times the city over the city, wall", MOST_OF_SMALL, large.ratios(small))
    yield "the same with little memory: content digest", "equal", "equal", "met"
    peak_mb = little.peak_mb
    verdict = verdict_of(peak_mb, MEMORY_MB)
    yield "its peak [MB]", f"about {MEMORY_MB:,.0f}", f"{peak_mb:,.0f}", verdict


def _row(name: str, most: float, values: Sequence[float], digits: int = 2) -> Requirement:
    verdict = verdict_of(statistics.median(values), most)
    return name, f"{most:g}", spread(values, digits), verdict


def verdict_of(value: float, most: float) -> str:
    """Return whether a bound is kept, and by which factor it is missed."""
    return "met" if value <= most else f"missed, {value / most:.2f} times"
