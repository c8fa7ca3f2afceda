"""Equal rows, distinct values and counting sorts, against plain twins."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from svprep import reference
from svprep.kernels.rows import count_distinct_per_group, counting_order, first_equal_row
from tests.property.meshes import arrays

EXTREME = [-(2**31), -(2**24), -1, 0, 1, 2**24, 2**31 - 1]


def starts(draw: st.DrawFn, n: int) -> np.ndarray:
    cuts = draw(st.lists(st.integers(0, n), max_size=4), label="cuts")
    return np.array([0, *sorted(cuts), n], np.int64)


@st.composite
def rows_in_groups(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    n = draw(st.integers(0, 60), label="n")
    elements = draw(st.sampled_from([st.integers(-1, 2), st.sampled_from(EXTREME)]))
    return draw(arrays(np.int32, (n, 3), elements=elements)), starts(draw, n)


@given(rows_in_groups(), st.data())
def test_first_equal_row(case: tuple[np.ndarray, np.ndarray], data: st.DataObject) -> None:
    rows, group_start = case
    n_groups = len(group_start) - 1
    first = np.full(len(rows), -7, np.int32)
    cut = data.draw(st.integers(0, n_groups), label="groups done first")
    first_equal_row(rows, group_start, cut, n_groups, first)
    assert (first[: group_start[cut]] == -7).all(), "groups outside the range were touched"
    first_equal_row(rows, group_start, 0, cut, first)
    assert first.tolist() == reference.first_equal_row(rows, group_start)


def test_first_equal_row_of_many_rows() -> None:
    """A full table with long probe runs: half of all rows are different."""
    rng = np.random.default_rng(0)
    rows = rng.integers(-12, 13, (20_000, 3)).astype(np.int32)
    group_start = np.array([0, 9_000, 9_000, 9_001, 20_000], np.int64)
    first = np.empty(len(rows), np.int32)
    first_equal_row(rows, group_start, 0, 4, first)
    assert first.tolist() == reference.first_equal_row(rows, group_start)


@pytest.mark.parametrize("axis", range(3))
def test_rows_that_differ_in_one_coordinate_differ(axis: int) -> None:
    rows = np.zeros((1024, 3), np.int32)
    rows[:, axis] = np.arange(1024) * 2**21
    rows[0, axis] = -1
    first = np.empty(len(rows), np.int32)
    first_equal_row(rows, np.array([0, 1024]), 0, 1, first)
    np.testing.assert_array_equal(first, np.arange(1024))


@given(st.data())
def test_count_distinct_per_group(data: st.DataObject) -> None:
    values = data.draw(arrays(np.uint32, st.integers(0, 50), elements=st.integers(0, 6)))
    group_start = starts(data.draw, len(values))
    counts = np.full(len(group_start) - 1, -7, np.int64)
    count_distinct_per_group(values, group_start, 7, counts)
    ranges = pairwise(group_start)
    assert counts.tolist() == [len(set(values[b:e].tolist())) for b, e in ranges]


@given(arrays(np.int32, st.integers(0, 60), elements=st.integers(0, 5)), st.integers(6, 8))
def test_counting_order(keys: np.ndarray, n_keys: int) -> None:
    order = np.empty(len(keys), np.int32)
    key_start = np.empty(n_keys + 1, np.int64)
    counting_order(keys, n_keys, order, key_start)
    np.testing.assert_array_equal(order, np.argsort(keys, kind="stable"))
    assert key_start.tolist() == [int((keys < k).sum()) for k in range(n_keys + 1)]
