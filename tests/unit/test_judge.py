"""The judge of rendered masks: scenes known analytically, and a plain twin in float64."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex")

from svprep.errors import InputError
from svprep.model import MOST_TILT_RAD, Mesh, Prepared, SourceMesh
from svprep_runtime import judge as judging
from svprep_runtime import judge_constants as constants
from svprep_runtime.camera import Camera, look_at
from svprep_runtime.judge import (
    JUDGE_CONSTANTS,
    Judge,
    Overlap,
    Truth,
    compare,
    difference_picture,
    load_truth,
    save_truth,
)
from svprep_runtime.judge_report import MARKER_COLOUR, MARKER_PX, SKY_COLOUR, WRONG_COLOUR
from tests.property.meshes import joined, source_mesh
from tests.unit.cache_samples import nothing
from tests.unit.hours_scenes import box, city, level, sheet

SUN = np.array([0.48, -0.36, 0.8, 0.0], np.float32)


def judge_of(prepared: Prepared) -> Judge:
    return Judge(prepared.mesh, prepared.planes, prepared.object_names)


def camera_in(
    prepared: Prepared, eye: object, target: object, size: tuple[int, int] = (96, 64), **kw: float
) -> Camera:
    """Return a camera, its eye and target given in source coordinates."""
    origin = prepared.mesh.grid.origin_m
    return look_at(np.array(eye, float) - origin, np.array(target, float) - origin, *size, **kw)


def lamp_in(prepared: Prepared, *at: float) -> np.ndarray:
    return np.array([*(np.array(at) - prepared.mesh.grid.origin_m), 1.0], np.float32)


def pixel_rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return eye (3,) and directions (h, w, 3) in float64."""
    y, x = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    rays = camera.directions(x.ravel(), y.ravel())
    return camera.eye.astype(float), rays.reshape(camera.height_px, camera.width_px, 3)


def crosses_box(start: np.ndarray, along: np.ndarray, low: np.ndarray, high: np.ndarray):
    """Return where lines enter and leave a box (slabs): it is met iff enter < leave."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (low - start) / along, (high - start) / along
    return np.minimum(one, two).max(axis=-1), np.maximum(one, two).min(axis=-1)


# Scenes known analytically -------------------------------------------------------------------


@dataclass(frozen=True)
class BoxOnGround:
    """A box on a level sheet, without a triangle."""

    low: np.ndarray
    high: np.ndarray
    half: float

    def expected(self, camera: Camera, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return which pixels are surfaces, and which in shadow."""
        eye, rays = pixel_rays(camera)
        enter, leave = crosses_box(eye, rays, self.low, self.high)
        on_box = (enter < leave) & (enter > 0)
        depth = (self.low[2] - eye[2]) / rays[..., 2]
        ground = eye + depth[..., None] * rays
        on_ground = ~on_box & (depth > 0) & (np.abs(ground[..., :2]) < self.half).all(axis=-1)
        point = np.where(on_box[..., None], eye + enter[..., None] * rays, ground)
        towards = light[:3].astype(float) - light[3] * point
        # Of the box, which is convex, a side is lit iff the light is on its outer side.
        apart = np.stack([np.abs(point - self.low), np.abs(point - self.high)])
        side, axis = np.divmod(apart.transpose(1, 2, 0, 3).reshape(*on_box.shape, 6).argmin(-1), 3)
        beyond = (
            np.where(side == 1, 1.0, -1.0)
            * np.take_along_axis(np.broadcast_to(towards, point.shape), axis[..., None], axis=-1)[
                ..., 0
            ]
        )
        enter, leave = crosses_box(ground, towards, self.low, self.high)
        end = 1.0 if light[3] else np.inf
        is_hidden = (enter < leave) & (leave > 0) & (enter < end)
        shadow = np.where(on_box, beyond <= 0, is_hidden)
        return on_box | on_ground, shadow & (on_box | on_ground)


def box_on_ground() -> tuple[Prepared, BoxOnGround]:
    low, high, half = (-2.0, -1.5, 0.0), (2.0, 2.5, 3.0), 16.0
    prepared = city(level(-half, -half, half, half), box(low, high), names=("ground", "house"))
    origin = prepared.mesh.grid.origin_m
    assert not origin[:2].any()
    return prepared, BoxOnGround(np.array(low) - origin, np.array(high) - origin, half)


