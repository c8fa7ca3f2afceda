"""`svprep clamp`, `build --light` and what `info` says of lights."""

from __future__ import annotations

import json
import os
import pty
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from svprep import cli
from svprep.cache.files import exclusive_lock
from svprep.cache.reader import open_cache
from svprep.cache.verify import verify

ROOT = Path(__file__).resolve().parents[2]
CITY = ROOT / "data" / "small_city.obj.gz"
CUBE = ROOT / "data" / "conformance" / "clean_cube.obj"
SUN, LAMP = "dir:135,40", "point:40,30,60"
ARC = "sun:48.2,16.37,2026-03-20/05:00/12:00/2h[Europe/Vienna]"
LIGHT_KEYS = {
    "spec", "light", "azimuth_deg", "altitude_deg", "position", "casters", "segments", "n_bytes",
    "bytes_per_caster", "cost_vertex", "cost_area", "gain", "gain_own_box",
}  # fmt: skip


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the caches of the city and of a cube, without lights."""
    folder = tmp_path_factory.mktemp("caches")
    for model, name in ((CITY, "city"), (CUBE, "cube")):
        assert cli.run(["build", str(model), "-o", str(folder / f"{name}.svp.h5")]) == 0
    return folder


@pytest.fixture(autouse=True)
def in_folder(bare: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder of its own, with copies of both caches."""
    shutil.copytree(bare, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)


