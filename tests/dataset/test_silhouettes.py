"""Silhouettes of every file: all methods equal the float64 twin, and volumes are closed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svprep.model import EdgeFlag, EdgeKind, Prepared
from svprep.reference import (
    SilhouetteRows,
    SilhouetteTwin,
    build_hextree,
    edge_buffer,
    eliminate_edges,
    visit_hextree,
)
from svprep.silhouette import METHODS, Silhouette, silhouette
from tests.dataset.datasets import build, buildable_files, label
from tests.dataset.lights import KINDS, TIES, hard_lights

FILES = buildable_files()
LIGHTS = 200
LIGHTS_OF_LARGE = 20
LARGE = {
    "broken/ogre.obj.gz",
    "cities/monastery.obj.gz",
    "cities/openfoam_buildings.obj.gz",
    "cities/wageningen_7-624-528",
}
"""Files of more than `MOST_FACES`: only --long tries all the lights. Their ids say so."""
MOST_FACES = 100_000


class Case:
    """A file, its twin and its lights."""

    def __init__(self, prepared: Prepared, n_lights: int) -> None:
        self.prepared = prepared
        self.twin = SilhouetteTwin(prepared)
        self.lights = hard_lights(prepared, n_lights)
        self.n_objects = len(prepared.object_names)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each test of a `case` on every file, with as many lights as its size allows."""
    if "case" not in metafunc.fixturenames:
        return
    is_long = metafunc.config.getoption("--long")
    few = [label(p) in LARGE and not is_long for p in FILES]
    ids = [
        f"{label(p)}: {LIGHTS_OF_LARGE} of {LIGHTS} lights" if is_few else label(p)
        for p, is_few in zip(FILES, few, strict=True)
    ]
    counts = [LIGHTS_OF_LARGE if is_few else LIGHTS for is_few in few]
    wanted = list(zip(FILES, counts, strict=True))
    metafunc.parametrize("case", wanted, ids=ids, indirect=True, scope="module")


@pytest.fixture(scope="module")
def case(request: pytest.FixtureRequest) -> Case:
    """Yield each file in turn, built."""
    path, n_lights = request.param
    outcome = build(path)
    assert not isinstance(outcome, str), outcome
    n_faces = len(outcome.prepared.mesh.faces)
    assert (n_faces > MOST_FACES) == (label(path) in LARGE), f"{n_faces} faces: correct LARGE"
    return Case(outcome.prepared, n_lights)


def assert_equal(result: Silhouette, expected: SilhouetteRows, light: np.ndarray) -> None:
    """Check a result against the twin's, dtypes included."""
    where = f"{result.method}, light {light.tolist()}"
    for name, dtype in (("edge", np.uint32), ("multiplicity", np.int8), ("object_start", np.int64)):
        found, wanted = getattr(result, name), getattr(expected, name)
        assert found.dtype == dtype, f"{where}: {name} is {found.dtype}"
        assert np.array_equal(found, wanted), f"{where}: {name} differs"


def test_lights_tie(case: Case) -> None:
    """The lights that are meant to lie in a plane do."""
    kinds = [KINDS[i % len(KINDS)] for i in range(len(case.lights))]
    for light, kind in zip(case.lights, kinds, strict=True):
        assert np.isfinite(light).all()
        if kind in TIES:
            assert (case.twin.facing(light) == 0).any(), f"{kind}: {light.tolist()}"


def test_every_method_finds_the_silhouette(case: Case) -> None:
    found = 0
    for light in case.lights:
        expected = case.twin.rows(light)
        found += len(expected.edge)
        for method in METHODS:
            assert_equal(silhouette(case.prepared, light, method), expected, light)
    assert found > 0, "no light found any silhouette: the test would prove nothing"


def test_every_method_obeys_a_forced_volume(case: Case) -> None:
    for light in case.lights[-2 * len(KINDS) :: 1 if len(case.lights) == LIGHTS else 4]:
        for volume in ("closed", "robust"):
            expected = case.twin.rows(light, volume)
            for method in METHODS:
                result = silhouette(case.prepared, light, method, volume=volume)
                assert_equal(result, expected, light)


def test_every_method_finds_the_silhouette_of_some_objects(case: Case) -> None:
    rng = np.random.default_rng(5)
    for turn, light in enumerate(case.lights[: len(KINDS)]):
        sizes = (0, 1, int(rng.integers(1, case.n_objects + 1)))
        objects = rng.choice(case.n_objects, sizes[turn % 3], replace=False)
        expected = case.twin.rows(light, objects=objects)
        for method in METHODS:
            result = silhouette(case.prepared, light, method, objects=objects)
            assert_equal(result, expected, light)
            assert np.array_equal(result.objects, np.sort(objects))


