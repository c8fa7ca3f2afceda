"""Where z-pass begins to count: the volumes around the eye, against faces on the line to the light.

The line to the light is followed by `reference.volumes.volume_count`, plainly, and through
segments by a loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svprep.errors import InputError
from svprep.light import parse_light
from svprep.model import ClampTable, Prepared, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep.reference.volumes import volume_count
from svprep_runtime import eye as eye_module
from svprep_runtime.camera import look_at
from svprep_runtime.eye import REACH, EyeCount, close_m, eye_count, is_cut_at_near
from svprep_runtime.volumes import ENDLESS, CastersOf, Segments, casters_of, segments_of
from tests.property.meshes import (
    cube,
    grid_meshes,
    moved,
    scaled,
    side_by_side,
    source_mesh,
    strip_of_one_side,
    unwelded,
)
from tests.unit.cache_samples import nothing
from tests.unit.hours_scenes import box, city, level, sheet

SUN = np.array([0.48, -0.36, 0.8, 0.0], np.float32)
ZENITH = np.array([0.0, 0.0, 1.0, 0.0], np.float32)


def soup(n: int, seed: int) -> SourceMesh:
    rng = np.random.default_rng(seed)
    middle = rng.uniform(0.0, 9.0, (n, 1, 3))
    corners = middle + rng.normal(size=(n, 3, 3)) * rng.uniform(0.3, 2.0, (n, 1, 1))
    return source_mesh(np.round(corners.reshape(-1, 3), 3), np.arange(3 * n).reshape(-1, 3))


def boxes(n: int, seed: int) -> SourceMesh:
    """n closed boxes that overlap each other, an object each."""
    rng = np.random.default_rng(seed)
    low = np.round(rng.uniform(0, 8, (n, 3)), 2)
    high = low + np.round(rng.uniform(0.5, 3, (n, 3)), 2)
    return side_by_side(*[box(tuple(a), tuple(b)) for a, b in zip(low, high, strict=True)])


def lamp_in(prepared: Prepared, *at: float) -> np.ndarray:
    return np.array([*(np.array(at) - prepared.mesh.grid.origin_m), 1.0], np.float32)


def eye_in(prepared: Prepared, *at: float) -> np.ndarray:
    return (np.array(at) - prepared.mesh.grid.origin_m).astype(np.float32)


def count_at(prepared: Prepared, light: np.ndarray, eye: np.ndarray) -> EyeCount:
    segments = segments_of(prepared, light, clamped=False)
    return eye_count(prepared, casters_of(prepared, light), segments, eye)


@dataclass(frozen=True)
class Around:
    """What stands around eyes, face by face and plainly."""

    casters: CastersOf
    value: np.ndarray
    """``(n_faces, n_eyes)``: how many segments hold each eye behind each face."""
    is_sure: np.ndarray
    """``(n_eyes,)``"""

    def total(self, nth: int, close: np.ndarray) -> int:
        """Return the count at an eye, components that are `close` to it left out."""
        is_far = ~np.isin(self.casters.component_of_face, close)
        return int(self.value[is_far, nth].sum())


def around(
    prepared: Prepared,
    casters: CastersOf,
    segments: Segments,
    eyes: np.ndarray,
    reach_m: float = 0.0,
) -> Around:
    """Return the reference: one line from each eye to the light, against each face."""
    mesh = prepared.mesh
    light = casters.light.astype(float)
    value = np.zeros((len(mesh.faces), len(eyes)), int)
    is_sure = np.ones(len(eyes), bool)
    for face in np.flatnonzero(casters.counts).tolist():
        found = volume_count(
            mesh.positions, mesh.faces[face][None], casters.facing[face][None], light, eyes
        )
        is_sure &= found.is_decidable
        value[face] = found.value
        if segments.is_clamped and found.value.any():
            value[face] *= n_segments(prepared, casters, segments, face, eyes, reach_m)
    return Around(casters, value, is_sure)


def n_segments(
    prepared: Prepared,
    casters: CastersOf,
    segments: Segments,
    face: int,
    eyes: np.ndarray,
    reach_m: float,
) -> np.ndarray:
    """Return how many segments of a face's caster hold each eye, as long as they are drawn."""
    component = casters.component_of_face[face]
    begin, end = segments.start[component : component + 2]
    a, b, c = prepared.mesh.positions[prepared.mesh.faces[face]].astype(float)
    light = casters.light.astype(float)
    u, v, t = segments.frame.astype(float) @ eyes.T.astype(float)
    total = np.zeros(len(eyes), int)
    for near, far, p, q in segments.table[begin:end].astype(float).tolist():
        if light[3]:
            normal = np.cross(b - a, c - a)
            depth = (eyes - light[:3]) @ normal / ((a - light[:3]) @ normal)
            far *= 1.0 + REACH
        else:
            depth = t - p * u - q * v
            far += reach_m * np.sqrt(1.0 + p * p + q * q)
        total += (depth >= near) & (depth <= far)
    return total


