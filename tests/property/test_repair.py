"""Repair keeps every shadow: what weld, repair and edges say, against plain twins."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import svprep.parallel
from svprep import reference
from svprep.defects import DEFECTS, Code
from svprep.facing import facing as facing_of_planes
from svprep.model import NO_INDEX, ComponentFlag, EdgeFlag, EdgeKind, SourceMesh
from svprep.repair.stage import repair
from tests.property.meshes import (
    SMALL_SUITE,
    SUITE,
    Built,
    any_mesh,
    build,
    grid_meshes,
    joined,
    lights,
    moved,
    renumbered,
    shuffled,
    side_by_side,
    solids,
    source_mesh,
    sphere,
    turned,
    unwelded,
    voxel_meshes,
)

RAYS = np.array([[0.5773, 0.2137, 0.7881], [-0.3311, 0.8119, -0.4810], [0.1234, -0.7411, 0.6600]])
"""Directions in no special position to grid meshes."""


def facing_of_face(built: Built, light: np.ndarray) -> np.ndarray:
    """Each face's facing, from its plane record."""
    return facing_of_planes(built.planes.planes, light)[built.planes.plane_of_face]


def raw_of_repaired(built: Built) -> np.ndarray:
    """Each repaired face's number in the welded mesh, by its source face."""
    number = {s: i for i, s in enumerate(built.mesh.source_face.tolist())}
    return np.array([number[s] for s in built.repaired.mesh.source_face.tolist()], np.int64)


def is_flipped(built: Built) -> np.ndarray:
    flipped = np.zeros(len(built.repaired.mesh.faces), bool)
    flipped[built.report.flipped_faces] = True
    return flipped


def normalised(faces: np.ndarray) -> np.ndarray:
    """Rotate every face's lowest corner to the front."""
    shift = faces.argmin(axis=1)[:, None]
    return np.take_along_axis(faces, (np.arange(3) + shift) % 3, axis=1)


# Twins of the stages -----------------------------------------------------------------------------


def check_twins(source: SourceMesh) -> None:
    built = build(source)
    faces, n = built.repaired.mesh.faces, len(built.repaired.mesh.faces)
    mesh, dropped, merged = reference.weld(source)
    assert mesh.grid.step_m == built.mesh.grid.step_m
    np.testing.assert_array_equal(mesh.grid.origin_m, built.mesh.grid.origin_m)
    for name in ("positions", "faces", "object_vertex_start", "object_face_start", "source_face"):
        np.testing.assert_array_equal(getattr(mesh, name), getattr(built.mesh, name), name)
    assert sorted(dropped) == sorted(built.weld_report.dropped.source_face.tolist())
    assert merged == built.weld_report.welded_vertices.tolist()

    groups = reference.group_edges(faces)
    assert [h for group in groups.values() for h in group] == built.repaired.groups.order.tolist()
    sizes = [len(group) for group in groups.values()]
    assert sizes == built.repaired.groups.n_faces_of_edge.tolist()
    mate = reference.pair_edges(built.points, faces, np.zeros(n, bool))
    assert mate == built.repaired.mate.tolist()
    component = reference.components(built.repaired.mate)
    assert component == built.component_of_face.tolist()
    rows, flags = reference.edge_rows(
        faces, built.repaired.mate, built.component_of_face, built.planes.plane_of_face
    )
    np.testing.assert_array_equal(rows, built.edges.rows)
    np.testing.assert_array_equal(flags, built.edges.flags)


@pytest.mark.parametrize("name", SUITE)
def test_stages_equal_their_twins(name: str) -> None:
    check_twins(SUITE[name]())


@given(any_mesh())
@settings(max_examples=150)
def test_stages_equal_their_twins_on_random_meshes(source: SourceMesh) -> None:
    check_twins(source)


# What every table must satisfy -------------------------------------------------------------------


