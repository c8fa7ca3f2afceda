"""The silhouette query as callers see it: arguments, errors, arrays, and a cube by hand."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from svprep.cache.reader import open_cache
from svprep.cache.writer import write_cache
from svprep.errors import InputError
from svprep.model import Prepared
from svprep.pipeline import BuildConfig, prepare
from svprep.silhouette import METHODS, VOLUMES, Silhouette, silhouette
from tests.property.meshes import cube, moved, open_shell, side_by_side, sphere, tetrahedron

SUN = np.array([1.0, 2.0, 3.0, 0.0], np.float32)
"""A direction that faces three sides of a cube and lies in none."""

every_method = pytest.mark.parametrize("method", METHODS)


@cache
def unit_cube() -> Prepared:
    return prepare(cube(), BuildConfig())


@cache
def three_objects() -> Prepared:
    """A cube, an open shell, and a sphere that is large enough for an index."""
    return prepare(
        side_by_side(
            cube(),
            moved(open_shell(), (3.0, 0.0, 0.0)),
            moved(sphere(16, 32, 50.0), (100.0, 0.0, 0.0)),
        ),
        BuildConfig(),
    )


def lamp(prepared: Prepared, x: float, y: float, z: float) -> np.ndarray:
    """Return a point light given in the model's coordinates."""
    at = np.array([x, y, z]) - prepared.mesh.grid.origin_m
    light = np.append(at, 1.0).astype(np.float32)
    assert np.array_equal(light[:3], at), "choose a light that float32 holds"
    return light


def sides(prepared: Prepared, result: Silhouette) -> dict[frozenset, int]:
    """Return ``{edge as a set of two corners: m}`` in the model's coordinates."""
    points = prepared.mesh.positions + prepared.mesh.grid.origin_m
    ends = points[prepared.edges.rows[result.edge, :2]]
    keys = [frozenset(tuple(p) for p in pair) for pair in ends.tolist()]
    return dict(zip(keys, result.multiplicity.tolist(), strict=True))


# A cube by hand ----------------------------------------------------------------------------------

HEXAGON = [(1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1), (1, 0, 1)]
"""The outline of the cube seen from `SUN`, counter-clockwise: all corners but the
one towards the light and the one away from it."""


def hexagon_edges() -> set[frozenset]:
    ring = [tuple(map(float, p)) for p in HEXAGON]
    return {frozenset((a, b)) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)}


@every_method
@pytest.mark.parametrize(("volume", "times"), [("auto", 1), ("closed", 1), ("robust", 2)])
def test_a_cube_in_the_sun_has_six_sides(method: str, volume: str, times: int) -> None:
    result = silhouette(unit_cube(), SUN, method, volume=volume)
    found = sides(unit_cube(), result)
    assert set(found) == hexagon_edges()
    assert {abs(m) for m in found.values()} == {times}


@every_method
def test_the_lit_side_is_on_the_left(method: str) -> None:
    """Run along each side so that the lit faces are left: round the hexagon, as the light sees."""
    prepared = unit_cube()
    result = silhouette(prepared, SUN, method)
    points = prepared.mesh.positions + prepared.mesh.grid.origin_m
    ends = prepared.edges.rows[result.edge, :2]
    runs = np.where(result.multiplicity[:, None] > 0, ends, ends[:, ::-1])
    steps = {tuple(tuple(int(x) for x in points[v]) for v in run) for run in runs}
    assert steps == set(zip(HEXAGON, HEXAGON[1:] + HEXAGON[:1], strict=True))


@every_method
def test_a_direction_along_the_faces(method: str) -> None:
    """Straight down, walls are edge-on: they cast nothing, and the top's outline is all."""
    top = {frozenset(p) for p in squares(2, 1.0)}
    bottom = {frozenset(p) for p in squares(2, 0.0)}
    zenith = [0.0, 0.0, 1.0, 0.0]
    closed = sides(unit_cube(), silhouette(unit_cube(), zenith, method))
    assert set(closed) == top
    assert set(np.abs(list(closed.values()))) == {1}
    robust = sides(unit_cube(), silhouette(unit_cube(), zenith, method, volume="robust"))
    assert set(robust) == top | bottom
    assert set(np.abs(list(robust.values()))) == {1}