# Counts ------------------------------------------------------------------------------------------

SCENES: dict[str, Callable[[], SourceMesh]] = {
    "soup": lambda: soup(60, 1),
    "welded soup": lambda: source_mesh(
        np.random.default_rng(2).integers(0, 9, (30, 3)),
        np.random.default_rng(3).integers(0, 30, (80, 3)),
    ),
    "boxes": lambda: boxes(40, 4),
    "broken boxes": lambda: side_by_side(
        *[box((i, i, 0), (i + 2, i + 3, 5 + i), without=(i,)) for i in range(5)]
    ),
    "Moebius strip": lambda: moved(scaled(strip_of_one_side(20), 4.0), (4, 4, 4)),
    "town": lambda: side_by_side(
        level(0, 0, 60, 60),
        *[box((x, y, 0), (x + 2, y + 2, 3 + x % 7)) for x in range(0, 60, 4) for y in (1, 21, 41)],
    ),
}


@pytest.mark.parametrize("light", ["sun", "low sun", "zenith", "lamp", "lamp inside"])
@pytest.mark.parametrize("name", SCENES)
def test_counts_are_those_of_the_faces_between(name: str, light: str) -> None:
    prepared = prepare(SCENES[name](), BuildConfig())
    lights = {
        "sun": SUN,
        "low sun": np.array([0.8, 0.6, 0.05, 0.0], np.float32),
        "zenith": ZENITH,
        "lamp": lamp_in(prepared, 5.3, 3.1, 17.7),
        "lamp inside": lamp_in(prepared, 4.31, 4.17, 2.73),
    }
    casters = casters_of(prepared, lights[light])
    segments = segments_of(prepared, lights[light], clamped=False)
    low, high = prepared.mesh.positions.min(axis=0), prepared.mesh.positions.max(axis=0)
    eyes = np.random.default_rng(7).uniform(low - 1, high + 1, (40, 3)).astype(np.float32)
    reference = around(prepared, casters, segments, eyes)
    assert reference.is_sure.mean() > 0.9
    n_close, counts = 0, set()
    for nth in np.flatnonzero(reference.is_sure).tolist():
        found = eye_count(prepared, casters, segments, eyes[nth])
        assert found.n_around == reference.total(nth, found.close)
        n_close += len(found.close) > 0
        counts.add(found.n_around)
    assert n_close < 6
    assert len(counts) > 1


