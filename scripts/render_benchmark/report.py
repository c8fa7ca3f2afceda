"""The figures as Markdown, for the terminal and for a file."""

from __future__ import annotations

import math
import statistics
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from render_benchmark.cold import STEPS, Cold
from render_benchmark.frames import MAP, PLAIN, VOLUMES, ViewFigures, Way, WayFigures
from silhouette_benchmark.report import table

NAMES = {"zpass": "z-pass", "zfail": "z-fail"}
PICTURE_TARGET_S, DRAW_TARGET_S = 2.0, 1.0
EXPLAINED = """\
Every way is drawn once unmeasured, then all ways by turns. "frame" is by the clock, from
nothing left to draw to nothing left again, reading pictures back left out; "counting" are the
passes that draw volumes (of the shadow map: the map). Medians, with their range. "ratio" is
to the frame without shadows of the same view, which is: see, ambient, light. "updates" are
samples that changed the count; "ns" are of counting. "differ" are surface pixels whose shadow
is not that of the first way with volumes. "triangles" are those made: geometry shaders, which
"each triangle" takes, too, make none that lie beside the picture."""
COLD_EXPLAINED = """\
A fresh process each, files and compiled kernels and shaders in the system's caches; seconds,
medians with their range; "CPU" is of all threads, and other work disturbs it less. The camera
sees all of the model, `auto`, clamped. Each step
is without the others inside it; "read" checks digests and makes tables, early or late;
"start Numba" is what its first kernel waits for, whichever that is; "facing" and "silhouette
query" load their compiled kernels; "first frame" includes what the driver compiles when it
first draws."""


@dataclass(frozen=True, slots=True)
class LightFigures:
    """What the light makes of the scene."""

    n_silhouette: int
    n_casting_faces: int
    n_closed: int
    n_components: int
    n_segments: int


@dataclass(frozen=True, slots=True)
class Report:
    """All figures of one run."""

    machine: str
    renderer: str
    load: str
    model: str
    objects: int
    triangles: int
    light: str
    size: str
    lit: LightFigures
    cameras: dict[str, str]
    views: list[ViewFigures]
    map_px: int
    cold: list[Cold]
    peak_bytes: int
    buffer_bytes: int


def markdown(report: Report) -> str:
    """Return the whole report."""
    lit = report.lit
    lines = [
        "# Render benchmark",
        "",
        "Made by `python3 scripts/benchmark_render.py --work FOLDER -o tests/benchmarks/render.md`."
        f" {report.machine}; {report.renderer}. The machine is shared: {report.load}.",
        "",
        "## Frames",
        "",
        f"{report.model}: {report.objects:,} objects, {report.triangles:,} triangles, "
        f"{lit.n_components:,} components, {lit.n_closed:,} of them with the closed volume; light "
        f"{report.light}: {lit.n_silhouette:,} silhouette edges, {lit.n_casting_faces:,} faces "
        f"cast, {lit.n_segments:,} clamped segments. {report.size} pixels. Peak resident memory "
        f"of the run {_mb(report.peak_bytes)}, graphics buffers of all ways together "
        f"{_mb(report.buffer_bytes)}.",
        "",
        EXPLAINED.replace("\n", " "),
    ]
    for view in report.views:
        lines += ["", *_view(report, view)]
    if report.cold:
        lines += ["", "## Cold starts", "", COLD_EXPLAINED.replace("\n", " "), ""]
        lines += _cold(report.cold)
    return "\n".join(map(_wrapped, lines)) + "\n"


def _view(report: Report, view: ViewFigures) -> Iterator[str]:
    yield f"### {view.name}"
    yield ""
    yield f"`--camera {report.cameras[view.name]}`; {view.n_surface:,} pixels are not sky."
    yield ""
    plain = view.plain.median_ms
    rows = [
        (
            name_of(found.way, report.map_px),
            _spread(found.frame_ms),
            f"{found.median_ms / plain:.2f}",
            *_counting(found, view.n_surface),
        )
        for found in view.ways
    ]
    head = ("", "frame ms", "ratio", "counting ms", "triangles", "updates", "a pixel")
    yield from table([*head, "ns/triangle", "ns/update", "differ"], rows)
    yield ""
    yield from _gains(view)
    yield from _remarks(view)


def name_of(way: Way, map_px: int) -> str:
    """Return what a row is called."""
    if way.volumes == MAP:
        return f"shadow map, {map_px} x {map_px}"
    if not way.is_counted:
        return way.volumes
    return f"{way.volumes}, {NAMES[way.method]}, {way.counter}"


def _counting(found: WayFigures, n_surface: int) -> tuple[str, ...]:
    if found.way.volumes == PLAIN:
        return ("",) * 7
    ns = 1e6 * found.median_count_ms
    return (
        _spread(found.count_ms),
        f"{found.n_triangles:,}",
        f"{found.n_updates:,}",
        f"{found.n_updates / max(n_surface, 1):.1f}" if found.way.is_counted else "",
        f"{ns / max(found.n_triangles, 1):,.0f}",
        f"{ns / max(found.n_updates, 1):,.1f}",
        f"{found.n_differing:,}",
    )


