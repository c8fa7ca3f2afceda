from __future__ import annotations

import gzip
import hashlib
from pathlib import Path

import numpy as np
import pytest

from svprep.defects import Code
from svprep.errors import InputError
from svprep.ingest import obj, obj_statements, read
from svprep.ingest.parsed import all_encodable
from svprep.model import SourceMesh

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "data"


def shared(name: str) -> Path:
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"not run: ../shared/data/{name} is absent")
    return path


@pytest.fixture
def write(tmp_path):
    def write(text: str | bytes, name: str = "house.obj") -> Path:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def corners(mesh: SourceMesh) -> list[list[list[float]]]:
    return mesh.positions[mesh.faces].tolist()


def test_contract(write):
    path = write("o A\n" + SQUARE + "f 1 2 3 4\no B\nf 1 2 3\n")
    mesh = read([path])
    assert mesh.positions.dtype == np.float64
    assert mesh.positions.shape == (4, 3)
    assert mesh.faces.dtype == np.uint32
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert mesh.object_face_start.dtype == np.int64
    assert mesh.object_face_start.tolist() == [0, 2, 3]
    assert mesh.source_face.dtype == np.uint32
    assert mesh.source_face.tolist() == [0, 0, 1]
    assert mesh.object_names == ("A", "B")
    assert mesh.object_source.tolist() == [0, 0]
    assert mesh.notes == ()
    (source,) = mesh.sources
    assert source.path == str(path)
    assert source.format == "obj"
    assert source.n_bytes == path.stat().st_size
    assert source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    "face",
    [
        "f 1 2 3",
        "f 1/1 2/2 3/3",
        "f 1//1 2//2 3//3",
        "f 1/1/1 2/2/2 3/3/3",
        "f 1// 2// 3//",
        "f 1/ 2/ 3/",
        "f -4 -3 -2",
        "f -4/-1 -3/-1/-1 -2//-1",
        "f +1 +2 +3",
        "  f\t1\t2  3  ",
        "f 1 2 3 # a comment 4",
        "f 1 2 3#4",
        "f 1 2\\\n 3",
        "f \\\n1 \\ \n 2 3",
        "f 1 1 2 2 3 1",
    ],
)
def test_face_forms(write, face):
    assert read([write(SQUARE + face + "\n")]).faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("last", [True, False])
def test_line_ends(write, end, last):
    text = "# c\n\n" + SQUARE + "f 1 2 \\\n3\nf 1 3 4" + ("\n" if last else "")
    mesh = read([write(text.replace("\n", end))])
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("vertex", "expected"),
    [
        ("v 1 2 3 0.5", [1, 2, 3]),
        ("v 1 2 3 1.0 0.2 0.3", [1, 2, 3]),
        ("v 1 2 3 # 4", [1, 2, 3]),
        ("v +1 -2. .5", [1, -2, 0.5]),
        ("v 1e2 1E+2 -1.5e-1", [100, 100, -0.15]),
        ("v 1 \\\n 2 3", [1, 2, 3]),
        ("v 0.1234567890123456789 1e-300 1e22", [0.1234567890123456789, 1e-300, 1e22]),
        (
            "v 123456789012345678901234567890 9007199254740993 0.00",
            [1.2345678901234568e29, 2**53, 0],
        ),
    ],
)
def test_vertex_forms(write, vertex, expected):
    mesh = read([write(vertex + "\nv 0 0 0\nv 9 0 0\nf 1 2 3\n")])
    assert mesh.positions[0].tolist() == expected


def test_forward_reference(write):
    assert read([write("f 1 2 3\n" + SQUARE)]).faces.tolist() == [[0, 1, 2]]


def test_byte_order_mark_and_gzip(write):
    text = b"\xef\xbb\xbf" + (SQUARE + "f 1 2 3\n").encode()
    packed = gzip.compress(text)
    mesh = read([write(packed, "city.obj.gz")])
    assert mesh.faces.tolist() == [[0, 1, 2]]
    assert mesh.object_names == ("city",)
    assert mesh.sources[0].sha256 == hashlib.sha256(packed).hexdigest()
    assert mesh.sources[0].n_bytes == len(packed)


