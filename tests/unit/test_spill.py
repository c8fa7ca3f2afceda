"""Reading with tables in files gives what reading in memory gives."""

from __future__ import annotations

import dataclasses
import gzip
import mmap
from pathlib import Path

import numpy as np
import pytest
import trimesh

from svprep.errors import EnvironmentProblem, InputError
from svprep.ingest import obj, read
from svprep.ingest.file_bytes import Text
from svprep.ingest.options import ReadOptions
from svprep.ingest.spill import Column, Spill, empty_table, is_spilled, release, row_blocks, spilled
from svprep.ingest.text_blocks import Buffers, text_blocks
from svprep.model import SourceMesh

DATA = Path(__file__).resolve().parents[2] / "data"
TABLES = ("positions", "faces", "source_face", "surface_of_polygon")


@pytest.fixture
def spill(tmp_path):
    folder = tmp_path / "spill"
    folder.mkdir()
    return Spill(folder, 1 << 40)


def town(seed: int, n: int = 60) -> str:
    """Objects that come back, relative and forward indices, quads, n-gons, short faces, lines."""
    rng = np.random.default_rng(seed)
    lines, n_vertices = ["# a town"], 0
    for i in range(n):
        lines.append(f"o B{rng.integers(9)}" if i % 7 else "usemtl brick")
        x, y, z = (round(float(c), 3) for c in rng.uniform(-500, 500, 3))
        for k, (u, v) in enumerate([(0, 0), (4, 0), (6, 2), (4, 3), (0, 3)]):
            lines.append(f"v {x + u} {y + v} {z + 0.1 * (k % 2)}{'1' * int(rng.integers(19))}")
        a = n_vertices + 1
        n_vertices += 5
        lines += [
            f"f {a} {a + 1} {a + 2}",
            "f -5 -4 -3 \\",
            " -2",
            f"f {a} {a + 1} {a + 2} {a + 4}",
        ]
        lines += ["f -1/1 -2/2 -3/3 -4/4 -5/5", f"f {a} {a} {a + 1}", "l 1 2", "f 1 2 300"]
    return "\n".join(lines)


def same(one: SourceMesh, other: SourceMesh) -> None:
    for field in dataclasses.fields(SourceMesh):
        a, b = getattr(one, field.name), getattr(other, field.name)
        pairs = [(a, b)]
        if field.name == "face_findings":
            pairs = [(getattr(a, name), getattr(b, name)) for name in a.__slots__]
        for x, y in pairs:
            if isinstance(x, np.ndarray):
                assert (x.dtype, x.shape) == (y.dtype, y.shape), field.name
                assert x.tobytes() == y.tobytes(), field.name
                assert y.flags.c_contiguous
                assert y.flags.writeable
            else:
                assert x == y, field.name


def tiny(monkeypatch: pytest.MonkeyPatch, chunk_bytes: int) -> None:
    monkeypatch.setattr(obj, "CHUNK_BYTES", chunk_bytes)
    monkeypatch.setattr(obj, "_MOST_CORNERS", 50)
    monkeypatch.setitem(row_blocks.__kwdefaults__, "rows", 7)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("chunk_bytes", [64, 1000, 1 << 20])
def test_obj(tmp_path, monkeypatch, spill, seed, chunk_bytes):
    paths = [tmp_path / "a.obj", tmp_path / "b.obj.gz"]
    paths[0].write_text(town(seed))
    paths[1].write_bytes(gzip.compress(town(seed + 10).replace("\n", "\r\n").encode()))
    for inputs in (paths[:1], paths[1:], paths):
        whole = read(inputs)
        assert (np.diff(whole.object_face_start) > 0).all()
        assert len(whole.face_findings.code)
        with monkeypatch.context() as patch:
            tiny(patch, chunk_bytes)
            found = read(inputs, spill=spill)
        same(whole, found)
        assert all(is_spilled(getattr(found, name)) for name in TABLES)
        assert not list(spill.folder.iterdir())


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ("f 1 2 9999", "face refers to vertex 9999, but only 300 vertices are defined in the file"),
        ("f 1 2 -301", "vertex -301, but only 300 vertices are defined before it"),
        ("f 1 2 x", '"x" in a face'),
        ("v 1 2 1e999", '"1e999" in a vertex (v) is not a finite'),
        ("v 1 2", "a vertex (v) with 2 numbers"),
    ],
)
@pytest.mark.parametrize("suffix", ["", ".gz"])
def test_refusals_name_the_same_line(tmp_path, monkeypatch, spill, bad, message, suffix):
    text = f"{town(1)}\n{bad}\nf 1 2 3\nf 1 2 8888\n"
    path = tmp_path / f"a.obj{suffix}"
    path.write_bytes(gzip.compress(text.encode()) if suffix else text.encode())
    with pytest.raises(InputError) as whole:
        read([path])
    tiny(monkeypatch, 200)
    with pytest.raises(InputError) as blockwise:
        read([path], spill=spill)
    assert str(whole.value) == str(blockwise.value)
    assert f"line {town(1).count(chr(10)) + 2}: " in str(whole.value)
    assert message in str(whole.value)


def test_the_first_of_two_bad_statements_is_named_wherever_blocks_end(tmp_path, monkeypatch):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 0 0 1e999\nv 0 0 x\n")
    for chunk_bytes in (4, 1 << 20):
        monkeypatch.setattr(obj, "CHUNK_BYTES", chunk_bytes)
        with pytest.raises(InputError, match=r"line 2: .*1e999"):
            read([path])