def squares(axis: int, value: float) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Return the four edges of the unit cube's face where coordinate `axis` is `value`."""
    corners = [c for c in product((0.0, 1.0), repeat=3) if c[axis] == value]
    pairs = [(a, b) for a, b in product(corners, corners) if a < b]
    return [(a, b) for a, b in pairs if sum(x != y for x, y in zip(a, b, strict=True)) == 1]


@every_method
def test_a_lamp_beside_the_cube_in_the_plane_of_its_top(method: str) -> None:
    """It faces the side x = 1 alone; the top is edge-on."""
    prepared = unit_cube()
    light = lamp(prepared, 3.0, 0.5, 1.0)
    lit = {frozenset(p) for p in squares(0, 1.0)}
    closed = sides(prepared, silhouette(prepared, light, method))
    assert set(closed) == lit
    assert set(np.abs(list(closed.values()))) == {1}
    robust = sides(prepared, silhouette(prepared, light, method, volume="robust"))
    top = {frozenset(p) for p in squares(2, 1.0)}
    assert set(robust) == lit | top
    # A lit side meets one turned away: twice. The top counts nothing: once.
    assert {edge: abs(m) for edge, m in robust.items()} == {
        edge: 1 if edge in top else 2 for edge in lit | top
    }


@every_method
def test_a_lamp_inside_the_cube_has_no_silhouette(method: str) -> None:
    """All faces are turned away alike, and turned round in the robust volume they close it."""
    light = lamp(unit_cube(), 0.5, 0.25, 0.75)
    for volume in VOLUMES:
        assert len(silhouette(unit_cube(), light, method, volume=volume)) == 0


@every_method
def test_a_lamp_on_a_face_of_the_cube_is_not_outside(method: str) -> None:
    """The face is edge-on and the others are turned away: only the robust volume sees them."""
    light = lamp(unit_cube(), 0.5, 0.5, 1.0)
    chosen = silhouette(unit_cube(), light, method)
    assert set(sides(unit_cube(), chosen)) == {frozenset(p) for p in squares(2, 1.0)}
    assert set(np.abs(chosen.multiplicity)) == {1}
    assert len(silhouette(unit_cube(), light, method, volume="closed")) == 0


@every_method
def test_bounds_choose_the_volume(method: str) -> None:
    """Outside a tetrahedron but within its bounds the volume is robust; a step farther, closed."""
    prepared = prepare(tetrahedron(), BuildConfig())  # bounds 0 to 3 along each axis
    for at, times in (((2.5, 2.5, 2.5), 2), ((3.0, 3.0, 3.0), 2), ((3.5, 3.0, 3.0), 1)):
        result = silhouette(prepared, lamp(prepared, *at), method)
        assert len(result) > 0
        assert set(np.abs(result.multiplicity)) == {times}, at


@every_method
def test_each_component_chooses_for_itself(method: str) -> None:
    result = silhouette(three_objects(), SUN, method)
    start = result.object_start
    by_object = [np.abs(result.multiplicity[start[i] : start[i + 1]]) for i in range(3)]
    assert set(by_object[0]) == {1}
    assert 2 in by_object[1], "an open shell is no solid"
    assert set(by_object[2]) == {1}
    forced = silhouette(three_objects(), SUN, method, volume="closed")
    assert set(np.abs(forced.multiplicity)) == {1}


# Arguments ---------------------------------------------------------------------------------------


@every_method
@pytest.mark.parametrize(
    "light",
    [
        (1.0, 2.0, 3.0),
        (1.0, 2.0, 3.0, 0.0, 0.0),
        [[1.0, 2.0, 3.0, 1.0]],
        (1.0, 2.0, 3.0, 2.0),
        (1.0, 2.0, 3.0, -1.0),
        (1.0, 2.0, 3.0, 0.5),
        (np.nan, 2.0, 3.0, 1.0),
        (1.0, np.inf, 3.0, 0.0),
        (1.0, 2.0, 3.0, np.nan),
        "dir:135,40",
        None,
        (),
    ],
    ids=str,
)
def test_a_light_is_four_finite_numbers(method: str, light: object) -> None:
    with pytest.raises(InputError, match="light"):
        silhouette(unit_cube(), light, method)


