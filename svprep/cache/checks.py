"""The numbered checks of `svprep validate`: what each code means.

Numbers are permanent, as those of `svprep.defects` are. 1xx the file's
structure, 2xx digests, 3xx values of one dataset, 4xx tables against each
other, 5xx the repair record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svprep.errors import first_few


@dataclass(frozen=True, slots=True)
class Check:
    """One documented check."""

    code: str
    name: str
    summary: str
    """One sentence: what is wrong when it fails."""
    consequence: str
    """What that means for whoever uses the cache."""

    @property
    def label(self) -> str:
        """``"V201 DAMAGED_DATASET"``."""
        return f"{self.code} {self.name}"


@dataclass(frozen=True, slots=True)
class Problem:
    """One failed check of one file."""

    code: str
    where: str
    """The dataset, attribute or table."""
    message: str
    """Expected, got, the first few ids and how many."""

    def __str__(self) -> str:
        return f"{CHECKS[self.code].label}: {self.where}: {self.message}"


def problem_at(code: str, where: str, message: str, bad: NDArray[np.bool_]) -> list[Problem]:
    """Return one problem that names the first few rows where `bad` holds, or none."""
    rows = np.flatnonzero(bad)
    if not len(rows):
        return []
    return [Problem(code, where, f"{message}: {first_few(rows)}")]


_REBUILD = "The cache cannot be used; build it again."
_BUG = (
    "The file is as it was written, so the program that wrote it is wrong. Shadows may be wrong; "
    "build the cache again with a released svprep, and report it if that does not help."
)

CHECKS: dict[str, Check] = {
    c.code: c
    for c in (
        Check("V101", "MISSING", "A declared dataset or attribute is not there.", _REBUILD),
        Check(
            "V102",
            "WRONG_FORM",
            "A dataset or attribute has another type, layout or shape than declared, or does not "
            "fit the length of the others.",
            _REBUILD,
        ),
        Check(
            "V103",
            "UNKNOWN",
            "The file holds something that the schema does not declare.",
            "svprep ignores it. Another program added it, or it stands for a declared name that "
            "was damaged.",
        ),
        Check(
            "V104",
            "UNREADABLE",
            "HDF5 cannot read a dataset or attribute: its own structures are damaged.",
            _REBUILD,
        ),
        Check(
            "V105",
            "BAD_ATTRIBUTE",
            "An attribute is not the JSON it should be, or a number is out of range (the grid "
            "step is no power of two, a number is not finite).",
            _REBUILD,
        ),
        Check(
            "V106",
            "BAD_VTKHDF",
            "The group VTKHDF does not show the mesh of the cache: it links to other arrays, or "
            "what should follow from the tables does not.",
            "svprep does not read it. ParaView and PyVista may show another mesh; build the cache "
            "again.",
        ),
        Check(
            "V201",
            "DAMAGED_DATASET",
            "The bytes of a dataset are not those that were written: its SHA-256 differs from the "
            "digest table.",
            "The disk, a transfer or another program changed it. Copy the file again, or build "
            "it again.",
        ),
        Check(
            "V202",
            "DAMAGED_ROOT",
            "The digest table and the root attributes do not give the stored root digests.",
            "The digest table or an attribute was changed after writing. Copy the file again, or "
            "build it again.",
        ),
        Check("V301", "BAD_OFFSETS", "Offsets do not rise from 0 to the table's length.", _BUG),
        Check("V302", "BAD_INDEX", "An index lies beyond the table that it refers to.", _BUG),
        Check(
            "V303",
            "BAD_POSITION",
            "A position is not finite, not a multiple of the grid step, or more than 2^24 steps "
            "from zero.",
            _BUG,
        ),
        Check("V304", "BAD_FLAGS", "Flags hold bits that have no meaning, or contradict.", _BUG),
        Check(
            "V305",
            "BAD_FACE",
            "A face repeats a corner, has zero area, or uses a vertex of another object.",
            _BUG,
        ),
        Check(
            "V401",
            "HALF_EDGE_COUNT",
            "A side of a face is not in exactly one edge record.",
            _BUG,
        ),
        Check(
            "V402",
            "EDGE_ENDS",
            "The two half-edges of a record do not run along the same edge in opposite "
            "directions, left from the smaller vertex to the larger.",
            _BUG,
        ),
        Check(
            "V403",
            "EDGE_ORDER",
            "Edge records are not sorted by (object, component, v0, v1, left face), or lie in "
            "another component than their faces.",
            _BUG,
        ),
        Check(
            "V404",
            "EDGE_KIND",
            "The kind of an edge record contradicts the number of its faces, or of the faces at "
            "its edge.",
            _BUG,
        ),
        Check(
            "V405",
            "EDGE_PLANAR",
            "A record is marked planar, but its two faces do not share a plane record.",
            _BUG,
        ),
        Check(
            "V406",
            "OFF_PLANE",
            "A vertex of a face lies farther from the face's plane record than the stored "
            "tolerance.",
            _BUG,
        ),
        Check(
            "V407",
            "AGAINST_PLANE",
            "A face is tilted against its plane record by more than 0.0002 rad, or a record names "
            "a face that does not share it.",
            _BUG,
        ),
        Check(
            "V408",
            "NOT_CLOSED",
            "A component is marked closed, but has edge records of one face; or it has none and "
            "is not marked.",
            _BUG,
        ),
        Check(
            "V409",
            "BAD_GROUPING",
            "The offsets of objects and components do not fit each other: a component reaches "
            "over the end of its object, or has no faces.",
            _BUG,
        ),
        Check(
            "V410",
            "PLANE_ORDER",
            "Plane records are not numbered by their lowest face, or a component uses one of "
            "another's.",
            _BUG,
        ),
        Check(
            "V411",
            "BAD_TREE",
            "A silhouette tree does not hold exactly the searched edge records of its object, each "
            "once; or its frame, number of blocks or expected work cannot be right.",
            _BUG,
        ),
        Check(
            "V412",
            "WRONG_BOUND",
            "A bound in a silhouette tree does not hold an edge below it. The boxes of dual points "
            "are always checked, the spheres with normal cones by --deep.",
            "For some lights a silhouette edge is passed over, and shadows leak there. " + _BUG,
        ),
        Check(
            "V413",
            "BAD_SCENE_TREE",
            "A scene tree does not hold every object or face once, a cluster holds faces of two "
            "objects or too many, or a box is not that of what it holds.",
            "What is culled or clamped with it may be seen, or cast a shadow, after all. " + _BUG,
        ),
        Check(
            "V414",
            "BAD_LIGHT",
            "A light, its frame or its segments cannot be right: no unit direction, axes that are "
            "not its own, a component without segments, a segment that ends before it begins.",
            "Shadows of that light are wrong when they are drawn clamped; with --clamp none they "
            "are right. " + _BUG,
        ),
        Check(
            "V501",
            "BAD_RECORD",
            "The repair record is not sorted, repeats itself, counts nothing, or gives fewer "
            "source triangles than are left.",
            _BUG,
        ),
        Check(
            "V502",
            "UNKNOWN_DEFECT",
            "The repair record holds a defect code that this svprep does not know.",
            "A newer svprep wrote the cache. Upgrade.",
        ),
    )
}
