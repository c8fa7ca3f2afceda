"""The cache as ParaView and PyVista see it: the same arrays, through VTK's own reader."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from svprep.cache.reader import open_cache
from svprep.cache.schema import LIBVER, SPEC_OF_PATH
from svprep.cache.verify import verify
from svprep.cache.vtkhdf import VTK_ITEMS
from svprep.cache.writer import _as_stored, write_cache
from svprep.errors import InternalError
from svprep.model import Prepared
from svprep.pipeline import add_lights, build
from tests.unit.cache_samples import no_lights, strip_and_tetrahedron

ROOT = Path(__file__).resolve().parents[2]
CITY = ROOT / "data" / "small_city.obj.gz"


@pytest.fixture(scope="module")
def city(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the cache of the city: long enough that arrays are packed."""
    return build([CITY], tmp_path_factory.mktemp("vtk") / "city.svp.h5").cache.path


def read_by_vtk(path: Path) -> dict[str, np.ndarray]:
    """Return what VTK's reader makes of a cache, whatever its suffix."""
    vtk = pytest.importorskip("vtk", reason="VTK, which reads the group, is not installed")
    numpy_support = pytest.importorskip("vtkmodules.util.numpy_support")
    to_numpy = numpy_support.vtk_to_numpy
    reader = vtk.vtkHDFReader()
    assert reader.CanReadFile(str(path))
    reader.SetFileName(str(path))
    reader.Update()
    output = reader.GetOutput()
    assert output.GetNumberOfVerts() == output.GetNumberOfLines() == 0
    assert output.GetNumberOfStrips() == 0
    cells, found = output.GetPolys(), {"Points": to_numpy(output.GetPoints().GetData())}
    found["Connectivity"] = to_numpy(cells.GetConnectivityArray())
    found["Offsets"] = to_numpy(cells.GetOffsetsArray())
    for data in (output.GetCellData(), output.GetFieldData()):
        for i in range(data.GetNumberOfArrays()):
            found[data.GetArrayName(i)] = to_numpy(data.GetArray(i)).reshape(-1)
    return {name: np.array(array) for name, array in found.items()}


def expected(prepared: Prepared) -> dict[str, np.ndarray]:
    mesh, parts = prepared.mesh, prepared.components
    n_objects, n_components = len(prepared.object_names), len(parts.flags)
    return {
        "Points": mesh.positions,
        "Connectivity": mesh.faces.reshape(-1),
        "Offsets": 3 * np.arange(len(mesh.faces) + 1),
        "object": np.repeat(np.arange(n_objects), np.diff(mesh.object_face_start)),
        "component": np.repeat(np.arange(n_components), np.diff(parts.face_start)),
        "plane": prepared.planes.plane_of_face,
        "surface": prepared.labels.surface_of_face,
        "source_face": mesh.source_face,
        "grid_origin_m": mesh.grid.origin_m,
    }


def assert_shown(path: Path) -> None:
    with open_cache(path) as cache:
        wanted = expected(cache.prepared())
    found = read_by_vtk(path)
    assert found.keys() == wanted.keys()
    for name, array in wanted.items():
        assert np.array_equal(found[name], array), name


def test_vtk_reads_a_small_cache(tmp_path: Path) -> None:
    path = tmp_path / "a.svp.h5"
    write_cache(strip_and_tetrahedron(), path)
    assert_shown(path)


def test_vtk_reads_a_city(city: Path) -> None:
    assert_shown(city)


def test_surfaces_are_coloured_as_the_documents_say(tmp_path: Path) -> None:
    vtk = pytest.importorskip("vtk", reason="VTK, which reads the group, is not installed")
    write_cache(strip_and_tetrahedron(), tmp_path / "a.svp.h5")
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(tmp_path / "a.svp.h5"))
    reader.Update()
    mapper = vtk.vtkPolyDataMapper()
    mapper.SetInputData(reader.GetOutput())
    mapper.SetScalarModeToUseCellFieldData()
    mapper.SelectColorArray("surface")
    mapper.SetScalarRange(0, 1)
    taken_for_colours = mapper.MapScalars(1.0)
    assert set(taken_for_colours.GetTuple(0)[:3]) == {1.0}  # as good as black
    mapper.SetColorModeToMapScalars()
    colours = mapper.MapScalars(1.0)
    roof, wall = (colours.GetTuple(face)[:3] for face in (0, 5))
    assert max(roof) == max(wall) == 255.0
    assert roof != wall
    for document in ("README.md", "FORMAT.md"):
        assert "SetColorModeToMapScalars()" in (ROOT / document).read_text("utf-8")


