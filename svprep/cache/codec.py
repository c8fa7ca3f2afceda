"""`model.Prepared` to the stored arrays, and back.

Encoding checks the contract of `svprep.model` as far as the stored form needs
it; what cannot be stored exactly is our own bug, never rounded or dropped.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svprep import __version__
from svprep.cache.schema import MAGIC, SCHEMA_VERSION
from svprep.cache.stage_code import stage_code
from svprep.defects import DEFECTS
from svprep.errors import InternalError, first_few
from svprep.model import (
    F64,
    I64,
    NO_INDEX,
    U8,
    U32,
    ClampTable,
    Components,
    EdgeTable,
    FaceFindings,
    Grid,
    Labels,
    Mesh,
    ObjectTables,
    Place,
    PlaneTable,
    Prepared,
    RepairRecord,
    SceneTree,
    SilhouetteIndex,
    SilhouetteTree,
    SourceFile,
)

Raw = NDArray[Any]
Fetch = Callable[[str], Raw]
"""Gives the stored array of a dataset path."""

BLOCK = 1 << 15
"""Rows per step of the loops over faces and edges: keeps their scratch in the CPU's cache."""


def encode_datasets(prepared: Prepared) -> dict[str, Raw]:
    """Return the stored array of every declared dataset.

    Raises
    ------
    InternalError
        A table breaks the contract of `svprep.model`.
    """
    return {
        **object_datasets(
            ObjectTables(
                mesh=prepared.mesh,
                components=prepared.components,
                planes=prepared.planes,
                edges=prepared.edges,
                index=prepared.index,
                repair=prepared.repair,
            )
        ),
        **label_datasets(prepared.object_names, prepared.object_source, prepared.labels),
        **scene_datasets(prepared.scene),
        **clamp_datasets(prepared.clamp),
    }


def object_datasets(tables: ObjectTables) -> dict[str, Raw]:
    """Return the stored arrays of what depends on single objects alone.

    Raises
    ------
    InternalError
        A table breaks the contract of `svprep.model`.
    """
    mesh, parts, edges, repair = tables.mesh, tables.components, tables.edges, tables.repair
    findings = repair.face_findings
    corners = _as("mesh.faces", mesh.faces, "<u4", (-1, 3)).reshape(-1)
    positions = _as("mesh.positions", mesh.positions, "<f4", (-1, 3))
    if not np.isfinite(positions).all():
        raise InternalError("mesh.positions are not all finite")
    if len(corners) and int(corners.max()) >= len(positions):
        raise InternalError("mesh.faces refers to vertices that do not exist")
    count_object, count_code, count = _sparse_counts(repair.defect_counts)
    return {
        "mesh/positions": positions,
        "mesh/face_corners": corners,
        "mesh/source_face": _as("mesh.source_face", mesh.source_face, "<u4", (-1,)),
        "objects/vertex_start": _offsets("object_vertex_start", mesh.object_vertex_start),
        "objects/face_start": _offsets("object_face_start", mesh.object_face_start),
        "objects/component_start": _offsets("components.object_start", parts.object_start),
        "components/face_start": _offsets("components.face_start", parts.face_start),
        "components/edge_start": _offsets("components.edge_start", parts.edge_start),
        "components/flags": _as("components.flags", parts.flags, "|u1", (-1,)),
        "planes/face": face_of_plane(tables.planes, mesh),
        "planes/d": np.ascontiguousarray(tables.planes.planes[:, 3], "<f8"),
        "planes/plane_of_face": _as("plane_of_face", tables.planes.plane_of_face, "<u4", (-1,)),
        "edges/half_edges": half_edges_of_rows(corners, _as("rows", edges.rows, "<u4", (-1, 4))),
        "edges/flags": _as("edges.flags", edges.flags, "|u1", (-1,)),
        **_index_datasets(tables.index),
        "repair/count_object": count_object,
        "repair/count_code": count_code,
        "repair/count": count,
        "repair/source_triangles": _as("source_triangles", repair.source_triangles, "<u4", (-1,)),
        "repair/source_digest": _as("source_digest", repair.source_digest, "<u8", (-1, 2)),
        "repair/finding_code": _as("finding code", findings.code, "<u2", (-1,)),
        "repair/finding_object": _as("finding object", findings.object_index, "<u4", (-1,)),
        "repair/finding_source_face": _as("finding face", findings.source_face, "<u4", (-1,)),
        "repair/flipped_faces": _as("flipped_faces", repair.flipped_faces, "<u4", (-1,)),
    }


