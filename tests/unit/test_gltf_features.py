"""Features, instances, extensions and Draco in glTF files."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from svprep.errors import EnvironmentProblem, InputError
from svprep.ingest.gltf import read_gltf
from svprep.ingest.parsed import ParsedFile
from tests.unit.gltf_samples import SQUARE, Glb, mesh_features, square_glb

FOUR = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (5, 0, 0), (6, 0, 0), (5, 1, 0)]
"""Two triangles that share no vertex."""
IDS = {"_FEATURE_ID_0": [0, 0, 0, 1, 1, 1]}


def parsed(glb: Glb | bytes) -> ParsedFile:
    raw = glb if isinstance(glb, bytes) else glb.bytes()
    return read_gltf(np.frombuffer(raw + b"\n", np.uint8), Path("a.glb"), "a")


def refusal(glb: Glb | bytes) -> str:
    with pytest.raises(InputError) as raised:
        parsed(glb)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 700
    return str(raised.value)


def objects(mesh: ParsedFile) -> dict[str, list[int]]:
    """Return the source triangles of each object."""
    ranges = mesh.object_face_start
    return {
        name: mesh.source_face[ranges[i] : ranges[i + 1]].tolist()
        for i, name in enumerate(mesh.object_names)
    }


def with_ids(ids: Any = IDS, n_nodes: int = 1, **more: Any) -> Glb:
    glb = Glb()
    mesh = glb.mesh(glb.primitive(FOUR, range(6), ids, **more))
    for i in range(n_nodes):
        glb.node(mesh=mesh, name=f"n{i}")
    return glb


# --- which features there are


@pytest.mark.parametrize(
    ("ids", "extensions"),
    [
        (IDS, mesh_features(attribute=0, featureCount=2)),
        (IDS, {}),
        ({"_BATCHID": [0, 0, 0, 1, 1, 1]}, {}),
        ({"_FEATURE_ID_3": [0, 0, 0, 1, 1, 1], "_FEATURE_ID_4": [7] * 6}, {}),
        (
            {"_FEATURE_ID_0": [0, 0, 0, 1, 1, 1]},
            {
                "EXT_feature_metadata": {
                    "featureIdAttributes": [{"featureIds": {"attribute": "_FEATURE_ID_0"}}]
                }
            },
        ),
        (
            {},
            {
                "EXT_feature_metadata": {
                    "featureIdAttributes": [{"featureIds": {"constant": 0, "divisor": 3}}]
                }
            },
        ),
    ],
)
def test_features_without_a_table_are_objects_of_their_node(ids, extensions):
    mesh = parsed(with_ids(ids, 2, extensions=extensions))
    assert objects(mesh) == {
        "n0/feature_0": [0],
        "n0/feature_1": [1],
        "n1/feature_0": [2],
        "n1/feature_1": [3],
    }


def test_a_node_of_one_feature_keeps_its_name():
    glb = with_ids({"_BATCHID": [4] * 6}, 2)
    glb.tree["nodes"][0]["extras"] = {"type": "Building"}
    mesh = parsed(glb)
    assert objects(mesh) == {"n0": [0, 1], "n1": [2, 3]}
    assert mesh.object_types == ("Building", "")


def test_rows_of_one_table_are_the_same_feature_everywhere():
    glb = with_ids(n_nodes=2, extensions=mesh_features(attribute=0, propertyTable=0))
    glb.table(2, {"id": ({"type": "STRING"}, glb.texts(["a", "b"]))})
    mesh = parsed(glb)
    assert objects(mesh) == {"a": [0, 2], "b": [1, 3]}
    assert mesh.faces.tolist() == [[0, 1, 2], [6, 7, 8], [3, 4, 5], [9, 10, 11]]
    assert 'features are objects, named by their property "id"' in mesh.notes


def test_null_feature_is_left_to_its_node():
    mesh = parsed(with_ids(extensions=mesh_features(attribute=0, nullFeatureId=0)))
    assert objects(mesh) == {"n0": [0], "n0/feature_1": [1]}
    assert len(mesh.notes) == 1


def test_a_triangle_goes_by_its_first_corner():
    mesh = parsed(with_ids({"_FEATURE_ID_0": [3, 1, 1, 1, 1, 1]}))
    assert objects(mesh) == {"n0/feature_1": [1], "n0/feature_3": [0]}
    assert mesh.notes[1:] == (
        "1 triangle with corners of different features: taken by the first corner",
    )


@pytest.mark.parametrize("bad", [-1.0, 0.5, np.nan, np.inf, -np.inf, 1e30])
def test_ids_that_name_no_feature(bad):
    mesh = parsed(with_ids({"_BATCHID": [bad, bad, bad, 4, 4, 4]}))
    assert objects(mesh) == {"n0": [0], "n0/feature_4": [1]}
    assert "1 triangle with a feature id that is negative or no whole number" in mesh.notes[1]


def test_ids_past_the_end_of_their_table():
    glb = with_ids({"_FEATURE_ID_0": [0, 0, 0, 9, 9, 9]})
    glb.tree["meshes"][0]["primitives"][0]["extensions"] = mesh_features(
        attribute=0, propertyTable=0
    )
    glb.table(1, {"id": ({"type": "STRING"}, glb.texts(["a"]))})
    mesh = parsed(glb)
    assert mesh.object_names == ("a", "feature_9")
    assert "1 feature id beyond the rows of their property table: named by number" in mesh.notes


@pytest.mark.parametrize(
    ("entry", "note"),
    [
        ({"featureCount": 5, "texture": {"index": 0}}, "5 objects as feature ids (a texture)"),
        ({"featureCount": 6}, "6 objects as feature ids (one per vertex)"),
        ({"featureCount": 2, "attribute": 4}, "2 objects as feature ids (_FEATURE_ID_4)"),
    ],
)
def test_feature_ids_that_are_not_read(entry, note):
    mesh = parsed(with_ids({}, extensions=mesh_features(**entry)))
    assert objects(mesh) == {"n0": [0, 1]}
    assert note in mesh.notes[1]


def test_of_several_sets_the_one_with_a_table_is_taken():
    both = {"_FEATURE_ID_0": [0, 0, 0, 1, 1, 1], "_FEATURE_ID_1": [1, 1, 1, 1, 1, 1]}
    entries = [{"attribute": 0}, {"attribute": 1, "propertyTable": 0}]
    glb = with_ids(both, extensions={"EXT_mesh_features": {"featureIds": entries}})
    glb.table(2, {})
    mesh = parsed(glb)
    assert objects(mesh) == {"feature_1": [0, 1]}
    assert "further sets of feature ids are not read: _FEATURE_ID_0" in mesh.notes


def test_feature_attribute_of_another_length():
    assert "has the shape (2, 1), not (6, 1)" in refusal(with_ids({"_FEATURE_ID_0": [0, 1]}))


# --- what features are called

TEXT = {"type": "STRING"}
NUMBER = {"type": "SCALAR", "componentType": "UINT16"}


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        ({"Name": ["x", "y"], "gml:id": ["a", "b"]}, ("a", "b")),
        ({"name": ["x", "y"], "other": ["a", "b"]}, ("x", "y")),
        ({"name": ["", "y"], "other": ["a", "b"]}, ("a", "b")),
        ({"color": ["red", "red"], "other": ["a", "b"]}, ("a", "b")),
        ({"color": ["red", "red"]}, ("feature_0", "feature_1")),
        ({"identificatie": ["a", "a"]}, ("a", "a")),
        ({"FID": [17, 4]}, ("17", "4")),
        ({"height": [17, 4]}, ("feature_0", "feature_1")),
        ({"id": ["\u00e9", "\u65e5"]}, ("\u00e9", "\u65e5")),
    ],
)
def test_property_that_names_features(columns, names):
    glb = with_ids(extensions=mesh_features(attribute=0, propertyTable=0))
    glb.table(
        2,
        {
            name: (TEXT, glb.texts(values))
            if isinstance(values[0], str)
            else (NUMBER, {"values": glb.view(np.array(values, "<u2").tobytes())})
            for name, values in columns.items()
        },
    )
    assert parsed(glb).object_names == names


def test_semantic_id_types_and_parents():
    glb = with_ids(extensions=mesh_features(attribute=0, propertyTable=0))
    glb.table(
        2,
        {
            "id": (TEXT, glb.texts(["x", "y"])),
            "key": ({**TEXT, "semantic": "ID"}, glb.texts(["a", ""])),
            "City Object Type": (
                {"type": "ENUM", "enumType": "kinds"},
                {"values": glb.view(np.array([7, 3], "<u2").tobytes())},
            ),
            "parent": ({**TEXT, "noData": "none"}, glb.texts(["none", "a"])),
        },
        enums={
            "kinds": {"values": [{"name": "Building", "value": 7}, {"name": "Bridge", "value": 3}]}
        },
    )
    mesh = parsed(glb)
    assert mesh.object_names == ("a", "feature_1")
    assert mesh.object_types == ("Building", "Bridge")
    assert mesh.object_parents == ("", "a")


def test_older_feature_metadata():
    ids = {"featureIds": {"attribute": "_FEATURE_ID_0"}, "featureTable": "houses"}
    glb = with_ids(extensions={"EXT_feature_metadata": {"featureIdAttributes": [ids]}})
    texts = glb.texts(["a", "b"])
    glb.tree["extensions"] = {
        "EXT_feature_metadata": {
            "schema": {"classes": {"house": {"properties": {"id": TEXT}}}},
            "featureTables": {
                "houses": {
                    "class": "house",
                    "count": 2,
                    "properties": {
                        "id": {
                            "bufferView": texts["values"],
                            "stringOffsetBufferView": texts["stringOffsets"],
                        }
                    },
                }
            },
        }
    }
    assert parsed(glb).object_names == ("a", "b")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values": 10**6}, "damaged (IndexError"),
        ({"stringOffsets": -1}, "-1 is not an index"),
        ({"stringOffsets": 2}, "the texts of a property table lie outside their bufferView"),
        ({"stringOffsetType": "FLOAT32"}, "damaged (KeyError"),
    ],
)
def test_damaged_property_tables(change, message):
    glb = with_ids(extensions=mesh_features(attribute=0, propertyTable=0))
    glb.table(2, {"id": (TEXT, {**glb.texts(["a", "b"]), **change})})
    assert message in refusal(glb)


def test_a_table_of_very_many_rows_costs_nothing():
    glb = with_ids(extensions=mesh_features(attribute=0, propertyTable=0))
    glb.table(10**15, {})
    assert parsed(glb).object_names == ("feature_0", "feature_1")


def test_a_schema_in_another_file_is_noted():
    glb = with_ids(extensions=mesh_features(attribute=0, propertyTable=0))
    glb.tree["extensions"] = {
        "EXT_structural_metadata": {
            "schemaUri": "schema.json",
            "propertyTables": [{"class": "c", "count": 2, "properties": {"id": {"values": 0}}}],
        }
    }
    mesh = parsed(glb)
    assert mesh.object_names == ("feature_0", "feature_1")
    assert "the schema of its properties is another file" in mesh.notes[1]


# --- extras


def test_extras_of_nodes_and_primitives():
    glb = Glb()
    first = glb.primitive(extras={"surface": "RoofSurface"})
    mesh = glb.mesh(first, glb.primitive(), extras={"type": "Building"})
    glb.node(mesh=mesh, name="a")
    glb.node(mesh=mesh, name="b", extras={"type": "BuildingPart", "parent": "a"})
    glb.node(mesh=mesh, name="c", extras=["not an object"])
    found = parsed(glb)
    assert found.object_types == ("Building", "BuildingPart", "Building")
    assert found.object_parents == ("", "a", "")
    assert found.surface_names == ("", "RoofSurface")
    assert found.surface_of_polygon.tolist() == [1, 1, 0, 0] * 3


def test_more_kinds_of_surfaces_than_a_byte_counts():
    glb = Glb()
    glb.node(mesh=glb.mesh(*(glb.primitive(extras={"surface": f"s{i}"}) for i in range(300))))
    mesh = parsed(glb)
    assert len(mesh.surface_names) == 256
    assert mesh.surface_names[-1] == "other"
    assert mesh.surface_of_polygon[[0, 1, 506, 508, 510]].tolist() == [1, 1, 254, 255, 255]


# --- instances


def instanced(n: int = 3, **attributes: Any) -> Glb:
    glb = square_glb()
    numbers = {name: glb.accessor(values) for name, values in attributes.items()}
    glb.tree["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": numbers}}
    glb.tree["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    return glb


def test_instances_are_objects():
    half = np.sqrt(0.5)
    glb = instanced(
        TRANSLATION=[(0, 0, 0), (5, 0, 0), (0, 7, 0)],
        ROTATION=[(0, 0, 0, 1), (0, 0, half, half), (0, 0, 0, 2)],
        SCALE=[(1, 1, 1), (1, 1, 1), (-2, 1, 1)],
    )
    mesh = parsed(glb)
    assert mesh.object_names == ("square_0", "square_1", "square_2")
    assert mesh.object_face_start.tolist() == [0, 2, 4, 6]
    corner = mesh.positions.reshape(3, 4, 3)[:, 1]  # (1, 0, 0) before
    assert np.allclose(corner, [(1, 0, 0), (5, 0, 1), (-2, 0, 7)], atol=1e-6)
    assert mesh.faces[4].tolist() == [10, 9, 8]  # a mirrored instance turns its triangles


def test_instances_that_are_features():
    glb = instanced(TRANSLATION=[(0, 0, 0), (5, 0, 0)], _FEATURE_ID_0=[1, 0])
    glb.tree["nodes"][0]["extensions"]["EXT_instance_features"] = {
        "featureIds": [{"attribute": 0, "propertyTable": 0, "featureCount": 2}]
    }
    glb.table(2, {"id": (TEXT, glb.texts(["a", "b"]))})
    assert objects(parsed(glb)) == {"b": [0, 1], "a": [2, 3]}


def test_one_instance_that_is_a_feature_keeps_its_name():
    glb = instanced(TRANSLATION=[(0, 0, 0)], _FEATURE_ID_0=[1])
    glb.tree["nodes"][0]["extensions"]["EXT_instance_features"] = {
        "featureIds": [{"attribute": 0, "propertyTable": 0}]
    }
    glb.table(2, {"id": (TEXT, glb.texts(["a", "b"]))})
    assert parsed(glb).object_names == ("b",)


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({}, "places [] instances at once"),
        (
            {"TRANSLATION": [(0, 0, 0)], "SCALE": [(1, 1, 1), (2, 2, 2)]},
            "places [1, 2] instances at once",
        ),
        ({"TRANSLATION": [(0, np.nan, 0)]}, "not a finite position"),
        ({"ROTATION": [(0, 0, 0, 0)]}, "not a finite position"),
        ({"TRANSLATION": [(0, 0)]}, "damaged (ValueError"),
    ],
)
def test_instances_that_are_damaged(attributes, message):
    assert message in refusal(instanced(**attributes))


# --- extensions


def test_rtc_center_is_added_once_z_is_up():
    glb = square_glb()
    glb.tree["extensions"] = {"CESIUM_RTC": {"center": [100, 200, 300]}}
    glb.tree["extensionsRequired"] = ["CESIUM_RTC"]
    assert parsed(glb).positions[2].tolist() == [101, 200, 301]


@pytest.mark.parametrize("center", [[1, 2], ["a", 2, 3], [1, 2, float("nan")], None])
def test_rtc_center_that_is_damaged(center):
    glb = square_glb()
    glb.tree["extensions"] = {"CESIUM_RTC": {"center": center}}
    assert "CESIUM_RTC" in refusal(glb) or "damaged" in refusal(glb)


def test_alpha_is_ignored_and_noted():
    glb = Glb()
    mesh = glb.mesh(glb.primitive(material=0), glb.primitive(material=2))
    glb.node(mesh=mesh)
    glb.tree["materials"] = [{"alphaMode": "MASK"}, {"alphaMode": "BLEND"}, {}]
    assert parsed(glb).notes[1:] == (
        "1 material with alphaMode MASK or BLEND: alpha is ignored, they cast as if opaque",
    )


@pytest.mark.parametrize(
    ("at", "crs"),
    [
        ((3919786, 4999819.5, -386316.5), "EPSG:4978"),
        ((3919786, 0, -386316.5), ""),
        ((500000, 50, -5761000), ""),
        ((500000, 50, -6362000), ""),
    ],
)
def test_positions_on_the_ellipsoid_are_earth_centred(at, crs):
    mesh = parsed(square_glb(at=at))
    assert mesh.crs == crs
    assert any("earth-centred (EPSG:4978)" in note for note in mesh.notes) == bool(crs)


@pytest.mark.parametrize(
    ("asset", "crs"),
    [
        ({"generator": "svprep export", "extras": {"crs": "EPSG:28992"}}, "EPSG:28992"),
        ({"generator": "svprep export", "extras": {"crs": 7}}, ""),
        ({"generator": "other", "extras": {"crs": "EPSG:28992"}}, ""),
    ],
)
def test_crs_of_our_own_export(asset, crs):
    glb = square_glb()
    glb.tree["asset"].update(asset)
    assert parsed(glb).crs == crs


@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_positions(has_base):
    glb = square_glb()
    accessor = glb.tree["accessors"][0]
    accessor["sparse"] = {
        "count": 2,
        "indices": {"bufferView": glb.view(b"\1\2"), "componentType": 5121},
        "values": {"bufferView": glb.view(np.array([(9, 0, 0), (9, 9, 0)], "<f4").tobytes())},
    }
    if not has_base:
        del accessor["bufferView"]
    last = [0.0, 0.0, 1.0] if has_base else [0.0, 0.0, 0.0]
    assert parsed(glb).positions.tolist() == [[0, 0, 0], [9, 0, 0], [9, 0, 9], last]
    accessor["sparse"]["indices"]["bufferView"] = glb.view(b"\1\4")
    assert "replaces row 4, but has 4" in refusal(glb)
    accessor["sparse"]["count"] = 10**15
    assert "reads past the end of its buffer" in refusal(glb)


def test_sparse_accessor_of_very_many_zeros():
    glb = square_glb()
    accessor = glb.tree["accessors"][0]
    del accessor["bufferView"]
    accessor.update(sparse={"count": 0}, count=10**12)
    assert "announces 1000000000000 rows of zeros" in refusal(glb)
    accessor["count"] = 100_000  # 1.2 MB of a file of 1 kB
    assert "announces 100000 rows of zeros, but the file has" in refusal(glb)


@pytest.mark.parametrize(
    ("n_instances", "n_triangles", "found"),
    [(80_000, 70, "5600000 triangles"), (1_010_000, 1, "1010000 instances of nodes")],
)
def test_instances_that_multiply(n_instances, n_triangles, found):
    """A file of kilobytes that would place millions."""
    glb = Glb()
    places = glb.accessor([0, 0, 0, 0], "i1")
    glb.tree["accessors"][places].update(type="VEC4", count=1, normalized=True)
    place = {"count": n_instances, "type": "VEC3", "componentType": 5120, "normalized": True}
    glb.tree["accessors"][places] = {**place, "sparse": {"count": 0}}
    glb.tree["accessors"][places]["sparse"] |= {
        side: {"bufferView": 0, "componentType": 5121} for side in ("indices", "values")
    }
    mesh = glb.mesh(glb.primitive(indices=(0, 1, 2) * n_triangles))
    instances = {"attributes": {"TRANSLATION": places}}
    glb.node(mesh=mesh, extensions={"EXT_mesh_gpu_instancing": instances})
    assert f"it unfolds to {found} or more" in refusal(glb)


# --- Draco


def draco(n_points: int = 4, n_indices: int = 6, **ids: list[int]) -> Glb:
    library = pytest.importorskip("DracoPy", reason="not run: DracoPy is not installed")
    generic = {9: np.array(ids["_FEATURE_ID_0"], np.uint16)[:, None]} if ids else None
    data = library.encode(
        np.array(SQUARE, np.float32),
        np.array([(0, 1, 2), (0, 2, 3)], np.uint32),
        quantization_bits=20,
        preserve_order=True,
        generic_attributes=generic,
    )
    number = next(
        a["unique_id"] for a in library.decode(data).attributes if a["attribute_type"] == 0
    )
    glb = Glb()
    packed: dict[str, Any] = {"bufferView": glb.view(data), "attributes": {"POSITION": number}}
    accessors = [
        {"componentType": 5126, "count": n_points, "type": "VEC3"},
        {"componentType": 5125, "count": n_indices, "type": "SCALAR"},
    ]
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    if ids:
        accessors.append({"componentType": 5123, "count": 4, "type": "SCALAR"})
        primitive["attributes"]["_FEATURE_ID_0"] = 2
        packed["attributes"]["_FEATURE_ID_0"] = 9
    glb.tree["accessors"] = accessors
    primitive["extensions"] = {"KHR_draco_mesh_compression": packed}
    glb.node(mesh=glb.mesh(primitive), name="d")
    glb.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return glb


def test_draco():
    mesh = parsed(draco())
    assert np.allclose(mesh.positions[:, [0, 2]], np.array(SQUARE)[:, :2], atol=1e-5)
    assert len(mesh.faces) == 2
    mesh = parsed(draco(_FEATURE_ID_0=[5, 5, 7, 7]))
    assert objects(mesh) == {"d": [0, 1]}
    assert "2 triangles with corners of different features" in mesh.notes[1]


@pytest.mark.parametrize(
    ("glb", "message"),
    [
        (lambda: draco(n_points=5), "holds 4 vertices and 6 indices, but its accessors say 5"),
        (lambda: draco(n_indices=9), "holds 4 vertices and 6 indices, but its accessors say 4 and"),
    ],
)
def test_draco_of_other_counts(glb, message):
    assert message in refusal(glb())


@pytest.mark.parametrize("n_bytes", [0, 4, 20, 40])
def test_draco_that_is_cut_off(n_bytes):
    glb = draco()
    glb.tree["bufferViews"][0]["byteLength"] = n_bytes
    assert "its Draco data is damaged" in refusal(glb)


def test_draco_without_its_package(monkeypatch):
    glb = draco()
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(EnvironmentProblem, match=r"pip install 'svprep\[formats\]'"):
        parsed(glb)


def test_draco_beside_an_uncompressed_copy_is_not_needed(monkeypatch):
    glb = square_glb()
    primitive = glb.tree["meshes"][0]["primitives"][0]
    primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}}
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    assert len(parsed(glb).faces) == 2


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
def test_meshopt_is_refused_by_name(name):
    glb = square_glb()
    glb.tree["extensionsUsed"] = [name]
    assert f"export it without {name}" in refusal(glb)
