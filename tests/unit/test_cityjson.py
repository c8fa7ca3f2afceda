"""CityJSON of every version: objects, levels, semantics, templates, sequences, bad input."""

from __future__ import annotations

import json
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from svprep.defects import Code
from svprep.errors import InputError
from svprep.ingest.cityjson import read_cityjson
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile

PATH = Path("t.city.json")
CUBE = [[x, y, z] for z in (0, 10) for y in (0, 10) for x in (0, 10)]
SHELL = [
    [[0, 2, 3, 1]], [[4, 5, 7, 6]], [[0, 1, 5, 4]], [[1, 3, 7, 5]], [[3, 2, 6, 7]], [[2, 0, 4, 6]],
]  # fmt: skip


def read(document, lod="highest") -> ParsedFile:
    raw = document if isinstance(document, bytes) else json.dumps(document).encode()
    data = np.frombuffer(bytearray(raw) + b"\n", np.uint8)
    return read_cityjson(data, PATH, "t", lambda fraction: None, ReadOptions(lod=lod))


def solid(lod="2", **more):
    return {"type": "Solid", "lod": lod, "boundaries": [SHELL], **more}


def sheet(*surfaces, lod="2", **more):
    return {"type": "MultiSurface", "lod": lod, "boundaries": list(surfaces), **more}


def building(*geometries, kind="Building", **more):
    return {"type": kind, "geometry": list(geometries), **more}


def city(objects, vertices=CUBE, **more):
    head = {"type": "CityJSON", "version": "2.0", "transform": UNIT}
    return {**head, "CityObjects": objects, "vertices": vertices, **more}


UNIT = {"scale": [1, 1, 1], "translate": [0, 0, 0]}


def boxes(read: ParsedFile):
    """Lowest and highest corner of each object."""
    starts = read.object_face_start
    corners = [read.positions[read.faces[a:b].ravel()] for a, b in pairwise(starts)]
    return [(c.min(axis=0).tolist(), c.max(axis=0).tolist()) for c in corners]


def message(document, **options) -> str:
    with pytest.raises(InputError) as caught:
        read(document, **options)
    text = str(caught.value)
    assert text.startswith("t.city.json: ")
    assert "\n" not in text
    assert len(text) < 700
    return text


# --- geometries


