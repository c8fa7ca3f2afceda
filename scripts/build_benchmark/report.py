"""The figures as Markdown, for the terminal and for a file."""

from __future__ import annotations

import statistics
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from build_benchmark.processes import Built, Run, Stage
from build_benchmark.requirements import requirements
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
    LARGE,
    LITTLE_MEMORY,
    MEMORY,
    MODULES,
    PLAIN_TYPER,
    REGION,
    RICH_TYPER,
    SVPREP_HELP,
    Row,
)
from build_benchmark.series import Series, middle_s, spread

EXPLAINED = """\
Every process is a fresh one, by turns with the others of its section (builds and peers in another
order each time); seconds are medians with
their range, ratios are taken round by round. Files and compiled kernels are in the system's
caches ("warm") where nothing else is said. "CPU" is of all threads. "peak" is the most resident
memory of any of these processes, as the system tells it when one has ended; MB are 10^6 bytes."""
FULL_EXPLAINED = """\
The build is `svprep build --full --light dir:135,40`: every table, all silhouette indices, one
light. Peers lose object names; pymeshlab's repair deletes faces."""
STAGES_EXPLAINED = """\
Stages of the run with the median time. Tiles of the city go side by side through weld to
silhouettes: the time from the first tile to the last is shared among these by what each took."""
FIRST_EXPLAINED = """\
The same build with an empty folder for compiled kernels, and then once more with what that
left."""
INCREMENTAL_EXPLAINED = """\
A full build first, then builds over an older cache, which holds the city with one light and is
put back before each. "between" are the stages between load and write; its share is of the same
stages of the round's full build (without clamp, where there is no light). A building is edited
by moving one vertex by 0.25 m; the lamp stands 117 m beside it, 80 m higher. (A change to the
bounds of the whole model would move the origin of the grid, and nothing could be taken over.)
The content digest of each was that of a full build of the same model, in every round; a
difference would have ended the run."""
REGION_EXPLAINED = f"""\
`--memory {MEMORY}` keeps tables in files; its digest was equal to that of the build without."""


@dataclass(frozen=True, slots=True)
class Figures:
    """All figures of one run."""

    command: str
    machine: str
    load: str
    """Of the machine when the run began and when it ended, in words."""
    model: str
    n_bytes: int
    """Of the city's OBJ."""
    region_bytes: int | None
    imports_numpy: bool | None
    """Whether ``svprep --help`` does; None if that was not asked."""
    left_out: list[str]
    rows: list[Row]

    @classmethod
    def of(cls, held: Mapping[str, Any]) -> Figures:
        """Return what `dataclasses.asdict` made of figures, read from JSON."""
        rows = [
            Row(**{**row, "run": Run(**row["run"]), "built": _built(row["built"])})
            for row in held["rows"]
        ]
        return cls(**{**held, "rows": rows})

    def series(self, part: str, name: str) -> Series:
        """Return the rounds of one of the things that were run."""
        return Series([r for r in self.rows if (r.part, r.name) == (part, name) and r.turn >= 0])


def _built(held: Mapping[str, Any] | None) -> Built | None:
    if held is None:
        return None
    return Built(**{**held, "stages": tuple(Stage(**stage) for stage in held["stages"])})


def markdown(figures: Figures) -> str:
    """Return the whole report."""
    lines = [
        "# Build benchmark",
        "",
        f"Made by `{figures.command}`. {figures.machine}. {figures.load}",
        "",
        _model(figures),
        "",
        EXPLAINED.replace("\n", " "),
        "",
        "## Required",
        "",
        *table(["", "required", "measured", "verdict"], list(requirements(figures))),
    ]
    for part, section in (
        (BUILD, _whole),
        (FIRST, _first),
        (HELP, _help),
        (INCREMENTAL, _incremental),
        (REGION, _region),
    ):
        if any(row.part == part for row in figures.rows):
            lines += ["", *section(figures)]
    return "\n".join(map(_wrapped, lines)) + "\n"


