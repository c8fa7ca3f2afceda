"""What the build found and did, per object: tables for people, planners, programs.

Every defect of `svprep.defects` that occurs is listed with its object, its
count and the source faces it concerns (0-based ordinals in the source file).
"""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from os import PathLike
from typing import Any, Final

import numpy as np

from svprep.defects import DEFECTS, Code
from svprep.model import (
    F32,
    NO_INDEX,
    U8,
    ComponentFlag,
    EdgeFlag,
    EdgeKind,
    EdgeTable,
    Labels,
    Prepared,
    RepairRecord,
    SilhouetteIndex,
)
from svprep.output_file import OutputKind, suffix_of, write_whole
from svprep.repair.winding import opposite_faces

FACES_IN_CSV = 1000
"""A CSV cell lists at most so many source faces: spreadsheets cut longer ones. JSON has all."""


REPORT: Final = OutputKind(
    name="the report",
    form="a report is .json or .csv",
    what="is not a report of svprep",
    suffixes=(".json", ".csv"),
    is_ours=lambda head: head.startswith((b"object_index,object,source,", b'{\n "sources": [')),
    option="--report",
)


def write_report(prepared: Prepared, path: str | PathLike[str]) -> None:
    """Write the per-object report as JSON or CSV, by the suffix of `path`."""
    target = REPORT.checked_path(path)
    text = to_json(prepared) if suffix_of(path) == ".json" else to_csv(prepared)
    write_whole(target, [text.encode("utf-8", "surrogateescape")])


def extent_m(positions: F32) -> list[float]:
    """Return how far vertices reach along x, y and z [m], to the millimetre.

    ``positions (n_vertices, 3)``
    """
    if not len(positions):
        return [0.0, 0.0, 0.0]
    # Column by column: several times as fast as all rows at once.
    return [round(float(axis.max()) - float(axis.min()), 3) for axis in positions.T]


def total_counts(repair: RepairRecord) -> dict[str, int]:
    """Return ``{"D302 OPEN_SHELL": 41, ...}`` of the defects that occur, over all objects."""
    totals = repair.defect_counts.sum(axis=0, dtype=np.int64)
    return {
        defect.label: int(total)
        for defect, total in zip(DEFECTS.values(), totals, strict=True)
        if total
    }


def edge_counts(edges: EdgeTable) -> dict[str, int]:
    """Return how many records there are of each kind, and how many are planar."""
    kind = edges.flags & np.uint8(EdgeFlag.KIND_MASK)
    counts = np.bincount(kind, minlength=len(EdgeKind))
    named = {k.name.lower(): int(counts[k]) for k in EdgeKind}
    return {**named, "planar": int(np.count_nonzero(edges.flags & np.uint8(EdgeFlag.PLANAR)))}


def index_counts(index: SilhouetteIndex) -> dict[str, int]:
    """Return how many objects have silhouette trees, over how many edges, in how many bytes."""
    n_bytes = index.objects.nbytes + index.frames.nbytes + 4 * len(index.pair_start)
    for tree in (index.cones, index.hextree):
        n_bytes += tree.edge.nbytes + tree.blocks.nbytes + tree.expected_work.nbytes
    return {
        "objects": len(index.objects),
        "edges": int(index.pair_start[-1]),
        "n_bytes": n_bytes,
    }


def component_counts(flags: U8) -> dict[str, int]:
    """Return how many components there are, closed and solid."""
    return {
        "components": len(flags),
        "closed": int(np.count_nonzero(flags & np.uint8(ComponentFlag.CLOSED))),
        "solid": int(np.count_nonzero(flags & np.uint8(ComponentFlag.SOLID))),
    }


def type_counts(labels: Labels) -> dict[str, int]:
    """Return how many objects are of each type, the most frequent first; none if none is stated.

    Those of which no type is stated count as ``""``.
    """
    counts = Counter(labels.object_types)
    return _by_frequency(counts) if any(counts) else {}


def surface_counts(surface_of_face: U8, labels: Labels) -> dict[str, int]:
    """Return how many of these faces have each surface name; none if none of them has one.

    Those of which no surface is stated count as ``""``.
    """
    counts = np.bincount(surface_of_face, minlength=len(labels.surface_names)).tolist()
    named = {name: n for name, n in zip(labels.surface_names, counts, strict=True) if n}
    return _by_frequency(Counter(named)) if any(named) else {}


def _by_frequency(counts: Counter[str]) -> dict[str, int]:
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def to_json(prepared: Prepared) -> str:
    """Return the report as one JSON object: totals, and a line per object."""
    head = {
        "sources": [asdict(source) for source in prepared.sources],
        "config": prepared.config,
        "place": asdict(prepared.place),
        "object_types": type_counts(prepared.labels),
        "faces_by_surface": surface_counts(prepared.labels.surface_of_face, prepared.labels),
        "notes": list(prepared.notes),
        "defects": total_counts(prepared.repair),
    }
    lines = ",\n".join(json.dumps(e) for e in _object_entries(prepared))
    text = json.dumps(head, indent=1).removesuffix("\n}")
    return f'{text},\n "objects": [\n{lines}\n]\n}}\n'


