"""What a face is - roof, wall, ground, underside - which side counts, and where samples lie."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from svprep.errors import InputError
from svprep.hours import Kind, sampling
from svprep.hours.sampling import place_samples, plan_samples
from svprep.model import Labels, Prepared, SourceMesh
from tests.property.meshes import joined, source_mesh, turned
from tests.unit.cache_samples import strip_and_tetrahedron
from tests.unit.hours_scenes import BOTTOM, TOP, box, city, face_under, level, sheet, surfaces_in

ROOF, WALL, GROUND, UNDERSIDE = Kind


def areas(prepared: Prepared, name: str) -> dict[Kind, float]:
    """Return the square metres of each kind of an object."""
    surfaces = surfaces_in(prepared)
    owner = prepared.object_names.index(name)
    begin, end = prepared.mesh.object_face_start[owner : owner + 2]
    kinds, area = surfaces.kind[begin:end], surfaces.area_m2[begin:end]
    return {Kind(k): round(float(area[kinds == k].sum()), 2) for k in np.unique(kinds)}


def normal_at(prepared: Prepared, point: tuple[float, float, float], name: str) -> list[float]:
    """Return the normal of the side that counts, rounded."""
    face = face_under(prepared, point, name)
    return (np.round(surfaces_in(prepared).normal[face], 6) + 0.0).tolist()


def gable() -> SourceMesh:
    """Return a closed house of 10 by 8 m with a ridge and eaves, no terrain."""
    corners = [
        (0, 0, 0), (10, 0, 0), (10, 8, 0), (0, 8, 0),
        (0, 0, 5), (10, 0, 5), (10, 8, 5), (0, 8, 5), (0, 4, 8), (10, 4, 8),
    ]  # fmt: skip
    faces = [
        [0, 2, 1], [0, 3, 2], [0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6],
        [1, 2, 6], [1, 6, 5], [5, 6, 9], [3, 0, 4], [3, 4, 7], [7, 4, 8],
        [4, 5, 9], [4, 9, 8], [6, 7, 8], [6, 8, 9],
    ]  # fmt: skip
    return source_mesh(np.array(corners, float), np.array(faces))


@pytest.mark.parametrize("on_terrain", [False, True])
def test_a_house_with_a_ridge(on_terrain: bool) -> None:
    terrain = [level(-30, -30, 30, 30)] if on_terrain else []
    prepared = city(gable(), *terrain)
    assert areas(prepared, "object 0") == {
        ROOF: 100.0,  # two slopes of 10 by 5
        WALL: 2 * 10 * 5 + 2 * (8 * 5 + 12),
        UNDERSIDE: 80.0,
    }
    if on_terrain:
        assert areas(prepared, "object 1") == {GROUND: 3600.0}


@pytest.mark.parametrize("turn", [False, True], ids=["wound up", "wound down"])
def test_terrain_is_ground_however_it_is_wound(turn: bool) -> None:
    hill = sheet([(-30, -30, 0), (30, -30, 2), (30, 30, 20), (-30, 30, 9)])
    prepared = city(turned(hill) if turn else hill, box((-5, -5, -3), (5, 5, 30)))
    assert set(areas(prepared, "object 0")) == {GROUND}
    assert normal_at(prepared, (20.0, -20.0, 2 * 50 / 60 + 18 * 10 / 60), "object 0")[2] > 0.5


def test_a_building_sunk_in_the_terrain_leaves_it_ground() -> None:
    # A solid under most of it; an open shell under its lesser part.
    for half, without in ((10, ()), (20, tuple(TOP))):
        terrain = level(-half, -half, half, half)
        prepared = city(terrain, box((-9, -9, -3), (9, 9, 6), without))
        assert areas(prepared, "object 0") == {GROUND: 4.0 * half**2}


@pytest.mark.parametrize("thickness", [0.0, 0.2])
def test_a_canopy_is_a_roof(thickness: float) -> None:
    top = level(-4, -4, 4, 4, 3.0)
    canopy = box((-4, -4, 3.0 - thickness), (4, 4, 3)) if thickness else top
    prepared = city(level(-30, -30, 30, 30), canopy)
    assert areas(prepared, "object 0") == {GROUND: 3600.0}
    assert areas(prepared, "object 1")[ROOF] == 64.0


def test_paving_is_ground() -> None:
    prepared = city(level(-30, -30, 30, 30), box((-4, -4, -0.05), (4, 4, 0.1)))
    assert areas(prepared, "object 1")[GROUND] == 64.0
    assert areas(prepared, "object 1")[UNDERSIDE] == 64.0


def test_a_wide_hall_is_no_ground() -> None:
    for without in ((), tuple(BOTTOM)):
        prepared = city(level(-99, -99, 99, 99), box((-80, -80, 0), (80, 80, 2), without))
        assert areas(prepared, "object 1")[ROOF] == 160.0**2


def test_a_closed_block_that_the_model_stands_on_is_ground() -> None:
    houses = [box((x, y, 0), (x + 8, y + 8, 6)) for x in (-40, 0, 30) for y in (-40, 20)]
    prepared = city(box((-90, -90, -3), (90, 90, 0)), *houses)
    assert areas(prepared, "object 0")[GROUND] == 180.0**2
    assert areas(prepared, "object 3")[ROOF] == 64.0
    alone = city(box((-90, -90, -3), (90, 90, 0)))
    assert areas(alone, "object 0")[ROOF] == 180.0**2


def test_sides_of_an_open_shell() -> None:
    # The north wall is missing: the bottom plate still looks down, the roof up.
    open_box = box((0, 0, 0), (8, 8, 6), without=(8, 9))
    prepared = city(level(-30, -30, 30, 30, -0.3), open_box)
    assert normal_at(prepared, (3.0, 5.0, 0.0), "object 1") == [0, 0, -1]
    assert normal_at(prepared, (3.0, 5.0, 6.0), "object 1") == [0, 0, 1]
    assert normal_at(prepared, (3.0, 0.0, 2.0), "object 1") == [0, -1, 0]
    assert areas(prepared, "object 1") == {ROOF: 64.0, WALL: 144.0, UNDERSIDE: 64.0}


def test_surfaces_of_a_soup_of_sheets() -> None:
    # Roof and ground plate of one object that share no vertex; the plate is wound to look down.
    soup = joined(level(0, 0, 8, 8, 6.0), turned(level(0, 0, 8, 8, 0.2)))
    prepared = city(level(-30, -30, 30, 30), soup, turned(level(20, 20, 25, 25, 4.0)))
    assert areas(prepared, "object 1") == {ROOF: 64.0, UNDERSIDE: 64.0}
    assert normal_at(prepared, (22.0, 23.0, 4.0), "object 2") == [0, 0, 1]


def test_an_upright_sheet_counts_the_side_it_is_wound_for() -> None:
    fence = sheet([(0, 0, 0), (9, 0, 0), (9, 0, 2), (0, 0, 2)])
    assert normal_at(city(fence), (3.0, 0.0, 1.0), "object 0") == [0, -1, 0]
    assert normal_at(city(turned(fence)), (3.0, 0.0, 1.0), "object 0") == [0, 1, 0]


def test_an_inside_out_solid_has_been_turned() -> None:
    prepared = city(turned(box((0, 0, 0), (8, 8, 6))))
    assert areas(prepared, "object 0") == {ROOF: 64.0, WALL: 192.0, UNDERSIDE: 64.0}


def test_sixty_degrees_part_roof_from_wall() -> None:
    for degrees, kind in ((59.0, ROOF), (61.0, WALL)):
        rise = 10.0 * math.tan(math.radians(degrees))
        ramp = sheet([(0, 0, 5), (10, 0, 5), (10, 10, 5 + rise), (0, 10, 5 + rise)])
        assert set(areas(city(ramp, level(-30, -30, 30, 30)), "object 0")) == {kind}


def planned(prepared: Prepared, spacing_m: float):
    surfaces = surfaces_in(prepared)
    groups = plan_samples(prepared.mesh, surfaces, spacing_m)
    position, face = place_samples(prepared.mesh, surfaces, groups, lambda done: None)
    return surfaces, groups, position, face


def test_one_sample_per_square_of_the_spacing() -> None:
    _, groups, _, _ = planned(city(gable(), level(-30, -30, 30, 30)), 0.5)
    assert np.diff(groups.sample_start).tolist() == [400, 204 * 4, 320, 14400]
    assert groups.kind.tolist() == [ROOF, WALL, UNDERSIDE, GROUND]
    assert groups.object.tolist() == [0, 0, 0, 1]
    assert groups.area_m2.sum() == pytest.approx(100 + 204 + 80 + 3600)


def test_all_that_has_area_has_a_sample() -> None:
    _, groups, _, face = planned(city(gable(), level(-30, -30, 30, 30)), 1e6)
    assert np.diff(groups.sample_start).tolist() == [1, 1, 1, 1]
    assert len(face) == 4


def test_samples_lie_in_their_triangles_and_are_even() -> None:
    prepared = city(gable(), level(-30, -30, 30, 30))
    surfaces, groups, position, face = planned(prepared, 0.5)
    a, b, c = np.moveaxis(prepared.mesh.positions[prepared.mesh.faces[face]].astype(float), 1, 0)
    normal = np.cross(b - a, c - a)
    for p, q in ((a, b), (b, c), (c, a)):
        assert ((np.cross(q - p, position - p) * normal).sum(axis=1) > 0.0).all()
    np.testing.assert_allclose(((position - a) * normal).sum(axis=1), 0.0, atol=1e-9)
    # Every face has its share of its group, rounded.
    share = surfaces.area_m2 * 4.0
    np.testing.assert_allclose(np.bincount(face, minlength=len(share)), share, atol=1.01)
    # A square metre of ground has its four samples, or nearly.
    ground = position[groups.sample_start[3] :, :2] + prepared.mesh.grid.origin_m[:2]
    count, _, _ = np.histogram2d(*ground.T, bins=20, range=[(-30, 30), (-30, 30)])
    assert (abs(count - 36) <= 5).all()


def test_slivers_get_their_fair_share() -> None:
    # A strip cut into a thousand slivers beside one large triangle of the same area.
    x = np.linspace(0.0, 10.0, 501)
    strip = np.concatenate([np.column_stack([x, y + 0 * x, 0 * x]) for y in (0.0, 5.0)])
    i = np.arange(500)
    slivers = np.concatenate(
        [np.column_stack([i, i + 1, i + 502]), np.column_stack([i, i + 502, i + 501])]
    )
    large = source_mesh(np.array([(20.0, 0, 0), (30, 0, 0), (20, 10, 0)]), np.array([[0, 1, 2]]))
    prepared = city(joined(source_mesh(strip, slivers), large))
    _, _, position, face = planned(prepared, 1.0)
    assert len(face) == 100
    in_strip = position[:, 0] + prepared.mesh.grid.origin_m[0] <= 10.0
    assert in_strip.sum() == 50
    assert len(np.unique(face[in_strip])) == 50


def test_a_speck_beside_a_country_keeps_its_digits() -> None:
    prepared = city(level(-8000, -8000, 8000, 8000), level(0, 0, 0.004, 0.004, 5.0))
    _, groups, position, _ = planned(prepared, 100.0)
    assert np.diff(groups.sample_start).tolist() == [25600, 1]
    at = position[-1] + prepared.mesh.grid.origin_m
    assert 0.0 < at[0] < 0.004
    assert 0.0 < at[1] < 0.004


@pytest.mark.parametrize("spacing", [0.0, -1.0, math.nan, math.inf])
def test_a_spacing_is_a_distance(spacing: float) -> None:
    with pytest.raises(InputError, match="distance in metres above 0"):
        planned(city(level(-5, -5, 5, 5)), spacing)


def test_too_many_samples_are_refused_with_a_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    prepared = city(level(-500, -500, 500, 500))
    with pytest.raises(InputError, match=r"1e\+206 samples.*Choose --spacing 0.11 or more"):
        planned(prepared, 1e-100)
    with pytest.raises(InputError, match="inf samples"):
        planned(prepared, 1e-300)
    with pytest.raises(InputError, match=r"a spacing of 0.01 m makes 10,000,000,000 samples on "):
        planned(prepared, 0.01)
    monkeypatch.setattr(sampling, "MOST_SAMPLES", 1000)
    with pytest.raises(InputError, match="Choose --spacing 32 or more"):
        planned(prepared, 31.0)
    assert planned(prepared, 32.0)[1].sample_start[-1] == 977
    monkeypatch.setattr(sampling, "MOST_SAMPLES", 0)
    with pytest.raises(InputError, match="need one each"):
        planned(prepared, 32.0)


def test_a_city_made_by_hand_has_surfaces_too() -> None:
    sample = strip_and_tetrahedron()
    assert areas(sample, "roof") == {ROOF: 2.0}  # which its file calls a RoofSurface
    nothing = Labels.none(len(sample.object_names), len(sample.mesh.faces))
    sample = replace(sample, labels=nothing)
    assert areas(sample, "roof") == {GROUND: 2.0}  # a lone sheet: nothing is beneath
