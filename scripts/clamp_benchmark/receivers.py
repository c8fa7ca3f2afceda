"""Clamping with other receivers: whole objects, as it was published, single and cut faces.

ours          clusters of up to eight faces, each a box and a slab; ends may slant
published     boxes of whole objects in the light's frame; ends across the light
              (Steiner 2006), the same rule for gaps (Lloyd et al. 2004)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from clamp_benchmark.kernels import cut_ends
from svprep.clamp import ClampCosts
from svprep.kernels.clamping import MOST_SEGMENTS, SLOPE_UNIT, clamp_casters
from svprep.kernels.light_boxes import bound_casters, bound_clusters, place_vertices, raise_levels
from svprep.model import F32, F64, I64, ClampTable, Mesh, SceneTree
from svprep.parallel import for_each, for_shares
from svprep.scene_tree import level_starts

_LEAST_PAD_M: Final = 0.0005
_PARTS: Final = 16


@dataclass(frozen=True, slots=True)
class Segments:
    """Segments of one light's casters, as `kernels.count_updates` takes them."""

    start: I64
    """``(n_casters + 1,)``"""
    depths: F64
    """``(n_segments, 2)`` [m]"""
    slopes: F64
    """``(n_segments, 2)``"""

    @property
    def per_caster(self) -> I64:
        """``(n_casters,)``: how many each has."""
        return np.diff(self.start)


@dataclass(frozen=True, slots=True)
class LitScene:
    """A mesh in a sun's frame."""

    mesh: Mesh
    frame: F64
    """``(3, 3)``: rows u, v, t."""
    pad_m: float
    """By which the product widens bounds."""
    placed: F32
    """``(n_vertices, 3)`` [m]: u, v, t."""

    def boxes(self, face_start: I64) -> F64:
        """Return ``(n, 6)`` [m], ``u0, u1, v0, v1, t0, t1``: of runs of faces, padded."""
        boxes = np.empty((len(face_start) - 1, 6), np.float64)
        faces = self.mesh.faces
        for_shares(
            len(boxes),
            lambda a, b: bound_casters(self.placed, faces, face_start, self.pad_m, a, b, boxes),
        )
        return boxes


def lit(mesh: Mesh, frame: F64) -> LitScene:
    """Return `mesh` in the frame of a sun."""
    reach = float(np.abs(mesh.positions).max()) * math.sqrt(3.0)
    placed = np.empty_like(mesh.positions)
    for_shares(len(placed), lambda a, b: place_vertices(mesh.positions, frame, a, b, placed))
    return LitScene(mesh, frame, max(_LEAST_PAD_M, 1e-6 * reach), placed)


def cached(table: ClampTable, light: int = 0) -> Segments:
    """Return the segments of one light of a table."""
    begin, end = int(table.light_start[light]), int(table.light_start[light + 1])
    return Segments(
        table.segment_start[light].astype(np.int64),
        table.depths[begin:end].astype(np.float64),
        table.slopes[begin:end] / SLOPE_UNIT,
    )


def between(near: F64, far: F64) -> Segments:
    """Return one segment a caster, across the light."""
    n = len(near)
    return Segments(np.arange(n + 1), np.column_stack([near, far]), np.zeros((n, 2)))


def single_faces(scene: SceneTree) -> SceneTree:
    """Return the tree with a cluster for every face."""
    return replace(scene, cluster_start=np.arange(len(scene.faces) + 1, dtype=np.int64))


