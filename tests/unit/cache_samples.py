"""Small valid `Prepared`, made by hand: what the cache tests write and damage.

Object "roof" is an open strip of two triangles in the plane z = 4 (one record,
one planar pair, four borders); object "tetra" is a closed tetrahedron, and has
silhouette trees of one leaf. Two lights are clamped: the sun at its zenith, and a
lamp. Trees of several levels: `two_spheres`.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from functools import cache
from itertools import pairwise
from unittest.mock import patch

import numpy as np

from svprep.defects import DEFECTS, Code
from svprep.model import (
    NO_INDEX,
    ClampTable,
    Components,
    EdgeFlag,
    EdgeKind,
    EdgeTable,
    FaceFindings,
    Grid,
    Labels,
    Mesh,
    Place,
    PlaneTable,
    Prepared,
    RepairRecord,
    SceneTree,
    SilhouetteIndex,
    SilhouetteTree,
    SourceFile,
)

STEP_M = 2.0**-11


def strip_and_tetrahedron(shift_m: float = 0.0) -> Prepared:
    """Return the sample, its positions moved by `shift_m` (a multiple of the step) along x."""
    positions = np.array(
        [
            # the strip       3---2
            #                 | \ |     seen from above
            #                 0---1
            [0, 0, 4],
            [2, 0, 4],
            [2, 1, 4],
            [0, 1, 4],
            # the tetrahedron
            [5, 0, 0],
            [6, 0, 0],
            [5, 1, 0],
            [5, 0, 1],
        ],
        np.float32,
    )
    positions[:, 0] += np.float32(shift_m)
    faces = np.array(
        [[0, 1, 3], [1, 2, 3], [4, 6, 5], [4, 5, 7], [5, 6, 7], [4, 7, 6]],
        np.uint32,
    )
    plane_of_face = np.array([0, 0, 1, 2, 3, 4], np.uint32)
    first_face = np.array([0, 2, 3, 4, 5])
    a, b, c = (positions[faces[first_face, i]].astype(np.float64) for i in range(3))
    normal = np.cross(b - a, c - a)
    planes = np.column_stack([normal, -(normal * a).sum(1)])
    mesh = Mesh(
        grid=Grid(STEP_M, np.array([85_000.0, 446_000.0, -2.0])),
        positions=positions,
        faces=faces,
        object_vertex_start=np.array([0, 4, 8], np.int64),
        object_face_start=np.array([0, 2, 6], np.int64),
        source_face=np.array([0, 2, 0, 1, 2, 3], np.uint32),
    )
    none = NO_INDEX
    rows = np.array(
        [
            [0, 1, 0, none],
            [0, 3, none, 0],
            [1, 2, 1, none],
            [1, 3, 0, 1],
            [2, 3, 1, none],
            [4, 5, 3, 2],
            [4, 6, 2, 5],
            [4, 7, 5, 3],
            [5, 6, 4, 2],
            [5, 7, 3, 4],
            [6, 7, 4, 5],
        ],
        np.uint32,
    )
    border, pair = int(EdgeKind.BORDER), int(EdgeKind.PAIR)
    flags = [border, border, border, pair | int(EdgeFlag.PLANAR), border] + [pair] * 6
    counts = np.zeros((2, len(DEFECTS)), np.uint32)
    column = list(DEFECTS)
    counts[0, column.index(Code.OPEN_SHELL)] = 4
    counts[0, column.index(Code.DEGENERATE_FACE)] = 1
    counts[1, column.index(Code.FLIPPED_FACE)] = 2
    return Prepared(
        sources=(
            SourceFile("models/sample.obj", "obj", 321, "ab" * 32),
            SourceFile("models/zweite Datei.ply", "ply", 123, "cd" * 32),
        ),
        object_names=("roof", "Türmchen \N{CASTLE}"),
        object_source=np.array([0, 1], np.uint32),
        labels=Labels(
            ("BuildingPart", ""),
            ("Haus 7", ""),
            ("", "RoofSurface"),
            np.array([1, 1, 0, 0, 0, 0], np.uint8),
        ),
        place=Place("EPSG:7415", 51.99, 4.38, -0.78),
        mesh=mesh,
        components=Components(
            object_start=np.array([0, 1, 2], np.int64),
            face_start=np.array([0, 2, 6], np.int64),
            edge_start=np.array([0, 5, 11], np.int64),
            flags=np.array([0, 3], np.uint8),
        ),
        planes=PlaneTable(planes, plane_of_face, tolerance_m=STEP_M / 2),
        edges=EdgeTable(rows, np.array(flags, np.uint8)),
        index=_trees_of_the_tetrahedron(positions[4:], planes[1:]),
        scene=one_cluster_each(mesh),
        clamp=_sun_and_lamp(shift_m),
        repair=RepairRecord(
            defect_counts=counts,
            source_triangles=np.array([3, 4], np.uint32),
            source_digest=np.array([[1, 2], [3, 2**64 - 1]], np.uint64),
            face_findings=FaceFindings(
                code=np.array([101, 201, 201], np.uint16),
                object_index=np.array([0, 1, 1], np.uint32),
                source_face=np.array([1, 0, 3], np.uint32),
            ),
            flipped_faces=np.array([2, 5], np.uint32),
        ),
        config={"weld_tolerance_m": 0.0, "lod": None, "objects": ["building"]},
        notes=("sample.obj: 3 lines are not surfaces and were left out",),
    )


def _trees_of_the_tetrahedron(points: np.ndarray, planes: np.ndarray) -> SilhouetteIndex:
    """Return two trees of one leaf: all six edges in one bound each, lane 0 of one block."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    radius = 1.0  # the corners are 0.87 m from the centre
    length = np.sqrt((planes[:, :3] ** 2).sum(axis=1))
    dual = np.column_stack(
        [
            planes[:, :3] / length[:, None],
            (planes[:, 3] + planes[:, :3] @ centre) / (radius * length),
        ]
    )
    low, high = dual.min(axis=0), dual.max(axis=0)
    box, cone = np.zeros((2, 1, 8, 8), np.int16)
    unit = np.array([1.0, 1.0, 1.0, 2.0]) / 32000.0
    box[0, :4, 0] = np.rint((low + high) / 2.0 / unit)
    box[0, 4:, 0] = np.ceil((high - low) / 2.0 / unit) + 1
    cone[0, 3, 0] = 30_000  # middles of edges are at most 0.5 from the centre
    cone[0, 7, 0] = 32_000  # the normals look every way
    edge = np.arange(5, 11, dtype=np.uint32)
    work = np.array([[6.0, 1.0]], np.float32)
    return SilhouetteIndex(
        objects=np.array([1], np.uint32),
        frames=np.array([[*centre, radius]], np.float32),
        pair_start=np.array([0, 6], np.int64),
        cones=SilhouetteTree(edge, cone, work),
        hextree=SilhouetteTree(edge[::-1].copy(), box, work),
    )


