"""The OBJ reader against a plain twin, and the promises of the triangulation."""

from __future__ import annotations

import re
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from svprep.defects import Code
from svprep.errors import InputError
from svprep.ingest import obj
from svprep.ingest.file_bytes import Text
from svprep.ingest.parsed import ParsedFile
from svprep.ingest.triangulation import LARGE_RING, MOST_EARCUT, triangulate

POOL = ThreadPoolExecutor(2)


def read_text(text: str | bytes) -> ParsedFile:
    raw = text if isinstance(text, bytes) else text.encode()
    file = Text(Path("t.obj"), len(raw), raw)
    return obj.read_obj(file, "t", POOL, lambda fraction: None)


# --- the twin


def twin(text: str) -> tuple[list[list[float]], list[list[int]], list[str]]:
    """Positions, polygons (0-based) and the object's name of each polygon."""
    text = re.sub(r"\r\n|\r", "\n", text)
    lines, pending = [], ""
    for line in text.split("\n"):
        if re.match(r"[ \t]*#", pending + line) or not re.search(r"\\[ \t]*$", line):
            lines.append(pending + line)
            pending = ""
        else:
            pending += line.rstrip(" \t")[:-1] + " "
    statements = [line.split(None, 1) for line in lines + [pending] if line.strip()]
    names = {word: [] for word in "og"}
    positions: list[list[float]] = []
    polygons: list[list[int]] = []
    for keyword, *rest in statements:
        if keyword in names:
            name = " ".join(rest[0].split()) if rest else "default"
            names[keyword].append((len(polygons), name))
            continue
        tokens = rest[0].split("#")[0].split() if rest else []
        if keyword == "v":
            positions.append([float(token) for token in tokens[:3]])
        elif keyword == "f":
            indices = [int(token.split("/")[0]) for token in tokens]
            polygons.append([i - 1 if i > 0 else len(positions) + i for i in indices])
    has_objects = {name for _, name in names["o"]} - {"default"} or len(names["o"]) == 0
    n_objects = len({name for _, name in names["o"]}) if has_objects else 0
    n_groups = len({name for _, name in names["g"]} - {"default"})
    object_names = []
    for i in range(len(polygons)):
        current = (["t"] + [name for start, name in names["o"] if start <= i])[-1]
        group = (["default"] + [name for start, name in names["g"] if start <= i])[-1]
        if n_objects == 1 and n_groups >= 2 and group != "default":
            object_names.append(f"{current}/{group}")
        elif n_objects:
            object_names.append(current)
        else:
            object_names.append(group if names["g"] else "t")
    return positions, polygons, object_names


# --- random text

blank = st.sampled_from([" ", "  ", "\t", " \t ", " \\\n ", "\\ \n"])
number = st.one_of(
    st.floats(-1e6, 1e6).map(repr),
    st.decimals(-1000, 1000, places=4).map(str),
    st.integers(-100, 100).map(str),
    st.sampled_from(["+1.", ".5", "-.25e2", "1E+2", "00012", "-0", "0.30000000000000004441"]),
)
words = st.text("abcäß ß#0\\/", min_size=1, max_size=8).map(lambda s: s.strip(" \\") or "n")
ignored = st.sampled_from(
    ["vt 0.5 1", "vn 0 0 1", "# f 1 2 3 \\", "", "  ", "usemtl a#b", "s off", "l 1 2", "zz top"]
)


@st.composite
def obj_text(draw) -> str:
    n_vertices = draw(st.integers(3, 8))
    lines = ["f 1 2 3"] if draw(st.booleans()) else []
    defined = 0
    statements = draw(
        st.lists(st.sampled_from(["f", "o", "g", "ignored"]), min_size=1, max_size=12)
    )
    for kind in ["v"] * n_vertices + [*statements, "f"] + draw(st.permutations(["v", "f"])):
        start = draw(st.sampled_from(["", " ", "\t"]))
        end = draw(st.sampled_from(["", " ", " # c", " #1"]))
        if kind == "v":
            parts = ["v", *draw(st.lists(number, min_size=3, max_size=6))]
            defined += 1
        elif kind == "f":
            n = draw(st.integers(1, 6))
            sign = draw(st.sampled_from([1, -1]))
            tail = draw(st.sampled_from(["", "/7", "//-2", "/1/2", "//", "/"]))
            indices = draw(st.lists(st.integers(1, defined), min_size=n, max_size=n))
            parts = ["f", *(f"{sign * i}{tail}" for i in indices)]
        elif kind in "og":
            parts = [kind, *draw(st.lists(words, max_size=2))]
            end = ""
        else:
            lines.append(draw(ignored))
            continue
        lines.append(start + "".join(p + draw(blank) for p in parts[:-1]) + parts[-1] + end)
    text = "\n".join(lines) + draw(st.sampled_from(["", "\n"]))
    return text.replace("\n", draw(st.sampled_from(["\n", "\r\n", "\r"])))


