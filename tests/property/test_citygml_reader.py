"""Whatever bytes come, the CityGML reader refuses them in one line or returns a valid file."""

from __future__ import annotations

import re

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from svprep.errors import InputError
from svprep.ingest.parsed import ParsedFile
from tests.unit.test_citygml import HEAD, building, city, lod, part, polygon, read, surfaces, wall

WHOLE = city(
    building(
        '<gml:boundedBy><gml:Envelope srsName="EPSG:28992" srsDimension="3"/></gml:boundedBy>',
        "<bldg:lod2Solid><gml:Solid><gml:exterior>",
        surfaces("#w", polygon("0 0 0 1 0 0 1 1 1 0 0 0"), kind="CompositeSurface"),
        "</gml:exterior></gml:Solid></bldg:lod2Solid>",
        wall(lod(polygon(name="w", holes=(".2 .2 0 .4 .2 0 .4 .4 0 .2 .2 0",)))),
        wall(lod("#w", polygon().replace("posList", "pos")), "RoofSurface"),
        part(lod(polygon(), name="lod1Solid")),
    ),
    building(
        "<bldg:lod3ImplicitRepresentation><ImplicitGeometry><transformationMatrix>"
        "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transformationMatrix><relativeGMLGeometry>"
        f"{surfaces(polygon(), '#w')}</relativeGMLGeometry><referencePoint><gml:Point>"
        "<gml:coordinates>1,2,3</gml:coordinates></gml:Point></referencePoint>"
        "</ImplicitGeometry></bldg:lod3ImplicitRepresentation>",
        name="b2",
    ),
).replace("<gml:pos>0 0 0 1 0 0 1 1 0 0 1 0 0 0 0</gml:pos>", "<gml:pos>0 0 1</gml:pos>" * 4)
BYTES = WHOLE.encode()
TAGS = re.findall(r"<[^>]*>|[^<]+", WHOLE.removeprefix(HEAD).removesuffix("</CityModel>"))
PIECES = [
    "NaN", "1e999", "-", "", "0 0", "&amp;", "&lol;", "<!--", "]]>", "<gml:pos>", "</gml:Polygon>",
    '<gml:Polygon gml:id="w">', "<gml:LinearRing>", ' srsName="EPSG:4326"', ' srsDimension="2"',
    ' orientation="-"', ' xlink:href="#w"', "<lod2Solid/>", "<appearance>", "1e300 -1e300 1e-300",
]  # fmt: skip


def check(text: str | bytes) -> None:
    """Read; whatever is returned must hold together."""
    message = ""
    try:
        check_parsed(read(text))
    except InputError as error:
        message = str(error)
    assert "\n" not in message


def check_parsed(parsed: ParsedFile) -> None:
    n = len(parsed.object_names)
    assert n == len(parsed.object_types) == len(parsed.object_parents) > 0
    assert parsed.positions.dtype == np.float64
    assert np.isfinite(parsed.positions).all()
    assert parsed.faces.dtype == np.uint32
    assert parsed.faces.max() < len(parsed.positions)
    start = parsed.object_face_start
    assert start[0] == 0
    assert start[-1] == len(parsed.faces) == len(parsed.source_face) > 0
    assert (np.diff(start) >= 0).all()
    assert parsed.source_face.max() < len(parsed.surface_of_polygon)
    assert parsed.surface_of_polygon.max() < len(parsed.surface_names)
    assert (parsed.face_findings.object_index < n).all()


def test_the_whole_document_is_read() -> None:
    check_parsed(read(WHOLE))
    assert len(read(WHOLE).object_names) == 2


@settings(max_examples=100)
@given(
    st.lists(st.tuples(st.integers(0, len(BYTES) - 1), st.integers(0, 255)), min_size=1, max_size=6)
)
def test_bytes_turned(flips: list[tuple[int, int]]) -> None:
    changed = bytearray(BYTES)
    for where, value in flips:
        changed[where] = value
    check(bytes(changed))


@settings(max_examples=100)
@given(st.integers(0, len(BYTES)), st.integers(0, 200), st.sampled_from(PIECES))
@example(len(HEAD), 0, "<!DOCTYPE x>")
def test_cut_off_or_with_a_piece_put_in(where: int, n_removed: int, piece: str) -> None:
    check(BYTES[:where])
    check(BYTES[:where] + piece.encode() + BYTES[where + n_removed :])


@settings(max_examples=100)
@given(st.data())
def test_tags_shuffled(data: st.DataObject) -> None:
    tags = list(TAGS)
    for _ in range(data.draw(st.integers(1, 4))):
        i, j = data.draw(st.tuples(*[st.integers(0, len(tags) - 1)] * 2))
        kind = data.draw(st.sampled_from(["swap", "repeat", "remove", "put"]))
        if kind == "swap":
            tags[i], tags[j] = tags[j], tags[i]
        elif kind == "repeat":
            tags[i:i] = tags[j : j + 5]
        elif kind == "put":
            tags.insert(i, data.draw(st.sampled_from(PIECES)))
        elif len(tags) > 1:
            del tags[i]
    check(f"{HEAD}{''.join(tags)}</CityModel>")


NAMES = [
    "bldg:Building", "bldg:BuildingPart", "bldg:WallSurface", "bldg:lod2MultiSurface",
    "bldg:lod1Solid",
    "bldg:boundedBy", "gml:MultiSurface", "gml:OrientableSurface", "gml:Polygon", "gml:exterior",
    "gml:interior", "gml:LinearRing", "gml:posList", "gml:pos", "gml:coordinates", "dem:tin",
    "dem:lod", "ImplicitGeometry", "relativeGMLGeometry", "referencePoint", "transformationMatrix",
    "gml:Envelope", "appearance", "gml:LineString",
]  # fmt: skip
ATTRIBUTES = [
    "", "", "", ' gml:id="a"', ' gml:id="b"', ' xlink:href="#a"', ' xlink:href="#b"',
    ' orientation="-"', ' srsDimension="2"', ' srsName="EPSG:28992"', ' srsName="nowhere"',
]  # fmt: skip
TEXTS = ["", "0 0 0 1 0 0 1 1 0 0 0 0", "1 2 3", "2", "1,2,3 4,5,6 7,9,9", "nan", "1 2"]


def element(name: str, attributes: str, inside: list[str]) -> str:
    return f"<{name}{attributes}>{''.join(inside)}</{name}>"


TREES = st.recursive(
    st.sampled_from([*TEXTS, polygon(), polygon(name="a"), lod(polygon(name="b"))]),
    lambda inside: st.builds(
        element, st.sampled_from(NAMES), st.sampled_from(ATTRIBUTES), st.lists(inside, max_size=4)
    ),
    max_leaves=25,
)


@settings(max_examples=120)
@given(st.lists(TREES, min_size=1, max_size=4))
def test_elements_anywhere(trees: list[str]) -> None:
    check(f"{HEAD}{''.join(trees)}{building(lod(polygon()))}</CityModel>")
