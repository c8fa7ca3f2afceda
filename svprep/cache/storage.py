"""What reading a cache's HDF5 file safely takes: open, check, name the damage."""

from __future__ import annotations

import contextlib
import json
import shlex
import stat
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

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
    DatasetSpec,
    content_digest,
    root_digest,
)
from svprep.errors import CacheError

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


SUPERBLOCK_V2 = struct.Struct("<8sBBBBQQQQL")
"""Signature, version, three sizes and flags, base, extension, end of file, root, checksum."""
MAX_NAMED_SOURCES = 4


def rebuild_advice(path: Path, file: h5py.File | None = None) -> str:
    """Return the sentence that names the command to build the cache `path` again.

    It names the sources, and the options of that build, where `file` still tells them.
    """
    inputs, options = ["SOURCE"], ""
    with contextlib.suppress(*DAMAGE):
        if file:
            found = json.loads(bytes(attribute_value(file, ATTRIBUTE_OF_NAME["source_paths"])))
            is_text = isinstance(found, list) and all(isinstance(p, str) for p in found)
            if is_text and 0 < len(found) <= MAX_NAMED_SOURCES:
                inputs = [shlex.quote(p) for p in found]
            config = json.loads(bytes(attribute_value(file, ATTRIBUTE_OF_NAME["config"])))
            options = "".join(f" {word}" for word in _options_of(config))
    command = f"svprep build {' '.join(inputs)} -o {shlex.quote(str(path))}{options}"
    return f"Build it again: {command}"


def _options_of(config: Mapping[str, Any]) -> list[str]:
    """Return the options of `svprep build` that a stored configuration stands for."""
    words = []
    if tolerance := float(config.get("weld_tolerance_m", 0.0)):
        words += ["--weld-tolerance", repr(tolerance)]
    if "lod" in config:
        words += ["--lod", shlex.quote(str(config["lod"]))]
    for name in config.get("objects", []):
        words += ["--objects", shlex.quote(str(name))]
    words += [] if config.get("terrain", True) else ["--no-terrain"]
    words += [] if config.get("openings", True) else ["--no-openings"]
    if "crs" in config:
        words += ["--crs", shlex.quote(str(config["crs"]))]
    return words


@contextlib.contextmanager
def damage_named(path: Path, what: str, file: h5py.File | None = None) -> Iterator[None]:
    """Turn whatever damaged bytes make a library raise into one `CacheError`."""
    try:
        yield
    except CacheError:
        raise  # it names the file, the reason and the next command
    except KeyError as error:
        reason = f"{what} is missing or cannot be read"
        raise CacheError(f"{path} is damaged: {reason}. {rebuild_advice(path, file)}") from error
    except DAMAGE as error:
        # HDF5's own words say nothing to a user; they stay in the cause.
        is_ours = isinstance(error, ValueError) and not str(error).startswith("Unable to")
        reason = " ".join(str(error).split()) if is_ours else ""
        reason = f"{what} cannot be used ({reason})" if reason else f"{what} cannot be read"
        raise CacheError(f"{path} is damaged: {reason}. {rebuild_advice(path, file)}") from error


def open_hdf5(path: Path) -> h5py.File:
    """Open a cache's HDF5 file and check its magic and schema version, nothing else."""
    head = _read_head(path)
    try:
        # No HDF5 lock: it would fail in folders that cannot be written. None is
        # needed, because caches are replaced and never changed in place.
        file = h5py.File(path, "r", locking=False)
    except DAMAGE as error:
        # HDF5 says "truncated" only after the superblock's checksum was right.
        is_cut = "truncated" in str(error) or len(head) < SUPERBLOCK_V2.size
        reason = _cut_off(head, path) if is_cut else "is damaged: HDF5 cannot open it"
        raise CacheError(f"{path} {reason}. {rebuild_advice(path)}") from error
    try:
        _check_header(file, path)
    except BaseException:
        file.close()
        raise
    return file


def _cut_off(head: bytes, path: Path) -> str:
    """Return ``"is cut off: 200,000 of 1,186,492 bytes"``."""
    n_bytes = path.stat().st_size
    if len(head) == SUPERBLOCK_V2.size:
        _, version, size_of_offsets, *_, base, _, end, _, _ = SUPERBLOCK_V2.unpack(head)
        if version in (2, 3) and size_of_offsets == 8:
            return f"is cut off: {n_bytes:,} of {base + end:,} bytes"
    return f"is cut off after {n_bytes:,} bytes"


def _read_head(path: Path) -> bytes:
    """Return the file's first bytes, at most a superblock, if they are those of HDF5."""
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            kind = "a folder" if stat.S_ISDIR(mode) else "not a regular file"
            raise CacheError(f"{path} is {kind}. Name a cache, such as NAME.svp.h5")
        with path.open("rb") as file:
            head = file.read(SUPERBLOCK_V2.size)
    except FileNotFoundError:
        raise CacheError(
            f"{path}: there is no such file. Make it: svprep build SOURCE -o "
            f"{shlex.quote(str(path))}"
        ) from None
    except OSError as error:
        raise CacheError(f"{path} cannot be read ({error.strerror})") from error
    if not head.startswith(HDF5_SIGNATURE):
        raise CacheError(
            f"{path} is not a cache: {_what_begins_with(head[: len(HDF5_SIGNATURE)])}. "
            "Make one of a model: svprep build MODEL"
        )
    return head


def _what_begins_with(head: bytes) -> str:
    """Return ``'expected an HDF5 file, got one that begins with "v 0 0 0"'``."""
    if not head:
        return "it is empty"
    if HDF5_SIGNATURE.startswith(head):
        return f"it ends after {len(head)} bytes"
    text = head.decode("ascii", "replace").strip()
    is_text = bool(text) and text.isascii() and text.isprintable()
    got = f'"{text}"' if is_text else f"the bytes {head.hex(' ')}"
    return f"expected an HDF5 file, got one that begins with {got}"


def _check_header(file: h5py.File, path: Path) -> None:
    with damage_named(path, "the file's header", file):
        has_magic = "magic" in file.attrs
        is_ours = has_magic and attribute_value(file, ATTRIBUTE_OF_NAME["magic"]) == MAGIC.encode()
    if not is_ours:
        raise CacheError(
            f"{path} is an HDF5 file, but not a svprep cache (it has no attribute magic = "
            f'"{MAGIC}"). Make one of a model: svprep build MODEL'
        )
    with damage_named(path, 'the attribute "schema_version"', file):
        schema = int(file.attrs["schema_version"])
    if schema == SCHEMA_VERSION:
        return
    producer = "another version"
    with contextlib.suppress(*DAMAGE):
        stored = bytes(attribute_value(file, ATTRIBUTE_OF_NAME["producer_version"]))
        producer = f"svprep {stored.decode()}"
    newer = "Upgrade svprep: git pull in its clone, then pip install . there"
    advice = newer if schema > SCHEMA_VERSION else rebuild_advice(path, file)
    raise CacheError(
        f"{path} was written by {producer} with schema {schema}; this svprep reads schema "
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
            raise KeyError(name)
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


def frozen_view(array: NDArray[np.generic], spec: DatasetSpec) -> NDArray[np.generic]:
    """Return a stored array as it is used in memory: the same bytes, read-only."""
    return array if spec.in_memory == spec.dtype else frozen(array.view(spec.in_memory))


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
            got = bytes(values[name]).decode("ascii", "replace")
            raise ValueError(f"{name} begins with {got[:12]}, expected {expected[:12]}")
