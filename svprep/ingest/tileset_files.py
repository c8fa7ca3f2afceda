"""The files of a tileset: found only inside its folder, read whole, each with its digest."""

from __future__ import annotations

import hashlib
import re
import stat
import zlib
from pathlib import Path
from typing import Final
from urllib.parse import unquote

from svprep.errors import InputError
from svprep.ingest.parsed import shown

_SCHEME: Final = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]*:")
_ALWAYS_UNPACKED: Final = 1 << 30
_MOST_RATIO: Final = 200
"""Of a gzip file: as in `svprep.ingest.file_bytes`."""


class TilesetFiles:
    """The files in the folder of one tileset."""

    def __init__(self, tileset: Path) -> None:
        self.tileset = tileset
        self._folder = tileset.parent.resolve()
        self.digests: list[bytes] = []
        """SHA-256 of every file read so far but the tileset itself, in order."""

    def locate(self, uri: object, base: Path) -> Path:
        """Return the file that a URI in `base` names.

        Raises
        ------
        InputError
            If it is not a relative one, or leads out of the folder of the tileset.
        """
        text = str(uri)
        plain = unquote(re.split(r"[?#]", text, maxsplit=1)[0])
        problem = ""
        if not isinstance(uri, str) or not plain or "\0" in plain:
            problem = "which names no file"
        elif _SCHEME.match(text):
            problem = "which is not read from there; download it, and name it by a relative path"
        elif plain.startswith(("/", "\\")):
            problem = f"outside its folder {self._folder}"
        if problem:
            raise InputError(f"{base}: it names {shown(text)}, {problem}.")
        try:
            inside = (base.parent / plain).resolve().relative_to(self._folder)
        except (OSError, RuntimeError, ValueError):  # a loop of links; elsewhere
            raise InputError(
                f"{base}: it names {shown(text)}, outside its folder {self._folder}; put all "
                "files of a tileset into one folder."
            ) from None
        return self.tileset.parent / inside

    def read(self, path: Path, base: Path) -> bytes:
        """Return a file that `base` names, unpacked if it is gzipped."""
        try:
            status = path.stat()
            if not stat.S_ISREG(status.st_mode):
                raise InputError(f"{base}: it names {shown(path)}, which is not a file.")
            data = path.read_bytes()
        except FileNotFoundError:
            raise InputError(
                f"{base}: it names {shown(path)}, but there is no such file; the tileset is "
                "incomplete."
            ) from None
        except (OSError, ValueError) as error:
            detail = getattr(error, "strerror", None) or error
            raise InputError(f"{shown(path)}: cannot be read: {detail}.") from None
        if path != self.tileset:
            self.digests.append(hashlib.sha256(data).digest())
        return _unpacked(data, path) if data[:2] == b"\x1f\x8b" else data


def _unpacked(data: bytes, path: Path) -> bytes:
    """Return what a gzip file unpacks to."""
    most = _MOST_RATIO * len(data) + _ALWAYS_UNPACKED
    unpack = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        text = unpack.decompress(data, most)
    except zlib.error as error:
        raise InputError(f"{path}: not a readable gzip file ({error}).") from None
    if not unpack.eof:
        problem = "unpacks to more than any model" if len(text) >= most else "is cut off"
        raise InputError(f"{path}: the gzip file {problem}.")
    return text
