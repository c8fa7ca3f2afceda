"""--crs: the CRS of files that state none, or one that nobody knows."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from svprep import cli
from svprep.cache.reader import open_cache
from svprep.errors import EnvironmentProblem, InputError
from svprep.ingest import read
from svprep.ingest.crs_given import crs_in_use
from svprep.ingest.options import ReadOptions

TRIANGLE = "v 85000 447000 0\nv 85010 447000 0\nv 85010 447010 0\nf 1 2 3\n"


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.obj").write_text(TRIANGLE)


def city(vertices: list[list[float]], crs: str = "") -> str:
    """Return CityJSON of one sheet."""
    surface = {"type": "MultiSurface", "lod": "2", "boundaries": [[[0, 1, 2]]]}
    return json.dumps(
        {
            "type": "CityJSON",
            "version": "1.0",
            "metadata": {"referenceSystem": crs} if crs else {},
            "CityObjects": {"b": {"type": "Building", "geometry": [surface]}},
            "vertices": vertices,
        }
    )


def gml(positions: str) -> str:
    """Return CityGML of one triangle, in no CRS."""
    return f"""<CityModel xmlns="http://www.opengis.net/citygml/2.0"
        xmlns:gml="http://www.opengis.net/gml" xmlns:b="http://www.opengis.net/citygml/building/2.0"
        ><cityObjectMember><b:Building gml:id="b"><b:lod2MultiSurface><gml:MultiSurface>
        <gml:surfaceMember><gml:Polygon><gml:exterior><gml:LinearRing><gml:posList>{positions}
        </gml:posList></gml:LinearRing></gml:exterior></gml:Polygon></gml:surfaceMember>
        </gml:MultiSurface></b:lod2MultiSurface></b:Building></cityObjectMember></CityModel>"""


IN_DELFT = [[85000, 447000, 0], [85010, 447000, 0], [85010, 447010, 0]]


def test_it_counts_where_none_is_stated_or_known() -> None:
    Path("u.json").write_text(city(IN_DELFT, "EPSG:1234"))
    Path("k.json").write_text(city(IN_DELFT, "EPSG:28992"))
    mesh = read(["a.obj", "u.json", "k.json"], options=ReadOptions(crs="EPSG:28992"))
    assert mesh.place.crs == "EPSG:28992"
    assert mesh.place.latitude_deg == pytest.approx(52.0, abs=0.1)
    assert [source.crs for source in mesh.sources] == ["", "EPSG:1234", "EPSG:28992"]
    np.testing.assert_array_equal(mesh.positions[:3], mesh.positions[3:6])
    assert mesh.notes == (
        "a.obj: no CRS is stated; taken to be EPSG:28992 (--crs)",
        'u.json: the CRS "EPSG:1234" is none that pyproj knows; taken to be EPSG:28992 (--crs)',
        'k.json: the CRS "EPSG:28992" is stated, so --crs EPSG:28992 is ignored',
    )


def test_a_known_one_is_never_overridden() -> None:
    assert crs_in_use("EPSG:28992", "EPSG:25832") == "EPSG:28992"
    assert crs_in_use("EPSG:28992", "") == "EPSG:28992"
    assert crs_in_use(" ", "") == " "
    assert crs_in_use("", "EPSG:25832") == "EPSG:25832"


@pytest.mark.parametrize("name", ["d.json", "d.gml"])
def test_degrees_are_read_as_if_the_file_stated_them(name: str) -> None:
    # Latitude first, as only that lies in Japan: x is to the east all the same.
    at = [[35.7, 139.7, 1.0], [35.7, 139.7001, 1.0], [35.7001, 139.7001, 9.0]]
    ring = [*at, at[0]]
    text = gml(" ".join(f"{c}" for p in ring for c in p)) if name == "d.gml" else city(at)
    Path(name).write_text(text)
    mesh = read([name], options=ReadOptions(crs="EPSG:6697"))
    assert mesh.place.latitude_deg == pytest.approx(35.7, abs=0.001)
    assert mesh.place.longitude_deg == pytest.approx(139.7, abs=0.001)
    east_m, north_m, up_m = np.ptp(mesh.positions, axis=0)
    assert (east_m, north_m, up_m) == pytest.approx((9.05, 11.1, 8.0), abs=0.1)


def test_the_cache_and_the_command_that_builds_again_have_it(
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert cli.run(["build", "a.obj", "--crs", "EPSG:28992"]) == 0
    assert "place    EPSG:28992; 52." in capfd.readouterr().out
    with open_cache("a.svp.h5") as cache:
        assert cache.config == {"weld_tolerance_m": 0.0, "crs": "EPSG:28992"}
    with h5py.File("a.svp.h5", "r+") as file:
        file.attrs.modify("schema_version", np.uint32(3))
    assert cli.run(["info", "a.svp.h5"]) == 1
    assert "-o a.svp.h5 --crs EPSG:28992" in capfd.readouterr().err


@pytest.mark.parametrize("crs", ["", "EPSG:1234", "EPSG:5703", "the grid of Delft"])
def test_another_text_is_a_usage_error(crs: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["build", "a.obj", "--crs", crs]) == 2
    assert f'such as EPSG:28992, not "{crs}"' in capfd.readouterr().err
    if crs:
        with pytest.raises(InputError, match="one on Earth that pyproj knows"):
            ReadOptions(crs=crs)


def test_errors_and_notes_name_it() -> None:
    Path("u.json").write_text(city(IN_DELFT, "EPSG:1234"))
    Path("k.json").write_text(city(IN_DELFT, "EPSG:28992"))
    Path("d.json").write_text(
        city([[4.0, 52.0, 0.0], [4.1, 52.0, 0.0], [4.1, 52.1, 0]], "OGC:CRS84")
    )
    assert "true north is unknown; name it: --crs EPSG:..." in read(["u.json"]).notes[0]
    for one, other in (("k.json", "u.json"), ("d.json", "a.obj")):
        with pytest.raises(InputError, match=r", or name it: --crs EPSG:\.\.\.\."):
            read([one, other])


def test_it_needs_pyproj(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("svprep.ingest.crs_names.has_pyproj", lambda: False)
    with pytest.raises(EnvironmentProblem, match="pyproj"):
        ReadOptions(crs="EPSG:28992")
