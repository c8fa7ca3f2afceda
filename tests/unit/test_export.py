"""Export: what each format says, what it cannot say, and what is refused."""

from __future__ import annotations

import gzip
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svprep import cli_export
from svprep.cache.reader import open_cache
from svprep.cache.writer import write_cache
from svprep.errors import CacheError, InputError
from svprep.export.city import city_of, distinct
from svprep.export.obj import written_names
from svprep.export.output import write_export
from svprep.ingest import read
from svprep.ingest.crs_names import normalised_crs
from svprep.model import Prepared
from svprep.pipeline import BuildConfig, prepare
from tests.property.meshes import source_mesh
from tests.unit.cache_samples import strip_and_tetrahedron
from tests.unit.export_checks import FORMS, assert_round_trip, built, exported

ROOT = Path(__file__).resolve().parents[2]
CITY = ROOT / "data" / "small_city.obj.gz"

ODD_NAMES = (
    "plain",
    "two  blanks",
    " leading",
    "a\nbreak\r\nand\ttab",
    "ends in \\",
    "default",
    "",
    "# no comment",
    "Türmchen \N{CASTLE} 塔",
    'quoted "name"',
    "plain",
    "plain~2",
    "object_6",
    "a/b",
)


def two_triangles_each(names: tuple[str, ...], source_of: list[int] | None = None) -> Prepared:
    """Return a city of strips side by side, one per name, each winged and open."""
    positions, faces = [], []
    for i in range(len(names)):
        x = 10.0 * i
        positions += [(x, 0.0, 0.25), (x + 1, 0.0, 0.1), (x + 1, 2.0, 0.0), (x, 1.0, 1 / 3)]
        faces += [(4 * i, 4 * i + 1, 4 * i + 2), (4 * i, 4 * i + 2, 4 * i + 3)]
    n = len(names)
    shift = np.array([85_000.0, 446_000.0, -3.0])
    source = source_mesh(np.array(positions) + shift, np.array(faces), list(range(0, 2 * n + 1, 2)))
    owner = np.array(source_of or [0] * n, np.uint32)
    sources = strip_and_tetrahedron().sources
    named = replace(source, object_names=names, object_source=owner, sources=sources)
    return prepare(named, BuildConfig())


def labelled(prepared: Prepared, **labels: object) -> Prepared:
    return replace(prepared, labels=replace(prepared.labels, **labels))


@pytest.fixture(scope="module")
def sample_city() -> Prepared:
    return built(CITY)


@pytest.mark.parametrize("form", FORMS)
def test_the_sample_city_comes_back(form: str, sample_city: Prepared, tmp_path: Path) -> None:
    assert_round_trip(sample_city, tmp_path, form)


@pytest.mark.parametrize("form", FORMS)
def test_packed_files_hold_the_same(form: str, sample_city: Prepared, tmp_path: Path) -> None:
    plain = write_export(city_of(sample_city), tmp_path / f"plain.{form}")
    packed = write_export(city_of(sample_city), tmp_path / f"packed.{form}.gz")
    assert gzip.decompress(packed.read_bytes()) == plain.read_bytes()
    assert np.array_equal(read([packed]).positions, read([plain]).positions)


@pytest.mark.parametrize("form", FORMS)
def test_the_same_cache_the_same_bytes(form: str, tmp_path: Path) -> None:
    city = two_triangles_each(("a", "b"))
    assert (
        exported(city, tmp_path, form)[0].read_bytes()
        == exported(city, tmp_path, form)[0].read_bytes()
    )


@pytest.mark.parametrize("form", FORMS)
def test_odd_names(form: str, tmp_path: Path) -> None:
    city = two_triangles_each(ODD_NAMES)
    output, summary = exported(city, tmp_path, form)
    again = built(output)
    if form in ("obj", "ply"):
        assert again.object_names == ODD_NAMES
    elif form == "city.json":  # ids are unique
        expected = list(ODD_NAMES)
        expected[10] = "plain~3"
        assert again.object_names == tuple(expected)
        assert summary["renamed"] == 1
    else:
        assert [new for new, old in zip(again.object_names, ODD_NAMES, strict=True) if old] == [
            old for old in ODD_NAMES if old
        ]
    assert np.array_equal(again.mesh.faces, city.mesh.faces)


