"""What lies in a glTF file: its JSON, its buffers, and the values of its accessors.

Every offset, count and type is checked against the bytes that are there before anything
is read or reserved.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from svprep.errors import InputError
from svprep.ingest.file_bytes import is_device
from svprep.ingest.parsed import shown

Locate = Callable[[str], Path]
"""Returns the file that a URI names; raises `InputError` for one that may not be read."""

_JSON_CHUNK: Final = 0x4E4F534A
_BIN_CHUNK: Final = 0x004E4942
_DTYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
INDEX_TYPES: Final = (5121, 5123, 5125)
# Bytes of a sparse accessor that has no values of its own.
_ALWAYS_ZEROS: Final = 1 << 20
_MOST_ZEROS_PER_BYTE: Final = 4  # and as many more for every byte of the file


def split(text: bytes | memoryview, path: Path) -> tuple[dict[str, Any], bytes | memoryview | None]:
    """Return the JSON of a ``.gltf`` or ``.glb`` file and, of the latter, the binary chunk."""
    binary: bytes | memoryview | None = None
    if bytes(text[:4]) == b"glTF":
        if len(text) < 20:
            raise InputError(f"{path}: the GLB file is cut off ({len(text)} bytes).")
        version, length = struct.unpack_from("<II", text, 4)
        if version != 2:
            raise InputError(f"{path}: glTF version {version}; version 2 is read.")
        if length > len(text):
            raise InputError(
                f"{path}: the GLB file is cut off: it announces {length} bytes and has {len(text)}."
            )
        chunks: dict[int, bytes | memoryview] = {}
        pos = 12
        while pos + 8 <= length:
            size, kind = struct.unpack_from("<II", text, pos)
            chunks.setdefault(kind, text[pos + 8 : pos + 8 + size])
            pos += 8 + size
        text, binary = chunks.get(_JSON_CHUNK, b""), chunks.get(_BIN_CHUNK)
    try:
        tree = json.loads(bytes(text).decode("utf-8-sig"))
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


def natural(value: object) -> int:
    """Return an index or a size; a negative one would count from the end."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"{shown(repr(value))} is not an index")
    return value


