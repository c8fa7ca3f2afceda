"""Cameras: what a user writes, and the numbers that shaders and judge compute with."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from svprep.errors import InputError
from svprep.model import Grid
from svprep_runtime.camera import (
    DEFAULT_FOV_DEG,
    DEFAULT_NEAR_M,
    MOST_PIXELS_A_SIDE,
    Camera,
    default_camera,
    look_at,
    parse_camera,
)

GRID = Grid(2.0**-11, np.array([85_000.0, 446_000.0, -2.0]))
SIZES = [(64, 64), (640, 400), (300, 900), (1, 1)]


def seen(camera: Camera, points: object) -> np.ndarray:
    """Return clip x, clip y over depth, and the view depth of points, ``(n, 3)``."""
    away = np.array(points, float).reshape(-1, 3) - camera.eye
    x, y, depth = camera.rows.astype(float) @ away.T
    return np.column_stack([x / depth, y / depth, depth])


def any_camera(seed: int, size: tuple[int, int] = (120, 80)) -> Camera:
    rng = np.random.default_rng(seed)
    eye, target = rng.uniform(-900, 900, (2, 3))
    return look_at(eye, target, *size, fov_deg=rng.uniform(10, 120), near_m=rng.uniform(0.01, 5))


# As the user writes it ---------------------------------------------------------------------------


def test_eye_and_target_are_input_coordinates() -> None:
    camera = parse_camera("85010,446020.5,3,85010,446120.5,3", GRID, 320, 200)
    assert camera.eye.tolist() == [10.0, 20.5, 5.0]
    assert (camera.width_px, camera.height_px) == (320, 200)
    assert camera.near_m == DEFAULT_NEAR_M
    np.testing.assert_allclose(camera.forward, [0, 1, 0], atol=1e-7)
    scale = 1.0 / math.tan(math.radians(DEFAULT_FOV_DEG) / 2.0)
    np.testing.assert_allclose(
        camera.rows, [[scale * 200 / 320, 0, 0], [0, 0, scale], [0, 1, 0]], atol=1e-6
    )


@pytest.mark.parametrize("fov", [1.0, 20.0, 90.0, 170.0])
def test_the_seventh_number_is_the_vertical_angle(fov: float) -> None:
    camera = parse_camera(f" 0, 0,0 ,0,10, 0,{fov}", Grid(1.0, np.zeros(3)), 90, 30)
    top = 10.0 * math.tan(math.radians(fov) / 2.0)
    found = seen(camera, [(0, 10, top), (3.0 * top, 10, 0), (0, 10, -top)])
    np.testing.assert_allclose(found[:, :2], [[0, 1], [1, 0], [0, -1]], atol=1e-5)


@pytest.mark.parametrize(
    "spec",
    ["", "1,2,3", "1,2,3,4,5", "1,2,3,4,5,6,7,8", "1,2,3,4,5,x", "1,2,3,4,5,nan",
     "1,2,inf,4,5,6", "1;2;3;4;5;6", "1,2,3,4,5,6,"],
)  # fmt: skip
def test_what_is_no_camera_is_quoted_with_the_form(spec: str) -> None:
    with pytest.raises(InputError, match="six or seven numbers, EX,EY,EZ") as error:
        parse_camera(spec, GRID, 64, 64)
    assert f'camera "{spec}"' in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        ("1,2,3,1,2,3", "the same point"),
        ("1,2,3,1,2,3.0000001", "the same point"),  # in float32, that is
        ("1,2,3,4,5,6,0.5", "0.5 degrees"),
        ("1,2,3,4,5,6,171", "171 degrees"),
        ("1,2,3,4,5,6,-40", "-40 degrees"),
    ],
)
def test_what_cannot_be_drawn_is_told(spec: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        parse_camera(spec, Grid(1.0, np.zeros(3)), 64, 64)


@pytest.mark.parametrize(
    "size", [(0, 64), (64, 0), (-3, 64), (MOST_PIXELS_A_SIDE + 1, 4), (4, MOST_PIXELS_A_SIDE + 1)]
)
def test_sizes_of_nothing_and_beyond_all_bounds_are_refused(size: tuple[int, int]) -> None:
    told = f"{size[0]}x{size[1]} pixels"
    with pytest.raises(InputError, match=told):
        parse_camera("0,0,0,1,1,1", GRID, *size)
    with pytest.raises(InputError, match=told):
        any_camera(0).resized(*size)
    with pytest.raises(InputError, match=told):
        default_camera(np.eye(3, dtype=np.float32), *size)


@pytest.mark.parametrize("near_m", [0.0, -1.0, math.inf, math.nan])
def test_a_near_plane_lies_before_the_eye(near_m: float) -> None:
    with pytest.raises(InputError, match="near plane"):
        look_at(np.zeros(3), np.ones(3), 64, 64, near_m=near_m)


# What is computed --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(8))
def test_directions_are_the_inverse_of_the_rows(seed: int) -> None:
    camera = any_camera(seed)
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 120, 50), rng.uniform(0, 80, 50)
    directions = camera.directions(x, y)
    found = camera.rows.astype(float) @ directions.T
    np.testing.assert_allclose(found, [x / 60 - 1, 1 - y / 40, np.ones(50)], atol=1e-12)
    # A point of view depth d along one is seen where it came from.
    ends = seen(camera, camera.eye + 7.0 * directions)
    np.testing.assert_allclose(ends[:, 2], 7.0, rtol=1e-6)
    np.testing.assert_allclose((ends[:, 0] + 1) * 60, x, atol=1e-6)


def test_columns_run_right_and_rows_run_down() -> None:
    camera = look_at(np.zeros(3), np.array([0.0, 5.0, 0.0]), 4, 2)  # to the north
    centres = camera.directions(np.array([0.5, 3.5]), np.array([0.5, 1.5]))
    assert centres[0, 0] < 0 < centres[1, 0]
    assert centres[0, 2] > 0 > centres[1, 2]
    np.testing.assert_allclose(camera.directions(2.0, 1.0), [0, 1, 0], atol=1e-7)


@pytest.mark.parametrize("seed", range(8))
def test_rows_are_a_right_handed_frame_with_a_level_horizon(seed: int) -> None:
    camera = any_camera(seed)
    right, up, forward = camera.rows.astype(float)
    assert abs(right[2]) < 1e-6
    assert up[2] > 0
    np.testing.assert_allclose(np.linalg.norm(forward), 1.0, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(camera.forward), 1.0, rtol=1e-15)
    for one, other in ((right, up), (right, forward), (up, forward)):
        assert abs(one @ other) < 1e-5 * np.linalg.norm(one) * np.linalg.norm(other)
    assert np.cross(right, up) @ forward < 0  # y up, and forward into the picture
    np.testing.assert_allclose(
        np.linalg.norm(up) / np.linalg.norm(right), 120 / 80, rtol=1e-5
    )  # square pixels


@pytest.mark.parametrize("seed", range(8))
def test_the_near_rectangle_fills_the_picture(seed: int) -> None:
    camera = any_camera(seed)
    found = seen(camera, camera.near_corners())
    np.testing.assert_allclose(found[:, 2], camera.near_m, rtol=1e-5)
    np.testing.assert_allclose(found[:, :2], [[-1, 1], [1, 1], [1, -1], [-1, -1]], atol=1e-9)


def test_the_eye_is_rounded_before_the_view_is_turned() -> None:
    # The same camera comes out of the rounded numbers: nothing else depends on the rest.
    eye, target = np.array([1e4 / 3, -2e4 / 7, 5.1]), np.array([1e3 / 9, 7.7, 0.3])
    one = look_at(eye, target, 64, 48)
    two = look_at(np.float32(eye).astype(float), np.float32(target).astype(float), 64, 48)
    assert one.rows.tobytes() == two.rows.tobytes()
    assert one.rows.dtype == one.eye.dtype == np.float32


@pytest.mark.parametrize(("z", "right"), [(-9.0, [1, 0, 0]), (9.0, [-1, 0, 0])])
def test_straight_up_and_down_north_is_up(z: float, right: list[float]) -> None:
    camera = look_at(np.array([3.0, 4.0, 0.0]), np.array([3.0, 4.0, z]), 50, 50, fov_deg=90)
    np.testing.assert_allclose(camera.rows, [right, [0, 1, 0], [0, 0, np.sign(z)]], atol=1e-6)
    almost = look_at(np.array([3.0, 4.0, 0.0]), np.array([3.0, 4.001, z]), 50, 50, fov_deg=90)
    assert (almost.rows[1] @ [0, 1, 0] > 0.9) == (z < 0)  # +z up: towards the zenith it turns


def test_another_size_keeps_the_vertical_angle() -> None:
    camera = any_camera(3)
    for width, height in SIZES:
        other = camera.resized(width, height)
        assert (other.width_px, other.height_px) == (width, height)
        np.testing.assert_array_equal(other.rows[1:], camera.rows[1:])
        ratio = np.linalg.norm(other.rows[1]) / np.linalg.norm(other.rows[0])
        np.testing.assert_allclose(ratio, width / height, rtol=1e-5)
    np.testing.assert_allclose(camera.resized(7, 7).resized(120, 80).rows, camera.rows, rtol=1e-6)


# The default -------------------------------------------------------------------------------------

BOXES = {
    "cube": ((-5, -5, 0), (5, 5, 10)),
    "city": ((-4000, -3000, -20), (3500, 5000, 180)),
    "tower": ((0, 0, 0), (2, 3, 300)),
    "street": ((-1000, -2, 0), (1000, 2, 5)),
    "sheet": ((-10, -10, 4), (10, 10, 4)),
    "far from the middle": ((7000, 7000, 90), (7100, 7050, 110)),
}


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", BOXES)
def test_the_default_camera_sees_all_and_fills_the_picture(
    name: str, size: tuple[int, int]
) -> None:
    low, high = BOXES[name]
    corners = np.array(list(product(*zip(low, high, strict=True))), np.float32)
    camera = default_camera(corners, *size)
    found = seen(camera, corners)
    assert (np.abs(found[:, :2]) <= 1.0).all()
    assert (found[:, 2] > camera.near_m).all()
    assert np.abs(found[:, :2]).max() > 0.85
    middle = (np.array(low) + high) / 2.0
    on_screen = found[:, :2]
    np.testing.assert_allclose(on_screen.min(axis=0) + on_screen.max(axis=0), 0.0, atol=0.02)
    # From the south-west, and above.
    assert camera.eye[0] < middle[0]
    assert camera.eye[1] < middle[1]
    assert camera.eye[2] > middle[2]
    np.testing.assert_allclose(math.degrees(math.asin(-camera.forward[2])), 35.0, atol=0.01)


@pytest.mark.parametrize("n", [0, 1])
def test_of_nothing_and_of_a_point_there_is_a_default_camera_too(n: int) -> None:
    camera = default_camera(np.full((n, 3), 40.0, np.float32), 64, 48)
    assert np.isfinite(camera.rows).all()
    if n:
        np.testing.assert_allclose(seen(camera, [40, 40, 40])[0, :2], 0.0, atol=1e-4)
