"""What ``svprep build`` and ``svprep info`` do with their options, and what they say of a city."""

from __future__ import annotations

import contextlib
import json
import os
import stat
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import typer

from svprep import cli_clamp, pipeline, report, warm
from svprep.cache.reader import Cache, open_cache
from svprep.clamp import ClampCosts
from svprep.cli_messages import crs_name
from svprep.defects import LEFT_OUT, Code
from svprep.ingest.crs_names import is_place_on_earth
from svprep.ingest.inputs import expanded
from svprep.ingest.options import HIGHEST, ReadOptions, is_lod
from svprep.model import EdgeTable, Place
from svprep.parallel import thread_count
from svprep.process_memory import keep_free_memory, use_small_pages
from svprep.stage_clock import StageRow

Tell = Callable[[str, int, int], None]

_MOST_NAMES: Final = 12
_MOST_SOURCES: Final = 12
_MOST_NOTES: Final = 25
"""What people are shown at most; --json and --report list all."""
_MOST_BYTES_IN_SMALL_PAGES: Final = 1 << 28
_ABOUT: Final = 1.1
"""The share of ``--memory`` that is held before a remark says so."""
LEAST_MEMORY: Final = 64 << 20


@dataclass(frozen=True, slots=True)
class Order:
    """The options of one build, each already known to be of its kind."""

    inputs: Sequence[str]
    output: str | None
    config: pipeline.BuildConfig
    lights: Sequence[str]
    costs: ClampCosts | None
    report: Path | None
    memory_bytes: int | None = None
    """[B]: about what the process may hold; None: all of the model."""
    is_full: bool = False
    """Whether objects that an older cache holds are built again as well."""


def config_of(
    weld_tolerance_m: float,
    lod: str,
    objects: Sequence[str],
    *,
    has_terrain: bool,
    has_openings: bool,
    crs: str | None = None,
) -> pipeline.BuildConfig:
    """Return what a build is asked for.

    Raises
    ------
    typer.BadParameter
        A usage error: no distance, no level of detail, an empty type, an unknown CRS.
    EnvironmentProblem
        A CRS, and pyproj is missing.
    """
    if not 0.0 <= weld_tolerance_m < float("inf"):
        raise typer.BadParameter("--weld-tolerance is a distance in metres, 0 or more")
    if not is_lod(lod):
        raise typer.BadParameter(f'--lod is "{HIGHEST}" or a number such as 2 or 2.2, not "{lod}"')
    if not all(name.strip() for name in objects):
        raise typer.BadParameter("--objects names a type, such as Building")
    if crs is not None and not is_place_on_earth(crs):
        raise typer.BadParameter(f'--crs is one that pyproj knows, such as EPSG:28992, not "{crs}"')
    reading = ReadOptions(lod, tuple(objects), has_terrain, has_openings, crs or "")
    return pipeline.BuildConfig(weld_tolerance_m, reading)


def build(
    order: Order, progress: Callable[[], contextlib.AbstractContextManager[Tell]]
) -> dict[str, Any]:
    """Build a cache, write its report, and return what ``--json`` prints.

    `progress` is begun when kernels are being seen to: it may start a thread, beside which no
    second compiler could be forked.

    Raises
    ------
    typer.BadParameter
        The report's name has no known suffix.
    InputError, CacheError, EnvironmentProblem
        As `pipeline.build`; or the report cannot be written there.
    """
    if order.report is not None:
        if not report.REPORT.has_suffix(order.report):
            raise typer.BadParameter(f"{order.report}: a report is .json or .csv; name it so")
        cache = order.output or pipeline.default_cache_path(order.inputs)
        report.REPORT.checked_path(order.report, [*expanded(order.inputs).paths, cache])
    thread_count()  # a slip in SVPREP_THREADS is told before any work
    warm.load_without_compiler()
    if order.memory_bytes is None:
        keep_free_memory()
    if _is_small(order.inputs):
        use_small_pages()
    with warm.second_compiler(order.lights), progress() as tell:
        result = pipeline.build(
            order.inputs,
            order.output,
            order.config,
            lambda stage: tell(stage, pipeline.STAGES.index(stage), len(pipeline.STAGES)),
            lights=order.lights,
            costs=order.costs,
            memory_bytes=order.memory_bytes,
            is_full=order.is_full,
        )
    if order.report is not None:
        report.write_report(result.prepared, order.report)
    with open_cache(result.cache.path, check_digests=False) as built:
        content = _content(built)
    return {
        "cache": str(result.cache.path),
        "n_bytes": result.cache.n_bytes,
        "content_digest": result.cache.content_digest,
        **content,
        "reused_objects": result.reused,
        "remarks": [
            *result.remarks,
            *_over_budget(result.stages, order.memory_bytes),
            *warm.remarks(),
        ],
        "seconds": {name: round(s, 4) for name, s in result.seconds.items()},
        "stages": [_stage(row) for row in result.stages],
    }


