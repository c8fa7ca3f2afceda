"""The figures as Markdown, for the terminal and for a file."""

from __future__ import annotations

import os
import platform
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from silhouette_benchmark.facts import Bound, Counts, FirstQuery, Published
from silhouette_benchmark.measure import Ratio, SubsetRow, Timing
from silhouette_benchmark.memory import Bandwidth

NUMPY, FLAT = "(a) NumPy flat", "flat"

EXPLAINED = """\
A new light for every query, the same ones for all methods: by turns directional, above
and below the horizon, and point lights at 0.1 to 10 times the model's radius. All
answers were compared row by row, and are equal. Times are milliseconds. "alone": each
method on its own, light after light. "in turns": all methods by turns, in changing order
and never the same light twice running, so that what a query finds in the processor's
cache is what the others left. "visited" are the records whose multiplicity was computed.
"bound" is the time that reading 32 B a plane and 4 B per face of a searched record, and
writing 5 B per silhouette record, take at the measured bandwidth of memory. (a) is one
core of NumPy, (b) compiled code, written apart from the product's `flat`. Ratios are to
the fastest of `flat` and (b); below 1 is faster than it."""


@dataclass(frozen=True, slots=True)
class DatasetReport:
    """All figures of one dataset."""

    name: str
    source: str
    counts: Counts
    lights: list[list[float]]
    timings: dict[str, Timing]
    """In turns."""
    alone: dict[str, Timing]
    baseline: str
    """The fastest of `FLAT` and `compiled`, by its median."""
    ratios: dict[str, Ratio]
    compiled: dict[str, str]
    """How baseline (b) goes about it, on one thread and on all."""
    bandwidth: Bandwidth
    bound: Bound
    index_bytes: dict[str, int]
    build_seconds: dict[str, float]
    published: Published | None
    first_query: FirstQuery
    coherent: dict[str, Timing]
    subsets: list[SubsetRow]


@dataclass(frozen=True, slots=True)
class Report:
    """All figures of one run."""

    machine: str
    threads: int
    seed: int
    memory: Bandwidth
    datasets: list[DatasetReport]


