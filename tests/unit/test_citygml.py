"""The CityGML reader: what each element of a file becomes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svprep.defects import Code
from svprep.errors import InputError
from svprep.ingest.citygml import read_citygml
from svprep.ingest.citygml_names import Role, role_of
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile

HEAD = (
    '<CityModel xmlns="http://www.opengis.net/citygml/2.0" '
    'xmlns:bldg="http://www.opengis.net/citygml/building/2.0" '
    'xmlns:gen="http://www.opengis.net/citygml/generics/2.0" '
    'xmlns:dem="http://www.opengis.net/citygml/relief/2.0" '
    'xmlns:gml="http://www.opengis.net/gml" xmlns:xlink="http://www.w3.org/1999/xlink">'
)
SQUARE = "0 0 0 1 0 0 1 1 0 0 1 0 0 0 0"
SHIFTED = "5 0 0 6 0 0 6 1 0 5 1 0 5 0 0"


def city(*members: str) -> str:
    inside = "".join(f"<cityObjectMember>{m}</cityObjectMember>" for m in members)
    return f"{HEAD}{inside}</CityModel>"


def ring(numbers: str) -> str:
    return f"<gml:LinearRing><gml:posList>{numbers}</gml:posList></gml:LinearRing>"


def polygon(numbers: str = SQUARE, name: str = "", holes: tuple[str, ...] = ()) -> str:
    inner = "".join(f"<gml:interior>{ring(hole)}</gml:interior>" for hole in holes)
    named = f' gml:id="{name}"' if name else ""
    return f"<gml:Polygon{named}><gml:exterior>{ring(numbers)}</gml:exterior>{inner}</gml:Polygon>"


def surfaces(*members: str, kind: str = "MultiSurface") -> str:
    inside = "".join(
        f'<gml:surfaceMember xlink:href="{m}"/>'
        if m.startswith("#")
        else f"<gml:surfaceMember>{m}</gml:surfaceMember>"
        for m in members
    )
    return f"<gml:{kind}>{inside}</gml:{kind}>"


def lod(*members: str, name: str = "lod2MultiSurface") -> str:
    return f"<bldg:{name}>{surfaces(*members)}</bldg:{name}>"


def building(*content: str, name: str = "b1", kind: str = "Building") -> str:
    named = f' gml:id="{name}"' if name else ""
    return f"<bldg:{kind}{named}>{''.join(content)}</bldg:{kind}>"


def wall(content: str, kind: str = "WallSurface") -> str:
    return f"<bldg:boundedBy><bldg:{kind}>{content}</bldg:{kind}></bldg:boundedBy>"


def part(content: str, name: str = "p1") -> str:
    inside = building(content, name=name, kind="BuildingPart")
    return f"<bldg:consistsOfBuildingPart>{inside}</bldg:consistsOfBuildingPart>"


def read(text: str | bytes, level: str = "highest") -> ParsedFile:
    content = (text.encode() if isinstance(text, str) else text) + b"\n"
    data = np.frombuffer(content, np.uint8)
    options = ReadOptions(lod=level)
    return read_citygml(data, Path("city.gml"), "city", lambda fraction: None, options)


def named_surfaces(parsed: ParsedFile) -> list[str]:
    return [parsed.surface_names[i] for i in parsed.surface_of_polygon]


def outlines(parsed: ParsedFile) -> list[list[list[float]]]:
    """Return the corners of each triangle."""
    return parsed.positions[parsed.faces].tolist()


def test_a_building_with_its_parts_and_surfaces() -> None:
    parsed = read(
        city(
            building(
                wall(lod(polygon())),
                wall(lod(polygon(SHIFTED)), "RoofSurface"),
                part(lod(polygon("0 0 5 1 0 5 1 1 5 0 0 5"))),
            ),
            building(lod(polygon()), name="b2"),
        )
    )
    assert parsed.object_names == ("b1", "p1", "b2")
    assert parsed.object_types == ("Building", "BuildingPart", "Building")
    assert parsed.object_parents == ("", "b1", "")
    assert parsed.object_face_start.tolist() == [0, 4, 5, 7]
    assert named_surfaces(parsed) == ["WallSurface", "RoofSurface", "", ""]
    assert parsed.source_face.tolist() == [0, 0, 1, 1, 2, 3, 3]
    assert parsed.crs == ""
    assert parsed.notes == ()


def test_faces_of_a_parent_behind_its_part_count_in_file_order() -> None:
    parsed = read(city(building(part(lod(polygon(SHIFTED))), lod(polygon()))))
    assert parsed.object_names == ("b1", "p1")
    assert parsed.source_face.tolist() == [1, 1, 0, 0]


@pytest.mark.parametrize(
    ("written", "role"),
    [
        ("http://www.opengis.net/citygml/building/1.0 Building", Role.OBJECT),
        ("http://www.opengis.net/citygml/relief/2.0 TINRelief", Role.OBJECT),
        ("http://www.opengis.net/citygml/building/2.0 RoofSurface", Role.SURFACE),
        ("http://www.opengis.net/citygml/building/2.0 Window", Role.SURFACE),
        ("http://www.opengis.net/gml MultiSurface", Role.AGGREGATE),
        ("http://www.opengis.net/gml/3.2 Shell", Role.AGGREGATE),
        ("http://www.opengis.net/gml MultiCurve", Role.NONE),
        ("x lod2Solid", Role.LOD_PROPERTY),
        ("x lod0FootPrint", Role.LOD_PROPERTY),
        ("x lod3ImplicitRepresentation", Role.LOD_PROPERTY),
        ("x lod2TerrainIntersection", Role.NO_SURFACE),
        ("x lod0MultiCurve", Role.NO_SURFACE),
        ("x boundedBy", Role.NONE),
        ("CityModel", Role.NONE),
    ],
)
def test_roles(written: str, role: Role) -> None:
    assert role_of(written) is role


def test_a_solid_that_refers_to_its_walls_is_counted_once() -> None:
    solid = "<bldg:lod2Solid><gml:Solid><gml:exterior>"
    solid += surfaces("#w", "#r", kind="CompositeSurface")
    solid += "</gml:exterior></gml:Solid></bldg:lod2Solid>"
    walls = wall(lod(polygon(name="w"))) + wall(lod(polygon(SHIFTED, "r")), "RoofSurface")
    for content in (solid + walls, walls + solid):  # forward and backward
        parsed = read(city(building(content)))
        assert named_surfaces(parsed) == ["WallSurface", "RoofSurface"]
        assert parsed.notes == ()


def test_a_wall_that_refers_to_its_solid_names_the_surface() -> None:
    solid = "<bldg:lod2Solid><gml:Solid><gml:exterior>"
    solid += surfaces(polygon(name="w"), polygon(SHIFTED), kind="CompositeSurface")
    solid += "</gml:exterior></gml:Solid></bldg:lod2Solid>"
    parsed = read(city(building(solid, wall(lod("#w")))))
    assert named_surfaces(parsed) == ["WallSurface", ""]


def test_a_shared_wall_stands_in_both_buildings() -> None:
    parsed = read(
        city(
            building(wall(lod(polygon(name="w")))),
            building(wall(lod("#w"), "ClosureSurface"), lod("#w"), name="b2"),
        )
    )
    assert parsed.object_names == ("b1", "b2")
    assert named_surfaces(parsed) == ["WallSurface", "ClosureSurface"]
    assert parsed.object_face_start.tolist() == [0, 2, 4]


def test_a_surface_of_an_installation_is_not_repeated_by_its_building() -> None:
    inside = building(lod(polygon(name="w")), name="i1", kind="BuildingInstallation")
    parsed = read(
        city(
            building(
                f"<bldg:outerBuildingInstallation>{inside}</bldg:outerBuildingInstallation>",
                lod("#w", polygon(SHIFTED)),
            )
        )
    )
    assert parsed.object_names == ("b1", "i1")
    assert np.diff(parsed.object_face_start).tolist() == [2, 2]


def test_whole_geometries_are_referred_to_and_cycles_end() -> None:
    cycle = (
        '<gml:MultiSurface gml:id="m"><gml:surfaceMember xlink:href="#n"/>'
        f"<gml:surfaceMember>{polygon()}</gml:surfaceMember></gml:MultiSurface>"
    )
    other = '<gml:MultiSurface gml:id="n"><gml:surfaceMember xlink:href="#m"/></gml:MultiSurface>'
    parsed = read(
        city(
            building(f"<bldg:lod2MultiSurface>{cycle}</bldg:lod2MultiSurface>"),
            building(f"<bldg:lod2MultiSurface>{other}</bldg:lod2MultiSurface>", name="b2"),
            building('<bldg:lod2MultiSurface xlink:href="#m"/>', name="b3"),
        )
    )
    assert parsed.object_names == ("b1", "b2", "b3")
    assert len(parsed.faces) == 6


def test_references_that_lead_nowhere_are_counted() -> None:
    parsed = read(city(building(lod(polygon(), "#gone", "#lost"))))
    assert parsed.notes == (
        '2 references to geometry that is not in the file left out (first "gone")',
    )


def test_of_repeated_ids_the_first_counts() -> None:
    walls = wall(lod(polygon(name="w"))) + wall(lod(polygon(SHIFTED, "w")))
    parsed = read(city(building(walls), building(lod("#w"), name="b2")))
    assert np.diff(parsed.object_face_start).tolist() == [4, 2]
    assert parsed.positions[parsed.faces[4:]].max() == 1.0
    assert parsed.notes == ("1 repeated id of geometry: references lead to the first",)


def test_a_reference_bomb_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("svprep.ingest.citygml_links._MOST_FOLLOWED", 5_000)
    many = f"<bldg:lod2MultiSurface>{surfaces(*[polygon(SQUARE)] * 500)}</bldg:lod2MultiSurface>"
    many = many.replace("<gml:MultiSurface>", '<gml:MultiSurface gml:id="m">', 1)
    users = [building('<bldg:lod2MultiSurface xlink:href="#m"/>', name=f"u{i}") for i in range(30)]
    with pytest.raises(InputError, match="repeat more than 10000 surfaces"):
        read(city(building(many), *users))


def test_orientable_surfaces_turn() -> None:
    turned = (
        '<gml:OrientableSurface orientation="-"><gml:baseSurface>'
        f"{polygon('0 0 0 1 0 0 1 1 0 0 0 0')}</gml:baseSurface></gml:OrientableSurface>"
    )
    plain = read(city(building(lod(polygon("0 0 0 1 0 0 1 1 0 0 0 0")))))
    parsed = read(city(building(lod(turned))))
    corners = plain.positions[plain.faces], parsed.positions[parsed.faces]
    normals = [np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])[0, 2] for c in corners]
    assert normals == [1.0, -1.0]
    # Elsewhere the same polygon runs as it is written, or as that place turns it.
    turned = turned.replace("<gml:Polygon>", '<gml:Polygon gml:id="p">')
    again = '<gml:OrientableSurface orientation="-"><gml:baseSurface xlink:href="#p"/>'
    again += "</gml:OrientableSurface>"
    for member, sign in (("#p", 1.0), (again, -1.0)):
        parsed = read(city(building(lod(turned)), building(lod(member), name="b2")))
        a, b, c = parsed.positions[parsed.faces[1]]
        assert np.cross(b - a, c - a)[2] == sign


def test_holes() -> None:
    outline = "0 0 0 4 0 0 4 4 0 0 4 0 0 0 0"
    parsed = read(city(building(lod(polygon(outline, holes=("1 1 0 2 1 0 2 2 0 1 2 0 1 1 0",))))))
    a, b, c = np.moveaxis(parsed.positions[parsed.faces], 1, 0)
    assert len(parsed.faces) == 8
    assert np.cross(b - a, c - a)[:, 2].sum() / 2 == 15.0


@pytest.mark.parametrize(
    "inside",
    [
        "<gml:pos>0 0 0</gml:pos><gml:pos>1 0 0</gml:pos><gml:pos>1 1 0</gml:pos>"
        "<gml:pos>0 0 0</gml:pos>",
        '<gml:posList srsDimension="3">\n0 0 0\t1 0 0\r\n1 1 0 <!-- ? -->0e0 -0.0 +0</gml:posList>',
        "<gml:coordinates>0,0,0 1,0,0 1,1,0 0,0,0</gml:coordinates>",
        '<gml:coordinates decimal="," cs=";" ts="|">0,0;0;0|1,0;0;0|1;1;0|0;0;0</gml:coordinates>',
        '<gml:posList srsDimension="2">0 0 1 0 1 1 0 0</gml:posList>',
        "<gml:pos>0 0</gml:pos><gml:pos>1 0</gml:pos><gml:pos>1 1</gml:pos>",
        "<gml:posList>0 0 0 1 0 0 1 1 0</gml:posList>",  # not closed
    ],
)
def test_ways_to_write_a_ring(inside: str) -> None:
    whole = polygon().replace(f"<gml:posList>{SQUARE}</gml:posList>", inside)
    parsed = read(city(building(lod(whole))))
    assert outlines(parsed) == [[[0, 0, 0], [1, 0, 0], [1, 1, 0]]]


def test_dimensions_are_inherited_and_may_be_mixed() -> None:
    flat = surfaces(polygon("0 0 1 0 1 1 0 0"), polygon("0 0 1 0 1 1 0 0"))
    flat = flat.replace("<gml:MultiSurface>", '<gml:MultiSurface srsDimension="2">')
    own = f"<bldg:lod2MultiSurface>{flat}</bldg:lod2MultiSurface>"
    parsed = read(city(building(own, lod(polygon(), name="lod2Geometry"))))
    assert len(parsed.faces) == 4
    assert parsed.positions.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


def test_curved_rings_are_joined_of_their_lines() -> None:
    lines = "".join(
        f"<gml:curveMember><gml:LineString><gml:posList>{p}</gml:posList></gml:LineString>"
        "</gml:curveMember>"
        for p in ("0 0 0 1 0 0", "1 0 0 1 1 0 0 1 0", "0 1 0 0 0 0")
    )
    whole = polygon().replace(ring(SQUARE), f"<gml:Ring>{lines}</gml:Ring>")
    parsed = read(city(building(lod(whole))))
    assert len(parsed.faces) == 2
    assert parsed.notes == ()


def test_every_kind_of_surface_is_read() -> None:
    triangle = ring("0 0 0 1 0 0 1 1 0 0 0 0")
    patch = f"<gml:Triangle><gml:exterior>{triangle}</gml:exterior></gml:Triangle>"
    tin = f"<gml:TriangulatedSurface><gml:trianglePatches>{patch * 2}</gml:trianglePatches>"
    tin += "</gml:TriangulatedSurface>"
    relief = (
        '<dem:ReliefFeature gml:id="r"><dem:lod>2</dem:lod><dem:reliefComponent>'
        '<dem:TINRelief gml:id="t"><dem:lod>2</dem:lod>'
        f"<dem:extent>{polygon(SHIFTED)}</dem:extent>"
        f"<dem:tin>{tin}</dem:tin></dem:TINRelief></dem:reliefComponent></dem:ReliefFeature>"
    )
    solid = f"<gml:exterior>{surfaces(polygon(), kind='CompositeSurface')}</gml:exterior>"
    hollow = solid.replace("<gml:exterior><gml:Comp", "<gml:interior><gml:Comp")
    hollow = hollow.removesuffix("</gml:exterior>") + "</gml:interior>"
    multi = (
        "<gml:MultiSolid><gml:solidMember><gml:Solid>"
        f"{solid}{hollow}</gml:Solid></gml:solidMember></gml:MultiSolid>"
    )
    generic = f'<gen:GenericCityObject gml:id="g"><gen:lod1Geometry>{multi}</gen:lod1Geometry>'
    generic += "</gen:GenericCityObject>"
    for kind in ("PolygonPatch", "Rectangle"):
        inside = f"<gml:exterior>{ring(SQUARE)}</gml:exterior>"
        inside = f"<gml:Surface><gml:patches><gml:{kind}>{inside}</gml:{kind}></gml:patches>"
        relief += f"<bldg:Building>{lod(inside + '</gml:Surface>')}</bldg:Building>"
    parsed = read(city(relief, generic))
    assert parsed.object_types == ("TINRelief", "Building", "Building", "GenericCityObject")
    assert parsed.object_names == ("t", "Building_1", "Building_2", "g")
    assert parsed.object_parents == ("r", "", "", "")
    assert np.diff(parsed.object_face_start).tolist() == [2, 2, 2, 4]
    assert parsed.notes == ()


def test_openings_belong_to_their_building() -> None:
    inside = f"<bldg:opening><bldg:Window>{lod(polygon(SHIFTED))}</bldg:Window></bldg:opening>"
    parsed = read(city(building(wall(lod(polygon()) + inside + lod(polygon("0 0 9 1 0 9 1 1 9"))))))
    assert parsed.object_names == ("b1",)
    assert named_surfaces(parsed) == ["WallSurface", "Window", "WallSurface"]


def test_levels_of_detail() -> None:
    one = lod(polygon(), name="lod1Solid")
    foot = lod(polygon(), name="lod0FootPrint")
    text = city(
        building(foot, one, part(lod(polygon(SHIFTED)))),
        building(foot, name="b2"),
        building(one, name="b3"),
    )
    assert read(text).object_names == ("p1", "b3")
    assert read(text, "1").object_names == ("b1", "b3")
    assert read(text, "0").object_names == ("b1", "b2")
    assert any("b2" in note and "LoD 0" in note for note in read(text).notes)
    with pytest.raises(InputError, match="no object has LoD 3"):
        read(text, "3")


def test_kinds_that_the_highest_level_lacks_are_taken_from_a_lower_one() -> None:
    at_3 = "lod3MultiSurface"
    pane = lod(polygon(SHIFTED), name=at_3)
    window = f"<bldg:opening><bldg:Window>{pane}</bldg:Window></bldg:opening>"
    walls = wall(lod(polygon(), polygon(SHIFTED)) + window)
    parsed = read(city(building(walls)))
    assert sorted(named_surfaces(parsed)) == ["WallSurface", "WallSurface", "Window"]
    (note,) = [note for note in parsed.notes if "lower LoD" in note]
    assert note.startswith("2 polygons of a lower LoD taken for 1 object without surfaces")
    assert note.endswith(": b1")

    roof = wall(lod(polygon(SHIFTED)), "RoofSurface")
    mixed = city(building(wall(lod(polygon(), name=at_3) + lod(polygon())) + roof))
    assert sorted(named_surfaces(read(mixed))) == ["RoofSurface", "WallSurface"]
    # What names no kinds is all of its object.
    solid = lod(polygon(), name=at_3)
    assert named_surfaces(read(city(building(solid + roof)))) == [""]
    assert named_surfaces(read(mixed, "3")) == ["WallSurface"]


def test_an_object_without_an_id_is_named_by_type_and_number() -> None:
    parsed = read(city(building(name=""), building(lod(polygon()), name="")))
    assert parsed.object_names == ("Building_2",)


def test_what_is_no_surface_is_counted() -> None:
    line = "<gml:LineString><gml:posList>0 0 0 1 0 0</gml:posList></gml:LineString>"
    curve = f"<bldg:lod2TerrainIntersection><gml:MultiCurve><gml:curveMember>{line}"
    curve += "</gml:curveMember></gml:MultiCurve></bldg:lod2TerrainIntersection>"
    mixed = f"<gml:MultiGeometry><gml:geometryMember>{line}</gml:geometryMember>"
    mixed += "</gml:MultiGeometry>"
    group = f'<grp:CityObjectGroup xmlns:grp="x"><grp:geometry>{surfaces(polygon())}</grp:geometry>'
    group += "</grp:CityObjectGroup>"
    points = "<dem:MassPointRelief><dem:lod>1</dem:lod></dem:MassPointRelief>"
    parsed = read(city(building(curve, lod(polygon(), mixed)), group, points))
    assert parsed.notes == (
        "1 MassPointRelief left out: points, lines or rasters",
        "1 line left out",
        "1 lod2TerrainIntersection left out: curves or points",
        "1 polygon left out that no property with a level of detail (lod2...) of a city object "
        "holds",
    )


def test_a_group_is_no_parent() -> None:
    member = building(lod(polygon()))
    group = '<grp:CityObjectGroup xmlns:grp="x" gml:id="g"><grp:groupMember>'
    parsed = read(city(f"{group}{member}</grp:groupMember></grp:CityObjectGroup>"))
    assert parsed.object_parents == ("",)


def test_appearances_are_not_looked_into() -> None:
    odd = "<appearance><Polygon><LinearRing><pos>x</pos></LinearRing></Polygon></appearance>"
    assert len(read(city(building(odd, lod(polygon())))).faces) == 2


def test_city_gml_3_and_indoor_gml() -> None:
    text = city(building(f"<boundary>{wall(lod(polygon()))}</boundary>"))
    for old, new in (("/2.0", "/3.0"), ("opengis.net/gml", "opengis.net/gml/3.2")):
        text = text.replace(old, new)
    assert named_surfaces(read(text)) == ["WallSurface"]
    shell = f"<gml:Shell><gml:surfaceMember>{polygon()}</gml:surfaceMember></gml:Shell>"
    cell = (
        '<IndoorFeatures xmlns="http://www.opengis.net/indoorgml/1.0/core" '
        'xmlns:gml="http://www.opengis.net/gml/3.2"><primalSpaceFeatures><PrimalSpaceFeatures>'
        '<cellSpaceMember><CellSpace gml:id="c"><cellSpaceGeometry><Geometry3D gml:id="g">'
        f"<gml:Solid><gml:exterior>{shell}</gml:exterior></gml:Solid></Geometry3D>"
        "</cellSpaceGeometry></CellSpace></cellSpaceMember></PrimalSpaceFeatures>"
        "</primalSpaceFeatures></IndoorFeatures>"
    )
    parsed = read(cell)
    assert (parsed.object_names, parsed.object_types) == (("c",), ("CellSpace",))
    assert parsed.object_parents == ("",)


def test_short_rings_are_listed() -> None:
    parsed = read(city(building(lod(polygon("0 0 0 1 0 0"), polygon(""), polygon()))))
    assert parsed.face_findings.code.tolist() == [Code.SHORT_POLYGON] * 2
    assert parsed.face_findings.source_face.tolist() == [0, 1]
    assert parsed.source_face.tolist() == [2, 2]


def test_self_touching_rings_are_kept() -> None:
    bow = "0 0 0 2 2 0 2 0 0 0 2 0 0 0 0"
    parsed = read(city(building(lod(polygon(bow)))))
    assert parsed.face_findings.code.tolist() == [Code.SELF_CROSSING_POLYGON]
    assert len(parsed.faces) == 2


def test_unclosed_rings_are_counted() -> None:
    whole = polygon("0 0 0 1 0 0 1 1 0")
    assert read(city(building(lod(whole)))).notes == (
        "1 ring without its first corner at the end: closed",
    )