def label_datasets(names: Sequence[str], source: U32, labels: Labels) -> dict[str, Raw]:
    """Return the stored arrays of what the sources say of objects and faces."""
    name_bytes, name_start = _text_table(names)
    parent_bytes, parent_start = _text_table(labels.object_parents)
    return {
        "mesh/surface": _as("surface_of_face", labels.surface_of_face, "|u1", (-1,)),
        "objects/source": _as("object_source", source, "<u4", (-1,)),
        "objects/name_start": _offsets("object name", name_start),
        "objects/name_bytes": name_bytes,
        "objects/type": _types(labels),
        "objects/parent_start": _offsets("object parent", parent_start),
        "objects/parent_bytes": parent_bytes,
    }


def _index_datasets(index: SilhouetteIndex) -> dict[str, Raw]:
    arrays = {
        "index/object": _as("index.objects", index.objects, "<u4", (-1,)),
        "index/frame": _as("index.frames", index.frames, "<f4", (-1, 4)),
        "index/pair_start": _offsets("index.pair_start", index.pair_start),
    }
    for group, tree in (("cones", index.cones), ("hextree", index.hextree)):
        arrays[f"{group}/edge"] = _as(f"{group}.edge", tree.edge, "<u4", (-1,))
        arrays[f"{group}/blocks"] = _as(f"{group}.blocks", tree.blocks, "<i2", (-1, 8, 8))
        arrays[f"{group}/work"] = _as(f"{group}.work", tree.expected_work, "<f4", (-1, 2))
    return arrays


def scene_datasets(scene: SceneTree) -> dict[str, Raw]:
    """Return the stored arrays of the scene trees."""
    return {
        "scene/object": _as("scene.objects", scene.objects, "<u4", (-1,)),
        "scene/object_boxes": _as("scene.object_boxes", scene.object_boxes, "<f4", (-1, 6)),
        "scene/object_nodes": _as("scene.object_nodes", scene.object_nodes, "<f4", (-1, 6)),
        "scene/face": _as("scene.faces", scene.faces, "<u4", (-1,)),
        "scene/cluster_start": _offsets("scene.cluster_start", scene.cluster_start),
        "scene/cluster_nodes": _as("scene.cluster_nodes", scene.cluster_nodes, "<f4", (-1, 6)),
    }


def clamp_datasets(clamp: ClampTable) -> dict[str, Raw]:
    """Return the stored arrays of the lights and their segments alone."""
    spec_bytes, spec_start = _text_table(clamp.specs)
    return {
        "lights/spec_start": _offsets("light spec", spec_start),
        "lights/spec_bytes": spec_bytes,
        "lights/light": _as("clamp.lights", clamp.lights, "<f4", (-1, 4)),
        "lights/frame": _as("clamp.frames", clamp.frames, "<f8", (-1, 3, 3)),
        "lights/facts": _as("clamp.facts", clamp.facts, "<f8", (-1, 5)),
        "lights/segment_start": _offsets("clamp.light_start", clamp.light_start),
        "clamp/segment_start": _as("clamp.segment_start", clamp.segment_start, "<u4", (-1, -1)),
        "clamp/depth": _as("clamp.depths", clamp.depths, "<f4", (-1, 2)),
        "clamp/slope": _as("clamp.slopes", clamp.slopes, "<i2", (-1, 2)),
    }


def encode_attributes(prepared: Prepared) -> dict[str, bytes | Raw]:
    """Return every root attribute but the two digests: texts as UTF-8, numbers as arrays."""
    return city_attributes(
        sources=prepared.sources,
        labels=prepared.labels,
        place=prepared.place,
        grid=prepared.mesh.grid,
        planar_tolerance_m=prepared.planes.tolerance_m,
        config=prepared.config,
        notes=prepared.notes,
    )