class Buffers:
    """The binary part of one file."""

    def __init__(
        self,
        tree: dict[str, Any],
        binary: bytes | memoryview | None,
        path: Path,
        locate: Locate | None = None,
        n_bytes: int = 0,
    ) -> None:
        self.tree = tree
        self.path = path
        self._binary = binary
        self._n_bytes = n_bytes  # of the file itself
        self._locate = locate or (lambda uri: path.parent / unquote(uri))
        self._buffers: dict[int, bytes | memoryview] = {}
        self._beside: set[int] = set()  # buffers that are files of their own

    @property
    def beside(self) -> tuple[bytes, ...]:
        """What was read from files beside this one."""
        return tuple(bytes(self._buffers[i]) for i in sorted(self._beside))

    @property
    def n_bytes(self) -> int:
        """How much was read so far, of this file and of those beside it."""
        return self._n_bytes + sum(len(self._buffers[i]) for i in self._beside)

    def described(self, index: int) -> dict[str, Any]:
        """Return what the JSON says of an accessor."""
        accessor: dict[str, Any] = self.tree["accessors"][natural(index)]
        return accessor

    def accessor(self, index: int) -> NDArray[np.generic]:
        """Return the values of an accessor, ``(count, width)``."""
        accessor = self.described(index)
        dtype = np.dtype(_DTYPES[accessor["componentType"]])
        width, count = _WIDTHS[accessor["type"]], natural(accessor["count"])
        what = f"accessor {index}"
        if "bufferView" in accessor:
            values = self._values(accessor, dtype, width, count, what)
        elif "sparse" not in accessor:
            raise InputError(f"{self.path}: {what} has no bufferView, so no values.")
        elif count * width * dtype.itemsize > _ALWAYS_ZEROS + _MOST_ZEROS_PER_BYTE * self.n_bytes:
            raise InputError(
                f"{self.path}: {what} is sparse and announces {count} rows of zeros, but the file "
                f"has {self.n_bytes} bytes; it is damaged, or a bomb."
            )
        else:
            values = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            values = self._with_sparse(values, accessor["sparse"], what)
        if accessor.get("normalized") and dtype.kind in "iu":
            return np.maximum(values.astype(np.float64) / np.iinfo(dtype).max, -1.0)
        return values

    def _values(
        self, place: dict[str, Any], dtype: np.dtype[Any], width: int, count: int, what: str
    ) -> NDArray[np.generic]:
        """Return `count` rows from where `place` says they are."""
        view = self.tree["bufferViews"][natural(place["bufferView"])]
        buffer = self.buffer(natural(view["buffer"]))
        view_start = natural(view.get("byteOffset", 0))
        start = view_start + natural(place.get("byteOffset", 0))
        row = dtype.itemsize * width
        stride = natural(view.get("byteStride", row))
        end = start + (count - 1) * stride + row if count else start
        if end > min(len(buffer), view_start + natural(view["byteLength"])) or stride < row:
            raise InputError(
                f"{self.path}: {what} reads past the end of its buffer "
                "(the file is damaged or cut off)."
            )
        return np.ndarray((count, width), dtype, buffer, start, (stride, dtype.itemsize))

    def _with_sparse(
        self, values: NDArray[np.generic], sparse: dict[str, Any], what: str
    ) -> NDArray[np.generic]:
        """Return a copy of `values` with the rows replaced that `sparse` lists."""
        count = natural(sparse["count"])
        kind = sparse["indices"]["componentType"]
        if kind not in INDEX_TYPES:
            raise InputError(f"{self.path}: {what}: its sparse indices are of type {shown(kind)}.")
        rows = self._values(sparse["indices"], np.dtype(_DTYPES[kind]), 1, count, what).ravel()
        if count and int(rows.max()) >= len(values):
            raise InputError(
                f"{self.path}: {what} is sparse and replaces row {int(rows.max())}, but has "
                f"{len(values)}."
            )
        values = values.copy()
        values[rows] = self._values(
            sparse["values"], values.dtype, values.shape[1], count, f"{what} (sparse)"
        )
        return values

    def view(self, index: int) -> memoryview:
        """Return the bytes of a bufferView."""
        view = self.tree["bufferViews"][natural(index)]
        buffer = self.buffer(natural(view["buffer"]))
        start = natural(view.get("byteOffset", 0))
        end = start + natural(view["byteLength"])
        if end > len(buffer):
            raise InputError(
                f"{self.path}: bufferView {index} ends past the end of its buffer "
                "(the file is damaged or cut off)."
            )
        return memoryview(buffer)[start:end]

    def buffer(self, index: int) -> bytes | memoryview:
        """Return a buffer: the binary chunk, data in the JSON, or a file beside it."""
        if index not in self._buffers:
            uri = self.tree["buffers"][index].get("uri")
            if uri is None:
                if self._binary is None:
                    raise InputError(f"{self.path}: buffer {index} has neither data nor a file.")
                self._buffers[index] = self._binary
            elif uri.startswith("data:"):
                try:
                    self._buffers[index] = base64.b64decode(uri.partition(",")[2], validate=True)
                except binascii.Error:
                    raise InputError(f"{self.path}: buffer {index} is not base64.") from None
            elif "://" in uri:
                raise InputError(
                    f"{self.path}: buffer {index} lies at {shown(uri)}; download it first."
                )
            else:
                self._buffers[index] = self._read_beside(uri)
                self._beside.add(index)
        return self._buffers[index]

    def _read_beside(self, uri: str) -> bytes:
        """Return a buffer that is a file of its own."""
        beside = self._locate(uri)
        try:
            if is_device(beside.stat()):
                raise InputError(
                    f"{self.path}: its buffer {shown(beside)} is a device, not a file."
                )
            return beside.read_bytes()
        except OSError as error:
            raise InputError(
                f"{self.path}: its buffer {shown(beside)} cannot be read: {error.strerror}."
            ) from None
