"""What a table of sun hours must say of itself, once, for CSV, PLY and JSON alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from svprep import __version__
from svprep.hours.buried import Burial
from svprep.hours.scene import component_of_faces
from svprep.hours.semantics import STATED_RULES, doubted_walls
from svprep.hours.surfaces import RULES, SIDES
from svprep.path_names import told_apart
from svprep.report import extent_m, total_counts
from svprep.sun import sun_angles

if TYPE_CHECKING:
    from svprep.cache.reader import Cache
    from svprep.hours.result import SunHours
    from svprep.model import BOOL

WHAT: Final = "svprep sun hours"
"""How every file of ours begins, of this version or of one before."""
TITLE: Final = f"{WHAT} 2"
"""The layout of a CSV or PLY file, and its version."""
_MOST_SOURCES: Final = 20


def facts_of(hours: SunHours, cache: Cache) -> dict[str, Any]:
    """Return what explains the numbers of `hours`, in a fixed order: JSON values only.

    Nothing in it depends on the clock, on the number of threads or on where the cache lies.
    """
    arc = hours.arc
    ends = np.array([arc.begin.timestamp(), arc.end.timestamp()])
    _, altitude_deg = sun_angles(ends, arc.latitude_deg, arc.longitude_deg)
    findings = total_counts(cache.repair)
    burial = hours.points.burial
    convergence = arc.convergence_deg
    return {
        "svprep": __version__,
        "cache": cache.path.name,
        "cache content digest": hours.digest,
        "sources": _sources(cache),
        "model extent x y z metres": extent_m(cache.mesh.positions),
        "coordinate reference system": cache.crs or "not stated",
        "light": arc.spec,
        "latitude": arc.latitude_deg,
        "longitude": arc.longitude_deg,
        "zone": arc.zone,
        "date": arc.date.isoformat(),
        "begin": arc.begin.isoformat(),
        "end": arc.end.isoformat(),
        "sun's altitude at begin and end degrees": [round(x, 2) for x in altitude_deg.tolist()],
        "step minutes": arc.step_minutes,
        "steps": arc.n_steps,
        "night steps skipped": arc.n_night,
        "meridian convergence degrees": (
            "grid north taken as true north (no CRS)" if convergence is None else convergence
        ),
        "sample spacing metres": hours.spacing_m,
        "ray offset metres": hours.offset_m,
        "grid step metres": cache.grid.step_m,
        "samples": hours.n_samples,
        "samples buried in solids": _count(burial == Burial.IN_SOLID),
        "samples buried under the ground": _count(burial == Burial.UNDER_GROUND),
        "samples on surfaces that are not solid": _count(~hours.is_on_solid),
        "repair findings": findings,
        "side that counts": SIDES,
        "kinds as the files name surfaces": STATED_RULES,
        "kinds by geometry": RULES,
        "samples whose kind the files state": _count(hours.is_stated),
        "samples on level faces of files that call every face a wall, by geometry": _count(
            _doubted(hours, cache)
        ),
        "sunlit": (
            "the sun is strictly in front of the face and the segment to its centre meets no face; "
            "each lit step counts step minutes"
        ),
        "atmosphere": "refraction is included; weather and terrain beyond the model are not",
    }


def _doubted(hours: SunHours, cache: Cache) -> BOOL:
    """Return ``(n_samples,)``: whether each lies on a face that is no wall though named one."""
    source = cache.object_source[component_of_faces(cache.mesh.object_face_start)]
    is_doubted = doubted_walls(cache.labels, source, hours.face_normal[:, 2])
    return np.asarray(is_doubted[hours.face])


def _sources(cache: Cache) -> list[str]:
    """Return the files by name and digest; of very many the first, and how many there are."""
    names = told_apart([source.path for source in cache.sources])[:_MOST_SOURCES]
    named = [f"{name} SHA-256 {s.sha256}" for name, s in zip(names, cache.sources, strict=False)]
    n_more = len(cache.sources) - len(named)
    return [*named, f"and {n_more} more, which the cache lists"] if n_more else named


def _count(chosen: BOOL) -> int:
    return int(np.count_nonzero(chosen))


def fact_lines(facts: dict[str, Any]) -> list[str]:
    """Return facts as ``key: value``, one printable line each."""
    lines = []
    for key, value in facts.items():
        if isinstance(value, list):
            value = ", ".join(map(str, value))
        if isinstance(value, dict):
            value = ", ".join(f"{name} {count}" for name, count in value.items()) or "none"
        lines.append(_one_line(f"{key}: {value}"))
    return lines


def _one_line(text: str) -> str:
    """Return `text` with everything escaped that would end a line or is no Unicode."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text
    )
