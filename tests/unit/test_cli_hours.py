"""`svprep hours`: what it prints where, what it writes, and how it refuses."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path

import pytest

from svprep import cli

ROOT = Path(__file__).resolve().parents[2]
CUBE = ROOT / "data" / "conformance" / "clean_cube.obj"
ARC = "sun:48.2,16.37,2026-06-21/05:00/21:00/1h[Europe/Vienna]"
SUN = ["--light", ARC]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the cache of a cube of one metre."""
    folder = tmp_path_factory.mktemp("caches")
    model = folder / "cube.obj"
    model.write_text(CUBE.read_text())
    assert cli.run(["build", str(model), "-o", str(folder / "cube.svp.h5")]) == 0
    return folder / "cube.svp.h5"


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def said(capfd: pytest.CaptureFixture[str], *arguments: object, status: int) -> str:
    """Run the command, expect `status`; return the one line of complaint."""
    capfd.readouterr()
    assert cli.run(["hours", *map(str, arguments)]) == status
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def test_one_object_as_json(built: Path, capfd: pytest.CaptureFixture[str]) -> None:
    capfd.readouterr()
    assert cli.run(["hours", str(built), *SUN, "--spacing", "0.1", "--json"]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert out.count("\n") == 1
    told = json.loads(out)
    assert told["facts"]["samples"] == 600
    assert told["facts"]["light"] == ARC
    assert (told["suns"], told["rows"], told["outputs"]) == (16, 3, [])
    kinds = {kind["kind"]: kind for kind in told["kinds"]}
    assert list(kinds) == ["roof", "wall", "underside"]
    assert kinds["roof"]["total_median"] == kinds["roof"]["longest_min"] == 16 * 60
    assert kinds["underside"]["total_p90"] == 0
    # Nothing stands around: north walls see the sun in the morning and in the evening.
    assert 0 < kinds["wall"]["total_min"] < kinds["wall"]["total_median"]
    assert kinds["wall"]["area_m2"] == 4.0
    assert told["rays"] > 0
    assert told["seconds"] >= told["trace_seconds"] > 0


def test_people_read_aligned_lines(built: Path, capfd: pytest.CaptureFixture[str]) -> None:
    files = [Path("hours.csv"), Path("hours.ply")]
    outputs = [word for file in files for word in ("-o", str(file))]
    capfd.readouterr()
    assert cli.run(["hours", str(built), *SUN, *outputs]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    lines = out.splitlines()
    assert [line.split()[0] for line in lines] == [
        *("model", "sun", "steps", "samples", "surface", "surface", "surface", "time"),
        *("written", "written"),
    ]
    assert lines.pop(0) == "model    1.0 x 1.0 x 1.0 m (east, north, up)"
    assert lines[0].startswith(
        "sun      48.2, 16.37 on 2026-06-21, 05:00 to 21:00 Europe/Vienna; grid north taken as"
    )
    assert lines[1] == "steps    16 of 60 min, 0 at night"
    assert lines[2].startswith(
        "samples  6, one per 1 m squared; 0 buried in solids and 0 under the ground left"
    )
    assert re.match(r"surface  roof +1\.00 m2  median 16 h 00 of sun, 16 h 00 to 16 h 00", lines[3])
    assert lines[7:] == ["written  hours.csv", "written  hours.ply"]
    assert all(file.stat().st_size for file in files)
    assert sorted(os.listdir()) == ["hours.csv", "hours.ply"]
    before = [file.read_bytes() for file in files]
    assert cli.run(["hours", str(built), *SUN, *outputs]) == 0  # ours may be written again
    assert [file.read_bytes() for file in files] == before


def test_an_arc_that_cuts_the_day_is_noted(built: Path, capfd: pytest.CaptureFixture[str]) -> None:
    def lines_of(clocks: str) -> str:
        arc = f"sun:48.2,16.37,2026-06-21/{clocks}/1h[Europe/Vienna]"
        assert cli.run(["hours", str(built), "--light", arc]) == 0
        return capfd.readouterr().out

    cut = lines_of("10:00/15:00")
    assert re.search(r"note     the sun stands 4\d\.\d degrees high when the arc begins and ", cut)
    whole = lines_of("00:00/24:00")
    assert "note " not in whole
    assert "00:00 to 24:00 Europe/Vienna" in whole


def test_usage_errors(built: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for arguments, what in (
        ([built], "name the sun's arc with --light"),
        ([built, *SUN, *SUN], "2 --light were given"),
        ([built, "--light", "dir:135,40"], 'arc of the sun, and "dir:135,40" is none'),
        ([built, "--light", "sun:48,16,2026-06-21T12:00Z"], "is none; one is sun:LAT,LON,"),
        ([built, *SUN, "--spacing", "0"], "--spacing is a distance in metres above 0"),
        ([built, *SUN, "--spacing", "nan"], "--spacing is a distance in metres above 0"),
        ([built, *SUN, "--spacing", "wide"], "--spacing"),
        ([built, *SUN, "-o", "hours.txt"], "written as .csv or .ply"),
        ([built, *SUN, "-o", "hours.csv/"], "written as .csv or .ply"),
        ([], "CACHE"),
    ):
        line = said(capfd, *arguments, status=2)
        assert what in line
        assert "svprep hours --help" in line


def test_input_that_cannot_be_used(built: Path, capfd: pytest.CaptureFixture[str]) -> None:
    Path("mine.csv").write_text("a,b\n")
    model = built.with_name("cube.obj")
    for arguments, what in (
        (["none.svp.h5", *SUN], "none.svp.h5"),
        ([model, *SUN], f"is a model, not a cache. Run: svprep build {model}"),
        ([built, *SUN, "-o", "mine.csv"], "mine.csv exists and does not hold sun hours"),
        ([built, *SUN, "-o", "no/hours.csv"], "there is no folder"),
        ([built, *SUN, "-o", "a.csv", "-o", "./a.csv"], "./a.csv is an input, the cache itself"),
        ([built, *SUN, "--spacing", "1e-6"], "makes 6,000,000,000,000 samples on 6 m2"),
        ([built, "--light", ARC.replace("48.2", "98.2")], "98.2"),
        ([built, "--light", ARC.replace("Vienna", "Wien")], "Wien"),
        ([built, "--light", ARC.replace("05:00/21:00", "00:00/03:00")], "below the horizon"),
    ):
        assert what in said(capfd, *arguments, status=1)
    assert os.listdir() == ["mine.csv"]
    assert Path("mine.csv").read_text() == "a,b\n"


def test_without_embree_the_extra_is_named_before_any_work(
    built: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    line = said(capfd, built, *SUN, status=1)
    assert "svprep hours needs the package" in line
    assert "svprep[judge]" in line
