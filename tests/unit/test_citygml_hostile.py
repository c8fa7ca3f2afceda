"""CityGML from strangers: a clear line or a counted defect, in bounded time and memory."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import pytest

from svprep.errors import InputError
from svprep.ingest.citygml_numbers import parse_numbers
from tests.unit.test_citygml import HEAD, building, city, lod, outlines, part, polygon, read

DTD = '<?xml version="1.0"?><!DOCTYPE CityModel {}>' + city(building(lod(polygon())))


def refusal(text: str | bytes) -> str:
    with pytest.raises(InputError) as caught:
        read(text)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("city.gml: ")
    return message


@pytest.mark.parametrize(
    ("declared", "named"),
    [
        ('[<!ENTITY lol "lol"><!ENTITY b "&lol;&lol;">]', 'the entity "lol"'),
        ('[<!ENTITY x SYSTEM "file:///etc/passwd">]', 'the entity "x"'),
        ('[<!ENTITY % p SYSTEM "http://example.org/p.dtd"> %p;]', 'the parameter entity "p"'),
        ('SYSTEM "http://example.org/city.dtd"', "example.org/city.dtd"),
        ('PUBLIC "-//X//Y" "city.dtd"', "city.dtd"),
        ('[<!ATTLIST CityModel big CDATA "x">]', 'the attribute "big"'),
    ],
)
def test_declarations_are_refused_by_name(declared: str, named: str) -> None:
    message = refusal(DTD.format(declared))
    assert named in message
    assert "remove the DOCTYPE" in message


def test_a_plain_doctype_and_plain_entities_are_fine() -> None:
    assert len(read(DTD.format("")).faces) == 2
    text = city(building(lod(polygon()), name="A&amp;B &#x43;"))
    assert read(text).object_names == ("A&B C",)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('<kml xmlns="http://www.opengis.net/kml/2.2"/>', "begins with <kml>"),
        ('<svg xmlns="http://www.w3.org/2000/svg"><path/></svg>', "begins with <svg>"),
        ("<html></html>", "begins with <html>"),
        ("v 0 0 0\nf 1 1 1\n", "not readable XML"),
        ("", "not readable XML"),
        ("<CityModel>", "not readable XML"),
        (HEAD, "not readable XML"),
        (city(), "no surface of any of 0 city objects"),
        (city(building()), "no surface of any of 1 city object"),
        (city(building(lod())), "no surface of any of 1 city object"),
        (city(building(lod(polygon("0 0 0 1 0 0 0 0 0")))), "has three different corners"),
        (city(building(lod(polygon()))).encode("utf-16")[:-9], "not readable XML"),
        (b'<?xml version="1.0" encoding="ebcdic-x"?><CityModel/>', "encoding"),
        (b'<?xml version="1.0" encoding="big5"?><CityModel/>', "encoding"),
        (city(building(name="\xe9")).encode("latin-1"), "not readable XML"),
        (city(building()).replace("CityModel", "x:CityModel", 1), "not readable XML"),
    ],
)
def test_what_is_no_city(text: str | bytes, named: str) -> None:
    assert named in refusal(text)


def test_other_encodings_are_read() -> None:
    text = city(building(lod(polygon()), name="Gebäude €"))
    for encoding in ("utf-16", "windows-1252", "utf-8-sig"):
        declared = f'<?xml version="1.0" encoding="{encoding.removesuffix("-sig")}"?>{text}'
        assert read(declared.encode(encoding)).object_names == ("Gebäude €",)


@pytest.mark.parametrize(
    ("numbers", "named"),
    [
        ("0 0 0 1 0 0 1 NaN 0 0 0 0", '"NaN" is not a finite number'),
        ("0 0 0 1 0 0 1 -INF 0 0 0 0", '"-INF" is not a finite number'),
        ("0 0 0 1 0 0 1 1e999 0 0 0 0", '"1e999" is not a finite number'),
        ("0 0 0 1 0 0 1 1.2.3 0 0 0 0", '"1.2.3" is not a finite number'),
        ("0 0 0 1 0 0 1 1_0 0 0 0 0", '"1_0" is not a finite number'),
        ("0 0 0 1 0 0 1 0x10 0 0 0 0", '"0x10" is not a finite number'),
        ("0 0 0 1 0 0 1 five 0 0 0 0", '"five" is not a finite number'),
        ("0 0 0 1 0 0 1 ٣ 0 0 0 0", '"٣" is not a finite number'),
        ("0,0,0 1,0,0", '"0,0,0" is not a finite number'),
        ("0 0 0 1 0 0 1 1 0 0 0", "11 numbers in a list (posList), 3 are needed"),
    ],
)
def test_numbers_that_are_none(numbers: str, named: str) -> None:
    good = polygon(name="good")
    message = refusal(
        city(building(lod(good)), building(lod(good, polygon(numbers, "bad")), name="b2"))
    )
    assert named in message
    assert 'polygon "bad"' in message


def test_numbers_are_rounded_as_python_rounds_them() -> None:
    rng = np.random.default_rng(5)
    words = [f"{x:.{d}g}" for x, d in zip(rng.normal(0, 1e6, 3000), [3, 9, 17] * 1000, strict=True)]
    values = parse_numbers(" ".join(words))
    assert values is not None
    assert values.tolist() == [float(word) for word in words]


def test_positions_of_four_numbers() -> None:
    whole = polygon("0 0 0 1").replace("posList", "pos")
    assert "4 numbers in 1 position (pos)" in refusal(city(building(lod(whole))))


@pytest.mark.parametrize(
    "inside",
    [
        "<gml:Polygon/>",
        "<gml:exterior><gml:LinearRing><gml:LinearRing/></gml:LinearRing></gml:exterior>",
        '<gml:exterior><gml:LinearRing srsDimension="many"/></gml:exterior>',
    ],
)
def test_geometry_that_is_nested_or_stated_wrongly(inside: str) -> None:
    refused = city(building(lod(f"<gml:Polygon>{inside}</gml:Polygon>")))
    assert "the file is damaged" in refusal(refused)


def test_rings_in_odd_places() -> None:
    loose = "<gml:LinearRing><gml:posList>0 0 x</gml:posList></gml:LinearRing>"
    parsed = read(city(loose, building(lod(loose, polygon()))))
    assert "2 rings outside of polygons left out" in parsed.notes
    swapped = polygon(holes=("1 1 0 2 1 0 2 2 0",)).replace("exterior", "interior")
    assert any(
        "first ring is an interior one" in n for n in read(city(building(lod(swapped)))).notes
    )


def test_truncation_at_every_byte() -> None:
    whole = city(building(lod(polygon()))).encode()
    for n in range(0, len(whole) - 1, 7):
        refusal(whole[:n])


def test_a_polygon_with_many_corners() -> None:
    text = " ".join(f"{x} {x % 2 * 1000} 0" for x in np.arange(100_000).tolist())  # a comb
    started = time.perf_counter()
    assert len(read(city(building(lod(polygon(text))))).faces) == 99_998
    assert time.perf_counter() - started < 10


def test_parts_nested_a_thousand_deep() -> None:
    depth = 1000
    inside = lod(polygon())
    for i in range(depth):
        inside = part(inside, f"p{i}")
    parsed = read(city(building(inside)))
    assert parsed.object_names == ("p0",)
    assert parsed.object_parents == ("p1",)


def test_many_empty_members() -> None:
    n = 20_000
    text = f"{HEAD}{'<cityObjectMember><bldg:Building/></cityObjectMember>' * n}"
    text += f"<cityObjectMember>{building(lod(polygon()))}</cityObjectMember></CityModel>"
    tracemalloc.start()
    parsed = read(text)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert parsed.object_names == ("b1",)
    assert peak < 1000 * n


def test_names_and_surfaces_without_end() -> None:
    many = "".join(
        f"<bldg:boundedBy><bldg:X{i}Surface>{lod(polygon())}</bldg:X{i}Surface></bldg:boundedBy>"
        for i in range(300)
    )
    parsed = read(city(building(many)))
    assert len(parsed.surface_names) == 256
    assert parsed.surface_names[-1] == "other"
    assert (parsed.surface_of_polygon == 255).sum() == 46


def test_huge_coordinates_are_no_warning() -> None:
    parsed = read(city(building(lod(polygon("0 0 0 1e300 0 0 1e300 1e300 0 0 0 0")))))
    assert outlines(parsed)[0][1][0] == 1e300
