"""Winding, duplicates, splitting and components on meshes small enough to check by eye."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from svprep import reference
from svprep.defects import DEFECTS, Code
from svprep.model import ComponentFlag, EdgeFlag, EdgeKind, SourceMesh
from svprep.repair.split import EdgeGroups, connect, sort_stably
from svprep.repair.winding import signed_volumes, wind
from tests.property.meshes import (
    SUITE,
    Built,
    arrays,
    build,
    cube,
    double_sheet,
    fan,
    joined,
    moved,
    shuffled,
    side_by_side,
    source_mesh,
    sphere,
    strip_of_one_side,
    turned,
)

CLOSED, SOLID, INVERTED = ComponentFlag.CLOSED, ComponentFlag.SOLID, ComponentFlag.INVERTED


def count(built: Built, code: Code) -> int:
    return int(built.record.defect_counts[:, list(DEFECTS).index(code)].sum())


def flipped_sources(built: Built) -> list[int]:
    return sorted(built.repaired.mesh.source_face[built.record.flipped_faces].tolist())


def findings(built: Built, code: Code) -> list[int]:
    table = built.record.face_findings
    return table.source_face[table.code == code].tolist()


# Winding -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("flips", [[0], [11], [3, 5, 6], [0, 1, 2, 3, 4]])
def test_the_few_are_turned_to_agree_with_the_many(flips: list[int]) -> None:
    built = build(turned(cube(), np.array(flips)))
    assert flipped_sources(built) == flips
    assert built.components.flags.tolist() == [CLOSED | SOLID]
    assert count(built, Code.INVERTED_COMPONENT) == 0


@pytest.mark.parametrize("keep", [[0], [3, 5, 6]])
def test_a_closed_component_is_turned_outward_whatever_the_many_say(keep: list[int]) -> None:
    flips = [f for f in range(12) if f not in keep]
    built = build(turned(cube(), np.array(flips)))
    assert flipped_sources(built) == flips
    assert built.components.flags.tolist() == [CLOSED | SOLID | INVERTED]
    assert count(built, Code.INVERTED_COMPONENT) == 1
    expected = build(cube()).repaired.mesh
    mesh = built.repaired.mesh
    for face, wanted in zip(
        mesh.positions[mesh.faces], expected.positions[expected.faces], strict=True
    ):
        assert face.tolist() in [np.roll(wanted, k, axis=0).tolist() for k in range(3)]


def test_an_open_shell_follows_its_majority_and_is_not_turned_outward() -> None:
    inward = turned(SUITE["open shell"]())
    built = build(inward)
    assert flipped_sources(built) == []
    assert built.components.flags.tolist() == [0]
    for few in ([2, 4], [0], [0, 1, 2, 3, 10]):
        assert flipped_sources(build(turned(inward, np.array(few)))) == few
    for few in ([1], [0, 7]):
        many = [f for f in range(11) if f not in few]
        assert flipped_sources(build(turned(inward, np.array(many)))) == few


def test_a_tie_keeps_the_lowest_face() -> None:
    square = source_mesh(
        np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    assert flipped_sources(build(square)) == []
    assert flipped_sources(build(turned(square, np.array([1])))) == [1]
    assert flipped_sources(build(turned(square, np.array([0])))) == [1]
    assert flipped_sources(build(turned(square))) == []


@pytest.mark.parametrize("turn", [False, True])
def test_a_component_of_two_minds_is_not_called_inverted(turn: bool) -> None:
    """Half of its faces look inward: they are turned, whichever half has the lowest face."""
    flips = list(range(0, 12, 2) if turn else range(1, 12, 2))
    built = build(turned(cube(), np.array(flips)))
    assert flipped_sources(built) == flips
    assert built.components.flags.tolist() == [CLOSED | SOLID]


def test_winding_does_not_cross_crowded_edges_or_objects() -> None:
    """Three leaves of a book, each wound as it came; two cubes, one of them inside out."""
    for turn in range(8):
        flips = np.array([f for f in range(3) if turn >> f & 1], int)
        assert flipped_sources(build(turned(fan(3), flips))) == []
    built = build(side_by_side(cube(), turned(cube())))
    assert flipped_sources(built) == list(range(12, 24))
    assert built.components.flags.tolist() == [CLOSED | SOLID, CLOSED | SOLID | INVERTED]
    inverted = built.record.defect_counts[:, list(DEFECTS).index(Code.INVERTED_COMPONENT)]
    assert inverted.tolist() == [0, 1]


def test_a_cavity_is_a_solid_of_its_own() -> None:
    """A hole in a block casts the block's shadow: both shells count outward."""
    built = build(SUITE["cavity"]())
    assert flipped_sources(built) == list(range(12, 24))
    assert built.components.flags.tolist() == [CLOSED | SOLID, CLOSED | SOLID | INVERTED]


