"""Lights are added to a cache, and nothing else in it changes by a byte."""

from __future__ import annotations

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from svprep.cache import codec
from svprep.cache.files import exclusive_lock
from svprep.cache.reader import open_cache
from svprep.cache.schema import DATASETS
from svprep.cache.verify import verify
from svprep.cache.writer import write_cache
from svprep.clamp import ClampCosts, selected
from svprep.errors import CacheError, InputError
from svprep.model import ClampTable
from svprep.pipeline import LightsAdded, add_lights, build
from tests.unit.cache_samples import assert_same, strip_and_tetrahedron

CITY = Path(__file__).resolve().parents[2] / "data" / "small_city.obj.gz"
SUN, LOW, LAMP = "dir:135,40", "dir:250,5", "point:40,30,60"
ARC = "sun:48.2,16.37,2026-03-20/05:00/12:00/2h[Europe/Vienna]"
"""Steps at 5, 7, 9 and 11 o'clock; the sun rises after the first one."""
OF_LIGHTS = {spec.path for spec in DATASETS if spec.path.startswith(("lights/", "clamp/"))}


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the cache of the city, built without lights."""
    return build([CITY], tmp_path_factory.mktemp("bare") / "city.svp.h5").cache.path


@pytest.fixture
def cache(bare: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(bare, tmp_path / "city.svp.h5"))


def raw_bytes(path: Path) -> dict[str, bytes]:
    """Return the bytes of every dataset and attribute."""
    with h5py.File(path, locking=False) as file:
        items = {spec.path: file[spec.path][...].tobytes() for spec in DATASETS}
        return items | {f"@{name}": np.asarray(v).tobytes() for name, v in file.attrs.items()}


def held(path: Path) -> ClampTable:
    with open_cache(path) as opened:
        return opened.clamp


def summary(done: LightsAdded) -> tuple[int, int, int]:
    return len(done.added), done.n_replaced, done.n_present


def test_lights_are_added_and_all_else_is_kept(cache: Path) -> None:
    before = raw_bytes(cache)
    done = add_lights(cache, [SUN, LAMP])
    assert summary(done) == (2, 0, 0)
    assert done.cache is not None
    assert done.cache.n_bytes == cache.stat().st_size
    assert verify(cache) == []
    after = raw_bytes(cache)
    changed = {name for name in before if before[name] != after[name]}
    assert changed == OF_LIGHTS | {"@content_digest", "@root_digest"}
    assert_same(held(cache), done.clamp)
    assert done.clamp.specs == (SUN, LAMP)
    # More, by themselves: those of before stay in front, as they were.
    more = add_lights(cache, [LOW])
    assert summary(more) == (1, 0, 0)
    assert more.clamp.specs == (SUN, LAMP, LOW)
    assert_same(selected(held(cache), [0, 1]), done.clamp)
    with open_cache(cache) as opened:
        assert opened.n_lights == 3
    assert list(cache.parent.iterdir()) == [cache]


def test_what_is_there_is_skipped(cache: Path) -> None:
    add_lights(cache, [SUN, LAMP])
    before, stamp = cache.read_bytes(), cache.stat()
    again = add_lights(cache, [LAMP, SUN, "dir:135.0,40.000", SUN])
    assert summary(again) == (0, 0, 4)
    assert again.cache is None
    assert again.clamp.specs == (SUN, LAMP)
    assert (cache.stat().st_ino, cache.stat().st_mtime_ns) == (stamp.st_ino, stamp.st_mtime_ns)
    assert cache.read_bytes() == before
    some = add_lights(cache, [SUN, LOW, LAMP])
    assert summary(some) == (1, 0, 2)
    assert some.clamp.specs == (SUN, LAMP, LOW)


def test_other_costs_replace(cache: Path) -> None:
    add_lights(cache, [SUN, LAMP, LOW])
    usual = held(cache)
    cheap = ClampCosts(vertex=0.5)
    done = add_lights(cache, [LAMP, SUN], cheap)
    assert summary(done) == (2, 2, 0)
    table = held(cache)
    assert table.specs == (LOW, LAMP, SUN)
    assert table.facts[:, 0].tolist() == [4.0, 0.5, 0.5]
    assert_same(selected(table, [0]), selected(usual, [2]))
    assert len(table.depths) > len(usual.depths)
    assert verify(cache) == []
    assert summary(add_lights(cache, [LAMP], cheap)) == (0, 0, 1)
    # Back again: the same as at first, but for the order.
    add_lights(cache, [SUN])
    add_lights(cache, [LAMP])
    assert_same(held(cache), selected(usual, [2, 0, 1]))


def test_a_light_named_twice_is_added_once(cache: Path) -> None:
    done = add_lights(cache, [SUN, LAMP, SUN, "dir:495,40", "DIR: 135 , 40"])
    assert summary(done) == (2, 0, 3)
    assert done.clamp.specs == (SUN, LAMP)


def test_an_arc_is_a_light_per_step_by_day(cache: Path) -> None:
    done = add_lights(cache, [ARC])
    assert summary(done) == (3, 0, 0)
    assert done.clamp.specs == tuple(
        f"sun:48.2,16.37,2026-03-20T{hour:02}:00+01:00" for hour in (7, 9, 11)
    )
    # A step of it, by itself, is the same light.
    assert summary(add_lights(cache, [done.clamp.specs[1]])) == (0, 0, 1)


def test_progress_is_told(cache: Path) -> None:
    told: list[tuple[int, int]] = []
    add_lights(cache, [SUN, LOW], on_light=lambda *done: told.append(done))
    assert told == [(1, 2), (2, 2)]


def test_build_with_lights_is_build_and_then_clamp(cache: Path, tmp_path: Path) -> None:
    lights = [SUN, LAMP, ARC, LOW]
    at_once = tmp_path / "at_once.svp.h5"
    costs = ClampCosts(vertex=1.0)
    built = build([CITY], at_once, lights=lights, costs=costs)
    assert len(built.prepared.clamp) == 6
    add_lights(cache, lights[:2], costs)
    add_lights(cache, lights[2:], costs)
    assert raw_bytes(cache) == raw_bytes(at_once)
    assert cache.read_bytes() == at_once.read_bytes()


@pytest.mark.parametrize("threads", ["1", "3"])
def test_threads_change_nothing(
    threads: str, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = Path(shutil.copy(cache, tmp_path / "other.svp.h5"))
    monkeypatch.setenv("SVPREP_THREADS", "2")
    add_lights(other, [SUN, LOW, LAMP])
    monkeypatch.setenv("SVPREP_THREADS", threads)
    add_lights(cache, [SUN, LOW, LAMP])
    assert cache.read_bytes() == other.read_bytes()


def test_an_open_reader_keeps_the_old_content(cache: Path) -> None:
    add_lights(cache, [SUN])
    with open_cache(cache) as reader:
        add_lights(cache, [LOW, LAMP])
        assert held(cache).specs == (SUN, LOW, LAMP)
        # Nothing of it had been read before.
        assert reader.clamp.specs == (SUN,)
        assert len(reader.prepared().clamp) == 1


def test_a_second_writer_is_told(cache: Path) -> None:
    before = cache.read_bytes()
    with (
        exclusive_lock(cache, 0.0),
        pytest.raises(CacheError, match=r"process \d+ is writing it") as caught,
    ):
        add_lights(cache, [SUN])
    assert str(cache) in str(caught.value)
    assert cache.read_bytes() == before


@pytest.mark.parametrize(
    ("specs", "says"),
    [
        (["dir:0,91"], "ALTITUDE 91"),
        ([SUN, "point:1,2"], "Z is missing"),
        ([SUN, "sun:48.2,16.37,2026-01-10T03:00Z"], "below the horizon"),
    ],
)
def test_a_bad_light_changes_nothing(specs: list[str], says: str, cache: Path) -> None:
    before = cache.read_bytes()
    with pytest.raises(InputError, match=says):
        add_lights(cache, specs)
    assert cache.read_bytes() == before
    assert list(cache.parent.iterdir()) == [cache]


def test_a_lamp_on_a_vertex_changes_nothing(cache: Path) -> None:
    add_lights(cache, [SUN])
    before = cache.read_bytes()
    with open_cache(cache) as opened:
        x, y, z = (opened.mesh.positions[7] + opened.grid.origin_m).tolist()
    with pytest.raises(InputError, match="exactly on a vertex"):
        add_lights(cache, [LOW, f"point:{x!r},{y!r},{z!r}"])
    assert cache.read_bytes() == before
    assert list(cache.parent.iterdir()) == [cache]


def test_a_missing_or_damaged_cache(cache: Path, tmp_path: Path) -> None:
    with pytest.raises(CacheError, match="no such file"):
        add_lights(tmp_path / "none.svp.h5", [SUN])
    # Damage is found even in what clamping does not look at, and is not signed anew.
    with h5py.File(cache, locking=False) as file:
        offset = file["planes/d"].id.get_offset()
    damaged = bytearray(cache.read_bytes())
    damaged[offset] ^= 1
    cache.write_bytes(damaged)
    with pytest.raises(CacheError, match='dataset "planes/d"'):
        add_lights(cache, [SUN])
    assert cache.read_bytes() == damaged
    assert list(cache.parent.iterdir()) == [cache]


def test_the_crs_notes_and_paths_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "sample.svp.h5"
    with monkeypatch.context() as patch:
        patch.setattr(codec, "__version__", "0.0.1")
        write_cache(strip_and_tetrahedron(), path)
    before = raw_bytes(path)
    assert summary(add_lights(path, [SUN])) == (1, 0, 0)
    after = raw_bytes(path)
    changed = {name for name in before if before[name] != after[name]}
    # Whoever adds lights has written the file.
    assert changed == OF_LIGHTS | {"@content_digest", "@root_digest", "@producer_version"}
    with open_cache(path) as opened:
        assert opened.crs == "EPSG:7415"
        assert opened.clamp.specs == ("dir:0,90", "point:Über,dem,Dach", SUN)
        assert_same(selected(opened.clamp, [0, 1]), strip_and_tetrahedron().clamp)
