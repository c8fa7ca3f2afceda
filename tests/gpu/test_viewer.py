"""The viewer's frame with each of its overlays, drawn without a window; and one in a window."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from svprep.cache.writer import write_cache
from svprep.light import Site
from svprep.model import Prepared
from svprep_runtime.context import Context
from svprep_runtime.viewer import core
from svprep_runtime.viewer.canvas import Canvas
from svprep_runtime.viewer.controls import Controls, eye_of
from svprep_runtime.viewer.core import Viewer
from svprep_runtime.viewer.lights import light_controls
from svprep_runtime.viewer.overlays import COUNT_COLOURS
from tests.gpu.scenes import built, camera_of
from tests.gpu.test_resources import live
from tests.unit.cache_samples import nothing
from tests.unit.hours_scenes import box, level

ROOT = Path(__file__).resolve().parents[2]
SUN = "dir:127,38"
SIZE = (320, 240)


@pytest.fixture(scope="module")
def town() -> Prepared:
    return built(
        level(-16, -16, 16, 16),
        box((-3, -2, 1), (3, 2, 4)),
        box((4, -1, 0), (6, 1, 2), without=(0,)),
        lights=[SUN],
    )


def viewer_of(context: Context, prepared: Prepared, *specs: str) -> Viewer:
    camera = camera_of(prepared, (2, -22, 14), (0, 0, 0), SIZE)
    eye = eye_of(camera, prepared.mesh.positions)
    site = Site("", 0.0, 0.0)
    lights = light_controls(specs, site, prepared.mesh.grid, eye.model_m)
    controls = Controls(eye, lights)
    controls.shown = set()
    return Viewer(context, prepared, controls, "town.svp.h5", SIZE)


@pytest.fixture
def viewer(context: Context, town: Prepared) -> Iterator[Viewer]:
    made = viewer_of(context, town, SUN)
    yield made
    made.release()


def drawn(viewer: Viewer, *shown: str) -> np.ndarray:
    """Return what a window of the viewer's size shows."""
    viewer.controls.shown = set(shown)
    into = Canvas(viewer.context, *viewer.size_px)
    try:
        viewer.draw(into.into)
        picture = into.read()
    finally:
        into.release()
    assert viewer.context.gl.glGetError() == 0
    return picture.astype(int)


def changed(one: np.ndarray, other: np.ndarray, least: int = 12) -> np.ndarray:
    return np.abs(one - other).max(axis=2) >= least


def test_the_bare_picture_shows_sky_light_and_shadow(viewer: Viewer) -> None:
    picture = drawn(viewer)
    assert picture[2, 2, 2] > picture[2, 2, 0] > 150  # the sky is blue
    grey = picture[picture.max(axis=2) - picture.min(axis=2) < 25].mean(axis=1)
    assert (grey > 200).sum() > 5000
    assert (grey < 150).sum() > 500


def test_counts_are_coloured_where_something_is_counted_and_nowhere_else(viewer: Viewer) -> None:
    bare, tinted = drawn(viewer), drawn(viewer, "counts")
    count = viewer._layers[1].targets.read_count()
    is_surface = viewer._layers[1].targets.read_seen() != 0
    assert (changed(bare, tinted) == ((count != 0) & is_surface)).all()
    of_one = np.median(tinted[(count == 1) & is_surface], axis=0)
    assert np.abs(of_one - COUNT_COLOURS[0][:3]).max() < 40
    assert (count > 0).sum() > 500


def test_silhouettes_are_thin_lines_along_the_boxes(viewer: Viewer) -> None:
    is_line = changed(drawn(viewer), drawn(viewer, "silhouettes"))
    assert 150 < is_line.sum() < 4000
    rows = drawn(viewer, "silhouettes")[is_line]
    assert np.median(rows[:, 0]) > 200 > np.median(rows[:, 2])  # yellow


def test_volumes_lie_over_the_picture_as_glass(viewer: Viewer) -> None:
    viewer.controls.clamp = False
    bare, glass = drawn(viewer), drawn(viewer, "volumes")
    is_glass = changed(bare, glass, 4)
    assert 500 < is_glass.sum() < 0.9 * is_glass.size
    assert np.abs(bare - glass).max() < 200


def test_ends_show_only_where_segments_are(viewer: Viewer) -> None:
    assert changed(drawn(viewer), drawn(viewer, "ends")).sum() > 500
    viewer.controls.clamp = False
    assert not changed(drawn(viewer), drawn(viewer, "ends")).any()


