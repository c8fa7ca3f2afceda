"""Damaged GLB, b3dm and 3D Tiles files: read, or refused in one line, never anything else."""

from __future__ import annotations

import copy
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from svprep.errors import InputError
from svprep.ingest.b3dm import read_b3dm
from svprep.ingest.gltf import read_gltf
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile
from svprep.ingest.tileset import read_tileset
from tests.unit.gltf_samples import Glb, b3dm, mesh_features, square_glb, subtree, tile

SIX = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (5, 0, 0), (6, 0, 0), (5, 1, 0)]


def full_glb() -> Glb:
    """Return a file with a bit of everything."""
    glb = Glb()
    ids = {"_FEATURE_ID_0": [0, 0, 0, 1, 1, 1]}
    extensions = mesh_features(attribute=0, propertyTable=0, nullFeatureId=4)
    primitive = glb.primitive(SIX, range(6), ids, extensions=extensions, material=0)
    mesh = glb.mesh(primitive, glb.primitive(mode=5, extras={"surface": "RoofSurface"}))
    number = {"type": "SCALAR", "componentType": "UINT16"}
    column = {"values": glb.view(np.array([3, 4], "<u2").tobytes())}
    names = ({"type": "STRING"}, glb.texts(["a", "b"]))
    glb.table(2, {"fid": (number, column), "name": names})
    instances = {"TRANSLATION": glb.accessor([(0, 0, 0), (9, 0, 0)])}
    glb.node(mesh=mesh, name="n", rotation=[0, 0, 0, 1], scale=[1, 2, 1])
    glb.node(mesh=mesh, extensions={"EXT_mesh_gpu_instancing": {"attributes": instances}})
    glb.accessor(SIX, sparse={"count": 0, "indices": {}, "values": {}})
    glb.tree["materials"] = [{"alphaMode": "MASK"}]
    glb.tree["extensions"]["CESIUM_RTC"] = {"center": [1, 2, 3]}
    return glb


def checked(mesh: ParsedFile) -> None:
    """What every reader promises."""
    n_objects = len(mesh.object_names)
    assert np.isfinite(mesh.positions).all()
    assert len(mesh.faces) == 0 or mesh.faces.max() < len(mesh.positions)
    assert mesh.object_face_start[0] == 0
    assert mesh.object_face_start[-1] == len(mesh.faces)
    assert (np.diff(mesh.object_face_start) > 0).all()
    assert len(mesh.object_face_start) == n_objects + 1
    assert sorted(mesh.source_face.tolist()) == list(range(len(mesh.faces)))
    assert len(mesh.object_types) in (0, n_objects)
    assert len(mesh.surface_of_polygon) in (0, len(mesh.faces))
    assert mesh.surface_of_polygon.max(initial=0) < len(mesh.surface_names)


def attempt(read: Callable[[], ParsedFile], place: str) -> None:
    """Read a file that may be damaged."""
    message = f"{place}: "
    try:
        checked(read())
    except InputError as error:
        message = str(error)
    assert "\n" not in message
    assert message.startswith(place)


def attempt_bytes(reader: Any, raw: bytes) -> None:
    attempt(lambda: reader(np.frombuffer(raw + b"\n", np.uint8), Path("f"), "f"), "f: ")


anything = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 40),
    st.sampled_from([10**9, 2**63, 1e308, float("nan"), float("inf"), -1.5, "", "VEC3", "x"]),
    st.lists(st.integers(-2, 9), max_size=4),
    st.dictionaries(st.sampled_from(["uri", "count", "type", "bufferView"]), st.integers(0, 3)),
)


