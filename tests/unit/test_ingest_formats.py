from __future__ import annotations

import base64
import hashlib
import json
import struct
import time
from pathlib import Path

import numpy as np
import pytest

from svprep.defects import Code
from svprep.errors import InputError
from svprep.ingest import read

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "data"
POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def shared(name: str) -> Path:
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"not run: ../shared/data/{name} is absent")
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as raised:
        read([path])
    assert str(raised.value).startswith(str(path))
    assert "\n" not in str(raised.value)
    return str(raised.value)


# --- OFF


@pytest.mark.parametrize(
    "header", ["OFF\n4 2 0", "OFF 4 2 0", "# c\nCOFF\n\n4 2 # counts", "4 2 0"]
)
def test_off(tmp_path, header):
    path = tmp_path / "a.off"
    path.write_text(header + "\n0 0 0 255\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3 9 9 9\n2 0 1\n")
    mesh = read([path])
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.object_names == ("a",)
    assert mesh.source_face.tolist() == [0, 0]
    assert mesh.face_findings.code.tolist() == [Code.SHORT_POLYGON]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("OFF\n1 1 0\n0 0 0\n", "cut off: 1 vertices and 1 faces announced, 1 lines found"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1 3\n", "line 6: face refers to vertex 3"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1 -1\n", "line 6: face refers to vertex -1"),
        ("OFF\n3 1 0\n0 0 0\n1 x 0\n1 1 0\n3 0 1 2\n", 'line 4: "1 x 0" cannot be read as OFF'),
        ("OFF\n3 1 0\n0 0 0\n1 0\n1 1 0\n3 0 1 2\n", 'line 4: "1 0" cannot be read as OFF'),
        ("OFF\n3 1 0\n0 0 0\n1 nan 0\n1 1 0\n3 0 1 2\n", "vertex 1 is (1, nan, 0)"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1\n", 'line 6: "3 0 1" cannot be read'),
        ("hello\n", 'line 1: not an OFF file: it begins with no "OFF"'),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1 1.5\n", 'line 6: "3 0 1 1.5" cannot be read'),
        ("OFF\n3 1 0\n0 0 0\n1_0 0 0\n1 1 0\n3 0 1 2\n", 'line 4: "1_0 0 0" cannot be read'),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1 0_2\n", 'line 6: "3 0 1 0_2" cannot be read'),
        (
            "OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n# c\n3 2 1 0\n",
            "line 8: more lines than the 3 vertices and 1 faces announced",
        ),
        ("OFF\n", "no counts"),
        ("OFF\n0 0 0\n", "no face with three different corners"),
    ],
)
def test_off_refusals(tmp_path, text, message):
    path = tmp_path / "a.off"
    path.write_text(text)
    assert message in refusal(path)


# --- PLY

PLY = """ply
format ascii 1.0
element vertex {n}
property float x
property float y
property float z
element face {m}
property list uchar int vertex_indices
end_header
"""


def ply(vertices: list[str], faces: list[str]) -> str:
    return PLY.format(n=len(vertices), m=len(faces)) + "\n".join(vertices + faces) + "\n"


FOUR = ["0 0 0", "1 0 0", "1 1 0", "0 1 0"]


@pytest.mark.parametrize(
    ("faces", "triangles", "source"),
    [
        (["3 0 1 2", "3 0 2 3"], [[0, 1, 2], [0, 2, 3]], [0, 1]),
        (["4 0 1 2 3"], [[0, 1, 2], [0, 2, 3]], [0, 0]),
        (["4 0 1 2 3", "3 0 1 2"], [[0, 1, 2], [0, 2, 3], [0, 1, 2]], [0, 0, 1]),
    ],
)
def test_ply(tmp_path, faces, triangles, source):
    path = tmp_path / "a.ply"
    path.write_text(ply(FOUR, faces))
    mesh = read([path])
    assert mesh.faces.tolist() == triangles
    assert mesh.source_face.tolist() == source
    assert mesh.object_names == ("a",)


