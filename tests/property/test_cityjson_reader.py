"""The CityJSON reader against a plain twin, and any text against one clear line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svprep.errors import InputError
from svprep.ingest import cityjson_text
from svprep.ingest.cityjson import read_cityjson
from svprep.ingest.holes import triangulate_rings
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile

DEPTH = {"MultiSurface": 0, "CompositeSurface": 0, "Solid": 1, "MultiSolid": 2}
N_VERTICES = 12


def read_text(text: str | bytes) -> ParsedFile:
    raw = text if isinstance(text, bytes) else text.encode()
    data = np.frombuffer(bytearray(raw) + b"\n", np.uint8)
    return read_cityjson(data, Path("t.json"), "t", lambda fraction: None, ReadOptions())


def twin(document: dict) -> tuple[list[list[list[int]]], list[str], list[str]]:
    """Polygons, the object of each and the name of each one's surface; one level of detail."""
    polygons, objects, names = [], [], []
    for name, described in document["CityObjects"].items():
        for geometry in described.get("geometry", []):
            surfaces = geometry["boundaries"]
            values = geometry.get("semantics", {}).get("values")
            for _ in range(DEPTH[geometry["type"]]):
                surfaces = [s for part in surfaces for s in part]
                values = values and [v for part in values for v in part]
            for i, surface in enumerate(surfaces):
                value = values[i] if values else None
                polygons.append(surface)
                objects.append(name)
                listed = geometry.get("semantics", {}).get("surfaces", [])
                names.append("" if value is None else listed[value]["type"])
    return polygons, objects, names


texts = st.text('ab"\\/{}[],: \n\u00e9\U0001f3e0', max_size=6)
junk = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), texts),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(texts, inner, max_size=3)),
    max_leaves=6,
)
surface = st.lists(st.lists(st.integers(0, N_VERTICES - 1), max_size=6), max_size=2)


@st.composite
def geometries(draw):
    kind = draw(st.sampled_from(list(DEPTH)))
    boundaries = st.lists(surface, min_size=1, max_size=4)
    value = st.one_of(st.none(), st.integers(0, 2))
    for _ in range(DEPTH[kind]):
        boundaries = st.lists(boundaries, min_size=1, max_size=2)
    geometry = {"type": kind, "lod": "2", "boundaries": draw(boundaries)}

    def values(part, depth):
        if depth:
            return [values(inner, depth - 1) for inner in part]
        return [draw(value) for _ in part]

    if draw(st.booleans()):
        listed = [{"type": draw(st.sampled_from(["A", "B", "C"]))} for _ in range(3)]
        found = values(geometry["boundaries"], DEPTH[kind])
        geometry["semantics"] = {"surfaces": listed, "values": found}
    if draw(st.booleans()):
        geometry[draw(st.sampled_from(["material", "texture", "z"]))] = draw(junk)
    keys = draw(st.permutations(list(geometry)))
    return {key: geometry[key] for key in keys}


@st.composite
def documents(draw):
    objects = {}
    for name in draw(st.lists(texts, min_size=1, max_size=4, unique=True)):
        described = {"attributes": draw(junk), "type": "Road", "address": draw(junk)}
        if draw(st.booleans()):
            described["geometry"] = draw(st.lists(geometries(), max_size=2))
        objects[name] = described
    number = st.floats(-1e6, 1e6)
    vertices = draw(st.lists(st.tuples(number, number, number), min_size=N_VERTICES, max_size=20))
    document = {
        "type": "CityJSON",
        "appearance": draw(junk),
        "CityObjects": objects,
        "vertices": vertices,
        "+x": draw(junk),
    }
    return {key: document[key] for key in draw(st.permutations(list(document)))}


@settings(max_examples=60)
@given(documents(), st.sampled_from([None, 1, "\t"]), st.booleans(), st.sampled_from([1, 1 << 20]))
def test_reader_equals_its_twin(document, indent, is_ascii, batch_bytes):
    text = json.dumps(document, indent=indent, ensure_ascii=is_ascii)
    polygons, objects, names = twin(document)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cityjson_text, "BATCH_BYTES", batch_bytes)
        if all(len(set(p[0])) < 3 if p else True for p in polygons):
            with pytest.raises(InputError):
                read_text(text)
            return
        got = read_text(text)
    rings = [ring for polygon in polygons for ring in polygon]
    corners = np.array([i for ring in rings for i in ring], np.uint32)
    ring_start = np.cumsum([0] + [len(ring) for ring in rings])
    polygon_start = np.cumsum([0] + [len(polygon) for polygon in polygons])
    positions = np.array(document["vertices"], np.float64)
    expected = triangulate_rings(positions, corners, ring_start, polygon_start)

    assert got.positions.tobytes() == positions.tobytes()
    assert got.faces.tolist() == expected.triangles.tolist()
    assert got.source_face.tolist() == expected.polygon_of_triangle.tolist()
    assert list(got.object_names) == list(dict.fromkeys(objects))
    owner = np.repeat(np.arange(len(got.object_names)), np.diff(got.object_face_start))
    assert [got.object_names[i] for i in owner] == [objects[p] for p in got.source_face]
    assert [got.surface_names[i] for i in got.surface_of_polygon] == names
    assert got.face_findings.code.tolist() == expected.finding[expected.finding > 0].tolist()


