"""The generated city as OBJ, and copies of it in which one building is another."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from build_benchmark.processes import ROOT, CommandFailed, run

BUILDINGS: Final = (
    "house", "gabled", "hipped", "ell", "row", "court", "horseshoe", "tower", "office",
)  # fmt: skip
"""Kinds of the generated city's objects; the rest are trees, terrain and street furniture."""
MOVE_M: Final = 0.25
LAMP_M: Final = (100.3, 60.7, 80.1)
"""East, north and up of a building's vertex."""


@dataclass(frozen=True, slots=True)
class Building:
    """One object of an OBJ file."""

    name: str
    first_line: int
    """The line ``o NAME``, 0-based."""
    end_line: int
    """That of the next object, or the number of lines."""
    first_vertex: int
    vertex: int = -1
    """0-based number of a vertex that its first face uses; -1 without a face."""

    @property
    def is_editable(self) -> bool:
        """Whether moving that vertex moves this object alone."""
        return self.vertex >= self.first_vertex


def make_city(objects: int, path: Path) -> Path:
    """Return `path`, with a city of so many objects in it; one that is there is kept.

    Raises
    ------
    CommandFailed
        It could not be made.
    """
    if path.exists():
        return path
    unfinished = path.with_name(f"unfinished_{path.name}")
    script = str(ROOT / "scripts" / "make_city.py")
    done = run([sys.executable, script, "--objects", str(objects), "-o", str(unfinished)])
    if done.exit_status:
        raise CommandFailed(f"make_city.py: {done.last_words}")
    return unfinished.rename(path)


def find_building(path: Path) -> Building:
    """Return the building nearest to the middle of an OBJ file's objects.

    Where no object is named like a building of the generated city, any object is one.

    Raises
    ------
    CommandFailed
        The file has no object that has faces and vertices of its own.
    """
    found = [each for each in _objects(path) if each.is_editable]
    if not found:
        raise CommandFailed(
            f'{path.name}: no "o NAME" with vertices and faces of its own, so no building can be '
            "edited; name another --input, or leave the part out: --only build --only first"
        )
    buildings = [each for each in found if each.name.rpartition("_")[0] in BUILDINGS] or found
    middle = found[len(found) // 2].first_line
    return min(buildings, key=lambda each: abs(each.first_line - middle))


def lamp_near(path: Path, building: Building) -> str:
    """Return a light for ``--light``: a lamp `LAMP_M` from the vertex that is moved."""
    line = next((line for line, is_moved in _lines(path, building) if is_moved), None)
    if line is None:
        raise CommandFailed(f"{path.name}: it has no vertex {building.vertex + 1}")
    at = (float(x) + m for x, m in zip(line.split()[1:4], LAMP_M, strict=True))
    return "point:" + ",".join(f"{x:.3f}" for x in at)


def write_edited(path: Path, building: Building, target: Path) -> None:
    """Copy an OBJ file with one vertex of a building moved to the east by `MOVE_M`."""
    with target.open("wb") as copy:
        for line, is_moved in _lines(path, building):
            copy.write(_moved(line) if is_moved else line)


def write_without(path: Path, building: Building, target: Path) -> None:
    """Copy an OBJ file without a building's name and faces.

    Its vertices stay, for the faces of others count them.
    """
    with path.open("rb") as source, target.open("wb") as copy:
        for number, line in enumerate(source):
            is_inside = building.first_line <= number < building.end_line
            if not (is_inside and line.startswith((b"f ", b"o "))):
                copy.write(line)


def _lines(path: Path, building: Building) -> Iterator[tuple[bytes, bool]]:
    """Yield each line of an OBJ file, and whether it is the vertex of a building that is moved."""
    n_vertices = 0
    with path.open("rb") as source:
        for line in source:
            is_vertex = line.startswith(b"v ")
            yield line, is_vertex and n_vertices == building.vertex
            n_vertices += is_vertex


def _objects(path: Path) -> list[Building]:
    """Return all objects of an OBJ file, which is read line by line."""
    found: list[Building] = []
    n_vertices = number = 0
    with path.open("rb") as source:
        for number, line in enumerate(source):
            if line.startswith(b"v "):
                n_vertices += 1
            elif line.startswith(b"o "):
                if found:
                    found[-1] = replace(found[-1], end_line=number)
                found.append(Building(line[2:].decode().strip(), number, number, n_vertices))
            elif found and found[-1].vertex < 0 and line.startswith(b"f "):
                corner = int(line.split()[1].split(b"/")[0])
                vertex = corner - 1 if corner > 0 else n_vertices + corner
                found[-1] = replace(found[-1], vertex=vertex)
    if found:
        found[-1] = replace(found[-1], end_line=number + 1)
    return found


def _moved(line: bytes) -> bytes:
    """Return a ``v`` line with another x, of as many digits."""
    key, x, *others = line.split()
    digits = len(x.partition(b".")[2])
    return b" ".join([key, f"{float(x) + MOVE_M:.{digits}f}".encode(), *others]) + b"\n"
