"""The depth of volumes' fragments, where a rasteriser's own would miss by metres; and speckles.

Slivers of sides, walls in the very plane of a side, and terrain with T-junctions under a sun
that grazes it.
"""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("embreex")

from svprep.model import Prepared, SourceMesh
from svprep_runtime import gl_raw as g
from svprep_runtime.camera import Camera
from svprep_runtime.frame import camera_uniforms, lift_uniforms
from svprep_runtime.scene import Scene
from svprep_runtime.state import PassState, apply
from svprep_runtime.volumes import SIGN_BIT, casters_of
from tests.gpu.scenes import (
    Stage,
    built,
    camera_of,
    every_setting,
    is_near_a_change,
    light_of,
    problems_of,
    rays_of,
)
from tests.property.meshes import joined, source_mesh, turned
from tests.unit.hours_scenes import box, level, sheet

GROUND = level(-16, -16, 16, 16)

# Slivers -----------------------------------------------------------------------------------------


def depth_of_side(
    stage: Stage, scene: Scene, camera: Camera, light: np.ndarray, edge: int
) -> np.ndarray:
    """Return ``(h, w)``: view depth [m] of the side of one edge where it is drawn, else nan."""
    gl = stage.context.gl
    lit = scene.lit_by(light, clamped=False)
    batch = scene.batch(lit, "vertex")
    targets = stage.targets(camera.width_px, camera.height_px)
    to_point = light[3] == 0.0
    (draw,) = [
        one for one in batch.draws if one.kind == ("sides_to_point" if to_point else "sides")
    ]
    entries = np.frombuffer(batch.entries.read(), np.uint32).reshape(-1, 2)
    of_draw = entries[draw.first_entry : draw.first_entry + draw.n_entries, 0] & ~SIGN_BIT
    nth = draw.first_entry + int(np.flatnonzero(of_draw == edge)[0])
    scene.bind()
    scene.bind_light(lit)
    scene.bind_batch(batch)
    apply(gl, PassState(depth_test="always", depth_write=True))
    gl.glBindTextureUnit(2, 0)  # asked at pixels' centres
    targets.bind(targets.count_into)
    gl.glClearNamedFramebufferfi(targets.count_into, g.GL_DEPTH_STENCIL, 0, 0.0, 0)
    targets.clear_count(0, "float")
    options = ("TO_A_POINT",) if to_point else ()
    program = scene.programs.get("sides.vert", "count.frag", options=options)
    program.set({**camera_uniforms(camera), **lift_uniforms(scene, camera), **lit.uniforms})
    program.set({"first_entry": nth, "is_far": False, "weight": 1.0})
    program.draw(g.GL_TRIANGLES, 3 if to_point else 6)
    reversed_depth = targets.read(targets.depth, g.GL_DEPTH_COMPONENT, g.GL_FLOAT, np.float32)
    is_drawn = targets.read_count() != 0
    with np.errstate(divide="ignore"):
        return np.where(is_drawn, np.float32(camera.near_m) / reversed_depth.astype(float), np.nan)


