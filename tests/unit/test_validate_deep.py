"""The deep validation finds what the quick one cannot: tables that are whole but wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from svprep import validate as checks
from svprep.cache.verify import verify
from svprep.cache.writer import write_cache
from svprep.errors import EnvironmentProblem
from svprep.ingest import read
from svprep.model import ComponentFlag, Prepared
from svprep.pipeline import BuildConfig, prepare

CONFORMANCE = Path(__file__).resolve().parents[2] / "data" / "conformance"


@cache
def prepared(name: str) -> Prepared:
    return prepare(read([CONFORMANCE / name]), BuildConfig())


def deep(changed: Prepared, folder: Path) -> list[str]:
    path = folder / "a.svp.h5"
    write_cache(changed, path)
    assert verify(path) == [], "the quick check finds it already: the test shows nothing"
    return [p.code for p in checks.validate(path, deep=True).problems]


@pytest.mark.parametrize(
    "name", ["clean_cube.obj", "touching_cubes_wall.obj", "mobius_strip.obj", "open_shell.obj"]
)
def test_a_right_cache_passes(name: str, tmp_path: Path) -> None:
    assert deep(prepared(name), tmp_path) == []


def test_a_solid_that_is_none_is_doubted(tmp_path: Path) -> None:
    right = prepared("self_intersecting_shell.obj")
    assert not (right.components.flags & np.uint8(ComponentFlag.SOLID)).any()
    flags = right.components.flags | np.uint8(ComponentFlag.SOLID)
    wrong = replace(right, components=replace(right.components, flags=flags))
    assert set(deep(wrong, tmp_path)) == {"V604"}


def test_a_solid_turned_inward_is_doubted(tmp_path: Path) -> None:
    right = prepared("clean_cube.obj")
    inward = replace(right.mesh, faces=np.ascontiguousarray(right.mesh.faces[:, [0, 2, 1]]))
    rows = np.ascontiguousarray(right.edges.rows[:, [0, 1, 3, 2]])
    order = np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))
    wrong = replace(
        right,
        mesh=inward,
        edges=replace(right.edges, rows=rows[order], flags=right.edges.flags[order]),
        planes=replace(right.planes, planes=-right.planes.planes),
    )
    assert {"V603", "V604"} <= set(deep(wrong, tmp_path))


def test_a_wrong_sum_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A table cannot be whole and sum wrongly, so here the reader of it is made to err."""
    path = tmp_path / "a.svp.h5"
    write_cache(prepared("clean_cube.obj"), path)
    right = checks.row_multiplicity

    def one_edge_off(edges, side):
        m = right(edges, side).copy()
        m[0] += 1
        return m

    monkeypatch.setattr(checks, "row_multiplicity", one_edge_off)
    codes = {p.code for p in checks.validate(path, deep=True).problems}
    assert codes == {"V602"}


def test_without_manifold3d_the_install_command_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "manifold3d", None)
    with pytest.raises(EnvironmentProblem, match=r"svprep\[judge\]"):
        checks.validate(tmp_path / "a.svp.h5", deep=True)


def test_lights_cover_every_kind() -> None:
    right = prepared("clean_cube.obj")
    lights = checks.random_lights(right.mesh, right.components)
    points = lights[lights[:, 3] == 1.0, :3]
    low, high = right.mesh.positions.min(axis=0), right.mesh.positions.max(axis=0)
    assert len(lights) == 100
    assert ((points > low) & (points < high)).all(axis=1).sum() >= 20
    assert (points[:, 2] < low[2]).any()
    assert np.allclose(np.linalg.norm(lights[lights[:, 3] == 0.0, :3], axis=1), 1.0, atol=1e-6)
