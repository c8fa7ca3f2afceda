"""What the user names, files, folders and patterns, as the list of inputs that are read.

    given                                 read
    ----------------------------------    ----------------------------------------------------
    a file                                that file
    a folder with a tileset.json          one input, the 3D Tiles tileset
    another folder                        every model in it and below, by path; a folder below
                                          with a tileset.json is one input of these
    a pattern (``*``, ``?``, ``[]``,      what it matches, by path; a folder among it as above
    ``**`` for folders), no file

What a folder or a pattern holds besides models is left out and counted; so are hidden files
and folders, and linked folders, which might lead in a circle. A model there has
one of the suffixes that are read; one of ``.json``, ``.jsonl``, ``.gml`` and ``.xml`` must
look like a city too, because those suffixes are used for much else.
"""

from __future__ import annotations

import glob
import gzip
import json
import os
import zlib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Final

from svprep.errors import InputError, first_few
from svprep.ingest.parsed import count_of

TILESET: Final = "tileset.json"
MESH_SUFFIXES: Final = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf", ".b3dm")
CITY_SUFFIXES: Final = (".json", ".jsonl", ".gml", ".xml")
MODEL_SUFFIXES: Final = (*MESH_SUFFIXES, *CITY_SUFFIXES)
"""What is read, each also with ``.gz`` behind it."""

