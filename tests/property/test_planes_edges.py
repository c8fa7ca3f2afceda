"""Plane records and edge records: tolerance without drift, one facing, every sum."""

from __future__ import annotations

import math
from collections import defaultdict
from fractions import Fraction

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from svprep import reference
from svprep.edges import build_edges
from svprep.errors import CacheError, InputError
from svprep.facing import facing
from svprep.model import EdgeFlag, Grid, PlaneTable, SourceMesh
from svprep.planes import build_planes, default_planar_tolerance_m
from svprep.repair.stage import Repaired, repair
from svprep.repair.weld import weld
from tests.property.meshes import (
    SMALL_SUITE,
    SUITE,
    any_mesh,
    arrays,
    build,
    lights,
    shuffled,
    source_mesh,
    sphere,
    turned,
)


@st.composite
def height_fields(draw: st.DrawFn) -> SourceMesh:
    """A sheet of 2 n^2 triangles over a square lattice, nearly flat."""
    n = draw(st.integers(2, 6), label="n")
    spacing = draw(st.sampled_from([1, 8, 64]), label="spacing")
    z = draw(hnp.arrays(np.int64, (n, n), elements=st.integers(0, 3), fill=st.just(0)), label="z")
    x, y = np.mgrid[:n, :n] * spacing
    at = np.arange(n * n).reshape(n, n)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    faces = np.stack((np.stack((a, b, c), -1), np.stack((a, c, d), -1)), 2).reshape(-1, 3)
    flips = draw(hnp.arrays(bool, len(faces), fill=st.just(False)), label="flips")
    return turned(source_mesh(np.column_stack((x.flat, y.flat, z.flat)), faces), flips)


TOLERANCES_M = st.sampled_from([2.0**-20, 0.125, 0.5, 1.0, 1.5, 4.0])


