"""The viewer's controls: where the eye and the lights get, without a window or OpenGL."""

from __future__ import annotations

import math
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import pytest

from svprep.errors import EnvironmentProblem, InputError
from svprep.light import Site, parse_light
from svprep.model import Grid
from svprep_runtime.camera import look_at
from svprep_runtime.viewer import keys, window
from svprep_runtime.viewer.controls import (
    FASTER,
    LONGEST_STEP_S,
    OVERLAYS,
    STEEPEST_RAD,
    Controls,
    Eye,
    eye_of,
)
from svprep_runtime.viewer.hud import Row, panel
from svprep_runtime.viewer.lights import SunWay, light_control, light_controls
from svprep_runtime.viewer.overlays import COUNT_COLOURS, legend, palette

GRID = Grid(step_m=2.0**-11, origin_m=np.array([1000.0, 2000.0, 10.0]))
NOWHERE = Site("", 0.0, 0.0)
VIENNA = "sun:48.2,16.37,2026-06-21T12:00[Europe/Vienna]"
TODAY = date(2026, 6, 21)


def eye(**other: float) -> Eye:
    return Eye(np.zeros(3), 0.3, -0.2, 60.0, 150.0, **other)


def controls(*specs: str) -> Controls:
    return Controls(eye(), light_controls(specs, NOWHERE, GRID, 150.0, TODAY))


def sun_way(c: Controls) -> SunWay:
    way = c.light.way
    assert isinstance(way, SunWay)
    return way


def test_flight_does_not_depend_on_the_frame_rate() -> None:
    ends = []
    for n in (1, 7, 100):
        e = eye()
        for ways, seconds in ((["forward", "up"], 0.8), ([], 0.2), (["left"], 0.5)):
            for _ in range(n):
                e.step(seconds / n, ways, is_fast=False)
        ends.append(e.at)
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-9)
    assert np.linalg.norm(ends[0]) > 1.0


def test_speed_scales_with_the_model_and_shift() -> None:
    way = {}
    for model_m, is_fast in ((150.0, False), (1500.0, False), (150.0, True)):
        e = Eye(np.zeros(3), 0.0, 0.0, 60.0, model_m)
        for _ in range(100):
            e.step(0.1, ["forward"], is_fast=is_fast)
        way[model_m, is_fast] = float(e.at[1])
    assert way[1500.0, False] == pytest.approx(10.0 * way[150.0, False])
    assert way[150.0, True] == pytest.approx(FASTER * way[150.0, False])
    # Fifteen seconds for the diagonal, less what it takes to get under way.
    assert way[150.0, False] == pytest.approx(100.0, rel=0.02)


def test_opposite_keys_stand_still_and_letting_go_stops() -> None:
    e = eye()
    assert not e.step(0.1, ["left", "right"], is_fast=False)
    e.step(0.5, ["forward"], is_fast=False)
    for _ in range(50):
        e.step(0.1, [], is_fast=False)
    assert not e.step(0.1, [], is_fast=False)
    assert not e.velocity.any()


def test_turning_about_a_point_keeps_it_where_it_is_on_the_screen() -> None:
    e = eye()
    point = e.at + 20.0 * e.forward + 3.0 * e.right + np.array([0.0, 0.0, 2.0])

    def seen() -> np.ndarray:
        clip = e.camera(640, 480).rows.astype(float) @ (point - e.at)
        return np.array([clip[0] / clip[2], clip[1] / clip[2], clip[2]])

    before = seen()
    for dx, dy in ((0.1, 0.05), (-0.4, -0.1), (0.9, 0.2)):
        e.turn_about(point, dx, dy)
        np.testing.assert_allclose(seen(), before, atol=1e-4)
    assert np.linalg.norm(e.at) > 5.0


def test_the_head_never_turns_over() -> None:
    e = eye()
    e.look(0.2, -50.0)
    assert e.pitch_rad == STEEPEST_RAD
    assert e.camera(64, 64).rows[1, 2] >= 0.0
    e.look(0.0, 50.0)
    assert e.pitch_rad == -STEEPEST_RAD
    e.look(1000.0, 0.0)
    assert abs(e.azimuth_rad) <= math.pi


