"""What ``svprep clamp``, ``build --light`` and ``info`` say of lights and their segments."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import typer

from svprep import pipeline, warm
from svprep.cache.reader import open_cache
from svprep.clamp import ClampCosts
from svprep.light import FORMS
from svprep.model import ClampTable, Grid

_MOST_LISTED = 12
"""Lights that a summary for people lists; --json lists all."""


def costs_of(vertex: float | None, area: float | None) -> ClampCosts:
    """Return the costs given on the command line.

    Raises
    ------
    typer.BadParameter
        One is not a number of at least 0.
    """
    for option, value in (("--cost-vertex", vertex), ("--cost-area", area)):
        if value is not None and not 0.0 <= value < math.inf:
            raise typer.BadParameter(f"{option} is a number of at least 0, not {value}")
    usual = ClampCosts()
    return ClampCosts(
        vertex=usual.vertex if vertex is None else vertex,
        area=usual.area if area is None else area,
    )


def add(
    cache: Path, specs: Sequence[str], costs: ClampCosts, tell: Callable[[str, int, int], None]
) -> dict[str, Any]:
    """Add lights to a cache and return the summary.

    Raises
    ------
    typer.BadParameter
        No light is named.
    InputError, CacheError, EnvironmentProblem
        As `pipeline.add_lights` says.
    """
    if not specs:
        raise typer.BadParameter(f"name one or more lights with --light SPEC: {FORMS}")
    started = time.perf_counter()
    warm.load_without_compiler()
    done = pipeline.add_lights(
        cache, specs, costs, lambda i, of: tell(f"clamp, light {i} of {of}", i, of)
    )
    seconds = time.perf_counter() - started
    with open_cache(cache) as opened:
        listed = light_facts(done.clamp, opened.grid)
        digest = opened.content_digest
    return {
        "cache": str(cache),
        "n_bytes": cache.stat().st_size,
        "content_digest": digest,
        "added": len(done.added),
        "replaced": done.n_replaced,
        "already_there": done.n_present,
        "seconds": round(seconds, 3),
        "new_lights": [listed[i] for i in done.added],
        "lights": len(listed),
        "lights_bytes": sum(light["n_bytes"] for light in listed),
        "remarks": warm.remarks(),
    }


def light_facts(table: ClampTable, grid: Grid) -> list[dict[str, Any]]:
    """Return one object a light: what it is, what its segments take, and what they gain."""
    n_casters = table.segment_start.shape[1] - 1
    per_segment = table.depths.itemsize * 2 + table.slopes.itemsize * 2
    facts = []
    for i, spec in enumerate(table.specs):
        x, y, z, w = table.lights[i].tolist()
        vertex, area, unclamped, own_box, clamped = table.facts[i].tolist()
        n_segments = int(table.light_start[i + 1] - table.light_start[i])
        n_bytes = (
            4 * (n_casters + 1)
            + per_segment * n_segments
            + 128
            + len(spec.encode("utf-8", "surrogateescape"))
        )
        facts.append(
            {
                "spec": spec,
                "light": [x, y, z, w],
                "azimuth_deg": None if w else round(math.degrees(math.atan2(x, y)) % 360.0, 4),
                "altitude_deg": None
                if w
                else round(math.degrees(math.atan2(z, math.hypot(x, y))), 4),
                "position": [p + float(o) for p, o in zip((x, y, z), grid.origin_m, strict=True)]
                if w
                else None,
                "casters": n_casters,
                "segments": n_segments,
                "n_bytes": n_bytes,
                "bytes_per_caster": round(n_bytes / max(n_casters, 1), 2),
                "cost_vertex": vertex,
                "cost_area": area,
                "gain": round(unclamped / clamped, 3) if clamped > 0.0 else None,
                "gain_own_box": round(unclamped / own_box, 3) if own_box > 0.0 else None,
            }
        )
    return facts


def add_lines(summary: dict[str, Any]) -> list[str]:
    """Return the summary of ``svprep clamp`` as lines for people."""
    parts = [f"{summary['added']} added"]
    if summary["replaced"]:
        parts.append(f"{summary['replaced']} of before replaced, with other costs")
    if summary["already_there"]:
        parts.append(f"{summary['already_there']} already there or named twice")
    return [
        f"cache    {summary['cache']} ({summary['n_bytes']:,} bytes)",
        f"lights   {', '.join(parts)}; it holds {summary['lights']} now, "
        f"{summary['lights_bytes']:,} bytes of them",
        *light_lines(summary["new_lights"]),
        *(f"remark   {remark}" for remark in summary["remarks"]),
        f"time     {summary['seconds']:.2f} s",
    ]


def light_lines(lights: Sequence[dict[str, Any]]) -> list[str]:
    """Return a line for each light, up to a number, and what the numbers mean."""
    lines = []
    for light in lights[:_MOST_LISTED]:
        gain = "" if light["gain"] is None else f", gain {light['gain']:.1f}x"
        if light["gain_own_box"] is not None:
            gain += f" (own box alone {light['gain_own_box']:.1f}x)"
        lines.append(
            f"light    {light['spec']}: {light['segments']:,} segments of {light['casters']:,} "
            f"casters, {light['n_bytes']:,} bytes{gain}"
        )
    if len(lights) > _MOST_LISTED:
        lines.append(f"light    ... and {len(lights) - _MOST_LISTED} more (--json lists all)")
    if lights:
        lines.append(
            "         gain: surface of all shadow volumes that reach to the end of the scene, over "
            "that of the clamped ones"
        )
    return lines
