from __future__ import annotations

import gzip
import os
from pathlib import Path

import numpy as np
import pytest

from svprep import ingest
from svprep.errors import InputError
from svprep.ingest import file_bytes, read
from svprep.ingest.parsed import ParsedFile, no_findings

TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n"


def test_several_files(tmp_path):
    one, two = tmp_path / "one.obj", tmp_path / "two.obj"
    one.write_bytes(TRIANGLE + b"l 1 2\n")
    two.write_bytes(b"g one\n" + TRIANGLE + b"f 1 2\n")
    mesh = read([one, str(two)])
    assert mesh.object_names == ("one", "one")
    assert mesh.object_source.tolist() == [0, 1]
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert mesh.source_face.tolist() == [0, 0]
    assert mesh.object_face_start.tolist() == [0, 1, 2]
    assert mesh.face_findings.object_index.tolist() == [1]
    assert [source.path for source in mesh.sources] == [str(one), str(two)]
    assert mesh.notes == (f"{one.name}: 1 line element is not a surface and was left out",)


def test_progress_ends_at_the_total(tmp_path):
    path, other = tmp_path / "a.obj", tmp_path / "b.obj"
    path.write_bytes(TRIANGLE)
    other.write_bytes(TRIANGLE)
    told = []
    read([path, other], lambda done, total: told.append((done, total)))
    total = 2 * len(TRIANGLE)
    assert told[-1] == (total, total)
    assert told == sorted(told)


def test_a_file_named_twice(tmp_path):
    path, link = tmp_path / "a.obj", tmp_path / "b.obj"
    path.write_bytes(TRIANGLE)
    link.symlink_to(path)
    for second in (path, tmp_path / "." / ".." / tmp_path.name / "a.obj", link):
        with pytest.raises(InputError) as raised:
            read([path, second])
        assert str(raised.value) == f"{second} is named twice; name each file once."


def refusal(path) -> str:
    with pytest.raises(InputError) as raised:
        read([path])
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_no_file():
    with pytest.raises(InputError, match="No input file"):
        read([])


def test_missing_file(tmp_path):
    assert refusal(tmp_path / "no.obj") == f"{tmp_path / 'no.obj'}: there is no such file."


@pytest.mark.parametrize("name", ["city", "city.obj"])
def test_a_folder(tmp_path, name):
    (tmp_path / name).mkdir()
    assert "this is a folder" in refusal(tmp_path / name)


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="not run: root may read every file"
)
def test_no_permission(tmp_path):
    path = tmp_path / "a.obj"
    path.write_bytes(TRIANGLE)
    path.chmod(0)
    assert "no permission" in refusal(path)


def test_no_permission_as_told_by_the_system(tmp_path, monkeypatch):
    path = tmp_path / "a.obj"
    path.write_bytes(TRIANGLE)

    def deny(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", deny)
    assert refusal(path) == f"{path}: no permission to read this file."


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("a.city.json", "CityJSON (.json) is not read yet"),
        ("a.gml", "CityGML (.gml) is not read yet"),
        ("a.xml.gz", "CityGML (.xml) is not read yet"),
        ("a.poly", "TetGen polyhedra (.poly) is not read yet"),
        ("a.fbx", 'no reader for the suffix ".fbx"'),
        ("a", "no suffix"),
    ],
)
def test_unknown_suffixes(tmp_path, name, problem):
    message = refusal(tmp_path / name)
    assert problem in message
    assert "Known: .obj, .ply, .stl, .off, .glb, .gltf" in message


