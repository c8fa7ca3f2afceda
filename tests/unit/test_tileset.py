"""3D Tiles: which contents count, where they stand, and what is refused."""

from __future__ import annotations

import gzip
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from svprep.errors import InputError
from svprep.ingest import read, tileset_subtrees, tileset_tree
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile
from svprep.ingest.tileset import read_tileset
from tests.unit.gltf_samples import (
    Glb,
    b3dm,
    cmpt,
    square_glb,
    subtree,
    tile,
    write_tileset,
)


def parsed(path: Path) -> ParsedFile:
    return read_tileset(path, lambda fraction: None, ReadOptions())


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as raised:
        parsed(path)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 900
    return str(raised.value)


@pytest.fixture
def folder(tmp_path):
    """A folder with the contents a.glb to e.glb, each an object of its name."""
    for name in "abcde":
        square_glb(name).write(tmp_path / "tiles" / f"{name}.glb")
    return tmp_path / "tiles"


def names(folder: Path, root: dict, **more: object) -> tuple[str, ...]:
    return parsed(write_tileset(folder / "tileset.json", root, **more)).object_names


# --- which contents count


@pytest.mark.parametrize(
    ("root", "expected"),
    [
        (tile("a.glb"), "a"),
        (tile("a.glb", [tile("b.glb"), tile("c.glb")], refine="REPLACE"), "bc"),
        (tile("a.glb", [tile("b.glb"), tile("c.glb")], refine="ADD"), "abc"),
        (tile("a.glb", [tile("b.glb"), tile("c.glb")], refine="add"), "abc"),
        (tile("a.glb", [tile(children=[tile()])], refine="REPLACE"), "a"),
        (tile("a.glb", [tile(children=[tile("b.glb")])], refine="REPLACE"), "b"),
        # refine is inherited; a tile may say otherwise
        (tile("a.glb", [tile("b.glb", [tile("c.glb")])], refine="REPLACE"), "c"),
        (tile("a.glb", [tile("b.glb", [tile("c.glb")], refine="ADD")], refine="REPLACE"), "bc"),
        (tile("a.glb", [tile("b.glb", [tile("c.glb")], refine="REPLACE")], refine="ADD"), "ac"),
        (tile(contents=[{"uri": "a.glb"}, {"uri": "b.glb"}]), "ab"),
        (tile(content={"url": "a.glb"}), "a"),
        (tile("a.glb?v=2#x"), "a"),
        (tile("%61.glb"), "a"),
        (tile("../tiles/./a.glb"), "a"),
        (
            tile(
                extensions={
                    "3DTILES_multiple_contents": {"content": [{"uri": "a.glb"}, {"uri": "d.glb"}]}
                }
            ),
            "ad",
        ),
    ],
)
def test_contents_that_count(folder, root, expected):
    assert names(folder, root) == tuple(expected)


def test_tilesets_in_tilesets(folder):
    write_tileset(
        folder / "inner" / "tileset.json", tile("../b.glb", [tile("../c.glb")], refine="REPLACE")
    )
    root = tile("a.glb", [tile("inner/tileset.json"), tile("d.glb")], refine="REPLACE")
    assert names(folder, root) == ("c", "d")
    mesh = parsed(folder / "tileset.json")
    files = ["inner/tileset.json", "c.glb", "d.glb"]
    assert mesh.beside == tuple(
        hashlib.sha256((folder / name).read_bytes()).digest() for name in files
    )


def test_the_same_name_in_two_tiles_is_two_objects(folder):
    assert names(folder, tile(children=[tile("a.glb"), tile("a.glb")])) == ("a", "a")


def test_a_folder_is_its_tileset(folder):
    write_tileset(folder / "tileset.json", tile("a.glb"))
    assert parsed(folder).object_names == ("a",)
    assert read([folder / "tileset.json"]).sources[0].format == "3dtiles"


def test_source_faces_count_through(folder):
    write_tileset(folder / "tileset.json", tile(children=[tile("a.glb"), tile("b.glb")]))
    mesh = parsed(folder)
    assert mesh.source_face.tolist() == [0, 1, 2, 3]
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    assert mesh.object_face_start.tolist() == [0, 2, 4]


