"""Writing a cache: whole or not at all, the same bytes for the same content.

    lock -> temporary sibling -> datasets, digests, attributes -> sync
         -> rename over the old cache -> sync the folder

Until the rename the older cache is untouched; after it the new one is whole.
Readers that have the old file open keep it. The SHA-256 digests are computed by
other threads while HDF5 writes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import h5py
import numpy as np

from svprep import __version__
from svprep.cache.codec import Raw, encode_attributes, encode_datasets
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
    content_digest,
    item_digest,
    root_digest,
    shape_problem,
)
from svprep.cache.vtkhdf import write_vtk
from svprep.errors import EnvironmentProblem, InternalError
from svprep.model import Prepared

WRITE_POINTS: Final[tuple[str, ...]] = (
    "locked",
    "temp_created",
    *(f"dataset:{spec.path}" for spec in DATASETS),
    f"dataset:{DIGESTS_PATH}",
    "vtkhdf",
    "attributes",
    "flushed",
    "synced",
    "renamed",
    "folder_synced",
)
"""What `checkpoint` is called with, in this order."""

HASH_THREADS: Final = 4
"""SHA-256 runs at about 1.7 GB/s per core; the two largest datasets bound the time."""

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
    return _replace(
        path,
        lambda target: (encode_datasets(prepared), encode_attributes(prepared)),
        lock_wait_s,
        checkpoint,
    )


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

    def contents(target: Path) -> tuple[dict[str, Raw], dict[str, bytes | Raw]]:
        with open_cache(target) as cache:
            changed = change(cache)
            datasets = {
                spec.path: changed[spec.path] if spec.path in changed else cache.raw(spec.path)
                for spec in DATASETS
            }
            return datasets, {**cache.attributes(), "producer_version": __version__.encode()}

    return _replace(path, contents, lock_wait_s, checkpoint)


def _replace(
    path: str | os.PathLike[str],
    contents: Callable[[Path], tuple[dict[str, Raw], dict[str, bytes | Raw]]],
    lock_wait_s: float,
    checkpoint: Checkpoint | None,
) -> CacheSummary:
    """Write what `contents` returns under the lock; the outline of all writing."""
    at: Checkpoint = checkpoint or (lambda name: None)
    target = resolve_target(path)
    with exclusive_lock(target, lock_wait_s):
        try:
            remove_leftovers(target)
            at("locked")
            datasets, attributes = contents(target)
            with Temporary(target) as temporary:
                at("temp_created")
                content = _write_hdf5(temporary, datasets, attributes, at)
                at("flushed")
                temporary.sync()
                at("synced")
                n_bytes = temporary.rename()
        except OSError as error:
            raise problem_of(error, target) from error
        at("renamed")
        try:
            sync_folder(target.parent)
        except OSError as error:
            raise EnvironmentProblem(
                f"{target} was written, but its folder could not be synced to the disk ({error}). "
                "A power failure now may bring the older cache back; build again"
            ) from error
        at("folder_synced")
    sizes = {name: array.nbytes for name, array in datasets.items()}
    return CacheSummary(target, n_bytes, content, sizes)


def _write_hdf5(
    temporary: Temporary,
    datasets: Mapping[str, Raw],
    attributes: Mapping[str, bytes | Raw],
    at: Checkpoint,
) -> str:
    """Write the file's content through `temporary`; return the content digest."""
    datasets = {spec.path: _as_stored(spec, datasets[spec.path]) for spec in DATASETS}
    _check_shapes(datasets, attributes)
    with ThreadPoolExecutor(HASH_THREADS) as pool, h5py.File(temporary, "w", libver=LIBVER) as file:
        digest_of: dict[str, Future[str]] = {
            spec.path: pool.submit(item_digest, spec.path, spec.dtype, datasets[spec.path])
            for spec in sorted(DATASETS, key=lambda s: -datasets[s.path].nbytes)
        }
        for spec in DATASETS:
            _create(file, spec.path, datasets[spec.path])
            temporary.check()
            at(f"dataset:{spec.path}")
        table = [(spec.path, digest_of[spec.path].result()) for spec in DATASETS]
        rows = [(name.encode(), digest.encode()) for name, digest in table]
        _create(file, DIGESTS_PATH, np.array(rows, DIGESTS_DTYPE))
        at(f"dataset:{DIGESTS_PATH}")
        origin = attributes["grid_origin_m"]
        assert not isinstance(origin, bytes)
        write_vtk(file, datasets, origin)
        temporary.check()
        at("vtkhdf")
        content = content_digest(attributes, table)
        root = root_digest(content, attributes)
        digests = {"content_digest": content.encode(), "root_digest": root.encode()}
        _write_attributes(file, {**attributes, **digests})
        temporary.check()
        at("attributes")
    temporary.check()
    return content


def _as_stored(spec: DatasetSpec, array: Raw) -> Raw:
    """Return `array` as it is stored, the same bytes: signed where the schema says so."""
    if spec.in_memory == spec.dtype or array.dtype != np.dtype(spec.in_memory):
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


def _check_shapes(datasets: Mapping[str, Raw], attributes: Mapping[str, bytes | Raw]) -> None:
    """Raise `InternalError` unless the arrays fit the schema and each other."""
    sizes: dict[str, int] = {}
    for spec in DATASETS:
        array = datasets[spec.path]
        if problem := shape_problem(spec, array.dtype, array.shape, sizes):
            raise InternalError(f"{spec.path}: {problem}")
    for name, value in attributes.items():
        if not isinstance(value, bytes) and not np.all(np.isfinite(value)):
            raise InternalError(f"{name}: expected finite numbers, got {value}")
