"""Batched 3D models."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from svprep.errors import InputError
from svprep.ingest import read
from svprep.ingest.b3dm import read_b3dm
from svprep.ingest.parsed import ParsedFile
from tests.unit.gltf_samples import Glb, b3dm, square_glb

SIX = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (5, 0, 0), (6, 0, 0), (5, 1, 0)]


def two_batches() -> bytes:
    glb = Glb()
    ids = {"_BATCHID": [0, 0, 0, 1, 1, 1]}
    # Two nodes: a batch id is the same feature in both.
    mesh = glb.mesh(glb.primitive(SIX, range(6), ids))
    glb.node(mesh=mesh, name="a")
    glb.node(mesh=mesh, name="b", translation=[0, 0, 9])
    return glb.bytes()


def parsed(raw: bytes) -> ParsedFile:
    return read_b3dm(np.frombuffer(raw + b"\n", np.uint8), Path("a.b3dm"), "a")


def refusal(raw: bytes) -> str:
    with pytest.raises(InputError) as raised:
        parsed(raw)
    assert "\n" not in str(raised.value)
    return str(raised.value)


@pytest.mark.parametrize(
    ("batch_table", "binary", "names"),
    [
        (None, b"", ("feature_0", "feature_1")),
        ({"id": ["x", "y"]}, b"", ("x", "y")),
        ({"id": [3, 4.0]}, b"", ("3", "4")),
        ({"id": ["x", None], "gml_id": ["p", "q"]}, b"", ("p", "q")),
        ({"id": ["x", "y", "z"]}, b"", ("feature_0", "feature_1")),
        ({"id": [{"a": 1}, ["b"]]}, b"", ("feature_0", "feature_1")),
        (
            {"id": {"byteOffset": 4, "componentType": "UNSIGNED_INT", "type": "SCALAR"}},
            struct.pack("<3I", 0, 7, 8),
            ("7", "8"),
        ),
        (
            {"fid": {"byteOffset": 0, "componentType": "DOUBLE", "type": "SCALAR"}},
            struct.pack("<2d", 7, 8.5),
            ("7", "8.5"),
        ),
    ],
)
def test_batches_are_objects(batch_table, binary, names):
    mesh = parsed(b3dm(two_batches(), {"BATCH_LENGTH": 2}, batch_table, batch_binary=binary))
    assert mesh.object_names == names
    assert mesh.object_face_start.tolist() == [0, 2, 4]
    assert mesh.source_face.tolist() == [0, 2, 1, 3]


def test_batch_types_and_parents():
    table = {"id": ["x", "y"], "Type": ["Building", ""], "parent": [None, "x"], "class": [1, 2]}
    mesh = parsed(b3dm(two_batches(), {"BATCH_LENGTH": 2}, table))
    assert mesh.object_types == ("Building", "")
    assert mesh.object_parents == ("", "x")


@pytest.mark.parametrize(
    ("table", "binary"),
    [
        ({"BATCH_LENGTH": 0, "RTC_CENTER": [100, 200, 300]}, b""),
        ({"RTC_CENTER": {"byteOffset": 4}}, struct.pack("<4f", 0, 100, 200, 300)),
    ],
)
def test_rtc_center_is_added_once_z_is_up(table, binary):
    mesh = parsed(b3dm(square_glb().bytes(), table, feature_binary=binary))
    assert mesh.positions[2].tolist() == [101, 200, 301]


def test_b3dm_is_an_input(tmp_path):
    path = tmp_path / "a.b3dm"
    path.write_bytes(b3dm(two_batches(), {"BATCH_LENGTH": 2}, {"id": ["x", "y"]}))
    mesh = read([path])
    assert mesh.object_names == ("x", "y")
    assert mesh.sources[0].format == "b3dm"


GOOD = b3dm(square_glb().bytes(), {"BATCH_LENGTH": 1}, {"id": ["x"]})


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"", 'does not begin with "b3dm"'),
        (b"glTF" + GOOD[4:], 'does not begin with "b3dm"'),
        (GOOD[:20], "cut off (20 bytes)"),
        (GOOD[:-1], "the b3dm file is cut off: it announces"),
        (GOOD[:4] + struct.pack("<I", 2) + GOOD[8:], "b3dm version 2; version 1 is read"),
        (GOOD[:12] + struct.pack("<I", 2**32 - 1) + GOOD[16:], "its tables end past its end"),
        (b3dm(b"glTFx", {}), "the GLB file is cut off"),
        (b3dm(b"", {}), "no readable JSON in it"),
        (b3dm(square_glb().bytes(), {"BATCH_LENGTH": -1}), "-1 is not an index"),
        (b3dm(square_glb().bytes(), {"RTC_CENTER": [1, 2]}), "not three finite numbers"),
        (
            b3dm(square_glb().bytes(), {"RTC_CENTER": {"byteOffset": 10**9}}),
            "not three finite numbers",
        ),
        (b3dm(Glb().bytes()), "no triangles in it"),
        (
            b3dm(
                two_batches(),
                {"BATCH_LENGTH": 2},
                {"id": {"byteOffset": 9, "componentType": "INT", "type": "SCALAR"}},
            ),
            "damaged (ValueError",
        ),
    ],
)
def test_refusals(raw, message):
    assert message in refusal(raw)


def test_a_batch_length_of_very_many_costs_nothing():
    assert len(parsed(b3dm(two_batches(), {"BATCH_LENGTH": 10**15})).faces) == 4