def machine() -> str:
    """Return what the figures depend on, in words."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return (
        f"{platform.machine()}, {cores} cores, Python {platform.python_version()}, "
        f"NumPy {np.__version__}, {datetime.now(UTC):%Y-%m-%d}"
    )


def numba_name(threads: int) -> str:
    """Return what baseline (b) on so many threads is called."""
    return f"(b) Numba, {threads} thread" + ("s" if threads > 1 else "")


def markdown(report: Report) -> str:
    """Return the whole report."""
    lines = [
        "# Silhouette benchmark",
        "",
        "Made by `python3 scripts/benchmark_silhouette.py -o tests/benchmarks/silhouette.md`.",
        f"{report.machine}; {report.threads} threads, seed {report.seed}. {_moved(report.memory)}",
        "",
        EXPLAINED,
    ]
    for dataset in report.datasets:
        lines += ["", *_dataset(dataset)]
    return "\n".join(map(_wrapped, lines)) + "\n"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield a Markdown table, its columns aligned, all but the first to the right."""
    cells = [list(head), *map(list, rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    for row in [cells[0], rule, *cells[1:]]:
        first, *rest = row
        padded = [first.ljust(widths[0]), *map(str.rjust, rest, widths[1:])]
        yield "| " + " | ".join(padded) + " |"


def _dataset(d: DatasetReport) -> Iterator[str]:
    """Yield the section of one dataset."""
    c = d.counts
    yield f"## {d.name}"
    yield ""
    yield (
        f"`{d.source}`: {c.objects:,} objects, {c.components:,} components ({c.solids:,} solid), "
        f"{c.planes:,} planes, {c.records:,} records ({c.single:,} single, {c.planar:,} planar, "
        f"{c.pairs:,} pairs to search, {c.indexed:,} of them in trees); {len(d.lights)} lights."
    )
    yield ""
    yield from _timings(d)
    yield ""
    yield from _ratios(d)
    yield ""
    yield from _bound(d)
    yield from _build(d)
    if d.published:
        p = d.published
        yield (
            f"- The hextree as published: {p.cells:,.0f} cells and {p.edges:,.0f} of its "
            f"{p.n_tree:,} edges visited; with the {p.n_always:,} records outside it that is "
            f"{p.edges + p.n_always:,.0f} (medians)."
        )
    q = d.first_query
    yield (
        f"- A fresh process, kernels compiled before: import {q.import_s:.2f} s, open "
        f"{q.open_s:.3f} s, first query {q.first_s:.3f} s, second {q.second_s:.4f} s."
    )
    yield ""
    yield "An hour of sun, a direction a minute, each method on its own:"
    yield ""
    rows = [(name, _ms(t.median_ms), f"{sum(t.ms):.1f}") for name, t in d.coherent.items()]
    yield from table(["method", "ms a step", "ms in all"], rows)
    if d.subsets:
        yield ""
        yield "Some of the objects, drawn at random for each light:"
        yield ""
        yield from _subsets(d.subsets)


def _timings(d: DatasetReport) -> Iterator[str]:
    head = ["method", "alone", "quartiles", "in turns", "quartiles", "visited", "of records",
            "silhouette", "ns/visited", "x bound"]  # fmt: skip
    rows = []
    for name, timing in d.timings.items():
        alone = d.alone[name]
        per_visited = np.array(alone.ms) * 1e6 / np.maximum(timing.visited, 1)
        visited = float(np.median(timing.visited))
        rows.append(
            (
                name, _ms(alone.median_ms), _quartiles(alone), _ms(timing.median_ms),
                _quartiles(timing), f"{visited:,.0f}", f"{visited / d.counts.records:.1%}",
                f"{np.median(timing.found):,.0f}", f"{np.median(per_visited):.2f}",
                f"{alone.median_ms / d.bound.memory_ms:.2f}",
            )
        )  # fmt: skip
    yield from table(head, rows)


def _quartiles(timing: Timing) -> str:
    low, high = np.percentile(timing.ms, [25, 75])
    return f"{_ms(low)}–{_ms(high)}"


def _ratios(d: DatasetReport) -> Iterator[str]:
    own = "; ".join(f"{name}: {how}" for name, how in d.compiled.items())
    yield f"Over the fastest flat scan, {d.baseline}. ({own}.)"
    yield ""
    head = ["method", "alone", "in turns", "quartiles", "directional", "point", "slower in turns"]
    whole = d.alone[d.baseline].median_ms
    rows = [
        (
            name, f"{d.alone[name].median_ms / whole:.3f}", f"{r.median:.3f}",
            f"{r.quartiles[0]:.3f}–{r.quartiles[1]:.3f}",
            f"{r.directional:.3f}", f"{r.point:.3f}", f"{r.slower} of {len(d.lights)}",
        )
        for name, r in d.ratios.items()
    ]  # fmt: skip
    yield from table(head, rows)


def _bound(d: DatasetReport) -> Iterator[str]:
    b = d.bound
    named = [name for name in ("auto", FLAT, *d.compiled) if name in d.timings]
    times = "; ".join(
        f"{name} {d.alone[name].median_ms / b.memory_ms:.2f} and "
        f"{d.alone[name].median_ms / b.cached_ms:.2f} times"
        for name in named
    )
    yield (
        f"- Bound: {b.n_read / 1e6:.1f} MB read, {b.n_written / 1e6:.2f} MB written: "
        f"{b.memory_ms:.3f} ms from memory, {b.cached_ms:.3f} ms if all of it stays in the "
        f"processor's cache; alone, {times}. {_moved(d.bandwidth)}"
    )


def _build(d: DatasetReport) -> Iterator[str]:
    """Yield what the indices cost: bytes and seconds."""
    for name, n_bytes in d.index_bytes.items():
        yield (
            f"- Index of {name}: {n_bytes / 1e6:.2f} MB, "
            f"{n_bytes / max(d.counts.indexed, 1):.2f} bytes per edge in it, "
            f"{n_bytes / d.counts.records:.2f} per record."
        )
    if not d.index_bytes:
        yield "- The cache holds no index."
    own = d.build_seconds.get("silhouettes")
    whole = sum(d.build_seconds.values())
    spent = "no stage of their own" if own is None else f"{own:.2f} s"
    yield f"- Building the indices: {spent}, of {whole:.2f} s for the whole build."


def _subsets(rows: list[SubsetRow]) -> Iterator[str]:
    whole = {row.method: row.median_ms for row in rows if row.share == 1.0}
    yield from table(
        ["objects", "of all", "method", "ms, median", "of the time for all", "visited"],
        [
            (
                f"{row.objects:,}", f"{row.share:.0%}", row.method, _ms(row.median_ms),
                f"{row.median_ms / whole[row.method]:.1%}", f"{row.visited:,.0f}",
            )
            for row in rows
        ],
    )  # fmt: skip


def _wrapped(line: str) -> str:
    """Break a long line of text; a table's row stays whole."""
    if line.startswith("|") or "\n" in line:
        return line
    indent = "  " if line.startswith("- ") else ""
    return textwrap.fill(
        line, 100, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _moved(b: Bandwidth) -> str:
    return (
        f"Over {b.n_bytes / 1e6:,.0f} MB this machine reads {b.read:.1f} GB/s, writes "
        f"{b.write:.1f}, copies {b.copy:.1f}."
    )


def _ms(value: float) -> str:
    """Return three significant digits or so."""
    return f"{value:.3f}" if value < 10.0 else f"{value:.1f}"