def _model(figures: Figures) -> str:
    """Return what was built, in words."""
    said = f"{figures.model}: OBJ {figures.n_bytes / 1e6:,.1f} MB"
    built = next((row.built for row in figures.rows if row.built is not None), None)
    if built is None:
        return f"{said}."
    return (
        f"{said}, {built.objects:,} objects, {built.triangles:,} triangles; cache "
        f"{built.n_bytes / 1e6:,.1f} MB, {built.n_bytes / figures.n_bytes:.2f} of the OBJ, "
        f"{built.n_bytes / built.triangles:.0f} bytes a triangle."
    )


def _whole(figures: Figures) -> Iterator[str]:
    yield from ("## Whole builds and peers", "", FULL_EXPLAINED.replace("\n", " "), "")
    ours = figures.series(BUILD, FULL)
    names = dict.fromkeys(row.name for row in figures.rows if row.part == BUILD)
    rows, gave_up = [], []
    for name in names:
        series = figures.series(BUILD, name)
        if problem := series.problem:
            gave_up.append(f"- {name}: gave up: {problem}")
            continue
        rows.append((name, *_columns(series), spread(ours.ratios(series))))
    yield from table(["", "wall s", "CPU s", "peak MB", "svprep build takes"], rows)
    left_out = [f"- {name}: not installed ({_package(name)})" for name in figures.left_out]
    if gave_up or left_out:
        yield from ("", *gave_up, *left_out)
    yield from ("", "### Stages", "", STAGES_EXPLAINED.replace("\n", " "), "")
    yield from _stages(ours.median_row)


def _package(peer: str) -> str:
    return f"pip install {MODULES[peer.split()[0]]}"


def _stages(row: Row) -> Iterator[str]:
    """Yield the stages of one build, and what of its time is in none of them."""
    assert row.built is not None
    whole_s = row.run.wall_s
    rows = [
        (
            stage.name, f"{stage.seconds:.3f}", f"{stage.seconds / whole_s:.1%}",
            "" if stage.mtri_per_s is None else f"{stage.mtri_per_s:.2f}",
            f"{stage.bytes_written / 1e6:,.1f}" if stage.bytes_written else "",
            "" if stage.peak_mb is None else f"{stage.peak_mb:,.0f}",
        )
        for stage in row.built.stages
    ]  # fmt: skip
    rest_s = whole_s - sum(stage.seconds for stage in row.built.stages)
    rate = f"{row.built.triangles / whole_s / 1e6:.2f}"
    rows += [
        ("start, imports, summary, end", f"{rest_s:.3f}", f"{rest_s / whole_s:.1%}", "", "", ""),
        ("whole process", f"{whole_s:.3f}", "", rate, "", f"{row.run.peak_mb:,.0f}"),
    ]
    yield from table(["stage", "wall s", "share", "Mtri/s", "MB written", "peak MB so far"], rows)


def _first(figures: Figures) -> Iterator[str]:
    yield from ("## First build after install", "", FIRST_EXPLAINED.replace("\n", " "), "")
    both = [(name, figures.series(FIRST, name)) for name in (EMPTY, FILLED)]
    rows = [(name, *_columns(series)) for name, series in both]
    yield from table(["", "wall s", "CPU s", "peak MB"], rows)
    each = [f"{a - b:.2f}" for a, b in zip(both[0][1].wall_s, both[1][1].wall_s, strict=True)]
    yield from ("", f"More than warm, round by round [s]: {', '.join(each)}.")


def _help(figures: Figures) -> Iterator[str]:
    yield from ("## `svprep --help`", "")
    ours = figures.series(HELP, SVPREP_HELP)
    rows = []
    for name in (SVPREP_HELP, PLAIN_TYPER, RICH_TYPER):
        series = figures.series(HELP, name)
        ratios = spread(ours.ratios(series))
        rows.append((name, spread(series.wall_s, 3), spread(series.cpu_s, 3), ratios))
    yield from table(["", "wall s", "CPU s", "svprep --help takes"], rows)
    yield ""
    yield (
        "A bare program has as many commands, of one option each, and nothing else: plain with "
        "`rich_markup_mode=None`, as svprep has it, or with Typer's own settings."
    )


