"""Readers: model files in, one `svprep.model.SourceMesh` out.

A format is a module with a function that returns a `ParsedFile`, and an entry in
`_SUFFIXES`, the only place that knows which formats there are.
"""

from __future__ import annotations

import gzip
import json
import os
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from svprep.errors import InputError
from svprep.ingest.file_bytes import check_file, read_file
from svprep.ingest.parsed import ParsedFile, Report, encodable
from svprep.model import U8, FaceFindings, SourceFile, SourceMesh

Progress = Callable[[int, int], None]
"""Told the bytes that are read and the bytes of all input files."""

_Reader = Callable[[U8, Path, str, Executor, Report], ParsedFile]


def _read_obj(data: U8, path: Path, stem: str, pool: Executor, report: Report) -> ParsedFile:
    from svprep.ingest.obj import read_obj

    return read_obj(data, path, stem, pool, report)


def _read_ply(data: U8, path: Path, stem: str, pool: Executor, report: Report) -> ParsedFile:
    from svprep.ingest.trimesh_formats import read_ply

    return read_ply(data, path, stem)


def _read_stl(data: U8, path: Path, stem: str, pool: Executor, report: Report) -> ParsedFile:
    from svprep.ingest.trimesh_formats import read_stl

    return read_stl(data, path, stem)


def _read_off(data: U8, path: Path, stem: str, pool: Executor, report: Report) -> ParsedFile:
    from svprep.ingest.off import read_off

    return read_off(data, path, stem)


def _read_gltf(data: U8, path: Path, stem: str, pool: Executor, report: Report) -> ParsedFile:
    from svprep.ingest.gltf import read_gltf

    return read_gltf(data, path, stem)


_SUFFIXES: dict[str, tuple[str, _Reader]] = {
    ".obj": ("obj", _read_obj),
    ".ply": ("ply", _read_ply),
    ".stl": ("stl", _read_stl),
    ".off": ("off", _read_off),
    ".glb": ("glb", _read_gltf),
    ".gltf": ("gltf", _read_gltf),
}
_NOT_YET = {
    ".json": "CityJSON",
    ".gml": "CityGML",
    ".xml": "CityGML",
    ".poly": "TetGen polyhedra",
}
_TILESET_KEYS = ("root", "geometricError")
_MOST_FACES = 715_000_000  # three times as many stay below 2**31
_TILESET_BYTES = 64 << 20  # larger files are not looked into: a tileset names files


def read(paths: Sequence[str | Path], progress: Progress | None = None) -> SourceMesh:
    """Read model files into one mesh of triangles, grouped by object.

    Parameters
    ----------
    paths
        One or more files; their format follows from the suffix, ``.gz`` behind it means
        gzip. The objects of all files are listed one file after the other; equal names in
        different files are different objects.
    progress
        Called now and then, from this thread.

    Raises
    ------
    InputError
        One line: which file (and line), what is wrong, what to do.
    """
    files = [Path(path) for path in paths]
    if not files:
        raise InputError("No input file was given; name at least one model file.")
    formats = [_format_of(path) for path in files]
    sizes = [check_file(path) for path in files]
    _refuse_repeated(files)
    parsed, sources = [], []
    with ThreadPoolExecutor(_n_threads()) as pool:
        for i, (path, (format_name, reader)) in enumerate(zip(files, formats, strict=True)):

            def report(fraction: float, i: int = i) -> None:
                if progress is not None:
                    progress(sum(sizes[:i]) + int(fraction * sizes[i]), sum(sizes))

            data, sha256 = read_file(path, pool)
            parsed.append(reader(data, path, _stem(path), pool, report))
            report(1.0)
            name = str(paths[i])
            sources.append(SourceFile(name, format_name, sizes[i], sha256(parsed[i].beside)))
    return _concatenate(parsed, sources)


