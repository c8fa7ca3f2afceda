"""Binary PLY: vertices in float64, faces with the numbers of their object and surface.

Comments at the head name objects and surfaces in the order of these numbers, so that
nothing is lost: empty objects, equal names, types, parents.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from svprep.export.city import City
from svprep.export.header import TITLE, header_lines, line

HEAD: Final = f"ply\nformat binary_little_endian 1.0\ncomment {TITLE.rpartition(' ')[0]}".encode()
_FACE: Final = np.dtype(
    [("n", "|u1"), ("corners", "<i4", 3), ("object_id", "<i4"), ("surface", "|u1")]
)


def ply_parts(city: City) -> Iterator[bytes]:
    """Yield the file. O(n)."""
    comments = list(header_lines(city))
    comments += [
        line("object", [name, name, kind, parent])
        for name, kind, parent in zip(city.names, city.types, city.parents, strict=True)
    ]
    comments += [line("surface", name) for name in city.surface_names]
    lines = (
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {text}" for text in comments),
        f"element vertex {len(city.positions)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {len(city.faces)}",
        "property list uchar int vertex_indices",
        "property int object_id",
        "property uchar surface",
        "end_header",
    )
    yield "".join(f"{text}\n" for text in lines).encode()
    yield city.source_positions.astype("<f8", copy=False).tobytes()
    faces = np.empty(len(city.faces), _FACE)
    faces["n"] = 3
    faces["corners"] = city.faces
    n_objects = len(city.names)
    faces["object_id"] = np.repeat(np.arange(n_objects), np.diff(city.object_face_start))
    faces["surface"] = city.surface_of_face
    yield faces.tobytes()
