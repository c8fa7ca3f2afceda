"""The judged pictures as Markdown."""

from __future__ import annotations

import statistics
import textwrap
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from shadow_judging.datasets import LeftOut
from shadow_judging.judging import Judged
from shadow_judging.store import Code, Result
from shadow_judging.views import LAMP, LIGHTS, SUNS, VIEWS
from silhouette_benchmark.report import table
from svprep_runtime.judge_constants import JUDGE_CONSTANTS

PIXELS_SHOWN = 6
WRITTEN_BEGINS, WRITTEN_ENDS = "<!-- written by hand: begins -->", "<!-- written by hand: ends -->"
WRITTEN_TITLE = "## What still differs, and why"
DECIDABLE_MEDIAN, DECIDABLE_LEAST = 0.90, 0.60


@dataclass(frozen=True, slots=True)
class Block:
    """Datasets that were judged alike."""

    title: str
    size: tuple[int, int]
    judged: list[Judged]
    exceeded: dict[str, tuple[int, int]]
    """Per dataset: pixels seen and admitted."""


@dataclass(frozen=True, slots=True)
class Report:
    """All of one run."""

    machine: str
    renderer: str
    seconds: float
    n_new: int
    """Pictures that this run judged; the others were kept from earlier ones."""
    code: Code
    blocks: list[Block]
    left_out: list[LeftOut]


def counted(results: Sequence[Result]) -> list[Result]:
    """Return the results that are to be exact: all but zp+."""
    return [one for one in results if one.shot.part != "apart"]


def n_differing(results: Sequence[Result]) -> int:
    """Return how many pixels of views and lights differ, each once however it is drawn.

    Of a picture with more than are listed, its largest number.
    """
    pixels: dict[tuple[str, str, str], set[tuple[int, int]]] = defaultdict(set)
    most: Counter[tuple[str, str, str]] = Counter()
    for one in counted(results):
        key = one.dataset, one.shot.view, one.shot.light
        pixels[key].update((x, y) for x, y, _ in one.differing)
        most[key] = max(most[key], one.n_differing)
    return sum(max(len(pixels[key]), most[key]) for key in most)


def markdown(report: Report) -> str:
    """Return the whole report."""
    lines = ["# Shadows, judged by rays", "", *_head(report)]
    for block in report.blocks:
        lines += ["", f"## {block.title}", "", *_block(block)]
    lines += ["", "## Pixels that differ", "", *_pixels(report)]
    lines += ["", "## Left out", "", *_left_out(report)]
    return "\n".join(map(_wrapped, lines)) + "\n"


def with_written(text: str, earlier: str) -> str:
    """Return a report with what was written by hand in an `earlier` one, before its pixels.

    Without any, with the place for it.
    """
    _, found, rest = earlier.partition(WRITTEN_BEGINS)
    written, ends, _ = rest.partition(WRITTEN_ENDS)
    if not (found and ends):
        written = f"\n{WRITTEN_TITLE}\n\nNothing is written yet.\n"
    before, title, after = text.partition("## Pixels that differ\n")
    return f"{before}{WRITTEN_BEGINS}{written}{WRITTEN_ENDS}\n\n{title}{after}"


def _head(report: Report) -> Iterator[str]:
    suns = ", ".join(f"{altitude:g}" for _, altitude in SUNS.values())
    yield "Made by `python3 scripts/judge_shadows.py --work FOLDER -o tests/benchmarks/shadows.md`."
    yield (
        f"{report.renderer}; {report.machine}; {report.seconds:,.0f} s, in which {report.n_new:,} "
        f"pictures were judged and the others kept. Code: judge {report.code.judge}, runtime "
        f"{report.code.runtime}."
    )
    yield ""
    yield (
        f"Constants: {JUDGE_CONSTANTS}. Wanted of each dataset: none differs, median decidable "
        f"{DECIDABLE_MEDIAN:.0%}, least {DECIDABLE_LEAST:.0%}."
    )
    yield ""
    yield (
        f"{len(VIEWS)} views ({', '.join(VIEWS)}) by {len(LIGHTS)} lights (suns at {suns} degrees "
        f"above the model's own ground, and a {LAMP} in the closed space nearest to its middle) "
        "are found by rays, before anything is drawn (`scripts/shadow_judging/views.py`). Each is "
        "judged once; zfail, zpass and auto, vertex and geometry shaders, clamped and whole "
        "volumes go around, each combination twice. One picture is drawn in all ways, and with "
        "counts in the stencil as well; with zp+, too, which is apart and not counted. A pixel "
        "that differs counts once for a view and a light, however often it is drawn."
    )


