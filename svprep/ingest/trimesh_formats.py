"""PLY and STL, decoded by trimesh, save for binary PLY (`svprep.ingest.ply_binary`).

Only its decoders are used, not its meshes: nothing is merged, triangulated or dropped by
it. What they leave unchecked (indices, cut-off text, numbers that are none) is checked
here, and whatever they raise becomes one line.
"""

from __future__ import annotations

import io
import re
import struct
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from svprep.errors import InputError
from svprep.ingest import ply_binary
from svprep.ingest.own_header import OwnHeader, parse_header
from svprep.ingest.parsed import (
    ParsedFile,
    count_of,
    no_findings,
    polygons_as_object,
    refuse_non_finite,
    shown,
)
from svprep.model import F64, I64, U8

_RING_NAMES = ("vertex_indices", "vertex_index")
_INTEGER = re.compile(r"[+-]?[0-9]+(\.0*)?")
_STL_HEADER_BYTES, _STL_TRIANGLE_BYTES = 84, 50


def read_ply(data: U8, path: Path, stem: str) -> ParsedFile:
    """Read a PLY file, ASCII or binary: one object with all its polygons.

    A binary one that svprep exported gives its objects again, empty ones too.
    """
    text = data[:-1].tobytes()
    values: dict[str, Any] = {}
    if ply_binary.is_binary(text):
        announced = ply_binary.element_counts(text, path)
        _refuse_no_faces(announced, path)
        positions, corners, sizes, values = ply_binary.decode(text, path)
    else:
        positions, corners, sizes, announced = _ascii_ply(data[:-1], path)
    refuse_non_finite(positions, path, f'object "{shown(stem)}"')
    is_bad = ~((corners >= 0) & (corners < len(positions)))
    if is_bad.any():
        raise InputError(
            f"{path}: face {np.searchsorted(np.cumsum(sizes), np.argmax(is_bad), 'right')} refers "
            f"to vertex {corners[is_bad][0]:g}; PLY counts from 0 to {len(positions) - 1} here."
        )
    notes = [
        f"{count_of(n, f'{shown(name)} element')} not read"
        for name, n in announced.items()
        if n and name not in ("vertex", "face")
    ]
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    parsed = polygons_as_object(positions, corners.astype(np.uint32), start, path, stem, notes)
    header = parse_header(ply_binary.comments(text), path) if values else None
    return parsed if header is None else _labelled(parsed, header, values, path)


def _labelled(
    parsed: ParsedFile, header: OwnHeader, values: dict[str, Any], path: Path
) -> ParsedFile:
    """Return an export of svprep as the objects that its faces belong to."""
    owner, surface = values.get("object_id"), values.get("surface")
    n_objects, n_surfaces = len(header.objects), len(header.surface_names)
    if owner is None or surface is None or owner.dtype.kind not in "iu":
        return replace(parsed, crs=header.crs)
    for what, numbers, n in (("object", owner, n_objects), ("surface", surface, n_surfaces)):
        is_bad = ~((numbers >= 0) & (numbers < n))
        if is_bad.any():
            raise InputError(
                f"{path}: face {int(np.argmax(is_bad))} is of {what} {numbers[is_bad][0]}, but "
                f"this export of svprep names {n} in its header; export it again."
            )
    owner = owner.astype(np.int64)
    of_face = owner[parsed.source_face]
    order = np.argsort(of_face, kind="stable")
    findings = parsed.face_findings
    return replace(
        parsed,
        faces=np.ascontiguousarray(parsed.faces[order]),
        object_face_start=np.searchsorted(of_face[order], np.arange(n_objects + 1)),
        source_face=parsed.source_face[order],
        object_names=tuple(found.name for found in header.objects),
        face_findings=replace(findings, object_index=owner[findings.source_face].astype(np.uint32)),
        object_types=tuple(found.type for found in header.objects),
        object_parents=tuple(found.parent for found in header.objects),
        surface_names=header.surface_names,
        surface_of_polygon=surface.astype(np.uint8),
        crs=header.crs,
    )


def _refuse_no_faces(announced: dict[str, int], path: Path) -> None:
    """Raise `InputError` where the header announces nothing that casts a shadow."""
    if not announced.get("face") or not announced.get("vertex"):
        found = ", ".join(f"{n} {name}" for name, n in announced.items() if n) or "nothing"
        raise InputError(f"{path}: no faces in this PLY file ({found}), so no shadow.")


def _ascii_ply(data: U8, path: Path) -> tuple[F64, F64, I64, dict[str, int]]:
    """Return positions, corners, the size of each face, and what the header announces."""
    from trimesh.exchange.ply import load_ply

    kwargs = _decoded(load_ply, "PLY", data, path, fix_texture=False, skip_materials=True)
    elements = kwargs["metadata"]["_ply_raw"]
    announced = {name: int(element["length"]) for name, element in elements.items()}
    _refuse_no_faces(announced, path)
    _check_ascii_faces(data, elements, path)
    positions = np.ascontiguousarray(kwargs["vertices"], np.float64)
    rings = _ascii_rings(elements["face"].get("data"))
    if len(positions) != announced["vertex"] or len(rings) != announced["face"]:
        raise InputError(
            f"{path}: cut off: {announced['vertex']} vertices and {announced['face']} faces "
            f"announced, {len(positions)} and {len(rings)} found."
        )
    sizes = np.array([len(ring) for ring in rings], np.int64)
    corners = np.concatenate([np.asarray(ring, np.float64) for ring in rings])
    return positions, corners, sizes, announced


