"""What a cache file holds: one declaration per dataset and per root attribute.

Writer, reader, validator and FORMAT.md all derive from `DATASETS` and
`ATTRIBUTES`. A change of any of them that an older reader would misread needs
a new `SCHEMA_VERSION`.

The group ``VTKHDF`` is declared by `svprep.cache.vtkhdf`: it shows the same arrays to
ParaView, and holds nothing that does not follow from them.

Two tables are stored in half the space that they take in memory, without loss:
an edge record as its two half-edges (its vertices and faces follow from the
face corners), and a plane record as a face that lies in it (its normal is the
cross product of that face's sides, which is exact on the grid) and its ``d``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

MAGIC: Final = "svprep-cache"
SCHEMA_VERSION: Final = 5

LIBVER: Final = ("v108", "v108")
"""HDF5 format bounds. Version 1.8 (2008) is the first that checksums its own
metadata and takes attributes over 64 KiB, and every later library reads it."""

DIGESTS_PATH: Final = "digests"
DIGESTS_DTYPE: Final = np.dtype([("path", "S64"), ("sha256", "S64")])

Role = Literal["", "offsets", "index", "index_or_none"]


class Dim(NamedTuple):
    """One length of a shape: ``times * symbol + plus``."""

    symbol: str
    times: int = 1
    plus: int = 0

    def __str__(self) -> str:
        text = self.symbol if self.times == 1 else f"{self.times} * {self.symbol}"
        return f"{text} + {self.plus}" if self.plus else text

    def length(self, sizes: Mapping[str, int]) -> int:
        """Return the length for known `sizes`."""
        return self.times * sizes[self.symbol] + self.plus

    def solve(self, length: int) -> int | None:
        """Return the symbol's value that gives `length`, or None."""
        value, rest = divmod(length - self.plus, self.times)
        return value if rest == 0 and value >= 0 else None


@dataclass(frozen=True, slots=True)
class DatasetSpec:
    """One dataset: where it lies, its stored type and shape, and what it means."""

    path: str
    dtype: str
    """NumPy notation with an explicit byte order: ``"<u4"``."""
    shape: tuple[Dim | int, ...]
    unit: str
    """``""`` for plain numbers."""
    meaning: str
    role: Role = ""
    """``"offsets"``: from 0 to `refers`, never falling. ``"index"``: below
    `refers`. ``"index_or_none"``: likewise, or `NO_INDEX`."""
    refers: Dim | None = None

    @property
    def in_memory(self) -> str:
        """What the bytes are taken for in memory: every index is unsigned there."""
        return "<u4" if self.dtype == "<i4" else self.dtype

    @property
    def shape_text(self) -> str:
        """``"(n_edges, 2)"``."""
        inner = ", ".join(str(n) for n in self.shape)
        return f"({inner},)" if len(self.shape) == 1 else f"({inner})"


@dataclass(frozen=True, slots=True)
class AttributeSpec:
    """One attribute of the root group."""

    name: str
    dtype: str
    """``"utf8"``, ``"json"`` (UTF-8 text that is JSON) or NumPy notation."""
    shape: tuple[int, ...]
    unit: str
    meaning: str
    in_content: bool = True
    """Whether `content_digest` covers it."""

    @property
    def is_text(self) -> bool:
        """Whether the value is a text, stored as fixed-length UTF-8."""
        return self.dtype in ("utf8", "json")


V, F, O = Dim("n_vertices"), Dim("n_faces"), Dim("n_objects")  # noqa: E741
C, P, E = Dim("n_components"), Dim("n_planes"), Dim("n_edges")
SOURCES = Dim("n_sources")
TYPES, SURFACES = Dim("n_types"), Dim("n_surface_names")
T, I, B = Dim("n_trees"), Dim("n_indexed_edges"), Dim("n_blocks")  # noqa: E741
L, S = Dim("n_lights"), Dim("n_segments")