def paths(tree: Any, above: tuple = ()) -> list[tuple]:
    """Return the way to every value of a JSON tree."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    found = []
    for key, value in items:
        found.append((*above, key))
        if isinstance(value, dict | list):
            found += paths(value, (*above, key))
    return found


@st.composite
def changed(draw, tree: Any) -> Any:
    """Return a copy of a JSON tree with a few values replaced or left out."""
    tree = copy.deepcopy(tree)
    for _ in range(draw(st.integers(1, 3))):
        if not (known := paths(tree)):
            break
        *path, last = draw(st.sampled_from(known))
        target = tree
        for key in path:
            target = target[key]
        if draw(st.integers(0, 3)) == 0:
            del target[last]
        else:
            target[last] = draw(anything)
    return tree


@st.composite
def damaged(draw, data: bytes) -> bytes:
    """Return bytes with some replaced, cut off or doubled."""
    raw = bytearray(data)
    for _ in range(draw(st.integers(0, 4))):
        raw[draw(st.integers(0, len(raw) - 1))] = draw(st.integers(0, 255))
    end = draw(st.one_of(st.just(len(raw)), st.integers(0, len(raw))))
    return bytes(raw[:end]) + draw(st.sampled_from([b"", b"\0" * 9, data[:30]]))


FULL = full_glb()
FULL_BYTES = FULL.bytes()
B3DM = b3dm(
    square_glb(_BATCHID=[0, 0, 1, 1]).bytes(),
    {"BATCH_LENGTH": 2, "RTC_CENTER": {"byteOffset": 0}},
    {"id": ["a", "b"], "n": {"byteOffset": 0, "componentType": "FLOAT", "type": "SCALAR"}},
    np.array([1, 2, 3], "<f4").tobytes(),
    np.array([5, 6], "<f4").tobytes(),
)


def test_samples_are_whole():
    mesh = read_gltf(np.frombuffer(FULL_BYTES + b"\n", np.uint8), Path("f"), "f")
    checked(mesh)
    assert len(mesh.faces) == 3 * (2 + 4)
    assert set(mesh.object_names) == {"3", "4", "n", "M_0", "M_1"}
    attempt_bytes(read_b3dm, B3DM)


@settings(max_examples=250)
@given(changed(FULL.tree))
def test_glb_with_other_json(tree):
    glb = full_glb()
    glb.tree = tree
    buffers, raw = tree.get("buffers"), b""
    try:
        raw = glb.bytes()
    except (TypeError, KeyError, ValueError):
        return
    if buffers is not None and isinstance(buffers, list) and buffers != [{}]:
        glb.tree["buffers"] = buffers
    attempt_bytes(read_gltf, raw)


@settings(max_examples=150)
@given(damaged(FULL_BYTES))
def test_glb_with_other_bytes(raw):
    attempt_bytes(read_gltf, raw)


@settings(max_examples=150)
@given(damaged(B3DM))
def test_b3dm_with_other_bytes(raw):
    attempt_bytes(read_b3dm, raw)


def test_every_truncation():
    for raw, read in ((FULL_BYTES, read_gltf), (B3DM, read_b3dm)):
        for end in range(0, len(raw), 7):
            attempt_bytes(read, raw[:end])


TILES = tile(
    "a.glb",
    [
        tile("b.b3dm", transform=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]),
        tile("inner.json"),
        tile(
            "{level}_{x}_{y}.glb",
            implicitTiling={
                "subdivisionScheme": "QUADTREE",
                "subtreeLevels": 2,
                "availableLevels": 2,
                "subtrees": {"uri": "{level}_{x}_{y}.subtree"},
            },
        ),
    ],
    refine="ADD",
)
SUBTREE = subtree([1, 0, 1, 0, 0], [1, 0, 0, 0, 0])


def write_tiles(folder: Path, tree: Any, availability: bytes) -> Path:
    """Write a tileset and what it names."""
    for name in ("a.glb", "0_0_0.glb"):
        (folder / name).write_bytes(FULL_BYTES)
    (folder / "b.b3dm").write_bytes(B3DM)
    (folder / "0_0_0.subtree").write_bytes(availability)
    (folder / "inner.json").write_text(json.dumps({"asset": {}, "root": tile("a.glb")}))
    path = folder / "tileset.json"
    path.write_text(json.dumps(tree))
    return path


@settings(max_examples=150)
@given(changed({"asset": {"version": "1.1"}, "root": TILES}), damaged(SUBTREE))
def test_tilesets_with_other_json(tree, availability):
    with tempfile.TemporaryDirectory() as folder:
        path = write_tiles(Path(folder), tree, availability)
        attempt(lambda: read_tileset(path, lambda fraction: None, ReadOptions()), folder)


def test_tiles_are_whole(tmp_path):
    path = write_tiles(tmp_path, {"asset": {}, "root": TILES}, SUBTREE)
    mesh = read_tileset(path, lambda fraction: None, ReadOptions())
    checked(mesh)
    assert len(mesh.faces) == 3 * 18 + 2