def test_other_formats_and_options(tmp_path, monkeypatch, spill):
    scene = trimesh.Scene()
    for i in range(3):
        box = trimesh.creation.box(
            (4, 4, 9), trimesh.transformations.translation_matrix([9 * i, 0, 0])
        )
        scene.add_geometry(box, geom_name=f"box {i}", node_name=f"box {i}")
    scene.export(tmp_path / "boxes.glb")
    inputs = [[DATA / "hamlet.city.json"], [tmp_path / "boxes.glb"], [DATA / "small_city.obj.gz"]]
    options = [ReadOptions(), ReadOptions(has_terrain=False, has_openings=False)]
    inputs.append([*inputs[0], *inputs[2]])
    whole = [[read(paths, options=option) for paths in inputs] for option in options]
    tiny(monkeypatch, 100_000)
    monkeypatch.setitem(row_blocks.__kwdefaults__, "rows", 100)
    for option, expected in zip(options, whole, strict=True):
        for paths, mesh in zip(inputs, expected, strict=True):
            same(mesh, read(paths, options=option, spill=spill))


def test_files_in_degrees_are_converted_and_joined(tmp_path, monkeypatch, spill):
    pytest.importorskip("pyproj")
    paths = [tmp_path / f"{name}.obj" for name in "ab"]
    for i, path in enumerate(paths):
        path.write_text(f"v 16.{i}1 48.2 9\nv 16.{i}11 48.2 9\nv 16.{i}1 48.21 9\nf 1 2 3\n")
    option = ReadOptions(crs="EPSG:4326")
    whole = read(paths, options=option)
    tiny(monkeypatch, 20)
    same(whole, read(paths, options=option, spill=spill))


def test_a_file_larger_than_the_memory_allowed_is_remarked_on(tmp_path, spill):
    stl = tmp_path / "a.stl"
    stl.write_bytes(
        bytes(80) + (1).to_bytes(4, "little") + np.eye(4, 3, dtype="<f4").tobytes() + b"\0\0"
    )
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    little = dataclasses.replace(spill, memory_bytes=10)
    # No note: the model is the same.
    assert read([stl, tmp_path / "a.obj"], spill=little).notes == ()
    assert little.remarks == [
        f"{stl} was read whole, which takes 1 MiB of memory at the least, more than the 0 MiB "
        "that were allowed"
    ]
    assert read([stl], spill=Spill(tmp_path, 1 << 30)).notes == ()


def test_columns_in_memory_and_in_files(spill):
    rng = np.random.default_rng(3)
    blocks = [rng.integers(0, 99, (n, 3)) for n in (0, 5, 1, 300, 0, 2)]
    whole = np.concatenate(blocks)
    for where in (None, spill):
        for share in (0.0, 0.5):
            column = Column(np.int32, 3, where)
            for block in blocks:
                column.append(block, share)
            assert len(column) == len(whole)
            table = column.table()
            assert np.array_equal(table, whole)
            assert table.dtype == np.int32
        assert Column(np.float64, 0, where).table().shape == (0,)
        assert Column(np.float64, 3, where).table().shape == (0, 3)


def test_what_is_released_keeps_its_content(spill):
    table = empty_table(np.float64, (5000, 3), spill)
    table[:] = np.arange(15000).reshape(-1, 3)
    for part in (table[100:4000], table[:0], table[::2], table, np.arange(3)):
        release(part)
    assert table.sum() == 15000 * 14999 / 2
    assert isinstance(
        table.base.base.obj if isinstance(table.base.base, memoryview) else table.base.base,
        mmap.mmap,
    )
    assert spilled(table, spill) is table
    assert is_spilled(table[10:20].reshape(-1))
    assert not is_spilled(np.arange(3))


def test_a_folder_without_room_is_told_in_one_line(tmp_path):
    with pytest.raises(
        EnvironmentProblem, match=r"gone: tables .* cannot be written there: No such"
    ):
        Column(np.int32, 0, Spill(tmp_path / "gone", 1))


@pytest.mark.parametrize("end", ["\n", "\r", "\r\n", ""])
def test_blocks_are_whole_statements(end):
    lines = ["v 1 2 3", "f 1 \\", " 2 3", "", "# x \\", "o a", "\\", "\\", "x" * 90, "v 3 4 5"]
    text = (end or "\n").join(lines) + end
    for block_bytes in (1, 2, 3, 7, 16, 50, 1000):
        buffers, found = Buffers(), []
        for block in text_blocks(Text(Path("a"), len(text), text.encode()), block_bytes, buffers):
            found.append(block.data[: block.n_bytes].tobytes().decode())
            assert block.data[block.n_bytes] == 10
            buffers.give_back(block.data)
        assert "".join(found).rstrip() == text.rstrip()
        for part in found[:-1]:
            assert part.endswith(("\n", "\r"))
            assert not part.rstrip().endswith("\\")
            assert not part.endswith("\r") or end == "\r"
        assert len(found) > 1 or block_bytes > 50


def test_a_file_that_changes_while_it_is_read(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\n" * 10)
    text = Text.of(path)
    path.write_text("v 0 0 0\n" * 9)
    with pytest.raises(InputError, match="cannot be read: it changed while it was read"):
        list(text_blocks(text, 16, Buffers()))
