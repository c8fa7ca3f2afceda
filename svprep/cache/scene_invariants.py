"""What must hold of the scene trees and the clamped segments of a cache.

A box that is too small hides what it should hold; segments that cannot be told apart
draw shadows twice, or not at all. Whether segments reach far enough is for rays to
say: `validate --deep`.
"""

from __future__ import annotations

import numpy as np

from svprep.cache.checks import Problem, problem_at
from svprep.cache.tables import CheckFunction, Tables, owner_of_rows
from svprep.model import BOOL, F32, I64

_LEAF = 8
_MOST_SEGMENTS = 8
_AXES_SLACK = 1e-9


def check_scene(t: Tables) -> list[Problem]:
    """Trees hold every object and face once, clusters lie in one object, boxes are exact."""
    start = t["scene/cluster_start"].astype(np.int64)
    faces = t["scene/face"]
    sizes = np.diff(start)
    problems = [
        *_not_each_once(t, "scene/object"),
        *_not_each_once(t, "scene/face"),
        *problem_at(
            "V413",
            "scene/cluster_start",
            "expected 1 to 8 faces; other clusters",
            (sizes < 1) | (sizes > _LEAF),
        ),
    ]
    if problems:
        return problems
    object_of_face = owner_of_rows(t["objects/face_start"])[faces]
    first = np.repeat(object_of_face[start[:-1]], sizes)
    corners = t["mesh/positions"][t["mesh/face_corners"].reshape(-1, 3)]
    boxes = np.hstack([corners.min(axis=1), corners.max(axis=1)])
    object_boxes = _joined(boxes, t["objects/face_start"].astype(np.int64))
    got = t["scene/object_boxes"]
    return [
        *problem_at(
            "V413", "scene/face", "another object than its cluster's at", object_of_face != first
        ),
        *problem_at(
            "V413",
            "scene/object_boxes",
            "wrong boxes of objects",
            (got != object_boxes).any(axis=1),
        ),
        *_node_problems(t, "scene/object_nodes", object_boxes[t["scene/object"]]),
        *_node_problems(t, "scene/cluster_nodes", _joined(boxes[faces], start)),
    ]


def check_lights(t: Tables) -> list[Problem]:
    """Lights are directions or points, frames are their axes, facts are numbers."""
    lights = t["lights/light"].astype(np.float64)
    frames, facts = t["lights/frame"], t["lights/facts"]
    w = lights[:, 3]
    length = np.sqrt((lights[:, :3] ** 2).sum(axis=1))
    is_sun = (w == 0.0) & (np.abs(length - 1.0) < 1e-5)
    is_point = (w == 1.0) & np.isfinite(length)
    away = np.where(is_sun[:, None], -lights[:, :3] / np.where(is_sun, length, 1.0)[:, None], 0.0)
    unlike = np.abs(frames @ frames.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    along = np.abs(frames[:, 2] - away).max(axis=1, initial=0.0)
    along = np.where(is_point, np.abs(frames - np.eye(3)).max(axis=(1, 2), initial=0.0), along)
    is_frame = (unlike <= _AXES_SLACK) & (along <= _AXES_SLACK)
    is_fact = (np.isfinite(facts) & (facts >= 0.0)).all(axis=1)
    return [
        *problem_at(
            "V414", "lights/light", "no direction or point in lights", ~(is_sun | is_point)
        ),
        *problem_at("V414", "lights/frame", "no axes of the light in lights", ~is_frame),
        *problem_at("V414", "lights/facts", "no numbers of at least 0 in lights", ~is_fact),
    ]


def check_segments(t: Tables) -> list[Problem]:
    """Each caster has 1 to 8 segments of a light; each of them has a near and a far."""
    start = t["clamp/segment_start"].astype(np.int64)
    light_start = t["lights/segment_start"].astype(np.int64)
    counts = np.diff(start, axis=1)
    fits = (start[:, 0] == 0) & (start[:, -1] == np.diff(light_start))
    fits &= ((counts >= 1) & (counts <= _MOST_SEGMENTS)).all(axis=1)
    depth, slope = t["clamp/depth"].astype(np.float64), t["clamp/slope"]
    near, far = depth[:, 0], depth[:, 1]
    is_depth = np.isfinite(near) & (far >= near)  # a far of NaN is not
    problems = [
        *problem_at(
            "V414",
            "clamp/segment_start",
            "expected 1 to 8 segments a component, up to the light's last; other lights",
            ~fits,
        ),
        *problem_at("V414", "clamp/depth", "no near before a far in segments", ~is_depth),
    ]
    if problems:
        return problems
    of_light = owner_of_rows(t["lights/segment_start"])
    is_point = t["lights/light"][of_light, 3] != 0.0
    is_first = np.zeros(len(near), np.bool_)
    for i in range(len(start)):
        is_first[light_start[i] + start[i, :-1]] = True
    wrong = is_point & ((slope != 0).any(axis=1) | (near < 0.0))
    # Where planes slant, segments may overlap: what lies in two is counted twice.
    is_level = (slope == 0).all(axis=1)
    falls = np.zeros(len(near), np.bool_)
    if len(near):
        falls[1:] = ~is_first[1:] & is_level[1:] & is_level[:-1] & (near[1:] < far[:-1])
    return [
        *problem_at(
            "V414", "clamp/slope", "slopes or near < 0 for a point light in segments", wrong
        ),
        *problem_at("V414", "clamp/depth", "not behind the one before it are segments", falls),
    ]


def _not_each_once(t: Tables, path: str) -> list[Problem]:
    rows = t[path]
    count: I64 = np.bincount(rows, minlength=len(rows))
    return problem_at("V413", path, "expected each once; not so are", count != 1)


def _node_problems(t: Tables, path: str, leaves: F32) -> list[Problem]:
    """Return the problems of the nodes over boxes of `leaves`."""
    wanted: list[F32] = []
    below = leaves
    while not wanted or len(below) > 1:
        below = _joined(below, np.append(np.arange(0, len(below), _LEAF), len(below)))
        wanted.append(below)
    boxes = np.concatenate(wanted)
    got = t[path]
    if len(got) != len(boxes):
        return [Problem("V413", path, f"expected {len(boxes)} nodes, got {len(got)}")]
    wrong: BOOL = (got != boxes).any(axis=1)
    return problem_at("V413", path, "wrong boxes of nodes", wrong)


def _joined(boxes: F32, start: I64) -> F32:
    """Return the box around each run of `boxes`, inside out for an empty one."""
    joined = np.full((len(start) - 1, 6), np.inf, np.float32)
    joined[:, 3:] = -np.inf
    rows = np.repeat(np.arange(len(joined)), np.diff(start))
    np.minimum.at(joined[:, :3], rows, boxes[:, :3])
    np.maximum.at(joined[:, 3:], rows, boxes[:, 3:])
    return joined


SCENE_CHECKS: tuple[tuple[CheckFunction, tuple[str, ...]], ...] = (
    (
        check_scene,
        (
            "mesh/positions",
            "mesh/face_corners",
            "objects/face_start",
            "scene/object",
            "scene/object_boxes",
            "scene/object_nodes",
            "scene/face",
            "scene/cluster_start",
            "scene/cluster_nodes",
        ),
    ),
    (check_lights, ("lights/light", "lights/frame", "lights/facts")),
    (
        check_segments,
        (
            "lights/light",
            "lights/segment_start",
            "clamp/segment_start",
            "clamp/depth",
            "clamp/slope",
        ),
    ),
)
"""As `invariants.TABLE_CHECKS`."""
