"""A scene that changed: its trees and its clamped lights are those of a build from nothing."""

from __future__ import annotations

from dataclasses import fields, replace
from unittest.mock import patch

import numpy as np
import pytest

from svprep import clamp_changes
from svprep import scene_tree as scene_tree_module
from svprep.clamp import ClampCosts, clamp_changed, clamp_lights, joined
from svprep.clamp_changes import PreviousClamp, SceneParts, TakenOver, taken_over
from svprep.clamp_rectangles import _in_views, not_empty
from svprep.errors import InputError
from svprep.hilbert import hilbert_keys
from svprep.light import parse_light
from svprep.model import Mesh, Prepared, SceneTree, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep.ranges import rows_of_runs
from svprep.scene_tree import (
    EarlierScene,
    build_scene_tree,
    join_clusters,
    local_clusters,
    scene_tree,
    updated_scene_tree,
)
from tests.property.meshes import cube, moved, side_by_side, sphere
from tests.unit.cache_samples import assert_same

LIGHTS = ("dir:135,40", "dir:20,3", "point:3.1,-2.3,60", "point:40.2,3.3,4.1")
KINDS = ("change", "remove", "add", "reorder", "several", "farther")
ANY_GAP = ClampCosts(vertex=0.01)


def town(seed: int) -> list[SourceMesh]:
    """Return some forty buildings, domes and slabs, between two posts that hold the extent."""
    rng = np.random.default_rng(seed)
    posts = [moved(cube(2.0), (at, at, 0.0)) for at in (-400.0, 400.0)]
    ground = [moved(cube(40.0), (40.0 * i, 40.0 * j, -40.0)) for i in (-1, 0) for j in (-1, 0)]
    return [*posts, *ground, *(building(rng) for _ in range(40))]


def building(rng: np.random.Generator) -> SourceMesh:
    size = float(rng.integers(2, 9))
    at = (*(float(x) for x in rng.integers(-300, 300, 2)), float(rng.integers(0, 20)))
    return moved(sphere(5, 6, size) if rng.random() < 0.4 else cube(size), at)


