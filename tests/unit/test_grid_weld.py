"""The quantisation grid, and welding with and without a tolerance."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from svprep import reference
from svprep.defects import Code
from svprep.errors import InputError
from svprep.model import Grid, SourceMesh
from svprep.repair.grid import (
    COARSEST_STEP_M,
    MAX_COORDINATE,
    choose_grid,
    grid_coordinates,
    to_grid,
)
from svprep.repair.weld import weld
from tests.property.meshes import arrays, cube, joined, moved, scaled, side_by_side, source_mesh


def triangle(*points: tuple[float, float, float]) -> SourceMesh:
    return source_mesh(np.array(points, float), np.array([[0, 1, 2]]))


def check_grid(source: SourceMesh) -> Grid:
    """Every used vertex is within half a step of its grid position, which float32 holds."""
    grid = choose_grid(source)
    assert np.frexp(grid.step_m)[0] == 0.5, f"{grid.step_m} is no power of two"
    assert 2.0**-60 <= grid.step_m <= COARSEST_STEP_M
    step = Fraction(grid.step_m)
    origin = [Fraction(x) for x in grid.origin_m.tolist()]
    assert all((x / step).denominator == 1 for x in origin)
    mesh, _ = weld(source)
    index = grid_coordinates(mesh.positions, mesh.grid)
    assert np.abs(index).max(initial=0) <= MAX_COORDINATE
    np.testing.assert_array_equal(index.astype(np.float64) * grid.step_m, mesh.positions)
    used = np.unique(source.faces)
    for point, place in zip(
        source.positions[used].tolist(), to_grid(source.positions[used], grid).tolist(), strict=True
    ):
        for x, i, o in zip(point, place, origin, strict=True):
            assert abs(Fraction(x) - (o + i * step)) <= step / 2
    return grid


finite = st.floats(-1e6, 1e6)


@given(arrays(np.float64, (9, 3), elements=finite))
@settings(max_examples=150)
def test_every_vertex_lies_within_half_a_step(points: np.ndarray) -> None:
    source = source_mesh(points, np.arange(9).reshape(-1, 3))
    grid = check_grid(source)
    # The finest: half the step would not hold the extent, or not the coordinates.
    extent = (points.max(axis=0) - points.min(axis=0)).max()
    magnitude = np.abs(points).max()
    finer = grid.step_m / 2
    assert (
        extent > (2 * MAX_COORDINATE - 1) * finer
        or magnitude > 2.0**52 * finer
        or grid.step_m == 2.0**-60
    )


@pytest.mark.parametrize("extent_m", [1e-12, 1e-9, 1e-3, 1.0, 333.3, 8192.0, 16384.1, 1e6, 2.0e6])
@pytest.mark.parametrize("at", [0.0, 100.0])
def test_extents_from_a_nanometre_to_a_thousand_kilometres(extent_m: float, at: float) -> None:
    source = moved(scaled(cube(), extent_m), (at, -at, 0.0))
    if extent_m < 1e-10 and at:
        assert check_grid(source).step_m == 2.0**-45  # what float64 resolves at 100 m
        return
    mesh, report = weld(source)
    check_grid(source)
    assert len(mesh.faces) == 12
    assert not len(report.dropped.code)
    edge = (mesh.positions.max(axis=0) - mesh.positions.min(axis=0)).astype(float)
    assert np.abs(edge - extent_m).max() <= 2 * mesh.grid.step_m


def test_steps_that_users_are_told() -> None:
    """2^-11 m for +-8 km; the whole range of 2^25 steps is used, and no more."""
    assert choose_grid(scaled(cube(), 16384.0)).step_m == 2.0**-11
    assert choose_grid(scaled(cube(), 16385.0)).step_m == 2.0**-10
    assert choose_grid(moved(scaled(cube(), 16384.0), (-8192.0, 0, 0))).step_m == 2.0**-11
    assert choose_grid(scaled(cube(), 2.0**21)).step_m == COARSEST_STEP_M
    whole = weld(scaled(cube(), 16384.0))[0].positions / 2.0**-11
    assert (whole.min(), whole.max()) == (-(2**24), 2**24)


def test_no_faces_and_one_point_have_a_grid() -> None:
    assert choose_grid(source_mesh(np.ones((3, 3)), np.zeros((0, 3)))).step_m == 2.0**-24
    same = check_grid(triangle((1, 2, 3), (1, 2, 3), (1, 2, 3)))
    np.testing.assert_array_equal(same.origin_m, [1, 2, 3])
    assert check_grid(triangle((0, 0, 0), (0, 0, 0), (0, 0, 0))).step_m == 2.0**-60


def test_only_vertices_that_faces_use_count() -> None:
    source = cube()
    stray = replace(source, positions=np.vstack((source.positions, [[1e300, -1e300, 5]])))
    grid = choose_grid(stray)
    assert grid.step_m == choose_grid(source).step_m
    np.testing.assert_array_equal(grid.origin_m, choose_grid(source).origin_m)
    np.testing.assert_array_equal(weld(stray)[0].positions, weld(source)[0].positions)


@pytest.mark.parametrize("far", [2.2e6, 1e9, 1e300, -1.7e308])
def test_too_wide_a_model_is_refused_and_the_vertex_named(far: float) -> None:
    near = side_by_side(cube(), scaled(cube(), 2.0))
    positions = near.positions.copy()
    positions[13] = (1.0, far, 2.0)
    with pytest.raises(InputError) as error:
        choose_grid(replace(near, positions=positions))
    message = str(error.value)
    assert 'test.obj, object "object 1"' in message
    assert f"(1, {far:g}, 2)" in message


def test_an_extent_beyond_float64_is_refused() -> None:
    source = cube()
    positions = source.positions.copy()
    positions[0], positions[7] = (-1.7e308, 0, 0), (1.7e308, 0, 0)
    with pytest.raises(InputError, match="km fit a grid"):
        choose_grid(replace(source, positions=positions))


@given(
    arrays(np.int64, (12, 3), elements=st.integers(-4096, 4096)),
    st.tuples(*[st.integers(-(2**23), 2**23)] * 3),
)
@settings(max_examples=150)
def test_a_shift_by_grid_steps_changes_nothing(
    points: np.ndarray, shift: tuple[int, int, int]
) -> None:
    """Coordinates in eighths of a step of the grid, halves among them."""
    eighth = 2.0**-16
    faces = np.arange(12).reshape(-1, 3)
    # Two far corners fix the extent: step 2^-13.
    points = points * eighth
    points[0], points[1] = (-2048.0, 0, 0), (2048.0, 0, 0)
    one = source_mesh(points, faces)
    grid = choose_grid(one)
    assert grid.step_m == 2.0**-13
    other = source_mesh(points + np.array(shift) * grid.step_m, faces)
    far = choose_grid(other)
    assert far.step_m == grid.step_m
    np.testing.assert_array_equal(far.origin_m - grid.origin_m, np.array(shift) * grid.step_m)
    np.testing.assert_array_equal(to_grid(other.positions, far), to_grid(one.positions, grid))


def test_a_grid_is_chosen_block_by_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of arrays that lie in a file, whatever a block holds, unused vertices left out."""
    rng = np.random.default_rng(3)
    source = source_mesh(rng.normal(0, 90, (1000, 3)), rng.integers(0, 400, (150, 3)))
    used = np.unique(source.faces)
    unused = np.setdiff1d(np.arange(1000), used)
    source.positions[unused] *= 1e6
    file = np.memmap(tmp_path / "positions", np.float64, "w+", shape=(1000, 3))
    file[:] = source.positions
    alone = source_mesh(source.positions[used], np.searchsorted(used, source.faces))
    expected = choose_grid(alone)
    for block in (1, 63, 64, 500, 1 << 16):
        monkeypatch.setattr("svprep.repair.grid._BLOCK", block)
        grid = choose_grid(replace(source, positions=file))
        assert grid.step_m == expected.step_m
        np.testing.assert_array_equal(grid.origin_m, expected.origin_m)