def test_ascii_ply_with_more_properties_of_faces(tmp_path):
    text = ply(FOUR, ["7 3 0 1 2 2 0.5 0.25 1.5", "7 3 0 2 3 0 -1"])
    text = text.replace(RING, "property int a\n" + RING + "property list uchar float t\n" + LAST)
    path = tmp_path / "a.ply"
    path.write_text(text)
    assert read([path]).faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    path.write_text(text.replace("0 -1", "1 -1"))
    assert 'line 18: "7 3 0 2 3 1 -1" cannot be read as a face' in refusal(path)


def test_binary_ply(tmp_path):
    path = tmp_path / "a.ply"
    text = (
        ply(FOUR, ["4 0 1 2 3"])
        .partition("end_header\n")[0]
        .replace("ascii", "binary_little_endian")
    )
    data = np.array(POINTS, "<f4").tobytes() + struct.pack("<B4i", 4, 0, 1, 2, 3)
    path.write_bytes(text.encode() + b"end_header\n" + data)
    assert read([path]).source_face.tolist() == [0, 0]
    path.write_bytes(text.encode() + b"end_header\n" + data[:-3])
    assert "1 face rows announced, 0 whole ones found" in refusal(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ply(FOUR, ["3 0 1 2"]).replace("3 0 1 2\n", ""), "a.ply: "),
        (
            ply(FOUR, ["3 0 1 2", "3 0 2 3"]).replace("3 0 2 3\n", ""),
            "cut off",
        ),
        (ply(FOUR, ["3 0 1 2", "3 0 2 4"]), "face 1 refers to vertex 4; PLY counts from 0 to 3"),
        (ply(FOUR, ["3 0 1 -1"]), "face 0 refers to vertex -1"),
        (ply([*FOUR[:3], "0 nan 0"], ["3 0 1 2"]), "vertex 3 is (0, nan, 0)"),
        (ply([*FOUR[:3], "0 x 0"], ["3 0 1 2"]), "damaged, cut off or not PLY"),
        (ply(FOUR, ["3 0 1 2", "3 0 1"]), 'line 15: "3 0 1" cannot be read as a face'),
        (ply(FOUR, ["3 0 1 2", "3 0 1 2 3"]), 'line 15: "3 0 1 2 3" cannot be read as a face'),
        (ply(FOUR, ["3 0 1 2", "4 0 1 2"]), 'line 15: "4 0 1 2" cannot be read as a face'),
        (ply(FOUR, ["3 0 1 2.5"]), 'line 14: "3 0 1 2.5" cannot be read as a face'),
        (ply(FOUR, ["-1 0 1 2"]), "line 14: "),
        (ply(FOUR, []), "no faces in this PLY file (4 vertex)"),
        ("ply\n", "a.ply: "),
        ("nothing\n", "damaged, cut off or not PLY (trimesh: Not a ply file!)"),
    ],
)
def test_ply_refusals(tmp_path, text, message):
    path = tmp_path / "a.ply"
    path.write_text(text)
    assert message in refusal(path)


LAST = "property float w\n"
RING = "property list uchar int vertex_indices\n"


def binary_ply(sign: str, before: str, after: str, faces: list[bytes], tail: bytes = b"") -> bytes:
    text = ply(FOUR, ["face"] * len(faces)).partition("end_header\n")[0]
    order = {"<": "little", ">": "big"}[sign]
    text = text.replace("ascii", f"binary_{order}_endian").replace(RING, before + RING + after)
    data = np.array(POINTS, sign + "f4").tobytes() + b"".join(faces) + tail
    return text.encode() + b"end_header\n" + data


@pytest.mark.parametrize("sign", ["<", ">"])
@pytest.mark.parametrize(
    ("before", "after", "head", "tail"),
    [
        ("", "", b"", b""),
        ("property ushort flags\n", "property uchar red\n", b"\1\2", b"\3"),
        ("property list uchar float texcoord\n", "", b"\1" + b"\0" * 4, b""),
        ("", "property list uchar short more\n", b"", b"\0"),
    ],
)
def test_binary_ply_with_faces_of_different_sizes(tmp_path, sign, before, after, head, tail):
    rings = [(0, 1, 2, 3), (0, 1, 2), (), (0, 2, 3)]
    faces = [head + struct.pack(f"{sign}B{len(ring)}i", len(ring), *ring) + tail for ring in rings]
    path = tmp_path / "a.ply"
    path.write_bytes(binary_ply(sign, before, after, faces, b"more"))
    mesh = read([path])
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3]]
    assert mesh.source_face.tolist() == [0, 0, 1, 3]
    assert mesh.positions.tolist() == [list(map(float, p)) for p in POINTS]
    whole = binary_ply(sign, before, after, faces)
    for end in range(1, len(whole)):
        path.write_bytes(whole[:end])
        refusal(path)


