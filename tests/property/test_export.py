"""Any repaired soup survives its export, bit for bit and vertex by vertex, in every format."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from svprep.errors import InputError
from svprep.export.city import city_of, distinct, has_grid_of_a_build
from svprep.export.output import write_export
from svprep.model import Prepared, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from tests.property.meshes import any_mesh, grid_meshes, moved, scaled
from tests.unit.export_checks import FORMS, assert_round_trip, built


@st.composite
def placed(draw: st.DrawFn) -> SourceMesh:
    """Soups anywhere on Earth, of any size, off every grid."""
    mesh = draw(st.one_of(any_mesh(), grid_meshes(20, 4)))
    factor = draw(st.sampled_from([1.0, 0.1, 1 / 3, 1e-3, 1234.5]))
    shift = draw(st.sampled_from([(0.0, 0.0, 0.0), (85_000.3, 446_000.1, -2.7), (5e6, -3e6, 0.1)]))
    return moved(scaled(mesh, factor), shift)


def prepared(mesh: SourceMesh) -> Prepared:
    """Return the city of a soup, without objects that are empty: most formats drop those."""
    try:
        city = prepare(mesh, BuildConfig())
    except InputError:  # no face has any area
        assume(False)
        raise
    assume(bool((np.diff(city.mesh.object_face_start) > 0).all()))
    return city


@given(mesh=placed(), form=st.sampled_from(FORMS))
@settings(max_examples=60)
def test_soups_come_back(mesh: SourceMesh, form: str) -> None:
    first = prepared(mesh)
    city = city_of(first)
    with tempfile.TemporaryDirectory() as folder:
        if has_grid_of_a_build(city):
            assert_round_trip(first, Path(folder), form)
            return
        again = built(write_export(city, Path(folder) / f"out.{form}")).mesh
    # On another grid: the same triangles at the same places.
    there = first.mesh.grid.origin_m + first.mesh.positions[first.mesh.faces]
    assert np.array_equal(again.grid.origin_m + again.positions[again.faces], there)


@given(names=st.lists(st.sampled_from(["a", "a~2", "a~3", "b", "", "a~2~2"]), max_size=12))
def test_names_become_different_and_first_ones_stay(names: list[str]) -> None:
    unique = distinct(names)
    assert len(set(unique)) == len(names)
    for i, name in enumerate(names):
        assert unique[i].startswith(name)
        assert unique[i] == name or name in names[:i]
    assert distinct(unique) == unique