def _n_threads() -> int:
    """Return how many threads parse: the result does not depend on it."""
    if hasattr(os, "sched_getaffinity"):
        return min(8, len(os.sched_getaffinity(0)))
    return min(8, os.cpu_count() or 1)


def _suffix(path: Path) -> str:
    """Return the suffix that names the format, without a ``.gz`` behind it."""
    name = path.name.lower()
    return Path(name.removesuffix(".gz")).suffix


def _stem(path: Path) -> str:
    """Return the file's name without the suffixes that `_suffix` looks at."""
    name = path.name[: -len(".gz")] if path.name.lower().endswith(".gz") else path.name
    return encodable(Path(name).stem)


def _format_of(path: Path) -> tuple[str, _Reader]:
    """Return the format's name and reader."""
    suffix = _suffix(path)
    if suffix in _SUFFIXES:
        return _SUFFIXES[suffix]
    if path.is_dir():
        raise InputError(f"{path}: this is a folder; name the model files in it.")
    if suffix == ".json" and _is_tileset(path):
        raise InputError(
            f"{path}: a 3D Tiles tileset is not read yet; name its .glb files. Its transform is "
            "not applied to them."
        )
    known = ", ".join(_SUFFIXES)
    if suffix in _NOT_YET:
        problem = f"{_NOT_YET[suffix]} ({suffix}) is not read yet"
    elif suffix:
        problem = f'no reader for the suffix "{suffix}"'
    else:
        problem = "no suffix, so the format is unknown"
    raise InputError(f"{path}: {problem}. Known: {known}, each also with .gz behind it.")


def _is_tileset(path: Path) -> bool:
    """Return whether a JSON file is a 3D Tiles tileset; what cannot be read is none."""
    if path.name.lower().removesuffix(".gz") == "tileset.json":
        return True
    if not path.is_file():
        return False
    is_packed = path.name.lower().endswith(".gz")
    try:
        with gzip.open(path) if is_packed else path.open("rb") as file:
            text = file.read(_TILESET_BYTES)
        if b'"asset"' not in text:
            return False
        root = json.loads(text)
    except (OSError, EOFError, zlib.error, ValueError, RecursionError):
        return False
    return isinstance(root, dict) and "asset" in root and not root.keys().isdisjoint(_TILESET_KEYS)


def _refuse_repeated(files: list[Path]) -> None:
    """Raise `InputError` for a file that is named twice: each of its faces would be doubled."""
    seen: set[Path] = set()
    for path in files:
        resolved = path.resolve()
        if resolved in seen:
            raise InputError(f"{path} is named twice; name each file once.")
        seen.add(resolved)


def _concatenate(parsed: list[ParsedFile], sources: list[SourceFile]) -> SourceMesh:
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
    return SourceMesh(
        positions=_joined([p.positions for p in parsed]),
        faces=_joined(
            [p.faces + v if v else p.faces for p, v in zip(parsed, first_vertex, strict=True)]
        ),
        object_face_start=np.concatenate([[0], np.cumsum(face_counts)]).astype(np.int64),
        source_face=_joined([p.source_face for p in parsed]),
        object_names=tuple(encodable(name) for p in parsed for name in p.object_names),
        object_source=np.repeat(np.arange(len(parsed), dtype=np.uint32), n_objects),
        sources=tuple(sources),
        face_findings=FaceFindings(
            code=_joined([f.code for f in findings]),
            object_index=_joined(
                [f.object_index + k for f, k in zip(findings, first_object, strict=True)]
            ),
            source_face=_joined([f.source_face for f in findings]),
        ),
        notes=tuple(
            encodable(f"{Path(source.path).name}: {note}")
            for p, source in zip(parsed, sources, strict=True)
            for note in p.notes
        ),
    )


def _joined(arrays: list[np.ndarray]) -> np.ndarray:
    """Concatenate, without a copy of a single array."""
    return np.ascontiguousarray(arrays[0]) if len(arrays) == 1 else np.concatenate(arrays)
