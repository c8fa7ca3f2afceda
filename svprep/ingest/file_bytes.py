"""A model file as bytes: read in parallel, unpacked if it ends in .gz, with its digest.

Every way in which that can fail is one `InputError`.
"""

from __future__ import annotations

import hashlib
import os
import stat
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from svprep.errors import InputError
from svprep.model import U8

_BLOCK_BYTES = 8 << 20
_PACKED_BYTES = 1 << 20  # of a gzip file, at a time

# More than that is no model that anyone packed: a gzip file may unpack to 1032 times its size.
_MOST_UNPACKED = 64 << 30
_MOST_RATIO = 200
_ALWAYS_UNPACKED = 1 << 30


@contextmanager
def _file_errors(path: Path) -> Iterator[None]:
    """Turn what the system says about a file into one line."""
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file.") from None
    except (IsADirectoryError, NotADirectoryError):
        raise InputError(
            f"{path}: this is a folder, or leads through a file; name a model file."
        ) from None
    except PermissionError:
        raise InputError(f"{path}: no permission to read this file.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from None


def check_file(path: Path) -> int:
    """Return the size of a file on disk; raise `InputError` if it cannot be a model."""
    with _file_errors(path):
        status = path.stat()
    if is_device(status):
        raise InputError(f"{path}: this is a device, not a file; name a model file.")
    if stat.S_ISDIR(status.st_mode):
        raise InputError(f"{path}: this is a folder; name the model files in it.")
    if stat.S_ISREG(status.st_mode) and status.st_size == 0:
        raise InputError(f"{path}: the file is empty.")
    return status.st_size


def is_device(status: os.stat_result) -> bool:
    """Return whether this is a device: there may be no end of it."""
    return stat.S_ISBLK(status.st_mode) or stat.S_ISCHR(status.st_mode)


def read_file(path: Path, pool: Executor) -> tuple[U8, Callable[[Sequence[bytes]], str]]:
    """Read a file.

    Returns
    -------
    data : (n_bytes + 1,) uint8
        The file's bytes, and a line feed that the OBJ parser needs. Of a ``.gz`` file, the
        bytes that it unpacks to.
    sha256 : function
        Returns the digest of the bytes on disk, followed by those of the files beside it
        that the reader names. `pool` computes it in the meantime.
    """
    with _file_errors(path), path.open("rb", buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        if size <= _BLOCK_BYTES or not hasattr(os, "preadv"):  # size 0: perhaps a pipe
            data = _with_line_feed(file.readall())
        else:
            data = np.empty(size + 1, np.uint8)
            data[size] = 0x0A
            starts = range(0, size, _BLOCK_BYTES)
            list(pool.map(lambda start: _read_block(file.fileno(), data, start), starts))
    if data.size == 1:
        raise InputError(f"{path}: the file is empty.")
    on_disk = data[:-1]
    hashing = pool.submit(hashlib.sha256, on_disk.data)

    def sha256(beside: Sequence[bytes]) -> str:
        digest = hashing.result().copy()
        for content in beside:
            digest.update(content)
        return digest.hexdigest()

    if path.suffix.lower() == ".gz":
        data = _unpack(path, on_disk)
    return data, sha256


def _read_block(descriptor: int, data: U8, start: int) -> None:
    """Fill one block of `data` from the file."""
    block = data.data[start : min(start + _BLOCK_BYTES, data.size - 1)]
    offset = start
    while block:
        n = os.preadv(descriptor, [block], offset)
        if n == 0:
            raise OSError("it became shorter while it was read")
        block, offset = block[n:], offset + n


def _unpack(path: Path, packed: U8) -> U8:
    """Return the bytes of a gzip file, and a line feed."""
    most = min(_MOST_UNPACKED, _MOST_RATIO * packed.size + _ALWAYS_UNPACKED)
    text = bytearray()
    try:
        for block in _unpacked(packed.data):
            text += block
            if len(text) > most:
                raise InputError(
                    f"{path}: unpacks to more than {most >> 20} MiB from {packed.size} bytes, "
                    "which no model does; if it is one, unpack it and name the file it gives."
                )
    except EOFError:
        raise InputError(
            f"{path}: the gzip file is cut off; it is incomplete. Copy or download it again."
        ) from None
    except zlib.error as error:
        raise InputError(f"{path}: not a readable gzip file ({error}).") from None
    if not text:
        raise InputError(f"{path}: the file is empty once unpacked.")
    text += b"\n"
    return np.frombuffer(text, np.uint8)


def _unpacked(packed: memoryview) -> Iterator[bytes]:
    """Yield what the members of a gzip file unpack to, in blocks."""
    pos = 0
    while pos < len(packed):
        member = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
        while not member.eof:
            part: bytes | memoryview = member.unconsumed_tail
            if not part:
                part = packed[pos : pos + _PACKED_BYTES]
                pos += len(part)
            block = member.decompress(part, _BLOCK_BYTES)
            if not part and not block:
                raise EOFError
            yield block
        pos -= len(member.unused_data)
        while pos < len(packed) and packed[pos] == 0:  # padding between members
            pos += 1


def _with_line_feed(text: bytes) -> U8:
    """Return bytes as a writable array (the only kind that kernels are compiled for)."""
    data = np.empty(len(text) + 1, np.uint8)
    data[:-1] = np.frombuffer(text, np.uint8)
    data[-1] = 0x0A
    return data