def check_tables(built: Built) -> None:
    faces, rows = built.repaired.mesh.faces, built.edges.rows
    n = len(faces)
    kind = built.edges.flags & int(EdgeFlag.KIND_MASK)
    is_planar = (built.edges.flags & int(EdgeFlag.PLANAR)) != 0

    # Every side of every face stands in exactly one record, on the side it winds.
    sides = Counter()
    for lo, hi, left, right in rows.tolist():
        assert lo < hi
        assert left != right
        for face, a, b in ((left, lo, hi), (right, hi, lo)):
            if face != NO_INDEX:
                corners = faces[face].tolist()
                c = corners.index(a)
                assert corners[(c + 1) % 3] == b, f"face {face} does not traverse {a} -> {b}"
                sides[face, c] += 1
    assert sides == Counter({(f, c): 1 for f in range(n) for c in range(3)})
    assert int((rows[:, 2:] != NO_INDEX).sum()) == 3 * n

    # Kinds say how many faces the edge has.
    sizes = {edge: len(group) for edge, group in reference.group_edges(faces).items()}
    has_two = (rows[:, 2:] != NO_INDEX).all(axis=1)
    for row, k, two in zip(rows.tolist(), kind.tolist(), has_two.tolist(), strict=True):
        size = sizes[row[0], row[1]]
        if size > 2:
            assert k == EdgeKind.SPLIT
        else:
            assert k == (EdgeKind.PAIR if two else EdgeKind.BORDER)
    # Planar is sharing a record.
    plane = np.append(built.planes.plane_of_face, NO_INDEX)
    shares = has_two & (plane[np.minimum(rows[:, 2], n)] == plane[np.minimum(rows[:, 3], n)])
    np.testing.assert_array_equal(is_planar, shares)

    # Grouped and sorted by (object, component, v0, v1, left).
    components, mesh = built.components, built.repaired.mesh
    for i in range(len(components.flags)):
        mine = built.rows_of(i).tolist()
        assert mine == sorted(mine)
        named = {f for row in mine for f in row[2:]} - {NO_INDEX}
        assert named == set(built.faces_of(i).tolist())
        is_closed = all(NO_INDEX not in row for row in mine)
        assert bool(components.flags[i] & ComponentFlag.CLOSED) == is_closed
    for o in range(len(mesh.object_face_start) - 1):
        first, last = components.object_start[o], components.object_start[o + 1]
        assert components.face_start[first] == mesh.object_face_start[o]
        assert components.face_start[last] == mesh.object_face_start[o + 1]
        own = faces[mesh.object_face_start[o] : mesh.object_face_start[o + 1]]
        begin, end = mesh.object_vertex_start[o], mesh.object_vertex_start[o + 1]
        assert np.array_equal(np.unique(own), np.arange(begin, end))
    assert components.edge_start[-1] == len(rows)

    # Vertices are numbered in the order in which the faces use them.
    used, first_corner = np.unique(faces, return_index=True)
    np.testing.assert_array_equal(used, np.arange(len(mesh.positions)))
    assert (np.diff(first_corner) > 0).all()

    # No face is there twice the same way; every one that went is accounted for.
    kept = normalised(faces)
    assert len(np.unique(kept, axis=0)) == n
    welded, old = built.welded_faces, raw_of_repaired(built)
    expected = welded[old]
    expected[is_flipped(built)] = expected[is_flipped(built)][:, [0, 2, 1]]
    np.testing.assert_array_equal(expected, faces)
    stays = {tuple(sorted(corners)) for corners in kept.tolist()}
    gone = set(range(len(welded))) - set(old.tolist())
    assert all(tuple(sorted(welded[f].tolist())) in stays for f in gone)
    source_faces = built.mesh.source_face[sorted(gone)].tolist()
    assert sorted(built.report.duplicates.source_face.tolist()) == sorted(source_faces)
    total = built.record.defect_counts.sum(axis=0)
    count = dict(zip(DEFECTS, total.tolist(), strict=True))
    assert count[Code.DUPLICATE_FACE] == len(gone)
    assert count[Code.FLIPPED_FACE] == len(built.report.flipped_faces)
    n_dropped = count[Code.DEGENERATE_FACE] + count[Code.COLLAPSED_FACE]
    assert len(built.source.faces) == n + len(gone) + n_dropped
    assert count[Code.NONMANIFOLD_EDGE] == sum(size > 2 for size in sizes.values())
    assert count[Code.OPEN_SHELL] == sum(size == 1 for size in sizes.values())
    n_border_rows = int((kind == EdgeKind.BORDER).sum())
    assert count[Code.OPEN_SHELL] + 2 * count[Code.CUT_EDGE] == n_border_rows