@pytest.mark.parametrize("panel", ["statistics", "help", "texts"])
def test_texts_are_plates_with_white_words(viewer: Viewer, panel: str) -> None:
    bare, written = drawn(viewer), drawn(viewer, "texts", panel)
    is_new = changed(bare, written)
    assert is_new.mean() > 0.04
    assert (written[is_new].min(axis=1) > 150).sum() > 50


def test_statistics_name_each_pass(viewer: Viewer) -> None:
    drawn(viewer, "statistics", "texts")
    assert {"see", "ambient", "z-pass", "light"} <= {f.name for f in viewer.figures}
    assert viewer.tallies[0].n_clamped_segments > 0


def test_the_object_under_the_cursor_has_its_name(viewer: Viewer, town: Prepared) -> None:
    bare = drawn(viewer, "texts")
    x, y = SIZE[0] / 2, SIZE[1] / 2
    found = viewer.under(x, y)
    assert found is not None
    assert found.name == town.object_names[1]
    # The point is on the box, where the judge of the pixel's centre sees it.
    point = found.point + town.mesh.grid.origin_m
    assert (point >= np.array([-3, -2, 1]) - 1e-3).all()
    assert (point <= np.array([3, 2, 4]) + 1e-3).all()
    viewer.cursor_px = (x, y)
    assert changed(bare, drawn(viewer, "texts", "names"))[-60:, :200].mean() > 0.1
    assert viewer.under(2, 2) is None
    assert viewer.under(-5, 9999) is None
    assert np.isfinite(viewer.point_under(2, 2)).all()


def test_a_picture_at_rest_is_not_drawn_again(viewer: Viewer) -> None:
    into = Canvas(viewer.context, *SIZE)
    assert viewer.draw(into.into)
    assert not viewer.draw(into.into)
    viewer.controls.key_down("NUMBER_3")
    assert viewer.draw(into.into)
    into.release()


@pytest.mark.parametrize("key", ["NUMBER_2", "NUMBER_3", "NUMBER_4", "C", "G"])
def test_methods_show_the_same_picture(viewer: Viewer, key: str) -> None:
    bare = drawn(viewer)
    viewer.controls.key_down(key)
    assert changed(bare, drawn(viewer)).sum() <= 4