@pytest.mark.parametrize(
    ("text", "names", "start"),
    [
        ("f 1 2 3\n", ("house",), [0, 1]),
        ("o A\nf 1 2 3\n", ("A",), [0, 1]),
        ("o\nf 1 2 3\n", ("house",), [0, 1]),
        ("o\ng x\nf 1 2 3\ng y\nf 1 2 3\n", ("x", "y"), [0, 1, 2]),
        ("o A\ng x\nf 1 2 3\n", ("A",), [0, 1]),
        ("g x\no A\nf 1 2 3\n", ("A",), [0, 1]),
        ("o A\nf 1 2 3\ng x\nf 1 2 3\ng default\nf 1 2 3", ("A",), [0, 3]),
        ("o A\ng x\nf 1 2 3\ng y\nf 1 2 3\ng x\nf 1 2 3", ("A/x", "A/y"), [0, 2, 3]),
        ("o A\nf 1 2 3\ng x\nf 1 2 3\ng y\nf 1 2 3\ng\nf 1 2 3", ("A", "A/x", "A/y"), [0, 2, 3, 4]),
        ("f 1 2 3\no A\nf 1 2 3\n", ("house", "A"), [0, 1, 2]),
        (
            "f 1 2 3\ng x\nf 1 2 3\no A\nf 1 2 3\ng y\nf 1 2 3",
            ("house", "house/x", "A/x", "A/y"),
            [0, 1, 2, 3, 4],
        ),
        ("f 1 2 3\ng x\nf 1 2 3\n", ("default", "x"), [0, 1, 2]),
        ("g x y  # z\nf 1 2 3\ng\nf 1 2 3\n", ("x y # z", "default"), [0, 1, 2]),
        ("f 1 2 3\no A\ng x\nf 1 2 3\no B\nf 1 2 3\n", ("house", "A", "B"), [0, 1, 2, 3]),
        ("o A\nf 1 2 3\no B\nf 2 3 4\no A\nf 3 4 1\n", ("A", "B"), [0, 2, 3]),
        ("o long \\\n name\nf 1 2 3\no B\nf 1 2 3", ("long name", "B"), [0, 1, 2]),
        ("o A\no B\nf 1 2 3 4\nf 1 2\n", ("B",), [0, 2]),
    ],
)
def test_objects(write, text, names, start):
    mesh = read([write(SQUARE + text)])
    assert mesh.object_names == names
    assert mesh.object_face_start.tolist() == start


def test_a_name_that_comes_back_keeps_file_order(write):
    mesh = read([write(SQUARE + "o A\nf 1 2 3\no B\nf 2 3 4\no A\nf 3 4 1\n")])
    assert mesh.source_face.tolist() == [0, 2, 1]


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_name_encodings(write, encoding):
    text = SQUARE + "g Straße 7\nf 1 2 3\n"
    assert read([write(text.encode(encoding))]).object_names == ("Straße 7",)


def test_a_comment_is_not_continued(write):
    mesh = read([write("# C:\\models\\\n" + SQUARE + "# x \\\nf 1 2 3\nv 1 2 3 # \\\nf 1 2 5\n")])
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 1, 4]]


def test_notes(write):
    text = SQUARE + "mtllib a.mtl\nusemtl b\ns 1\nvt 0 0\nvn 0 0 1\nvp 1\nl 1 2\nl 2 3\np 1\n"
    text += "f 1 2 3\nmagic 1\nmagic 2\nfoo\no A\no B\n"
    path = write(text)
    assert read([path]).notes == (
        f"{path.name}: 2 line elements are not surfaces and were left out",
        f"{path.name}: 1 point element is not a surface and was left out",
        f"{path.name}: 3 statements with a keyword that OBJ does not have left out: "
        '"magic" (line 15), "foo" (line 17)',
        f'{path.name}: 2 objects without faces left out: "A", "B"',
    )


@pytest.mark.parametrize(
    ("text", "note"),
    [
        ("g x\no A\nf 1 2 3\ng y\nf 1 2 3\n", ""),
        ("o A\ng x\nf 1 2 3\ng y\n", '1 object without faces left out: "A/y"'),
        ("f 1 2 3\no A\n", '1 object without faces left out: "A"'),
        ("o A\ng\ng x\nf 1 2 3\n", ""),
    ],
)
def test_notes_on_names_without_faces(write, text, note):
    path = write(SQUARE + text)
    assert read([path]).notes == ((f"{path.name}: {note}",) if note else ())