def test_zoom_goes_to_the_point_never_through_it_at_any_frame_rate() -> None:
    ends = []
    for n in (1, 50):
        e = eye()
        point = np.array([3.0, 30.0, -4.0])
        e.zoom(4.0, point)
        for _ in range(n):
            e.step(0.4 / n, [], is_fast=False)
        ends.append(e.at)
        assert np.linalg.norm(np.cross(point - e.at, point)) < 1e-6  # on the line to it
    np.testing.assert_allclose(ends[0], ends[1], atol=0.02)
    e.zoom(500.0, point)
    for _ in range(100):
        e.step(0.1, [], is_fast=False)
    assert np.linalg.norm(point - e.at) == pytest.approx(0.2, rel=0.01)
    e.zoom(-8.0, point)
    for _ in range(100):
        e.step(0.1, [], is_fast=False)
    assert np.linalg.norm(point - e.at) > 0.5


def test_sliding_moves_what_is_at_that_distance_with_the_mouse() -> None:
    e = eye()
    point = e.at + 25.0 * e.forward
    e.slide(0.25, 0.0, 25.0)
    clip = e.camera(800, 400).rows.astype(float) @ (point - e.at)
    # A quarter of the height of a window twice as wide: an eighth of its width.
    assert clip[0] / clip[2] == pytest.approx(0.25, abs=1e-5)
    assert clip[1] / clip[2] == pytest.approx(0.0, abs=1e-5)


def test_an_eye_is_that_of_the_camera_it_begins_with() -> None:
    camera = look_at(np.array([5.0, -40.0, 12.0]), np.array([1.0, 2.0, 3.0]), 640, 480, fov_deg=47)
    positions = np.array([[0, 0, 0], [30, 40, 0]], np.float32)
    e = eye_of(camera, positions)
    assert e.fov_deg == pytest.approx(47.0, abs=1e-4)
    assert e.model_m == pytest.approx(50.0)
    np.testing.assert_allclose(e.camera(640, 480).rows, camera.rows, atol=2e-6)
    np.testing.assert_array_equal(e.camera(640, 480).eye, camera.eye)
    assert eye_of(camera, positions[:0]).model_m > 0.0


def test_a_far_eye_looks_where_it_was_told() -> None:
    e = Eye(np.array([7000.3, -7000.7, 40.0]), 0.123456, -0.05, 60.0, 10.0)
    assert np.abs(e.camera(64, 64).forward - e.forward).max() < 3e-7


def test_long_frames_do_not_leap() -> None:
    slow, exact = controls(), controls()
    for c, seconds in ((slow, 6.0), (exact, LONGEST_STEP_S)):
        c.key_down("W")
        assert c.tick(seconds)
    np.testing.assert_array_equal(slow.eye.at, exact.eye.at)
    assert not controls().tick(-1.0)


def test_keys_switch_what_they_say() -> None:
    c = controls()
    for key, method in (("NUMBER_2", "zpass"), ("NUMBER_3", "zfail"), ("NUMBER_4", "zp+")):
        c.key_down(key)
        assert c.settings().method == method
    c.key_down("C")
    assert not c.settings().clamp
    seen = []
    for _ in range(3):
        c.key_down("G")
        seen.append(c.settings().construction)
    assert seen == ["geometry", "triangles", "vertex"]
    for key, overlay in (
        ("V", "volumes"), ("O", "silhouettes"), ("X", "ends"), ("K", "counts"),
        ("I", "statistics"), ("F1", "help"),
    ):  # fmt: skip
        c.key_down(key)
        assert overlay in c.shown
        c.key_down(key)
        assert overlay not in c.shown
    c.key_down("P")
    c.key_down("ESCAPE")
    assert c.wants_screenshot
    assert c.is_done
    assert c.key_down("F9") == ""


def test_home_brings_the_eye_back_again_and_again() -> None:
    c = controls()
    begin = c.eye.camera(64, 64).rows
    for _ in range(2):
        c.eye.look(0.3, 0.1)
        c.eye.at = c.eye.at + 5.0
        c.key_down("R")
        np.testing.assert_array_equal(c.eye.camera(64, 64).rows, begin)
        assert not c.eye.at.any()


