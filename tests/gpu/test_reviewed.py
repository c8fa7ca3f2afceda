"""Cases that a review found, each small enough to keep."""

from __future__ import annotations

import numpy as np
import pytest

from svprep_runtime.camera import look_at
from svprep_runtime.context import Context
from svprep_runtime.frame import Settings, render
from svprep_runtime.judge import Judge, compare
from svprep_runtime.scene import Scene
from svprep_runtime.targets import Targets
from tests.gpu.scenes import built, light_of
from tests.unit.hours_scenes import box, level

SIZE = (96, 72)


def differing(context: Context, prepared, eye, target, spec: str, settings: Settings) -> int:
    camera = look_at(np.array(eye, float), np.array(target, float), *SIZE)
    light = light_of(prepared, spec)
    truth = Judge(prepared.mesh, prepared.planes, prepared.object_names).truth(camera, light)
    targets = Targets(context, *SIZE, 1)
    try:
        with Scene(context, prepared) as scene:
            picture = render(scene, targets, camera, [light], settings)
    finally:
        targets.release()
    found = compare(truth, picture.mask, picture.is_surface)
    assert found.n_decidable > 500
    return found.n_differing + found.n_shadow_in_sky


def test_zp_plus_under_a_light_that_stands_in_the_near_plane(context: Context) -> None:
    prepared = built(level(-16, -16, 16, 16), box((-3, -2, 0), (3, 2, 4)))
    settings = Settings(method="zp+")
    assert (
        differing(context, prepared, (0.3, -9.0, 3.0), (0.3, 0.0, 3.0), "dir:0,90", settings) == 0
    )


@pytest.mark.parametrize("construction", ["vertex", "geometry"])
def test_a_face_in_whose_plane_the_eye_lies_is_not_seen(
    context: Context, construction: str
) -> None:
    prepared = built(level(-16, -16, 16, 16), level(-2, -2, 2, 2, 1.5), box((4, 4, 0), (6, 6, 3)))
    settings = Settings(construction=construction)  # type: ignore[arg-type]
    eye, target = (0.25, -0.5, 1.5), (5.0, 5.0, 1.5)
    assert differing(context, prepared, eye, target, "dir:200,50", settings) == 0


def test_a_far_lamp_clamped(context: Context) -> None:
    spec = "point:37500,-37500,100000"
    prepared = built(
        level(-16, -16, 16, 16),
        box((-3, -2, 0), (3, 2, 4)),
        box((-1, -1, 4), (1, 1, 5)),
        lights=[spec],
    )
    eye, target = (2.5, 1.0, 4.8), (-3.0, -2.0, 4.0)
    assert differing(context, prepared, eye, target, spec, Settings()) == 0