@every_method
@pytest.mark.parametrize("light", [(0.0, 0.0, 0.0, 0.0), (-0.0, 0.0, -0.0, 0.0)])
def test_a_direction_is_not_zero(method: str, light: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="direction"):
        silhouette(unit_cube(), light, method)


@every_method
def test_lights_that_look_bad_but_are_good(method: str) -> None:
    origin = silhouette(unit_cube(), (0, 0, 0, 1), method)
    assert origin.light.tolist() == [0.0, 0.0, 0.0, 1.0]
    whole = silhouette(unit_cube(), [1, 2, 3, 0], method)
    assert set(sides(unit_cube(), whole)) == hexagon_edges()
    minus_zero = silhouette(unit_cube(), np.array([1.0, 2.0, 3.0, -0.0]), method)
    assert set(sides(unit_cube(), minus_zero)) == hexagon_edges()


def test_unknown_methods_and_volumes_are_named() -> None:
    with pytest.raises(InputError, match="fastest"):
        silhouette(unit_cube(), SUN, "fastest")
    with pytest.raises(InputError, match="edge_buffer"):  # lists those there are
        silhouette(unit_cube(), SUN, "")
    with pytest.raises(InputError, match="open"):
        silhouette(unit_cube(), SUN, volume="open")
    with pytest.raises(InputError, match="robust"):
        silhouette(unit_cube(), SUN, volume="")


@every_method
@pytest.mark.parametrize(
    "objects",
    [[3], [0, 3], [-1], [0, -1], [2**31], [2**32], [2**40], np.array([2**63], np.uint64)],
    ids=str,
)
def test_objects_out_of_range(method: str, objects: object) -> None:
    with pytest.raises(InputError, match="object"):
        silhouette(three_objects(), SUN, method, objects=objects)


@every_method
@pytest.mark.parametrize(
    "objects",
    [[0.5], [0.0], ["0"], [None], [True, False, True], [2**70], [[0, 1]]],
    ids=str,
)
def test_objects_are_whole_numbers(method: str, objects: object) -> None:
    with pytest.raises(InputError, match="object"):
        silhouette(three_objects(), SUN, method, objects=objects)


@every_method
def test_objects_are_sorted_and_named_once(method: str) -> None:
    expected = silhouette(three_objects(), SUN, method, objects=[0, 2])
    assert expected.objects.tolist() == [0, 2]
    for objects in ([2, 0], [0, 2, 2, 0], (2, 0), np.array([2, 0], np.uint8), range(0, 3, 2)):
        assert_same(silhouette(three_objects(), SUN, method, objects=objects), expected)


@every_method
def test_all_objects_are_the_default(method: str) -> None:
    everything = silhouette(three_objects(), SUN, method)
    assert everything.objects.tolist() == [0, 1, 2]
    assert_same(silhouette(three_objects(), SUN, method, objects=[0, 1, 2]), everything)
    for i in range(3):
        rows = slice(*everything.object_start[i : i + 2])
        one = silhouette(three_objects(), SUN, method, objects=[i])
        assert np.array_equal(one.edge, everything.edge[rows])
        assert np.array_equal(one.multiplicity, everything.multiplicity[rows])
        assert one.object_start.tolist() == [0, len(one)]


@every_method
@pytest.mark.parametrize("objects", [[], np.zeros(0, np.int64)], ids=["list", "array"])
def test_no_objects_have_no_silhouette(method: str, objects: object) -> None:
    result = silhouette(three_objects(), SUN, method, objects=objects)
    assert len(result) == 0
    assert result.object_start.tolist() == [0]
    assert_well_formed(result)


@every_method
def test_no_lit_face_gives_empty_arrays(method: str) -> None:
    result = silhouette(unit_cube(), lamp(unit_cube(), 0.5, 0.5, 0.5), method)
    assert len(result) == 0
    assert result.object_start.tolist() == [0, 0]
    assert_well_formed(result)


# Results -----------------------------------------------------------------------------------------


