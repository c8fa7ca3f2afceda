"""The reader of 3D Tiles: a ``tileset.json`` and the files that it names, as one input.

    tileset    1.0 and 1.1; tilesets in tilesets, implicit tiling, several contents
    tiles      .glb, .gltf, .b3dm, and .cmpt of those; .i3dm is refused by name, the points
               of .pnts are left out and counted
    detail     of tiles that replace each other (REPLACE) the last ones, of ADD all
    frame      of the root tile, z up; "EPSG:4978" where that is earth-centred

Objects keep the names that their tiles give them. The same name in two tiles is two objects:
nothing says that they are the same.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from svprep.errors import InputError
from svprep.ingest.b3dm import read_tile
from svprep.ingest.gltf import read_content
from svprep.ingest.gltf_frame import with_earth_frame
from svprep.ingest.gltf_objects import MOST_TRIANGLES
from svprep.ingest.options import ReadOptions
from svprep.ingest.parsed import ParsedFile, Report, count_of, no_findings, shown
from svprep.ingest.surface_names import SurfaceNames
from svprep.ingest.tileset_files import TilesetFiles
from svprep.ingest.tileset_tree import Tile, read_tree
from svprep.model import U8

_MOST_INSIDE: Final = 16  # .cmpt in .cmpt
_MOST_NOTES: Final = 20
_HOW_TO_CONVERT: Final = "convert it to 3D Tiles 1.1 (3d-tiles-tools upgrade)"


def read_tileset(path: Path, report: Report, options: ReadOptions) -> ParsedFile:
    """Read a tileset.

    Parameters
    ----------
    path
        The JSON file, or the folder with its ``tileset.json``.
    report
        Told the fraction of the contents that are read.
    options
        Not looked at: tiles have no level of detail by name.

    Returns
    -------
    ParsedFile
        `beside` has the SHA-256 of each file that was read, not its bytes.

    Raises
    ------
    InputError
        For a file that is missing, damaged or outside the folder, and for contents that are
        not read: leaving them out would leave out shadows.
    """
    files = TilesetFiles(path / "tileset.json" if path.is_dir() else path)
    tree = read_tree(files)
    tiles = tree.contributing()
    contents = [(tile, content) for tile in tiles for content in tile.contents]
    parts: list[ParsedFile] = []
    points: list[Path] = []
    n_triangles = 0
    for i, (tile, content) in enumerate(contents):
        found = _read_content(tile, content, files, points)
        parts += found
        n_triangles += sum(len(part.faces) for part in found)
        if n_triangles > MOST_TRIANGLES:
            raise InputError(
                f"{files.tileset}: more than {MOST_TRIANGLES} triangles; name a part of it."
            )
        report((i + 1) / len(contents))
    if n_triangles == 0:
        raise InputError(
            f"{files.tileset}: no triangles in {count_of(len(contents), 'content')} of "
            f"{count_of(len(tree.tiles), 'tile')}."
        )
    parsed = _joined(parts, _notes(parts, len(tree.tiles), len(contents), points), files.digests)
    return with_earth_frame(parsed, is_stated=tree.has_region)


def _read_content(
    tile: Tile, path: Path, files: TilesetFiles, points: list[Path]
) -> list[ParsedFile]:
    """Return what one content holds; the files of `points` hold none of it."""
    base = tile.document.path
    parts = []
    for text in _unpacked(files.read(path, base), path):
        magic = bytes(text[:4])
        if magic == b"pnts":
            points.append(path)
        elif magic == b"b3dm":
            parts.append(
                read_tile(
                    text,
                    path,
                    frame=tile.root_from_tile,
                    is_y_up=tile.document.is_y_up,
                    locate=lambda uri: files.locate(uri, path),
                )
            )
        elif magic == b"glTF" or bytes(text[:64]).lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"{":
            parts.append(
                read_content(
                    text,
                    path,
                    frame=tile.root_from_tile,
                    is_y_up=tile.document.is_y_up,
                    locate=lambda uri: files.locate(uri, path),
                )
            )
        else:
            kind = ".i3dm (instances)" if magic == b"i3dm" else f"a file beginning {magic!r}"
            raise InputError(
                f"{path}: this content is {shown(kind)}, which is not read; {_HOW_TO_CONVERT}."
            )
    files.digests += [hashlib.sha256(data).digest() for part in parts for data in part.beside]
    return [replace(part, beside=()) for part in parts]


def _unpacked(text: bytes, path: Path) -> list[memoryview]:
    """Return the tiles in a ``.cmpt``, or the one that it is."""
    found = []
    stack = [(memoryview(text), 0)]
    while stack:
        view, depth = stack.pop()
        if bytes(view[:4]) != b"cmpt":
            found.append(view)
            continue
        if depth >= _MOST_INSIDE:
            raise InputError(f"{path}: composite tiles more than {_MOST_INSIDE} inside each other.")
        inner: list[tuple[memoryview, int]] = []
        pos, length, n_tiles = 16, 0, 0
        if len(view) >= pos:
            length, n_tiles = struct.unpack_from("<II", view, 8)
        for _ in range(n_tiles):
            size = struct.unpack_from("<I", view, pos + 8)[0] if pos + 12 <= len(view) else 0
            if size < 12 or pos + size > min(length, len(view)):
                break
            inner.append((view[pos : pos + size], depth + 1))
            pos += size
        if len(view) < 16 or len(inner) < n_tiles:
            raise InputError(
                f"{path}: the composite tile is cut off: {len(inner)} of {n_tiles} tiles in it."
            )
        stack.extend(reversed(inner))
    return found


def _notes(
    parts: Sequence[ParsedFile], n_tiles: int, n_contents: int, points: list[Path]
) -> tuple[str, ...]:
    """Return the notes on the tileset, and what its contents have to say."""
    said: dict[str, int] = {}
    for part in parts:
        for note in part.notes:
            said[note] = said.get(note, 0) + 1
    notes = [f"{count_of(n_contents, 'content')} read of a tileset of {count_of(n_tiles, 'tile')}"]
    if points:
        notes.append(
            f"{count_of(len(points), 'content')} with points (.pnts) left out, "
            f"the first {shown(points[0].name)}"
        )
    n_empty = sum(len(part.faces) == 0 for part in parts)
    if n_empty:
        notes.append(f"{count_of(n_empty, 'content')} without a triangle")
    for note, n in list(said.items())[:_MOST_NOTES]:
        notes.append(note if n == len(parts) else f"{note} (in {count_of(n, 'content')})")
    if len(said) > _MOST_NOTES:
        notes.append(f"{len(said) - _MOST_NOTES} further notes on contents")
    return tuple(notes)


def _joined(
    parts: Sequence[ParsedFile], notes: tuple[str, ...], digests: Sequence[bytes]
) -> ParsedFile:
    """Put the contents one behind the other."""
    n_vertices = np.array([len(part.positions) for part in parts])
    n_faces = np.array([len(part.faces) for part in parts])
    if n_vertices.sum() >= 1 << 32:
        raise InputError(f"{n_vertices.sum()} vertices in one tileset; 2**32 - 1 are read.")
    first_vertex = (np.cumsum(n_vertices) - n_vertices).astype(np.uint32)
    first_face = (np.cumsum(n_faces) - n_faces).astype(np.uint32)
    counts = np.concatenate([np.diff(part.object_face_start) for part in parts])
    surface_names, surfaces = _surfaces(parts)
    return ParsedFile(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([p.faces + first for p, first in zip(parts, first_vertex, strict=True)]),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        np.concatenate([p.source_face + first for p, first in zip(parts, first_face, strict=True)]),
        tuple(name for part in parts for name in part.object_names),
        no_findings(),
        notes,
        tuple(digests),
        _stated([(part.object_types, len(part.object_names)) for part in parts]),
        _stated([(part.object_parents, len(part.object_names)) for part in parts]),
        surface_names,
        surfaces,
    )


def _stated(texts: list[tuple[tuple[str, ...], int]]) -> tuple[str, ...]:
    """Return a text per object, or none at all where none is stated of any."""
    filled = tuple(text for stated, n in texts for text in stated or ("",) * n)
    return filled if any(filled) else ()


def _surfaces(parts: Sequence[ParsedFile]) -> tuple[tuple[str, ...], U8]:
    """Return the names of surfaces of all contents, and which each polygon has."""
    names = SurfaceNames()
    of_polygon = []
    for part in parts:
        table = np.array([names.number_of(name) for name in part.surface_names], np.uint8)
        stated = part.surface_of_polygon
        of_polygon.append(table[stated] if len(stated) else np.zeros(len(part.faces), np.uint8))
    if len(names.names()) == 1:
        return ("",), np.zeros(0, np.uint8)
    return names.names(), np.concatenate(of_polygon)
