"""A silhouette as lines that other programs read: .ply, .obj, .npz.

Lines are in source coordinates and run as the side of the shadow volume starts
(FORMAT.md, "Sides"), so that the lit face lies on a known side of each:

    m > 0    v1 -> v0          m < 0    v0 -> v1

    .ply    binary: every line with its multiplicity and its object
    .obj    text: the lines of each object under its name; a side that is needed
            twice is one line
    .npz    NumPy arrays: the fields of `Lines`
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from svprep.model import F64, I8, I64, U32, Prepared
from svprep.output_file import OutputKind, suffix_of, write_whole
from svprep.silhouette.result import Silhouette

if TYPE_CHECKING:
    from svprep.cache.reader import Cache


_TITLE = "svprep silhouette 1"
_HEADS = (
    f"ply\nformat binary_little_endian 1.0\ncomment {_TITLE}\n".encode(),
    f"# {_TITLE}\n".encode(),
)
_FIRST_IN_ZIP: Final = b"svprep_silhouette.npy"
"""The first array of an .npz, the version of its layout, by its name in the archive."""
_ZIP_NAME_AT: Final = 30
"""Bytes before a name in an archive."""


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """The lines of a silhouette and the vertices that they use, grouped by object."""

    edge: U32
    """``(n,)``: ids of edge records in the cache, ascending."""
    multiplicity: I8
    """``(n,)``: m of each record, -2 to 2, never 0: the side is needed ``|m|`` times.
    Its sign has gone into the order of `vertices` already."""
    vertices: U32
    """``(n, 2)``: where each line begins and ends, as rows of `positions`."""
    positions: F64
    """``(n_used, 3)`` [m], source coordinates, exact; each is used by a line."""
    object: U32
    """``(n,)``: index into `object_names`."""
    object_names: tuple[str, ...]
    """``(n_objects,)``: of the whole cache."""
    object_line_start: I64
    """``(n_objects + 1,)``: object i has the lines ``start[i]`` to ``start[i + 1] - 1``."""
    object_vertex_start: I64
    """``(n_objects + 1,)``: and the positions ``start[i]`` to ``start[i + 1] - 1``."""
    light: F64
    """``(4,)``: (x, y, z, w) in source coordinates, quantised as it was asked for."""
    method: str


def silhouette_lines(found: Silhouette, cache: Cache | Prepared) -> Lines:
    """Return the lines of a silhouette of `cache`. O(silhouette + vertices)."""
    mesh = cache.mesh
    n_objects = len(mesh.object_vertex_start) - 1
    rows = cache.edges.rows[found.edge]
    ends = np.where(found.multiplicity[:, None] > 0, rows[:, [1, 0]], rows[:, [0, 1]])
    is_used = np.zeros(len(mesh.positions), bool)
    is_used[ends] = True
    new_from_old = np.cumsum(is_used, dtype=np.uint32) - np.uint32(1)
    used = np.flatnonzero(is_used)
    count = np.zeros(n_objects, np.int64)
    count[found.objects] = np.diff(found.object_start)
    origin = mesh.grid.origin_m
    light = found.light.astype(np.float64)
    light[:3] += light[3] * origin
    return Lines(
        edge=found.edge,
        multiplicity=found.multiplicity,
        vertices=np.ascontiguousarray(new_from_old[ends]),
        positions=origin + mesh.positions[used],
        object=np.repeat(np.arange(n_objects, dtype=np.uint32), count),
        object_names=cache.object_names,
        object_line_start=np.concatenate(([0], np.cumsum(count))),
        object_vertex_start=np.searchsorted(used, mesh.object_vertex_start),
        light=light,
        method=found.method,
    )


def _is_ours(head: bytes) -> bool:
    """Whether a file begins as one that `write_lines` made."""
    return head.startswith(_HEADS) or (
        head.startswith(b"PK\x03\x04") and head[_ZIP_NAME_AT:].startswith(_FIRST_IN_ZIP)
    )


LINES: Final = OutputKind(
    name="the lines",
    form="lines are written as .ply, .obj or .npz",
    what="is not a silhouette of svprep",
    suffixes=(".ply", ".obj", ".npz"),
    is_ours=_is_ours,
)


def write_lines(lines: Lines, path: str | os.PathLike[str]) -> Path:
    """Write lines in the form that the suffix of `path` names; the same lines, the same bytes.

    The file is written beside its place and renamed: an older one stays whole
    until the new one is. Returns the file, links followed. About 2 us a line as
    text (.obj), 0.1 us otherwise.

    Raises
    ------
    InputError, EnvironmentProblem
        As `OutputKind.checked_path`, or the disk is full.
    """
    target = LINES.checked_path(path)
    write_whole(target, {".ply": _ply, ".obj": _obj, ".npz": _npz}[suffix_of(path)](lines))
    return target


def _light_text(light: F64) -> str:
    x, y, z, w = light.tolist()
    kind = "a point" if w else "the direction towards it"
    return f"light {x!r} {y!r} {z!r} ({kind})"


def _ply(lines: Lines) -> Iterator[bytes]:
    """Yield a binary PLY file; its lines are ``edge`` elements."""
    edges = np.empty(
        len(lines.edge), [("vertices", "<i4", 2), ("multiplicity", "i1"), ("object", "<u4")]
    )
    edges["vertices"] = lines.vertices
    edges["multiplicity"] = lines.multiplicity
    edges["object"] = lines.object
    header = (
        f"comment {_light_text(lines.light)}",
        "comment vertex1 to vertex2: as the side of the shadow volume starts",
        "comment multiplicity: the side is needed |m| times",
        f"element vertex {len(lines.positions)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element edge {len(edges)}",
        "property int vertex1",
        "property int vertex2",
        "property char multiplicity",
        "property uint object",
        "end_header",
    )
    yield _HEADS[0] + "".join(f"{line}\n" for line in header).encode()
    yield lines.positions.astype("<f8", copy=False).tobytes()
    yield edges.tobytes()


def _obj(lines: Lines) -> Iterator[bytes]:
    """Yield an OBJ file: for each object its name, its vertices, its lines."""
    yield _HEADS[1]
    yield f"# {_light_text(lines.light)}\n".encode()
    yield b"# a line runs as the side of the shadow volume starts\n"
    # A coordinate occurs many times in a city: walls are upright, roofs level.
    numbers, which = np.unique(lines.positions, return_inverse=True)
    text = np.array([repr(x) for x in numbers.tolist()], object)[which].reshape(-1, 3)
    ends = lines.vertices.astype(np.int64) + 1
    vertex_start, line_start = lines.object_vertex_start, lines.object_line_start
    for i in np.flatnonzero(np.diff(line_start)).tolist():
        corners = text[vertex_start[i] : vertex_start[i + 1]]
        here = ends[line_start[i] : line_start[i + 1]]
        yield b"o " + _obj_name(lines.object_names[i], i) + b"\n"
        yield ("v %s %s %s\n" * len(corners) % tuple(corners.ravel().tolist())).encode()
        yield ("l %d %d\n" * len(here) % tuple(here.ravel().tolist())).encode()


def _obj_name(name: str, index: int) -> bytes:
    """Return a name that stays one OBJ statement, its bytes as the source had them."""
    kept = "".join(
        c if c.isprintable() or "\udc80" <= c <= "\udcff" or c.isspace() else "_" for c in name
    )
    # A backslash at the end of a line would join the next one to it.
    kept = " ".join(kept.split()).rstrip("\\ ") or f"object_{index}"
    return kept.encode("utf-8", "surrogateescape")


def _npz(lines: Lines) -> Iterator[bytes]:
    """Yield a NumPy archive: arrays by the names of the fields, and the layout's version."""
    archive = io.BytesIO()
    np.savez(
        archive,
        svprep_silhouette=np.array(1),
        edge=lines.edge,
        multiplicity=lines.multiplicity,
        vertices=lines.vertices,
        positions=lines.positions,
        object=lines.object,
        object_names=np.array(lines.object_names, np.str_),
        light=lines.light,
        method=np.array(lines.method),
    )
    yield archive.getvalue()
