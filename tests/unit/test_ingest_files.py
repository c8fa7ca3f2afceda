from __future__ import annotations

import gzip
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svprep import ingest
from svprep.errors import InputError
from svprep.ingest import file_bytes, read
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile, no_findings
from svprep.model import SourceFile

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
def test_a_folder_without_models(tmp_path, name):
    (tmp_path / name).mkdir()
    assert "no model in this folder" in refusal(tmp_path / name)


def test_a_way_through_a_file(tmp_path):
    (tmp_path / "a.obj").write_bytes(TRIANGLE)
    assert "leads through a file" in refusal(tmp_path / "a.obj" / "b.obj")


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
        ("a.poly", "TetGen polyhedra (.poly) is not read yet"),
        ("a.fbx", 'no reader for the suffix ".fbx"'),
        ("a", "no suffix"),
    ],
)
def test_unknown_suffixes(tmp_path, name, problem):
    (tmp_path / name).write_text("text")
    message = refusal(tmp_path / name)
    assert problem in message
    assert "Known: .obj, .ply, .stl, .off, .glb, .gltf" in message
    assert ".json, .jsonl, .gml, .xml, each also with .gz" in message


@pytest.mark.parametrize("name", ["nonexist", "nonexist.obj"])
def test_a_misspelt_name_is_no_such_file(tmp_path, name):
    path = tmp_path / name
    assert refusal(path) == f"{path}: there is no such file."


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("a.city.json", b"{", "a.city.json"),
        ("a.city.json.gz", gzip.compress(b'{"type": "Feature"}'), "a.city.json.gz"),
        ("a.city.jsonl", b"[]\n", "a.city.jsonl"),
        ("a.gml", b"<kml/>", "a.gml"),
        ("a.xml.gz", gzip.compress(b"<svg"), "a.xml.gz"),
        ("a.b3dm", b"glTF", "a.b3dm"),
        ("tileset.json", b"{", "tileset.json"),
        ("a.json", b'{"asset": {}, "root": {}}', "a.json"),
    ],
)
def test_a_file_that_is_not_what_its_suffix_says(tmp_path, name, content, problem):
    (tmp_path / name).write_bytes(content)
    assert problem in refusal(tmp_path / name)


def labelled(name: str, *surfaces: str, types: tuple[str, ...] = (), crs: str = "") -> ParsedFile:
    """Return a file of one object, a triangle per surface name."""
    n = len(surfaces)
    return ParsedFile(
        np.arange(9.0).reshape(3, 3),
        np.tile(np.arange(3, dtype=np.uint32), (n, 1)),
        np.array([0, n], np.int64),
        np.arange(n, dtype=np.uint32),
        (name,),
        no_findings(),
        (),
        object_types=types,
        surface_names=("", *surfaces),
        surface_of_polygon=np.arange(1, n + 1, dtype=np.uint8),
        crs=crs,
    )


def test_labels_of_several_files_are_joined():
    plain = replace(labelled("b", "x"), surface_names=("",), surface_of_polygon=np.zeros(0, "u1"))
    files = [
        labelled("a", "Roof", "Wall", types=("Building",)),
        plain,
        labelled("c", "Wall", "Door"),
    ]
    sources = [SourceFile(f"{p.object_names[0]}.gml", "citygml", 1, "") for p in files]
    mesh = ingest._concatenate(files, sources)
    assert mesh.object_types == ("Building", "", "")
    assert mesh.object_parents == ("", "", "")
    assert mesh.surface_names == ("", "Roof", "Wall", "Door")
    assert mesh.surface_of_polygon.tolist() == [1, 2, 2, 3]
    assert mesh.polygon_start.tolist() == [0, 2, 2, 4]


def test_more_surface_names_than_a_byte_counts():
    names = [f"surface {i}" for i in range(300)]
    files = [labelled(f"{i}", *names[i : i + 100]) for i in (0, 100, 200)]
    mesh = ingest._concatenate(files, [SourceFile("a.gml", "citygml", 1, "")] * 3)
    assert len(mesh.surface_names) == 256
    assert mesh.surface_names[-1] == "other"
    found = [mesh.surface_names[i] for i in mesh.surface_of_polygon.tolist()]
    assert found == names[:254] + ["other"] * 46


def test_lod_is_said_to_be_ignored_where_there_is_none(tmp_path):
    (tmp_path / "a.obj").write_bytes(TRIANGLE)
    mesh = read([tmp_path / "a.obj"], options=ReadOptions(lod="2"))
    assert mesh.notes == (
        "a.obj: this format (obj) states no levels of detail, so --lod 2 is ignored",
    )


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
    path.write_bytes(gzip.compress(b" " * (40 << 20)))
    assert f"unpacks to more than 8 MiB from {path.stat().st_size} bytes" in refusal(path)
