"""Types, parents, surfaces, places and options: what the report, `info` and errors say of them."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from svprep import cli, cli_export, report
from svprep.cache.reader import open_cache
from svprep.cache.writer import write_cache
from svprep.cli_build import build_lines, crs_name, info_lines
from svprep.cli_silhouette import objects_named
from svprep.errors import InputError
from svprep.model import Labels, Place, Prepared, SourceFile
from tests.unit.cache_samples import strip_and_tetrahedron

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n"


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def told(prepared: Prepared) -> dict:
    """Return what ``info --json`` says of a city, written and read."""
    write_cache(prepared, "a.svp.h5")
    from svprep.cli_build import describe

    return describe(Path("a.svp.h5"))


def test_info_says_types_parts_surfaces_and_the_place() -> None:
    summary = told(strip_and_tetrahedron())
    assert summary["object_types"] == {"": 1, "BuildingPart": 1}
    assert summary["objects_with_parent"] == 1
    assert summary["faces_by_surface"] == {"": 4, "RoofSurface": 2}
    assert summary["place"]["latitude_deg"] == 51.99
    json.dumps(summary)
    lines = info_lines(summary)
    assert "types    not stated 1, BuildingPart 1; 1 are parts of others" in lines
    assert "surfaces not stated 4, RoofSurface 2" in lines
    assert (
        "place    EPSG:7415; 51.99000 N 4.38000 E; grid north is 0.78 degrees west of true north"
    ) in lines


def test_what_is_not_stated_takes_no_line() -> None:
    sample = strip_and_tetrahedron()
    plain = replace(sample, labels=Labels.none(2, 6), place=Place())
    lines = info_lines(told(plain))
    assert "place    no CRS is stated; +y is taken for north" in lines
    assert not [line for line in lines if line.startswith(("types", "surfaces"))]
    unplaced = replace(sample, place=Place("EPSG:7415"))
    assert "place    EPSG:7415; true north is not known" in info_lines(told(unplaced))
    south = replace(sample, place=Place('PROJCRS["local",BASEGEOGCRS["x"]]', -33.0, -70.5, 0.25))
    assert (
        "place    local; 33.00000 S 70.50000 W; grid north is 0.25 degrees east of true north"
    ) in info_lines(told(south))
    assert crs_name("+proj=tmerc") == "+proj=tmerc"


def test_wkt_is_shown_by_its_name_alone() -> None:
    wkt = 'PROJCRS["local",BASEGEOGCRS["x"]]'
    sample = strip_and_tetrahedron()
    sources = tuple(replace(source, crs=wkt) for source in sample.sources)
    summary = told(replace(sample, sources=sources, place=Place(wkt, 52.0, 4.0, 0.0)))
    assert summary["sources"][0]["crs"] == wkt
    lines = info_lines(summary)
    assert not [line for line in lines if "BASEGEOGCRS" in line]
    assert [line for line in lines if line.startswith("source") and line.endswith("CRS local)")]
    exported = cli_export.run(Path("a.svp.h5"), "a.obj")
    assert exported["crs"] == wkt
    assert "crs      local" in cli_export.summary_lines(exported)


def test_very_many_sources_and_notes_stay_readable() -> None:
    sample = strip_and_tetrahedron()
    sources = tuple(SourceFile(f"{i}.gml", "citygml", 10**6, "ab", "EPSG:1") for i in range(3000))
    many = replace(sample, sources=sources, notes=tuple(f"note {i}" for i in range(3000)))
    summary = told(many)
    assert len(summary["sources"]) == len(summary["notes"]) == 3000
    lines = info_lines(summary)
    assert len(lines) < 130
    assert "source   ... and 2,988 more, 3000.0 MB in all; --json lists them" in lines
    assert "note     ... and 2,975 more; --json lists them" in lines
    assert any(line.endswith("CRS EPSG:1)") for line in lines)
    built = {"seconds": {}, "stages": [], "remarks": [], "reused_objects": 0}
    assert build_lines({**summary, **built})[0] == "sources  3,000 files, 3000.0 MB"


def test_reports_have_types_parents_and_surfaces() -> None:
    sample = strip_and_tetrahedron()
    report.write_report(sample, "r.json")
    found = json.loads(Path("r.json").read_text())
    assert found["object_types"] == {"": 1, "BuildingPart": 1}
    assert found["place"]["crs"] == "EPSG:7415"
    assert "crs" in found["sources"][0]
    roof, tetrahedron = found["objects"]
    assert (roof["type"], roof["parent"]) == ("BuildingPart", "Haus 7")
    assert roof["faces_by_surface"] == {"RoofSurface": 2}
    assert (tetrahedron["type"], tetrahedron["faces_by_surface"]) == ("", {})
    labels = replace(sample.labels, object_types=("=1+1", ""))
    report.write_report(replace(sample, labels=labels), "r.csv")
    with open("r.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {(row["type"], row["parent"]) for row in rows} == {("'=1+1", "Haus 7"), ("", "")}
    report.write_report(sample, "r.csv")  # over an older one of ours


def parts() -> Labels:
    """Return labels by which the roof is a part of a part, and the tetrahedron its own parent."""
    sample = strip_and_tetrahedron()
    name = sample.object_names[1]
    return replace(sample.labels, object_parents=("Haus 7", name))


def test_a_building_is_named_by_its_id_even_without_a_surface() -> None:
    sample = strip_and_tetrahedron()
    write_cache(replace(sample, labels=parts()), "a.svp.h5")
    with open_cache("a.svp.h5") as cache:
        tetrahedron = cache.object_names[1]
        assert objects_named(cache, ("Haus 7",)).tolist() == [0]
        assert objects_named(cache, ("roof",)).tolist() == [0]
        assert objects_named(cache, (tetrahedron,)).tolist() == [1]
        assert objects_named(cache, ("roof", tetrahedron)).tolist() == [0, 1]
        with pytest.raises(InputError, match="close to it: 'Haus 7'"):
            objects_named(cache, ("haus 7",))
        with pytest.raises(InputError, match="it is a type, and --objects asks for names here"):
            objects_named(cache, ("buildingpart",))
    chained = replace(sample.labels, object_parents=("Haus 7", "roof"))
    write_cache(replace(sample, labels=chained), "b.svp.h5")
    with open_cache("b.svp.h5") as cache:
        assert objects_named(cache, ("Haus 7",)).tolist() == [0, 1]
        assert objects_named(cache, ("roof",)).tolist() == [0, 1]
        assert objects_named(cache, (cache.object_names[1],)).tolist() == [1]


def test_the_command_that_builds_again_has_the_options(capfd: pytest.CaptureFixture[str]) -> None:
    config = {
        "weld_tolerance_m": 0.01,
        "lod": "2.2",
        "objects": ["Building", "my type"],
        "terrain": False,
        "openings": False,
    }
    write_cache(replace(strip_and_tetrahedron(), config=config), "a.svp.h5")
    with h5py.File("a.svp.h5", "r+") as file:
        file.attrs.modify("schema_version", np.uint32(3))
    assert cli.run(["info", "a.svp.h5"]) == 1
    assert (
        "-o a.svp.h5 --weld-tolerance 0.01 --lod 2.2 --objects Building --objects 'my type' "
        "--no-terrain --no-openings"
    ) in capfd.readouterr().err


def test_options_are_stored_as_far_as_they_differ(capfd: pytest.CaptureFixture[str]) -> None:
    Path("a.obj").write_text(TRIANGLE)
    assert cli.run(["build", "a.obj"]) == 0
    assert cli.run(["build", "a.obj", "-o", "b.svp.h5", "--lod", "2", "--no-terrain"]) == 0
    out = capfd.readouterr().out
    assert "note     a.obj: this format (obj) states no levels of detail" in out
    assert "note     a.obj: no types of objects are stated, so --no-terrain left nothing" in out
    with open_cache("a.svp.h5") as cache:
        assert cache.config == {"weld_tolerance_m": 0.0}
    with open_cache("b.svp.h5") as cache:
        assert cache.config == {"weld_tolerance_m": 0.0, "lod": "2", "terrain": False}


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["build", "a.obj", "--lod", "high"], 2, '--lod is "highest" or a number'),
        (["build", "a.obj", "--objects", ""], 2, "--objects names a type"),
        (["build", "a.obj", "--objects", "Building"], 1, "a.obj: this file states no types"),
        (["build", "no*.obj"], 1, "no*.obj: no file or folder matches this pattern"),
        (["info", "a.city.json"], 1, "svprep build a.city.json"),
        (["export", "a.gml", "-o", "a.obj"], 1, "svprep build a.gml"),
        (["export", "a.svp.h5"], 2, "-o"),
    ],
)
def test_one_line(
    arguments: list[str], status: int, says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    Path("a.obj").write_text(TRIANGLE)
    assert cli.run(arguments) == status
    out, err = capfd.readouterr()
    assert out == ""
    assert says in err
    assert err.count("\n") == 1


def test_export_is_a_command(capfd: pytest.CaptureFixture[str]) -> None:
    Path("a.obj").write_text(TRIANGLE)
    assert cli.run(["build", "a.obj", "--json"]) == 0
    built = json.loads(capfd.readouterr().out)
    assert cli.run(["export", "a.svp.h5", "-o", "b.obj", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["faces"] == 1
    assert cli.run(["export", "a.svp.h5", "-o", "b.obj"]) == 0
    assert capfd.readouterr().out.startswith("export   b.obj")
    assert cli.run(["build", "b.obj", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["vertices"] == built["vertices"]
