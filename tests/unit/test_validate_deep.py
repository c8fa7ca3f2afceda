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
from tests.unit.cache_samples import two_spheres

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
    assert codes == {"V602", "V605"}


@pytest.mark.parametrize("method", checks.SEARCHES)
def test_a_search_that_misses_an_edge_is_found(
    method: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = tmp_path / "a.svp.h5"
    write_cache(prepared("clean_cube.obj"), path)
    right = checks.silhouette

    def one_edge_short(cache, light, asked):
        found = right(cache, light, asked)
        if asked != method:
            return found
        return replace(found, edge=found.edge[1:], multiplicity=found.multiplicity[1:])

    monkeypatch.setattr(checks, "silhouette", one_edge_short)
    problems = checks.validate(path, deep=True).problems
    assert {p.code for p in problems} == {"V605"}
    assert all(f"method {method} " in p.message for p in problems)


def test_right_trees_pass(tmp_path: Path) -> None:
    assert deep(two_spheres(), tmp_path) == []


@pytest.mark.parametrize(
    ("block", "number", "n_units"),
    [(1, 3, 3), (3, 3, 3), (20, 3, 3), (34, 3, 3), (2, 7, 3), (15, 7, 3), (40, 7, 3)],
)
def test_a_sphere_or_cone_too_small_is_found(
    block: int, number: int, n_units: int, tmp_path: Path
) -> None:
    right = two_spheres()
    blocks = right.index.cones.blocks.copy()
    assert 0 < blocks[block, number, 0] < 32_000
    blocks[block, number, 0] -= n_units
    assert deep(with_cones(right, blocks), tmp_path) == ["V412"]


@pytest.mark.parametrize("number", [1, 4, 5])
def test_a_sphere_moved_or_an_axis_turned_is_found(number: int, tmp_path: Path) -> None:
    blocks = two_spheres().index.cones.blocks.copy()
    blocks[10, number, 2] += 1_500
    assert deep(with_cones(two_spheres(), blocks), tmp_path) == ["V412"]


def test_a_bound_far_too_small_loses_edges_and_both_are_said(tmp_path: Path) -> None:
    blocks = two_spheres().index.cones.blocks.copy()
    blocks[1:33, 3] //= 2
    blocks[1:33, 7] //= 2
    assert set(deep(with_cones(two_spheres(), blocks), tmp_path)) == {"V412", "V605"}


def test_a_cone_that_bounds_nothing_needs_no_sphere(tmp_path: Path) -> None:
    blocks = two_spheres().index.cones.blocks.copy()
    blocks[10, :7, 2] = 0
    blocks[10, 7, 2] = 32_000
    assert deep(with_cones(two_spheres(), blocks), tmp_path) == []


def with_cones(right: Prepared, blocks: np.ndarray) -> Prepared:
    cones = replace(right.index.cones, blocks=blocks)
    return replace(right, index=replace(right.index, cones=cones))


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