@pytest.mark.parametrize("n", [3, 5, 8])
def test_a_one_sided_strip_is_cut_once(n: int) -> None:
    for seed in range(4):
        built = build(shuffled(strip_of_one_side(n), seed)[0])
        assert count(built, Code.CUT_EDGE) == 1
        assert built.components.flags.tolist() == [0]
        kind = built.edges.flags & int(EdgeFlag.KIND_MASK)
        assert (kind == EdgeKind.BORDER).sum() == 2 * n + 2
        assert (kind == EdgeKind.PAIR).sum() == 2 * n - 1
        cut = built.edges.rows[kind == EdgeKind.BORDER, :2]
        edges, times = np.unique(cut, axis=0, return_counts=True)
        assert (times == 2).sum() == 1
        # The tree is made of the longest edges, so the cut is the shortest it could be.
        points = built.points.astype(float)
        doubles = np.vstack((built.edges.rows[kind == EdgeKind.PAIR, :2], edges[times == 2]))
        length = np.linalg.norm(points[doubles[:, 1]] - points[doubles[:, 0]], axis=1)
        assert length[-1] == length.min()


def test_passes_end() -> None:
    """A turned cube pairs differently with its neighbour, so a second pass looks again."""
    assert build(cube()).report.n_passes == 1
    assert build(turned(cube())).report.n_passes == 1
    assert build(SUITE["touching, inside out"]()).report.n_passes == 2


def block(n: int) -> SourceMesh:
    """n^3 unit cubes, wall to wall."""
    return joined(*[moved(cube(), at) for at in product(map(float, range(n)), repeat=3)])


def volume_m3(built: Built) -> float:
    volume, _ = signed_volumes(
        built.points,
        built.repaired.mesh.faces,
        np.zeros(len(built.repaired.mesh.faces), bool),
        built.component_of_face.astype(np.int32),
        built.components.face_start[:-1].astype(np.int32),
    )
    return float(volume.sum()) * built.mesh.grid.step_m**3


def test_a_block_of_cubes_falls_into_its_cubes() -> None:
    built = build(block(3))
    assert built.components.flags.tolist() == [CLOSED | SOLID] * 27
    assert volume_m3(built) == 27.0
    built = build(turned(block(2)))
    assert (built.components.flags & SOLID != 0).tolist() == [True] * 8
    assert volume_m3(built) == 8.0


def test_a_block_of_inward_cubes_mostly_falls_into_its_cubes() -> None:
    """Admitted: pairs of inward walls enclose the gaps between cubes, and turning them
    makes some walls equal, of which one goes. The robust volume takes what is left open."""
    built = build(turned(block(3)))
    assert built.report.n_passes <= 4
    assert (built.components.flags & SOLID != 0).sum() >= 22
    assert count(built, Code.DUPLICATE_FACE) <= 12


def test_cubes_wound_against_each_other_share_their_wall() -> None:
    """Admitted: their walls are equal faces, so one goes and the later cube is open."""
    one, other = cube(), turned(moved(cube(), (1, 0, 0)))
    built = build(joined(one, other))
    assert (built.components.flags & SOLID != 0).tolist() == [True, False]
    assert count(built, Code.DUPLICATE_FACE) == 2


def test_wind_leaves_its_input_alone() -> None:
    built = build(turned(joined(cube(), moved(cube(), (1, 0, 0))), np.array([3, 8, 20])))
    before = built.mesh.faces.copy()
    winding = wind(built.mesh, built.points)
    np.testing.assert_array_equal(built.mesh.faces, before)
    assert winding.is_kept.sum() == len(built.repaired.mesh.faces)


# Duplicates --------------------------------------------------------------------------------------


@pytest.mark.parametrize("rotation", range(3))
def test_the_first_of_equal_faces_stays(rotation: int) -> None:
    mesh = SUITE["tetrahedron"]()
    again = np.roll(mesh.faces[[2, 0]], rotation, axis=1)
    built = build(source_mesh(mesh.positions, np.vstack((mesh.faces, again))))
    assert findings(built, Code.DUPLICATE_FACE) == [4, 5]
    assert built.repaired.mesh.source_face.tolist() == [0, 1, 2, 3]
    assert built.components.flags.tolist() == [CLOSED | SOLID]
    assert count(built, Code.OPPOSITE_FACE) == 0


def test_duplicates_are_listed_by_source_face_and_object() -> None:
    """Behind faces without area, so that no two numberings agree."""
    cube_again = source_mesh(
        cube().positions, np.vstack(([[0, 0, 1], [0, 1, 1]], cube().faces, cube().faces[5:7]))
    )
    built = build(side_by_side(cube_again, cube_again))
    table = built.record.face_findings
    listed = zip(
        table.object_index.tolist(), table.code.tolist(), table.source_face.tolist(), strict=True
    )
    flat, twice = int(Code.DEGENERATE_FACE), int(Code.DUPLICATE_FACE)
    assert list(listed) == [
        *[(0, flat, 0), (0, flat, 1), (0, twice, 14), (0, twice, 15)],
        *[(1, flat, 16), (1, flat, 17), (1, twice, 30), (1, twice, 31)],
    ]
    assert built.components.flags.tolist() == [CLOSED | SOLID] * 2