@pytest.mark.parametrize(
    ("name", "content", "is_tileset"),
    [
        ("tileset.json", b"", True),
        ("Tileset.json.gz", b"no gzip", True),
        ("a.json", b'{"asset": {}, "root": {}}', True),
        ("a.json.gz", gzip.compress(b'{"asset": {}, "geometricError": 1}'), True),
        ("a.json", b'{"asset": {}}', False),
        ("a.json", b'{"type": "CityJSON", "x": {"asset": 1, "root": 1}}', False),
        ("a.json", b'["asset", "root"]', False),
        ("a.json", b'{"asset": ' + b"[" * 100_000, False),
        ("a.json.gz", b'"asset"', False),
        ("a.json.gz", gzip.compress(b'{"asset": {}, "root": {}}')[:-12], False),
    ],
)
def test_tilesets(tmp_path, name, content, is_tileset):
    (tmp_path / name).write_bytes(content)
    message = refusal(tmp_path / name)
    assert ("a 3D Tiles tileset is not read yet; name its .glb files" in message) == is_tileset
    assert ("CityJSON (.json) is not read yet" in message) != is_tileset


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (gzip.compress(TRIANGLE * 100)[:-20], "cut off"),
        (b"not gzip at all", "not a readable gzip file"),
        (gzip.compress(TRIANGLE)[:-8] + b"12345678", "not a readable gzip file"),
        (gzip.compress(b""), "empty once unpacked"),
        (b"", "the file is empty"),
    ],
)
def test_damaged_gzip(tmp_path, content, problem):
    path = tmp_path / "a.obj.gz"
    path.write_bytes(content)
    assert problem in refusal(path)


@pytest.mark.parametrize("name", ["a.obj", "a.glb", "a.obj.gz"])
def test_a_device(tmp_path, name):
    (tmp_path / name).symlink_to("/dev/zero")
    assert refusal(tmp_path / name) == (
        f"{tmp_path / name}: this is a device, not a file; name a model file."
    )


def test_a_file_name_that_is_no_text(tmp_path):
    path = tmp_path / os.fsdecode(b"\xff.obj")
    try:
        path.write_bytes(TRIANGLE + b"l 1 2\n")
    except OSError:
        pytest.skip("not run: this file system takes only UTF-8 names")
    mesh = read([path])
    assert mesh.object_names == ("\ufffd",)
    assert mesh.notes[0].startswith("\ufffd.obj: 1 line element")


def test_too_many_faces():
    faces = np.broadcast_to(np.uint32(0), (400_000_000, 3))
    start = np.array([0, len(faces)])
    parsed = ParsedFile(np.zeros((3, 3)), faces, start, faces[:, 0], ("a",), no_findings(), ())
    with pytest.raises(InputError, match=r"^800000000 triangles in all input files; one build"):
        ingest._concatenate([parsed, parsed], [])


def test_gzip_of_several_members_with_padding(tmp_path):
    path = tmp_path / "a.obj.gz"
    path.write_bytes(b"".join(gzip.compress(b) + b"\0" * 5 for b in (TRIANGLE, b"", b"f 1 3 2\n")))
    assert read([path]).faces.tolist() == [[0, 1, 2], [0, 2, 1]]


@pytest.mark.parametrize("packed_bytes", [1, 7, 1000])
def test_gzip_in_blocks(tmp_path, monkeypatch, packed_bytes):
    monkeypatch.setattr(file_bytes, "_PACKED_BYTES", packed_bytes)
    monkeypatch.setattr(file_bytes, "_BLOCK_BYTES", 100)
    text = TRIANGLE + b"".join(b"# %d\n" % i for i in range(3000))
    packed = np.frombuffer(gzip.compress(text) + gzip.compress(b"end"), np.uint8)
    assert file_bytes._unpack(Path("a.gz"), packed).tobytes() == text + b"end\n"
    for end in (5, 20, packed.size - 1):
        with pytest.raises(InputError, match="cut off"):
            file_bytes._unpack(Path("a.gz"), packed[:end])


def test_gzip_that_unpacks_to_too_much(tmp_path, monkeypatch):
    monkeypatch.setattr(file_bytes, "_ALWAYS_UNPACKED", 1 << 20)
    path = tmp_path / "a.obj.gz"
    path.write_bytes(gzip.compress(bytes(40 << 20)))
    assert f"unpacks to more than 8 MiB from {path.stat().st_size} bytes" in refusal(path)
