"""The build benchmark counts processes right, notices wrong caches, and its report is whole."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from svprep.pipeline import build
from tests.unit.scripts import SCRIPTS, load_script

OBJ = """\
o terrain_0
v 0 0 0
v 9 0 0
v 9 9 0
f 1 2 3
o house_0001
v 1.250 1 1
v 2.250 1 1
v 2.250 2 1
f -3 -2 -1
o tree_0001
v 4 4 1
f 4 5 7
o stray_0001
f 1 2 7
"""


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module of its own, as ``python3 scripts/NAME.py`` finds it."""
    return load_script("benchmark_build", monkeypatch)


@pytest.fixture
def city(script: ModuleType, tmp_path: Path) -> Path:
    from city_generator.city import write_city

    path = tmp_path / "city.obj"
    with path.open("w", encoding="ascii") as stream:
        # In many so small cities the building that is removed bounds the whole, and the grid.
        write_city(stream, 30, 13, (0.0, 0.0, 0.0), clean=False)
    return path


def _said(result: Any, lights: Sequence[str]) -> dict[str, Any]:
    """Return what the command line would print of a build, as far as it is asked."""
    return {
        "n_bytes": result.cache.n_bytes,
        "content_digest": result.cache.content_digest,
        "objects": 30,
        "triangles_in": 3000,
        "lights": lights,
        "reused_objects": result.reused,
        "stages": [asdict(row) for row in result.stages],
    }


def _in_this_process(script: ModuleType) -> Callable[..., Any]:
    """Return a way to execute builds without starting Python; all else is not done."""
    from build_benchmark.processes import Run

    def execute(command: Sequence[str], variables: Mapping[str, str] | None) -> Run:
        if "build" not in command:
            return Run(2.0, 2.0, 20.0, 0, "")
        lights = [command[i + 1] for i, word in enumerate(command) if word == "--light"]
        target = command[command.index("-o") + 1]
        begun = time.perf_counter()
        result = build([command[4]], target, lights=lights, is_full="--full" in command)
        wall_s = time.perf_counter() - begun
        return Run(wall_s, 1.0, 100.0, 0, "", json.dumps(_said(result, lights)))

    return execute


def test_a_process_is_accounted_for(script: ModuleType) -> None:
    code = "import sys; print('said'); print('first\\nlast', file=sys.stderr); "
    done = script.run([sys.executable, "-c", code + "b = bytearray(50_000_000); sys.exit(3)"])
    assert (done.said, done.last_words, done.exit_status) == ("said\n", "last", 3)
    assert done.cpu_s > 0.0
    assert done.peak_mb > 50.0


def test_what_starts_processes_is_small(script: ModuleType) -> None:
    """The system counts to a process what its parent held."""
    code = "import benchmark_build, sys; print(sorted({'numpy', 'numba', 'h5py'} & {*sys.modules}))"
    done = script.run([sys.executable, "-c", code], {"PYTHONPATH": str(SCRIPTS)})
    assert done.said.strip() == "[]", done.last_words


def test_one_building_is_changed(script: ModuleType, tmp_path: Path) -> None:
    from build_benchmark.models import find_building, write_edited, write_without

    path, copy = tmp_path / "city.obj", tmp_path / "copy.obj"
    path.write_text(OBJ)
    house = find_building(path)
    assert (house.name, house.first_vertex, house.vertex) == ("house_0001", 3, 3)
    write_edited(path, house, copy)
    assert copy.read_text() == OBJ.replace("v 1.250 1 1", "v 1.500 1 1")
    write_without(path, house, copy)
    assert copy.read_text() == OBJ.replace("o house_0001\n", "").replace("f -3 -2 -1\n", "")


def test_a_model_without_objects_is_refused(
    script: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "city.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert script.main(["--input", str(path), "--work", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: city.obj: no ")
    assert "--only build" in error


