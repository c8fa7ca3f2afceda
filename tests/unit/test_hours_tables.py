"""Sun hours as tables: quantiles, the CSV with its header, the point cloud."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svprep import __version__
from svprep.cache.reader import Cache, open_cache
from svprep.cache.writer import write_cache
from svprep.errors import EnvironmentProblem, InputError
from svprep.hours import Kind, SunHours, sun_hours
from svprep.hours.buried import Burial
from svprep.hours.csv_table import COLUMNS, csv_parts
from svprep.hours.facts import facts_of
from svprep.hours.output import HOURS, write_hours
from svprep.hours.ply_points import BURIED_GREY, ramp
from svprep.hours.summary import kind_totals, rows_of
from svprep.report import total_counts
from tests.unit.hours_scenes import VIENNA, arc_at, box, city, level

NAMES = (
    "plain",
    'with, comma and "quotes"',
    "two\nlines\r\n# not a comment",
    "# not a comment either",
    "=1+1",
    " @cmd",
    "-12",
    "Türmchen \N{CASTLE}",
    "bytes \udcff\udc80",
    "",
    "tab\there",
)
SPEC = "2026-06-21/05:00/21:00/1h"


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    """Return a city of houses with hostile names, one of them in another's wall."""
    houses = [box((12.0 * k, 0, -1), (12.0 * k + 8, 9, 5 + k)) for k in range(len(NAMES) - 1)]
    ground = level(-20, -30, 140, 40)
    path = tmp_path_factory.mktemp("hours") / "odd\nname.svp.h5"
    write_cache(city(ground, *houses, names=NAMES), path)
    return open_cache(path)


@pytest.fixture(scope="module")
def hours(cache: Cache) -> SunHours:
    return sun_hours(cache, arc_at(VIENNA, SPEC), spacing_m=1.5)


@pytest.fixture(scope="module")
def table(cache: Cache, hours: SunHours) -> bytes:
    return b"".join(csv_parts(hours, facts_of(hours, cache)))


def parsed(table: bytes) -> tuple[dict[str, str], list[list[str]]]:
    """Return a CSV's header as it says, and its rows."""
    text = table.decode("utf-8")
    n_lines = int(text.split("\n")[1].removeprefix("# header lines: "))
    lines = text.split("\n", n_lines)
    assert all(line.startswith("# ") for line in lines[:n_lines])
    header = dict(line[2:].split(": ", 1) for line in lines[1:n_lines])
    return header, list(csv.reader(io.StringIO(lines[n_lines], newline="")))


def test_rows_are_quantiles_of_their_samples(hours: SunHours) -> None:
    rows = rows_of(hours)
    start = hours.groups.sample_start
    assert rows.samples.sum() == hours.n_samples
    assert rows.buried.sum() == hours.is_buried.sum() > 0
    for i in range(len(rows.samples)):
        here = slice(start[i], start[i + 1])
        left = ~hours.is_buried[here]
        for found, minutes in (
            (rows.total, hours.total_minutes),
            (rows.longest, hours.longest_minutes),
        ):
            values = minutes[here][left]
            for name, q in (("median", 0.5), ("min", 0.0), ("p10", 0.1), ("p90", 0.9)):
                assert found[name][i] == np.quantile(values, q, method="inverted_cdf")
            assert found["mean"][i] == pytest.approx(values.mean())


def test_totals_weight_samples_by_the_area_they_stand_for(hours: SunHours) -> None:
    weight = hours.area_of_sample_m2
    assert len(np.unique(np.round(weight, 6))) > 1  # so equal weights would be wrong
    totals = kind_totals(hours)
    assert [t.kind for t in totals] == list(Kind)
    assert sum(t.area_m2 for t in totals) == pytest.approx(weight.sum())
    for total in totals:
        chosen = (hours.kind == total.kind) & ~hours.is_buried
        values = hours.total_minutes[chosen]
        for name, q in (("median", 0.5), ("min", 0.0), ("p10", 0.1), ("p90", 0.9)):
            order = np.argsort(values, kind="stable")
            reach = np.cumsum(weight[chosen][order]) / weight[chosen].sum()
            wanted = values[order][np.searchsorted(reach, q * (1 - 1e-9))]
            assert total.total[name] == wanted
        assert total.total_mean == pytest.approx(np.average(values, weights=weight[chosen]))


