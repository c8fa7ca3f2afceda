"""FORMAT.md is in step with the schema, and its reader reads a real cache."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from svprep import __version__
from svprep.cache.schema import ATTRIBUTES, DATASETS
from svprep.cache.writer import write_cache
from svprep.defects import DEFECTS
from svprep.model import NO_INDEX
from tests.unit.cache_samples import strip_and_tetrahedron

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "FORMAT.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    (block,) = re.findall(r"^```python\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
    path = tmp_path_factory.mktemp("reader") / "reader.py"
    path.write_text(block, encoding="utf-8")
    return path


def run(reader: Path, cache: Path) -> subprocess.CompletedProcess[str]:
    # -I: nothing of this checkout can be imported, only what is installed.
    return subprocess.run(
        [sys.executable, "-I", "-W", "error", str(reader), str(cache)],
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
    assert len(code.splitlines()) <= 150
    imported = set(re.findall(r"^\s*(?:import|from) (\w+)", code, re.MULTILINE))
    assert imported <= {"h5py", "numpy"} | sys.stdlib_module_names


def test_the_reader_reads_a_cache(reader: Path, tmp_path: Path) -> None:
    sample = strip_and_tetrahedron()
    path = tmp_path / "a.svp.h5"
    summary = write_cache(sample, path, crs="EPSG:7415")
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
    assert "the dataset planes/d is damaged" in result.stderr
