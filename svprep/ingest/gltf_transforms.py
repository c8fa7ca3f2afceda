"""Where glTF places a mesh: the matrix of a node, and those of its instances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from svprep.model import F64

INSTANCING: Final = "EXT_mesh_gpu_instancing"
PLACING: Final = frozenset(["matrix", "rotation", "scale", "translation"])
"""What of a node places it in its parent."""


def local_matrix(node: dict[str, Any]) -> F64:
    """Return a node's parent-from-local matrix, ``(4, 4)``."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    if "rotation" in node:
        matrix[:3, :3] = _rotations(np.array(node["rotation"], np.float64).reshape(1, 4))[0]
    if "scale" in node:
        matrix[:3, :3] *= np.array(node["scale"], np.float64)
    if "translation" in node:
        matrix[:3, 3] = node["translation"]
    return matrix


def instance_matrices(
    attributes: dict[str, int], accessor: Callable[[int], NDArray[np.generic]]
) -> F64:
    """Return the node-from-instance matrices of EXT_mesh_gpu_instancing, ``(n, 4, 4)``.

    Raises
    ------
    ValueError
        If its attributes place different numbers of instances, or none.
    """
    parts = {
        name: accessor(attributes[name]).astype(np.float64)
        for name in ("TRANSLATION", "ROTATION", "SCALE")
        if name in attributes
    }
    counts = {len(part) for part in parts.values()}
    if len(counts) != 1:
        raise ValueError(f"EXT_mesh_gpu_instancing places {sorted(counts)} instances at once")
    matrices = np.tile(np.eye(4), (counts.pop(), 1, 1))
    if "ROTATION" in parts:
        matrices[:, :3, :3] = _rotations(parts["ROTATION"])
    if "SCALE" in parts:
        matrices[:, :3, :3] *= parts["SCALE"].reshape(-1, 1, 3)
    if "TRANSLATION" in parts:
        matrices[:, :3, 3] = parts["TRANSLATION"]
    return matrices


def _rotations(quaternions: F64) -> F64:
    """Return the matrices of quaternions ``(x, y, z, w)``, normalised first."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)
