"""Ranges of objects on several threads, with the same result for any number.

Kernels release the GIL and write disjoint parts of arrays they are given, so
threads need no locks and the outcome cannot depend on their number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

import numpy as np

from svprep.model import I64

T = TypeVar("T")

MOST_THREADS = 256
"""More than any machine gains from."""
_FEWEST_SHARED = 4096
"""Items that cost little each, such as vertices, below which one thread does them."""
_SMALLEST_SHARE = 20_000
"""Work items below which a second thread costs more than it brings."""


def thread_count() -> int:
    """Return how many threads to use: ``SVPREP_THREADS``, or the cores we may run on."""
    asked = os.environ.get("SVPREP_THREADS", "")
    if asked.isascii() and asked.isdigit() and int(asked) > 0:
        return min(int(asked), MOST_THREADS)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def for_ranges(start: I64, work: Callable[[int, int], object]) -> None:
    """Call ``work(begin, end)`` on ranges of groups that hold about equal work.

    ``start (n_groups + 1,)``: where each group's items begin. Four ranges a
    thread even out groups of different cost.
    """
    n_groups = len(start) - 1
    n_items = int(start[-1] - start[0])
    n_threads = thread_count()
    if n_threads == 1 or n_items < 2 * _SMALLEST_SHARE or n_groups < 2:
        work(0, n_groups)
        return
    shares = start[0] + np.arange(1, 4 * n_threads) * (n_items / (4 * n_threads))
    cuts = np.unique(np.concatenate(([0], np.searchsorted(start, shares), [n_groups])))
    ranges = list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))
    with ThreadPoolExecutor(n_threads) as pool:
        for future in [pool.submit(work, begin, end) for begin, end in ranges]:
            future.result()


def run_together(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Run `tasks` at the same time, the first one here; return what they return.

    The threads stay for the next call: starting one takes longer than many a task.
    """
    if len(tasks) < 2:
        return [task() for task in tasks]
    others = [_pool(max(thread_count(), len(tasks)) - 1).submit(task) for task in tasks[1:]]
    first = tasks[0]()
    return [first, *(future.result() for future in others)]


def for_each(n: int, do: Callable[[int], object]) -> None:
    """Call ``do(0) .. do(n - 1)``, on as many threads as there are, each taking the next."""
    left = iter(range(n))

    def run() -> None:
        for i in left:  # next() on a range is atomic
            do(i)

    run_together([run] * min(thread_count(), n))


def for_shares(n: int, work: Callable[[int, int], object]) -> None:
    """Call ``work(begin, end)`` on four equal ranges a thread of n items that cost the same.

    Every range but the last ends on a multiple of 8, so that none shares a block of eight.
    """
    n_parts = 4 * thread_count() if n > _FEWEST_SHARED else 1
    cuts = [min(n, -(-n * i // n_parts) // 8 * 8) for i in range(n_parts)] + [n]
    for_each(n_parts, lambda i: work(cuts[i], cuts[i + 1]))


@lru_cache(maxsize=1)
def _pool(n_threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(n_threads, thread_name_prefix="svprep")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork
