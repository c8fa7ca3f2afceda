"""Readers: model files in, one `svprep.model.SourceMesh` out.

A format is a module with a function that returns a `ParsedFile`, and an entry in
`_SUFFIXES`, the only place that knows which formats there are.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from svprep.errors import InputError
from svprep.ingest.crs_given import with_crs_given
from svprep.ingest.doubts import on_distance, on_lonely_tile
from svprep.ingest.file_bytes import Text, check_file, read_file
from svprep.ingest.filters import filtered
from svprep.ingest.inputs import TILESET, expanded, is_tileset, suffix_of_model
from svprep.ingest.notes import merged_notes
from svprep.ingest.options import HIGHEST, ReadOptions
from svprep.ingest.parsed import (
    ParsedFile,
    Report,
    all_encodable,
    bytes_of_tables,
    encodable,
    in_files,
)
from svprep.ingest.spill import Array, Spill, empty_table, release, row_blocks
from svprep.ingest.surface_names import SurfaceNames
from svprep.model import U8, U32, FaceFindings, Place, SourceFile, SourceMesh
from svprep.path_names import told_apart

Progress = Callable[[int, int], None]
"""Told the bytes that are read and the bytes of all input files."""

_Reader = Callable[[U8, Path, str, Report, ReadOptions], ParsedFile]


def _read_obj(
    path: Path, stem: str, pool: Executor, report: Report, spill: Spill | None
) -> tuple[ParsedFile, str]:
    """Read an OBJ file, which alone is never held whole; return its digest, too.

    The digest is computed first and meanwhile: what parses is imported and loaded then.
    """
    text = Text.of(path)
    digest = pool.submit(text.sha256)
    from svprep.ingest.obj import read_obj

    return read_obj(text, stem, pool, report, spill), digest.result()


def _read_ply(data: U8, path: Path, stem: str, report: Report, options: ReadOptions) -> ParsedFile:
    from svprep.ingest.trimesh_formats import read_ply

    return read_ply(data, path, stem)


def _read_stl(data: U8, path: Path, stem: str, report: Report, options: ReadOptions) -> ParsedFile:
    from svprep.ingest.trimesh_formats import read_stl

    return read_stl(data, path, stem)


def _read_off(data: U8, path: Path, stem: str, report: Report, options: ReadOptions) -> ParsedFile:
    from svprep.ingest.off import read_off

    return read_off(data, path, stem)


def _read_gltf(data: U8, path: Path, stem: str, report: Report, options: ReadOptions) -> ParsedFile:
    from svprep.ingest.gltf import read_gltf

    return read_gltf(data, path, stem)


def _read_cityjson(
    data: U8, path: Path, stem: str, report: Report, options: ReadOptions
) -> ParsedFile:
    from svprep.ingest.cityjson import read_cityjson

    return read_cityjson(data, path, stem, report, options)


def _read_citygml(
    data: U8, path: Path, stem: str, report: Report, options: ReadOptions
) -> ParsedFile:
    from svprep.ingest.citygml import read_citygml

    return read_citygml(data, path, stem, report, options)


def _read_b3dm(data: U8, path: Path, stem: str, report: Report, options: ReadOptions) -> ParsedFile:
    from svprep.ingest.b3dm import read_b3dm

    return read_b3dm(data, path, stem)


def _read_tileset(
    data: U8, path: Path, stem: str, report: Report, options: ReadOptions
) -> ParsedFile:
    from svprep.ingest.tileset import read_tileset

    return read_tileset(path, report, options)


_SUFFIXES: dict[str, tuple[str, _Reader | None]] = {
    ".obj": ("obj", None),  # see `_read_obj`
    ".ply": ("ply", _read_ply),
    ".stl": ("stl", _read_stl),
    ".off": ("off", _read_off),
    ".glb": ("glb", _read_gltf),
    ".gltf": ("gltf", _read_gltf),
    ".b3dm": ("b3dm", _read_b3dm),
    ".json": ("cityjson", _read_cityjson),
    ".jsonl": ("cityjsonseq", _read_cityjson),
    ".gml": ("citygml", _read_citygml),
    ".xml": ("citygml", _read_citygml),
}
_TILES = ("3dtiles", _read_tileset)
_HAVE_LODS = ("cityjson", "cityjsonseq", "citygml")
_NOT_YET = {
    ".poly": "TetGen polyhedra",
}
_MOST_FACES = 715_000_000  # three times as many stay below 2**31


def read(
    paths: Sequence[str | Path],
    progress: Progress | None = None,
    options: ReadOptions | None = None,
    spill: Spill | None = None,
) -> SourceMesh:
    """Read model files into one mesh of triangles, grouped by object.

    Parameters
    ----------
    paths
        Files, folders and patterns: see `svprep.ingest.inputs`. The format of a file follows
        from its suffix, ``.gz`` behind it means gzip. The objects of all files are listed one
        file after the other; equal names in different files are different objects.
    progress
        Called now and then, from this thread.
    options
        What of the files is wanted.
    spill
        If given, `positions`, `faces`, `source_face` and `surface_of_polygon` become mapped
        files (`svprep.ingest.spill`). OBJ is then held in memory block by block, other
        formats one file at a time: its bytes, what its reader makes of them, and its tables.
        So are the tables of a file of which options leave something out, or whose
        positions are converted. A file that takes more than `Spill.memory_bytes` is read
        all the same, and remarked on. Names, types and findings stay in memory.

    Raises
    ------
    InputError
        One line: which file (and line), what is wrong, what to do.
    EnvironmentProblem
        The folder of `spill` has no room.
    """
    options = options or ReadOptions()
    if not paths:
        raise InputError("No input file was given; name at least one model file.")
    inputs = expanded(paths)
    files = [_file_of(path) for path in inputs.paths]
    formats = [_format_of(path) for path in files]
    _refuse_repeated(files, inputs.paths, [reader is _read_tileset for _, reader in formats])
    sizes = [check_file(path) for path in files]
    parsed, digests = [], []
    with ThreadPoolExecutor(_n_threads()) as pool:
        for i, (path, (_, reader)) in enumerate(zip(files, formats, strict=True)):

            def report(fraction: float, i: int = i) -> None:
                if progress is not None:
                    progress(sum(sizes[:i]) + int(fraction * sizes[i]), sum(sizes))

            one, digest = _read_file(path, reader, pool, report, options, spill)
            report(1.0)
            parsed.append(one)
            digests.append(digest)
    sources = [
        SourceFile(name, format_name, size, digest, p.crs)
        for name, (format_name, _), size, digest, p in zip(
            inputs.paths, formats, sizes, digests, parsed, strict=True
        )
    ]
    parsed = [_noted(p, source, options) for p, source in zip(parsed, sources, strict=True)]
    keep = partial(in_files, spill=spill)
    parsed, place = _in_one_frame(filtered(parsed, files, options, keep), files, keep)
    notes = (*inputs.notes, *on_distance(parsed, told_apart(inputs.paths)))
    return replace(_concatenate(parsed, sources, notes, spill), place=place)


def _read_file(
    path: Path,
    reader: _Reader | None,
    pool: Executor,
    report: Report,
    options: ReadOptions,
    spill: Spill | None,
) -> tuple[ParsedFile, str]:
    """Return a file, and its digest."""
    if reader is None:
        return _read_obj(path, _stem(path), pool, report, spill)
    data, sha256 = read_file(path, pool)
    parsed = reader(data, path, _stem(path), report, options)
    digest = sha256(parsed.beside)
    if spill is not None:
        n_bytes = data.nbytes + bytes_of_tables(parsed)
        if n_bytes > spill.memory_bytes:
            spill.remarks.append(
                f"{path} was read whole, which takes {-(-n_bytes >> 20)} MiB of memory at the "
                f"least, more than the {spill.memory_bytes >> 20} MiB that were allowed"
            )
    return in_files(parsed, spill), digest


def _in_one_frame(
    parsed: list[ParsedFile], files: list[Path], keep: Callable[[ParsedFile], ParsedFile]
) -> tuple[list[ParsedFile], Place]:
    """Bring all files into one frame in metres, if any states a CRS."""
    if not any(p.crs for p in parsed):
        return parsed, Place()
    from svprep.ingest.georeference import in_one_frame

    return in_one_frame(parsed, files, keep)


def _noted(parsed: ParsedFile, source: SourceFile, options: ReadOptions) -> ParsedFile:
    """Return a file with the CRS that counts; say where options or its place have no meaning."""
    notes = list(on_lonely_tile(Path(source.path), source.format))
    if options.lod != HIGHEST and source.format not in _HAVE_LODS:
        format_name, lod = source.format, options.lod
        notes.append(
            f"this format ({format_name}) states no levels of detail, so --lod {lod} is ignored"
        )
    return with_crs_given(replace(parsed, notes=(*parsed.notes, *notes)), options.crs)


def _n_threads() -> int:
    """Return how many threads parse: the result does not depend on it."""
    if hasattr(os, "sched_getaffinity"):
        return min(8, len(os.sched_getaffinity(0)))
    return min(8, os.cpu_count() or 1)


def _stem(path: Path) -> str:
    """Return the file's name without the suffix of its format and ``.gz``."""
    name = path.name[: -len(".gz")] if path.name.lower().endswith(".gz") else path.name
    return encodable(Path(name).stem)


