"""FORMAT.md is in step with the schema, and its reader reads a real cache."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from svprep import __version__, pipeline
from svprep.cache.codec import encode_datasets
from svprep.cache.schema import ATTRIBUTES, DATASETS
from svprep.cache.writer import write_cache
from svprep.clamp import ClampCosts
from svprep.defects import DEFECTS
from svprep.facing import facing
from svprep.ingest import read
from svprep.model import NO_INDEX, EdgeFlag, Prepared
from svprep.silhouette import silhouette
from svprep.validate import random_lights
from tests.unit.cache_samples import strip_and_tetrahedron, two_spheres

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "FORMAT.md").read_text(encoding="utf-8")
SILHOUETTES, SEARCH, SEGMENTS, READER = re.findall(
    r"^```python\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL
)
"""The four blocks of code."""


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reader") / "reader.py"
    path.write_text(READER, encoding="utf-8")
    return path


def run(reader: Path, *cache: Path) -> subprocess.CompletedProcess[str]:
    # -I: nothing of this checkout can be imported, only what is installed.
    return subprocess.run(
        [sys.executable, "-I", "-W", "error", str(reader), *map(str, cache)],
        capture_output=True,
        text=True,
        check=False,
    )


def test_generated_parts_are_in_step() -> None:
    # An assertion on the whole text would print all of it.
    script = runpy.run_path(str(ROOT / "scripts" / "write_format.py"))
    regenerated: Callable[[str], str] = script["regenerated"]
    is_in_step = regenerated(TEXT) == TEXT
    assert is_in_step, "run: python3 scripts/write_format.py"
    assert all(f"`{s.path}`" in TEXT for s in DATASETS)
    assert all(f"`{s.name}`" in TEXT for s in ATTRIBUTES)
    assert all(d.label in TEXT for d in DEFECTS.values())


def test_the_reader_is_short_and_needs_only_h5py_and_numpy(reader: Path) -> None:
    code = reader.read_text(encoding="utf-8")
    assert len(code.splitlines()) < 150
    assert len(SILHOUETTES.splitlines()) <= 20
    assert len(SEARCH.splitlines()) <= 45
    assert len(SEGMENTS.splitlines()) <= 20
    imported = set(re.findall(r"^\s*(?:import|from) (\w+)", code, re.MULTILINE))
    assert imported <= {"h5py", "numpy"} | sys.stdlib_module_names


def test_the_reader_reads_a_cache(reader: Path, tmp_path: Path) -> None:
    sample = strip_and_tetrahedron()
    path = tmp_path / "a.svp.h5"
    summary = write_cache(sample, path)
    result = run(reader, path)
    assert result.returncode == 0, result.stderr
    rows, flags = sample.edges.rows, sample.edges.flags
    assert json.loads(result.stdout) == {
        "producer": __version__,
        "content_digest": summary.content_digest,
        "sources": [s.path for s in sample.sources],
        "crs": "EPSG:7415",
        "origin_m": sample.mesh.grid.origin_m.tolist(),
        "objects": list(sample.object_names),
        "n_objects": 2,
        "n_vertices": 8,
        "n_faces": 6,
        "n_planes": 5,
        "n_edges": 11,
        "n_edges_by_kind": np.bincount(flags & 3, minlength=3).tolist(),
        "n_planar": 1,
        "n_single_face_edges": int((rows[:, 2:] == NO_INDEX).sum()),
        "n_faces_up": 3,
        "n_trees": 1,
        "n_closed_components": 1,
        "n_defects": int(sample.repair.defect_counts.sum()),
        "area_m2": pytest.approx(2 + 3 * 0.5 + np.sqrt(3) / 2),
        "vertex_sum": int(rows[:, :2].sum()),
        "plane_sum": sample.planes.planes.sum(),
    }


def test_the_reader_finds_damage(reader: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.svp.h5"
    write_cache(strip_and_tetrahedron(), path)
    data = bytearray(path.read_bytes())
    at = data.index(np.array([-8.0], "<f8").tobytes())
    data[at] ^= 1
    path.write_bytes(data)
    result = run(reader, path)
    assert result.returncode == 1
    assert "is damaged: the dataset planes/d" in result.stderr


def test_the_reader_answers_misuse_in_one_line(reader: Path, tmp_path: Path) -> None:
    whole, bad = tmp_path / "a.svp.h5", tmp_path / "bad.h5"
    write_cache(strip_and_tetrahedron(), whole)
    result = run(reader)
    assert result.stderr == "Read a svprep cache with h5py and NumPy alone: python3 reader.py " + (
        "NAME.svp.h5\n"
    )
    data = whole.read_bytes()
    contents = [b"", b"v 0 0 0\n", data[:30], data[: len(data) // 2]]
    contents += [data[:at] + b"\xff\xfe" + data[at + 2 :] for at in range(50, len(data), 2999)]
    for content in contents:
        bad.write_bytes(content)
        result = run(reader, bad)
        if result.returncode == 0:  # a byte that nothing reads
            continue
        assert result.returncode == 1
        assert result.stderr.startswith(f"{bad} ")
        assert result.stderr.count("\n") == 1, result.stderr
    for path in (tmp_path, tmp_path / "none.h5"):
        result = run(reader, path)
        assert result.returncode == 1
        assert result.stderr.count("\n") == 1, result.stderr


def code_of_format_md() -> dict[str, Any]:
    """Return what FORMAT.md's blocks of code define."""
    names: dict[str, Any] = {"__name__": "reader"}
    exec(READER + SILHOUETTES + SEARCH + SEGMENTS, names)
    return names


