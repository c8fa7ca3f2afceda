"""Why a pixel differs: told only where float64 gives what was drawn.

A sheet of 2 mm above a ground that is there twice, looked at from near by:

      o eye
       \\        ________ sheet
    ____\\_______/_________ ground, twice: faces 0, 1 and 2, 3 the other way around
         X
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svprep.cache.reader import open_cache
from svprep.pipeline import build

pytest.importorskip("moderngl", reason="pictures need the extra view: OpenGL")
pytest.importorskip("embreex", reason="judging needs the extra judge: rays")

from svprep_runtime import judge_causes
from svprep_runtime.camera import parse_camera
from svprep_runtime.judge_causes import NOT_FOUND, Tracer

SIZE = (64, 48)
MIDDLE = (32, 24)
FIRST, SECOND, SHEET = 1, 3, 4
"""The faces of the ground at (-1, 1), and the sheet, which lies over the other half."""
STEEP, LOW = (0.1, 0.0, 1.0, 0.0), (0.8, -0.6, 2e-3, 0.0)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("causes")
    model, kept = folder / "sheet.obj", folder / "sheet.svp.h5"
    square = [(x, y, z) for z in (0, 0.002) for x, y in ((-2, -2), (2, -2), (2, 2), (-2, 2))]
    lines = [f"v {x} {y} {z}" for x, y, z in square]
    lines += ["g ground", "f 1 2 3", "f 1 3 4", "f 3 2 1", "f 4 3 1", "g sheet", "f 5 6 7"]
    model.write_text("\n".join(lines) + "\n", encoding="utf-8")
    build([Path(model)], kept)
    with open_cache(kept) as opened:
        yield opened


def tracer(cache, light, target="-1,1,0") -> Tracer:
    camera = parse_camera(f"-1.6,0.5,0.5,{target}", cache.grid, *SIZE)
    return Tracer(cache.mesh, cache.planes, camera, np.float32(light))


def test_what_was_drawn_and_float64_says_too_is_told(cache):
    said = tracer(cache, STEEP).cause(*MIDDLE, drawn=False, face_judged=FIRST)
    assert said.startswith("X itself lit, ")
    assert said.endswith(" mm beside lit, as drawn")


def test_a_displacement_that_leaves_a_thin_shadow_is_told_in_millimetres(cache):
    # Near the diagonal, from where the low sun is seen past the sheet's edge, 2 mm up.
    said = tracer(cache, LOW, "-1,-0.9,0").cause(*MIDDLE, drawn=True, face_judged=FIRST)
    assert said.startswith("X itself shadow, ")
    assert ", 2 mm lit; " in said
    assert said.endswith(" mm beside shadow, as drawn")


def test_another_face_than_the_judge_saw_is_named(cache):
    said = tracer(cache, STEEP).cause(*MIDDLE, drawn=False, face_judged=SHEET)
    assert said.startswith(f"the ray meets face {FIRST} in float64, as drawn, ")
    assert said.endswith(f" px inside; the judge found {SHEET}")


def test_where_a_picture_displaces_a_point_to(cache, monkeypatch):
    """Along the normal; less far beside the ray if that is too far; on it if that is hidden."""
    one = tracer(cache, STEEP)
    ray = one._camera.directions(np.array([MIDDLE[0] + 0.5]), np.array([MIDDLE[1] + 0.5]))[0]
    depth = one._met(one._eye, ray)[FIRST]
    point, lift = one._eye + depth * ray, 1e-3
    one._least_lift_m = lift
    along = point + [0.0, 0.0, lift]
    np.testing.assert_allclose(one._displaced(FIRST, ray, depth), along, atol=1e-12)

    on_ray = point - lift / abs(ray[2]) * ray
    monkeypatch.setattr(judge_causes, "MOST_SHIFT_PX", 0.01)
    found = one._displaced(FIRST, ray, depth)
    away = found - one._eye
    shift = away / (away @ one._camera.forward) - ray
    assert np.linalg.norm(shift) / one._a_pixel == pytest.approx(0.01, rel=1e-5)
    share = np.linalg.norm(found - on_ray) / np.linalg.norm(along - on_ray)
    assert 0.05 < share < 0.95
    np.testing.assert_allclose(on_ray + share * (along - on_ray), found, atol=1e-12)

    hidden = np.full(5, np.inf)
    hidden[SHEET] = 0.5
    monkeypatch.setattr(Tracer, "_met", lambda *of: hidden)
    np.testing.assert_allclose(one._displaced(FIRST, ray, depth), on_ray, atol=1e-12)


def test_what_float64_does_not_give_has_no_cause(cache):
    for face in (FIRST, SECOND, SHEET, -1):
        assert tracer(cache, STEEP).cause(*MIDDLE, drawn=True, face_judged=face) == NOT_FOUND
    sky = tracer(cache, STEEP, "-1,1,5").cause(*MIDDLE, drawn=False, face_judged=FIRST)
    assert sky == NOT_FOUND
