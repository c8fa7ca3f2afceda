"""What glTF extensions mean for a reader of surfaces: refused, noted or of no concern.

An extension that is listed as required and is not known here may change any position, so
the file is refused by its name. Materials, textures, lights and metadata change none.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np

from svprep.errors import InputError, first_few
from svprep.ingest.parsed import count_of, shown
from svprep.model import F64

_UNDECODED: Final = {
    "EXT_meshopt_compression": "its buffers are meshopt-compressed",
    "KHR_meshopt_compression": "its buffers are meshopt-compressed",
}
_NO_GEOMETRY: Final = re.compile(
    r"(KHR|EXT)_(materials|texture|lights)_\w+|MSFT_texture_dds|KHR_techniques_webgl"
    r"|EXT_(mesh_features|instance_features|structural_metadata|feature_metadata|mesh_manifold)"
    r"|KHR_xmp(_json_ld)?|CESIUM_primitive_outline"
)
_METADATA: Final = ("EXT_structural_metadata", "EXT_feature_metadata")
_READ: Final = frozenset(
    ["KHR_mesh_quantization", "CESIUM_RTC", "KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing"]
)


def refuse_unread(tree: dict[str, Any], path: Path) -> None:
    """Raise `InputError` for extensions without which the geometry would be another."""
    required = tree.get("extensionsRequired", [])
    for name, problem in _UNDECODED.items():
        if name in required or name in tree.get("extensionsUsed", []):
            raise InputError(
                f"{path}: {problem}, which is not read; export it without {name} "
                "(gltf-transform can)."
            )
    unknown = [n for n in required if n not in _READ and not _NO_GEOMETRY.fullmatch(n)]
    if unknown:
        listed = first_few(map(shown, unknown))
        raise InputError(
            f"{path}: it requires {listed}, which is not read and may change its geometry; export "
            "it without."
        )


def rtc_center(tree: dict[str, Any], path: Path) -> F64 | None:
    """Return what CESIUM_RTC adds to positions once z is up, ``(3,)``, if it is there."""
    if "CESIUM_RTC" not in tree.get("extensions", {}):
        return None
    stated = tree["extensions"]["CESIUM_RTC"].get("center")
    center = np.array(stated, np.float64)
    if center.shape != (3,) or not np.isfinite(center).all():
        raise InputError(
            f"{path}: the center of CESIUM_RTC is {shown(stated)}, not three finite numbers."
        )
    return center


def extension_notes(tree: dict[str, Any], meshes: Iterable[int]) -> list[str]:
    """Say what the file says beyond the surfaces that were read, once each.

    Parameters
    ----------
    meshes
        The meshes of which surfaces were read.
    """
    with_targets = [
        mesh
        for mesh in sorted(set(meshes))
        if any(p.get("targets") for p in tree["meshes"][mesh]["primitives"])
    ]
    notes = []
    if with_targets:
        found = count_of(len(with_targets), "mesh", "meshes")
        notes.append(f"morph targets are not applied: {found} with them read as without")
    metadata = [tree.get("extensions", {}).get(name, {}) for name in _METADATA]
    if any("schemaUri" in found and "schema" not in found for found in metadata):
        notes.append(
            "the schema of its properties is another file, which is not read: features are named "
            "by number"
        )
    return notes