_TILESET_KEYS: Final = ("root", "geometricError")
_SNIFFED_BYTES: Final = 64 << 20
_HEAD_BYTES: Final = 64 << 10
_WORDS: Final = {
    ".json": (b'"CityObjects"', b'"CityJSON'),
    ".jsonl": (b'"CityJSON',),
    ".gml": (b"citygml",),
    ".xml": (b"citygml",),
}
"""One of these stands in every file of the format; in XML, among the namespaces at its head."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """What is read."""

    paths: tuple[str, ...]
    """Files, and folders that hold a tileset; as the user named them, or below that."""
    notes: tuple[str, ...]
    """What of folders and patterns was left out: the same for a folder of any name."""


def expanded(given: Sequence[str | PathLike[str]]) -> Inputs:
    """Return the inputs that `given` names. What is expanded already stays as it is.

    Raises
    ------
    InputError
        A folder without a model, a pattern without a match.
    """
    paths: list[str] = []
    others: Counter[str] = Counter()
    for path in given:
        each = fspath(path)
        if os.path.isdir(each):
            found, left_out = _in_folder(each)
            where = f"{each}: no model in this folder and those below it"
        elif glob.has_magic(each) and not os.path.lexists(each):
            found, left_out = _matched(each)
            where = f"{each}: nothing that this pattern matches is a model"
        else:
            paths.append(each)
            continue
        if not found:
            seen = f" ({_listed(left_out)})" if left_out else ""
            known = ", ".join(MODEL_SUFFIXES)
            raise InputError(f"{where}{seen}. Models end in {known}, each also with .gz.")
        others += left_out
        paths += found
    if not others:
        return Inputs(tuple(paths), ())
    n = count_of(others.total(), "file is no model and was", "files are no models and were")
    return Inputs(tuple(paths), (f"{n} left out ({_listed(others)})",))


def is_tileset_folder(path: str | PathLike[str]) -> bool:
    """Whether a folder is one 3D Tiles input."""
    return os.path.isfile(os.path.join(path, TILESET))


def suffix_of_model(path: str | PathLike[str]) -> str:
    """Return the suffix that names the format, without a ``.gz`` behind it."""
    return Path(Path(path).name.lower().removesuffix(".gz")).suffix


def stem_of(path: str | PathLike[str]) -> str:
    """Return a name without the suffixes of models: ``"delft"`` of ``"delft.city.json.gz"``."""
    name = Path(path).name
    if os.path.isdir(path):
        return name or Path(path).resolve().name or "city"
    if name.lower().endswith(".gz"):
        name = name[: -len(".gz")]
    stem = Path(name).stem
    is_city = suffix_of_model(path) in (".json", ".jsonl") and stem.lower().endswith(".city")
    return (stem[: -len(".city")] if is_city else stem) or name


def is_tileset(path: Path) -> bool:
    """Whether a JSON file is a 3D Tiles tileset; what cannot be read is none."""
    if path.name.lower().removesuffix(".gz") == TILESET:
        return True
    if not path.is_file():
        return False
    try:
        head = _text(path, _HEAD_BYTES)
        if b'"CityJSON' in head:
            return False
        text = _text(path, _SNIFFED_BYTES)
        if b'"asset"' not in text:
            return False
        root = json.loads(text)
    except (OSError, EOFError, zlib.error, ValueError, RecursionError):
        return False
    return isinstance(root, dict) and "asset" in root and not root.keys().isdisjoint(_TILESET_KEYS)


def _in_folder(folder: str) -> tuple[list[str], Counter[str]]:
    """Return the inputs in a folder and below, by path, and the suffixes of other files."""
    if is_tileset_folder(folder):
        return [folder], Counter()
    found: list[str] = []
    left_out: Counter[str] = Counter()
    waiting = [folder]
    while waiting:
        try:
            with os.scandir(waiting.pop()) as listed:
                entries = list(listed)
        except OSError as error:
            raise InputError(
                f"{error.filename}: this folder cannot be read: {error.strerror}."
            ) from None
        files = []
        for entry in entries:
            if entry.name.startswith("."):
                left_out["hidden"] += 1
            elif not entry.is_dir():
                files.append(entry.path)
            elif is_tileset_folder(entry.path):
                found.append(entry.path)
            elif entry.is_symlink():
                left_out["linked folders"] += 1
            else:
                waiting.append(entry.path)
        _sort_out(files, found, left_out)
    return sorted(found, key=_by_path), left_out


def _matched(pattern: str) -> tuple[list[str], Counter[str]]:
    """Return the inputs that a pattern matches, by path, and the suffixes of other files."""
    matches = sorted(set(glob.glob(pattern, recursive=True)), key=_by_path)
    if not matches:
        raise InputError(f"{pattern}: no file or folder matches this pattern.")
    found: list[str] = []
    left_out: Counter[str] = Counter()
    folders = [m for m in matches if os.path.isdir(m)]
    _sort_out((m for m in matches if not os.path.isdir(m)), found, left_out)
    if "**" not in pattern:  # which matches each file on its own, below folders too
        for folder in folders:
            more, others = _in_folder(folder)
            found += more
            left_out += others
    return sorted(found, key=_by_path), left_out


def _by_path(path: str) -> tuple[str, ...]:
    return Path(path).parts


def _sort_out(paths: Iterable[str], found: list[str], left_out: Counter[str]) -> None:
    """Add files to `found` if they look like models, else count their suffixes."""
    for path in paths:
        suffix = suffix_of_model(path)
        if not os.path.isfile(path):  # a pipe, a device, a link to nowhere
            left_out["not a file"] += 1
        elif suffix in MESH_SUFFIXES or (
            suffix in CITY_SUFFIXES and _looks_like_city(path, suffix)
        ):
            found.append(path)
        else:
            left_out[suffix or "no suffix"] += 1


def _looks_like_city(path: str, suffix: str) -> bool:
    """Whether a file holds the words of its format; one that cannot be read is told later."""
    is_xml = suffix in (".gml", ".xml")
    n_bytes = _HEAD_BYTES if is_xml else _SNIFFED_BYTES
    try:
        text = _text(Path(path), n_bytes)
    except (OSError, EOFError, zlib.error):
        return True
    if is_xml and b"\0" in text[:4]:  # UTF-16
        text = text.replace(b"\0", b"")
    is_long = len(text) == n_bytes and not is_xml
    return is_long or any(word in text for word in _WORDS[suffix]) or is_tileset(Path(path))


def _text(path: Path, n_bytes: int) -> bytes:
    """Return the first bytes of a file, unpacked."""
    is_packed = path.name.lower().endswith(".gz")
    with gzip.open(path) if is_packed else path.open("rb") as file:
        return file.read(n_bytes)


def _listed(left_out: Counter[str]) -> str:
    """Return ``".md 2, .txt 1"``, the most frequent first."""
    ordered = sorted(left_out.items(), key=lambda item: (-item[1], item[0]))
    return first_few([f"{suffix} {n}" for suffix, n in ordered], limit=6)
