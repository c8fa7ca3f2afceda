"""How fast this machine moves memory, and so how fast a flat query could be at all."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from silhouette_benchmark.numba_kernels import copy_all, sum_floats, sum_integers, write_all
from svprep.model import F64

ROUNDS = 9
LEAST_BYTES = 1 << 26
"""Moved in a round, by going over a small array repeatedly: starting threads takes a
tenth of a millisecond."""
LANES = 8
"""Numbers that `sum_floats` takes at a time."""


@dataclass(frozen=True, slots=True)
class Bandwidth:
    """Bytes over seconds, on all threads together; the best of `ROUNDS`."""

    n_bytes: int
    """Of the array."""
    read: float
    """[GB/s]"""
    write: float
    """[GB/s]"""
    copy: float
    """[GB/s], counting each byte once."""

    def seconds(self, n_read: float, n_written: float) -> float:
        """Return how long reading and writing that many bytes takes at least."""
        return (n_read / self.read + n_written / self.write) * 1e-9


def measure_bandwidth(n_bytes: int, threads: int) -> Bandwidth:
    """Return the bandwidth over arrays of this size.

    Arrays smaller than the caches are read from there: give the size of the data
    that a query touches to learn what it could reach when asked again and again.
    """
    n = max(n_bytes // 8 // (LANES * threads), 1) * LANES * threads
    times = max(1, LEAST_BYTES // (8 * n))
    source, target = np.ones(n), np.zeros(n)
    integers = source.view(np.uint64)
    with ThreadPoolExecutor(threads) as pool:

        def best(work: Callable[[int, int], object]) -> float:
            def repeat(low: int, high: int) -> None:
                for _ in range(times):
                    work(low, high)

            repeat(0, LANES)  # compiles
            seconds = []
            for _ in range(ROUNDS):
                begun = time.perf_counter()
                share = n // threads
                futures = [pool.submit(repeat, j * share, (j + 1) * share) for j in range(threads)]
                for future in futures:
                    future.result()
                seconds.append(time.perf_counter() - begun)
            return 8e-9 * n * times / min(seconds)

        return Bandwidth(
            n_bytes=8 * n,
            read=max(
                best(lambda low, high: sum_floats(source, low, high)),
                best(lambda low, high: sum_integers(integers, low, high)),
            ),
            write=best(lambda low, high: _write(target, low, high)),
            copy=best(lambda low, high: copy_all(source, target, low, high)),
        )


def _write(target: F64, low: int, high: int) -> None:
    write_all(target, 2.0, low, high)
