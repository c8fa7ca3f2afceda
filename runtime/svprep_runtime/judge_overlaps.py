"""Coplanar overlaps that a picture shows: faces that coincide with the visible one.

Two faces overlap at a pixel where its ray meets both, strictly inside, no farther apart
than the judge's offset along their normals, and they are parallel (`PARALLEL_RAD`). Both
give the same shadow, so such pixels stay decidable; but only one of the two has been meant
to be seen, and a renderer that moved them apart would flicker there.

Embree cannot list the faces that a ray meets in one place: it names one of them, always the
same. So each face is put into a second scene, displaced along its own normal by a distance
of its own, and a ray along the normal of the visible face finds all of them one by one:

           where they are        displaced            ray through X
    f, g   ==========X====       ----------- f    ------|---
                                 ----------- g    ------|---

What it finds is measured in float64, where the faces really are. Distances go in steps of
the golden ratio: two faces get the same one in float32, so that one of them is not listed,
once in 2,000 pairs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.model import BOOL, F64, I32, I64, Mesh
from svprep.rays import Scene
from svprep_runtime.judge_constants import PARALLEL_RAD
from svprep_runtime.judge_report import Overlap

_FAN_OFFSETS: Final = 256.0
"""How far a face is displaced at most, in offsets, each at least 8 steps of float32."""
_MOST_HITS: Final = 64
"""Of one ray: where more faces are within a fan of a point, the others are not looked at."""
_GOLDEN: Final = 0.6180339887498949


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Planes of single faces, exact on the grid."""

    corner: F64
    """``(n_faces, 3)`` [m]: a"""
    normal: F64
    """``(n_faces, 3)`` [m^2]: (b - a) x (c - a)"""
    length: F64
    """``(n_faces,)`` [m^2]: of the normal, above 0."""

    @classmethod
    def of(cls, mesh: Mesh) -> Shapes:
        """Return the planes of all faces of `mesh`."""
        a, b, c = (mesh.positions[mesh.faces[:, i]].astype(np.float64) for i in range(3))
        normal = np.cross(b - a, c - a)
        return cls(a, normal, np.linalg.norm(normal, axis=1))


class Fan:
    """All faces of a mesh, displaced each by a distance of its own."""

    __slots__ = ("_mesh", "_offset", "_reach", "_scene", "_shapes")

    def __init__(self, mesh: Mesh, shapes: Shapes, offset: float, device: object) -> None:
        self._mesh, self._shapes, self._offset = mesh, shapes, offset
        n = len(mesh.faces)
        most = _FAN_OFFSETS * offset
        # A ray starts and ends beyond what may be displaced to either side.
        self._reach = most + 4.0 * offset
        away = (np.arange(n) * _GOLDEN) % 1.0 * most / shapes.length
        corners = mesh.positions[mesh.faces] + (away[:, None] * shapes.normal)[:, None]
        self._scene = Scene(
            corners.reshape(-1, 3).astype(np.float32), np.arange(3 * n).reshape(-1, 3), device
        )

    def met(self, rays: F64, face: I32, point: F64) -> I64:
        """Return ``(n_met, 2) int64``: pairs of objects that overlap where a pixel sees them.

        The lower index first; each pair once for a pixel.

        Parameters
        ----------
        rays : ndarray
            ``(n, 3)``: of pixels that see `point` ``(n, 3)`` [m] of `face` ``(n,)``.

        Notes
        -----
        About two short rays a pixel.
        """
        unit = self._shapes.normal[face] / self._shapes.length[face, None]
        rows = np.flatnonzero(self._is_inside(face, point))
        towards = unit.astype(np.float32)
        at = np.full(len(face), -self._reach)
        found: list[tuple[I64, I64]] = []
        for _ in range(_MOST_HITS):
            if not len(rows):
                break
            starts = (point[rows] + at[rows, None] * unit[rows]).astype(np.float32)
            left = (self._reach - at[rows]).astype(np.float32)
            met, ahead = self._scene.first_hit(starts, towards[rows], left)
            is_met = met >= 0
            rows, other, ahead = rows[is_met], met[is_met].astype(np.int64), ahead[is_met]
            is_other = self._is_overlap(rays, face, point, unit, rows, other)
            found.append((rows[is_other], other[is_other]))
            at[rows] += ahead + self._offset / 4.0  # two steps of float32
        return self._distinct(found, face)

    def _is_overlap(
        self, rays: F64, face: I32, point: F64, unit: F64, rows: I64, other: I64
    ) -> BOOL:
        """Return whether each `other` overlaps the face of its row, where it really is."""
        is_overlap = other != face[rows]
        asked = np.flatnonzero(is_overlap)
        rows, other = rows[asked], other[asked]
        shapes = self._shapes
        theirs = shapes.normal[other] / shapes.length[other, None]
        tilt = np.linalg.norm(np.cross(theirs, unit[rows]), axis=1)
        # Where the pixel's ray meets the other plane, from X on.
        with np.errstate(divide="ignore", invalid="ignore"):
            further = np.einsum("ij,ij->i", theirs, shapes.corner[other] - point[rows])
            further /= np.einsum("ij,ij->i", theirs, rays[rows])
            there = point[rows] + further[:, None] * rays[rows]
            apart = np.abs(np.einsum("ij,ij->i", there - point[rows], unit[rows]))
        is_near = (tilt <= PARALLEL_RAD) & (apart <= self._offset)
        is_near[is_near] = self._is_inside(other[is_near], there[is_near])
        is_overlap[asked] = is_near
        return is_overlap

    def _is_inside(self, face: I32 | I64, point: F64) -> BOOL:
        """Return whether points of faces' planes are strictly inside the faces.

        So what only shares an edge overlaps nowhere.
        """
        corners = self._mesh.positions[self._mesh.faces[face]].astype(np.float64)
        normal = self._shapes.normal[face]
        is_inside = np.ones(len(face), bool)
        for i in range(3):
            side = corners[:, (i + 1) % 3] - corners[:, i]
            is_inside &= np.einsum("ij,ij->i", np.cross(side, point - corners[:, i]), normal) > 0.0
        return is_inside

    def _distinct(self, found: list[tuple[I64, I64]], face: I32) -> I64:
        """Return pairs of objects, a pixel's own and another's, each once a pixel."""
        if not sum(len(rows) for rows, _ in found):
            return np.zeros((0, 2), np.int64)
        row = np.concatenate([rows for rows, _ in found])
        start = self._mesh.object_face_start
        pair = np.column_stack([face[row], np.concatenate([others for _, others in found])])
        objects = np.sort(np.searchsorted(start, pair, side="right") - 1, axis=1)
        return np.unique(np.column_stack([row, objects]), axis=0)[:, 1:]


def overlaps_by_name(met: Mapping[int, I64], names: Sequence[str]) -> tuple[Overlap, ...]:
    """Return how many pixels show an overlap of each pair of objects, most pixels first.

    Parameters
    ----------
    met : mapping
        ``(n, 2) int64`` pairs of objects, by batch.
    """
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *met.values()])
    objects, pixels = np.unique(pairs, axis=0, return_counts=True)
    listed = [
        Overlap(names=(names[a], names[b]), pixels=n)
        for (a, b), n in zip(objects.tolist(), pixels.tolist(), strict=True)
    ]
    return tuple(sorted(listed, key=lambda one: (-one.pixels, one.names)))