def _file_of(path: str) -> Path:
    """Return the file that stands for an input: of a folder, its tileset."""
    return Path(path, TILESET) if os.path.isdir(path) else Path(path)


def _format_of(path: Path) -> tuple[str, _Reader | None]:
    """Return the format's name and reader."""
    suffix = suffix_of_model(path)
    if suffix == ".json" and is_tileset(path):
        return _TILES
    if suffix in _SUFFIXES:
        return _SUFFIXES[suffix]
    known = ", ".join(_SUFFIXES)
    if suffix in _NOT_YET:
        problem = f"{_NOT_YET[suffix]} ({suffix}) is not read yet"
    elif suffix:
        problem = f'no reader for the suffix "{suffix}"'
    elif not os.path.lexists(path):
        raise InputError(f"{path}: there is no such file.")
    else:
        problem = "no suffix, so the format is unknown"
    raise InputError(f"{path}: {problem}. Known: {known}, each also with .gz behind it.")


def _refuse_repeated(files: list[Path], names: Sequence[str], is_tileset: list[bool]) -> None:
    """Raise `InputError` for what is named twice: each of its faces would be doubled."""
    seen: set[Path] = set()
    resolved = [path.resolve() for path in files]
    folders = {
        path.parent: name
        for path, name, is_one in zip(resolved, names, is_tileset, strict=True)
        if is_one
    }
    for path, name, is_one in zip(resolved, names, is_tileset, strict=True):
        if path in seen:
            raise InputError(f"{name} is named twice; name each file once.")
        seen.add(path)
        above = path.parents[1:] if is_one else path.parents
        for folder in folders.keys() & set(above):
            raise InputError(
                f"{name} lies in the folder of the tileset {folders[folder]}, which is read "
                "whole; name one of the two."
            )