def test_opposite_faces_stay() -> None:
    built = build(double_sheet())
    assert len(built.repaired.mesh.faces) == 4
    assert findings(built, Code.DUPLICATE_FACE) == []
    assert count(built, Code.OPPOSITE_FACE) == 2
    assert count(built, Code.FLAT_COMPONENT) == 1
    assert built.components.flags.tolist() == [CLOSED]


def test_equal_faces_of_different_objects_stay() -> None:
    built = build(side_by_side(cube(), cube()))
    assert len(built.repaired.mesh.faces) == 24
    assert built.record.defect_counts.sum() == 0


def test_a_large_curved_double_sheet_is_no_solid() -> None:
    """Its volume cancels to rounding; whatever its sign, no closed volume may use it."""
    mesh = sphere(60, 80, 100_000.0)
    half = mesh.faces[(mesh.positions[mesh.faces, 2] >= 0).all(axis=1)]
    built = build(source_mesh(mesh.positions, np.vstack((half, half[::-1, ::-1]))))
    assert not (built.components.flags & SOLID).any()


# Splitting ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("where", ["along a wall", "along an edge", "at a corner"])
def test_touching_cubes_keep_their_own_pairs(where: str) -> None:
    built = build(SUITE[f"touching {where}"]())
    assert built.components.flags.tolist() == [CLOSED | SOLID] * 2
    sources = [built.repaired.mesh.source_face[built.faces_of(i)] for i in range(2)]
    assert [s.tolist() for s in sources] == [list(range(12)), list(range(12, 24))]


@pytest.mark.parametrize("seed", range(6))
def test_touching_cubes_are_told_apart_in_any_order(seed: int) -> None:
    for name in ("touching along a wall", "touching along an edge", "touching, inside out"):
        source, old = shuffled(SUITE[name](), seed)
        built = build(source)
        assert (built.components.flags & SOLID != 0).tolist() == [True, True]
        assert sorted(np.diff(built.components.face_start).tolist()) == [12, 12]
        if name == "touching along an edge":
            cubes = built.repaired.mesh.source_face // 12
            for i in range(2):
                assert len(np.unique(cubes[built.faces_of(i)])) == 1
    assert len(old) == 24


def test_an_inner_wall_leaves_the_building_solid() -> None:
    """Whichever way the wall is wound, it is left out, and the envelope pairs with itself."""
    for flips in ([], [12, 13]):
        built = build(turned(SUITE["inner wall"](), np.array(flips, int)))
        solid = (built.components.flags & SOLID) != 0
        size = np.diff(built.components.face_start)
        assert sorted(zip(solid.tolist(), size.tolist(), strict=True)) == [(False, 2), (True, 12)]
        assert count(built, Code.NONMANIFOLD_EDGE) == 4


def test_left_over_faces_keep_single_records() -> None:
    """A fan of three, two wound one way: a pair and one left over, both SPLIT."""
    built = build(fan(3))
    rows = built.edges.rows[built.edges.flags & int(EdgeFlag.KIND_MASK) == EdgeKind.SPLIT]
    assert len(rows) == 2
    n_faces = (rows[:, 2:] < 3).sum(axis=1)
    assert sorted(n_faces.tolist()) == [1, 2]
    one_way = source_mesh(fan(3).positions, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))
    rows = build(one_way).edges.rows
    assert ((rows[:, 2:] < 3).sum(axis=1) == 1).all()
    assert len(rows) == 9


# Components --------------------------------------------------------------------------------------


@given(st.data(), st.integers(0, 20))
def test_connect(data: st.DataObject, n_faces: int) -> None:
    mate = np.full(3 * n_faces, -1, np.int32)
    half_edges = data.draw(st.permutations(range(3 * n_faces)))
    n_pairs = data.draw(st.integers(0, 3 * n_faces // 2))
    for i in range(n_pairs):
        a, b = half_edges[2 * i], half_edges[2 * i + 1]
        mate[a], mate[b] = b, a
    # As if all sides met in one edge: pairs at edges of two are known already.
    every = np.arange(3 * n_faces, dtype=np.int32)
    groups = EdgeGroups(order=every, start=np.array([0, len(every)], np.int64))
    root = connect(mate, np.arange(n_faces, dtype=np.int32), groups)
    expected = reference.components(mate)
    assert root.tolist() == [expected.index(i) for i in expected]


@given(arrays(np.int32, st.integers(0, 40), elements=st.integers(0, 6)))
def test_sort_stably(keys: np.ndarray) -> None:
    order, start = sort_stably(keys, 7)
    np.testing.assert_array_equal(order, np.argsort(keys, kind="stable"))
    assert np.diff(start).tolist() == np.bincount(keys, minlength=7).tolist()
