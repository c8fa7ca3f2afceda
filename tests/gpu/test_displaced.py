"""Where volumes are counted, and which of two faces is seen that float32 cannot tell apart."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from svprep.model import Prepared
from svprep_runtime import frame
from svprep_runtime import gl_raw as g
from svprep_runtime.camera import Camera
from svprep_runtime.frame import Settings
from tests.gpu.scenes import Stage, built, camera_of, light_of, rays_of
from tests.unit.hours_scenes import box, level, sheet

SIZE, LARGER = (96, 72), (160, 120)
SUN = "dir:130,40"


@pytest.mark.parametrize("construction", ["vertex", "geometry"])
@pytest.mark.parametrize("nearer_first", [False, True])
def test_of_faces_at_one_float32_depth_the_nearer_one_is_seen(
    stage: Stage, construction: str, nearer_first: bool
) -> None:
    """Sheets 4 um apart, seen from 120 m: float32 steps there are 7 um and more."""
    far = sheet([(-1, 0, 0), (1, 0, 0), (1, 0, 2), (-1, 0, 2)])
    near = sheet([(-1, -4e-6, 0), (1, -4e-6, 0), (1, -4e-6, 2), (-1, -4e-6, 2)])
    prepared = built(*((near, far) if nearer_first else (far, near)))
    y = prepared.mesh.positions[prepared.mesh.faces][:, :, 1]
    assert 2e-6 < np.ptp(y) < 6e-6
    camera = camera_of(prepared, (0.3, -120.0, 0.9), (0.0, 0.0, 1.0), SIZE, fov_deg=1.0)
    with stage.scene(prepared) as scene:
        light = light_of(prepared, SUN)
        stage.draw(scene, camera, [light], Settings(construction=construction))
        seen = stage.targets(*SIZE).read_seen()
    face = (seen[seen != 0] & 0x7FFFFFFF).astype(int) - 1
    assert len(face) > 2000
    assert (y[face] == y.min()).all()


@pytest.mark.parametrize("near_m", [0.05, 6.0])
def test_points_are_displaced_along_the_normal_but_where_that_hides_them(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, near_m: float
) -> None:
    """By a 25th of a pixel, so that many are hidden: said by rays in float64 to each of them."""
    monkeypatch.setattr(frame, "LIFT_PX", 0.04)
    monkeypatch.setattr(frame, "MOST_LIFT_M", 1.0)
    boxes = [box((x, y, 0), (x + 0.7, y + 0.6, 1 + x / 9)) for x in range(-6, 7) for y in (0, 3, 5)]
    prepared = built(level(-16, -16, 16, 16), *boxes)
    camera = camera_of(prepared, (-2.0, -8.0, 5.0), (0.3, 3.0, 0.5), LARGER, near_m=near_m)
    with stage.scene(prepared) as scene:
        stage.draw(scene, camera, [light_of(prepared, SUN)], Settings())
        targets = stage.targets(*LARGER)
        seen = targets.read_seen()
        found = targets.read(targets.displaced, g.GL_RGBA_INTEGER, g.GL_UNSIGNED_INT, np.uint32, 4)
        depth = targets.read(targets.depth, g.GL_DEPTH_COMPONENT, g.GL_FLOAT, np.float32)
    rows, columns = np.nonzero(seen)
    face = (seen[rows, columns] & 0x7FFFFFFF).astype(int) - 1
    shift = found[rows, columns, :2].copy().view(np.float32).astype(float)
    seen_from, rays = rays_of(camera)
    right, down = rays[0, 1] - rays[0, 0], rays[1, 0] - rays[0, 0]
    rays = rays[rows, columns]
    away = near_m / depth[rows, columns].astype(float)
    placed = (rays + shift[:, :1] * right - shift[:, 1:] * down) * away[:, None]

    corners = prepared.mesh.positions[prepared.mesh.faces].astype(float) - seen_from
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    normal *= np.where((normal * corners[:, 0]).sum(axis=1) > 0.0, -1.0, 1.0)[:, None]
    n = normal[face]
    at = ((n * corners[face, 0]).sum(axis=1) / (n * rays).sum(axis=1))[:, None] * rays
    lift = 0.04 * np.linalg.norm(right) * (at @ camera.forward)[:, None]
    along = at + lift * n

    is_hidden = np.zeros(len(face), bool)
    for i, (a, b, c) in enumerate(corners):
        sides = [along @ np.cross(p, q) for p, q in ((a, b), (b, c), (c, a))]
        is_inside = (np.sign(sides) == np.sign(sides[0])).all(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            times = (normal[i] @ a) / (along @ normal[i])
        is_hidden |= is_inside & (times > 0.0) & (times < 1.0) & (times * away >= near_m)
    tolerance = 1e-6 * away
    is_along = np.linalg.norm(placed - along, axis=1) < tolerance
    np.testing.assert_array_equal(is_along, ~is_hidden & (along @ camera.forward >= near_m))
    assert is_hidden.sum() >= 5
    assert (shift[~is_along] == 0.0).all()
    height = ((placed - at) * n).sum(axis=1)
    assert (height[~is_along] > 0.0).all()


def strips_over_the_ground(seed: int) -> tuple[Prepared, Camera]:
    """Strips a 50th of a millimetre above the ground, edge-on to an eye that looks up.

    What is displaced of the ground is then farther from the picture's plane, and behind them.
    """
    rng = np.random.default_rng(seed)
    pitch = np.radians(35.0)
    up, ahead = np.cos(pitch), np.sin(pitch)
    px = 2.0 * np.tan(np.radians(60.0)) / LARGER[1]
    strips = []
    for _ in range(60):
        y = rng.uniform(1.0, 8.0)
        x, turn = rng.uniform(-y, y) / 2.0, rng.uniform(-0.004, 0.004)
        lift = frame.LIFT_PX * px * max(y * up - 2.0 * ahead, 0.3)
        corners = [(x - 2, 0.2), (x + 2, 0.2), (x + 2, 3.0), (x - 2, 3.0)]
        strips.append(
            sheet([(a, y + turn * (a - x) - ahead * lift * t, up * lift * t) for a, t in corners])
        )
    prepared = built(level(-30, -30, 30, 30), *strips)
    return prepared, camera_of(prepared, (0, 0, 2), (0, up, 2 + ahead), LARGER, fov_deg=120.0)


def a_valley_at_pixel_centres() -> tuple[Prepared, Camera]:
    """Two sheets that cross, steep, where pixels have their centres: at one float32 depth."""
    sheets = [
        sheet([(-3, 10 - d, -3), (3, 10 + d, -3), (3, 10 + d, 3), (-3, 10 - d, 3)]) for d in (9, -9)
    ]
    prepared = built(*sheets)
    return prepared, camera_of(prepared, (0, 0, 0), (0, 1, 0), (65, 65))


@pytest.mark.parametrize("scene_of", [lambda: strips_over_the_ground(1), a_valley_at_pixel_centres])
def test_z_pass_counts_to_points_that_something_all_but_hides(
    stage: Stage, scene_of: Callable[[], tuple[Prepared, Camera]]
) -> None:
    prepared, camera = scene_of()
    highest = 0
    for towards in ((0.1, -0.6, 0.8), (0.1, 0.6, 0.8), (-0.3, -1.0, 0.2), (0.3, -1.0, 0.2)):
        light = np.array([*towards, 0.0], np.float32) / np.float32(np.linalg.norm(towards))
        with stage.scene(prepared) as scene:
            by_zpass, by_zfail = (
                stage.draw(scene, camera, [light], Settings(method=method))[1]
                for method in ("zpass", "zfail")
            )
            is_seen = stage.targets(camera.width_px, camera.height_px).read_seen() != 0
        np.testing.assert_array_equal(by_zpass[is_seen], by_zfail[is_seen])
        assert by_zpass[is_seen].min() >= 0
        highest = max(highest, by_zpass[is_seen].max())
    assert highest > 0