def _gains(view: ViewFigures) -> Iterator[str]:
    """Yield how the kinds of volumes compare, by method, medians over counters."""
    by_way = {found.way: found for found in view.ways if found.way.is_counted}
    first = next((v for v in VOLUMES if any(way.volumes == v for way in by_way)), "")
    for method, name in NAMES.items():
        said = []
        for volumes in VOLUMES:
            pairs = [
                (by_way[Way(first, method, way.counter)], found)
                for way, found in by_way.items()
                if way.volumes == volumes != first and way.method == method
            ]
            if pairs:
                times = statistics.median(a.median_ms / b.median_ms for a, b in pairs)
                updates = statistics.median(a.n_updates / max(b.n_updates, 1) for a, b in pairs)
                said.append(
                    f"{volumes} {times:.1f} times faster, {updates:.1f} times fewer updates"
                )
        if said:
            yield f"- {name}, against {first}, medians over counters: {'; '.join(said)}."


def _remarks(view: ViewFigures) -> Iterator[str]:
    once = [f for f in view.ways if len(f.frame_ms) == 1]
    if once:
        yield ""
        yield (
            f"{len(once)} ways have one measured frame and no range; where they took long, it is "
            "their first, compiling and uploading included."
        )
    if any(f.way.method == "zpass" and "z-fail" in f.passes for f in view.ways):
        yield ""
        yield "Volumes that end at the eye are counted by z-fail in z-pass, too."
    if negative := max((f.n_negative for f in view.ways), default=0):
        yield ""
        yield f"At most {negative:,} pixels of a frame had a count below 0."
    if math.isfinite(view.map_texel_m):
        wrong = next(f.n_differing for f in view.ways if f.way.volumes == MAP)
        yield ""
        yield (
            f"A texel of the map is {100.0 * view.map_texel_m:.0f} cm of the city; "
            f"{wrong / max(view.n_surface, 1):.1%} of the surface pixels differ from exact shadows."
        )


def _cold(cold: Sequence[Cold]) -> Iterator[str]:
    starts = [c.starts for c in cold]
    rows = [
        ("from opening to first draw call", *_pairs([[s.first_draw_s for s in x] for x in starts])),
        (
            "from opening to first picture",
            *_pairs([[s.first_picture_s for s in x] for x in starts]),
        ),
    ]
    for step in STEPS:
        wall = [[s.seconds.get(step, 0.0) for s in x] for x in starts]
        cpu = [[s.cpu_seconds.get(step, 0.0) for s in x] for x in starts]
        rows.append((f"step: {step}", *_pairs(wall, cpu)))
    for name, value in (
        ("peak resident memory", lambda s: s.peak_bytes),
        ("graphics buffers", lambda s: s.buffer_bytes),
    ):
        rows.append((name, *(cell for x in starts for cell in (_mb(max(map(value, x))), ""))))
    head = [cell for c in cold for cell in (f"{c.name}, {c.triangles:,} triangles", "CPU")]
    yield from table(["", *head], rows)
    yield ""
    for c in cold:
        aim, found, what = (
            (PICTURE_TARGET_S, [s.first_picture_s for s in c.starts], "first picture")
            if c.name == "sample city"
            else (DRAW_TARGET_S, [s.first_draw_s for s in c.starts], "first draw call")
        )
        reached = statistics.median(found)
        verdict = "met" if reached <= aim else f"missed, {reached / aim:.1f} times"
        yield f"- {c.name}, {what}: aim {aim:g} s, {reached:.2f} s, {verdict}."
        if c.first_ever is not None:
            ever = c.first_ever
            steps = sorted(ever.seconds.items(), key=lambda item: -item[1])[:3]
            most = ", ".join(f"{name} {s:.1f}" for name, s in steps)
            yield (
                f"- {c.name}, no kernel or shader compiled before: first picture after "
                f"{ever.first_picture_s:.1f} s (most: {most})."
            )


def _spread(values: Sequence[float]) -> str:
    digits = 0 if max(values) >= 100.0 else 1
    median = f"{statistics.median(values):,.{digits}f}"
    if len(values) == 1:
        return median
    return f"{median} ({min(values):,.{digits}f}-{max(values):,.{digits}f})"


def _pairs(
    wall: Sequence[Sequence[float]], cpu: Sequence[Sequence[float]] | None = None
) -> Iterator[str]:
    """Yield a cell of wall seconds and one of the processor's, for each cache."""
    for i, seconds in enumerate(wall):
        yield _s(seconds)
        yield f"{statistics.median(cpu[i]):.2f}" if cpu else ""


def _s(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.2f} ({min(values):.2f}-{max(values):.2f})"


def _mb(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:,.0f} MB"


def _wrapped(line: str) -> str:
    """Break a line of prose; tables and headings stay whole."""
    if line.startswith(("|", "#")):
        return line
    indent = "  " if line.startswith("- ") else ""
    return "\n".join(
        textwrap.wrap(
            line, 100, break_long_words=False, break_on_hyphens=False, subsequent_indent=indent
        )
    )
