"""The scene trees: every object and face once, clusters of one object, boxes exact."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from svprep.model import Mesh, SceneTree, SourceMesh
from svprep.repair.weld import weld
from svprep.scene_tree import build_scene_tree, level_starts, node_boxes
from tests.property.meshes import SUITE, cube, moved, side_by_side, source_mesh, sphere

NOWHERE = [np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf]


def scattered(n: int, seed: int = 0) -> SourceMesh:
    """Return one object of n triangles that do not touch."""
    rng = np.random.default_rng(seed)
    at = rng.integers(0, 1000, (n, 3)) + 2000 * np.arange(n)[:, None] * [1, 0, 0]
    corners = at[:, None] + np.array([[0, 0, 0], [5, 0, 1], [0, 7, 2]])
    return source_mesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3))


def box_of(mesh: Mesh, faces: list[int]) -> list[float]:
    if not faces:
        return NOWHERE
    points = mesh.positions[mesh.faces[faces].reshape(-1)]
    return [*points.min(axis=0).tolist(), *points.max(axis=0).tolist()]


def boxes_above(leaves: list[list[float]]) -> list[list[float]]:
    """Return the boxes of all nodes over `leaves`, one by one."""
    nodes: list[list[float]] = []
    below = leaves
    while not nodes or len(below) > 1:
        level = []
        for i in range(0, len(below), 8):
            low, high = np.hsplit(np.array(below[i : i + 8]), 2)
            level.append([*low.min(axis=0).tolist(), *high.max(axis=0).tolist()])
        nodes += level
        below = level
    return nodes


def assert_right(mesh: Mesh, tree: SceneTree) -> None:
    """Check a tree against its definition, one object and cluster after the other."""
    n_objects = len(mesh.object_face_start) - 1
    start = mesh.object_face_start.tolist()
    assert sorted(tree.objects.tolist()) == list(range(n_objects))
    assert sorted(tree.faces.tolist()) == list(range(len(mesh.faces)))
    boxes = [box_of(mesh, list(range(start[i], start[i + 1]))) for i in range(n_objects)]
    assert tree.object_boxes.tolist() == boxes
    assert tree.object_nodes.tolist() == boxes_above([boxes[i] for i in tree.objects])
    cuts = tree.cluster_start.tolist()
    clusters = [tree.faces[a:b].tolist() for a, b in pairwise(cuts)]
    assert (cuts[0], cuts[-1]) == (0, len(mesh.faces))
    owner = np.searchsorted(mesh.object_face_start, np.arange(len(mesh.faces)), side="right") - 1
    for faces in clusters:
        assert 1 <= len(faces) <= 8
        assert len(set(owner[faces].tolist())) == 1
    # No object has more clusters than it needs.
    sizes = np.diff(mesh.object_face_start)
    assert len(clusters) == int((-(-sizes // 8)).sum())
    above = boxes_above([box_of(mesh, faces) for faces in clusters])
    assert tree.cluster_nodes.tolist() == above
    dtypes = {name: getattr(tree, name).dtype for name in SceneTree.__slots__}
    assert {name: str(dtype) for name, dtype in dtypes.items()} == {
        "objects": "uint32",
        "object_boxes": "float32",
        "object_nodes": "float32",
        "faces": "uint32",
        "cluster_start": "int64",
        "cluster_nodes": "float32",
    }


@pytest.mark.parametrize("n", [1, 2, 7, 8, 9, 16, 17, 63, 64, 65, 512, 513])
def test_one_object(n: int) -> None:
    mesh = weld(scattered(n))[0]
    assert len(mesh.faces) == n
    tree = build_scene_tree(mesh)
    assert_right(mesh, tree)
    assert len(tree.cluster_start) - 1 == -(-n // 8)
    assert tree.object_nodes.tolist() == tree.object_boxes.tolist()


@pytest.mark.parametrize("name", [name for name in SUITE if name != "nothing"])
def test_named_meshes(name: str) -> None:
    mesh = weld(SUITE[name]())[0]
    assert_right(mesh, build_scene_tree(mesh))


@pytest.mark.parametrize("n", [1, 8, 9, 65])
def test_many_objects(n: int) -> None:
    rng = np.random.default_rng(n)
    places = rng.integers(-500, 500, (n, 3)).astype(float)
    mesh = weld(side_by_side(*[moved(cube(), tuple(at)) for at in places.tolist()]))[0]
    tree = build_scene_tree(mesh)
    assert_right(mesh, tree)
    assert len(tree.object_nodes) == int(level_starts(n)[-1])
    assert len(tree.cluster_start) - 1 == 2 * n


def test_objects_without_faces_are_at_the_end() -> None:
    source = source_mesh(cube().positions, cube().faces, [0, 0, 5, 5, 12, 12])
    mesh = weld(source)[0]
    tree = build_scene_tree(mesh)
    assert_right(mesh, tree)
    assert sorted(tree.objects[:2].tolist()) == [1, 3]
    assert tree.objects[2:].tolist() == [0, 2, 4]
    assert tree.object_boxes[[0, 2, 4]].tolist() == [NOWHERE] * 3


def test_nothing() -> None:
    mesh = weld(source_mesh(np.zeros((0, 3)), np.zeros((0, 3)), [0, 0]))[0]
    tree = build_scene_tree(mesh)
    assert tree.objects.tolist() == [0]
    assert tree.object_nodes.tolist() == [NOWHERE]
    assert len(tree.faces) == len(tree.cluster_nodes) == 0
    assert tree.cluster_start.tolist() == [0]


@pytest.mark.parametrize(
    ("n", "starts"),
    [
        (0, [0, 0]),
        (1, [0, 1]),
        (8, [0, 1]),
        (9, [0, 2, 3]),
        (64, [0, 8, 9]),
        (65, [0, 9, 11, 12]),
        (512, [0, 64, 72, 73]),
        (513, [0, 65, 74, 76, 77]),
    ],
)
def test_where_levels_begin(n: int, starts: list[int]) -> None:
    assert level_starts(n).tolist() == starts
    assert len(node_boxes(np.zeros((n, 6), np.float32))) == starts[-1]


def test_near_faces_are_together() -> None:
    mesh = weld(sphere(24, 32, 100.0))[0]
    tree = build_scene_tree(mesh)
    n_lowest = int(level_starts(len(tree.cluster_start) - 1)[1])
    sides = tree.cluster_nodes[:n_lowest, 3:] - tree.cluster_nodes[:n_lowest, :3]
    # 64 of 1472 faces cover a patch of 74 m x 74 m; drawn at random, they would reach over 200 m.
    assert np.median(sides.max(axis=1)) < 110.0
    assert sides.max() < 140.0


def test_the_same_for_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    # Enough faces for several threads to have a share.
    parts = [moved(sphere(40, 60), (0.0, 2500.0 * i, 0.0)) for i in range(12)]
    mesh = weld(side_by_side(*parts))[0]
    trees = []
    for n in ("1", "2", "3"):
        monkeypatch.setenv("SVPREP_THREADS", n)
        trees.append(build_scene_tree(mesh))
    for tree in trees[1:]:
        for name in SceneTree.__slots__:
            assert getattr(tree, name).tobytes() == getattr(trees[0], name).tobytes()
