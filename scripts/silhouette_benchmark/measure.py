"""Timing queries so that a noisy machine treats all alike, and checking that they agree."""

from __future__ import annotations

import gc
import hashlib
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from silhouette_benchmark.lights import sun_hour
from svprep.cache.reader import Cache
from svprep.model import F32, I8, I64, U32
from svprep.silhouette import Method, silhouette

SUBSET_SHARES = (0.01, 0.1, 1.0)
LEAST_OBJECTS = 100
"""A dataset of fewer has no hundredth part."""


class Answer(Protocol):
    """What every subject returns, the product's `Silhouette` among them."""

    @property
    def edge(self) -> U32: ...  # noqa: D102
    @property
    def multiplicity(self) -> I8: ...  # noqa: D102
    @property
    def object_start(self) -> I64: ...  # noqa: D102


Subject = Callable[[F32], Answer]


class Disagreement(Exception):
    """Two subjects gave different silhouettes for one light."""


@dataclass(frozen=True, slots=True)
class Timing:
    """One subject's queries, a number per light, in the order of the lights."""

    ms: list[float] = field(default_factory=list)
    visited: list[int] = field(default_factory=list)
    """Edge records whose multiplicity was computed."""
    found: list[int] = field(default_factory=list)
    """Edge records of the silhouette."""

    @property
    def median_ms(self) -> float:
        """Of all lights."""
        return statistics.median(self.ms)


@dataclass(frozen=True, slots=True)
class Ratio:
    """Times over those of a baseline, light by light."""

    median: float
    quartiles: tuple[float, float]
    directional: float
    """Median of the directional lights."""
    point: float
    slower: int
    """For how many lights it took longer than the baseline."""


@dataclass(frozen=True, slots=True)
class SubsetRow:
    """Queries for some of the objects."""

    share: float
    objects: int
    method: str
    median_ms: float
    visited: float
    """Median, edge records."""


def measure(
    subjects: Mapping[str, Subject], records: int, lights: Sequence[F32], warm: Sequence[F32]
) -> dict[str, Timing]:
    """Time every subject for every light, in turns, and compare their answers.

    Who follows whom changes from turn to turn, and in a turn each has another light:
    nobody finds in the processor's cache what a neighbour read for the same light.
    `warm` are asked first and not timed: they load tables and kernels. `records` is
    what a subject that does not count its work, a flat scan, visits.

    Raises
    ------
    Disagreement
        Two answers differ in any row.
    """
    n = len(lights)
    timings = {name: Timing([0.0] * n, [0] * n, [0] * n) for name in subjects}
    for light in warm:
        for subject in subjects.values():
            subject(light)
    names = list(subjects)
    shuffle = np.random.default_rng(0).permutation
    answers: dict[int, tuple[str, tuple[bytes, ...]]] = {}
    with _no_collection():
        for turn in range(n):
            for place in shuffle(len(names)).tolist():
                name, k = names[place], (turn + place * n // len(names)) % n
                times: list[float] = []
                answer = _timed(subjects[name], lights[k], times)
                work = getattr(answer, "work", None)
                timings[name].ms[k] = times[0]
                timings[name].visited[k] = records if work is None else work.n_edges
                timings[name].found[k] = len(answer.edge)
                _compare(answers.setdefault(k, (name, _digests(answer))), (name, answer), lights[k])
                del answer
    return timings


def measure_alone(subjects: Mapping[str, Subject], lights: Sequence[F32]) -> dict[str, Timing]:
    """Time every subject on its own, a new light for each query: what a program sees."""
    timings = {}
    for name, subject in subjects.items():
        subject(lights[-1])
        timings[name] = Timing()
        with _no_collection():
            for light in lights:
                timings[name].found.append(len(_timed(subject, light, timings[name].ms).edge))
    return timings


def ratio(timing: Timing, baseline: Timing, lights: Sequence[F32]) -> Ratio:
    """Return a subject's times over a baseline's, paired light by light."""
    over = np.array(timing.ms) / np.array(baseline.ms)
    is_point = np.array([light[3] for light in lights]) != 0.0
    low, high = np.percentile(over, [25, 75]).tolist()
    return Ratio(
        median=float(np.median(over)),
        quartiles=(low, high),
        directional=float(np.median(over[~is_point])),
        point=float(np.median(over[is_point])) if is_point.any() else float("nan"),
        slower=int((over > 1.0).sum()),
    )


def measure_coherent(subjects: Mapping[str, Subject]) -> dict[str, Timing]:
    """Time an hour of sun for each subject on its own, minute after minute.

    One after the other, so that whatever a subject keeps of the last light is there.
    """
    timings = {}
    for name, subject in subjects.items():
        subject(sun_hour(1)[0])
        timing = Timing()
        with _no_collection():
            for light in sun_hour():
                timing.found.append(len(_timed(subject, light, timing.ms).edge))
        timings[name] = timing
    return timings


def measure_subsets(
    cache: Cache, methods: Sequence[Method], lights: Sequence[F32], seed: int
) -> list[SubsetRow]:
    """Time queries for random objects: a hundredth, a tenth and all; other ones each time."""
    if cache.n_objects < LEAST_OBJECTS:
        return []
    generator = np.random.default_rng(seed)
    rows = []
    for share in SUBSET_SHARES:
        n = max(1, round(share * cache.n_objects))
        timings = {method: Timing() for method in methods}
        with _no_collection():
            for light in lights:
                objects = np.sort(generator.choice(cache.n_objects, n, replace=False))
                for method, timing in timings.items():
                    begun = time.perf_counter()
                    answer = silhouette(cache, light, method, objects=objects)
                    timing.ms.append(1e3 * (time.perf_counter() - begun))
                    timing.visited.append(answer.work.n_edges)
                    del answer
        for method, timing in timings.items():
            visited = statistics.median(timing.visited)
            rows.append(SubsetRow(share, n, method, timing.median_ms, visited))
    return rows


def _timed(subject: Subject, light: F32, ms: list[float]) -> Answer:
    """Ask once; append the milliseconds."""
    begun = time.perf_counter()
    answer = subject(light)
    ms.append(1e3 * (time.perf_counter() - begun))
    return answer


TABLES = ("edge", "multiplicity", "object_start")


def _digests(answer: Answer) -> tuple[bytes, ...]:
    return tuple(
        hashlib.sha256(np.ascontiguousarray(getattr(answer, table))).digest() for table in TABLES
    )


def _compare(first: tuple[str, tuple[bytes, ...]], other: tuple[str, Answer], light: F32) -> None:
    """Raise unless an answer is the same as the first one for this light, row by row."""
    for table, a, b in zip(TABLES, first[1], _digests(other[1]), strict=True):
        if a != b:
            raise Disagreement(
                f"{first[0]} and {other[0]} differ in {table} for the light {light.tolist()}"
            )


@contextmanager
def _no_collection() -> Iterator[None]:
    """Keep Python's garbage collector from running inside a measurement."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
