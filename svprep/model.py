"""The arrays that pass between stages.

Every table is a frozen dataclass of C-contiguous arrays with fixed dtypes.
Faces, vertices, components and edges are grouped by object; an object's part
of a table is the half-open range ``start[i]:start[i + 1]`` of its offset array.

    SourceMesh  --weld-->  Mesh  --repair-->  Mesh + Adjacency + findings
                --planes-->  PlaneTable  --edges-->  EdgeTable
    Mesh  --scene tree-->  SceneTree  --clamp, per light-->  ClampTable

Frames: a *source* position is in the file's own coordinates (float64, metres,
+z up); a *cache* position is ``source - grid.origin_m``, an exact multiple of
``grid.step_m`` that float32 holds without rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import Final

import numpy as np
from numpy.typing import NDArray

NO_INDEX: Final = 0xFFFFFFFF
"""The one sentinel of every uint32 index: no face, no edge, no object."""

MOST_TILT_RAD: Final = 2e-4
"""[rad]: a face shares a plane record only within this tilt. A face's own facing and
its record's then differ only for a light that grazes both this closely, which is
the angle below which no shadow is decidable."""

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
I8 = NDArray[np.int8]
I16 = NDArray[np.int16]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]
BOOL = NDArray[np.bool_]


class EdgeKind(IntEnum):
    """What an edge record is. Values are stored in the cache."""

    PAIR = 0
    """An edge of exactly two faces that wind consistently."""
    BORDER = 1
    """One face: an edge with a single face, or half of a cut edge, whose two
    faces run the same way and cannot be turned to agree."""
    SPLIT = 2
    """From an edge of three or more faces: a consistently wound pair of them,
    or one left over (Steiner 2006, A.2, edge duplication)."""


class EdgeFlag(IntFlag):
    """Bits of `EdgeTable.flags`: the kind in bits 0-1, planar in bit 2."""

    KIND_MASK = 3
    PLANAR = 4


class ComponentFlag(IntFlag):
    """Bits of `Components.flags`."""

    CLOSED = 1
    """Every edge record of the component holds two of its faces."""
    SOLID = 2
    """Closed, outward and free of self-intersection: safe for the closed volume."""
    INVERTED = 4
    """Closed, and turned outward by the repair."""


@dataclass(frozen=True, slots=True)
class SourceFile:
    """One input file as it was read."""

    path: str
    """As the user named it."""
    format: str
    """``"obj"``, ``"ply"``, ``"stl"``, ``"off"``, ``"glb"``, ``"gltf"``, ``"cityjson"``,
    ``"cityjsonseq"``, ``"citygml"``, ``"b3dm"`` or ``"3dtiles"``."""
    n_bytes: int
    """Of the file itself, on disk."""
    sha256: str
    """Of the file's bytes on disk (of the compressed bytes for ``.gz``); for glTF
    followed by the bytes of each buffer file beside it that was read, in the
    order of its ``buffers``; for 3D Tiles of the tileset followed by the SHA-256
    (32 bytes) of each file that was read, in the order of reading."""
    crs: str = ""
    """Coordinate reference system as the file states it, ``""`` where it states none."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where on Earth a model stands."""

    crs: str = ""
    """Of the source positions: projected, in metres, what pyproj understands
    (``"EPSG:28992"``, WKT); ``""`` when unknown."""
    latitude_deg: float | None = None
    """In WGS 84, of the middle of the model; None where it was not computed."""
    longitude_deg: float | None = None
    convergence_deg: float | None = None
    """There, from true north to grid north (+y), clockwise."""


@dataclass(frozen=True, slots=True)
class FaceFindings:
    """Defects that are attached to single source faces, one row each."""

    code: NDArray[np.uint16]
    """``(n,)``: `Code` values (see `svprep.defects`)."""
    object_index: U32
    """``(n,)``: index into the object list."""
    source_face: U32
    """``(n,)``: 0-based ordinal of the face in its source file."""


