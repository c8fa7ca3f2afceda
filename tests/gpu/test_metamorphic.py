"""What changes no shadow: unwelded, permuted, flipped and shuffled faces, turns, long ways.

Each change is drawn and compared with the judge's answer for the scene unchanged, pixel by
pixel. A scene is turned or moved together with its camera and light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

pytest.importorskip("embreex")

from svprep.model import SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep_runtime.frame import Settings
from svprep_runtime.judge import Truth, compare
from tests.gpu.scenes import Stage, camera_of, light_of, truth_of
from tests.property.meshes import (
    crossing_shell,
    cube,
    inner_wall,
    moved,
    scaled,
    shuffled,
    side_by_side,
    strip_of_one_side,
    turned,
    unwelded,
)
from tests.unit.hours_scenes import box, level

Point = tuple[float, float, float]
EYE, TARGET, LAMP = (-9.0, -14.0, 12.0), (0.25, 0.5, 1.0), (4.5, -1.25, 7.0)
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
FAR = np.array([100_000.0, -100_000.0, 512.0])
SETTINGS = (
    Settings(method="zfail"),
    Settings(method="zpass", construction="geometry", counter="stencil"),
    Settings(method="auto", construction="triangles"),
    Settings(method="zp+", counter="stencil"),
)


def town() -> SourceMesh:
    """Solids, broken ones and open sheets; coordinates on any grid but the strip's."""
    strip = moved(scaled(strip_of_one_side(16), 3.0), (4.0, 5.0, 4.0))
    strip = replace(strip, positions=np.round(strip.positions * 64.0) / 64.0)
    return side_by_side(
        level(-16, -16, 16, 16),
        moved(scaled(inner_wall(), 1.5), (-5.0, -4.0, 0.0)),
        moved(scaled(crossing_shell(), 1.5), (1.0, -5.0, 2.0)),
        box((3, 0, 0), (6, 2, 4), without=(4, 5)),
        moved(cube(2.0), (-4.0, 3.0, 0.0)),
        strip,
    )


def kept(point: Point) -> Point:
    return point


def rotated(point: Point) -> Point:
    return tuple((TURN @ point).tolist())


def far(point: Point) -> Point:
    return tuple((np.array(point) + FAR).tolist())


def permuted(mesh: SourceMesh) -> SourceMesh:
    """Objects in another order, and the vertices of all of them."""
    order = [5, 2, 0, 4, 1, 3]
    start = mesh.object_face_start.tolist()
    faces = np.concatenate([mesh.faces[start[i] : start[i + 1]] for i in order])
    sizes = np.diff(mesh.object_face_start)[order]
    new = np.random.default_rng(5).permutation(len(mesh.positions))
    positions = np.empty_like(mesh.positions)
    positions[new] = mesh.positions
    return replace(
        mesh,
        positions=positions,
        faces=new[faces].astype(np.uint32),
        object_face_start=np.concatenate(([0], np.cumsum(sizes))),
    )


CHANGES: dict[str, tuple[Callable[[SourceMesh], SourceMesh], Callable[[Point], Point]]] = {
    "nothing": (lambda mesh: mesh, kept),
    "unwelded": (unwelded, kept),
    "shuffled": (lambda mesh: shuffled(mesh, 11)[0], kept),
    "permuted": (permuted, kept),
    "flipped": (turned, kept),
    "some flipped": (lambda mesh: turned(mesh, np.arange(0, len(mesh.faces), 3)), kept),
    "all of it": (lambda mesh: unwelded(turned(shuffled(mesh, 3)[0])), kept),
    "turned by 90 degrees": (
        lambda mesh: replace(mesh, positions=np.ascontiguousarray(mesh.positions @ TURN.T)),
        rotated,
    ),
    "100 km away": (lambda mesh: replace(mesh, positions=mesh.positions + FAR), far),
}
LIGHTS = {"sun": "dir:127,38", "low sun": "dir:127,7", "lamp": "point:{},{},{}"}


def spec_of(name: str, change: str) -> str:
    if name == "lamp":
        return LIGHTS[name].format(*CHANGES[change][1](LAMP))
    azimuth = 127 - 90 * (change == "turned by 90 degrees")  # clockwise from north
    return LIGHTS[name].replace("127", str(azimuth))


@cache
def truth(name: str) -> Truth:
    prepared = prepare(town(), BuildConfig())
    camera = camera_of(prepared, EYE, TARGET, (96, 96))
    return truth_of(prepared, camera, light_of(prepared, LIGHTS[name].format(*LAMP)))


@pytest.mark.parametrize("change", CHANGES)
def test_shadows_stay(stage: Stage, change: str) -> None:
    of_mesh, of_point = CHANGES[change]
    prepared = prepare(of_mesh(town()), BuildConfig())
    camera = camera_of(prepared, of_point(EYE), of_point(TARGET), (96, 96))
    with stage.scene(prepared) as scene:
        for name in LIGHTS:
            expected = truth(name)
            assert expected.is_decidable.sum() > 0.85 * expected.is_surface.sum()
            assert 0.04 < expected.in_shadow[expected.is_surface].mean() < 0.9
            light = light_of(prepared, spec_of(name, change))
            for one in SETTINGS:
                picture, _ = stage.draw(scene, camera, [light], one)
                found = compare(expected, picture.mask)
                assert found.n_differing == 0, (name, one, found.differing[:5].tolist())
                assert found.n_shadow_in_sky == 0


def test_the_same_picture_comes_out_twice(stage: Stage) -> None:
    prepared = prepare(town(), BuildConfig())
    camera = camera_of(prepared, EYE, TARGET, (96, 96))
    light = light_of(prepared, LIGHTS["sun"])
    with stage.scene(prepared) as scene:
        for one in SETTINGS:
            first, first_count = stage.draw(scene, camera, [light], one)
            again, again_count = stage.draw(scene, camera, [light], one)
            assert first.radiance.tobytes() == again.radiance.tobytes()
            assert first.mask.tobytes() == again.mask.tobytes()
            assert first_count.tobytes() == again_count.tobytes()