@pytest.mark.parametrize("spec", ["dir:127,38", "dir:200,9", "point:5.3,3.1,17.7"])
@pytest.mark.parametrize("name", ["soup", "boxes", "broken boxes"])
def test_each_segment_counts_that_holds_the_eye(name: str, spec: str) -> None:
    light = parse_light(spec)
    prepared = prepare(SCENES[name](), BuildConfig(), lights=[light])
    vector = light.in_cache_frame(prepared.mesh.grid)
    casters, segments = casters_of(prepared, vector), segments_of(prepared, vector, clamped=True)
    assert segments.is_clamped
    # In the shadows of all faces, near them and beyond all receivers.
    rng = np.random.default_rng(8)
    corners = prepared.mesh.positions[prepared.mesh.faces].astype(float)
    points = np.einsum("fk,fkc->fc", rng.dirichlet(np.ones(3), len(corners)), corners)
    points = points[rng.integers(0, len(points), 60)]
    away = vector[3] * points - vector[:3]
    eyes = (points + rng.uniform(0.0, 14.0, (60, 1)) * away / (14.0 if vector[3] else 1.0)).astype(
        np.float32
    )
    for reach_m in (0.0, 0.05):
        reference = around(prepared, casters, segments, eyes, reach_m)
        whole = around(prepared, casters, segments_of(prepared, vector, clamped=False), eyes)
        assert (reference.value != whole.value).any()  # segments do leave something out
        assert reference.value.any()
        n_close = 0
        for nth in np.flatnonzero(reference.is_sure).tolist():
            found = eye_count(prepared, casters, segments, eyes[nth], reach_m)
            assert found.n_around == reference.total(nth, found.close)
            n_close += len(found.close) > 0
        assert n_close < 0.5 * len(eyes)


@settings(max_examples=40)
@given(
    source=grid_meshes(),
    at=st.tuples(*[st.integers(-9, 25)] * 3),
    towards=st.tuples(*[st.integers(-7, 7)] * 3).filter(any),
    is_lamp=st.booleans(),
)
def test_small_broken_meshes_are_counted_alike(
    source: SourceMesh, at: tuple[int, ...], towards: tuple[int, ...], is_lamp: bool
) -> None:
    try:
        prepared = prepare(source, BuildConfig())
    except InputError:  # without a face of any area there is no city
        return
    # Off the grid's own planes and lines, mostly.
    offset = np.array([0.137, 0.211, 0.093])
    eye = eye_in(prepared, *(np.array(at) / 7.0 + offset))
    light = (
        lamp_in(prepared, *(np.array(towards) + offset[::-1]))
        if is_lamp
        else np.array([*(np.array(towards) + offset[::-1]), 0.0], np.float32)
    )
    casters, segments = casters_of(prepared, light), segments_of(prepared, light, clamped=False)
    reference = around(prepared, casters, segments, eye[None])
    if reference.is_sure[0]:
        found = eye_count(prepared, casters, segments, eye)
        assert found.n_around == reference.total(0, found.close)


# Ties --------------------------------------------------------------------------------------------


