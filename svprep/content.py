"""What an object is made of, in 128 bits: by them a later build knows it again.

Two objects with the same bits get the same tables, on the same grid and with the same
configuration, apart from where their vertices, faces and source polygons are counted from.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from svprep.kernels.content import digest_objects
from svprep.model import I64, U32, SourceMesh
from svprep.parallel import for_ranges

U16 = NDArray[np.uint16]
_PRIMES: Final = tuple(np.uint64(k) for k in (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F))


def source_digests(
    source: SourceMesh, begin: int = 0, end: int | None = None
) -> NDArray[np.uint64]:
    """Return 128 bits of the triangles and findings of the objects ``begin .. end - 1``.

    ``(end - begin, 2) uint64``; of all objects by default. Shifting the numbers of an
    object's vertices, or of its polygons, changes none of them. They do not guard against
    someone who makes two objects agree on purpose. O(n).
    """
    end = len(source.object_names) if end is None else end
    start = np.ascontiguousarray(source.object_face_start[begin : end + 1], np.int64)
    digest = np.empty((end - begin, 2), np.uint64)
    words = np.ascontiguousarray(source.positions).view(np.uint64)
    faces, source_face = source.faces, source.source_face
    for_ranges(start, lambda a, b: digest_objects(words, faces, start, source_face, a, b, digest))
    found = source.face_findings
    own = slice(*np.searchsorted(found.object_index, [begin, end]).tolist())
    if own.start < own.stop:
        owner = found.object_index[own].astype(np.int64) - begin
        _add_findings(digest, owner, found.code[own], found.source_face[own], start, source_face)
    return digest


def _add_findings(
    digest: NDArray[np.uint64], owner: I64, code: U16, face: U32, start: I64, source_face: U32
) -> None:
    """Add what the reader found, in any order, counted from the object's first polygon."""
    has_faces = start[owner] < start[owner + 1]
    first = np.zeros(len(owner), np.uint32)
    first[has_faces] = source_face[start[owner[has_faces]]]
    word = code.astype(np.uint64) << np.uint64(32) | (face - first)
    for column, prime in enumerate(_PRIMES):
        mixed = (word ^ prime) * prime
        mixed ^= mixed >> np.uint64(31)
        np.add.at(digest[:, column], owner, mixed * prime)