def read_tables(names: dict[str, Any], path: Path) -> tuple[Any, np.ndarray, np.ndarray]:
    """Return datasets, planes and rows of a cache as FORMAT.md's reader makes them."""
    _, data = names["read_file"](path)
    faces = data["mesh/face_corners"].reshape(-1, 3)
    rows = names["edge_rows"](data["mesh/face_corners"], data["edges/half_edges"])
    record = data["planes/face"], data["planes/d"]
    return data, names["plane_records"](data["mesh/positions"], faces, *record), rows


def sides(prepared: Prepared, path: Path, light: np.ndarray) -> np.ndarray:
    """Return the multiplicities that FORMAT.md's code reads from a cache."""
    names = code_of_format_md()
    write_cache(prepared, path)
    data, planes, rows = read_tables(names, path)
    assert np.array_equal(rows, prepared.edges.rows)
    assert np.array_equal(planes, prepared.planes.planes)
    m: np.ndarray = names["multiplicities"](data, planes, rows, light)
    assert m.dtype == np.int8
    return m


def light_caps(prepared: Prepared, s: np.ndarray, start: int, stop: int) -> Counter[Any]:
    """Return how often the faces `start` to `stop` that count run along each edge."""
    along: Counter[Any] = Counter()
    for face in range(start, stop):
        for i in range(3):
            a, b = prepared.mesh.faces[face, [i, (i + 1) % 3]].tolist()
            along[min(a, b), max(a, b)] += int(s[face]) * (1 if a < b else -1)
    return along


MODELS = (
    "box_lit_from_inside",
    "clean_cube",
    "mobius_strip",
    "near_coplanar_wall",
    "nested_solids",
    "three_faces_on_edge",
)


@pytest.mark.parametrize("model", ["sample", *MODELS])
def test_the_formulas_give_closed_volumes(model: str, tmp_path: Path) -> None:
    prepared = strip_and_tetrahedron()
    if model != "sample":
        source = read([ROOT / "data" / "conformance" / f"{model}.obj"])
        prepared = pipeline.prepare(source, pipeline.BuildConfig())
    mesh, parts, rows = prepared.mesh, prepared.components, prepared.edges.rows
    centre = mesh.positions[mesh.faces[-1]].mean(axis=0)
    inside = mesh.positions[mesh.faces[parts.face_start[-2] :]].mean(axis=(0, 1))
    lights = [
        [0, 0, 1, 0],  # edge-on to every wall
        [0.48, -0.6, 0.64, 0],
        [*(centre + 100 * np.array([1, 2, 3])), 1],
        [*inside, 1],
        [0.1, 0.2, 0.3, 1],
    ]
    n_closed = 0
    for light in np.array(lights, np.float64):
        m = sides(prepared, tmp_path / "a.svp.h5", light)
        s = facing(prepared.planes.planes, light)[prepared.planes.plane_of_face]
        assert not m[prepared.edges.flags & EdgeFlag.PLANAR != 0].any()
        for i, flags in enumerate(parts.flags):
            own = slice(parts.edge_start[i], parts.edge_start[i + 1])
            first, last = parts.face_start[i], parts.face_start[i + 1]
            corners = mesh.positions[mesh.faces[first:last].reshape(-1)]
            is_inside = light[3] and np.all(
                (np.float32(light[:3]) >= corners.min(0))
                & (np.float32(light[:3]) <= corners.max(0))
            )
            is_closed = bool(flags & 2) and not is_inside
            n_closed += is_closed
            got: Counter[Any] = Counter()
            for (v0, v1), n in zip(rows[own, :2].tolist(), m[own].tolist(), strict=True):
                got[v0, v1] += n
            # A side runs against the light cap at their common edge, as often as the cap.
            assert got == light_caps(prepared, np.maximum(s, 0) if is_closed else s, first, last)
            v0, v1 = rows[own, :2].astype(np.int64).T
            size = len(mesh.positions)
            starts, ends = (np.bincount(v, m[own], size) for v in (v0, v1))
            assert np.array_equal(starts, ends)
            assert np.abs(m[own]).max() <= (1 if is_closed else 2)
    assert bool(n_closed) == bool((parts.flags & 2).any())