def near_a_change(values: np.ndarray) -> np.ndarray:
    """Return the pixels of whose 3 x 3 neighbours some have another value, and the frame."""
    padded = np.pad(values.astype(int), 1, constant_values=-1)
    h, w = values.shape
    parts = [padded[i : i + h, j : j + w] for i in range(3) for j in range(3)]
    return np.any([part != values for part in parts], axis=0)


@pytest.mark.parametrize("light", ["sun", "lamp", "lamp beside the box"])
def test_the_shadow_of_a_box_is_as_computed_pixel_by_pixel(light: str) -> None:
    prepared, scene = box_on_ground()
    lights = {
        "sun": SUN,
        "lamp": lamp_in(prepared, 4.0, -3.0, 8.0),
        "lamp beside the box": lamp_in(prepared, 4.0, 0.25, 1.5),
    }
    camera = camera_in(prepared, (-8.0, 9.0, 7.0), (0.0, 1.0, 0.5), (192, 128))
    truth = judge_of(prepared).truth(camera, lights[light])
    is_surface, in_shadow = scene.expected(camera, lights[light])
    np.testing.assert_array_equal(truth.is_surface, is_surface)
    wrong = truth.is_decidable & (truth.in_shadow != in_shadow)
    assert not wrong.any(), np.argwhere(wrong)
    assert 0.05 < in_shadow[is_surface].mean() < 0.95
    # Only what lies at an edge cannot be told.
    may_be_open = near_a_change(is_surface * (1 + in_shadow))
    assert not (is_surface & ~truth.is_decidable & ~may_be_open).any()
    assert truth.is_decidable.sum() > 0.93 * is_surface.sum()
    assert truth.overlaps == ()
    assert ((truth.face >= 0) == truth.is_surface).all()
    assert compare(truth, np.where(in_shadow, 255, 0).astype(np.uint8)).n_differing == 0


def test_a_box_with_a_lamp_inside_is_dark_outside_and_bright_inside() -> None:
    prepared = city(box((0, 0, 0), (4, 6, 3)))
    lamp = lamp_in(prepared, 2.0, 2.0, 2.0)
    outside = judge_of(prepared).truth(camera_in(prepared, (10, -9, 8), (2, 3, 1)), lamp)
    assert outside.is_surface.any()
    assert (outside.in_shadow == outside.is_surface).all()
    # Nothing but the sky beside it can change what is seen.
    assert (outside.is_decidable | near_a_change(outside.is_surface))[outside.is_surface].all()
    inside = judge_of(prepared).truth(camera_in(prepared, (1, 1, 1), (3, 5, 1.5)), lamp)
    assert inside.is_surface.all()
    assert inside.is_decidable.all()
    assert not inside.in_shadow.any()


def test_a_lamp_shades_nothing_behind_itself() -> None:
    # The sheet above the lamp is on the line from the ground to it, and farther.
    prepared = city(level(-5, -5, 5, 5), level(-1, -1, 1, 1, 3.0))
    camera = camera_in(prepared, (0, -12, 1.5), (0, 0, 0))
    judge = judge_of(prepared)
    below = judge.truth(camera, lamp_in(prepared, 0.0, 0.0, 2.0))
    above = judge.truth(camera, lamp_in(prepared, 0.0, 0.0, 4.0))
    ground = np.isin(below.face, [0, 1])
    assert not (below.in_shadow & ground).any()
    assert (above.in_shadow & ground).any()


@pytest.mark.parametrize("height", [1e-3, 0.01, 0.1])
def test_a_lamp_close_over_the_ground_lights_it(height: float) -> None:
    # Displaced points may stand above the lamp, even on its far side; a roof over it shades
    # nothing.
    prepared = city(level(-4, -4, 4, 4), level(-4, -4, 4, 4, 0.25))
    camera = camera_in(prepared, (0.0, -3.0, 0.1), (0.0, 0.0, 0.0))
    truth = judge_of(prepared).truth(camera, lamp_in(prepared, 0.0, 0.0, height))
    ground = np.isin(truth.face, [0, 1])
    assert ground.any()
    assert not (truth.in_shadow & ground).any()


