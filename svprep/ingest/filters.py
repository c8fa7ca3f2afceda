"""What of the objects and surfaces that were read is wanted: types, terrain, openings.

Readers hand over everything of the level of detail that was chosen; what options leave out
is taken away here, the same for every format, and counted. Source faces keep the numbers
that they have in their file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from svprep.errors import InputError, first_few
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile, count_of, shown
from svprep.model import BOOL, FaceFindings

FAMILIES: Final = {
    "building": ("building", "intbuilding", "room"),
    "bridge": ("bridge", "intbridge"),
    "tunnel": ("tunnel", "inttunnel", "hollowspace"),
}
"""Types that take others along: those that begin with one of these."""
OPENINGS: Final = frozenset({"window", "door", "windowsurface", "doorsurface"})
"""Names of surfaces that ``--no-openings`` leaves out: CityGML 1 and 2, CityJSON; CityGML 3."""
_NOT_STATED: Final = "not stated"
_HOLES: Final = ": walls keep holes where these stood, and light falls through"


def is_of_type(stated: str, wanted: str) -> bool:
    """Whether an object's type is `wanted`, or one of its family; case does not matter."""
    stated, wanted = stated.casefold().lstrip("+"), wanted.casefold().lstrip("+")
    return stated == wanted or stated.startswith(FAMILIES.get(wanted, ("\0",)))


def is_terrain(stated: str) -> bool:
    """Whether an object's type is terrain: TINRelief, ReliefFeature, RasterRelief, Terrain."""
    stated = stated.casefold().lstrip("+")
    return stated.startswith("terrain") or stated.endswith(("relief", "relieffeature"))


def filtered(
    parsed: Sequence[ParsedFile],
    paths: Sequence[Path],
    options: ReadOptions,
    keep: Callable[[ParsedFile], ParsedFile] = lambda parsed: parsed,
) -> list[ParsedFile]:
    """Return the files without what `options` leave out, which their notes count.

    A file of which nothing is left stays, without objects: it was read. `keep` puts away what
    is left of each file before the next one's tables are made, in memory.

    Raises
    ------
    InputError
        A type that no object has, or of files that state no types; nothing is left at all.
    """
    if not options.objects and options.has_terrain and options.has_openings:
        return list(parsed)
    if options.objects:
        _check_types(parsed, paths, options.objects)
    has_terrain = any(is_terrain(t) for t in {t for p in parsed for t in _types_of(p)})
    left = [keep(_filtered_file(p, options, has_terrain)) for p in parsed]
    if not any(len(p.faces) for p in left) and any(len(p.faces) for p in parsed):
        n = sum(len(p.object_names) for p in parsed)
        raise InputError(
            f"{paths[0]}{' and the other inputs' if len(paths) > 1 else ''}: nothing is left of "
            f"{count_of(n, 'object')} ({_types_listed(parsed)}) after {_named(options)}; "
            "ask for less to be left out."
        )
    return left


def _named(options: ReadOptions) -> str:
    """Return the options as they are written."""
    names = [f"--objects {name}" for name in options.objects]
    names += [] if options.has_terrain else ["--no-terrain"]
    names += [] if options.has_openings else ["--no-openings"]
    return " ".join(names)


def _types_of(parsed: ParsedFile) -> tuple[str, ...]:
    return parsed.object_types or ("",) * len(parsed.object_names)


def _types_listed(parsed: Sequence[ParsedFile]) -> str:
    """Return ``"Building 12, TINRelief 1"``, the most frequent first."""
    return _counts_listed(Counter(t for p in parsed for t in _types_of(p)))


def _counts_listed(counts: Counter[str]) -> str:
    ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return first_few([f"{shown(name) or _NOT_STATED} {n}" for name, n in ordered], limit=12)


def _check_types(
    parsed: Sequence[ParsedFile], paths: Sequence[Path], wanted: tuple[str, ...]
) -> None:
    """Raise unless every file states types, and every one that is wanted occurs."""
    for p, path in zip(parsed, paths, strict=True):
        if len(p.object_names) and not any(p.object_types):
            raise InputError(
                f"{path}: this file states no types of objects, so --objects {wanted[0]} cannot "
                "choose among them; leave --objects out, or build this file apart."
            )
    stated = {t for p in parsed for t in _types_of(p)}
    for name in wanted:
        if not any(is_of_type(each, name) for each in stated):
            raise InputError(
                f"{paths[0]}{' and the other inputs' if len(paths) > 1 else ''}: no object is of "
                f'the type "{name}" (--objects); the types are {_types_listed(parsed)}.'
            )


def _filtered_file(parsed: ParsedFile, options: ReadOptions, has_terrain: bool) -> ParsedFile:
    """Return a file without what is not wanted; `has_terrain`: some file has."""
    types = _types_of(parsed)
    is_kept = np.ones(len(types), bool)
    notes = []
    if options.objects:
        wanted = {t: any(is_of_type(t, name) for name in options.objects) for t in set(types)}
        is_kept = np.array([wanted[t] for t in types], bool)
        option = " ".join(f"--objects {name}" for name in options.objects)
        notes += _count_note("object", types, ~is_kept, option)
    if not options.has_terrain:
        terrain = {t: is_terrain(t) for t in set(types)}
        is_out = is_kept & np.array([terrain[t] for t in types], bool)
        is_kept &= ~is_out
        notes += _count_note("object", types, is_out, "--no-terrain")
        if not any(types):
            notes.append("no types of objects are stated, so --no-terrain left nothing out")
        elif not has_terrain:
            stated = first_few(sorted(shown(t) for t in set(types) if t), limit=12)
            notes.append(
                "the type of no object is terrain, so --no-terrain left nothing out (types: "
                f"{stated})"
            )
    is_face = np.repeat(is_kept, np.diff(parsed.object_face_start))
    is_finding = is_kept[parsed.face_findings.object_index]
    if not options.has_openings and len(parsed.surface_of_polygon):
        is_name = np.array([name.casefold() in OPENINGS for name in parsed.surface_names])
        is_opening = is_name[parsed.surface_of_polygon]
        is_out = np.zeros(len(is_opening), bool)
        is_out[parsed.source_face[is_face]] = True
        is_out &= is_opening
        names = np.array(parsed.surface_names, object)[parsed.surface_of_polygon]
        notes += _count_note("polygon", names, is_out, "--no-openings", _HOLES)
        is_face &= ~is_opening[parsed.source_face]
        is_finding &= ~is_opening[parsed.face_findings.source_face]
    elif not options.has_openings:
        notes.append("no surfaces are named, so --no-openings left nothing out")
    left = _taken(parsed, is_kept, is_face, is_finding)
    return replace(left, notes=(*parsed.notes, *notes))


def _count_note(
    what: str, names: Sequence[str] | np.ndarray, is_out: BOOL, option: str, more: str = ""
) -> list[str]:
    """Return the note that counts what was left out, by its names, if anything was."""
    counts = Counter(names[i] for i in np.flatnonzero(is_out).tolist())
    if not counts:
        return []
    n = count_of(counts.total(), what)
    return [f"{n} left out by {option} ({_counts_listed(counts)}){more}"]


def _taken(parsed: ParsedFile, is_kept: BOOL, is_face: BOOL, is_finding: BOOL) -> ParsedFile:
    """Return what is kept; an object that loses all of its faces goes, too."""
    start = parsed.object_face_start
    before = np.diff(start)
    after = np.diff(np.concatenate([[0], np.cumsum(is_face)])[start])
    is_kept = is_kept & ((after > 0) | (before == 0))
    faces = parsed.faces[is_face]
    is_used = np.zeros(len(parsed.positions), bool)
    is_used[faces.ravel()] = True
    new_from_old = np.cumsum(is_used, dtype=np.uint32) - np.uint32(1)
    found = parsed.face_findings
    is_finding = is_finding & is_kept[found.object_index]
    object_from_old = np.cumsum(is_kept, dtype=np.uint32) - np.uint32(1)
    kept = np.flatnonzero(is_kept).tolist()
    return replace(
        parsed,
        positions=parsed.positions[is_used],
        faces=new_from_old[faces],
        object_face_start=np.concatenate([[0], np.cumsum(after[is_kept])]).astype(np.int64),
        source_face=parsed.source_face[is_face],
        object_names=tuple(parsed.object_names[i] for i in kept),
        face_findings=FaceFindings(
            found.code[is_finding],
            object_from_old[found.object_index[is_finding]],
            found.source_face[is_finding],
        ),
        object_types=_of_kept(parsed.object_types, kept),
        object_parents=_of_kept(parsed.object_parents, kept),
    )


def _of_kept(texts: tuple[str, ...], kept: list[int]) -> tuple[str, ...]:
    return tuple(texts[i] for i in kept) if texts else ()