@dataclass(frozen=True, slots=True)
class SourceMesh:
    """What a reader returns: triangles in source coordinates, grouped by object.

    Nothing has been welded, moved, flipped or dropped yet, except source faces
    that are not surfaces at all (fewer than three corners), which
    `face_findings` lists.
    """

    positions: F64
    """``(n_vertices, 3)`` [m], every one finite; some may be unused."""
    faces: U32
    """``(n_faces, 3)``, indices into `positions`; repeated corners are allowed."""
    object_face_start: I64
    """``(n_objects + 1,)``: object i owns the faces ``[start[i], start[i+1])``."""
    source_face: U32
    """``(n_faces,)``: 0-based ordinal of the polygon that each triangle came
    from, in the order of its source file."""
    object_names: tuple[str, ...]
    object_source: U32
    """``(n_objects,)``: index into `sources`."""
    sources: tuple[SourceFile, ...]
    face_findings: FaceFindings
    """What the reader itself found (short or non-planar polygons), ascending by object."""
    notes: tuple[str, ...]
    """One line each on what the file holds that is not a surface (lines,
    points, empty groups) and on conversions made (y up to z up)."""
    object_types: tuple[str, ...] = ()
    """``(n_objects,)``: ``"Building"``, ``"TINRelief"``; ``""`` where none is
    stated. Empty: none is stated of any."""
    object_parents: tuple[str, ...] = ()
    """``(n_objects,)``: id of the object that each is a part of, ``""`` if of none.
    A parent without a surface of its own is no object here. Empty: none of any."""
    surface_names: tuple[str, ...] = ("",)
    """What polygons are, as their file names it: ``"RoofSurface"``, ``"Window"``.
    The first is ``""``: not stated. At most 256."""
    surface_of_polygon: U8 = field(default_factory=lambda: np.zeros(0, np.uint8))
    """``(polygon_start[-1],)``: index into `surface_names`, by source polygon."""
    polygon_start: I64 = field(default_factory=lambda: np.zeros(1, np.int64))
    """``(n_sources + 1,)``: source i has the entries ``[start[i], start[i + 1])`` of
    `surface_of_polygon`, numbered as `source_face` does; none where it states none.
    One zero: no source states any."""
    place: Place = Place()