DATASETS: Final[tuple[DatasetSpec, ...]] = (
    DatasetSpec(
        "mesh/positions",
        "<f4",
        (V, 3),
        "m",
        "Vertex positions in the cache frame: exact multiples of `grid_step_m`, at most 2^24 "
        "steps from zero. Source position = `grid_origin_m` + this.",
    ),
    DatasetSpec(
        "mesh/face_corners",
        "<i4",
        (Dim("n_faces", 3),),
        "",
        "Vertex of each face corner, flat: face f has the corners 3 f, 3 f + 1, 3 f + 2. "
        "Half-edge h runs from corner h to the next corner of its face, h // 3. Signed, though "
        "never negative: VTK before 9.6 reads no other corners.",
        "index",
        V,
    ),
    DatasetSpec(
        "mesh/source_face",
        "<u4",
        (F,),
        "",
        "0-based ordinal, in its source file, of the polygon that each face came from.",
    ),
    DatasetSpec(
        "mesh/surface",
        "|u1",
        (F,),
        "",
        "What each face is, as its file names it: index into the attribute `surface_names`.",
        "index",
        SURFACES,
    ),
    DatasetSpec(
        "objects/vertex_start",
        "<u4",
        (O._replace(plus=1),),
        "",
        "Object i owns the vertices start[i] to start[i + 1] - 1.",
        "offsets",
        V,
    ),
    DatasetSpec(
        "objects/face_start",
        "<u4",
        (O._replace(plus=1),),
        "",
        "Object i owns the faces start[i] to start[i + 1] - 1.",
        "offsets",
        F,
    ),
    DatasetSpec(
        "objects/component_start",
        "<u4",
        (O._replace(plus=1),),
        "",
        "Object i owns the components start[i] to start[i + 1] - 1.",
        "offsets",
        C,
    ),
    DatasetSpec(
        "objects/source",
        "<u4",
        (O,),
        "",
        "Source file of each object: index into the attribute `sources`.",
        "index",
        SOURCES,
    ),
    DatasetSpec(
        "objects/name_start",
        "<u4",
        (O._replace(plus=1),),
        "bytes",
        "Object i is named by the bytes start[i] to start[i + 1] - 1 of `name_bytes`.",
        "offsets",
        Dim("n_name_bytes"),
    ),
    DatasetSpec(
        "objects/name_bytes",
        "|u1",
        (Dim("n_name_bytes"),),
        "",
        "All object names, UTF-8, end to end (a byte that was not UTF-8 in the source is kept).",
    ),
    DatasetSpec(
        "objects/type",
        "<u2",
        (O,),
        "",
        "What each object is, as its file names it: index into the attribute `object_types`.",
        "index",
        TYPES,
    ),
    DatasetSpec(
        "objects/parent_start",
        "<u4",
        (O._replace(plus=1),),
        "bytes",
        "Object i is a part of the one named by the bytes start[i] to start[i + 1] - 1 of "
        "`parent_bytes`, which need not have a surface of its own; of none if there are no bytes.",
        "offsets",
        Dim("n_parent_bytes"),
    ),
    DatasetSpec(
        "objects/parent_bytes",
        "|u1",
        (Dim("n_parent_bytes"),),
        "",
        "All names of parents, UTF-8, end to end.",
    ),
    DatasetSpec(
        "components/face_start",
        "<u4",
        (C._replace(plus=1),),
        "",
        "Component i owns the faces start[i] to start[i + 1] - 1.",
        "offsets",
        F,
    ),
    DatasetSpec(
        "components/edge_start",
        "<u4",
        (C._replace(plus=1),),
        "",
        "Component i owns the edge records start[i] to start[i + 1] - 1.",
        "offsets",
        E,
    ),
    DatasetSpec(
        "components/flags",
        "|u1",
        (C,),
        "bits",
        "1 closed: every edge record has two faces; 2 solid: closed, outward and free of "
        "self-intersection; 4 inverted: the repair turned it outward.",
    ),
    DatasetSpec(
        "planes/face",
        "<u4",
        (P,),
        "",
        "A face of each plane record. With its corners a, b, c the record's normal is "
        "n = (b - a) x (c - a), exact in float64.",
        "index",
        F,
    ),
    DatasetSpec(
        "planes/d",
        "<f8",
        (P,),
        "m^3",
        "The record's fourth number: its plane is n . x + d = 0, and n is not normalised.",
    ),
    DatasetSpec(
        "planes/plane_of_face",
        "<u4",
        (F,),
        "",
        "Plane record of each face. Records are numbered by their lowest face, and none is shared "
        "between components. No vertex of the face lies farther from the record's plane than "
        "`planar_tolerance_m`, and the face is tilted against it by at most 0.0002 rad.",
        "index",
        P,
    ),
    DatasetSpec(
        "edges/half_edges",
        "<u4",
        (E, 2),
        "",
        "An edge record: its left half-edge, which runs from the smaller vertex v0 to the "
        "larger v1, and its right one, from v1 to v0; 4294967295 for none. Sorted by (object, "
        "component, v0, v1, left face); every half-edge occurs exactly once.",
        "index_or_none",
        Dim("n_faces", 3),
    ),
    DatasetSpec(
        "edges/flags",
        "|u1",
        (E,),
        "bits",
        "Bits 0-1: kind, 0 pair (an edge of exactly two faces), 1 border (one face, or half of "
        "a cut edge), 2 split (from an edge of three or more faces). Bit 2: planar, both faces "
        "share a plane record.",
    ),
    DatasetSpec(
        "index/object",
        "<u4",
        (T,),
        "",
        "The objects that have silhouette trees, ascending.",
        "index",
        O,
    ),
    DatasetSpec(
        "index/frame",
        "<f4",
        (T, 4),
        "m",
        "Frame of each of these objects: a centre (x, y, z) and a radius that holds all its "
        "vertices and is at least twice `planar_tolerance_m`.",
    ),
    DatasetSpec(
        "index/pair_start",
        "<u4",
        (T._replace(plus=1),),
        "",
        "Trees i hold the entries start[i] to start[i + 1] - 1 of `cones/edge` and of "
        "`hextree/edge`, at least one.",
        "offsets",
        I,
    ),
    *(
        spec
        for group, bounds, fields in (
            (
                "cones",
                "spheres with normal cones",
                "centre (x, y, z), radius, axis (x, y, z), sine of the half-angle, in 1/32000; a "
                "sine of 32000 bounds nothing",
            ),
            (
                "hextree",
                "boxes of dual points",
                "centre (x, y, z, d), half extents (x, y, z, d), in 1/32000, the fourth of each in "
                "2/32000",
            ),
        )
        for spec in (
            DatasetSpec(
                f"{group}/edge",
                "<u4",
                (I,),
                "",
                f"Edge records in the order of the trees of {bounds}: each record of the object "
                "whose flags are 0, once. Leaf j of a tree has its edges 8 j to 8 j + 7.",
                "index",
                E,
            ),
            DatasetSpec(
                f"{group}/blocks",
                "<i2",
                (B, 8, 8),
                "1/32000",
                f"Bounds, [block, number, lane]: {fields}. See Silhouette trees, below.",
            ),
            DatasetSpec(
                f"{group}/work",
                "<f4",
                (T, 2),
                "",
                "Edges and nodes that a query of this tree tests on average over all lights, "
                "estimated from its bounds.",
            ),
        )
    ),
    DatasetSpec(
        "scene/object",
        "<u4",
        (O,),
        "",
        "Objects in the order of the tree over them. See Scene trees, below.",
        "index",
        O,
    ),
    DatasetSpec(
        "scene/object_boxes",
        "<f4",
        (O, 6),
        "m",
        "Box of each object, by object: x0, y0, z0, x1, y1, z1, exact. An object without faces "
        "has x0 = infinity, x1 = -infinity.",
    ),
    DatasetSpec(
        "scene/object_nodes",
        "<f4",
        (Dim("n_object_nodes"), 6),
        "m",
        "Boxes of the nodes of the tree over objects, level by level from the lowest.",
    ),
    DatasetSpec(
        "scene/face",
        "<u4",
        (F,),
        "",
        "Faces in the order of clusters, each once.",
        "index",
        F,
    ),
    DatasetSpec(
        "scene/cluster_start",
        "<u4",
        (Dim("n_clusters", plus=1),),
        "",
        "Cluster i holds the entries start[i] to start[i + 1] - 1 of `scene/face`: 1 to 8 faces "
        "of one object.",
        "offsets",
        F,
    ),
    DatasetSpec(
        "scene/cluster_nodes",
        "<f4",
        (Dim("n_cluster_nodes"), 6),
        "m",
        "Boxes of the nodes of the tree over clusters, level by level from the lowest.",
    ),
    DatasetSpec(
        "lights/spec_start",
        "<u4",
        (L._replace(plus=1),),
        "bytes",
        "Light i is named by the bytes start[i] to start[i + 1] - 1 of `lights/spec_bytes`.",
        "offsets",
        Dim("n_spec_bytes"),
    ),
    DatasetSpec(
        "lights/spec_bytes",
        "|u1",
        (Dim("n_spec_bytes"),),
        "",
        "All lights as they were asked for, UTF-8, end to end; an arc is one light per step.",
    ),
    DatasetSpec(
        "lights/light",
        "<f4",
        (L, 4),
        "",
        "(x, y, z, w) in the cache frame: w = 1 a point light [m], w = 0 the direction towards "
        "the light.",
    ),
    DatasetSpec(
        "lights/frame",
        "<f8",
        (L, 3, 3),
        "",
        "Rows u, v, t of each light frame: unit vectors, t away from the light; x, y, z for a "
        "point light.",
    ),
    DatasetSpec(
        "lights/facts",
        "<f8",
        (L, 5),
        "",
        "What clamping weighed and gained: cost of a vertex, cost of a square metre; surface "
        "[m^2] of all shadow volumes unclamped, clamped to each caster's own box, and clamped "
        "(each caster's rounded to the nearest 2**(2 e - 40) m^2, where 2**e is the power of two "
        "above the scene's largest coordinate).",
    ),
    DatasetSpec(
        "lights/segment_start",
        "<u4",
        (L._replace(plus=1),),
        "",
        "Light i has the segments start[i] to start[i + 1] - 1.",
        "offsets",
        S,
    ),
    DatasetSpec(
        "clamp/segment_start",
        "<u4",
        (L, C._replace(plus=1)),
        "",
        "Of light i, component j has the segments start[i, j] to start[i, j + 1] - 1, counted "
        "from the light's first: at least one.",
    ),
    DatasetSpec(
        "clamp/depth",
        "<f4",
        (S, 2),
        "m",
        "Near and far of each segment (for a point light: factors). See Clamped segments, below.",
    ),
    DatasetSpec(
        "clamp/slope",
        "<i2",
        (S, 2),
        "1/512",
        "Slopes of a segment's two planes along u and v; 0 for a point light.",
    ),
    DatasetSpec(
        "repair/count_object",
        "<u4",
        (Dim("n_counts"),),
        "",
        "Object of each defect count; a pair (object, code) that is not listed has none. "
        "Sorted by (object, code).",
        "index",
        O,
    ),
    DatasetSpec(
        "repair/count_code",
        "<u2",
        (Dim("n_counts"),),
        "",
        "Defect code of each count.",
    ),
    DatasetSpec(
        "repair/count",
        "<u4",
        (Dim("n_counts"),),
        "",
        "How often the defect occurs in the object: at least 1.",
    ),
    DatasetSpec(
        "repair/source_triangles",
        "<u4",
        (O,),
        "",
        "Triangles of each object before anything was dropped.",
    ),
    DatasetSpec(
        "repair/source_digest",
        "<u8",
        (O, 2),
        "",
        "128 bits of each object's triangles as the sources give them: a later build takes over "
        "the tables of objects whose bits are the same.",
    ),
    DatasetSpec(
        "repair/finding_code",
        "<u2",
        (Dim("n_findings"),),
        "",
        "Defect code of each finding on a single source face.",
    ),
    DatasetSpec(
        "repair/finding_object",
        "<u4",
        (Dim("n_findings"),),
        "",
        "Object of each finding.",
        "index",
        O,
    ),
    DatasetSpec(
        "repair/finding_source_face",
        "<u4",
        (Dim("n_findings"),),
        "",
        "0-based ordinal of the source face. Findings are sorted by (object, code, face).",
    ),
    DatasetSpec(
        "repair/flipped_faces",
        "<u4",
        (Dim("n_flipped"),),
        "",
        "Faces wound against their source, ascending.",
        "index",
        F,
    ),
)

