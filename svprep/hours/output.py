"""Writing sun hours where the user asked for them, and nowhere else."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Final

from svprep.hours import csv_table, ply_points
from svprep.hours.facts import facts_of
from svprep.hours.result import SunHours
from svprep.output_file import OutputKind, suffix_of, write_whole

if TYPE_CHECKING:
    from svprep.cache.reader import Cache

HOURS: Final = OutputKind(
    name="the sun hours",
    form="sun hours are written as .csv or .ply",
    what="does not hold sun hours of svprep",
    suffixes=(".csv", ".ply"),
    is_ours=lambda head: head.startswith((csv_table.OURS, ply_points.OURS)),
)


def write_hours(hours: SunHours, cache: Cache, path: str | os.PathLike[str]) -> Path:
    """Write sun hours in the form that the suffix of `path` names: a table or a point cloud.

    The same hours give the same bytes. The file is written beside its place and renamed:
    an older one stays whole until the new one is. Returns the file, links followed.

    Raises
    ------
    InputError, EnvironmentProblem
        As `OutputKind.checked_path`, or the disk is full.
    """
    target = HOURS.checked_path(path)
    facts = facts_of(hours, cache)
    if suffix_of(path) == ".csv":
        write_whole(target, csv_table.csv_parts(hours, facts))
    else:
        write_whole(target, ply_points.ply_parts(hours, cache.grid.origin_m, facts))
    return target
