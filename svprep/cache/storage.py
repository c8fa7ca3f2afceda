"""What reading a cache's HDF5 file safely takes: open, check, name the damage."""

from __future__ import annotations

import contextlib
import stat
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from svprep.cache.codec import frozen
from svprep.cache.files import HDF5_SIGNATURE
from svprep.cache.schema import (
    ATTRIBUTE_OF_NAME,
    DIGESTS_DTYPE,
    DIGESTS_PATH,
    MAGIC,
    SCHEMA_VERSION,
    AttributeSpec,
    content_digest,
    root_digest,
)
from svprep.errors import CacheError

REBUILD = "Build it again: svprep build"
DAMAGE = (
    OSError,
    RuntimeError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ArithmeticError,
    MemoryError,
    RecursionError,
)
"""What h5py, NumPy and json raise on damaged bytes."""


@contextlib.contextmanager
def damage_named(path: Path, what: str) -> Iterator[None]:
    """Turn whatever damaged bytes make a library raise into one `CacheError`."""
    try:
        yield
    except CacheError as error:
        raise CacheError(f"{path}: {what}: {error}. {REBUILD}") from error
    except DAMAGE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise CacheError(
            f"{path}: {what} is damaged ({reason}). See what else: svprep validate {path}. "
            f"{REBUILD}"
        ) from error


def open_hdf5(path: Path) -> h5py.File:
    """Open a cache's HDF5 file and check its magic and schema version, nothing else."""
    _check_is_hdf5(path)
    try:
        # No HDF5 lock: it would fail in folders that cannot be written. None is
        # needed, because caches are replaced and never changed in place.
        file = h5py.File(path, "r", locking=False)
    except DAMAGE as error:
        reason = " ".join(str(error).split())
        what = "truncated" if "truncated" in reason else "damaged"
        raise CacheError(f"{path}: the file is {what} ({reason}). {REBUILD}") from error
    try:
        _check_header(file, path)
    except BaseException:
        file.close()
        raise
    return file


def _check_is_hdf5(path: Path) -> None:
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            raise CacheError(f"{path}: is {'a folder' if stat.S_ISDIR(mode) else 'not a file'}")
        with path.open("rb") as file:
            head = file.read(len(HDF5_SIGNATURE))
    except FileNotFoundError:
        raise CacheError(
            f"{path}: there is no such file. Make it: svprep build INPUT -o {path}"
        ) from None
    except OSError as error:
        raise CacheError(f"{path}: cannot be read ({error.strerror})") from error
    if head != HDF5_SIGNATURE:
        got = "an empty file" if not head else f"a file that begins with {head!r}"
        raise CacheError(
            f"{path}: is not a cache: expected an HDF5 file, got {got}. "
            "To make a cache of a model: svprep build MODEL"
        )


def _check_header(file: h5py.File, path: Path) -> None:
    with damage_named(path, "the file's header"):
        has_magic = "magic" in file.attrs
        is_ours = has_magic and attribute_value(file, ATTRIBUTE_OF_NAME["magic"]) == MAGIC.encode()
    if not is_ours:
        raise CacheError(
            f"{path}: is an HDF5 file but not a svprep cache (it has no attribute magic = "
            f'"{MAGIC}"). To make one: svprep build MODEL'
        )
    with damage_named(path, 'the attribute "schema_version"'):
        schema = int(file.attrs["schema_version"])
    if schema == SCHEMA_VERSION:
        return
    producer = "another version"
    with contextlib.suppress(*DAMAGE):
        producer = bytes(attribute_value(file, ATTRIBUTE_OF_NAME["producer_version"])).decode()
    advice = "Upgrade svprep" if schema > SCHEMA_VERSION else REBUILD
    raise CacheError(
        f"{path}: written by svprep {producer} with schema {schema}; this svprep reads schema "
        f"{SCHEMA_VERSION}. {advice}"
    )


def attribute_value(file: h5py.File, spec: AttributeSpec) -> bytes | NDArray[np.generic]:
    """Return a root attribute as it is stored: a text's UTF-8 bytes, or an array.

    Raises
    ------
    KeyError, ValueError
        It is missing, or not of the declared type and shape.
    """
    value = np.asarray(file.attrs[spec.name])
    expected = "text of fixed length" if spec.is_text else spec.dtype
    is_type = value.dtype.kind == "S" if spec.is_text else value.dtype == np.dtype(spec.dtype)
    if not is_type or value.shape != spec.shape:
        raise ValueError(f"expected {expected} {spec.shape}, got {value.dtype.str} {value.shape}")
    return bytes(value[()]) if spec.is_text else value


def stored_dataset(file: h5py.File, path: str) -> h5py.Dataset:
    """Return a dataset's handle once it is sure that reading it is safe.

    Raises
    ------
    KeyError, ValueError
        It is missing, or not stored in the file in one piece.
    """
    group = path.rpartition("/")[0]
    for name in filter(None, (group, path)):
        link = file.get(name, getlink=True)
        if link is None:
            raise KeyError(f'"{name}" is missing')
        if not isinstance(link, h5py.HardLink):
            raise ValueError(f'"{name}" is a link, expected it in the file itself')
    dataset = file[path]
    if not isinstance(dataset, h5py.Dataset):
        raise ValueError(f"expected a dataset, got a {type(dataset).__name__.lower()}")
    plist = dataset.id.get_create_plist()
    if plist.get_layout() != h5py.h5d.CONTIGUOUS or plist.get_external_count():
        raise ValueError("expected a contiguous dataset inside the file, got another layout")
    n_stored = dataset.id.get_storage_size()
    if dataset.shape is None or n_stored != dataset.nbytes:
        raise ValueError(f"expected {dataset.nbytes} bytes in the file, got {n_stored}")
    return dataset


def read_raw(dataset: h5py.Dataset) -> NDArray[np.generic]:
    """Return the whole array, read-only."""
    array = np.empty(dataset.shape, dataset.dtype)
    if array.size:
        dataset.read_direct(array)
    return frozen(array)


def read_digest_table(file: h5py.File) -> list[tuple[str, str]]:
    """Return the rows (dataset path, SHA-256 in hex) of the digest table."""
    dataset = stored_dataset(file, DIGESTS_PATH)
    if dataset.dtype != DIGESTS_DTYPE or dataset.ndim != 1:
        raise ValueError(f"expected {DIGESTS_DTYPE} (n,), got {dataset.dtype} {dataset.shape}")
    return [(row["path"].decode(), row["sha256"].decode()) for row in read_raw(dataset)]


def check_root(
    values: Mapping[str, bytes | NDArray[np.generic]], table: Sequence[tuple[str, str]]
) -> None:
    """Raise ValueError unless the two root digests fit the attributes and the digest table."""
    content = content_digest(values, table)
    for name, expected in (
        ("content_digest", content),
        ("root_digest", root_digest(content, values)),
    ):
        if values[name] != expected.encode():
            raise ValueError(f"expected {name} {expected[:12]}..., got {values[name]!r:.16}...")