def test_every_key_has_one_action_and_every_action_a_word() -> None:
    pressed = [key for b in keys.BINDINGS for key in b.keys]
    assert len(pressed) == len(set(pressed))
    shown = " ".join(what for what, _ in keys.help_rows()).split()
    for binding in keys.BINDINGS:
        if binding.action not in ("back", "forward", "left", "right", "up", "down"):
            first = binding.keys[0].removeprefix("NUMBER_")
            assert first in shown or first.title()[:3] in {word[:3] for word in shown}
    assert set(OVERLAYS) <= set(keys.ACTION_OF_KEY.values())


def test_left_drags_turn_or_look_and_the_wheel_zooms_or_sets_the_pace() -> None:
    c = controls()
    c.pivot = np.array([0.0, 50.0, 0.0])
    c.drag("left", 0.1, 0.0)
    assert c.eye.at.any()
    at = c.eye.at
    c.end_drag()
    c.key_down("TAB")
    c.drag("left", 0.1, 0.0)
    np.testing.assert_array_equal(c.eye.at, at)
    pace = c.eye.speed_m_s
    c.wheel(1.0, np.zeros(3))
    assert c.eye.speed_m_s == pytest.approx(1.25 * pace)
    c.key_down("TAB")
    c.wheel(1.0, np.array([0.0, 50.0, 0.0]))
    assert c.tick(0.1)


def test_the_sun_goes_by_hour_and_date_on_local_clocks() -> None:
    c = controls(VIENNA)
    assert c.light.words()[0].startswith("Sun  2026-06-21  12:00  Europe/Vienna, UTC+02:00")
    first = c.light.vector()
    exact = parse_light(VIENNA).in_cache_frame(GRID)
    np.testing.assert_array_equal(first, exact)
    c.key_down("J")
    assert "12:10" in c.light.words()[0]
    c.key_down("H")
    np.testing.assert_array_equal(c.light.vector(), exact)
    # Over the end of summer time the clock keeps its hour, and the offset changes.
    for _ in range(150):
        c.key_down("M")
    assert c.light.words()[0].startswith("Sun  2026-11-18  12:00  Europe/Vienna, UTC+01:00")


def test_a_key_that_is_held_goes_on_at_any_frame_rate() -> None:
    ends = []
    for n in (8, 160):
        c = controls(VIENNA)
        c.key_down("J")
        for _ in range(n):
            c.tick(1.6 / n)
        c.key_up("J")
        assert not c.tick(0.1)
        ends.append(sun_way(c).when)
    assert abs((ends[0] - ends[1]).total_seconds()) < 1.0
    # One step, then eight of ten minutes a second after a third of one.
    assert (ends[0] - datetime(2026, 6, 21, 10, 10, tzinfo=UTC)).total_seconds() == pytest.approx(
        600 * 8 * 1.25, abs=1.0
    )


def test_a_drag_changes_the_hour_or_the_date_not_both() -> None:
    c = controls(VIENNA)
    for dx, dy in ((0.002, 0.001), (0.02, 0.004), (0.228, 0.3)):
        c.drag("right", dx, dy)
    assert c.light.words()[0].startswith("Sun  2026-06-21  15:00")
    c.end_drag()
    c.drag("right", 0.001, -0.1)
    assert c.light.words()[0].startswith("Sun  2026-07-09  15:00")


def test_night_has_no_light_and_says_so() -> None:
    c = controls("sun:48.2,16.37,2026-06-21T21:50[Europe/Vienna]".replace("21:50", "20:50"))
    assert c.light.vector() is not None
    for _ in range(6):
        c.key_down("J")
    assert c.light.vector() is None
    assert any("below the horizon" in words for words in c.light.words())
    assert "no direction" in c.light.switch()
    for _ in range(6):
        c.key_down("H")
    assert c.light.vector() is not None


