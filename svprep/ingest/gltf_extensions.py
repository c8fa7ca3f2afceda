"""What glTF extensions mean for a reader of surfaces: refused, noted or of no concern.

An extension that is listed as required and is not known here may change any position, so
the file is refused by its name. Materials, textures, lights and metadata change none.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from svprep.errors import InputError, first_few
from svprep.ingest.parsed import count_of, shown

_UNDECODED: Final = {
    "KHR_draco_mesh_compression": "its meshes are Draco-compressed",
    "EXT_meshopt_compression": "its buffers are meshopt-compressed",
    "KHR_meshopt_compression": "its buffers are meshopt-compressed",
    "EXT_mesh_gpu_instancing": "it places meshes by EXT_mesh_gpu_instancing",
}
_NO_GEOMETRY: Final = re.compile(
    r"(KHR|EXT)_(materials|texture|lights)_\w+|MSFT_texture_dds|KHR_techniques_webgl"
    r"|EXT_(mesh_features|structural_metadata|feature_metadata|mesh_manifold)"
    r"|KHR_xmp(_json_ld)?|CESIUM_primitive_outline"
)
_READ_OR_NOTED: Final = frozenset(["KHR_mesh_quantization", "CESIUM_RTC"])
_FEATURE_ATTRIBUTE: Final = re.compile(r"_FEATURE_ID(_\d+)?|_BATCHID")


def refuse_unread(tree: dict[str, Any], path: Path) -> None:
    """Raise `InputError` for extensions without which the geometry would be another."""
    required = tree.get("extensionsRequired", [])
    for name, problem in _UNDECODED.items():
        if name in required or name in tree.get("extensionsUsed", []):
            raise InputError(
                f"{path}: {problem}, which is not read; export it without {name} "
                "(gltf-transform can)."
            )
    unknown = [n for n in required if n not in _READ_OR_NOTED and not _NO_GEOMETRY.fullmatch(n)]
    if unknown:
        listed = first_few(map(shown, unknown))
        raise InputError(
            f"{path}: it requires {listed}, which is not read and may change its geometry; export "
            "it without."
        )


def extension_notes(
    tree: dict[str, Any], meshes: Iterable[int], accessor: Callable[[int], NDArray[np.generic]]
) -> list[str]:
    """Say what the file says beyond the surfaces that were read, once each.

    Parameters
    ----------
    meshes
        The meshes of which surfaces were read.
    accessor
        Returns the values of an accessor, ``(count, width)``.
    """
    meshes = sorted(set(meshes))
    notes = []
    if "CESIUM_RTC" in tree.get("extensions", {}):
        center = tree["extensions"]["CESIUM_RTC"].get("center")
        notes.append(
            f"CESIUM_RTC is not applied: its center {shown(center)} is not added to positions"
        )
    with_targets = [m for m in meshes if any(p.get("targets") for p in _primitives(tree, m))]
    if with_targets:
        found = count_of(len(with_targets), "mesh", "meshes")
        notes.append(f"morph targets are not applied: {found} with them read as without")
    for label, n in _count_features(tree, meshes, accessor):
        notes.append(
            f"holds {n} objects as feature ids ({shown(label)}), which are not read yet: "
            "each mesh is one object"
        )
    return notes


def _primitives(tree: dict[str, Any], mesh: int) -> list[dict[str, Any]]:
    primitives: list[dict[str, Any]] = tree["meshes"][mesh]["primitives"]
    return primitives


def _count_features(
    tree: dict[str, Any], meshes: list[int], accessor: Callable[[int], NDArray[np.generic]]
) -> Iterator[tuple[str, int]]:
    """Yield each way in which features are told apart, if one mesh holds several of them.

    Ids that name rows of one property table are the same features in every mesh; other
    ids count anew in each mesh.
    """
    ids: dict[str, dict[str, set[float]]] = defaultdict(lambda: defaultdict(set))
    announced: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    is_several: dict[str, bool] = defaultdict(bool)
    for mesh in meshes:
        in_mesh: dict[str, set[float]] = defaultdict(set)
        for primitive in _primitives(tree, mesh):
            attributes = primitive["attributes"]
            features = primitive.get("extensions", {}).get("EXT_mesh_features", {})
            sets = {_label(entry): entry for entry in features.get("featureIds", [])}
            for name in filter(_FEATURE_ATTRIBUTE.fullmatch, attributes):
                sets.setdefault(name, {})
            for label, entry in sets.items():
                table = entry.get("propertyTable")
                scope = f"mesh {mesh}" if table is None else f"table {table}"
                if label in attributes:
                    found = set(np.unique(accessor(attributes[label])).tolist())
                    found.discard(entry.get("nullFeatureId"))
                    in_mesh[label] |= found
                    ids[label][scope] |= found
                    is_several[label] |= len(in_mesh[label]) > 1
                else:
                    n = int(entry.get("featureCount", 0))
                    announced[label][scope] = max(announced[label][scope], n)
                    is_several[label] |= n > 1
    for label, several in is_several.items():
        if several:
            n_announced = sum(announced[label].values())
            yield label, n_announced + sum(len(found) for found in ids[label].values())


def _label(entry: dict[str, Any]) -> str:
    """Return the name of a set of feature ids."""
    if "attribute" in entry:
        return f"_FEATURE_ID_{entry['attribute']}"
    return "a texture" if "texture" in entry else "one per vertex"