def _block(block: Block) -> Iterator[str]:
    width, height = block.size
    yield f"{width}x{height} pixels."
    yield ""
    yield from _datasets(block)
    results = [one for judged in block.judged for one in judged.results]
    yield ""
    yield "By how they were drawn:"
    yield ""
    yield from _ways(results)
    poor = [judged for judged in block.judged if not _is_wanted(judged)]
    if poor:
        yield ""
        yield "Less decidable than wanted:"
        yield ""
        yield from _poor(poor)
    apart = [one for one in results if one.shot.part == "apart"]
    if apart:
        yield ""
        yield (
            f"Apart, zp+: {len(apart)} pictures, {sum(o.n_differing for o in apart):,} pixels "
            f"differ in {sum(1 for o in apart if o.n_differing)} of them; "
            f"{sum(o.n_negative for o in apart):,} counts are negative."
        )
    for name, (seen, admitted) in block.exceeded.items():
        yield ""
        yield f"**{name}: {seen} pixels differ, {admitted} are admitted.**"


def _datasets(block: Block) -> Iterator[str]:
    head = [
        "", "triangles", "pictures", "drawn", "surface pixels", "decidable", "least",
        "differ", "a million", "negative", "in the sky", "lamp closed in",
    ]  # fmt: skip
    rows = [_row(judged) for judged in block.judged]
    if len(block.judged) > 1:
        every = [one for judged in block.judged for one in judged.results]
        total = Judged("all", False, sum(j.n_faces for j in block.judged), 0, 0, every)
        rows.append([*_row(total)[:-1], ""])
    yield from table(head, rows)


def _row(judged: Judged) -> list[str]:
    once = [one for one in judged.results if one.shot.part == "once"]
    shares = _shares(once)
    of_all = counted(judged.results)
    differing = n_differing(of_all)
    decidable = sum(one.n_decidable for one in once)
    return [
        judged.name, f"{judged.n_faces:,}", f"{len(once):,}", f"{len(of_all):,}",
        f"{sum(one.n_surface for one in once):,}",
        f"{statistics.median(shares):.1%}" if shares else "",
        f"{min(shares):.1%}" if shares else "",
        f"{differing:,}", f"{1e6 * differing / decidable:.3g}" if decidable else "",
        f"{sum(one.n_negative for one in of_all):,}",
        f"{sum(one.n_shadow_in_sky for one in of_all):,}", f"{judged.lamp_blocked} of 26",
    ]  # fmt: skip


def _shares(results: Sequence[Result]) -> list[float]:
    """Return the decidable shares of pictures that see anything."""
    return [one.n_decidable / one.n_surface for one in results if one.n_surface]


def _is_wanted(judged: Judged) -> bool:
    shares = _shares([one for one in judged.results if one.shot.part == "once"])
    return not shares or (
        statistics.median(shares) >= DECIDABLE_MEDIAN and min(shares) >= DECIDABLE_LEAST
    )


def _poor(poor: Sequence[Judged]) -> Iterator[str]:
    """Yield the pictures that make a dataset less decidable than wanted."""
    head = ["", "view", "light", "surface pixels", "decidable"]
    rows = []
    for judged in poor:
        for one in judged.results:
            if one.shot.part == "once" and one.n_decidable < DECIDABLE_MEDIAN * one.n_surface:
                share = f"{one.n_decidable / one.n_surface:.1%}"
                rows.append(
                    [judged.name, one.shot.view, one.shot.light, f"{one.n_surface:,}", share]
                )
    yield from table(head, rows)