def check_records(repaired: Repaired, table: PlaneTable) -> None:
    """Each record is the plane of its largest face, near all its faces, and connected."""
    mesh = repaired.mesh
    steps = (mesh.positions.astype(np.float64) / mesh.grid.step_m).astype(np.int64)
    tolerance = Fraction(table.tolerance_m) / Fraction(mesh.grid.step_m)
    members = defaultdict(list)
    for f, p in enumerate(table.plane_of_face.tolist()):
        members[p].append(f)
    assert sorted(members) == list(range(len(table.planes)))
    lowest = [faces[0] for _, faces in sorted(members.items())]
    assert lowest == sorted(lowest), "records are not numbered by their lowest face"

    for p, own in members.items():
        normals = {}
        for f in own:
            a, b, c = steps[mesh.faces[f]].tolist()
            normals[f] = _cross(_minus(b, a), _minus(c, a))
        record = table.planes[p].tolist()
        area = mesh.grid.step_m**2
        of_record = [f for f, n in normals.items() if [x * area for x in n] == record[:3]]
        assert of_record, f"record {p} is no face's plane"
        n = normals[of_record[0]]
        largest = max(_dot(m, m) for m in normals.values())
        assert largest <= _dot(n, n) * (1 + 2**-22)  # areas are compared in float32
        # One of those faces is the seed: its own plane, exactly, is within reach of all.
        offsets = {_dot(n, steps[mesh.faces[f, 0]].tolist()) for f in of_record}
        assert any(
            all(
                (_dot(n, steps[v].tolist()) - offset) ** 2 <= (tolerance**2 * _dot(n, n))
                for f in own
                for v in mesh.faces[f]
            )
            for offset in offsets
        )
        assert all(_dot(n, m) > 0 for m in normals.values())
        d = -(Fraction(mesh.grid.step_m) ** 3) * min(offsets, key=lambda x: abs(x))
        if len(offsets) == 1:
            assert abs(Fraction(record[3]) - d) <= abs(d) * Fraction(2) ** -50

        reached, stack, mine = {own[0]}, [own[0]], set(own)
        while stack:
            for other in repaired.mate[3 * stack[-1] : 3 * stack.pop() + 3].tolist():
                if other >= 0 and other // 3 in mine - reached:
                    reached.add(other // 3)
                    stack.append(other // 3)
        assert reached == mine, f"record {p} is not connected over pairs"
    if len(mesh.faces):
        worst = reference.check_planes(
            mesh.positions, mesh.faces, table.planes, table.plane_of_face
        )
        assert worst.max() <= table.tolerance_m * (1 + 1e-9) + 1e-9 * mesh.grid.step_m


def _minus(a: list[int], b: list[int]) -> list[int]:
    return [x - y for x, y in zip(a, b, strict=True)]


def _cross(a: list[int], b: list[int]) -> list[int]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _dot(a: list[int], b: list[int]) -> int:
    return sum(x * y for x, y in zip(a, b, strict=True))


@given(height_fields(), TOLERANCES_M)
@settings(max_examples=120)
def test_every_corner_lies_near_its_record(source: SourceMesh, tolerance_m: float) -> None:
    repaired, _ = repair(weld(source)[0])
    check_records(repaired, build_planes(repaired, tolerance_m))


@given(any_mesh())
@settings(max_examples=60)
def test_every_corner_of_random_meshes_lies_near_its_record(source: SourceMesh) -> None:
    built = build(source)
    check_records(built.repaired, built.planes)


@pytest.mark.parametrize("name", SMALL_SUITE)
def test_every_corner_of_the_suite_lies_near_its_record(name: str) -> None:
    built = build(SMALL_SUITE[name]())
    for tolerance_m in (None, 0.25, 1.0):
        check_records(built.repaired, build_planes(built.repaired, tolerance_m))


@given(any_mesh())
@settings(max_examples=80)
def test_on_small_grids_planar_is_exactly_coplanar(source: SourceMesh) -> None:
    """The default tolerance is far below one unit, so it neither adds nor misses any."""
    built = build(source)
    points, faces = built.points.astype(np.int64).tolist(), built.repaired.mesh.faces.tolist()
    for (_, _, left, right), flags in zip(
        built.edges.rows.tolist(), built.edges.flags.tolist(), strict=True
    ):
        is_coplanar = False
        if left < len(faces) and right < len(faces):
            a, b, c = (points[v] for v in faces[left])
            d, e, f = (points[v] for v in faces[right])
            n, m = _cross(_minus(b, a), _minus(c, a)), _cross(_minus(e, d), _minus(f, d))
            is_coplanar = not any(_cross(n, m)) and _dot(n, m) > 0
        assert bool(flags & EdgeFlag.PLANAR) == is_coplanar


def curved_strip(n: int, sagitta: int) -> SourceMesh:
    """n quads along x whose heights follow ``sagitta * i^2 / 2``: a slow, even curve."""
    i = np.arange(n + 1)
    rim = np.column_stack((64 * i, np.zeros(n + 1), sagitta * i * i / 2))
    vertices = np.vstack((rim, rim + (0, 32, 0)))
    a, b = i[:-1], i[1:]
    c, d = b + n + 1, a + n + 1
    faces = np.vstack((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    return source_mesh(vertices, faces)


def test_a_slow_curve_does_not_drift() -> None:
    """Neighbours differ by less than the tolerance; 64 of them do not share a plane."""
    repaired, _ = repair(weld(curved_strip(64, 1))[0])
    table = build_planes(repaired, 1.25, math.pi / 2)
    check_records(repaired, table)
    # Within 1.25 m of one quad's plane lies a quad or two either side of it.
    sizes = np.bincount(table.plane_of_face)
    assert 2 <= sizes.max() <= 6
    assert len(table.planes) >= 20


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["height field", "cylinder", *SUITE])
def test_records_do_not_depend_on_the_order_of_faces(name: str, seed: int) -> None:
    tolerance_m = None
    if name == "height field":
        rng = np.random.default_rng(11)
        x, y = np.mgrid[:12, :12] * 16
        at = np.arange(144).reshape(12, 12)
        a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
        faces = np.stack((np.stack((a, b, c), -1), np.stack((a, c, d), -1)), 2).reshape(-1, 3)
        z = rng.integers(0, 3, 144)
        source = source_mesh(np.column_stack((x.flat, y.flat, z)), faces)
        tolerance_m = 1.5
    elif name == "cylinder":
        source, tolerance_m = sphere(8, 48, 2000.0), 30.0
    else:
        source = SUITE[name]()

    one, other = records(source, tolerance_m), records(shuffled(source, seed)[0], tolerance_m)
    # Which of coincident faces stays may differ where an edge has more than two.
    crowded = (build(source).repaired.groups.n_faces_of_edge > 2).any()
    if not crowded:
        assert one.keys() == other.keys()
    for face in one.keys() & other.keys():
        np.testing.assert_array_equal(one[face][:3], other[face][:3])
        # d is rounded, and not from the same corner.
        assert one[face][3] == pytest.approx(other[face][3], rel=2.0**-48, abs=2.0**-48)


def records(source: SourceMesh, tolerance_m: float | None) -> dict[int, np.ndarray]:
    """Each source face's plane record, as if its face had never been turned."""
    repaired, report = repair(weld(source)[0])
    table = build_planes(repaired, tolerance_m)
    planes = table.planes[table.plane_of_face]
    planes[report.flipped_faces] *= -1
    return dict(zip(repaired.mesh.source_face.tolist(), planes, strict=True))


def test_default_tolerance() -> None:
    def at(step: float) -> float:
        return default_planar_tolerance_m(Grid(step, np.zeros(3)))

    assert at(2.0**-24) == 2.0**-20
    assert at(2.0**-11) == 4 * 2.0**-11
    assert at(2.0**-13) == 1e-3
    assert at(2.0**-4) == 0.25


# Facing ------------------------------------------------------------------------------------------

small = st.integers(-1000, 1000).map(float)


@given(arrays(np.float64, (20, 4), elements=small), lights())
def test_facing_equals_its_twin(planes: np.ndarray, light: np.ndarray) -> None:
    """Coordinates of few bits, so that float64 does not round and ties are ties."""
    light = np.array([*np.round(light[:3] * 16) / 16, light[3]], np.float32)
    found = facing(planes, light)
    assert found.dtype == np.int8
    assert found.tolist() == [reference.facing(p, light) for p in planes]


@given(
    arrays(np.float64, (20, 4), elements=st.floats(-1e6, 1e6)),
    arrays(np.float32, 3, elements=st.floats(-1e4, 1e4, width=32)),
    st.booleans(),
)
def test_facing_is_right_above_rounding(
    planes: np.ndarray, xyz: np.ndarray, is_point: bool
) -> None:
    assume(is_point or xyz.any())  # (0, 0, 0, 0) is no light
    light = np.array([*xyz, is_point], np.float32)
    terms = planes * light.astype(float)
    is_clear = np.abs(terms.sum(axis=1)) > 1e-12 * np.abs(terms).sum(axis=1)
    expected = [reference.facing(p, light) for p in planes]
    np.testing.assert_array_equal(facing(planes, light)[is_clear], np.array(expected)[is_clear])


@pytest.mark.parametrize(
    "light",
    [
        [1, 2, 3],
        [1, 2, 3, 0.5],
        [np.nan, 0, 1, 0],
        [0, 0, np.inf, 1],
        [[1, 2, 3, 0]],
        [0, 0, 0, 0],
    ],
)
def test_what_is_no_light_is_refused(light: list[float]) -> None:
    with pytest.raises(InputError, match=r"a light is four finite numbers|names no direction"):
        facing(np.ones((1, 4)), np.array(light, np.float32))


def test_one_facing_for_both_sides_of_a_planar_edge() -> None:
    """A light in the very plane of a bent quad: its halves share the record's answer."""
    source = source_mesh(
        np.array([[0, 0, 0], [64, 0, 0], [64, 64, 1], [0, 64, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    repaired, _ = repair(weld(source)[0])
    table = build_planes(repaired, 1.0, math.pi / 2)
    edges, _ = build_edges(repaired, table)
    assert len(table.planes) == 1
    assert (edges.flags & EdgeFlag.PLANAR != 0).sum() == 1
    for xyz in ([1, 0, 0], [0, 1, 0], [1, 0, 1 / 64], [64, 0, -1]):
        s = facing(table.planes, np.array([*xyz, 0], np.float32))[table.plane_of_face]
        assert s[0] == s[1]


# Edge sums ---------------------------------------------------------------------------------------


def test_sums_of_no_faces() -> None:
    sums = reference.EdgeSums(np.zeros((0, 3), np.uint32))
    nothing = np.zeros(0, np.int8)
    assert sums.n_edges == 0
    assert sums.edges.shape == (0, 2)
    assert sums.of_triangles(nothing).shape == (0,)
    assert sums.of_rows(np.zeros((0, 4), np.uint32), nothing).shape == (0,)


def test_sums_of_a_lone_pair() -> None:
    """m is 2 across a ridge, 0 where neighbours agree, and turning a face keeps it."""
    faces = np.array([[0, 1, 2], [1, 0, 3]], np.uint32)
    sums = reference.EdgeSums(faces)
    assert sums.edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3]]
    assert sums.of_triangles(np.array([1, 1])).tolist() == [0, -1, 1, 1, -1]
    assert sums.of_triangles(np.array([1, -1])).tolist() == [2, -1, -1, 1, 1]
    other_way = reference.EdgeSums(np.array([[0, 1, 2], [0, 1, 3]], np.uint32))
    assert other_way.of_triangles(np.array([1, 1])).tolist() == [2, -1, -1, 1, 1]


@pytest.mark.parametrize("row", [[0, 4, 0, 1], [3, 4, 0, 1], [2, 3, 0, 1], [0, 9, 0, 1]])
def test_a_record_on_no_edge_is_named(row: list[int]) -> None:
    sums = reference.EdgeSums(np.array([[0, 1, 2], [1, 0, 3]], np.uint32))
    rows = np.array([[0, 1, 0, 1], row], np.uint32)
    with pytest.raises(CacheError, match="edge records 1 lie on edges that no triangle has"):
        sums.of_rows(rows, np.array([1, 1]))


@pytest.mark.parametrize("name", SUITE)
def test_a_wrong_record_is_seen(name: str) -> None:
    """Losing a record, or turning one, changes a sum for some light."""
    built = build(SUITE[name]())
    faces, rows = built.repaired.mesh.faces, built.edges.rows
    if not len(rows):
        return
    sums = reference.EdgeSums(faces)
    s = np.arange(len(faces)) % 2 * 2 - 1
    right = sums.of_triangles(s)
    m = s[np.minimum(rows[:, 2], len(s) - 1)] - s[np.minimum(rows[:, 3], len(s) - 1)]
    both = (rows[:, 2:] < len(faces)).all(axis=1)
    counted = np.flatnonzero(~both | (m != 0))
    lost = np.delete(rows, counted[0], axis=0)
    assert (sums.of_rows(lost, s) != right).any()
    changed = rows.copy()
    changed[counted[-1], 2:] = changed[counted[-1], [3, 2]]
    assert (sums.of_rows(changed, s) != right).any()


def test_a_steep_sliver_keeps_its_own_record() -> None:
    """A drip edge a millimetre high at a roof's rim: within the tolerance, but not its plane.

    Were it to face where the roof faces, a low sun behind it would find its
    volume inside out, and light would leak along the eave's shadow.
    """
    x, z = 20.0002, 9.9991
    roof = [[0, 0, 10], [20, 0, 10], [20, 20, 10], [0, 20, 10], [x, 0, z], [x, 20, z]]
    far = [[2000, 0, 0], [2001, 0, 0], [2000, 1, 0]]  # makes the grid as coarse as a city's
    faces = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2], [6, 7, 8]])
    source = source_mesh(np.array([*roof, *far], float), faces)
    built = build(source)
    mesh, table = built.repaired.mesh, built.planes
    assert table.tolerance_m >= 0.9e-3
    planes = table.plane_of_face[np.argsort(mesh.source_face)]
    assert planes[0] == planes[1]
    assert planes[2] == planes[3] != planes[0]
    altitude = np.radians(2.0)
    light = np.array([-np.cos(altitude), 0.0, np.sin(altitude), 0.0], np.float32)
    side = facing(table.planes, light)[table.plane_of_face]
    along = np.linspace(-1.0, 306.0, 400)
    ground = np.column_stack((along, np.full(400, 9.7), np.zeros(400))) - mesh.grid.origin_m
    a, b, c = (mesh.positions[mesh.faces[:, i]].astype(float) for i in range(3))
    own = np.sign(np.cross(b - a, c - a) @ light[:3].astype(float)).astype(int)
    truth = reference.volume_count(mesh.positions, mesh.faces, own, light, ground)
    ray = np.array([0.31, 0.77, 0.55])
    rows = built.edges.rows
    robust = reference.robust_count(mesh.positions, mesh.faces, rows, side, light, ground, ray)
    sure = truth.is_decidable & robust.is_decidable
    np.testing.assert_array_equal(robust.value[sure], truth.value[sure])
    assert (truth.value[sure] > 0).any()
