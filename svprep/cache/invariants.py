"""What must hold inside and between the tables of a cache.

Each check names the datasets that it `needs`; it runs only where those are
whole, so that one damaged dataset is reported once and not by all its effects.
Every check is vectorised: O(n), or O(n log n) where edges are sorted. Those of the
silhouette trees are in `tree_invariants`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svprep.cache.checks import Problem, problem_at
from svprep.cache.codec import BLOCK, face_normals, next_half_edge, rows_of_half_edges
from svprep.cache.scene_invariants import SCENE_CHECKS
from svprep.cache.schema import DATASETS, DatasetSpec
from svprep.cache.tables import CheckFunction, Tables, owner_of_rows
from svprep.cache.tree_invariants import TREE_CHECKS
from svprep.defects import DEFECTS
from svprep.model import BOOL, MOST_TILT_RAD, NO_INDEX, U32, ComponentFlag, EdgeFlag, EdgeKind

MAX_STEPS = 2**24


def check_values(spec: DatasetSpec, array: NDArray[Any], sizes: Mapping[str, int]) -> list[Problem]:
    """Return what is wrong with the values of one dataset by its declared role."""
    if spec.refers is None or spec.refers.symbol not in sizes:
        return []
    end = spec.refers.length(sizes)
    if spec.role == "offsets":
        ends_right = array[0] == 0 and array[-1] == end
        message = f"expected offsets that rise from 0 to {end}"
        if not ends_right:
            return [Problem("V301", spec.path, f"{message}, got {array[0]} to {array[-1]}")]
        return problem_at("V301", spec.path, f"{message}; they fall after", array[1:] < array[:-1])
    beyond: NDArray[Any] = np.asarray(array >= end)
    if spec.role == "index_or_none":
        beyond &= array != NO_INDEX
    message = f"expected indices below {end} ({spec.refers}); rows with others"
    return problem_at(
        "V302", spec.path, message, np.asarray(beyond.any(axis=tuple(range(1, beyond.ndim))))
    )


def check_positions(t: Tables) -> list[Problem]:
    """Positions are finite, on the grid, and at most 2^24 steps from zero."""
    bad = np.zeros(len(t["mesh/positions"]), np.bool_)
    for start in range(0, len(bad), BLOCK):
        block = slice(start, start + BLOCK)
        steps = t["mesh/positions"][block].astype(np.float64) / t.step_m
        on_grid = (steps == np.rint(steps)) & (np.abs(steps) <= MAX_STEPS)
        bad[block] = ~on_grid.all(1)
    message = f"expected finite multiples of {t.step_m} m within 2^24 steps; other vertices"
    return problem_at("V303", "mesh/positions", message, bad)


def check_flags(t: Tables) -> list[Problem]:
    """Only known bits; solid and inverted components are closed."""
    parts, edges = t["components/flags"], t["edges/flags"]
    is_closed = (parts & ComponentFlag.CLOSED) != 0
    more = (parts & (ComponentFlag.SOLID | ComponentFlag.INVERTED)) != 0
    known_parts = ComponentFlag.CLOSED | ComponentFlag.SOLID | ComponentFlag.INVERTED
    bad_parts = (parts > int(known_parts)) | (more & ~is_closed)
    known_edges = EdgeFlag.KIND_MASK | EdgeFlag.PLANAR
    bad_edges = (edges > int(known_edges)) | ((edges & EdgeFlag.KIND_MASK) > int(EdgeKind.SPLIT))
    return [
        *problem_at("V304", "components/flags", "unknown or contradicting bits", bad_parts),
        *problem_at("V304", "edges/flags", "unknown bits", bad_edges),
    ]


def check_grouping(t: Tables) -> list[Problem]:
    """Components have faces, and each object's first component starts its faces."""
    first, start = t["objects/component_start"], t["components/face_start"]
    mismatch = start[first] != t["objects/face_start"]
    return [
        *problem_at("V409", "objects", "components reach over the start of", mismatch),
        *problem_at("V409", "components", "no faces in", start[1:] <= start[:-1]),
    ]


