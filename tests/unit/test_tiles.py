"""Tiles, runs taken over, files in place of memory: always the cache of a whole, full build."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from svprep import building, older, pipeline
from svprep.building import Room, room_for
from svprep.cache.codec import object_datasets
from svprep.cache.reader import Cache, open_cache
from svprep.cache.runs import PER_OBJECT, Joined, whole_run
from svprep.cache.writer import rewrite_cache
from svprep.content import source_digests
from svprep.errors import CacheError, EnvironmentProblem
from svprep.ingest import read
from svprep.model import I64, SourceMesh
from svprep.parallel import map_ordered
from svprep.pipeline import BuildConfig, BuildResult, build
from svprep.repair.grid import choose_grid
from svprep.tiles import Tile, cut, prepare_objects, prepare_tile, tile_of

ROOT = Path(__file__).resolve().parents[2]
CITY = ROOT / "data" / "small_city.obj.gz"
CONFORMANCE = sorted((ROOT / "data" / "conformance").glob("*.obj"))
SOME = [
    path
    for path in CONFORMANCE
    if path.stem in ("three_faces_on_edge", "mobius_strip", "nested_solids", "doubled_face")
]
SUN = "dir:135,40"


@dataclass(frozen=True)
class Block:
    """One object of an OBJ file."""

    name: str
    vertices: NDArray[np.float64]
    polygons: list[list[int]]


def box(name: str, at: tuple[float, float], *, faces: int = 6, lift: float = 0.0) -> Block:
    """Return a box of 8 m x 6 m x 10 m, without its last faces if `faces` says so."""
    x, y = np.array([0, 8, 8, 0] * 2) + at[0], np.array([0, 0, 6, 6] * 2) + at[1]
    z = np.repeat([0.0, 10.0], 4)
    z[6] += lift
    sides = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    return Block(name, np.stack([x, y, z], axis=1), sides[:faces])


def hill(name: str, at: tuple[float, float]) -> Block:
    """Return a closed, bumpy sheet with enough edges for silhouette trees."""
    n = 20
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    z = 4.0 + np.sin(i * 0.9) + np.cos(j * 0.7)
    top = np.stack([at[0] + i, at[1] + j, z], axis=-1).reshape(-1, 3)
    under = top * [1.0, 1.0, -1.0]
    quads = []
    for a in range(n - 1):
        for b in range(n - 1):
            k = a * n + b
            quads += [
                [k, k + n, k + n + 1, k + 1],
                [n * n + q for q in (k, k + 1, k + n + 1, k + n)],
            ]
    return Block(name, np.concatenate([top, under]), quads)


def broken(name: str, at: tuple[float, float]) -> Block:
    """Return a box with a face twice, one turned, one flat, and a fin on an edge."""
    whole = box(name, at)
    fin = np.array([[at[0] - 3.0, at[1], 5.0]])
    extra = [whole.polygons[0], whole.polygons[2][::-1], [0, 1, 1], [0, 4, 8]]
    return Block(name, np.concatenate([whole.vertices, fin]), [*whole.polygons, *extra])


def town() -> list[Block]:
    """Return a row of boxes, a hill among them, some broken."""
    blocks = [box(f"house {i}", (12.0 * i, 3.0 * (i % 3))) for i in range(12)]
    blocks[3] = broken("house 3", (36.0, 0.0))
    blocks[8] = broken("house 8", (96.0, 6.0))
    blocks[5] = hill("hill", (60.0, 20.0))
    return blocks


def written(blocks: list[Block], path: Path) -> Path:
    """Write an OBJ file."""
    lines, n = [], 1
    for block in blocks:
        lines.append(f"o {block.name}")
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in block.vertices.tolist()]
        lines += ["f " + " ".join(str(n + i) for i in polygon) for polygon in block.polygons]
        n += len(block.vertices)
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def at_once(source: SourceMesh) -> dict[str, np.ndarray]:
    """Return all tables of a mesh, prepared whole."""
    tile = Tile(source, source_digests(source), choose_grid(source), 0.0)
    return object_datasets(prepare_objects(tile))


def joined(source: SourceMesh, runs: list[tuple[int, int]]) -> dict[str, np.ndarray]:
    """Return all tables of a mesh, prepared in tiles."""
    grid = choose_grid(source)

    def do(objects: tuple[int, int]) -> dict[str, np.ndarray]:
        return prepare_tile(tile_of(source, *objects, grid, 0.0)).arrays

    whole = Joined([whole_run(arrays) for arrays in map_ordered(do, runs, 4)])
    return {spec.path: whole.array(spec.path) for spec in PER_OBJECT}


def check_same(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    """Fail where a table is another one."""
    for spec in PER_OBJECT:
        one, other = found[spec.path], expected[spec.path]
        assert one.shape == other.shape, spec.path
        assert one.dtype.itemsize == other.dtype.itemsize, spec.path
        assert (one == other).all(), spec.path


@pytest.mark.parametrize("most_faces", [40, 1000, 10**9])
def test_tiles_join_to_the_tables_of_the_whole(most_faces: int, tmp_path: Path) -> None:
    for source in (read([CITY]), read([written(town(), tmp_path / "town.obj")])):
        n = len(source.object_names)
        runs = cut(source.object_face_start, most_faces)
        assert [runs[0][0], runs[-1][1]] == [0, n]
        assert all(a[1] == b[0] for a, b in pairwise(runs))
        expected = at_once(source)
        check_same(joined(source, runs), expected)
        assert expected["index/object"].size or "hill" not in source.object_names


def test_tiles_of_vertices_from_all_over_the_file() -> None:
    source = read([CITY])
    order = np.random.default_rng(3).permutation(len(source.positions))
    place = np.argsort(order).astype(np.uint32)
    mixed = replace(source, positions=source.positions[order], faces=place[source.faces])
    check_same(joined(mixed, cut(mixed.object_face_start, 300)), at_once(mixed))


def built(source: Path, cache: Path, **options: object) -> BuildResult:
    """Build with a light."""
    return build([source], cache, lights=[SUN], **options)  # type: ignore[arg-type]


def moved(blocks: list[Block]) -> list[Block]:
    return [*blocks[:4], box("house 4", (48.0, 3.0), lift=-2.0), *blocks[5:]]


def fewer_polygons(blocks: list[Block]) -> list[Block]:
    return [*blocks[:2], box("house 2", (24.0, 6.0), faces=4), *blocks[3:]]


def removed(blocks: list[Block]) -> list[Block]:
    return [*blocks[:6], *blocks[7:]]


def inserted(blocks: list[Block]) -> list[Block]:
    return [*blocks[:1], box("new", (12.0, 30.0)), hill("second hill", (90.0, 30.0)), *blocks[1:]]


def shuffled(blocks: list[Block]) -> list[Block]:
    return [blocks[i] for i in np.random.default_rng(1).permutation(len(blocks))]


def renamed(blocks: list[Block]) -> list[Block]:
    return [replace(block, name=f"{block.name} b") for block in blocks]


def doubled(blocks: list[Block]) -> list[Block]:
    return [*blocks, replace(blocks[2], name="again")]


def broken_edited(blocks: list[Block]) -> list[Block]:
    return [*blocks[:3], broken("house 3", (36.0, 0.5)), *blocks[4:]]


def every_second(blocks: list[Block]) -> list[Block]:
    return [
        replace(block, vertices=block.vertices + [0.0, 0.25 * (i % 2), 0.0])
        for i, block in enumerate(blocks)
    ]


EDITS: list[tuple[Callable[[list[Block]], list[Block]], int]] = [
    (list, 12),
    (moved, 11),
    (fewer_polygons, 11),
    (removed, 11),
    (inserted, 12),
    (shuffled, 12),
    (renamed, 12),
    (doubled, 12),
    (broken_edited, 11),
    (every_second, 6),
]


@pytest.mark.parametrize(("edit", "reused"), EDITS, ids=lambda x: getattr(x, "__name__", ""))
def test_building_over_a_cache_gives_what_a_full_build_gives(
    edit: Callable[[list[Block]], list[Block]], reused: int, tmp_path: Path
) -> None:
    source, cache = tmp_path / "town.obj", tmp_path / "town.svp.h5"
    # Nothing of the edits changes the extent, which would change the grid.
    frame = [box("west", (-200.0, -200.0)), box("east", (300.0, 300.0))]
    built(written([*town(), *frame], source), cache)
    written([*edit(town()), *frame], source)
    again = built(source, cache)
    full = built(source, tmp_path / "full.svp.h5", is_full=True)
    assert again.cache.content_digest == full.cache.content_digest
    assert again.cache.datasets == full.cache.datasets
    assert again.reused == reused + len(frame)
    assert full.reused == 0


def test_many_short_runs_are_not_worth_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, cache = tmp_path / "town.obj", tmp_path / "town.svp.h5"
    built(written(town(), source), cache)
    monkeypatch.setattr(older, "MOST_RUNS", 2)
    written(every_second(town())[:5] + town()[5:], source)  # kept: 0, 2 and 4 to 11
    again = built(source, cache)
    full = built(source, tmp_path / "full.svp.h5", is_full=True)
    assert again.cache.content_digest == full.cache.content_digest
    assert again.reused == 9


def test_another_grid_tolerance_or_light_is_built_anew(tmp_path: Path) -> None:
    source, cache = tmp_path / "town.obj", tmp_path / "town.svp.h5"
    built(written(town(), source), cache)
    config = BuildConfig(weld_tolerance_m=0.01)
    done = build([source], cache, config)
    assert done.reused == 0
    assert done.remarks == (
        "nothing is taken over from the older cache: it was welded with another tolerance",
    )
    assert build([source], cache).reused == 0
    assert build([source], cache).reused == 12
    other = build([source], cache, lights=["dir:10,20", SUN])
    full = build([source], tmp_path / "f.svp.h5", lights=["dir:10,20", SUN])
    assert other.cache.content_digest == full.cache.content_digest
    assert build([source], cache).remarks == (
        "2 lights of the older cache not taken over: name them with --light, here or "
        "for svprep clamp",
    )
    # Ten times as wide: another step.
    written([*town(), box("far", (9000.0, 0.0))], source)
    (remark,) = build([source], cache).remarks
    assert "the model's outermost box changed" in remark


def test_a_cache_that_contradicts_itself_is_passed_over(tmp_path: Path) -> None:
    source, cache = written(town(), tmp_path / "town.obj"), tmp_path / "town.svp.h5"
    expected = built(source, cache).cache.content_digest
    for path in (
        "scene/face",
        "lights/segment_start",
        "clamp/segment_start",
        "objects/vertex_start",
    ):

        def change(opened: Cache, path: str = path) -> dict[str, np.ndarray]:
            array = opened.raw(path).copy()
            array[..., -1] += 1_000_000
            return {path: array}

        rewrite_cache(cache, change)
        done = built(source, cache)
        assert done.reused == 0
        assert done.remarks == (
            "nothing is taken over from the older cache: it is damaged, or not of this svprep's "
            "schema",
        )
        assert done.cache.content_digest == expected


def test_a_cache_of_no_use_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, cache = written(town(), tmp_path / "town.obj"), tmp_path / "town.svp.h5"
    expected = built(source, cache).cache.content_digest
    whole = cache.read_bytes()
    with open_cache(cache) as opened:
        positions = opened.raw("mesh/positions").tobytes()
    at = whole.index(positions[:64])
    cache.write_bytes(whole[:at] + b"\xff" + whole[at + 1 :])
    assert built(source, cache).reused == 0  # damaged
    assert built(source, cache).reused == 12
    cache.write_bytes(whole[: len(whole) // 2])
    assert built(source, cache).reused == 0  # cut off
    monkeypatch.setattr(older, "stage_code", lambda: "of tomorrow")
    done = built(source, cache)
    assert done.reused == 0  # made by other code
    assert done.cache.content_digest == expected
    cache.write_text("not a cache")
    with pytest.raises(CacheError, match="not a cache"):
        built(source, cache)


@pytest.mark.parametrize("path", [CITY, *SOME], ids=lambda path: path.name)
def test_with_little_memory_the_cache_is_the_same(path: Path, tmp_path: Path) -> None:
    expected = built(path, tmp_path / "whole.svp.h5")
    done = built(path, tmp_path / "tiled.svp.h5", memory_bytes=1 << 18)
    assert done.cache.content_digest == expected.cache.content_digest
    assert done.cache.datasets == expected.cache.datasets
    written = {row.name: row.bytes_written for row in done.stages}
    assert written["write"] > done.cache.n_bytes
    assert written["load"] > 0


def test_an_object_over_the_budget_is_prepared_alone_and_said_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = written(town(), tmp_path / "town.obj")
    groups: list[list[tuple[int, int]]] = []
    grouped = building._groups

    def seen(start: I64, plan: building.Plan) -> list[list[tuple[int, int]]]:
        groups[:] = grouped(start, plan)
        return groups

    monkeypatch.setattr(building, "_groups", seen)
    done = built(source, tmp_path / "a.svp.h5", memory_bytes=1 << 18)
    assert [(5, 6)] in groups
    (remark,) = done.remarks
    assert 'town.obj, object "hill": its 1,444 triangles are prepared alone' in remark
    assert not built(source, tmp_path / "b.svp.h5").remarks


def test_a_temporary_folder_that_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "none"))
    with pytest.raises(EnvironmentProblem, match="which is no folder"):
        built(CITY, tmp_path / "a.svp.h5", memory_bytes=1 << 26)


def test_a_temporary_folder_that_takes_no_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("svprep.building.os.access", lambda path, mode: path != str(tmp_path))
    with pytest.raises(EnvironmentProblem, match="which takes no new files"):
        built(CITY, tmp_path / "a.svp.h5", memory_bytes=1 << 26)


def test_what_goes_to_files_is_counted_to_the_byte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rooms: list[Room] = []

    @contextlib.contextmanager
    def noted(memory_bytes: int | None) -> Iterator[Room | None]:
        with room_for(memory_bytes) as room:
            assert room is not None
            rooms.append(room)
            yield room

    monkeypatch.setattr(pipeline, "room_for", noted)
    done = built(CITY, tmp_path / "a.svp.h5", memory_bytes=1 << 18)
    in_files = rooms[0].spill.n_bytes()
    assert in_files > done.cache.n_bytes / 2
    assert sum(row.bytes_written for row in done.stages) == done.cache.n_bytes + in_files


def test_stages_are_told_in_order_and_accounted_for(tmp_path: Path) -> None:
    told: list[str] = []
    done = build([CITY], tmp_path / "a.svp.h5", on_stage=told.append)
    assert tuple(told) == pipeline.STAGES
    assert sorted(row.name for row in done.stages) == sorted(pipeline.STAGES)
    assert done.stages[-1].bytes_written == done.cache.n_bytes
    for row in done.stages:
        assert row.seconds >= 0.0
        assert row.peak_mb is None or row.peak_mb > 10.0