def sheet_of_quads(n: int, z: float = 4.0) -> SourceMesh:
    """A level sheet of n x n quads, cut along alternate diagonals: inner vertices all round."""
    vertices = np.array([(x, y, z) for x in range(n + 1) for y in range(n + 1)], float)
    faces = []
    for x in range(n):
        for y in range(n):
            a, b, c, d = ((x + i) * (n + 1) + y + j for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
            faces += [[a, b, c], [a, c, d]] if (x + y) % 2 else [[a, b, d], [b, c, d]]
    return source_mesh(vertices, np.array(faces))


@pytest.mark.parametrize("change", ["welded", "unwelded", "flipped in part"])
def test_a_line_through_an_edge_or_vertex_meets_one_face(
    change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As close as can be, such an edge is left to z-fail: nothing is close here.
    monkeypatch.setattr(eye_module, "close_m", lambda *_: -1e-12)
    source = sheet_of_quads(4)
    if change == "unwelded":
        source = unwelded(source)
    if change == "flipped in part":
        source.faces[::3] = source.faces[::3, ::-1]
    prepared = prepare(source, BuildConfig())
    for x in np.arange(0.5, 3.0, 0.25):
        for y in np.arange(0.5, 3.0, 0.25):
            eye = eye_in(prepared, x, y, 1.0)
            for light in (ZENITH, lamp_in(prepared, x, y, 9.0)):
                assert count_at(prepared, light, eye).n_around == 1, (x, y)
            # Across: a line that meets the sheet in a vertex or an edge, in exact numbers.
            along = np.array([1.0, 0.5, 4.0])
            for light in (
                np.array([*along, 0.0], np.float32),
                lamp_in(prepared, *(np.array([x, y, 4.0]) + 2.0 * along)),
            ):
                below = eye_in(prepared, *(np.array([x, y, 4.0]) - 0.5 * along))
                assert count_at(prepared, light, below).n_around == 1, (x, y)
                above = eye_in(prepared, *(np.array([x, y, 4.0]) + 0.5 * along))
                assert count_at(prepared, light, above).n_around == 0, (x, y)


def test_a_lamp_between_eye_and_face_leaves_it_out() -> None:
    prepared = city(level(-5, -5, 5, 5, 4.0))
    eye = eye_in(prepared, 0.3, 0.2, 1.0)
    for z, n in ((2.0, 0), (3.9, 0), (4.1, 1), (99.0, 1), (-3.0, 0)):
        assert count_at(prepared, lamp_in(prepared, 0.4, 0.1, z), eye).n_around == n


# Close -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("light", ["sun", "lamp"])
@pytest.mark.parametrize(("away_m", "is_close"), [(0.0, True), (0.0005, True), (0.02, False)])
def test_an_eye_on_a_side_is_close(light: str, away_m: float, is_close: bool) -> None:
    prepared = city(level(-2, -2, 2, 2, 6.0), level(20, 20, 22, 22, 6.0))
    vector = {"sun": SUN, "lamp": lamp_in(prepared, 1.0, -1.0, 20.0)}[light]
    on_edge = np.array([2.0, 0.3, 6.0]) - prepared.mesh.grid.origin_m
    from_light = -vector[:3].astype(float) if light == "sun" else on_edge - vector[:3]
    from_light /= np.linalg.norm(from_light)
    across = np.cross(from_light, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    for side in (-1.0, 1.0):
        eye = (on_edge + 3.0 * from_light + side * away_m * across).astype(np.float32)
        found = count_at(prepared, vector, eye)
        assert found.close.tolist() == [0] * is_close
        n_around = [count_at(prepared, vector, (on_edge + 3.0 * from_light + x * across).astype(
            np.float32)).n_around for x in (-0.02, 0.02)]  # fmt: skip
        assert sorted(n_around) == [0, 1]
        assert found.n_around == (0 if is_close else n_around[side > 0])


@pytest.mark.parametrize(("away_m", "is_close"), [(0.0, True), (0.0005, True), (0.02, False)])
def test_an_eye_on_a_face_is_close(away_m: float, is_close: bool) -> None:
    prepared = city(level(-2, -2, 2, 2, 6.0))
    for side in (-1.0, 1.0):
        eye = eye_in(prepared, 0.3, 0.2, 6.0 + side * away_m)
        for light in (SUN, ZENITH, lamp_in(prepared, 1.0, -1.0, 20.0)):
            found = count_at(prepared, light, eye)
            assert found.close.tolist() == [0] * is_close
            if away_m:
                assert found.n_around == (side < 0 and not is_close)


def with_segments(prepared: Prepared, light: np.ndarray, depths: list[list[float]]) -> Segments:
    """Return the segments of a city of one caster."""
    is_sun = light[3] == 0.0
    frame = np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1]]) if is_sun else np.eye(3)
    n = len(depths)
    table = ClampTable(
        specs=("by hand",),
        lights=light[None],
        frames=frame[None].astype(float),
        facts=np.zeros((1, 5)),
        light_start=np.array([0, n]),
        segment_start=np.array([[0, n]], np.uint32),
        depths=np.array(depths, np.float32),
        slopes=np.zeros((n, 2), np.int16),
    )
    return segments_of(replace(prepared, clamp=table), light, clamped=True)