def test_what_is_all_buried_has_no_quantile() -> None:
    # The inner box stands in the outer one: nothing of it sees the sun.
    prepared = city(box((0, 0, 0), (9, 9, 9)), box((3, 3, 3), (5, 5, 5)))
    hours = sun_hours(prepared, arc_at(VIENNA, SPEC))
    rows = rows_of(hours)
    inner = hours.groups.object == 1
    assert (rows.buried == rows.samples).tolist() == inner.tolist()
    assert np.isnan(rows.total["median"]).tolist() == inner.tolist()


def test_the_header_says_everything(cache: Cache, hours: SunHours, table: bytes) -> None:
    header, _ = parsed(table)
    assert table.startswith(b"# svprep sun hours 2\n# header lines: ")
    arc = hours.arc
    assert header == {
        "header lines": str(len(header) + 1),
        "svprep": __version__,
        "cache": "odd\\nname.svp.h5",
        "cache content digest": cache.content_digest,
        "sources": "".join(f"test.obj SHA-256 {s.sha256}" for s in cache.sources),
        "model extent x y z metres": "160.0, 70.0, 15.0",
        "sun's altitude at begin and end degrees": "0.45, -1.01",
        "coordinate reference system": "not stated",
        "light": arc.spec,
        "latitude": "48.2",
        "longitude": "16.37",
        "zone": "Europe/Vienna",
        "date": "2026-06-21",
        "begin": "2026-06-21T05:00:00+02:00",
        "end": "2026-06-21T21:00:00+02:00",
        "step minutes": "60.0",
        "steps": "16",
        "night steps skipped": str(arc.n_night),
        "meridian convergence degrees": "grid north taken as true north (no CRS)",
        "sample spacing metres": "1.5",
        "ray offset metres": "0.001",
        "grid step metres": repr(cache.grid.step_m),
        "samples": str(hours.n_samples),
        "samples buried in solids": str((hours.points.burial == Burial.IN_SOLID).sum()),
        "samples buried under the ground": str((hours.points.burial == 2).sum()),
        "samples on surfaces that are not solid": str((hours.object == 0).sum()),
        "repair findings": ", ".join(f"{k} {n}" for k, n in total_counts(cache.repair).items()),
        "side that counts": header["side that counts"],
        "kinds as the files name surfaces": header["kinds as the files name surfaces"],
        "kinds by geometry": header["kinds by geometry"],
        "samples whose kind the files state": "0",
        "samples on level faces of files that call every face a wall, by geometry": "0",
        "sunlit": header["sunlit"],
        "atmosphere": "refraction is included; weather and terrain beyond the model are not",
        "columns": header["columns"],
        "names": header["names"],
    }
    assert "D302 OPEN_SHELL 4" in header["repair findings"]
    for key, word in (
        ("kinds by geometry", "60 degrees"),
        ("kinds as the files name surfaces", "RoofSurface"),
        ("columns", "Hyndman"),
        ("sunlit", "in front"),
    ):
        assert word in header[key]


def test_rows_keep_hostile_names_apart(hours: SunHours, table: bytes) -> None:
    _, (columns, *rows) = parsed(table)
    assert tuple(columns) == COLUMNS
    assert len(rows) == len(hours.groups.kind) == 1 + 3 * (len(NAMES) - 1)
    by_index = {int(row[0]): row[1] for row in rows}
    assert by_index == {
        i: name.encode("utf-8", "backslashreplace").decode() if i not in (4, 5, 6) else f"'{name}"
        for i, name in enumerate(NAMES)
    }
    assert {tuple(row[2:5]) for row in rows} == {("", "", "test.obj")}
    assert {row[5] for row in rows} == {"roof", "wall", "ground", "underside"}
    for row, area in zip(rows, hours.groups.area_m2.tolist(), strict=True):
        assert float(row[6]) == pytest.approx(area, rel=1e-3)


def test_pandas_reads_it_in_either_way(table: bytes, hours: SunHours) -> None:
    pandas = pytest.importorskip("pandas")
    n_lines = int(table.split(b"\n")[1].removeprefix(b"# header lines: "))
    by_comment = pandas.read_csv(io.BytesIO(table), comment="#", keep_default_na=False)
    by_lines = pandas.read_csv(io.BytesIO(table), skiprows=n_lines, keep_default_na=False)
    assert by_comment.equals(by_lines)
    assert tuple(by_comment.columns) == COLUMNS
    first = by_comment.drop_duplicates("object_index").set_index("object_index")["object"]
    assert first[2] == NAMES[2]
    assert first[3] == NAMES[3]
    rows = rows_of(hours)
    np.testing.assert_array_equal(by_comment["total_median"], rows.total["median"])
    np.testing.assert_array_equal(by_comment["longest_p90"], rows.longest["p90"])