@dataclass(frozen=True, slots=True)
class Grid:
    """The quantisation grid: cache position = integer * step_m, |integer| <= 2**24."""

    step_m: float
    """[m], a power of two."""
    origin_m: F64
    """``(3,)`` [m], a multiple of the step: source = origin + cache position."""


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles on the grid, welded per object; vertices and faces grouped by object."""

    grid: Grid
    positions: F32
    """``(n_vertices, 3)`` [m] in the cache frame, exact multiples of the step. A build
    numbers vertices in the order in which its faces use them."""
    faces: U32
    """``(n_faces, 3)``, indices into `positions`, none with a repeated corner
    or zero area."""
    object_vertex_start: I64
    """``(n_objects + 1,)``"""
    object_face_start: I64
    """``(n_objects + 1,)``"""
    source_face: U32
    """``(n_faces,)``: 0-based ordinal of the source polygon in its file."""


@dataclass(frozen=True, slots=True)
class Components:
    """Connected components over edge records with two faces, grouped by object."""

    object_start: I64
    """``(n_objects + 1,)``: components of each object."""
    face_start: I64
    """``(n_components + 1,)``: faces are sorted by (object, component)."""
    edge_start: I64
    """``(n_components + 1,)``: so are edge records."""
    flags: U8
    """``(n_components,)``: `ComponentFlag` bits."""


@dataclass(frozen=True, slots=True)
class PlaneTable:
    """Plane records shared by connected faces that are coplanar within a tolerance."""

    planes: F64
    """``(n_planes, 4)``: ``(nx, ny, nz, d)`` in the cache frame, not normalised:
    n = (b - a) x (c - a) [m^2] exactly, d = -n . a [m^3]."""
    plane_of_face: U32
    """``(n_faces,)``"""
    tolerance_m: float
    """[m]: no vertex of a face lies farther from its record's plane. Nor is the
    face tilted against it by more than `MOST_TILT_RAD`."""


@dataclass(frozen=True, slots=True)
class EdgeTable:
    """Every edge record: a pair of faces, or a single one. None is dropped.

        v1          `left` traverses v0 -> v1, `right` the other way.
        |           A record of one face holds NO_INDEX on the other side.
    left|right
        |
        v0
    """

    rows: U32
    """``(n_edges, 4)``: ``[v0, v1, f_left, f_right]``, ``v0 < v1``, sorted by
    (object, component, v0, v1, f_left)."""
    flags: U8
    """``(n_edges,)``: `EdgeKind` in bits 0-1, `EdgeFlag.PLANAR` in bit 2."""


@dataclass(frozen=True, slots=True)
class Labels:
    """What the source files say of objects and faces beyond their geometry."""

    object_types: tuple[str, ...]
    """``(n_objects,)``: ``""`` where none is stated."""
    object_parents: tuple[str, ...]
    """``(n_objects,)``: id of the object that each is a part of, or ``""``."""
    surface_names: tuple[str, ...]
    """At most 256, the first ``""``."""
    surface_of_face: U8
    """``(n_faces,)``: index into `surface_names`."""

    @classmethod
    def none(cls, n_objects: int, n_faces: int) -> Labels:
        """Return those of files that state nothing."""
        nothing = ("",) * n_objects
        return cls(nothing, nothing, ("",), np.zeros(n_faces, np.uint8))


@dataclass(frozen=True, slots=True)
class RepairRecord:
    """Every decision of weld and repair, so that it can be listed and checked."""

    defect_counts: U32
    """``(n_objects, len(DEFECTS))``: how often each defect occurs in each
    object; column j is the j-th code of `svprep.defects.DEFECTS`."""
    source_triangles: U32
    """``(n_objects,)``: triangles before anything was dropped."""
    source_digest: NDArray[np.uint64]
    """``(n_objects, 2)``: 128 bits of what the sources say of each object's shape, by
    which a later build knows it again; see `svprep.content`."""
    face_findings: FaceFindings
    """Defects of single source faces: every dropped or kept-with-a-remark face,
    sorted by (object, code, source face)."""
    flipped_faces: U32
    """``(n_flipped,)``, ascending: faces of the mesh wound against their source."""


@dataclass(frozen=True, slots=True)
class SilhouetteTree:
    """A hierarchy over the searched edges of objects, for one kind of bounds."""

    edge: U32
    """``(n_indexed_edges,)``: edge records in the order of the tree, per object."""
    blocks: I16
    """``(n_blocks, 8, 8)``: bounds of 8 children a block; `SilhouetteIndex`."""
    expected_work: F32
    """``(n_trees, 2)``: edges and nodes that a query tests on average over all lights,
    estimated from the bounds."""


@dataclass(frozen=True, slots=True)
class SilhouetteIndex:
    """Two hierarchies over the pairs that may be silhouette, for objects with many.

    Searched are the records of kind `PAIR` that are not planar. Edges, in the order
    of a tree, fill leaves of 8; leaves fill blocks of 8 lanes, blocks the blocks
    above, up to one. An object's blocks follow each other level by level, from the
    top: block b of a level bounds the blocks ``8 b .. 8 b + 7`` of the next.

        blocks[b, number, lane]     dual box      sphere and cone
                  0 1 2 3           its centre    centre (x, y, z), radius
                  4 5 6 7           half extents  axis (x, y, z), sine of half-angle

    All in the object's frame: about its centre, in units of its radius. A plane
    record is the dual point ``(n / |n|, (d + n . c) / (r |n|))``, a light
    ``((L - w c) / r, w)``. Numbers are int16 in units of 1 / 32000, the fourth of each
    dual point in 2 / 32000. A sine of 1 (32000) bounds nothing.
    """

    objects: U32
    """``(n_trees,)``, ascending: the objects that have trees."""
    frames: F32
    """``(n_trees, 4)``: centre and radius of each [m]."""
    pair_start: I64
    """``(n_trees + 1,)``: where each one's edges begin in either tree."""
    cones: SilhouetteTree
    hextree: SilhouetteTree


@dataclass(frozen=True, slots=True)
class ObjectTables:
    """The tables of whole objects that depend on nothing but each object and the grid.

    So those of a city are those of its objects, one after the other, with the indices
    counted on.
    """

    mesh: Mesh
    components: Components
    planes: PlaneTable
    edges: EdgeTable
    index: SilhouetteIndex
    repair: RepairRecord