def test_an_eye_at_the_end_of_a_segment_is_close() -> None:
    prepared = city(level(-2, -2, 2, 2, 6.0), names=("sheet",))
    top = 6.0 - prepared.mesh.grid.origin_m[2]
    # The sun at the zenith: depths are -z; the shadow is cut from 2 to 5 m below the sheet.
    segments = with_segments(
        prepared, ZENITH, [[-top - 0.1, -top + 2.0], [-top + 5.0, float(ENDLESS) * 2]]
    )
    casters = casters_of(prepared, ZENITH)
    for below_m, n, is_close in (
        (1.0, 1, False), (1.98, 1, False), (1.9995, 1, True), (2.0005, 0, True),
        (2.02, 0, False), (4.98, 0, False), (4.9995, 0, True), (5.0005, 1, True),
        (5.02, 1, False), (500.0, 1, False), (-0.05, 0, False), (-0.1, 0, False),
    ):  # fmt: skip
        eye = eye_in(prepared, 0.3, 0.2, 6.0 - below_m)
        found = eye_count(prepared, casters, segments, eye)
        assert found.n_around == n * (not is_close), below_m
        assert found.close.tolist() == [0] * is_close, below_m


def test_an_eye_in_what_segments_are_drawn_longer_by_is_close_before_and_counted_behind() -> None:
    prepared = city(level(-2, -2, 2, 2, 6.0))
    top = 6.0 - prepared.mesh.grid.origin_m[2]
    segments = with_segments(prepared, ZENITH, [[-top - 0.1, -top + 2.0], [-top + 5.0, -top + 7.0]])
    casters = casters_of(prepared, ZENITH)
    for below_m, n, is_close in (
        (1.98, 1, False), (2.02, 1, False), (2.28, 1, False), (2.2995, 0, True), (2.3005, 0, True),
        (2.32, 0, False), (4.68, 0, False), (4.6995, 0, True), (4.72, 0, True), (4.98, 0, True),
        (5.0005, 0, True), (5.02, 1, False), (7.28, 1, False), (7.32, 0, False),
    ):  # fmt: skip
        eye = eye_in(prepared, 0.3, 0.2, 6.0 - below_m)
        found = eye_count(prepared, casters, segments, eye, reach_m=0.3)
        assert (found.n_around, len(found.close)) == (n, is_close), below_m


def test_an_eye_at_the_end_of_a_lamps_segment_is_close() -> None:
    prepared = city(level(-2, -2, 2, 2, 6.0))
    lamp = lamp_in(prepared, 0.25, 0.5, 16.0)
    # k = 1 on the sheet, 10 m from the lamp; from 1.2 to 1.5 there is nothing.
    segments = with_segments(prepared, lamp, [[0.9, 1.2], [1.5, 1.9]])
    casters = casters_of(prepared, lamp)
    # They are drawn from 1.47 and to 1.224 and 1.938.
    for k, n, is_close in (
        (1.1, 1, False), (1.21, 1, False), (1.2235, 1, False), (1.22395, 0, True),
        (1.22405, 0, True), (1.2242, 0, False), (1.23, 0, False), (1.4698, 0, False),
        (1.46995, 0, True), (1.4702, 0, True), (1.48, 0, True), (1.49995, 0, True),
        (1.5002, 1, False), (1.9, 1, False), (1.9378, 1, False), (1.93805, 0, True),
        (1.9382, 0, False),
    ):  # fmt: skip
        eye = eye_in(prepared, 0.3, 0.2, 16.0 - 10.0 * k)
        found = eye_count(prepared, casters, segments, eye)
        assert (found.n_around, len(found.close)) == (n, is_close), k


def test_an_eye_in_two_segments_counts_twice() -> None:
    prepared = city(level(-2, -2, 2, 2, 6.0))
    top = 6.0 - prepared.mesh.grid.origin_m[2]
    segments = with_segments(prepared, ZENITH, [[-top, -top + 3.0], [-top + 2.0, -top + 5.0]])
    casters = casters_of(prepared, ZENITH)
    for below_m, n in ((1.0, 1), (2.5, 2), (4.0, 1), (5.5, 0)):
        eye = eye_in(prepared, 0.3, 0.2, 6.0 - below_m)
        assert eye_count(prepared, casters, segments, eye).n_around == n


