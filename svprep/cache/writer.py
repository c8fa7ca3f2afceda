"""Writing a cache: whole or not at all, the same bytes for the same content.

    lock -> temporary sibling -> datasets, digests, attributes -> sync
         -> rename over the old cache -> sync the folder

Until the rename the older cache is untouched; after it the new one is whole.
Readers that have the old file open keep it. HDF5 lays the file out; the datasets' bytes are
written and digested by other threads.
"""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import h5py
import numpy as np

from svprep import __version__
from svprep.cache.codec import Raw, encode_attributes, encode_datasets
from svprep.cache.contents import Block, Contents, InMemory
from svprep.cache.files import (
    Temporary,
    exclusive_lock,
    problem_of,
    remove_leftovers,
    resolve_target,
    sync_folder,
)
from svprep.cache.reader import Cache, open_cache
from svprep.cache.schema import (
    ATTRIBUTES,
    DATASETS,
    DIGESTS_DTYPE,
    DIGESTS_PATH,
    LIBVER,
    DatasetSpec,
    ItemDigest,
    content_digest,
    root_digest,
    shape_problem,
)
from svprep.cache.vtkhdf import write_vtk
from svprep.errors import EnvironmentProblem, InternalError
from svprep.interrupts import interrupts_held_back
from svprep.model import Prepared

WRITE_POINTS: Final[tuple[str, ...]] = (
    "locked",
    "temp_created",
    *(f"dataset:{spec.path}" for spec in DATASETS),
    "vtkhdf",
    f"dataset:{DIGESTS_PATH}",
    "attributes",
    "flushed",
    "synced",
    "renamed",
    "folder_synced",
)
"""What `checkpoint` is called with, in this order."""

WRITE_THREADS: Final = 4
"""SHA-256 runs at about 1.7 GB/s per core, and a core writes some 0.5 GB/s."""
MOST_PENDING_BYTES: Final = 1 << 27
"""Of blocks that are written and wait for their digest."""

Checkpoint = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class CacheSummary:
    """What `write_cache` wrote."""

    path: Path
    n_bytes: int
    content_digest: str
    """Equal for two builds from the same sources and configuration."""
    datasets: dict[str, int]
    """Bytes of each dataset."""


def write_cache(
    prepared: Prepared,
    path: str | os.PathLike[str],
    *,
    lock_wait_s: float = 0.0,
    checkpoint: Checkpoint | None = None,
) -> CacheSummary:
    """Write `prepared` to the cache file `path`, replacing an older one atomically.

    Parameters
    ----------
    prepared : Prepared
        Tables that keep the contract of `svprep.model`.
    path : path-like
        A symbolic link is followed: the file that it names is replaced.
    lock_wait_s : float
        How long to wait for another writer [s]; 0: be told at once.
    checkpoint : callable, optional
        Called with each name of `WRITE_POINTS` as it is passed, for tests.

    Raises
    ------
    CacheError
        Another process is writing `path`, or it names something that is not a
        cache.
    EnvironmentProblem
        The disk is full, the folder is missing or cannot be written. The older
        cache is whole and no temporary is left.
    InternalError
        A table breaks its contract.
    """
    datasets, attributes = encode_datasets(prepared), encode_attributes(prepared)
    return write_contents(
        InMemory(datasets), attributes, path, lock_wait_s=lock_wait_s, checkpoint=checkpoint
    )


def write_contents(
    contents: Contents,
    attributes: Mapping[str, bytes | Raw],
    path: str | os.PathLike[str],
    *,
    lock_wait_s: float = 0.0,
    checkpoint: Checkpoint | None = None,
) -> CacheSummary:
    """Write stored arrays to the cache file `path`, as `write_cache` does.

    Parameters
    ----------
    contents : Contents
        No more of it is held than `MOST_PENDING_BYTES` and a block.
    attributes : mapping
        Every root attribute but the two digests, as `codec.city_attributes` returns them.
    path, lock_wait_s, checkpoint
        As for `write_cache`, which names the errors.
    """
    return _replace(path, lambda target: (contents, attributes), lock_wait_s, checkpoint)