def to_csv(prepared: Prepared) -> str:
    """Return the report as CSV: a row per object and defect, one row per clean object."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    head = ["object_index", "object", "source", "type", "parent", "triangles_in", "faces"]
    head += ["components", "closed", "solid"]
    rows.writerow((*head, "code", "defect", "count", "action", "source_faces"))
    for entry in _object_entries(prepared):
        start = [_not_a_formula(entry[name]) for name in head]
        for found in entry["findings"]:
            faces = found["source_faces"]
            listed = " ".join(map(str, faces[:FACES_IN_CSV]))
            if len(faces) > FACES_IN_CSV:
                listed += f" ... ({len(faces)}; a .json report lists all)"
            rows.writerow(
                [*start, *(found[k] for k in ("code", "defect", "count", "action")), listed]
            )
        if not entry["findings"]:
            rows.writerow([*start, "", "", "", "", ""])
    return out.getvalue()


def _not_a_formula(cell: object) -> object:
    """Return a cell that a spreadsheet shows instead of computing."""
    return f"'{cell}" if isinstance(cell, str) and cell[:1] in ("=", "+", "-", "@") else cell


def _object_entries(prepared: Prepared) -> Iterator[dict[str, Any]]:
    """Yield the report's entry of each object."""
    mesh, components, repair = prepared.mesh, prepared.components, prepared.repair
    labels = prepared.labels
    owner, code, face = source_faces_of_defects(prepared)
    begin = np.searchsorted(owner, np.arange(len(prepared.object_names) + 1))
    codes = list(DEFECTS)
    for i, name in enumerate(prepared.object_names):
        flags = components.flags[components.object_start[i] : components.object_start[i + 1]]
        here = slice(begin[i], begin[i + 1])
        own = slice(mesh.object_face_start[i], mesh.object_face_start[i + 1])
        findings = []
        for j in np.flatnonzero(repair.defect_counts[i]):
            defect = codes[j]
            findings.append(
                {
                    "code": f"D{int(defect)}",
                    "defect": defect.name,
                    "count": int(repair.defect_counts[i, j]),
                    "action": DEFECTS[defect].action,
                    "source_faces": face[here][code[here] == defect].tolist(),
                }
            )
        yield {
            "object_index": i,
            "object": name,
            "source": prepared.sources[int(prepared.object_source[i])].path,
            "type": labels.object_types[i],
            "parent": labels.object_parents[i],
            "triangles_in": int(repair.source_triangles[i]),
            "faces": int(own.stop - own.start),
            "faces_by_surface": surface_counts(labels.surface_of_face[own], labels),
            **component_counts(flags),
            "findings": findings,
        }


def source_faces_of_defects(prepared: Prepared) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``(object, code, source face)`` of every defect that has source faces.

    Sorted, each once: dropped, flipped and opposite faces, faces at border, cut and
    non-manifold edges, and faces of flat, inverted or self-touching components.
    """
    mesh, edges, components = prepared.mesh, prepared.edges, prepared.components
    found = prepared.repair.face_findings
    owner_of_face = np.repeat(
        np.arange(len(prepared.object_names), dtype=np.uint32), np.diff(mesh.object_face_start)
    )
    faces_of: dict[Code, np.ndarray] = {
        Code.FLIPPED_FACE: prepared.repair.flipped_faces,
        Code.OPPOSITE_FACE: opposite_faces(mesh),
    }
    kind = edges.flags & np.uint8(EdgeFlag.KIND_MASK)
    split = edges.rows[kind == EdgeKind.SPLIT, 2:].reshape(-1)
    faces_of[Code.NONMANIFOLD_EDGE] = split[split != NO_INDEX]
    border = edges.rows[kind == EdgeKind.BORDER]
    is_cut = cut_border_rows(border)
    single = np.minimum(border[:, 2], border[:, 3])
    faces_of[Code.OPEN_SHELL] = single[~is_cut]
    faces_of[Code.CUT_EDGE] = single[is_cut]
    bit = np.repeat(components.flags, np.diff(components.face_start))
    closed = (bit & np.uint8(ComponentFlag.CLOSED)) != 0
    solid = (bit & np.uint8(ComponentFlag.SOLID)) != 0
    inverted = (bit & np.uint8(ComponentFlag.INVERTED)) != 0
    faces_of[Code.INVERTED_COMPONENT] = np.flatnonzero(inverted)
    unsafe = np.flatnonzero(closed & ~solid)
    # An object may hold both kinds of closed component that are not solid.
    columns = list(DEFECTS)
    for defect in (Code.SELF_INTERSECTION, Code.FLAT_COMPONENT):
        has = prepared.repair.defect_counts[:, columns.index(defect)] > 0
        faces_of[defect] = unsafe[has[owner_of_face[unsafe]]]
    triples = [(found.object_index, found.code, found.source_face)]
    for defect, faces in faces_of.items():
        triples.append((owner_of_face[faces], np.full(len(faces), defect), mesh.source_face[faces]))
    owner, code, face = (
        np.concatenate(column).astype(np.int64) for column in zip(*triples, strict=True)
    )
    order = np.lexsort((face, code, owner))
    owner, code, face = owner[order], code[order], face[order]
    is_new = np.ones(len(owner), bool)
    is_new[1:] = (owner[1:] != owner[:-1]) | (code[1:] != code[:-1]) | (face[1:] != face[:-1])
    return owner[is_new], code[is_new], face[is_new]


def cut_border_rows(border: np.ndarray) -> np.ndarray:
    """Return which of the given BORDER rows are halves of a cut edge.

    A cut edge has two border rows over the same vertices; a border edge one.
    """
    if len(border) == 0:
        return np.zeros(0, bool)
    key = border[:, 0].astype(np.uint64) << np.uint64(32) | border[:, 1]
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    return count[inverse] > 1
