"""A camera as the user names it, and the numbers that shaders and judge share.

EX,EY,EZ,TX,TY,TZ[,FOV]    eye and target, input coordinates [m]; vertical degrees

     up  ^   . target
         |  / forward
         | /
     eye *-----> right        row 0 of a picture is its top row
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from svprep.errors import InputError
from svprep.model import F32, F64, Grid

DEFAULT_FOV_DEG: Final = 60.0
DEFAULT_NEAR_M: Final = 0.05
FARTHEST_M: Final = 2.0**30
"""[m]: an eye or target this far from the model is an error."""
MOST_PIXELS_A_SIDE: Final = 16384
FORM: Final = "EX,EY,EZ,TX,TY,TZ[,FOV]: eye and target in input coordinates, vertical degrees"


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A pinhole camera in the cache frame, rounded to what shaders compute with."""

    eye: F32
    """``(3,)`` [m]"""
    rows: F32
    """``(3, 3)``: right and up, scaled so that the picture's edges are at -1 and 1, and
    forward: ``rows @ (x - eye)`` is clip x, y and the view depth [m]."""
    width_px: int
    height_px: int
    near_m: float
    """[m] of view depth: what lies nearer is not seen. It casts shadows all the same."""

    @property
    def forward(self) -> F64:
        """``(3,)``, unit."""
        row = self.rows[2].astype(np.float64)
        return row / np.linalg.norm(row)

    def directions(self, x_px: F64, y_px: F64) -> F64:
        """Return ``(n, 3) float64``: rays through points of the picture, of view depth 1.

        The point at view depth d is ``eye + d * direction``. Pixel (column i, row j) has
        its centre at ``(i + 0.5, j + 0.5)``; y grows downwards.
        """
        ndc = np.stack(
            [
                2.0 * np.asarray(x_px, np.float64) / self.width_px - 1.0,
                1.0 - 2.0 * np.asarray(y_px, np.float64) / self.height_px,
                np.ones(np.shape(x_px)),
            ],
            axis=-1,
        )
        return ndc @ np.linalg.inv(self.rows.astype(np.float64)).T

    def near_corners(self) -> F64:
        """Return ``(4, 3) float64`` [m]: the corners of the near rectangle, cache frame."""
        x = np.array([0.0, self.width_px, self.width_px, 0.0])
        y = np.array([0.0, 0.0, self.height_px, self.height_px])
        return self.eye.astype(np.float64) + self.near_m * self.directions(x, y)

    def resized(self, width_px: int, height_px: int) -> Camera:
        """Return this camera with pictures of another size, its vertical angle kept."""
        check_size(width_px, height_px)
        rows = self.rows.astype(np.float64)
        rows[0] *= (self.width_px / self.height_px) * (height_px / width_px)
        return replace(self, rows=rows.astype(np.float32), width_px=width_px, height_px=height_px)


def check_size(width_px: int, height_px: int) -> None:
    """Raise `InputError` unless pictures of that size can be made."""
    if not (1 <= width_px <= MOST_PIXELS_A_SIDE and 1 <= height_px <= MOST_PIXELS_A_SIDE):
        raise InputError(
            f"a picture of {width_px}x{height_px} pixels cannot be made; "
            f"1 to {MOST_PIXELS_A_SIDE} each way"
        )


