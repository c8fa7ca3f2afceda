"""What must hold on every file: tables whole, multiplicities right, no shadow changed."""

from __future__ import annotations

import numpy as np
import pytest

from svprep import reference
from svprep.facing import facing
from svprep.model import MOST_TILT_RAD, NO_INDEX, ComponentFlag
from svprep.silhouette.volumes import closed_volume_allowed, component_bounds
from svprep.validate import random_lights, row_multiplicity
from tests.dataset.datasets import SHARED, Built, build, buildable_files, label, thin
from tests.property.meshes import renumbered

FILES = buildable_files()
LIGHTS = 100


@pytest.fixture(params=FILES, ids=[label(p) for p in FILES], scope="module")
def built(request: pytest.FixtureRequest) -> Built:
    """Yield each file in turn, built."""
    outcome = build(request.param)
    assert not isinstance(outcome, str), outcome
    return outcome


def test_shared_data_is_present() -> None:
    """Say by name what a run without ../shared leaves out."""
    if not SHARED.is_dir():
        pytest.skip("../shared/data is absent: its cities, broken meshes and reader files not run")
    assert any(path.is_relative_to(SHARED) for path in FILES)


def test_each_side_of_each_face_stands_in_one_record(built: Built) -> None:
    mesh, rows = built.prepared.mesh, built.prepared.edges.rows.astype(np.int64)
    assert (rows[:, 0] < rows[:, 1]).all()
    sides = []
    for column, start, end in ((2, 0, 1), (3, 1, 0)):
        held = rows[rows[:, column] != NO_INDEX]
        corners = mesh.faces[held[:, column]].astype(np.int64)
        at = (corners == held[:, [start]]).argmax(axis=1)
        row = np.arange(len(held))
        assert (corners[row, at] == held[:, start]).all()
        assert (corners[row, (at + 1) % 3] == held[:, end]).all()
        sides.append(3 * held[:, column] + at)
    assert np.array_equal(np.sort(np.concatenate(sides)), np.arange(3 * len(mesh.faces)))