def test_a_slow_machine_draws_coarsely_while_things_move(
    viewer: Viewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    fine = drawn(viewer)
    monkeypatch.setattr(core, "SLOW_S", 1e-9)
    into = Canvas(viewer.context, *SIZE)
    assert viewer.draw(into.into, is_moving=True)
    coarse = into.read().astype(int)
    assert viewer.is_coarse
    assert viewer.under(SIZE[0] / 2, SIZE[1] / 2) is not None
    assert changed(fine, coarse).mean() < 0.25
    monkeypatch.setattr(core, "TOO_SLOW_S", 0.0)
    assert viewer.draw(into.into, is_moving=True)
    assert viewer.tallies == ()  # the eye moves without shadows
    viewer.controls.key_down("J")
    assert viewer.draw(into.into, is_moving=True)
    assert len(viewer.tallies) == 1  # a light that moves is worth them
    viewer.controls.key_down("H")
    assert viewer.draw(into.into)
    assert not changed(into.read().astype(int), fine, 3).any()
    into.release()


def test_a_window_of_no_size_draws_nothing_and_comes_back(viewer: Viewer) -> None:
    bare = drawn(viewer)
    for size in ((0, 0), (0, 100), (100, 0)):
        viewer.resize(*size)
        assert not viewer.draw(0)
    viewer.resize(100, 70)
    assert drawn(viewer).shape == (70, 100, 3)
    viewer.resize(*SIZE)
    assert (drawn(viewer) == bare).all()


def test_lights_that_are_gone_take_no_memory(viewer: Viewer) -> None:
    drawn(viewer)
    used = []
    for _ in range(12):
        viewer.controls.key_down("J")
        drawn(viewer)
        used.append(viewer.scene.memory.used_bytes)
    assert max(used) < 1.2 * min(used)
    assert len(viewer.scene._lights) == 1


def test_at_night_only_the_sky_lights(context: Context, town: Prepared) -> None:
    viewer = viewer_of(context, town, "sun:48.2,16.37,2026-06-21T20:50[Europe/Vienna]")
    try:
        day = drawn(viewer)
        for _ in range(12):
            viewer.controls.key_down("J")
        night = drawn(viewer, "counts", "volumes", "silhouettes", "ends")
        assert viewer.tallies == ()
        assert night[2, 2].max() < 90
        assert day[2, 2].max() > 150
        assert night.max() < 170
    finally:
        viewer.release()


def test_a_light_that_cannot_be_drawn_leaves_the_picture_as_it_was(
    context: Context, town: Prepared
) -> None:
    vertex = town.mesh.positions[4].astype(float) + town.mesh.grid.origin_m
    x, y, z = vertex.tolist()
    viewer = viewer_of(context, town, f"point:{x},{y},{z + 1}")
    try:
        bare = drawn(viewer)
        way = viewer.controls.light.way
        way.at = way.at - np.array([0.0, 0.0, 1.0])  # type: ignore[attr-defined]
        assert (drawn(viewer) == bare).all()
        assert "vertex" in viewer.controls.message
        viewer.controls.key_down("M")
        assert changed(bare, drawn(viewer), 4).any()
    finally:
        viewer.release()


def test_an_empty_cache_shows_the_sky(context: Context) -> None:
    viewer = viewer_of(context, nothing(), SUN)
    try:
        picture = drawn(viewer, "volumes", "silhouettes", "counts")
        assert not changed(picture, picture[:1, :1]).any()
        assert np.isfinite(viewer.point_under(5, 5)).all()
    finally:
        viewer.release()


def test_all_is_given_back(context: Context, town: Prepared) -> None:
    before = live(context)
    viewer = viewer_of(context, town, SUN, "dir:20,30")
    drawn(viewer, "texts", "volumes", "silhouettes", "ends", "counts", "help")
    viewer.resize(77, 55)
    drawn(viewer, "texts")
    viewer.release()
    assert live(context) == before


SCRIPT = """
import sys
from pathlib import Path
from svprep_runtime.app import view

def after(stage):
    window, keys = stage.window, stage.window.keys
    def press(key):
        window.on_key_press(key, 0)
        window.on_key_release(key, 0)
    match stage.n_rounds:
        case 1: press(keys.P)
        case 2:
            press(keys.K)
            window.on_text("?")
        case 3: window.size = (300, 200)
        case 8:
            window.on_mouse_motion(150, 100, 1, 1)
            window.on_mouse_press(150, 100, 1, 0)
            window.on_mouse_drag(170, 110, 20, 10, 1, 0)
            window.on_mouse_release(170, 110, 1, 0)
            window.on_mouse_scroll(150, 100, 0, 1)
            window.on_mouse_press(150, 100, 4, 0)
            window.on_mouse_drag(190, 100, 40, 0, 4, 0)
            window.on_mouse_release(190, 100, 4, 0)
            press(keys.P)
        case 14:
            print(*stage.viewer.size_px, *sorted(stage.controls.shown))
            press(keys.ESCAPE)
        case 99: sys.exit("the window does not close")

view(Path(sys.argv[1]), ["dir:127,38"], (400, 260), after_frame=after)
print("closed")
"""


def test_a_real_window_opens_takes_events_and_closes(town: Prepared, tmp_path: Path) -> None:
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed: no window was opened (apt-get install xvfb)")
    cache = tmp_path / "town.svp.h5"
    write_cache(town, cache)
    ready, told = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(told), "-screen", "0", "800x600x24", "-nolisten", "tcp"],
        pass_fds=(told,),
        stderr=subprocess.DEVNULL,
    )
    try:
        os.close(told)
        with os.fdopen(ready) as stream:
            display = stream.readline().strip()
        environment = {
            **os.environ,
            "DISPLAY": f":{display}",
            "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "runtime")]),
        }
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT, str(cache)],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=60,
        )
    finally:
        server.terminate()
        server.wait()
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:2] == ["300 200 counts help names texts", "closed"]
    first, second = (np.asarray(Image.open(tmp_path / f"town-00{n}.png")) for n in (1, 2))
    assert first.shape == (260, 400, 3)
    assert second.shape == (200, 300, 3)
    for picture in (first, second):
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


def test_no_display_is_one_line(tmp_path: Path) -> None:
    code = (
        "from svprep.errors import EnvironmentProblem\n"
        "from svprep_runtime.viewer.window import open_window\n"
        "try: open_window('t', 100, 100)\n"
        "except EnvironmentProblem as error: print(error)\n"
    )
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(ROOT / "runtime")])
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    assert "DISPLAY" in done.stdout
    assert "svprep render" in done.stdout