@pytest.mark.parametrize("tolerance_m", [0.0, 0.6])
def test_objects_welded_one_by_one_on_the_grid_of_all_are_those_of_all(tolerance_m: float) -> None:
    parts = [joined(cube(), moved(cube(), (1.25, 0, 0))), cube(30.0, (500, 3, 1)), cube(1e-6)]
    source = side_by_side(*parts)
    whole, report = weld(source, tolerance_m)
    for i, part in enumerate(parts):
        mesh, own = weld(part, tolerance_m, choose_grid(source))
        vertices = slice(*whole.object_vertex_start[i : i + 2])
        faces = slice(*whole.object_face_start[i : i + 2])
        np.testing.assert_array_equal(mesh.positions, whole.positions[vertices])
        np.testing.assert_array_equal(mesh.faces, whole.faces[faces] - np.uint32(vertices.start))
        assert own.welded_vertices.tolist() == [report.welded_vertices[i]]
        assert len(own.dropped.code) == (report.dropped.object_index == i).sum()


def test_halves_round_up() -> None:
    grid = Grid(1.0, np.zeros(3))
    points = np.array([[-1.5, -0.5, 0.5], [1.5, 2.4999999, 2.5000001]])
    assert to_grid(points, grid).tolist() == [[-1, 0, 1], [2, 2, 3]]


