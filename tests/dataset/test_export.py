"""Every file that builds, exported in every format and built again: the same tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svprep.pipeline import BuildConfig, prepare
from tests.dataset.datasets import DATA, SHARED, build, buildable_files, label
from tests.property.meshes import source_mesh
from tests.unit.export_checks import FORMS, assert_round_trip

CITIES = (
    "munich_lod2_v0.json",
    "munich_lod2.gml",
    "wageningen_7-624-528/content/1_0_0.glb",
    "ingolstadt_lod3/4018210.xml.gz",
)
LONG = [p for p in buildable_files() if p.is_relative_to(SHARED)]


def conformance_files() -> list[Path]:
    return [p for p in buildable_files() if p.is_relative_to(DATA / "conformance")]


def round_trips(path: Path, folder: Path, forms: tuple[str, ...] = FORMS) -> None:
    found = build(path)
    assert not isinstance(found, str), found
    # An object without faces has no place in most formats.
    city = found.prepared
    if not (np.diff(city.mesh.object_face_start) > 0).all():
        forms = ("ply",)
    for form in forms:
        assert_round_trip(city, folder, form)


@pytest.mark.parametrize("path", conformance_files(), ids=label)
def test_conformance_files_come_back(path: Path, tmp_path: Path) -> None:
    round_trips(path, tmp_path, ("obj", "city.json"))


@pytest.mark.parametrize("name", CITIES)
def test_real_cities_come_back(name: str, tmp_path: Path) -> None:
    path = SHARED / "cities" / name
    if not path.is_file():
        pytest.skip(f"../shared/data/cities/{name} is absent")
    round_trips(path, tmp_path, ("ply", "city.json"))


@pytest.mark.long
@pytest.mark.parametrize("path", LONG, ids=label)
def test_all_files_come_back(path: Path, tmp_path: Path) -> None:
    round_trips(path, tmp_path)


def test_a_weld_tolerance_needs_no_repeating(tmp_path: Path) -> None:
    """What was welded is welded: the exported mesh is built without the tolerance."""
    rng = np.random.default_rng(5)
    points = rng.integers(0, 6, (60, 3)) + rng.normal(0.0, 0.01, (60, 3))
    faces = rng.integers(0, 60, (40, 3))
    source = source_mesh(points, faces)
    city = prepare(replace(source, object_names=("soup",)), BuildConfig(weld_tolerance_m=0.05))
    for form in FORMS:
        assert_round_trip(city, tmp_path, form)
