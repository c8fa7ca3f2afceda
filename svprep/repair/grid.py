"""The quantisation grid: a power-of-two step that fits the model's extent.

Positions become integers of at most 24 bits and a sign times the step: exact in
float32, and a face normal is exact in float64. A translation by multiples of
the step changes nothing at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from svprep.errors import InputError
from svprep.model import BOOL, F32, F64, I32, Grid, SourceMesh

MAX_COORDINATE = 1 << 24
"""A grid coordinate is an integer in [-2**24, 2**24]."""
COARSEST_STEP_M = 2.0**-4
"""[m]: a model that needs a coarser grid is refused (extent above 2,097 km)."""
FINEST_EXPONENT = -60
_BLOCK = 1 << 16
"""Faces or vertices looked at together: a mesh may be larger than memory."""
FINE_STEP_M = 0.001
"""[m]: a coarser step than this is worth a note; 32 km fit a finer one."""


def choose_grid(source: SourceMesh) -> Grid:
    """Return the finest grid that holds every vertex that a face uses.

    The step is also no finer than float64 resolves the source coordinates, so
    the origin is exact. Only vertices used by faces count.

    Raises
    ------
    InputError
        When the extent needs a step above `COARSEST_STEP_M`: names the vertex
        that lies farthest out, and its object.
    """
    used = _used_vertices(source)
    if not used.any():
        return Grid(step_m=2.0**-24, origin_m=np.zeros(3))
    low, high = _bounds(source.positions, used)
    with np.errstate(over="ignore"):
        extent = float((high - low).max())
    magnitude = float(max(np.abs(low).max(), np.abs(high).max()))
    exponent = max(_ceil_log2(extent) - 25, _ceil_log2(magnitude) - 52, FINEST_EXPONENT)
    if not math.isfinite(extent) or 2.0**exponent > COARSEST_STEP_M:
        raise _too_large(source, used, extent)
    while True:
        step = 2.0**exponent
        low_index, high_index = np.floor(low / step + 0.5), np.floor(high / step + 0.5)
        if (high_index - low_index).max() <= 2 * MAX_COORDINATE:
            break
        exponent += 1
    if step > COARSEST_STEP_M:
        raise _too_large(source, used, extent)
    centre = low_index + np.floor((high_index - low_index) / 2)
    return Grid(step_m=step, origin_m=centre * step)


def notes_on_step(grid: Grid, positions: Callable[[], F32]) -> tuple[str, ...]:
    """Return the note that the extent makes the grid coarser than `FINE_STEP_M`, if it does.

    `positions` gives those of `Mesh`, and is called only if it does.
    """
    step_m = grid.step_m
    if step_m <= FINE_STEP_M or not len(points := positions()):
        return ()
    extent_m = float(np.ptp(points.astype(np.float64), axis=0).max())
    if extent_m <= MAX_COORDINATE * step_m:  # it would fit a finer one, but for float64
        return (f"that far from the origin the grid step is {step_m * 1000:.2g} mm",)
    return (
        f"the extent of {extent_m / 1000:.3g} km allows a grid step of {step_m * 1000:.2g} mm; "
        "build parts of it apart for a finer one",
    )


def to_grid(positions: F64, grid: Grid) -> I32:
    """Return ``(n, 3) int32`` grid coordinates of source positions.

    Halves round up, so that rounding commutes with any shift by grid steps.
    Vertices no face uses may lie outside the grid; they are clipped.
    """
    with np.errstate(over="ignore"):
        index = positions * (1.0 / grid.step_m)  # a power of two: as exact as dividing
    index += 0.5
    np.floor(index, out=index)
    index -= grid.origin_m / grid.step_m
    np.clip(index, -MAX_COORDINATE, MAX_COORDINATE, out=index)
    return index.astype(np.int32)


def grid_coordinates(positions: np.ndarray, grid: Grid) -> I32:
    """Return the integers behind cache positions: ``positions / step``, exact."""
    return (positions * np.float32(1.0 / grid.step_m)).astype(np.int32)


def _ceil_log2(x: float) -> int:
    return math.ceil(math.log2(x)) if x > 0.0 and math.isfinite(x) else -1100 if x == 0.0 else 1024


def _used_vertices(source: SourceMesh) -> BOOL:
    """Return ``(n_vertices,)``: whether a face uses each vertex."""
    used = np.zeros(len(source.positions), bool)
    for begin in range(0, len(source.faces), _BLOCK):
        used[source.faces[begin : begin + _BLOCK].reshape(-1)] = True
    return used


def _bounds(positions: F64, used: BOOL) -> tuple[F64, F64]:
    """Return the lowest and highest coordinates of the used vertices, of which there are some."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for begin in range(0, len(positions), _BLOCK):
        block, chosen = positions[begin : begin + _BLOCK], used[begin : begin + _BLOCK]
        if not chosen.all():
            block = block[chosen]
        # Rows side by side make long loops of the short ones over three coordinates.
        n_abreast = 64 if len(block) >= 64 else 1
        n_even = len(block) - len(block) % n_abreast
        wide = block[:n_even].reshape(-1, 3 * n_abreast)
        for part in (wide.min(axis=0, initial=np.inf), block[n_even:]):
            low = np.minimum(low, part.reshape(-1, 3).min(axis=0, initial=np.inf))
        for part in (wide.max(axis=0, initial=-np.inf), block[n_even:]):
            high = np.maximum(high, part.reshape(-1, 3).max(axis=0, initial=-np.inf))
    return low, high


def _too_large(source: SourceMesh, used: BOOL, extent: float) -> InputError:
    """Name the vertex farthest from the median, and an object that uses it."""
    with np.errstate(over="ignore"):
        centre = 2 * np.median(source.positions[used] / 2, axis=0)
        distance = np.abs(source.positions - centre).max(axis=1)
    vertex = int(np.argmax(np.where(used, distance, -1.0)))
    face = int(np.flatnonzero((source.faces == vertex).any(axis=1))[0])
    owner = int(np.searchsorted(source.object_face_start, face, side="right")) - 1
    x, y, z = source.positions[vertex]
    magnitude = float(np.abs(source.positions[vertex]).max())
    too_far = extent <= COARSEST_STEP_M * 2 * MAX_COORDINATE
    problem = (
        f"that far from the origin float64 resolves no less than {np.spacing(magnitude):g} m"
        if too_far
        else f"so the model is {extent:g} m wide; at most "
        f"{COARSEST_STEP_M * 2 * MAX_COORDINATE / 1000:,.0f} km fit a grid of {COARSEST_STEP_M} m"
    )
    path = source.sources[int(source.object_source[owner])].path
    advice = "Move the model nearer" if too_far else "Mend or remove that vertex"
    return InputError(
        f'{path}, object "{source.object_names[owner]}": a face uses a vertex at '
        f"({x:g}, {y:g}, {z:g}), {problem}. {advice}, or build the parts apart."
    )