def test_a_lamp_in_a_plane_leaves_open_which_side_it_lights() -> None:
    prepared = city(level(-4, -4, 4, 4))
    lamp = lamp_in(prepared, 0.0, 0.0, 1e-4)
    camera = camera_in(prepared, (0.0, 0.0, 3.0), (0.0, 0.01, 0.0))
    truth = judge_of(prepared).truth(camera, lamp)
    eye, rays = pixel_rays(camera)
    away = np.linalg.norm((eye + (0.0 - eye[2]) / rays[..., 2, None] * rays)[..., :2], axis=-1)
    assert not (truth.in_shadow & truth.is_surface).any()
    # 2e-4 rad are 0.1 mm in half a metre.
    assert not truth.is_decidable[away > 0.55].any()
    assert (away > 0.55).any()


def test_the_shadow_of_a_kerb_lower_than_the_far_offset_is_left_open() -> None:
    prepared = city(level(-4, -4, 4, 4), level(-1, -3, 0, 3, 0.01))
    sun = np.array([-np.cos(0.02), 0.0, np.sin(0.02), 0.0], np.float32)
    camera = camera_in(prepared, (1.0, -1.0, 3.0), (1.0, 0.0, 0.0), near_m=0.5)
    truth = judge_of(prepared).truth(camera, sun)
    ground = np.isin(truth.face, [0, 1])
    # 8 mm of height at 0.02 rad are 0.4 m of shadow.
    assert (truth.in_shadow & ground).sum() > 100
    assert not (truth.in_shadow & truth.is_decidable & ground).any()
    assert (~truth.in_shadow & truth.is_decidable & ground).sum() > 100


def test_a_sheet_has_a_lit_side_and_a_dark_one() -> None:
    prepared = city(level(-5, -5, 5, 5, 2.0))
    judge = judge_of(prepared)
    above, below = ((0.5, -3, 5), (0, 0, 2)), ((0.5, -3, -1), (0, 0, 2))
    for eye, light, is_dark in (
        (above, SUN, False),
        (below, SUN, True),
        (above, -SUN, True),
        (below, -SUN, False),
    ):
        truth = judge.truth(camera_in(prepared, *eye), np.where(light == 0.0, 0.0, light))
        assert truth.is_surface.any()
        assert (truth.in_shadow == (truth.is_surface & is_dark)).all()
        assert (truth.is_decidable | near_a_change(truth.is_surface))[truth.is_surface].all()


def test_what_is_before_the_near_plane_is_not_seen_and_casts_shadows() -> None:
    wall = sheet([(-3, 1, 0), (3, 1, 0), (3, 1, 4), (-3, 1, 4)])
    prepared = city(level(-30, -30, 30, 30), wall)
    judge = judge_of(prepared)
    view = (0.0, 0.0, 1.0), (0.0, 6.0, 0.0)
    sun = np.array([0.0, -0.6, 0.8, 0.0], np.float32)
    near = judge.truth(camera_in(prepared, *view, near_m=0.5), sun)
    past = judge.truth(camera_in(prepared, *view, near_m=2.5), sun)
    assert np.isin(near.face, [2, 3]).any()
    assert not np.isin(past.face, [2, 3]).any()
    shaded = past.in_shadow & past.is_decidable
    eye, rays = pixel_rays(camera_in(prepared, *view))
    y = (eye - (eye[2] + prepared.mesh.grid.origin_m[2]) / rays[..., 2, None] * rays)[..., 1]
    assert shaded.any()
    # A wall of 4 m throws 3 m of shadow.
    assert ((y[shaded] > 1.0) & (y[shaded] < 4.0)).all()


def test_a_close_view_far_from_the_origin_is_not_moved() -> None:
    # Float32 holds the eye exactly, but a start on the near plane to 0.25 mm only: half a pixel.
    prepared = city(level(7000, 7000, 7001, 7001), level(-7001, -7001, -7000, -7000))
    camera = camera_in(
        prepared, (7000.98, 7000.5, 0.03), (7001.0, 7000.52, 0.0), fov_deg=40.0, near_m=0.005
    )
    truth = judge_of(prepared).truth(camera, SUN)
    eye, rays = pixel_rays(camera)
    at = (eye - (eye[2] + prepared.mesh.grid.origin_m[2]) / rays[..., 2, None] * rays)[..., :2]
    corner = np.array([7001.0, 7001.0]) - prepared.mesh.grid.origin_m[:2]
    expected = ((at < corner) & (at > corner - 1.0)).all(axis=-1) & (rays[..., 2] < 0)
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal(truth.is_surface, expected)


