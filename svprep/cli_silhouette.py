"""What ``svprep silhouette`` does with its options: ask, time, sum up, say it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import typer

from svprep import warm
from svprep.cache.reader import Cache, open_cache
from svprep.errors import InputError
from svprep.light import FORMS, Light, is_arc, is_sun, parse_light
from svprep.silhouette import METHODS, VOLUMES, Silhouette, silhouette
from svprep.silhouette.lines import LINES, silhouette_lines, write_lines

if TYPE_CHECKING:
    from svprep.model import I64
    from svprep.silhouette import Method, Volume

_Name = TypeVar("_Name", bound=str)


@dataclass(frozen=True, slots=True)
class Query:
    """The options of one call, each already known to be of its kind."""

    cache: Path
    light_spec: str
    method: Method
    volume: Volume
    object_names: tuple[str, ...]
    """Empty: all objects."""
    output: str | None


def query_of(
    cache: Path,
    lights: Sequence[str],
    method: str,
    volume: str,
    object_names: Sequence[str],
    output: str | None,
) -> Query:
    """Return the options as a query.

    Raises
    ------
    typer.BadParameter
        A usage error: no light or several, an arc, an unknown method, volume or suffix.
    InputError
        The light is not one. The sun is looked at later: it may need the cache's CRS.
    """
    if not lights:
        raise typer.BadParameter(f"name the light with --light SPEC: {FORMS}")
    if len(lights) > 1:
        raise typer.BadParameter(f"a silhouette is of one light; {len(lights)} --light were given")
    if output is not None and not LINES.has_suffix(output):
        raise typer.BadParameter(f"{output}: lines are written as .ply, .obj or .npz; name it so")
    known_method = _one_of("--method", method, METHODS)
    known_volume = _one_of("--volume", volume, VOLUMES)
    if is_arc(lights[0]):
        raise typer.BadParameter(
            f'a silhouette is of one light, and "{lights[0]}" is an arc of the sun; one moment of '
            "it is written sun:LAT,LON,2026-03-20T12:00[Europe/Vienna]"
        )
    if not is_sun(lights[0]):
        parse_light(lights[0])
    return Query(cache, lights[0], known_method, known_volume, tuple(object_names), output)


def _one_of(option: str, given: str, known: tuple[_Name, ...]) -> _Name:
    for name in known:
        if name == given:
            return name
    raise typer.BadParameter(f'{option} "{given}" is none of {", ".join(known)}')


def answer(query: Query) -> dict[str, Any]:
    """Return the summary of a silhouette, its lines written where they were asked for.

    Raises
    ------
    InputError, CacheError, EnvironmentProblem
        An unknown object, a light out of reach, a bad cache, an output that
        cannot be written (told before the tables are loaded).
    """
    if query.output is not None:
        LINES.checked_path(query.output, [query.cache])
    started = time.perf_counter()
    warm.load_without_compiler()
    with open_cache(query.cache) as cache:
        if query.output is not None:
            LINES.checked_path(query.output, [s.path for s in cache.sources])
        named = parse_light(query.light_spec, cache.site)
        light = named.in_cache_frame(cache.grid)
        objects = objects_named(cache, query.object_names) if query.object_names else None
        # Tables are read, what is derived from them is made, and compiled code is loaded
        # at the first query: the second one takes the time of a silhouette.
        silhouette(cache, light, query.method, volume=query.volume, objects=objects)
        loaded = time.perf_counter()
        found = silhouette(cache, light, query.method, volume=query.volume, objects=objects)
        asked = time.perf_counter()
        summary = _summary(query, named, cache, found)
        if query.output is not None:
            lines = silhouette_lines(found, cache)
            write_lines(lines, query.output)
            summary["output"] = query.output
            summary["output_vertices"] = len(lines.positions)
    summary["load_seconds"] = round(loaded - started, 4)
    summary["query_ms"] = round((asked - loaded) * 1e3, 4)
    return summary


def objects_named(cache: Cache, names: tuple[str, ...]) -> I64:
    """Return the objects, ascending, that bear one of `names`, and the parts of such objects.

    An object that has no surface of its own is known by its parts.

    Raises
    ------
    InputError
        No object is called so: names what comes close.
    """
    parents = cache.labels.object_parents
    parts: dict[str, list[int]] = {}
    for i, parent in enumerate(parents):
        if parent:
            parts.setdefault(parent, []).append(i)
    known = list(dict.fromkeys([*cache.object_names, *parts]))
    for name in names:
        if name in known:
            continue
        # Names that differ only in case come first, which difflib does not see to.
        folded = [k for k in known if k.casefold() == name.casefold()]
        close = list(dict.fromkeys(folded + get_close_matches(name, known, n=3)))[:3]
        hint = f"close to it: {', '.join(map(repr, close))}" if close else "none comes close"
        if name.casefold() in {each.casefold() for each in cache.labels.object_types}:
            hint = "it is a type, and --objects asks for names here, for types in svprep build"
        raise InputError(
            f'no object "{name}" among the {cache.n_objects:,} of {cache.path}; {hint}. '
            "All names: svprep build SOURCE --report FILE.csv, or "
            "svprep.open_cache(CACHE).object_names in Python"
        )
    wanted, waiting = set(names), list(dict.fromkeys(names))
    while waiting:
        found = [cache.object_names[i] for i in parts.get(waiting.pop(), ())]
        waiting += [name for name in dict.fromkeys(found) if name and name not in wanted]
        wanted.update(found)
    is_part = [parent != "" and parent in wanted for parent in parents]
    is_named = [name in wanted for name in cache.object_names]
    return np.flatnonzero(np.array(is_part, bool) | np.array(is_named, bool))


def _summary(query: Query, light: Light, cache: Cache, found: Silhouette) -> dict[str, Any]:
    at = found.light[:3].astype(np.float64)
    size = np.abs(found.multiplicity.astype(np.int64))
    summary: dict[str, Any] = {
        "cache": str(query.cache),
        "light": {
            "spec": light.spec,
            "words": light.words,
            "cache_frame": found.light.tolist(),
            "distance_m": round(float(np.linalg.norm(at)), 3) if light.w else None,
        },
        "method": found.method,
        "volume": query.volume,
        "objects": len(found.objects),
        "objects_in_cache": cache.n_objects,
        "edges": len(found),
        "double_edges": int(np.count_nonzero(size == 2)),
        "sides": int(size.sum()),
        "edge_records": cache.n_edges,
        "edges_visited": found.work.n_edges,
        "nodes_tested": found.work.n_nodes,
        "remarks": warm.remarks(),
    }
    if query.object_names:
        begin, end = found.object_start[:-1].tolist(), found.object_start[1:].tolist()
        summary["per_object"] = [
            {
                "object_index": int(i),
                "object": cache.object_names[i],
                "edges": end[k] - begin[k],
                "double_edges": int(np.count_nonzero(size[begin[k] : end[k]] == 2)),
                "sides": int(size[begin[k] : end[k]].sum()),
            }
            for k, i in enumerate(found.objects.tolist())
        ]
    return summary


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """Return a summary as the lines that people read."""
    light = summary["light"]
    where = light["words"]
    if light["distance_m"] is not None:
        where += f", {light['distance_m']:,.1f} m from the middle of the model"
    few = summary["objects"] < summary["objects_in_cache"]
    of = f" of {summary['objects_in_cache']:,}" if few else ""
    lines = [
        f"light    {where}",
        f"method   {summary['method']}, volume {summary['volume']}, {summary['objects']:,}{of} "
        "objects",
        f"found    {summary['edges']:,} silhouette edges, {summary['double_edges']:,} of them "
        f"with |m| = 2; they need {summary['sides']:,} sides",
        f"work     {summary['edges_visited']:,} of {summary['edge_records']:,} edge records "
        f"visited, {summary['nodes_tested']:,} nodes tested",
        f"time     {summary['query_ms']:,.2f} ms for a query, after "
        f"{summary['load_seconds']:.2f} seconds of loading and a first one",
    ]
    if "output" in summary:
        lines.append(
            f"lines    {summary['output']} ({summary['edges']:,} lines, "
            f"{summary['output_vertices']:,} vertices)"
        )
    return lines + [f"remark   {remark}" for remark in summary["remarks"]]