def test_binary_ply_with_elements_around_the_faces(tmp_path):
    text = """ply\r
format binary_little_endian 1.0\r
comment element vertex 7\r
element strip 2\r
property list int uchar of\r
element vertex 4\r
property double x\r
property uchar red\r
property double y\r
property double z\r
element face 1\r
property list uint8 uint32 vertex_index\r
element edge 9\r
property int a\r
end_header\r
"""
    data = struct.pack("<iBBiB", 2, 7, 7, 1, 7)
    data += b"".join(struct.pack("<dBdd", x, 9, y, z) for x, y, z in POINTS)
    path = tmp_path / "a.ply"
    path.write_bytes(text.encode() + data + struct.pack("<B3I", 3, 0, 2, 3))
    mesh = read([path])
    assert mesh.faces.tolist() == [[0, 2, 3]]
    assert mesh.notes == ("a.ply: 2 strip elements not read", "a.ply: 9 edge elements not read")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"property float z", b"property float w", "a vertex has no x, y and z"),
        (b"property float z", b"property long z", 'the header line "property long z"'),
        (b"list uchar int", b"list float int", 'the header line "property list float int'),
        (b"list uchar int", b"list char int", "a list of length -1 in face 1"),
        (b"property list uchar int", b"property int", "faces without a list of vertices"),
        (b"element face 2", b"element face -2", 'the header line "element face -2"'),
        (b"element face 2", b"element face 9", "9 face rows announced, 2 whole ones found"),
        (b"element face 2", b"element face 0", "no faces in this PLY file (4 vertex)"),
        (b"element vertex 4", b"element vertex 400", "vertices end too early"),
        (b"element face 2", b"element vertex 2", "an element that the header lists twice"),
    ],
)
def test_damaged_binary_ply(tmp_path, old, new, message):
    faces = [struct.pack("<B4i", 4, 0, 1, 2, 3), struct.pack("<B3i", 3, 0, 1, 2)]
    data = binary_ply("<", "", "", faces)
    if b"char int" in new:
        data = data.replace(faces[1], b"\xff" + faces[1][1:])
    if b"vertex 2" in new:
        data = data.replace(b"element face", b"element face 2\nelement face")
    assert old in data
    path = tmp_path / "a.ply"
    path.write_bytes(data.replace(old, new))
    assert message in refusal(path)


# --- STL


def solid(name: str, n: int = 1) -> str:
    facet = "facet normal 0 0 1\n outer loop\n vertex 0 0 0\n vertex 1 0 0\n vertex 1 1 0\n"
    return f"solid {name}\n" + (facet + " endloop\nendfacet\n") * n + f"endsolid {name}\n"


def test_ascii_stl(tmp_path):
    path = tmp_path / "a.stl"
    path.write_text(solid("Wall", 2) + solid("Roof"))
    mesh = read([path])
    assert mesh.object_names == ("Wall", "Roof")
    assert mesh.object_face_start.tolist() == [0, 2, 3]
    assert mesh.source_face.tolist() == [0, 1, 2]


def binary_stl(points: list[tuple[float, ...]]) -> bytes:
    triangle = struct.pack("<12f", 0, 0, 1, *(c for p in points for c in p)) + b"\0\0"
    return b"solid in a binary header".ljust(80, b"\0") + struct.pack("<I", 1) + triangle