@pytest.mark.parametrize("name", SUITE)
def test_every_side_stands_in_one_record(name: str) -> None:
    check_tables(build(SUITE[name]()))


@given(any_mesh())
@settings(max_examples=150)
def test_every_side_stands_in_one_record_on_random_meshes(source: SourceMesh) -> None:
    check_tables(build(source))


# Multiplicities: repair changes no shadow --------------------------------------------------------


def check_multiplicities(built: Built, facing: np.ndarray) -> None:
    """Raw triangles, repaired triangles and records agree on m_e; volumes are closed."""
    faces, rows = built.repaired.mesh.faces, built.edges.rows
    raw_facing = np.where(is_flipped(built), -facing, facing)
    raw = reference.edge_multiplicity(built.welded_faces[raw_of_repaired(built)], raw_facing)
    by_rows = reference.multiplicity_of_rows(rows, facing)
    assert by_rows == raw

    sums = reference.EdgeSums(faces)
    edges = [tuple(edge) for edge in sums.edges.tolist()]
    assert dict(zip(edges, sums.of_triangles(facing).tolist(), strict=True)) == raw
    assert dict(zip(edges, sums.of_rows(rows, facing).tolist(), strict=True)) == raw
    again = sums.of_rows(rows, facing, sums.edge_of_rows(rows))
    assert dict(zip(edges, again.tolist(), strict=True)) == raw

    # Whatever each face's facing is, each component's sides form closed loops.
    for i in range(len(built.components.flags)):
        for s in (facing, np.maximum(facing, 0)):
            balance = Counter()
            for (lo, hi), m in reference.multiplicity_of_rows(built.rows_of(i), s).items():
                balance[lo] -= m
                balance[hi] += m
            assert not any(balance.values())


@given(any_mesh(), st.lists(lights(), min_size=3, max_size=3))
@settings(max_examples=100)
def test_multiplicities_survive_repair(source: SourceMesh, some: list[np.ndarray]) -> None:
    built = build(source)
    is_planar = (built.edges.flags & int(EdgeFlag.PLANAR)) != 0
    for light in some:
        facing = facing_of_face(built, light)
        check_multiplicities(built, facing)
        flat = reference.multiplicity_of_rows(built.edges.rows[is_planar], facing)
        assert not any(flat.values())


@given(any_mesh(), st.integers(0, 2**32 - 1))
@settings(max_examples=100)
def test_multiplicities_survive_repair_for_any_facing(source: SourceMesh, seed: int) -> None:
    built = build(source)
    rng = np.random.default_rng(seed)
    check_multiplicities(built, rng.integers(-1, 2, len(built.repaired.mesh.faces)))


@pytest.mark.parametrize("name", SUITE)
def test_multiplicities_survive_repair_of_the_suite(name: str) -> None:
    built = build(SUITE[name]())
    rng = np.random.default_rng(1)
    n = len(built.repaired.mesh.faces)
    for facing in (rng.integers(-1, 2, n), rng.integers(0, 2, n) * 2 - 1, np.ones(n, int)):
        check_multiplicities(built, facing)
    for light in rng.normal(size=(4, 4)).astype(np.float32):
        light[3] = light[0] > 0
        check_multiplicities(built, facing_of_face(built, light))


# Shadows: brute force against the volumes --------------------------------------------------------