def rewrite_cache(
    path: str | os.PathLike[str],
    change: Callable[[Cache], Mapping[str, Raw]],
    *,
    lock_wait_s: float = 0.0,
    checkpoint: Checkpoint | None = None,
) -> CacheSummary:
    """Replace some datasets of the cache `path`, as atomically as `write_cache`.

    Parameters
    ----------
    path : path-like
    change : callable
        Given the open cache while no one else can write it; returns the stored arrays of
        the datasets that change. All others are copied, their digests checked.
    lock_wait_s, checkpoint
        As for `write_cache`.

    Raises
    ------
    CacheError, EnvironmentProblem, InternalError
        As for `write_cache`; also if `path` is not there, or damaged. It stays as it was.
    """
    open_cache(path).close()  # told before the lock is taken

    def contents(target: Path) -> tuple[Contents, dict[str, bytes | Raw]]:
        with open_cache(target) as cache:
            changed = change(cache)
            datasets = {
                spec.path: changed[spec.path] if spec.path in changed else cache.raw(spec.path)
                for spec in DATASETS
            }
            version = {"producer_version": __version__.encode()}
            return InMemory(datasets), {**cache.attributes(), **version}

    return _replace(path, contents, lock_wait_s, checkpoint)


def _replace(
    path: str | os.PathLike[str],
    contents: Callable[[Path], tuple[Contents, Mapping[str, bytes | Raw]]],
    lock_wait_s: float,
    checkpoint: Checkpoint | None,
) -> CacheSummary:
    """Write what `contents` returns under the lock; the outline of all writing."""
    hook: Checkpoint = checkpoint or (lambda name: None)
    target = resolve_target(path)
    with exclusive_lock(target, lock_wait_s):
        try:
            remove_leftovers(target)
            hook("locked")
            datasets, attributes = contents(target)
            sizes = _checked_sizes(datasets, attributes)
            with interrupts_held_back() as interrupt, Temporary(target) as temporary:

                def at(point: str) -> None:
                    interrupt()
                    hook(point)

                at("temp_created")
                content = _write_hdf5(temporary, datasets, attributes, at)
                at("flushed")
                temporary.sync()
                at("synced")
                n_bytes = temporary.rename()
        except OSError as error:
            raise problem_of(error, target) from error
        hook("renamed")
        try:
            sync_folder(target.parent)
        except OSError as error:
            raise EnvironmentProblem(
                f"{target} was written, but its folder could not be synced to the disk ({error}). "
                "A power failure now may bring the older cache back; build again"
            ) from error
        hook("folder_synced")
    return CacheSummary(target, n_bytes, content, sizes)


def _write_hdf5(
    temporary: Temporary,
    contents: Contents,
    attributes: Mapping[str, bytes | Raw],
    at: Checkpoint,
) -> str:
    """Write the file's content through `temporary`; return the content digest."""
    with (
        ThreadPoolExecutor(WRITE_THREADS) as pool,
        h5py.File(temporary, "w", libver=LIBVER) as file,
    ):
        written = _Rows(temporary, pool)
        for spec in DATASETS:
            _write_dataset(file, spec, contents, written)
            temporary.check()
            at(f"dataset:{spec.path}")
        origin = attributes["grid_origin_m"]
        assert not isinstance(origin, bytes)
        write_vtk(file, contents, origin)  # while rows are still being written
        temporary.check()
        at("vtkhdf")
        table = written.table()
        temporary.check()
        rows = [(name.encode(), digest.encode()) for name, digest in table]
        _create(file, DIGESTS_PATH, np.array(rows, DIGESTS_DTYPE))
        at(f"dataset:{DIGESTS_PATH}")
        content = content_digest(attributes, table)
        root = root_digest(content, attributes)
        digests = {"content_digest": content.encode(), "root_digest": root.encode()}
        _write_attributes(file, {**attributes, **digests})
        temporary.check()
        at("attributes")
    temporary.check()
    return content