def whole_objects(lit: LitScene, scene: SceneTree, face_start: I64, costs: ClampCosts) -> Segments:
    """Return the segments of casters, given by their faces, for whole objects as receivers.

    Parameters
    ----------
    face_start : ndarray
        ``(n_casters + 1,) int64``: none is empty.

    Notes
    -----
    Done by the product's kernel with the boxes of objects for those of clusters, slabs that
    say the same as the boxes, and no horizontal plane to try.
    """
    starts = lit.mesh.object_face_start
    sizes = np.diff(starts)
    objects = scene.objects[sizes[scene.objects] > 0].astype(np.int64)
    leaf_start = np.concatenate(([0], np.cumsum(sizes[objects])))
    faces = np.repeat(starts[objects] - leaf_start[:-1], sizes[objects]) + np.arange(leaf_start[-1])
    blocks, slabs, levels = _tree(lit, faces, leaf_start)
    boxes = lit.boxes(face_start)
    cuts = np.linspace(0, len(boxes), _PARTS + 1).astype(np.int64).tolist()
    parts: list[tuple[np.ndarray, ...]] = [()] * _PARTS
    prices = np.array([costs.vertex, costs.area])

    def do(part: int) -> None:
        a, b = cuts[part], cuts[part + 1]
        counts = np.empty(b - a, np.uint32)
        depths = np.empty((MOST_SEGMENTS * (b - a), 2), np.float32)
        slopes = np.empty((MOST_SEGMENTS * (b - a), 2), np.int16)
        k = clamp_casters(
            boxes, face_start, lit.placed, lit.mesh.faces, np.empty(0, np.uint32), leaf_start,
            blocks, slabs, levels, len(levels) - 1, np.zeros(2), lit.pad_m, prices, a, b, counts,
            depths, slopes,
        )  # fmt: skip
        parts[part] = counts, depths[:k].copy(), slopes[:k] / SLOPE_UNIT

    for_each(_PARTS, do)
    counts = np.concatenate([part[0] for part in parts]).astype(np.int64)
    return Segments(
        np.concatenate(([0], np.cumsum(counts))),
        np.concatenate([part[1] for part in parts]).astype(np.float64),
        np.concatenate([part[2] for part in parts]),
    )


def cut_faces(lit: LitScene, scene: SceneTree, face_start: I64) -> Segments:
    """Return one segment a caster, from its front to where the last face within it ends.

    Each face is cut to the rectangle; the end is across the light or horizontal, whichever
    leaves the smaller surface. What gaps would save is not in it.
    """
    faces = scene.faces.astype(np.int64)
    blocks, _, levels = _tree(lit, faces, np.arange(len(faces) + 1))
    boxes = lit.boxes(face_start)
    triangles = lit.placed[lit.mesh.faces[faces]]
    horizon = -lit.frame[:2, 2] / lit.frame[2, 2]
    ends = np.empty((len(boxes), 2))
    for_shares(
        len(boxes), lambda a, b: cut_ends(boxes, blocks, levels, triangles, horizon, a, b, ends)
    )
    across, level = (ends + lit.pad_m * (1.0 + np.array([0.0, np.abs(horizon).sum()]))).T
    width, height = boxes[:, 1] - boxes[:, 0], boxes[:, 3] - boxes[:, 2]
    middle = np.column_stack([boxes[:, :2].mean(axis=1), boxes[:, 2:4].mean(axis=1)])
    rim, cap, slant = 2.0 * (width + height), width * height, math.sqrt(1.0 + horizon @ horizon)
    is_level = rim * (level + middle @ horizon) + slant * cap < rim * across + cap
    return Segments(
        np.arange(len(boxes) + 1),
        np.column_stack([boxes[:, 4], np.where(is_level, level, across)]),
        np.where(is_level[:, None], horizon, 0.0),
    )


def _tree(lit: LitScene, faces: I64, leaf_start: I64) -> tuple[F32, F64, I64]:
    """Return blocks, slabs that say the same as the boxes, and levels of a tree over runs."""
    n = len(leaf_start) - 1
    levels = level_starts(n)
    blocks = np.empty((int(levels[-1]), 5, 8), np.float32)
    slabs = np.empty((n, 5), np.float64)
    edge_on = np.tile(lit.frame[0].astype(np.float32), (n, 1))  # gives no slab
    order = faces.astype(np.uint32)
    for_shares(
        n,
        lambda a, b: bound_clusters(
            lit.placed,
            lit.mesh.faces,
            order,
            leaf_start,
            edge_on,
            lit.frame,
            lit.pad_m,
            a,
            b,
            blocks,
            slabs,
        ),
    )
    raise_levels(levels, len(levels) - 1, n, blocks)
    return blocks, slabs, levels
