"""The silhouette benchmark: its baselines are right, and its report is whole."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from svprep.cache.reader import open_cache
from svprep.pipeline import build
from svprep.silhouette import METHODS, silhouette
from tests.unit.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
BASELINES = ("(a) NumPy flat", "(b) Numba, 1 thread")


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module of its own, as ``python3 scripts/NAME.py`` finds it."""
    return load_script("benchmark_silhouette", monkeypatch)


def test_quick_run_reports_every_method(
    script: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report, figures = tmp_path / "report.md", tmp_path / "report.json"
    arguments = ["--quick", "--work", str(tmp_path / "work"), "-o", str(report), "-o", str(figures)]
    assert script.main(arguments) == 0
    text = capsys.readouterr().out
    assert report.read_text(encoding="utf-8") == text
    datasets = json.loads(figures.read_text(encoding="utf-8"))["datasets"]
    assert [d["name"] for d in datasets] == ["small_city", "smooth_50000"]
    for dataset in datasets:
        section = text.split(f"## {dataset['name']}\n")[1].split("\n## ")[0]
        rows = [line.split("|")[1].strip() for line in section.splitlines() if "| " in line]
        for name in (*METHODS, *BASELINES):
            assert name in rows
            assert len(dataset["timings"][name]["ms"]) == 5
        # All answers were equal, or the run had ended with status 1.
        assert len({tuple(t["found"]) for t in dataset["timings"].values()}) == 1
        assert dataset["baseline"] not in dataset["ratios"]
        assert dataset["published"] is not None
    city = datasets[0]
    assert [row["objects"] for row in city["subsets"][::2]] == [3, 30, 300]
    assert len(city["coherent"]["auto"]["ms"]) == 60


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("branching", [False, True])
def test_baselines_agree_with_the_product(
    script: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    threads: int,
    branching: bool,
) -> None:
    from silhouette_benchmark.numba_scan import NumbaScan

    monkeypatch.setattr("silhouette_benchmark.numba_scan.RECORDS_PER_THREAD", 100)
    path = tmp_path / "small_city.svp.h5"
    build([ROOT / "data" / "small_city.obj.gz"], path)
    with open_cache(path) as cache:
        tables = script.flat_tables(cache)
        corner = cache.mesh.positions[cache.mesh.faces[0]].mean(axis=0)
        lights = [
            *script.random_lights(cache.mesh.positions, 6, 3),
            np.array([0.0, 0.0, 1.0, 0.0], np.float32),
            np.array([*corner, 1.0], np.float32),
            *(np.array([*p, 1.0], np.float32) for p in _middles_of_solids(tables)),
        ]
        compiled = NumbaScan(tables, threads, branching)
        assert compiled.threads == threads
        scans = [script.NumpyScan(tables), compiled]
        for by_object in {False, compiled.by_object}:
            compiled.by_object = by_object
            for light in lights:
                expected = silhouette(cache, light)
                for scan in scans:
                    found = scan(light)
                    np.testing.assert_array_equal(found.edge, expected.edge)
                    np.testing.assert_array_equal(found.multiplicity, expected.multiplicity)
                    np.testing.assert_array_equal(found.object_start, expected.object_start)
                    assert found.multiplicity.dtype == np.int8


def _middles_of_solids(tables: Any) -> np.ndarray:
    """Lights that turn a solid's closed volume into a robust one."""
    return ((tables.solid_low + tables.solid_high) / 2)[:: max(1, len(tables.solid_low) // 5)]


def test_a_difference_ends_the_run(
    script: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    numpy_scan = script.NumpyScan.__call__

    def one_too_few(self: Any, light: np.ndarray) -> Any:
        found = numpy_scan(self, light)
        return found._replace(edge=found.edge[1:])

    monkeypatch.setattr(script.NumpyScan, "__call__", one_too_few)
    status = script.main(["--quick", "--datasets", "smooth:300", "--methods", "auto"])
    assert status == 1
    assert "differ in edge" in capsys.readouterr().err


def test_what_is_absent_is_named_and_left_out(
    script: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [str(tmp_path / "absent.obj"), "smooth:"]
    assert script.main(["--quick", "--datasets", *names]) == 0
    assert capsys.readouterr().err.count("left out: ") == 2