def test_lights_keep_it(city: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(city, tmp_path / "lit.svp.h5"))
    add_lights(path, ["dir:135,40"])
    assert_shown(path)
    assert verify(path) == []


def test_it_is_linked_not_copied(city: Path) -> None:
    own = 0
    with h5py.File(city, locking=False) as file:
        for item in VTK_ITEMS:
            found = file[f"VTKHDF/{item.path}"]
            if item.link:
                assert found == file[item.link]
            else:
                own += found.id.get_storage_size()
                assert found.dtype == np.dtype(item.dtype)
        n_faces = len(file["mesh/source_face"])
    # Per face: packed offsets, object and component.
    assert own / n_faces < 1.0
    assert own < 0.01 * city.stat().st_size


def test_the_same_city_the_same_bytes(city: Path, tmp_path: Path) -> None:
    again = build([CITY], tmp_path / "again.svp.h5").cache.path
    assert again.read_bytes() == city.read_bytes()


def test_svprep_does_not_need_it(city: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(city, tmp_path / "bare.svp.h5"))
    with h5py.File(path, "r+", libver=LIBVER) as file:
        del file["VTKHDF"]
    with open_cache(path) as cache:
        assert cache.prepared().mesh.faces.dtype == np.uint32
    assert [(p.code, p.where) for p in verify(path)] == [("V101", "VTKHDF")]
    # Adding lights writes the group again.
    add_lights(path, ["dir:135,40"])
    assert verify(path) == []


@pytest.mark.parametrize("name", ["Polygons/Offsets", "CellData/object", "CellData/component"])
def test_damage_in_packed_bytes_is_named(name: str, city: Path, tmp_path: Path) -> None:
    path = tmp_path / "copy.svp.h5"
    with h5py.File(city, locking=False) as file:
        chunk = file[f"VTKHDF/{name}"].id.get_chunk_info(0)
    data = bytearray(city.read_bytes())
    for offset in (3, chunk.size // 2, chunk.size - 1):
        damaged = data.copy()
        damaged[chunk.byte_offset + offset] ^= 0x10
        path.write_bytes(damaged)
        (problem,) = verify(path)
        assert problem.code in ("V104", "V106")
        assert problem.where in (f"VTKHDF/{name}", "VTKHDF")


def test_a_huge_announced_array_is_not_read(city: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(city, tmp_path / "huge.svp.h5"))
    with h5py.File(path, "r+", libver=LIBVER) as file:
        del file["VTKHDF/CellData/object"]
        huge: dict[str, Any] = {"chunks": (1 << 16,), "compression": "gzip"}
        file.create_dataset("VTKHDF/CellData/object", (1 << 40,), "<i4", **huge)
    assert [(p.code, p.where) for p in verify(path)] == [("V106", "VTKHDF/CellData/object")]


def test_corners_are_never_negative(tmp_path: Path) -> None:
    path = tmp_path / "a.svp.h5"
    write_cache(strip_and_tetrahedron(), path)
    with h5py.File(path, "r+", libver=LIBVER) as file:
        file["mesh/face_corners"][4] = -1
    assert ("V201", "mesh/face_corners") in [(p.code, p.where) for p in verify(path)]


def test_no_lights_changes_nothing_there(tmp_path: Path) -> None:
    path = tmp_path / "dark.svp.h5"
    write_cache(replace(strip_and_tetrahedron(), clamp=no_lights(2)), path)
    assert_shown(path)


def test_an_index_beyond_int32_is_our_bug() -> None:
    spec = SPEC_OF_PATH["mesh/face_corners"]
    most = np.array([2**31 - 1], "<u4")
    assert _as_stored(spec, most).tolist() == [2**31 - 1]
    with pytest.raises(InternalError, match="mesh/face_corners"):
        _as_stored(spec, most + np.uint32(1))
