"""CityGML: coordinate reference systems, axis order and implicit geometries."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from svprep.errors import InputError
from svprep.ingest.citygml_surfaces import _merged
from tests.unit.test_citygml import HEAD, SQUARE, building, city, lod, outlines, polygon, read, wall

RD = "urn:ogc:def:crs:EPSG::28992"


def envelope(name: str, text: str) -> str:
    stated = f'<gml:boundedBy><gml:Envelope srsName="{name}"/></gml:boundedBy>'
    return text.replace(HEAD, HEAD + stated)


def at(x: float, y: float, dx: float = 1.0, dy: float = 1.0) -> str:
    return f"{x} {y} 0 {x + dx} {y} 0 {x + dx} {y + dy} 0 {x} {y} 0"


def placed(content: str, lod_name: str = "lod2ImplicitRepresentation") -> str:
    inside = f"<ImplicitGeometry>{content}</ImplicitGeometry>"
    return f"<bldg:{lod_name}>{inside}</bldg:{lod_name}>"


def template(content: str, matrix: str = "", point: str = "0 0 0") -> str:
    text = f"<transformationMatrix>{matrix}</transformationMatrix>" if matrix else ""
    text += f"<relativeGMLGeometry>{content}</relativeGMLGeometry>"
    return text + (
        f"<referencePoint><gml:Point><gml:pos>{point}</gml:pos></gml:Point></referencePoint>"
    )


def test_eastings_first_stay() -> None:
    parsed = read(envelope(RD, city(building(lod(polygon(at(85_000, 447_000)))))))
    assert parsed.crs == RD
    assert parsed.positions[0].tolist() == [85_000, 447_000, 0]
    assert parsed.notes == ()


def test_latitudes_first_are_swapped() -> None:
    name = "http://www.opengis.net/def/crs/EPSG/0/6697"
    parsed = read(envelope(name, city(building(lod(polygon(at(35.5, 139.7, 0.1, 0.2)))))))
    assert outlines(parsed) == [[[139.7, 35.5, 0], [139.7, 35.6, 0], [139.7 + 0.2, 35.6, 0]]]
    assert parsed.notes == (f"{name} puts north first: (north, east, z) -> (east, north, z)",)


@pytest.mark.parametrize("first", [4_424_648.0, 5_482_614.0])
def test_a_survey_that_puts_either_first_is_told_by_its_positions(first: float) -> None:
    # Gauss-Krueger is northing first by the register; Bavaria writes the easting first.
    second = 9_907_262.0 - first
    parsed = read(
        envelope(
            "urn:adv:crs:DE_DHDN_3GK4*DE_DHN92_NH", city(building(lod(polygon(at(first, second)))))
        )
    )
    assert parsed.positions[0].tolist() == [4_424_648.0, 5_482_614.0, 0.0]


def test_the_nearest_name_counts_and_two_do_not_mix() -> None:
    text = envelope("EPSG:4326", city(building(lod(polygon(at(85_000, 447_000))))))
    own = text.replace("<gml:MultiSurface>", f'<gml:MultiSurface srsName="{RD}">')
    assert read(own).crs == RD
    other = lod(polygon(at(85_000, 447_000))).replace(
        "<gml:Polygon>", '<gml:Polygon srsName="EPSG:25832">'
    )
    one = lod(polygon(at(85_000, 447_000)))
    with pytest.raises(InputError, match=r'two coordinate reference systems, "urn.*"EPSG:25832"'):
        read(envelope(RD, city(building(one), building(other, name="b2"))))
    same = other.replace("EPSG:25832", "http://www.opengis.net/def/crs/EPSG/0/28992")
    assert read(envelope(RD, city(building(one), building(same, name="b2")))).crs == RD


def test_an_envelope_of_a_feature_counts_for_what_is_inside() -> None:
    stated = f'<gml:boundedBy><gml:Envelope srsName="{RD}"/></gml:boundedBy>'
    inside = building(stated, wall(lod(polygon(at(85_000, 447_000)))))
    assert read(city(inside)).crs == RD
    with pytest.raises(InputError, match="two coordinate reference systems"):
        read(envelope("EPSG:25832", city(inside, building(lod(polygon(at(5e5, 5e6))), name="b2"))))


def test_implicit_geometry_is_placed_by_matrix_and_point() -> None:
    turn = "0 -1 0 0  1 0 0 0  0 0 1 5  0 0 0 1"
    first = template(polygon("0 0 0 1 0 0 1 1 0 0 0 0", name="t"), turn, "100 200 300")
    again = template("", point="10 0 0").replace(
        "<relativeGMLGeometry></relativeGMLGeometry>", '<relativeGMLGeometry xlink:href="#t"/>'
    )
    parsed = read(city(building(placed(first)), building(placed(again), name="b2")))
    assert parsed.object_names == ("b1", "b2")
    assert outlines(parsed) == [
        [[100, 200, 305], [100, 201, 305], [99, 201, 305]],
        [[10, 0, 0], [11, 0, 0], [11, 1, 0]],
    ]


def test_a_mirrored_template_keeps_its_outside() -> None:
    mirror = "-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"
    parsed = read(city(building(placed(template(polygon("0 0 0 1 0 0 1 1 0"), mirror)))))
    a, b, c = parsed.positions[parsed.faces[0]]
    assert np.cross(b - a, c - a)[2] == 1.0


def test_a_template_in_metres_around_a_point_in_degrees() -> None:
    size = "0 0 0 1000 0 0 1000 1000 0 0 0 0"
    text = city(building(placed(template(polygon(size), point="35.5 139.5 7"))))
    parsed = read(envelope("http://www.opengis.net/def/crs/EPSG/0/6697", text))
    corners = parsed.positions[parsed.faces[0]]
    assert corners[0].tolist() == [139.5, 35.5, 7]
    from pyproj import Geod

    geod = Geod(ellps="GRS80")
    for (lon0, lat0, _), (lon1, lat1, _) in pairwise(corners):
        assert geod.inv(lon0, lat0, lon1, lat1)[2] == pytest.approx(1000.0, rel=1e-3)


def test_implicit_geometry_in_other_files_is_counted() -> None:
    library = "<mimeType>model/gltf</mimeType><libraryObject>tree.gltf</libraryObject>"
    parsed = read(city(building(placed(library), lod(polygon()))))
    assert parsed.notes == ("1 implicit geometry in a file of its own left out",)


def test_implicit_geometry_without_a_level_of_detail_is_counted() -> None:
    loose = placed(template(polygon())).replace("lod2ImplicitRepresentation", "shape")
    parsed = read(city(building(loose, lod(polygon()))))
    assert parsed.notes == ("1 implicit geometry without a level of detail left out",)


@pytest.mark.parametrize(
    ("matrix", "point", "message"),
    [
        ("1 2 3", "0 0 0", "transformationMatrix .* 16 finite numbers"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 1 0 0 1", "0 0 0", "last row"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 nan", "0 0 0", "16 finite numbers"),
        ("", "0 0", "referencePoint .* 3 finite numbers"),
        ("", "1 inf 2", "referencePoint .* 3 finite numbers"),
        ("1e300 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1e-300", "0 0 0", "not a finite position"),
    ],
)
def test_places_that_cannot_be_read(matrix: str, point: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(city(building(placed(template(polygon(SQUARE), matrix, point)))))


def test_corners_at_one_position_are_one_vertex() -> None:
    points = np.array([[0.0, 0, 0], [1, 2, 3], [-0.0, 0, 0], [3, 2, 1], [1, 2, 3]])
    positions, corners = _merged(points)
    assert positions.tolist() == [[0, 0, 0], [1, 2, 3], [3, 2, 1]]
    assert corners.tolist() == [0, 1, 0, 2, 1]
    some = np.random.default_rng(1).integers(0, 20, (5000, 3)).astype(np.float64)
    positions, corners = _merged(some)
    assert np.array_equal(positions[corners], some)
    assert len(positions) == len(np.unique(some, axis=0))
    assert np.array_equal(
        np.unique(corners, return_index=True)[1],
        np.sort(np.unique(some, axis=0, return_index=True)[1]),
    )
