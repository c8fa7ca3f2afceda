"""The choice of a level of detail: nothing doubled, nothing lost, whatever the depth."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from svprep.errors import InputError
from svprep.ingest.lod import choose_lods

PATH = Path("t.city.json")


def choose(*objects, lod="highest"):
    """Each object is (parent, type, levels); return the level of each."""
    parents, types, lods = zip(*objects, strict=True)
    return choose_lods(parents, types, lods, lod, PATH)


def lods(*objects, lod="highest"):
    return list(choose(*objects, lod=lod).lods)


B, P, I = "Building", "BuildingPart", "BuildingInstallation"  # noqa: E741


def test_the_highest_of_a_single_object_compared_as_numbers():
    assert lods((-1, B, ["1", "2"])) == ["2"]
    assert lods((-1, B, ["2.2", "10", "1.3"])) == ["10"]
    assert lods((-1, B, ["2", "2.2", "2.1"])) == ["2.2"]
    assert lods((-1, B, ["2.0", "1"])) == ["2.0"]
    assert lods((-1, B, ["0", ""])) == [""]
    assert lods((-1, B, [])) == [None]


def test_ground_is_no_footprint():
    types = ["TINRelief", "Road", "WaterBody", "Building", "+LandUse"]
    chosen = choose_lods(
        [-1] * 5, types, [["0"], ["0"], ["0.1", "1"], ["0"], ["0"]], "highest", PATH
    )
    assert chosen.lods == ("0", "0", "1", None, "0")
    assert chosen.only_footprint.tolist() == [3]


def test_footprints_are_left_out_and_named():
    choice = choose((-1, B, ["0"]), (-1, B, ["0", "1"]), (-1, "CityFurniture", ["0.3"]))
    assert list(choice.lods) == [None, "1", None]
    (note,) = choice.notes(["a", "b", "c"], "highest")
    assert note.startswith("2 objects with LoD 0 (a footprint) only left out: a, c")
    assert lods((-1, B, ["0"]), (-1, B, ["0", "1"]), lod="0") == ["0", "0"]


def test_a_level_by_name_doubles_nothing():
    choice = choose((-1, B, ["2"]), (0, P, ["2.2"]), (-1, B, ["2"]), lod="2")
    assert list(choice.lods) == [None, "2.2", "2"]
    assert choice.n_doubled == 1


def test_names_of_levels_with_letters():
    assert lods((-1, B, ["LOD1", "lod2"])) == ["lod2"]
    assert lods((-1, B, ["LoD 1.3", "2.2+"])) == ["LoD 1.3"]
    assert lods((-1, B, ["LOD1", "LOD2"]), lod="1") == ["LOD1"]


def test_a_building_is_not_doubled_by_its_parts():
    choice = choose((-1, B, ["1", "2"]), (0, P, ["1", "2.2"]), (0, P, ["2.2"]))
    assert list(choice.lods) == [None, "2.2", "2.2"]
    assert choice.n_doubled == 1
    assert "1 object at a lower LoD" in choice.notes(["a", "b", "c"], "highest")[0]
    # The whole at the highest level, the parts below it.
    assert lods((-1, B, ["3"]), (0, P, ["2"]), (0, P, ["1"])) == ["3", None, None]
    # Both at the same: the file says that both exist.
    assert lods((-1, B, ["2"]), (0, P, ["2"])) == ["2", "2"]


def test_a_part_that_lacks_the_level_is_not_lost():
    assert lods((-1, B, []), (0, P, ["2"]), (0, P, ["1"])) == [None, "2", "1"]
    assert lods((-1, B, ["1"]), (0, P, ["3"]), (0, P, ["2"])) == [None, "3", "2"]
    # Below the part that lacks it, its own part is the coarser of the two.
    three = [(-1, B, []), (0, P, ["3"]), (0, P, ["2"]), (2, P, ["1"]), (2, P, ["2"])]
    assert lods(*three) == [None, "3", "2", None, "2"]


def test_the_order_of_objects_does_not_matter():
    assert lods((1, P, ["2"]), (-1, B, ["1"]), (0, P, ["1"])) == ["2", None, None]


def test_installations_take_the_level_of_their_building():
    objects = [(-1, B, ["1", "2"]), (0, I, ["2", "3"]), (0, I, ["1"]), (0, I, ["3"])]
    assert lods(*objects) == ["2", "2", "1", "3"]
    # An installation of a part, and of a building that has only parts.
    assert lods((-1, B, []), (0, P, ["1", "2"]), (1, I, ["1", "2", "3"])) == [None, "2", "2"]
    assert lods((-1, B, []), (0, I, ["3"])) == [None, "3"]


def test_a_named_level():
    objects = [(-1, B, ["1", "2"]), (0, P, ["2.2", "2.1"]), (-1, "Road", ["1"]), (-1, B, [])]
    choice = choose(*objects, lod="2")
    assert list(choice.lods) == [None, "2.2", None, None]
    without, doubled = choice.notes(list("abcd"), "2")
    assert without == "1 object without LoD 2 left out: c"
    assert doubled.startswith("1 object at a lower LoD left out")
    assert lods(*objects, lod="2.1") == [None, "2.1", None, None]
    assert lods(*objects, lod="2.0") == [None, "2.2", None, None]


@pytest.mark.parametrize(("lod", "message"), [("3", "not stated, 1, 2.2."), ("best", '"highest"')])
def test_a_level_that_does_not_exist(lod, message):
    levels = [["2.2", "1"], [""]]
    with pytest.raises(InputError) as caught:
        choose_lods([-1, -1], [B, B], levels, lod, PATH)
    assert message in str(caught.value)


@pytest.mark.parametrize("lod", ["-1", "nan", "inf", "", "2..1", "1e9"])
def test_what_is_no_level(lod):
    with pytest.raises(InputError, match="--lod"):
        choose((-1, B, ["2"]), lod=lod)


def test_cycles_are_cut():
    choice = choose((1, P, ["1"]), (0, P, ["2"]), (2, B, ["1"]))
    assert list(choice.lods) == [None, "2", "1"]
    assert choice.cut_parents.tolist() == [0, 2]
    assert "their own ancestors: a, c" in choice.notes(list("abc"), "highest")[-1]


@pytest.mark.parametrize("direction", [1, -1])
def test_parts_nested_deep(direction):
    n = 20_000
    objects = [(i + 1 if i < n - 1 else -1, P, ["1"]) for i in range(n)]
    objects[0] = (1, P, ["2"])
    if direction < 0:
        objects = [(n - 1 - p if p >= 0 else -1, kind, levels) for p, kind, levels in objects[::-1]]
    chosen = [name for name in lods(*objects) if name]
    assert chosen == ["2"]


@st.composite
def forests(draw):
    n = draw(st.integers(1, 12))
    objects = []
    for i in range(n):
        levels = draw(st.lists(st.sampled_from(["0", "1", "1.2", "2", "3", ""]), max_size=3))
        kind = draw(st.sampled_from([B, P, P, I]))
        objects.append((draw(st.integers(-1, i - 1)), kind, levels))
    return objects


@given(forests())
def test_nothing_is_doubled_and_nothing_is_lost(objects):
    choice = choose(*objects)

    def ancestors(i):
        found = set()
        while objects[i][0] >= 0 and objects[i][1] == P:
            i = objects[i][0]
            found.add(i)
        return found

    related = [
        {j for j in range(len(objects)) if j in ancestors(i) or i in ancestors(j)}
        for i in range(len(objects))
    ]
    number = [None if name is None else float(name or -1) for name in choice.lods]
    for i, (_, _, levels) in enumerate(objects):
        if number[i] is not None:
            assert all(number[j] in (None, number[i]) for j in related[i])
        elif set(levels) - {"0"}:
            assert any(number[j] is not None for j in related[i])
        assert choice.lods[i] is None or choice.lods[i] in levels