def test_the_search_of_a_tree_finds_the_silhouette(tmp_path: Path) -> None:
    names = code_of_format_md()
    for sample in (two_spheres(), strip_and_tetrahedron()):
        path = tmp_path / "a.svp.h5"
        write_cache(sample, path)
        data, planes, rows = read_tables(names, path)
        n_found = 0
        for light in random_lights(sample.mesh, sample.components, 40):
            for tree, number in enumerate(sample.index.objects.tolist()):
                edge, m = names["object_silhouette"](data, planes, rows, light, tree)
                expected = silhouette(sample, light, "brute", objects=[number])
                assert np.array_equal(edge, expected.edge)
                assert np.array_equal(m, expected.multiplicity)
                n_found += len(edge)
        assert n_found > 100


def test_the_search_leaves_most_edges_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a test that decides nothing would be right too."""
    names = code_of_format_md()
    sample = two_spheres()
    data = {name: np.asarray(array) for name, array in encode_datasets(sample).items()}
    looked_at: list[int] = []
    right = names["multiplicities"]

    def counted(data: Any, planes: Any, rows: Any, light: Any, edge: Any) -> Any:
        looked_at.append(len(edge))
        return right(data, planes, rows, light, edge)

    monkeypatch.setitem(names, "multiplicities", counted)
    light = np.array([1.0, 2.0, 3.0, 0.0])
    names["object_silhouette"](data, sample.planes.planes, sample.edges.rows, light, 0)
    n_edges = sample.index.pair_start[1]
    assert 0 < looked_at[0] < n_edges / 2


def test_the_test_of_cones_decides_only_what_is_decided() -> None:
    """The formula of FORMAT.md against the facing of every edge below each node."""
    level_sizes = code_of_format_md()["level_sizes"]
    sample = two_spheres()
    index, rows, base, n_decided = sample.index, sample.edges.rows, 0, 0
    lights = random_lights(sample.mesh, sample.components, 40).astype(np.float64)
    for tree, (begin, end) in enumerate(pairwise(index.pair_start.tolist())):
        *c, r = index.frames[tree].astype(np.float64)
        records = sample.planes.plane_of_face[rows[index.cones.edge[begin:end], 2:]]
        sizes = level_sizes(end - begin)
        for height, n_blocks in zip(range(len(sizes) - 2, -1, -1), sizes[:-1], strict=True):
            block = index.cones.blocks[base : base + n_blocks].astype(np.float64) / 32000
            base += n_blocks
            node = np.arange(end - begin) // 8 ** (height + 1)
            number = block.transpose(0, 2, 1).reshape(-1, 8)[: node[-1] + 1].T
            axis = number[4:7] / np.linalg.norm(number[4:7], axis=0)
            for light in lights:
                w = light[3]
                towards = (light[:3] - w * np.array(c)) / r
                d = towards[:, None] - w * number[:3]
                along = (axis * d).sum(axis=0)
                across = np.sqrt(np.maximum((d * d).sum(axis=0) - along**2, 0.0))
                least = abs(along) * np.sqrt(1 - number[7] ** 2) - across * number[7]
                slack = 2e-6 * (abs(towards).sum() + 2 * w)
                is_decided = (least > number[3] * w + slack) & (number[7] < 1)
                s = facing(sample.planes.planes, light)[records]
                assert (s[is_decided[node]] == np.sign(along)[node[is_decided[node]], None]).all()
                n_decided += int(is_decided.sum())
    assert base == len(index.cones.blocks)
    assert n_decided > 1000


def test_the_reader_tells_what_lies_in_a_segment(tmp_path: Path) -> None:
    # A box floats 10 m over a wide floor: its shadow can be seen on itself and on the floor.
    floor = "v -50 -50 0\nv 50 -50 0\nv 50 50 0\nv -50 50 0\nf 1 2 3 4\n"
    corners = "".join(f"v {x} {y} {z}\n" for z in (10, 11) for y in (0, 1) for x in (0, 1))
    sides = ("5 7 8 6", "9 10 12 11", "5 6 10 9", "8 7 11 12", "6 8 12 10", "7 5 9 11")
    model = tmp_path / "floor.obj"
    model.write_text(f"o floor\n{floor}o box\n{corners}" + "".join(f"f {s}\n" for s in sides))
    path = tmp_path / "floor.svp.h5"
    lights = ["dir:0,90", "dir:90,30", "point:0.5,0.5,20.5"]
    pipeline.build([model], path, lights=lights, costs=ClampCosts(vertex=0.0))
    names = code_of_format_md()
    attributes, data = names["read_file"](path)
    inside = names["lies_in_a_segment"]
    for light, along in enumerate([(0, 0, -1), (-np.sqrt(3) / 2, 0, -0.5), (0, 0, -1)]):
        top = np.array([0.5, 0.5, 11.0]) - attributes["grid_origin_m"]
        on_floor, on_box = 11 / -along[2], 0.9
        for far, expected in ((0.0, True), (on_box, True), (5.0, False), (on_floor, True)):
            point = top + far * np.array(along)
            assert inside(data, light, 1, top, point) is expected, (light, far)
        below = top + (on_floor + 3.0) * np.array(along)
        assert inside(data, light, 1, top, below) is False
        assert inside(data, light, 0, top, top) is True  # the floor's own first segment
