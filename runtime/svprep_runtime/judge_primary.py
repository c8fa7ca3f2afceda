r"""Which face each pixel's centre shows: found with float32 rays, decided in float64.

    | \ f
    |  \       .       the float64 ray through a pixel's centre passes just inside of f,
    |   \  x          Embree's float32 ray just outside: it meets what is behind
    |____\

Embree rounds a ray's direction to float32, which moves it by some 1e-4 pixel, and compares
depths in float32. So what it finds is checked. A pixel is **doubtful** where

- one of the four pixels beside it found another face, and
- the float64 ray does not meet the face found, or the near plane cuts what is before it, or a
  ray turned by `TURN_PX` towards that pixel finds another face. That ray is left out where
  what is beside is behind, and so cannot hide the face found, and where both faces share an
  edge: there it is doubtful if the float64 ray meets the other as well.

Thirteen rays, the pixel's own and four each turned by four times that, by that and by as
little as float32 can tell, then give the faces it may show. Of those that the float64 ray
meets, from the near plane on, it shows the nearest, and of equal depths the first of the
file. Where it meets none, they go on behind the nearest found.

A face is met iff the ray is on the same side of its three edges as seen from the eye, edges
included; the same products decide for both faces of an edge, so that no ray passes between
them. A face that is edge-on to the eye shows nothing.

Of faces with the same corners, party walls for instance, the first of the file is shown.
Others that lie in one place are told apart where a ray turned a little finds the other: not
where Embree names one of two coincident faces all over, whose planes, and so whose shadows,
are the same but for rounding. A face in front that no pixel beside shows, as it is thinner
than a pixel, and whose edge passes the centre, may be missed as before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.model import BOOL, F32, F64, I32, I64, U32
from svprep.rays import Scene

TURN_PX: Final = 1.0 / 64.0
"""How far rays are turned to find what is beside them."""
_LEAST_TURN: Final = 2.0**-19
"""Of a ray's length: what float32 directions can tell, with a margin of 16."""
_BEHIND: Final = 1e-6
"""Of a depth: what is farther by more is behind for certain."""
_BESIDE: Final = ((1, 0), (-1, 0), (0, 1), (0, -1))
_AROUND: Final = (
    (0, 0, 0.0),
    *((x, y, turn_px) for turn_px in (4.0 * TURN_PX, TURN_PX, 0.0) for x, y in _BESIDE),
)
_MOST_ROUNDS: Final = 16
"""How many faces a ray may pass beside; where there are more, float32 has the last word."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """All faces of a city, seen from the eye of a camera."""

    scene: Scene
    first_in_place: I64
    """``(n_faces,)``: see `first_in_place`."""
    positions: F32
    """``(n_vertices, 3)`` [m]"""
    corners: U32
    """``(n_faces, 3)``: of each face, in `positions`."""
    planes: F64
    """``(n_faces, 5)``: normal [m^2], its product with eye - a [m^3], and what the normal is
    multiplied by to displace a point of the face by the offset to the eye's side [1/m]."""
    eye: F64
    """``(3,)`` [m]"""
    near_m: float
    right_px: F64
    """``(3,)``: what a step of a pixel to the right adds to a ray of view depth 1."""
    down_px: F64
    step_m: float
    """How far behind a face rays go on: several float32 steps of the largest coordinate."""

    def first(self, rays: F64) -> tuple[I32, BOOL]:
        """Return the face that float32 finds on rays ``(n, 3)`` of view depth 1, -1 for none.

        They start at the eye, which float32 holds exactly, and again at the near plane if
        they meet a face before it, which is told: rounding that start to float32 would move
        all the picture.
        """
        directions = rays.astype(np.float32)
        origins = np.empty_like(directions)
        origins[:] = self.eye
        face, _ = self.scene.first_hit(origins, directions)
        depth, _ = self.depth(rays, face)
        is_cut = (face >= 0) & ~(depth >= self.near_m)
        rows = np.flatnonzero(is_cut)
        if len(rows):
            starts = (self.eye + self.near_m * rays[rows]).astype(np.float32)
            face[rows], _ = self.scene.first_hit(starts, directions[rows])
        return face, is_cut

    def depth(self, rays: F64, face: I32) -> tuple[F64, F64]:
        """Return at which view depth rays meet the planes of `face`, and the rows of those.

        What stands for face -1 means nothing.
        """
        if not len(self.planes):
            return np.full(len(rays), np.nan), np.zeros((len(rays), 5))
        record = self.planes.take(face, axis=0, mode="wrap")
        with np.errstate(divide="ignore", invalid="ignore"):
            return record[:, 3] / -np.einsum("ij,ij->i", record[:, :3], rays), record

    def shown(self, first: I32, is_cut: BOOL, width: int, begin: int, rays: F64) -> I32:
        """Return which faces the pixels from `begin` on show, -1 for none.

        Parameters
        ----------
        first, is_cut : ndarray
            ``(n_pixels,)``: `first` of all pixels of a picture, row by row.
        width
            Of the picture.
        rays : ndarray
            ``(n, 3)``: of the pixels asked.

        Notes
        -----
        A ray for each edge between pixels that is not one of the surface, thirteen or more
        for a pixel that is doubtful: 1 in 100 or 1,000.
        """
        face = first[begin : begin + len(rays)].copy()
        beside = {at: _differing(first, width, begin, len(rays), *at) for at in _BESIDE}
        is_edge, is_doubtful = np.zeros(len(rays), bool), np.zeros(len(rays), bool)
        for rows in beside.values():
            is_edge[rows] = True
        edge = np.flatnonzero(is_edge)
        is_missed = (face[edge] >= 0) & ~np.isfinite(self._met(rays[edge], face[edge]))
        is_doubtful[edge] = is_missed | is_cut[begin + edge]
        for (x, y), rows in beside.items():
            asked = rows[~is_doubtful[rows]]
            other = first[begin + asked + x + y * width]
            is_next = self._share_edge(face[asked], other)
            folded = asked[is_next]
            is_doubtful[folded] = np.isfinite(self._met(rays[folded], other[is_next]))
            asked, other = asked[~is_next], other[~is_next]
            asked = asked[self._may_hide(other, face[asked], rays[asked], x, y)]
            found, _ = self.first(self._turned(rays[asked], x, y, TURN_PX))
            is_doubtful[asked] = found != face[asked]
        doubtful = np.flatnonzero(is_doubtful)
        face[doubtful] = self._nearest(rays[doubtful], face[doubtful])
        is_some = face >= 0
        face[is_some] = self.first_in_place[face[is_some]]
        return face

    def _may_hide(self, other: I32, face: I32, rays: F64, x: int, y: int) -> BOOL:
        """Return whether what pixels beside show, `other`, may lie before `face` here.

        Not so where it is behind the plane of `face`.
        """
        along = rays + (x * self.right_px + y * self.down_px)
        depth, plane = self.depth(along, other)[0], self.depth(along, face)[0]
        is_behind = (other < 0) | (depth > plane * (1.0 + _BEHIND))
        return (face < 0) | ~((plane > 0.0) & is_behind)

    def _share_edge(self, face: I32, other: I32) -> BOOL:
        """Return which two faces have two vertices in common."""
        mine = self.corners.take(face, axis=0, mode="wrap")
        theirs = self.corners.take(other, axis=0, mode="wrap")
        n_shared = (mine[:, :, None] == theirs[:, None, :]).sum(axis=(1, 2))
        return (n_shared == 2) & (face >= 0) & (other >= 0)

    def _nearest(self, rays: F64, face: I32) -> I32:
        """Return the nearest face that float64 rays meet, of those that float32 finds around.

        Parameters
        ----------
        face : ndarray
            ``(n,)``: what remains where a ray passes beside too many faces.
        """
        face = face.copy()
        rows = np.arange(len(rays))
        since = np.zeros(len(rays))
        for _ in range(_MOST_ROUNDS):
            if not len(rows):
                break
            nearest, depth, ahead = self._around(rays[rows], since[rows])
            is_cut = ahead < self.near_m
            is_done = ~is_cut & (np.isfinite(depth) | ~np.isfinite(ahead))
            face[rows[is_done]] = nearest[is_done]
            beyond = ahead * (1.0 + _LEAST_TURN) + self.step_m
            since[rows] = np.where(is_cut, self.near_m, beyond)
            rows = rows[~is_done]
        return face

    def _around(self, rays: F64, since: F64) -> tuple[I32, F64, F64]:
        """Return the nearest face that rays meet of those that rays around them find.

        Its depth follows, and the depth of the first found, all from depth `since` ``(n,)`` on.
        Starts other than the eye are rounded to float32: those of turned rays are moved apart
        by more than that.
        """
        nearest = np.full(len(rays), -1, np.int32)
        depth, ahead = np.full(len(rays), np.inf), np.full(len(rays), np.inf)
        is_moved = since > 0.0
        for x, y, turn_px in _AROUND:
            turned = self._turned(rays, x, y, turn_px)
            starts = self.eye + since[:, None] * turned
            if x or y:
                away = x * self.right_px + y * self.down_px
                starts[is_moved] += self.step_m / np.linalg.norm(away) * away
            found, far = self.scene.first_hit(starts.astype(np.float32), turned.astype(np.float32))
            ahead = np.minimum(ahead, np.where(found >= 0, since + far, np.inf))
            met = self._met(rays, found)
            is_nearer = (met < depth) | ((met == depth) & (found < nearest) & (met < np.inf))
            nearest[is_nearer], depth[is_nearer] = found[is_nearer], met[is_nearer]
        return nearest, depth, ahead

    def _turned(self, rays: F64, x: int, y: int, turn_px: float) -> F64:
        """Return rays turned towards the pixel `x` right and `y` down, by `turn_px` at least."""
        away = x * self.right_px + y * self.down_px
        if not (x or y):
            return rays
        # A ray is at least as long as 1, its view depth.
        length = np.linalg.norm(rays, axis=1) / np.linalg.norm(away)
        return rays + np.maximum(_LEAST_TURN * length, turn_px)[:, None] * away

    def _met(self, rays: F64, face: I32) -> F64:
        """Return ``(n,)``: at which view depth rays meet `face`, infinite where they do not.

        Nor before the near plane.
        """
        depth, _ = self.depth(rays, face)
        if not len(self.planes):
            return np.full(len(rays), np.inf)
        # Components apart, contiguous: half the time of rows of three.
        corners = self.positions.take(self.corners.take(face, axis=0, mode="wrap"), axis=0)
        a, b, c = np.subtract(corners.transpose(1, 2, 0), self.eye[:, None], order="C")
        x, y, z = rays.T
        sides = [
            (p[1] * q[2] - p[2] * q[1]) * x
            + (p[2] * q[0] - p[0] * q[2]) * y
            + (p[0] * q[1] - p[1] * q[0]) * z
            for p, q in ((b, c), (c, a), (a, b))
        ]
        least = np.minimum(np.minimum(sides[0], sides[1]), sides[2])
        most = np.maximum(np.maximum(sides[0], sides[1]), sides[2])
        is_met = (face >= 0) & ((least >= 0.0) | (most <= 0.0))
        is_met &= (depth >= self.near_m) & np.isfinite(depth)
        return np.where(is_met, depth, np.inf)


def first_in_place(positions: F32, corners: U32) -> I64:
    """Return ``(n_faces,)``: the first face of the file that has the same corners, in any order."""
    vertex = _first_of_equal(positions)
    return _first_of_equal(np.sort(vertex[corners], axis=1))


def _first_of_equal(rows: F32 | I64) -> I64:
    """Return of each row the first that equals it."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    is_new = np.ones(len(rows), bool)
    is_new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    first = np.empty(len(rows), np.int64)
    first[order] = order[is_new][np.cumsum(is_new) - 1]
    return first


def _differing(first: I32, width: int, begin: int, n: int, x: int, y: int) -> I64:
    """Return which of n pixels differ from the one beside them, `x` right and `y` down."""
    pixel = np.arange(begin, begin + n)
    column = pixel % width + x
    beside = pixel + x + y * width
    is_in = (column >= 0) & (column < width) & (beside >= 0) & (beside < len(first))
    is_other = first.take(beside, mode="clip") != first[begin : begin + n]
    return np.flatnonzero(is_in & is_other)
