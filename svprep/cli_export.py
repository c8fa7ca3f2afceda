"""What ``svprep export`` does with its options: read, write, sum up, say it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from svprep.cache.reader import open_cache
from svprep.cli_messages import crs_name
from svprep.export.city import City, city_of, has_grid_of_a_build
from svprep.export.cityjson import family_of, n_retyped, n_untyped, reference_system
from svprep.export.obj import written_names
from svprep.export.output import checked_export_path, export_format, write_export


def run(cache: Path, output: str) -> dict[str, Any]:
    """Write the mesh of `cache` to `output` and return a summary.

    Raises
    ------
    InputError
        A suffix that is no format; `output` is an input, the cache, or a file that is no
        export.
    CacheError, EnvironmentProblem
        The cache cannot be read, or the file not be written. Nothing is left behind.
    """
    form = export_format(output)
    checked_export_path(output, [cache])
    started = time.perf_counter()
    with open_cache(cache) as opened:
        checked_export_path(output, [source.path for source in opened.sources])
        city = city_of(opened, opened.content_digest)
    target = write_export(city, output)
    return {
        "cache": str(cache),
        "output": output,
        "format": form.name,
        "objects": len(city.names),
        "vertices": len(city.positions),
        "faces": len(city.faces),
        "bytes": target.stat().st_size,
        "crs": city.crs,
        "renamed": _n_renamed(city, form.name),
        "retyped": n_retyped(city) if form.name == "cityjson" else 0,
        "untyped": n_untyped(city) if form.name == "cityjson" else 0,
        "empty_objects": int(np.count_nonzero(~city.has_faces)),
        "unused_vertices": int(np.count_nonzero(~city.is_used)),
        "not_kept": _not_kept(city, form.name, form.not_kept),
        "is_grid_kept": has_grid_of_a_build(city),
        "seconds": round(time.perf_counter() - started, 3),
    }


def _n_renamed(city: City, form: str) -> int:
    """Return how many objects the format cannot call what they are called."""
    if form == "obj":
        names = written_names(city.names)
    elif form == "cityjson":
        names = family_of(city).ids
    else:
        return 0
    return sum(new != old for new, old in zip(names, city.names, strict=True))


def _not_kept(city: City, form: str, lost: tuple[str, ...]) -> list[str]:
    """Return what the cache holds and this file does not."""
    found = list(lost) if city.surface_of_face.any() else []
    if city.crs and form == "cityjson" and not reference_system(city.crs):
        found.append("crs")
    return found


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """Return a summary as the lines that people read."""
    lines = [
        f"export   {summary['output']} ({summary['format']}, {summary['bytes']:,} bytes, "
        f"{summary['seconds']:.2f} s)",
        f"mesh     {summary['objects']:,} objects, {summary['faces']:,} faces, "
        f"{summary['vertices']:,} vertices",
    ]
    if summary["crs"]:
        lines.append(f"crs      {crs_name(summary['crs'])}")
    notes = [
        (summary["renamed"], "objects under another name than their own, which the format forbids"),
        (summary["retyped"], "objects as GenericCityObject, their type as an attribute"),
        (summary["untyped"], "objects without a type written as GenericCityObject"),
        (summary["empty_objects"], "objects without faces: named, but nothing to draw"),
        (summary["unused_vertices"], "vertices that no face uses"),
    ]
    lines += [f"note     {n:,} {text}" for n, text in notes if n]
    if summary["not_kept"]:
        lines.append(f"note     the format has no place for: {', '.join(summary['not_kept'])}")
    if not summary["is_grid_kept"]:
        lines.append(
            "note     a build of this file chooses another grid: its positions are the same in "
            "source coordinates, and shifted in the cache's"
        )
    return lines