def check_faces(t: Tables) -> list[Problem]:
    """Faces use three different vertices of their own object and have an area."""
    faces = t["mesh/face_corners"].reshape(-1, 3)
    owner = owner_of_rows(t["objects/face_start"])
    vertex_start = t["objects/vertex_start"]
    foreign = np.empty(len(faces), np.bool_)
    flat = np.empty(len(faces), np.bool_)
    for start in range(0, len(faces), BLOCK):
        block = slice(start, start + BLOCK)
        own, corner = owner[block, None], faces[block]
        outside = (corner < vertex_start[own]) | (corner >= vertex_start[own + 1])
        foreign[block] = outside.any(1)
        flat[block] = ~face_normals(t["mesh/positions"], corner).any(1)
    return [
        *problem_at("V305", "mesh/face_corners", "vertices of another object in faces", foreign),
        *problem_at("V305", "mesh/face_corners", "faces of zero area", flat),
    ]


def check_planes(t: Tables) -> list[Problem]:
    """Every vertex is near its face's record, and no face is tilted against it."""
    faces, positions = t["mesh/face_corners"].reshape(-1, 3), t["mesh/positions"]
    plane_of_face, d = t["planes/plane_of_face"], t["planes/d"]
    normal_of_plane = face_normals(positions, faces[t["planes/face"]])
    length = np.sqrt((normal_of_plane**2).sum(1))
    # Slack: what float64 itself loses in n . x + d, in units of |n|.
    reach = float(np.abs(positions).max(initial=0.0))
    limit = (t.tolerance_m + 16 * np.finfo(np.float64).eps * reach) * length
    off = np.empty(len(faces), np.bool_)
    against = np.empty(len(faces), np.bool_)
    for start in range(0, len(faces), BLOCK):
        block = slice(start, start + BLOCK)
        plane, corners = plane_of_face[block], faces[block]
        n = normal_of_plane[plane]
        away = np.zeros(len(plane))
        for i in range(3):
            height = np.abs((n * positions[corners[:, i]]).sum(1) + d[plane])
            np.maximum(away, height, out=away)
        off[block] = ~(away <= limit[plane])
        m = face_normals(positions, corners)
        # The same sums in the same order as `grow_planes`, with room for rounding.
        turn2 = (np.cross(n, m) ** 2).sum(1)
        most2 = math.sin(MOST_TILT_RAD) ** 2 * (n**2).sum(1) * (m**2).sum(1)
        against[block] = ~(((m * n).sum(1) > 0) & (turn2 <= most2 * (1.0 + 1e-9)))
    message = f"expected vertices within {t.tolerance_m:g} m of their record; faces beyond"
    stray = plane_of_face[t["planes/face"]] != np.arange(len(d), dtype=np.uint32)
    return [
        *problem_at("V406", "planes/plane_of_face", message, off),
        *problem_at(
            "V407",
            "planes/plane_of_face",
            f"faces tilted by more than {MOST_TILT_RAD:g} rad",
            against,
        ),
        *problem_at("V407", "planes/face", "records whose face has another record", stray),
    ]


def check_plane_order(t: Tables) -> list[Problem]:
    """Records are numbered by their lowest face, and lie within one component."""
    plane = t["planes/plane_of_face"].astype(np.int64)
    highest = np.maximum.accumulate(plane)
    is_new = np.ones(len(plane), np.bool_)
    is_new[1:] = highest[1:] > highest[:-1]
    # The first record is 0, and each new one follows the highest before it.
    skips = is_new & (plane != np.cumsum(is_new) - 1)
    first = t["components/face_start"][:-1]
    first = first[first < t["components/face_start"][1:]]
    lowest = np.repeat(plane[first], np.diff(first, append=len(plane)))
    shared = plane < lowest
    shared[first] |= ~is_new[first]
    where = "planes/plane_of_face"
    unused = np.arange(len(t["planes/d"])) > (highest[-1] if len(highest) else -1)
    return [
        *problem_at("V410", where, "records not numbered by their lowest face at faces", skips),
        *problem_at("V410", where, "records of another component at faces", shared),
        *problem_at("V410", "planes/d", "records of no face", unused),
    ]


def check_half_edges(t: Tables) -> list[Problem]:
    """Every side of every face is in exactly one edge record."""
    half = t["edges/half_edges"]
    count = np.bincount(half[half != NO_INDEX], minlength=len(t["mesh/face_corners"]))
    sides = "half-edges (3 x face + corner)"
    return [
        *problem_at("V401", "edges/half_edges", f"{sides} in no record", count == 0),
        *problem_at("V401", "edges/half_edges", f"{sides} in several records", count > 1),
    ]