@given(obj_text(), st.sampled_from([1, 16, 1 << 20]))
def test_reader_equals_its_twin(text, chunk_bytes):
    positions, polygons, names = twin(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(obj, "CHUNK_BYTES", chunk_bytes)
        if all(len(set(ring)) < 3 for ring in polygons):
            with pytest.raises(InputError, match="three different corners"):
                read_text(text)
            return
        read = read_text(text)
    assert read.positions.tobytes() == np.array(positions, np.float64).tobytes()

    start = np.cumsum([0] + [len(ring) for ring in polygons])
    corners = np.array([i for ring in polygons for i in ring], np.uint32)
    expected = triangulate(np.array(positions), corners, start)
    objects = list(dict.fromkeys(names))
    assert list(read.object_names) == objects
    owner = np.array([objects.index(names[p]) for p in expected.polygon_of_triangle], np.int64)
    order = np.argsort(owner, kind="stable")
    assert read.faces.tolist() == expected.triangles[order].tolist()
    assert read.source_face.tolist() == expected.polygon_of_triangle[order].tolist()
    assert np.diff(read.object_face_start).tolist() == [
        int((owner == i).sum()) for i in range(len(objects))
    ]
    found = np.flatnonzero(expected.finding)
    assert read.face_findings.code.tolist() == expected.finding[found].tolist()
    assert read.face_findings.source_face.tolist() == found.tolist()
    assert read.face_findings.object_index.tolist() == [objects.index(names[p]) for p in found]


digits = st.text("0123456789", max_size=25)
decimal = st.builds(
    lambda sign, a, b, dot, e: sign + a + (dot + b if dot else "") + e,
    st.sampled_from(["", "+", "-"]),
    digits,
    digits,
    st.sampled_from(["", "."]),
    st.one_of(
        st.just(""), st.integers(-340, 330).map("e{}".format), st.integers(0, 30).map("E+{}".format)
    ),
)


@given(st.lists(st.one_of(decimal, st.floats(allow_nan=False).map(repr)), min_size=3, max_size=3))
def test_numbers_are_those_of_float(tokens):
    text = f"v {' '.join(tokens)}\nf 1 1 1\nv 0 0 0\nv 1 0 0\nf 1 2 3\n"
    try:
        expected = np.array([float(token) for token in tokens])
        is_good = bool(np.isfinite(expected).all()) and all(tokens)
    except ValueError:
        is_good = False
    if is_good:
        assert read_text(text).positions[0].tobytes() == expected.tobytes()
    else:
        with pytest.raises(InputError, match=r"line 1: "):
            read_text(text)


@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(text):
    message = ""
    try:
        read_text(b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n" + text)
    except InputError as error:
        message = str(error)
    assert "\n" not in message


# --- triangulation


def run(points: np.ndarray):
    n = len(points)
    return triangulate(points, np.arange(n, dtype=np.uint32), np.array([0, n]))


def area2(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = points[triangles].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def ring_edges_once(n: int, triangles: np.ndarray) -> bool:
    """Each ring edge in its direction once; every other edge in both directions once."""
    edges = [(int(t[k]), int(t[(k + 1) % 3])) for t in triangles for k in range(3)]
    ring = {(i, (i + 1) % n) for i in range(n)}
    inner = [edge for edge in edges if edge not in ring]
    return (
        len(edges) == len(set(edges))
        and ring <= set(edges)
        and all((b, a) in set(inner) for a, b in inner)
    )


@st.composite
def star(draw) -> np.ndarray:
    """A simple polygon on the integer grid, some edges with corners on them, in some plane."""
    n = draw(st.integers(3, 14))
    angles = (np.arange(n) + 0.8 * draw(st.floats(0, 1))) * 2 * np.pi / n
    radii = np.array(draw(st.lists(st.integers(200, 4000), min_size=n, max_size=n)))
    corners = np.rint(np.stack([radii * np.cos(angles), radii * np.sin(angles)], 1)) * 8
    points = []
    for i in range(n):
        a, b = corners[i], corners[(i + 1) % n]
        parts = draw(st.sampled_from([[0], [0], [0, 4], [0, 1, 2], [0, 2, 4, 6]]))
        points += [a + (b - a) / 8 * k for k in parts]
    points = np.roll(np.array(points), draw(st.integers(0, 20)), axis=0)
    if draw(st.booleans()):
        points = points[::-1]
    lift = draw(st.sampled_from([(0, 0), (1, 0), (0, -2), (3, 5)]))
    space = np.column_stack([points, points @ np.array(lift)])
    return np.roll(space, draw(st.integers(0, 2)), axis=1) * draw(st.sampled_from([1.0, 2.0**-11]))


@given(star())
def test_simple_polygons(points):
    result = run(points)
    n = len(points)
    assert len(result.triangles) == n - 2
    assert result.polygon_of_triangle.tolist() == [0] * (n - 2)
    assert result.finding.tolist() == [0]
    if n > 3:
        assert ring_edges_once(n, result.triangles)
    areas = area2(points, result.triangles)
    assert (areas > 0).all()
    whole = np.linalg.norm(np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0))
    assert np.isclose(areas.sum(), whole, rtol=1e-12)

    far = points + [390000, 5820000, 40]
    assert run(far).triangles.tolist() == result.triangles.tolist()


@given(st.lists(st.tuples(*[st.integers(-3, 3)] * 2), min_size=3, max_size=14, unique=True))
def test_any_ring_of_different_points_gives_n_minus_2(points):
    result = run(np.column_stack([np.array(points, float), np.zeros(len(points))]))
    assert len(result.triangles) == len(points) - 2
    used = set(result.triangles.ravel().tolist())
    assert used == set(range(len(points)))


@given(st.lists(st.integers(0, 4), min_size=1, max_size=9))
def test_rings_with_repeated_corners(ring):
    points = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [2, 1, 0]], float)
    result = triangulate(points, np.array(ring, np.uint32), np.array([0, len(ring)]))
    reduced = [c for c, following in zip(ring, ring[1:] + ring[:1], strict=True) if c != following]
    if len(set(ring)) < 3:
        assert result.finding.tolist() == [Code.SHORT_POLYGON]
        assert len(result.triangles) == 0
    else:
        assert len(result.triangles) == len(reduced) - 2
        if len(set(reduced)) < len(reduced):
            assert result.finding.tolist() == [Code.SELF_CROSSING_POLYGON]


