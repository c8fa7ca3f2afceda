"""The clamp benchmark counts what can be counted by hand, and its report is whole."""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np
import pytest

from svprep.clamp import ClampCosts, clamp_lights
from svprep.light import parse_light
from svprep.model import Prepared
from tests.unit.hours_scenes import city, level
from tests.unit.scripts import load_script

PLATE_M = 10.0


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module of its own, as ``python3 scripts/NAME.py`` finds it."""
    return load_script("benchmark_clamp", monkeypatch)


@pytest.fixture
def plate() -> Prepared:
    """A plate of 2 m x 2 m, 10 m above a ground of 40 m x 40 m: two objects, two casters."""
    return city(level(-20, -20, 20, 20), level(-1, -1, 1, 1, z=PLATE_M))


def _looking(prepared: Prepared, *rays: tuple[tuple[float, ...], tuple[float, ...]]):
    """Return views, one a ray, of a pixel each: from an eye to a target (source)."""
    from clamp_benchmark.views import Views, surfaces
    from svprep.rays import Scene

    origin_m = prepared.mesh.grid.origin_m
    eyes = np.array([eye for eye, _ in rays], float) - origin_m
    toward = np.array([target for _, target in rays], float) - origin_m - eyes
    toward /= np.linalg.norm(toward, axis=1)[:, None]
    scene = Scene(prepared.mesh.positions, prepared.mesh.faces)
    return Views(1, eyes, eyes, toward, *surfaces(scene, eyes, toward))


def test_updates_are_those_counted_by_hand(script: ModuleType, plate: Prepared) -> None:
    """The sun is in the zenith; each ray is a view of one pixel."""
    from clamp_benchmark.receivers import between, cached, lit
    from clamp_benchmark.tight import updates_of

    views = _looking(
        plate,
        ((10, 0.1, 5), (0.1, 0.2, 0)),  # the ground in the plate's shadow
        ((10, 0.1, 5), (5, 0.1, 0)),  # the ground before it: the shadow's column is behind
        ((10, 0.1, 5), (-5, 0.1, 2.5)),  # across the column in the air, then ground: not seen
        ((0.3, 0.2, 30), (0.3, 0.2, 10)),  # the plate, and the ground under it
        ((10, 0.1, 5), (20, 0.1, 30)),  # the sky
    )
    table = clamp_lights(plate.mesh, plate.components, plate.scene, [parse_light("dir:0,90")])
    placed = lit(plate.mesh, table.frames[0])
    boxes = placed.boxes(plate.components.face_start)
    tables = {
        "unclamped": between(boxes[:, 4], np.full(2, 1e30)),
        "own": between(boxes[:, 4], boxes[:, 5]),
        "clamped": cached(table),
    }
    assert tables["clamped"].per_caster.tolist() == [1, 2]  # the plate: itself, and the ground
    found, (held, hidden) = updates_of(placed, boxes, views, tables)
    # The ground as a caster is left behind itself; below the plate it is also entered.
    # Of the plate's column, the second ray enters and leaves it below the ground.
    assert found["unclamped"].per_view == [1 + 1, 2 + 1, 0 + 1, 1 + 2, 0]
    assert found["own"].per_view == [0 + 1, 0 + 1, 0 + 1, 1 + 2, 0]
    assert found["clamped"].per_view == [1 + 1, 0 + 1, 0 + 1, 1 + 2 + 2, 0]
    assert [found[name].left_out for name in tables] == [0, 1, 0]
    # Held: by both, by the ground, by the ground, by the plate; hidden there: by the ground.
    assert (held, hidden) == (5, 1)


def test_whole_objects_have_no_gap_where_a_box_is(script: ModuleType, plate: Prepared) -> None:
    """Under a slanted sun the ground's box fills the air that its slab leaves free."""
    from clamp_benchmark.receivers import cached, cut_faces, lit, single_faces, whole_objects

    light = parse_light("dir:90,45")
    table = clamp_lights(plate.mesh, plate.components, plate.scene, [light])
    placed = lit(plate.mesh, table.frames[0])
    start = plate.components.face_start
    ours, theirs = cached(table), whole_objects(placed, plate.scene, start, ClampCosts())
    assert ours.per_caster.tolist() == [1, 2]
    assert theirs.per_caster.tolist() == [1, 1]
    assert (theirs.slopes == 0.0).all()
    # The plate's front is 10 m high at x = 1; the ground's box ends at x = -20.
    front = (-PLATE_M - 1.0) / math.sqrt(2.0)
    back = 20.0 / math.sqrt(2.0)
    up = plate.mesh.grid.origin_m @ table.frames[0][2]
    np.testing.assert_allclose(theirs.depths[-1] + up, [front, back], atol=0.01)
    faces = clamp_lights(plate.mesh, plate.components, single_faces(plate.scene), [light])
    assert np.diff(faces.segment_start[0]).tolist() == [1, 2]
    # Cut to the plate's rectangle, the ground is level: the end is horizontal, at the ground.
    cut = cut_faces(placed, plate.scene, start)
    assert cut.per_caster.tolist() == [1, 1]
    assert cut.slopes[1] == pytest.approx(-table.frames[0][:2, 2] / table.frames[0][2, 2])
    ground_m = -plate.mesh.grid.origin_m[2]
    assert cut.depths[1, 1] * table.frames[0][2, 2] == pytest.approx(ground_m, abs=0.01)