def check_edge_ends(t: Tables) -> list[Problem]:
    """Left runs v0 -> v1 with v0 < v1, right runs v1 -> v0, and one of them is there."""
    half, corners = t["edges/half_edges"], t["mesh/face_corners"]
    rows = rows_of_half_edges(corners, _with_some_half(half))
    right = half[:, 1]
    both = (half != NO_INDEX).all(1)
    last = np.where(both, right, 0)
    ends_differ = (corners[last] != rows[:, 1]) | (corners[next_half_edge(last)] != rows[:, 0])
    empty = (half == NO_INDEX).all(1)
    bad = empty | (rows[:, 0] >= rows[:, 1]) | (both & ends_differ)
    message = "expected left v0 -> v1, right v1 -> v0, v0 < v1; other records"
    return problem_at("V402", "edges/half_edges", message, bad)


def check_edge_tables(t: Tables) -> list[Problem]:
    """Order, grouping, kind and the planar flag of edge records; closed components."""
    half, flags = t["edges/half_edges"], t["edges/flags"]
    rows = rows_of_half_edges(t["mesh/face_corners"], _with_some_half(half))
    component = owner_of_rows(t["components/edge_start"])
    component_of_face = owner_of_rows(t["components/face_start"])
    has_face = rows[:, 2:] != NO_INDEX
    face = np.where(has_face, rows[:, 2:], 0)
    is_pair = has_face.all(1)
    elsewhere = (has_face & (component_of_face[face] != component[:, None])).any(1)
    planar = (flags & EdgeFlag.PLANAR) != 0
    plane = t["planes/plane_of_face"][face]
    return [
        *problem_at("V403", "edges/half_edges", "faces of another component in records", elsewhere),
        *problem_at("V403", "edges/half_edges", "not sorted after", _falls(component, rows)),
        *_kind_problems(rows, flags, is_pair),
        *problem_at(
            "V405",
            "edges/flags",
            "planar, but not two faces of one plane record",
            planar & ~(is_pair & (plane[:, 0] == plane[:, 1])),
        ),
        *_closed_problems(t, component, is_pair),
    ]


def _kind_problems(rows: U32, flags: NDArray[np.uint8], is_pair: BOOL) -> list[Problem]:
    kind = flags & EdgeFlag.KIND_MASK
    # Incident faces of each geometric edge, over all its records.
    key = rows[:, 0].astype(np.uint64) << np.uint64(32) | rows[:, 1]
    order = np.argsort(key, kind="stable")
    is_first = np.ones(len(key), np.bool_)
    is_first[1:] = key[order][1:] != key[order][:-1]
    group = np.cumsum(is_first) - 1
    faces = np.bincount(group, weights=1 + is_pair[order])[group] if len(key) else np.zeros(0)
    incident = np.empty(len(key), np.int64)
    incident[order] = faces
    where = "edges/flags"
    bad_pair = (kind == EdgeKind.PAIR) & ~(is_pair & (incident == 2))
    bad_border = (kind == EdgeKind.BORDER) & (is_pair | (incident > 2))
    bad_split = (kind == EdgeKind.SPLIT) & (incident < 3)
    return [
        *problem_at("V404", where, "pair records at edges without exactly two faces", bad_pair),
        *problem_at("V404", where, "border records of two faces or at split edges", bad_border),
        *problem_at("V404", where, "split records at edges of fewer than three faces", bad_split),
    ]


def _closed_problems(t: Tables, component: NDArray[np.int64], is_pair: BOOL) -> list[Problem]:
    flags = t["components/flags"]
    singles = np.bincount(component[~is_pair], minlength=len(flags)) > 0
    is_closed = (flags & ComponentFlag.CLOSED) != 0
    where = "components/flags"
    return [
        *problem_at("V408", where, "closed, but with records of one face", is_closed & singles),
        *problem_at("V408", where, "no record of one face, but not closed", ~is_closed & ~singles),
    ]


def check_counts(t: Tables) -> list[Problem]:
    """Defect counts are sorted, unique, positive and of known codes."""
    obj, code = t["repair/count_object"].astype(np.int64), t["repair/count_code"]
    key = obj << 16 | code
    return [
        *_unknown_codes("repair/count_code", code),
        *problem_at("V501", "repair/count_object", "not sorted after", key[1:] <= key[:-1]),
        *problem_at("V501", "repair/count", "counts of nothing", t["repair/count"] == 0),
    ]