def test_an_edge_on_sun_lights_nothing_level() -> None:
    prepared = city(level(-9, -9, 9, 9), box((-1, -1, 0), (1, 1, 2)))
    truth = judge_of(prepared).truth(
        camera_in(prepared, (6, -9, 6), (0, 0, 0)), np.array([1, 0, 0, 0], np.float32)
    )
    ground = np.isin(truth.face, [0, 1])
    assert (truth.in_shadow & ground).sum() == ground.sum()
    # A sun a little higher would light it, but for where the box hides that one too.
    is_told = truth.is_decidable & ground
    assert 0 < is_told.sum() < 0.2 * ground.sum()
    east = truth.is_surface & ~ground & ~truth.in_shadow
    assert (truth.is_decidable & east).any()


def test_of_the_sky_nothing_is_said() -> None:
    prepared = city(level(-9, -9, 9, 9))
    for scene in (prepared, nothing()):
        truth = judge_of(scene).truth(camera_in(scene, (0, 0, 5), (0, 1, 9)), SUN)
        assert not truth.is_surface.any()
        assert not truth.is_decidable.any()
        assert not truth.in_shadow.any()
        assert (truth.face == -1).all()
        found = compare(truth, np.zeros((64, 96), np.uint8))
        assert (found.n_surface, found.decidable_share, found.per_million) == (0, 1.0, 0.0)
        assert (difference_picture(truth, np.zeros((64, 96), np.uint8)) == SKY_COLOUR).all()


# What a pixel's centre shows -----------------------------------------------------------------


def face_met(prepared: Prepared, camera: Camera) -> np.ndarray:
    """Return ``(h, w)``: the face that each pixel's float64 ray meets first, -1 for none."""
    eye, rays = pixel_rays(camera)
    corners = prepared.mesh.positions[prepared.mesh.faces].astype(float) - eye
    a, b, c = np.moveaxis(corners, 1, 0)
    sides = np.stack([rays @ np.cross(p, q).T for p, q in ((b, c), (c, a), (a, b))])
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (normal * a).sum(axis=1) / (rays @ normal.T)
    is_met = (sides >= 0.0).all(axis=0) | (sides <= 0.0).all(axis=0)
    depth = np.where(is_met & (depth >= camera.near_m), depth, np.inf)
    return np.where(np.isfinite(depth).any(axis=-1), depth.argmin(axis=-1), -1)


def test_edges_closer_to_centres_than_float32_can_tell() -> None:
    # The eye is moved float32 by float32 past where the roof's edge is at a column's centres.
    prepared = city(level(-40, -40, 40, 40), level(-8, -8, 8, 8, 4.0))
    judge = judge_of(prepared)
    above = camera_in(prepared, (0.37, 0.71, 39.3), (0.37, 0.71, 0.0), (40, 24))
    column = above.directions(np.array([24.5]), np.array([12.5]))[0]
    top = prepared.mesh.positions[prepared.mesh.faces[2]]
    height = float(above.eye[2]) - float(top[0, 2])
    x = np.float32(float(top[:, 0].max()) - height * column[0])
    for step in range(-4, 5):
        eye = above.eye.copy()
        eye[0] = x + step * np.spacing(x)
        camera = replace(above, eye=eye)
        truth = judge.truth(camera, SUN)
        np.testing.assert_array_equal(truth.face, face_met(prepared, camera), str(step))


def test_of_walls_with_the_same_corners_the_first_is_shown() -> None:
    corners = [(0, 0, 0), (6, 0, 0), (6, 0, 4), (0, 0, 4)]
    turned = [corners[i] for i in (2, 1, 0, 3)]
    for one, other in ((corners, turned), (turned, corners)):
        prepared = city(sheet(one), sheet(other), sheet(one))
        camera = camera_in(prepared, (2.0, -5.0, 3.0), (3.0, 0.0, 2.0))
        truth = judge_of(prepared).truth(camera, SUN)
        assert np.unique(truth.face).tolist() == [-1, 0, 1]