def test_types_and_surfaces_of_contents(folder):
    glb = Glb()
    primitive = glb.primitive(extras={"surface": "RoofSurface"})
    glb.node(mesh=glb.mesh(primitive), name="r", extras={"type": "Building"})
    glb.write(folder / "r.glb")
    write_tileset(folder / "tileset.json", tile(children=[tile("a.glb"), tile("r.glb")]))
    mesh = parsed(folder)
    assert mesh.object_types == ("", "Building")
    assert mesh.object_parents == ()
    assert mesh.surface_names == ("", "RoofSurface")
    assert mesh.surface_of_polygon.tolist() == [0, 0, 1, 1]


# --- other contents


def test_b3dm_and_composites(folder):
    glb = square_glb(_BATCHID=[1, 1, 1, 1]).bytes()
    batched = b3dm(glb, {"BATCH_LENGTH": 2, "RTC_CENTER": [100, 200, 300]}, {"id": ["x", "y"]})
    (folder / "m.b3dm").write_bytes(batched)
    (folder / "m.cmpt").write_bytes(cmpt(batched, cmpt(batched)))
    shift = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 7, 1]
    root = tile(children=[tile("m.b3dm", transform=shift), tile("m.cmpt")], refine="ADD")
    assert names(folder, root) == ("y", "y", "y")
    mesh = parsed(folder)
    assert mesh.positions[2].tolist() == [101, 200, 308]
    assert mesh.positions[6].tolist() == [101, 200, 301]


def test_gltf_with_its_buffer_and_gzipped_contents(folder):
    glb = square_glb("g")
    glb.bytes()
    glb.tree["buffers"] = [{"uri": "g.bin", "byteLength": len(glb.blob)}]
    (folder / "g.gltf").write_text(json.dumps(glb.tree))
    (folder / "g.bin").write_bytes(glb.blob)
    packed = gzip.compress((folder / "a.glb").read_bytes())
    (folder / "packed.glb").write_bytes(packed)
    assert names(folder, tile(children=[tile("g.gltf"), tile("packed.glb")])) == ("g", "a")
    digests = [hashlib.sha256(packed).digest(), hashlib.sha256(glb.blob).digest()]
    assert set(digests) < set(parsed(folder).beside)
    (folder / "packed.glb").write_bytes(packed[:-5])
    assert "the gzip file is cut off" in refusal(folder)


def test_points_are_counted_and_other_formats_refused(folder):
    (folder / "p.pnts").write_bytes(b"pnts" + bytes(60))
    (folder / "i.i3dm").write_bytes(b"i3dm" + bytes(60))
    write_tileset(folder / "tileset.json", tile(children=[tile("a.glb"), tile("p.pnts")]))
    assert "1 content with points (.pnts) left out, the first p.pnts" in parsed(folder).notes
    write_tileset(folder / "tileset.json", tile(children=[tile("a.glb"), tile("i.i3dm")]))
    assert "i.i3dm: this content is .i3dm (instances), which is not read" in refusal(folder)
    write_tileset(folder / "tileset.json", tile("p.pnts"))
    assert "no triangles in 1 content of 1 tile" in refusal(folder)


# --- where contents stand


def test_transforms_are_nested(folder):
    turn = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1]  # columns: x -> y, y -> -x
    mirror = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    root = tile(children=[tile("a.glb", transform=mirror)], transform=turn)
    write_tileset(folder / "tileset.json", root)
    mesh = parsed(folder)
    # (1, 1, 0) is (1, 0, 1) with z up, mirrored (-1, 0, 1), turned (0, -1, 1)
    assert mesh.positions[2].tolist() == [10, 19, 31]
    assert mesh.faces[0].tolist() == [2, 1, 0]


@pytest.mark.parametrize(("up", "corner"), [("Y", [1, 0, 1]), ("z", [1, 1, 0])])
def test_older_tilesets_say_which_axis_is_up(folder, up, corner):
    asset = {"version": "1.0", "gltfUpAxis": up}
    path = folder / "tileset.json"
    path.write_text(json.dumps({"asset": asset, "root": tile("a.glb")}))
    assert parsed(path).positions[2].tolist() == corner