@pytest.mark.parametrize("spec", ["dir:200,25", "dir:23,12", "point:3.1,-4.7,9.3"])
def test_a_sliver_has_the_depth_of_its_own_plane(stage: Stage, spec: str) -> None:
    """A side seen from a third of a millimetre beside its plane, across the picture.

    A hundredth of a pixel wide, it holds the centres of few pixels; there its depth is that
    of the float64 plane through the same corners.
    """
    rng = np.random.default_rng(9)
    prepared = built(GROUND, box((-3.1, -2.3, 4.2), (2.9, 2.1, 6.3)))
    light = light_of(prepared, spec)
    casters = casters_of(prepared, light)
    edges = casters.edge[casters.component_of_edge > 0]
    size = (300, 200)
    px_rad = 2.0 * np.tan(np.radians(30.0)) / size[1]
    errors, spans = [], []
    with stage.scene(prepared) as scene:
        for _ in range(50):
            edge = int(rng.choice(edges))
            a, b = prepared.mesh.positions[prepared.edges.rows[edge, :2]].astype(float)
            middle = (a + b) / 2.0
            away = light[3] * middle - light[:3]
            away /= np.linalg.norm(away)
            normal = np.cross(b - a, away)
            normal /= np.linalg.norm(normal)
            # Beside the plane, and beside the volume: it runs across the picture from 8 m on.
            target = middle + 6.0 * away
            back = (b - a) / np.linalg.norm(b - a) * rng.choice([-1.0, 1.0])
            distance = rng.uniform(9.0, 14.0)
            beside = rng.uniform(0.5, 1.0) * 0.01 * px_rad * distance * rng.choice([-1.0, 1.0])
            eye = target + distance * back + beside * normal + prepared.mesh.grid.origin_m
            camera = camera_of(prepared, eye, target + prepared.mesh.grid.origin_m, size)
            found = depth_of_side(stage, scene, camera, light, edge)
            at = np.isfinite(found)
            if not at.any():
                continue
            seen_from, rays = rays_of(camera)
            height = (a - seen_from) @ normal
            assert abs(height) < 0.02 * px_rad * distance
            # Where rounded vertices cover more than the side: no nearer or farther than it is.
            depths = [(p - seen_from) @ camera.forward for p in (a, b)]
            low, high = 1.0 / max(depths), 1.0 / min(depths)
            low, high = (0.0, high) if away @ camera.forward > 0.0 else (low, np.inf)
            exact = np.clip(rays[at] @ normal / height, low, high)
            # Towards infinity, what is left of 1 / depth is its rounding.
            is_asked = exact > 1.0 / 40.0
            errors += (1.0 / found[at] / exact - 1.0)[is_asked].tolist()
            y, x = np.nonzero(at)
            spans.append(max(np.ptp(x), np.ptp(y)))
    assert len(errors) > 50
    assert max(spans) > 100
    # What float32 leaves of a plane that turns by its own width: W / 2^24 / width, 0.4 %.
    assert np.abs(errors).max() < 0.005


# In the plane of a side --------------------------------------------------------------------------


def folded(flip: bool) -> SourceMesh:
    """Two sheets that meet in the edge x = 3: a fold, whose side there counts twice."""
    low = [(-1, -2, 6), (3, -2, 6), (3, 2, 6), (-1, 2, 6)]
    vertices = np.array([*low, (-1, -2, 8), (-1, 2, 8)], float)
    fold = source_mesh(vertices, np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]))
    return turned(fold) if flip else fold


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("spec", ["dir:180,30", "point:3,-11,14"])
def test_a_wall_in_the_plane_of_a_side_that_counts_twice(
    stage: Stage, spec: str, flip: bool
) -> None:
    """Seen from within the shadow its points are in it, from outside they are not.

    The wall itself is edge-on to the light and never lit: the count tells.
    """
    wall = [(3, 2.5, 0), (3, 15, 0), (3, 15, 6), (3, 2.5, 6)]
    prepared = built(GROUND, folded(flip), sheet(wall), lights=[spec])
    light = light_of(prepared, spec)
    casters = casters_of(prepared, light)
    origin = prepared.mesh.grid.origin_m
    is_at_wall = casters.component_of_edge == 1
    ends = prepared.mesh.positions[prepared.edges.rows[casters.edge, :2]] + origin
    is_fold = is_at_wall & (ends[..., 0] == 3.0).all(axis=1)
    assert np.abs(casters.multiplicity[is_fold]).tolist() == [2]
    for x, n_around in ((-4.0, 2), (10.0, 0)):
        camera = camera_of(prepared, (x, 9.0, 4.5), (3.0, 9.0, 2.5), (72, 56))
        eye, rays = rays_of(camera)
        depth = (3.0 - origin[0] - eye[0]) / rays[..., 0]
        at = eye + depth[..., None] * rays + origin
        towards = light[:3] - light[3] * (at - origin)
        # Along the light to where the edge of the fold is: z = 6, y from -2 to 2.
        y = at[..., 1] + (6.0 - at[..., 2]) / towards[..., 2] * towards[..., 1]
        on_ground = eye[2] + origin[2] + rays[..., 2] * depth < 0.0
        is_wall = (np.abs(at[..., 1] - 8.75) < 6.25) & (np.abs(at[..., 2] - 3.0) < 3.0)
        expected = np.where(is_wall & (np.abs(y) < 2.0), n_around, 0)
        is_sure = is_wall & ~on_ground & ~is_near_a_change(np.where(is_wall, np.abs(y) < 2.0, -1))
        assert is_sure.sum() > 1000
        assert (np.abs(y) < 2.0)[is_sure].sum() > 300
        with stage.scene(prepared) as scene:
            for one in every_setting():
                picture, count = stage.draw(scene, camera, [light], one)
                np.testing.assert_array_equal(count[is_sure], expected[is_sure], err_msg=str(one))
                assert picture.in_shadow[0][is_sure].all()
                assert picture.tallies[0].n_negative == 0