def _concatenate(
    parsed: list[ParsedFile],
    sources: list[SourceFile],
    notes: Sequence[str] = (),
    spill: Spill | None = None,
) -> SourceMesh:
    """Put the files one behind the other."""
    n_vertices = np.array([len(p.positions) for p in parsed])
    n_objects = [len(p.object_names) for p in parsed]
    if n_vertices.sum() >= 1 << 32:
        raise InputError(
            f"{n_vertices.sum()} vertices in all input files; one build takes 2**32 - 1. "
            "Build the files one by one."
        )
    n_faces = sum(len(p.faces) for p in parsed)
    if n_faces > _MOST_FACES:
        raise InputError(
            f"{n_faces} triangles in all input files; one build takes {_MOST_FACES}. "
            "Build the files one by one, or split them."
        )
    first_vertex = (np.cumsum(n_vertices) - n_vertices).astype(np.uint32)
    first_object = (np.cumsum(n_objects) - n_objects).astype(np.uint32)
    face_counts = np.concatenate([np.diff(p.object_face_start) for p in parsed])
    findings = [p.face_findings for p in parsed]
    surface_names, tables = _joined_names(parsed)
    return SourceMesh(
        positions=_joined([p.positions for p in parsed], spill),
        faces=_joined(
            [p.faces for p in parsed],
            spill,
            [first.__add__ for first in first_vertex] if len(parsed) > 1 else (),
        ),
        object_face_start=np.concatenate([[0], np.cumsum(face_counts)]).astype(np.int64),
        source_face=_joined([p.source_face for p in parsed], spill),
        object_names=all_encodable(chain.from_iterable(p.object_names for p in parsed)),
        object_source=np.repeat(np.arange(len(parsed), dtype=np.uint32), n_objects),
        sources=tuple(sources),
        face_findings=_by_object(findings, first_object),
        notes=(
            *map(encodable, notes),
            *merged_notes(
                (name, note)
                for p, name in zip(parsed, told_apart([s.path for s in sources]), strict=True)
                for note in p.notes
            ),
        ),
        object_types=_stated([p.object_types for p in parsed], n_objects),
        object_parents=_stated([p.object_parents for p in parsed], n_objects),
        surface_names=surface_names,
        surface_of_polygon=_joined(
            [p.surface_of_polygon for p in parsed], spill, [table.take for table in tables]
        ),
        polygon_start=np.cumsum([0, *(len(p.surface_of_polygon) for p in parsed)], dtype=np.int64),
    )