def test_all_figures_of_a_scene_are_reported(script: ModuleType, plate: Prepared) -> None:
    from clamp_benchmark.report_tight import city_tight, cost_rows, models
    from clamp_benchmark.tight import CLAMPED, OWN_BOX, UNCLAMPED, measure_tight
    from clamp_benchmark.views import VIEWS, look

    views = look(plate.mesh.positions, plate.mesh.faces, 8, 6)
    assert len(views.eyes) == len(VIEWS)
    assert views.is_surface.any(axis=1).all()
    ground_m = -plate.mesh.grid.origin_m[2]
    assert views.eyes[:2, 2] == pytest.approx(ground_m + 1.7, abs=0.01)
    tight = [measure_tight(plate, views, altitude) for altitude in (30.0, 60.0)]
    for t in tight:
        assert t.held > 0
        assert t.floor <= t.updates[CLAMPED].total <= t.updates[UNCLAMPED].total
        assert t.updates[OWN_BOX].total <= t.updates[UNCLAMPED].total
        # From the plate's front to the ground under its middle.
        assert t.lengths.own_box < t.lengths.to_last_surface
        assert t.lengths.clamped < t.lengths.clamped_end
    model = script.Model("plate", 2, 2, 4, tight)
    text = "\n".join([*city_tight("plate", tight), *cost_rows(tight), *models([model], 48)])
    for heading in ("whole objects", "floor", "Lengths along the light", "Gain in surface"):
        assert heading in text
    assert "nan" not in text


def test_times_are_of_every_light(script: ModuleType, plate: Prepared) -> None:
    from clamp_benchmark.report import markdown
    from clamp_benchmark.speed import ColdStart, Command, Times, time_lights
    from clamp_benchmark.tight import measure_tight
    from clamp_benchmark.views import look

    lights = {"sun, altitude 30": parse_light("dir:135,30"), "lamp": parse_light("point:5,0,4")}
    rows, setup = time_lights(plate, lights, rounds=2)
    assert [row.name for row in rows] == list(lights)
    assert all(len(row.times.wall_s) == 2 and row.segments >= 1.0 for row in rows)
    assert len(setup.wall_s) == 2
    day = Times([7.0], [13.0])
    command = Command(wall_s=2.0, cpu_s=3.0, peak_bytes=1 << 20, n_lights=1)
    speed = script.Speed("plate", 2, 2, 4, rows, setup, day, [command], [command])
    views = look(plate.mesh.positions, plate.mesh.faces, 4, 3)
    model = script.Model("plate", 2, 2, 4, [measure_tight(plate, views, 30.0)])
    report = script.Report(
        machine="a machine",
        threads=1,
        load="load average 0.",
        columns=4,
        rows=3,
        city=model,
        models=[],
        speed=speed,
        large=speed,
        cold=[ColdStart("dir:135,30", command, command)],
    )
    text = markdown(report)
    assert "| seconds a caster, ten times the city over the city | near 1 |" in text
    assert "a day of 48 suns" in text
    assert max(len(line) for line in text.splitlines() if not line.startswith("|")) <= 100


def test_contradictions_end_the_run(script: ModuleType) -> None:
    from clamp_benchmark.tight import CLAMPED, OWN_BOX, UNCLAMPED, Inconsistent, Updates, _check

    fine = {name: Updates([1.0], 10, 0) for name in (UNCLAMPED, OWN_BOX, CLAMPED)}
    _check(fine, 3.0)
    with pytest.raises(Inconsistent, match=r"altitude 3, clamped: 2 visible points"):
        _check(fine | {CLAMPED: Updates([1.0], 10, 2)}, 3.0)
    with pytest.raises(Inconsistent, match=r"view 0: 0\.4 updates a pixel unclamped, 1\.0 of own"):
        _check(fine | {UNCLAMPED: Updates([0.4], 4, 0)}, 3.0)


def test_targets_say_how_far_they_are_missed(script: ModuleType) -> None:
    from clamp_benchmark.report import _verdict

    assert _verdict(0.6, 0.6, is_least=True) == "met"
    assert _verdict(0.3, 0.6, is_least=True) == "missed, 2.00 times"
    assert _verdict(0.5, 0.25) == "missed, 2.00 times"
