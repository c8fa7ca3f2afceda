"""Whole files, drawn small and judged by rays: no decidable pixel differs.

The long table, at 1280x1024, is made by ``scripts/judge_shadows.py``.
"""

from __future__ import annotations

from itertools import cycle
from pathlib import Path

import numpy as np
import pytest

from svprep.light import parse_light
from svprep_runtime.camera import Camera, default_camera, look_at
from svprep_runtime.context import Context
from svprep_runtime.frame import Settings, render
from svprep_runtime.judge import Judge, compare
from svprep_runtime.scene import Scene
from svprep_runtime.targets import Targets
from tests.dataset.datasets import DATA, SHARED, build, label

SIZE = (240, 180)
LIGHTS = ("dir:250.3,3", "dir:133.7,20", "dir:31.1,60")
ADMITTED = {"cities/campus_lod1.obj": 3}
"""Pixels of all six pictures of a file that differ, at details finer than these coarse pixels'
own grid; may only go down."""
WAYS = (
    Settings(method="zfail"),
    Settings(method="zpass", construction="geometry"),
    Settings(method="auto", counter="stencil"),
)
FILES = [
    DATA / "small_city.obj.gz",
    *(
        DATA / "conformance" / f"{name}.obj"
        for name in (
            "mobius_strip",
            "nested_solids",
            "near_coplanar_wall",
            "t_junction",
            "open_shell",
        )
    ),
    SHARED / "cities" / "amsterdam_station.glb",
    SHARED / "cities" / "campus_lod1.obj",
]


def views(positions: np.ndarray) -> list[Camera]:
    """All of the model from above, and low across it."""
    whole = default_camera(positions, *SIZE)
    low, high = positions.min(axis=0).astype(float), positions.max(axis=0).astype(float)
    middle, extent = (low + high) / 2.0, high - low
    across = middle + np.array([0.31, -0.27, 0.0]) * extent + [0.0, 0.0, 0.55 * extent[2]]
    return [whole, look_at(across, middle, *SIZE)]


@pytest.mark.parametrize("path", FILES, ids=label)
def test_rays_see_the_same_shadows(context: Context, path: Path) -> None:
    if not path.exists():
        if path.is_relative_to(SHARED):
            pytest.skip(f"{label(path)} of ../shared/data is not here")
        pytest.fail(f"{path} is missing")
    prepared = build(path).prepared
    judge = Judge(prepared.mesh, prepared.planes, prepared.object_names)
    ways = cycle(WAYS)
    n_decidable = n_differing = 0
    targets = Targets(context, *SIZE, 1)
    try:
        with Scene(context, prepared) as scene:
            for camera in views(prepared.mesh.positions):
                for spec in LIGHTS:
                    light = parse_light(spec).in_cache_frame(prepared.mesh.grid)
                    picture = render(scene, targets, camera, [light], next(ways))
                    found = compare(judge.truth(camera, light), picture.mask, picture.is_surface)
                    assert found.n_shadow_in_sky == 0, spec
                    n_differing += found.n_differing
                    n_decidable += found.n_decidable
    finally:
        targets.release()
    assert n_decidable > 2_000
    assert n_differing <= ADMITTED.get(label(path), 0)