def check_shadows(built: Built, light: np.ndarray, seed: int) -> None:
    """Count through every component's volumes and compare with faces in the way.

    Only points within the margin of `reference.volumes` (1e-9) of a decision
    are left out; nearly all must remain.
    """
    rng = np.random.default_rng(seed)
    mesh, components = built.repaired.mesh, built.components
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    x = rng.uniform(low - 0.5, high + 0.5, (30, 3))
    facing = facing_of_face(built, light)
    brute = reference.volume_count(mesh.positions, mesh.faces, facing, light, x)
    total = np.zeros(len(x), int)
    closed_total = np.zeros(len(x), int)
    sure = brute.is_decidable.copy()
    for i in range(len(components.flags)):
        own, rows = built.faces_of(i), built.rows_of(i)
        local = np.where(rows[:, 2:] == NO_INDEX, NO_INDEX, rows[:, 2:] - own[0])
        rows = np.column_stack((rows[:, :2], local)).astype(np.uint32)
        faces, s = mesh.faces[own], facing[own]
        expected = reference.volume_count(mesh.positions, faces, s, light, x)
        points = mesh.positions[faces].reshape(-1, 3)
        inside = ((light[:3] >= points.min(0)) & (light[:3] <= points.max(0))).all()
        use_closed = components.flags[i] & ComponentFlag.SOLID and not (light[3] and inside)
        for ray in RAYS[i % 2 : i % 2 + 2]:
            arguments = (mesh.positions, faces, rows, s, light, x, ray)
            robust = reference.robust_count(*arguments)
            decided = robust.is_decidable & expected.is_decidable
            np.testing.assert_array_equal(robust.value[decided], expected.value[decided])
            closed = reference.closed_count(*arguments) if use_closed else robust
            decided &= closed.is_decidable
            assert (closed.value[decided] >= 0).all()
            np.testing.assert_array_equal(closed.value[decided] > 0, expected.value[decided] > 0)
        total += robust.value
        closed_total += closed.value
        sure &= decided
    np.testing.assert_array_equal(total[sure], brute.value[sure])
    np.testing.assert_array_equal(closed_total[sure] > 0, brute.value[sure] > 0)
    assert sure.sum() >= 25


@given(any_mesh(), lights(), st.integers(0, 2**32 - 1))
@settings(max_examples=80)
def test_volumes_shade_what_faces_shade(source: SourceMesh, light: np.ndarray, seed: int) -> None:
    built = build(source)
    assume(len(built.repaired.mesh.faces))
    light = light.copy()
    light[:3] -= light[3] * built.mesh.grid.origin_m.astype(np.float32)
    check_shadows(built, light, seed)


@pytest.mark.parametrize("name", [n for n in SMALL_SUITE if n not in ("nothing", "far sliver")])
def test_volumes_of_the_suite_shade_what_faces_shade(name: str) -> None:
    built = build(SUITE[name]())
    for seed, light in enumerate(([1, 2, 3, 0], [0, 0, 1, 0], [0.3, 7, 9, 1], [0.21, 0.3, 0.4, 1])):
        check_shadows(built, np.array(light, np.float32), seed)


# Repairing again ---------------------------------------------------------------------------------


def check_repair_again(built: Built) -> None:
    again, report = repair(built.repaired.mesh)
    for name in ("positions", "faces", "source_face", "object_face_start", "object_vertex_start"):
        np.testing.assert_array_equal(
            getattr(again.mesh, name), getattr(built.repaired.mesh, name), name
        )
    np.testing.assert_array_equal(again.mate, built.repaired.mate)
    np.testing.assert_array_equal(again.component_face_start, built.repaired.component_face_start)
    inverted = np.uint8(ComponentFlag.INVERTED)
    np.testing.assert_array_equal(again.component_flags, built.repaired.component_flags & ~inverted)
    assert not len(report.flipped_faces)
    assert not len(report.duplicates.code)
    assert report.n_passes == 1


@given(any_mesh())
@settings(max_examples=250)
def test_repairing_again_changes_nothing(source: SourceMesh) -> None:
    check_repair_again(build(source))


@pytest.mark.parametrize("name", SUITE)
def test_repairing_the_suite_again_changes_nothing(name: str) -> None:
    check_repair_again(build(SUITE[name]()))


