"""--objects, --no-terrain, --no-openings: what is left, what is counted, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svprep.defects import Code
from svprep.errors import InputError
from svprep.ingest.filters import filtered, is_of_type, is_terrain
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile, no_findings
from svprep.model import FaceFindings

PATHS = [Path("one.gml"), Path("two.gml")]


def town() -> ParsedFile:
    """Return four objects of two triangles each; the second of each is an opening or terrain."""
    return ParsedFile(
        positions=np.arange(27.0).reshape(9, 3),
        faces=np.array(
            [
                [0, 1, 2],
                [1, 2, 3],
                [2, 3, 4],
                [3, 4, 5],
                [4, 5, 6],
                [5, 6, 7],
                [6, 7, 8],
                [0, 7, 8],
            ],
            np.uint32,
        ),
        object_face_start=np.array([0, 2, 4, 6, 8], np.int64),
        source_face=np.array([0, 1, 2, 3, 5, 5, 6, 7], np.uint32),
        object_names=("house", "wing", "tin", "bridge"),
        face_findings=FaceFindings(
            np.array([Code.NONPLANAR_POLYGON, Code.SHORT_POLYGON], np.uint16),
            np.array([1, 2], np.uint32),
            np.array([3, 4], np.uint32),
        ),
        notes=("said before",),
        object_types=("Building", "BuildingPart", "TINRelief", "+Bridge"),
        object_parents=("", "house", "", ""),
        surface_names=("", "WallSurface", "Window", "Door"),
        surface_of_polygon=np.array([1, 2, 1, 3, 0, 0, 0, 0], np.uint8),
    )


def left(options: ReadOptions) -> ParsedFile:
    (found,) = filtered([town()], PATHS[:1], options)
    assert found.notes[0] == "said before"
    assert found.object_face_start.tolist()[-1] == len(found.faces) == len(found.source_face)
    assert len(found.object_names) == len(found.object_types) == len(found.object_parents)
    assert set(found.faces.ravel().tolist()) == set(range(len(found.positions)))
    return found


def test_everything_is_the_default() -> None:
    parsed = town()
    assert filtered([parsed], PATHS[:1], ReadOptions())[0] is parsed
    assert filtered([parsed], PATHS[:1], ReadOptions(lod="2"))[0] is parsed


def test_objects_of_a_type_bring_their_parts() -> None:
    found = left(ReadOptions(objects=("building",)))
    assert found.object_names == ("house", "wing")
    assert found.object_parents == ("", "house")
    assert found.source_face.tolist() == [0, 1, 2, 3]
    assert found.face_findings.object_index.tolist() == [1]
    assert found.face_findings.source_face.tolist() == [3]
    assert found.notes[1] == "2 objects left out by --objects building (+Bridge 1, TINRelief 1)"
    only_part = left(ReadOptions(objects=("BuildingPart",)))
    assert only_part.object_names == ("wing",)
    wing = town().positions[town().faces[2:4]]
    np.testing.assert_array_equal(only_part.positions[only_part.faces], wing)


def test_terrain_is_left_out() -> None:
    found = left(ReadOptions(has_terrain=False))
    assert found.object_names == ("house", "wing", "bridge")
    assert found.source_face.tolist() == [0, 1, 2, 3, 6, 7]
    assert found.notes[1] == "1 object left out by --no-terrain (TINRelief 1)"


def test_openings_are_left_out_and_polygons_keep_their_numbers() -> None:
    found = left(ReadOptions(has_openings=False))
    assert found.object_names == ("house", "wing", "tin", "bridge")
    assert found.source_face.tolist() == [0, 2, 5, 5, 6, 7]
    assert found.face_findings.source_face.tolist() == [4]
    assert found.notes[1] == (
        "2 polygons left out by --no-openings (Door 1, Window 1): walls keep holes where these "
        "stood, and light falls through"
    )
    np.testing.assert_array_equal(found.surface_of_polygon, town().surface_of_polygon)


def test_an_object_of_openings_alone_goes_and_an_empty_one_stays() -> None:
    parsed = replace(
        town(),
        surface_of_polygon=np.array([2, 3, 1, 1, 0, 0, 0, 0], np.uint8),
        object_face_start=np.array([0, 2, 4, 4, 8], np.int64),
    )
    (found,) = filtered([parsed], PATHS[:1], ReadOptions(has_openings=False))
    assert found.object_names == ("wing", "tin", "bridge")
    assert np.diff(found.object_face_start).tolist() == [2, 0, 4]


def test_options_add_up() -> None:
    found = left(ReadOptions(objects=("Building", "Bridge"), has_openings=False))
    assert found.object_names == ("house", "wing", "bridge")
    assert found.source_face.tolist() == [0, 2, 6, 7]


def test_a_file_of_which_nothing_is_left_stays_a_file() -> None:
    tin = replace(town(), object_types=("TINRelief",) * 4)
    found = filtered([tin, town()], PATHS, ReadOptions(objects=("Building",)))
    assert [len(p.object_names) for p in found] == [0, 2]
    assert found[0].faces.shape == (0, 3)


def test_a_type_that_no_object_has_lists_those_there_are() -> None:
    with pytest.raises(InputError) as raised:
        filtered([town()], PATHS[:1], ReadOptions(objects=("Building", "Brigde")))
    assert str(raised.value) == (
        'one.gml: no object is of the type "Brigde" (--objects); the types are +Bridge 1, '
        "Building 1, BuildingPart 1, TINRelief 1."
    )


def test_files_without_types_are_refused_by_name() -> None:
    untyped = replace(town(), object_types=())
    with pytest.raises(InputError, match=r"^two.gml: this file states no types of objects, so "):
        filtered([town(), untyped], PATHS, ReadOptions(objects=("Building",)))


def test_nothing_left_is_refused() -> None:
    tin = replace(town(), object_types=("TINRelief",) * 4)
    with pytest.raises(InputError) as raised:
        filtered([tin], PATHS[:1], ReadOptions(has_terrain=False))
    assert str(raised.value) == (
        "one.gml: nothing is left of 4 objects (TINRelief 4) after --no-terrain; "
        "ask for less to be left out."
    )


def test_what_had_no_effect_is_said() -> None:
    plain = replace(town(), object_types=(), surface_of_polygon=np.zeros(0, np.uint8))
    (found,) = filtered([plain], PATHS[:1], ReadOptions(has_terrain=False, has_openings=False))
    assert len(found.faces) == 8
    assert found.notes[1:] == (
        "no types of objects are stated, so --no-terrain left nothing out",
        "no surfaces are named, so --no-openings left nothing out",
    )


def test_no_terrain_where_there_is_none_says_so() -> None:
    built = replace(town(), object_types=("Building", "BuildingPart", "Building", ""))
    (found,) = filtered([built], PATHS[:1], ReadOptions(has_terrain=False))
    assert found.notes[1:] == (
        "the type of no object is terrain, so --no-terrain left nothing out (types: Building, "
        "BuildingPart)",
    )
    one, other = filtered([built, town()], PATHS, ReadOptions(has_terrain=False))
    assert one.notes == built.notes  # the terrain is in the other file
    assert other.notes[1] == "1 object left out by --no-terrain (TINRelief 1)"


@pytest.mark.parametrize(
    ("stated", "wanted", "is_one"),
    [
        ("Building", "Building", True),
        ("BuildingInstallation", "building", True),
        ("IntBuildingInstallation", "Building", True),
        ("Room", "Building", True),
        ("Building", "BuildingPart", False),
        ("TunnelPart", "Tunnel", True),
        ("HollowSpace", "Tunnel", True),
        ("Road", "R", False),
        ("+Shed", "shed", True),
        ("", "Building", False),
    ],
)
def test_types(stated: str, wanted: str, is_one: bool) -> None:
    assert is_of_type(stated, wanted) == is_one


def test_terrain_types() -> None:
    for name in ("TINRelief", "ReliefFeature", "RasterRelief", "terrain", "+TerrainPatch"):
        assert is_terrain(name)
    for name in ("Building", "LandUse", "Road", ""):
        assert not is_terrain(name)


def test_no_object_at_all() -> None:
    empty = ParsedFile(
        np.zeros((0, 3)), np.zeros((0, 3), np.uint32), np.zeros(1, np.int64),
        np.zeros(0, np.uint32), (), no_findings(), (),
    )  # fmt: skip
    (found,) = filtered([empty], PATHS[:1], ReadOptions(has_terrain=False))
    assert found.object_names == ()


def test_equal_options_are_equal_json() -> None:
    assert ReadOptions().as_config() == {}
    one = ReadOptions("2.2", ("Bridge", "Building"), False, False)
    other = ReadOptions("2.2", ("Building", "Bridge", "Building"), False, False)
    assert one.as_config() == other.as_config() == {
        "lod": "2.2", "objects": ["Bridge", "Building"], "terrain": False, "openings": False,
    }  # fmt: skip
    for lod in ("", "x", "2.", "-1", "1e3", "Highest"):
        with pytest.raises(InputError, match="level of detail"):
            ReadOptions(lod)
