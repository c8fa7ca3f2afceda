"""Wind every face alike: patches by spanning forest, closed components outward.

One pass over a set of objects

    coincident faces that run the same way     -> one stays, the rest are dropped
    patches over edges of exactly two faces    -> wound alike, the majority wins
    edges paired, faces connected through pairs -> components
    closed components of negative volume       -> turned outward

may change what the next pass would find (a turned face can become a duplicate,
a turned component pairs differently at an edge of several faces), so objects
that changed are passed again until nothing does. It ends: every pass that goes
on either drops a face or raises the total signed volume, of which there are
finitely many values. So repairing a repaired mesh changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svprep.errors import InternalError
from svprep.kernels.rows import first_equal_row
from svprep.kernels.surface import component_volumes, face_normals
from svprep.kernels.union_find import union_with_parity
from svprep.model import BOOL, F64, I32, I64, U32, Mesh
from svprep.parallel import for_ranges
from svprep.repair.split import (
    EdgeGroups,
    connect,
    doubles,
    group_edges,
    loose_faces,
    pair_edges,
)

_FLAT = 1e-14
"""A signed volume below this share of its uncancelled sum is zero in float64."""
_MOST_PASSES = 1000


@dataclass(frozen=True, slots=True)
class Winding:
    """Which faces of a mesh stay, which are turned, and how they then hang together."""

    is_kept: BOOL
    """``(n_faces,)``: false for duplicates, of which the rest says nothing."""
    is_flipped: BOOL
    """``(n_faces,)``"""
    mate: I32
    """``(3 n_faces,)``: the half-edge that each one is paired with, or -1. Numbered as
    faces are wound in the mesh, before any is turned."""
    root: I32
    """``(n_faces,)``: the lowest face of each one's component."""
    is_closed: BOOL
    """``(n_faces,)``: of the component whose lowest face it is."""
    is_flat: BOOL
    """``(n_faces,)``: whether that component's volume is zero."""
    n_opposite: I64
    """``(n_objects,)``: faces that repeat an earlier one the other way round."""
    n_passes: int


@dataclass(frozen=True, slots=True)
class Part:
    """Faces of some of a mesh's objects, with vertices numbered as in the mesh."""

    faces: U32
    face_start: I64
    vertex_begin: I64
    vertex_end: I64
    points: I32


def whole(mesh: Mesh, points: I32) -> Part:
    """Return all of `mesh` as a `Part`. ``points``: grid coordinates."""
    return Part(
        faces=mesh.faces,
        face_start=mesh.object_face_start,
        vertex_begin=mesh.object_vertex_start[:-1],
        vertex_end=mesh.object_vertex_start[1:],
        points=points,
    )


def wind(mesh: Mesh, points: I32) -> Winding:
    """Decide which faces stay and which are turned, so that faces wind alike.

    Parameters
    ----------
    mesh : Mesh
    points : ndarray
        ``(n_vertices, 3) int32``: grid coordinates of its vertices.

    Notes
    -----
    O(n log n) at worst, near-linear in faces and in components. Patches without
    a consistent winding (Moebius strips) are wound along a spanning forest of
    their longest edges, so that the outcome does not depend on face order.
    """
    n_faces = len(mesh.faces)
    is_kept = np.ones(n_faces, bool)
    is_flipped = np.zeros(n_faces, bool)
    wound = Wound.nothing(n_faces)
    twins = _coincident_faces(mesh)
    unsettled: np.ndarray | None = None  # objects still to pass; None for all
    for n_passes in range(1, _MOST_PASSES + 1):
        is_kept[_same_way_again(twins, is_kept, is_flipped)] = False
        part, face_of = _take(mesh, points, is_kept, unsettled)
        flips = is_flipped[face_of]
        found, turned, crowded = _wind_part(part, flips)
        wound = found if len(face_of) == n_faces else wound.replaced(face_of, found)
        is_flipped[face_of] = flips ^ turned
        changed = _objects_of(mesh, face_of[turned]) & _objects_of(mesh, face_of[crowded])
        if not changed.any():
            return Winding(
                is_kept=is_kept,
                is_flipped=is_flipped,
                mate=wound.mate,
                root=wound.root,
                is_closed=wound.is_closed,
                is_flat=wound.is_flat,
                n_opposite=_count_opposite(mesh, twins, is_kept),
                n_passes=n_passes,
            )
        unsettled = changed
    raise InternalError(
        f"winding did not settle in {_MOST_PASSES} passes; still changing: "
        f"{int(unsettled.sum()) if unsettled is not None else 0} objects"
    )


