"""What a report says of a dataset apart from the timings: sizes, peers, first query."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from silhouette_benchmark.datasets import environment
from silhouette_benchmark.flat_tables import FlatTables
from silhouette_benchmark.memory import Bandwidth
from svprep.cache.reader import Cache
from svprep.model import F32, ComponentFlag, EdgeFlag, EdgeKind

INDEX_GROUPS = {"cones": ("cones/", "index/"), "hextree": ("hextree/", "index/")}
"""Datasets of the cache that a method reads beside the tables every method reads."""

FIRST_QUERY = """
import json, sys, time
begun = time.perf_counter()
import numpy as np
from svprep.cache.reader import open_cache
from svprep.silhouette import silhouette
imported = time.perf_counter()
cache = open_cache(sys.argv[1])
opened = time.perf_counter()
silhouette(cache, np.array([0.3, 0.4, 0.5, 0.0], np.float32))
first = time.perf_counter()
silhouette(cache, np.array([0.3, -0.4, 0.5, 0.0], np.float32))
second = time.perf_counter()
print(json.dumps([imported - begun, opened - imported, first - opened, second - first]))
"""
PROCESSES = 3


@dataclass(frozen=True, slots=True)
class Counts:
    """What a dataset is made of."""

    objects: int
    components: int
    solids: int
    planes: int
    records: int
    single: int
    """Records of one face."""
    planar: int
    """Records that no light can make a silhouette."""
    pairs: int
    """Pairs that are not planar: those that an index may search."""
    indexed: int
    """Of them, those of objects that have trees."""


@dataclass(frozen=True, slots=True)
class Bound:
    """How long moving the bytes of a flat query takes, and nothing else."""

    n_read: int
    """32 B a plane, 4 B for each face of a searched record."""
    n_written: float
    """4 + 1 B per silhouette record; median over the lights."""
    cached_ms: float
    """At the bandwidth over arrays as large as what is read."""
    memory_ms: float
    """At the bandwidth over arrays larger than any cache."""


@dataclass(frozen=True, slots=True)
class Published:
    """What the hextree as it was published looks at; medians over the lights."""

    n_tree: int
    """Edges in the tree."""
    n_always: int
    """Searched records outside it, which every query looks at."""
    cells: float
    edges: float
    """Of those in the tree."""


@dataclass(frozen=True, slots=True)
class FirstQuery:
    """Seconds of a fresh process whose kernels were compiled earlier; medians."""

    import_s: float
    open_s: float
    first_s: float
    """Reads the tables it needs."""
    second_s: float


def count(cache: Cache) -> Counts:
    """Return what a cache holds."""
    flags = cache.edges.flags
    is_planar = (flags & np.uint8(EdgeFlag.PLANAR)) != 0
    is_pair = (flags & np.uint8(EdgeFlag.KIND_MASK)) == EdgeKind.PAIR
    solid = (cache.components.flags & np.uint8(ComponentFlag.SOLID)) != 0
    return Counts(
        objects=cache.n_objects,
        components=cache.n_components,
        solids=int(solid.sum()),
        planes=cache.n_planes,
        records=cache.n_edges,
        single=int((cache.edges.rows[:, 2:] >= cache.n_faces).any(axis=1).sum()),
        planar=int(is_planar.sum()),
        pairs=int((is_pair & ~is_planar).sum()),
        indexed=int(cache.index.pair_start[-1]),
    )


def index_bytes(cache: Cache) -> dict[str, int]:
    """Return the bytes that each index takes in the cache; none where it holds none."""
    sizes = cache.dataset_sizes()
    own = {name: prefixes[0] for name, prefixes in INDEX_GROUPS.items()}
    return {
        name: sum(n for path, n in sizes.items() if path.startswith(prefixes))
        for name, prefixes in INDEX_GROUPS.items()
        if any(path.startswith(own[name]) for path in sizes)
    }


def bound(tables: FlatTables, found: Sequence[int], cached: Bandwidth, memory: Bandwidth) -> Bound:
    """Return the byte bound of a dataset, for silhouettes of these sizes."""
    n_written = 5.0 * statistics.median(found)
    return Bound(
        n_read=tables.bytes_read,
        n_written=n_written,
        cached_ms=1e3 * cached.seconds(tables.bytes_read, n_written),
        memory_ms=1e3 * memory.seconds(tables.bytes_read, n_written),
    )


def published_hextree(cache: Cache, searched: int, lights: Sequence[F32]) -> Published:
    """Return what the published tree, the plain twin of the indices, visits."""
    from svprep.reference.hextree import build_hextree, visit_hextree

    tree = build_hextree(cache)
    visits = [visit_hextree(tree, light) for light in lights]
    return Published(
        n_tree=tree.n_edges,
        n_always=searched - tree.n_edges,
        cells=statistics.median(visit.n_cells for visit in visits),
        edges=statistics.median(len(visit.edge) for visit in visits),
    )


def first_query(cache: Path) -> FirstQuery:
    """Return the seconds of a first and a second query in processes of their own."""
    runs = []
    for _ in range(PROCESSES + 1):
        done = subprocess.run(
            [sys.executable, "-c", FIRST_QUERY, str(cache)],
            capture_output=True, text=True, check=True, env=environment(),
        )  # fmt: skip
        runs.append(json.loads(done.stdout))
    # The first may have had to compile.
    return FirstQuery(*(statistics.median(values) for values in zip(*runs[1:], strict=True)))
