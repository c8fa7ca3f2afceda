"""The result of a query does not depend on how many threads share it, or where."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from svprep.model import EdgeFlag, Prepared
from svprep.silhouette import METHODS, Silhouette, scan, silhouette
from tests.dataset.datasets import DATA, build_with_trees

ROOT = Path(__file__).resolve().parents[2]
LIGHTS = (
    np.array([0.3, -0.4, 0.8, 0.0]),
    np.array([0.0, 0.0, 1.0, 0.0]),
    np.array([1.0, 2.0, 30.0, 1.0]),
)


@pytest.fixture(scope="module")
def city() -> Prepared:
    """Return the sample city with trees for objects of ten searched edges."""
    prepared = build_with_trees(DATA / "small_city.obj.gz", 10)
    assert len(prepared.index.objects) > 200
    return prepared


@pytest.fixture(autouse=True)
def poisoned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fill scratch memory with nonsense: what a query does not write itself shows."""
    plain = scan.Scratch.array

    def poisoned_array(self: scan.Scratch, name: str, n: int, dtype: type) -> np.ndarray:
        array = plain(self, name, n, dtype)
        array.view(np.uint8)[:] = 0xA7
        return array

    monkeypatch.setattr(scan.Scratch, "array", poisoned_array)


def assert_same(a: Silhouette, b: Silhouette) -> None:
    assert np.array_equal(a.edge, b.edge)
    assert np.array_equal(a.multiplicity, b.multiplicity)
    assert np.array_equal(a.object_start, b.object_start)


@pytest.mark.parametrize("n_threads", [1, 2, 3, 7])
@pytest.mark.parametrize("share", [1, 50, 3000])
def test_any_cut_gives_the_same_rows(
    city: Prepared, n_threads: int, share: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SVPREP_THREADS", str(n_threads))
    monkeypatch.setattr(scan, "_SHARE", share)
    monkeypatch.setattr(scan, "_WORTH_CUTTING", 2 * share)
    rng = np.random.default_rng(n_threads)
    n_objects = len(city.object_names)
    for light in LIGHTS:
        for method in ("flat", "cones", "hextree", "auto"):
            # Every object, as a list: plans of whole caches are kept from before.
            everything = silhouette(city, light, method, objects=np.arange(n_objects))
            assert_same(everything, silhouette(city, light, "brute"))
            some = rng.choice(n_objects, 40, replace=False)
            assert_same(
                silhouette(city, light, method, objects=some),
                silhouette(city, light, "brute", objects=some),
            )


@pytest.mark.parametrize("n_threads", [2, 3, 4, 7])
def test_a_large_object_is_cut_whatever_lies_beside_it(
    city: Prepared, n_threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Several threads' targets may fall into an object too small to cut, before or
    # behind one that is cut.
    monkeypatch.setenv("SVPREP_THREADS", str(n_threads))
    start = city.components.edge_start[city.components.object_start]
    is_scanned = (city.edges.flags & EdgeFlag.PLANAR) == 0
    sizes = np.diff(np.append(0, np.cumsum(is_scanned))[start])
    by_size = np.argsort(sizes, kind="stable").tolist()
    n_cut = 0
    for small, large in itertools.product(by_size[-2:-24:-3], by_size[-1:-14:-4]):
        if not sizes[small] + 2 <= sizes[large]:
            continue
        monkeypatch.setattr(scan, "_SHARE", 1)
        monkeypatch.setattr(scan, "_WORTH_CUTTING", int(sizes[small]) + 1)
        asked = np.array([small, large])
        for light in LIGHTS:
            whole = silhouette(city, light, "brute", objects=asked)
            for method in ("flat", "hextree", "auto"):
                assert_same(silhouette(city, light, method, objects=asked), whole)
        n_cut += 1
    assert n_cut >= 20


def test_queries_at_the_same_time_do_not_disturb_each_other(city: Prepared) -> None:
    rng = np.random.default_rng(4)
    jobs = [
        (np.append(rng.normal(size=3), i % 2), METHODS[i % len(METHODS)], i % 3) for i in range(120)
    ]
    expected = [silhouette(city, light, "brute", objects=range(k, 300)) for light, _, k in jobs]
    with ThreadPoolExecutor(6) as pool:
        found = pool.map(lambda j: silhouette(city, j[0], j[1], objects=range(j[2], 300)), jobs)
        for a, b in zip(found, expected, strict=True):
            assert_same(a, b)


def test_rows_are_kept_when_the_next_query_comes(city: Prepared) -> None:
    names = ("edge", "multiplicity", "object_start", "objects", "light")
    for method in METHODS:
        first = silhouette(city, LIGHTS[0], method)
        kept = {name: getattr(first, name).copy() for name in names}
        other = silhouette(city, LIGHTS[2], method)
        for name in names:
            assert np.array_equal(getattr(first, name), kept[name])
            getattr(other, name)[:] = 7  # the caller's own: nobody else sees it
        again = silhouette(city, LIGHTS[0], method)
        for name in names:
            assert np.array_equal(getattr(again, name), kept[name])


ON_ANOTHER_PROCESSOR = """
import sys, hashlib, numpy as np
from svprep.cache.reader import open_cache
from svprep.silhouette import silhouette
with open_cache(sys.argv[1]) as cache:
    for method in ("flat", "cones", "hextree"):
        for light in ([0.3, -0.4, 0.8, 0], [1, 2, 30, 1]):
            found = silhouette(cache, light, method)
            print(hashlib.sha256(found.edge.tobytes() + found.multiplicity.tobytes()).hexdigest())
"""


def test_code_for_any_processor_gives_the_same_rows(city: Prepared, tmp_path: Path) -> None:
    # On this one, instructions of its own may be used (AVX-512): here they are not. On
    # some virtual machines Numba leaves out AVX by itself.
    from svprep.cache.writer import write_cache

    path = tmp_path / "city.svp.h5"
    write_cache(city, path)
    outputs = []
    for change in ({}, {"NUMBA_CPU_NAME": "generic"}, {"NUMBA_ENABLE_AVX": "0"}):
        environment = {**os.environ, "PYTHONPATH": str(ROOT), **change}
        if change:
            environment["NUMBA_CACHE_DIR"] = str(tmp_path / next(iter(change)))
        done = subprocess.run(
            [sys.executable, "-c", ON_ANOTHER_PROCESSOR, str(path)],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        outputs.append(done.stdout.split())
    assert len(set(outputs[0])) == 2  # one for each light
    assert outputs[0] == outputs[1] == outputs[2]
