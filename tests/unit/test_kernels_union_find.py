"""Union-find with parity, against a plain breadth-first search."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from svprep.kernels.union_find import union_with_parity

Relation = tuple[int, int, bool]


def run(n: int, relations: list[Relation]) -> tuple[list[int], list[bool], list[bool]]:
    parent, parity = np.arange(n, dtype=np.int32), np.zeros(n, bool)
    conflict = np.ones(len(relations), bool)
    a = np.array([r[0] for r in relations], np.int32)
    b = np.array([r[1] for r in relations], np.int32)
    union_with_parity(a, b, np.array([r[2] for r in relations], bool), parent, parity, conflict)
    return parent.tolist(), parity.tolist(), conflict.tolist()


def plain(n: int, relations: list[Relation]) -> tuple[list[int], list[bool], list[bool]]:
    """Relabel whole sets at every relation: O(n) each, nothing clever."""
    root, parity = list(range(n)), [False] * n
    conflict = []
    for a, b, differ in relations:
        if root[a] == root[b]:
            conflict.append((parity[a] ^ parity[b]) != differ)
            continue
        conflict.append(False)
        joined = parity[a] ^ parity[b] ^ differ
        keep, lose = min(root[a], root[b]), max(root[a], root[b])
        for i in range(n):
            if root[i] == lose:
                root[i], parity[i] = keep, parity[i] ^ joined
    return root, parity, conflict


@st.composite
def relations(draw: st.DrawFn) -> tuple[int, list[Relation]]:
    n = draw(st.integers(1, 24), label="n")
    element = st.integers(0, n - 1)
    return n, draw(st.lists(st.tuples(element, element, st.booleans()), max_size=60))


@given(relations())
def test_union_equals_its_twin(case: tuple[int, list[Relation]]) -> None:
    assert run(*case) == plain(*case)


@given(relations(), st.randoms(use_true_random=False))
def test_order_does_not_matter_without_contradiction(
    case: tuple[int, list[Relation]], random: object
) -> None:
    n, some = case
    colour = [i * 7 % 3 == 0 for i in range(n)]
    sound = [(a, b, colour[a] != colour[b]) for a, b, _ in some]
    mixed = list(sound)
    random.shuffle(mixed)  # type: ignore[attr-defined]
    assert run(n, sound)[:2] == run(n, mixed)[:2]
    assert not any(run(n, mixed)[2])


def test_long_chains_end_at_the_lowest() -> None:
    n = 50_000
    for step in (
        [(i, i + 1, True) for i in range(n - 1)],
        [(i + 1, i, True) for i in range(n - 1)],
    ):
        for chain in (step, step[::-1]):
            parent, parity, conflict = run(n, chain)
            assert set(parent) == {0}
            assert parity == [bool(i % 2) for i in range(n)]
            assert not any(conflict)
