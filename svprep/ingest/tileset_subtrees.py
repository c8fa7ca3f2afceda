"""Implicit tiling (3D Tiles 1.1): which tiles of a quadtree or octree there are.

A subtree file tells of a few levels at a time, a bit per tile, level by level and in
Morton order within each:

    bit of the tile m of level l  =  (N**l - 1) / (N - 1) + m,  N = 4 or 8
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from svprep.errors import InputError
from svprep.ingest.gltf_buffers import natural
from svprep.ingest.parsed import shown
from svprep.ingest.tileset_files import TilesetFiles
from svprep.model import BOOL, I64

_MOST_BITS: Final = 1 << 22  # of one subtree: 11 levels of a quadtree
_MOST_BITS_IN_ALL: Final = 1 << 29  # of all subtrees of a tileset, of every kind
_MOST_SUBTREES: Final = 1 << 15
_DIMENSIONS: Final = {"QUADTREE": 2, "OCTREE": 3}


@dataclass(frozen=True, slots=True)
class Tiling:
    """How a tile is divided."""

    n_dimensions: int
    subtree_levels: int
    available_levels: int
    template: str
    """URI of the subtree files."""

    @property
    def n_children(self) -> int:
        """Of a tile."""
        return 1 << self.n_dimensions


@dataclass(slots=True)
class BitCount:
    """How many bits of availability a tileset had so far."""

    n_bits: int = 0

    def add(self, n: int, base: Path) -> None:
        """Raise `InputError` if with `n` more there are more than of any city."""
        self.n_bits += n
        if self.n_bits > _MOST_BITS_IN_ALL:
            raise InputError(
                f"{base}: its subtrees have more than {_MOST_BITS_IN_ALL} bits of availability; "
                "name a part of it."
            )


@dataclass(frozen=True, slots=True)
class ImplicitTile:
    """One tile that there is."""

    level: int
    coordinates: tuple[int, ...]
    """x, y and of an octree z."""
    contents: tuple[int, ...]
    """Which of the contents of the template it has."""

    @property
    def parent(self) -> tuple[int, tuple[int, ...]]:
        """Level and coordinates of the tile above."""
        return self.level - 1, tuple(c >> 1 for c in self.coordinates)

    def fill(self, template: str) -> str:
        """Return a template URI with level and coordinates put in."""
        return _filled(template, self.level, self.coordinates)


def _filled(template: str, level: int, coordinates: tuple[int, ...]) -> str:
    text = template.replace("{level}", str(level))
    for name, value in zip("xyz", coordinates, strict=False):
        text = text.replace(f"{{{name}}}", str(value))
    return text


def tiling_of(tile: dict[str, Any], path: Path) -> Tiling | None:
    """Return how a tile is divided, if it is divided implicitly."""
    older = tile.get("extensions", {}).get("3DTILES_implicit_tiling")
    stated = tile.get("implicitTiling", older)
    if stated is None:
        return None
    scheme, levels = stated["subdivisionScheme"], natural(stated["subtreeLevels"])
    available = natural(stated.get("availableLevels", stated.get("maximumLevel", 0)))
    if "availableLevels" not in stated:
        available += 1
    if scheme not in _DIMENSIONS:
        raise InputError(
            f"{path}: its subdivision scheme is {shown(scheme)}; QUADTREE and OCTREE are read."
        )
    tiling = Tiling(_DIMENSIONS[scheme], levels, available, str(stated["subtrees"]["uri"]))
    if not 1 <= levels <= 24 or available > 48 or _first_bit(tiling, levels) > _MOST_BITS:
        raise InputError(
            f"{path}: subtrees of {levels} levels, {available} in all; at most {_MOST_BITS} tiles "
            "in a subtree and 48 levels are read."
        )
    return tiling


def implicit_tiles(
    tiling: Tiling, n_contents: int, files: TilesetFiles, base: Path, count: BitCount
) -> Iterator[ImplicitTile]:
    """Yield the tiles that there are, parents first.

    Parameters
    ----------
    n_contents
        How many contents the template has.
    base
        The tileset that names the subtrees.
    count
        Of the whole tileset; what is read here is added.

    Raises
    ------
    InputError
        Two subtrees are one file, or there are more bits in all than of any city.
    """
    n_subtrees = 1
    bits_of_each = (2 + n_contents) * _first_bit(tiling, tiling.subtree_levels)
    seen: set[Path] = set()
    stack: list[tuple[int, tuple[int, ...]]] = [(0, (0,) * tiling.n_dimensions)]
    while stack:
        level, root = stack.pop()
        path = files.locate(_filled(tiling.template, level, root), base)
        if path in seen:
            raise InputError(
                f"{base}: two of its subtrees are the same file, {shown(path)}; each has its own, "
                "named by level and coordinates."
            )
        seen.add(path)
        count.add(bits_of_each, base)
        subtree = _Subtree(files, path, base)
        yield from _tiles_of(subtree, tiling, n_contents, level, root)
        below = level + tiling.subtree_levels
        if below < tiling.available_levels:
            n = tiling.n_children**tiling.subtree_levels
            index = np.flatnonzero(subtree.bits("childSubtreeAvailability", n))
            n_subtrees += index.size
            if n_subtrees > _MOST_SUBTREES:
                raise InputError(f"{base}: more than {_MOST_SUBTREES} subtrees; name a part of it.")
            for offset in _from_morton(index, tiling).tolist()[::-1]:
                stack.append((below, _below(root, offset, tiling.subtree_levels)))


def _tiles_of(
    subtree: _Subtree, tiling: Tiling, n_contents: int, level: int, root: tuple[int, ...]
) -> Iterator[ImplicitTile]:
    """Yield the tiles of one subtree, level by level."""
    n_levels = min(tiling.subtree_levels, tiling.available_levels - level)
    n_bits = _first_bit(tiling, tiling.subtree_levels)
    has_content = [subtree.bits("contentAvailability", n_bits, i) for i in range(n_contents)]
    is_there = subtree.bits("tileAvailability", n_bits)
    for bits in has_content:
        is_there = is_there | bits
    for depth in range(n_levels):
        first = _first_bit(tiling, depth)
        index = np.flatnonzero(is_there[first : _first_bit(tiling, depth + 1)])
        contents = [bits[first + index] for bits in has_content]
        offsets = _from_morton(index, tiling).tolist()
        for row, offset in enumerate(offsets):
            found = tuple(i for i, bits in enumerate(contents) if bits[row])
            yield ImplicitTile(level + depth, _below(root, offset, depth), found)


def _first_bit(tiling: Tiling, depth: int) -> int:
    """Return the bit of the first tile of a level, which is how many lie above."""
    return int((tiling.n_children**depth - 1) // (tiling.n_children - 1))


def _below(root: tuple[int, ...], offset: list[int], depth: int) -> tuple[int, ...]:
    return tuple((r << depth) + o for r, o in zip(root, offset, strict=True))


def _from_morton(index: I64, tiling: Tiling) -> I64:
    """Return the coordinates of tiles within their level, ``(n, n_dimensions)``."""
    coordinates = np.zeros((index.size, tiling.n_dimensions), np.int64)
    for bit in range(tiling.subtree_levels):
        for axis in range(tiling.n_dimensions):
            coordinates[:, axis] |= ((index >> (bit * tiling.n_dimensions + axis)) & 1) << bit
    return coordinates


class _Subtree:
    """One subtree file, binary or JSON."""

    def __init__(self, files: TilesetFiles, path: Path, base: Path) -> None:
        self.files = files
        self.path = path
        data = files.read(path, base)
        self.binary = b""
        if data[:4] == b"subt":
            if len(data) < 24:
                raise InputError(f"{path}: the subtree file is cut off ({len(data)} bytes).")
            _, n_text, n_binary = struct.unpack_from("<IQQ", data, 4)
            if 24 + n_text + n_binary > len(data):
                raise InputError(
                    f"{path}: the subtree file is cut off: it announces "
                    f"{24 + n_text + n_binary} bytes and has {len(data)}."
                )
            data, self.binary = data[24 : 24 + n_text], data[24 + n_text : 24 + n_text + n_binary]
        try:
            self.tree = json.loads(data)
        except (ValueError, RecursionError):
            raise InputError(f"{path}: not a subtree file: no readable JSON in it.") from None
        if not isinstance(self.tree, dict):
            raise InputError(f"{path}: not a subtree file: its JSON is no object.")

    def bits(self, name: str, n_bits: int, number: int = 0) -> BOOL:
        """Return one availability, a truth value per tile."""
        stated = self.tree.get(name, {"constant": 0})
        if isinstance(stated, list):
            stated = stated[number] if number < len(stated) else {"constant": 0}
        if "constant" in stated:
            return np.full(n_bits, bool(stated["constant"]))
        view = self.tree["bufferViews"][natural(stated.get("bitstream", stated.get("bufferView")))]
        buffer = self._buffer(natural(view["buffer"]))
        start, length = natural(view.get("byteOffset", 0)), natural(view["byteLength"])
        data = buffer[start : start + length]
        if len(data) < length or 8 * length < n_bits:
            raise InputError(
                f"{self.path}: {name} needs {n_bits} bits, but its bufferView of {length} bytes "
                f"gives {8 * len(data)} (the file is damaged or cut off)."
            )
        unpacked = np.unpackbits(np.frombuffer(data, np.uint8), count=n_bits, bitorder="little")
        return unpacked.astype(np.bool_)

    def _buffer(self, index: int) -> bytes:
        """Return the binary part, or the file that a buffer names."""
        uri = self.tree["buffers"][index].get("uri")
        if uri is None:
            return self.binary
        return self.files.read(self.files.locate(uri, self.path), self.path)