def check_findings(t: Tables) -> list[Problem]:
    """Findings are sorted by (object, code, face), and of known codes."""
    code = t["repair/finding_code"]
    group = t["repair/finding_object"].astype(np.int64) << 16 | code
    face = t["repair/finding_source_face"]
    same = group[1:] == group[:-1]
    falls = (group[1:] < group[:-1]) | (same & (face[1:] < face[:-1]))
    return [
        *_unknown_codes("repair/finding_code", code),
        *problem_at("V501", "repair/finding_object", "not sorted after", falls),
    ]


def check_flipped(t: Tables) -> list[Problem]:
    """Flipped faces ascend."""
    face = t["repair/flipped_faces"]
    return problem_at("V501", "repair/flipped_faces", "not ascending after", face[1:] <= face[:-1])


def check_source_triangles(t: Tables) -> list[Problem]:
    """No object has more faces than its source had triangles."""
    kept = np.diff(t["objects/face_start"].astype(np.int64))
    more = kept > t["repair/source_triangles"]
    return problem_at("V501", "repair/source_triangles", "fewer than the faces left in", more)


TABLE_CHECKS: tuple[tuple[CheckFunction, tuple[str, ...]], ...] = (
    (check_flags, ("components/flags", "edges/flags")),
    (
        check_grouping,
        ("objects/component_start", "components/face_start", "objects/face_start"),
    ),
    (
        check_faces,
        ("mesh/face_corners", "objects/face_start", "objects/vertex_start", "mesh/positions"),
    ),
    (
        check_planes,
        (
            "mesh/face_corners",
            "mesh/positions",
            "planes/face",
            "planes/d",
            "planes/plane_of_face",
        ),
    ),
    (check_plane_order, ("components/face_start", "planes/d", "planes/plane_of_face")),
    (check_half_edges, ("edges/half_edges", "mesh/face_corners")),
    (check_edge_ends, ("edges/half_edges", "mesh/face_corners")),
    (
        check_edge_tables,
        (
            "edges/half_edges",
            "edges/flags",
            "mesh/face_corners",
            "components/edge_start",
            "components/face_start",
            "components/flags",
            "planes/plane_of_face",
        ),
    ),
    (check_counts, ("repair/count_object", "repair/count_code", "repair/count")),
    (
        check_findings,
        ("repair/finding_object", "repair/finding_code", "repair/finding_source_face"),
    ),
    (check_flipped, ("repair/flipped_faces",)),
    (check_source_triangles, ("repair/source_triangles", "objects/face_start")),
    *TREE_CHECKS,
    *SCENE_CHECKS,
)
"""Every check between tables, with the datasets that must be whole for it."""


def check_tables(tables: Tables) -> list[Problem]:
    """Return every broken invariant of the datasets that are whole."""
    problems: list[Problem] = []
    whole = dict(tables.arrays)
    kept = Tables(whole, tables.sizes, tables.step_m, tables.tolerance_m)
    with np.errstate(all="ignore"):  # a damaged number may be anything
        for spec in DATASETS:
            if spec.path not in whole:
                continue
            found = check_values(spec, whole[spec.path], tables.sizes)
            if spec.path == "mesh/positions":
                found = check_positions(kept)
            if found:
                problems += found
                del whole[spec.path]
        for check, needs in TABLE_CHECKS:
            if all(path in whole for path in needs):
                problems += check(kept)
    return problems


def _with_some_half(half: U32) -> U32:
    """Return `half`, empty records (V402) replaced by half-edge 0, so that gathers stay inside."""
    empty = (half == NO_INDEX).all(1)
    return np.where(empty[:, None], np.uint32(0), half) if empty.any() else half


def _falls(component: NDArray[np.int64], rows: U32) -> BOOL:
    """Return where (component, v0, v1, left face) falls from one record to the next."""
    falls = np.zeros(max(len(rows) - 1, 0), np.bool_)
    same = np.ones(len(falls), np.bool_)
    for column in (component, rows[:, 0], rows[:, 1], rows[:, 2]):
        falls |= same & (column[1:] < column[:-1])
        same &= column[1:] == column[:-1]
    return falls


def _unknown_codes(path: str, code: NDArray[np.uint16]) -> list[Problem]:
    known = np.array([int(c) for c in DEFECTS], np.uint16)
    return problem_at("V502", path, "rows of unknown codes", ~np.isin(code, known))
