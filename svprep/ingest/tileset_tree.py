"""The tiles of a 3D Tiles tileset, as a flat list with parents first.

Tilesets named by tiles and implicit tiles are followed. Nothing recurses, and the number of
tiles, of tilesets and their depth are bounded: a tileset is untrusted input.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from svprep.errors import InputError, first_few
from svprep.ingest.gltf_frame import composed
from svprep.ingest.parsed import count_of, shown
from svprep.ingest.tileset_files import TilesetFiles
from svprep.ingest.tileset_subtrees import BitCount, Tiling, implicit_tiles, tiling_of
from svprep.model import F64

NO_PARENT: Final = -1

_MOST_TILES: Final = 1_000_000
_MOST_TILESETS: Final = 20_000
_MOST_DEPTH: Final = 64  # of tilesets in tilesets
_NO_GEOMETRY: Final = frozenset(
    [
        *("3DTILES_content_gltf", "3DTILES_implicit_tiling", "3DTILES_multiple_contents"),
        *("3DTILES_metadata", "3DTILES_batch_table_hierarchy", "3DTILES_bounding_volume_S2"),
        *("3DTILES_bounding_volume_cylinder", "3DTILES_ellipsoid"),
    ]
)


@dataclass(frozen=True, slots=True)
class Document:
    """One tileset file."""

    path: Path
    above: Document | None
    """The tileset that names it."""
    is_y_up: bool
    """Of the glTF in its tiles."""
    depth: int = 0

    def is_below(self, path: Path) -> bool:
        """Return whether `path` is this tileset or one that leads to it."""
        document: Document | None = self
        while document is not None:
            if document.path == path:
                return True
            document = document.above
        return False


@dataclass(frozen=True, slots=True)
class Tile:
    """One tile that there is."""

    parent: int
    """Its place in the list, or `NO_PARENT`."""
    is_replaced: bool
    """Whether the tiles below show the same in more detail (REPLACE)."""
    root_from_tile: F64
    """``(4, 4)``"""
    contents: tuple[Path, ...]
    document: Document


@dataclass(frozen=True, slots=True)
class TileTree:
    """All tiles of a tileset."""

    tiles: list[Tile]
    has_region: bool
    """Whether a bounding volume is a region on Earth: positions are earth-centred then."""

    def contributing(self) -> list[Tile]:
        """Return the tiles whose contents are the most detailed there is.

        A tile that is replaced contributes if no tile below has any content.
        """
        is_full_below = [False] * len(self.tiles)
        for i in range(len(self.tiles) - 1, -1, -1):
            parent = self.tiles[i].parent
            if parent != NO_PARENT and (self.tiles[i].contents or is_full_below[i]):
                is_full_below[parent] = True
        return [
            tile
            for tile, is_full in zip(self.tiles, is_full_below, strict=True)
            if tile.contents and not (tile.is_replaced and is_full)
        ]


def read_tree(files: TilesetFiles) -> TileTree:
    """Read a tileset and every tileset that it names.

    Raises
    ------
    InputError
        One line: which tileset, and what is wrong in it.
    """
    return _Walk(files).walk()


@dataclass(frozen=True, slots=True)
class _Pending:
    """A tile that is still JSON."""

    tree: dict[str, Any]
    parent: int
    root_from_parent: F64
    refine: str
    document: Document


class _Walk:
    """A tileset while its tiles are listed."""

    def __init__(self, files: TilesetFiles) -> None:
        self.files = files
        self.tiles: list[Tile] = []
        self.bit_count = BitCount()
        self.n_tilesets = 0
        self.has_region = False

    def walk(self) -> TileTree:
        """Return all tiles."""
        tileset = self.files.tileset
        root, document = self._open(tileset, None, tileset)
        stack = [_Pending(root, NO_PARENT, np.eye(4), "REPLACE", document)]
        while stack:
            pending = stack.pop()
            try:
                below = self._visit(pending)
            except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
                detail = shown(f"{type(error).__name__}: {error}")
                raise InputError(
                    f"{pending.document.path}: the tileset is damaged ({detail})."
                ) from None
            stack.extend(reversed(below))
        return TileTree(self.tiles, self.has_region)

    def _open(self, path: Path, above: Document | None, base: Path) -> tuple[Any, Document]:
        """Return the root tile of a tileset file, and what holds for the whole file."""
        self.n_tilesets += 1
        depth = 0 if above is None else above.depth + 1
        if above is not None and above.is_below(path):
            raise InputError(f"{path}: the tileset leads back to itself (through {base}).")
        if self.n_tilesets > _MOST_TILESETS or depth > _MOST_DEPTH:
            raise InputError(
                f"{path}: more than {_MOST_TILESETS} tilesets in tilesets, or more than "
                f"{_MOST_DEPTH} inside each other; name one of those inside."
            )
        try:
            tree = json.loads(self.files.read(path, base).decode("utf-8-sig"))
        except ValueError as error:
            raise InputError(f"{path}: not a tileset: no readable JSON ({error}).") from None
        except RecursionError:
            raise InputError(f"{path}: its tiles are nested too deeply to be read.") from None
        if not isinstance(tree, dict) or not isinstance(tree.get("root"), dict):
            raise InputError(f'{path}: not a tileset: the JSON has no "root".')
        required = tree.get("extensionsRequired") or []
        unknown = [str(name) for name in required if name not in _NO_GEOMETRY]
        if unknown:
            listed = first_few(map(shown, unknown))
            raise InputError(
                f"{path}: it requires {listed}, which is not read and may change its geometry."
            )
        asset = tree.get("asset")
        up = str(asset.get("gltfUpAxis", "Y") if isinstance(asset, dict) else "Y").upper()
        if up not in ("Y", "Z"):
            raise InputError(f"{path}: its gltfUpAxis is {shown(up)}; Y and Z are read.")
        return tree["root"], Document(path, above, up == "Y", depth)

    def _visit(self, pending: _Pending) -> list[_Pending]:
        """List one tile, and return the tiles below it."""
        tree, document = pending.tree, pending.document
        volume = tree.get("boundingVolume", {})
        self.has_region |= "region" in volume
        refine = str(tree.get("refine", pending.refine)).upper()
        if refine not in ("ADD", "REPLACE"):
            raise InputError(
                f"{document.path}: a tile is refined by {shown(refine)}; ADD and REPLACE are read."
            )
        world = pending.root_from_parent
        if "transform" in tree:
            world = composed(world, _matrix(tree["transform"], document.path))
        uris = list(_uris(tree))
        tiling = tiling_of(tree, document.path)
        if tiling is not None:
            if tree.get("children"):
                raise InputError(
                    f"{document.path}: a tile is divided implicitly and has children, too; it may "
                    "have one of them."
                )
            self._add_implicit(tiling, uris, pending.parent, refine, world, document)
            return []
        paths = [self.files.locate(uri, document.path) for uri in uris]
        tilesets = [path for path in paths if self._is_tileset(path)]
        contents = tuple(path for path in paths if path not in tilesets)
        index = self._add(Tile(pending.parent, refine == "REPLACE", world, contents, document))
        below = []
        for path in tilesets:
            root, inner = self._open(path, document, document.path)
            below.append(_Pending(root, index, world, refine, inner))
        for child in tree.get("children") or []:
            below.append(_Pending(child, index, world, refine, document))
        return below

    def _is_tileset(self, path: Path) -> bool:
        """Return whether a content is another tileset."""
        return path.suffix.lower() == ".json"

    def _add(self, tile: Tile) -> int:
        """List a tile and return its place."""
        if len(self.tiles) >= _MOST_TILES:
            raise InputError(
                f"{tile.document.path}: more than {_MOST_TILES} tiles; name a part of the tileset."
            )
        self.tiles.append(tile)
        return len(self.tiles) - 1

    def _add_implicit(
        self,
        tiling: Tiling,
        templates: list[object],
        parent: int,
        refine: str,
        world: F64,
        document: Document,
    ) -> None:
        """List the tiles of a tile that is divided implicitly; each of them is placed like it."""
        texts = list(map(str, templates))
        listed: dict[tuple[int, tuple[int, ...]], int] = {}
        for tile in implicit_tiles(tiling, len(texts), self.files, document.path, self.bit_count):
            uris = [tile.fill(texts[i]) for i in tile.contents]
            paths = tuple(self.files.locate(uri, document.path) for uri in uris)
            if any(map(self._is_tileset, paths)):
                raise InputError(
                    f"{document.path}: implicit tiles that are tilesets ({shown(uris[0])}) are "
                    "not read."
                )
            above = listed.get(tile.parent, parent)
            listed[tile.level, tile.coordinates] = self._add(
                Tile(above, refine == "REPLACE", world, paths, document)
            )


def _uris(tree: dict[str, Any]) -> Iterable[object]:
    """Yield the URIs of a tile's contents, as any version writes them."""
    older = tree.get("extensions", {}).get("3DTILES_multiple_contents", {})
    several = tree.get("contents") or older.get("contents") or older.get("content") or []
    for content in [*([tree["content"]] if tree.get("content") else []), *several]:
        yield content["uri"] if "uri" in content else content["url"]


def _matrix(numbers: object, path: Path) -> F64:
    """Return a tile's transform, ``(4, 4)``: its 16 numbers run down the columns."""
    matrix = np.array(numbers, np.float64)
    if matrix.shape != (16,):
        raise InputError(
            f"{path}: the transform of a tile has {count_of(matrix.size, 'number')}, not 16."
        )
    matrix = matrix.reshape(4, 4).T
    if not np.isfinite(matrix).all() or (matrix[3] != (0, 0, 0, 1)).any():
        raise InputError(
            f"{path}: the transform of a tile is not finite, or not affine (its last row is "
            f"{shown(matrix[3].tolist())}, not 0, 0, 0, 1)."
        )
    return np.ascontiguousarray(matrix)
