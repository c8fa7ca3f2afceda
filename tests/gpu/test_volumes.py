"""Named scenes by pixels: every way to count agrees with rays, and with what is known by hand.

Each view is drawn by every method, construction and counter, whole and, where segments are
cached, clamped. `problems_of` compares masks with the judge and counts with the faces
between what is seen and the light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest

pytest.importorskip("embreex")

from svprep.errors import InputError
from svprep.model import ComponentFlag, Prepared, SourceMesh
from svprep_runtime.camera import Camera
from svprep_runtime.eye import eye_count
from svprep_runtime.frame import METHODS, Settings
from svprep_runtime.judge import Truth, compare
from svprep_runtime.volumes import casters_of, segments_of
from tests.gpu.scenes import (
    Stage,
    built,
    camera_of,
    count_expected,
    every_setting,
    is_near_a_change,
    light_of,
    problems_of,
    rays_of,
    truth_of,
)
from tests.property.meshes import (
    cube,
    inner_wall,
    joined,
    moved,
    source_mesh,
    strip_of_one_side,
    turned,
)
from tests.property.meshes import scaled as scaled_mesh
from tests.unit.hours_scenes import TOP, box, level, sheet

GROUND = level(-16, -16, 16, 16)
SUN = "dir:127,38"
LOW_SUN = "dir:127,6"
View = tuple[tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True)
class Case:
    """A scene, where it is looked at from, and what lights it."""

    make: Callable[[], list[SourceMesh]]
    views: tuple[View, ...]
    lights: tuple[str, ...]
    near_m: float = 0.05
    methods: tuple[str, ...] = METHODS
    counts: bool = True
    """Counts are the number of faces: not where faces coincide, whose order is open."""


def room() -> list[SourceMesh]:
    """A box to be lit from inside, with a pillar."""
    return [box((-5, -4, 0), (5, 4, 5)), box((1, -1, 0), (2, 1, 3))]


def shelled(n: int, without: tuple[int, ...] = ()) -> SourceMesh:
    """n nested boxes about (0, 0, 5), two metres and more a side."""
    radii = 1.0 + 0.015 * np.arange(n)
    return joined(*[box((-r, -r, 5 - r / 4), (r, r, 5 + r / 4), without) for r in radii.tolist()])


def stacked(n: int) -> list[SourceMesh]:
    """n level sheets above each other over the ground: a count of n beneath."""
    return [GROUND, joined(*[level(-3, -3, 3, 3, 3.0 + 0.01 * i) for i in range(n)])]


def moebius() -> SourceMesh:
    return moved(scaled_mesh(strip_of_one_side(24), 4.0), (0.0, 0.0, 3.0))


def slivers() -> SourceMesh:
    """A fan of 40 triangles a few centimetres wide, 6 m long, about one corner."""
    angles = np.linspace(0.1, 0.5, 41)
    rim = 6.0 * np.column_stack([np.cos(angles), np.sin(angles), 0.1 * np.sin(9 * angles)])
    vertices = np.vstack([[0, 0, 0], rim]) + (-3, -2, 3)
    return source_mesh(vertices, np.array([[0, i, i + 1] for i in range(1, 41)]))


FROM_ABOVE: View = ((-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
FROM_ASIDE: View = ((13.0, -6.0, 4.0), (0.1, 0.3, 1.5))

CASES = {
    "a box lit from inside": Case(
        room,
        (((-4.3, -3.2, 3.1), (2.0, 0.5, 1.0)), ((-9.0, -14.0, 12.0), (0.0, 0.0, 1.0))),
        ("point:-2.1,1.3,3.7",),
    ),
    "a solid with an inner wall": Case(
        lambda: [GROUND, scaled_mesh(inner_wall(), 2.0)], (FROM_ABOVE, FROM_ASIDE), (SUN, LOW_SUN)
    ),
    "forty nested shells": Case(lambda: [GROUND, shelled(40)], (FROM_ABOVE,), (SUN,)),
    "a Moebius strip": Case(
        lambda: [GROUND, moebius()], (FROM_ABOVE, FROM_ASIDE), (SUN, "point:0.4,0.3,6.1")
    ),
    "two coincident opposite sheets": Case(
        lambda: [GROUND, level(-3, -3, 3, 3, 2.0), turned(level(-3, -3, 3, 3, 2.0))],
        (FROM_ABOVE, ((5.0, -7.0, 1.0), (0.0, 0.0, 1.6))),
        (SUN,),
        counts=False,
    ),
    "two coincident opposite sheets of one object": Case(
        lambda: [GROUND, joined(level(-3, -3, 3, 3, 2.0), turned(level(-3, -3, 3, 3, 2.0)))],
        (FROM_ABOVE, ((5.0, -7.0, 1.0), (0.0, 0.0, 1.6))),
        (SUN,),
        counts=False,
    ),
    "doubled faces": Case(
        lambda: [GROUND, cube(4.0), cube(4.0)], (FROM_ABOVE,), (SUN,), counts=False
    ),
    "an open sheet": Case(
        lambda: [GROUND, sheet([(-3, -2, 2), (3, -2, 2), (3, 2, 4), (-3, 2, 4)])],
        (FROM_ABOVE, ((-5.0, -9.0, 1.0), (0.0, 0.0, 3.0)), ((3.0, 9.0, 0.5), (0.0, 0.0, 3.0))),
        (SUN, "dir:10,50"),
    ),
    "an open box": Case(
        lambda: [GROUND, box((-3, -2, 0.5), (3, 2, 4), without=tuple(TOP))],
        (FROM_ABOVE, ((0.5, -1.5, 3.6), (-1.0, 1.0, 1.0))),
        (SUN, "point:0.6,0.4,2.2"),
    ),
    "the sun edge-on to a wall": Case(
        lambda: [GROUND, sheet([(-4, 1, 0), (4, 1, 0), (4, 1, 3), (-4, 1, 3)])],
        (FROM_ABOVE,),
        ("dir:90,40", "dir:270,40"),
    ),
    "an eye in a shadow": Case(
        lambda: [GROUND, box((-3, -2, 4), (3, 2, 6))],
        (((-2.0, 1.4, 1.2), (5.0, -6.0, 0.5)), ((-2.0, 1.4, 1.2), (1.0, 8.0, 0.3))),
        (SUN,),
    ),
    # Segments end a millimetre above and below the ground: what is displaced of X must not
    # leave them, however coarse the picture.
    "a clamped sheet over level ground": Case(
        lambda: [GROUND, level(-6, -6, 3, -3, 5.0)],
        (((3.2, 9.0, 1.5), (-3.0, 2.0, 0.0)), FROM_ABOVE),
        ("dir:180,30", "dir:180,60"),
    ),
    # The planes of sides hold the eye, exactly: such a side fills the picture or none of it,
    # as the rasteriser rounds, and z-fail must have it before everything.
    "an eye on the sides of shadows": Case(
        lambda: [GROUND, box((-3, -2, 4), (3, 2, 6)), level(-6, -6, 3, -3, 5.0)],
        (((3.0, 9.0, 1.5), (-3.0, 2.0, 0.0)), ((3.0, 9.0, 1.5), (5.0, 16.0, 0.0))),
        ("dir:180,30", "point:3,-9,10.5"),
        methods=("zfail", "zpass", "auto"),
    ),
    "an eye on a slanted side": Case(
        lambda: [GROUND, box((-3, -2, 4), (3, 2, 6))],
        (
            ((-2.017311, 3.896961, 3.537354), (3.0, -4.0, 0.0)),  # (0.5, 2, 6) - 4 light
            ((-2.017311, 3.896961, 3.537354), (-4.0, 12.0, 0.0)),
        ),
        (SUN,),
        methods=("zfail", "zpass", "auto"),
    ),
    "an eye in a solid": Case(
        lambda: [GROUND, box((-3, -2, 0), (3, 2, 4)), box((4, -1, 0), (5, 1, 2))],
        (((0.4, 0.3, 1.7), (5.0, -6.0, 0.5)),),
        (SUN, "point:6.3,-4.1,5.2"),
    ),
    "an eye in several nested volumes": Case(
        lambda: [GROUND, shelled(12), level(-4, -4, 4, 4, 9.0)],
        (((-2.6, 2.2, 2.4), (3.0, -2.0, 0.0)), ((0.2, 0.1, 5.05), (3.0, -2.0, 4.0))),
        (SUN, "dir:127,80"),
    ),
    "a near plane that crosses a wall": Case(
        lambda: [
            GROUND,
            box((-3, -2, 0), (3, 2, 4)),
            sheet([(-5, -4, 0), (5, -4, 0), (5, -4, 3), (-5, -4, 3)]),
        ],
        (((0.3, -4.9, 1.4), (1.5, 0.0, 1.0)), ((4.0, -3.2, 1.4), (0.0, -2.4, 1.0))),
        (SUN, "dir:200,30", "point:-6.2,-7.1,5.3"),
        near_m=1.5,
    ),
    "a lamp between two walls": Case(
        lambda: [
            GROUND,
            box((-4, -3, 0), (-3.6, 3, 3)),
            box((3.6, -3, 0), (4, 3, 3)),
            box((-1, 1, 0), (0, 2, 1)),
        ],
        (FROM_ABOVE, FROM_ASIDE, ((-2.0, -2.0, 1.5), (0.5, 3.0, 0.4))),
        ("point:0.3,0.2,2.1", "point:7.2,-4.3,3.9"),
    ),
    "light from below": Case(
        lambda: [level(-5, -5, 5, 5, 6.0), box((-1, -1, 2), (1, 1, 3))],
        (((7.0, -9.0, -3.0), (0.0, 0.0, 4.0)), ((7.0, -9.0, 9.0), (0.0, 0.0, 5.0))),
        ("dir:127,-52", "point:0.7,-0.6,-2.2"),
    ),
    "slivers": Case(
        lambda: [GROUND, slivers()],
        (FROM_ABOVE, FROM_ASIDE),
        (SUN, LOW_SUN),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_every_way_to_count_agrees_with_rays(stage: Stage, name: str) -> None:
    case = CASES[name]
    prepared = built(*case.make(), lights=case.lights)
    assert len(prepared.clamp) == len(case.lights)
    settings = every_setting(case.methods, clamps=(False, True))
    problems = []
    for spec in case.lights:
        light = light_of(prepared, spec)
        for view in case.views:
            camera = camera_of(prepared, *view, near_m=case.near_m)
            found = problems_of(stage, prepared, camera, light, settings, counts=case.counts)
            problems += [f"{spec}, {view}: {one}" for one in found]
    assert not problems, f"{len(problems)} problems:\n" + "\n".join(problems[:20])


@pytest.mark.parametrize("light", ["sun", "lamp"])
def test_an_eye_on_a_side_up_to_rounding_sees_what_rays_see(stage: Stage, light: str) -> None:
    """The rasteriser may have such an eye beyond the side, and the side fill the picture."""
    rng = np.random.default_rng(3)
    problems, n_close = [], 0
    for nth in range(24):
        turn = rng.uniform(0.0, 2.0 * np.pi)
        c, s = np.cos(turn), np.sin(turn)
        body = box((-3, -2, 4), (3, 2, 6))
        body = replace(body, positions=body.positions @ [[c, s, 0], [-s, c, 0], [0, 0, 1]])
        spec = f"dir:{rng.uniform(0, 360):.3f},{rng.uniform(15, 50):.3f}"
        spec = spec if light == "sun" else "point:3,-9,10.5"
        prepared = built(GROUND, body, lights=[spec])
        vector = light_of(prepared, spec)
        casters = casters_of(prepared, vector)
        ends = prepared.edges.rows[rng.choice(casters.edge[casters.component_of_edge > 0]), :2]
        a, b = prepared.mesh.positions[ends].astype(float)
        on_edge = a + rng.uniform(0.1, 0.9) * (b - a)
        away = vector[3] * on_edge - vector[:3]
        eye = on_edge + rng.uniform(0.5, 3.0) * away / np.linalg.norm(away)
        eye = eye + prepared.mesh.grid.origin_m
        camera = camera_of(prepared, eye, rng.uniform([-9, -9, -0.5], [9, 9, 0.5]), (48, 48))
        segments = segments_of(prepared, vector, clamped=False)
        n_close += len(eye_count(prepared, casters, segments, camera.eye).close)
        settings = every_setting(("zfail", "zpass"), ("vertex",), ("float",), (False, True))
        found = problems_of(stage, prepared, camera, vector, settings, counts=False)
        problems += [f"{nth}, {spec}: {one}" for one in found]
    assert n_close > 20
    assert not problems, f"{len(problems)} problems:\n" + "\n".join(problems[:20])


def test_clamped_volumes_are_drawn_where_segments_are_cached(stage: Stage) -> None:
    prepared = built(GROUND, box((-3, -2, 4), (3, 2, 6)), lights=[SUN])
    camera = camera_of(prepared, *FROM_ABOVE)
    with stage.scene(prepared) as scene:
        for spec, clamp, is_clamped in (
            (SUN, True, True),
            (SUN, False, False),
            (LOW_SUN, True, False),
        ):
            lights = [light_of(prepared, spec)]
            picture, _ = stage.draw(scene, camera, lights, Settings(clamp=clamp))
            assert (picture.tallies[0].n_clamped_segments > 0) == is_clamped


# Known by hand -----------------------------------------------------------------------------------


def on_ground(camera: Camera, prepared: Prepared) -> np.ndarray:
    """Return ``(h, w, 3)``: where the rays of pixels meet z = 0, source coordinates."""
    eye, rays = rays_of(camera)
    eye = eye + prepared.mesh.grid.origin_m
    with np.errstate(divide="ignore"):
        depth = -eye[2] / rays[..., 2]
    return eye + np.where(depth > 0, depth, np.nan)[..., None] * rays


def is_hidden_by_box(
    points: np.ndarray, towards: np.ndarray, low: tuple[float, ...], high: tuple[float, ...]
) -> np.ndarray:
    """Return whether rays from `points` meet a box, by its slabs."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = ((np.array(bound) - points) / towards for bound in (low, high))
    enter, leave = np.minimum(one, two).max(axis=-1), np.maximum(one, two).min(axis=-1)
    return (enter < leave) & (leave > 0)