def test_what_obj_calls_objects() -> None:
    names = written_names(ODD_NAMES)
    assert len(set(names)) == len(names)
    kept = {"plain", "# no comment", "Türmchen \N{CASTLE} 塔", 'quoted "name"', "a/b", "plain~2"}
    assert kept <= set(names)
    assert names[3:7] == ["object_3", "object_4", "object_5", "object_6~"]
    assert distinct(["a", "a", "a~2", "a"]) == ["a", "a~3", "a~2", "a~4"]


def test_one_object_named_default(tmp_path: Path) -> None:
    for form in FORMS:
        output, _ = exported(two_triangles_each(("default",)), tmp_path, form)
        assert built(output).object_names == ("default",)


def test_what_is_stated_of_objects_and_faces(tmp_path: Path) -> None:
    city = two_triangles_each(("house", "part", "tree", "hill"))
    city = labelled(
        city,
        object_types=("Building", "BuildingPart", "SolitaryVegetationObject", "TINRelief"),
        object_parents=("", "house", "", ""),
        surface_names=("", "RoofSurface", "WallSurface"),
        surface_of_face=np.array([1, 2, 1, 0, 0, 0, 0, 0], np.uint8),
    )
    for form in FORMS:
        assert_round_trip(city, tmp_path, form)


def test_a_parent_without_faces(tmp_path: Path) -> None:
    city = labelled(
        two_triangles_each(("part 1", "part 2", "loose", "room")),
        object_types=("BuildingPart", "BuildingPart", "+Kiosk", "BridgeRoom"),
        object_parents=("house", "house", "", "bridge"),
    )
    for form in FORMS:
        assert_round_trip(city, tmp_path, form)
    output, summary = exported(city, tmp_path, "city.json")
    objects = json.loads(output.read_text())["CityObjects"]
    assert objects["house"] == {
        "type": "Building",
        "children": ["part 1", "part 2"],
    }
    assert objects["part 2"]["parents"] == ["house"]
    assert objects["bridge"]["type"] == "Bridge"
    assert summary["objects"] == 4


def test_equal_names_in_two_sources(tmp_path: Path) -> None:
    city = labelled(
        two_triangles_each(("B1", "P", "B1", "P"), [0, 0, 1, 1]),
        object_types=("Building", "BuildingPart") * 2,
        object_parents=("", "B1") * 2,
    )
    for form in ("obj", "ply", "glb"):
        assert_round_trip(city, tmp_path, form)
    output, summary = exported(city, tmp_path, "city.json")
    objects = json.loads(output.read_text())["CityObjects"]
    assert list(objects) == ["B1", "P", "B1~2", "P~2"]
    assert objects["P~2"]["parents"] == ["B1~2"]
    assert objects["B1"]["children"] == ["P"]
    assert summary["renamed"] == 2


def test_types_that_cityjson_does_not_have(tmp_path: Path) -> None:
    city = labelled(two_triangles_each(("a", "b")), object_types=("Kiosk", ""))
    output, summary = exported(city, tmp_path, "city.json")
    objects = json.loads(output.read_text())["CityObjects"]
    assert [o["type"] for o in objects.values()] == ["GenericCityObject"] * 2
    assert objects["a"]["attributes"] == {"type": "Kiosk"}
    assert summary["retyped"] == 1
    assert summary["untyped"] == 1
    assert "1 objects without a type written as Generic" in cli_export.summary_lines(summary)[-1]
    assert exported(city, tmp_path, "ply")[1]["untyped"] == 0


@pytest.mark.parametrize(
    ("crs", "code", "not_kept"),
    [
        ("EPSG:7415", "/EPSG/0/7415", []),
        (
            "EPSG:28992+5709",
            "-compound?1=https://www.opengis.net/def/crs/EPSG/0/28992"
            "&2=https://www.opengis.net/def/crs/EPSG/0/5709",
            [],
        ),
        ('PROJCRS["local frame at 48.137, 11.575"]', None, ["crs"]),
        ("EPSG:28992 or so", None, ["crs"]),
        ("", None, []),
    ],
)
def test_what_cityjson_calls_a_crs(
    crs: str, code: str | None, not_kept: list[str], tmp_path: Path
) -> None:
    sample = strip_and_tetrahedron()
    sample = replace(sample, place=replace(sample.place, crs=crs))
    output, summary = exported(sample, tmp_path, "city.json")
    stated = json.loads(output.read_text())["metadata"].get("referenceSystem")
    assert stated == (code and f"https://www.opengis.net/def/crs{code}")
    assert summary["not_kept"] == not_kept
    if stated:
        assert normalised_crs(read([output]).sources[0].crs) == crs


