"""Whole city files from the command line: every id, type, surface, CRS and option arrives.

What each reader makes of geometry is told by the tests of its own; here a build is looked at
from outside, as a user does.
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from svprep.cache.reader import open_cache
from svprep.cache.verify import verify
from svprep.cli import run
from tests.dataset.datasets import DATA, SHARED

HAMLET = DATA / "hamlet.city.json"


@dataclass(frozen=True)
class City:
    """What a build of a file must say."""

    objects: int
    types: dict[str, int]
    n_parts: int = 0
    surfaces: frozenset[str] = frozenset()
    """Names that occur; "" is not listed."""
    crs: str = ""
    at: tuple[float, float] | None = None
    """Latitude and longitude, to a hundredth of a degree."""


BUILDING = frozenset({"RoofSurface", "WallSurface", "GroundSurface"})
CITIES = {
    "denhaag_01.gml.gz": City(
        1991,
        {"BuildingPart": 1653, "Building": 337, "TINRelief": 1},
        n_parts=1654,  # the terrain is a component of its ReliefFeature, which CityJSON lacks
        surfaces=BUILDING,
        crs="EPSG:28992",
        at=(52.10, 4.27),
    ),
    "denhaag_01_v0.json": City(
        1991,
        {"BuildingPart": 1653, "Building": 337, "TINRelief": 1},
        n_parts=1653,
        surfaces=BUILDING,
    ),
    "delfshaven.city.json": City(
        853, {"Building": 853}, surfaces=BUILDING, crs="EPSG:28992", at=(51.91, 4.46)
    ),
    "delft.city.json": City(
        570,
        {"Building": 160, "Road": 143, "PlantCover": 126, "LandUse": 81}
        | {"GenericCityObject": 54, "Bridge": 3, "WaterBody": 3},
        crs="EPSG:7415",
        at=(52.01, 4.37),
    ),
    "munich_lod2.gml": City(
        111, {"Building": 111}, surfaces=BUILDING, crs="EPSG:31468", at=(49.48, 10.96)
    ),
    "campus_terrain.city.json": City(
        306, {"Building": 305, "TINRelief": 1}, crs="EPSG:32734", at=(-33.94, 18.45)
    ),
    "wageningen_7-624-528": City(2956, {}, crs="PROJCRS", at=(51.96, 5.63)),
    "campus_lod1.obj": City(152, {}),
}


def shared(name: str) -> Path:
    path = SHARED / "cities" / name
    if not path.exists():
        pytest.skip(f"../shared/data/cities/{name} is absent: not built")
    return path


def built(
    capfd: pytest.CaptureFixture[str], *arguments: str | Path, cache: str = "a.svp.h5"
) -> dict:
    """Build and return what ``--json`` says."""
    assert run(["build", *map(str, arguments), "-o", cache, "--json"]) == 0, capfd.readouterr().err
    out, err = capfd.readouterr()
    assert err == ""
    assert verify(Path(cache)) == []
    return json.loads(out)


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def names_in(cache: str = "a.svp.h5") -> Counter[str]:
    with open_cache(cache) as opened:
        return Counter(opened.object_names)


def test_the_hamlet_from_end_to_end(capfd: pytest.CaptureFixture[str]) -> None:
    said = built(capfd, HAMLET, "--report", "r.csv")
    assert said["object_types"] == {"BuildingPart": 2, "Building": 1, "TINRelief": 1}
    assert said["objects_with_parent"] == 2
    assert said["faces_by_surface"] == {
        "WallSurface": 32, "RoofSurface": 8, "GroundSurface": 6, "": 2, "Window": 2,
    }  # fmt: skip
    assert said["place"]["crs"] == "EPSG:7415"
    assert said["sources"][0]["format"] == "cityjson"
    with open("r.csv", newline="") as file:
        rows = {row["object"]: row for row in csv.DictReader(file)}
    assert {n: (r["type"], r["parent"]) for n, r in rows.items()} == {
        "house": ("Building", ""),
        "farm-main": ("BuildingPart", "farm"),
        "farm-barn": ("BuildingPart", "farm"),
        "meadow": ("TINRelief", ""),
    }
    assert rows["meadow"]["defect"] == "OPEN_SHELL"
    arc = "sun:2026-06-21/00:00/24:00/1h[Europe/Amsterdam]"  # no place: the cache knows it
    assert run(["hours", "a.svp.h5", "--light", arc, "-o", "h.csv", "--json"]) == 0
    facts = json.loads(capfd.readouterr().out)["facts"]
    assert facts["samples whose kind the files state"] == facts["samples"]
    with open("h.csv", newline="") as file:
        lines = [line for line in file if not line.startswith("#")]
    hours = {(row["object"], row["kind"]): row for row in csv.DictReader(lines)}
    assert set(hours) == {
        *((name, kind) for name in ("house", "farm-main", "farm-barn")
          for kind in ("roof", "wall", "underside")),
        ("meadow", "ground"),
    }  # fmt: skip
    assert hours["farm-barn", "roof"]["parent"] == "farm"
    assert hours["meadow", "ground"]["source"] == "hamlet.city.json"
    assert float(hours["house", "roof"]["area_m2"]) == pytest.approx(100.0, rel=1e-3)


def test_options_leave_out_what_they_say(capfd: pytest.CaptureFixture[str]) -> None:
    built(capfd, HAMLET, "--objects", "building")
    assert set(names_in()) == {"house", "farm-main", "farm-barn"}
    built(capfd, HAMLET, "--no-terrain")
    assert set(names_in()) == {"house", "farm-main", "farm-barn"}
    said = built(capfd, HAMLET, "--no-openings")
    assert said["faces"] == 48
    assert (
        "hamlet.city.json: 1 polygon left out by --no-openings (Window 1): walls keep holes where "
        "these stood, and light falls through"
    ) in said["notes"]
    built(capfd, HAMLET, "--lod", "1")
    assert set(names_in()) == {"house", "farm", "meadow"}
    assert run(["silhouette", "a.svp.h5", "--light", "dir:1,1", "--objects", "farm-main"]) == 1
    assert 'no object "farm-main"' in capfd.readouterr().err
    assert run(["build", str(HAMLET), "-o", "b.svp.h5", "--objects", "Tree"]) == 1
    assert "the types are BuildingPart 2, Building 1, TINRelief 1" in capfd.readouterr().err


def test_two_files_in_one_frame(capfd: pytest.CaptureFixture[str]) -> None:
    Path("in").mkdir()
    text = HAMLET.read_text()
    Path("in/a.city.json").write_text(text)
    degrees = json.loads(text)
    degrees["metadata"]["referenceSystem"] = "https://www.opengis.net/def/crs/EPSG/0/28992"
    Path("in/b.city.json").write_text(json.dumps(degrees))
    Path("in/notes.txt").write_text("hello")
    said = built(capfd, "in")
    assert said["objects"] == 8
    assert [s["path"] for s in said["sources"]] == ["in/a.city.json", "in/b.city.json"]
    with open_cache("a.svp.h5") as cache:
        low = np.array_split(cache.mesh.positions, 2)
        assert cache.object_source.tolist() == [0] * 4 + [1] * 4
        np.testing.assert_allclose(low[0], low[1], atol=1e-3)


@pytest.mark.parametrize("name", CITIES)
def test_city(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    said, city = built(capfd, shared(name)), CITIES[name]
    assert said["objects"] == city.objects
    assert said["object_types"] == city.types
    assert said["objects_with_parent"] == city.n_parts
    assert {s for s in said["faces_by_surface"] if s} == city.surfaces
    assert said["place"]["crs"].startswith(city.crs)
    assert bool(said["place"]["crs"]) == bool(city.crs)
    if city.at:
        found = said["place"]["latitude_deg"], said["place"]["longitude_deg"]
        assert found == pytest.approx(city.at, abs=0.01)
        assert abs(said["place"]["convergence_deg"]) < 3.0


def test_the_whole_folder_of_ingolstadt(capfd: pytest.CaptureFixture[str]) -> None:
    folder = shared("ingolstadt_lod3")
    said = built(capfd, folder)
    assert len(said["sources"]) == 13
    assert said["object_types"]["Building"] == 13
    assert {s["crs"] for s in said["sources"]} == {"EPSG:32632"}
    without = built(capfd, folder, "--no-openings", cache="b.svp.h5")
    assert not {"Window", "Door"} & set(without["faces_by_surface"])
    assert without["objects"] == said["objects"]
