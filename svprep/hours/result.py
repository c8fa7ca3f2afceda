"""How much sun every sample gets: what `sun_hours` returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from svprep.hours.buried import Burial
from svprep.hours.sampling import Groups
from svprep.hours.tracing import steps_of
from svprep.model import BOOL, F64, U8, U32

if TYPE_CHECKING:
    from svprep.light import Arc


@dataclass(frozen=True, slots=True, eq=False)
class PointHours:
    """The sun at given points, a row each."""

    burial: U8
    """``(n,)``: `Burial`: inside a solid, under the ground, or neither."""
    total_steps: U32
    """``(n,)``: steps of the arc at which it is lit."""
    longest_steps: U32
    """``(n,)``: the most of them that follow each other; a step at night ends a run."""
    bits: U8
    """``(n, ceil(n_steps / 8))``: bit ``s % 8`` (the lowest first) of byte ``s // 8`` is
    whether the point is lit at step s."""
    n_steps: int
    """Of the arc, at night too."""
    step_minutes: float
    n_suns: int
    n_rays: int
    """Rays that were traced: of faces turned to the sun."""
    trace_seconds: float
    """What they took."""

    @property
    def is_buried(self) -> BOOL:
        """``(n,)``: the point can never be lit."""
        return np.asarray(self.burial != np.uint8(Burial.NONE))

    @property
    def total_minutes(self) -> F64:
        """``(n,)`` [min]: sun over the whole arc."""
        return self.total_steps.astype(np.float64) * self.step_minutes

    @property
    def longest_minutes(self) -> F64:
        """``(n,)`` [min]: sun without a break."""
        return self.longest_steps.astype(np.float64) * self.step_minutes

    def is_lit(self, begin: int = 0, end: int | None = None) -> BOOL:
        """Return ``(end - begin, n_steps) bool``: whether each point is lit at each step."""
        return steps_of(self.bits[begin:end], self.n_steps)


@dataclass(frozen=True, slots=True, eq=False)
class SunHours:
    """The sun on all surfaces of a city over an arc, sampled by area.

    Samples are sorted by (object, kind); `groups` says where each part begins. A sample
    stands for ``groups.area_m2[i] / (its samples)`` square metres: the same in its group,
    not between groups.
    """

    arc: Arc
    spacing_m: float
    offset_m: float
    """[m]: how far before its face a ray starts."""
    digest: str
    """Content digest of the cache, ``""`` for a city that is in no cache."""
    object_names: tuple[str, ...]
    object_types: tuple[str, ...]
    """``(n_objects,)``: ``""`` where none is stated; so are parents."""
    object_parents: tuple[str, ...]
    object_sources: tuple[str, ...]
    """``(n_objects,)``: name of the file that each comes from."""
    groups: Groups
    position: F64
    """``(n_samples, 3)`` [m], cache frame; source = grid origin + position."""
    face: U32
    """``(n_samples,)``: the face that it lies on."""
    face_normal: F64
    """``(n_faces, 3)``: unit normal of the side that counts, of every face of the mesh."""
    object: U32
    """``(n_samples,)``: index into `object_names`."""
    kind: U8
    """``(n_samples,)``: `Kind`."""
    is_on_solid: BOOL
    """``(n_samples,)``: of a solid; of another surface, `surfaces` says which side counts."""
    is_stated: BOOL
    """``(n_samples,)``: whether the kind follows from what the file says, not from geometry."""
    points: PointHours

    @property
    def n_samples(self) -> int:
        """Samples."""
        return len(self.face)

    @property
    def is_buried(self) -> BOOL:
        """``(n_samples,)``: in a solid or under the ground, and left out of statistics."""
        return self.points.is_buried

    @property
    def total_minutes(self) -> F64:
        """``(n_samples,)`` [min]: sun over the whole arc."""
        return self.points.total_minutes

    @property
    def longest_minutes(self) -> F64:
        """``(n_samples,)`` [min]: sun without a break."""
        return self.points.longest_minutes

    @property
    def area_of_sample_m2(self) -> F64:
        """``(n_samples,)`` [m2]: what each sample stands for."""
        count = np.diff(self.groups.sample_start)
        return np.repeat(self.groups.area_m2 / count, count)
