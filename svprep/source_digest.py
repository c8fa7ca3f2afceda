"""The SHA-256 of an OBJ file, worked out while the modules that read it are imported.

Imports keep one core busy and leave the others idle; hashing a file of a hundred megabytes
takes a core a tenth of a second. Other formats are read whole, and then hashed without being
read twice. Without NumPy, which is not imported yet.
"""

from __future__ import annotations

import hashlib
import os
import stat
import threading
from collections.abc import Sequence
from typing import Final

LEAST_BYTES: Final = 1 << 23
MOST_BYTES: Final = 1 << 28
"""What takes much longer than the imports would only be waited for, if a build has to compile."""
_SUFFIXES: Final = (".obj", ".obj.gz")
_BLOCK_BYTES: Final = 1 << 23
"""Few blocks: for each, the thread waits until the one that imports lets it go on."""

Identity = tuple[int, int, int, int]

_begun: dict[Identity, _Digest] = {}


def begin(inputs: Sequence[str]) -> None:
    """Begin with the digest of a model that is one OBJ file of such a size, on a thread."""
    if len(inputs) != 1 or not inputs[0].lower().endswith(_SUFFIXES):
        return
    try:
        status = os.stat(inputs[0])
    except (OSError, ValueError):  # told when it is read
        return
    if stat.S_ISREG(status.st_mode) and LEAST_BYTES <= status.st_size <= MOST_BYTES:
        _begun[_identity(status)] = _Digest(inputs[0])


def of(file: int) -> str | None:
    """Return the digest of an open file, by its descriptor, if it was begun as it is now."""
    digest = _begun.get(_identity(os.fstat(file)))
    return None if digest is None else digest.wait()


def settle() -> None:
    """Wait until nothing is being hashed: a process is forked that has one thread only."""
    for digest in _begun.values():
        digest.join()


class _Digest(threading.Thread):
    """Hashes a file."""

    def __init__(self, path: str) -> None:
        super().__init__(daemon=True)
        self._path = path
        self._digest: str | None = None
        self.start()

    def run(self) -> None:
        """Read and hash, block by block."""
        room = memoryview(bytearray(_BLOCK_BYTES))
        digest = hashlib.sha256()
        try:
            with open(self._path, "rb", buffering=0) as file:
                while n := file.readinto(room):
                    digest.update(room[:n])
        except OSError:  # told when it is read
            return
        self._digest = digest.hexdigest()

    def wait(self) -> str | None:
        """Return the digest once it is there; None if the file could not be read."""
        self.join()
        return self._digest


def _identity(status: os.stat_result) -> Identity:
    """Return what changes when another file is put there, or this one is written to."""
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