@dataclass(frozen=True, slots=True)
class SceneTree:
    """Where things are: a tree over objects, and one over clusters of nearby faces.

    A cluster is 1 to 8 faces of one object, the ones that clamping takes for one receiver.
    Both trees have eight children a node and no pointers: the leaves, in their order, fill
    the nodes of level 0, these fill the nodes of level 1, and so on up to one:

        leaf   0 1 .. 7  8 .. 15  16 .. 23     node b of level 0 holds leaves 8 b .. 8 b + 7,
        level 0   [0]      [1]       [2]       node b of level l + 1 the nodes
        level 1            [0]                 8 b .. 8 b + 7 of level l.

    Nodes are stored from level 0 up. A box is ``(x0, y0, z0, x1, y1, z1)``, exact.
    """

    objects: U32
    """``(n_objects,)``: the leaves of the tree over objects."""
    object_boxes: F32
    """``(n_objects, 6)`` [m], in the order of objects, not of leaves; one without faces
    holds infinities, x0 > x1."""
    object_nodes: F32
    """``(n_object_nodes, 6)`` [m]"""
    faces: U32
    """``(n_faces,)``: faces in the order of clusters."""
    cluster_start: I64
    """``(n_clusters + 1,)``: cluster i, leaf i of its tree: ``faces[start[i]:start[i + 1]]``."""
    cluster_nodes: F32
    """``(n_cluster_nodes, 6)`` [m]"""


@dataclass(frozen=True, slots=True)
class ClampTable:
    """Per light and caster: the intervals in which a shadow can be received.

    A caster is a component.

    Sun: a light frame has the axes u and v across the light and the depth t along it, away
    from it, all [m] from the origin of the cache frame. A segment is the part of the
    caster's shadow with ``near <= t - slope_u u - slope_v v <= far``: it lies between two
    parallel planes, across the light where the slopes are 0.

    Point light L: a segment holds the points ``L + k (x - L)`` with ``near <= k <= far`` of
    the points x of the caster; slopes are 0, and the frame is x, y, z.

    A caster's segments follow each other away from the light; those with slopes may overlap,
    and a point in two of them is counted twice. The first one begins at the caster itself,
    whatever its `near`. `far` may be infinite.
    """

    specs: tuple[str, ...]
    """``(n_lights,)``: each light as the user named it."""
    lights: F32
    """``(n_lights, 4)``: in the cache frame."""
    frames: F64
    """``(n_lights, 3, 3)``: rows u, v, t."""
    facts: F64
    """``(n_lights, 5)``: costs of a vertex and of a square metre of side or cap; surface
    [m^2] of all volumes unclamped (to the end of the scene), with each caster clamped to
    its own box alone, and clamped. Each is a sum of whole `ClampScene.unit_m2`, below 2**53
    of them exact, so the same in whatever order casters are added."""
    light_start: I64
    """``(n_lights + 1,)``: where each light's segments begin."""
    segment_start: U32
    """``(n_lights, n_components + 1)``: where each caster's begin, counted from the light's."""
    depths: F32
    """``(n_segments, 2)``: near and far."""
    slopes: I16
    """``(n_segments, 2)``: along u and v, in units of 1 / 512."""

    def __len__(self) -> int:
        """Return the number of lights."""
        return len(self.specs)


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Prepared:
    """A whole prepared city: what `pipeline.prepare` returns and a cache holds."""

    sources: tuple[SourceFile, ...]
    object_names: tuple[str, ...]
    object_source: U32
    """``(n_objects,)``: index into `sources`."""
    labels: Labels
    place: Place
    mesh: Mesh
    components: Components
    planes: PlaneTable
    edges: EdgeTable
    index: SilhouetteIndex
    scene: SceneTree
    clamp: ClampTable
    """Of the lights that the build was asked for, or that were added since; maybe none."""
    repair: RepairRecord
    config: dict[str, object]
    """What the build was asked for: JSON values only; the same configuration and
    sources give identical tables."""
    notes: tuple[str, ...]