def test_binary_stl(tmp_path):
    path = tmp_path / "a.STL"
    path.write_bytes(binary_stl(POINTS[:3]))
    mesh = read([path])
    assert mesh.object_names == ("a",)
    assert mesh.positions.tolist() == [list(map(float, p)) for p in POINTS[:3]]
    assert mesh.sources[0].format == "stl"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (binary_stl(POINTS[:3])[:-1], "a binary STL file of 1 triangles has 134 bytes"),
        (binary_stl([(0, 0, 0), (1, 0, 0), (np.inf, 1, 0)]), "vertex 2 is (inf, 1, 0)"),
        (b"short", "too short"),
        (b"0" * 200, "not an STL file or cut off: text that does not begin with"),
        (b"\0" * 80 + b"0" * 90, "not an STL file or cut off: a binary STL file of 808464432"),
        (b"solid a\nendsolid a\n", "no triangles"),
        ((solid("a") + solid("b")[:-20]).encode(), 'damaged or cut off: 2 "outer loop", but 1'),
        (solid("a").replace("1 1 0", "1 x 0").encode(), "damaged, cut off or not STL"),
    ],
)
def test_stl_refusals(tmp_path, data, message):
    path = tmp_path / "a.stl"
    path.write_bytes(data)
    assert message in refusal(path)


# --- glTF


def gltf(
    nodes: list[dict], primitive: dict | None = None, points=POINTS, indices=(0, 1, 2)
) -> dict:
    blob = np.array(points, "<f4").tobytes()
    n = len(blob)
    blob += np.array(indices, "<u2").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": [
            {
                "name": "M",
                "primitives": [{"attributes": {"POSITION": 0}, "indices": 1, **(primitive or {})}],
            }
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": len(indices), "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": n},
            {"buffer": 0, "byteOffset": n, "byteLength": len(blob) - n},
        ],
        "buffers": [{"byteLength": len(blob), "uri": uri}],
    }


def write_gltf(path: Path, tree: dict) -> Path:
    path.write_text(json.dumps(tree))
    return path


def test_gltf_is_turned_to_z_up(tmp_path):
    path = write_gltf(
        tmp_path / "a.gltf", gltf([{"mesh": 0}], points=[(1, 2, 3), (4, 5, 6), (7, 8, 0)])
    )
    mesh = read([path])
    assert mesh.positions.tolist() == [[1, -3, 2], [4, -6, 5], [7, 0, 8]]
    assert mesh.faces.tolist() == [[0, 1, 2]]
    assert mesh.object_names == ("M",)
    assert mesh.notes == (f"{path.name}: y up was turned to z up: (x, y, z) -> (x, -z, y)",)


