"""Files, folders and patterns: what is read of them, in which order, and what is said."""

from __future__ import annotations

import gzip
import json
import os
from pathlib import Path

import pytest

from svprep import cli
from svprep.errors import InputError
from svprep.ingest import read
from svprep.ingest.inputs import expanded, is_tileset, stem_of
from svprep.ingest.notes import merged_notes
from svprep.ingest.options import ReadOptions
from svprep.pipeline import build, default_cache_path

TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n"
CITY = b'{"type": "CityJSON", "CityObjects": {}}'
TILESET = b'{"asset": {"version": "1.1"}, "geometricError": 1, "root": {}}'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of models and other files, in the current one."""
    monkeypatch.chdir(tmp_path)
    files = {
        "city/b.obj": TRIANGLE,
        "city/a.obj.gz": gzip.compress(TRIANGLE),
        "city/a/z.OBJ": TRIANGLE,
        "city/README.md": b"# hello",
        "city/LICENSE": b"",
        "city/old.svp.h5": b"",
        "city/report.json": b'{\n "sources": [',
        "city/a/c.city.json": CITY,
        "city/a/house.gml": b'<CityModel xmlns="http://www.opengis.net/citygml/2.0"/>',
        "city/a/other.gml": b'<gml:FeatureCollection xmlns:gml="http://www.opengis.net/gml"/>',
        "city/a/pom.xml": b"<project/>",
        "city/a/log.jsonl": b'{"time": 1}\n',
        "city/t/tileset.json": TILESET,
        "city/t/content/0.glb": b"",
    }
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
    return tmp_path / "city"


def test_a_folder_is_every_model_below_it(folder: Path) -> None:
    found = expanded(["city"])
    assert found.paths == (
        "city/a/c.city.json",
        "city/a/house.gml",
        "city/a/z.OBJ",
        "city/a.obj.gz",
        "city/b.obj",
        "city/t",
    )
    (note,) = found.notes
    assert note.startswith("7 files are no models and were left out (")
    for word in (".md 1", "no suffix 1", ".h5 1", ".json 1", ".gml 1", ".xml 1"):
        assert word in note or "(7)" in note
    assert expanded(found.paths) == type(found)(found.paths, ())


def test_a_folder_with_a_tileset_is_one_input(folder: Path) -> None:
    assert expanded(["city/t"]).paths == ("city/t",)
    assert expanded(["city/t/content"]).paths == ("city/t/content/0.glb",)


def test_what_a_folder_is_called_changes_no_note_and_no_digest(folder: Path) -> None:
    for name in ("fa", "fb"):
        Path(name).mkdir()
        Path(name, "a.obj").write_bytes(TRIANGLE)
        Path(name, "README.md").write_bytes(b"# hello")
    given = ("fa", "fa/", "./fa", str(Path("fa").resolve()), "fb", "fa/*")
    assert {expanded([each]).notes for each in given} == {
        ("1 file is no model and was left out (.md 1)",)
    }
    assert expanded(["fa", "fb"]).notes == ("2 files are no models and were left out (.md 2)",)
    caches = [build([each], f"{i}.svp.h5").cache for i, each in enumerate(("fa", "./fa/", "fb"))]
    assert len({cache.content_digest for cache in caches}) == 1


def test_what_might_not_end_is_not_followed(folder: Path) -> None:
    only = folder.parent / "only"
    (only / ".git").mkdir(parents=True)
    (only / ".git" / "x.obj").write_bytes(TRIANGLE)
    (only / "._a.obj").write_bytes(b"\0")
    (only / "a.obj").write_bytes(TRIANGLE)
    (only / "loop").symlink_to(folder)
    (only / "gone.obj").symlink_to("nowhere")
    os.mkfifo(only / "pipe.json")
    found = expanded(["only"])
    assert found.paths == ("only/a.obj",)
    assert found.notes[0].endswith("(hidden 2, not a file 2, linked folders 1)")


def test_a_tileset_of_another_name_is_not_read_twice(folder: Path) -> None:
    (folder / "t" / "tileset.json").rename(folder / "t" / "root.json")
    with pytest.raises(InputError, match=r"0.glb lies in the folder of the tileset city/t/root"):
        read(["city/t"])


@pytest.mark.parametrize(
    ("pattern", "paths"),
    [
        ("city/*.obj*", ("city/a.obj.gz", "city/b.obj")),
        ("city/?.obj", ("city/b.obj",)),
        ("city/**/*.OBJ", ("city/a/z.OBJ",)),
        ("city/[ab].obj", ("city/b.obj",)),
        ("c*y/t", ("city/t",)),
    ],
)
def test_a_pattern_is_what_it_matches(folder: Path, pattern: str, paths: tuple[str, ...]) -> None:
    assert expanded([pattern]).paths == paths


def test_a_file_with_brackets_in_its_name_is_itself(folder: Path) -> None:
    (folder / "x[1].obj").write_bytes(TRIANGLE)
    assert expanded(["city/x[1].obj"]).paths == ("city/x[1].obj",)
    assert len(read(["city/x[1].obj"]).faces) == 1


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("city/*.stl", "city/*.stl: no file or folder matches this pattern."),
        ("city/*.md", "city/*.md: nothing that this pattern matches is a model (.md 1)."),
        ("empty", "empty: no model in this folder and those below it. Models end in .obj, .ply"),
        ("gone.obj", "gone.obj: there is no such file."),
    ],
)
def test_nothing_to_read_is_one_clear_line(folder: Path, given: str, says: str) -> None:
    Path("empty").mkdir()
    with pytest.raises(InputError) as raised:
        read([given])
    assert str(raised.value).startswith(says)
    assert "\n" not in str(raised.value)


def test_what_is_named_twice_is_refused(folder: Path) -> None:
    for given in (["city/b.obj", "city/*.obj"], ["city", "city/b.obj"], ["city/t", "city/t"]):
        with pytest.raises(InputError, match="named twice"):
            read(given)
    for given in (["city/t", "city/t/content/0.glb"], ["city/t/content", "city/t"]):
        with pytest.raises(InputError, match="lies in the folder of the tileset city/t, which"):
            read(given)


def test_each_file_stays_its_own_source(folder: Path) -> None:
    mesh = read(["city/*.obj*", "city/a/z.OBJ"])
    assert [s.path for s in mesh.sources] == ["city/a.obj.gz", "city/b.obj", "city/a/z.OBJ"]
    assert mesh.object_names == ("a", "b", "z")
    assert mesh.object_source.tolist() == [0, 1, 2]


def test_notes_tell_files_of_one_name_apart(folder: Path) -> None:
    (folder / "a/b.obj").write_bytes(TRIANGLE)
    mesh = read(["city/b.obj", "city/a/b.obj", "city/a/z.OBJ"], options=ReadOptions(lod="2"))
    assert mesh.notes[0].startswith("3 files (city/b.obj, ...): this format (obj)")
    mesh = read(["city/b.obj", "city/a/b.obj"], options=ReadOptions(crs="EPSG:28992"))
    assert {note.partition(":")[0] for note in mesh.notes} == {"2 files (city/b.obj, ...)"}


@pytest.mark.parametrize(
    ("given", "name"),
    [
        (["city"], "city.svp.h5"),
        (["city/"], "city.svp.h5"),
        (["city/t"], "t.svp.h5"),
        (["city/?.obj"], "b.svp.h5"),
        (["city/a/c.city.json"], "c.svp.h5"),
        (["city/a.obj.gz"], "a.svp.h5"),
        (["."], None),
        (["gone.obj"], "gone.svp.h5"),
    ],
)
def test_the_name_of_the_cache(folder: Path, given: list[str], name: str | None) -> None:
    expected = name or f"{folder.parent.name}.svp.h5"
    assert str(default_cache_path(given)) == expected


@pytest.mark.parametrize("given", [["city/*.obj*"], ["a.obj", "b.obj"]])
def test_several_inputs_need_a_name(folder: Path, given: list[str]) -> None:
    with pytest.raises(InputError, match="2 inputs make one cache: name it with -o CACHE"):
        default_cache_path(given)


def test_stems() -> None:
    assert stem_of("x/a.city.jsonl.gz") == "a"
    assert stem_of("a.city.obj") == "a.city"
    assert stem_of(".obj") == ".obj"


def test_the_command_line_takes_folders(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (folder / "a").rename(folder.parent / "elsewhere")
    (folder / "t").rename(folder.parent / "tiles")
    assert cli.run(["build", "city", "--json", "--report", "r.json"]) == 0
    built = json.loads(capfd.readouterr().out)
    assert [s["path"] for s in built["sources"]] == ["city/a.obj.gz", "city/b.obj"]
    assert built["objects"] == 2
    assert any("no models" in note for note in built["notes"])
    assert cli.run(["build", "city"]) == 0
    out = capfd.readouterr().out
    assert "sources  2 files" in out
    assert "city.svp.h5" in out
    before = (folder / "b.obj").read_bytes()
    os.link(folder / "b.obj", "b.csv")
    assert cli.run(["build", "city", "--report", "b.csv"]) == 1
    assert "is an input" in capfd.readouterr().err
    assert (folder / "b.obj").read_bytes() == before


@pytest.mark.parametrize(
    ("content", "is_one"),
    [
        (TILESET, True),
        (b'{"asset": {}, "root": {}}', True),
        (b'{"asset": {}}', False),
        (CITY, False),
        (b'{"type": "CityJSON", "x": {"asset": 1, "root": 1}}', False),
        (b'["asset", "root"]', False),
        (b'{"asset": ' + b"[" * 100_000, False),
    ],
)
def test_tilesets_are_known_by_their_content(tmp_path: Path, content: bytes, is_one: bool) -> None:
    (tmp_path / "a.json").write_bytes(content)
    (tmp_path / "a.json.gz").write_bytes(gzip.compress(content))
    (tmp_path / "cut.json.gz").write_bytes(gzip.compress(content)[:-12])
    assert is_tileset(tmp_path / "a.json") == is_one
    assert is_tileset(tmp_path / "a.json.gz") == is_one
    assert not is_tileset(tmp_path / "cut.json.gz")
    assert is_tileset(tmp_path / "tileset.json")  # by its name alone


def test_notes_of_many_files_are_said_once() -> None:
    notes = [(f"{i}.glb", "y up was turned to z up") for i in range(3000)]
    notes += [("0.glb", "3 points are left out (a, b)"), ("1.glb", "4 points are left out (c)")]
    notes += [("2.glb", "1 line is left out"), ("3.glb", "in EPSG:1"), ("4.glb", "in EPSG:2")]
    assert merged_notes(notes) == (
        "3000 files (0.glb, ...): y up was turned to z up",
        "2 files (0.glb, ...): 7 points are left out (first: a, b)",
        "2.glb: 1 line is left out",
        "3.glb: in EPSG:1",
        "4.glb: in EPSG:2",
    )


@pytest.mark.parametrize(
    ("notes", "merged"),
    [
        (
            ["3 left out by --x (A 2, B 1)", "4 left out by --x (B 4)"],
            "7 left out by --x (B 5, A 2)",
        ),
        (
            ["2 left out by --x (A 2): so", "1 left out by --x (+B 1): so"],
            "3 left out by --x (A 2, +B 1): so",
        ),
        (["3 left out by --x (A 3)", "4 left out by --x (A 1, ... (4))"], "7 left out by --x"),
        (["9 left out by --x (A 8, ... (2))"] * 2, "18 left out by --x"),
        (["1 unknown (line 1)", "1 unknown (line 1)"], "2 unknown (line 1)"),  # no breakdown
        (["2 unknown (line 2)", "3 unknown (line 9)"], "5 unknown (first: line 2)"),
    ],
)
def test_breakdowns_of_counts_are_summed(notes: list[str], merged: str) -> None:
    named = [(f"{i}.gml", note) for i, note in enumerate(notes)]
    assert merged_notes(named) == (f"2 files (0.gml, ...): {merged}",)
