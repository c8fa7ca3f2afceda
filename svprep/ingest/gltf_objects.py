"""What is gathered while a glTF file is walked: triangles, and the objects they belong to."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from svprep.errors import InputError
from svprep.ingest.parsed import ParsedFile, all_encodable, no_findings, refuse_non_finite
from svprep.ingest.surface_names import SurfaceNames
from svprep.model import F64, I64, U32

MOST_TRIANGLES: Final = 715_000_000
"""Three times as many corners stay below 2**31."""
# What a file may unfold to, placed as often as its nodes and instances say.
_ALWAYS_PLACED: Final = 5_000_000  # triangles
_MOST_PER_BYTE: Final = 10  # as many more for every byte of the file
_ALWAYS_INSTANCES: Final = 1_000_000  # each is an object; and one more for every byte
_MOST_WAITING: Final = 1 << 20  # vertices


class Owner(NamedTuple):
    """An object as the file names it."""

    key: Hashable
    name: str
    type: str = ""
    parent: str = ""


class Gathered:
    """Surfaces and objects, in the order in which they were found."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.n_faces = 0
        self._n_instances = 0
        self._n_vertices = 0
        self._positions: list[F64] = [np.empty((0, 3))]
        self._faces: list[U32] = [np.empty((0, 3), np.uint32)]
        self._object_of_face: list[I64] = [np.empty(0, np.int64)]
        self._waiting: list[tuple[F64, I64, str]] = []  # points, triangles, name
        self._n_waiting = 0
        self._matrices: F64 = np.empty((0, 4, 4))  # that place them
        self._number: dict[Hashable, int] = {}
        self._owners: list[Owner] = []
        self._surface: list[tuple[int, int]] = []  # name, faces
        self._surface_names = SurfaceNames()

    def number(self, owner: Owner) -> int:
        """Return an object's number; it is given one when it is first met."""
        number = self._number.setdefault(owner.key, len(self._owners))
        if number == len(self._owners):
            self._owners.append(owner)
        return number

    @property
    def n_objects(self) -> int:
        """How many objects were met."""
        return len(self._owners)

    def rename_last(self, name: str) -> None:
        """Give the object that was met last another name."""
        self._owners[-1] = self._owners[-1]._replace(name=name)

    def find(self, key: Hashable) -> int:
        """Return the number of an object that was met, or -1."""
        return self._number.get(key, -1)

    def count_instances(self, n: int, n_bytes: int) -> None:
        """Raise `InputError` if with `n` more there are too many for a file of `n_bytes`."""
        self._n_instances += n
        self._refuse_above(
            self._n_instances, _ALWAYS_INSTANCES + n_bytes, "instances of nodes", n_bytes
        )

    def count_triangles(self, n: int, n_bytes: int) -> None:
        """Raise `InputError` if with `n` more there are too many for a file of `n_bytes`."""
        most = min(_ALWAYS_PLACED + _MOST_PER_BYTE * n_bytes, MOST_TRIANGLES)
        self._refuse_above(self.n_faces + n, most, "triangles", n_bytes)

    def _refuse_above(self, n: int, most: int, kind: str, n_bytes: int) -> None:
        if n > most:
            raise InputError(
                f"{self.path}: it unfolds to {n} {kind} or more, as often as its meshes are "
                f"placed; of {n_bytes} bytes at most {most} are read. Split the file, or write "
                "out what it repeats."
            )

    def add(
        self, points: F64, triangles: I64, matrices: F64, objects: I64, surface: str, what: str
    ) -> None:
        """Take one surface, which is placed once or more.

        Parameters
        ----------
        points : (n, 3) float64
        triangles : (m, 3) int64
        matrices : (n_times, 4, 4) float64
        objects : (n_times * m,) int64
        surface
            What its polygons are, or ``""``.
        what
            Its name for a message.
        """
        n_new = len(matrices) * len(triangles)
        is_together = len(matrices) == 1 and np.array_equal(matrices, self._matrices)
        if not is_together or self._n_waiting > _MOST_WAITING:
            self._place()
        self._matrices = matrices
        self._waiting.append((points, triangles, what))
        self._n_waiting += len(points)
        self._object_of_face.append(objects)
        self.n_faces += n_new
        self._surface.append((self._surface_names.number_of(surface), n_new))

    def _place(self) -> None:
        """Place the surfaces that wait for it, all by the same matrices.

        Most nodes of a city stand in one frame, and thousands of small steps take seconds.
        """
        if not self._waiting:
            return
        pieces, self._waiting, self._n_waiting = self._waiting, [], 0
        points = np.concatenate([points for points, _, _ in pieces])
        sizes = np.array([(len(points), len(triangles)) for points, triangles, _ in pieces])
        placed = _placed(points, self._matrices)
        if not np.isfinite(placed).all():
            for of_piece, _, what in pieces:
                refuse_non_finite(
                    _placed(of_piece, self._matrices), self.path, f"{what}, placed by its nodes"
                )
        triangles = np.concatenate([triangles for _, triangles, _ in pieces])
        triangles += np.repeat(np.cumsum(sizes[:, 0]) - sizes[:, 0], sizes[:, 1])[:, None]
        first = self._n_vertices + np.arange(len(self._matrices)) * len(points)
        faces = triangles + first[:, None, None]
        is_mirrored = np.linalg.slogdet(self._matrices[:, :3, :3])[0] < 0
        faces[is_mirrored] = faces[is_mirrored, :, ::-1]
        self._positions.append(placed)
        self._faces.append(faces.reshape(-1, 3).astype(np.uint32))
        self._n_vertices += len(placed)

    def parsed(self, notes: tuple[str, ...], beside: tuple[bytes, ...]) -> ParsedFile:
        """Return everything, the triangles of each object together."""
        self._place()
        faces = np.concatenate(self._faces)
        objects = np.concatenate(self._object_of_face)
        source_face = np.arange(len(faces), dtype=np.uint32)
        if (objects[1:] < objects[:-1]).any():
            order = np.argsort(objects, kind="stable")
            faces, source_face = faces[order], source_face[order]
        counts = np.bincount(objects, minlength=len(self._owners))
        names = self._surface_names.names()
        surfaces: NDArray[np.uint8] = np.empty(0, np.uint8)
        if len(names) > 1:
            numbers, lengths = np.array(self._surface, np.int64).T
            surfaces = np.repeat(numbers.astype(np.uint8), lengths)
        return ParsedFile(
            np.concatenate(self._positions),
            faces,
            np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            source_face,
            all_encodable(owner.name for owner in self._owners),
            no_findings(),
            notes,
            beside,
            _stated([owner.type for owner in self._owners]),
            _stated([owner.parent for owner in self._owners]),
            all_encodable(names),
            surfaces,
        )


def _placed(points: F64, matrices: F64) -> F64:
    """Return points placed by each matrix, ``(n_times * n, 3)``.

    Not by the matrix product: its last bits depend on the machine, and its threads wait for
    each other on a busy one.
    """
    x, y, z = points.T
    placed = np.empty((len(matrices), len(points), 3))
    with np.errstate(all="ignore"):  # what is not finite is refused
        for axis in range(3):
            of_x, of_y, of_z, shift = matrices[:, axis, :, None].transpose(1, 0, 2)
            placed[:, :, axis] = of_x * x + of_y * y + of_z * z + shift
    return placed.reshape(-1, 3)


def _stated(texts: list[str]) -> tuple[str, ...]:
    """Return a text per object, or none at all where none is stated of any."""
    return all_encodable(texts) if any(texts) else ()