def test_gltf_instances_and_transforms(tmp_path):
    half = 0.5**0.5
    nodes = [
        {"children": [1, 2, 3], "translation": [10, 0, 0]},
        {"name": "A", "mesh": 0, "scale": [2, 2, 2]},
        {"name": "B", "mesh": 0, "rotation": [0, 0, half, half], "camera": 0},
        {"name": "C", "mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]},
    ]
    mesh = read([write_gltf(tmp_path / "a.gltf", gltf(nodes))])
    assert mesh.object_names == ("A", "B", "C")
    assert mesh.object_face_start.tolist() == [0, 1, 2, 3]
    assert mesh.source_face.tolist() == [0, 1, 2]
    a, b, c = mesh.positions[mesh.faces]
    assert a.tolist() == [[10, 0, 0], [12, 0, 0], [12, 0, 2]]
    assert np.allclose(b, [[10, 0, 0], [10, 0, 1], [9, 0, 1]])
    assert c.tolist() == [[9, 0, 1], [9, 0, 0], [10, 0, 0]]  # mirrored: turned round


@pytest.mark.parametrize(
    ("mode", "triangles"),
    [
        (4, [[0, 1, 2]]),
        (5, [[0, 1, 2], [2, 1, 3]]),
        (6, [[0, 1, 2], [0, 2, 3]]),
    ],
)
def test_gltf_modes(tmp_path, mode, triangles):
    tree = gltf([{"mesh": 0}], {"mode": mode}, indices=(0, 1, 2, 3))
    mesh = read([write_gltf(tmp_path / "a.gltf", tree)])
    expected = np.array(triangles)
    assert [sorted(t) for t in mesh.faces.tolist()] == [sorted(t) for t in triangles]
    normals = [np.cross(p[1] - p[0], p[2] - p[0]) for p in mesh.positions[mesh.faces]]
    if mode == 6:
        assert all(np.allclose(normal, normals[0]) for normal in normals)
    assert len(expected) == len(mesh.faces)


def test_gltf_points_and_lines_are_noted(tmp_path):
    tree = gltf([{"mesh": 0}])
    for mode in (0, 1, 3):
        tree["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "mode": mode})
    notes = read([write_gltf(tmp_path / "a.gltf", tree)]).notes
    assert [note.partition(": ")[2] for note in notes[1:]] == [
        "1 point set left out",
        "2 line sets left out",
    ]


def test_gltf_takes_the_vertices_it_needs_from_a_large_accessor(tmp_path):
    points = [*POINTS, *POINTS, (5, 0, 0), (6, 0, 0), (6, 1, 0)]
    mesh = read([write_gltf(tmp_path / "a.gltf", gltf([{"mesh": 0}], None, points, (10, 9, 8)))])
    assert mesh.positions[mesh.faces].tolist() == [[[6, 0, 1], [6, 0, 0], [5, 0, 0]]]
    assert len(mesh.positions) == 3


def test_glb_equals_gltf(tmp_path):
    tree = gltf([{"mesh": 0}])
    blob = base64.b64decode(tree["buffers"][0].pop("uri").partition(",")[2])
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    body += struct.pack("<II", len(blob), 0x004E4942) + blob
    path = tmp_path / "a.glb"
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    assert read([path]).faces.tolist() == [[0, 1, 2]]
    for end in range(1, 12 + len(body), 7):
        path.write_bytes((struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)[:end])
        refusal(path)


def test_gltf_digest_covers_the_buffers_beside_it(tmp_path):
    tree = gltf([{"mesh": 0}])
    blob = base64.b64decode(tree["buffers"][0]["uri"].partition(",")[2])
    inline = write_gltf(tmp_path / "a.gltf", tree)
    assert read([inline]).sources[0].sha256 == hashlib.sha256(inline.read_bytes()).hexdigest()
    tree["buffers"] = [
        {"byteLength": 48, "uri": "a%20b.bin"},
        {"byteLength": 99, "uri": "image.bin"},
        {"byteLength": 6, "uri": "indices.bin"},
    ]
    tree["bufferViews"][1] = {"buffer": 2, "byteLength": 6}
    (tmp_path / "a b.bin").write_bytes(blob[:48])
    (tmp_path / "indices.bin").write_bytes(blob[48:])
    path = write_gltf(tmp_path / "a.gltf", tree)
    expected = hashlib.sha256(path.read_bytes() + blob).hexdigest()
    assert read([path]).sources[0].sha256 == expected
    (tmp_path / "a b.bin").write_bytes(np.array(POINTS[::-1], "<f4").tobytes())
    assert read([path]).sources[0].sha256 != expected


@pytest.mark.parametrize(
    ("component", "dtype", "normalized", "unit"),
    [
        (5120, "<i1", True, 127),
        (5121, "<u1", True, 255),
        (5122, "<i2", True, 32767),
        (5123, "<u2", True, 65535),
        (5122, "<i2", False, 1),
        (5121, "<u1", False, 1),
    ],
)
def test_gltf_quantised_positions(tmp_path, component, dtype, normalized, unit):
    tree = gltf([{"mesh": 0, "scale": [2, 2, 2]}])
    low = -unit if "i" in dtype else 0
    points = np.zeros((4, 4), dtype)  # rows padded to four components
    points[:, :3] = np.array([(0, 0, 0), (unit, 0, 0), (unit, unit, low), (0, unit, 0)])
    blob = points.tobytes()
    uri = "data:;base64," + base64.b64encode(blob).decode()
    tree["buffers"].append({"byteLength": len(blob), "uri": uri})
    tree["bufferViews"][0] = {
        "buffer": 1,
        "byteLength": len(blob),
        "byteStride": 4 * points.itemsize,
    }
    tree["accessors"][0] |= {"componentType": component, "normalized": normalized}
    tree["extensionsUsed"] = tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    mesh = read([write_gltf(tmp_path / "a.gltf", tree)])
    assert mesh.positions[:3].tolist() == [[0, 0, 0], [2, 0, 0], [2, 2 if low else 0, 2]]


def test_gltf_notes_what_moves_its_vertices(tmp_path):
    tree = gltf([{"mesh": 0}, {"mesh": 0}], {"targets": [{"POSITION": 0}]})
    tree["scenes"] = [{"nodes": [0, 1]}]
    tree["extensionsRequired"] = ["CESIUM_RTC", "KHR_materials_unlit", "EXT_texture_webp"]
    tree["extensions"] = {"CESIUM_RTC": {"center": [1, 2, 3]}}
    mesh = read([write_gltf(tmp_path / "a.gltf", tree)])
    assert mesh.notes[1:] == (
        "a.gltf: morph targets are not applied: 1 mesh with them read as without",
    )
    assert mesh.positions[0].tolist() == [1, 2, 3]


def changed(key: str, value: object) -> dict:
    tree = gltf([{"mesh": 0}])
    target: object = tree
    *path, last = key.split("/")
    for part in path:
        target = target[int(part) if part.isdigit() else part]  # type: ignore[index]
    target[int(last) if last.isdigit() else last] = value  # type: ignore[index]
    return tree


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (
            gltf([{"mesh": 0}], indices=(0, 1, 4)),
            "1 index past the end (first 4), but it has only 4",
        ),
        (
            gltf([{"mesh": 0}], points=[(0, np.nan, 0), *POINTS]),
            'object "M", primitive 0: vertex 0 is',
        ),
        (
            gltf([{"mesh": 0, "scale": [1e999, 1, 1]}]),
            "node 0 is placed by a transform that is not finite",
        ),
        (gltf([{"children": [0], "mesh": 0}]), "node 0 is reached twice"),
        (gltf([{}]), "no triangles in it (y up was turned"),
        (gltf([{"mesh": 0}], {"mode": 0}), "1 point set left out"),
        (gltf([{"mesh": 7}]), "the glTF structure is damaged (IndexError"),
        (gltf([{"mesh": -1}]), "the glTF structure is damaged (ValueError: -1 is not an index"),
        (changed("accessors/0/count", 99), "accessor 0 reads past the end of its buffer"),
        (changed("accessors/0/sparse", {}), "damaged (KeyError: 'count')"),
        (changed("buffers/0/uri", "no.bin"), "no.bin cannot be read: No such file"),
        (changed("buffers/0/uri", "https://x/y.bin"), "download it first"),
        (changed("asset", {"version": "1.0"}), "glTF version 1.0; version 2 is read"),
        (changed("extensionsUsed", ["EXT_meshopt_compression"]), "meshopt-compressed"),
        (
            changed("extensionsRequired", ["KHR_materials_unlit", "FB_geometry", "MSFT_lod"]),
            "it requires FB_geometry, MSFT_lod, which is not read and may change its geometry",
        ),
        (
            changed("accessors/1/componentType", 5120),
            "of componentType 5120, but indices are SCALAR",
        ),
        (
            changed("accessors/1/componentType", 5126),
            "of componentType 5126, but indices are SCALAR",
        ),
        (changed("accessors/1/type", "VEC3"), "accessor 1 holds no indices: its type is VEC3"),
        (
            changed("accessors/0/type", "VEC4"),
            'object "M", primitive 0: its positions are not VEC3',
        ),
        (changed("scene", -1), "-1 is not an index"),
        (changed("scene", True), "True is not an index"),
        (changed("scene", 1), "it starts from scene 1, but has 1 scene"),
        (changed("accessors/0/count", 10**15), "accessor 0 reads past the end of its buffer"),
        (changed("bufferViews/0/byteStride", 10**30), "accessor 0 reads past the end"),
        (
            changed("accessors/0", {"componentType": 5126, "count": 10**15, "type": "VEC3"}),
            "accessor 0 has no bufferView",
        ),
        (
            changed("accessors/1", {"componentType": 5123, "count": 3, "type": "SCALAR"}),
            "accessor 1 has no bufferView",
        ),
        (
            gltf([{"mesh": 0, "scale": [1e308] * 3}], points=[(9, 9, 9), *POINTS]),
            'object "M", primitive 0, placed by its nodes: vertex 0 is (inf, -inf, inf)',
        ),
        (gltf([{"mesh": 0, "rotation": [0, 0, 0, 0]}]), "placed by a transform that is not finite"),
        (gltf([{"mesh": 0, "matrix": [10**400] * 16}]), "damaged (OverflowError"),
        (changed("scenes/0/nodes", [0, 0]), "node 0 is reached twice"),
        (gltf([{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}]), "node 2 is reached twice"),
        (
            {k: v for k, v in gltf([{"mesh": 0}, {"children": [1]}]).items() if "scene" not in k},
            "node 1 is, or lies below, its own parent",
        ),
        (gltf([{"mesh": 0, "name": "x\ny" + "z" * 999}], points=[(np.inf, 0, 0)]), 'object "x yzz'),
        ({"a": 1}, 'the JSON has no "asset"'),
    ],
)
def test_gltf_refusals(tmp_path, tree, message):
    path = write_gltf(tmp_path / "a.gltf", tree)
    assert message in refusal(path)
    assert len(refusal(path)) < 700


