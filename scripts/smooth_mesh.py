"""Write a smooth, closed mesh of a million triangles as Wavefront OBJ.

    python scripts/smooth_mesh.py -o smooth.obj
    python scripts/smooth_mesh.py --triangles 50000 -o smooth.obj

The counterpart of the city: one solid without a flat spot, whose silhouette is a
vanishing part of its edges. A sphere whose radius is modulated by a few low
harmonics, so that it has folds and hollows. The same options give the same bytes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

DEFAULT_TRIANGLES = 1_330_668
RADIUS_M = 100.0
LINES_AT_ONCE = 1 << 17


def smooth_mesh(triangles: int) -> tuple[F64, I64]:
    """Return a closed mesh of about `triangles` triangles, wound outward.

    Returns
    -------
    positions : ndarray
        ``(6 n^2 + 2, 3) float64`` [m], no two alike.
    faces : ndarray
        ``(12 n^2, 3) int64``, with n as `subdivisions` gives it.

    Notes
    -----
    An equiangular cube sphere: a lattice on the surface of a cube, its coordinates
    spread by the tangent and pushed out to the sphere. Its vertices are told apart
    by their integer coordinates, so that the six sides share those of the cube's
    edges. Each vertex only moves along its own ray from the centre, so the surface
    cannot meet itself.
    """
    n = subdivisions(triangles)
    lattice, faces = cube_lattice(n)
    on_cube = np.tan(np.pi / 4.0 * (2.0 * lattice / n - 1.0))
    direction = on_cube / np.sqrt((on_cube**2).sum(axis=1))[:, None]
    return RADIUS_M * relative_radius(direction)[:, None] * direction, faces


def subdivisions(triangles: int) -> int:
    """Return n: a side of the cube has n x n cells of two triangles, 12 n^2 in all."""
    return max(1, round((triangles / 12.0) ** 0.5))


def relative_radius(direction: F64) -> F64:
    """Return ``(n,)``: how far out the surface is along each unit vector, 0.6 to 1.4."""
    x, y, z = direction.T
    wide = 0.16 * np.sin(5.0 * x + 0.4) * np.cos(4.0 * y)
    slanted = 0.12 * np.sin(7.0 * z + 3.0 * x)
    fine = 0.08 * np.sin(9.0 * y - 6.0 * z + 1.1) * np.cos(5.0 * x)
    return 1.0 + wide + slanted + fine


def cube_lattice(n: int) -> tuple[I64, I64]:
    """Return the lattice points on the surface of the cube ``[0, n]^3``, and its triangles.

    q01 --- q11      A cell of a side, seen from outside: a and b are the side's
     |    /  |       own axes, a x b points out.
     |  /    |
    q00 --- q10      Triangles (q00, q10, q11) and (q00, q11, q01).
    """
    along = np.arange(n + 1)
    a, b = (grid.ravel() for grid in np.meshgrid(along, along, indexing="ij"))
    q00 = (along[:-1, None] * (n + 1) + along[:-1]).ravel()
    q10, q01, q11 = q00 + n + 1, q00 + 1, q00 + n + 2
    cells = np.stack([q00, q10, q11, q00, q11, q01], axis=1).reshape(-1, 3)
    codes: list[I64] = []
    faces: list[I64] = []
    for axis in range(3):
        for end in (0, n):
            point = np.empty((len(a), 3), np.int64)
            point[:, axis] = end
            # (axis, axis + 1, axis + 2) is right-handed; on the far side a x b is +axis.
            point[:, (axis + 1) % 3], point[:, (axis + 2) % 3] = (a, b) if end else (b, a)
            codes.append((point[:, 0] * (n + 1) + point[:, 1]) * (n + 1) + point[:, 2])
            faces.append(cells + len(a) * len(faces))
    unique, vertex_of_corner = np.unique(np.concatenate(codes), return_inverse=True)
    lattice = np.stack([unique // (n + 1) ** 2, unique // (n + 1) % (n + 1), unique % (n + 1)], 1)
    return lattice, vertex_of_corner.reshape(-1)[np.concatenate(faces)]


def write_obj(path: Path, positions: F64, faces: I64) -> None:
    """Write one object named ``smooth``."""
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.write("o smooth\n")
        stream.writelines(_blocks("v %.6f %.6f %.6f\n", positions))
        stream.writelines(_blocks("f %d %d %d\n", faces + 1))


def _blocks(line: str, table: F64 | I64) -> Iterator[str]:
    """Yield `line` filled with each row of `table`, many rows in one string."""
    for begin in range(0, len(table), LINES_AT_ONCE):
        rows = table[begin : begin + LINES_AT_ONCE]
        yield line * len(rows) % tuple(rows.ravel().tolist())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    parser = argparse.ArgumentParser(description="Write a smooth, closed mesh as OBJ.")
    parser.add_argument(
        "--triangles", type=int, default=DEFAULT_TRIANGLES, metavar="N",
        help=f"about how many: the nearest 12 n^2; default {DEFAULT_TRIANGLES}",
    )  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE")
    options = parser.parse_args(argv)
    if options.triangles < 12:
        parser.error(f"a closed mesh of this kind has at least 12 triangles: {options.triangles}")
    positions, faces = smooth_mesh(options.triangles)
    try:
        write_obj(options.output, positions, faces)
    except OSError as error:
        print(f"smooth_mesh: cannot write {options.output}: {error.strerror}", file=sys.stderr)
        return 1
    print(f"{options.output}: {len(positions):,} vertices, {len(faces):,} triangles",
          file=sys.stderr)  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