@pytest.mark.parametrize(
    ("kind", "boundaries", "n"),
    [
        ("MultiSurface", SHELL, 12),
        ("CompositeSurface", SHELL, 12),
        ("Solid", [SHELL], 12),
        ("Solid", [SHELL, SHELL], 24),
        ("MultiSolid", [[SHELL], [SHELL]], 24),
        ("CompositeSolid", [[SHELL, SHELL], [SHELL]], 36),
    ],
)
def test_every_type_of_geometry(kind, boundaries, n):
    got = read(city({"a": building({"type": kind, "lod": "2", "boundaries": boundaries})}))
    assert len(got.faces) == n
    assert got.object_face_start.tolist() == [0, n]
    assert np.bincount(got.source_face).tolist() == [2] * (n // 2)
    assert boxes(got) == [([0, 0, 0], [10, 10, 10])]


def test_holes_points_and_short_rings():
    vertices = [*CUBE, [2, 2, 0], [2, 4, 0], [4, 4, 0]]
    surfaces = [[[0, 1, 3, 2], [8, 9, 10]], [[0, 1]], [], [[0, 1, 5, 4]]]
    points = {"type": "MultiPoint", "lod": "0", "boundaries": [0, 1]}
    got = read(city({"a": building(sheet(*surfaces), points)}, vertices))
    assert np.bincount(got.source_face).tolist() == [7, 0, 0, 2]
    assert got.face_findings.code.tolist() == [Code.SHORT_POLYGON] * 2
    assert got.face_findings.source_face.tolist() == [1, 2]
    assert got.notes == ("1 MultiPoint geometry (points) left out",)


def test_the_transform_is_exact():
    transform = {"scale": [0.001, 0.01, 1e-3], "translate": [78248.66, 457604.591, 2.463]}
    got = read(city({"a": building(solid())}, transform=transform))
    expected = np.array(CUBE) * np.array([0.001, 0.01, 1e-3]) + [78248.66, 457604.591, 2.463]
    assert got.positions.tobytes() == expected.tobytes()


# --- objects


def test_ids_types_and_parents():
    objects = {
        "house": building(children=["part"]),
        "part": building(solid(), kind="BuildingPart", parents=["group", "house"]),
        "chimney": building(solid(), kind="BuildingInstallation"),
        "old": building(solid(), kind="BuildingPart", parent="house"),
        "group": building(kind="CityObjectGroup", children=["tree"], members=["tree"]),
        "tree": building(solid(), kind="+Tree"),
        "empty": {"type": "Road"},
        "lost": building(solid(), kind="BuildingPart", parents=["nobody"]),
    }
    objects["house"]["Installations"] = ["chimney"]
    got = read(city(objects))
    assert got.object_names == ("part", "chimney", "old", "tree", "lost")
    assert got.object_types == (
        "BuildingPart", "BuildingInstallation", "BuildingPart", "+Tree", "BuildingPart",
    )  # fmt: skip
    assert got.object_parents == ("house", "house", "house", "", "nobody")


def test_the_same_id_twice():
    one = json.dumps(building(solid()))
    text = json.dumps(city({"X": 0})).replace('"X": 0', f'"a": {one}, "b": {one}, "a": {one}')
    got = read(text.encode())
    assert got.object_names == ("a", "b", "a")
    assert got.notes == ("1 object with the id of an earlier one, kept: a",)


def test_levels_of_detail():
    flat = sheet([[0, 1, 3, 2]], lod="0")
    objects = {
        "a": building(flat, solid("1.2"), solid("2.2"), solid("1.3")),
        "b": building(flat, sheet(SHELL[0], lod=1), sheet(SHELL[0], lod=10**400)),
        "c": building(flat),
    }
    got = read(city(objects))
    assert got.object_names == ("a", "b")
    assert np.diff(got.object_face_start).tolist() == [12, 2]
    assert got.source_face.tolist() == [i // 2 for i in range(14)]
    assert "LoD 0 (a footprint) only left out: c" in got.notes[0]
    got = read(city(objects), lod="1")
    assert np.diff(got.object_face_start).tolist() == [12, 2]
    assert read(city(objects), lod="0").object_names == ("a", "b", "c")
    assert "0, 1, 1.2, 1.3, 2.2" in message(city(objects), lod="3")
    assert "no surface in 1 object" in message(city({"c": objects["c"]}))


# --- surfaces


def names_of(got: ParsedFile) -> list[str]:
    return [got.surface_names[i] for i in got.surface_of_polygon]


def test_semantics():
    listed = [{"type": "RoofSurface"}, {"type": "+Solar"}, {"type": 7}]
    semantics = {"surfaces": listed, "values": [[0, None, 1, 0, 2, 0]]}
    got = read(city({"a": building(solid(semantics=semantics))}))
    assert names_of(got) == ["RoofSurface", "", "+Solar", "RoofSurface", "", "RoofSurface"]
    shells = {"surfaces": listed, "values": [[[1] * 6, None], None]}
    two = {"type": "MultiSolid", "boundaries": [[SHELL, SHELL], [SHELL]], "semantics": shells}
    assert names_of(read(city({"a": building(two)}))) == ["+Solar"] * 6 + [""] * 12
    old = [["Wall"] * 4 + ["Roof", "Window"]]
    got = read(city({"a": building(solid(semantics=old))}, version="0.1"))
    assert names_of(got) == ["WallSurface"] * 4 + ["RoofSurface", "Window"]


@pytest.mark.parametrize(
    "semantics",
    [
        7,
        {"surfaces": [], "values": [[0] * 6]},
        {"surfaces": [{"type": "RoofSurface"}], "values": [0] * 6},
        {"surfaces": [{"type": "RoofSurface"}], "values": [[0] * 5]},
        {"surfaces": ["RoofSurface"], "values": [[0] * 6]},
        {"surfaces": 3, "values": [[0] * 6]},
        {"surfaces": [{"type": "RoofSurface"}], "values": [[-1] * 6]},
        {"surfaces": [{"type": "RoofSurface"}], "values": [[{}] * 6]},
    ],
)
def test_semantics_that_do_not_fit(semantics):
    got = read(city({"a": building(solid(semantics=semantics))}))
    assert names_of(got) == [""] * 6
    assert got.notes[0].startswith("1 geometry with semantics that do not fit")


def test_more_names_than_a_byte_holds():
    many = [sheet(SHELL[0], semantics={"surfaces": [{"type": f"+{i}"}], "values": [0]})
            for i in range(300)]  # fmt: skip
    got = read(city({"a": building(*many)}))
    assert len(got.surface_names) == 256
    assert names_of(got) == [f"+{i}" for i in range(254)] + ["other"] * 46


# --- templates


def test_templates_are_placed():
    turned = [0, -1, 0, 5, 2, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    templates = {
        "templates": [solid("1"), solid("3", semantics={"surfaces": [{"type": "A"}],
                                                        "values": [[0] * 6]})],
        "vertices-templates": CUBE,
    }  # fmt: skip

    def tree(template, vertex, matrix=None):
        more = {"transformationMatrix": matrix} if matrix else {}
        return {"type": "GeometryInstance", "template": template, "boundaries": [vertex], **more}

    objects = {
        "a": building(solid("1"), tree(1, 7, turned)),
        "b": building(tree(0, 1)),
        "c": building(solid("2")),
        "d": building(tree(1, 1)),
    }
    document = city(objects, **{"geometry-templates": templates})
    got = read(document)
    assert got.object_names == ("a", "b", "c", "d")
    assert np.diff(got.object_face_start).tolist() == [12] * 4
    assert boxes(got) == [
        ([5, 10, 10], [15, 30, 20]),
        ([10, 0, 0], [20, 10, 10]),
        ([0, 0, 0], [10, 10, 10]),
        ([10, 0, 0], [20, 10, 10]),
    ]
    assert names_of(got) == ["A"] * 6 + [""] * 12 + ["A"] * 6
    assert read(document, lod="1").object_names == ("a", "b")

    for bad, text in (
        (tree(2, 0), "geometry template 2, but there are 2"),
        (tree(True, 0), "geometry template True"),
        (tree(0, 8), "[8], not one of the 8 vertices"),
        (tree(0, 0, turned[:15]), "16 finite numbers"),
        (tree(0, 0, [float("nan"), *turned[1:]]), "16 finite numbers"),
        (tree(0, 0, [*turned[:12], 1, 0, 0, 1]), "the last row 0 0 0 1"),
    ):
        document["CityObjects"]["b"] = building(bad)
        found = message(document)
        assert 'object "b"' in found
        assert text in found


def test_an_instance_that_is_not_finite():
    matrix = [1e299, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1e-9]
    templates = {"templates": [solid("1")], "vertices-templates": CUBE}
    one = {"type": "GeometryInstance", "template": 0, "boundaries": [0]}
    objects = {"a": building({**one, "transformationMatrix": matrix})}
    assert "not a finite position" in message(city(objects, **{"geometry-templates": templates}))


def test_templates_that_are_wrong():
    itself = {"type": "GeometryInstance", "template": 0, "boundaries": [0]}
    for template, text in (
        (itself, "geometry template 0: it is itself an instance"),
        ({"type": "Cube"}, "no geometry of type 'Cube'"),
        (3, "it is no geometry"),
        (solid(), "vertex 7, but there are 0 in vertices-templates"),
    ):
        document = city(
            {"a": building(itself)}, **{"geometry-templates": {"templates": [template]}}
        )
        assert text in message(document)


def test_instances_that_ask_for_gigabytes():
    templates = {"templates": [sheet(*[[[0, 1, 2]]] * 20_000)], "vertices-templates": CUBE}
    one = {"type": "GeometryInstance", "template": 0, "boundaries": [0]}
    objects = {"a": building(*[one] * 3000)}
    found = message(city(objects, **{"geometry-templates": templates}))
    assert "3000 instances of geometry templates have 180000000 corners" in found
    objects = {"a": building(*[one] * 150)}  # 9 M corners of a file of half a megabyte
    found = message(city(objects, **{"geometry-templates": templates}))
    assert "have 9000000 corners; of a file of" in found


@pytest.mark.parametrize("is_swapped", [False, True])
def test_metres_of_a_template_around_degrees(is_swapped):
    pytest.importorskip("pyproj")
    templates = {"templates": [solid("1")], "vertices-templates": CUBE}
    objects = {"a": building({"type": "GeometryInstance", "template": 0, "boundaries": [0]})}
    at = [139.7, 35.5, 3.0]
    vertices = [[35.5, 139.7, 3.0] if is_swapped else at]
    document = city(objects, vertices=vertices, **{"geometry-templates": templates})
    document["metadata"] = {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/6697"}
    placed = read(document).positions
    extent = np.ptp(placed[1:], axis=0)
    np.testing.assert_allclose(extent, [10 / 90_735, 10 / 110_949, 10], rtol=1e-3)
    np.testing.assert_allclose(placed[1:].min(axis=0), at, rtol=1e-9)


# --- sequences


def feature(name, vertices=CUBE, **more):
    objects = {name: building(solid())}
    return {
        "type": "CityJSONFeature",
        "id": name,
        "CityObjects": objects,
        "vertices": vertices,
        **more,
    }


def lines(*documents) -> bytes:
    return "\n".join(json.dumps(d) for d in documents).encode()


def test_a_sequence():
    transform = {"scale": [0.5, 0.5, 0.5], "translate": [100, 0, 0]}
    head = city({}, [], transform=transform, metadata={"referenceSystem": "EPSG:28992"})
    far = [[x + 40, y, z] for x, y, z in CUBE]
    got = read(lines(head, feature("a"), feature("b", far)) + b"\n\n")
    assert got.object_names == ("a", "b")
    assert boxes(got) == [([100, 0, 0], [105, 5, 5]), ([120, 0, 0], [125, 5, 5])]
    assert got.crs == "EPSG:28992"
    assert got.source_face.tolist() == [i // 2 for i in range(24)]


def test_sequences_that_are_wrong():
    head = city({}, [])
    assert "a CityJSONFeature comes first" in message(lines(feature("a"), head))
    assert "feature 2: its \"type\" is 'CityJSON'" in message(lines(head, feature("a"), head))
    assert 'object "b": its boundaries refer to vertex 7' in message(
        lines(head, feature("a"), feature("b", CUBE[:7]))
    )
    whole = lines(head, feature("a"), feature("b"))
    assert "feature 2: the text ends" in message(whole[:-30])


# --- coordinates


@pytest.mark.parametrize(
    ("metadata", "crs"),
    [
        ({"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/7415"},) * 2,
        ([{"referenceSystem": " urn:ogc:def:crs:EPSG::28992 "}], "urn:ogc:def:crs:EPSG::28992"),
        ({"crs": {"epsg": 7415}}, "EPSG:7415"),
        ({"crs": {"epsg": "x"}, "referenceSystem": 4}, ""),
        ([3], ""),
        ("no", ""),
    ],
)
def test_crs(metadata, crs):
    got = read(city({"a": building(solid())}, metadata=metadata))
    assert got.crs == (crs["referenceSystem"] if isinstance(crs, dict) else crs)
    assert got.positions[1].tolist() == [10, 0, 0]


@pytest.mark.parametrize("crs", [6697, 4326])
def test_latitude_first_is_swapped(crs):
    pytest.importorskip("pyproj")
    url = f"https://www.opengis.net/def/crs/EPSG/0/{crs}"
    transform = {"scale": [1e-6, 1e-6, 1], "translate": [35.6, 139.7, 0]}
    document = city({"a": building(solid())}, metadata={"referenceSystem": url})
    got = read({**document, "transform": transform})
    assert got.positions[1].tolist() == [139.7, 10 * 1e-6 + 35.6, 0]
    assert "swapped" in got.notes[0]


# --- bad input


def test_what_is_not_cityjson():
    assert "its \"type\" is 'FeatureCollection'" in message({"type": "FeatureCollection"})
    assert 'it has no "type"' in message({})
    assert "byte 0 begins" in message(b"[1, 2]")
    assert "byte 0 begins" in message(b"<xml/>")
    assert "UTF-16" in message("{}".encode("utf-16"))
    assert "nothing but white space" in message(b"  ")
    assert "not UTF-8" in message(b'{"type": "CityJS\xff"}')
    assert "twice" in message(b'{"type": "CityJSON", "type": "CityJSON"}')
    assert "no surface in 0 objects" in message({"type": "CityJSON"})


def test_a_byte_order_mark_and_a_new_version():
    got = read(b"\xef\xbb\xbf" + json.dumps(city({"a": building(solid())}, version="3.0")).encode())
    assert "version 3.0 is newer" in got.notes[0]


GOOD = json.dumps(city({"a": building(solid(), attributes={"x": '}\\"]'})})).encode()


def test_every_truncation_is_refused():
    for n in range(1, len(GOOD)):
        message(GOOD[:n])


@pytest.mark.parametrize(
    ("boundaries", "text"),
    [
        (None, "not nested deeply enough"),
        (7, "not nested deeply enough"),
        ("abc", "not nested deeply enough"),
        ({"a": 1}, "not nested deeply enough"),
        (SHELL, "not nested deeply enough"),
        ([[SHELL]], "nested too deeply"),
        ([[[[0, 1, "2"]]]], "'2' in its boundaries is not"),
        ([[[[0, 1, True]]]], "True in its boundaries"),
        ([[[[0, 1, 2.0]]]], "2.0 in its boundaries"),
        ([[[[0, 1, None]]]], "None in its boundaries"),
        ([[[[0, 1, -1]]]], "vertex -1 in its boundaries does not exist"),
        ([[[[0, 1, 1 << 40]]]], "does not exist"),
        ([[[[0, 1, 8]]]], "refer to vertex 8, but there are 8 vertices"),
        ([[[[0, 1, float("nan")]]]], "nan in its boundaries"),
    ],
)
def test_boundaries_that_are_wrong(boundaries, text):
    good = building(solid())
    found = message(city({"a": good, "b": building({**solid(), "boundaries": boundaries})}))
    assert 'object "b"' in found
    assert text in found


@pytest.mark.parametrize(
    ("described", "text"),
    [
        (None, "it is None"),
        ([], "it is []"),
        (building(None), "not a list of geometries"),
        ({"type": "Building", "geometry": "x"}, "not a list of geometries"),
        (building({"type": "Sphere"}), "no geometry of type 'Sphere'"),
        (building({}), "no geometry of type None"),
        (building({"type": ["Solid"]}), "no geometry of type"),
    ],
)
def test_objects_that_are_wrong(described, text):
    found = message(city({"b": described}))
    assert 'object "b"' in found
    assert text in found


@pytest.mark.parametrize(
    ("vertices", "text"),
    [
        ("[[0, 0, NaN]]", '"NaN" in vertex 0 is not a finite number'),
        ("[[0, 0, 0], [0, -Infinity, 0]]", '"-Infinity" in vertex 1'),
        ("[[0, 0, 1e999]]", '"1e999" in vertex 0'),
        ("[[0, 0, 1.5.2]]", '"1.5.2" in vertex 0'),
        ("[[0, 0, -]]", '"-" in vertex 0'),
        ("[[0, 0, null]]", '"null" in vertex 0'),
        ('[[0, 0, "1"]]', "in vertex 0"),
        ("[[0, 0]]", "vertex 0: three numbers"),
        ("[[0, 0, 1, 2]]", "vertex 1: three numbers"),
        ("[[,,],[,,],[,,]]", "vertex 0: three numbers"),
        ("[[0, 0, [1]]]", '"[1" in vertex 0'),
        ("[0, 0, 1]", "vertex 0: three numbers"),
        ("{}", "vertex 0: three numbers"),
        ("7", "vertex 0: three numbers"),
    ],
)
def test_vertices_that_are_wrong(vertices, text):
    raw = json.dumps(city({"a": building(solid())}, "V")).replace('"V"', vertices).encode()
    assert text in message(raw)


def test_numbers_that_take_more_than_one_step():
    numbers = ["0.30000000000000004441", "1e-7", "-0.0", "123456789012345678901", "1E+3", "9.7e22"]
    raw = json.dumps(city({"a": building(sheet([[0, 1, 2]]))}, "V"))
    vertices = f"[[{', '.join(numbers[:3])}],[{','.join(numbers[3:])}] , [ 1 ,2,\t3\n]\r]"
    got = read(raw.replace('"V"', vertices).replace(json.dumps(UNIT), "{}", 0).encode())
    expected = [float(number) for number in numbers]
    assert got.positions[:2].ravel().tolist() == expected


@pytest.mark.parametrize(
    "transform",
    [
        None,
        {"scale": [1, 1]},
        {"scale": [1, 1, 1], "translate": [0, 0, "0"]},
        {"scale": [1, 1, 0], "translate": [0, 0, 0]},
        {"scale": [1, 1, float("inf")], "translate": [0, 0, 0]},
        {"scale": [1, 1, 1e299], "translate": [0, 0, 0]},
    ],
)
def test_transforms_that_are_wrong(transform):
    far = [[x * 1e10, y, z * 1e10] for x, y, z in CUBE]
    assert "transform" in message(city({"a": building(solid())}, far, transform=transform))


@pytest.mark.parametrize(
    "where", ["attributes", "geometry", "metadata", "unknown", "vertices", "type"]
)
def test_deep_nesting(where):
    deep = "[" * 100_000 + "]" * 100_000
    document = city({"a": building(solid(), attributes="DEEP")})
    if where == "geometry":
        document["CityObjects"]["a"]["geometry"].append("DEEP")
    elif where != "attributes":
        document[where] = "DEEP"
    raw = json.dumps(document).replace('"DEEP"', deep).replace('"DEEP"', "0").encode()
    if where in ("attributes", "unknown"):  # nobody reads it
        if where == "unknown":
            assert len(read(raw).faces) == 12
        return
    found = message(raw)
    assert where == "vertices" or "nested too deeply" in found


def test_parts_nested_a_thousand_deep_and_cycles():
    objects = {
        str(i): building(kind="BuildingPart", parents=[str(i + 1)], children=[str(i - 1)])
        for i in range(3000)
    }
    objects["0"]["geometry"] = [solid("2")]
    objects["2999"]["geometry"] = [solid("1")]
    assert read(city(objects)).object_names == ("0",)
    objects["2999"]["parents"] = ["0"]
    got = read(city(objects))
    assert any("their own ancestors" in note for note in got.notes)


def test_very_many_empty_objects():
    empty = ",".join(f'"{i}":{{"type":"Building"}}' for i in range(200_000))  # a million: 5 times
    raw = json.dumps(city({"X": building(solid())})).replace('"X":', empty + ',"X":').encode()
    begin = time.perf_counter()
    got = read(raw)
    assert time.perf_counter() - begin < 30
    assert got.object_names == ("X",)


def test_a_polygon_of_many_corners():
    n = 50_000
    angles = np.arange(n) * 2 * np.pi / n
    ring = np.rint(1e6 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)).astype(int)
    got = read(city({"a": building(sheet([list(range(n))]))}, ring.tolist()))
    assert len(got.faces) == n - 2
