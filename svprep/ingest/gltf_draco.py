"""Meshes compressed by Draco (KHR_draco_mesh_compression), decoded by DracoPy."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from svprep.errors import InputError, require_extra
from svprep.ingest.gltf_buffers import Buffers
from svprep.ingest.parsed import shown
from svprep.model import F64, I64

DRACO: Final = "KHR_draco_mesh_compression"


def is_draco(primitive: dict[str, Any], buffers: Buffers) -> bool:
    """Return whether a primitive must be decoded: it has no uncompressed copy beside it."""
    if DRACO not in primitive.get("extensions", {}):
        return False
    accessors = [primitive["attributes"]["POSITION"]]
    if "indices" in primitive:
        accessors.append(primitive["indices"])
    return not all("bufferView" in buffers.described(index) for index in accessors)


def decode_draco(
    primitive: dict[str, Any], buffers: Buffers, path: Path, what: str
) -> tuple[F64, I64, Callable[[str], NDArray[np.generic]]]:
    """Decode one primitive.

    Returns
    -------
    points : (n, 3) float64
    corners : (3 n_triangles,) int64
    values : function
        Returns the values of an attribute, ``(n, width)``.

    Raises
    ------
    InputError
        If it is damaged, or holds other counts than its accessors say.
    EnvironmentProblem
        If DracoPy is not installed.
    """
    try:
        draco = importlib.import_module("DracoPy")  # it has no types
    except ImportError:
        raise require_extra("DracoPy", "formats", f"{path}: its Draco-compressed mesh") from None
    packed = primitive["extensions"][DRACO]
    numbers = packed["attributes"]
    try:
        mesh = draco.decode(bytes(buffers.view(packed["bufferView"])))
        by_number = {a["unique_id"]: np.asarray(a["data"]) for a in mesh.attributes}
        points = by_number[numbers["POSITION"]].astype(np.float64)
        corners = np.asarray(mesh.faces).reshape(-1).astype(np.int64)
    except InputError:
        raise
    except Exception as error:  # DracoPy raises Exception itself, too
        detail = shown(f"{type(error).__name__}: {error}")
        raise InputError(f"{path}: {what}: its Draco data is damaged ({detail}).") from None
    n_corners = buffers.described(primitive["indices"])["count"] if "indices" in primitive else None
    n_points = buffers.described(primitive["attributes"]["POSITION"])["count"]
    if points.shape != (n_points, 3) or n_corners not in (None, corners.size):
        raise InputError(
            f"{path}: {what}: its Draco data holds {len(points)} vertices and {corners.size} "
            f"indices, but its accessors say {shown(n_points)} and {shown(n_corners)}."
        )

    def values(attribute: str) -> NDArray[np.generic]:
        if attribute in numbers:
            decoded: NDArray[np.generic] = by_number[numbers[attribute]].reshape(len(points), -1)
            return decoded
        return buffers.accessor(primitive["attributes"][attribute])

    return points, corners, values