def raw_weights(built: Built) -> tuple[np.ndarray, np.ndarray]:
    """Return the welded source faces, one for each set of corners, and how many stay.

    In the numbers of the repaired mesh's vertices.
    A face's share of a multiplicity does not depend on its winding, so faces on
    the same corners count alike: what repair dropped is known by counting.
    """
    mesh = built.prepared.mesh
    raw_faces = renumbered(built.welded, mesh)
    rows, first, raw_count = np.unique(
        np.sort(raw_faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    kept, kept_count = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_counts=True)
    assert np.array_equal(rows, kept), "repair lost or invented a face"
    assert (kept_count <= raw_count).all()
    found = built.prepared.repair.face_findings
    assert (raw_count - kept_count).sum() == np.count_nonzero(found.code == 103)
    return raw_faces[first], kept_count


def own_facing(positions: np.ndarray, faces: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Return each face's own facing, from its own corners in float64."""
    a, b, c = (positions[faces[:, i]].astype(np.float64) for i in range(3))
    n = np.cross(b - a, c - a)
    towards = light[:3].astype(np.float64) - light[3] * a
    return np.sign((n * towards).sum(axis=1)).astype(np.int64)


def test_multiplicities_of_raw_triangles_and_of_records_agree(built: Built) -> None:
    """Also that any one choice of facing per face gives closed volumes."""
    prepared = built.prepared
    mesh, edges, components = prepared.mesh, prepared.edges, prepared.components
    raw_faces, weight = raw_weights(built)
    raw_sums, sums = reference.EdgeSums(raw_faces), reference.EdgeSums(mesh.faces)
    assert np.array_equal(raw_sums.edges, sums.edges)
    edge_of_rows = sums.edge_of_rows(edges.rows)
    component = np.repeat(np.arange(len(components.flags)), np.diff(components.face_start))
    bounds = component_bounds(mesh, components)
    lights = random_lights(mesh, components, LIGHTS, seed=1)
    lights = lights[thin(LIGHTS, LIGHTS if len(mesh.faces) < 100_000 else 20)]
    for light in lights:
        own = own_facing(mesh.positions, mesh.faces, light)
        raw = raw_sums.of_triangles(own_facing(mesh.positions, raw_faces, light) * weight)
        assert np.array_equal(raw, sums.of_rows(edges.rows, own, edge_of_rows))
        # And with the facing that everything downstream uses, one per plane record.
        side = facing(prepared.planes.planes, light).astype(np.int64)
        side = side[prepared.planes.plane_of_face]
        by_rows = sums.of_rows(edges.rows, side, edge_of_rows)
        assert np.array_equal(sums.of_triangles(side), by_rows)
        allowed = closed_volume_allowed(components, bounds, light)[component]
        for chosen in (side, np.where(allowed, side > 0, side)):
            m = row_multiplicity(edges, chosen)
            balance = np.bincount(edges.rows[:, 1], m, len(mesh.positions))
            balance -= np.bincount(edges.rows[:, 0], m, len(mesh.positions))
            assert not balance.any()
        closed_m = row_multiplicity(edges, (side > 0).astype(np.int64))
        is_closed = (components.flags & np.uint8(ComponentFlag.SOLID)) != 0
        rows_of_solids = np.repeat(is_closed, np.diff(components.edge_start))
        assert (np.abs(closed_m[rows_of_solids]) <= 1).all()


def test_both_volumes_tell_shadow_as_brute_force_does(built: Built, is_long: bool) -> None:
    """In shadow or not: by faces between point and light, robust volume, closed volume."""
    prepared = built.prepared
    mesh, edges, components = prepared.mesh, prepared.edges, prepared.components
    rng = np.random.default_rng(2)
    wanted, points_at_once = (10_000, 40) if is_long else (1_000, 20)
    budget = 2e9 if is_long else 1e7
    tested = shaded = by_closed = grazing = turns = 0
    bounds = component_bounds(mesh, components)
    lights = random_lights(mesh, components, 64, seed=3)
    solids = np.flatnonzero(components.flags & np.uint8(ComponentFlag.SOLID))
    for turn in range(4 * wanted // points_at_once):
        if tested >= wanted or budget < 0:
            break
        turns += 1
        light = lights[turn % len(lights)]
        pool = solids if len(solids) and turn % 2 else np.arange(len(components.flags))
        chosen = int(rng.choice(pool))
        f0, f1 = components.face_start[chosen], components.face_start[chosen + 1]
        e0, e1 = components.edge_start[chosen], components.edge_start[chosen + 1]
        n_points = int(min(points_at_once, max(1, 1e6 // (e1 - e0))))
        budget -= n_points * float(e1 - e0)
        faces, rows = mesh.faces[f0:f1], edges.rows[e0:e1].astype(np.int64)
        rows[:, 2:] = np.where(rows[:, 2:] == NO_INDEX, NO_INDEX, rows[:, 2:] - f0)
        # The truth by each face's own facing, the volumes by that of its plane record.
        own = own_facing(mesh.positions, faces, light)
        side = facing(prepared.planes.planes, light).astype(np.int64)
        side = side[prepared.planes.plane_of_face[f0:f1]]
        if (own != side).any():
            assert_grazed(mesh.positions[faces[own != side]], light, prepared.planes.tolerance_m)
            grazing += 1
            continue
        x = _points_behind(mesh.positions[faces], light, n_points, rng)
        ray = rng.normal(size=3)
        truth = reference.volume_count(mesh.positions, faces, own, light, x)
        robust = reference.robust_count(mesh.positions, faces, rows, side, light, x, ray)
        sure = truth.is_decidable & robust.is_decidable
        assert np.array_equal(truth.value[sure], robust.value[sure])
        if closed_volume_allowed(components, bounds, light)[chosen]:
            closed = reference.closed_count(mesh.positions, faces, rows, side, light, x, ray)
            both = truth.is_decidable & closed.is_decidable
            assert (closed.value[both] >= 0).all()
            assert np.array_equal(truth.value[both] > 0, closed.value[both] > 0)
            by_closed += int(both.sum())
        tested += int(sure.sum())
        shaded += int((truth.value[sure] > 0).sum())
    assert tested >= 20, "too few points were beyond doubt to mean anything"
    assert shaded > 0, "no point was in shadow: the test would prove nothing"
    assert by_closed > 0 or not len(solids), "no closed volume was tried"
    assert grazing <= 1 + 0.02 * turns, "lights graze faces far more often than chance allows"


def assert_grazed(corners: np.ndarray, light: np.ndarray, tolerance_m: float) -> None:
    """Check that faces whose record faces otherwise than they are barely grazed.

    The light may lie off a face's plane by the tilt that a record allows, seen
    from the face, and by the record's tolerance.
    """
    a, b, c = (corners[:, i].astype(np.float64) for i in range(3))
    n = np.cross(b - a, c - a)
    towards = light[:3].astype(np.float64) - light[3] * a
    height = np.abs((n * towards).sum(axis=1)) / np.linalg.norm(n, axis=1)
    reach = np.linalg.norm(towards, axis=1)
    assert (height <= 1.01 * MOST_TILT_RAD * reach + 2.0 * light[3] * tolerance_m).all()


def _points_behind(
    corners: np.ndarray, light: np.ndarray, n: int, rng: np.random.Generator
) -> np.ndarray:
    """Return points around a component, most of them on its side away from the light."""
    corners = corners.reshape(-1, 3).astype(np.float64)
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = max(float((high - low).max()), 1e-6)
    at = rng.uniform(low - 0.1 * size, high + 0.1 * size, (n, 3))
    away = light[3] * at - light[:3].astype(np.float64)
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-30)
    return at + away * rng.uniform(-0.5, 2.0, (n, 1)) * size


def test_repair_changes_no_occlusion(built: Built, is_long: bool) -> None:
    """Random rays against the raw quantised triangles and against the repaired ones."""
    raw, mesh = built.welded, built.prepared.mesh
    n_rays = 100_000 if is_long else 10_000
    rng = np.random.default_rng(4)
    origins, directions = _random_rays(raw.positions, raw.faces, n_rays, rng)
    before = _is_occluded(raw.positions, raw.faces, origins, directions)
    after = _is_occluded(mesh.positions, mesh.faces, origins, directions)
    assert before.any(), "no ray met anything: the test would prove nothing"
    for ray in np.flatnonzero(before != after):
        assert _meets_any(raw.positions, raw.faces, origins[ray], directions[ray]) == _meets_any(
            mesh.positions, mesh.faces, origins[ray], directions[ray]
        )


def _random_rays(
    positions: np.ndarray, faces: np.ndarray, n: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return rays from near faces and from anywhere in the bounds, float32."""
    corners = positions[faces[rng.integers(len(faces), size=n)]].astype(np.float64)
    share = rng.dirichlet((1.0, 1.0, 1.0), size=n)
    at = (corners * share[:, :, None]).sum(axis=1)
    size = float(np.ptp(positions, axis=0).max())
    at += rng.normal(size=(n, 3)) * size * 10.0 ** rng.uniform(-5, -1, (n, 1))
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return at.astype(np.float32), directions.astype(np.float32)


def _is_occluded(
    positions: np.ndarray, faces: np.ndarray, origins: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene(robust=True)
    TriangleMesh(scene, np.ascontiguousarray(positions[faces], np.float32))
    return scene.run(origins, directions, query="OCCLUDED") >= 0


def _meets_any(
    positions: np.ndarray, faces: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> bool:
    """Brute force in float64: does the ray meet any face?"""
    a, b, c = (positions[faces[:, i]].astype(np.float64) - origin for i in range(3))
    d = direction.astype(np.float64)
    turns = [(np.cross(p, q) * d).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))]
    inside = (np.min(turns, axis=0) >= 0) | (np.max(turns, axis=0) <= 0)
    n = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (n * a).sum(axis=1) / (n @ d)
    return bool((inside & (t > 0)).any())
