"""A model file as bytes, unpacked if it ends in .gz, with its digest: whole, or as a stream.

Every way in which that can fail is one `InputError`.
"""

from __future__ import annotations

import hashlib
import io
import os
import stat
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from svprep import source_digest
from svprep.errors import InputError
from svprep.model import U8

_BLOCK_BYTES = 8 << 20
_PACKED_BYTES = 1 << 20  # of a gzip file, at a time

# More than that is no model that anyone packed: a gzip file may unpack to 1032 times its size.
_MOST_UNPACKED = 64 << 30
_MOST_RATIO = 200
_ALWAYS_UNPACKED = 1 << 30


@contextmanager
def file_errors(path: Path) -> Iterator[None]:
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
    with file_errors(path):
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
    """Read a file whole, several blocks at the same time.

    Returns
    -------
    data : (n_bytes + 1,) uint8
        The file's bytes, and a line feed. Of a ``.gz`` file, the bytes that it unpacks to.
    sha256 : function
        Returns the digest of the bytes on disk, followed by those of the files beside it
        that the reader names. `pool` computes it in the meantime.
    """
    with file_errors(path), path.open("rb", buffering=0) as file:
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


@dataclass(frozen=True, slots=True)
class Text:
    """A text that can be read again and again from its start, never held as a whole."""

    path: Path
    n_bytes: int
    """On disk."""
    content: bytes | None = None
    """The bytes on disk, of what can be read only once."""

    @classmethod
    def of(cls, path: Path) -> Text:
        """Return that of a file, or of a pipe."""
        with file_errors(path), path.open("rb", buffering=0) as file:
            status = os.fstat(file.fileno())
            if stat.S_ISREG(status.st_mode):
                return cls(path, status.st_size)
            content = file.readall()
        if not content:
            raise InputError(f"{path}: the file is empty.")
        return cls(path, len(content), content)

    @contextmanager
    def stream(self) -> Iterator[TextStream]:
        """Open the text, and close it behind the block."""
        with file_errors(self.path):
            if self.content is None:
                packed: BinaryIO = self.path.open("rb", buffering=0)
            else:
                packed = io.BytesIO(self.content)
            with packed:
                yield TextStream(self, packed)

    def sha256(self) -> str:
        """Return the digest of the bytes on disk."""
        if self.content is not None:
            return hashlib.sha256(self.content).hexdigest()
        with file_errors(self.path), self.path.open("rb", buffering=0) as file:
            return (
                source_digest.of(file.fileno()) or hashlib.file_digest(file, "sha256").hexdigest()
            )


class TextStream:
    """A text from its start on, unpacked if its file ends in .gz."""

    def __init__(self, text: Text, file: BinaryIO) -> None:
        self._text = text
        self._file = file
        is_packed = text.path.suffix.lower() == ".gz"
        self._blocks = _unpacked_blocks(text.path, file, text.n_bytes) if is_packed else None
        self._block = memoryview(b"")

    def fill(self, room: U8) -> int:
        """Fill `room`; less of it only at the end of the text. Return how much."""
        filled = 0
        while filled < room.size:
            n = self._some(room.data[filled:])
            if n == 0:
                break
            filled += n
        return filled

    def share(self) -> float:
        """Return the share of the file that is read, 0 to 1."""
        return min(1.0, self._file.tell() / max(1, self._text.n_bytes))

    def _some(self, room: memoryview) -> int:
        """Read something; nothing at the end."""
        if self._blocks is None:
            n = self._file.readinto(room)  # type: ignore[attr-defined]
            if n == 0 and self._file.tell() != self._text.n_bytes:
                raise OSError("it changed while it was read")
            return int(n)
        while not self._block:
            block = next(self._blocks, None)
            if block is None:
                return 0
            self._block = memoryview(block)
        n = min(len(room), len(self._block))
        room[:n] = self._block[:n]
        self._block = self._block[n:]
        return n


def _unpack(path: Path, packed: U8) -> U8:
    """Return the bytes of a gzip file, and a line feed."""
    text = bytearray()
    for block in _unpacked_blocks(path, io.BytesIO(packed.data), packed.size):
        text += block
    text += b"\n"
    return np.frombuffer(text, np.uint8)


def _unpacked_blocks(path: Path, packed: BinaryIO, n_bytes: int) -> Iterator[bytes]:
    """Yield what a gzip file of so many bytes unpacks to, in blocks."""
    most = min(_MOST_UNPACKED, _MOST_RATIO * n_bytes + _ALWAYS_UNPACKED)
    unpacked = 0
    try:
        for block in _unpacked(packed):
            unpacked += len(block)
            if unpacked > most:
                raise InputError(
                    f"{path}: unpacks to more than {most >> 20} MiB from {n_bytes} bytes, "
                    "which no model does; if it is one, unpack it and name the file it gives."
                )
            yield block
    except EOFError:
        raise InputError(
            f"{path}: the gzip file is cut off; it is incomplete. Copy or download it again."
        ) from None
    except zlib.error as error:
        raise InputError(f"{path}: not a readable gzip file ({error}).") from None
    if not unpacked:
        raise InputError(f"{path}: the file is empty once unpacked.")


def _unpacked(packed: BinaryIO) -> Iterator[bytes]:
    """Yield what the members of a gzip file unpack to, in blocks."""
    rest = packed.read(_PACKED_BYTES)
    while rest:
        member = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
        while not member.eof:
            part = member.unconsumed_tail or rest or packed.read(_PACKED_BYTES)
            rest = b""
            block = member.decompress(part, _BLOCK_BYTES)
            if not part and not block:
                raise EOFError
            yield block
        rest = member.unused_data.lstrip(b"\0")  # padding between members
        while not rest and (part := packed.read(_PACKED_BYTES)):
            rest = part.lstrip(b"\0")


def _with_line_feed(text: bytes) -> U8:
    """Return bytes as a writable array (the only kind that kernels are compiled for)."""
    data = np.empty(len(text) + 1, np.uint8)
    data[:-1] = np.frombuffer(text, np.uint8)
    data[-1] = 0x0A
    return data
