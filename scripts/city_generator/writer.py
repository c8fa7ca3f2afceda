"""Wavefront OBJ, written object by object as exporters write it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from city_generator.mesh import F64, PolyMesh

I64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Style:
    """How one object is written."""

    decimals: int
    """Of its vertices, 3 to 6."""
    with_uv: bool
    with_normals: bool
    relative: bool
    """Negative indices, counted back from the last line."""

    @property
    def label(self) -> str:
        """The form of a corner: ``"v/vt/vn"``, ``"v//vn"``, ``"v/vt"``, ``"v"`` or ``"-v"``."""
        sign = "-" if self.relative else ""
        normal = "vn" if self.with_normals else ""
        middle = ("/vt" if self.with_uv else "/") + (f"/{normal}" if normal else "")
        return sign + "v" + (middle if self.with_uv or normal else "")


class ObjWriter:
    """Writes objects one after another; holds no more than the one at hand."""

    def __init__(self, stream: TextIO, origin_m: tuple[float, float, float]) -> None:
        self._stream = stream
        self._origin_m = np.array(origin_m, dtype=np.float64)
        self._written = np.zeros(3, dtype=np.int64)  # v, vt, vn lines so far

    def comment(self, text: str) -> None:
        """Write one comment line."""
        self._stream.write(f"# {text}\n")

    def write(self, name: str, mesh: PolyMesh, style: Style) -> None:
        """Write one object; `mesh` is in city coordinates, before the origin is added."""
        sizes = np.array([len(p) for p in mesh.polygons], dtype=np.int64)
        corners = np.fromiter(chain.from_iterable(mesh.polygons), np.int64, int(sizes.sum()))
        normals = _polygon_normals(mesh.vertices, corners, sizes)
        place = mesh.vertices + self._origin_m
        parts = [f"o {name}\n", _lines("v", place, style.decimals)]
        columns = [corners]
        counts = [len(place), 0, 0]
        if style.with_uv:
            places = max(style.decimals, 4)
            uv = _box_mapped(mesh.vertices[corners], np.repeat(normals, sizes, axis=0))
            table, index = np.unique(uv.round(places), axis=0, return_inverse=True)
            parts.append(_lines("vt", table, places))
            columns.append(index.reshape(-1))
            counts[1] = len(table)
        if style.with_normals:
            table, index = np.unique(normals.round(4), axis=0, return_inverse=True)
            parts.append(_lines("vn", table, 4))
            columns.append(np.repeat(index.reshape(-1), sizes))
            counts[2] = len(table)
        parts.append("s 0\n")
        used = [True, style.with_uv, style.with_normals]
        base = -np.array(counts) if style.relative else self._written + 1
        indices = np.column_stack(columns) + base[used]
        parts.append(_faces(indices, sizes, style))
        self._written += counts
        self._stream.write("".join(parts))


def _lines(key: str, table: F64, decimals: int) -> str:
    """Return one line per row of `table`."""
    line: str = key + f" %.{decimals}f" * table.shape[1] + "\n"
    return line * len(table) % tuple(table.ravel().tolist())


def _faces(indices: I64, sizes: I64, style: Style) -> str:
    """Return the ``f`` lines of corners ``(n, 1 to 3)`` in polygons of `sizes` corners."""
    slash = "//" if style.with_normals and not style.with_uv else "/"
    corner = " " + slash.join(["%d"] * indices.shape[1])
    lines: Iterable[str] = ("f" + corner * size + "\n" for size in sizes.tolist())
    return "".join(lines) % tuple(indices.ravel().tolist())


def _polygon_normals(vertices: F64, corners: I64, sizes: I64) -> F64:
    """Return unit normals ``(n_polygons, 3)`` by Newell's sum; +z where there is none."""
    first = np.cumsum(sizes) - sizes
    follow = np.arange(len(corners)) + 1
    follow[first + sizes - 1] = first
    at = vertices[corners]
    around = at - np.repeat(at[first], sizes, axis=0)
    twice = np.add.reduceat(np.cross(around, around[follow]), first, axis=0)
    length = np.sqrt((twice**2).sum(axis=1))
    flat = length < 1e-12
    normals: F64 = twice / np.where(flat, 1.0, length)[:, None]
    normals[flat] = [0.0, 0.0, 1.0]
    return normals


def _box_mapped(at_m: F64, normals: F64) -> F64:
    """Return texture coordinates: one texture per 4 m, from the side a face looks to most."""
    axis = np.abs(normals).argmax(axis=1)
    u = np.where(axis == 0, at_m[:, 1], at_m[:, 0])
    v = np.where(axis == 2, at_m[:, 1], at_m[:, 2])
    return np.column_stack([u, v]) / 4.0