ECEF = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3919786, 386316.5, 4999819.5, 1]
EQUATOR = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 6378137, 0, 0, 1]
REGION = {"boundingVolume": {"region": [0, 0, 1, 1, 0, 9]}}


@pytest.mark.parametrize(
    ("more", "crs", "note"),
    [
        ({"transform": ECEF}, "EPSG:4978", "earth-centred"),
        ({"transform": EQUATOR, **REGION}, "EPSG:4978", "earth-centred"),
        ({"transform": EQUATOR}, "", "content"),
        (REGION, "", "a region on Earth, but its positions do not lie there"),
        ({}, "", "content"),
    ],
)
def test_earth_centred_frames(folder, more, crs, note):
    write_tileset(folder / "tileset.json", tile("a.glb", **more))
    mesh = parsed(folder)
    assert mesh.crs == crs
    assert any(note in line for line in mesh.notes)


# --- implicit tiling


def implicit(scheme: str = "QUADTREE", levels: int = 2, available: int = 3, **more: object) -> dict:
    axes = "{x}_{y}" if scheme == "QUADTREE" else "{x}_{y}_{z}"
    return tile(
        f"c/{{level}}_{axes}.glb",
        refine="ADD",
        implicitTiling={
            "subdivisionScheme": scheme,
            "subtreeLevels": levels,
            "availableLevels": available,
            "subtrees": {"uri": f"s/{{level}}_{axes}.subtree"},
            **more,
        },
    )


def write_subtree(folder: Path, name: str, data: bytes) -> None:
    (folder / "s").mkdir(exist_ok=True)
    (folder / "s" / f"{name}.subtree").write_bytes(data)


def write_contents(folder: Path, *contents: str) -> None:
    for name in contents:
        square_glb(name).write(folder / "c" / f"{name}.glb")


@pytest.mark.parametrize("is_binary", [True, False])
@pytest.mark.parametrize(("refine", "expected"), [("ADD", 4), ("REPLACE", 3)])
def test_quadtree(folder, refine, expected, is_binary):
    # Level 1: tiles 1 (x = 1) and 2 (y = 1); below tile 2 one subtree, at morton 10.
    write_subtree(
        folder, "0_0_0", subtree([1, 0, 1, 1, 0], [1, 0, 1, 0, 0], [0] * 10 + [1] + [0] * 5)
    )
    constant = subtree(1, 1, 0, is_binary)
    write_subtree(folder, "2_0_3", constant if is_binary else constant.strip())
    write_contents(folder, "0_0_0", "1_1_0", "2_0_3")
    root = implicit()
    root["refine"] = refine
    # The subtree at level 2 has two levels, but only 3 levels are available.
    wanted = ("0_0_0", "1_1_0", "2_0_3")[4 - expected :]
    assert names(folder, root) == wanted


def test_octree_and_several_contents(folder):
    bits = [1, 0, 0, 0, 0, 0, 1, 0, 0]  # morton 5 of level 1: x = 1, y = 0, z = 1
    write_subtree(folder, "0_0_0_0", subtree(bits, bits))
    write_contents(folder, "0_0_0_0", "1_1_0_1")
    assert names(folder, implicit("OCTREE", 2, 2)) == ("0_0_0_0", "1_1_0_1")


def test_older_implicit_tiling(folder):
    root = implicit()
    tiling = root.pop("implicitTiling")
    del tiling["availableLevels"]
    root["extensions"] = {"3DTILES_implicit_tiling": {**tiling, "maximumLevel": 1}}
    write_subtree(folder, "0_0_0", subtree([1, 1, 0, 0, 0], [0, 1, 0, 0, 0]))
    write_contents(folder, "1_0_0")
    assert names(folder, root) == ("1_0_0",)


