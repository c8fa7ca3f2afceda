"""What is judged: the sample city, models beside the checkout, the conformance files.

Caches are built once into the work folder. A second cache of each holds the clamped segments
of its lights; its name holds digests of the first one's content and of the code that clamps.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from shadow_judging.code_digest import code_digest
from silhouette_benchmark.datasets import (
    ROOT,
    SHARED,
    BuildFailed,
    MissingDataset,
    provide,
)
from svprep.cache.reader import open_cache
from svprep.errors import SvprepError
from svprep.ingest.inputs import MODEL_SUFFIXES
from svprep.pipeline import add_lights, build

CITIES: Final = SHARED / "cities"
CONFORMANCE: Final = ROOT / "data" / "conformance"
SAMPLE: Final = "small_city"


@dataclass(frozen=True, slots=True)
class Source:
    """A model that may be judged."""

    name: str
    """Of its row in the report, the same on every machine."""
    path: str
    """Or the name under which `provide` knows it."""
    is_conformance: bool = False


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A model that is not judged, and why."""

    name: str
    why: str


@dataclass(frozen=True, slots=True)
class Ready:
    """A model with its cache built."""

    source: Source
    cache: Path
    digest: str
    """Of the cache's content, before any light was added."""


def sources(names: Sequence[str]) -> tuple[list[Source], list[LeftOut]]:
    """Return the models that `names` name, all if there are none, and what is left out.

    A name is that of a report's row, its file name without suffixes, the path of a model, or
    ``conformance``.
    """
    cities, absent = _cities()
    conformance = [
        Source(f"conformance/{path.name}", str(path), True)
        for path in sorted(CONFORMANCE.glob("*.obj"))
    ]
    every = [Source(f"{SAMPLE}.obj.gz", SAMPLE), *cities, *conformance]
    if not names:
        return every, absent
    chosen: list[Source] = []
    left_out: list[LeftOut] = []
    for name in names:
        found = conformance if name == "conformance" else [one for one in every if _is(one, name)]
        if not found and Path(name).is_file():
            found = [Source(Path(name).name, name)]
        chosen += found
        if not found:
            left_out.append(LeftOut(name, "absent: there is no such model here"))
    return list(dict.fromkeys(chosen)), left_out


def prepare(source: Source, work: Path) -> Ready:
    """Return a model with its cache, from `work` if it is there.

    Raises
    ------
    MissingDataset, BuildFailed
        It is not there, or cannot be built.
    """
    if not source.is_conformance:
        cache = provide(source.path, work).cache
    else:
        # Dozens of small files: a process for each would take longer than judging them.
        cache = work / f"conformance_{_stem(source.name)}.svp.h5"
        try:
            if not cache.exists():
                build([source.path], cache)
        except SvprepError as error:
            raise BuildFailed(_reason(str(error))) from None
    with open_cache(cache) as opened:
        return Ready(source, cache, opened.content_digest)


def with_lights(ready: Ready, specs: Sequence[str], work: Path) -> Path:
    """Return a copy of a model's cache that holds the segments of lights."""
    stem = ready.cache.name.removesuffix(".svp.h5")
    clamping = code_digest(["svprep.clamp"])
    lit = work / f"{stem}.{ready.digest[:12]}.{clamping[:8]}.lit.svp.h5"
    if not lit.exists():
        copied = lit.with_suffix(".copying")
        shutil.copyfile(ready.cache, copied)
        os.replace(copied, lit)
    add_lights(lit, specs)
    return lit


def _cities() -> tuple[list[Source], list[LeftOut]]:
    """Return the models beside the checkout, or that there are none."""
    if not CITIES.is_dir():
        return [], [LeftOut("shared/data/cities", "absent: no real models beside the checkout")]
    found = [
        Source(path.relative_to(CITIES).as_posix(), str(path))
        for path in sorted(CITIES.rglob("*"))
        if path.name.removesuffix(".gz").endswith(MODEL_SUFFIXES) and path.name != "tileset.json"
    ]
    return found, []


def _is(source: Source, name: str) -> bool:
    return name in (source.name, source.path, _stem(source.name))


def _stem(name: str) -> str:
    return Path(name).name.partition(".")[0]


def _reason(text: str) -> str:
    """Return a reader's complaint without the folders of this machine."""
    return text.replace(f"{CONFORMANCE}{os.sep}", "").splitlines()[0]


__all__ = [
    "BuildFailed",
    "LeftOut",
    "MissingDataset",
    "Ready",
    "Source",
    "prepare",
    "sources",
    "with_lights",
]
