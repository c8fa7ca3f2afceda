"""The render benchmark counts what can be counted by hand, and its report is whole."""

from __future__ import annotations

import math
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest

from svprep.errors import EnvironmentProblem
from svprep.light import parse_lights
from svprep.model import Prepared
from svprep.pipeline import BuildConfig, prepare
from svprep_runtime.camera import look_at
from svprep_runtime.context import headless
from svprep_runtime.scene import Scene
from svprep_runtime.targets import Targets
from tests.property.meshes import side_by_side
from tests.unit.hours_scenes import level
from tests.unit.scripts import load_script

SUN = "dir:90,45"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module of its own, as ``python3 scripts/NAME.py`` finds it."""
    return load_script("benchmark_render", monkeypatch)


@pytest.fixture(scope="module")
def plate() -> Prepared:
    """A plate of 4 m x 4 m, 10 m above a ground of 40 m x 40 m, clamped for one sun."""
    objects = side_by_side(level(-20, -20, 20, 20), level(-2, -2, 2, 2, z=10.0))
    return prepare(objects, BuildConfig(), lights=parse_lights([SUN]))


@pytest.fixture
def scene(plate: Prepared) -> Iterator[Scene]:
    try:
        with headless() as context, Scene(context, plate) as made:
            yield made
    except EnvironmentProblem as error:
        pytest.skip(f"no OpenGL: {error}")


def test_every_way_draws_the_same_shadow(script: ModuleType, scene: Scene) -> None:
    from render_benchmark.frames import MAP, PLAIN, Way, measure_view
    from render_benchmark.shadow_map import shadow_map

    mesh = scene.cache.mesh
    light = parse_lights([SUN])[0].in_cache_frame(mesh.grid)
    eye, target = np.array([-10.0, -12.0, 18.0]), np.array([-10.0, 0.0, 0.0])
    camera = look_at(eye - mesh.grid.origin_m, target - mesh.grid.origin_m, 48, 32)
    ways = [
        Way(PLAIN),
        Way(MAP),
        Way("each triangle", "zpass"),
        Way("silhouettes", "zfail"),
        Way("silhouettes, clamped", "zfail"),
    ]  # drivers compile long: every way anew
    targets = Targets(scene.context, 48, 32, 1)
    try:
        with shadow_map(scene, light, 256) as drawn:
            view = measure_view(
                "above", scene, targets, camera, light, ways, 1, 60.0,
                lambda meter: drawn.draw(targets, camera, light, meter),
            )  # fmt: skip
    finally:
        targets.release()
    by_way = {found.way: found for found in view.ways}
    assert view.plain.way.volumes == PLAIN
    assert (view.plain.n_updates, view.n_surface > 100) == (0, True)
    # Without volumes nothing is in shadow here: what differs is the shadow, and it is there.
    assert view.plain.n_differing > 20
    for way, found in by_way.items():
        assert len(found.frame_ms) == len(found.count_ms) == 1
        assert found.first_ms > 0.0
        if way.is_counted:
            assert (found.n_differing, found.n_negative) == (0, 0)
        if way.volumes == MAP:
            assert found.n_triangles == 4
            assert found.n_differing <= 10
    each, whole, clamped = (by_way[way] for way in ways[2:])
    # Four triangles of three sides, one of them beside the picture: a geometry shader leaves it.
    # Two sheets of four sides, and the four triangles themselves.
    assert (each.n_triangles, whole.n_triangles) == (11, 12)
    assert each.passes == ["z-pass"]
    assert 0 < clamped.n_updates <= whole.n_updates


def test_all_ways_are_listed(script: ModuleType) -> None:
    from render_benchmark.frames import PLAIN, VOLUMES, ways_of

    ways = ways_of(["zpass", "zfail"], ["float", "stencil"], with_map=True)
    assert len(set(ways)) == len(ways) == 2 + 4 * len(VOLUMES)
    assert ways[0].volumes == PLAIN


def test_a_slow_way_is_drawn_once(script: ModuleType, scene: Scene) -> None:
    from render_benchmark.frames import PLAIN, Way, measure_view

    mesh = scene.cache.mesh
    light = parse_lights([SUN])[0].in_cache_frame(mesh.grid)
    camera = look_at(np.array([0.0, -30.0, 40.0]), np.zeros(3), 16, 16)
    targets = Targets(scene.context, 16, 16, 1)
    try:
        view = measure_view("above", scene, targets, camera, light, [Way(PLAIN)], 3, 0.0)
    finally:
        targets.release()
    assert view.plain.frame_ms == [view.plain.first_ms]


def test_a_map_holds_the_whole_box(script: ModuleType) -> None:
    from render_benchmark.shadow_map import fitted

    sides = np.array([[-3.0, 5.0], [0.0, 2.0], [1.0, 9.0]])
    corners = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    for light in ([0.0, 0.0, 1.0, 0.0], [0.6, 0.0, 0.8, 0.0], [0.0, -1.0, 0.0, 0.0]):
        matrix, width_m, depth_m = fitted(corners, np.array(light, np.float32))
        inside = corners @ matrix[:3, :3].T + matrix[:3, 3]
        np.testing.assert_allclose(np.abs(inside[:, :2]).max(axis=0), 1.0, atol=2e-3)
        assert (inside[:, 2].min(), inside[:, 2].max()) == pytest.approx((0, 1), abs=2e-3)
        # Towards the light is nearer.
        assert (matrix[2, :3] @ np.array(light[:3])) * depth_m == pytest.approx(-1.0, abs=2e-3)
        assert 8.0 <= width_m <= math.dist(corners[0], corners[-1]) * 1.01


def test_steps_are_without_those_inside(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    from render_benchmark import cold_child

    now = iter([0.0, 1.0, 3.0, 10.0])
    monkeypatch.setattr(cold_child.time, "perf_counter", lambda: next(now))
    cpu = iter([0.0, 1.0, 1.5, 4.0])
    monkeypatch.setattr(cold_child.time, "process_time", lambda: next(cpu))
    laps = cold_child.Laps()
    inner = laps.wrapped("inner", lambda: None)
    with laps.step("outer"):
        inner()
    assert laps.seconds == {"inner": 2.0, "outer": 8.0}
    assert laps.cpu_seconds == {"inner": 0.5, "outer": 3.5}


def test_what_cold_starts_watch_is_there(script: ModuleType) -> None:
    from render_benchmark.cold import STEPS
    from render_benchmark.cold_child import WATCHED, owner_of

    for place, step, *functions in WATCHED:
        assert step in STEPS
        assert all(callable(getattr(owner_of(place), name)) for name in functions)


def test_the_report_says_what_was_met(script: ModuleType) -> None:
    from render_benchmark.cold import Cold, Start
    from render_benchmark.frames import MAP, PLAIN, ViewFigures, Way, WayFigures
    from render_benchmark.report import LightFigures, markdown

    def figures(way: Way, *ms: float, **more: int) -> WayFigures:
        return WayFigures(way, 99.0, list(ms), [m / 2.0 for m in ms], **more)

    view = ViewFigures(
        "street", 100,
        [
            figures(Way(PLAIN), 10.0),
            figures(Way(MAP), 15.0, n_triangles=4, n_differing=7),
            figures(Way("each triangle"), 400.0, 600.0, n_triangles=400, n_updates=5000),
            figures(Way("silhouettes, clamped"), 20.0, 40.0, n_triangles=40, n_updates=500),
        ],
        map_texel_m=0.25,
    )  # fmt: skip
    start = Start(
        {"open": 0.1, "read": 0.5}, {"open": 0.1, "read": 0.25}, 1.5, 1.8, 1 << 20, 1 << 20, 3
    )
    report = script.Report(
        machine="a machine", renderer="a renderer", load="load 0", model="generated city",
        objects=2, triangles=4, light=SUN, size="8x8", lit=LightFigures(8, 4, 0, 2, 3),
        cameras={"street": "0,0,0,1,1,1,60"}, views=[view], map_px=4096,
        cold=[Cold("sample city", 4, [start], start), Cold("city", 4, [start], None)],
        peak_bytes=1 << 20, buffer_bytes=1 << 20,
    )  # fmt: skip
    text = markdown(report)
    rows = {line.split("|")[1].strip(): line for line in text.splitlines() if line.startswith("|")}
    triangles = [cell.strip() for cell in rows["each triangle, z-pass, float"].split("|")]
    assert triangles[2:5] == ["500 (400-600)", "50.00", "250 (200-300)"]
    assert triangles[5:10] == ["400", "5,000", "50.0", "625,000", "50,000.0"]
    assert "clamped 16.7 times faster, 10.0 times fewer updates" in " ".join(text.split())
    assert "7.0% of the surface pixels differ" in " ".join(text.split())
    assert "sample city, first picture: aim 2 s, 1.80 s, met" in text
    assert "city, first draw call: aim 1 s, 1.50 s, missed, 1.5 times" in text
    assert max(len(line) for line in text.splitlines() if not line.startswith("|")) <= 100


@pytest.mark.parametrize("size", ["0x4", "4", "4x", "axb", "4x4x4", "-1x4"])
def test_a_size_of_nothing_is_refused(script: ModuleType, size: str) -> None:
    with pytest.raises(SystemExit):
        script.main(["--size", size])
