"""Which face each pixel sees: the one that float64 finds at its centre, not the rasteriser's.

Random triangles, most of them slivers a thousandth to a tenth of a pixel wide, some reaching
behind the eye: a rasteriser that moves corners to 1/256 of a pixel draws many of them where
they are not.
"""

from __future__ import annotations

import numpy as np
import pytest

from svprep.light import parse_light
from svprep.model import Mesh, Prepared
from svprep_runtime.camera import Camera, look_at
from svprep_runtime.frame import Picture, Settings
from svprep_runtime.judge import compare
from tests.gpu.scenes import Stage, built, camera_of, light_of, rays_of, truth_of
from tests.property.meshes import source_mesh

SURE_PX = 1e-4
EYE, TARGET = (0.0, -20.0, 3.0), (0.0, 0.0, 1.0)


def slivers(seed: int, n: int = 400) -> np.ndarray:
    """Return ``(n, 3, 3)`` corners, some of them behind an eye at `EYE`."""
    rng = np.random.default_rng(seed)
    a = rng.uniform((-9, -12, -6), (9, 9, 9), (n, 3))
    b = a + rng.normal(0.0, 6.0, (n, 3))
    b[::5] = a[::5] + rng.uniform((-3, -60, -3), (3, -20, 3), (len(a[::5]), 3))
    along = rng.uniform(-0.2, 1.2, (n, 1))
    width = 10.0 ** rng.uniform(-3.0, 0.0, (n, 1))
    c = a + along * (b - a) + width * rng.normal(0.0, 0.5, (n, 3))
    return np.stack([a, b, c], axis=1)