def unclear(truth: Truth) -> np.ndarray:
    """Return the pixels at edges of surfaces or shadows, which arithmetic does not decide."""
    return is_near_a_change(truth.face) | is_near_a_change(truth.in_shadow.astype(int))


@pytest.mark.parametrize("one", every_setting(), ids=str)
def test_the_shadow_of_a_box_on_the_ground_is_where_arithmetic_has_it(
    stage: Stage, one: Settings
) -> None:
    low, high = (-2.0, -1.5, 2.0), (2.0, 2.5, 3.0)
    prepared = built(GROUND, box(low, high))
    light = light_of(prepared, SUN)
    camera = camera_of(prepared, (-7.0, -12.0, 11.0), (-1.0, 1.0, 0.5), (96, 96))
    truth = truth_of(prepared, camera, light)
    sees_ground = (truth.face == 0) | (truth.face == 1)
    points = on_ground(camera, prepared)
    hidden = is_hidden_by_box(points, light[:3].astype(float), low, high)
    with stage.scene(prepared) as scene:
        picture, _ = stage.draw(scene, camera, [light], one)
    asked = sees_ground & ~unclear(truth)
    assert asked.sum() > 3000
    assert hidden[asked].sum() > 150
    np.testing.assert_array_equal(picture.in_shadow[0][asked], hidden[asked])


