"""Tables that no build makes are refused before clamping, or hours, go astray on them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from svprep.clamp import clamp_lights, selected
from svprep.errors import CacheError
from svprep.hours import sun_hours
from svprep.light import parse_arc, parse_light
from svprep.model import Prepared
from svprep.pipeline import BuildConfig, prepare
from tests.property.meshes import cube, moved, side_by_side
from tests.unit.test_silhouette_contradictions import changed, put

ARC = "sun:48.2,16.37,2026-06-21/10:00/14:00/2h[Europe/Vienna]"
MESH = {
    "component start beyond": ("components.face_start", put(1, 10**9)),
    "last component start beyond": ("components.face_start", put(-1, 4 * 10**9)),
    "component without faces": ("components.face_start", put(1, 0)),
    "object start falls": ("mesh.object_face_start", put(1, 10**6)),
    "corner beyond": ("mesh.faces", put((3, 1), 10**8)),
    "position infinite": ("mesh.positions", put((2, 0), np.inf)),
    "position not a number": ("mesh.positions", put((2, 0), np.nan)),
}
CLUSTERS = {
    "cluster start beyond": ("scene.cluster_start", put(-1, 10**8)),
    "cluster start falls": ("scene.cluster_start", put(1, 10**6)),
    "clusters all empty": ("scene.cluster_start", put(slice(None), 0)),
    "clustered face beyond": ("scene.faces", put(4, 10**8)),
    "clustered face missing": ("scene.faces", lambda a: a[:-1].copy()),
}


@pytest.fixture(scope="module")
def boxes() -> Prepared:
    city = side_by_side(cube(6.0), moved(cube(4.0), (9.0, 0.0, 2.0)))
    return prepare(city, BuildConfig(), lights=[parse_light("dir:10,40")])


@pytest.mark.parametrize("light", ["dir:135,30", "point:3,20,9"])
@pytest.mark.parametrize("what", [*MESH, *CLUSTERS])
def test_clamping_refuses_it(boxes: Prepared, what: str, light: str) -> None:
    city = changed(boxes, *{**MESH, **CLUSTERS}[what])
    with pytest.raises(CacheError, match="contradict each other"):
        clamp_lights(city.mesh, city.components, city.scene, [parse_light(light)])


@pytest.mark.parametrize("what", MESH)
def test_sun_hours_refuse_it(boxes: Prepared, what: str) -> None:
    with pytest.raises(CacheError, match="contradict each other"):
        sun_hours(changed(boxes, *MESH[what]), parse_arc(ARC))


def test_sun_hours_refuse_a_plane_that_is_not_there(boxes: Prepared) -> None:
    city = changed(boxes, "planes.plane_of_face", put(0, 10**6))
    with pytest.raises(CacheError, match="contradict each other"):
        sun_hours(city, parse_arc(ARC))


@pytest.mark.parametrize("change", [put(-1, 4 * 10**9), put(0, 1)])
def test_lights_that_reach_beyond_their_segments_are_refused(
    boxes: Prepared, change: Callable[[np.ndarray], Any]
) -> None:
    city = changed(boxes, "clamp.light_start", change)
    with pytest.raises(CacheError, match="contradict each other"):
        selected(city.clamp, [0])
