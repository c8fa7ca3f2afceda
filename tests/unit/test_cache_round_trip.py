"""What is written is what is read, and the same content is the same bytes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import svprep.cache.codec as codec
from svprep.cache.reader import open_cache
from svprep.cache.schema import DATASETS
from svprep.cache.verify import verify
from svprep.cache.writer import WRITE_POINTS, write_cache
from svprep.errors import CacheError, InternalError
from svprep.model import NO_INDEX, Prepared
from tests.unit.cache_samples import assert_same, nothing, strip_and_tetrahedron, two_spheres


@pytest.mark.parametrize(
    "sample", [strip_and_tetrahedron, two_spheres, nothing], ids=["city", "spheres", "nothing"]
)
def test_round_trip(sample: Callable[[], Prepared], tmp_path: Path) -> None:
    prepared = sample()
    path = tmp_path / "a.svp.h5"
    summary = write_cache(prepared, path)
    assert verify(path) == []
    with open_cache(path) as cache:
        assert_same(cache.prepared(), prepared)
        assert cache.crs == prepared.place.crs
        assert cache.content_digest == summary.content_digest
        assert cache.dataset_sizes() == summary.datasets
        assert cache.n_objects == len(prepared.object_names)
        assert cache.n_vertices == len(prepared.mesh.positions)
        assert cache.n_faces == len(prepared.mesh.faces)
        assert cache.n_components == len(prepared.components.flags)
        assert cache.n_planes == len(prepared.planes.planes)
        assert cache.n_edges == len(prepared.edges.rows)
    assert summary.path == path
    assert summary.n_bytes == path.stat().st_size


def test_arrays_are_read_only_and_outlive_the_cache(tmp_path: Path) -> None:
    path = tmp_path / "a.svp.h5"
    write_cache(strip_and_tetrahedron(), path)
    with open_cache(path) as cache:
        prepared = cache.prepared()

    def arrays(part: object) -> list[np.ndarray]:
        if isinstance(part, np.ndarray):
            return [part]
        if is_dataclass(part):
            return [a for f in fields(part) for a in arrays(getattr(part, f.name))]
        return []

    found = arrays(prepared)
    assert len(found) >= 20
    assert all(not a.flags.writeable and a.flags.c_contiguous for a in found)
    with pytest.raises(CacheError, match="closed"):
        cache.raw("mesh/source_face")


def test_same_content_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = strip_and_tetrahedron()
    paths = [tmp_path / name for name in ("a.h5", "b.h5", "c.h5")]
    digests = [write_cache(sample, path).content_digest for path in paths[:2]]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    # Another producer, and the same files by other names: the same content.
    monkeypatch.setattr(codec, "__version__", "9.9.9")
    moved = tuple(replace(s, path="/elsewhere/" + s.path) for s in sample.sources)
    digests.append(write_cache(replace(sample, sources=moved), paths[2]).content_digest)
    assert len(set(digests)) == 1
    with h5py.File(paths[0], locking=False) as a, h5py.File(paths[2], locking=False) as c:
        differing = {n for n in a.attrs if bytes(a.attrs[n]) != bytes(c.attrs[n])}
    assert differing == {"producer_version", "source_paths", "root_digest"}
    assert verify(paths[2]) == []


def test_other_content_other_digest(tmp_path: Path) -> None:
    sample = strip_and_tetrahedron()
    variants = [
        sample,
        strip_and_tetrahedron(shift_m=1.0),
        replace(sample, notes=("another",)),
        replace(sample, config={**sample.config, "lod": 2}),
        replace(sample, object_names=("roof", "Turm")),
        replace(sample, place=replace(sample.place, crs="EPSG:1")),
        replace(sample, labels=replace(sample.labels, object_types=("Building", ""))),
        replace(sample, planes=replace(sample.planes, tolerance_m=1.0)),
    ]
    digests = [write_cache(v, tmp_path / "a.h5").content_digest for v in variants]
    assert len(set(digests)) == len(variants)


def test_long_texts_and_odd_names(tmp_path: Path) -> None:
    # Over 64 KiB an attribute is stored in another way; names need not be UTF-8.
    names = ("a\0b\n", b"stra\xdfe".decode("utf-8", "surrogateescape"))
    sample = replace(
        strip_and_tetrahedron(), notes=tuple(f"note {i}" for i in range(20_000)), object_names=names
    )
    path = tmp_path / "a.h5"
    write_cache(sample, path)
    assert verify(path) == []
    with open_cache(path) as cache:
        assert_same(cache.prepared(), sample)


def test_every_write_point_is_passed_in_order(tmp_path: Path) -> None:
    passed: list[str] = []
    write_cache(strip_and_tetrahedron(), tmp_path / "a.h5", checkpoint=passed.append)
    assert tuple(passed) == WRITE_POINTS


def test_datasets_are_contiguous_and_in_one_piece(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    write_cache(strip_and_tetrahedron(), path)
    data = path.read_bytes()
    with h5py.File(path, locking=False) as file:
        for spec in DATASETS:
            dataset = file[spec.path]
            assert dataset.chunks is None
            assert dataset.dtype == np.dtype(spec.dtype)
            start = dataset.id.get_offset()
            assert data[start : start + dataset.nbytes] == dataset[...].tobytes()


def _with_rows(prepared: Prepared, change: tuple[int, int, int]) -> Prepared:
    row, column, value = change
    rows = prepared.edges.rows.copy()
    rows[row, column] = value
    return replace(prepared, edges=replace(prepared.edges, rows=rows))


def _broken(sample: Prepared) -> dict[str, Prepared]:
    mesh, planes = sample.mesh, sample.planes
    far = mesh.positions.copy()
    far[3, 1] = np.inf
    return {
        "finite": replace(sample, mesh=replace(mesh, positions=far)),
        "positions": replace(
            sample, mesh=replace(mesh, positions=mesh.positions.astype(np.float64))
        ),
        "traverse": _with_rows(sample, (3, 2, 1)),
        "exist": _with_rows(sample, (3, 2, NO_INDEX - 1)),
        "source_face": replace(sample, mesh=replace(mesh, source_face=mesh.source_face[:-1])),
        "offsets": replace(
            sample, mesh=replace(mesh, object_face_start=np.array([1, 2, 6], np.int64))
        ),
        "normal": replace(sample, planes=replace(planes, planes=planes.planes * 2.0)),
        "JSON": replace(sample, config={"path": Path("x")}),
        "config": replace(sample, config={"x": float("nan")}),
        "planar_tolerance_m": replace(sample, planes=replace(planes, tolerance_m=float("inf"))),
        "defect_counts": replace(
            sample,
            repair=replace(sample.repair, defect_counts=sample.repair.defect_counts[:, :3].copy()),
        ),
        "not text": replace(sample, object_names=("\ud800", "x")),
    }


@pytest.mark.parametrize("what", list(_broken(strip_and_tetrahedron())))
def test_broken_contract_is_our_bug_and_leaves_nothing(what: str, tmp_path: Path) -> None:
    with pytest.raises(InternalError, match=what):
        write_cache(_broken(strip_and_tetrahedron())[what], tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []


def test_half_edges_and_rows_are_inverse() -> None:
    sample = strip_and_tetrahedron()
    corners = sample.mesh.faces.reshape(-1)
    half = codec.half_edges_of_rows(corners, sample.edges.rows)
    assert sorted(half[half != NO_INDEX]) == list(range(3 * len(sample.mesh.faces)))
    assert np.array_equal(codec.rows_of_half_edges(corners, half), sample.edges.rows)


def test_reader_imports_little() -> None:
    code = (
        "import sys, svprep.cache.reader; "
        "print([m for m in ('scipy', 'numba', 'trimesh', 'pvlib', 'OpenGL', 'typer') "
        "if m in sys.modules])"
    )
    root = Path(__file__).resolve().parents[2]
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root
    )
    assert result.stdout.strip() == "[]"