@pytest.mark.parametrize("one", every_setting(), ids=str)
def test_a_box_lit_from_inside_is_lit_inside_and_nowhere_else(stage: Stage, one: Settings) -> None:
    prepared = built(box((-5, -4, 0), (5, 4, 5)))
    light = light_of(prepared, "point:-2.1,1.3,3.7")
    inside = camera_of(prepared, (-4.3, -3.2, 3.1), (2.0, 0.5, 1.0))
    outside = camera_of(prepared, (-9.0, -14.0, 12.0), (0.0, 0.0, 2.0))
    with stage.scene(prepared) as scene:
        seen_inside, _ = stage.draw(scene, inside, [light], one)
        assert not seen_inside.mask.any()
        assert (seen_inside.radiance[..., 0] > 0.17).all()  # no hole shows the sky either
        seen_outside, _ = stage.draw(scene, outside, [light], one)
    is_box = truth_of(prepared, outside, light).is_surface
    assert 0.1 < is_box.mean() < 0.9
    sure = ~is_near_a_change(is_box.astype(int))
    np.testing.assert_array_equal((seen_outside.mask == 255)[sure], is_box[sure])


def test_an_inner_wall_changes_nothing_outside(stage: Stage) -> None:
    light, masks = None, []
    for body in (scaled_mesh(inner_wall(), 2.0), cube(4.0)):
        prepared = built(GROUND, body)
        light = light_of(prepared, SUN)
        with stage.scene(prepared) as scene:
            camera = camera_of(prepared, *FROM_ABOVE, (96, 96))
            of_setting = [
                stage.draw(scene, camera, [light], one)[0].mask for one in every_setting()
            ]
        sure = ~unclear(truth_of(prepared, camera, light))
        masks += [mask[sure] for mask in of_setting]
        assert (masks[0] == 255).sum() > 100
    for mask in masks:
        np.testing.assert_array_equal(mask, masks[0])


