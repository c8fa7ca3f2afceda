"""A cache is replaced whole or not at all, whatever becomes of its writer."""

from __future__ import annotations

import errno
import multiprocessing
import os
import random
import resource
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event
from pathlib import Path

import pytest

from svprep.cache import files
from svprep.cache.codec import Raw, clamp_datasets
from svprep.cache.reader import Cache, open_cache
from svprep.cache.verify import verify
from svprep.cache.writer import WRITE_POINTS, rewrite_cache, write_cache
from svprep.errors import CacheError, EnvironmentProblem, SvprepError
from svprep.interrupts import keep_interrupts
from tests.unit.cache_samples import assert_same, no_lights, strip_and_tetrahedron

OLD = strip_and_tetrahedron()
NEW = strip_and_tetrahedron(shift_m=1.0)
DARK = replace(OLD, clamp=no_lights(2))
"""The old city with other lights: none."""

# One server process, free of threads, that every child is forked from.
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["tests.unit.test_crash_safety"])


@pytest.fixture
def old(tmp_path: Path) -> Path:
    path = tmp_path / "city.svp.h5"
    write_cache(OLD, path)
    return path


def in_child(function: object, *arguments: object) -> BaseProcess:
    child = CONTEXT.Process(target=function, args=arguments)
    child.start()
    return child


def finish(child: BaseProcess) -> int:
    child.join(60)
    assert child.exitcode is not None, "the child hangs"
    code = child.exitcode
    child.close()
    return code


def names_in(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def write_and_die(path: Path, point: str) -> None:
    def checkpoint(name: str) -> None:
        if name == point:
            os.kill(os.getpid(), signal.SIGKILL)

    write_cache(NEW, path, checkpoint=checkpoint)


@pytest.mark.parametrize("point", WRITE_POINTS)
def test_killed_at_each_write_point(point: str, old: Path) -> None:
    before = old.read_bytes()
    assert finish(in_child(write_and_die, old, point)) == -signal.SIGKILL
    is_replaced = WRITE_POINTS.index(point) >= WRITE_POINTS.index("renamed")
    assert verify(old) == []
    with open_cache(old) as cache:
        assert_same(cache.prepared(), NEW if is_replaced else OLD)
    if not is_replaced:
        assert old.read_bytes() == before
    # The dead writer's lock does not hold, and the next writer removes what it left.
    write_cache(NEW, old)
    assert names_in(old.parent) == [old.name]


def without_lights(cache: Cache) -> dict[str, Raw]:
    assert_same(cache.prepared(), OLD)
    return clamp_datasets(no_lights(cache.n_components))


def rewrite_and_die(path: Path, point: str) -> None:
    def checkpoint(name: str) -> None:
        if name == point:
            os.kill(os.getpid(), signal.SIGKILL)

    rewrite_cache(path, without_lights, checkpoint=checkpoint)


@pytest.mark.parametrize("point", WRITE_POINTS)
def test_killed_at_each_write_point_of_other_lights(point: str, old: Path) -> None:
    before = old.read_bytes()
    assert finish(in_child(rewrite_and_die, old, point)) == -signal.SIGKILL
    is_replaced = WRITE_POINTS.index(point) >= WRITE_POINTS.index("renamed")
    assert verify(old) == []
    with open_cache(old) as cache:
        assert_same(cache.prepared(), DARK if is_replaced else OLD)
    if not is_replaced:
        assert old.read_bytes() == before
        rewrite_cache(old, without_lights)
    # The same, to the byte, as if it had been written so at first.
    rewritten = old.read_bytes()
    write_cache(DARK, old)
    assert old.read_bytes() == rewritten
    assert names_in(old.parent) == [old.name]


def test_rewriting_passes_every_write_point_in_order(old: Path) -> None:
    passed: list[str] = []
    rewrite_cache(old, without_lights, checkpoint=passed.append)
    assert tuple(passed) == WRITE_POINTS


def test_a_change_that_fails_leaves_the_old_cache(old: Path) -> None:
    before = old.read_bytes()

    def fail(cache: Cache) -> dict[str, Raw]:
        raise Interrupt

    with pytest.raises(Interrupt):
        rewrite_cache(old, fail)
    assert old.read_bytes() == before
    assert names_in(old.parent) == [old.name]
    with pytest.raises(CacheError, match="no such file"):
        rewrite_cache(old.with_name("none.svp.h5"), without_lights)
    assert names_in(old.parent) == [old.name]


def test_killed_before_there_was_a_cache(tmp_path: Path) -> None:
    path = tmp_path / "city.svp.h5"
    assert finish(in_child(write_and_die, path, "synced")) == -signal.SIGKILL
    assert not path.exists()
    with pytest.raises(CacheError, match="no such file"):
        open_cache(path)


def write_for_ever(path: Path, ready: Event) -> None:
    write_cache(OLD, path)
    ready.set()
    while True:
        write_cache(NEW, path)
        write_cache(OLD, path)


def ended_at_random_times(old: Path, write: object, number: int, n_times: int) -> Iterator[int]:
    """Yield the exit codes of writers that were sent a signal; the cache is whole each time."""
    whole = [old.read_bytes()]
    write_cache(NEW, old)
    whole.append(old.read_bytes())
    rng = random.Random(5)
    for _ in range(n_times):
        ready = CONTEXT.Event()
        child = in_child(write, old, ready)
        assert ready.wait(60)
        time.sleep(rng.uniform(0.0, 0.06))
        assert child.pid is not None
        os.kill(child.pid, number)
        code = finish(child)
        assert old.read_bytes() in whole
        yield code


def test_killed_at_random_times(old: Path) -> None:
    for code in ended_at_random_times(old, write_for_ever, signal.SIGKILL, 12):
        assert code == -signal.SIGKILL
    write_cache(OLD, old)
    assert names_in(old.parent) == [old.name]


def write_until_interrupted(path: Path, ready: Event) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    keep_interrupts()  # as the command line does
    try:
        write_for_ever(path, ready)
    except KeyboardInterrupt:
        os._exit(5)


def test_interrupted_at_random_times(old: Path) -> None:
    for code in ended_at_random_times(old, write_until_interrupted, signal.SIGINT, 24):
        assert code == 5
        assert names_in(old.parent) == [old.name]


def test_leftovers_of_other_caches_stay(old: Path) -> None:
    mine = old.with_name(f".{old.name}.tmp-12-0a1b2c3d")
    others = [
        old.with_name(name)
        for name in (".other.h5.tmp-12-0a1b2c3d", f".{old.name}.tmp-notes", f"{old.name}.bak")
    ]
    for path in (mine, *others):
        path.write_bytes(b"x")
    write_cache(NEW, old)
    assert names_in(old.parent) == sorted([old.name, *(p.name for p in others)])


class Interrupt(BaseException):
    """Stands for KeyboardInterrupt, which would stop pytest where it leaks."""


@pytest.mark.parametrize("point", WRITE_POINTS[: WRITE_POINTS.index("renamed")])
def test_interrupted_writer_leaves_nothing(point: str, old: Path) -> None:
    before = old.read_bytes()

    def checkpoint(name: str) -> None:
        if name == point:
            raise Interrupt

    with pytest.raises(Interrupt):
        write_cache(NEW, old, checkpoint=checkpoint)
    assert old.read_bytes() == before
    assert names_in(old.parent) == [old.name]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), Interrupt()], ids=["full", "int"])
