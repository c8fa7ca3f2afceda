"""A scene that changed: its trees and its clamped lights are those of a build from nothing."""

from __future__ import annotations

from dataclasses import fields, replace
from unittest.mock import patch

import numpy as np
import pytest

from svprep.clamp import ClampCosts, clamp_lights, joined
from svprep.clamp_changes import PreviousClamp, segments_after
from svprep.hilbert import hilbert_keys
from svprep.light import parse_light
from svprep.model import Mesh, Prepared, SceneTree, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep.scene_tree import (
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


def previous_of(old: Prepared, new: Prepared, before: np.ndarray, table: object) -> PreviousClamp:
    parts = [
        np.arange(*old.components.object_start[i : i + 2])
        if i >= 0
        else np.full(int(np.diff(new.components.object_start[j : j + 2])[0]), -1)
        for j, i in enumerate(before.tolist())
    ]
    gone = np.setdiff1d(np.arange(len(old.scene.objects)), before)
    boxes = [old.scene.object_boxes[gone], new.scene.object_boxes[before < 0]]
    return PreviousClamp(
        table, np.concatenate(parts), np.concatenate(boxes), old.scene.cluster_nodes[-1]
    )


def assert_trees_alike(one: SceneTree, other: SceneTree) -> None:
    for field in fields(SceneTree):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes(), field.name


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("kind", KINDS)
def test_a_changed_scene_is_as_if_built_from_nothing(kind: str, seed: int) -> None:
    parts = town(seed)
    old = on_one_grid([*parts, moved(cube(2.0), (1500.0, 1500.0, 0.0))])
    if kind != "farther":  # else the far corner goes, and with it the pad
        parts.append(moved(cube(2.0), (1500.0, 1500.0, 0.0)))
    objects, numbers = edited(kind, parts, seed)
    new, before = on_one_grid(objects, old.mesh), np.array(numbers)
    assert new.mesh.grid.step_m == old.mesh.grid.step_m
    tree = updated_scene_tree(new.mesh, old.scene, old.mesh.object_face_start, before)
    assert_trees_alike(tree, build_scene_tree(new.mesh))
    assert_trees_alike(tree, new.scene)
    lights = [parse_light(spec) for spec in LIGHTS]
    tables = [
        clamp_lights(one.mesh, one.components, one.scene, lights, ANY_GAP) for one in (old, new)
    ]
    taken = []
    with patch(
        "svprep.clamp.segments_after", lambda *a: taken.append(segments_after(*a)) or taken[-1]
    ):
        again = clamp_lights(
            new.mesh, new.components, tree, lights, ANY_GAP,
            previous=previous_of(old, new, before, tables[0]),
        )  # fmt: skip
    assert_same(again, tables[1])
    if kind != "farther":
        assert sum(one is not None for one in taken) >= 2  # a lamp may see a change everywhere


def test_only_lights_of_the_same_costs_are_taken_over() -> None:
    old = on_one_grid(town(3))
    arguments = old.mesh, old.components, old.scene
    sun, lamp = (parse_light(spec) for spec in (LIGHTS[0], LIGHTS[2]))
    table = clamp_lights(*arguments, [sun], ANY_GAP)
    everyone = np.arange(len(old.scene.objects))
    previous = previous_of(old, old, everyone, joined(table, table))
    for costs in (ANY_GAP, ClampCosts()):
        expected = clamp_lights(*arguments, [lamp, sun], costs)
        assert_same(clamp_lights(*arguments, [lamp, sun], costs, previous=previous), expected)


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