@pytest.mark.parametrize("one", every_setting(), ids=str)
def test_an_edge_on_wall_casts_nothing_and_is_not_lit(stage: Stage, one: Settings) -> None:
    wall = sheet([(-4, 1, 0), (4, 1, 0), (4, 1, 3), (-4, 1, 3)])
    prepared = built(level(-40, -40, 40, 40), wall)
    light = light_of(prepared, "dir:90,40")
    assert light[1] == 0.0
    with stage.scene(prepared) as scene:
        for y in (-9.0, 11.0):  # its front and its back
            camera = camera_of(prepared, (-6.0, y, 7.0), (0.3, 0.9, 1.0))
            truth = truth_of(prepared, camera, light)
            sure = ~is_near_a_change(truth.face)
            picture, count = stage.draw(scene, camera, [light], one)
            assert (truth.face >= 2).sum() > 100
            assert (picture.in_shadow[0] == (truth.face >= 2))[sure].all()
            assert not count[sure].any()


@pytest.mark.parametrize("one", every_setting(), ids=str)
def test_an_open_sheet_is_lit_on_the_side_of_the_sun_alone(stage: Stage, one: Settings) -> None:
    for body in (level(-3, -3, 3, 3, 2.0), turned(level(-3, -3, 3, 3, 2.0))):
        prepared = built(body)
        light = light_of(prepared, SUN)
        for eye_z, is_dark in ((9.0, False), (-5.0, True)):
            camera = camera_of(prepared, (4.0, -5.0, eye_z), (0.0, 0.0, 2.0))
            is_sheet = truth_of(prepared, camera, light).is_surface
            assert is_sheet.sum() > 300
            with stage.scene(prepared) as scene:
                picture, _ = stage.draw(scene, camera, [light], one)
            sure = ~is_near_a_change(is_sheet.astype(int))
            assert ((picture.mask == 255) == (is_sheet & is_dark))[sure].all()