def test_every_failing_write_leaves_the_old_cache(
    error: BaseException, old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = old.read_bytes()
    real, n_writes, fail_at = os.pwrite, 0, -1

    def pwrite(fd: int, data: bytes, offset: int) -> int:
        nonlocal n_writes
        n_writes += 1
        if n_writes == fail_at:
            raise error
        # Half at a time: a write may be short.
        return real(fd, data[: max(1, len(data) // 2)], offset)

    monkeypatch.setattr(files.os, "pwrite", pwrite)
    write_cache(OLD, old)
    assert old.read_bytes() == before
    total = n_writes
    assert total > 100
    # The first write is the lock file's, whose text may be missing on a full disk.
    first = 2 if isinstance(error, OSError) else 1
    for fail_at in [*range(first, 40), *range(40, total + 1, 17), total]:  # noqa: B007
        n_writes = 0
        with pytest.raises((EnvironmentProblem, Interrupt)) as caught:
            write_cache(NEW, old)
        if caught.type is EnvironmentProblem:
            assert "disk is full" in str(caught.value)
            assert "\n" not in str(caught.value)
        assert old.read_bytes() == before
        assert names_in(old.parent) == [old.name]


def write_limited(path: Path, limit: int) -> None:
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        write_cache(NEW, path)
    except EnvironmentProblem as error:
        os._exit(3 if "ulimit" in str(error) and "\n" not in str(error) else 4)
    os._exit(0)


def test_file_size_limit(old: Path) -> None:
    before = old.read_bytes()
    for limit in (0, 1, 47, 100, 3000, len(before) // 2, len(before) - 1):
        assert finish(in_child(write_limited, old, limit)) == 3, limit
        assert old.read_bytes() == before
        assert names_in(old.parent) == [old.name]
    assert finish(in_child(write_limited, old, len(before))) == 0
    assert verify(old) == []


@pytest.fixture
def read_only_folder() -> Iterator[Path]:
    # Not below tmp_path, which an unprivileged child could not even enter.
    folder = Path(tempfile.mkdtemp())
    write_cache(OLD, folder / "city.svp.h5")
    folder.chmod(0o555)
    yield folder
    folder.chmod(0o755)
    shutil.rmtree(folder)


def use_unprivileged(path: Path) -> None:
    if os.getuid() == 0:
        os.setgid(65534)
        os.setuid(65534)
    status = 1
    try:
        write_cache(NEW, path)
    except EnvironmentProblem as error:
        is_clear = "no files can be made in the folder" in str(error) and "\n" not in str(error)
        with open_cache(path) as cache:  # reading needs no lock and no right to write
            assert_same(cache.prepared(), OLD)
        status = 3 if is_clear else 4
    os._exit(status)


def test_read_only_folder(read_only_folder: Path) -> None:
    assert finish(in_child(use_unprivileged, read_only_folder / "city.svp.h5")) == 3
    assert names_in(read_only_folder) == ["city.svp.h5"]


def test_targets_that_cannot_be(tmp_path: Path) -> None:
    model = tmp_path / "model.obj"
    model.write_text("v 0 0 0\n")
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    cases: list[tuple[Path | str, type[SvprepError], str]] = [
        (tmp_path / "none" / "a.h5", EnvironmentProblem, "there is no folder"),
        (model / "a.h5", EnvironmentProblem, "is a file, not a folder"),
        (model / "b" / "a.h5", EnvironmentProblem, r"model\.obj\" is a file, not a folder"),
        (tmp_path, CacheError, "names a folder"),
        (f"{tmp_path}/sub/", CacheError, r"sub/\" names a folder.*sub/NAME\.svp\.h5"),
        (f"{tmp_path}/sub/.", CacheError, "names a folder"),
        (Path("/proc/a.h5"), EnvironmentProblem, 'folder "/proc" takes no new files'),
        (pipe, CacheError, "not a regular file"),
        (Path("/dev/null"), CacheError, "not a regular file"),
        (model, CacheError, "not overwritten"),
        (tmp_path / ("x" * 250), EnvironmentProblem, "name is too long"),
    ]
    before = names_in(tmp_path)
    for path, kind, message in cases:
        with pytest.raises(kind, match=message) as caught:
            write_cache(NEW, path)
        assert "\n" not in str(caught.value)
        assert names_in(tmp_path) == before
        with pytest.raises(kind, match=message):  # a build asks this before it begins
            files.resolve_target(path)
        assert names_in(tmp_path) == before
    assert model.read_text() == "v 0 0 0\n"


def test_a_symbolic_link_keeps_leading_to_the_cache(old: Path, tmp_path: Path) -> None:
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    link = folder / "link.h5"
    link.symlink_to(old)
    assert write_cache(NEW, link).path == old
    assert link.is_symlink()
    assert names_in(folder) == ["link.h5"]
    with open_cache(link) as cache:
        assert_same(cache.prepared(), NEW)


def hold_the_lock(path: Path, held: Event, go_on: Event) -> None:
    def checkpoint(name: str) -> None:
        if name == "temp_created":
            held.set()
            go_on.wait(60)

    write_cache(NEW, path, checkpoint=checkpoint)


def test_a_second_writer_is_told_or_waits(old: Path) -> None:
    held, go_on = CONTEXT.Event(), CONTEXT.Event()
    child = in_child(hold_the_lock, old, held, go_on)
    assert held.wait(60)
    for wait_s in (0.0, 0.15):
        with pytest.raises(CacheError, match=rf"process {child.pid} is writing it") as caught:
            write_cache(OLD, old, lock_wait_s=wait_s)
        assert str(old) in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(CacheError, match=rf"process {child.pid} is writing it"):
        rewrite_cache(old, without_lights)
    # Being told harms nothing: the first writer's temporary is still there.
    assert len(names_in(old.parent)) == 3
    go_on.set()
    write_cache(OLD, old, lock_wait_s=60.0)
    assert finish(child) == 0
    with open_cache(old) as cache:
        assert_same(cache.prepared(), OLD)
    assert names_in(old.parent) == [old.name]


def write_some(path: Path, n_times: int) -> None:
    for _ in range(n_times):
        write_cache(NEW, path, lock_wait_s=120.0)


def test_many_writers_take_turns(old: Path) -> None:
    children = [in_child(write_some, old, 8) for _ in range(4)]
    while any(child.is_alive() for child in children):
        assert verify(old) == []
    assert [finish(child) for child in children] == [0, 0, 0, 0]
    assert names_in(old.parent) == [old.name]
    with open_cache(old) as cache:
        assert_same(cache.prepared(), NEW)


def test_an_open_reader_keeps_the_old_cache(old: Path) -> None:
    with open_cache(old) as cache:
        write_cache(NEW, old)
        with open_cache(old) as other:
            assert_same(other.prepared(), NEW)
        # Nothing had been read before the replacement.
        assert_same(cache.prepared(), OLD)
    with open_cache(old) as cache:
        assert_same(cache.prepared(), NEW)