def around_one_edge() -> SourceMesh:
    """Five faces, three of them at one edge: welding numbers that edge's ends one way, and
    repair, which reorders the faces, the other."""
    vertices = [[0, 0, 0], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]]
    faces = [[4, 1, 5], [2, 6, 7], [6, 0, 7], [6, 3, 7], [7, 4, 5]]
    return source_mesh(np.array([*vertices, [2, 0, 0]]), np.array(faces))


def test_repair_finds_the_same_pairs_under_its_own_numbers() -> None:
    built = build(around_one_edge())
    assert (built.repaired.groups.n_faces_of_edge > 2).any()
    check_repair_again(built)


@given(any_mesh(), st.integers(0, 2**32 - 1))
@settings(max_examples=150)
def test_the_numbers_of_vertices_do_not_matter(source: SourceMesh, seed: int) -> None:
    built = build(source)
    rng = np.random.default_rng(seed)
    starts = built.mesh.object_vertex_start.tolist()
    old = np.concatenate([b + rng.permutation(e - b) for b, e in pairwise([0, *starts])])
    new = np.argsort(old).astype(np.uint32)
    mesh = replace(built.mesh, positions=built.mesh.positions[old], faces=new[built.mesh.faces])
    other, report = repair(mesh)
    assert report.n_passes == built.report.n_passes
    np.testing.assert_array_equal(report.flipped_faces, built.report.flipped_faces)
    np.testing.assert_array_equal(
        report.duplicates.source_face, built.report.duplicates.source_face
    )
    for name in ("mate", "component_start", "component_face_start", "component_flags"):
        np.testing.assert_array_equal(getattr(other, name), getattr(built.repaired, name), name)
    np.testing.assert_array_equal(other.mesh.source_face, built.repaired.mesh.source_face)
    np.testing.assert_array_equal(
        renumbered(other.mesh, built.repaired.mesh), built.repaired.mesh.faces
    )


# Metamorphic relations ---------------------------------------------------------------------------

PROBES = np.array([[1, 2, 3, 0], [0, 0, 1, 0], [-3, 1, 0, 0], [5, 2.5, 7, 1], [1, 1, 1, 1]])
"""Lights in source coordinates: in general position, and along the grid."""

Key = tuple[int, tuple[float, ...], tuple[float, ...]]


def multiplicity_in_space(
    built: Built, probes: np.ndarray, rotation: np.ndarray, shift: np.ndarray
) -> list[dict[Key, int]]:
    """m_e by object and source position, as if the model had not been turned and moved."""
    mesh = built.repaired.mesh
    positions = mesh.positions.astype(float) + mesh.grid.origin_m
    original = ((positions - shift) @ rotation).tolist()
    owner = np.searchsorted(mesh.object_vertex_start, np.arange(len(positions)), side="right") - 1
    found = []
    for probe in probes:
        xyz = rotation @ probe[:3] + probe[3] * (shift - mesh.grid.origin_m)
        light = np.array([*xyz, probe[3]], np.float32)
        sums: dict[Key, int] = {}
        rows = reference.multiplicity_of_rows(built.edges.rows, facing_of_face(built, light))
        for (lo, hi), m in rows.items():
            a, b = tuple(original[lo]), tuple(original[hi])
            if a > b:
                a, b, m = b, a, -m
            sums[int(owner[lo]), a, b] = m
        found.append(sums)
    return found


def counts_of(built: Built, but: frozenset[Code] = frozenset()) -> dict[str, object]:
    """What a transformation of the model should leave as it is."""
    flags = built.components.flags
    if Code.INVERTED_COMPONENT in but:
        flags = flags & ~np.uint8(ComponentFlag.INVERTED)
    defects = built.record.defect_counts.sum(axis=0)
    return {
        "faces": len(built.repaired.mesh.faces),
        "vertices": len(built.repaired.mesh.positions),
        "rows by flags": np.bincount(built.edges.flags, minlength=8).tolist(),
        "planes": len(built.planes.planes),
        "components by flags": np.bincount(flags, minlength=8).tolist(),
        "defects": {
            code.name: int(n) for code, n in zip(DEFECTS, defects, strict=True) if code not in but
        },
    }


IDENTITY = np.eye(3)
QUARTER_TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
NOWHERE = np.zeros(3)