def test_gltf_that_is_nested_too_deeply(tmp_path):
    path = tmp_path / "a.gltf"
    path.write_text('{"asset": ' + "[" * 100_000)
    assert "not glTF: " in refusal(path)


def test_gltf_chain_of_very_many_nodes(tmp_path):
    n = 100_000
    nodes = [{"children": [i + 1]} for i in range(n)]
    nodes[0]["translation"] = [5, 0, 0]
    path = write_gltf(tmp_path / "a.gltf", gltf([*nodes, {"mesh": 0}]))
    start = time.perf_counter()
    mesh = read([path])
    assert time.perf_counter() - start < 10  # 0.2 s; the square of n would take minutes
    assert mesh.positions[0].tolist() == [5, 0, 0]


def test_gltf_names_are_made_encodable(tmp_path):
    tree = gltf([{"mesh": 0, "name": "\ud800x\0" + "y" * 500}])
    (name,) = read([write_gltf(tmp_path / "a.gltf", tree)]).object_names
    assert name == "\ufffdx\ufffd" + "y" * 500


def test_gltf_buffer_that_is_a_device(tmp_path):
    (tmp_path / "zero.bin").symlink_to("/dev/zero")
    path = write_gltf(tmp_path / "a.gltf", changed("buffers/0/uri", "zero.bin"))
    assert "zero.bin is a device, not a file" in refusal(path)