ATTRIBUTES: Final[tuple[AttributeSpec, ...]] = (
    AttributeSpec("magic", "utf8", (), "", f'"{MAGIC}".'),
    AttributeSpec("schema_version", "<u4", (), "", f"{SCHEMA_VERSION}. Refuse any other."),
    AttributeSpec(
        "producer_version", "utf8", (), "", "The svprep that wrote the file.", in_content=False
    ),
    AttributeSpec(
        "tables_by",
        "utf8",
        (),
        "",
        "SHA-256 of the code that made the tables: a later build takes tables over "
        "if they are its own.",
        in_content=False,
    ),
    AttributeSpec(
        "source_paths",
        "json",
        (),
        "",
        "A list: the source files as the user named them.",
        in_content=False,
    ),
    AttributeSpec(
        "sources",
        "json",
        (),
        "",
        'A list of {"format", "n_bytes", "sha256", "crs"}: the source files.',
    ),
    AttributeSpec(
        "object_types",
        "json",
        (),
        "",
        'A list: what objects are, such as "Building"; the first is "", not stated.',
    ),
    AttributeSpec(
        "surface_names",
        "json",
        (),
        "",
        'A list: what faces are, such as "RoofSurface"; the first is "", not stated.',
    ),
    AttributeSpec("config", "json", (), "", "An object: what the build was asked for."),
    AttributeSpec("notes", "json", (), "", "A list of lines on what was left out or converted."),
    AttributeSpec("grid_step_m", "<f8", (), "m", "The grid's step, a power of two."),
    AttributeSpec("grid_origin_m", "<f8", (3,), "m", "The grid's origin in source coordinates."),
    AttributeSpec(
        "planar_tolerance_m", "<f8", (), "m", "How far a vertex may lie from its face's record."
    ),
    AttributeSpec(
        "crs",
        "utf8",
        (),
        "",
        "Coordinate reference system of source positions, in metres; empty when unknown.",
    ),
    AttributeSpec(
        "place",
        "json",
        (),
        "",
        "An object: latitude_deg and longitude_deg of the model's middle in WGS 84, and there "
        "convergence_deg, from true north to +y, clockwise; empty when unknown.",
    ),
    AttributeSpec(
        "content_digest",
        "utf8",
        (),
        "",
        "SHA-256 over everything but the producer version, its code and the source paths: what two "
        "builds compare. Adding lights changes it.",
        in_content=False,
    ),
    AttributeSpec(
        "root_digest",
        "utf8",
        (),
        "",
        "SHA-256 over the content digest, the producer version, its code and the source paths.",
        in_content=False,
    ),
)