def _by_object(findings: list[FaceFindings], first_object: U32) -> FaceFindings:
    """Return what the readers found, one object after the other."""
    owner = _joined([f.object_index + k for f, k in zip(findings, first_object, strict=True)])
    order = np.argsort(owner, kind="stable")
    return FaceFindings(
        code=_joined([f.code for f in findings])[order],
        object_index=owner[order],
        source_face=_joined([f.source_face for f in findings])[order],
    )


def _stated(texts: list[tuple[str, ...]], n_objects: list[int]) -> tuple[str, ...]:
    """Return a text per object, "" for those of files that state none."""
    filled = (t or ("",) * n for t, n in zip(texts, n_objects, strict=True))
    return all_encodable(chain.from_iterable(filled))


def _joined_names(parsed: list[ParsedFile]) -> tuple[tuple[str, ...], list[U8]]:
    """Return the names of surfaces of all files, and per file where its own stand there."""
    names = SurfaceNames()
    tables = [
        np.array([names.number_of(encodable(name)) for name in p.surface_names], np.uint8)
        for p in parsed
    ]
    return names.names(), tables


def _joined(
    arrays: Sequence[Array],
    spill: Spill | None = None,
    changes: Sequence[Callable[[Array], Array]] = (),
) -> Array:
    """Concatenate, each array changed in its own way; without a copy of a single unchanged one."""
    if len(arrays) == 1 and not changes:
        return np.ascontiguousarray(arrays[0])
    n = sum(len(array) for array in arrays)
    whole = empty_table(arrays[0].dtype, (n, *arrays[0].shape[1:]), spill)
    begin = 0
    for i, array in enumerate(arrays):
        for (block,) in row_blocks(array):
            end = begin + len(block)
            whole[begin:end] = changes[i](block) if changes else block
            release(whole[begin:end])
            begin = end
    return whole