@given(
    arrays(np.float64, (8, 3), elements=st.floats(-2, 2)),
    arrays(np.int64, (6, 3), elements=st.integers(0, 7)),
)
@settings(max_examples=150)
def test_weld_equals_its_twin(points: np.ndarray, faces: np.ndarray) -> None:
    source = source_mesh(points, faces, [0, 2, 2, 6])
    used = points[np.unique(faces)]
    for size in ((used.max(axis=0) - used.min(axis=0)).max(), np.abs(used).max()):
        # Within rounding above a power of two, either of two steps is right.
        assume(not 0.5 < np.frexp(size)[0] < 0.5 + 1e-9)
    mesh, report = weld(source)
    expected, dropped, merged = reference.weld(source)
    assert mesh.grid.step_m == expected.grid.step_m
    for name in ("positions", "faces", "object_vertex_start", "object_face_start", "source_face"):
        np.testing.assert_array_equal(getattr(mesh, name), getattr(expected, name), name)
    assert sorted(report.dropped.source_face.tolist()) == dropped
    assert report.welded_vertices.tolist() == merged
    assert report.source_triangles.tolist() == [2, 0, 4]


def test_objects_stay_apart() -> None:
    mesh, report = weld(side_by_side(cube(), cube(), moved(cube(), (1, 0, 0))))
    assert mesh.object_vertex_start.tolist() == [0, 8, 16, 24]
    assert report.welded_vertices.tolist() == [0, 0, 0]
    one, report = weld(joined(cube(), cube(), moved(cube(), (1, 0, 0))))
    assert len(one.positions) == 12
    assert report.welded_vertices.tolist() == [12]


def test_faces_without_area_are_dropped_and_listed() -> None:
    tiny = 2.0**-24
    points = [
        *[(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0), (1, 1, 0)],
        *[(0, 0, 1), (0, 0.3 * tiny, 1), (1, 0, 1), (0.5, 0.4 * tiny, 1)],
    ]
    faces = [
        [0, 1, 2],  # stays
        [0, 1, 1],  # a repeated corner
        [0, 1, 3],  # on a line
        [5, 6, 7],  # its corners fall together on the grid of 2^-24 m
        [5, 7, 8],  # its height does
        [1, 3, 4],  # stays
    ]
    source = source_mesh(np.array(points), np.array(faces), [0, 2, 6])
    assert choose_grid(source).step_m == tiny
    mesh, report = weld(source)
    assert mesh.source_face.tolist() == [0, 5]
    assert mesh.object_face_start.tolist() == [0, 1, 2]
    listed = sorted(
        zip(
            report.dropped.source_face.tolist(),
            report.dropped.code.tolist(),
            report.dropped.object_index.tolist(),
            strict=True,
        )
    )
    assert listed == [
        (1, Code.DEGENERATE_FACE, 0),
        (2, Code.DEGENERATE_FACE, 1),
        (3, Code.COLLAPSED_FACE, 1),
        (4, Code.COLLAPSED_FACE, 1),
    ]


def test_a_line_that_only_float64_bends_is_degenerate() -> None:
    """0.1, 0.2 and 0.3 do not lie on a line in binary; the file says that they do."""
    source = triangle((0.1, 0.1, 0.7), (0.2, 0.2, 0.7), (0.3, 0.3, 0.7))
    far = moved(source, (390_000.0, 5_820_000.0, 40.0))
    for mesh in (source, far):
        welded, report = weld(mesh)
        assert len(welded.faces) == 0
        assert report.dropped.code.tolist() == [Code.DEGENERATE_FACE]


# The tolerance -----------------------------------------------------------------------------------