def city_attributes(
    *,
    sources: Sequence[SourceFile],
    labels: Labels,
    place: Place,
    grid: Grid,
    planar_tolerance_m: float,
    config: Mapping[str, object],
    notes: Sequence[str],
) -> dict[str, bytes | Raw]:
    """Return every root attribute but the two digests, of what a city is made from."""
    described = [
        {"format": s.format, "n_bytes": s.n_bytes, "sha256": s.sha256, "crs": s.crs}
        for s in sources
    ]
    where = asdict(place)
    crs = where.pop("crs")
    return {
        "magic": MAGIC.encode(),
        "schema_version": np.asarray(SCHEMA_VERSION, "<u4"),
        "producer_version": __version__.encode(),
        "tables_by": stage_code().encode(),
        "source_paths": _json("source paths", [s.path for s in sources]),
        "sources": _json("sources", described),
        "object_types": _json("object types", _type_names(labels)),
        "surface_names": _json("surface names", list(labels.surface_names)),
        "config": _json("config", config),
        "notes": _json("notes", list(notes)),
        "grid_step_m": np.asarray(grid.step_m, "<f8"),
        "grid_origin_m": np.asarray(grid.origin_m, "<f8"),
        "planar_tolerance_m": np.asarray(planar_tolerance_m, "<f8"),
        "crs": crs.encode(),
        "place": _json("place", {k: v for k, v in where.items() if v is not None}),
    }


def _json(what: str, value: object) -> bytes:
    """Return `value` as ASCII JSON with sorted keys: the same bytes for the same value."""
    try:
        text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InternalError(f"the {what} of a cache must be JSON: {error}") from error
    return text.encode()


