"""Silhouettes written as lines: read back by other readers, oriented, exact, safe."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svprep.errors import EnvironmentProblem, InputError
from svprep.ingest import read
from svprep.light import parse_light
from svprep.model import Prepared
from svprep.pipeline import BuildConfig, prepare
from svprep.silhouette import Silhouette, silhouette
from svprep.silhouette.lines import (
    LINES,
    Lines,
    silhouette_lines,
    write_lines,
)

ROOT = Path(__file__).resolve().parents[2]
CUBE = ROOT / "data" / "conformance" / "clean_cube.obj"
CITY = ROOT / "data" / "small_city.obj.gz"
FAR = np.array([390_000.25, 5_820_000.5, -7.125])
PLY_TYPES = {"double": "<f8", "int": "<i4", "uint": "<u4", "char": "i1"}


def cube_at(folder: Path, origin: np.ndarray = FAR) -> Prepared:
    """Return the unit cube moved to `origin`."""

    def moved(match: re.Match) -> str:
        return "v {!r} {!r} {!r}".format(*(np.array(match[1].split(), float) + origin).tolist())

    path = folder / "cube.obj"
    path.write_text(re.sub(r"^v (.*)$", moved, CUBE.read_text(), flags=re.M))
    return prepare(read([path]), BuildConfig())


def ask(city: Prepared, spec: str, **options) -> Silhouette:
    return silhouette(city, parse_light(spec).in_cache_frame(city.mesh.grid), **options)


def lines_of(city: Prepared, spec: str, **options) -> Lines:
    return silhouette_lines(ask(city, spec, **options), city)


def segments(lines: Lines) -> set[tuple]:
    """Return ``{((x, y, z), (x, y, z)), ...}``: where each line begins and ends."""
    return {tuple(map(tuple, ends)) for ends in lines.positions[lines.vertices].tolist()}


def read_ply(path: Path) -> tuple[list[str], dict[str, np.ndarray]]:
    """Return comments and elements of a binary PLY file, by its own header."""
    header, _, data = path.read_bytes().partition(b"end_header\n")
    statements = header.decode("ascii").splitlines()
    assert statements[:2] == ["ply", "format binary_little_endian 1.0"]
    elements: list[tuple[str, int, list]] = []
    for words in (line.split() for line in statements[2:]):
        if words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property":
            elements[-1][2].append((words[2], PLY_TYPES[words[1]]))
    at, arrays = 0, {}
    for name, count, fields in elements:
        arrays[name] = np.frombuffer(data, np.dtype(fields), count, at)
        at += arrays[name].nbytes
    assert at == len(data)
    return [line[8:] for line in statements if line.startswith("comment ")], arrays


def read_obj(path: Path) -> dict[bytes, list[tuple]]:
    """Return the segments of each object of an OBJ file."""
    vertices: list[tuple] = []
    found: dict[bytes, list[tuple]] = {}
    for line in path.read_bytes().splitlines():
        kind, _, rest = line.partition(b" ")
        if kind == b"o":
            current = found.setdefault(rest, [])
        elif kind == b"v":
            vertices.append(tuple(map(float, rest.split())))
        elif kind == b"l":
            current.append(tuple(vertices[int(i) - 1] for i in rest.split()))
        else:
            assert kind == b"#"
    return found


@pytest.fixture(scope="module")
def city() -> Prepared:
    return prepare(read([CITY]), BuildConfig())


def test_the_outline_of_a_cube_runs_clockwise_seen_from_the_light(tmp_path: Path) -> None:
    x, y, z = FAR.tolist()
    corner = [(x, y, z + 1), (x + 1, y, z + 1), (x + 1, y + 1, z + 1), (x, y + 1, z + 1)]
    clockwise = {(corner[i], corner[i - 1]) for i in range(4)}
    cube = cube_at(tmp_path)
    assert segments(lines_of(cube, "dir:0,90", volume="closed")) == clockwise
    # Robust: the lower face, turned to the light, has the same outline.
    lower = {tuple((px, py, pz - 1) for px, py, pz in line) for line in clockwise}
    assert segments(lines_of(cube, "dir:0,90", volume="robust")) == clockwise | lower


@pytest.mark.parametrize(("volume", "times"), [("closed", 1), ("robust", 2)])
def test_a_cube_lit_from_a_corner_has_six_lines(tmp_path: Path, volume: str, times: int) -> None:
    # The light is above, east and south: corners (1, 0, 1) and (0, 1, 0) are inside
    # the outline, and the hexagon of the six others runs clockwise seen from there.
    hexagon = [(0, 0, 0), (0, 0, 1), (0, 1, 1), (1, 1, 1), (1, 1, 0), (1, 0, 0)]
    place = [tuple((np.array(p) + FAR).tolist()) for p in hexagon]
    lines = lines_of(cube_at(tmp_path), "dir:135,40", volume=volume)
    assert segments(lines) == {(place[i - 1], place[i]) for i in range(6)}
    assert np.abs(lines.multiplicity).tolist() == [times] * 6
    assert len(lines.positions) == 6
    assert lines.object.tolist() == [0] * 6


def test_a_point_light_is_told_in_source_coordinates(tmp_path: Path) -> None:
    x, y, z = FAR.tolist()
    lines = lines_of(cube_at(tmp_path), f"point:{x + 0.5!r},{y + 0.5!r},{z + 9!r}")
    assert lines.light.tolist() == [x + 0.5, y + 0.5, z + 9, 1.0]
    assert len(segments(lines)) == 4
    sun = lines_of(cube_at(tmp_path), "dir:90,0")
    assert sun.light.tolist() == [1.0, 0.0, 0.0, 0.0]


def test_every_format_says_the_same(city: Prepared, tmp_path: Path) -> None:
    lines = lines_of(city, "dir:135,40")
    assert len(lines.edge) > 10_000
    for suffix in LINES.suffixes:
        assert write_lines(lines, tmp_path / f"a{suffix}") == tmp_path / f"a{suffix}"
    expected = lines.positions[lines.vertices]

    comments, ply = read_ply(tmp_path / "a.ply")
    positions = np.stack([ply["vertex"][axis] for axis in "xyz"], axis=1)
    edge = ply["edge"]
    ends = np.stack([edge["vertex1"], edge["vertex2"]], axis=1)
    assert np.array_equal(positions[ends], expected)
    assert np.array_equal(edge["multiplicity"], lines.multiplicity)
    assert np.array_equal(edge["object"], lines.object)
    assert any(text.startswith("light ") for text in comments)

    with np.load(tmp_path / "a.npz") as npz:
        assert np.array_equal(npz["positions"][npz["vertices"]], expected)
        for name in ("edge", "multiplicity", "vertices", "positions", "object", "light"):
            assert npz[name].dtype == getattr(lines, name).dtype
            assert np.array_equal(npz[name], getattr(lines, name))
        assert tuple(npz["object_names"].tolist()) == city.object_names
        assert str(npz["method"]) == lines.method

    by_name = read_obj(tmp_path / "a.obj")
    for i in np.unique(lines.object).tolist():
        here = [tuple(map(tuple, e)) for e in expected[lines.object == i].tolist()]
        assert by_name.pop(city.object_names[i].encode()) == here
    assert by_name == {}


def test_the_lines_are_the_records_and_the_vertices_are_all_in_use(city: Prepared) -> None:
    found = ask(city, "point:10,20,60")
    lines = silhouette_lines(found, city)
    rows = city.edges.rows[found.edge]
    v0, v1 = (city.mesh.positions[rows[:, i]] + city.mesh.grid.origin_m for i in (0, 1))
    is_forward = (found.multiplicity < 0)[:, None]
    begin, end = (lines.positions[lines.vertices[:, i]] for i in (0, 1))
    assert np.array_equal(begin, np.where(is_forward, v0, v1))
    assert np.array_equal(end, np.where(is_forward, v1, v0))
    assert np.array_equal(np.unique(lines.vertices), np.arange(len(lines.positions)))
    owner = np.searchsorted(city.mesh.object_face_start, np.minimum(*rows[:, 2:].T), "right") - 1
    assert np.array_equal(lines.object, owner)


def test_only_the_objects_that_were_asked_for(city: Prepared, tmp_path: Path) -> None:
    tower, tree = (city.object_names.index(name) for name in ("tower_0000", "tree_0001"))
    lines = lines_of(city, "dir:135,40", objects=[tower, tree])
    assert set(lines.object.tolist()) == {tower, tree}
    write_lines(lines, tmp_path / "two.obj")
    assert list(read_obj(tmp_path / "two.obj")) == sorted(
        [b"tower_0000", b"tree_0001"], key=lambda n: city.object_names.index(n.decode())
    )


@pytest.mark.parametrize("suffix", LINES.suffixes)
def test_a_silhouette_of_nothing_is_a_file_of_no_lines(
    city: Prepared, tmp_path: Path, suffix: str
) -> None:
    lines = lines_of(city, "dir:135,40", objects=np.zeros(0, np.int64))
    path = write_lines(lines, tmp_path / f"none{suffix}")
    if suffix == ".ply":
        assert [len(a) for a in read_ply(path)[1].values()] == [0, 0]
    elif suffix == ".obj":
        assert read_obj(path) == {}
    else:
        assert np.load(path)["vertices"].shape == (0, 2)


@pytest.mark.parametrize("suffix", LINES.suffixes)
def test_the_same_lines_give_the_same_bytes(city: Prepared, tmp_path: Path, suffix: str) -> None:
    lines = lines_of(city, "dir:135,40")
    path = write_lines(lines, tmp_path / f"a{suffix}")
    before = path.read_bytes()
    assert write_lines(lines, path).read_bytes() == before  # ours may be replaced
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("plain", b"plain"),
        ("two\nf 1 2 3", b"two f 1 2 3"),
        ("joined \\", b"joined"),
        ("\x1b]0;x\x07", b"_]0;x_"),
        ("  caf\xe9 \u2028 1 ", "caf\xe9 1".encode()),
        ("Gr\udcfc\udcdf", b"Gr\xfc\xdf"),
        ("\ud800", b"_"),
        ("", b"object_0"),
        ("\\", b"object_0"),
    ],
)
def test_a_name_stays_on_its_line(tmp_path: Path, name: str, written: bytes) -> None:
    lines = replace(lines_of(cube_at(tmp_path), "dir:135,40"), object_names=(name,))
    path = write_lines(lines, tmp_path / "a.obj")
    assert {name: len(found) for name, found in read_obj(path).items()} == {written: 6}
    write_lines(lines, tmp_path / "a.npz")
    assert np.load(tmp_path / "a.npz")["object_names"].tolist() == [name]


def folder(path: Path) -> None:
    path.mkdir()


def foreign(path: Path) -> None:
    path.write_bytes(b"v 0 0 0\n")


@pytest.mark.parametrize(
    ("name", "make", "error", "says"),
    [
        ("a.txt", None, InputError, ".ply, .obj or .npz"),
        ("a", None, InputError, ".ply, .obj or .npz"),
        ("a.ply/", None, InputError, ".ply, .obj or .npz"),
        ("no/a.ply", None, EnvironmentProblem, "there is no folder"),
        ("a.ply", folder, InputError, "not a regular file"),
        ("a.fifo.ply", os.mkfifo, InputError, "not a regular file"),
        ("a.ply", foreign, InputError, "not a silhouette of svprep"),
        ("a.obj", foreign, InputError, "not a silhouette of svprep"),
        ("a.npz", lambda path: np.savez(path, x=1), InputError, "not a silhouette of svprep"),
        ("city.obj", None, InputError, "an input"),
        ("link.obj", lambda p: p.symlink_to("city.obj"), InputError, "an input"),
    ],
)
def test_what_must_not_be_written_over(
    tmp_path: Path, name: str, make: Callable | None, error: type[Exception], says: str
) -> None:
    (tmp_path / "city.obj").write_bytes(b"# svprep silhouette 1\n")
    if make is not None:
        make(tmp_path / name)
    before = sorted(os.listdir(tmp_path))
    with pytest.raises(error) as refused:
        LINES.checked_path(f"{tmp_path}/{name}", [tmp_path / "city.obj", "gone.h5"])
    assert says in str(refused.value)
    assert sorted(os.listdir(tmp_path)) == before


def test_a_link_is_followed_and_a_failed_write_leaves_the_older_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = lines_of(cube_at(tmp_path), "dir:135,40")
    (tmp_path / "store").mkdir()
    (tmp_path / "a.obj").symlink_to("store/lines.dat")
    write_lines(lines, tmp_path / "a.obj")
    assert (tmp_path / "a.obj").is_symlink()
    before = (tmp_path / "store" / "lines.dat").read_bytes()
    assert before.startswith(b"# svprep silhouette 1\n")

    def full(*_args: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.pwrite", full)
    with pytest.raises(EnvironmentProblem, match="the disk is full"):
        write_lines(lines, tmp_path / "a.obj")
    assert (tmp_path / "store" / "lines.dat").read_bytes() == before
    assert os.listdir(tmp_path / "store") == ["lines.dat"]