class Boundary:
    """Sums over the undirected edges of each component, straight from its triangles."""

    def __init__(self, prepared: Prepared) -> None:
        mesh, rows = prepared.mesh, prepared.edges.rows.astype(np.int64)
        self.n_vertices = len(mesh.positions)
        components = prepared.components
        n_components = len(components.flags)
        assert n_components * self.n_vertices**2 < 2**63
        self.component_of_face = np.repeat(np.arange(n_components), np.diff(components.face_start))
        self.component_of_row = np.repeat(np.arange(n_components), np.diff(components.edge_start))
        start = mesh.faces.astype(np.int64)
        end = start[:, [1, 2, 0]]
        lo, hi = np.minimum(start, end), np.maximum(start, end)
        key = self._key(self.component_of_face[:, None], lo, hi).reshape(-1)
        self.order = np.argsort(key, kind="stable")
        key = key[self.order]
        self.first = np.flatnonzero(np.diff(key, prepend=-1))
        self.sign = np.where(start < end, 1, -1).reshape(-1)[self.order]
        self.edge_of_row = np.searchsorted(
            key[self.first], self._key(self.component_of_row, rows[:, 0], rows[:, 1])
        )
        # Vertices, too, once for each component that they are in.
        ends = self.component_of_row[:, None] * self.n_vertices + rows[:, :2]
        self.n_ends, self.ends = self._number(ends)

    def _key(self, component: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
        return (component * self.n_vertices + lo) * self.n_vertices + hi

    @staticmethod
    def _number(keys: np.ndarray) -> tuple[int, np.ndarray]:
        different, number = np.unique(keys, return_inverse=True)
        return len(different), number.reshape(keys.shape)

    def of_cap(self, orientation: np.ndarray) -> np.ndarray:
        """Return the boundary of faces, each as often and turned as `orientation` says.

        A face that runs lo -> hi along an edge adds its orientation there.
        """
        terms = self.sign * orientation[self.order // 3]
        return np.add.reduceat(terms, self.first)

    def of_sides(self, edge: np.ndarray, multiplicity: np.ndarray) -> np.ndarray:
        """Return the sum of the sides' edges beside the cap: v1 -> v0 where m > 0."""
        sums = np.bincount(self.edge_of_row[edge], -multiplicity.astype(float), len(self.first))
        return sums.astype(np.int64)

    def at_vertices(self, edge: np.ndarray, multiplicity: np.ndarray) -> np.ndarray:
        """Return what ends at each vertex of each component, less what begins there."""
        v0, v1 = self.ends[edge].T
        m = multiplicity.astype(float)
        return np.bincount(v1, m, self.n_ends) - np.bincount(v0, m, self.n_ends)


def test_sides_and_caps_are_closed(case: Case) -> None:
    """The light cap's boundary is cancelled by the sides, edge by edge and component by component.

    The dark cap is the light cap turned round, and at its end of each side the
    same edge runs the other way: so it is closed as well.
    """
    boundary = Boundary(case.prepared)
    for light in case.lights:
        result = silhouette(case.prepared, light)
        assert not boundary.at_vertices(result.edge, result.multiplicity).any()
        facing = case.twin.facing(light).astype(np.int64)
        is_closed = case.twin.is_closed(light)[boundary.component_of_face]
        cap = boundary.of_cap(np.where(is_closed, facing == 1, facing))
        sides = boundary.of_sides(result.edge, result.multiplicity)
        assert not (cap + sides).any(), f"light {light.tolist()}"


def test_the_published_hextree_finds_every_pair(case: Case) -> None:
    edges = case.prepared.edges
    is_indexed = edges.flags & np.uint8(EdgeFlag.KIND_MASK) == EdgeKind.PAIR
    is_indexed &= edges.flags & np.uint8(EdgeFlag.PLANAR) == 0
    tree = build_hextree(case.prepared)
    assert tree.n_edges == is_indexed.sum()
    for light in case.lights[:20]:
        visit = visit_hextree(tree, light)
        assert is_indexed[visit.edge].all()
        assert (np.diff(visit.edge.astype(np.int64)) > 0).all()
        m = case.twin.multiplicity(light, "robust")
        needed = np.flatnonzero(is_indexed & (m != 0))
        assert np.array_equal(visit.edge[m[visit.edge] != 0], needed), f"light {light.tolist()}"


@pytest.mark.parametrize("path", [p for p in FILES if p.parent.name == "conformance"], ids=label)
def test_walks_over_faces_find_the_silhouette(path: Path) -> None:
    """Edge elimination and the edge buffer as published, in plain Python: on small files."""
    outcome = build(path)
    assert not isinstance(outcome, str), outcome
    rows, components = outcome.prepared.edges.rows, outcome.prepared.components
    twin = SilhouetteTwin(outcome.prepared)
    for light in hard_lights(outcome.prepared, 2 * len(KINDS)):
        facing = twin.facing(light)
        is_closed = np.repeat(twin.is_closed(light), np.diff(components.face_start))
        expected = twin.rows(light)
        for walk in (eliminate_edges, edge_buffer):
            found = walk(rows, facing, is_closed)
            assert list(found) == expected.edge.tolist()
            assert list(found.values()) == expected.multiplicity.tolist()