def _as(what: str, array: Raw, dtype: str, shape: tuple[int, ...]) -> Raw:
    array = np.asarray(array)
    fits = array.ndim == len(shape) and all(
        want in (-1, got) for want, got in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype.newbyteorder("<") != np.dtype(dtype):
        raise InternalError(
            f"{what}: expected {np.dtype(dtype).name} of shape {shape}, "
            f"got {array.dtype.name} of shape {array.shape}"
        )
    return np.ascontiguousarray(array, dtype)


def _offsets(what: str, offsets: I64) -> Raw:
    array = np.asarray(offsets)
    if array.ndim != 1 or array.dtype != np.int64 or not len(array):
        raise InternalError(f"{what}: expected int64 offsets, got {array.dtype} {array.shape}")
    if array[0] != 0 or array[-1] >= NO_INDEX or np.any(np.diff(array) < 0):
        raise InternalError(f"{what}: offsets must rise from 0 and stay below 2**32 - 1")
    return array.astype("<u4")


def _text_table(texts: Sequence[str]) -> tuple[Raw, I64]:
    """Return texts as bytes end to end, and where each starts."""
    together = "".join(texts)
    if together.isascii():
        lengths = np.fromiter(map(len, texts), np.int64, len(texts))
        return np.frombuffer(together.encode(), np.uint8), np.append(0, np.cumsum(lengths))
    encoded = [_name_bytes(text) for text in texts]
    start = np.concatenate(([0], np.cumsum([len(text) for text in encoded], dtype=np.int64)))
    return np.frombuffer(b"".join(encoded), np.uint8), start


def _type_names(labels: Labels) -> list[str]:
    return ["", *sorted(set(labels.object_types) - {""})]


def _types(labels: Labels) -> Raw:
    """Return the index of each object's type among `_type_names`."""
    names = _type_names(labels)
    if len(names) > 1 << 16:
        raise InternalError(f"{len(names)} types of objects; a cache holds {1 << 16}")
    number = {name: i for i, name in enumerate(names)}
    return np.array([number[t] for t in labels.object_types], "<u2")


def _name_bytes(name: str) -> bytes:
    # surrogateescape: names read from files that are not UTF-8 survive unchanged.
    try:
        return name.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError as error:
        raise InternalError(f"the object name {name!r} is not text: {error}") from error


def _sparse_counts(dense: U32) -> tuple[Raw, Raw, Raw]:
    dense = np.asarray(dense)
    if dense.ndim != 2 or dense.shape[1] != len(DEFECTS) or dense.dtype != np.uint32:
        raise InternalError(
            f"defect_counts: expected uint32 of shape (n_objects, {len(DEFECTS)}), "
            f"got {dense.dtype} of shape {dense.shape}"
        )
    codes = np.array([int(code) for code in DEFECTS], "<u2")
    by_code = np.argsort(codes, kind="stable")
    row, column = np.nonzero(dense[:, by_code])
    return row.astype("<u4"), codes[by_code][column], dense[row, by_code[column]].astype("<u4")


def half_edges_of_rows(corners: Raw, rows: U32) -> Raw:
    """Return ``(n_edges, 2)``: the left and right half-edge of each edge record.

    Half-edge ``3 f + i`` runs from corner i of face f to the next; `NO_INDEX`
    where the record has no face. O(n).
    """
    corners = np.ravel(corners)
    half = np.full((len(rows), 2), NO_INDEX, "<u4")
    for side, (start, end) in enumerate(((0, 1), (1, 0))):
        face = rows[:, 2 + side]
        is_side = face != NO_INDEX
        has_face = slice(None) if is_side.all() else is_side
        face, first, last = face[has_face], rows[has_face, start], rows[has_face, end]
        if len(face) and int(face.max()) >= len(corners) // 3:
            raise InternalError("edges.rows refers to faces that do not exist")
        found = np.uint32(3) * face
        is_later = corners.take(found) != first
        found += is_later
        is_last = is_later & (corners.take(found) != first)
        found += is_last
        follows = found + np.uint32(1)
        follows[is_last] -= np.uint32(3)
        fits = corners.take(follows) == last
        fits &= ~is_last | (corners.take(found) == first)
        if not fits.all():
            bad = np.flatnonzero(is_side)[~fits]
            raise InternalError(
                f"edge records {first_few(bad)}: their {('left', 'right')[side]} face does not "
                f"traverse {('v0 -> v1', 'v1 -> v0')[side]}"
            )
        half[has_face, side] = found
    return half


def next_half_edge(half: U32) -> U32:
    """Return the half-edge that follows each one around its face."""
    return np.where(half % 3 == 2, half - np.uint32(2), half + np.uint32(1)).astype(np.uint32)


def rows_of_half_edges(corners: U32, half: U32) -> U32:
    """Return the edge records ``[v0, v1, f_left, f_right]`` of `half`: its inverse. O(n)."""
    rows = np.empty((len(half), 4), np.uint32)
    for first in range(0, len(half), BLOCK):
        block = slice(first, first + BLOCK)
        left, right = half[block, 0], half[block, 1]
        on_left = left != NO_INDEX
        any_half = np.where(on_left, left, right)
        start, end = corners.take(any_half), corners.take(next_half_edge(any_half))
        rows[block, 0] = np.where(on_left, start, end)
        rows[block, 1] = np.where(on_left, end, start)
        rows[block, 2] = np.where(on_left, left // 3, NO_INDEX)
        rows[block, 3] = np.where(right != NO_INDEX, right // 3, NO_INDEX)
    return rows


def face_normals(positions: Raw, faces: U32) -> F64:
    """Return ``(n, 3) float64 [m^2]``: (b - a) x (c - a), exact for positions on the grid."""
    # take: several times the speed of positions[...] on rows this short.
    a, b, c = (positions.take(faces[:, i], axis=0).astype(np.float64) for i in range(3))
    b -= a
    c -= a
    n = np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        n[:, i] = b[:, j] * c[:, k] - b[:, k] * c[:, j]
    n += 0.0  # -0.0 becomes 0.0
    return n


def face_of_plane(table: PlaneTable, mesh: Mesh) -> Raw:
    """Return the first face of each plane record whose own normal is the record's. O(n).

    That is nearly always the first face of all, so only the faces of the other
    records are looked at one by one.
    """
    planes = _as("planes.planes", table.planes, "<f8", (-1, 4))
    plane_of_face = _as("plane_of_face", table.plane_of_face, "<u4", (len(mesh.faces),))
    if len(plane_of_face) and int(plane_of_face.max()) >= len(planes):
        raise InternalError("plane_of_face refers to plane records that do not exist")
    numbers = np.arange(len(mesh.faces), dtype="<u4")
    face = np.full(len(planes), NO_INDEX, "<u4")
    face[plane_of_face[::-1]] = numbers[::-1]  # the last write, the lowest face, stays
    used = np.flatnonzero(face != NO_INDEX)
    searched = np.ones(len(planes), np.bool_)
    searched[used] = ~_has_normal_of(planes, used, mesh, face[used])
    face[searched] = NO_INDEX
    candidates = numbers[searched.take(plane_of_face)]
    own = candidates[_has_normal_of(planes, plane_of_face.take(candidates), mesh, candidates)]
    face[plane_of_face[own[::-1]]] = own[::-1]
    if (orphans := np.flatnonzero(face == NO_INDEX)).size:
        raise InternalError(
            f"plane records {first_few(orphans)}: expected the exact normal of a face that "
            "shares the record, found none"
        )
    return face


def _has_normal_of(planes: F64, records: Raw, mesh: Mesh, faces: Raw) -> NDArray[np.bool_]:
    """Return whether the normal of each of `faces` is exactly that of its row of `records`."""
    is_equal = np.empty(len(faces), np.bool_)
    for start in range(0, len(faces), BLOCK):
        block = slice(start, start + BLOCK)
        found = face_normals(mesh.positions, mesh.faces.take(faces[block], axis=0))
        wanted = planes.take(records[block], axis=0)
        is_equal[block] = (
            (found[:, 0] == wanted[:, 0])
            & (found[:, 1] == wanted[:, 1])
            & (found[:, 2] == wanted[:, 2])
        )
    return is_equal


def decode_mesh(fetch: Fetch, grid: Grid) -> Mesh:
    """Return the mesh of a cache."""
    return Mesh(
        grid=grid,
        positions=_native(fetch("mesh/positions"), np.float32),
        faces=_native(fetch("mesh/face_corners"), np.uint32).reshape(-1, 3),
        object_vertex_start=_native(fetch("objects/vertex_start"), np.int64),
        object_face_start=_native(fetch("objects/face_start"), np.int64),
        source_face=_native(fetch("mesh/source_face"), np.uint32),
    )


def decode_components(fetch: Fetch) -> Components:
    """Return the components of a cache."""
    return Components(
        object_start=_native(fetch("objects/component_start"), np.int64),
        face_start=_native(fetch("components/face_start"), np.int64),
        edge_start=_native(fetch("components/edge_start"), np.int64),
        flags=_native(fetch("components/flags"), np.uint8),
    )


def decode_planes(fetch: Fetch, tolerance_m: float) -> PlaneTable:
    """Return the plane records of a cache: normals again from their faces, exactly."""
    positions = fetch("mesh/positions")
    faces = _native(fetch("mesh/face_corners"), np.uint32).reshape(-1, 3)
    face, d = fetch("planes/face"), fetch("planes/d")
    planes = np.empty((len(face), 4), np.float64)
    for start in range(0, len(face), BLOCK):
        block = slice(start, start + BLOCK)
        with np.errstate(invalid="raise", over="raise"):  # positions that are not numbers
            planes[block, :3] = face_normals(positions, faces.take(face[block], axis=0))
    planes[:, 3] = d
    return PlaneTable(
        planes=frozen(planes),
        plane_of_face=_native(fetch("planes/plane_of_face"), np.uint32),
        tolerance_m=tolerance_m,
    )


def decode_edges(fetch: Fetch) -> EdgeTable:
    """Return the edge records of a cache."""
    corners = _native(fetch("mesh/face_corners"), np.uint32)
    half = _native(fetch("edges/half_edges"), np.uint32)
    flags: U8 = _native(fetch("edges/flags"), np.uint8)
    return EdgeTable(rows=frozen(rows_of_half_edges(corners, half)), flags=flags)


def decode_index(fetch: Fetch) -> SilhouetteIndex:
    """Return the silhouette trees of a cache."""

    def tree(group: str) -> SilhouetteTree:
        return SilhouetteTree(
            edge=_native(fetch(f"{group}/edge"), np.uint32),
            blocks=_native(fetch(f"{group}/blocks"), np.int16),
            expected_work=_native(fetch(f"{group}/work"), np.float32),
        )

    return SilhouetteIndex(
        objects=_native(fetch("index/object"), np.uint32),
        frames=_native(fetch("index/frame"), np.float32),
        pair_start=_native(fetch("index/pair_start"), np.int64),
        cones=tree("cones"),
        hextree=tree("hextree"),
    )


def decode_scene(fetch: Fetch) -> SceneTree:
    """Return the scene trees of a cache."""
    return SceneTree(
        objects=_native(fetch("scene/object"), np.uint32),
        object_boxes=_native(fetch("scene/object_boxes"), np.float32),
        object_nodes=_native(fetch("scene/object_nodes"), np.float32),
        faces=_native(fetch("scene/face"), np.uint32),
        cluster_start=_native(fetch("scene/cluster_start"), np.int64),
        cluster_nodes=_native(fetch("scene/cluster_nodes"), np.float32),
    )


def decode_clamp(fetch: Fetch) -> ClampTable:
    """Return the lights of a cache and their segments."""
    return ClampTable(
        specs=_texts(fetch("lights/spec_bytes"), fetch("lights/spec_start")),
        lights=_native(fetch("lights/light"), np.float32),
        frames=_native(fetch("lights/frame"), np.float64),
        facts=_native(fetch("lights/facts"), np.float64),
        light_start=_native(fetch("lights/segment_start"), np.int64),
        segment_start=_native(fetch("clamp/segment_start"), np.uint32),
        depths=_native(fetch("clamp/depth"), np.float32),
        slopes=_native(fetch("clamp/slope"), np.int16),
    )


def decode_repair(fetch: Fetch, n_objects: int) -> RepairRecord:
    """Return the repair record of a cache.

    Raises
    ------
    ValueError
        A defect code that this svprep does not know.
    """
    codes = np.array([int(code) for code in DEFECTS], np.uint16)
    row, code = fetch("repair/count_object"), fetch("repair/count_code")
    is_column = code[:, None] == codes[None, :]
    if not is_column.any(1).all():
        unknown = np.unique(code[~is_column.any(1)])
        raise ValueError(
            f"it holds defect codes that this svprep does not know: {first_few(unknown)}"
        )
    dense = np.zeros((n_objects, len(codes)), np.uint32)
    dense[row, is_column.argmax(1)] = fetch("repair/count")
    return RepairRecord(
        defect_counts=frozen(dense),
        source_triangles=_native(fetch("repair/source_triangles"), np.uint32),
        source_digest=_native(fetch("repair/source_digest"), np.uint64),
        face_findings=FaceFindings(
            code=_native(fetch("repair/finding_code"), np.uint16),
            object_index=_native(fetch("repair/finding_object"), np.uint32),
            source_face=_native(fetch("repair/finding_source_face"), np.uint32),
        ),
        flipped_faces=_native(fetch("repair/flipped_faces"), np.uint32),
    )


def decode_names(fetch: Fetch) -> tuple[str, ...]:
    """Return the object names of a cache."""
    return _texts(fetch("objects/name_bytes"), fetch("objects/name_start"))


def decode_labels(fetch: Fetch, type_names: Any, surface_names: Any) -> Labels:
    """Return what the sources say of objects and faces."""
    return Labels(
        object_types=tuple(map(type_names.__getitem__, fetch("objects/type").tolist())),
        object_parents=_texts(fetch("objects/parent_bytes"), fetch("objects/parent_start")),
        surface_names=tuple(surface_names),
        surface_of_face=_native(fetch("mesh/surface"), np.uint8),
    )


def decode_place(crs: str, place: Any) -> Place:
    """Return where the model stands, from two attributes."""
    return Place(crs, **{str(name): float(value) for name, value in place.items()})


def _texts(text_bytes: Raw, start: Raw) -> tuple[str, ...]:
    blob = text_bytes.tobytes()
    if blob.isascii():
        text = blob.decode()
        return tuple([text[a:b] for a, b in pairwise(start.tolist())])
    return tuple(blob[a:b].decode("utf-8", "surrogateescape") for a, b in pairwise(start.tolist()))


def decode_sources(paths: object, sources: object) -> tuple[SourceFile, ...]:
    """Return the source files from the two JSON attributes."""
    if not isinstance(paths, list) or not isinstance(sources, list) or len(paths) != len(sources):
        raise ValueError("sources and source_paths must be lists of one length")
    return tuple(
        SourceFile(str(path), str(s["format"]), int(s["n_bytes"]), str(s["sha256"]), str(s["crs"]))
        for path, s in zip(paths, sources, strict=True)
    )


def _native(array: Raw, dtype: type[np.generic]) -> NDArray[Any]:
    return frozen(array.astype(dtype, copy=False))


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return `array`, made read-only."""
    array.flags.writeable = False
    return array