class _Rows:
    """Rows of datasets on their way to the file and into digests, on other threads.

    HDF5 writes on one thread. So it is only asked where a dataset lies, and the bytes are
    written there.
    """

    def __init__(self, temporary: Temporary, pool: Executor) -> None:
        self._temporary = temporary
        self._pool = pool
        self._digests: dict[str, tuple[ItemDigest, Future[None] | None]] = {}
        self._pending: deque[tuple[int, Future[None]]] = deque()
        self._n_bytes = 0

    def begin(self, spec: DatasetSpec, shape: tuple[int, ...]) -> None:
        """Begin a dataset."""
        self._digests[spec.path] = ItemDigest(spec.path, spec.dtype, shape), None

    def add(self, spec: DatasetSpec, offset: int, block: Block) -> None:
        """Take the next rows of a dataset, once there is room for them."""
        digest, before = self._digests[spec.path]

        def take() -> None:
            rows = _as_stored(spec, block.make())
            if len(rows) != block.n_rows:
                raise InternalError(f"{spec.path}: {len(rows)} rows, not {block.n_rows}")
            if rows.size:
                self._temporary.write_at(offset, rows.reshape(-1).view(np.uint8).data)
            if before is not None:  # begun earlier, so it does not wait for this one
                before.result()
            digest.update(rows)
            block.let_go()

        while self._pending and self._n_bytes + block.n_bytes > MOST_PENDING_BYTES:
            n_bytes, oldest = self._pending.popleft()
            oldest.result()
            self._n_bytes -= n_bytes
        future = self._pool.submit(take)
        self._pending.append((block.n_bytes, future))
        self._n_bytes += block.n_bytes
        self._digests[spec.path] = digest, future

    def table(self) -> list[tuple[str, str]]:
        """Return each dataset and its digest, in the order in which they were begun."""
        for _, future in self._pending:
            future.result()
        return [(path, digest.hexdigest()) for path, (digest, _) in self._digests.items()]


def _write_dataset(file: h5py.File, spec: DatasetSpec, contents: Contents, rows: _Rows) -> None:
    """Write one dataset, block by block."""
    shape = contents.shape(spec.path)
    rows.begin(spec, shape)
    offset = _room_in(file, spec, shape)
    row_bytes = math.prod(shape[1:]) * np.dtype(spec.dtype).itemsize
    row = 0
    for block in contents.blocks(spec.path):
        rows.add(spec, offset + row * row_bytes, block)
        row += block.n_rows
    if row != shape[0]:
        raise InternalError(f"{spec.path}: {row} rows were written, not {shape[0]}")


def _room_in(file: h5py.File, spec: DatasetSpec, shape: tuple[int, ...]) -> int:
    """Declare a dataset, and return where in the file its bytes lie; 0 if it has none."""
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_layout(h5py.h5d.CONTIGUOUS)
    plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    plan.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    plan.set_obj_track_times(False)
    links = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    links.set_create_intermediate_group(True)
    kind = h5py.h5t.py_create(np.dtype(spec.dtype))
    space = h5py.h5s.create_simple(shape)
    made = h5py.h5d.create(file.id, spec.path.encode(), kind, space, plan, links)
    return int(made.get_offset() or 0)


def _as_stored(spec: DatasetSpec, array: Raw) -> Raw:
    """Return `array` as it is stored, the same bytes: signed where the schema says so."""
    if array.dtype != np.dtype(spec.in_memory):
        raise InternalError(f"{spec.path}: expected {spec.in_memory}, got {array.dtype.str}")
    array = np.ascontiguousarray(array)
    if spec.in_memory == spec.dtype:
        return array
    if array.size and int(array.max()) >= 1 << 31:
        raise InternalError(f"{spec.path}: an index of 2**31 or more cannot be stored")
    return array.view(spec.dtype)


def _create(file: h5py.File, path: str, array: Raw) -> None:
    file.create_dataset(path, data=array, dtype=array.dtype, track_times=False)


def _write_attributes(file: h5py.File, values: Mapping[str, bytes | Raw]) -> None:
    for spec in ATTRIBUTES:
        value = values[spec.name]
        if isinstance(value, bytes):
            # Fixed length: a text of variable length would lie in a heap without a checksum.
            text = h5py.string_dtype("utf-8", max(len(value), 1))
            file.attrs.create(spec.name, np.array(value, text), dtype=text)
        else:
            file.attrs.create(spec.name, value, dtype=spec.dtype)


def _checked_sizes(contents: Contents, attributes: Mapping[str, bytes | Raw]) -> dict[str, int]:
    """Return the bytes of each dataset.

    Raises
    ------
    InternalError
        The arrays do not fit the schema or each other, or a number is not finite.
    """
    sizes: dict[str, int] = {}
    n_bytes: dict[str, int] = {}
    for spec in DATASETS:
        shape = contents.shape(spec.path)
        if problem := shape_problem(spec, np.dtype(spec.dtype), shape, sizes):
            raise InternalError(f"{spec.path}: {problem}")
        n_bytes[spec.path] = math.prod(shape) * np.dtype(spec.dtype).itemsize
    for name, value in attributes.items():
        if not isinstance(value, bytes) and not np.all(np.isfinite(value)):
            raise InternalError(f"{name}: expected finite numbers, got {value}")
    return n_bytes