def test_a_pixel_of_the_mask_is_reached_by_no_light(stage: Stage) -> None:
    prepared = built(GROUND, box((-2, -2, 0), (2, 2, 5)))
    camera = camera_of(prepared, *FROM_ABOVE)
    specs = (SUN, "dir:150,30", "point:6.1,-8.3,9.2")
    lights = [light_of(prepared, spec) for spec in specs]
    with stage.scene(prepared) as scene:
        for one in every_setting():
            alone = [stage.draw(scene, camera, [light], one)[0] for light in lights]
            together, _ = stage.draw(scene, camera, lights, one)
            for i in range(3):
                np.testing.assert_array_equal(together.in_shadow[i], alone[i].in_shadow[0])
            assert ((together.mask == 255) == np.all([a.mask == 255 for a in alone], axis=0)).all()
            assert together.mask.any()
            assert len({a.mask.sum() for a in alone}) == 3
            assert len(together.tallies) == 3


def test_a_picture_without_lights_is_refused(stage: Stage) -> None:
    prepared = built(GROUND, cube(3.0))
    with stage.scene(prepared) as scene, pytest.raises(InputError, match="light"):
        stage.draw(scene, camera_of(prepared, *FROM_ABOVE), [], Settings())


def test_samples_vote(stage: Stage) -> None:
    prepared = built(GROUND, box((-3, -2, 1), (3, 2, 3)), lights=[SUN])
    camera, light = camera_of(prepared, *FROM_ABOVE), light_of(prepared, SUN)
    truth = truth_of(prepared, camera, light)
    with stage.scene(prepared) as scene:
        for samples in (3, 5, 7):
            picture, _ = stage.draw(scene, camera, [light], Settings(samples=samples))
            assert compare(truth, picture.mask).n_differing == 0


