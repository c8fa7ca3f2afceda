r"""Why a picture and the judge differ at a pixel: what float64 says, over all faces, one by one.

        eye
          \   . X' along the normal: where the judge asks, and pictures, too, of all
           \  |  that is not seen from close by
    X' as   o |
    drawn    \|  Both are lit, or both are not, unless a shadow's edge passes between
    _________ X  them, or between the heights, closer to X than a millimetre.

Nothing of the judge or of the renderer is used: no hierarchy, no float32 ray, no depth
buffer. A cause is told only where float64 gives what was drawn; all else is `NOT_FOUND`.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from svprep.facing import facing
from svprep.model import F32, F64, I64, U8, Mesh, PlaneTable
from svprep.rays import offset_m
from svprep_runtime.camera import Camera
from svprep_runtime.frame import LIFT_PX, LIFT_ULPS, MOST_LIFT_M, MOST_SHIFT_PX, MOST_SLANT
from svprep_runtime.judge_constants import CENTRE_ULPS, LEAST_OFFSET_M, OFFSET_ULPS
from svprep_runtime.judge_report import Truth

NOT_FOUND: Final = "not found"
MOST_TRACED: Final = 20
"""Pixels of one picture whose cause is looked for."""


def causes_of(
    mesh: Mesh, planes: PlaneTable, camera: Camera, light: F32, truth: Truth, mask: U8, at: I64
) -> list[str]:
    """Return why pixels of a picture differ, of the first `MOST_TRACED` of them.

    ``mask (height, width)``: what was drawn, 0 where lit; ``at (n, 2)``: rows and columns, as
    in `Comparison.differing`.
    """
    if not len(at):
        return []
    tracer = Tracer(mesh, planes, camera, light)
    return [
        tracer.cause(x, y, drawn=bool(mask[y, x]), face_judged=int(truth.face[y, x]))
        for y, x in at[:MOST_TRACED].tolist()
    ]


class Tracer:
    """All faces of a city in float64, for one camera and light.

    Parameters
    ----------
    light : ndarray
        ``(4,) float32``, in the cache frame.

    Notes
    -----
    A pixel takes five passes over all faces.
    """

    def __init__(self, mesh: Mesh, planes: PlaneTable, camera: Camera, light: F32) -> None:
        self._camera, self._light = camera, light.astype(np.float64)
        self._eye = camera.eye.astype(np.float64)
        self._corners = mesh.positions[mesh.faces].astype(np.float64)
        a, b, c = self._corners.transpose(1, 0, 2)
        self._normals = np.cross(b - a, c - a)
        self._middle = (a + b + c) / 3.0
        away = self._corners - self._middle[:, None]
        # A little more than the farthest corner: what is left out is not met for certain.
        self._reach2 = (1.0 + 1e-6) * np.einsum("ijk,ijk->ij", away, away).max(axis=1)
        self._faces_light = facing(planes.planes, light)[planes.plane_of_face]
        self._nearest_m = offset_m(mesh, 0.0, CENTRE_ULPS)
        self._offset_m = offset_m(mesh, LEAST_OFFSET_M, OFFSET_ULPS)
        self._least_lift_m = offset_m(mesh, 0.0, LIFT_ULPS)
        across = camera.directions(np.array([0.0, 1.0]), np.zeros(2))
        self._a_pixel = float(np.linalg.norm(across[1] - across[0]))

    def cause(self, column: int, row: int, *, drawn: bool, face_judged: int) -> str:
        """Return why a pixel is `drawn` in shadow, or lit, and the judge disagrees.

        Parameters
        ----------
        drawn
            In shadow.
        face_judged
            The face that the judge saw, -1 for none.
        """
        ray = self._camera.directions(np.array([column + 0.5]), np.array([row + 0.5]))[0]
        met = self._met(self._eye, ray)
        met[met < self._camera.near_m] = np.inf
        nearest = int(met.argmin())
        if face_judged < 0 or not np.isfinite(met[nearest]):
            return NOT_FOUND
        as_drawn = self._displaced(nearest, ray, met[nearest])
        if self._is_shaded(nearest, as_drawn) != drawn:
            return NOT_FOUND
        if nearest != face_judged:
            return (
                f"the ray meets face {nearest} in float64, as drawn, "
                f"{self._beside_px(nearest, ray):.1g} px inside; the judge found {face_judged}"
            )
        point = self._eye + met[nearest] * ray
        normal = self._towards_eye(nearest)
        said = [
            f"{name} {_word(self._is_shaded(nearest, point + lift * normal))}"
            for name, lift in (
                ("X itself", 0.0),
                (f"{1e3 * self._nearest_m:.2g} mm along the normal", self._nearest_m),
                (f"{1e3 * self._offset_m:.2g} mm", self._offset_m),
            )
        ]
        height = float(normal @ (as_drawn - point))
        beside = float(np.linalg.norm(as_drawn - point - height * normal))
        return (
            f"{', '.join(said)}; {1e3 * height:.2g} mm along it and {1e3 * beside:.2g} mm beside "
            f"{_word(drawn)}, as drawn"
        )

    def _displaced(self, face: int, ray: F64, depth: float) -> F64:
        """Return how a picture displaces X of a face, as ``displace.frag`` does."""
        normal = self._towards_eye(face)
        most_m = max(MOST_LIFT_M, self._least_lift_m)
        lift = min(max(LIFT_PX * self._a_pixel * depth, self._least_lift_m), most_m)
        along = depth * ray + lift * normal
        lifted = float(self._camera.forward @ along)
        shift_px = float(np.linalg.norm(along / lifted - ray)) / self._a_pixel
        hidden = self._met(self._eye, along)
        hidden[face] = np.inf
        most_px = MOST_SHIFT_PX
        is_hidden = (hidden < 1.0) & (hidden * lifted >= self._camera.near_m)
        if lifted < self._camera.near_m or is_hidden.any():
            most_px = 0.0
        if shift_px <= most_px:
            return self._eye + along
        slope = -float(normal @ ray)
        slant = MOST_SLANT / float(np.linalg.norm(ray))
        if slope * slant > 1.0:
            slant = 1.0 / slope
        on_ray = depth - lift * slant
        share = most_px * on_ray / (shift_px * lifted - most_px * (lifted - on_ray))
        return self._eye + on_ray * ray + share * (along - on_ray * ray)

    def _is_shaded(self, face: int, point: F64) -> bool:
        """Return whether `point`, which lies before `face`, is in shadow by definition."""
        height = float(self._normals[face] @ (self._eye - self._corners[face, 0]))
        if self._faces_light[face] != np.sign(height):
            return True
        towards = self._light[:3] if self._light[3] == 0.0 else self._light[:3] - point
        met = self._met(point, towards)
        met[face] = np.inf
        return bool((met < (np.inf if self._light[3] == 0.0 else 1.0)).any())

    def _towards_eye(self, face: int) -> F64:
        normal = self._normals[face] / np.linalg.norm(self._normals[face])
        towards = float(normal @ (self._eye - self._corners[face, 0]))
        return normal if towards > 0.0 else -normal

    def _met(self, start: F64, ray: F64) -> F64:
        """Return ``(n_faces,)``: how many times `ray` from `start` to each face, inf for none."""
        times = np.full(len(self._corners), np.inf)
        towards = self._middle - start
        along = towards @ (ray / np.linalg.norm(ray))
        away2 = np.einsum("ij,ij->i", towards, towards)
        near = np.flatnonzero((1.0 - 1e-12) * away2 - along**2 <= self._reach2)
        a, b, c = (self._corners[near] - start).transpose(1, 0, 2)
        inside = np.stack([np.cross(b, c) @ ray, np.cross(c, a) @ ray, np.cross(a, b) @ ray])
        is_met = (inside >= 0.0).all(axis=0) | (inside <= 0.0).all(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.einsum("ij,ij->i", self._normals[near], a) / (self._normals[near] @ ray)
        is_met &= found > 0.0
        times[near[is_met]] = found[is_met]
        return times

    def _beside_px(self, face: int, ray: F64) -> float:
        """Return how far inside of the edges of `face` a ray passes [pixels], about."""
        corners = self._corners[face] - self._eye
        edges = np.cross(corners, np.roll(corners, -1, axis=0))
        inside = np.abs(edges @ ray) / np.linalg.norm(edges, axis=1)
        return float(inside.min()) / self._a_pixel


def _word(is_shaded: bool) -> str:
    return "shadow" if is_shaded else "lit"