# Overlaps ----------------------------------------------------------------------------------------


def seen_parts(prepared: Prepared, camera: Camera, low: float, high: float) -> int:
    """Return how many pixels see the plane z = 1 with x and y inside a square's columns."""
    eye, rays = pixel_rays(camera)
    at = eye + ((1.0 - prepared.mesh.grid.origin_m[2] - eye[2]) / rays[..., 2])[..., None] * rays
    at = at + prepared.mesh.grid.origin_m
    in_columns = (at[..., 0] > low) & (at[..., 0] < high) & (at[..., 1] > 0) & (at[..., 1] < 10)
    return int((in_columns & (rays[..., 2] < 0)).sum())


@pytest.mark.parametrize("is_turned", [False, True])
def test_coincident_sheets_are_listed(is_turned: bool) -> None:
    other = sheet([(5, 0, 1), (5, 10, 1), (15, 10, 1), (15, 0, 1)]) if is_turned else None
    prepared = city(
        level(0, 0, 10, 10, 1.0), other or level(5, 0, 15, 10, 1.0), names=("yard", "lawn")
    )
    camera = camera_in(prepared, (7.1, -6.3, 9.2), (7.3, 5.2, 1.0))
    judge = judge_of(prepared)
    truth = judge.truth(camera, SUN)
    expected = seen_parts(prepared, camera, 5.0, 10.0)
    # Pixels on a shared diagonal lie strictly inside of no face.
    assert [one.names for one in truth.overlaps] == [("yard", "lawn")]
    assert expected - 3 <= truth.overlaps[0].pixels <= expected
    assert (truth.is_decidable | near_a_change(truth.is_surface))[truth.is_surface].all()


def test_three_sheets_in_one_place_are_three_pairs_at_most() -> None:
    prepared = city(*[level(0, 0, 8, 8, 1.0)] * 3, names=("a", "b", "c"))
    camera = camera_in(prepared, (4.1, -5.3, 9.2), (4.3, 4.2, 1.0))
    truth = judge_of(prepared).truth(camera, SUN)
    pixels = sum(one.pixels for one in truth.overlaps)
    # A pixel shows one of them, and counts a pair with each of the others.
    assert 0.98 * truth.is_surface.sum() < pixels / 2 <= truth.is_surface.sum()
    assert {one.names for one in truth.overlaps} <= {("a", "b"), ("a", "c"), ("b", "c")}
    assert [one.pixels for one in truth.overlaps] == sorted(
        (one.pixels for one in truth.overlaps), reverse=True
    )


@pytest.mark.parametrize(("gap", "is_listed"), [(0.0015, True), (0.0025, False)])
def test_sheets_overlap_within_the_offset(gap: float, is_listed: bool) -> None:
    prepared = city(level(0, 0, 8, 8, 1.0), level(2, 2, 6, 6, 1.0 - gap), names=("top", "under"))
    camera = camera_in(prepared, (4.1, -5.3, 2.2), (4.3, 4.2, 1.0))
    truth = judge_of(prepared).truth(camera, SUN)
    assert [one.names for one in truth.overlaps] == [("top", "under")] * is_listed


def test_one_object_may_overlap_itself_and_neighbours_do_not() -> None:
    twice = joined(level(0, 0, 6, 6, 1.0), level(2, -1, 4, 7, 1.0))
    prepared = city(twice, level(6, 0, 9, 6, 1.0), names=("twice", "beside"))
    camera = camera_in(prepared, (3.1, -5.3, 9.2), (3.3, 3.2, 1.0))
    truth = judge_of(prepared).truth(camera, SUN)
    assert [one.names for one in truth.overlaps] == [("twice", "twice")]
    tilted = city(level(0, 0, 6, 6), sheet([(0, 0, 0), (6, 0, 0), (6, 6, 0.003), (0, 6, 0.003)]))
    assert judge_of(tilted).truth(camera, SUN).overlaps == ()


# The plain twin ----------------------------------------------------------------------------------


