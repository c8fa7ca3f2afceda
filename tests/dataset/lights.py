"""Lights that are hard for silhouettes: ties, insides, extremes; seeded, ten kinds in turn."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from svprep.model import ComponentFlag, Prepared

KINDS = (
    "direction from above",
    "direction",
    "inside a solid's bounds",
    "on a vertex",
    "in a face's plane",
    "direction in a face's plane",
    "10 km away",
    "below the ground",
    "far",
    "barely off a tie",
)
"""Light i is of kind i modulo their number."""

TIES = ("on a vertex", "in a face's plane", "direction in a face's plane")
"""Kinds that make ``plane . light`` exactly 0 in float64 for some record."""

MOST_STEPS = 2**24
"""A coordinate of at most this many grid steps is exact in float32."""


def hard_lights(prepared: Prepared, n: int, seed: int = 0) -> np.ndarray:
    """Return ``(n, 4) float32`` lights in the cache frame, of all `KINDS` in turn."""
    make = _Maker(prepared, seed)
    return np.array([make.light(i) for i in range(n)], np.float32).reshape(-1, 4)


class _Maker:
    """Draws lights for one model."""

    def __init__(self, prepared: Prepared, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.prepared = prepared
        self.low = prepared.mesh.positions.min(axis=0).astype(np.float64)
        self.high = prepared.mesh.positions.max(axis=0).astype(np.float64)
        self.centre = (self.low + self.high) / 2.0
        self.size = float((self.high - self.low).max())
        step = prepared.mesh.grid.step_m
        self.points = np.rint(prepared.mesh.positions.astype(np.float64) / step).astype(np.int64)
        flags = prepared.components.flags
        self.solids = np.flatnonzero(flags & np.uint8(ComponentFlag.SOLID))

    def light(self, i: int) -> np.ndarray:
        makers: dict[str, Callable[[int], np.ndarray]] = {
            "direction from above": lambda turn: np.append(np.abs(self._unit()), 0.0),
            "direction": lambda turn: np.append(self._unit(), 0.0),
            "inside a solid's bounds": lambda turn: self._inside(),
            "on a vertex": self._on_vertex,
            "in a face's plane": self._in_plane,
            "direction in a face's plane": self._along_plane,
            "10 km away": lambda turn: np.append(self.centre + 1e4 * self._unit(), 1.0),
            "below the ground": lambda turn: self._below(),
            "far": lambda turn: np.append(1e7 * self._unit(), 1.0),
            "barely off a tie": self._off_tie,
        }
        assert tuple(makers) == KINDS
        return makers[KINDS[i % len(KINDS)]](i // len(KINDS)).astype(np.float32)

    def _unit(self) -> np.ndarray:
        direction = self.rng.normal(size=3)
        return direction / np.linalg.norm(direction)

    def _inside(self) -> np.ndarray:
        """Return a point within a solid's bounds, or within the model's where there is none."""
        low, high = self.low, self.high
        if len(self.solids):
            mesh, start = self.prepared.mesh, self.prepared.components.face_start
            chosen = int(self.rng.choice(self.solids))
            corners = mesh.positions[mesh.faces[start[chosen] : start[chosen + 1]].reshape(-1)]
            low, high = corners.min(axis=0), corners.max(axis=0)
        return np.append(self.rng.uniform(low, high), 1.0)

    def _below(self) -> np.ndarray:
        at = self.centre + self.size * self.rng.uniform(-1.0, 1.0, 3)
        at[2] = self.low[2] - self.size * 10.0 ** self.rng.uniform(-3.0, 1.0)
        return np.append(at, 1.0)

    def _on_vertex(self, turn: int) -> np.ndarray:
        faces, corners = self._random_corners()
        at = self.points[corners[:, 0]]
        return self._tie(faces, at, 1.0)

    def _in_plane(self, turn: int) -> np.ndarray:
        """Return a vertex shifted along an edge of its face, by whole steps of the grid."""
        faces, corners = self._random_corners()
        at = self.points[corners[:, 0]]
        along = self._primitive(self.points[corners[:, 1]] - at)
        # Up to some ten times the model's size, in either direction.
        most = np.maximum(8 * MOST_STEPS // np.maximum(np.abs(along).max(axis=1), 1), 1)
        share = self.rng.choice((-1.0, 1.0), len(at)) * 10.0 ** self.rng.uniform(-8, 0, len(at))
        steps = np.rint(most * share).astype(np.int64)
        return self._tie(faces, at + along * np.where(steps, steps, 1)[:, None], 1.0)

    def _along_plane(self, turn: int) -> np.ndarray:
        """Return the direction of an edge, as whole numbers without common factor."""
        faces, corners = self._random_corners()
        along = self._primitive(self.points[corners[:, 1]] - self.points[corners[:, 0]])
        return self._tie(faces, along * self.rng.choice((-1, 1), (len(along), 1)), 0.0)

    def _off_tie(self, turn: int) -> np.ndarray:
        """Return a light beside a tie, by one unit of float32 or the smallest number there is."""
        light = (self._in_plane, self._along_plane, self._on_vertex)[turn % 3](turn)
        axis = int(self.rng.integers(3))
        towards = np.float32(self.rng.choice((-1.0, 1.0)) * np.inf)
        light = light.astype(np.float32)
        light[axis] = np.nextafter(light[axis], towards)
        return light

    def _random_corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Return faces ``(n,)`` and a side of each, ``(n, 2)`` vertices."""
        mesh = self.prepared.mesh
        faces = self.rng.integers(len(mesh.faces), size=512)
        side = self.rng.integers(3, size=512)
        return faces, mesh.faces[faces[:, None], np.stack((side, (side + 1) % 3), axis=1)]

    @staticmethod
    def _primitive(vectors: np.ndarray) -> np.ndarray:
        """Divide whole vectors by the greatest common divisor of their numbers."""
        common = np.gcd.reduce(np.abs(vectors), axis=1)
        return vectors // np.maximum(common, 1)[:, None]

    def _tie(self, faces: np.ndarray, steps: np.ndarray, w: float) -> np.ndarray:
        """Return the first of the candidates that is exactly in the plane of its face's record.

        ``steps (n, 3)``: whole numbers of grid steps; directions are left in them.
        """
        planes = self.prepared.planes
        xyz = steps * (self.prepared.mesh.grid.step_m if w else 1.0)
        nx, ny, nz, d = planes.planes[planes.plane_of_face[faces]].T
        value = ((nx * xyz[:, 0] + ny * xyz[:, 1]) + nz * xyz[:, 2]) + d * w
        is_exact = (xyz.astype(np.float32) == xyz).all(axis=1)
        ties = np.flatnonzero(is_exact & (value == 0.0) & ((w != 0.0) | steps.any(axis=1)))
        assert len(ties), "no light lies in a plane exactly: draw more candidates"
        return np.append(xyz[ties[0]], w)
