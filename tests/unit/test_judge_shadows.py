"""The judged table: what is judged how often, what is kept, and that a wrong picture is told."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from svprep.cache.reader import open_cache
from svprep.pipeline import build
from tests.unit.scripts import load_script

pytest.importorskip("moderngl", reason="judging needs the extra view: OpenGL")
pytest.importorskip("embreex", reason="judging needs the extra judge: rays")

ROOT = Path(__file__).resolve().parents[2]
SMALL = ["--small", "--size", "64x48"]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module of its own, as ``python3 scripts/NAME.py`` finds it."""
    return load_script("judge_shadows", monkeypatch)


@pytest.fixture
def quick(script: ModuleType, house: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, with the house built in this process and the code's digests made up."""
    from shadow_judging import datasets
    from shadow_judging.store import Code

    def prepare(source: datasets.Source, work: Path) -> datasets.Ready:
        assert source.path == str(house)
        cache = house.with_suffix(".svp.h5")
        if not cache.exists():
            build([house], cache)
        with open_cache(cache) as opened:
            return datasets.Ready(source, cache, opened.content_digest)

    monkeypatch.setattr(script, "prepare", prepare)
    monkeypatch.setattr(Code, "now", lambda: Code("judge", "runtime"))
    return script


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A box on a ground of 40 m x 40 m: closed, with room for a lamp. Caches stay beside it."""
    path = tmp_path_factory.mktemp("judged") / "house.obj"
    corners = [(x, y, z) for z in (0, 6) for y in (-4, 4) for x in (-4, 4)]
    ground = [(x, y, -0.01) for y in (-20, 20) for x in (-20, 20)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners + ground]
    lines += ["f 1 3 4 2", "f 5 6 8 7", "f 1 2 6 5", "f 3 7 8 4", "f 1 5 7 3", "f 2 4 8 6"]
    lines += ["g ground", "f 9 10 12 11"]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["small_city.obj.gz", "a", "b", "c", "d", "e"])
def test_each_combination_occurs_equally_often(script: ModuleType, name: str) -> None:
    from shadow_judging.plan import shots

    every = shots(name, small=False)
    once = [shot for shot in every if shot.part == "once"]
    assert len({(shot.view, shot.light) for shot in once}) == len(once) == 24
    ways = Counter((shot.method, shot.construction, shot.clamp) for shot in once)
    assert len(ways) == 12
    assert set(ways.values()) == {2}
    by_light = Counter((shot.light, shot.method) for shot in once)
    assert set(by_light.values()) == {2}
    pairs = {(shot.light, shot.construction, shot.clamp) for shot in once}
    assert len(pairs) == 16
    in_all = [shot for shot in every if shot.part == "all"]
    assert len({shot.way for shot in in_all}) == len(in_all) == 24
    assert len({(shot.view, shot.light) for shot in in_all}) == 1
    assert {shot.method for shot in every if shot.part == "apart"} == {"zp+"}


def test_small_pictures_have_each_pair_and_method(script: ModuleType) -> None:
    from shadow_judging.plan import shots

    small = shots("conformance/clean_cube.obj", small=True)
    assert len({(shot.view, shot.light) for shot in small}) == len(small) == 4
    assert len({(shot.construction, shot.clamp) for shot in small}) == 4
    assert len({shot.method for shot in small}) == 3


def test_views_are_what_they_are_called(script: ModuleType, house: Path) -> None:
    from shadow_judging.views import LAMP, Chooser

    prepared = build([house], house.with_suffix(".svp.h5")).prepared
    mesh, grid = prepared.mesh, prepared.mesh.grid
    chooser, again = Chooser(mesh, grid), Chooser(mesh, grid)
    for view in ("street", "bird"):
        assert chooser.view(view, LAMP) == again.view(view, "sun 20")
    for light in ("sun 20", LAMP):
        eye = chooser.view("in shadow", light).camera(grid, 64, 48).eye.astype(np.float64)
        at = chooser.light(light).in_cache_frame(grid)
        assert chooser.place.is_in_shadow(eye[None] @ chooser.place.axes.T, at)[0]
    assert chooser.lamp.n_blocked == 26
    x, y, z = (float(c) for c in chooser.light(LAMP).spec.removeprefix("point:").split(","))
    assert max(abs(x), abs(y)) < 4.0
    assert 0.0 < z < 6.0
    cut = chooser.view("near plane", "sun 20").camera(grid, 64, 48)
    columns, rows = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    rays = cut.directions(columns.ravel(), rows.ravel())
    eyes = np.broadcast_to(cut.eye, rays.shape).astype(np.float32)
    _, depth = chooser.place.scene.first_hit(eyes, rays.astype(np.float32))
    assert 0.002 < (depth < cut.near_m).mean() < 0.3
    for name, down_deg in (("oblique", 8.0), ("bird", 50.0)):
        forward = chooser.view(name, "sun 20").camera(grid, 64, 48).forward
        assert np.degrees(np.arcsin(-forward[2])) == pytest.approx(down_deg, abs=0.01)


def test_up_is_the_axis_along_which_a_model_is_thin(script: ModuleType) -> None:
    from shadow_judging.place import _axes

    rng = np.random.default_rng(1)
    level = rng.uniform(-1.0, 1.0, (500, 3)) * [50.0, 40.0, 1.0]
    level[:, 2] = np.abs(level[:, 2]) ** 4 * 8.0  # towers: few are high
    area = np.ones(500)
    assert np.array_equal(_axes(level, area), np.eye(3))
    lying = level[:, [0, 2, 1]]  # y up
    axes = _axes(lying, area)
    assert axes[2] == pytest.approx([0.0, 1.0, 0.0], abs=0.1)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_a_run_is_judged_kept_and_resumed(
    quick: ModuleType, house: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    work, figures = house.parent, tmp_path / "figures.json"
    (work / "results.jsonl").unlink(missing_ok=True)
    common = ["--work", str(work), "--json", str(figures), *SMALL, "--datasets", str(house)]
    assert quick.main([*common, "no_such_city"]) == 0
    said = capsys.readouterr()
    assert "no_such_city: absent" in said.out
    assert "[4/4" in said.err
    report = json.loads(figures.read_text("utf-8"))
    assert report["n_new"] == 4
    results = report["blocks"][0]["judged"][0]["results"]
    assert sum(one["n_differing"] for one in results) == 0
    assert all(one["n_decidable"] > 0.6 * one["n_surface"] > 0 for one in results)
    assert str(work) not in said.out

    # As if it had been interrupted within the last line.
    lines = (work / "results.jsonl").read_text("utf-8")
    (work / "results.jsonl").write_text(lines[:-40], "utf-8")
    assert quick.main(common) == 0
    report = json.loads(figures.read_text("utf-8"))
    assert report["n_new"] == 1
    assert report["blocks"][0]["judged"][0]["results"][-1]["truth_s"] == 0.0


def test_a_pixel_that_differs_is_named_and_fails(
    quick: ModuleType,
    house: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from shadow_judging import judging

    drawn = judging.render

    def one_wrong(scene, targets, camera, lights, settings):
        picture = drawn(scene, targets, camera, lights, settings)
        wrong = picture.in_shadow[0].copy()
        wrong[40, 30] ^= True
        return replace(picture, in_shadow=(wrong,))

    monkeypatch.setattr(judging, "render", one_wrong)
    monkeypatch.setattr(quick, "ADMITTED", tmp_path / "admitted.toml")
    common = [*SMALL, "--work", str(house.parent), "--datasets", str(house)]
    results = house.parent / "results.jsonl"
    results.unlink(missing_ok=True)
    assert quick.main(common) == 1
    assert "30, 40: " in capsys.readouterr().out
    assert quick.main([*common, "--admit"]) == 0
    assert '"house.obj" = ' in (tmp_path / "admitted.toml").read_text("utf-8")
    # With a renderer that is right again the number goes down, and stays there.
    monkeypatch.setattr(judging, "render", drawn)
    results.unlink()
    assert quick.main([*common, "--admit"]) == 0
    assert '"house.obj" = 0' in (tmp_path / "admitted.toml").read_text("utf-8")


def test_what_is_admitted_only_goes_down(script: ModuleType) -> None:
    from shadow_judging.admitted import exceeded, lowered

    before = {"1280x1024": {"a": 3, "b": 2}}
    after = lowered(before, "1280x1024", {"a": 1, "b": 5, "c": 4})
    assert after == {"1280x1024": {"a": 1, "b": 2, "c": 4}}
    assert exceeded(after["1280x1024"], {"a": 1, "b": 5, "d": 1}) == {"b": (5, 2), "d": (1, 0)}


def test_what_is_written_by_hand_stays(script: ModuleType) -> None:
    from shadow_judging.table import WRITTEN_ENDS, with_written

    def report(seconds: int) -> str:
        return f"# Shadows\n\n{seconds} s\n\n## Pixels that differ\n\nNone.\n"

    first = with_written(report(1), "")
    edited = first.replace("Nothing is written yet.", "Two, by lamplight.")
    again = with_written(report(2), edited)
    assert again == edited.replace("1 s", "2 s")
    assert again.index("Two, by lamplight.") < again.index(WRITTEN_ENDS) < again.index("None.")


def test_digests_of_code_see_meaning_and_not_words(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from shadow_judging import code_digest as module

    (tmp_path / "svprep").mkdir()
    first, second = tmp_path / "svprep" / "first.py", tmp_path / "svprep" / "second.py"
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "_FOLDERS", {"svprep": tmp_path / "svprep"})

    def digest(of_first: str, of_second: str) -> str:
        first.write_text(of_first, "utf-8")
        second.write_text(of_second, "utf-8")
        module._looked_at.cache_clear()
        return module.code_digest(["svprep.first"])

    plain = digest("from svprep.second import x\n", "x = 1\n")
    assert digest("'''Text.'''\nfrom svprep.second import x  # why\n", "x  =  1\n") == plain
    assert digest("from svprep.second import x\n", "x = 2\n") != plain