@pytest.mark.parametrize(
    ("data", "more", "message"),
    [
        (subtree(1, [1, 0, 0, 0, 0], n_cut=9), {}, "the subtree file is cut off: it announces"),
        (b"subt" + bytes(9), {}, "the subtree file is cut off (13 bytes)"),
        (b"subt" + b"\xff" * 20, {}, "the subtree file is cut off: it announces"),
        (b"{", {}, "not a subtree file"),
        (b"[]", {}, "not a subtree file"),
        (subtree([1], [1]), {"subtreeLevels": 4}, "needs 85 bits, but its bufferView of 1 bytes"),
        (subtree(1, 1), {"subtreeLevels": 20}, "at most 4194304 tiles in a subtree"),
        (subtree(1, 1), {"subtreeLevels": 0}, "at most 4194304 tiles in a subtree"),
        (subtree(1, 1), {"availableLevels": 10**9}, "at most 4194304 tiles in a subtree"),
        (subtree(1, 1), {"subdivisionScheme": "KD"}, "its subdivision scheme is KD"),
        (subtree(1, 0, 1), {}, "0_0.subtree, but there is no such file"),
        (subtree(1, 1), {"subtrees": {"uri": "../x.subtree"}}, "outside its folder"),
        (subtree(1, 1), {"subtrees": {}}, "the tileset is damaged (KeyError"),
        (subtree(1, 1), {}, "0_0_0.glb, but there is no such file"),
    ],
)
def test_subtrees_that_are_refused(folder, data, more, message):
    write_subtree(folder, "0_0_0", data)
    write_tileset(folder / "tileset.json", implicit(**more))
    assert message in refusal(folder)


def test_implicit_tile_with_children(folder):
    write_tileset(folder / "tileset.json", {**implicit(), "children": [tile("a.glb")]})
    assert "is divided implicitly and has children, too" in refusal(folder)


def test_subtrees_that_multiply(folder, monkeypatch):
    more = {"availableLevels": 48}
    write_tileset(folder / "tileset.json", implicit(**more))
    write_subtree(folder, "0_0_0", subtree(0, 0, 1))
    monkeypatch.setattr(tileset_subtrees, "_MOST_SUBTREES", 16)
    assert "more than 16 subtrees" in refusal(folder)
    monkeypatch.setattr(tileset_subtrees, "_MOST_BITS_IN_ALL", 14)
    assert "more than 14 bits of availability" in refusal(folder)


@pytest.mark.parametrize("uri", ["s/0_0_0.subtree", "s/0_0_0.subtree?{level}_{x}_{y}"])
def test_one_file_for_all_subtrees(folder, uri):
    write_subtree(folder, "0_0_0", subtree(0, 0, 1))
    more = {"availableLevels": 48, "subtrees": {"uri": uri}}
    write_tileset(folder / "tileset.json", implicit(**more))
    assert "two of its subtrees are the same file" in refusal(folder)


def test_tiles_that_are_too_many(folder, monkeypatch):
    monkeypatch.setattr(tileset_tree, "_MOST_TILES", 500)
    write_subtree(folder, "0_0_0", subtree(1, 0))
    write_tileset(folder / "tileset.json", implicit(subtreeLevels=8, availableLevels=8))
    assert "more than 500 tiles" in refusal(folder)


# --- what is refused


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("../outside.glb", "outside its folder"),
        ("%2e%2e/outside.glb", "outside its folder"),
        ("link.glb", "outside its folder"),
        ("loop.glb", ""),
        ("/etc/passwd", "outside its folder"),
        ("//host/a.glb", "outside its folder"),
        ("file:///etc/passwd", "not read from there"),
        ("http://x/a.glb", "not read from there; download it"),
        ("data:;base64,AAAA", "not read from there"),
        ("C:\\a.glb", "not read from there"),
        ("a\0.glb", "names no file"),
        ("?x", "names no file"),
        ("no.glb", "no.glb, but there is no such file; the tileset is incomplete"),
        ("folder", "which is not a file"),
        ("x" * 5000, "cannot be read"),
    ],
)
def test_uris_that_are_refused(folder, uri, message):
    square_glb().write(folder.parent / "outside.glb")
    (folder / "link.glb").symlink_to("../outside.glb")
    (folder / "loop.glb").symlink_to("loop.glb")
    (folder / "folder").mkdir()
    write_tileset(folder / "tileset.json", tile(uri))
    assert message in refusal(folder)