def _ways(results: Sequence[Result]) -> Iterator[str]:
    """Yield the same by method, construction, clamping and counter, and their combinations."""
    kinds: list[tuple[str, Callable[[Result], str]]] = [
        ("method", lambda one: one.shot.method),
        ("construction", lambda one: one.shot.construction),
        ("clamping", lambda one: "clamped" if one.shot.clamp else "whole"),
        ("counter", lambda one: one.shot.counter),
        ("all of these", lambda one: one.shot.way),
    ]
    rows = []
    for kind, of in kinds:
        groups: dict[str, list[Result]] = defaultdict(list)
        for one in counted(results):
            groups[of(one)].append(one)
        for name, group in sorted(groups.items()):
            decidable = sum(one.n_decidable for one in group)
            differing = sum(one.n_differing for one in group)
            rows.append(
                [
                    f"{kind}: {name}", f"{len(group):,}", f"{differing:,}",
                    f"{1e6 * differing / decidable:.3g}" if decidable else "",
                    f"{sum(one.n_negative for one in group):,}",
                    f"{1e3 * statistics.median(one.draw_s for one in group):,.0f}",
                ]
            )  # fmt: skip
    yield from table(["", "drawn", "differ", "a million", "negative", "ms, median"], rows)


def _pixels(report: Report) -> Iterator[str]:
    """Yield every picture that differs, and where."""
    rows: list[Result] = []
    apart: list[Result] = []
    for block in report.blocks:
        for judged in block.judged:
            for one in judged.results:
                if one.n_differing:
                    (apart if one.shot.part == "apart" else rows).append(one)
    head = ["", "view", "light", "drawn", "differ", "negative", "column, row: what is drawn"]
    if not rows:
        yield "None, of any dataset."
    else:
        yield from table(head, _pixel_rows(rows))
    if apart:
        yield ""
        yield "Of zp+:"
        yield ""
        yield from table(head, _pixel_rows(apart))
    seen = {(one.dataset, one.shot.view, one.shot.light): one for one in rows}
    if seen:
        yield ""
        yield "Why, in float64 over all faces (`runtime/svprep_runtime/judge_causes.py`):"
        yield ""
        yield from _causes(rows)
        yield ""
        yield "Their cameras (`--camera`, input coordinates) and lights:"
        yield ""
        for one in seen.values():
            near = f", near plane at {one.near_m:g} m"
            yield (
                f"- {one.dataset}, {one.shot.view}, {one.shot.light}: `{one.camera_spec}`{near}; "
                f"`{one.light_spec}`"
            )


def _causes(rows: Sequence[Result]) -> Iterator[str]:
    """Yield a line for each pixel of a view and a light, and each cause of it."""
    told: dict[str, None] = {}
    for one in rows:
        for (x, y, _), cause in zip(one.differing, one.causes, strict=False):
            told[f"- {one.dataset}, {one.shot.view}, {one.shot.light}, {x}, {y}: {cause}."] = None
    yield from told


def _pixel_rows(results: Sequence[Result]) -> list[list[str]]:
    """Return a row for each picture; for all ways in which the same pixels of it differ, one."""
    groups: dict[str, list[Result]] = defaultdict(list)
    for one in results:
        same = one.dataset, one.shot.view, one.shot.light, one.n_differing, one.differing
        groups[repr(same)].append(one)
    return [_pixel_row(group) for group in groups.values()]


def _pixel_row(group: Sequence[Result]) -> list[str]:
    one = group[0]
    words = [f"{x}, {y}: {'shadow' if dark else 'lit'}" for x, y, dark in one.differing]
    shown = "; ".join(words[:PIXELS_SHOWN])
    if one.n_differing > PIXELS_SHOWN:
        shown += "; ..."
    ways = list(dict.fromkeys(each.shot.way for each in group))
    others = f" and {len(ways) - 1} more ways" if len(ways) > 1 else ""
    return [
        one.dataset, one.shot.view, one.shot.light, ways[0] + others, f"{one.n_differing:,}",
        f"{max(each.n_negative for each in group):,}", shown,
    ]  # fmt: skip


def _left_out(report: Report) -> Iterator[str]:
    if not report.left_out:
        yield "Nothing."
    for one in report.left_out:
        yield f"- {one.name}: {one.why}"


def _wrapped(line: str) -> str:
    """Break a long line of text; a table's row stays whole."""
    if line.startswith("|"):
        return line
    indent = "  " if line.startswith("- ") else ""
    return textwrap.fill(
        line, 100, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