def assert_same(a: Silhouette, b: Silhouette) -> None:
    for name in ("edge", "multiplicity", "objects", "object_start", "light"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


def assert_well_formed(result: Silhouette) -> None:
    dtypes = {
        "edge": np.uint32,
        "multiplicity": np.int8,
        "orientation": np.int8,
        "objects": np.int64,
        "object_start": np.int64,
        "light": np.float32,
    }
    for name, dtype in dtypes.items():
        array = getattr(result, name)
        assert type(array) is np.ndarray, name
        assert array.dtype == dtype, name
        assert array.ndim == 1, name
        assert array.flags.c_contiguous, name
    n = len(result)
    assert len(result.edge) == len(result.multiplicity) == len(result.orientation) == n
    assert (np.diff(result.edge.astype(np.int64)) > 0).all()
    assert len(result.object_start) == len(result.objects) + 1
    assert result.object_start[0] == 0
    assert result.object_start[-1] == n
    assert (np.diff(result.object_start) >= 0).all()
    assert set(np.abs(result.multiplicity)) <= {1, 2}
    assert (result.orientation == np.sign(result.multiplicity)).all()
    assert type(result.work.n_edges) is int
    assert type(result.work.n_nodes) is int


@every_method
@pytest.mark.parametrize("volume", VOLUMES)
def test_results_are_well_formed(method: str, volume: str) -> None:
    result = silhouette(three_objects(), SUN, method, volume=volume)
    assert len(result) > 0
    assert_well_formed(result)
    assert np.array_equal(result.light, SUN)
    assert result.method in METHODS
    assert method in ("auto", result.method)


@every_method
def test_results_are_the_callers_own(method: str) -> None:
    """A result can be written to, and neither the arguments nor the next result change."""
    light, objects = SUN.copy(), np.array([0, 2])
    first = silhouette(three_objects(), light, method, objects=objects)
    kept = {f.name: np.copy(getattr(first, f.name)) for f in fields(first)[:5]}
    light[:] = -1.0
    objects[:] = 1
    for name, values in kept.items():
        assert np.array_equal(getattr(first, name), values), name
    first.edge[:] = 0
    first.multiplicity[:] = 0
    again = silhouette(three_objects(), SUN, method, objects=[0, 2])
    for name, values in kept.items():
        assert np.array_equal(getattr(again, name), values), name
    with pytest.raises(FrozenInstanceError):
        first.edge = kept["edge"]  # type: ignore[misc]


@every_method
def test_a_cache_gives_what_was_prepared(method: str, tmp_path: Path) -> None:
    path = tmp_path / "a.svp.h5"
    write_cache(three_objects(), path)
    with open_cache(path) as stored:
        found = [silhouette(stored, SUN, method, objects=objects) for objects in (None, [2], [])]
        found.append(silhouette(stored, (0.0, 0.0, 0.0, 1.0), method))
    for result, objects in zip(found, (None, [2], []), strict=False):
        assert_well_formed(result)  # after the file is closed
        assert_same(result, silhouette(three_objects(), SUN, method, objects=objects))
    assert_same(found[3], silhouette(three_objects(), (0.0, 0.0, 0.0, 1.0), method))


def test_methods_and_volumes_are_those_documented() -> None:
    assert METHODS == ("auto", "brute", "edge_buffer", "elimination", "flat", "cones", "hextree")
    assert VOLUMES == ("auto", "closed", "robust")


def test_a_parsed_light_is_taken_into_the_cache_frame() -> None:
    from svprep.light import parse_light

    made = unit_cube()
    spec = parse_light("dir:120,35")
    named = silhouette(made, spec)
    plain = silhouette(made, spec.in_cache_frame(made.mesh.grid))
    assert np.array_equal(named.edge, plain.edge)
    assert np.array_equal(named.light, plain.light)
    with pytest.raises(InputError, match="parse_light"):
        silhouette(made, "dir:120,35")


def test_a_path_is_no_cache() -> None:
    with pytest.raises(TypeError, match=r"svprep.open_cache\(PATH\)"):
        silhouette("city.svp.h5", [0, 0, 1, 0])  # type: ignore[arg-type]