def places(source: SourceMesh, tolerance_m: float) -> tuple[dict, float]:
    """Where each used source vertex of each object ends up [grid steps], and the step."""
    mesh, report = weld(source, tolerance_m)
    kept = {int(f): i for i, f in enumerate(mesh.source_face)}
    index = grid_coordinates(mesh.positions, mesh.grid).astype(int)
    found = {}
    for o in range(len(source.object_names)):
        for f in range(source.object_face_start[o], source.object_face_start[o + 1]):
            if f in kept:
                for c in range(3):
                    at = tuple(index[mesh.faces[kept[f], c]].tolist())
                    key = (o, int(source.faces[f, c]))
                    assert found.setdefault(key, at) == at, "one vertex went two ways"
    assert report.farthest_move_m <= tolerance_m
    return found, mesh.grid.step_m


@given(
    arrays(np.int64, (14, 3), elements=st.integers(0, 12)),
    arrays(np.int64, (10, 3), elements=st.integers(0, 13)),
    st.integers(0, 10),
    st.sampled_from([0.5, 1.0, 1.5, 2.0, 3.0, 5.0]),
)
@settings(max_examples=150)
def test_no_vertex_moves_farther_than_the_tolerance(
    points: np.ndarray, faces: np.ndarray, cut: int, tolerance_m: float
) -> None:
    source = source_mesh(points.astype(float), faces, [0, cut, 10])
    grid = choose_grid(source)
    before = to_grid(source.positions, grid).astype(int)
    found, step = places(source, tolerance_m)
    limit = (tolerance_m / step) ** 2
    for (_, vertex), at in found.items():
        assert ((before[vertex] - at) ** 2).sum() <= limit
    # Each goes to the place of a vertex of its own object, which did not move itself.
    for o in range(2):
        own = faces[:cut] if o == 0 else faces[cut:]
        theirs = {tuple(before[v].tolist()) for v in np.unique(own)}
        mine = {key[1]: at for key, at in found.items() if key[0] == o}
        assert set(mine.values()) <= theirs
        for vertex, at in mine.items():
            if tuple(before[vertex].tolist()) in set(mine.values()):
                assert at == tuple(before[vertex].tolist()), "a target moved: moves chain"


@given(arrays(np.int64, (9, 3), elements=st.integers(0, 9)), st.sampled_from([1.0, 1.5, 2.5]))
def test_what_stays_apart_is_farther_than_the_tolerance(
    points: np.ndarray, tolerance_m: float
) -> None:
    """No two vertices left in one object lie within the tolerance of each other.

    Only where no face was dropped: the vertices of those are gone."""
    source = source_mesh(points.astype(float), np.arange(9).reshape(-1, 3))
    mesh, report = weld(source, tolerance_m)
    assume(not len(report.dropped.code))
    for p, q in combinations(mesh.positions.astype(float), 2):
        assert ((p - q) ** 2).sum() > tolerance_m**2


def test_a_row_of_near_vertices_does_not_chain() -> None:
    """0, 1, 2, 3 ... with tolerance 1: 1 goes to 0, 3 to 2, and none farther."""
    points = np.array([(x, 0, 0) for x in range(8)] + [(x, 50, 20 * (x % 2)) for x in range(8)])
    faces = np.array([[i, 8 + i, 8 + (i + 3) % 8] for i in range(8)])
    found, step = places(source_mesh(points.astype(float), faces), 1.0)
    x = [found[0, v][0] - found[0, 0][0] for v in range(8)]
    assert [round(v * step) for v in x] == [0, 0, 2, 2, 4, 4, 6, 6]


def test_the_tolerance_keeps_objects_apart() -> None:
    near = side_by_side(cube(), moved(cube(), (1.01, 0, 0)), moved(cube(), (0, 0.005, 0)))
    mesh, report = weld(near, 0.05)
    assert mesh.object_vertex_start.tolist() == [0, 8, 16, 24]
    assert report.welded_vertices.tolist() == [0, 0, 0]
    assert report.farthest_move_m == 0.0
    plain, _ = weld(near)
    np.testing.assert_array_equal(mesh.positions, plain.positions)
    mesh, report = weld(joined(cube(), moved(cube(), (1.01, 0, 0))), 0.05)
    assert len(mesh.positions) == 12
    assert report.welded_vertices.tolist() == [4]
    assert report.farthest_move_m == pytest.approx(0.01, abs=mesh.grid.step_m)


def test_what_the_tolerance_collapses_is_listed() -> None:
    source = triangle((0, 0, 0), (1, 0, 0), (0, 0.01, 0))
    mesh, report = weld(source, 0.1)
    assert len(mesh.faces) == 0
    assert report.dropped.code.tolist() == [Code.COLLAPSED_FACE]