@dataclass(frozen=True, slots=True)
class Wound:
    """How faces hang together once they are wound; as in `Winding`."""

    mate: I32
    root: I32
    is_closed: BOOL
    is_flat: BOOL

    @classmethod
    def nothing(cls, n_faces: int) -> Wound:
        """Return what is known of faces before any is looked at."""
        nowhere = np.full(3 * n_faces, -1, np.int32)
        root = np.arange(n_faces, dtype=np.int32)
        return cls(nowhere, root, np.zeros(n_faces, bool), np.zeros(n_faces, bool))

    def replaced(self, face_of: I64, part: Wound) -> Wound:
        """Return this with what is known of some faces, ``face_of (n,)``, all of their objects."""
        number = face_of.astype(np.int32)
        mate = 3 * number[part.mate // 3] + part.mate % 3
        mate[part.mate < 0] = -1
        whole = Wound(
            mate=self.mate.copy(),
            root=self.root.copy(),
            is_closed=self.is_closed.copy(),
            is_flat=self.is_flat.copy(),
        )
        whole.mate.reshape(-1, 3)[face_of] = mate.reshape(-1, 3)
        whole.root[face_of] = number[part.root]
        whole.is_closed[face_of] = part.is_closed
        whole.is_flat[face_of] = part.is_flat
        return whole


def _wind_part(part: Part, flips: BOOL) -> tuple[Wound, BOOL, I32]:
    """Wind faces alike and outward.

    Returns
    -------
    Wound
    ndarray
        ``(n_faces,) bool``: the faces that were turned.
    ndarray
        A face of each edge of more than two.
    """
    groups = group_edges(part.faces, part.face_start, part.vertex_begin, part.vertex_end)
    turned, patch = _wind_patches(part, flips, groups)
    flips = flips ^ turned
    mate = pair_edges(part.points, part.faces, flips, groups, loose_faces(patch, groups))
    # Faces of a patch that its winding does not fit still hang together over the others.
    root = connect(mate, patch, groups)
    every = np.arange(len(root), dtype=np.int32)
    volume, is_flat = signed_volumes(part.points, part.faces, flips, root, every)
    closed = is_closed(mate, root, len(root))
    # Turned as a whole, a component keeps its pairs, save at edges of more than two.
    turned ^= (closed & (volume < 0.0) & ~is_flat)[root]
    crowded = groups.order[groups.start[:-1][groups.n_faces_of_edge > 2]] // np.int32(3)
    return Wound(mate=mate, root=root, is_closed=closed, is_flat=is_flat), turned, crowded


def _objects_of(mesh: Mesh, faces: I64) -> BOOL:
    """Return ``(n_objects,)``: whether each has one of these faces."""
    has_face = np.zeros(len(mesh.object_face_start) - 1, bool)
    has_face[np.searchsorted(mesh.object_face_start, faces, side="right") - 1] = True
    return has_face


def _take(mesh: Mesh, points: I32, is_kept: BOOL, objects: BOOL | None) -> tuple[Part, I64]:
    """Return the kept faces of some objects as a `Part`, and each one's number in `mesh`."""
    chosen = is_kept
    if objects is not None:
        chosen = is_kept & np.repeat(objects, np.diff(mesh.object_face_start))
    face_of = np.flatnonzero(chosen)
    if len(face_of) == len(mesh.faces):
        return whole(mesh, points), face_of
    kept_before = np.concatenate(([0], np.cumsum(chosen)))[mesh.object_face_start]
    begin, end = mesh.object_vertex_start[:-1], mesh.object_vertex_start[1:]
    if objects is not None:
        kept_before = np.concatenate((kept_before[:-1][objects], kept_before[-1:]))
        begin, end = begin[objects], end[objects]
    return (
        Part(
            faces=mesh.faces[face_of],
            face_start=kept_before,
            vertex_begin=begin,
            vertex_end=end,
            points=points,
        ),
        face_of,
    )


@dataclass(frozen=True, slots=True)
class _Twins:
    """Faces that share all three vertices with another, in either direction."""

    face: I64
    group: I64
    """Lowest face of the same three vertices."""
    runs_down: BOOL
    """Whether the face runs against the ascending order of its vertices."""


def _coincident_faces(mesh: Mesh) -> _Twins:
    """Find faces with the same three vertices, whatever their direction."""
    a, b, c = mesh.faces.T
    ascending = np.empty(mesh.faces.shape, np.uint32)
    np.minimum(np.minimum(a, b), c, out=ascending[:, 0])
    np.maximum(np.maximum(a, b), c, out=ascending[:, 2])
    np.subtract(a + b + c, ascending[:, 0] + ascending[:, 2], out=ascending[:, 1])
    first = np.empty(len(mesh.faces), np.int32)

    def work(begin: int, end: int) -> None:
        first_equal_row(ascending.view(np.int32), mesh.object_face_start, begin, end, first)

    for_ranges(mesh.object_face_start, work)
    later = np.flatnonzero(first != np.arange(len(first), dtype=np.int32))
    face = np.union1d(later, first[later])
    corners = mesh.faces[face]
    lowest = corners.argmin(axis=1)
    row = np.arange(len(face))
    runs_down = corners[row, (lowest + 1) % 3] > corners[row, (lowest + 2) % 3]
    return _Twins(face=face, group=first[face].astype(np.int64), runs_down=runs_down)


def _same_way_again(twins: _Twins, is_kept: BOOL, is_flipped: BOOL) -> I64:
    """Return kept faces that repeat another in the same direction.

    One as it was wound in the source stays rather than a turned one, and then
    the lowest, so that how many are turned does not depend on face order.
    """
    kept = is_kept[twins.face]
    face, group = twins.face[kept], twins.group[kept]
    direction = twins.runs_down[kept] ^ is_flipped[face]
    order = np.lexsort((face, is_flipped[face], direction, group))
    again = (group[order][1:] == group[order][:-1]) & (
        direction[order][1:] == direction[order][:-1]
    )
    return face[order][1:][again]


def _count_opposite(mesh: Mesh, twins: _Twins, is_kept: BOOL) -> I64:
    """Count, per object, kept faces that repeat another one the other way round."""
    group, n_alike = np.unique(twins.group[is_kept[twins.face]], return_counts=True)
    owner = np.searchsorted(mesh.object_face_start, group[n_alike > 1], side="right") - 1
    return np.bincount(owner, minlength=len(mesh.object_face_start) - 1)


def opposite_faces(mesh: Mesh) -> I64:
    """Return the faces of a repaired mesh that repeat an earlier one the other way round."""
    twins = _coincident_faces(mesh)
    return twins.face[twins.face != twins.group]


def _wind_patches(part: Part, flips: BOOL, groups: EdgeGroups) -> tuple[BOOL, I32]:
    """Return the faces to turn so that faces over edges of two agree, fewest first.

    And the lowest face that each hangs together with over such edges.
    """
    n_faces = len(part.faces)
    h, g = doubles(groups)
    runs_up = _runs_up(part.faces, flips)
    differ = runs_up[h] == runs_up[g]
    a, b = h // np.int32(3), g // np.int32(3)
    root, turned, conflict = _union(n_faces, a, b, differ)
    if conflict.any():
        # No winding fits all: choose the tree by length, not by face order.
        one_sided = np.zeros(n_faces, bool)
        one_sided[root[a[conflict]]] = True
        among = np.flatnonzero(one_sided[root[a]])
        among = among[_longest_first(part, h[among])]
        _, again, _ = _union(n_faces, a[among], b[among], differ[among])
        turned = np.where(one_sided[root], again, turned)
    if not turned.any():
        return turned, root
    size = np.bincount(root, minlength=n_faces)
    n_turned = np.bincount(root[turned], minlength=n_faces)
    # A tie keeps the patch's lowest face as it is, which is the root.
    return turned ^ (2 * n_turned > size)[root], root


def _union(n_faces: int, a: I32, b: I32, differ: BOOL) -> tuple[I32, BOOL, BOOL]:
    root = np.arange(n_faces, dtype=np.int32)
    turned = np.zeros(n_faces, bool)
    conflict = np.empty(len(a), bool)
    union_with_parity(a, b, differ, root, turned, conflict)
    return root, turned, conflict


def _runs_up(faces: U32, flips: BOOL) -> BOOL:
    """Return ``(3 n_faces,)``: whether each half-edge runs lo -> hi, flips counted."""
    up = np.empty((len(faces), 3), bool)
    for c in range(3):
        np.less(faces[:, c], faces[:, (c + 1) % 3], out=up[:, c])
    up ^= flips[:, None]
    return up.reshape(-1)


def _longest_first(part: Part, half_edges: I32) -> I64:
    """Order half-edges by length, then by the places of their ends: independent of numbering."""
    face, corner = half_edges // 3, half_edges % 3
    p = part.points[part.faces[face, corner]].astype(np.int64)
    q = part.points[part.faces[face, (corner + 1) % 3]].astype(np.int64)
    low, high = np.minimum(p, q), np.maximum(p, q)
    across = q - p
    diagonal = across * np.roll(across, 1, axis=1)  # of the box from low to high: which one
    length = (across**2).sum(axis=1)
    return np.lexsort((*diagonal.T, *high.T, *low.T, -length))


def is_closed(mate: I32, component: I32, n_components: int) -> BOOL:
    """Return ``(n_components,)``: whether no half-edge of the component is single."""
    closed = np.ones(n_components, bool)
    closed[component[np.flatnonzero(mate < 0) // 3]] = False
    return closed


def signed_volumes(
    points: I32, faces: U32, flips: BOOL, component: I32, lowest: I32
) -> tuple[F64, BOOL]:
    """Return each component's signed volume [steps^3], and whether it is zero."""
    normals = np.empty((len(faces), 3))
    face_normals(points, faces, normals)
    volume = np.zeros(len(lowest))
    scale = np.zeros(len(lowest))
    component_volumes(points, faces, normals, flips, component, lowest, volume, scale)
    return volume / 6.0, np.abs(volume) <= _FLAT * scale