def in_space(built: Built) -> list[dict[Key, int]]:
    return multiplicity_in_space(built, PROBES, IDENTITY, NOWHERE)


def has_crowded_edge(built: Built) -> bool:
    return bool((built.repaired.groups.n_faces_of_edge > 2).any())


def has_coincident_faces(built: Built) -> bool:
    """Whether two welded faces share their three vertices: which of them are duplicates
    depends on how they are wound, and so do the multiplicities (never the shadow)."""
    corners = np.sort(built.mesh.faces, axis=1)
    return len(np.unique(corners, axis=0)) < len(corners)


def check_same(a: Built, b: Built, *, but: frozenset[Code] = frozenset()) -> None:
    assert counts_of(a, but) == counts_of(b, but)


WINDING = frozenset({Code.FLIPPED_FACE, Code.INVERTED_COMPONENT})


@given(any_mesh(), st.integers(0, 2**32 - 1))
@settings(max_examples=120)
def test_the_order_of_faces_does_not_matter(source: SourceMesh, seed: int) -> None:
    one, other = build(source), build(shuffled(source, seed)[0])
    if not has_coincident_faces(one):
        assert in_space(one) == in_space(other)
    if not has_crowded_edge(one):
        check_same(one, other, but=WINDING)


@pytest.mark.parametrize("name", SUITE)
def test_the_order_of_faces_of_the_suite_does_not_matter(name: str) -> None:
    one = build(SUITE[name]())
    for seed in range(3):
        other = build(shuffled(SUITE[name](), seed)[0])
        check_same(one, other, but=WINDING)


@given(grid_meshes(30, 4))
@settings(max_examples=60)
def test_the_order_of_objects_does_not_matter(source: SourceMesh) -> None:
    starts = source.object_face_start
    n = len(starts) - 1
    reverse = [np.arange(starts[i], starts[i + 1]) for i in reversed(range(n))]
    old = np.concatenate(reverse)
    turned_round = replace(
        source,
        faces=source.faces[old],
        source_face=source.source_face[old],
        object_face_start=np.cumsum([0, *map(len, reverse)]),
    )
    one, other = build(source), build(turned_round)
    check_same(one, other)
    np.testing.assert_array_equal(one.record.defect_counts[::-1], other.record.defect_counts)
    mirrored = [
        {(n - 1 - owner, a, b): m for (owner, a, b), m in sums.items()} for sums in in_space(other)
    ]
    assert in_space(one) == mirrored


@given(any_mesh())
@settings(max_examples=60)
def test_unwelded_input_does_not_matter(source: SourceMesh) -> None:
    one, other = build(source), build(unwelded(source))
    check_same(one, other, but=frozenset({Code.UNWELDED_VERTEX}))
    np.testing.assert_array_equal(one.edges.rows, other.edges.rows)
    np.testing.assert_array_equal(one.edges.flags, other.edges.flags)
    np.testing.assert_array_equal(one.mesh.positions, other.mesh.positions)
    np.testing.assert_array_equal(one.repaired.mesh.positions, other.repaired.mesh.positions)


@given(any_mesh(), st.integers(0, 2**32 - 1))
@settings(max_examples=120)
def test_winding_does_not_matter(source: SourceMesh, seed: int) -> None:
    flips = np.random.default_rng(seed).random(len(source.faces)) < 0.5
    one, other = build(source), build(turned(source, flips))
    assume(not has_coincident_faces(one))
    assert in_space(one) == in_space(other)
    if not has_crowded_edge(one):
        check_same(one, other, but=WINDING)


@pytest.mark.parametrize("name", ["cube", "sphere", "nested", "Moebius strip", "Klein bottle"])
def test_winding_of_the_suite_does_not_matter(name: str) -> None:
    one = build(SUITE[name]())
    flips = np.random.default_rng(5).random(len(one.source.faces)) < 0.4
    other = build(turned(SUITE[name](), flips))
    check_same(one, other, but=WINDING)
    assert in_space(one) == in_space(other)