def edited(kind: str, parts: list[SourceMesh], seed: int) -> tuple[list[SourceMesh], list[int]]:
    """Return the objects of a changed town, and the number that each had before, or -1."""
    rng = np.random.default_rng(seed + 100)
    new, before = list(parts), list(range(len(parts)))
    i = int(rng.integers(6, len(parts)))
    if kind in ("change", "several"):
        new[i], before[i] = building(rng), -1
    if kind in ("remove", "several"):
        del new[i - 1], before[i - 1]
    if kind in ("add", "several"):
        new.insert(i // 2, building(rng))
        before.insert(i // 2, -1)
    if kind == "reorder":
        order = [0, 1, *(2 + rng.permutation(len(parts) - 2))]
        new, before = [parts[j] for j in order], [int(j) for j in order]
    if kind == "farther":
        new[1], before[1] = moved(cube(2.0), (900.0, 900.0, 0.0)), -1
    return new, before


def on_one_grid(parts: list[SourceMesh], mesh: Mesh | None = None) -> Prepared:
    """Prepare objects on the grid of another mesh."""
    source = side_by_side(*parts)
    if mesh is None:
        return prepare(source, BuildConfig())
    with patch("svprep.pipeline.choose_grid", return_value=mesh.grid):
        return prepare(source, BuildConfig())


def parts_of(city: Prepared) -> SceneParts:
    mesh, components = city.mesh, city.components
    return SceneParts(
        tree=city.scene,
        object_start=components.object_start,
        face_start=components.face_start,
        points_of=lambda faces: mesh.positions[mesh.faces[faces].reshape(-1)],
    )


def previous_of(old: Prepared, new: Prepared, before: np.ndarray, table: object) -> PreviousClamp:
    parts = [
        np.arange(*old.components.object_start[i : i + 2])
        if i >= 0
        else np.full(int(np.diff(new.components.object_start[j : j + 2])[0]), -1)
        for j, i in enumerate(before.tolist())
    ]
    gone = np.setdiff1d(np.arange(len(old.scene.objects)), before)
    boxes = [old.scene.object_boxes[gone], new.scene.object_boxes[before < 0]]
    caster_before = np.concatenate(parts)
    return PreviousClamp(
        table=table,
        then=parts_of(old),
        now=parts_of(new),
        caster_before=caster_before,
        casters_gone=np.setdiff1d(np.arange(len(old.components.flags)), caster_before),
        changed_boxes=np.concatenate(boxes),
    )


def updated(old: Prepared, new: Prepared, before: np.ndarray) -> SceneTree | None:
    """Return the tree of a changed town from the one before."""
    mesh = new.mesh
    start, chosen = mesh.object_face_start, np.flatnonzero(before < 0)
    rows, face_start = rows_of_runs(start, chosen)
    alone = replace(
        mesh,
        faces=mesh.faces[rows],
        object_face_start=face_start,
        object_vertex_start=np.zeros(len(chosen) + 1, np.int64),
        source_face=mesh.source_face[rows],
    )
    return updated_scene_tree(
        EarlierScene(old.mesh, old.scene, before), start, local_clusters(alone)
    )


def assert_trees_alike(one: SceneTree, other: SceneTree) -> None:
    for field in fields(SceneTree):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes(), field.name


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("kind", KINDS)
def test_a_changed_scene_is_as_if_built_from_nothing(kind: str, seed: int) -> None:
    kept = check_changed(kind, seed)
    # What is farther may end the scene elsewhere, and with it every volume.
    assert all(one.units is not None for one in kept) or kind == "farther"


def check_changed(kind: str, seed: int) -> list[TakenOver]:
    """Change a town, compare its trees and lights, and return what was taken over."""
    parts = town(seed)
    old = on_one_grid([*parts, moved(cube(2.0), (1500.0, 1500.0, 0.0))])
    if kind != "farther":  # else the far corner goes, and with it the pad
        parts.append(moved(cube(2.0), (1500.0, 1500.0, 0.0)))
    objects, numbers = edited(kind, parts, seed)
    new, before = on_one_grid(objects, old.mesh), np.array(numbers)
    assert new.mesh.grid.step_m == old.mesh.grid.step_m
    tree = updated(old, new, before)
    assert (tree is None) == (kind == "reorder")
    assert_trees_alike(tree or new.scene, build_scene_tree(new.mesh))
    lights = [parse_light(spec) for spec in LIGHTS]
    tables = [
        clamp_lights(one.mesh, one.components, one.scene, lights, ANY_GAP) for one in (old, new)
    ]
    found: list[TakenOver | None] = []
    with patch("svprep.clamp.taken_over", lambda *a: found.append(taken_over(*a)) or found[-1]):
        again = clamp_changed(
            previous_of(old, new, before, tables[0]), lambda: (new.mesh, new.components),
            new.mesh.grid, lights, ANY_GAP,
        )  # fmt: skip
    assert_same(again, tables[1])
    kept = [one for one in found if one is not None]
    assert len(kept) >= 2 or kind == "farther"  # a lamp may see a change everywhere
    return kept


@pytest.mark.parametrize("is_caster", [False, True])
@pytest.mark.parametrize(("x1", "views"), [(50.0, [5]), (120.0, [0, 5])])
def test_a_slab_below_a_lamp_is_in_views_that_see_it(
    is_caster: bool, x1: float, views: list[int]
) -> None:
    low, high = np.array([[-50.0, -50.0, -91.0]]), np.array([[x1, 50.0, -90.0]])
    assert not_empty(_in_views(low, high, 1e-3, range(6), is_caster)) == views


def test_however_many_runs_probes_and_nodes_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("_MOST_SLICES", 1), ("_MOST_DEEPEST", 0), ("_FIRST_DEEPEST", 1)):
        monkeypatch.setattr(clamp_changes, name, value)
    monkeypatch.setattr(scene_tree_module, "_PROBES", 1)
    for kind in ("change", "add"):
        assert any(one.units is None for one in check_changed(kind, 2))


def test_surfaces_that_were_counted_in_another_way_are_summed_anew() -> None:
    town_now = on_one_grid(town(4))
    lights = [parse_light(spec) for spec in LIGHTS]
    expected = clamp_lights(town_now.mesh, town_now.components, town_now.scene, lights)
    table = replace(expected, facts=expected.facts + [0.0, 0.0, 1e-7, 1e-7, 1e-7])
    everyone = np.arange(len(town_now.scene.objects))
    previous = previous_of(town_now, town_now, everyone, table)
    whole = town_now.mesh, town_now.components
    assert_same(clamp_changed(previous, lambda: whole, town_now.mesh.grid, lights), expected)


def test_a_lamp_on_a_vertex_is_refused_as_ever() -> None:
    city = on_one_grid(town(5))
    sun = parse_light(LIGHTS[0])
    x, y, z = (city.mesh.positions[100] + city.mesh.grid.origin_m).tolist()
    lamp = parse_light(f"point:{x!r},{y!r},{z!r}")
    arguments = city.mesh, city.components, city.scene
    table = clamp_lights(*arguments, [sun])
    table = replace(table, lights=np.array([lamp.in_cache_frame(city.mesh.grid)]))
    previous = previous_of(city, city, np.arange(len(city.scene.objects)), table)
    errors = []
    for do in (
        lambda: clamp_lights(*arguments, [lamp]),
        lambda: clamp_changed(previous, lambda: arguments[:2], city.mesh.grid, [lamp]),
    ):
        with pytest.raises(InputError, match="lies exactly on a vertex") as caught:
            do()
        errors.append(str(caught.value))
    assert errors[0] == errors[1]


def test_only_lights_of_the_same_costs_are_taken_over() -> None:
    old = on_one_grid(town(3))
    arguments = old.mesh, old.components, old.scene
    sun, lamp = (parse_light(spec) for spec in (LIGHTS[0], LIGHTS[2]))
    table = clamp_lights(*arguments, [sun], ANY_GAP)
    everyone = np.arange(len(old.scene.objects))
    previous = previous_of(old, old, everyone, joined(table, table))
    for costs in (ANY_GAP, ClampCosts()):
        expected = clamp_lights(*arguments, [lamp, sun], costs)
        mesh, components, _ = arguments
        found = clamp_changed(
            previous, lambda m=mesh, c=components: (m, c), mesh.grid, [lamp, sun], costs
        )
        assert_same(found, expected)


def test_tiles_join_to_the_whole() -> None:
    mesh = on_one_grid(town(2)).mesh
    start, vertices = mesh.object_face_start, mesh.object_vertex_start
    parts = []
    for a, b in ((0, 7), (7, 8), (8, len(start) - 1)):
        faces = slice(start[a], start[b])
        tile = replace(
            mesh,
            positions=mesh.positions[vertices[a] : vertices[b]],
            faces=mesh.faces[faces] - np.uint32(vertices[a]),
            object_vertex_start=vertices[a : b + 1] - vertices[a],
            object_face_start=start[a : b + 1] - start[a],
            source_face=mesh.source_face[faces],
        )
        parts.append(local_clusters(tile))
    assert_trees_alike(scene_tree(join_clusters(parts)), build_scene_tree(mesh))


@pytest.mark.parametrize("shift", [0, 6, 17])
def test_the_curve_steps_from_cell_to_neighbour(shift: int) -> None:
    cells = np.indices((16, 16, 16)).reshape(3, -1).T
    keys = hilbert_keys(cells << shift)
    steps = np.abs(np.diff(cells[np.argsort(keys)], axis=0)).sum(axis=1)
    assert len(np.unique(keys)) == len(cells)
    assert (steps == 1).all()
