"""Sun hours where geometry gives the answer in closed form, with the sun from pvlib."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from svprep.hours import trace_points
from svprep.light import Arc
from svprep.model import Prepared
from tests.unit.hours_scenes import (
    SVALBARD,
    SYDNEY,
    VIENNA,
    arc_at,
    box,
    city,
    face_under,
    in_cache_frame,
    level,
    longest_run,
    sun_path,
)

Rule = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""From east, north and up of the sun, whether the point is lit while the sun is up."""

HALF_LENGTH, WALL_HEIGHT, FAR = 100.0, 10.0, 5.0
COURT, COURT_HEIGHT = 8.0, 6.0
DEPTH, RISE, SLAB_HALF = 1.5, 2.0, 50.0


def check(prepared: Prepared, arc: Arc, point: tuple, name: str, rule: Rule) -> None:
    """Compare bits step by step, and minutes with a day in steps of a minute."""
    face = face_under(prepared, point, name)
    got = trace_points(prepared, arc, in_cache_frame(prepared, point), [face])
    assert not got.is_buried[0]
    path = sun_path(arc)
    wanted = rule(*path.towards.T) & path.is_up
    assert len(wanted) == arc.n_steps
    np.testing.assert_array_equal(got.is_lit()[0], wanted)
    assert got.total_minutes[0] == wanted.sum() * arc.step_minutes
    assert got.longest_minutes[0] == longest_run(wanted) * arc.step_minutes
    fine = sun_path(arc, 1.0)
    by_minute = rule(*fine.towards.T) & fine.is_up
    n_runs = np.count_nonzero(np.diff(by_minute.astype(int), prepend=0) == 1)
    assert abs(got.total_minutes[0] - by_minute.sum()) <= max(n_runs, 1) * arc.step_minutes
    assert abs(got.longest_minutes[0] - longest_run(by_minute)) <= arc.step_minutes


@pytest.fixture(scope="module")
def wall() -> Prepared:
    """Return a wall from west to east on level ground."""
    return city(
        level(-400, -400, 400, 400),
        box((-HALF_LENGTH, -0.25, 0), (HALF_LENGTH, 0.25, WALL_HEIGHT)),
        names=("ground", "wall"),
    )


def beside_a_wall(away: int) -> Rule:
    """Return the rule `FAR` metres north (+1) or south (-1) of the wall's face."""

    def lit(east: np.ndarray, north: np.ndarray, up: np.ndarray) -> np.ndarray:
        # Where the ray crosses the plane of the face: later it is higher and further out.
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = FAR / (-away * north)
            hits = (np.abs(east * reach) <= HALF_LENGTH) & (up * reach < WALL_HEIGHT)
        return ~((-away * north > 0.0) & hits)

    return lit


@pytest.mark.parametrize(
    ("place", "when"),
    [
        (VIENNA, "2026-06-21/04:00/22:00/15m"),
        (VIENNA, "2026-03-29/00:00/24:00/15m"),  # clocks are put forward: 23 hours
        (VIENNA, "2026-10-25/00:00/24:00/30m"),  # and back: 25
        (SYDNEY, "2026-06-21/06:00/18:00/15m"),
        (SYDNEY, "2026-12-21/05:00/21:00/15m"),
    ],
    ids=["june", "23 hours", "25 hours", "southern winter", "southern summer"],
)
def test_ground_north_and_south_of_a_wall(
    wall: Prepared, place: tuple[float, float, str], when: str
) -> None:
    arc = arc_at(place, when)
    for away in (1, -1):
        check(wall, arc, (0.0, away * (0.25 + FAR), 0.0), "ground", beside_a_wall(away))


def test_shade_is_on_the_side_away_from_the_sun(wall: Prepared) -> None:
    for place, shaded in ((VIENNA, 1), (SYDNEY, -1)):
        arc = arc_at(place, "2026-03-20/09:00/15:00/30m")
        points = [(0.0, away * (0.25 + FAR), 0.0) for away in (shaded, -shaded)]
        faces = [face_under(wall, point, "ground") for point in points]
        total = trace_points(wall, arc, in_cache_frame(wall, points), faces).total_minutes
        assert total[0] == 0.0
        assert total[1] == 360.0


def test_the_middle_of_a_courtyard() -> None:
    thick = 1.0
    out, low, high = COURT + thick, 0.0, COURT_HEIGHT
    court = city(
        level(-60, -60, 60, 60),
        box((-out, COURT, low), (out, out, high)),
        box((-out, -out, low), (out, -COURT, high)),
        box((COURT, -COURT, low), (out, COURT, high)),
        box((-out, -COURT, low), (-COURT, COURT, high)),
        names=("ground", "north", "south", "east", "west"),
    )

    def lit(east: np.ndarray, north: np.ndarray, up: np.ndarray) -> np.ndarray:
        return up * COURT > COURT_HEIGHT * np.maximum(np.abs(east), np.abs(north))

    check(court, arc_at(VIENNA, "2026-06-21/05:00/21:00/15m"), (0, 0, 0), "ground", lit)
    check(court, arc_at(SYDNEY, "2026-12-21/05:00/21:00/15m"), (0, 0, 0), "ground", lit)


@pytest.mark.parametrize(
    ("place", "when", "looks"),
    [
        (VIENNA, "2026-06-21/04:00/22:00/10m", -1),
        (VIENNA, "2026-12-21/07:00/17:00/10m", -1),
        (SYDNEY, "2026-12-21/05:00/21:00/10m", 1),
    ],
)
def test_a_facade_under_an_overhang(place: tuple[float, float, str], when: str, looks: int) -> None:
    bottom = 1.0 + RISE
    front = sorted((0.0, looks * DEPTH))
    back = sorted((0.0, -looks * 10.0))
    house = city(
        box((-SLAB_HALF, back[0], 0), (SLAB_HALF, back[1], 9)),
        box((-SLAB_HALF, front[0], bottom), (SLAB_HALF, front[1], bottom + 0.2)),
        names=("house", "slab"),
    )

    def lit(east: np.ndarray, north: np.ndarray, up: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = RISE / up
            under = (looks * north * reach < DEPTH) & (np.abs(east * reach) < SLAB_HALF)
        return (looks * north > 0.0) & ~under

    check(house, arc_at(place, when), (0.0, 0.0, 1.0), "house", lit)


def test_polar_day_on_open_ground() -> None:
    ground = city(level(-50, -50, 50, 50))
    arc = arc_at(SVALBARD, "2026-06-21/00:00/24:00/30m")
    got = trace_points(ground, arc, [(1.0, 2.0, 0.0)], [0])
    assert (got.total_minutes[0], got.longest_minutes[0]) == (1440.0, 1440.0)


def test_a_step_at_night_ends_a_run() -> None:
    ground = city(level(-50, -50, 50, 50))
    arc = arc_at(SVALBARD, "2026-06-21/00:00/24:00/1h")
    night = (7, 8, 20)
    kept = [k for k in range(24) if k not in night]
    broken = replace(
        arc,
        n_night=3,
        step_of_light=tuple(kept),
        times=tuple(arc.times[k] for k in kept),
        lights=tuple(arc.lights[k] for k in kept),
    )
    got = trace_points(ground, broken, [(1.0, 2.0, 0.0)], [0])
    assert got.total_minutes[0] == 21 * 60.0
    assert got.longest_minutes[0] == 11 * 60.0
    assert np.flatnonzero(~got.is_lit()[0]).tolist() == list(night)