# --- files by others


@pytest.mark.parametrize(
    ("name", "n_triangles", "n_objects"),
    [
        ("broken/no_indices_3storybuilding.glb", 72, 3),
        ("broken/multibody.stl", 32, 2),
        ("broken/bunny.ply", 16301, 1),
        ("broken/degtri_sliding.off", 8, 1),
        ("readers/Spider_ascii.stl", 1368, 1),
        ("readers/Spider_binary.stl", 1368, 1),
        ("readers/Wuson.ply", 3732, 1),
        ("cities/amsterdam_station.glb", 10483, 249),
        ("cities/openfoam_terrain.stl.gz", 21186, 1),
    ],
)
def test_shared_files(name, n_triangles, n_objects):
    mesh = read([shared(name)])
    assert (len(mesh.faces), len(mesh.object_names)) == (n_triangles, n_objects)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("readers/BoxWithInfinites.glb", "not a finite position"),
        ("readers/IndexOutOfRange/IndexOutOfRange.gltf", "past the end"),
        ("readers/IndexOutOfRange/AllIndicesOutOfRange.gltf", "36 indices past the end"),
        ("readers/issue623.ply", "no faces"),
        ("readers/index0.obj", "line 9: face refers to vertex 0"),
        ("readers/index901.obj", "line 11: face refers to vertex 9"),
        ("readers/number_formats.obj", 'line 11: "3.1+e2"'),
    ],
)
def test_shared_refusals(name, message):
    assert message in refusal(shared(name))
