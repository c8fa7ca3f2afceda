"""The reader of glTF 2.0: ``.gltf`` with its buffers, and ``.glb``.

Our own, because the decoder in trimesh names nodes at random where a mesh has several
primitives, loses what hangs below a camera, skips triangle fans, and reads normalised or
sparse positions as something else without a word. Quantised positions
(KHR_mesh_quantization) are read; of other extensions see `svprep.ingest.gltf_extensions`.

One object per node with a surface, so a mesh that n nodes use gives n objects. A node's
triangles count in file order. y up becomes z up: (x, y, z) -> (x, -z, y).
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections import Counter
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from svprep.errors import InputError, first_few
from svprep.ingest.file_bytes import is_device
from svprep.ingest.gltf_extensions import extension_notes, refuse_unread
from svprep.ingest.parsed import (
    ParsedFile,
    count_of,
    encodable,
    no_findings,
    refuse_non_finite,
    shown,
)
from svprep.model import F64, I64, U8

_JSON_CHUNK: Final = 0x4E4F534A
_BIN_CHUNK: Final = 0x004E4942
_DTYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_INDEX_TYPES: Final = (5121, 5123, 5125)
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_PLACING: Final = frozenset(["matrix", "rotation", "scale", "translation"])
_Z_UP_FROM_Y_UP: Final = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def read_gltf(data: U8, path: Path, stem: str) -> ParsedFile:
    """Read a glTF or GLB file.

    Parameters
    ----------
    data : (n_bytes + 1,) uint8
        The file and a line feed behind it.

    Raises
    ------
    InputError
        Also for compressed or instanced geometry that is not decoded here: reading the
        rest would leave out shadows.
    """
    try:
        tree, binary = _split(data[:-1].tobytes(), path)
        return _Gltf(tree, binary, path).read(stem)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        detail = shown(f"{type(error).__name__}: {error}")
        raise InputError(f"{path}: the glTF structure is damaged ({detail}).") from None


def _split(text: bytes, path: Path) -> tuple[dict[str, Any], bytes | None]:
    """Return the JSON and, of a GLB file, the binary chunk."""
    binary = None
    if text[:4] == b"glTF":
        if len(text) < 20:
            raise InputError(f"{path}: the GLB file is cut off ({len(text)} bytes).")
        version, length = struct.unpack_from("<II", text, 4)
        if version != 2:
            raise InputError(f"{path}: glTF version {version}; version 2 is read.")
        if length > len(text):
            raise InputError(
                f"{path}: the GLB file is cut off: it announces {length} bytes and has {len(text)}."
            )
        chunks: dict[int, bytes] = {}
        pos = 12
        while pos + 8 <= length:
            size, kind = struct.unpack_from("<II", text, pos)
            chunks.setdefault(kind, text[pos + 8 : pos + 8 + size])
            pos += 8 + size
        text, binary = chunks.get(_JSON_CHUNK, b""), chunks.get(_BIN_CHUNK)
    try:
        tree = json.loads(text.decode("utf-8-sig"))
    except ValueError as error:
        raise InputError(f"{path}: not glTF: no readable JSON in it ({error}).") from None
    except RecursionError:
        raise InputError(f"{path}: not glTF: its JSON is nested too deeply.") from None
    if not isinstance(tree, dict) or "asset" not in tree:
        raise InputError(f'{path}: not glTF: the JSON has no "asset".')
    version = str(tree["asset"].get("version", "2.0"))
    if not version.startswith("2"):
        raise InputError(f"{path}: glTF version {shown(version)}; version 2 is read.")
    return tree, binary


class _Gltf:
    """One file while it is read."""

    def __init__(self, tree: dict[str, Any], binary: bytes | None, path: Path) -> None:
        self.tree = tree
        self.path = path
        self.binary = binary
        self.buffers: dict[int, bytes] = {}
        self.beside: set[int] = set()  # buffers that are files of their own
        self.meshes: set[int] = set()  # with surfaces that were read
        self.left_out: Counter[str] = Counter()
        self.positions: list[F64] = []
        self.faces: list[NDArray[np.uint32]] = []
        self.n_vertices = 0
        self.names: list[str] = []
        self.face_counts: list[int] = []

    def read(self, stem: str) -> ParsedFile:
        """Walk the scene and gather its surfaces."""
        refuse_unread(self.tree, self.path)
        nodes = self.tree.get("nodes", [])
        with np.errstate(all="ignore"):  # what is not finite is refused
            self._visit_all(self._roots())
        if not self.faces:
            detail = "; ".join(self._notes())
            raise InputError(
                f"{self.path}: no triangles in any of {count_of(len(nodes), 'node')}"
                f"{f' ({detail})' if detail else ''}."
            )
        faces = np.concatenate(self.faces)
        notes = self._notes() + extension_notes(self.tree, self.meshes, self._accessor)
        return ParsedFile(
            np.concatenate(self.positions),
            faces,
            np.concatenate([[0], np.cumsum(self.face_counts)]).astype(np.int64),
            np.arange(len(faces), dtype=np.uint32),
            tuple(self.names),
            no_findings(),
            ("y up was turned to z up: (x, y, z) -> (x, -z, y)", *notes),
            tuple(self.buffers[i] for i in sorted(self.beside)),
        )

    def _roots(self) -> list[int]:
        """Return the nodes that the scene starts from; without a scene, all that have no parent."""
        scenes = self.tree.get("scenes", [])
        default = _natural(self.tree.get("scene", 0))
        if default >= len(scenes) and "scene" in self.tree:
            raise InputError(
                f"{self.path}: it starts from scene {shown(default)}, but has "
                f"{count_of(len(scenes), 'scene')}, counted from 0."
            )
        if scenes:
            if len(scenes) > 1:
                self.left_out["scene that is not the default one"] += len(scenes) - 1
            return list(scenes[default].get("nodes", []))
        nodes = self.tree.get("nodes", [])
        children = {child for node in nodes for child in node.get("children", [])}
        return [i for i in range(len(nodes)) if i not in children]

    def _notes(self) -> list[str]:
        return [f"{count_of(n, kind)} left out" for kind, n in self.left_out.items()]

    def _visit_all(self, roots: list[int]) -> None:
        """Gather the nodes below `roots`, parents first; they must form a forest."""
        nodes = self.tree.get("nodes", [])
        visited: set[int] = set()
        stack = [(root, np.eye(4)) for root in reversed(roots)]
        while stack:
            index, world = stack.pop()
            if index in visited:
                raise InputError(
                    f"{self.path}: node {index} is reached twice; a node may have one parent and "
                    "stand in a scene once."
                )
            node = nodes[_natural(index)]
            visited.add(index)
            if not _PLACING.isdisjoint(node):
                world = world @ _local_matrix(node)
                if not np.isfinite(world).all():
                    raise InputError(
                        f"{self.path}: node {index} is placed by a transform that is not finite."
                    )
            if "mesh" in node:
                self._add_object(node, index, world)
            stack.extend((child, world) for child in reversed(node.get("children", [])))
        if not self.tree.get("scenes") and len(visited) < len(nodes):
            index = next(i for i in range(len(nodes)) if i not in visited)
            raise InputError(f"{self.path}: node {index} is, or lies below, its own parent.")

    def _add_object(self, node: dict[str, Any], index: int, world: F64) -> None:
        """Gather the surfaces of one node's mesh."""
        mesh = self.tree["meshes"][_natural(node["mesh"])]
        name = encodable(str(node.get("name") or mesh.get("name") or f"node_{index}"))
        n_faces = 0
        for number, primitive in enumerate(mesh["primitives"]):
            what = f'object "{shown(name)}", primitive {number}'
            mode = primitive.get("mode", _TRIANGLES)
            if mode not in (_TRIANGLES, _STRIP, _FAN):
                self.left_out["point set" if mode == 0 else "line set"] += 1
                continue
            position = primitive["attributes"]["POSITION"]
            if self._described(position)["type"] != "VEC3":
                raise InputError(f"{self.path}: {what}: its positions are not VEC3.")
            points = self._accessor(position).astype(np.float64)
            refuse_non_finite(points, self.path, what)
            if "indices" in primitive:
                self._refuse_no_indices(primitive["indices"], what)
                corners = self._accessor(primitive["indices"]).reshape(-1).astype(np.int64)
            else:
                corners = np.arange(len(points))
            is_bad = corners >= len(points)
            if is_bad.any():
                raise InputError(
                    f"{self.path}: {what}: {count_of(int(is_bad.sum()), 'index', 'indices')} "
                    f"past the end (first {first_few(corners[is_bad])}), but it has only "
                    f"{count_of(len(points), 'vertex', 'vertices')}."
                )
            if len(points) > 2 * corners.size:  # primitives may share one large accessor
                used, corners = np.unique(corners, return_inverse=True)
                points = points[used]
            triangles = self._triangles(corners, mode)
            if len(triangles) == 0:
                continue
            points = points @ world[:3, :3].T + world[:3, 3]
            refuse_non_finite(points, self.path, f"{what}, placed by its nodes")
            points = points @ _Z_UP_FROM_Y_UP.T
            if np.linalg.slogdet(world[:3, :3])[0] < 0:
                triangles = triangles[:, ::-1]
            self.faces.append((triangles + self.n_vertices).astype(np.uint32))
            self.positions.append(points)
            self.n_vertices += len(points)
            n_faces += len(triangles)
        if n_faces:
            self.meshes.add(node["mesh"])
            self.names.append(name)
            self.face_counts.append(n_faces)
        if "skin" in node:
            self.left_out["skin (its mesh is read unposed)"] += 1

    def _triangles(self, corners: I64, mode: int) -> I64:
        """Return the triangles of a list, strip or fan."""
        if mode == _TRIANGLES:
            if corners.size % 3:
                self.left_out["index behind the last whole triangle"] += corners.size % 3
            return corners[: corners.size // 3 * 3].reshape(-1, 3)
        n = max(corners.size - 2, 0)
        first = np.arange(n)
        if mode == _FAN:
            return np.stack([corners[first * 0], corners[first + 1], corners[first + 2]], axis=1)
        odd = first % 2
        return np.stack([corners[first + odd], corners[first + 1 - odd], corners[first + 2]], 1)

    def _described(self, index: int) -> dict[str, Any]:
        """Return what the JSON says of an accessor."""
        accessor: dict[str, Any] = self.tree["accessors"][_natural(index)]
        return accessor

    def _refuse_no_indices(self, index: int, what: str) -> None:
        """Raise `InputError` for values that another type would turn into other vertices."""
        accessor = self._described(index)
        kind, component = accessor["type"], accessor["componentType"]
        if kind != "SCALAR" or component not in _INDEX_TYPES or accessor.get("normalized"):
            raise InputError(
                f"{self.path}: {what}: accessor {index} holds no indices: its type is "
                f"{shown(kind)} of componentType {shown(component)}, but indices are SCALAR of "
                "5121, 5123 or 5125, not normalized."
            )

    def _accessor(self, index: int) -> NDArray[np.generic]:
        """Return the values of an accessor, ``(count, width)``."""
        accessor = self._described(index)
        if "sparse" in accessor:
            raise InputError(
                f"{self.path}: accessor {index} is sparse, which is not read; export it dense."
            )
        dtype = np.dtype(_DTYPES[accessor["componentType"]])
        width, count = _WIDTHS[accessor["type"]], _natural(accessor["count"])
        if "bufferView" not in accessor:
            raise InputError(f"{self.path}: accessor {index} has no bufferView, so no values.")
        view = self.tree["bufferViews"][_natural(accessor["bufferView"])]
        buffer = self._buffer(_natural(view["buffer"]))
        view_start = _natural(view.get("byteOffset", 0))
        start = view_start + _natural(accessor.get("byteOffset", 0))
        row = dtype.itemsize * width
        stride = _natural(view.get("byteStride", row))
        end = start + (count - 1) * stride + row if count else start
        if end > min(len(buffer), view_start + _natural(view["byteLength"])) or stride < row:
            raise InputError(
                f"{self.path}: accessor {index} reads past the end of its buffer "
                "(the file is damaged or cut off)."
            )
        values = np.ndarray((count, width), dtype, buffer, start, (stride, dtype.itemsize))
        if accessor.get("normalized") and dtype.kind in "iu":
            return np.maximum(values / float(np.iinfo(dtype).max), -1.0)
        return values

    def _buffer(self, index: int) -> bytes:
        """Return a buffer: the binary chunk, data in the JSON, or a file beside it."""
        if index not in self.buffers:
            uri = self.tree["buffers"][index].get("uri")
            if uri is None:
                if self.binary is None:
                    raise InputError(f"{self.path}: buffer {index} has neither data nor a file.")
                self.buffers[index] = self.binary
            elif uri.startswith("data:"):
                try:
                    self.buffers[index] = base64.b64decode(uri.partition(",")[2], validate=True)
                except binascii.Error:
                    raise InputError(f"{self.path}: buffer {index} is not base64.") from None
            elif "://" in uri:
                raise InputError(
                    f"{self.path}: buffer {index} lies at {shown(uri)}; download it first."
                )
            else:
                beside = self.path.parent / unquote(uri)
                try:
                    if is_device(beside.stat()):
                        raise InputError(
                            f"{self.path}: its buffer {shown(beside)} is a device, not a file."
                        )
                    self.buffers[index] = beside.read_bytes()
                    self.beside.add(index)
                except OSError as error:
                    raise InputError(
                        f"{self.path}: its buffer {shown(beside)} cannot be read: {error.strerror}."
                    ) from None
        return self.buffers[index]


def _natural(value: object) -> int:
    """Return an index or a size; a negative one would count from the end."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"{value!r} is not an index")
    return value


def _local_matrix(node: dict[str, Any]) -> F64:
    """Return a node's parent-from-local matrix."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    if "rotation" in node:
        x, y, z, w = np.array(node["rotation"], np.float64) / np.linalg.norm(node["rotation"])
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    if "scale" in node:
        matrix[:3, :3] *= np.array(node["scale"], np.float64)
    if "translation" in node:
        matrix[:3, 3] = node["translation"]
    return matrix