def shape_problem(
    spec: DatasetSpec, dtype: np.dtype, shape: tuple[int, ...], sizes: dict[str, int]
) -> str | None:
    """Return why an array does not fit its declaration, or None.

    `sizes` holds the symbols known so far; a symbol met for the first time is
    learnt from the shape, so datasets are to be given in schema order.
    """
    learnt = dict(sizes)
    fits = dtype == np.dtype(spec.dtype) and len(shape) == len(spec.shape)
    for dim, length in zip(spec.shape, shape, strict=False):
        if isinstance(dim, int):
            fits &= length == dim
        elif dim.symbol in learnt:
            fits &= length == dim.length(learnt)
        elif (value := dim.solve(length)) is not None:
            learnt[dim.symbol] = value
        else:
            fits = False
    if fits:
        sizes.update(learnt)
        return None
    symbols = [d.symbol for d in spec.shape if isinstance(d, Dim) and d.symbol in sizes]
    given = "".join(f", {symbol} = {sizes[symbol]}" for symbol in symbols)
    return f"expected {spec.dtype} {spec.shape_text}{given}; got {dtype.str} {shape}"


LISTS: Final = {
    SOURCES.symbol: "sources",
    TYPES.symbol: "object_types",
    SURFACES.symbol: "surface_names",
}
"""Lengths that are those of JSON attributes."""