def told(capfd: pytest.CaptureFixture[str], *arguments: str) -> dict:
    """Run a command with ``--json``; return the only thing that it printed."""
    capfd.readouterr()
    assert cli.run([*arguments, "--json"]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert out.count("\n") == 1
    return json.loads(out)


def said(capfd: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    """Run a command; return the lines that it printed for people."""
    capfd.readouterr()
    assert cli.run(list(arguments)) == 0
    out, err = capfd.readouterr()
    assert err == ""
    return out.splitlines()


def lights(*specs: str) -> list[str]:
    return [word for spec in specs for word in ("--light", spec)]


def test_clamp_tells_what_it_added(capfd: pytest.CaptureFixture[str]) -> None:
    done = told(capfd, "clamp", "city.svp.h5", *lights(SUN, LAMP, SUN))
    assert set(done) == {
        "cache", "n_bytes", "content_digest", "added", "replaced", "already_there", "seconds",
        "new_lights", "lights", "lights_bytes", "remarks",
    }  # fmt: skip
    assert done["cache"] == "city.svp.h5"
    assert done["n_bytes"] == Path("city.svp.h5").stat().st_size
    assert (done["added"], done["replaced"], done["already_there"]) == (2, 0, 1)
    assert (done["lights"], done["lights_bytes"] > 0, done["seconds"] > 0) == (2, True, True)
    sun, lamp = done["new_lights"]
    assert set(sun) == set(lamp) == LIGHT_KEYS
    assert (sun["spec"], sun["azimuth_deg"], sun["altitude_deg"]) == (SUN, 135.0, 40.0)
    assert sun["position"] is None
    assert (lamp["spec"], lamp["azimuth_deg"], lamp["altitude_deg"]) == (LAMP, None, None)
    assert lamp["position"] == [40.0, 30.0, 60.0]
    for light in (sun, lamp):
        assert 1 <= light["segments"] / light["casters"] <= 8
        assert light["gain"] > 1.0
        assert (light["cost_vertex"], light["cost_area"]) == (4.0, 1.0)
        assert light["bytes_per_caster"] == pytest.approx(
            light["n_bytes"] / light["casters"], abs=0.01
        )
    assert verify(Path("city.svp.h5")) == []


def test_the_bytes_told_are_those_of_the_datasets(capfd: pytest.CaptureFixture[str]) -> None:
    done = told(capfd, "clamp", "city.svp.h5", *lights(SUN, LAMP, ARC))
    with open_cache("city.svp.h5") as cache:
        sizes = cache.dataset_sizes()
    of_lights = sum(n for name, n in sizes.items() if name.startswith(("lights/", "clamp/")))
    # Each of two offset tables holds one number more than there are lights.
    assert abs(done["lights_bytes"] - of_lights) <= 8 + 8 * done["lights"]


def test_clamp_says_the_same_to_people(capfd: pytest.CaptureFixture[str]) -> None:
    lines = said(capfd, "clamp", "city.svp.h5", *lights(SUN, LAMP))
    assert [line.split()[0] for line in lines] == [
        *("cache", "lights", "light", "light", "gain:", "time"),
    ]
    assert lines[1].startswith("lights   2 added; it holds 2 now, ")
    assert lines[2].startswith(f"light    {SUN}: ")
    assert "gain" in lines[2]
    again = said(capfd, "clamp", "city.svp.h5", *lights(LAMP))
    assert again[1].startswith("lights   0 added, 1 already there or named twice; it holds 2 now")
    other = said(capfd, "clamp", "city.svp.h5", *lights(LAMP), "--cost-vertex", "1")
    assert other[1].startswith("lights   1 added, 1 of before replaced, with other costs; it holds")


def test_costs_are_kept_and_weighed(capfd: pytest.CaptureFixture[str]) -> None:
    usual = told(capfd, "clamp", "city.svp.h5", *lights(SUN))["new_lights"][0]
    options = ["--cost-vertex", "0", "--cost-area", "2.5"]
    free = told(capfd, "clamp", "city.svp.h5", *lights(SUN), *options)
    assert (free["added"], free["replaced"], free["lights"]) == (1, 1, 1)
    light = free["new_lights"][0]
    assert (light["cost_vertex"], light["cost_area"]) == (0.0, 2.5)
    assert light["segments"] > usual["segments"]
    assert light["gain"] > usual["gain"]
    none = told(capfd, "clamp", "city.svp.h5", *lights(SUN), "--cost-area", "0")["new_lights"][0]
    assert none["segments"] == none["casters"]


def test_build_with_lights(capfd: pytest.CaptureFixture[str]) -> None:
    built = told(capfd, "build", str(CITY), "-o", "a.svp.h5", *lights(SUN, ARC, LAMP))
    assert [light["spec"] for light in built["lights"]] == [
        SUN,
        *(f"sun:48.2,16.37,2026-03-20T{hour:02}:00+01:00" for hour in (7, 9, 11)),
        LAMP,
    ]
    assert {"scene tree", "clamp"} <= set(built["seconds"])
    info = told(capfd, "info", "a.svp.h5")
    assert info["lights"] == built["lights"]
    assert info["content_digest"] == built["content_digest"]
    for arguments in (lights(SUN), lights(ARC, LAMP)):
        done = told(capfd, "clamp", "city.svp.h5", *arguments)
    assert done["content_digest"] == info["content_digest"]
    assert Path("city.svp.h5").read_bytes() == Path("a.svp.h5").read_bytes()


def test_build_takes_costs(capfd: pytest.CaptureFixture[str]) -> None:
    options = ["--cost-vertex", "0.5", "--cost-area", "3"]
    built = told(capfd, "build", str(CUBE), "-o", "a.svp.h5", *lights(SUN), *options)
    assert (built["lights"][0]["cost_vertex"], built["lights"][0]["cost_area"]) == (0.5, 3.0)


def test_info_lists_lights_with_size_and_gain(capfd: pytest.CaptureFixture[str]) -> None:
    assert told(capfd, "info", "city.svp.h5")["lights"] == []
    assert not [line for line in said(capfd, "info", "city.svp.h5") if line.startswith("light ")]
    many = [f"dir:{10 * i},30" for i in range(15)]
    told(capfd, "clamp", "city.svp.h5", *lights(*many))
    info = told(capfd, "info", "city.svp.h5")
    assert [light["spec"] for light in info["lights"]] == many
    assert info["clusters"] > 0
    lines = [line for line in said(capfd, "info", "city.svp.h5") if line.startswith("light ")]
    assert len(lines) == 13
    first = info["lights"][0]
    assert lines[0] == (
        f"light    {many[0]}: {first['segments']:,} segments of {first['casters']:,} casters, "
        f"{first['n_bytes']:,} bytes, gain {first['gain']:.1f}x "
        f"(own box alone {first['gain_own_box']:.1f}x)"
    )
    assert lines[-1] == "light    ... and 3 more (--json lists all)"


BAD_LIGHTS = {
    "": "begins with none of dir:, point: and sun:",
    "frob:1": "begins with none of dir:, point: and sun:",
    "dir:0,91": "ALTITUDE 91 is not between -90 and 90",
    "dir:nan,40": 'AZIMUTH is "nan", which is not a finite number',
    "dir:0,inf": 'ALTITUDE is "inf"',
    "point:nan,0,0": 'X is "nan", which is not a finite number',
    "point:1,2": "Z is missing",
    "point:0,0,0": "lies exactly on a vertex (vertices 0, objects 0)",
    "point:1e39,0,0": "1e+39 m from the middle of the model",
    "sun:91,10,2026-06-21T12:00Z": "LAT 91 is not between -90 and 90",
    "sun:48,16,2026-02-30T12:00Z": "there is no date 2026-02-30",
    "sun:48,16,2026-06-21T25:00Z": "25:00",
    "sun:48,16,2026-06-21T12:00": "has no zone",
    "sun:48,16,2026-06-21T12:00[Mars/Base]": 'the zone "Mars/Base" is unknown',
    "sun:48,16,2026-06-21T23:00Z": "below the horizon",
    "sun:48,16,2026-03-20/12:00/12:00/1h[UTC]": "the end, 12:00, is not after the begin",
    "sun:48,16,2026-03-20/12:00/11:00/1h[UTC]": "the end, 11:00, is not after the begin",
    "sun:48,16,2026-03-20/06:00/18:00/0m[UTC]": "0m",
    "sun:70,25,2026-12-21/06:00/18:00/1h[UTC]": "polar night",
    "sun:2026-06-21T12:00Z": "LAT",
}


@pytest.mark.parametrize("spec", BAD_LIGHTS)
@pytest.mark.parametrize("command", ["clamp", "build"])
def test_a_bad_light_is_one_clear_line(
    command: str, spec: str, capfd: pytest.CaptureFixture[str]
) -> None:
    before = Path("cube.svp.h5").read_bytes()
    files = sorted(os.listdir())
    target = ["cube.svp.h5"] if command == "clamp" else [str(CUBE), "-o", "new.svp.h5"]
    capfd.readouterr()
    assert cli.run([command, *target, *lights(SUN, spec), "--json"]) == 1
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith(f'svprep: light "{spec}"')
    assert BAD_LIGHTS[spec] in err
    assert err.count("\n") == 1
    assert Path("cube.svp.h5").read_bytes() == before
    assert sorted(os.listdir()) == files


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["clamp"], 2, "CACHE"),
        (["clamp", "cube.svp.h5"], 2, "--light SPEC"),
        (["clamp", "none.svp.h5"], 2, "--light SPEC"),
        (["clamp", "none.svp.h5", *lights(SUN)], 1, "there is no such file"),
        (["clamp", str(CITY), *lights(SUN)], 1, "is a model, not a cache. Run: svprep build"),
        (["clamp", ".", *lights(SUN)], 1, "folder"),
        (["clamp", "cube.svp.h5", *lights(SUN), "--cost-vertex", "-1"], 2, "at least 0, not -1.0"),
        (["clamp", "cube.svp.h5", *lights(SUN), "--cost-area", "-0.5"], 2, "--cost-area is a"),
        (["clamp", "cube.svp.h5", *lights(SUN), "--cost-area", "nan"], 2, "not nan"),
        (["clamp", "cube.svp.h5", *lights(SUN), "--cost-vertex", "inf"], 2, "not inf"),
        (["clamp", "cube.svp.h5", *lights(SUN), "--cost-vertex", "much"], 2, "--cost-vertex"),
        (["clamp", "cube.svp.h5", "--light"], 2, "--light"),
        (["build", str(CUBE), "-o", "a.svp.h5", "--cost-vertex", "-1"], 2, "--cost-vertex is a"),
        (["build", "gone.obj", *lights("dir:0,91")], 1, "ALTITUDE 91"),
    ],
)
def test_one_line_on_standard_error(
    arguments: list[str], status: int, says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    before = Path("cube.svp.h5").read_bytes()
    capfd.readouterr()
    assert cli.run(arguments) == status
    out, err = capfd.readouterr()
    assert out == ""
    assert says in err
    assert err.count("\n") == 1
    assert Path("cube.svp.h5").read_bytes() == before
    assert sorted(os.listdir()) == ["city.svp.h5", "cube.svp.h5"]


def test_another_writer_is_told(capfd: pytest.CaptureFixture[str]) -> None:
    with exclusive_lock(Path("cube.svp.h5").resolve(), 0.0):
        capfd.readouterr()
        assert cli.run(["clamp", "cube.svp.h5", *lights(SUN)]) == 1
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "is writing it" in err


def test_a_damaged_cache_is_named(capfd: pytest.CaptureFixture[str]) -> None:
    whole = Path("cube.svp.h5").read_bytes()
    Path("cube.svp.h5").write_bytes(whole[:-100])
    assert cli.run(["clamp", "cube.svp.h5", *lights(SUN)]) == 1
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "is cut off" in err
    assert Path("cube.svp.h5").read_bytes() == whole[:-100]


def test_progress_shows_on_a_terminal_only(capfd: pytest.CaptureFixture[str]) -> None:
    leader, follower = pty.openpty()
    command = ["clamp", "city.svp.h5", *lights(*(f"dir:{i},30" for i in range(20))), "--json"]
    shown = subprocess.Popen(
        [sys.executable, "-m", "svprep", *command],
        env={**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm"},
        stdout=subprocess.PIPE,
        stderr=follower,
    )
    out, _ = shown.communicate()
    os.close(follower)
    on_terminal = os.read(leader, 100_000)
    os.close(leader)
    assert json.loads(out)["added"] == 20
    assert b"\x1b[" in on_terminal
    # The same, not on a terminal: `told` checks that nothing is on standard error.
    assert told(capfd, *command[:-1])["already_there"] == 20


def test_a_spec_cannot_steer_a_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    capfd.readouterr()
    assert cli.run(["clamp", "cube.svp.h5", *lights("dir:\x1b]0;x\x07,3")]) == 1
    assert "\x1b" not in capfd.readouterr().err