def seen_in_float64(mesh: Mesh, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest face at each pixel's centre, -1 for none, and where that is sure."""
    eye, rays = rays_of(camera)
    shape, flat = rays.shape[:2], rays.reshape(-1, 3)
    pixel = np.linalg.norm(rays[0, 1] - rays[0, 0])
    nearest, face = np.full(len(flat), np.inf), np.full(len(flat), -1)
    is_sure = np.ones(len(flat), bool)
    for i, corners in enumerate(mesh.positions[mesh.faces].astype(float) - eye):
        volume = corners[0] @ np.cross(corners[1], corners[2])
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (normal @ corners[0]) / (flat @ normal)
        inside = np.full(len(flat), np.inf)
        for k in range(3):
            edge = np.sign(volume) * np.cross(corners[k], corners[(k + 1) % 3])
            across = np.linalg.norm(edge - (edge @ camera.forward) * camera.forward)
            inside = np.minimum(inside, flat @ edge / (across * pixel))
        is_before = depth > camera.near_m
        is_sure &= ~((np.abs(inside) < SURE_PX) & (depth > 0.5 * camera.near_m))
        is_sure &= ~((inside > 0) & (np.abs(depth - nearest) < 1e-5 * depth))
        is_nearer = (inside > 0) & is_before & (depth < nearest)
        nearest[is_nearer], face[is_nearer] = depth[is_nearer], i
    return face.reshape(shape), is_sure.reshape(shape)


@pytest.mark.parametrize("construction", ["vertex", "geometry"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_face_at_the_centre_is_seen(stage: Stage, seed: int, construction: str) -> None:
    soup = slivers(seed)
    prepared = built(source_mesh(soup, np.arange(3 * len(soup)).reshape(-1, 3)))
    camera = camera_of(prepared, EYE, TARGET, near_m=0.05)
    expected, is_sure = seen_in_float64(prepared.mesh, camera)
    with stage.scene(prepared) as scene:
        light = light_of(prepared, "dir:130,40")
        settings = Settings(construction=construction)
        stage.draw(scene, camera, [light], settings)
        seen = stage.targets(camera.width_px, camera.height_px).read_seen()
    found = (seen & 0x7FFFFFFF).astype(np.int64) - 1
    assert is_sure.mean() > 0.95
    assert len(np.unique(expected)) > 100
    wrong = is_sure & (found != expected)
    assert not wrong.any(), f"{wrong.sum()} of {is_sure.sum()}, first {np.argwhere(wrong)[0]}"


def counted_alike(
    stage: Stage, prepared: Prepared, camera: Camera, light: np.ndarray
) -> tuple[Picture, np.ndarray]:
    """Return the picture and the count of whole volumes, which z-pass and z-fail agree on."""
    with stage.scene(prepared) as scene:
        (picture, zpass), (_, zfail) = (
            stage.draw(scene, camera, [light], Settings(method=method, clamp=False))
            for method in ("zpass", "zfail")
        )
    wrong = zpass != zfail
    assert not wrong.any(), f"{wrong.sum()} pixels, first {np.argwhere(wrong)[0]}"
    return picture, zpass


def test_slivers_from_behind_the_eye_are_counted_alike(stage: Stage) -> None:
    """z-pass draws their sides before a floor, z-fail those behind it: one lost tells.

    Each speck lies behind the eye and shades a point of the ray of one pixel; its volume, a
    hundredth of a pixel wide or less, ends in the picture where the light's rays vanish.
    """
    rng = np.random.default_rng(7)
    n, sun = 15_000, parse_light("dir:135,40")
    towards = np.array([sun.x, sun.y, sun.z])
    floor = np.array([[[-700, -500, -100], [700, -500, -100], [0, 900, -100]]])
    eye, target = (0.0, 0.0, 0.0), tuple([0.5, 0.3, 0.4] - 10.0 * towards)
    _, rays = rays_of(look_at(np.array(eye), np.array(target), 512, 512))
    ray = rng.permutation(rays.reshape(-1, 3))[:n]
    shaded = 10.0 ** rng.uniform(0.0, 2.3, (n, 1)) * ray
    on_floor = np.arange(0, n, 3)
    shaded[on_floor] = ray[on_floor] * (-100.0 / ray[on_floor, 2:])
    middle = shaded + rng.uniform(300.0, 500.0, (n, 1)) * towards
    along = rng.normal(0.0, 1.0, (n, 3, 1)) * ray[:, None]
    across = rng.normal(0.0, 1.0, (n, 3, 1)) * np.cross(ray, towards)[:, None]
    specks = middle[:, None] + along + 10.0 ** rng.uniform(-3.0, -0.5, (n, 1, 1)) * across
    soup = np.concatenate([specks, floor])
    prepared = built(source_mesh(soup, np.arange(3 * len(soup)).reshape(-1, 3)))
    camera = camera_of(prepared, eye, target, (512, 512))
    picture, _ = counted_alike(stage, prepared, camera, light_of(prepared, "dir:135,40"))
    assert picture.in_shadow[0].sum() > 500


@pytest.mark.parametrize("seed", [30, 32, 33])
def test_sides_that_end_far_beside_the_picture_are_counted_alike(stage: Stage, seed: int) -> None:
    """The light's rays vanish thousands of pixels beside the picture, behind the eye.

    Specks between the eye and the sun lie close to where these would vanish before it.
    """
    rng = np.random.default_rng(seed)
    spec = f"dir:{rng.uniform(75.0, 89.5):.3f},{rng.uniform(5.0, 45.0):.3f}"
    sun, n = parse_light(spec), 1500
    towards = np.array([sun.x, sun.y, sun.z])
    eye, target = np.array([0.0, 0.0, 1.7]), (0.0, 10.0, 1.7 - rng.uniform(0.0, 3.0))
    middle = eye + towards * 10.0 ** rng.uniform(0.5, 2.0, (n, 1))
    middle += rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-2.0, 0.3, (n, 1))
    specks = middle[:, None] + rng.normal(size=(n, 3, 3)) * 10.0 ** rng.uniform(
        -1.5, 0.3, (n, 1, 1)
    )
    floor = [[[-300, -100, 0], [300, -100, 0], [0, 500, 0]]]
    wall = [[[-300, 60, -5], [300, 60, -5], [0, 60, 300]]]
    soup = np.concatenate([specks, np.array(floor, float), np.array(wall, float)])
    prepared = built(source_mesh(soup, np.arange(3 * len(soup)).reshape(-1, 3)))
    camera = camera_of(prepared, eye, target, (200, 160), fov_deg=5.0)
    light = light_of(prepared, spec)
    picture, count = counted_alike(stage, prepared, camera, light)
    assert (count >= 0).all()
    compared = compare(truth_of(prepared, camera, light), picture.mask, picture.is_surface)
    assert compared.n_decidable > 25_000
    assert compared.n_differing == 0
