"""Which steps of an arc are lit at each point: one bit a step.

A point X on face f is lit by a sun iff the sun is strictly in front of the side of f
that counts, decided by `svprep.facing.facing` on the plane record of f (a tie is not lit),
and a ray from X, displaced to that side, to the sun meets no face (README,
"Concepts"). Rays whose face is turned away from the sun are not traced.

    bit s of a point's row = lit at step s, s = 0 .. n_steps - 1
    byte s // 8, bit s % 8, the lowest first; steps at night are 0
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from svprep.facing import facing
from svprep.hours.scene import RayStarts
from svprep.model import BOOL, F32, I8, U8, U32, PlaneTable
from svprep.rays import RAYS_AT_ONCE, Scene, for_batches

_MOST_BITS: int = 1 << 23
"""Steps times points of a batch, a byte each while it is worked on."""


@dataclass(frozen=True, slots=True)
class Suns:
    """The suns of an arc."""

    light: F32
    """``(n_suns, 4)``: in the cache frame, each w = 0."""
    step: tuple[int, ...]
    """``(n_suns,)``: the step of each, below `n_steps`."""
    n_steps: int
    """By day and by night."""


def lit_bits(
    scene: Scene,
    planes: PlaneTable,
    side_of_face: I8,
    suns: Suns,
    starts: RayStarts,
    is_left_out: BOOL,
    on_done: Callable[[int], None],
) -> tuple[U8, int]:
    """Return the lit bits of points, and how many rays were traced.

    Parameters
    ----------
    side_of_face : ndarray
        ``(n_faces,) int8``: +1 where the side of the stored winding counts, else -1.
    starts : RayStarts
        Points, displaced to the side that counts.
    is_left_out : ndarray
        ``(n,) bool``: points known never to be lit.

    Returns
    -------
    bits : ``(n, ceil(n_steps / 8)) uint8``
    n_rays : int

    Notes
    -----
    Batches of points, and for each batch all suns in turn, bound the memory. A ray's answer
    does not depend on its batch, so neither do the bits.
    """
    n, n_steps = len(starts.face), suns.n_steps
    bits = np.zeros((n, -(-n_steps // 8)), np.uint8)
    n_rays: list[int] = []  # of batches, in any order
    size = max(256, min(RAYS_AT_ONCE, _MOST_BITS // max(n_steps, 1)))

    def trace(begin: int, end: int) -> None:
        rows = begin + np.flatnonzero(~is_left_out[begin:end])
        face, origin = starts.face[rows], starts.origin[rows]
        records, which = np.unique(planes.plane_of_face[face], return_inverse=True)
        own_planes, side = planes.planes[records], side_of_face[face]
        lit = np.zeros((n_steps, len(rows)), bool)
        for light, step in zip(suns.light, suns.step, strict=True):
            turned = np.flatnonzero(facing(own_planes, light)[which] == side)
            lit[step, turned] = ~scene.is_blocked(origin[turned], light[:3])
            n_rays.append(len(turned))
        bits[rows] = np.packbits(lit.T, axis=1, bitorder="little")

    for_batches(n, size, trace, on_done)
    return bits, sum(n_rays)


def runs(bits: U8, n_steps: int) -> tuple[U32, U32]:
    """Return how many steps of each row are lit, and how many in the longest run.

    A step at night, or in shadow, ends a run.

    Parameters
    ----------
    bits : ndarray
        ``(n, ceil(n_steps / 8)) uint8``, as `lit_bits` returns them.
    """
    total, longest = np.zeros(len(bits), np.uint32), np.zeros(len(bits), np.uint32)
    size = max(256, _MOST_BITS // max(n_steps, 1))

    def count(begin: int, end: int) -> None:
        lit = steps_of(bits[begin:end], n_steps)
        run = np.zeros(end - begin, np.uint32)
        for step in range(n_steps):
            run += np.uint32(1)
            run *= lit[:, step]
            np.maximum(longest[begin:end], run, out=longest[begin:end])
        total[begin:end] = lit.sum(axis=1, dtype=np.uint32)

    for_batches(len(bits), size, count, lambda done: None)
    return total, longest


def steps_of(bits: U8, n_steps: int) -> BOOL:
    """Return ``(n, n_steps) bool``: the bits of each row, a step each."""
    return np.unpackbits(bits, axis=1, count=n_steps, bitorder="little").view(bool)
