"""Binary PLY, decoded here: the decoder in trimesh takes all faces for as large as the first.

Rows whose lists are all as long as those of the first row are one NumPy view. Others are
walked one by one, since where a row begins depends on all rows before it.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from svprep.errors import InputError
from svprep.model import F64, I64

_FORMAT: Final = re.compile(rb"ply\s.*?^format\s+binary_(little|big)_endian\s", re.M | re.S)
_END: Final = re.compile(rb"^end_header[ \t]*(\r\n|\n|\r)", re.M)
_CODES: Final = {
    **dict.fromkeys(("char", "int8"), "b"),
    **dict.fromkeys(("uchar", "uint8"), "B"),
    **dict.fromkeys(("short", "int16"), "h"),
    **dict.fromkeys(("ushort", "uint16"), "H"),
    **dict.fromkeys(("int", "int32"), "i"),
    **dict.fromkeys(("uint", "uint32"), "I"),
    **dict.fromkeys(("float", "float32"), "f"),
    **dict.fromkeys(("double", "float64"), "d"),
    "float16": "e",
    "int64": "q",
    "uint64": "Q",
}
_RING_NAMES: Final = ("vertex_indices", "vertex_index")


class PlyFaces(NamedTuple):
    """Vertices and polygons of a PLY file, unchecked."""

    positions: F64
    """``(n_vertices, 3)``"""
    corners: NDArray[Any]
    """``(n_corners,)``, in the file's type."""
    sizes: I64
    """``(n_faces,)``"""
    values: dict[str, NDArray[Any]]
    """``(n_faces,)`` each: the single values that faces have, by name; none where the rows
    of faces differ in length."""


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    dtype: np.dtype[Any]
    count: struct.Struct | None
    """Reads the length of a list; None for a single value."""


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    n_rows: int
    properties: list[_Property]


def is_binary(text: bytes) -> bool:
    """Return whether this is a binary PLY file, going by its header."""
    end = _END.search(text)
    return bool(end and _FORMAT.match(text, 0, end.start()))


def element_counts(text: bytes, path: Path) -> dict[str, int]:
    """Return how many rows of each element the header announces."""
    return {element.name: element.n_rows for element in _header(text, path)[0]}


def decode(text: bytes, path: Path) -> PlyFaces:
    """Decode the vertices and faces of a binary PLY file that announces some of both.

    Raises
    ------
    InputError
        For a damaged header or data that end too early.
    """
    elements, pos = _header(text, path)
    found: dict[str, Any] = {}
    for element in elements:
        if element.name == "vertex":
            rows = _uniform_rows(text, pos, element)
            if rows is None:
                raise _damaged(path, "vertices end too early or hold lists of different lengths")
            columns = {p.name: rows[f"{i}"] for i, p in enumerate(element.properties)}
            if any(axis not in columns or columns[axis].ndim != 1 for axis in "xyz"):
                raise _damaged(path, "a vertex has no x, y and z")
            found["vertex"] = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], 1)
            pos += rows.nbytes
        elif element.name == "face":
            found["face"], pos = _faces(text, pos, element, path)
        else:
            rows = _uniform_rows(text, pos, element)
            if rows is not None:
                pos += rows.nbytes
            elif not {"vertex", "face"} <= found.keys():
                pos = _walk(text, pos, element, -1, path)[2]
    return PlyFaces(found["vertex"], *found["face"])


def comments(text: bytes) -> list[str]:
    """Return the comments of the header."""
    end = _END.search(text)
    lines = text[: end.start()].decode(errors="replace").splitlines() if end else []
    return [line.removeprefix("comment ") for line in lines if line.startswith("comment ")]


def _damaged(path: Path, problem: str) -> InputError:
    return InputError(f"{path}: damaged or cut off: {problem} in this binary PLY file.")