@pytest.mark.parametrize(
    ("face", "code", "n_triangles"),
    [
        ("f 1 2", Code.SHORT_POLYGON, 0),
        ("f", Code.SHORT_POLYGON, 0),
        ("f 1 1 2", Code.SHORT_POLYGON, 0),
        ("f 1 2 1 2", Code.SHORT_POLYGON, 0),
        ("f 1 2 3 4 1 2 3 4", Code.SELF_CROSSING_POLYGON, 6),
        ("f 1 3 2 4", Code.SELF_CROSSING_POLYGON, 2),
        ("f 1 2 3 5", Code.NONPLANAR_POLYGON, 2),
        ("f 1 2 2 3", None, 1),
    ],
)
def test_face_findings(write, face, code, n_triangles):
    text = SQUARE + "v 0 1 .5\no A\nf 1 2 3\no B\n" + face + "\nf 1 2 3\n"
    mesh = read([write(text)])
    assert len(mesh.faces) == n_triangles + 2
    assert mesh.face_findings.code.tolist() == ([] if code is None else [code])
    assert mesh.face_findings.object_index.tolist() == ([] if code is None else [1])
    assert mesh.face_findings.source_face.tolist() == ([] if code is None else [1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 1 2\n", "line 1: a vertex (v) with 2 numbers; x, y and z are needed."),
        ("v\n", "line 1: a vertex (v) with 0 numbers; x, y and z are needed."),
        ("v 1 # 2 3\n", "line 1: a vertex (v) with 1 number; x, y and z are needed."),
        ("\n\r\nv 3.1+e2 0 0\n", 'line 3: "3.1+e2" in a vertex (v) is not a number.'),
        ("v 0 abc 0\n", 'line 1: "abc" in a vertex (v) is not a number.'),
        ("v 0 1e 0\n", 'line 1: "1e" in a vertex (v) is not a number.'),
        ("v 0 . 0\n", 'line 1: "." in a vertex (v) is not a number.'),
        ("v 0 - 0\n", 'line 1: "-" in a vertex (v) is not a number.'),
        ("v 0 1_0 0\n", 'line 1: "1_0" in a vertex (v) is not a number.'),
        ("v 0 0x1 0\n", 'line 1: "0x1" in a vertex (v) is not a number.'),
        ("v 1,5 0 0\n", 'line 1: "1,5" in a vertex (v) is not a number (decimals take a point'),
        ("v 0 \\\n nan 0\n", 'line 2: "nan" in a vertex (v) is not a finite coordinate'),
        ("v 0 -inf 0\n", 'line 1: "-inf" in a vertex (v) is not a finite coordinate'),
        ("v 0 1e999 0\n", 'line 1: "1e999" in a vertex (v) is not a finite coordinate'),
        (SQUARE + "f 0 1 2\n", "line 5: face refers to vertex 0, but OBJ counts vertices from 1."),
        (
            SQUARE + "f 1 2 \\\n901/1\n",
            "line 6: face refers to vertex 901, but only 4 vertices are",
        ),
        (
            SQUARE + "f 1 2 99999999999999999999\n",
            "line 5: face refers to vertex 99999999999999999999, but only 4 vertices are defined",
        ),
        (
            "v 0 0 0\nf -1 -2 -3\nv 0 0 1\n",
            "line 2: face refers to vertex -2, but only 1 vertex is ",
        ),
        (SQUARE + "f a 2 3\n", 'line 5: "a" in a face (f) is not a vertex index.'),
        (SQUARE + "f 1.0 2 3\n", 'line 5: "1.0" in a face (f) is not a vertex index.'),
        (SQUARE + "f 1/a 2 3\n", 'line 5: "1/a" in a face (f) is not a vertex index.'),
        (SQUARE + "f - 2 3\n", 'line 5: "-" in a face (f) is not a vertex index.'),
        (SQUARE, ": no face (f) in this file, so nothing that casts a shadow."),
        (SQUARE + "l 1 2\n", "no face (f) in this file"),
        (SQUARE + "f 1 2\n", "none of the 1 face has three different corners"),
        (b"", ": the file is empty."),
        (b"PK\0\0", "this is a binary file, not OBJ text"),
        ("v 0 0 0\n".encode("utf-16"), "this is UTF-16 text; save it as UTF-8."),
    ],
)
def test_refusals(write, text, message):
    path = write(text)
    with pytest.raises(InputError) as raised:
        read([path])
    assert str(raised.value).startswith(str(path))
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_chunks_do_not_show(write, monkeypatch):
    lines = ["# C:\\x\\"]
    for i in range(200):
        lines += [
            f"o B{i % 7}",
            f"v {i} 0 0",
            "v 1 \\",
            f" {i}.25 0",
            f"v 0 0 0.1234567890123456{i}",
        ]
        lines += ["f -1 -2 \\", "-3", f"f {3 * i + 1} 2 3", "foo"]
    text = "\r\n".join(lines)
    whole = read([write(text)])
    for size in (1, 50, 1000):
        monkeypatch.setattr(obj, "CHUNK_BYTES", size)
        parts = read([write(text)])
        for name in ("positions", "faces", "object_face_start", "source_face"):
            assert np.array_equal(getattr(whole, name), getattr(parts, name))
        assert (whole.object_names, whole.notes) == (parts.object_names, parts.notes)
    for bad, message in (
        ("f 1 2 601", "vertex 601"),
        ("v 1 2 nan", '"nan"'),
        ("v 1e999 0 0", "1e999"),
    ):
        with pytest.raises(InputError, match=f"line {len(lines) + 1}: .*{message}"):
            read([write(text + "\r\n" + bad + "\r\nv 0 0 0\n"[: 2 if bad[0] == "f" else None])])


