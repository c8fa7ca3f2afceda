"""Ranges of objects, or tiles of them, on several threads; the same result for any number.

Kernels release the GIL and write disjoint parts of arrays they are given, so
threads need no locks and the outcome cannot depend on their number.

Work is shared on one level only. Where tiles run side by side (`map_ordered`), what a
tile's stages would share out runs on the tile's own thread (`alone`).
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import chain, islice
from typing import TypeVar

import numpy as np

from svprep.errors import EnvironmentProblem
from svprep.model import I64

S = TypeVar("S")
T = TypeVar("T")

MOST_THREADS = 256
"""More than any machine gains from."""
_FEWEST_SHARED = 4096
"""Items that cost little each, such as vertices, below which one thread does them."""
_SMALLEST_SHARE = 20_000
"""Work items below which a second thread costs more than it brings."""


_THREAD = threading.local()
"""``is_alone``: whether this thread shares its work with no other one; ``is_helper``: whether
it is one of those that `run_together` shares work with."""


def thread_count() -> int:
    """Return how many threads to use: ``SVPREP_THREADS``, or the cores we may run on.

    It is 1 in a block of `alone`.

    Raises
    ------
    EnvironmentProblem
        ``SVPREP_THREADS`` is not a number of threads.
    """
    if getattr(_THREAD, "is_alone", False):
        return 1
    asked = os.environ.get("SVPREP_THREADS", "")
    if asked:
        return min(_as_count(asked), MOST_THREADS)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _as_count(asked: str) -> int:
    if not (asked.isascii() and asked.isdigit() and len(asked) < 10 and int(asked) > 0):
        raise EnvironmentProblem(
            f'SVPREP_THREADS is "{asked}", which is no number of threads; set it to 1 or more, '
            "or unset it to use every core"
        )
    return int(asked)


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """Keep the work of a block on the thread that runs it: nothing here is shared out."""
    before = getattr(_THREAD, "is_alone", False)
    _THREAD.is_alone = True
    try:
        yield
    finally:
        _THREAD.is_alone = before


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

    The threads stay for the next call: starting one takes longer than many a task. A task
    that calls this on one of them has its own done there, one by one: threads that wait for
    each other would wait forever.
    """
    is_single = getattr(_THREAD, "is_alone", False) or getattr(_THREAD, "is_helper", False)
    if len(tasks) < 2 or is_single:
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


def map_ordered(do: Callable[[S], T], items: Iterable[S], most_ahead: int) -> Iterator[T]:
    """Yield ``do(item)`` of every item, in order, of several items at the same time.

    Parameters
    ----------
    do : callable
        Runs on `thread_count` threads, each `alone`. On the calling thread, and free to
        share out its work, if there is one thread or one item.
    items : iterable
        Taken on the calling thread, no sooner than they are needed.
    most_ahead : int
        Items at most, 1 or more, that are begun and not yet yielded.

    Raises
    ------
    Exception
        The first one, in the order of the items, that `do` raises. No item is begun after it
        is met, nor once the iterator is closed; those that run then are waited for.
    """
    left = iter(items)
    head = list(islice(left, 2))
    is_shared = len(head) > 1 and min(thread_count(), most_ahead) > 1
    queue = chain(head, left)
    del head  # an item that is done is not kept
    if not is_shared:
        yield from (do(item) for item in queue)
        return

    def run(item: S) -> T:
        with alone():
            return do(item)

    pool = ThreadPoolExecutor(min(thread_count(), most_ahead), thread_name_prefix="svprep-tile")
    try:
        begun = deque(pool.submit(run, item) for item in islice(queue, most_ahead))
        while begun:
            begun[0].result()  # raises before another item is begun
            begun.extend(pool.submit(run, item) for item in islice(queue, 1))
            yield begun.popleft().result()  # kept by nobody here while the caller uses it
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@lru_cache(maxsize=1)
def _pool(n_threads: int) -> ThreadPoolExecutor:
    def begin() -> None:
        _THREAD.is_helper = True

    return ThreadPoolExecutor(n_threads, thread_name_prefix="svprep", initializer=begin)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork
