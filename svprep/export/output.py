"""Writing an export where the user asked for it: guarded, whole or not at all."""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from svprep.errors import InputError
from svprep.export import cityjson, glb, obj, ply
from svprep.export.city import City
from svprep.output_file import OutputKind, write_whole

Parts = Callable[[City], Iterator[bytes]]


@dataclass(frozen=True, slots=True)
class ExportFormat:
    """One format that a mesh is exported in."""

    name: str
    parts: Parts
    not_kept: tuple[str, ...]
    """What it has no place for."""


_FORMATS: Final = {
    ".obj": ExportFormat("obj", obj.obj_parts, ("surfaces",)),
    ".ply": ExportFormat("ply", ply.ply_parts, ()),
    ".glb": ExportFormat("glb", glb.glb_parts, ()),
    ".json": ExportFormat("cityjson", cityjson.cityjson_parts, ()),
}
FORM: Final = "a mesh is exported as .obj, .ply, .glb or .city.json, each also with .gz behind it"
_GZIP: Final = b"\x1f\x8b"
_HEAD_BYTES: Final = 80  # of a packed file, in a member of their own


def _is_ours(head: bytes) -> bool:
    """Whether a file begins as one that `write_export` made, packed or not."""
    if head.startswith(_GZIP):
        try:
            # What follows the member that `_packed` puts first is cut off here, which is no error.
            head = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS).decompress(head)
        except zlib.error:
            return False
    return head.startswith((obj.HEAD, ply.HEAD, cityjson.HEAD)) or (
        head.startswith(b"glTF") and head[glb.JSON_AT :].startswith(glb.HEAD)
    )


EXPORT: Final = OutputKind(
    name="the export",
    form=FORM,
    what="is not an export of svprep",
    suffixes=(*_FORMATS, ".gz"),
    is_ours=_is_ours,
)


def export_format(path: str | os.PathLike[str]) -> ExportFormat:
    """Return the format that the name of a file asks for.

    Raises
    ------
    InputError
        For none that is known.
    """
    name = os.path.basename(os.fspath(path)).lower()
    suffix = os.path.splitext(name.removesuffix(".gz"))[1]
    if suffix not in _FORMATS:
        raise InputError(f"{path}: {FORM}; name the file so")
    return _FORMATS[suffix]


def checked_export_path(
    path: str | os.PathLike[str], others: Sequence[str | os.PathLike[str]] = ()
) -> Path:
    """Return the file that `path` names, if an export may be written there.

    Raises
    ------
    InputError, EnvironmentProblem
        As `OutputKind.checked_path`; also for a suffix that is no format.
    """
    export_format(path)
    return EXPORT.checked_path(path, others)


def write_export(city: City, path: str | os.PathLike[str]) -> Path:
    """Write a city in the format that the name of `path` asks for; return the file.

    The same city gives the same bytes. The file is written beside its place and renamed:
    an older one stays whole until the new one is.

    Raises
    ------
    InputError, EnvironmentProblem
        As `checked_export_path`, or the disk is full.
    """
    target = checked_export_path(path)
    parts: Iterable[bytes] = export_format(path).parts(city)
    if os.fspath(path).lower().endswith(".gz"):
        parts = _packed(parts)
    write_whole(target, parts)
    return target


def _packed(parts: Iterable[bytes]) -> Iterator[bytes]:
    """Yield a gzip file: the first bytes as a member of their own, so that they can be told."""
    first = True
    member = zlib.compressobj(6, wbits=16 + zlib.MAX_WBITS)
    for part in parts:
        rest = part
        if first:
            head = zlib.compressobj(6, wbits=16 + zlib.MAX_WBITS)
            yield head.compress(part[:_HEAD_BYTES]) + head.flush()
            rest, first = part[_HEAD_BYTES:], False
        if block := member.compress(rest):
            yield block
    yield member.flush()
