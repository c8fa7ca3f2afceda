"""The models that are asked about: made or found, built once, and kept."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

from svprep.cache.reader import open_cache
from svprep.errors import CacheError, SvprepError

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared" / "data"
"""Real models beside the checkout, where they are present."""
SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb")
LIKELY = 8
"""The largest is looked for among this many files of the most bytes."""

DEFAULT = ("small_city", "ogre", "largest", "city:17420", "smooth:1330668")
QUICK = ("small_city", "smooth:50000")
MAKERS = {"city": ("make_city.py", "--objects"), "smooth": ("smooth_mesh.py", "--triangles")}


class MissingDataset(Exception):
    """A dataset that is not on this machine; the benchmark goes on without it."""


class BuildFailed(Exception):
    """A dataset that could not be made or built."""


@dataclass(frozen=True, slots=True)
class Dataset:
    """A model with its cache built."""

    name: str
    source: str
    """File name of the model."""
    cache: Path
    build: dict[str, Any]
    """What ``svprep build --json`` said."""


def provide(name: str, work: Path) -> Dataset:
    """Return a dataset by name, from `work` if an earlier run left it there.

    ``small_city``, ``ogre``, ``largest`` (of the models beside the checkout),
    ``city:OBJECTS``, ``smooth:TRIANGLES``, or the path of a model.

    Raises
    ------
    MissingDataset
        There is no such file.
    BuildFailed
        It could not be made or built.
    """
    kind, _, size = name.partition(":")
    if kind in MAKERS and not size.isdigit():
        raise MissingDataset(f"{name}: say how large, such as {kind}:5000")
    label = _label(name)
    cache, summary = work / f"{label}.svp.h5", work / f"{label}.build.json"
    if not _is_usable(cache, summary):
        if kind in MAKERS:
            source = work / f"{label}.obj"
            script, option = MAKERS[kind]
            _run([str(ROOT / "scripts" / script), option, size, "-o", str(source)])
        else:
            source = _found(name)
        built = _run(["-m", "svprep", "build", str(source), "-o", str(cache), "--json"])
        kept = {"source": source.name, "build": json.loads(built)}
        summary.write_text(json.dumps(kept), encoding="utf-8")
        if kind in MAKERS:
            source.unlink()  # a hundred megabytes; the cache holds all that is asked for
    kept = json.loads(summary.read_text(encoding="utf-8"))
    return Dataset(label, kept["source"], cache, kept["build"])


def _label(name: str) -> str:
    """Return the name that a dataset's files and its section of the report get."""
    kind, _, size = name.partition(":")
    if kind in MAKERS:
        return f"{kind}_{int(size)}"
    if name in DEFAULT:
        return name
    # Two models of one file name are two datasets.
    path = Path(name).resolve()
    return f"{path.name.partition('.')[0]}_{crc32(str(path).encode()):08x}"


def environment() -> dict[str, str]:
    """Return the environment in which a new process finds this svprep."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return {**os.environ, "PYTHONPATH": path}


def _found(name: str) -> Path:
    """Return the path of a model that is not made."""
    if name == "small_city":
        return ROOT / "data" / "small_city.obj.gz"
    if name == "largest":
        return _largest()
    path = SHARED / "broken" / "ogre.obj.gz" if name == "ogre" else Path(name)
    if not path.is_file():
        raise MissingDataset(f"{name}: there is no {path.name} here")
    return path


def _largest() -> Path:
    """Return the model beside the checkout with the most triangles."""
    from svprep.ingest import read

    weights = {}
    for path in SHARED.rglob("*"):
        if path.name.removesuffix(".gz").endswith(SUFFIXES):
            weights[path] = path.stat().st_size * (4 if path.suffix == ".gz" else 1)
    triangles = {}
    for path in sorted(weights, key=lambda p: (-weights[p], p.as_posix()))[:LIKELY]:
        try:
            triangles[path] = len(read([path]).faces)
        except SvprepError:
            continue  # some are there because they cannot be read
    if not triangles:
        raise MissingDataset("largest: there are no models beside the checkout")
    return max(triangles, key=lambda p: triangles[p])


def _is_usable(cache: Path, summary: Path) -> bool:
    """Whether an earlier run's cache is there, and of the schema that is read now."""
    if not (cache.exists() and summary.exists()):
        return False
    try:
        open_cache(cache).close()
    except CacheError:
        return False
    return True


def _run(arguments: list[str]) -> str:
    """Run Python to its end; return its standard output, or raise its last words."""
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, env=environment()
    )
    if done.returncode:
        words = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        raise BuildFailed(f"{' '.join(arguments)}: {words[-1]}")
    return done.stdout
