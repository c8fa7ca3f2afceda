"""The reader of glTF 2.0: ``.gltf`` with its buffers, and ``.glb``.

Our own, because the decoder in trimesh names nodes at random where a mesh has several
primitives, loses what hangs below a camera, skips triangle fans, and reads normalised or
sparse positions as something else without a word. Quantised positions
(KHR_mesh_quantization), instances (EXT_mesh_gpu_instancing) and, with an extra, Draco are
read; of other extensions see `svprep.ingest.gltf_extensions`.

One object per feature where a mesh has feature ids (`svprep.ingest.gltf_features`), else
one per node with a surface and per instance of it, so a mesh that n nodes use gives n
objects. Triangles count in the order of the nodes. y up becomes z up: (x, y, z) ->
(x, -z, y); the center of CESIUM_RTC is added after that. ``extras`` of a node or of its
mesh may state ``type`` and ``parent`` of the object, those of a primitive its ``surface``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from svprep.errors import InputError, first_few
from svprep.ingest.gltf_buffers import INDEX_TYPES, Buffers, Locate, natural, split
from svprep.ingest.gltf_draco import decode_draco, is_draco
from svprep.ingest.gltf_extensions import extension_notes, refuse_unread, rtc_center
from svprep.ingest.gltf_features import BATCH_TABLE, NO_FEATURE, Features, FeatureSet
from svprep.ingest.gltf_frame import Z_UP_FROM_Y_UP, composed, shifted, with_earth_frame
from svprep.ingest.gltf_objects import Gathered, Owner
from svprep.ingest.gltf_properties import FeatureTable, property_tables
from svprep.ingest.gltf_transforms import INSTANCING, PLACING, instance_matrices, local_matrix
from svprep.ingest.parsed import ParsedFile, count_of, encodable, refuse_non_finite, shown
from svprep.model import F64, I64, U8

DAMAGED: Final = (LookupError, TypeError, ValueError, AttributeError, OverflowError)
"""What a reader trips over in JSON of another shape than it must have."""

OWN_GENERATOR: Final = "svprep export"
"""Of GLB files that hold their CRS, as ``asset.extras.crs``."""

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_SEE_THROUGH: Final = ("MASK", "BLEND")
_Values = Callable[[str], NDArray[np.generic]]


def read_gltf(data: U8, path: Path, stem: str) -> ParsedFile:
    """Read a glTF or GLB file.

    Parameters
    ----------
    data : (n_bytes + 1,) uint8
        The file and a line feed behind it.

    Raises
    ------
    InputError
        Also for geometry that is not decoded here: reading the rest would leave out shadows.
    EnvironmentProblem
        If it is Draco-compressed and DracoPy is not installed.
    """
    return alone(read_content(data[:-1].data, path), path)


def alone(parsed: ParsedFile, path: Path) -> ParsedFile:
    """Return what is in a file that is an input by itself: it must have triangles."""
    if len(parsed.faces) == 0:
        raise InputError(f"{path}: no triangles in it ({'; '.join(parsed.notes)}).")
    return with_earth_frame(parsed)


def read_content(
    text: bytes | memoryview,
    path: Path,
    *,
    frame: F64 | None = None,
    batch_table: FeatureTable | None = None,
    is_y_up: bool = True,
    locate: Locate | None = None,
) -> ParsedFile:
    """Read a glTF file, or the one in a tile, which may hold no triangle.

    Parameters
    ----------
    frame : (4, 4) float64, optional
        Places the z-up frame of the file.
    batch_table
        What ``_BATCHID`` names the rows of.
    is_y_up
        False: z is up already.
    locate
        Finds the files beside it.
    """
    try:
        tree, binary = split(text, path)
        buffers = Buffers(tree, binary, path, locate, len(text))
        refuse_unread(tree, path)
        root = np.eye(4) if frame is None else frame
        if (center := rtc_center(tree, path)) is not None:
            root = shifted(root, center)
        if is_y_up:
            root = composed(root, Z_UP_FROM_Y_UP)
        parsed = _Gltf(buffers, batch_table).read(root)
        turned = ("y up was turned to z up: (x, y, z) -> (x, -z, y)",) if is_y_up else ()
        return replace(parsed, notes=(*turned, *parsed.notes), crs=_own_crs(tree["asset"]))
    except DAMAGED as error:
        detail = shown(f"{type(error).__name__}: {error}")
        raise InputError(f"{path}: the glTF structure is damaged ({detail}).") from None


def _own_crs(asset: dict[str, Any]) -> str:
    """Return the CRS that `svprep export` writes; glTF itself has no place for one."""
    is_own = asset.get("generator") == OWN_GENERATOR
    return _text(_extras(asset).get("crs")) if is_own else ""


class _Gltf:
    """One file while it is read."""

    def __init__(self, buffers: Buffers, batch_table: FeatureTable | None) -> None:
        self.buffers = buffers
        self.tree = buffers.tree
        self.path = buffers.path
        tables = property_tables(buffers)
        if batch_table is not None:
            tables[BATCH_TABLE] = batch_table
        self.features = Features(tables)
        self.gathered = Gathered(self.path)
        self.meshes: set[int] = set()  # with surfaces that were read
        self.materials: set[int] = set()  # of those
        self.left_out: Counter[str] = Counter()

    def read(self, root: F64) -> ParsedFile:
        """Walk the scene and gather its surfaces."""
        with np.errstate(all="ignore"):  # what is not finite is refused
            self._visit_all(self._roots(), root)
        notes = [f"{count_of(n, kind)} left out" for kind, n in self.left_out.items()]
        notes += self._material_notes() + extension_notes(self.tree, self.meshes)
        return self.gathered.parsed((*notes, *self.features.notes()), self.buffers.beside)

    def _roots(self) -> list[int]:
        """Return the nodes that the scene starts from; without a scene, all that have no parent."""
        scenes = self.tree.get("scenes", [])
        default = natural(self.tree.get("scene", 0))
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

    def _visit_all(self, roots: list[int], root_matrix: F64) -> None:
        """Gather the nodes below `roots`, parents first; they must form a forest."""
        nodes = self.tree.get("nodes", [])
        visited: set[int] = set()
        stack = [(root, root_matrix) for root in reversed(roots)]
        while stack:
            index, world = stack.pop()
            if index in visited:
                raise InputError(
                    f"{self.path}: node {index} is reached twice; a node may have one parent and "
                    "stand in a scene once."
                )
            node = nodes[natural(index)]
            visited.add(index)
            if not PLACING.isdisjoint(node):
                world = world @ local_matrix(node)
                if not np.isfinite(world).all():
                    raise InputError(
                        f"{self.path}: node {index} is placed by a transform that is not finite."
                    )
            if "mesh" in node:
                self._add_node(node, index, world)
            stack.extend((child, world) for child in reversed(node.get("children", [])))
        if not self.tree.get("scenes") and len(visited) < len(nodes):
            index = next(i for i in range(len(nodes)) if i not in visited)
            raise InputError(f"{self.path}: node {index} is, or lies below, its own parent.")

    def _add_node(self, node: dict[str, Any], index: int, world: F64) -> None:
        """Gather the surfaces of one node's mesh, as often as it is placed."""
        mesh = self.tree["meshes"][natural(node["mesh"])]
        name = encodable(str(node.get("name") or mesh.get("name") or f"node_{index}"))
        stated = {**_extras(mesh), **_extras(node)}
        owner = Owner(index, name, _text(stated.get("type")), _text(stated.get("parent")))
        matrices, owners = self._instances(node, owner, world)
        n_objects = self.gathered.n_objects
        is_of_node = True
        for number, primitive in enumerate(mesh["primitives"]):
            what = f'object "{shown(name)}", primitive {number}'
            surface = self._surface(primitive, what)
            if surface is None:
                continue
            points, triangles, feature, chosen = surface
            self.gathered.count_triangles(len(owners) * len(triangles), self.buffers.n_bytes)
            objects = self._objects(owners, feature, chosen, len(triangles))
            is_of_node &= chosen is None or chosen.table is None
            named = _text(_extras(primitive).get("surface"))
            self.gathered.add(points, triangles, matrices, objects, named, what)
            self.meshes.add(node["mesh"])
            if "material" in primitive:
                self.materials.add(natural(primitive["material"]))
        if is_of_node and len(owners) == 1 and self.gathered.n_objects == n_objects + 1:
            self.gathered.rename_last(owners[0].name)  # a node of one feature needs no number
        if "skin" in node:
            self.left_out["skin (its mesh is read unposed)"] += 1

    def _instances(self, node: dict[str, Any], owner: Owner, world: F64) -> tuple[F64, list[Owner]]:
        """Return where a node's mesh is placed, ``(n, 4, 4)``, and what is an object there."""
        extensions = node.get("extensions", {})
        if INSTANCING not in extensions:
            return world[None], [owner]
        attributes = extensions[INSTANCING].get("attributes", {})
        counts = [self.buffers.described(index)["count"] for index in attributes.values()]
        self.gathered.count_instances(max(map(natural, counts), default=0), self.buffers.n_bytes)
        matrices = world @ instance_matrices(attributes, self.buffers.accessor)
        n = len(matrices)
        ids = extensions.get("EXT_instance_features", {}).get("featureIds", [])
        entry = next((e for e in ids if "propertyTable" in e), None)
        if entry is None:
            return matrices, [
                owner._replace(key=(owner.key, i), name=f"{owner.name}_{i}") for i in range(n)
            ]
        label = f"_FEATURE_ID_{entry.get('attribute')}"
        chosen = FeatureSet(label, label if "attribute" in entry else "", divisor=1)
        each = np.repeat(np.arange(n)[:, None], 3, axis=1)
        feature = self.features.of_triangles(
            chosen, lambda name: self.buffers.accessor(attributes[name]), each, n
        )
        table = entry["propertyTable"]
        return matrices, [
            Owner(("feature", table, f), *self.features.row(table, f))
            if f != NO_FEATURE
            else owner._replace(key=(owner.key, i), name=f"{owner.name}_{i}")
            for i, f in enumerate(feature.tolist())
        ]

    def _objects(
        self, owners: list[Owner], feature: I64 | None, chosen: FeatureSet | None, n_faces: int
    ) -> I64:
        """Return the object of each triangle at each place, ``(n_places * n_faces,)``."""
        if feature is None or chosen is None:
            return np.repeat([self.gathered.number(owner) for owner in owners], n_faces)
        ids, local = np.unique(feature, return_inverse=True)
        rows = []
        for owner in owners:
            rows.append([self._number(owner, i, chosen) for i in ids.tolist()])
        return np.array(rows, np.int64)[:, local.reshape(-1)].reshape(-1)

    def _number(self, owner: Owner, feature: int, chosen: FeatureSet) -> int:
        """Return the number of the object that a feature is."""
        if feature == NO_FEATURE:
            return self.gathered.number(owner)
        if chosen.table is None:
            key = (owner.key, chosen.label, feature)
            name = f"{owner.name}/feature_{feature}"
            return self.gathered.number(owner._replace(key=key, name=name))
        table_key = ("feature", chosen.table, feature)
        number = self.gathered.find(table_key)
        if number < 0:
            row = self.features.row(chosen.table, feature)
            number = self.gathered.number(Owner(table_key, *row))
        return number

    def _surface(
        self, primitive: dict[str, Any], what: str
    ) -> tuple[F64, I64, I64 | None, FeatureSet | None] | None:
        """Return points, triangles and their features; None if it is no surface or is empty."""
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            self.left_out["point set" if mode == 0 else "line set"] += 1
            return None
        if self.buffers.described(primitive["attributes"]["POSITION"])["type"] != "VEC3":
            raise InputError(f"{self.path}: {what}: its positions are not VEC3.")
        values: _Values
        if is_draco(primitive, self.buffers):
            points, corners, values = decode_draco(primitive, self.buffers, self.path, what)
            mode = _TRIANGLES
        else:
            points, corners, values = self._plain(primitive, what)
        if not np.isfinite(points).all():
            refuse_non_finite(points, self.path, what)
        is_bad = corners >= len(points)
        if is_bad.any():
            raise InputError(
                f"{self.path}: {what}: {count_of(int(is_bad.sum()), 'index', 'indices')} "
                f"past the end (first {first_few(corners[is_bad])}), but it has only "
                f"{count_of(len(points), 'vertex', 'vertices')}."
            )
        triangles = self._triangles(corners, mode)
        if len(triangles) == 0:
            return None
        feature = None
        if (chosen := self.features.chosen(primitive)) is not None:
            feature = self.features.of_triangles(chosen, values, triangles, len(points))
        if len(points) > 2 * corners.size:  # primitives may share one large accessor
            used, inverse = np.unique(triangles, return_inverse=True)
            points, triangles = points[used], inverse.reshape(-1, 3)
        return points, triangles, feature, chosen

    def _plain(self, primitive: dict[str, Any], what: str) -> tuple[F64, I64, _Values]:
        """Return positions, the corners of what is drawn, and what gives other attributes."""
        attributes = primitive["attributes"]
        points = self.buffers.accessor(attributes["POSITION"]).astype(np.float64)
        if "indices" in primitive:
            self._refuse_no_indices(primitive["indices"], what)
            corners = self.buffers.accessor(primitive["indices"]).reshape(-1).astype(np.int64)
        else:
            corners = np.arange(len(points))
        return points, corners, lambda name: self.buffers.accessor(attributes[name])

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

    def _refuse_no_indices(self, index: int, what: str) -> None:
        """Raise `InputError` for values that another type would turn into other vertices."""
        accessor = self.buffers.described(index)
        kind, component = accessor["type"], accessor["componentType"]
        if kind != "SCALAR" or component not in INDEX_TYPES or accessor.get("normalized"):
            raise InputError(
                f"{self.path}: {what}: accessor {index} holds no indices: its type is "
                f"{shown(kind)} of componentType {shown(component)}, but indices are SCALAR of "
                "5121, 5123 or 5125, not normalized."
            )

    def _material_notes(self) -> list[str]:
        """Say how many materials that were met can be seen through."""
        materials = self.tree.get("materials", [])
        met = [materials[i] for i in sorted(self.materials) if i < len(materials)]
        n = sum(material.get("alphaMode") in _SEE_THROUGH for material in met)
        if n == 0:
            return []
        return [
            f"{count_of(n, 'material')} with alphaMode MASK or BLEND: alpha is ignored, they "
            "cast as if opaque"
        ]


def _extras(node: dict[str, Any]) -> dict[str, Any]:
    extras = node.get("extras")
    return extras if isinstance(extras, dict) else {}


def _text(value: object) -> str:
    return encodable(value) if isinstance(value, str) else ""