def test_a_file_larger_than_a_block(write):
    text = SQUARE + "f 1 2 3\n" + "# padding that is ignored\n" * 400_000 + "f 1 3 4\n"
    mesh = read([write(text)])
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.sources[0].sha256 == hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.parametrize(
    ("name", "n_triangles", "n_objects"),
    [
        ("broken/cow.obj", 5804, 1),
        ("broken/chair_model.obj", 12756, 4),
        ("broken/ogre.obj.gz", 124008, 1),
        ("cities/campus_lod1.obj", 21678, 152),
        ("cities/openfoam_buildings.obj.gz", 400020, 1),
        ("readers/box_longline.obj", 944, 1),
        ("readers/spider.obj", 1368, 19),
    ],
)
def test_shared_files(name, n_triangles, n_objects):
    mesh = read([shared(name)])
    assert (len(mesh.faces), len(mesh.object_names)) == (n_triangles, n_objects)


def test_names_that_differ_only_in_bytes(write):
    face = b"f 1 2 3\n"
    names = [b"o caf\xe9\n", b"o caf\xc3\xa9\n", b"o caf\xe9 \n"]
    mesh = read([write(SQUARE.encode() + b"".join(name + face for name in names))])
    assert mesh.object_names == ("café", "café")
    assert mesh.object_face_start.tolist() == [0, 2, 3]
    assert mesh.source_face.tolist() == [0, 2, 1]


@pytest.mark.parametrize("keyword", ["f", "o", "v", "", "usemtl"])
def test_a_keyword_behind_a_nul_is_unknown(write, keyword):
    text = "#" * 5000 + "\n" + SQUARE + "f 1 2 3\n\0" + keyword + " 1 3 4\nf 2 3 4\n"
    mesh = read([write(text)])
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 2, 3]]
    assert mesh.object_names == ("house",)
    assert mesh.notes == (
        "house.obj: 1 statement with a keyword that OBJ does not have left out: "
        f'"\ufffd{keyword}" (line 7)',
    )


def test_very_long_names_are_shortened_in_notes_only(write):
    name = "n" * 999
    mesh = read([write(f"{SQUARE}o {name}\nf 1 2 3\no {name}x\n")])
    assert mesh.object_names == (name,)
    assert mesh.notes == (f'house.obj: 1 object without faces left out: "{"n" * 197}..."',)


UNUSUAL = (b" a", b"a  b", b" \\\n b", b"\x1c", b"", b"   ", b"default", b"\xff", b"\x1ca", b"a\tb")


@pytest.mark.parametrize("unusual", ["none", *UNUSUAL], ids=repr)
def test_names_taken_together_are_those_taken_one_by_one(unusual):
    texts = [b" house 1", b"", b"b", *([] if unusual == "none" else [unusual]), b" a/b "]
    names = obj_statements._names(texts)
    assert names == list(map(obj_statements._name, texts))
    for several in (names, [*names, b"two\nlines"], []):
        readable = obj_statements._all_readable(several)
        assert readable == tuple(map(obj_statements._readable, several))


def test_names_that_cannot_be_kept_are_found_among_others():
    texts = ("a", "", "b\0", "c\ud800", "é")
    assert all_encodable(texts) == ("a", "", "b\ufffd", "c\ufffd", "é")
    assert all_encodable(texts[:3]) == ("a", "", "b\ufffd")
    assert all_encodable(iter(texts[:2])) == texts[:2]
