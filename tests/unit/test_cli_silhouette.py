"""`svprep silhouette`: what it prints where, what it writes, and how it refuses."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from svprep import cli
from svprep.light import FORMS
from svprep.silhouette import METHODS, VOLUMES

ROOT = Path(__file__).resolve().parents[2]
CONFORMANCE = ROOT / "data" / "conformance"
CITY = ROOT / "data" / "small_city.obj.gz"
SUN = ["--light", "dir:135,40"]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with caches of a cube, of two cubes, and of the city."""
    folder = tmp_path_factory.mktemp("caches")
    cube = str(CONFORMANCE / "clean_cube.obj")
    (folder / "named").mkdir()
    text = Path(cube).read_text()
    east = text.replace("v 0", "v 5").replace("v 1", "v 6")
    (folder / "named" / "a.obj").write_text("o a\n" + text)
    (folder / "named" / "b.obj").write_text("o b\n" + east)
    named = [str(folder / "named" / f"{name}.obj") for name in "ab"]
    for arguments in (
        [cube, "-o", str(folder / "cube.svp.h5")],
        [*named, "-o", str(folder / "two.svp.h5")],
        [str(CITY), "-o", str(folder / "city.svp.h5")],
    ):
        assert cli.run(["build", *arguments]) == 0
    return folder


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def told(capfd: pytest.CaptureFixture[str], *arguments: str) -> dict:
    """Run the command with ``--json``; return the only thing that it printed."""
    capfd.readouterr()
    assert cli.run(["silhouette", *arguments, "--json"]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert out.count("\n") == 1
    return json.loads(out)


def test_a_cube_lit_from_a_corner(built: Path, capfd: pytest.CaptureFixture[str]) -> None:
    cube = str(built / "cube.svp.h5")
    closed = told(capfd, cube, *SUN)
    # Three faces are lit: their outline is a hexagon of the cube's 12 edges.
    assert (closed["edges"], closed["double_edges"], closed["sides"]) == (6, 0, 6)
    assert closed["volume"] == "auto"
    assert (closed["objects"], closed["objects_in_cache"], closed["edge_records"]) == (1, 1, 18)
    assert closed["light"] == {
        "spec": "dir:135,40",
        "words": "direction, azimuth 135, altitude 40",
        "cache_frame": pytest.approx([0.5416752, -0.5416752, 0.6427876, 0.0]),
        "distance_m": None,
    }
    assert 0 < closed["edges_visited"] <= 18
    assert closed["query_ms"] > 0
    assert closed["load_seconds"] > 0
    assert "per_object" not in closed
    robust = told(capfd, cube, *SUN, "--volume", "robust")
    assert (robust["edges"], robust["double_edges"], robust["sides"]) == (6, 6, 12)


def test_edge_on_faces_cast_nothing(built: Path, capfd: pytest.CaptureFixture[str]) -> None:
    # Lit along an axis, four faces are edge-on: only the east one is lit.
    cube = str(built / "cube.svp.h5")
    assert told(capfd, cube, "--light", "dir:90,0")["sides"] == 4
    assert told(capfd, cube, "--light", "dir:90,0", "--volume", "robust")["edges"] == 8


def test_a_light_inside_takes_the_robust_volume(
    built: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    # No face is turned to it, all are turned away: no outline, whatever the volume.
    inside = told(capfd, str(built / "cube.svp.h5"), "--light", "point:0.25,0.5,0.5")
    assert inside["edges"] == 0
    assert inside["light"]["distance_m"] == 0.25
    above = told(capfd, str(built / "cube.svp.h5"), "--light", "point:0.5,0.5,3")
    assert (above["edges"], above["sides"]) == (4, 4)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_same(
    built: Path, capfd: pytest.CaptureFixture[str], method: str
) -> None:
    got = told(capfd, str(built / "city.svp.h5"), *SUN, "--method", method)
    brute = told(capfd, str(built / "city.svp.h5"), *SUN, "--method", "brute")
    for key in ("edges", "double_edges", "sides"):
        assert got[key] == brute[key]
    assert brute["edges_visited"] == brute["edge_records"] == 39_983
    assert got["method"] in METHODS


def test_the_summary_says_the_same_to_people(
    built: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    city = str(built / "city.svp.h5")
    counts = told(capfd, city, *SUN)
    assert cli.run(["silhouette", city, *SUN]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    lines = dict(line.split(None, 1) for line in out.splitlines())
    assert list(lines) == ["light", "method", "found", "work", "time"]
    assert lines["light"] == "direction, azimuth 135, altitude 40"
    assert lines["method"].endswith("volume auto, 300 objects")
    assert lines["found"] == (
        f"{counts['edges']:,} silhouette edges, {counts['double_edges']:,} of them with |m| = 2; "
        f"they need {counts['sides']:,} sides"
    )
    assert f"{counts['edges_visited']:,} of 39,983 edge records visited" in lines["work"]
    assert re.fullmatch(
        r"[\d,.]+ ms for a query, after [\d.]+ seconds of loading and a first one", lines["time"]
    )


def test_objects_by_name(built: Path, capfd: pytest.CaptureFixture[str]) -> None:
    city = str(built / "city.svp.h5")
    asked = ["--objects", "tree_0001", "--objects", "tower_0000", "--objects", "tree_0001"]
    some = told(capfd, city, *SUN, *asked)
    assert some["objects"] == 2
    assert [entry["object"] for entry in some["per_object"]] == ["tree_0001", "tower_0000"]
    for key in ("edges", "double_edges", "sides"):
        assert sum(entry[key] for entry in some["per_object"]) == some[key]
    assert cli.run(["silhouette", city, *SUN, *asked]) == 0
    assert "2 of 300 objects" in capfd.readouterr().out
    for entry in some["per_object"]:
        alone = told(capfd, city, *SUN, "--objects", entry["object"])
        assert alone["per_object"] == [entry]


def test_an_unknown_object_is_answered_with_what_comes_close(
    built: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for name, close in (
        ("tower_000", "'tower_0000'"),
        ("TREE_0001", "close to it: 'tree_0001'"),
        ("zz", "none comes close"),
    ):
        assert cli.run(["silhouette", str(built / "city.svp.h5"), *SUN, "--objects", name]) == 1
        out, err = capfd.readouterr()
        assert out == ""
        assert err.startswith(f'svprep: no object "{name}" among the 300 of ')
        assert close in err
        assert "--report" in err
        assert err.count("\n") == 1


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".npz"])
def test_lines_are_written_and_told(
    built: Path, capfd: pytest.CaptureFixture[str], suffix: str
) -> None:
    cache, name = str(built / "two.svp.h5"), f"lines{suffix}"
    assert cli.run(["silhouette", cache, *SUN, "-o", name]) == 0
    assert capfd.readouterr().out.splitlines()[-1] == f"lines    {name} (12 lines, 12 vertices)"
    assert os.listdir() == [name]
    counts = told(capfd, cache, *SUN, "--objects", "b", "-o", name)
    assert (counts["output"], counts["output_vertices"], counts["edges"]) == (name, 6, 6)
    if suffix == ".npz":
        lines = np.load(name)
        assert lines["positions"][:, 0].min() == 5.0
        assert lines["object"].tolist() == [1] * 6
        assert lines["object_names"].tolist() == ["a", "b"]
    elif suffix == ".obj":
        text = Path(name).read_text()
        assert (text.count("\no "), text.count("\nv "), text.count("\nl ")) == (1, 6, 6)
        assert "\no b\n" in text


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["gone.svp.h5"], 2, FORMS),
        ([*SUN], 2, "CACHE"),
        (["gone.svp.h5", *SUN, *SUN], 2, "one light"),
        (["gone.svp.h5", *SUN, "--method", "magic"], 2, ", ".join(METHODS)),
        (["gone.svp.h5", *SUN, "--volume", "thin"], 2, ", ".join(VOLUMES)),
        (["gone.svp.h5", *SUN, "-o", "a.txt"], 2, ".ply, .obj or .npz"),
        (["gone.svp.h5", *SUN, "-o", "a.ply/"], 2, ".ply, .obj or .npz"),
        (["gone.svp.h5", "--light", "dir:135"], 1, "ALTITUDE is missing"),
        (["gone.svp.h5", "--light", ""], 1, FORMS),
        (["gone.svp.h5", "--light", "sun:48,16,2026-06-21T12:00Z"], 1, "gone.svp.h5"),
        (
            ["gone.svp.h5", "--light", "sun:48,16,2026-06-21/06:00/18:00/1h[UTC]"],
            2,
            "one light",
        ),
        (["gone.svp.h5", "--light", "dir:\x1b[1,2"], 1, "\\x1b"),
        (["gone.svp.h5", *SUN, "-o", "no/a.ply"], 1, 'no folder "'),
        (["gone.svp.h5", *SUN], 1, "gone.svp.h5"),
        (["city.obj", *SUN], 1, "svprep build city.obj"),
    ],
)
def test_refused_in_one_line(
    arguments: list[str], status: int, says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["silhouette", *arguments]) == status
    out, err = capfd.readouterr()
    assert out == ""
    assert says in err
    assert err.count("\n") == 1
    assert os.listdir() == []


def test_a_light_out_of_reach_is_refused(built: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["silhouette", str(built / "cube.svp.h5"), "--light", "point:0,1e300,0"]) == 1
    assert "Y lies 1e+300 m" in capfd.readouterr().err


def test_nothing_of_the_users_is_overwritten(
    built: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    two, model = built / "two.svp.h5", built / "named" / "a.obj"
    os.link(two, "linked.ply")
    Path("mine.obj").write_text("v 0 0 0\n")
    kept = {path: path.read_bytes() for path in (two, model, Path("mine.obj"))}
    for name in ("linked.ply", str(model), "mine.obj"):
        assert cli.run(["silhouette", str(two), *SUN, "-o", name]) == 1
        out, err = capfd.readouterr()
        assert out == ""
        assert err.count("\n") == 1
    assert {path: path.read_bytes() for path in kept} == kept


def test_the_help_names_every_method_and_volume(capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["silhouette", "--help"]) == 0
    words = set(re.findall(r"\w+", capfd.readouterr().out))
    assert words >= {*METHODS, *VOLUMES, "AZIMUTH", "point"}