digits = st.text("0123456789", min_size=1, max_size=25)
tokens = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True).map(str),
    st.builds("{}{}.{}".format, st.sampled_from(["", "-"]), digits, digits),
    st.builds("{}e{}".format, digits, st.integers(-340, 330)),
    st.text("0123456789+-.eE", min_size=1, max_size=6),
)


@settings(max_examples=150)
@given(st.lists(tokens, min_size=3, max_size=3))
def test_numbers_are_those_of_json(numbers):
    objects = '{"a":{"type":"Road","geometry":[{"type":"MultiSurface","boundaries":[[[1,2,3]]]}]}}'
    vertices = f"[[{','.join(numbers)}],[0,0,0],[1,0,0],[0,1,0]]"
    text = f'{{"type":"CityJSON","vertices":{vertices},"CityObjects":{objects}}}'
    try:
        expected = np.array(json.loads(f"[{','.join(numbers)}]"), np.float64)
        is_good = bool(np.isfinite(expected).all())
    except (ValueError, OverflowError):
        is_good = False
    message = refused_in_one_line(text.encode())
    if message:
        assert not is_good
        assert "vertex 0" in message
        return
    got = read_text(text).positions[0]
    if is_good:
        assert got.tobytes() == expected.tobytes()
    else:  # 007 and 7. are no JSON, and can be read all the same
        assert got.tolist() == [float(number) for number in numbers]


SMALL = json.dumps(
    {
        "type": "CityJSON",
        "version": "1.1",
        "transform": {"scale": [0.5, 1, 2], "translate": [0, 0, 0]},
        "metadata": {"referenceSystem": "x"},
        "geometry-templates": {
            "templates": [{"type": "MultiSurface", "boundaries": [[[0, 1, 2]]], "lod": "1"}],
            "vertices-templates": [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        },
        "CityObjects": {
            "a": {
                "type": "Building",
                "children": ["b"],
                "geometry": [
                    {
                        "type": "Solid",
                        "lod": 1,
                        "boundaries": [[[[0, 1, 2]], [[0, 1, 3], [1, 2, 3]]]],
                        "semantics": {"surfaces": [{"type": "W"}], "values": [[0, None]]},
                    }
                ],
            },
            "b": {
                "type": "BuildingPart",
                "parents": ["a"],
                "geometry": [
                    {
                        "type": "GeometryInstance",
                        "template": 0,
                        "boundaries": [3],
                        "transformationMatrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
                    }
                ],
            },
        },
        "vertices": [[0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, 4]],
    }
).encode()


def refused_in_one_line(text: bytes) -> str:
    message = ""
    try:
        read_text(text)
    except InputError as error:
        message = str(error)
    assert "\n" not in message
    assert message == "" or message.startswith("t.json: ")
    return message


@settings(max_examples=300)
@given(
    st.lists(
        st.tuples(
            st.integers(0, len(SMALL) - 1),
            st.integers(0, 12),
            st.sampled_from(
                [b"", b"[", b"]", b"{", b"}", b",", b'"', b"\\", b"-1", b"7", b"1e9", b"true",
                 b"null", b'""', b"[]", b"{}", b"\xff", b"\0", b"NaN", b":", b"99999999999999999"]
            ),
        ),
        min_size=1,
        max_size=3,
    )
)  # fmt: skip
def test_damaged_text_is_read_or_refused(edits):
    text = SMALL
    for at, n, new in edits:
        text = text[:at] + new + text[at + n :]
    refused_in_one_line(text)


@settings(max_examples=100)
@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(text):
    assert refused_in_one_line(text)
    refused_in_one_line(SMALL + text)


def spots(tree, path=()):
    """Yield the path to every value of a JSON tree."""
    yield path
    if isinstance(tree, dict | list):
        for key in tree if isinstance(tree, dict) else range(len(tree)):
            yield from spots(tree[key], (*path, key))


SPOTS = list(spots(json.loads(SMALL)))[1:]


@settings(max_examples=250)
@given(st.lists(st.tuples(st.sampled_from(SPOTS), junk), min_size=1, max_size=2))
def test_any_value_in_any_place_is_read_or_refused(edits):
    document = json.loads(SMALL)
    for path, value in edits:
        at = document
        try:
            for key in path[:-1]:
                at = at[key]
            at[path[-1]] = value
        except (TypeError, LookupError):  # the other edit took the place away
            continue
    refused_in_one_line(json.dumps(document).encode())