def test_several_polygons_at_once_equal_each_alone():
    rng = np.random.default_rng(5)
    points, start, rings = [], [0], []
    for i in range(60):
        n = 3 + i % 7
        angles = np.arange(n) * 2 * np.pi / n
        radii = rng.integers(1, 9, n)
        ring = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.full(n, i)])
        rings.append(ring)
        points += ring.tolist()
        start.append(start[-1] + n)
    together = triangulate(np.array(points), np.arange(start[-1], dtype=np.uint32), np.array(start))
    alone = [run(ring).triangles + begin for ring, begin in zip(rings, start[:-1], strict=True)]
    assert together.triangles.tolist() == np.concatenate(alone).tolist()


@pytest.mark.parametrize("mirror", [1, -1])
def test_a_keyhole_is_filled_and_reported(mirror):
    outer = [(0, 0), (8, 0), (8, 8), (0, 8), (0, 0)]
    inner = [(2, 2), (2, 6), (6, 6), (6, 2), (2, 2)]
    points = np.array([(mirror * x, y, 0.0) for x, y in outer + inner])
    result = run(points)
    assert result.finding.tolist() == [Code.SELF_CROSSING_POLYGON]
    assert len(result.triangles) == 8
    assert area2(points, result.triangles).sum() == 2 * (64 - 16)


def test_repeated_positions_are_no_crossing():
    points = np.array([(0, 0, 0), (4, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0), (0, 0, 0)], float)
    result = run(points)
    assert result.finding.tolist() == [0]
    assert len(result.triangles) == 4
    assert area2(points, result.triangles).sum() == 32