def test_without_a_place_angles_are_dragged() -> None:
    c = controls()
    np.testing.assert_array_equal(c.light.vector(), parse_light("dir:135,40").in_cache_frame(GRID))
    c.drag("right", 0.25, 0.125)
    assert c.light.words() == ["Direction  azimuth 165.0°, altitude 25.0°"]
    c.drag("right", 0.0, -5.0)
    assert "altitude 90.0" in c.light.words()[0]
    c.drag("right", 0.0, 5.0)
    assert "below the horizon" in c.light.words()[0]
    assert "no place is known" in c.light.switch()


def test_a_crs_gives_the_place_and_hours() -> None:
    pytest.importorskip("pyproj")
    site = Site("EPSG:28992", 85000.0, 446000.0)
    c = Controls(eye(), light_controls([], site, GRID, 150.0, TODAY))
    c.key_down("Y")
    assert c.light.words()[0].startswith("Sun  2026-06-21  12:00  zone by longitude: UTC+00:00")
    vector = c.light.vector()
    assert vector is not None
    assert vector[2] > 0.8
    c.key_down("Y")
    assert c.light.words()[0].startswith("Direction  azimuth 188")


def test_a_sun_becomes_angles_where_it_stands() -> None:
    c = controls(VIENNA)
    vector = c.light.vector()
    c.key_down("Y")
    np.testing.assert_array_equal(c.light.vector(), vector)
    assert c.light.words()[0].startswith("Direction")


def test_a_lamp_is_moved_level_by_drags_and_up_by_keys() -> None:
    c = controls("point:1010,2020,15")
    np.testing.assert_array_equal(c.light.vector(), np.array([10, 20, 5, 1], np.float32))
    c.drag("right", 0.1, 0.1)
    vector = c.light.vector()
    assert vector is not None
    assert vector[2] == 5.0
    assert np.hypot(*(vector[:2] - [10, 20])) > 1.0
    c.key_down("M")
    vector = c.light.vector()
    assert vector is not None
    assert vector[2] > 5.0
    assert c.light.switch() == "a point light has no hour"


def test_several_lights_take_turns_and_an_arc_begins_in_its_middle() -> None:
    arc = "sun:48.2,16.37,2026-03-20/08:00/16:00/60m[Europe/Vienna]"
    c = controls("dir:10,20", arc)
    assert c.light.words()[0].startswith("Direction")
    c.key_down("L")
    assert "2026-03-20  12:00" in c.light.words()[0]
    c.key_down("J")
    c.key_down("L")
    assert c.light.words() == ["Direction  azimuth 10.0°, altitude 20.0°"]


def test_a_bad_light_is_refused_before_there_is_a_window() -> None:
    with pytest.raises(InputError, match="below the horizon"):
        light_control(VIENNA.replace("12:00", "01:00"), NOWHERE, GRID, 10.0)


def test_panels_are_as_large_as_their_words() -> None:
    small = panel([Row(("a",))])
    large = panel([Row(("a", "12")), Row(("a long word", "1"))], numbers_right=True)
    assert small.shape[1] < large.shape[1]
    assert small.shape[2] == 4
    assert panel([Row(("a" * 900,))], most_px=300).shape[1] == 300
    assert panel([Row(("a",))], scale=2.0).shape[0] > 1.5 * small.shape[0]
    assert (small[..., :3].max(axis=2) > 200).any()  # something is written


def test_the_legend_tells_each_colour_of_the_shader() -> None:
    rows = legend({"counts", "ends"}, has_segments=False, highest=3)
    swatches = [row.swatch for row in rows if row.swatch]
    assert [tuple(round(c * 255) for c in colour) for colour in palette()] == swatches
    assert len(swatches) == len(COUNT_COLOURS) + 1
    assert any("no segments" in row.cells[0] for row in rows)
    assert legend(set(), has_segments=True, highest=0) == []


def test_pictures_never_overwrite_one_another(tmp_path: Path) -> None:
    picture = np.zeros((2, 3, 3), np.uint8)
    paths = [window.save_numbered(picture, tmp_path, "town.svp.h5") for _ in range(2)]
    assert [path.name for path in paths] == ["town-001.png", "town-002.png"]
    with pytest.raises(EnvironmentProblem, match="cannot be written"):
        window.save_numbered(picture, tmp_path / "nowhere", "town.svp.h5")
