"""Small glTF, b3dm and 3D Tiles files, made byte by byte."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
TWO_TRIANGLES = (0, 1, 2, 0, 2, 3)
COMPONENT = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPE = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class Glb:
    """A GLB file while it is made."""

    def __init__(self) -> None:
        self.blob = b""
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
            "buffers": [{}],
        }

    def view(self, data: bytes) -> int:
        """Add a bufferView."""
        self.blob += b"\0" * (-len(self.blob) % 8)
        self.tree["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)}
        )
        self.blob += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, values: Any, kind: str = "f4", **more: Any) -> int:
        """Add an accessor."""
        array = np.array(values, f"<{kind}")
        self.tree["accessors"].append(
            {
                "bufferView": self.view(array.tobytes()),
                "componentType": COMPONENT[kind],
                "count": len(array),
                "type": TYPE[1 if array.ndim == 1 else array.shape[1]],
                **more,
            }
        )
        return len(self.tree["accessors"]) - 1

    def primitive(
        self,
        points: Any = SQUARE,
        indices: Any = TWO_TRIANGLES,
        attributes: dict[str, Any] | None = None,
        **more: Any,
    ) -> dict[str, Any]:
        """Return a primitive; attributes are float32."""
        numbers = {name: self.accessor(v) for name, v in (attributes or {}).items()}
        return {
            "attributes": {"POSITION": self.accessor(points), **numbers},
            "indices": self.accessor(indices, "u2"),
            **more,
        }

    def mesh(self, *primitives: dict[str, Any], **more: Any) -> int:
        """Add a mesh."""
        self.tree["meshes"].append({"name": "M", "primitives": list(primitives), **more})
        return len(self.tree["meshes"]) - 1

    def node(self, **node: Any) -> int:
        """Add a node to the scene."""
        self.tree["nodes"].append(node)
        self.tree["scenes"][0]["nodes"].append(len(self.tree["nodes"]) - 1)
        return len(self.tree["nodes"]) - 1

    def texts(self, values: list[str]) -> dict[str, int]:
        """Add a column of texts; return its place in a property table."""
        parts = [value.encode() for value in values]
        ends = np.cumsum([0, *map(len, parts)])
        return {
            "values": self.view(b"".join(parts)),
            "stringOffsets": self.view(ends.astype("<u4").tobytes()),
        }

    def table(self, count: int, columns: dict[str, tuple[dict, dict]], **schema: Any) -> None:
        """Add a property table: of each property what it is, and where."""
        found = self.tree.setdefault("extensions", {}).setdefault(
            "EXT_structural_metadata", {"schema": {"classes": {}, **schema}, "propertyTables": []}
        )
        name = f"class_{len(found['propertyTables'])}"
        found["schema"]["classes"][name] = {"properties": {k: c[0] for k, c in columns.items()}}
        places = {k: c[1] for k, c in columns.items()}
        found["propertyTables"].append({"class": name, "count": count, "properties": places})

    def bytes(self) -> bytes:
        """Return the file."""
        self.tree["buffers"] = [{"byteLength": len(self.blob)}]
        text = json.dumps(self.tree).encode()
        text += b" " * (-len(text) % 4)
        blob = self.blob + b"\0" * (-len(self.blob) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(blob), 0x004E4942) + blob
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks

    def write(self, path: Path) -> Path:
        """Write the file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(self.bytes())
        return path


def mesh_features(**entry: Any) -> dict[str, Any]:
    """Return a primitive's extension with one set of feature ids."""
    return {"EXT_mesh_features": {"featureIds": [entry]}}


def square_glb(name: str = "square", at: Any = (0, 0, 0), **attributes: Any) -> Glb:
    """Return a file of one node: a square of two triangles."""
    glb = Glb()
    mesh = glb.mesh(glb.primitive(attributes=attributes))
    glb.node(mesh=mesh, name=name, translation=list(at))
    return glb


def b3dm(
    glb: bytes,
    feature_table: dict[str, Any] | None = None,
    batch_table: dict[str, Any] | None = None,
    feature_binary: bytes = b"",
    batch_binary: bytes = b"",
) -> bytes:
    """Return a ``.b3dm`` file."""
    tables = []
    for tree in (feature_table or {"BATCH_LENGTH": 0}, batch_table):
        text = json.dumps(tree).encode() if tree else b""
        tables.append(text + b" " * (-len(text) % 8))
    parts = [tables[0], feature_binary, tables[1], batch_binary]
    length = 28 + sum(map(len, parts)) + len(glb)
    return b"b3dm" + struct.pack("<6I", 1, length, *map(len, parts)) + b"".join(parts) + glb


def cmpt(*tiles: bytes) -> bytes:
    """Return a composite tile."""
    body = b"".join(tiles)
    return b"cmpt" + struct.pack("<3I", 1, 16 + len(body), len(tiles)) + body


def tile(uri: str = "", children: Any = (), **more: Any) -> dict[str, Any]:
    """Return a tile's JSON."""
    tree = {"boundingVolume": {"sphere": [0, 0, 0, 9]}, "geometricError": 0, **more}
    if uri:
        tree["content"] = {"uri": uri}
    if children:
        tree["children"] = list(children)
    return tree


def write_tileset(path: Path, root: dict[str, Any], **more: Any) -> Path:
    """Write a tileset."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"asset": {"version": "1.1"}, "root": root, **more}))
    return path


def subtree(
    tiles: Any, contents: Any, children: Any = 0, is_binary: bool = True, n_cut: int = 0
) -> bytes:
    """Return a subtree file; each availability is a constant or a list of bits."""
    blob, views, tree = b"", [], {}
    for name, bits in (
        ("tileAvailability", tiles),
        ("contentAvailability", contents),
        ("childSubtreeAvailability", children),
    ):
        if isinstance(bits, int):
            stated: dict[str, int] = {"constant": bits}
        else:
            packed = np.packbits(np.array(bits, np.uint8), bitorder="little").tobytes()
            views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(packed)})
            blob += packed + b"\0" * (-len(packed) % 8)
            stated = {"bitstream": len(views) - 1}
        tree[name] = [stated] if name == "contentAvailability" else stated
    tree["buffers"], tree["bufferViews"] = [{"byteLength": len(blob)}], views
    if not is_binary:
        return json.dumps(tree).encode()
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 8)
    data = b"subt" + struct.pack("<IQQ", 1, len(text), len(blob)) + text + blob
    return data[: len(data) - n_cut]