@given(any_mesh())
@settings(max_examples=80)
def test_a_quarter_turn_does_not_matter(source: SourceMesh) -> None:
    one = build(source)
    other = build(replace(source, positions=source.positions @ QUARTER_TURN.T))
    assert in_space(one) == multiplicity_in_space(other, PROBES, QUARTER_TURN, NOWHERE)
    # A one-sided patch is cut along its shortest edges; among equal ones place decides.
    n_cut = one.record.defect_counts[:, list(DEFECTS).index(Code.CUT_EDGE)].sum()
    if not has_crowded_edge(one) and not n_cut:
        check_same(one, other)


@given(any_mesh())
@settings(max_examples=80)
def test_a_long_way_does_not_matter(source: SourceMesh) -> None:
    shift = (390_000.0, 5_820_000.0, 40.0)
    one, other = build(source), build(moved(source, shift))
    assume(len(one.mesh.faces))
    check_same(one, other)
    np.testing.assert_array_equal(one.mesh.grid.origin_m + shift, other.mesh.grid.origin_m)
    np.testing.assert_array_equal(one.mesh.positions, other.mesh.positions)
    np.testing.assert_array_equal(one.repaired.mesh.positions, other.repaired.mesh.positions)
    np.testing.assert_array_equal(one.edges.rows, other.edges.rows)
    np.testing.assert_array_equal(one.planes.planes, other.planes.planes)


OFF_THE_MOVED_GRID = {"nothing", "Moebius strip", "Klein bottle", "far sliver"}


@pytest.mark.parametrize("name", [n for n in SMALL_SUITE if n not in OFF_THE_MOVED_GRID])
def test_turning_and_moving_the_suite_does_not_matter(name: str) -> None:
    one = build(SUITE[name]())
    source = SUITE[name]()
    shift = np.array((390_000.0, 5_820_000.0, 40.0))
    far = replace(source, positions=source.positions @ QUARTER_TURN.T + shift)
    other = build(far)
    check_same(one, other)
    assert in_space(one) == multiplicity_in_space(other, PROBES, QUARTER_TURN, shift)


# Threads -----------------------------------------------------------------------------------------


def everything(built: Built) -> list[np.ndarray]:
    return [
        built.mesh.positions,
        built.mesh.faces,
        built.repaired.mesh.positions,
        built.repaired.mesh.faces,
        built.repaired.mesh.source_face,
        built.repaired.mate,
        built.repaired.groups.order,
        built.repaired.groups.start,
        built.edges.rows,
        built.edges.flags,
        built.components.object_start,
        built.components.face_start,
        built.components.edge_start,
        built.components.flags,
        built.planes.planes,
        built.planes.plane_of_face,
        built.record.defect_counts,
        built.record.flipped_faces,
        built.record.face_findings.source_face,
    ]