def test_cityjson_is_what_it_should_be(tmp_path: Path) -> None:
    sample = strip_and_tetrahedron()
    sample = replace(sample, place=replace(sample.place, crs="EPSG:28992"))
    output, summary = exported(sample, tmp_path, "city.json")
    tree = json.loads(output.read_text())
    assert (tree["type"], tree["version"]) == ("CityJSON", "2.0")
    assert tree["metadata"]["referenceSystem"] == "https://www.opengis.net/def/crs/EPSG/0/28992"
    assert tree["metadata"]["geographicalExtent"] == [
        85_000.0, 446_000.0, -2.0, 85_006.0, 446_001.0, 2.0
    ]  # fmt: skip
    grid = sample.mesh.grid
    assert tree["transform"] == {
        "scale": [grid.step_m] * 3, "translate": grid.origin_m.tolist()
    }  # fmt: skip
    roof, tower = tree["CityObjects"]["roof"], tree["CityObjects"]["Türmchen \N{CASTLE}"]
    assert roof["geometry"][0]["type"] == "MultiSurface"
    assert roof["geometry"][0]["semantics"] == {
        "surfaces": [{"type": "RoofSurface"}], "values": [0, 0]
    }  # fmt: skip
    assert tower["geometry"][0]["type"] == "Solid"
    assert len(tower["geometry"][0]["boundaries"][0]) == 4
    assert len({tuple(v) for v in tree["vertices"]}) == len(tree["vertices"]) == 8
    assert tree["CityObjects"]["Haus 7"]["children"] == ["roof"]
    assert summary["crs"] == "EPSG:28992"
    assert summary["not_kept"] == []


def test_glb_is_what_it_should_be(tmp_path: Path) -> None:
    sample = strip_and_tetrahedron()
    output, summary = exported(sample, tmp_path, "glb")
    data = output.read_bytes()
    magic, version, total, n_json, _ = struct.unpack_from("<4sIIII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    tree = json.loads(data[20 : 20 + n_json])
    assert tree["nodes"][0]["translation"] == [85_000.0, -2.0, -446_000.0]
    assert tree["nodes"][1]["extras"] == {"type": "BuildingPart", "parent": "Haus 7"}
    assert tree["asset"]["extras"]["crs"] == "EPSG:7415"
    assert all(view["byteLength"] > 0 for view in tree["bufferViews"])
    assert tree["accessors"][0]["max"] == [2.0, 4.0, 0.0]
    roof = tree["meshes"][0]["primitives"]
    assert [p.get("extras") for p in roof] == [{"surface": "RoofSurface"}]
    assert summary["not_kept"] == []
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.load(output, process=False)
    assert len(scene.geometry) == 2


def test_large_objects_take_wide_indices(tmp_path: Path) -> None:
    n = 300  # a sheet of 90,000 vertices
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    at = np.arange(n * n).reshape(n, n)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    small = [[n * n, n * n + 1, n * n + 2]]
    points = np.stack([x, y, np.sin(x) + np.cos(y)], -1).reshape(-1, 3)
    points = np.concatenate([points, [[0.0, 0, 9], [1, 0, 9], [0, 1, 9]]])
    source = source_mesh(points, np.concatenate([small, faces]), [0, 1, 1 + len(faces)])
    city = prepare(source, BuildConfig())
    again = assert_round_trip(city, tmp_path, "glb")
    assert len(again.mesh.faces) == 1 + 2 * (n - 1) ** 2


@pytest.mark.parametrize("form", FORMS)
def test_empty_objects_are_named_and_counted(form: str, tmp_path: Path) -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, 0, 0]])
    flat = source_mesh(points, np.array([[0, 1, 3], [0, 1, 2]]), [0, 1, 2])
    flat = replace(flat, object_names=("flat", "full"))
    city = prepare(flat, BuildConfig())
    output, summary = exported(city, tmp_path, form)
    assert summary["empty_objects"] == 1
    assert b"flat" in output.read_bytes()
    again = built(output)
    names = ("flat", "full") if form == "ply" else ("full",)
    assert again.object_names == names
    assert np.array_equal(again.mesh.positions, city.mesh.positions)


def test_a_grid_that_reached_farther_is_told(tmp_path: Path) -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [100.3, 0, 0]])
    far = source_mesh(points, np.array([[0, 1, 3], [0, 1, 2]]))
    city = prepare(far, BuildConfig())
    for form in FORMS:
        output, summary = exported(city, tmp_path, form)
        assert not summary["is_grid_kept"]
        assert "another grid" in cli_export.summary_lines(summary)[-1]
        again, first = built(output).mesh, city.mesh
        assert np.array_equal(
            again.grid.origin_m + again.positions, first.grid.origin_m + first.positions
        )


