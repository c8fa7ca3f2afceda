r"""Why a pixel differs: what float64 says of it, over all faces, one by one.

        eye
          \   . X' along the normal: where the judge asks
           \  |
    X' as   o |     Both are lit, or both are not, unless a shadow's edge passes
    drawn    \|     between them, closer to X than a millimetre.
    _________ X _________ face

Nothing of the judge or of the renderer is used: no hierarchy, no float32 ray, no depth
buffer. A cause is told only where float64 gives what was drawn; all else is "not found".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svprep.cache.reader import Cache
from svprep.facing import facing
from svprep.model import F32, F64
from svprep.rays import offset_m
from svprep_runtime.camera import Camera
from svprep_runtime.judge_constants import CENTRE_ULPS, LEAST_OFFSET_M, OFFSET_ULPS

NOT_FOUND = "not found"
MOST_TRACED = 20
"""Pixels of one picture."""


@dataclass(frozen=True, slots=True)
class Lift:
    """How far a picture displaces X (`svprep_runtime.frame.lift_uniforms`)."""

    px: float
    least_m: float
    most_m: float
    most_slant: float


class Tracer:
    """All faces of a city in float64, for one camera and light."""

    def __init__(self, cache: Cache, camera: Camera, light: F32, lift: Lift) -> None:
        mesh = cache.mesh
        self._camera, self._light, self._lift = camera, light.astype(np.float64), lift
        self._eye = camera.eye.astype(np.float64)
        self._corners = mesh.positions[mesh.faces].astype(np.float64)
        a, b, c = self._corners.transpose(1, 0, 2)
        self._normals = np.cross(b - a, c - a)
        self._faces_light = facing(cache.planes.planes, light)[cache.planes.plane_of_face]
        self._nearest_m = offset_m(mesh, 0.0, CENTRE_ULPS)
        self._offset_m = offset_m(mesh, LEAST_OFFSET_M, OFFSET_ULPS)

    def cause(self, x: int, y: int, *, drawn: bool, face_drawn: int, face_judged: int) -> str:
        """Return why pixel (`x`, `y`) is `drawn` in shadow, or lit, and the judge disagrees."""
        if face_drawn < 0:
            return NOT_FOUND
        ray = self._camera.directions(np.array([x + 0.5]), np.array([y + 0.5]))[0]
        met = self._met(self._eye, ray)
        met[met < self._camera.near_m] = np.inf
        nearest = int(met.argmin())
        if not np.isfinite(met[nearest]) or not np.isfinite(met[face_drawn]):
            return NOT_FOUND
        if self._as_drawn(face_drawn, ray, met[face_drawn]) != drawn:
            return NOT_FOUND
        if face_drawn != nearest:
            apart = (met[face_drawn] - met[nearest]) / met[nearest]
            if apart > 2.0**-22:
                return NOT_FOUND
            return (
                f"faces {nearest} and {face_drawn} are {1e6 * apart * met[nearest]:.2g} um apart "
                f"here, {apart:.1g} of their depth: to a depth buffer of float32 the same, and "
                "the first of the file is drawn"
            )
        if face_drawn != face_judged:
            return (
                f"the ray meets face {nearest} in float64, as drawn; the judge's float32 ray "
                f"meets {face_judged}, {self._across_px(nearest, ray):.1g} px beside"
            )
        return self._displacement(nearest, ray, met[nearest], drawn)

    def _displacement(self, face: int, ray: F64, depth: float, drawn: bool) -> str:
        """Return where along the normal, and along the ray, X is lit or in shadow."""
        point = self._eye + depth * ray
        normal = self._towards_eye(face)
        said = [
            f"{name} {_word(self._is_shaded(face, point + lift * normal))}"
            for name, lift in (
                ("X itself", 0.0),
                (f"{1e3 * self._nearest_m:.2g} mm along the normal", self._nearest_m),
                (f"{1e3 * self._offset_m:.2g} mm", self._offset_m),
            )
        ]
        step = float(np.linalg.norm(self._step(face, ray, depth)))
        return f"{', '.join(said)}; {1e3 * step:.2g} mm along the ray {_word(drawn)}, as drawn"

    def _as_drawn(self, face: int, ray: F64, depth: float) -> bool:
        """Return whether X, displaced along its ray as ``displace.frag`` does, is in shadow."""
        point = self._eye + depth * ray
        return self._is_shaded(face, point - self._step(face, ray, depth))

    def _step(self, face: int, ray: F64, depth: float) -> F64:
        lift = self._lift
        across = self._camera.directions(np.array([0.0, 1.0]), np.zeros(2))
        a_pixel = float(np.linalg.norm(across[1] - across[0]))
        metres = min(max(lift.px * a_pixel * depth, lift.least_m), lift.most_m)
        slope = abs(float(self._towards_eye(face) @ ray))
        slant = lift.most_slant / float(np.linalg.norm(ray))
        if slope > 0.0:
            slant = min(1.0 / slope, slant)
        return metres * slant * ray

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
        a, b, c = (self._corners - start).transpose(1, 0, 2)
        inside = np.stack([np.cross(b, c) @ ray, np.cross(c, a) @ ray, np.cross(a, b) @ ray])
        is_met = (inside >= 0.0).all(axis=0) | (inside <= 0.0).all(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            times = np.einsum("ij,ij->i", self._normals, a) / (self._normals @ ray)
        return np.where(is_met & (times > 0.0), times, np.inf)

    def _across_px(self, face: int, ray: F64) -> float:
        """Return how far inside of the edges of `face` a ray passes [pixels], about."""
        corners = self._corners[face] - self._eye
        across = self._camera.directions(np.array([0.0, 1.0]), np.zeros(2))
        a_pixel = float(np.linalg.norm(across[1] - across[0]))
        edges = np.cross(corners, np.roll(corners, -1, axis=0))
        return float((np.abs(edges @ ray) / np.linalg.norm(edges, axis=1)).min()) / a_pixel


def _word(is_shaded: bool) -> str:
    return "shadow" if is_shaded else "lit"
