"""The smooth mesh of the silhouette benchmark."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from svprep.ingest import read
from svprep.model import ComponentFlag
from svprep.pipeline import BuildConfig, prepare

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "smooth_mesh.py"


def smooth_mesh(output: Path, triangles: int) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), "--triangles", str(triangles), "-o", str(output)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.mark.parametrize("n", [1, 2, 21])
def test_builds_as_one_solid_component(tmp_path: Path, n: int) -> None:
    path = tmp_path / "smooth.obj"
    assert smooth_mesh(path, 12 * n * n).returncode == 0
    prepared = prepare(read([path]), BuildConfig())
    assert prepared.object_names == ("smooth",)
    assert len(prepared.mesh.faces) == 12 * n * n
    assert len(prepared.mesh.positions) == 6 * n * n + 2
    assert prepared.components.flags.tolist() == [ComponentFlag.CLOSED | ComponentFlag.SOLID]
    assert not prepared.repair.defect_counts.any()
    assert len(prepared.repair.flipped_faces) == 0


def test_it_has_hollows(tmp_path: Path) -> None:
    path = tmp_path / "smooth.obj"
    smooth_mesh(path, 5000)
    prepared = prepare(read([path]), BuildConfig())
    left, right = prepared.edges.rows[:, 2:].T
    across = prepared.mesh.positions[prepared.mesh.faces[right]].mean(axis=1)
    plane = prepared.planes.planes[prepared.planes.plane_of_face[left]]
    reflex = (plane[:, :3] * across).sum(axis=1) + plane[:, 3] > 0.0
    assert 0.1 < np.mean(reflex) < 0.9


def test_same_options_give_same_bytes(tmp_path: Path) -> None:
    first, second = tmp_path / "a.obj", tmp_path / "b.obj"
    smooth_mesh(first, 300)
    smooth_mesh(second, 300)
    assert first.read_bytes() == second.read_bytes()
    assert first.read_text().startswith("o smooth\nv ")


def test_what_cannot_be_made_is_said(tmp_path: Path) -> None:
    assert smooth_mesh(tmp_path / "a.obj", 11).returncode == 2
    failed = smooth_mesh(tmp_path / "absent" / "a.obj", 300)
    assert failed.returncode == 1
    assert failed.stderr.startswith("smooth_mesh: cannot write ")