def _incremental(figures: Figures) -> Iterator[str]:
    yield from ("## Over an older cache", "", INCREMENTAL_EXPLAINED.replace("\n", " "), "")
    rows = []
    for name, full_name in FULL_OF.items():
        full, series = (figures.series(INCREMENTAL, each) for each in (full_name, name))
        builds = series.builds
        with_clamp = bool(builds[0].lights)
        between = [middle_s(built, with_clamp=with_clamp) for built in builds]
        whole = [middle_s(built, with_clamp=with_clamp) for built in full.builds]
        shares = [a / b for a, b in zip(between, whole, strict=True)]
        rows.append(
            (
                name, spread(series.wall_s), spread(series.ratios(full)), spread(between, 3),
                _percent(shares), f"{builds[0].reused:,} of {builds[0].objects:,}",
            )
        )  # fmt: skip
    head = ["", "wall s", "of the full build", "between, s", "share", "objects taken over"]
    yield from table(head, rows)
    yield from (
        "",
        "Stages of the median run after an edit, and of its round's full build [s]:",
        "",
    )
    median = figures.series(INCREMENTAL, EDITED).median_row
    beside = next(row for row in figures.series(INCREMENTAL, FULL).rows if row.turn == median.turn)
    yield from _beside(median, beside)


def _beside(row: Row, other: Row) -> Iterator[str]:
    """Yield the stages of two builds side by side."""
    assert row.built is not None
    assert other.built is not None
    full = {stage.name: stage.seconds for stage in other.built.stages}
    rows = [
        (stage.name, f"{stage.seconds:.3f}", f"{full[stage.name]:.3f}")
        for stage in row.built.stages
    ]
    yield from table(["stage", row.name, "full build"], rows)


def _region(figures: Figures) -> Iterator[str]:
    series = {name: figures.series(REGION, name) for name in (FULL, LARGE, LITTLE_MEMORY)}
    built = series[LARGE].builds[0]
    yield from ("## Ten times the city", "")
    size = f", OBJ {figures.region_bytes / 1e6:,.1f} MB" if figures.region_bytes else ""
    yield (
        f"{built.objects:,} objects, {built.triangles:,} triangles{size}; cache "
        f"{built.n_bytes / 1e6:,.1f} MB. {REGION_EXPLAINED}"
    )
    yield ""
    small = series[FULL]
    rows = [(name, *_columns(s), spread(s.ratios(small), 1)) for name, s in series.items()]
    yield from table(["", "wall s", "CPU s", "peak MB", "of the small build"], rows)
    for name in (LARGE, LITTLE_MEMORY):
        yield from ("", f"Stages, {name}:", "")
        yield from _stages(series[name].median_row)


def _columns(series: Series) -> tuple[str, ...]:
    return spread(series.wall_s), spread(series.cpu_s), f"{series.peak_mb:,.0f}"


def _percent(shares: Sequence[float]) -> str:
    return (
        f"{statistics.median(shares):.1%}"
        if len(shares) == 1
        else f"{statistics.median(shares):.1%} ({min(shares):.1%}-{max(shares):.1%})"
    )


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield a Markdown table, its columns aligned, all but the first to the right."""
    cells = [list(head), *map(list, rows)]
    widths = [max(3, *(len(row[column]) for row in cells)) for column in range(len(head))]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    for row in [cells[0], rule, *cells[1:]]:
        first, *rest = row
        padded = [first.ljust(widths[0]), *map(str.rjust, rest, widths[1:])]
        yield "| " + " | ".join(padded) + " |"


def _wrapped(line: str) -> str:
    """Break a long line of text; a table's row stays whole."""
    if line.startswith("|"):
        return line
    indent = "  " if line.startswith("- ") else ""
    return textwrap.fill(
        line, 100, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
