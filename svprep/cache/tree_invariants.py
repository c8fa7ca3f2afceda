"""What must hold of the silhouette trees of a cache.

A tree that leaves out an edge makes shadows leak only for some lights, so this is
checked to the last edge: what it holds, and (`tree_bounds`) that its bounds do.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from svprep.cache.checks import Problem, problem_at
from svprep.cache.codec import BLOCK
from svprep.cache.tables import CheckFunction, Tables, owner_of_rows
from svprep.cache.tree_bounds import BOUND_NEEDS, box_problems, levels
from svprep.model import I64, NO_INDEX

GROUPS = ("cones", "hextree")


def check_trees(t: Tables) -> list[Problem]:
    """Trees hold the searched records of their objects, and their boxes hold those."""
    problems = [*_index_problems(t), *_frame_problems(t)]
    for group in GROUPS:
        problems += _edge_problems(t, group)
    # Bounds of the wrong edges, or in a wrong frame, would say the same again.
    return problems or box_problems(t)


def check_work(t: Tables, group: str) -> list[Problem]:
    """The expected work of each tree is a number that is not negative."""
    work = t[f"{group}/work"]
    bad = ~(np.isfinite(work) & (work >= 0)).all(axis=1)
    return problem_at("V411", f"{group}/work", "no finite work of at least 0 in trees", bad)


def _index_problems(t: Tables) -> list[Problem]:
    """Objects ascend, every tree has edges, and all have as many blocks as they need."""
    objects, start = t["index/object"], t["index/pair_start"]
    problems = [
        *problem_at("V411", "index/object", "not ascending after", objects[1:] <= objects[:-1]),
        *problem_at("V411", "index/pair_start", "trees without edges", start[1:] <= start[:-1]),
    ]
    _, n_blocks = levels(start)
    got = len(t["hextree/blocks"])  # cones/blocks is as long, or was reported
    if n_blocks != got:
        message = f"expected {n_blocks} blocks for the edges of `pair_start`, got {got}"
        problems.append(Problem("V411", "index/pair_start", message))
    return problems


def _frame_problems(t: Tables) -> list[Problem]:
    """Frames are finite, as wide as two tolerances, and hold every vertex of the object."""
    frames = t["index/frame"].astype(np.float64)
    radius = frames[:, 3]
    is_one = np.isfinite(frames).all(axis=1) & (radius > 0.0) & (radius >= 2.0 * t.tolerance_m)
    tree_of_object = np.full(len(t["objects/vertex_start"]) - 1, -1)
    tree_of_object[t["index/object"]] = np.arange(len(frames))
    tree = tree_of_object[owner_of_rows(t["objects/vertex_start"])]
    vertices = np.flatnonzero(tree >= 0)
    is_too_small = np.zeros(len(frames), np.bool_)
    for start in range(0, len(vertices), BLOCK):
        chosen = vertices[start : start + BLOCK]
        own = tree[chosen]
        away = t["mesh/positions"].take(chosen, axis=0) - frames.take(own, axis=0)[:, :3]
        outside = ~((away**2).sum(axis=1) <= radius[own] ** 2)
        is_too_small[own[outside]] = True
    where = "index/frame"
    return [
        *problem_at("V411", where, "no centre and radius in trees", ~is_one),
        *problem_at(
            "V411", where, "vertices of the object outside in trees", is_too_small & is_one
        ),
    ]


def _edge_problems(t: Tables, group: str) -> list[Problem]:
    """Each tree holds every searched record of its object once, and no other.

    Searched are records with flags 0, which are those of two faces (V404).
    """
    edge, start = t[f"{group}/edge"], t["index/pair_start"].astype(np.int64)
    objects, object_edge = t["index/object"], _first_edges(t)
    n_own = np.diff(object_edge)
    has_tree = np.zeros(len(n_own), np.bool_)
    has_tree[objects] = True
    half = t["edges/half_edges"]
    is_searched = (t["edges/flags"] == 0) & np.repeat(has_tree, n_own)
    is_searched &= (half[:, 0] != NO_INDEX) & (half[:, 1] != NO_INDEX)
    count = np.bincount(edge, minlength=len(is_searched))
    n_of_tree = np.diff(start)
    begin = np.repeat(object_edge[objects], n_of_tree)
    end = np.repeat(object_edge[objects.astype(np.int64) + 1], n_of_tree)
    is_foreign = (edge < begin) | (edge >= end)
    where = f"{group}/edge"
    return [
        *problem_at(
            "V411", where, "searched records that are not in it", is_searched & (count == 0)
        ),
        *problem_at("V411", where, "records more than once in it", count > 1),
        *problem_at(
            "V411", where, "records in it that are not searched", ~is_searched & (count > 0)
        ),
        *problem_at("V411", where, "records of another object at", is_foreign),
    ]


def _first_edges(t: Tables) -> I64:
    """Return where each object's edge records begin, and end, ``(n_objects + 1,)``."""
    return t["components/edge_start"].astype(np.int64)[t["objects/component_start"]]


TREE_CHECKS: tuple[tuple[CheckFunction, tuple[str, ...]], ...] = (
    (
        check_trees,
        (
            *BOUND_NEEDS,
            "components/edge_start",
            "cones/edge",
            "edges/flags",
            "hextree/blocks",
            "hextree/edge",
            "objects/component_start",
            "objects/vertex_start",
        ),
    ),
    *((partial(check_work, group=group), (f"{group}/work",)) for group in GROUPS),
)
"""As `invariants.TABLE_CHECKS`."""
