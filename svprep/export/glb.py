"""GLB: a node and a mesh per object, named by its id, below a node that places them all.

Positions are float32 from the grid's origin, which is the root node's translation (numbers
of JSON are float64): exact together. glTF has y up: ``(x, z, -y)``. Type and parent of an
object stand in the extras of its node, the CRS and the sources in those of the asset. An
object without faces is a node without a mesh. Faces are in the order of the cache: each run
of faces of one surface is a primitive, and its extras name the surface.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Final

import numpy as np

from svprep.export.city import City
from svprep.model import I64, U32

_GENERATOR: Final = "svprep export"
HEAD: Final = f'{{"asset":{{"generator":"{_GENERATOR}"'.encode()
"""What the JSON begins with, 20 bytes behind the start of the file."""
JSON_AT: Final = 20
_JSON_CHUNK, _BIN_CHUNK = 0x4E4F534A, 0x004E4942
_FLOAT, _USHORT, _UINT = 5126, 5123, 5125
_VERTICES, _INDICES = 34962, 34963
_MOST_SHORT: Final = 65535
"""Vertices that uint16 numbers: the highest number stands for something else in OpenGL."""


def glb_parts(city: City) -> Iterator[bytes]:
    """Yield the file. O(n)."""
    points = np.ascontiguousarray(city.positions[:, [0, 2, 1]], "<f4")
    points[:, 2] *= np.float32(-1.0)
    points += np.float32(0.0)  # -0.0 becomes 0.0
    vertex_count = np.diff(city.object_vertex_start)
    is_short = vertex_count <= _MOST_SHORT
    face_count = np.diff(city.object_face_start)
    local = city.faces - np.repeat(city.object_vertex_start[:-1], face_count)[:, None]
    is_in_short = np.repeat(is_short, face_count)
    shorts = local[is_in_short].astype("<u2").tobytes()
    longs = local[~is_in_short].astype("<u4").tobytes()
    sections = [points.tobytes(), _padded(shorts, b"\0"), longs]
    tree = _tree(city, points, is_short, [len(section) for section in sections])
    text = _padded(json.dumps(tree, separators=(",", ":")).encode(), b" ")
    n_binary = sum(len(section) for section in sections)
    total = 12 + 8 + len(text) + 8 + n_binary
    if total >= 1 << 32:
        raise _too_large(total)
    yield struct.pack("<4sIIII", b"glTF", 2, total, len(text), _JSON_CHUNK) + text
    yield struct.pack("<II", n_binary, _BIN_CHUNK)
    yield from sections


def _too_large(total: int) -> Exception:
    from svprep.errors import InputError

    return InputError(
        f"a GLB file holds 4 GiB, this city takes {total >> 20} MiB; export it as .ply instead"
    )


def _padded(data: bytes, filler: bytes) -> bytes:
    """Return bytes filled up to a multiple of four."""
    return data + filler * (-len(data) % 4)


def _tree(city: City, points: Any, is_short: Any, sizes: list[int]) -> dict[str, Any]:
    """Return the JSON of the file."""
    x, y, z = city.grid.origin_m.tolist()
    root = {"name": "city", "translation": [x, z, 0.0 - y]}
    nodes: list[dict[str, Any]] = [root]
    meshes: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    index_at = [0, 0]  # the next byte of the two views of indices
    low, high = _bounds(points, city.object_vertex_start)
    vertex_start = city.object_vertex_start.tolist()
    run_start = _runs(city)
    run_of = np.searchsorted(run_start, city.object_face_start).tolist()
    for i, name in enumerate(city.names):
        node: dict[str, Any] = {"name": name}
        extras = {"type": city.types[i], "parent": city.parents[i]}
        if stated := {key: text for key, text in extras.items() if text}:
            node["extras"] = stated
        runs = run_start[run_of[i] : run_of[i + 1] + 1].tolist()
        if len(runs) > 1:
            node["mesh"] = len(meshes)
            accessor = _accessor(
                0, 12 * vertex_start[i], _FLOAT, vertex_start[i + 1] - vertex_start[i]
            )
            accessor |= {"type": "VEC3", "min": low[i].tolist(), "max": high[i].tolist()}
            primitives = _primitives(city, runs, bool(is_short[i]), accessor, accessors, index_at)
            meshes.append({"name": name, "primitives": primitives})
        nodes.append(node)
    root["children"] = list(range(1, len(nodes)))
    if not sizes[1]:  # no view may be empty: the one of uint32 is then the second
        for accessor in accessors:
            accessor["bufferView"] = min(accessor["bufferView"], 1)
    return {
        "asset": {"generator": _GENERATOR, "version": "2.0", "extras": _extras(city)},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": meshes,
        "accessors": accessors,
        "bufferViews": _views(sizes),
        "buffers": [{"byteLength": sum(sizes)}],
    }


def _primitives(
    city: City,
    runs: list[int],
    is_short: bool,
    positions: dict[str, Any],
    accessors: list[dict[str, Any]],
    index_at: list[int],
) -> list[dict[str, Any]]:
    """Return a primitive per run of faces; `accessors` and `index_at` go on accordingly."""
    first = len(accessors)
    accessors.append(positions)
    view = 0 if is_short else 1
    kind, width = (_USHORT, 2) if is_short else (_UINT, 4)
    primitives = []
    for begin, end in pairwise(runs):
        primitive: dict[str, Any] = {"attributes": {"POSITION": first}, "indices": len(accessors)}
        if surface := int(city.surface_of_face[begin]):
            primitive["extras"] = {"surface": city.surface_names[surface]}
        primitives.append(primitive)
        n_corners = 3 * (end - begin)
        accessors.append(_accessor(view + 1, index_at[view], kind, n_corners) | {"type": "SCALAR"})
        index_at[view] += n_corners * width
    return primitives


def _accessor(view: int, at: int, component: int, count: Any) -> dict[str, Any]:
    return {
        "bufferView": view,
        "byteOffset": at,
        "componentType": component,
        "count": int(count),
    }


def _runs(city: City) -> I64:
    """Return where runs of faces of one object and one surface start, and where the last ends."""
    is_start = np.ones(len(city.faces) + 1, bool)
    is_start[1:-1] = city.surface_of_face[1:] != city.surface_of_face[:-1]
    is_start[city.object_face_start] = True
    return np.flatnonzero(is_start)


def _extras(city: City) -> dict[str, Any]:
    """Return what the whole file is told of itself."""
    sources = [{"path": s.path, "sha256": s.sha256} for s in city.sources]
    return {"crs": city.crs, "digest": city.digest, "sources": sources}


def _views(sizes: list[int]) -> list[dict[str, Any]]:
    """Return the views of the buffer: positions, then indices of two and of four bytes."""
    views = []
    at = 0
    for number, size in enumerate(sizes):
        if size:
            view = {"buffer": 0, "byteOffset": at, "byteLength": size}
            view["target"] = _INDICES if number else _VERTICES
            views.append(view)
        at += size
    return views


def _bounds(points: Any, start: Any) -> tuple[Any, Any]:
    """Return the lowest and highest corner of each object's vertices."""
    empty = start[:-1] == start[1:]
    low = np.zeros((len(empty), 3), np.float32)
    high = np.zeros((len(empty), 3), np.float32)
    begin: U32 = start[:-1][~empty]
    if len(begin):
        low[~empty] = np.minimum.reduceat(points, begin, axis=0)
        high[~empty] = np.maximum.reduceat(points, begin, axis=0)
    return low, high
