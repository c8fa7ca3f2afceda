"""What decides whether a pixel can be judged: these numbers, here and nowhere else.

They are printed in each report and are not loosened to pass. A test holds them.
"""

from __future__ import annotations

from typing import Final

PIXEL_JITTER_PX: Final = 0.7
PIXEL_JITTERS: Final = ((-1, -1), (1, 1), (1, -1), (-1, 1), (1, 0), (-1, 0), (0, 1), (0, -1))
"""Eight points around a pixel's centre, in units of `PIXEL_JITTER_PX`; corners first, since
an edge that passes the centre nearby most likely parts it from one of them."""
LEAST_OFFSET_M: Final = 2e-3
OFFSET_ULPS: Final = 8.0
"""Of float32, at the model's largest coordinate."""
FAR_OFFSET: Final = 10.0
"""Of the offset: the second displacement that must agree."""
CENTRE_ULPS: Final = 4.0
"""Of float32: the displacement that stands for none. The centre itself is one of the samples
that must agree: where a shadow is thinner than the offset, 2 mm beside X is not at X."""
LIGHT_JITTER_RAD: Final = 2e-4
N_LIGHT_JITTERS: Final = 8
PARALLEL_RAD: Final = 2e-4
"""Faces tilted by no more against each other may be a coplanar overlap."""

JUDGE_CONSTANTS: Final = (
    f"a pixel is decidable iff its centre (displaced by {CENTRE_ULPS:g} float32 ulps of the "
    f"extent), {len(PIXEL_JITTERS)} points "
    f"+-{PIXEL_JITTER_PX:g} px around it, displacements of "
    f"max({1e3 * LEAST_OFFSET_M:g} mm, {OFFSET_ULPS:g} float32 ulps of the extent) and "
    f"{FAR_OFFSET:g} times that, and {N_LIGHT_JITTERS} lights turned by "
    f"{LIGHT_JITTER_RAD:g} rad all agree; percentages are of surface pixels, sky excluded"
)
