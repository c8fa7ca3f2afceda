"""What an OBJ file says besides shapes: the names of objects, and what was left out.

The rule by which names make objects stands in `svprep.ingest.obj`.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, field
from itertools import chain, compress
from typing import NamedTuple

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
_UNUSUAL = re.compile(rb"[^ -\[\]-~\n]|  ")
"""In names: what is not visible ASCII or a single blank, and a backslash."""


def decode(text: bytes) -> str:
    """Return UTF-8, or Latin-1 where it is none."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")


class Keyword(NamedTuple):
    """A keyword other than those of shapes and names."""

    n: int
    """How many statements have it."""
    text: bytes
    line: int
    """Of the first one."""


@dataclass(slots=True)
class Statements:
    """What the statements of a file say besides shapes, gathered block by block."""

    names: list[bytes] = field(default_factory=list)
    """Of every ``o`` and ``g`` statement."""
    is_object: list[bool] = field(default_factory=list)
    """Whether it is an ``o`` statement."""
    polygon: list[int] = field(default_factory=list)
    """How many polygons stand before it."""
    keywords: dict[int, Keyword] = field(default_factory=dict)
    """By the parser's hash, in the order of the first statement of each."""

    def add(self, block: Statements, first_polygon: int, first_line: int) -> None:
        """Add those of a block, which counts polygons and lines from its own start."""
        self.names += block.names
        self.is_object += block.is_object
        self.polygon += [first_polygon + polygon for polygon in block.polygon]
        for key, (n, text, line) in block.keywords.items():
            before = self.keywords.get(key)
            self.keywords[key] = (
                Keyword(n, text, first_line + line)
                if before is None
                else before._replace(n=before.n + n)
            )


def statements_of(data: U8, rows: I64) -> Statements:
    """Return what the parser's ``(n, 5)`` rows of statements of a block say."""
    is_object = rows[:, 0] == ord("o")
    is_name = is_object | (rows[:, 0] == ord("g"))
    text = data.data
    begin, end = rows[is_name, 1].tolist(), rows[is_name, 2].tolist()
    names = _names([bytes(text[i:j]) for i, j in zip(begin, end, strict=True)])
    others = rows[~is_name]
    _, first, counts = np.unique(others[:, 0], return_index=True, return_counts=True)
    keywords = {}
    for row, n in sorted(zip(first.tolist(), counts.tolist(), strict=True)):
        key, i, j, _, line = others[row].tolist()
        keywords[key] = Keyword(n, bytes(text[i:j]), line)
    return Statements(names, is_object[is_name].tolist(), rows[is_name, 3].tolist(), keywords)


def _names(texts: list[bytes]) -> list[bytes]:
    """Return `_name` of each text; of usual ones all at once."""
    together = b"\n".join(texts)
    if not texts or _UNUSUAL.search(together):
        return list(map(_name, texts))
    return [text.strip() or b"default" for text in together.split(b"\n")]


def _name(text: bytes) -> bytes:
    """Return the text behind ``o`` or ``g`` with single blanks."""
    if b"\\" in text:
        text = _CONTINUATION.sub(b" ", text)
    name = b" ".join(text.split())
    return name if name[:1].isalnum() or decode(text).split() else b"default"


def _readable(name: bytes) -> str:
    text = decode(name)
    return text if text.isprintable() else " ".join(text.split())


def _all_readable(names: Collection[bytes]) -> tuple[str, ...]:
    """Return `_readable` of each name; of ASCII ones all at once."""
    together = b"\n".join(names)
    if together.isascii():
        texts = together.decode().split("\n")
        if len(texts) == len(names) and "".join(texts).isprintable():
            return tuple(texts)
    return tuple(map(_readable, names))


class Objects(NamedTuple):
    """Which polygons make which object."""

    names: tuple[str, ...]
    run_start: I64
    """``(n_runs + 1,)``: run i is the polygons ``[start[i], start[i + 1])``."""
    object_of_run: I64
    notes: list[str]


def objects_of(said: Statements, n_polygons: int, stem: str) -> Objects:
    """Return the objects' names, the object of each polygon, and what is to be noted.

    Names that differ in a byte are different, though they may read the same: "café" in
    UTF-8 and in Latin-1.
    """
    stem_name = stem.encode(errors="replace")
    of_group, of_object = (
        [name for name, is_object in zip(said.names, said.is_object, strict=True) if is_object is k]
        for k in (False, True)
    )
    has_objects = set(of_object) not in (set(), {b"default"})
    if has_objects and len(set(of_object)) == 1 and len(set(of_group) - {b"default"}) >= 2:
        before, polygon, parts = stem_name, said.polygon, _groups_of_one_object(said, stem_name)
        words = [p[0] if w == b"default" else w for p, w in zip(parts, said.names, strict=True)]
        wholes = list(map(b"/".join, parts))
    else:
        wholes = words = of_object if has_objects else of_group
        at = zip(said.polygon, said.is_object, strict=True)
        polygon = [first for first, is_object in at if is_object is has_objects]
        before, parts = b"default" if words and not has_objects else stem_name, None
    start = np.array([0, *polygon, n_polygons], np.int64)
    is_full = np.diff(start) > 0
    of_run = list(compress([before, *wholes], is_full.tolist()))
    names = {name: number for number, name in enumerate(dict.fromkeys(of_run))}
    objects = np.fromiter(map(names.__getitem__, of_run), np.int64, len(of_run))
    filled = set(of_run)
    if parts is not None:
        filled = set(chain.from_iterable(compress([(before,), *parts], is_full.tolist())))
    empty = {w: whole for w, whole in zip(words, wholes, strict=True) if w not in filled}
    notes = []
    if empty:
        listed = first_few([f'"{shown(_readable(name))}"' for name in empty.values()])
        notes.append(f"{count_of(len(empty), 'object')} without faces left out: {listed}")
    run_start = np.append(start[:-1][is_full], n_polygons)
    return Objects(_all_readable(names), run_start, objects, notes)


def _groups_of_one_object(said: Statements, stem: bytes) -> list[tuple[bytes, ...]]:
    """Return the object and the group (none if it is ``default``) from each statement on."""
    parts: list[tuple[bytes, ...]] = []
    current, group = stem, b"default"
    for is_object, name in zip(said.is_object, said.names, strict=True):
        current, group = (name, group) if is_object else (current, name)
        parts.append((current,) if group == b"default" else (current, group))
    return parts


def keyword_notes(statements: Statements) -> list[str]:
    """Say which elements are no surfaces, and which keywords OBJ does not have."""
    notes, unknown = [], []
    for n, text, line in statements.keywords.values():
        keyword = decode(text)
        if keyword in _SILENT:
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