SPEC_OF_PATH: Final = {spec.path: spec for spec in DATASETS}
ATTRIBUTE_OF_NAME: Final = {spec.name: spec for spec in ATTRIBUTES}


class ItemDigest:
    """The SHA-256 of one dataset or attribute, of blocks that come one after the other.

    Hashed are its name, its dtype and the shape's lengths joined by commas, a line each,
    then the raw little-endian bytes.
    """

    def __init__(self, name: str, dtype: str, shape: Sequence[int]) -> None:
        lengths = ",".join(map(str, shape))
        self._sha256 = hashlib.sha256(f"{name}\n{dtype}\n{lengths}\n".encode())

    def update(self, value: NDArray[np.generic] | bytes) -> None:
        """Take the next bytes. Releases the GIL."""
        if isinstance(value, bytes):
            self._sha256.update(value)
        elif value.size:
            self._sha256.update(np.ascontiguousarray(value).reshape(-1).view(np.uint8).data)

    def hexdigest(self) -> str:
        """Return the digest of all that was taken."""
        return self._sha256.hexdigest()


def item_digest(name: str, dtype: str, value: NDArray[np.generic] | bytes) -> str:
    """Return the `ItemDigest` of a value that is all there."""
    digest = ItemDigest(name, dtype, (len(value),) if isinstance(value, bytes) else value.shape)
    digest.update(value)
    return digest.hexdigest()