def test_only_the_close_component_is_told_apart() -> None:
    prepared = city(*[level(-9 + i, -9, 9, 9, 10.0 + i) for i in range(5)])
    eye = eye_in(prepared, -6.9999, 0.3, 1.0)  # under the edge of the third
    found = count_at(prepared, ZENITH, eye)
    assert found.close.tolist() == [2]
    assert found.n_around == 2
    beside = eye_in(prepared, -6.98, 0.3, 1.0)
    assert count_at(prepared, ZENITH, beside).n_around == 3


def test_the_tolerance_grows_with_coordinates() -> None:
    near, far = (np.full((1, 3), x, np.float32) for x in (9.0, 8000.0))
    assert close_m(near, near[0]) == 1e-3
    assert close_m(far, near[0]) == close_m(near, far[0]) == 64.0 * 2.0**-11
    assert close_m(np.zeros((0, 3), np.float32), near[0]) == 1e-3


def test_in_a_city_of_nothing_nothing_is_around() -> None:
    prepared = nothing()
    found = count_at(prepared, SUN, np.zeros(3, np.float32))
    assert (found.n_around, found.close.tolist()) == (0, [])


# Before the near plane ---------------------------------------------------------------------------


def test_faces_before_the_near_plane_are_noticed() -> None:
    prepared = city(sheet([(-4, 1, 0), (4, 1, 0), (4, 1, 3), (-4, 1, 3)]), cube(1.0))
    target = np.array([0.3, 5.0, 1.5])
    for distance, near_m, is_cut in (
        (2.0, 0.05, False), (0.04, 0.05, True), (2.0, 2.5, True), (2.0, 1.0, False),
    ):  # fmt: skip
        camera = look_at(
            np.array([0.3, 1.0 - distance, 1.5]) - prepared.mesh.grid.origin_m,
            target - prepared.mesh.grid.origin_m,
            64,
            64,
            near_m=near_m,
        )
        if is_cut:
            assert is_cut_at_near(prepared, camera)
    away = look_at(np.array([0.0, -900.0, 1.0]), np.array([0.0, -999.0, 1.0]), 64, 64, near_m=3.0)
    assert not is_cut_at_near(prepared, away)
    empty = look_at(np.zeros(3), np.ones(3), 8, 8)
    assert not is_cut_at_near(nothing(), empty)


@pytest.mark.parametrize("seed", range(4))
def test_what_lies_before_the_near_plane_is_never_missed(seed: int) -> None:
    prepared = prepare(SCENES["town"](), BuildConfig())
    rng = np.random.default_rng(seed)
    positions, faces = prepared.mesh.positions.astype(float), prepared.mesh.faces
    n_cut = 0
    for _ in range(40):
        target, (face,) = rng.uniform([-30, -30, -4], [30, 30, 9]), rng.integers(0, len(faces), 1)
        near_m = float(rng.uniform(0.05, 2.0))
        eye = rng.dirichlet(np.ones(3)) @ positions[faces[face]] + rng.normal(size=3) * near_m
        camera = look_at(eye, target, 64, 48, near_m=near_m)
        # Points all over the faces, in the pyramid between eye and near rectangle.
        weights = rng.dirichlet(np.ones(3), 60)
        points = np.einsum("wk,fkc->fwc", weights, positions[faces]).reshape(-1, 3)
        x, y, depth = camera.rows.astype(float) @ (points - camera.eye).T
        is_before = (depth > 0) & (depth < camera.near_m) & (np.maximum(abs(x), abs(y)) < depth)
        if is_before.any():
            n_cut += 1
            assert is_cut_at_near(prepared, camera)
    assert n_cut > 5
