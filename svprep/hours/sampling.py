"""Sample points by area: deterministic, the same for any number of threads.

Faces of one object and one kind are laid end to end by area; n samples divide that
length into n equal parts and stand in the middle of each. So a thousand slivers get
their fair share, and no group that has area goes without a sample.

    area   |----- face 0 -----|-- face 1 --|f2|f3|--- face 4 ---|
    sample    0     1     2     3     4     5     6     7     8

Where in its face a sample lies is told by `svprep.hours.spread`.

Every sample of a group stands for the same area: the group's, divided by its samples.
Groups differ: a face of 0.1 m2 on its own has one sample of 0.1 m2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.errors import InputError
from svprep.hours.kinds import Kind
from svprep.hours.spread import points_in_faces
from svprep.hours.surfaces import Surfaces
from svprep.model import F64, I64, U8, U32, Mesh
from svprep.rays import for_batches

MOST_SAMPLES: Final = 100_000_000
_AT_ONCE: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class Groups:
    """The surfaces of one kind of one object, a row each, sorted by (object, kind)."""

    object: U32
    """``(n_groups,)``"""
    kind: U8
    """``(n_groups,)``: `Kind`."""
    area_m2: F64
    """``(n_groups,)`` [m2], each above 0."""
    sample_start: I64
    """``(n_groups + 1,)``: group i has the samples ``start[i]`` to ``start[i + 1] - 1``."""
    faces: U32
    """``(n_faces,)``: all faces, those of a group together and ascending."""
    face_start: I64
    """``(n_groups + 1,)``: where each group's `faces` begin."""


def check_spacing(spacing_m: float) -> None:
    """Raise unless `spacing_m` is a finite distance above 0.

    Raises
    ------
    InputError
        It is not.
    """
    if not (math.isfinite(spacing_m) and spacing_m > 0.0):
        raise InputError(f"a spacing of samples is a distance in metres above 0, not {spacing_m:g}")


def plan_samples(mesh: Mesh, surfaces: Surfaces, spacing_m: float) -> Groups:
    """Return how many samples each object has of each kind: one per ``spacing_m**2``.

    Raises
    ------
    InputError
        `spacing_m` is not a distance, or so small that there were more than
        `MOST_SAMPLES`: says how many, and which spacing would do.
    """
    check_spacing(spacing_m)
    n_objects = len(mesh.object_face_start) - 1
    owner = np.repeat(np.arange(n_objects), np.diff(mesh.object_face_start))
    key = owner * len(Kind) + surfaces.kind
    faces = np.argsort(key, kind="stable")
    is_first = np.concatenate(([True], np.diff(key[faces]) != 0))[: len(faces)]
    begin = np.flatnonzero(is_first)
    face_start = np.concatenate((begin, [len(faces)]))
    area = np.add.reduceat(surfaces.area_m2[faces], begin) if len(begin) else np.zeros(0)
    with np.errstate(over="ignore"):
        wanted = np.maximum(np.rint(area / spacing_m / spacing_m), 1.0)
        n_samples = float(wanted.sum())
    if n_samples > MOST_SAMPLES:
        raise InputError(_too_many(n_samples, float(area.sum()), len(begin), spacing_m))
    return Groups(
        object=(key[faces[begin]] // len(Kind)).astype(np.uint32),
        kind=(key[faces[begin]] % len(Kind)).astype(np.uint8),
        area_m2=area,
        sample_start=np.concatenate(([0], np.cumsum(wanted.astype(np.int64)))),
        faces=faces.astype(np.uint32),
        face_start=face_start,
    )


def _too_many(n_samples: float, area_m2: float, n_groups: int, spacing_m: float) -> str:
    """Return the message that refuses so many samples."""
    shown = f"{int(n_samples):,}" if n_samples < 1e15 else f"{n_samples:.3g}"
    said = (
        f"a spacing of {spacing_m:g} m makes {shown} samples on {area_m2:,.0f} m2 of surface; at "
        f"most {MOST_SAMPLES:,} can be computed with"
    )
    room = MOST_SAMPLES - n_groups
    if room <= 0:
        return f"{said}, and {n_groups:,} surfaces need one each. Split the model"
    enough = math.sqrt(area_m2 / room)
    digit = 10.0 ** (math.floor(math.log10(enough)) - 1)
    return f"{said}. Choose --spacing {math.ceil(enough / digit) * digit:g} or more"


def place_samples(
    mesh: Mesh, surfaces: Surfaces, groups: Groups, on_done: Callable[[int], None]
) -> tuple[F64, U32]:
    """Return where the samples of `groups` lie and on which faces.

    Returns
    -------
    position : ``(n_samples, 3) float64`` [m], cache frame
    face : ``(n_samples,) uint32``
    """
    n_samples = int(groups.sample_start[-1])
    position, face = np.empty((n_samples, 3)), np.empty(n_samples, np.uint32)
    # In shares of their group, so that small groups keep their digits beside large ones.
    group_of_face = np.repeat(np.arange(len(groups.kind)), np.diff(groups.face_start))
    share = surfaces.area_m2[groups.faces] / groups.area_m2[group_of_face]
    reach = np.cumsum(share)
    before = np.concatenate(([0.0], reach))[groups.face_start]

    def place(begin: int, end: int) -> None:
        number = np.arange(begin, end)
        group = np.searchsorted(groups.sample_start, number, side="right") - 1
        within = number - groups.sample_start[group]
        count = groups.sample_start[group + 1] - groups.sample_start[group]
        part = (within + 0.5) / count
        at = before[group] + part * (before[group + 1] - before[group])
        row = np.searchsorted(reach, at, side="right")
        row = np.clip(row, groups.face_start[group], groups.face_start[group + 1] - 1)
        face[begin:end] = chosen = groups.faces[row]
        position[begin:end] = points_in_faces(mesh, chosen, within)

    for_batches(n_samples, _AT_ONCE, place, on_done)
    return position, face