def look_at(
    eye: F64,
    target: F64,
    width_px: int,
    height_px: int,
    *,
    fov_deg: float = DEFAULT_FOV_DEG,
    near_m: float = DEFAULT_NEAR_M,
) -> Camera:
    """Return a camera at `eye` that looks at `target`, both ``(3,)`` [m], cache frame.

    +z is up in its pictures; looking straight up or down, north is.

    Raises
    ------
    InputError
        Eye and target coincide, an angle outside 1 to 170 degrees, a size of nothing.
    """
    check_size(width_px, height_px)
    if not 1.0 <= fov_deg <= 170.0:
        raise InputError(f"a field of view of {fov_deg:g} degrees cannot be drawn; 1 to 170")
    if not 0.0 < near_m < math.inf:
        raise InputError(f"a near plane at {near_m:g} m is none; a distance above 0")
    for name, point in (("eye", eye), ("target", target)):
        if not (np.abs(point) < FARTHEST_M).all():
            raise InputError(
                f"the camera's {name} is more than {FARTHEST_M:.2g} m from the middle of the model"
            )
    eye32, target32 = np.array(eye, np.float32), np.array(target, np.float32)
    forward = target32.astype(np.float64) - eye32.astype(np.float64)
    length = float(np.linalg.norm(forward))
    if not (math.isfinite(length) and length > 0.0):
        raise InputError("the camera's eye and target are the same point: it looks nowhere")
    forward /= length
    is_vertical = abs(forward[2]) > 1.0 - 1e-9
    above = np.array([0.0, 1.0, 0.0]) if is_vertical else np.array([0.0, 0.0, 1.0])
    right = np.cross(forward, above)
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    scale = 1.0 / math.tan(math.radians(fov_deg) / 2.0)
    rows = np.stack([right * scale * height_px / width_px, up * scale, forward])
    return Camera(
        eye=eye32,
        rows=rows.astype(np.float32),
        width_px=width_px,
        height_px=height_px,
        near_m=near_m,
    )


def parse_camera(spec: str, grid: Grid, width_px: int, height_px: int) -> Camera:
    """Return the camera that `spec` names (`FORM`).

    Raises
    ------
    InputError
        It is not six or seven finite numbers, or what `look_at` says.
    """
    words = spec.split(",")
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) not in (6, 7) or not all(map(math.isfinite, numbers)):
        raise InputError(f'camera "{spec}": expected six or seven numbers, {FORM}')
    origin = np.asarray(grid.origin_m, np.float64)
    return look_at(
        np.array(numbers[:3]) - origin,
        np.array(numbers[3:6]) - origin,
        width_px,
        height_px,
        fov_deg=numbers[6] if len(numbers) == 7 else DEFAULT_FOV_DEG,
    )


def default_camera(positions: F32, width_px: int, height_px: int) -> Camera:
    """Return a camera that sees the whole of `positions` ``(n, 3)`` from the south-west.

    It stands at 35 degrees above the middle of their box, as near as lets all of them be
    seen.
    """
    if not len(positions):
        return look_at(np.array([-1.0, -1.0, 1.0]), np.zeros(3), width_px, height_px)
    low = positions.min(axis=0).astype(np.float64)
    high = positions.max(axis=0).astype(np.float64)
    middle = (low + high) / 2.0
    altitude = math.radians(35.0)
    back = -np.array([math.sin(math.radians(30.0)), math.cos(math.radians(30.0)), 0.0]) * math.cos(
        altitude
    ) + np.array([0.0, 0.0, math.sin(altitude)])
    fov_deg = 45.0
    at = look_at(middle + back, middle, width_px, height_px, fov_deg=fov_deg)
    scaled = at.rows.astype(np.float64)
    seen = (positions - middle) @ scaled.T
    moved = np.zeros(3)
    for _ in range(4):  # a few steps put the middle of what is seen in the middle
        around = seen - moved
        distance = _distance(around)
        on_screen = around[:, :2] / (distance + around[:, 2:])
        moved[:2] += distance * (on_screen.min(axis=0) + on_screen.max(axis=0)) / 2.0
    around = seen - moved
    distance = _distance(around)
    target = middle + np.linalg.solve(scaled, moved)
    return look_at(target + distance * back, target, width_px, height_px, fov_deg=fov_deg)


def _distance(seen: F64) -> float:
    """Return how far away a camera sees all of `seen` ``(n, 3)``: scaled x and y, depth."""
    # A point is seen from a distance d of the origin iff |x|, |y| <= d + depth.
    reach = float((np.abs(seen[:, :2]).max(axis=1) - seen[:, 2]).max())
    return max(1.02 * reach, 10.0 * DEFAULT_NEAR_M)
