"""Change how a city is written down, not what it is: the tables must say the same."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svprep.defects import DEFECTS, Code
from svprep.facing import facing
from svprep.model import NO_INDEX, Prepared, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep.repair.weld import weld
from svprep.report import component_counts, edge_counts
from tests.dataset.datasets import DATA, SHARED, build, label

CANDIDATES = [
    DATA / "small_city.obj.gz",
    SHARED / "cities/campus_lod1.obj",
    SHARED / "cities/amsterdam_station.glb",
    SHARED / "broken/chair_model.obj",
    SHARED / "broken/beetle.obj",
    SHARED / "broken/ogre.obj.gz",
    SHARED / "broken/bunny.ply",
]
FILES = [path for path in CANDIDATES if path.exists()]
SHIFT_M = np.array([390000.0, 5820000.0, 40.0])

Change = Callable[[SourceMesh], SourceMesh]


def on_grid(source: SourceMesh, prepared: Prepared) -> SourceMesh:
    """Return the source with its used vertices where the grid puts them.

    A vertex that lies exactly between two steps rounds up, which a turn cannot
    keep; on the grid nothing is left to round.
    """
    grid = prepared.mesh.grid
    return replace(
        source,
        positions=np.floor(source.positions / grid.step_m + 0.5) * grid.step_m,
    )


def without_coincident(source: SourceMesh) -> SourceMesh:
    """Return the source with one face left of each three corners.

    Two faces on the same corners are duplicates or opposites, as they happen to
    be wound; only where there are none does a flip change nothing that counts.
    """
    welded = weld(source)[0]
    _, first = np.unique(np.sort(welded.faces, axis=1), axis=0, return_index=True)
    keep = np.sort(first)
    return replace(
        source,
        positions=welded.positions.astype(np.float64) + welded.grid.origin_m,
        faces=welded.faces[keep],
        source_face=welded.source_face[keep],
        object_face_start=np.searchsorted(keep, welded.object_face_start),
    )


def shuffled_faces(source: SourceMesh) -> SourceMesh:
    rng = np.random.default_rng(1)
    order = np.concatenate(
        [
            begin + rng.permutation(end - begin)
            for begin, end in zip(
                source.object_face_start[:-1], source.object_face_start[1:], strict=True
            )
        ]
    )
    faces = source.faces[order]
    turn = rng.integers(3, size=len(faces))
    faces = faces[np.arange(len(faces))[:, None], (np.arange(3) + turn[:, None]) % 3]
    return replace(source, faces=faces, source_face=source.source_face[order])


def shuffled_objects(source: SourceMesh) -> SourceMesh:
    order = np.random.default_rng(2).permutation(len(source.object_names))
    start = source.object_face_start
    faces = np.concatenate([np.arange(start[i], start[i + 1]) for i in order])
    return replace(
        source,
        faces=source.faces[faces],
        source_face=source.source_face[faces],
        object_face_start=np.concatenate(([0], np.cumsum(np.diff(start)[order]))),
        object_names=tuple(source.object_names[i] for i in order),
        object_source=source.object_source[order],
    )


def unwelded(source: SourceMesh) -> SourceMesh:
    corners = source.faces.reshape(-1)
    return replace(
        source,
        positions=source.positions[corners],
        faces=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
    )


def turned(source: SourceMesh) -> SourceMesh:
    x, y, z = source.positions.T
    return replace(source, positions=np.column_stack((-y, x, z)))


def moved(source: SourceMesh) -> SourceMesh:
    return replace(source, positions=source.positions + SHIFT_M)


def flipped(source: SourceMesh) -> SourceMesh:
    chosen = np.random.default_rng(3).random(len(source.faces)) < 0.3
    faces = source.faces.copy()
    faces[chosen] = faces[chosen][:, [0, 2, 1]]
    return replace(source, faces=faces)


def counts(prepared: Prepared) -> dict[str, object]:
    """Return everything that can be counted, welding aside."""
    defects = prepared.repair.defect_counts.sum(axis=0)
    skipped = Code.UNWELDED_VERTEX
    return {
        "faces": len(prepared.mesh.faces),
        "vertices": len(prepared.mesh.positions),
        "planes": len(prepared.planes.planes),
        **edge_counts(prepared.edges),
        **component_counts(prepared.components.flags),
        "defects": {c.name: int(n) for c, n in zip(DEFECTS, defects, strict=True) if c != skipped},
    }


def multiplicities(
    prepared: Prepared, light: np.ndarray, back: Callable[[np.ndarray], np.ndarray]
) -> Counter:
    """Return the multiset of (edge end positions, oriented multiplicity).

    ``back`` maps positions to the frame that is compared. Rows over one
    geometric edge are summed per object, since splitting may differ.
    """
    side = facing(prepared.planes.planes, light).astype(np.int64)
    side = np.append(side[prepared.planes.plane_of_face], 0)
    rows = prepared.edges.rows
    held = np.where(rows[:, 2:] == NO_INDEX, len(side) - 1, rows[:, 2:])
    m = side[held[:, 0]] - side[held[:, 1]]
    key = rows[:, 0].astype(np.uint64) << np.uint64(32) | rows[:, 1]
    edges, inverse = np.unique(key, return_inverse=True)
    total = np.bincount(inverse, m, len(edges)).astype(np.int64)
    found = np.flatnonzero(total)
    a, b = edges[found] >> np.uint64(32), edges[found] & np.uint64(NO_INDEX)
    # The sum runs a -> b: bring every edge to one orientation by position.
    p, q, total = back(prepared.mesh.positions[a]), back(prepared.mesh.positions[b]), total[found]
    table = Counter()
    for p_row, q_row, times in zip(p.tolist(), q.tolist(), total.tolist(), strict=True):
        one, other = tuple(p_row), tuple(q_row)
        table[(one, other, times) if one < other else (other, one, -times)] += 1
    return table


CHANGES: dict[str, Change] = {
    "shuffled_faces": shuffled_faces,
    "shuffled_objects": shuffled_objects,
    "unwelded": unwelded,
    "turned": turned,
    "moved": moved,
    "flipped": flipped,
}


@pytest.mark.parametrize("change", list(CHANGES))
@pytest.mark.parametrize("path", FILES, ids=label)
def test_same_city_written_otherwise(path: Path, change: str) -> None:
    first = build(path)
    assert not isinstance(first, str), first
    source = on_grid(first.source, first.prepared)
    if change == "flipped":
        source = without_coincident(source)
    before = prepare(source, BuildConfig())
    after = prepare(CHANGES[change](source), BuildConfig())
    assert after.mesh.grid.step_m == before.mesh.grid.step_m
    expected, got = counts(before), counts(after)
    if change == "flipped":
        # Where three faces meet, which of them pair depends on how they were wound.
        crowded = expected["defects"]["NONMANIFOLD_EDGE"] > 0
        for name in ("FLIPPED_FACE", "INVERTED_COMPONENT"):
            expected["defects"].pop(name), got["defects"].pop(name)
        if crowded:
            expected = {k: expected[k] for k in ("faces", "vertices")}
            got = {k: got[k] for k in ("faces", "vertices")}
    assert got == expected

    rng = np.random.default_rng(5)
    direction = rng.normal(size=3).astype(np.float32)
    origin = before.mesh.grid.origin_m
    point = (before.mesh.positions.mean(axis=0) + [0, 0, 20]).astype(np.float32)

    def same(positions: np.ndarray) -> np.ndarray:
        return positions.astype(np.float64) + after.mesh.grid.origin_m - origin

    def unturn(positions: np.ndarray) -> np.ndarray:
        x, y, z = (positions.astype(np.float64) + after.mesh.grid.origin_m).T
        return np.column_stack((y, -x, z)) - origin

    def unshift(positions: np.ndarray) -> np.ndarray:
        return positions.astype(np.float64) + (after.mesh.grid.origin_m - SHIFT_M) - origin

    back = {"turned": unturn, "moved": unshift}.get(change, same)
    for x, y, z, w in ((*direction, 0.0), (*point, 1.0)):
        light = np.array([x, y, z, w], np.float32)
        other = np.array([-y, x, z, w] if change == "turned" else [x, y, z, w], np.float64)
        if w:  # a point keeps its place among the vertices, whatever the origin
            delta = {"turned": unturn, "moved": unshift}.get(change, same)(np.zeros((1, 3)))[0]
            other[:3] = [x, y, z] - delta if change != "turned" else other[:3]
            if change == "turned":
                sx, sy, sz = np.array([x, y, z]) + origin
                other[:3] = np.array([-sy, sx, sz]) - after.mesh.grid.origin_m
        table = multiplicities(after, other.astype(np.float32), back)
        assert table == multiplicities(before, light, lambda p: p.astype(np.float64))