@pytest.mark.parametrize("flip", [False, True])
def test_what_lies_around_a_side_that_counts_twice(stage: Stage, flip: bool) -> None:
    spec = "dir:180,30"
    wall = box((3, 4, 0), (4, 13, 6))
    prepared = built(GROUND, folded(flip), wall, lights=[spec])
    for eye in ((-5.0, 8.0, 4.5), (12.0, 4.0, 9.0)):
        camera = camera_of(prepared, eye, (3.0, 9.0, 1.5))
        problems = problems_of(
            stage, prepared, camera, light_of(prepared, spec), every_setting(clamps=(False, True))
        )
        assert problems == []


# Terrain -----------------------------------------------------------------------------------------


def patch(x0: float, n: int, step: float) -> SourceMesh:
    """Hills of n x n cells from x0 on: on x = 0, between its corners, straight every metre."""

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        coarse = np.round(8.0 * (0.4 * np.sin(0.9 * y) + 0.3 * np.cos(1.7 * y))) / 8.0
        hills = 0.3 * np.sin(1.3 * x + 0.4 * y) * np.sin(0.7 * y) * np.minimum(np.abs(x), 1.0)
        return coarse + np.round(64.0 * hills) / 64.0

    grid = np.arange(n + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(x0 + step * grid, -4.0 + step * grid))
    below = np.floor(y)
    share = y - below
    z = (1.0 - share) * height(x, below) + share * height(x, below + 1.0)
    cell = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    corners = np.column_stack([cell, cell + 1, cell + n + 2, cell, cell + n + 2, cell + n + 1])
    return source_mesh(np.column_stack([x, y, z]), corners.reshape(-1, 3))


def terrain(is_one_object: bool) -> Prepared:
    """Two patches that meet on x = 0: cells of 1 m and of 0.25 m, three T-junctions each."""
    patches = [patch(-8.0, 8, 1.0), patch(0.0, 32, 0.25)]
    return built(*([joined(*patches)] if is_one_object else patches), lights=["dir:80,3"])


@pytest.mark.parametrize("is_one_object", [False, True], ids=["two objects", "one object"])
def test_terrain_with_t_junctions_has_no_speckles(stage: Stage, is_one_object: bool) -> None:
    """Under a sun that grazes it, from above and from close by, along the seam and across."""
    prepared = terrain(is_one_object)
    views = (((-5.0, -7.0, 10.0), (1.0, 0.0, 0.0)), ((-1.1, -3.5, 2.1), (0.4, 4.0, 0.3)))
    settings = every_setting(
        ("zfail", "zpass"), ("vertex", "geometry"), clamps=(False, True)
    ) + every_setting(("zp+",), ("vertex",))
    for spec in ("dir:80,3", "dir:3,3"):
        light = light_of(prepared, spec)
        for view in views:
            camera = camera_of(prepared, *view, (96, 72))
            problems = problems_of(stage, prepared, camera, light, settings, counts=False)
            assert problems == [], (spec, view)