class Twin:
    """The definition, plainly: every pixel, jitter and face, in float64.

    Moeller and Trumbore 1997 finds faces; nothing is left out for what is known already.
    """

    def __init__(self, prepared: Prepared, camera: Camera, light: np.ndarray) -> None:
        self.mesh: Mesh = prepared.mesh
        self.camera, self.light = camera, light
        self.record = prepared.planes.planes[prepared.planes.plane_of_face]
        corners = self.mesh.positions[self.mesh.faces].astype(float)
        self.a, self.b, self.c = np.moveaxis(corners, 1, 0)
        self.normal = np.cross(self.b - self.a, self.c - self.a)
        self.eye = camera.eye.astype(float)
        self.side = np.sign(((self.eye - self.a) * self.normal).sum(axis=1))
        ulp = float(np.spacing(np.abs(self.mesh.positions).max()))
        self.offset = max(0.002, 8.0 * ulp)

    def distances(self, start: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Return ``(n_rays, n_faces)``: where each ray meets each face; infinite: not."""
        edge1, edge2 = self.b - self.a, self.c - self.a
        across = np.cross(along[:, None], edge2)
        scale = (across * edge1).sum(axis=-1)
        away = start[:, None] - self.a
        other = np.cross(away, edge1)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (away * across).sum(axis=-1) / scale
            v = (other * along[:, None]).sum(axis=-1) / scale
            t = (other * edge2).sum(axis=-1) / scale
            return np.where((u >= 0) & (v >= 0) & (u + v <= 1), t, np.inf)

    def states(self, x: np.ndarray, y: np.ndarray, n_offsets: float, turn: int) -> np.ndarray:
        """Return 0 lit, 1 in shadow, -1 sky for points of the picture."""
        rays = self.camera.directions(x, y)
        t = self.distances(np.broadcast_to(self.eye, rays.shape), rays)
        t = np.where(t >= self.camera.near_m, t, np.inf)
        face = t.argmin(axis=1)
        depth = t.min(axis=1)
        is_seen = np.isfinite(depth)
        point = self.eye + np.where(is_seen, depth, 1.0)[:, None] * rays
        w = float(self.light[3])
        towards = self.light[:3].astype(float) - w * point
        if turn >= 0:
            towards = judging._turned(towards, turn)
        at = towards + w * point  # a direction, or the lamp
        record = self.record[face]
        is_facing = np.sign((record[:, :3] * at).sum(axis=1) + w * record[:, 3])
        unit = self.normal[face] / np.linalg.norm(self.normal[face], axis=1)[:, None]
        start = point + (n_offsets * self.offset * self.side[face])[:, None] * unit
        along = at - w * start
        hits = self.distances(start, along)
        end = 1.0 - self.offset / np.linalg.norm(along, axis=1) if w else np.full(len(x), 1e30)
        is_blocked = ((hits > 0) & (hits <= end[:, None])).any(axis=1)
        is_lit = (is_facing == self.side[face]) & (self.side[face] != 0) & ~is_blocked
        return np.where(is_seen, np.where(is_lit, 0, 1), -1)

    def truth(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return surfaces, shadows and what is decidable, ``(h, w)`` each."""
        shape = (self.camera.height_px, self.camera.width_px)
        y, x = (v.ravel() + 0.5 for v in np.indices(shape).astype(float))
        centre = self.states(x, y, 1.0, -1)
        others = [
            self.states(x + 0.7 * i, y + 0.7 * j, 1.0, -1)
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if i or j
        ]
        others += [self.states(x, y, 10.0, -1)]
        others += [self.states(x, y, 1.0, turn) for turn in range(8)]
        is_decidable = (centre >= 0) & np.all([other == centre for other in others], axis=0)
        return tuple(v.reshape(shape) for v in (centre >= 0, centre == 1, is_decidable))


def loose_soup(n: int, seed: int) -> SourceMesh:
    """Return n triangles of all sizes with light between them."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(0.0, 9.0, (n, 1, 3))
    corners = middle + rng.normal(size=(n, 3, 3)) * rng.uniform(0.2, 1.6, (n, 1, 1))
    return source_mesh(np.round(corners.reshape(-1, 3), 3), np.arange(3 * n).reshape(-1, 3))


@pytest.mark.parametrize("light", ["sun", "low sun", "lamp"])
@pytest.mark.parametrize("seed", [1, 2])
def test_random_soups_are_as_the_plain_twin_says(seed: int, light: str) -> None:
    prepared = city(loose_soup(38, seed))
    lights = {
        "sun": SUN,
        "low sun": np.array([0.8, 0.6, 0.05, 0.0], np.float32),
        "lamp": lamp_in(prepared, 5.3, 3.1, 7.7),
    }
    # Amid the triangles: the near plane cuts some of them.
    camera = camera_in(prepared, (-1.2, -0.7, 6.1), (5.1, 4.2, 3.3), (60, 40), near_m=2.0)
    truth = judge_of(prepared).truth(camera, lights[light])
    is_surface, in_shadow, is_decidable = Twin(prepared, camera, lights[light]).truth()
    np.testing.assert_array_equal(truth.is_surface, is_surface)
    np.testing.assert_array_equal(truth.is_decidable, is_decidable)
    np.testing.assert_array_equal(truth.in_shadow, in_shadow)
    assert 0.1 < is_decidable[is_surface].mean() < 1.0
    assert 0.1 < in_shadow[is_surface].mean() < 0.98


def test_lights_are_turned_eight_ways_by_the_angle() -> None:
    rng = np.random.default_rng(0)
    towards = np.concatenate([rng.normal(size=(40, 3)), np.eye(3), -np.eye(3)]) * 30.0
    turned = np.stack([judging._turned(towards, nth) for nth in range(8)])
    np.testing.assert_allclose(
        np.linalg.norm(turned, axis=2), np.tile(np.linalg.norm(towards, axis=1), (8, 1))
    )
    across = turned - np.cos(2e-4) * towards
    size = np.linalg.norm(across, axis=2) / np.linalg.norm(towards, axis=1)
    np.testing.assert_allclose(size, np.sin(2e-4), rtol=1e-9)
    # Equally far around: each is across the light, and 45 degrees from the next.
    cosine = (across * np.roll(across, 1, axis=0)).sum(axis=2) / (across**2).sum(axis=2)
    np.testing.assert_allclose(cosine, np.sqrt(0.5), rtol=1e-6)


def test_the_constants_are_those_of_the_definition() -> None:
    assert constants.PIXEL_JITTER_PX == 0.7
    assert sorted(constants.PIXEL_JITTERS) == [
        (i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j
    ]
    assert (constants.LEAST_OFFSET_M, constants.OFFSET_ULPS) == (0.002, 8.0)
    assert (constants.FAR_OFFSET, constants.N_LIGHT_JITTERS) == (10.0, 8)
    assert constants.LIGHT_JITTER_RAD == constants.PARALLEL_RAD == MOST_TILT_RAD == 2e-4
    for number in ("0.7 px", "2 mm", "8 float32 ulps", "10 times", "8 lights", "0.0002 rad"):
        assert number in JUDGE_CONSTANTS


# Threads, comparing, files -----------------------------------------------------------------------


def same(one: Truth, other: Truth) -> bool:
    return one.overlaps == other.overlaps and all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("in_shadow", "is_surface", "is_decidable", "face")
    )


def test_threads_and_batches_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    prepared = city(loose_soup(38, 3), level(0, 0, 8, 8, 9.0), level(3, 3, 9, 9, 9.0))
    camera = camera_in(prepared, (-6, -9, 16), (4, 4, 3))
    judge = judge_of(prepared)
    whole = judge.truth(camera, SUN)
    assert whole.overlaps
    monkeypatch.setattr(judging, "RAYS_AT_ONCE", 500)
    for n in ("1", "2", "3"):
        monkeypatch.setenv("SVPREP_THREADS", n)
        told: list[tuple[str, int, int]] = []
        again = judge.truth(camera, SUN, lambda *step: told.append(step))  # noqa: B023
        assert same(again, whole)
        assert told[-1] == ("judging", 6144, 6144)
        assert len(told) == 13


@pytest.fixture(scope="module")
def truth() -> Truth:
    prepared, _ = box_on_ground()
    return judge_of(prepared).truth(camera_in(prepared, (-9, -14, 12), (0, 1, 4)), SUN)


def mask_of(truth: Truth) -> np.ndarray:
    return np.where(truth.in_shadow, 255, 0).astype(np.uint8)


def test_flipped_pixels_are_counted_and_shown(truth: Truth) -> None:
    mask = mask_of(truth)
    right = compare(truth, mask)
    assert (right.n_differing, right.per_million, right.n_shadow_in_sky) == (0, 0.0, 0)
    assert right.n_surface == truth.is_surface.sum()
    assert right.decidable_share == right.n_decidable / right.n_surface > 0.9
    (row, column), other = np.argwhere(truth.is_decidable)[[0, -1]]
    for at in ((row, column), tuple(other)):
        mask[at] ^= 255
    open_at = tuple(np.argwhere(truth.is_surface & ~truth.is_decidable)[3])
    mask[open_at] ^= 255
    found = compare(truth, mask)
    assert found.differing.tolist() == [[row, column], other.tolist()]
    assert found.per_million == 2e6 / found.n_decidable
    picture = difference_picture(truth, mask)
    assert picture.shape == (64, 96, 3)
    reds = np.argwhere((picture == WRONG_COLOUR).all(axis=2))
    assert reds.tolist() == found.differing.tolist()
    corner = picture[row + MARKER_PX, column - MARKER_PX if column >= MARKER_PX else column]
    assert corner.tolist() == list(MARKER_COLOUR)
    assert picture[open_at].tolist() not in ([212] * 3, [84] * 3)
    plain = difference_picture(truth, mask_of(truth))
    assert not (plain == WRONG_COLOUR).all(axis=2).any()


def test_shadow_in_the_sky_is_counted_apart(truth: Truth) -> None:
    mask = mask_of(truth)
    assert not truth.is_surface[:5, :5].any()
    mask[2, 2] = 255
    found = compare(truth, mask)
    assert (found.n_differing, found.n_shadow_in_sky) == (0, 1)


def test_a_mask_of_another_kind_is_refused(truth: Truth) -> None:
    with pytest.raises(InputError, match=r"\(64, 95\).*\(64, 96\)"):
        compare(truth, mask_of(truth)[:, 1:])
    with pytest.raises(InputError, match="float64"):
        compare(truth, mask_of(truth).astype(float))
    with pytest.raises(InputError, match="this one 17"):
        compare(truth, np.full((64, 96), 17, np.uint8))


def test_a_truth_comes_back_from_its_file(truth: Truth, tmp_path: Path) -> None:
    kept = replace(truth, overlaps=(Overlap(("a", "b"), 7), Overlap(("c", "c"), 2)))
    path = tmp_path / "truth.npz"
    for one in (truth, kept):
        save_truth(path, one, "city, camera, sun")
        assert same(load_truth(path, "city, camera, sun"), one)
    with pytest.raises(InputError, match="not of"):
        load_truth(path, "city, camera, lamp")
    with pytest.raises(InputError, match="cannot be read"):
        load_truth(tmp_path / "none.npz", "key")
    whole = path.read_bytes()
    for n in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:n])
        with pytest.raises(InputError, match="cannot be read"):
            load_truth(path, "city, camera, sun")
    assert [p.name for p in tmp_path.iterdir()] == ["truth.npz"]


def test_a_truth_of_other_constants_is_refused(
    truth: Truth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "truth.npz"
    save_truth(path, truth, "key")
    monkeypatch.setattr("svprep_runtime.judge_report.JUDGE_CONSTANTS", "looser ones")
    with pytest.raises(InputError, match="other constants"):
        load_truth(path, "key")


def test_a_picture_that_lost_or_made_up_surfaces_differs() -> None:
    truth = Truth(
        in_shadow=np.zeros((6, 6), bool),
        is_surface=np.tril(np.ones((6, 6), bool)),
        is_decidable=np.tril(np.ones((6, 6), bool)),
        face=np.where(np.tril(np.ones((6, 6), bool)), 0, -1).astype(np.int32),
        overlaps=(),
    )
    mask = np.zeros((6, 6), np.uint8)
    shown = truth.is_surface.copy()
    assert compare(truth, mask, shown).n_differing == 0
    shown[4, 1] = False
    shown[1, 4] = True
    found = compare(truth, mask, shown)
    assert found.differing.tolist() == [[4, 1]]
    assert found.n_shadow_in_sky == 1
    assert compare(truth, mask).n_differing == 0  # a mask alone cannot tell
