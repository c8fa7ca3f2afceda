"""Meshes to test with: strategies for random ones, and a suite of named classes.

Coordinates are small integers wherever a test compares exactly, so that they
lie on any grid and a coincidence is a coincidence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import hypothesis.extra.numpy as hnp
import numpy as np
from hypothesis import strategies as st

from svprep.content import source_digests
from svprep.edges import build_edges
from svprep.model import (
    Components,
    EdgeTable,
    FaceFindings,
    Mesh,
    PlaneTable,
    RepairRecord,
    SourceFile,
    SourceMesh,
)
from svprep.planes import build_planes
from svprep.repair.grid import grid_coordinates
from svprep.repair.stage import Repaired, RepairReport, record, repair
from svprep.repair.weld import WeldReport, weld


@dataclass(frozen=True)
class Built:
    """Everything the stages from weld to edges say about one source mesh."""

    source: SourceMesh
    mesh: Mesh
    weld_report: WeldReport
    repaired: Repaired
    report: RepairReport
    planes: PlaneTable
    edges: EdgeTable
    components: Components
    record: RepairRecord

    @property
    def points(self) -> np.ndarray:
        """``(n_vertices, 3) int32``: grid coordinates of the repaired mesh."""
        return grid_coordinates(self.repaired.mesh.positions, self.mesh.grid)

    @property
    def welded_faces(self) -> np.ndarray:
        """``(n_welded_faces, 3)``: the welded mesh's faces, in the repaired mesh's vertices."""
        return renumbered(self.mesh, self.repaired.mesh)

    @property
    def component_of_face(self) -> np.ndarray:
        sizes = np.diff(self.components.face_start)
        return np.repeat(np.arange(len(sizes)), sizes)

    def faces_of(self, component: int) -> np.ndarray:
        start = self.components.face_start
        return np.arange(start[component], start[component + 1])

    def rows_of(self, component: int) -> np.ndarray:
        start = self.components.edge_start
        return self.edges.rows[start[component] : start[component + 1]]


def renumbered(welded: Mesh, repaired: Mesh) -> np.ndarray:
    """Return the faces of `welded` in the vertices of `repaired`.

    Repair numbers vertices anew, so it is by place that faces of the two are the same:
    within an object no two vertices share one.
    """
    ranks, places = [], []
    for mesh in (welded, repaired):
        sizes = np.diff(mesh.object_vertex_start)
        place = np.column_stack((np.repeat(np.arange(len(sizes)), sizes), mesh.positions))
        rank = np.lexsort(place.T)
        ranks.append(rank)
        places.append(place[rank])
    assert np.array_equal(*places), "repair lost, moved or invented a vertex"
    assert (places[0][1:] != places[0][:-1]).any(axis=1).all(), "two vertices share a place"
    new_from_old = np.empty(len(ranks[0]), np.uint32)
    new_from_old[ranks[0]] = ranks[1]
    return new_from_old[welded.faces]


def build(source: SourceMesh) -> Built:
    mesh, weld_report = weld(source)
    repaired, report = repair(mesh)
    planes = build_planes(repaired)
    edges, components = build_edges(repaired, planes)
    return Built(
        source=source,
        mesh=mesh,
        weld_report=weld_report,
        repaired=repaired,
        report=report,
        planes=planes,
        edges=edges,
        components=components,
        record=record(source, weld_report, report, source_digests(source)),
    )


def source_mesh(
    vertices: np.ndarray, faces: np.ndarray, face_start: list[int] | None = None
) -> SourceMesh:
    """Wrap arrays as a reader would; source faces are numbered like the triangles."""
    face_start = [0, len(faces)] if face_start is None else face_start
    n_objects = len(face_start) - 1
    return SourceMesh(
        positions=np.ascontiguousarray(vertices, np.float64).reshape(-1, 3),
        faces=np.ascontiguousarray(faces, np.uint32).reshape(-1, 3),
        object_face_start=np.array(face_start, np.int64),
        source_face=np.arange(len(faces), dtype=np.uint32),
        object_names=tuple(f"object {i}" for i in range(n_objects)),
        object_source=np.zeros(n_objects, np.uint32),
        sources=(SourceFile("test.obj", "obj", 0, ""),),
        face_findings=FaceFindings(
            code=np.zeros(0, np.uint16),
            object_index=np.zeros(0, np.uint32),
            source_face=np.zeros(0, np.uint32),
        ),
        notes=(),
    )


def joined(*meshes: SourceMesh) -> SourceMesh:
    """One object of all faces of all `meshes`, each with its own vertices."""
    offsets = np.cumsum([0, *[len(m.positions) for m in meshes[:-1]]])
    return source_mesh(
        np.vstack([m.positions for m in meshes]),
        np.vstack([m.faces + np.uint32(o) for m, o in zip(meshes, offsets, strict=True)]),
    )


def side_by_side(*meshes: SourceMesh) -> SourceMesh:
    """One object for each of `meshes`."""
    starts = np.cumsum([0, *[len(m.faces) for m in meshes]])
    return replace(
        source_mesh((one := joined(*meshes)).positions, one.faces, [int(start) for start in starts])
    )


def moved(mesh: SourceMesh, shift: tuple[float, float, float]) -> SourceMesh:
    return replace(mesh, positions=mesh.positions + np.array(shift))


def scaled(mesh: SourceMesh, factor: float) -> SourceMesh:
    return replace(mesh, positions=mesh.positions * factor)


def turned(mesh: SourceMesh, faces: np.ndarray | slice = slice(None)) -> SourceMesh:
    """Flip some faces, all by default."""
    corners = mesh.faces.copy()
    corners[faces] = corners[faces][:, [0, 2, 1]]
    return replace(mesh, faces=corners)


def shuffled(mesh: SourceMesh, seed: int) -> tuple[SourceMesh, np.ndarray]:
    """Shuffle the faces of each object and rotate their corners; return ``old_from_new``."""
    rng = np.random.default_rng(seed)
    ranges = zip(mesh.object_face_start[:-1], mesh.object_face_start[1:], strict=True)
    old = np.concatenate([np.zeros(0, np.int64), *[b + rng.permutation(e - b) for b, e in ranges]])
    shift = rng.integers(0, 3, (len(old), 1))
    faces = np.take_along_axis(mesh.faces[old], (np.arange(3) + shift) % 3, axis=1)
    return replace(mesh, faces=faces, source_face=mesh.source_face[old]), old


def unwelded(mesh: SourceMesh) -> SourceMesh:
    """Give every corner a vertex of its own."""
    corners = mesh.faces.reshape(-1)
    return replace(
        mesh,
        positions=mesh.positions[corners],
        faces=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
    )


# The suite ---------------------------------------------------------------------------------------


def cube(size: float = 1.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> SourceMesh:
    vertices = np.array(list(product((0, 1), repeat=3)), float) * size + at
    # Vertex 4 x + 2 y + z; outward.
    faces = [
        *[[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]],
        *[[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]],
    ]
    return source_mesh(vertices, np.array(faces))


def tetrahedron() -> SourceMesh:
    vertices = np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0], [1, 1, 3]])
    return source_mesh(vertices, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]))


def inner_wall() -> SourceMesh:
    """A cube with a wall across its diagonal: four edges of three faces."""
    mesh = cube(2.0)
    return source_mesh(mesh.positions, np.vstack((mesh.faces, [[0, 1, 7], [0, 7, 6]])))


def fan(n: int) -> SourceMesh:
    """n triangles around one edge, at angles of the grid, every other one turned."""
    ring = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]])
    spokes = np.array([ring[i % 8] * (1 + i // 8) + (i // 8, 0) for i in range(n)])
    vertices = np.vstack(([[0, 0, 0], [0, 0, 2]], np.column_stack((spokes, np.ones(n)))))
    faces = [[0, 1, 2 + i] if i % 2 else [1, 0, 2 + i] for i in range(n)]
    return source_mesh(vertices, np.array(faces))


def strip_of_one_side(n: int) -> SourceMesh:
    """A Moebius strip of n quads."""
    angles = np.arange(n) * (2 * np.pi / n)
    vertices = []
    for angle, side in product(angles, (-0.25, 0.25)):
        reach = 1 + side * np.cos(angle / 2)
        rise = side * np.sin(angle / 2)
        vertices.append([reach * np.cos(angle), reach * np.sin(angle), rise])
    faces = []
    for i in range(n):
        p, q = 2 * i, 2 * i + 1
        r, s = (2 * i + 2, 2 * i + 3) if i < n - 1 else (1, 0)
        faces += [[p, q, r], [r, q, s]]
    return source_mesh(np.array(vertices), np.array(faces))


def klein_bottle(n: int = 8, m: int = 6) -> SourceMesh:
    """The figure-8 immersion: closed, one side only, and it crosses itself."""
    vertices = np.empty((n, m, 3))
    for i, j in product(range(n), range(m)):
        u, v = 2 * np.pi * i / n, 2 * np.pi * (j + 0.5) / m
        reach = 3 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
        rise = np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)
        vertices[i, j] = reach * np.cos(u), reach * np.sin(u), rise
    grid = np.arange(n * m).reshape(n, m)
    faces = []
    for i, j in product(range(n), range(m)):
        k = (j + 1) % m
        a, b = grid[i, j], grid[i, k]
        if i + 1 < n:
            c, d = grid[i + 1, j], grid[i + 1, k]
        else:  # after one turn the line v arrives at -v
            c, d = grid[0, m - 1 - j], grid[0, m - 1 - k]
        faces += [[a, c, b], [b, c, d]]
    return source_mesh(vertices.reshape(-1, 3), np.array(faces))


def sphere(n: int = 40, m: int = 60, radius: float = 1000.0) -> SourceMesh:
    """A globe of integer coordinates: 2 m (n - 1) triangles."""
    u = np.pi * np.arange(1, n) / n
    v = 2 * np.pi * np.arange(m) / m
    ring = np.stack(
        [
            np.outer(np.sin(u), np.cos(v)),
            np.outer(np.sin(u), np.sin(v)),
            np.outer(np.cos(u), np.ones(m)),
        ],
        axis=2,
    )
    vertices = np.vstack(([[0, 0, 1], [0, 0, -1]], ring.reshape(-1, 3))) * radius
    at = np.arange(2, 2 + (n - 1) * m).reshape(n - 1, m)
    nxt = np.roll(at, -1, axis=1)
    faces = [np.column_stack((np.zeros(m, int), at[0], nxt[0]))]
    faces.append(np.column_stack((np.ones(m, int), nxt[-1], at[-1])))
    for i in range(n - 2):
        faces.append(np.column_stack((at[i], at[i + 1], nxt[i + 1])))
        faces.append(np.column_stack((at[i], nxt[i + 1], nxt[i])))
    return source_mesh(np.round(vertices), np.vstack(faces))


def double_sheet() -> SourceMesh:
    """A square drawn from both sides: closed, and without volume."""
    mesh = source_mesh(
        np.array([[0, 0, 0], [2, 0, 0], [2, 2, 1], [0, 2, 1]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    return source_mesh(mesh.positions, np.vstack((mesh.faces, mesh.faces[:, ::-1])))


def triple_faces() -> SourceMesh:
    """Three coincident faces, one of them turned, and a neighbour."""
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 1]])
    return source_mesh(vertices, np.array([[0, 1, 2], [2, 1, 0], [1, 2, 0], [1, 3, 2]]))


def soup(n: int = 60, seed: int = 3) -> SourceMesh:
    rng = np.random.default_rng(seed)
    return source_mesh(rng.integers(0, 9, (3 * n, 3)), np.arange(3 * n).reshape(-1, 3))


def crossing_shell() -> SourceMesh:
    """A closed box whose lid dips through its floor."""
    mesh = cube(2.0)
    vertices = np.vstack((mesh.positions, [[1, 1, -1]]))
    sides = mesh.faces[:10]
    lid = [[1, 5, 8], [5, 7, 8], [7, 3, 8], [3, 1, 8]]
    return source_mesh(vertices, np.vstack((sides, lid)))


def twisted_box() -> SourceMesh:
    """A closed bow tie: one half has winding number -1 whichever way it is wound."""
    outline = np.array([[0, 0], [4, 3], [4, 0], [0, 2]])
    vertices = np.vstack([np.column_stack((outline, np.full(4, z))) for z in (0, 2)])
    faces = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
    for i in range(4):
        j = (i + 1) % 4
        faces += [[i, j, 4 + j], [i, 4 + j, 4 + i]]
    return source_mesh(vertices, np.array(faces))


def far_sliver() -> SourceMesh:
    """A closed needle across the whole grid: coordinates at and beside +-2**24."""
    m = 2.0**24
    vertices = np.array([[-m, -m, -m], [m, m, m], [m, m, m - 1], [m - 1, m, m - 2]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    return source_mesh(vertices * 2.0**-10, faces)


def voxels(is_full: np.ndarray) -> SourceMesh:
    """The outward surface between full and empty cells, welded: edges of four faces where
    two cells meet along an edge only."""
    padded = np.pad(is_full, 1)
    quads = []
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        for cell in np.argwhere(padded):
            for up in (0, 1):
                beyond = cell.copy()
                beyond[axis] += 2 * up - 1
                if padded[tuple(beyond)]:
                    continue
                corners = np.repeat(cell[None], 4, axis=0)
                corners[:, axis] += up
                corners[:, i] += [0, 1, 1, 0] if up else [0, 0, 1, 1]
                corners[:, j] += [0, 0, 1, 1] if up else [0, 1, 1, 0]
                quads.append(corners)
    corners = np.array(quads).reshape(-1, 3)
    vertices, number = np.unique(corners, axis=0, return_inverse=True)
    quad = number.reshape(-1, 4)
    return source_mesh(vertices, np.vstack((quad[:, [0, 1, 2]], quad[:, [0, 2, 3]])))


def open_shell() -> SourceMesh:
    mesh = cube()
    return source_mesh(mesh.positions, mesh.faces[1:])


SUITE: dict[str, Callable[[], SourceMesh]] = {
    "nothing": lambda: source_mesh(np.zeros((0, 3)), np.zeros((0, 3)), [0]),
    "empty object": lambda: source_mesh(cube().positions, cube().faces, [0, 0, 12, 12]),
    "single face": lambda: source_mesh(np.eye(3), np.array([[0, 1, 2]])),
    "cube": cube,
    "tetrahedron": tetrahedron,
    "inner wall": inner_wall,
    "fan of three": lambda: fan(3),
    "fan of fifty": lambda: fan(50),
    "touching along a wall": lambda: joined(cube(), cube(1.0, (1, 0, 0))),
    "touching along an edge": lambda: joined(cube(), cube(1.0, (1, 1, 0))),
    "touching at a corner": lambda: joined(cube(), cube(1.0, (1, 1, 1))),
    "Moebius strip": lambda: strip_of_one_side(7),
    "Klein bottle": klein_bottle,
    "flipped patch": lambda: turned(cube(), np.array([3, 5, 6])),
    "inside out": lambda: turned(cube()),
    "touching, inside out": lambda: turned(joined(cube(), cube(1.0, (1, 0, 0)))),
    "nested": lambda: joined(cube(4.0), cube(1.0, (1, 1, 1))),
    "cavity": lambda: joined(cube(4.0), turned(cube(1.0, (1, 1, 1)))),
    "open shell": open_shell,
    "double sheet": double_sheet,
    "triple faces": triple_faces,
    "soup": soup,
    "crossing shell": crossing_shell,
    "twisted box": twisted_box,
    "overlapping cubes": lambda: joined(cube(2.0), cube(2.0, (1, 1, 1))),
    "checkerboard": lambda: voxels(np.indices((2, 2, 2)).sum(axis=0) % 2 == 0),
    "pinched": lambda: voxels(np.array([[[1, 1], [1, 0]], [[1, 0], [1, 1]]], bool)),
    "far sliver": far_sliver,
    "sphere": sphere,
    "two objects": lambda: side_by_side(cube(), turned(cube(1.0, (1, 0, 0))), double_sheet()),
}
"""Named mesh classes, smallest first where it matters to nobody."""

SMALL_SUITE = {name: make for name, make in SUITE.items() if name != "sphere"}


# Strategies --------------------------------------------------------------------------------------


def arrays(
    dtype: type, shape: object, elements: st.SearchStrategy | None = None
) -> st.SearchStrategy[np.ndarray]:
    """Arrays whose every element is drawn: Hypothesis would fill most of them alike."""
    return hnp.arrays(dtype, shape, elements=elements, fill=st.nothing())


@st.composite
def grid_meshes(draw: st.DrawFn, max_faces: int = 14, max_objects: int = 1) -> SourceMesh:
    """Triangles between the points of a cubic grid of 2 to 4 points a side.

    So few places make edges of many faces, duplicates, opposite and degenerate
    faces, and coplanar overlaps common. Some vertices are given twice.
    """
    side = draw(st.integers(2, 4), label="side")
    places = np.array(list(product(range(side), repeat=3)))
    n = draw(st.integers(1, max_faces), label="n_faces")
    faces = draw(
        arrays(np.int64, (n, 3), elements=st.integers(0, 2 * len(places) - 1)), label="faces"
    )
    cuts = draw(st.lists(st.integers(0, n), max_size=max_objects - 1)) if max_objects > 1 else []
    return source_mesh(np.vstack((places, places)), faces, [0, *sorted(cuts), n])


@st.composite
def voxel_meshes(draw: st.DrawFn) -> SourceMesh:
    """Random cells of a 3 x 3 x 3 block: solids that touch along edges and at corners.

    Either one surface of their union, or a cube for each with its party walls.
    Some faces are turned.
    """
    is_full = draw(arrays(bool, (3, 3, 3), elements=st.booleans()), label="cells")
    is_full[1, 1, 1] = True
    if draw(st.booleans(), label="as one surface"):
        mesh = voxels(is_full)
    else:
        mesh = joined(*[cube(1.0, tuple(cell)) for cell in np.argwhere(is_full).astype(float)])
    flips = draw(hnp.arrays(bool, len(mesh.faces), elements=st.booleans(), fill=st.just(False)))
    return turned(mesh, flips) if draw(st.booleans(), label="turn some") else mesh


@st.composite
def solids(draw: st.DrawFn) -> SourceMesh:
    """One to three overlapping, nested or touching boxes and tetrahedra in one object."""
    parts = []
    for _ in range(draw(st.integers(1, 3), label="parts")):
        at = draw(arrays(np.int64, 3, elements=st.integers(0, 4)), label="at")
        if draw(st.booleans(), label="box"):
            size = draw(st.integers(1, 3), label="size")
            part = cube(float(size), tuple(at.astype(float)))
        else:
            part = moved(tetrahedron(), tuple(at.astype(float)))
        parts.append(turned(part) if draw(st.booleans(), label="inside out") else part)
    return joined(*parts)


def any_mesh() -> st.SearchStrategy[SourceMesh]:
    return st.one_of(grid_meshes(), grid_meshes(40, 3), voxel_meshes(), solids())


@st.composite
def lights(draw: st.DrawFn) -> np.ndarray:
    """Directions and points, in general position or along the grid, far and near."""
    exact = draw(st.booleans(), label="on the grid")
    elements = (
        st.integers(-4, 8).map(float)
        if exact
        else st.floats(-8.0, 12.0, width=32).map(lambda x: float(np.float32(x)))
    )
    w = draw(st.sampled_from([0.0, 1.0]), label="w")
    xyz = draw(arrays(np.float64, 3, elements=elements), label="light")
    if w == 0.0 and not xyz.any():
        xyz[2] = 1.0
    return np.array([*xyz, w], np.float32)