def _over_budget(stages: Sequence[StageRow], memory_bytes: int | None) -> list[str]:
    """Return a remark if more was held than ``--memory`` asks for."""
    peak_mb = max((row.peak_mb or 0.0 for row in stages), default=0.0)
    if memory_bytes is None or peak_mb * 1e6 <= memory_bytes * _ABOUT:
        return []
    return [
        f"at most {peak_mb:,.0f} MB were held, more than the {memory_bytes / 1e6:,.0f} of "
        "--memory: Python, its libraries, the scene tree, the lights and an object larger than a "
        "tile are held all the same; so are pages of files, which the system takes back where it "
        "needs them"
    ]


def _stage(row: StageRow) -> dict[str, Any]:
    """Return what ``--json`` says of one stage."""
    return {
        "name": row.name,
        "seconds": round(row.seconds, 4),
        "peak_mb": None if row.peak_mb is None else round(row.peak_mb, 1),
        "mtri_per_s": None if row.mtri_per_s is None else float(f"{row.mtri_per_s:.4g}"),
        "bytes_written": row.bytes_written,
    }


def describe(path: Path) -> dict[str, Any]:
    """Return what ``svprep info --json`` prints of a cache.

    Raises
    ------
    CacheError
        It is missing or damaged.
    """
    with open_cache(path) as cache:
        return _cache_summary(cache)


def _cache_summary(cache: Cache) -> dict[str, Any]:
    return {
        "cache": str(cache.path),
        "n_bytes": cache.path.stat().st_size,
        "content_digest": cache.content_digest,
        "producer_version": cache.producer_version,
        "config": cache.config,
        "crs": cache.crs,
        "grid_origin_m": cache.grid.origin_m.tolist(),
        "planar_tolerance_m": cache.planes.tolerance_m,
        **_content(cache),
        "datasets": cache.dataset_sizes(),
    }


def _is_small(inputs: Sequence[str]) -> bool:
    """Whether the inputs are files, not packed, that hold little; others would have to be read."""
    n_bytes = 0
    for each in inputs:
        try:
            status = os.stat(each)
        except (OSError, ValueError):  # told when it is read, or it is a pattern
            return False
        if not stat.S_ISREG(status.st_mode) or each.lower().endswith(".gz"):
            return False
        n_bytes += status.st_size
    return n_bytes <= _MOST_BYTES_IN_SMALL_PAGES


def _content(cache: Cache) -> dict[str, Any]:
    """Return what `build` and `info` both say of a city.

    Of the large tables only the columns that are counted are read: a city may be larger
    than memory.
    """
    labels, repair = cache.labels, cache.repair
    flags = cache.raw("edges/flags")
    edges = EdgeTable(rows=np.empty((0, 4), np.uint32), flags=flags)
    left_out = np.isin(repair.face_findings.code, (*LEFT_OUT, Code.SHORT_POLYGON))
    return {
        "sources": [asdict(source) for source in cache.sources],
        "place": asdict(cache.place),
        "objects": cache.n_objects,
        "object_types": report.type_counts(labels),
        "objects_with_parent": sum(1 for parent in labels.object_parents if parent),
        "faces_by_surface": report.surface_counts(labels.surface_of_face, labels),
        "triangles_in": int(repair.source_triangles.sum(dtype=np.int64)),
        "faces": cache.n_faces,
        "vertices": cache.n_vertices,
        "planes": cache.n_planes,
        "edges": report.edge_counts(edges),
        **report.component_counts(cache.raw("components/flags")),
        "index": report.index_counts(cache.index),
        "clusters": len(cache.raw("scene/cluster_start")) - 1,
        "lights": cli_clamp.light_facts(cache.clamp, cache.grid),
        "grid_step_m": cache.grid.step_m,
        "extent_m": report.extent_m(cache.raw("mesh/positions")),
        "left_out": int(np.count_nonzero(left_out)),
        "turned": len(repair.flipped_faces),
        "defects": report.total_counts(repair),
        "notes": list(cache.notes),
    }


def build_lines(summary: dict[str, Any]) -> list[str]:
    """Return what `build` made as the lines that people read."""
    n_sources = len(summary["sources"])
    seconds = ", ".join(f"{name} {s:.2f}" for name, s in summary["seconds"].items())
    return [
        *([f"sources  {n_sources:,} files, {_megabytes(summary)}"] if n_sources > 1 else []),
        *_content_lines(summary),
        *_reused_lines(summary),
        *(f"remark   {remark}" for remark in summary["remarks"]),
        f"seconds  {sum(summary['seconds'].values()):.2f} ({seconds})",
        *_memory_lines(summary["stages"]),
        f"cache    {summary['cache']} ({summary['n_bytes'] / 1e6:.1f} MB)",
    ]


def _reused_lines(summary: dict[str, Any]) -> list[str]:
    """Return how much of an older cache was used, if any."""
    n, of = summary["reused_objects"], summary["objects"]
    if not n:
        return []
    return [f"reused   {n:,} of {of:,} objects, from the older cache; --full builds all again"]


def _memory_lines(stages: list[dict[str, Any]]) -> list[str]:
    """Return the most memory that was held, where the system tells."""
    peaks = [s["peak_mb"] for s in stages if s["peak_mb"]]
    return [f"memory   at most {max(peaks):,.0f} MB"] if peaks else []


