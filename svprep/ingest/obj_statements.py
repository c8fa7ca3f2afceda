"""What an OBJ file says besides shapes: the names of objects, and what was left out.

The rule by which names make objects stands in `svprep.ingest.obj`.
"""

from __future__ import annotations

import re

import numpy as np

from svprep.errors import first_few
from svprep.ingest.parsed import count_of, shown
from svprep.model import I64, U8

_ELEMENTS = {
    "p": ("point element", "point elements"),
    "l": ("line element", "line elements"),
    "curv": ("curve", "curves"),
    "curv2": ("2D curve", "2D curves"),
    "surf": ("free-form surface", "free-form surfaces"),
}
# Appearance and grouping, and what belongs to a free-form element.
_SILENT = frozenset(
    [
        "usemtl",
        "mtllib",
        "usemap",
        "maplib",
        "mg",
        "bevel",
        "c_interp",
        "d_interp",
        "lod",
        "shadow_obj",
        "trace_obj",
        "ctech",
        "stech",
        "cstype",
        "deg",
        "bmat",
        "step",
        "parm",
        "trim",
        "hole",
        "scrv",
        "sp",
        "end",
        "con",
    ]
)
_CONTINUATION = re.compile(rb"\\[ \t\v\f]*(?:\r\n|\n|\r)")


def decode(text: bytes) -> str:
    """Return UTF-8, or Latin-1 where it is none."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")


def _name(data: U8, begin: int, end: int) -> bytes:
    """Return the bytes of an ``o`` or ``g`` statement with single blanks."""
    text = _CONTINUATION.sub(b" ", data[begin:end].tobytes())
    return b" ".join(text.split()) if decode(text).split() else b"default"


def _readable(name: bytes) -> str:
    return " ".join(decode(name).split())


def objects_of(
    data: U8, statements: I64, n_polygons: int, stem: str
) -> tuple[tuple[str, ...], I64, list[str]]:
    """Return the objects' names, the object of each polygon, and what is to be noted.

    Names that differ in a byte are different, though they may read the same: "café" in
    UTF-8 and in Latin-1.
    """
    stem_name = stem.encode(errors="replace")
    is_name = np.isin(statements[:, 0], [ord("o"), ord("g")])
    rows = [
        (chr(key), _name(data, begin, end), polygon)
        for key, begin, end, polygon, _ in statements[is_name].tolist()
    ]
    o_names = {name for key, name, _ in rows if key == "o"}
    groups = {name for key, name, _ in rows if key == "g" and name != b"default"}
    if o_names == {b"default"}:
        o_names = set()
    if len(o_names) == 1 and len(groups) >= 2:
        before, used = stem_name, _groups_of_one_object(rows, stem_name)
    else:
        wanted = "o" if o_names else "g"
        used = [((name,), name, polygon) for key, name, polygon in rows if key == wanted]
        before = b"default" if used and wanted == "g" else stem_name
    starts = [0, *(polygon for _, _, polygon in used), n_polygons]
    names: dict[bytes, int] = {}
    filled: set[bytes] = set()
    objects = []
    for i, parts in enumerate([(before,), *(parts for parts, _, _ in used)]):
        is_empty = starts[i] == starts[i + 1]
        objects.append(-1 if is_empty else names.setdefault(b"/".join(parts), len(names)))
        filled.update(() if is_empty else parts)
    empty = {said: b"/".join(parts) for parts, said, _ in used if said not in filled}
    notes = []
    if empty:
        listed = first_few([f'"{shown(_readable(name))}"' for name in empty.values()])
        notes.append(f"{count_of(len(empty), 'object')} without faces left out: {listed}")
    return tuple(map(_readable, names)), np.repeat(objects, np.diff(starts)), notes


def _groups_of_one_object(
    rows: list[tuple[str, bytes, int]], stem: bytes
) -> list[tuple[tuple[bytes, ...], bytes, int]]:
    """Return at each statement: object and group (none if it is ``default``), its name, polygon."""
    used: list[tuple[tuple[bytes, ...], bytes, int]] = []
    current, group = stem, b"default"
    for key, name, polygon in rows:
        current, group = (name, group) if key == "o" else (current, name)
        parts = (current,) if group == b"default" else (current, group)
        used.append((parts, parts[0] if name == b"default" else name, polygon))
    return used


def keyword_notes(data: U8, statements: I64) -> list[str]:
    """Say which elements are no surfaces, and which keywords OBJ does not have."""
    _, first, counts = np.unique(statements[:, 0], return_index=True, return_counts=True)
    notes, unknown = [], []
    for row, n in sorted(zip(first.tolist(), counts.tolist(), strict=True)):
        key, begin, end, _, line = statements[row].tolist()
        keyword = decode(data[begin:end].tobytes())
        if key in (ord("o"), ord("g")) or keyword in _SILENT:
            continue
        if keyword in _ELEMENTS:
            if keyword == "surf":
                reason = "is not read and was" if n == 1 else "are not read and were"
            else:
                reason = "is not a surface and was" if n == 1 else "are not surfaces and were"
            notes.append(f"{count_of(n, *_ELEMENTS[keyword])} {reason} left out")
        else:
            short = shown(keyword if len(keyword) <= 40 else keyword[:37] + "...")
            unknown.append((n, f'"{short}" (line {line})'))
    if unknown:
        total = sum(n for n, _ in unknown)
        listed = first_few([where for _, where in unknown])
        notes.append(
            f"{count_of(total, 'statement')} with a keyword that OBJ does not have left out: "
            f"{listed}"
        )
    return notes