@pytest.mark.parametrize("share", [1, 50])
def test_threads_change_nothing(share: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """With shares of a few faces, every kernel that can run on threads does."""
    monkeypatch.setattr(svprep.parallel, "_SMALLEST_SHARE", share)
    source = side_by_side(*[make() for name, make in SUITE.items() if name != "far sliver"])
    results = []
    for count in ("1", "2", "3"):
        monkeypatch.setenv("SVPREP_THREADS", count)
        results.append(everything(build(source)))
    for result in results[1:]:
        for one, other in zip(results[0], result, strict=True):
            np.testing.assert_array_equal(one, other)


def test_threads_change_nothing_at_full_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = [moved(sphere(24, 40, 50.0), (120.0 * i, 0.0, 0.0)) for i in range(24)]
    source = side_by_side(*[turned(b) if i % 3 else b for i, b in enumerate(bodies)])
    assert len(source.faces) > 2 * svprep.parallel._SMALLEST_SHARE
    results = []
    for count in ("1", "2"):
        monkeypatch.setenv("SVPREP_THREADS", count)
        results.append(everything(build(source)))
    for one, other in zip(*results, strict=True):
        np.testing.assert_array_equal(one, other)


# Solids ------------------------------------------------------------------------------------------


def six_volumes(points: np.ndarray, faces: np.ndarray) -> int:
    """Six times the signed volume, exact."""
    corners = [[[int(x) for x in points[v]] for v in face] for face in faces]
    return sum(
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
        for a, b, c in corners
    )


def touches_itself(points: np.ndarray, faces: np.ndarray) -> bool:
    corners = points[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    return any(
        (low[i] <= high[j]).all()
        and (low[j] <= high[i]).all()
        and reference.triangles_touch(corners[i], corners[j])
        for i, j in combinations(range(len(faces)), 2)
    )


def winding_numbers(positions: np.ndarray, faces: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The winding number at each point, by solid angles (van Oosterom, Strackee 1983)."""
    corners = positions[faces].astype(float)[None] - x[:, None, None]
    a, b, c = corners[:, :, 0], corners[:, :, 1], corners[:, :, 2]
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=2)
    below = la * lb * lc
    below += (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
    return 2 * np.arctan2(above, below).sum(axis=1) / (4 * np.pi)


def check_solids(built: Built, seed: int = 0) -> None:
    points, faces = built.points, built.repaired.mesh.faces
    rng = np.random.default_rng(seed)
    for i, flags in enumerate(built.components.flags.tolist()):
        own = faces[built.faces_of(i)]
        if not flags & ComponentFlag.CLOSED:
            assert not flags & (ComponentFlag.SOLID | ComponentFlag.INVERTED)
            continue
        volume = six_volumes(points, own)
        assert volume >= 0
        is_solid = volume > 0 and not touches_itself(points, own)
        assert bool(flags & ComponentFlag.SOLID) == is_solid
        if is_solid:
            x = rng.uniform(points[own].min((0, 1)), points[own].max((0, 1)), (20, 3))
            number = winding_numbers(points, own, x)
            near = np.abs(number - np.round(number)) < 1e-6
            assert near.sum() >= 18
            assert set(np.round(number[near]).astype(int)) <= {0, 1}


@given(st.one_of(solids(), voxel_meshes()), st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_solids_are_solid(source: SourceMesh, seed: int) -> None:
    check_solids(build(source), seed)


@given(grid_meshes(40))
@settings(max_examples=60)
def test_solids_among_random_faces_are_solid(source: SourceMesh) -> None:
    check_solids(build(source))


@pytest.mark.parametrize("name", SMALL_SUITE)
def test_solids_of_the_suite_are_solid(name: str) -> None:
    check_solids(build(SMALL_SUITE[name]()))


EXPECTED_SOLIDS = {
    "cube": 1,
    "inside out": 1,
    "flipped patch": 1,
    "inner wall": 1,
    "touching along a wall": 2,
    "touching along an edge": 2,
    "touching at a corner": 2,
    "touching, inside out": 2,
    "nested": 2,
    "cavity": 2,
    "overlapping cubes": 2,
    "checkerboard": 4,
    "pinched": 1,
    "sphere": 1,
    "far sliver": 1,
    "open shell": 0,
    "double sheet": 0,
    "crossing shell": 0,
    "twisted box": 0,
    "Moebius strip": 0,
    "Klein bottle": 0,
}


@pytest.mark.parametrize("name", EXPECTED_SOLIDS)
def test_the_suite_has_as_many_solids_as_it_should(name: str) -> None:
    built = build(SUITE[name]())
    n = int(((built.components.flags & ComponentFlag.SOLID) != 0).sum())
    assert n == EXPECTED_SOLIDS[name]


def test_closed_shell_of_negative_winding_is_no_solid() -> None:
    """The bow tie winds -1 around one half, so the closed volume would count wrongly."""
    built = build(joined(SUITE["twisted box"]()))
    corners = built.repaired.mesh.positions
    x = np.random.default_rng(2).uniform(corners.min(0), corners.max(0), (200, 3))
    number = np.round(winding_numbers(corners, built.repaired.mesh.faces, x)).astype(int)
    assert set(number) == {-1, 0, 1}
    assert built.components.flags.tolist() == [ComponentFlag.CLOSED | ComponentFlag.INVERTED] or (
        built.components.flags.tolist() == [ComponentFlag.CLOSED]
    )