def test_two_runs_and_three_threads_give_the_same_bytes(
    cache: Cache, table: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clouds = []
    for threads in ("1", "3"):
        monkeypatch.setenv("SVPREP_THREADS", threads)
        again = sun_hours(cache, arc_at(VIENNA, SPEC), spacing_m=1.5)
        assert write_hours(again, cache, tmp_path / "a.csv").read_bytes() == table
        clouds.append(write_hours(again, cache, tmp_path / "a.ply").read_bytes())
    assert clouds[0] == clouds[1]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "a.ply"]


def test_the_point_cloud_is_read_by_others(cache: Cache, hours: SunHours, tmp_path: Path) -> None:
    import trimesh

    path = write_hours(hours, cache, tmp_path / "points.PLY")
    cloud = trimesh.load(path)
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
    source = cache.grid.origin_m + hours.position
    np.testing.assert_array_equal(np.column_stack([raw[axis] for axis in "xyz"]), source)
    np.testing.assert_array_equal(raw["total_minutes"], hours.total_minutes.astype(np.float32))
    np.testing.assert_array_equal(raw["longest_minutes"], hours.longest_minutes.astype(np.float32))
    for name in ("object", "kind"):
        np.testing.assert_array_equal(raw[name], getattr(hours, name))
    np.testing.assert_array_equal(raw["buried"], hours.points.burial)
    assert set(hours.points.burial) == set(Burial)
    colours = cloud.colors[:, :3]
    assert (colours[hours.is_buried] == BURIED_GREY).all()
    most, least = hours.total_minutes == 15 * 60, (hours.total_minutes == 0) & ~hours.is_buried
    assert (colours[least] == ramp(np.zeros(1))).all()
    assert colours[most].mean() > 180 > colours[least].mean()
    head = path.read_bytes().partition(b"end_header\n")[0].decode("ascii")
    assert f"comment light: {hours.arc.spec}\n" in head
    normals = np.stack([raw[f"n{axis}"] for axis in "xyz"], axis=1)
    assert np.allclose(normals, hours.face_normal[hours.face])
    assert "comment property kind: 0 roof, 1 wall, 2 ground, 3 underside\n" in head
    assert "comment cache: odd\\nname.svp.h5\n" in head


def test_pymeshlab_reads_the_point_cloud(cache: Cache, hours: SunHours, tmp_path: Path) -> None:
    pymeshlab = pytest.importorskip("pymeshlab")
    path = write_hours(hours, cache, tmp_path / "points.ply")
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(path))
    source = cache.grid.origin_m + hours.position
    np.testing.assert_array_equal(meshes.current_mesh().vertex_matrix(), source)


def test_lightness_of_the_colours_only_grows() -> None:
    colours = ramp(np.linspace(0, 1, 256)) / 255.0
    linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) > -2e-3).all()
    assert luminance[0] < 0.05 < 0.7 < luminance[-1]


def test_where_sun_hours_may_not_be_written(cache: Cache, hours: SunHours, tmp_path: Path) -> None:
    foreign = tmp_path / "mine.csv"
    foreign.write_text("a,b\n1,2\n")
    model = tmp_path / "model.ply"
    write_hours(hours, cache, model)
    (tmp_path / "link.csv").symlink_to(foreign)
    (tmp_path / "folder.csv").mkdir()
    for path, others, said in (
        (tmp_path / "hours.txt", [], r"written as \.csv or \.ply"),
        (foreign, [], "does not hold sun hours"),
        (tmp_path / "link.csv", [], "does not hold sun hours"),
        (model, [model], "an input, the cache"),
        (tmp_path / "folder.csv", [], "not a regular file"),
    ):
        with pytest.raises(InputError, match=said):
            HOURS.checked_path(path, others)
    with pytest.raises(EnvironmentProblem, match="there is no folder"):
        HOURS.checked_path(tmp_path / "none" / "hours.csv")
    assert foreign.read_text() == "a,b\n1,2\n"
    write_hours(hours, cache, model)  # ours may be written again
    assert not list(tmp_path.glob(".*"))


def test_files_of_one_name_are_told_apart() -> None:
    pair = city(level(0, 0, 2, 2), level(5, 0, 7, 2), names=("a", "b"))
    (source,) = pair.sources
    pair = replace(
        pair,
        sources=tuple(replace(source, path=f"x/{part}/city.gml") for part in "ab"),
        object_source=np.array([0, 1], np.uint32),
    )
    assert sun_hours(pair, arc_at(VIENNA, SPEC)).object_sources == ("a/city.gml", "b/city.gml")
