"""Sun hours as a point cloud: binary PLY, a point per sample, coloured by its sun.

The colours run from dark blue (no sun) over violet and orange to light yellow (as much sun
as the arc has) with lightness growing evenly, in Oklab (Ottosson 2020), so that equal
differences of sun look equal, and do in grey too. Buried samples are grey.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from svprep.hours.facts import TITLE, WHAT, fact_lines
from svprep.hours.kinds import Kind
from svprep.hours.result import SunHours
from svprep.model import F64, U8

OURS: Final = f"ply\nformat binary_little_endian 1.0\ncomment {WHAT} ".encode()
"""What files of any version begin with."""
HEAD: Final = f"ply\nformat binary_little_endian 1.0\ncomment {TITLE}\n".encode()
BURIED_GREY: Final = 128
_POINTS_AT_ONCE: Final = 1 << 20
_POINT: Final = np.dtype(
    [
        ("position", "<f8", 3),
        ("normal", "<f4", 3),
        ("total_minutes", "<f4"),
        ("longest_minutes", "<f4"),
        ("object", "<u4"),
        ("kind", "u1"),
        ("buried", "u1"),
        ("colour", "u1", 3),
    ]
)
_DARKEST, _LIGHTEST = 0.30, 0.95
_FIRST_HUE_DEG, _LAST_HUE_DEG = 275.0, 465.0
"""From blue over red to yellow (105)."""
_CHROMA: Final = 0.13


def ply_parts(hours: SunHours, origin_m: F64, facts: dict[str, Any]) -> Iterator[bytes]:
    """Yield the point cloud, piece by piece; positions in source coordinates [m]."""
    most = len(hours.arc.lights) * hours.arc.step_minutes
    kinds = ", ".join(f"{int(kind)} {kind.name.lower()}" for kind in Kind)
    comments = [
        *fact_lines(facts),
        f"property kind: {kinds}",
        "property buried: 0 not, 1 in a solid, 2 under the ground",
        f"property colour: even lightness, dark 0 to light {most:g} minutes; grey buried",
        "property object: index of the object in the cache",
    ]
    yield HEAD
    header = [
        # Readers differ in what they make of others; names of files need not be ASCII.
        *(f"comment {line.encode('ascii', 'backslashreplace').decode()}" for line in comments),
        f"element vertex {hours.n_samples}",
        *(f"property double {axis}" for axis in "xyz"),
        *(f"property float n{axis}" for axis in "xyz"),
        "property float total_minutes",
        "property float longest_minutes",
        "property uint object",
        "property uchar kind",
        "property uchar buried",
        *(f"property uchar {colour}" for colour in ("red", "green", "blue")),
        "end_header",
    ]
    yield "".join(f"{line}\n" for line in header).encode()
    of_steps = ramp(np.linspace(0.0, 1.0, len(hours.arc.lights) + 1))
    for begin in range(0, hours.n_samples, _POINTS_AT_ONCE):
        part = slice(begin, begin + _POINTS_AT_ONCE)
        steps = hours.points.total_steps[part]
        points = np.empty(len(steps), _POINT)
        points["position"] = origin_m + hours.position[part]
        points["normal"] = hours.face_normal[hours.face[part]]
        points["total_minutes"] = steps * hours.arc.step_minutes
        points["longest_minutes"] = hours.points.longest_steps[part] * hours.arc.step_minutes
        points["object"] = hours.object[part]
        points["kind"] = hours.kind[part]
        points["buried"] = hours.points.burial[part]
        points["colour"] = of_steps[steps]
        points["colour"][hours.is_buried[part]] = BURIED_GREY
        yield points.tobytes()


def ramp(share: F64) -> U8:
    """Return ``(n, 3) uint8`` sRGB colours of shares 0 to 1, even in lightness."""
    lightness = _DARKEST + share * (_LIGHTEST - _DARKEST)
    hue = np.radians(_FIRST_HUE_DEG + share * (_LAST_HUE_DEG - _FIRST_HUE_DEG))
    a, b = _CHROMA * np.cos(hue), _CHROMA * np.sin(hue)
    # Oklab to linear sRGB: Ottosson 2020, "A perceptual color space for image processing".
    long = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3
    medium = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3
    short = (lightness - 0.0894841775 * a - 1.2914855480 * b) ** 3
    linear = np.stack(
        [
            4.0767416621 * long - 3.3077115913 * medium + 0.2309699292 * short,
            -1.2684380046 * long + 2.6097574011 * medium - 0.3413193965 * short,
            -0.0041960863 * long - 0.7034186147 * medium + 1.7076147010 * short,
        ],
        axis=1,
    ).clip(0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * encoded).astype(np.uint8)