def attribute_digest(spec: AttributeSpec, value: bytes | NDArray[np.generic]) -> str:
    """Return the digest of one root attribute; texts are given as their UTF-8 bytes."""
    return item_digest(spec.name, "utf8" if spec.is_text else spec.dtype, value)


def _lines_digest(lines: Sequence[tuple[str, str]]) -> str:
    return hashlib.sha256("".join(f"{name} {text}\n" for name, text in lines).encode()).hexdigest()


def content_digest(
    attributes: Mapping[str, bytes | NDArray[np.generic]], table: Sequence[tuple[str, str]]
) -> str:
    """Return the digest of all that two equal builds share.

    SHA-256 over a line ``NAME DIGEST`` per covered attribute, in schema order,
    then per dataset, in the order of the digest table.
    """
    lines = [(s.name, attribute_digest(s, attributes[s.name])) for s in ATTRIBUTES if s.in_content]
    return _lines_digest([*lines, *table])


def root_digest(content: str, attributes: Mapping[str, bytes | NDArray[np.generic]]) -> str:
    """Return the digest over the content digest and what that leaves out."""
    names = ("producer_version", "tables_by", "source_paths")
    lines = [(n, attribute_digest(ATTRIBUTE_OF_NAME[n], attributes[n])) for n in names]
    return _lines_digest([("content_digest", content), *lines])
