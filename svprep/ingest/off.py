"""The reader of OFF, Geomview's ASCII polygon format.

``OFF``, ``COFF``, ``NOFF``, ``STOFF`` and their combinations: the first three numbers of a
vertex line are its position. Colours, normals and texture coordinates are ignored.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from svprep.errors import InputError
from svprep.ingest.parsed import ParsedFile, polygons_as_object, refuse_non_finite, shown
from svprep.model import U8

_HEADER = re.compile(rb"(ST)?C?N?OFF")


def read_off(data: U8, path: Path, stem: str) -> ParsedFile:
    """Read an OFF file; each line of text is one vertex or polygon.

    Raises
    ------
    InputError
        With the line at fault.
    """
    text = data.tobytes()
    if b"\0" in text[:4096]:
        raise InputError(f"{path}: this is a binary file; ASCII OFF is read.")
    lines = [
        (number, tokens)
        for number, line in enumerate(text.splitlines(), 1)
        if (tokens := line.partition(b"#")[0].split())
    ]
    if lines and _HEADER.fullmatch(lines[0][1][0]):
        number, tokens = lines[0]
        lines[0] = (number, tokens[1:])
        lines = lines if tokens[1:] else lines[1:]
    elif lines and not lines[0][1][0].isdigit():
        raise InputError(f'{path}, line {lines[0][0]}: not an OFF file: it begins with no "OFF".')
    if not lines:
        raise InputError(f"{path}: no counts of vertices and faces in this OFF file.")
    line = lines[0][0]
    try:
        n_vertices, n_faces = (int(token) for token in lines[0][1][:2])
        if n_vertices < 0 or n_faces < 0:
            raise ValueError
        if len(lines) < 1 + n_vertices + n_faces:
            raise InputError(
                f"{path}: cut off: {n_vertices} vertices and {n_faces} faces announced, "
                f"{len(lines) - 1} lines found."
            )
        if len(lines) > 1 + n_vertices + n_faces:
            raise InputError(
                f"{path}, line {lines[1 + n_vertices + n_faces][0]}: more lines than the "
                f"{n_vertices} vertices and {n_faces} faces announced; correct the counts."
            )
        positions = np.empty((n_vertices, 3))
        for row in range(n_vertices):
            line, tokens = lines[1 + row]
            positions[row] = [float(token) for token in tokens[:3]]
            if any(b"_" in token for token in tokens):  # Python reads "1_0" as 10
                raise ValueError
        corners: list[int] = []
        start = [0]
        for line, tokens in lines[1 + n_vertices : 1 + n_vertices + n_faces]:
            size = int(tokens[0])
            ring = [int(token) for token in tokens[1 : 1 + size]]
            if size < 0 or len(ring) != size or any(b"_" in token for token in tokens):
                raise ValueError
            if ring and (min(ring) < 0 or max(ring) >= n_vertices):
                bad = min(ring) if min(ring) < 0 else max(ring)
                raise InputError(
                    f"{path}, line {line}: face refers to vertex {bad}; OFF counts from 0 to "
                    f"{n_vertices - 1} here."
                )
            corners += ring
            start.append(len(corners))
    except ValueError:
        found = next(b" ".join(tokens) for number, tokens in lines if number == line)
        raise InputError(
            f'{path}, line {line}: "{found[:60].decode("latin-1")}" cannot be read as OFF counts, '
            "position or face."
        ) from None
    refuse_non_finite(positions, path, f'object "{shown(stem)}"')
    return polygons_as_object(
        positions, np.array(corners, np.uint32), np.array(start, np.int64), path, stem
    )
