"""Every data file that the dataset tests run on, and what is built from each once.

Files in ``data/`` are always there. Those in ``../shared/data`` are used when
present; a test that misses them skips with their folder's name, so that the
run's summary says what was not covered.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from svprep.errors import InputError
from svprep.ingest import read
from svprep.model import Mesh, Prepared, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep.repair.weld import weld
from svprep.silhouette import index

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "data"
SHARED = ROOT.parent / "shared" / "data"
SHARED_FOLDERS = ("cities", "broken", "readers")
MESHES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
CITIES = (".json", ".jsonl", ".gml", ".xml", ".b3dm")
READ = MESHES + CITIES
"""Suffixes that svprep reads; other files in ``../shared`` are none of its formats."""
TILESET = "tileset.json"
"""A folder with such a file is one dataset; the files in it are not others."""


REFUSED_SHARED = {
    "readers/BoxWithInfinites.glb": "",
    "readers/IndexOutOfRange/AllIndicesOutOfRange.gltf": "",
    "readers/IndexOutOfRange/IndexOutOfRange.gltf": "",
    "readers/issue623.ply": "no faces",
    "readers/index0.obj": "line 9: face refers to vertex 0",
    "readers/index901.obj": "line 11: face refers to vertex 9",
    "readers/number_formats.obj": 'line 11: "3.1+e2"',
}
"""Files of ../shared/data with a known suffix that are refused, and what is said."""


def is_readable(path: Path) -> bool:
    """Whether `path` has a suffix of `READ`, gzipped or not, or is a tileset's folder."""
    return path.is_dir() or path.name.lower().removesuffix(".gz").endswith(READ)


def manifest() -> dict[str, dict]:
    """Return ``data/manifest.toml`` by file name."""
    with (DATA / "manifest.toml").open("rb") as file:
        return {entry["name"]: entry for entry in tomllib.load(file)["file"]}


def shared_files() -> list[Path]:
    """Return the datasets of ``../shared/data``, or none where it is absent."""
    paths = [p for folder in SHARED_FOLDERS for p in sorted((SHARED / folder).rglob("*"))]
    tilesets = [path.parent for path in paths if path.name == TILESET]
    files = [p for p in paths if p.is_file() and not set(p.parents) & set(tilesets)]
    return sorted(files + tilesets)


def buildable_files() -> list[Path]:
    """Return every file that builds, in ``data/`` and in ``../shared/data``."""
    own = [DATA / name for name, entry in manifest().items() if "refused" not in entry["expect"]]
    shared = [p for p in shared_files() if is_readable(p) and label(p) not in REFUSED_SHARED]
    return own + shared


def label(path: Path) -> str:
    """Return a short test id."""
    base = SHARED if path.is_relative_to(SHARED) else DATA
    return path.relative_to(base).as_posix()


@dataclass(frozen=True, slots=True)
class Built:
    """A file as read, as welded, and as prepared."""

    source: SourceMesh
    welded: Mesh
    prepared: Prepared


@lru_cache(maxsize=3)
def build(path: Path) -> Built | str:
    """Build a file in memory; return the message if it is refused."""
    try:
        source = read([path])
        return Built(source, weld(source)[0], prepare(source, BuildConfig()))
    except InputError as error:
        return str(error)


def build_with_trees(path: Path, fewest_pairs: int) -> Prepared:
    """Build a file anew, with silhouette trees for objects of `fewest_pairs` searched edges."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(index, "FEWEST_PAIRS", fewest_pairs)
        return prepare(read([path]), BuildConfig())


def thin(n: int, limit: int, seed: int = 0) -> np.ndarray:
    """Return up to `limit` of the numbers below `n`, seeded, ascending."""
    if n <= limit:
        return np.arange(n)
    return np.sort(np.random.default_rng(seed).choice(n, limit, replace=False))