@pytest.mark.parametrize("form", ["obj", "ply"])
def test_the_crs_is_read_back(form: str, tmp_path: Path) -> None:
    output, _ = exported(strip_and_tetrahedron(), tmp_path, form)
    assert read([output]).sources[0].crs == "EPSG:7415"


@pytest.mark.parametrize("form", FORMS)
def test_only_exports_are_overwritten(form: str, tmp_path: Path) -> None:
    cache, target = tmp_path / "a.svp.h5", tmp_path / f"out.{form}"
    write_cache(strip_and_tetrahedron(), cache)
    target.write_bytes(b"o mine\nv 0 0 0\n")
    with pytest.raises(InputError, match="is not an export of svprep"):
        cli_export.run(cache, str(target))
    assert target.read_bytes() == b"o mine\nv 0 0 0\n"
    target.unlink()
    for _ in range(2):
        cli_export.run(cache, str(target))
    packed = tmp_path / f"out.{form}.gz"
    for _ in range(2):
        cli_export.run(cache, str(packed))
    packed.write_bytes(gzip.compress(b"something else entirely"))
    with pytest.raises(InputError, match="is not an export of svprep"):
        cli_export.run(cache, str(packed))
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_what_is_refused(tmp_path: Path) -> None:
    cache = tmp_path / "a.svp.h5"
    write_cache(strip_and_tetrahedron(), cache)
    for name in ("out.stl", "out.gz", "out", "out.obj.zip", "sub.obj/"):
        with pytest.raises(InputError, match=r"exported as \.obj, \.ply, \.glb or"):
            cli_export.run(cache, str(tmp_path / name) + ("/" if name.endswith("/") else ""))
    with pytest.raises(CacheError, match="no such file"):
        cli_export.run(tmp_path / "none.svp.h5", str(tmp_path / "out.obj"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.svp.h5"]


def test_a_source_is_not_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    cache, first = tmp_path / "a.svp.h5", tmp_path / "first.obj"
    write_cache(strip_and_tetrahedron(), cache)
    cli_export.run(cache, "first.obj")
    from svprep.pipeline import build

    build(["first.obj"], "b.svp.h5")
    before = first.read_bytes()
    with pytest.raises(InputError, match="is an input"):
        cli_export.run(tmp_path / "b.svp.h5", str(first))
    assert first.read_bytes() == before


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b'object ["roof"', b'object ["roof', "is damaged"),
        (b'object ["roof", ', b"object [7, ", "is damaged"),
        (b'crs "EPSG:7415"', b'crs ["EPSG:7415", 1]', "is damaged"),
        (b'comment object ["T', b'comment 0bject ["T', "names 1 in its header"),
        (b'comment surface "Roof', b'comment 5urface "Roof', "names 1 in its header"),
    ],
)
def test_a_damaged_header_is_named(old: bytes, new: bytes, says: str, tmp_path: Path) -> None:
    output, _ = exported(strip_and_tetrahedron(), tmp_path, "ply")
    data = output.read_bytes()
    assert old in data
    output.write_bytes(data.replace(old, new))
    with pytest.raises(InputError, match=says) as caught:
        read([output])
    assert str(output) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_edited_obj_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    output, _ = exported(strip_and_tetrahedron(), tmp_path, "obj")
    text = output.read_text()
    assert '# object ["roof", "roof", "BuildingPart", "Haus 7"]' in text
    output.write_text(text.replace("\no roof\n", "\no another\n"))
    mesh = read([output])
    assert mesh.object_names == ("another", "Türmchen \N{CASTLE}")
    assert mesh.object_types == ("", "")
    # Without its header it is an OBJ file like any other.
    output.write_text("".join(line for line in text.splitlines(True) if line[0] != "#"))
    assert read([output]).object_names == ("roof", "Türmchen \N{CASTLE}")


def test_a_damaged_cache_is_not_exported(tmp_path: Path) -> None:
    path = tmp_path / "a.svp.h5"
    write_cache(strip_and_tetrahedron(), path)
    data = bytearray(path.read_bytes())
    at = data.index(strip_and_tetrahedron().mesh.positions.tobytes())
    data[at + 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(CacheError, match="mesh/positions"):
        cli_export.run(path, str(tmp_path / "out.obj"))
    assert [p.name for p in tmp_path.iterdir()] == ["a.svp.h5"]
    with open_cache(path) as cache:
        assert cache.n_faces == 6