def _header(text: bytes, path: Path) -> tuple[list[_Element], int]:
    """Return the elements that the header lists and where the data begin."""
    end = _END.search(text)
    order = _FORMAT.match(text)
    if not end or not order:
        raise _damaged(path, "no header")
    sign = "<" if order[1] == b"little" else ">"
    elements: list[_Element] = []
    for line in text[: end.start()].splitlines():
        words = line.decode("latin-1").split()
        try:
            if words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2]), []))
                if elements[-1].n_rows < 0:
                    raise ValueError
            elif words[:2] == ["property", "list"]:
                count = struct.Struct(sign + _CODES[words[2]])
                if _CODES[words[2]] in "efd":
                    raise ValueError
                dtype = np.dtype(sign + _CODES[words[3]])
                elements[-1].properties.append(_Property(words[4], dtype, count))
            elif words[:1] == ["property"]:
                dtype = np.dtype(sign + _CODES[words[1]])
                elements[-1].properties.append(_Property(words[2], dtype, None))
        except (KeyError, IndexError, ValueError):
            raise _damaged(path, f'the header line "{" ".join(words)[:60]}"') from None
    names = [element.name for element in elements]
    if len(set(names)) < len(names):
        raise _damaged(path, "an element that the header lists twice")
    return elements, end.end()


def _uniform_rows(text: bytes, pos: int, element: _Element) -> NDArray[Any] | None:
    """Return the rows of an element if its lists have one length, else None.

    Field ``"i"`` is property i; ``"i count"`` the length of its list.
    """
    fields: list[Any] = []
    first = pos
    for i, prop in enumerate(element.properties):
        if prop.count is None or element.n_rows == 0:
            fields.append((f"{i}", prop.dtype))
            first += prop.dtype.itemsize
            continue
        if first + prop.count.size > len(text):
            return None
        (n,) = prop.count.unpack_from(text, first)
        first += prop.count.size + n * prop.dtype.itemsize
        if n < 0 or first > len(text):
            return None
        fields += [(f"{i} count", prop.count.format), (f"{i}", prop.dtype, (n,))]
    dtype = np.dtype(fields)
    if pos + element.n_rows * dtype.itemsize > len(text):
        return None
    if dtype.itemsize == 0 or element.n_rows == 0:
        return np.empty(0, dtype)
    rows = np.frombuffer(text, dtype, element.n_rows, pos)
    counts = [rows[name] for name in dtype.names or () if name.endswith("count")]
    return rows if all((count == count[0]).all() for count in counts) else None


def _faces(
    text: bytes, pos: int, element: _Element, path: Path
) -> tuple[tuple[NDArray[Any], I64, dict[str, NDArray[Any]]], int]:
    """Return corners, sizes and single values of all faces, and the byte behind them."""
    lists = [i for i, prop in enumerate(element.properties) if prop.count is not None]
    named = [i for i in lists if element.properties[i].name in _RING_NAMES]
    if not lists:
        raise _damaged(path, "faces without a list of vertices")
    ring = (named or lists)[0]
    rows = _uniform_rows(text, pos, element)
    if rows is not None:
        corners = rows[f"{ring}"]
        sizes = np.full(len(rows), corners.shape[1], np.int64)
        values = {p.name: rows[f"{i}"] for i, p in enumerate(element.properties) if not p.count}
        return (corners.reshape(-1), sizes, values), pos + rows.nbytes
    begins, sizes, end = _walk(text, pos, element, ring, path)
    dtype = element.properties[ring].dtype
    within = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    at = np.repeat(begins, sizes) + within * dtype.itemsize
    data = np.frombuffer(text, np.uint8)
    corners = data[at[:, None] + np.arange(dtype.itemsize)].view(dtype).reshape(-1)
    return (corners, sizes, {}), end


def _walk(
    text: bytes, pos: int, element: _Element, wanted: int, path: Path
) -> tuple[I64, I64, int]:
    """Walk through rows with lists of any lengths.

    Returns
    -------
    begins, sizes : (n_rows,) int64
        First byte and length of the list of property `wanted`.
    end : int
        The byte behind the last row.
    """
    begins: list[int] = []
    sizes: list[int] = []
    steps = [
        (prop.count, prop.dtype.itemsize, i == wanted) for i, prop in enumerate(element.properties)
    ]
    for row in range(element.n_rows):
        for count, itemsize, is_wanted in steps:
            n = 1
            if count is not None:
                if pos + count.size > len(text):
                    break
                (n,) = count.unpack_from(text, pos)
                pos += count.size
            if is_wanted:
                begins.append(pos)
                sizes.append(n)
            if n < 0:
                raise _damaged(path, f"a list of length {n} in {element.name} {row}")
            pos += n * itemsize
        else:
            if pos <= len(text):
                continue
        raise _damaged(
            path, f"{element.n_rows} {element.name} rows announced, {row} whole ones found"
        )
    return np.array(begins, np.int64), np.array(sizes, np.int64), pos