def _megabytes(summary: dict[str, Any]) -> str:
    return f"{sum(source['n_bytes'] for source in summary['sources']) / 1e6:.1f} MB"


def info_lines(summary: dict[str, Any]) -> list[str]:
    """Return what a cache holds as the lines that people read."""
    lines = [
        f"cache    {summary['cache']} ({summary['n_bytes'] / 1e6:.1f} MB)",
        f"digest   {summary['content_digest']}",
        f"made by  svprep {summary['producer_version']}, {json.dumps(summary['config'])}",
    ]
    sources = summary["sources"]
    for source in sources[:_MOST_SOURCES]:
        crs = f", CRS {crs_name(source['crs'])}" if source["crs"] else ""
        lines.append(
            f"source   {source['path']} ({source['format']}, {source['n_bytes']:,} bytes, "
            f"SHA-256 {source['sha256'][:16]}...{crs})"
        )
    if len(sources) > _MOST_SOURCES:
        lines.append(
            f"source   ... and {len(sources) - _MOST_SOURCES:,} more, {_megabytes(summary)} in "
            "all; --json lists them"
        )
    x, y, z = summary["grid_origin_m"]
    lines.append(f"origin   ({x:.3f}, {y:.3f}, {z:.3f}) m")
    lines += _content_lines(summary)
    lines += [f"bytes    {size:>13,}  {name}" for name, size in summary["datasets"].items()]
    return lines


def _content_lines(summary: dict[str, Any]) -> list[str]:
    """Return what `build` and `info` both say."""
    edges, index = summary["edges"], summary["index"]
    n_edges = edges["pair"] + edges["border"] + edges["split"]
    x, y, z = summary["extent_m"]
    notes = summary["notes"]
    lines = [
        f"mesh     {summary['objects']:,} objects, {summary['faces']:,} faces "
        f"(of {summary['triangles_in']:,} triangles read), {summary['vertices']:,} vertices, "
        f"{summary['planes']:,} planes",
        *_label_lines(summary),
        f"edges    {n_edges:,} records: {edges['pair']:,} pairs, {edges['border']:,} border, "
        f"{edges['split']:,} split; {edges['planar']:,} planar",
        f"parts    {summary['components']:,} components, {summary['closed']:,} closed, "
        f"{summary['solid']:,} solid",
        f"index    {index['objects']:,} objects have silhouette trees, over {index['edges']:,} "
        f"edges ({index['n_bytes'] / 1e6:.1f} MB)",
        f"extent   {x:,.2f} x {y:,.2f} x {z:,.2f} m (east, north, up)",
        *_place_lines(Place(**summary["place"])),
        f"grid     {summary['grid_step_m']:g} m; {summary['clusters']:,} clusters of faces",
        f"repair   {summary['left_out']:,} faces left out (no area on the grid, duplicates, "
        f"no surface), {summary['turned']:,} turned; all listed by --report",
    ]
    lines += [f"found    {count:>10,}  {label}" for label, count in summary["defects"].items()]
    lines += [f"note     {note}" for note in notes[:_MOST_NOTES]]
    if len(notes) > _MOST_NOTES:
        lines.append(f"note     ... and {len(notes) - _MOST_NOTES:,} more; --json lists them")
    return lines + cli_clamp.light_lines(summary["lights"])


def _label_lines(summary: dict[str, Any]) -> list[str]:
    """Return what the files say of objects and faces, if they say anything."""
    lines = []
    n_parts = summary["objects_with_parent"]
    of_others = f"; {n_parts:,} are parts of others" if n_parts else ""
    if summary["object_types"]:
        lines.append(f"types    {_counts(summary['object_types'])}{of_others}")
    elif n_parts:
        lines.append(f"types    not stated{of_others}")
    if summary["faces_by_surface"]:
        lines.append(f"surfaces {_counts(summary['faces_by_surface'])}")
    return lines


def _counts(counts: dict[str, int]) -> str:
    """Return ``"Building 1,200, not stated 3"``."""
    named = [f"{name or 'not stated'} {n:,}" for name, n in counts.items()]
    more = [f"... ({len(named)} kinds)"] if len(named) > _MOST_NAMES else []
    return ", ".join(named[:_MOST_NAMES] + more)


def _place_lines(place: Place) -> list[str]:
    """Return where on Earth the model stands, as far as that is known."""
    if not place.crs:
        return ["place    no CRS is stated; +y is taken for north"]
    line = f"place    {crs_name(place.crs)}"
    if place.latitude_deg is not None and place.longitude_deg is not None:
        line += (
            f"; {abs(place.latitude_deg):.5f} {'SN'[place.latitude_deg >= 0.0]} "
            f"{abs(place.longitude_deg):.5f} {'WE'[place.longitude_deg >= 0.0]}"
        )
    if place.convergence_deg is None:
        return [f"{line}; true north is not known"]
    side = "west" if place.convergence_deg < 0.0 else "east"
    angle = abs(np.round(place.convergence_deg, 4))
    return [f"{line}; grid north is {angle:g} degrees {side} of true north"]
