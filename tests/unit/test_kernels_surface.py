"""Normals, volumes, shape hashes and plane growth, against exact integers."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from svprep.kernels.surface import component_volumes, face_normals, grow_planes, shape_hashes
from tests.property.meshes import SMALL_SUITE, Built, arrays, build, sphere

FAR = [-(2**24), -(2**24) + 1, -1, 0, 1, 2**24 - 1, 2**24]


def exact_normal(a: list[int], b: list[int], c: list[int]) -> list[int]:
    u = [y - x for x, y in zip(a, b, strict=True)]
    w = [y - x for x, y in zip(a, c, strict=True)]
    return [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]]


def normals_of(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    normals = np.empty((len(faces), 3))
    face_normals(points.astype(np.int32), faces, normals)
    return normals


coordinates = st.one_of(st.integers(-(2**24), 2**24), st.sampled_from(FAR))


@given(arrays(np.int32, (12, 3), elements=coordinates))
def test_face_normals_are_exact(points: np.ndarray) -> None:
    faces = np.arange(12, dtype=np.uint32).reshape(-1, 3)
    expected = [exact_normal(*points[face].tolist()) for face in faces]
    assert [[int(x) for x in n] for n in normals_of(points, faces).tolist()] == expected


@given(arrays(np.int32, (12, 3), elements=st.integers(-50, 50)), st.data())
def test_component_volumes(points: np.ndarray, data: st.DataObject) -> None:
    faces = data.draw(arrays(np.uint32, (10, 3), elements=st.integers(0, 11)))
    flips = data.draw(arrays(bool, 10))
    component = data.draw(arrays(np.int32, 10, elements=st.integers(0, 2)))
    component[:3] = 0, 1, 2
    volume, scale = np.zeros(3), np.zeros(3)
    lowest = np.arange(3, dtype=np.int32)
    component_volumes(
        points, faces, normals_of(points, faces), flips, component, lowest, volume, scale
    )
    expected = [0, 0, 0]
    for f, corners in enumerate(faces.tolist()):
        i = int(component[f])
        r = points[faces[i, 0]].tolist()
        a, b, c = (points[v].tolist() for v in corners)
        n = exact_normal(a, b, c)
        term = sum((x - y) * z for x, y, z in zip(a, r, n, strict=True))
        expected[i] += -term if flips[f] else term
    assert volume.tolist() == expected
    assert (np.abs(volume) <= scale * (1 + 1e-12)).all()


def hashes_of(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    hashes = np.empty(len(faces), np.uint32)
    shape_hashes(points.astype(np.int32), faces, np.array([0, len(faces)], np.int64), hashes)
    return hashes


@given(
    arrays(np.int32, (8, 3), elements=st.integers(-1000, 1000)),
    arrays(np.uint32, (6, 3), elements=st.integers(0, 7)),
    arrays(np.int32, 3, elements=st.integers(-(2**22), 2**22)),
    st.permutations(range(6)),
)
def test_shape_hashes_keep_what_they_promise(
    points: np.ndarray, faces: np.ndarray, shift: np.ndarray, order: list[int]
) -> None:
    hashes = hashes_of(points, faces)
    np.testing.assert_array_equal(hashes_of(points + shift, faces), hashes)
    np.testing.assert_array_equal(hashes_of(points, faces[:, [0, 2, 1]]), hashes)
    np.testing.assert_array_equal(hashes_of(points, faces[:, [1, 2, 0]]), hashes)
    np.testing.assert_array_equal(hashes_of(points, faces[order]), hashes[order])
    quarter = points[:, [1, 0, 2]] * [-1, 1, 1]
    np.testing.assert_array_equal(hashes_of(quarter, faces) >> 12, hashes >> 12)


def test_shape_hashes_tell_places_apart() -> None:
    """Equal triangles on a square lattice: nearly all hashes differ."""
    n = 16
    points = np.array(list(product(range(n + 1), repeat=2)))
    points = np.column_stack((points * 100, points.sum(axis=1) % 3))
    at = np.arange(n * n) // n * (n + 1) + np.arange(n * n) % n
    faces = np.column_stack((at, at + n + 1, at + 1)).astype(np.uint32)
    hashes = hashes_of(points, faces)
    assert len(np.unique(hashes)) > 0.99 * len(hashes)


def plain_growth(built: Built, seeds: list[int], numerator: int, denominator: int) -> list[int]:
    """Grow planes with integers: |n . (x - a)| <= tolerance |n|, squared."""
    points, faces = built.points, built.repaired.mesh.faces
    corners = [[points[v].tolist() for v in face] for face in faces]
    normals = [exact_normal(*c) for c in corners]
    mate = built.repaired.mate.tolist()
    seed_of_face = [-1] * len(faces)

    def fits(seed: int, g: int) -> bool:
        n = normals[seed]
        if sum(x * y for x, y in zip(n, normals[g], strict=True)) <= 0:
            return False
        limit = numerator**2 * sum(x * x for x in n)
        for p in corners[g]:
            d = sum(x * (y - z) for x, y, z in zip(n, p, corners[seed][0], strict=True))
            if (denominator * d) ** 2 > limit:
                return False
        return True

    for seed in seeds:
        if seed_of_face[seed] >= 0:
            continue
        seed_of_face[seed] = seed
        stack = [seed]
        while stack:
            f = stack.pop()
            for other in mate[3 * f : 3 * f + 3]:
                if other >= 0 and seed_of_face[other // 3] < 0 and fits(seed, other // 3):
                    seed_of_face[other // 3] = seed
                    stack.append(other // 3)
    return seed_of_face


def check_growth(built: Built, seed: int, numerator: int, denominator: int) -> None:
    n = len(built.repaired.mesh.faces)
    seeds = np.random.default_rng(seed).permutation(n).astype(np.int32)
    grown = np.full(n, -1, np.int32)
    faces = built.repaired.mesh.faces
    normals = normals_of(built.points, faces)
    tolerance = numerator / denominator
    mate, any_tilt = built.repaired.mate, math.pi / 2
    grow_planes(built.points, faces, normals, mate, seeds, tolerance, any_tilt, grown)
    assert grown.tolist() == plain_growth(built, seeds.tolist(), numerator, denominator)


def test_grow_planes() -> None:
    for name, make in SMALL_SUITE.items():
        built = build(make())
        if name != "nothing":
            largest = int(np.abs(built.points).max())
            for seed, share in enumerate((0, 7, 40, 200)):
                # An odd tolerance, so that no distance is equal to it.
                check_growth(built, seed, largest * share // 100 * 2 + 1, 2)


def test_grow_planes_on_a_curved_surface() -> None:
    built = build(sphere(12, 20, 512.0))
    for seed, share in enumerate((1, 4, 16, 64)):
        check_growth(built, seed, int(np.abs(built.points).max()) // share // 8 * 2 + 1, 2)