def _check_ascii_faces(data: U8, elements: dict[str, Any], path: Path) -> None:
    """Raise `InputError` at a face row that its counts do not fit, or that is not integer.

    The decoder takes a row for as long as the others, and cuts decimals off.
    """
    lines = data.tobytes().decode().splitlines()
    first = next(i for i, line in enumerate(lines) if "end_header" in line.split()) + 1
    for name, element in elements.items():
        if name == "face":
            break
        first += int(element["length"])
    properties = elements["face"]["properties"]
    lists = [name for name, kind in properties.items() if "$LIST" in kind]
    for number in range(first, min(first + int(elements["face"]["length"]), len(lines))):
        tokens = lines[number].split()
        at = 0
        is_right = True
        for name in properties:
            n = 1
            if name in lists:
                n = int(tokens[at]) if at < len(tokens) and tokens[at].isdecimal() else -1
                at += 1
                is_ring = name in _RING_NAMES or name == lists[0]
                is_right &= n >= 0 and not (is_ring and not _are_integers(tokens[at : at + n]))
            at += n
        if not is_right or at != len(tokens):
            raise InputError(
                f'{path}, line {number + 1}: "{shown(lines[number])[:60]}" cannot be read as a '
                "face: as many integers as its count says, and what else the header lists."
            )


def _are_integers(tokens: list[str]) -> bool:
    return all(_INTEGER.fullmatch(token) for token in tokens)


def _ascii_rings(data: Any) -> Any:
    """Return the corners of each polygon: rows of an array, or a list of arrays."""
    if isinstance(data, dict):
        found = [data[name] for name in _RING_NAMES if name in data]
        return np.atleast_2d(found[0]) if found and found[0].dtype != object else (found or [[]])[0]
    return []


def read_stl(data: U8, path: Path, stem: str) -> ParsedFile:
    """Read an STL file, binary or ASCII: one object per solid.

    Raises
    ------
    InputError
        Also where a count in the file and what is in it disagree.
    """
    from trimesh.exchange.stl import load_stl

    text = data[:-1].tobytes()
    is_ascii = text[:512].lstrip()[:5].lower() == b"solid" and b"\0" not in text[:512]
    n_announced = 0
    if is_ascii:
        n_announced = len(re.findall(rb"\bouter\s+loop\b", text, re.IGNORECASE))
    elif len(text) >= _STL_HEADER_BYTES:
        (n_announced,) = struct.unpack_from("<I", text, 80)
        n_bytes = _STL_HEADER_BYTES + _STL_TRIANGLE_BYTES * n_announced
        if n_bytes != len(text) and b"\0" not in text[:512]:  # text: its count means nothing
            raise InputError(
                f'{path}: not an STL file or cut off: text that does not begin with "solid".'
            )
        if n_bytes != len(text):
            raise InputError(
                f"{path}: not an STL file or cut off: a binary STL file of {n_announced} "
                f"triangles has {n_bytes} bytes, this one has {len(text)}."
            )
    else:
        raise InputError(f"{path}: not an STL file: too short for one ({len(text)} bytes).")
    if n_announced == 0:
        raise InputError(f"{path}: no triangles in this STL file.")
    kwargs = _decoded(load_stl, "STL", data[:-1], path)
    solids = kwargs.get("geometry", {stem: kwargs})
    points = [np.asarray(solid["vertices"], np.float64) for solid in solids.values()]
    names = list(solids)
    if len(solids) == 1 and (name := kwargs.get("metadata", {}).get("name")):
        names = [str(name)]
    n_found = sum(len(p) for p in points) // 3
    if n_found != n_announced:
        raise InputError(
            f'{path}: damaged or cut off: {n_announced} "outer loop", but {n_found} whole '
            'triangles between "solid" and "endsolid".'
        )
    for name, solid_points in zip(names, points, strict=True):
        refuse_non_finite(solid_points, path, f'object "{shown(name)}"')
    return ParsedFile(
        np.concatenate(points),
        np.arange(3 * n_found, dtype=np.uint32).reshape(-1, 3),
        np.concatenate([[0], np.cumsum([len(p) // 3 for p in points])]).astype(np.int64),
        np.arange(n_found, dtype=np.uint32),
        tuple(names),
        no_findings(),
        (),
    )


def _decoded(load: Any, kind: str, data: U8, path: Path, **options: Any) -> dict[str, Any]:
    """Return what a decoder of trimesh makes of the bytes.

    NumPy only warns of text that is no number, and stops reading there: here it raises.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", message="string or file could not be read")
            return load(io.BytesIO(data.tobytes()), **options)
    except Exception as error:
        detail = (str(error).splitlines() or [""])[0][:120] or type(error).__name__
        raise InputError(f"{path}: damaged, cut off or not {kind} (trimesh: {detail}).") from None
