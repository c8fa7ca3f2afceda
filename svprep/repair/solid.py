"""Which closed components are safe for the closed volume.

The closed volume counts only faces turned to the light, so it is right only
where the component's winding number is nowhere negative. A connected surface
that is closed, outward and meets itself nowhere has winding number 0 outside
and 1 inside. Whatever is not proven so keeps the robust volume.
"""

from __future__ import annotations

import numpy as np

from svprep.kernels.self_contact import touches_itself
from svprep.model import BOOL, I32, I64, U32
from svprep.parallel import for_ranges


def find_self_contact(points: I32, faces: U32, component_face_start: I64, candidates: I64) -> BOOL:
    """Return ``(len(candidates),)``: whether each component crosses or touches itself.

    Faces are grouped by component. Exact (integer predicates, after Devillers
    and Guigue 2002); time is bounded, and a component that would need more
    counts as touching (see `kernels.self_contact`).
    Plain twin: `reference.triangles_touch` on every pair.
    """
    touching = np.zeros(len(candidates), bool)
    n_faces = component_face_start[candidates + 1] - component_face_start[candidates]
    wide = points.astype(np.int64)

    def work(begin: int, end: int) -> None:
        touches_itself(wide, faces, component_face_start, candidates, begin, end, touching)

    if len(candidates):
        for_ranges(np.concatenate(([0], np.cumsum(n_faces))), work)
    return touching
