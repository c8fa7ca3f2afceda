"""Work shared among threads: in order, bounded, alone within a tile, errors told."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Iterator

import numpy as np
import pytest

from svprep.errors import EnvironmentProblem
from svprep.parallel import (
    alone,
    for_each,
    for_ranges,
    for_shares,
    map_ordered,
    run_together,
    thread_count,
)


@pytest.fixture(autouse=True)
def _three_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SVPREP_THREADS", "3")


def threads_of(share_out: str) -> set[int]:
    """Return the threads that took part in work which is shared out in one way."""
    seen: set[int] = set()
    together = threading.Barrier(2)

    def meet() -> None:
        seen.add(threading.get_ident())
        if thread_count() > 1:
            together.wait(10)  # so that one thread cannot do it all

    if share_out == "ranges":
        for_ranges(np.array([0, 40_000, 80_000]), lambda a, b: meet())
    elif share_out == "together":
        run_together([meet, meet])
    elif share_out == "each":
        for_each(2, lambda i: meet())
    else:
        for_shares(9_000, lambda a, b: seen.add(threading.get_ident()))
    return seen


@pytest.mark.parametrize("share_out", ["ranges", "together", "each", "shares"])
def test_alone_keeps_work_on_the_thread(share_out: str) -> None:
    with alone():
        with alone():
            pass
        assert thread_count() == 1
        assert threads_of(share_out) == {threading.get_ident()}
    assert thread_count() == 3
    if share_out in ("together", "each"):
        assert len(threads_of(share_out)) == 2


def test_alone_is_of_one_thread_and_ends_with_an_error() -> None:
    with alone():
        elsewhere: list[int] = []
        thread = threading.Thread(target=lambda: elsewhere.append(thread_count()))
        thread.start()
        thread.join()
    assert elsewhere == [3]
    with pytest.raises(ZeroDivisionError), alone():
        _ = 1 / 0
    assert thread_count() == 3


def test_results_come_in_the_order_of_the_items() -> None:
    gates = [threading.Event() for _ in range(3)]

    def do(i: int) -> int:
        if i < 2:
            assert gates[i].wait(10)
        else:
            gates[1].set()
            gates[0].set()
        return i * i

    assert list(map_ordered(do, range(3), 3)) == [0, 1, 4]
    assert list(map_ordered(lambda i: -i, range(50), 4)) == [-i for i in range(50)]


def test_tiles_run_alone_on_other_threads() -> None:
    def do(_: int) -> tuple[int, int]:
        return threading.get_ident(), thread_count()

    for name, count in map_ordered(do, range(6), 4):
        assert name != threading.get_ident()
        assert count == 1
    assert thread_count() == 3


@pytest.mark.parametrize("case", ["one item", "one thread", "one ahead", "alone"])
def test_what_is_not_shared_among_threads_runs_here(
    case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if case == "one thread":
        monkeypatch.setenv("SVPREP_THREADS", "1")
    items = range(1) if case == "one item" else range(3)

    def do(_: int) -> tuple[int, int]:
        return threading.get_ident(), thread_count()

    def found() -> set[tuple[int, int]]:
        return set(map_ordered(do, items, 1 if case == "one ahead" else 4))

    if case == "alone":
        with alone():
            assert found() == {(threading.get_ident(), 1)}
    else:
        # Nothing else runs meanwhile, so it may share out what it does.
        assert found() == {(threading.get_ident(), 1 if case == "one thread" else 3)}


def test_no_items_yield_nothing() -> None:
    assert list(map_ordered(lambda i: i, [], 4)) == []


def test_few_items_are_begun_ahead_and_none_is_kept() -> None:
    class Thing:
        pass

    taken = 0
    made: list[weakref.ref[Thing]] = []

    def items() -> Iterator[int]:
        nonlocal taken
        for i in range(20):
            taken += 1
            yield i

    def do(_: int) -> Thing:
        thing = Thing()
        made.append(weakref.ref(thing))
        return thing

    n_yielded = 0
    for thing in map_ordered(do, items(), 4):
        n_yielded += 1
        assert taken <= n_yielded + 4
        assert sum(each() is not None for each in made) <= 5
        mine = weakref.ref(thing)
        del thing
        assert mine() is None
    assert n_yielded == taken == 20


def test_an_error_comes_in_its_turn_and_ends_the_rest() -> None:
    begun: list[int] = []

    def do(i: int) -> int:
        begun.append(i)
        if i >= 2:
            raise ValueError(f"item {i}")
        return i

    results = map_ordered(do, range(1000), 4)
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ValueError, match="item 2"):
        next(results)
    assert len(begun) <= 6
    assert list(results) == []


def test_a_closed_iterator_begins_nothing_more() -> None:
    begun: list[int] = []
    results = map_ordered(begun.append, range(1000), 3)
    next(results)
    results.close()
    n_begun = len(begun)
    assert n_begun <= 4
    assert not [t for t in threading.enumerate() if t.name.startswith("svprep-tile")]


@pytest.mark.parametrize("given", ["zero", "0", "-1", "1.5", " ", "9999999999999"])
def test_a_thread_count_that_is_none_is_told(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SVPREP_THREADS", given)
    with pytest.raises(EnvironmentProblem, match=f'SVPREP_THREADS is "{given}"'):
        thread_count()


def test_a_thread_count_is_taken_as_given(monkeypatch: pytest.MonkeyPatch) -> None:
    for given, expected in (("7", 7), ("1000", 256)):
        monkeypatch.setenv("SVPREP_THREADS", given)
        assert thread_count() == expected
    monkeypatch.setenv("SVPREP_THREADS", "")
    assert thread_count() >= 1


@pytest.mark.parametrize("n_threads", ["2", "3"])
def test_shares_of_shares_wait_for_no_one(n_threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SVPREP_THREADS", n_threads)
    n = 5000  # as many as are shared out
    done = np.zeros(n, np.int64)

    def outer(begin: int, end: int) -> None:
        for _ in range(20):
            for_shares(n, lambda _a, _b: time.sleep(1e-4))
        done[begin:end] += 1

    work = threading.Thread(target=for_shares, args=(n, outer), daemon=True)
    work.start()
    work.join(30.0)
    assert not work.is_alive()
    assert (done == 1).all()