def one_cluster_each(mesh: Mesh) -> SceneTree:
    """Return the scene trees of at most eight objects of 1 to 8 faces: a node over each."""
    boxes = []
    for begin, end in pairwise(mesh.object_face_start.tolist()):
        points = mesh.positions[mesh.faces[begin:end].reshape(-1)]
        boxes.append([*points.min(axis=0), *points.max(axis=0)])
    low, high = np.hsplit(np.array(boxes, np.float32), 2)
    node = np.array([[*low.min(axis=0), *high.max(axis=0)]], np.float32)
    return SceneTree(
        objects=np.arange(len(boxes), dtype=np.uint32),
        object_boxes=np.array(boxes, np.float32),
        object_nodes=node,
        faces=np.arange(len(mesh.faces), dtype=np.uint32),
        cluster_start=mesh.object_face_start,
        cluster_nodes=node.copy(),
    )


def _sun_and_lamp(shift_m: float) -> ClampTable:
    """Return segments of the strip and of the tetrahedron, right but for being any one's.

    Three of the sun's, the strip's second one slanted; three of a lamp's over the strip.
    """
    return ClampTable(
        specs=("dir:0,90", "point:Über,dem,Dach"),
        lights=np.array([[0, 0, 1, 0], [1 + shift_m, 0.5, 10, 1]], np.float32),
        frames=np.array([[[1, 0, 0], [0, -1, 0], [0, 0, -1]], np.eye(3)]),
        facts=np.array([[4, 1, 30, 20, 10], [4, 0.5, 60, 50, 40]], np.float64),
        light_start=np.array([0, 3, 6], np.int64),
        segment_start=np.array([[0, 2, 3], [0, 2, 3]], np.uint32),
        depths=np.array(
            [[-4.1, -3.9], [-1.5, 0.5], [-1.1, 0.1], [0.9, 1.1], [1.25, np.inf], [0.9, 1.5]],
            np.float32,
        ),
        slopes=np.array([[0, 0], [-256, 512], [0, 0], [0, 0], [0, 0], [0, 0]], np.int16),
    )


def no_lights(n_components: int) -> ClampTable:
    """Return the table of a build without lights."""
    return ClampTable(
        specs=(),
        lights=np.zeros((0, 4), np.float32),
        frames=np.zeros((0, 3, 3)),
        facts=np.zeros((0, 5)),
        light_start=np.zeros(1, np.int64),
        segment_start=np.zeros((0, n_components + 1), np.uint32),
        depths=np.zeros((0, 2), np.float32),
        slopes=np.zeros((0, 2), np.int16),
    )


def no_trees() -> SilhouetteIndex:
    """Return the index of a city whose objects are too small for trees."""
    none32 = np.zeros(0, np.uint32)
    tree = SilhouetteTree(none32, np.zeros((0, 8, 8), np.int16), np.zeros((0, 2), np.float32))
    return SilhouetteIndex(
        none32, np.zeros((0, 4), np.float32), np.zeros(1, np.int64), cones=tree, hextree=tree
    )


@cache
def two_spheres() -> Prepared:
    """Return a roof, a sphere and a half sphere: trees of three and of two levels, two lights.

    The half sphere ends in borders, so that some of its records are in no tree.
    """
    # Here, because the tests that kill writers fork a process that needs none of it.
    from svprep.light import parse_lights
    from svprep.pipeline import BuildConfig, prepare
    from svprep.silhouette import index
    from tests.property.meshes import moved, open_shell, side_by_side, source_mesh, sphere

    whole = sphere(24, 32, 50.0)
    half = sphere(16, 24, 30.0)
    upper = half.faces[(half.positions[half.faces, 2] >= -1e-9).all(axis=1)]
    used, faces = np.unique(upper, return_inverse=True)
    dome = source_mesh(half.positions[used], faces.reshape(-1, 3))
    source = side_by_side(
        open_shell(), moved(whole, (200.0, 0.0, 0.0)), moved(dome, (0.0, 200.0, 10.0))
    )
    with patch.object(index, "FEWEST_PAIRS", 64):  # whatever is fastest now
        lights = parse_lights(["dir:135,40", "point:90,60,120"])
        return prepare(source, BuildConfig(), lights=lights)


def assert_same(got: object, expected: object, where: str = "prepared") -> None:
    """Assert that two `Prepared` (or parts of them) are equal, naming what is not."""
    if is_dataclass(expected):
        for field in fields(expected):
            inner = getattr(got, field.name), getattr(expected, field.name)
            assert_same(*inner, f"{where}.{field.name}")
    elif isinstance(expected, np.ndarray):
        assert isinstance(got, np.ndarray), where
        assert got.dtype == expected.dtype, where
        assert np.array_equal(got, expected), where
    else:
        assert got == expected, where


def nothing() -> Prepared:
    """Return a city without a single object."""
    sample = strip_and_tetrahedron()
    one, none32 = np.zeros(1, np.int64), np.zeros(0, np.uint32)
    return Prepared(
        sources=(),
        object_names=(),
        object_source=none32,
        labels=Labels.none(0, 0),
        place=Place(),
        mesh=Mesh(
            grid=sample.mesh.grid,
            positions=np.zeros((0, 3), np.float32),
            faces=np.zeros((0, 3), np.uint32),
            object_vertex_start=one,
            object_face_start=one,
            source_face=none32,
        ),
        components=Components(one, one, one, np.zeros(0, np.uint8)),
        planes=PlaneTable(np.zeros((0, 4)), none32, STEP_M),
        edges=EdgeTable(np.zeros((0, 4), np.uint32), np.zeros(0, np.uint8)),
        index=no_trees(),
        scene=SceneTree(
            objects=none32,
            object_boxes=np.zeros((0, 6), np.float32),
            object_nodes=np.zeros((0, 6), np.float32),
            faces=none32,
            cluster_start=one,
            cluster_nodes=np.zeros((0, 6), np.float32),
        ),
        clamp=no_lights(0),
        repair=RepairRecord(
            defect_counts=np.zeros((0, len(DEFECTS)), np.uint32),
            source_triangles=none32,
            source_digest=np.zeros((0, 2), np.uint64),
            face_findings=FaceFindings(np.zeros(0, np.uint16), none32, none32),
            flipped_faces=none32,
        ),
        config={},
        notes=(),
    )