def test_a_buffer_outside_the_folder(folder):
    glb = square_glb("g")
    glb.tree["buffers"] = [{"uri": "../g.bin", "byteLength": len(glb.blob)}]
    (folder / "g.gltf").write_text(json.dumps(glb.tree))
    (folder.parent / "g.bin").write_bytes(glb.blob)
    write_tileset(folder / "tileset.json", tile("g.gltf"))
    assert "outside its folder" in refusal(folder)


@pytest.mark.parametrize("uri", ["tileset.json", "./x/../tileset.json", "b.json"])
def test_tilesets_that_lead_back_to_themselves(folder, uri):
    write_tileset(folder / "b.json", tile("tileset.json"))
    write_tileset(folder / "tileset.json", tile(uri))
    assert "leads back to itself" in refusal(folder)


def test_tilesets_that_multiply(folder, monkeypatch):
    """2**40 tilesets in 40 files."""
    monkeypatch.setattr(tileset_tree, "_MOST_TILESETS", 500)
    for i in range(40):
        uri = f"{i + 1}.json" if i < 39 else "a.glb"
        write_tileset(folder / f"{i}.json", tile(children=[tile(uri), tile(uri)]))
    write_tileset(folder / "tileset.json", tile("0.json"))
    assert "more than 500 tilesets in tilesets" in refusal(folder)


NAN = float("nan")


@pytest.mark.parametrize(
    ("root", "more", "message"),
    [
        (tile("a.glb", transform=[1, 2, 3]), {}, "has 3 numbers, not 16"),
        (tile("a.glb", transform=[NAN] * 16), {}, "is not finite, or not affine"),
        (tile("a.glb", transform=[1] * 16), {}, "is not finite, or not affine"),
        (tile("a.glb", transform="x"), {}, "the tileset is damaged (ValueError"),
        (tile("a.glb", refine="OTHER"), {}, "refined by OTHER; ADD and REPLACE are read"),
        (tile("a.glb", children=[7]), {}, "the tileset is damaged (AttributeError"),
        (tile(), {}, "no triangles in 0 contents of 1 tile"),
        (tile(content={}), {}, "no triangles in 0 contents of 1 tile"),
        (tile(content={"x": 1}), {}, "the tileset is damaged (KeyError"),
        (tile("a.glb"), {"extensionsRequired": ["MAXAR_x"]}, "it requires MAXAR_x"),
        (tile("a.glb"), {"asset": {"gltfUpAxis": "X"}}, "gltfUpAxis is X; Y and Z are read"),
        (tile("a.glb"), {"root": 3}, 'the JSON has no "root"'),
        (tile("bad.glb"), {}, "bad.glb: not glTF"),
        (tile("text.txt"), {}, "text.txt: this content is a file beginning b'hell'"),
        (tile("bad.cmpt"), {}, "the composite tile is cut off: 0 of 9 tiles in it"),
        (tile("deep.cmpt"), {}, "more than 16 inside each other"),
    ],
)
def test_refusals(folder, root, more, message):
    (folder / "bad.glb").write_bytes(b"{}")
    (folder / "text.txt").write_bytes(b"hello")
    (folder / "bad.cmpt").write_bytes(b"cmpt" + np.array([1, 99, 9], "<u4").tobytes() + b"b3dm")
    deep = b"pnts" + np.array([1, 12], "<u4").tobytes()
    for _ in range(20):
        deep = cmpt(deep)
    (folder / "deep.cmpt").write_bytes(deep)
    path = folder / "tileset.json"
    path.write_text(json.dumps({"asset": {"version": "1.1"}, "root": root, **more}))
    assert message in refusal(folder)


def test_json_that_is_nested_too_deeply(folder):
    (folder / "tileset.json").write_text('{"root": ' + '{"children": [' * 100_000)
    assert "tileset.json: " in refusal(folder)