# Counts beyond eight bits ------------------------------------------------------------------------

UNDER: View = ((-13.0, -9.0, 2.3), (0.0, 0.0, 0.3))
BESIDE: View = ((-6.5, -5.2, 2.9), (-0.7, 0.5, 0.0))
HIGH_SUN = "dir:127,80"
BOTTOM_ONE = (0,)
"""A triangle of the bottom: the box is open, and its volume robust."""


def test_three_hundred_nested_shells_are_counted(stage: Stage) -> None:
    prepared = built(GROUND, shelled(300))
    assert (prepared.components.flags[1:] & ComponentFlag.SOLID).all()
    light = light_of(prepared, HIGH_SUN)
    camera = camera_of(prepared, *BESIDE, (24, 24), fov_deg=20.0)
    truth = truth_of(prepared, camera, light)
    settings = every_setting(counters=("float",), constructions=("vertex", "geometry"))
    assert problems_of(stage, prepared, camera, light, settings) == []
    expected, is_sure = count_expected(prepared, casters_of(prepared, light), camera, truth)
    assert (expected[is_sure] == 300).sum() > 5
    with stage.scene(prepared) as scene:
        picture, _ = stage.draw(scene, camera, [light], Settings())
    assert picture.tallies[0].highest_count == 300


def test_a_hundred_and_fifty_open_shells_count_twice_where_two_faces_stand(stage: Stage) -> None:
    prepared = built(GROUND, shelled(150, without=BOTTOM_ONE))
    light = light_of(prepared, HIGH_SUN)
    casters = casters_of(prepared, light)
    assert not casters.is_closed.any()
    camera = camera_of(prepared, *BESIDE, (24, 24), fov_deg=20.0)
    truth = truth_of(prepared, camera, light)
    settings = every_setting(counters=("float",), constructions=("vertex", "geometry"))
    assert problems_of(stage, prepared, camera, light, settings) == []
    expected, is_sure = count_expected(prepared, casters, camera, truth, robust=True)
    assert expected[is_sure].max() > 256


def test_eight_bits_take_a_multiple_of_256_for_light(stage: Stage) -> None:
    """Why counts are floats: the stencil counts modulo 256, and 1 to 255 are shadow."""
    for n in (127, 128, 255, 256, 300, 512):
        prepared = built(*stacked(n))
        light = light_of(prepared, HIGH_SUN)
        camera = camera_of(prepared, *UNDER, fov_deg=36.0)
        truth = truth_of(prepared, camera, light)
        # Between the sheets nothing is sure: their own pixels are left out.
        under = truth.is_decidable & (truth.face <= 1) & truth.in_shadow
        core = under & ~unclear(truth)
        assert core.sum() > 100
        with stage.scene(prepared) as scene:
            for counter, method in product(("float", "stencil"), ("zfail", "zpass")):
                one = Settings(method=method, counter=counter)
                picture, count = stage.draw(scene, camera, [light], one)
                is_lit = under & ~picture.in_shadow[0]
                assert picture.tallies[0].n_negative == 0
                assert np.bincount(count[under].astype(int)).argmax() == (
                    n if counter == "float" else n % 256
                )
                if counter == "stencil" and n % 256 == 0:
                    assert is_lit.sum() > 0.5 * under.sum()
                else:
                    assert not is_lit.any()


def test_robust_counts_are_the_faces_between(stage: Stage) -> None:
    for body in (moebius(), box((-3, -2, 0.5), (3, 2, 4), without=tuple(TOP)), slivers()):
        prepared = built(GROUND, body)
        light = light_of(prepared, SUN)
        casters = casters_of(prepared, light)
        assert not casters.is_closed.any()
        camera = camera_of(prepared, *FROM_ABOVE)
        truth = truth_of(prepared, camera, light)
        expected, is_sure = count_expected(prepared, casters, camera, truth, robust=True)
        assert is_sure.sum() > 0.5 * truth.is_decidable.sum()
        with stage.scene(prepared) as scene:
            for one in every_setting():
                _, count = stage.draw(scene, camera, [light], one)
                np.testing.assert_array_equal(count[is_sure], expected[is_sure])