@pytest.mark.parametrize(
    ("points", "finding"),
    [
        ([(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)], 0),
        ([(0, 0, 0), (2, 2, 0), (2, 0, 0), (0, 2, 0)], Code.SELF_CROSSING_POLYGON),
        ([(0, 0, 0), (5, 4, 0), (4, 0, 0), (0, 4, 0)], Code.SELF_CROSSING_POLYGON),
        ([(0, 0, 0), (4, 0, 0), (4, 4, 0), (2, 0, 0)], Code.SELF_CROSSING_POLYGON),
        ([(0, 0, 0), (4, 0, 0), (4, 4, 0.01), (0, 4, 0)], 0),
        ([(0, 0, 0), (4, 0, 0), (4, 4, 0.1), (0, 4, 0)], Code.NONPLANAR_POLYGON),
        ([(0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0)], 0),
    ],
)
def test_findings(points, finding):
    result = run(np.array(points, float))
    assert result.finding.tolist() == [finding]
    assert len(result.triangles) == 2


def test_pentagram():
    angles = np.arange(5) * 4 * np.pi / 5
    points = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    assert run(points).finding.tolist() == [Code.SELF_CROSSING_POLYGON]


@pytest.mark.parametrize("n", [LARGE_RING - 100, LARGE_RING + 1, 3 * LARGE_RING])
def test_large_rings_keep_collinear_corners(n):
    rng = np.random.default_rng(n)
    angles = np.arange(n // 3) * 2 * np.pi / (n // 3)
    radii = rng.uniform(500, 1000, n // 3)
    corners = np.rint(np.stack([radii * np.cos(angles), radii * np.sin(angles)], 1) * 64) * 4
    following = np.roll(corners, -1, axis=0)
    points = np.stack([corners, (corners + following) / 2, (corners + 3 * following) / 4], 1)
    points = points.reshape(-1, 2)
    points = np.vstack(
        [points, points[-1:] + (points[:1] - points[-1:]) / np.arange(4, 1, -1)[:, None]]
    )
    points = np.column_stack([points, points @ [1, 2]])[: 3 * (n // 3) + n % 3]
    result = run(points)
    assert len(result.triangles) == len(points) - 2
    assert result.finding.tolist() == [0]
    assert ring_edges_once(len(points), result.triangles)
    whole = np.linalg.norm(np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0))
    assert np.isclose(area2(points, result.triangles).sum(), whole, rtol=1e-9)


def test_a_large_crossing_ring_still_gives_n_minus_2():
    n = LARGE_RING + 500
    points = np.column_stack([np.random.default_rng(1).random((n, 2)), np.zeros(n)])
    result = run(points)
    assert len(result.triangles) == n - 2
    assert result.finding.tolist() == [Code.SELF_CROSSING_POLYGON]


@pytest.mark.parametrize("is_crossing", [False, True])
def test_a_ring_that_winds_or_crosses_takes_no_minutes(is_crossing):
    # mapbox-earcut takes half a minute for such a spiral.
    n = 20_000
    turns = np.linspace(0, 250 * 2 * np.pi, n // 2)
    inner, outer = (
        np.column_stack([np.cos(turns) * (turns + r), np.sin(turns) * (turns + r)]) for r in (1, 3)
    )
    points = np.vstack([inner, outer[::-1]])
    if is_crossing:
        points = np.random.default_rng(1).random((n, 2))
    points = np.column_stack([points, np.zeros(n)])
    result = run(points)
    assert result.finding.tolist() == [Code.SELF_CROSSING_POLYGON if is_crossing else 0]
    assert len(result.triangles) == n - 2


def test_a_ring_with_one_crossing_is_fanned_around_it_alone():
    n = MOST_EARCUT + 1000
    angles = np.arange(n) * 2 * np.pi / n
    radii = np.random.default_rng(2).uniform(900, 1000, n)
    points = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(n)])
    whole = area2(points, run(points).triangles).sum()
    points[[500, 504]] = points[[504, 500]]
    result = run(points)
    assert result.finding.tolist() == [Code.SELF_CROSSING_POLYGON]
    assert area2(points, result.triangles).sum() == pytest.approx(whole, rel=1e-2)


@pytest.mark.parametrize("n", [5, LARGE_RING + 1])
@pytest.mark.parametrize("size", [1e160, 1e308])
def test_a_ring_too_large_to_measure_warns_of_nothing(n, size):
    angles = np.arange(n) * 2 * np.pi / n
    points = size * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(run(points).triangles) == n - 2
