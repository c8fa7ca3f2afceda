"""Whether triangles meet: the exact kernel against rational arithmetic."""

from __future__ import annotations

import time
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svprep import reference
from svprep.kernels.self_contact import touches_itself
from svprep.repair.solid import find_self_contact
from tests.property.meshes import SUITE, arrays, build, sphere


def kernel(points: np.ndarray, faces: np.ndarray, starts: list[int] | None = None) -> list[bool]:
    """Ask the kernel about components of two faces each, or those between `starts`."""
    face_start = np.array(starts or range(0, len(faces) + 1, 2), np.int64)
    candidates = np.arange(len(face_start) - 1)
    touching = np.zeros(len(candidates), bool)
    touches_itself(
        points.astype(np.int64), faces.astype(np.uint32), face_start, candidates,
        0, len(candidates), touching,
    )  # fmt: skip
    return touching.tolist()


def has_area(triangles: np.ndarray) -> np.ndarray:
    wide = triangles.astype(object)
    u, w = wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0]
    minors = [u[:, i] * w[:, j] - u[:, j] * w[:, i] for i, j in ((0, 1), (1, 2), (2, 0))]
    return (np.array(minors) != 0).any(axis=0)


def check_pairs(triangles: np.ndarray) -> int:
    """Compare ``(2 n, 3, 3)`` triangles pairwise, welded; return how many touch."""
    fine = has_area(triangles).reshape(-1, 2).all(axis=1)
    triangles = triangles.reshape(-1, 2, 3, 3)[fine].reshape(-1, 3, 3)
    pair = np.repeat(np.arange(len(triangles) // 2), 6)
    rows = np.column_stack((pair, triangles.reshape(-1, 3)))
    unique, vertex = np.unique(rows, axis=0, return_inverse=True)
    found = kernel(unique[:, 1:], vertex.reshape(-1, 3))
    expected = [
        reference.triangles_touch(p, q)
        for p, q in zip(triangles[::2], triangles[1::2], strict=True)
    ]
    wrong = [i for i, (a, b) in enumerate(zip(found, expected, strict=True)) if a != b]
    assert not wrong, triangles[2 * wrong[0] : 2 * wrong[0] + 2].tolist()
    return sum(expected)


@pytest.mark.parametrize("reach", [1, 2, 3, 8])
def test_random_triangles_on_a_small_grid(reach: int) -> None:
    """Shared corners, shared edges, coplanar overlaps and touches of every kind."""
    rng = np.random.default_rng(reach)
    n_touching = check_pairs(rng.integers(0, reach + 1, (2400, 3, 3)))
    assert 100 < n_touching < 1200


@pytest.mark.parametrize("shared", [1, 2, 3])
def test_random_triangles_that_share_corners(shared: int) -> None:
    rng = np.random.default_rng(shared)
    triangles = rng.integers(0, 4, (1600, 3, 3))
    for k in range(0, 1600, 2):
        own, other = rng.permutation(3), rng.permutation(3)
        triangles[k + 1, other[:shared]] = triangles[k, own[:shared]]
    n_touching = check_pairs(triangles)
    assert n_touching > 50


def test_random_coplanar_triangles() -> None:
    rng = np.random.default_rng(9)
    flat = rng.integers(-3, 4, (2000, 3, 2))
    basis = rng.integers(-3, 4, (1000, 2, 3)).repeat(2, axis=0)
    n_touching = check_pairs(np.einsum("kci,kij->kcj", flat, basis))
    assert n_touching > 200


FAR = 2**24


@given(
    arrays(
        np.int64,
        (8, 3, 3),
        elements=st.one_of(st.sampled_from([-FAR, -FAR + 1, FAR - 1, FAR]), st.integers(-FAR, FAR)),
    )
)
@settings(max_examples=150)
def test_triangles_across_the_whole_grid(triangles: np.ndarray) -> None:
    check_pairs(triangles)


@pytest.mark.parametrize("far", [FAR, 2**19 - 1], ids=["in halves", "in one int64"])
def test_near_misses_across_a_wide_plane(far: int) -> None:
    """A corner one step above, on, and below a slanted plane; numbers just fit int64."""
    rng = np.random.default_rng(6)
    triangles = []
    for _ in range(300):
        p = rng.integers(-far, far + 1, (3, 3))
        weights = rng.dirichlet((1, 1, 1))
        tip = np.round(weights @ p).astype(int)
        tip[rng.integers(0, 3)] += rng.integers(-1, 2)
        away = rng.integers(-far, far + 1, (2, 3))
        triangles += [p, np.vstack((tip, away))]
    n_touching = check_pairs(np.array(triangles))
    assert 100 < n_touching < 290


def test_exactly_on_the_plane_across_the_whole_grid() -> None:
    """Corners exactly on the other triangle's edge or inside it, and one step off."""
    m = FAR
    base = np.array([[-m, -m, -m], [m, -m, 0], [-m, m, m]])
    middle = (base[1] + base[2]) // 2  # on an edge: even sums
    inner = (base[0] + middle) // 2
    assert ((base[1] + base[2]) % 2 == 0).all()
    assert ((base[0] + middle) % 2 == 0).all()
    triangles = []
    for tip in (middle, inner):
        for step in ([0, 0, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0], [1, 1, 0]):
            triangles += [base, np.array([tip + step, [0, 0, m], [1, 5, m]])]
    assert 2 <= check_pairs(np.array(triangles)) <= 8


FLAT = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]
CASES = {
    "apart": ([[0, 0, 1], [2, 0, 1], [0, 2, 1]], False),
    "pierced": ([[1, 1, -1], [1, 1, 1], [9, 9, 1]], True),
    "corner on face": ([[1, 1, 0], [1, 1, 3], [2, 2, 3]], True),
    "corner on edge": ([[2, 0, 0], [2, -1, 3], [3, 0, 3]], True),
    "edge across edge": ([[2, -1, -1], [2, 1, 1], [2, -2, 5]], True),
    "just past the edge": ([[2, -2, -1], [2, 0, 1], [2, -2, 5]], False),
    "shared edge": ([[4, 0, 0], [0, 0, 0], [0, -4, 0]], False),
    "folded over": ([[4, 0, 0], [0, 0, 0], [1, 1, 0]], True),
    "folded up": ([[4, 0, 0], [0, 0, 0], [1, 1, 1]], False),
    "shared corner": ([[0, 0, 0], [1, 1, 1], [2, 1, 1]], False),
    "shared corner, and over": ([[0, 0, 0], [3, 3, 0], [3, 3, 2]], True),
    "shared corner, along an edge": ([[0, 0, 0], [2, 0, 0], [2, 0, 2]], True),
    "shared corner, through": ([[0, 0, 0], [1, 1, -1], [2, 2, 1]], True),
    "same": ([[4, 0, 0], [0, 0, 0], [0, 4, 0]], True),
    "inside, coplanar": ([[1, 1, 0], [2, 1, 0], [1, 2, 0]], True),
    "part of an edge": ([[1, 0, 0], [3, 0, 0], [2, -2, 0]], True),
    "touching corners": ([[4, 0, 0], [5, 0, 0], [5, 1, 0]], False),
}
"""Each is met with `FLAT`."""


@pytest.mark.parametrize("name", CASES)
def test_named_pairs(name: str) -> None:
    p, (q, touches) = FLAT, CASES[name]
    assert reference.triangles_touch(np.array(p), np.array(q)) == touches
    for one, other in ((p, q), (q, p)):
        for turn in range(3):
            assert check_pairs(np.array([np.roll(one, turn, axis=0), other])) == touches


def test_every_pair_of_a_large_component_is_looked_at() -> None:
    """Two faces that meet are found wherever they stand among many that do not."""
    rng = np.random.default_rng(0)
    n = 400
    at = rng.permutation(np.argwhere(np.ones((20, 20, 3), bool)))[:n] * 10
    points = (at[:, None] + [[0, 0, 0], [4, 1, 2], [1, 4, 3]]).reshape(-1, 3)
    faces = np.arange(3 * n).reshape(-1, 3)
    assert kernel(points, faces, [0, n]) == [False]
    for _ in range(60):
        i, j = rng.choice(n, 2, replace=False)
        moved = points.copy()
        # Through the middle of face i; face j lies nowhere near otherwise.
        centre = points[faces[i]].sum(axis=0) // 3
        moved[faces[j]] = centre + [[-1, -1, 3], [1, 1, -3], [0, 2, 4]]
        expected = any(
            reference.triangles_touch(moved[faces[a]], moved[faces[j]]) for a in range(n) if a != j
        )
        assert kernel(moved, faces, [0, n]) == [expected]
        assert expected


@given(st.integers(0, 2**32 - 1), st.integers(2, 40))
@settings(max_examples=40)
def test_random_components_equal_all_pairs(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.integers(0, 60, (n, 1, 3)) + rng.integers(0, 9, (n, 3, 3))
    corners = corners[has_area(corners)]
    unique, vertex = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    expected = any(reference.triangles_touch(p, q) for p, q in combinations(corners, 2))
    assert kernel(unique, vertex.reshape(-1, 3), [0, len(corners)]) == [expected]


def test_only_candidates_are_looked_at() -> None:
    built = build(SUITE["crossing shell"]())
    faces, start = built.repaired.mesh.faces, built.components.face_start
    two = np.vstack((faces, faces))
    face_start = np.array([0, len(faces), 2 * len(faces)], np.int64)
    assert start.tolist() == [0, len(faces)]
    points = built.points
    assert find_self_contact(points, two, face_start, np.array([1])).tolist() == [True]
    assert find_self_contact(points, two, face_start, np.array([0, 1])).tolist() == [True, True]
    assert find_self_contact(points, two, face_start, np.zeros(0, np.int64)).tolist() == []


def test_a_dented_sphere_touches_itself_only_when_the_dent_goes_through() -> None:
    source = sphere(16, 24, 1000.0)
    for depth, touches in ((1900, False), (2100, True)):
        positions = source.positions.copy()
        positions[0, 2] -= depth  # the pole goes down, towards the other one
        unique, vertex = np.unique(positions, axis=0, return_inverse=True)
        faces = vertex.reshape(-1)[source.faces.astype(int)]
        assert kernel(unique, faces, [0, len(faces)]) == [touches]


def test_slivers_side_by_side_are_given_up_in_bounded_time() -> None:
    """A fan-capped prism of 20,000 sides: every pair of its slivers has boxes that overlap."""
    n = 20_000
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    ring = np.column_stack((np.cos(angle), np.sin(angle))) * (1 << 22)
    points = np.vstack((np.column_stack((ring, np.zeros(n))), np.column_stack((ring, np.ones(n)))))
    i = np.arange(n)
    j = (i + 1) % n
    k = np.arange(1, n - 1)
    zero = np.zeros_like(k)
    faces = np.vstack(
        (
            np.column_stack((i, j, j + n)),
            np.column_stack((i, j + n, i + n)),
            np.column_stack((zero, k + 1, k)),
            np.column_stack((zero + n, k + n, k + 1 + n)),
        )
    ).astype(np.uint32)
    start = np.array([0, len(faces)], np.int64)
    points = np.rint(points).astype(np.int32)
    begun = time.perf_counter()
    touching = find_self_contact(points, faces, start, np.array([0]))
    assert touching.tolist() == [True]
    assert time.perf_counter() - begun < 60.0, "the budget of pairs does not hold"
