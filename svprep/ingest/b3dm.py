"""The reader of batched 3D models, ``.b3dm``: a GLB, and what its ``_BATCHID`` refers to.

28 bytes    "b3dm", version, length, lengths of the four parts below
feature table   JSON, binary    BATCH_LENGTH; RTC_CENTER, added once z is up
batch table     JSON, binary    properties of each feature
GLB
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from svprep.errors import InputError
from svprep.ingest.gltf import DAMAGED, alone, read_content
from svprep.ingest.gltf_buffers import Locate, natural
from svprep.ingest.gltf_frame import shifted
from svprep.ingest.gltf_properties import Column, FeatureTable, number_text
from svprep.ingest.parsed import ParsedFile, encodable, shown
from svprep.model import F64, U8

_HEADER_BYTES: Final = 28
_COMPONENTS: Final = {
    "BYTE": "<i1",
    "UNSIGNED_BYTE": "<u1",
    "SHORT": "<i2",
    "UNSIGNED_SHORT": "<u2",
    "INT": "<i4",
    "UNSIGNED_INT": "<u4",
    "FLOAT": "<f4",
    "DOUBLE": "<f8",
}


def read_b3dm(data: U8, path: Path, stem: str) -> ParsedFile:
    """Read a ``.b3dm`` file that is an input by itself.

    Parameters
    ----------
    data : (n_bytes + 1,) uint8
        The file and a line feed behind it.

    Raises
    ------
    InputError
        As `svprep.ingest.gltf.read_gltf` does.
    """
    return alone(read_tile(data[:-1].data, path), path)


def read_tile(
    text: bytes | memoryview,
    path: Path,
    *,
    frame: F64 | None = None,
    is_y_up: bool = True,
    locate: Locate | None = None,
) -> ParsedFile:
    """Read a ``.b3dm`` tile; parameters as of `svprep.ingest.gltf.read_content`."""
    try:
        features, batches, start, end = _tables(text, path)
        n_features = natural(features[0].get("BATCH_LENGTH", 0))
        center = _center(*features, path)
        table = FeatureTable(n_features, tuple(_columns(*batches, n_features)))
    except DAMAGED as error:
        detail = shown(f"{type(error).__name__}: {error}")
        raise InputError(f"{path}: the tables of the b3dm file are damaged ({detail}).") from None
    root = shifted(np.eye(4) if frame is None else frame, center)
    return read_content(
        text[start:end], path, frame=root, batch_table=table, is_y_up=is_y_up, locate=locate
    )


_Table = tuple[dict[str, Any], memoryview]


def _tables(text: bytes | memoryview, path: Path) -> tuple[_Table, _Table, int, int]:
    """Return the feature table, the batch table, and where the GLB begins and ends."""
    if bytes(text[:4]) != b"b3dm":
        raise InputError(f'{path}: not a b3dm file: it does not begin with "b3dm".')
    if len(text) < _HEADER_BYTES:
        raise InputError(f"{path}: the b3dm file is cut off ({len(text)} bytes).")
    version, length, *sizes = struct.unpack_from("<6I", text, 4)
    if version != 1:
        raise InputError(f"{path}: b3dm version {version}; version 1 is read.")
    if length > len(text):
        raise InputError(
            f"{path}: the b3dm file is cut off: it announces {length} bytes and has {len(text)}."
        )
    if _HEADER_BYTES + sum(sizes) > length:
        raise InputError(f"{path}: the b3dm file is damaged: its tables end past its end.")
    ends = _HEADER_BYTES + np.cumsum(sizes)
    view = memoryview(text)
    parts = [view[end - size : end] for end, size in zip(ends.tolist(), sizes, strict=True)]
    features, batches = _json(parts[0]), _json(parts[2])
    return (features, parts[1]), (batches, parts[3]), int(ends[-1]), length


def _json(text: memoryview) -> dict[str, Any]:
    """Return the JSON part of a table, which may be empty."""
    stripped = bytes(text).rstrip(b"\0 \r\n\t")
    try:
        tree = json.loads(stripped) if stripped else {}
    except RecursionError:
        raise ValueError("the JSON is nested too deeply") from None
    if not isinstance(tree, dict):
        raise ValueError("a table is no JSON object")
    return tree


def _center(table: dict[str, Any], binary: memoryview, path: Path) -> F64:
    """Return RTC_CENTER, ``(3,)``, or zeros."""
    stated = table.get("RTC_CENTER", [0, 0, 0])
    if isinstance(stated, dict):
        offset = natural(stated["byteOffset"])
        stated = np.frombuffer(binary[offset : offset + 12], "<f4").tolist()
    center = np.array(stated, np.float64)
    if center.shape != (3,) or not np.isfinite(center).all():
        raise InputError(f"{path}: its RTC_CENTER is {shown(stated)}, not three finite numbers.")
    return center


def _columns(table: dict[str, Any], binary: memoryview, n_features: int) -> list[Column]:
    """Return the properties of a batch table that hold one text or number per feature."""
    columns = []
    for name, values in table.items():
        label = encodable(str(name))
        if isinstance(values, list) and len(values) == n_features:
            if all(isinstance(value, str | int | float | None) for value in values):
                is_text = any(isinstance(value, str) for value in values)
                columns.append(Column(label, "", is_text, _listed(values)))
        elif isinstance(values, dict) and values.get("type", "SCALAR") == "SCALAR":
            dtype = _COMPONENTS.get(str(values.get("componentType")))
            if dtype and "byteOffset" in values:
                offset = natural(values["byteOffset"])
                columns.append(Column(label, "", False, _packed(binary, offset, dtype, n_features)))
    return columns


def _listed(values: list[Any]) -> Callable[[], list[str]]:
    return lambda: ["" if v is None else encodable(_text(v)) for v in values]


def _text(value: str | float) -> str:
    return number_text(value) if isinstance(value, float) else str(value)


def _packed(binary: memoryview, offset: int, dtype: str, count: int) -> Callable[[], list[str]]:
    def read() -> list[str]:
        values = np.frombuffer(binary, dtype, count, offset).tolist()
        return [_text(value) for value in values]

    return read
