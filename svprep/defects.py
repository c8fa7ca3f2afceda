"""The numbered defects: what each code means and what svprep does about it.

Numbers are permanent: a code is never given another meaning. Tables of the
cache and reports use the number, messages use ``D302 OPEN_SHELL``.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final


class Code(IntEnum):
    """Defect codes. 1xx faces, 2xx winding, 3xx edges, 4xx solids."""

    DEGENERATE_FACE = 101
    COLLAPSED_FACE = 102
    DUPLICATE_FACE = 103
    OPPOSITE_FACE = 104
    SHORT_POLYGON = 105
    NONPLANAR_POLYGON = 106
    SELF_CROSSING_POLYGON = 107
    FLIPPED_FACE = 201
    INVERTED_COMPONENT = 202
    CUT_EDGE = 203
    NONMANIFOLD_EDGE = 301
    OPEN_SHELL = 302
    SELF_INTERSECTION = 401
    FLAT_COMPONENT = 402
    UNWELDED_VERTEX = 501


@dataclass(frozen=True, slots=True)
class Defect:
    """One documented defect."""

    code: Code
    unit: str
    """What is counted: ``"face"``, ``"edge"``, ``"component"``, ``"vertex"``."""
    summary: str
    """One sentence: what it is."""
    action: str
    """One or two sentences: what svprep does, and what that means for shadows."""

    @property
    def label(self) -> str:
        """``"D302 OPEN_SHELL"``."""
        return f"D{int(self.code)} {self.code.name}"


DEFECTS: dict[Code, Defect] = {
    d.code: d
    for d in (
        Defect(
            Code.DEGENERATE_FACE,
            "face",
            "A face whose area is zero in the source: two corners at one position, or three "
            "corners on a line.",
            "Dropped and listed. It casts nothing. Neighbours that met only through it keep "
            "border edges there.",
        ),
        Defect(
            Code.COLLAPSED_FACE,
            "face",
            "A face with area in the source whose corners fall on one line or point once they "
            "lie on the grid (or within --weld-tolerance).",
            "Dropped and listed. Its shadow would be thinner than one grid step.",
        ),
        Defect(
            Code.DUPLICATE_FACE,
            "face",
            "A face with the same three vertices, in the same cyclic order, as an earlier face "
            "of its object.",
            "Dropped and listed; the earlier one casts the same shadow.",
        ),
        Defect(
            Code.OPPOSITE_FACE,
            "face",
            "A face with the same three vertices as another face of its object, in the "
            "opposite order: a party wall, or a sheet drawn from both sides.",
            "Kept. Both cast; a point behind them is in shadow either way.",
        ),
        Defect(
            Code.SHORT_POLYGON,
            "face",
            "A polygon with fewer than three different corners in the file; it makes no triangle, "
            "so it is not among those read.",
            "Not a surface: left out and listed.",
        ),
        Defect(
            Code.NONPLANAR_POLYGON,
            "face",
            "A polygon whose corners lie farther from their common plane than one thousandth "
            "of its diameter.",
            "Triangulated in its best plane and kept. The surface between its corners is a "
            "choice that the file leaves open.",
        ),
        Defect(
            Code.SELF_CROSSING_POLYGON,
            "face",
            "A polygon whose outline crosses or touches itself, so that it has no unique inside.",
            "Triangulated as well as its outline allows and kept.",
        ),
        Defect(
            Code.FLIPPED_FACE,
            "face",
            "A face wound against its neighbours.",
            "Turned to agree with them and listed. A shadow does not depend on winding; the "
            "closed volume does.",
        ),
        Defect(
            Code.INVERTED_COMPONENT,
            "component",
            "A closed component whose faces look inward.",
            "Turned outward as a whole; its faces are listed as flipped.",
        ),
        Defect(
            Code.CUT_EDGE,
            "edge",
            "An edge whose two faces run the same way and cannot be turned to agree: the "
            "component has one side only (a Moebius strip, a Klein bottle).",
            "Cut into two border records. The robust volume is used; shadows are exact.",
        ),
        Defect(
            Code.NONMANIFOLD_EDGE,
            "edge",
            "An edge with three or more faces: an inner wall, touching solids, overlapping "
            "triangulations.",
            "Split by angle into consistently wound pairs and single records. Shadows are exact.",
        ),
        Defect(
            Code.OPEN_SHELL,
            "edge",
            "An edge with a single face; a closed solid has none.",
            "Kept as a border record. Its component casts by the robust volume, which needs no "
            "closed surface.",
        ),
        Defect(
            Code.SELF_INTERSECTION,
            "component",
            "A closed component that crosses or touches itself, or may do so.",
            "Kept. It casts by the robust volume, because the closed volume would count wrongly.",
        ),
        Defect(
            Code.FLAT_COMPONENT,
            "component",
            "A closed component that encloses no volume: a sheet drawn from both sides.",
            "Kept. It casts by the robust volume.",
        ),
        Defect(
            Code.UNWELDED_VERTEX,
            "vertex",
            "A vertex at exactly the grid position of another vertex of its object.",
            "Merged with it, so that faces that meet in space also meet in the tables. "
            "Nothing moves.",
        ),
    )
}

LEFT_OUT: Final = (Code.DEGENERATE_FACE, Code.COLLAPSED_FACE, Code.DUPLICATE_FACE)
"""Defects of triangles that are not in the mesh."""