@pytest.fixture
def bench(script: ModuleType, city: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """All parts run once, builds in this process."""
    from build_benchmark import rounds
    from build_benchmark.models import find_building

    monkeypatch.setattr(rounds, "LEAST_FIRST_ROUNDS", 1)
    monkeypatch.setattr(script.Bench, "_installed", lambda self: rounds.PEERS.items())
    bench = script.Bench(city, city.parent, 1, _in_this_process(script))
    bench.compare()
    bench.first_builds()
    bench.incremental(find_building(city))
    city.with_name("city_300.obj").write_bytes(city.read_bytes() + b"# another one\n")
    bench.region(300)
    bench.clean()
    return bench


def _check_incremental(rows: Sequence[Any]) -> None:
    from build_benchmark.rounds import (
        EDITED,
        FULL,
        LAMP_EDITED,
        LAMP_FULL,
        REMOVED,
        UNEDITED,
        UNLIT,
    )  # fmt: skip

    reused = {row.name: row.built.reused for row in rows if row.turn == 0}
    assert reused == {FULL: 0, UNEDITED: 30, EDITED: 29, REMOVED: 29, UNLIT: 30} | {
        LAMP_FULL: 0,
        LAMP_EDITED: 29,
    }
    assert [row.turn for row in rows if row.name == EDITED] == [-1, 0]
    assert len({row.built.content_digest for row in rows}) == 6


def test_wrong_caches_end_the_run(script: ModuleType, tmp_path: Path) -> None:
    bench = script.Bench(tmp_path / "city.obj", tmp_path, 1)
    bench._check("a build", "city", "12")
    bench._check("another build", "city", "12")
    with pytest.raises(script.Inconsistent, match=r"content digest 13, another build .* had 12"):
        bench._check("over an older cache", "city", "13")
    with pytest.raises(script.Inconsistent, match="city and edited have one content digest"):
        bench._check("a building edited", "edited", "12")


def test_a_failed_build_ends_the_run(script: ModuleType, tmp_path: Path) -> None:
    from build_benchmark.rounds import BUILD

    def execute(command: Sequence[str], variables: Mapping[str, str] | None) -> Any:
        return script.Run(1.0, 1.0, 1.0, 1, "svprep: city.obj: no such file")

    bench = script.Bench(tmp_path / "city.obj", tmp_path, 1, execute)
    with pytest.raises(script.CommandFailed, match=r"svprep build city\.obj: svprep: city\.obj"):
        bench.full(BUILD, 0)


def test_helps_are_timed(script: ModuleType, tmp_path: Path) -> None:
    from build_benchmark.rounds import PLAIN_TYPER, RICH_TYPER, SVPREP_HELP

    bench = script.Bench(tmp_path / "city.obj", tmp_path, 1)
    bench.helps(1)
    assert [row.name for row in bench.rows] == 2 * [SVPREP_HELP, PLAIN_TYPER, RICH_TYPER]
    assert not bench.imports_numpy()


def test_all_parts_are_reported_and_the_report_can_be_remade(
    script: ModuleType, bench: Any, city: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from build_benchmark import rounds
    from build_benchmark.rounds import HELP, SVPREP_HELP

    assert sorted(path.name for path in city.parent.iterdir()) == ["city.obj", "city_300.obj"]
    _check_incremental([row for row in bench.rows if row.part == rounds.INCREMENTAL])
    bench.rows += [
        rounds.Row(HELP, name, 0, script.Run(wall_s, 0.1, 20.0, 0, ""))
        for name, wall_s in (
            (SVPREP_HELP, 0.25),
            (rounds.PLAIN_TYPER, 0.1),
            (rounds.RICH_TYPER, 0.2),
        )
    ]
    figures = script.Figures(
        command="a command", machine="a machine", load="no load", model="Generated city",
        n_bytes=city.stat().st_size, region_bytes=None, imports_numpy=False,
        left_out=["trimesh load"], rows=bench.rows,
    )  # fmt: skip
    text = script.markdown(figures)
    kept, report = city.with_name("figures.json"), city.with_name("build.md")
    kept.write_text(json.dumps(asdict(figures)))
    assert script.main(["--remake", str(kept), "-o", str(report)]) == 0
    assert report.read_text() == capsys.readouterr().out == text
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
    rows = {row[0]: row[1:] for row in cells if row}
    assert rows["svprep --help over a bare Typer program, wall"] == [
        "1.25", "2.50", "missed, 2.00 times",
    ]  # fmt: skip
    assert rows["whole build over pymeshlab load, wall"][2] == "met"
    assert rows["the same with little memory: content digest"] == ["equal", "equal", "met"]
    assert rows["a building edited"][-1] == "29 of 30"
    assert {"load", "silhouettes", "write", "whole process"} <= set(rows)
    assert "trimesh load: not installed (pip install trimesh)" in text
    assert "nan" not in text
    assert max(len(line) for line in text.splitlines() if not line.startswith("|")) <= 100


def test_a_build_tells_what_is_read_of_it(script: ModuleType, city: Path, tmp_path: Path) -> None:
    from build_benchmark.rounds import BUILD, FULL

    bench = script.Bench(city, tmp_path, 1)
    bench.full(BUILD, 0)
    (row,) = bench.rows
    assert (row.name, row.run.said, row.built.objects, row.built.lights) == (FULL, "", 30, 1)
    assert row.built.n_bytes == (tmp_path / "benchmark.svp.h5").stat().st_size
    assert [stage.name for stage in row.built.stages][:2] == ["load", "weld"]
