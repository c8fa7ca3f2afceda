"""What the judge found of a view, a mask compared with it, and both on disk or in a picture."""

from __future__ import annotations

import io
import os
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from svprep.cache.files import Temporary, problem_of
from svprep.errors import InputError
from svprep.model import BOOL, I32, I64, U8
from svprep_runtime.judge_constants import JUDGE_CONSTANTS

SHADOW: Final = 255
"""In a mask; 0 is lit or sky."""

SKY_COLOUR: Final = (86, 110, 134)
LIT_COLOUR: Final = (212, 212, 212)
SHADOW_COLOUR: Final = (84, 84, 84)
TINT: Final = (64, 96, 224)
"""Undecidable pixels are half of this."""
WRONG_COLOUR: Final = (255, 0, 0)
MARKER_COLOUR: Final = (255, 200, 0)
MARKER_PX: Final = 6
"""From a differing pixel to the frame around it."""


@dataclass(frozen=True, slots=True)
class Overlap:
    """Two objects, or twice the same one, with coincident faces in sight."""

    names: tuple[str, str]
    pixels: int
    """That see a face of either, with one of the other in the same place."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What the judge found of a view; arrays ``(height, width)``, row 0 the top."""

    in_shadow: BOOL
    """A surface that is not lit; false for sky."""
    is_surface: BOOL
    is_decidable: BOOL
    """Only ever of surfaces: nothing is said of the sky."""
    face: I32
    """The face seen, -1 for sky."""
    overlaps: tuple[Overlap, ...]
    """Most pixels first."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A mask, pixel by pixel against the truth."""

    n_surface: int
    n_decidable: int
    differing: I64
    """``(n_differing, 2)``: row and column of the decidable pixels that differ, in order."""
    n_shadow_in_sky: int
    """Pixels that the mask has in shadow, or that show a surface, in the middle of 3 x 3 of
    sky. They are in none of the other numbers."""

    @property
    def n_differing(self) -> int:
        """Decidable pixels that differ."""
        return len(self.differing)

    @property
    def decidable_share(self) -> float:
        """Of the surface pixels; 1.0 where there are none."""
        return self.n_decidable / self.n_surface if self.n_surface else 1.0

    @property
    def per_million(self) -> float:
        """Differing pixels in a million decidable ones; 0.0 where there are none."""
        return 1e6 * self.n_differing / self.n_decidable if self.n_decidable else 0.0


def compare(truth: Truth, mask: U8, is_surface: BOOL | None = None) -> Comparison:
    """Return where a mask and the truth differ.

    Parameters
    ----------
    mask : ndarray
        ``(height, width) uint8``: 255 in shadow, 0 lit or sky.
    is_surface : ndarray, optional
        ``(height, width) bool``: where the picture shows a surface. With it, a decidable
        pixel that shows none differs, and so does one that shows some in the middle of sky.

    Raises
    ------
    InputError
        The mask is of another size or dtype, or holds another value.
    """
    is_dark = _checked_mask(truth, mask) == SHADOW
    shown = is_dark if is_surface is None else is_dark | is_surface
    is_wrong = truth.is_decidable & (is_dark != truth.in_shadow)
    if is_surface is not None:
        is_wrong |= truth.is_decidable & ~is_surface
    height, width = truth.is_surface.shape
    # Beyond the picture's edge is nothing known: it counts as surface.
    near = np.ones((height + 2, width + 2), bool)
    near[1:-1, 1:-1] = truth.is_surface
    is_near = np.zeros((height, width), bool)
    for row in range(3):
        for column in range(3):
            is_near |= near[row : row + height, column : column + width]
    return Comparison(
        n_surface=int(truth.is_surface.sum()),
        n_decidable=int(truth.is_decidable.sum()),
        differing=np.argwhere(is_wrong),
        n_shadow_in_sky=int((shown & ~is_near).sum()),
    )


def _checked_mask(truth: Truth, mask: U8) -> U8:
    """Return `mask`, or raise."""
    expected = truth.is_surface.shape
    if mask.shape != expected or mask.dtype != np.uint8:
        raise InputError(
            f"a mask of {mask.shape} {mask.dtype} cannot be compared with a view of "
            f"{expected}; expected (height, width) uint8 of the same camera"
        )
    other = np.setdiff1d(mask, [0, SHADOW])
    if len(other):
        raise InputError(
            f"a mask holds 255 (in shadow) and 0 (lit or background), and this one "
            f"{int(other[0])}; was it smoothed or compressed with losses?"
        )
    return mask


def difference_picture(truth: Truth, mask: U8) -> U8:
    """Return ``(height, width, 3) uint8``: where a mask differs from the truth.

    Light and dark grey what is lit and in shadow, as the truth has it; blue in them what is
    undecidable; differing pixels red, each in a yellow frame, since nobody sees a single one.

    Raises
    ------
    InputError
        As for `compare`.
    """
    wrong = compare(truth, mask).differing
    picture = np.empty((*truth.is_surface.shape, 3), np.uint8)
    picture[:] = SKY_COLOUR
    picture[truth.is_surface] = LIT_COLOUR
    picture[truth.in_shadow] = SHADOW_COLOUR
    is_open = truth.is_surface & ~truth.is_decidable
    picture[is_open] = (picture[is_open].astype(np.uint16) + np.array(TINT, np.uint16)) // 2
    height, width = truth.is_surface.shape
    for i in range(-MARKER_PX, MARKER_PX + 1):
        for away in ((-MARKER_PX, i), (MARKER_PX, i), (i, -MARKER_PX), (i, MARKER_PX)):
            row, column = (wrong + away).T
            is_in = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            picture[row[is_in], column[is_in]] = MARKER_COLOUR
    picture[wrong[:, 0], wrong[:, 1]] = WRONG_COLOUR
    return picture


def save_truth(path: str | os.PathLike[str], truth: Truth, key: str) -> None:
    """Write a truth as NPZ, whole or not at all.

    Parameters
    ----------
    key : str
        What it is of: whatever tells apart models, cameras and lights.

    Raises
    ------
    EnvironmentProblem
        The file cannot be written.
    """
    target = Path(path)
    stream = io.BytesIO()
    np.savez_compressed(
        stream,
        key=np.array(key),
        constants=np.array(JUDGE_CONSTANTS),
        in_shadow=truth.in_shadow,
        is_surface=truth.is_surface,
        is_decidable=truth.is_decidable,
        face=truth.face,
        overlap_names=np.array([one.names for one in truth.overlaps], np.str_).reshape(-1, 2),
        overlap_pixels=np.array([one.pixels for one in truth.overlaps], np.int64),
    )
    try:
        with Temporary(target) as new:
            new.write(memoryview(stream.getvalue()))
            new.sync()
            new.rename()
    except OSError as error:
        raise problem_of(error, target) from None


def load_truth(path: str | os.PathLike[str], key: str) -> Truth:
    """Return the truth that `save_truth` wrote with the same key.

    Raises
    ------
    InputError
        No such file, none of `save_truth`, another key, or of other constants.
    """
    try:
        # From memory: NumPy leaves a file that it cannot read open.
        with np.load(io.BytesIO(Path(path).read_bytes()), allow_pickle=False) as data:
            stored, constants = str(data["key"]), str(data["constants"])
            if stored != key:
                raise InputError(f'{path}: is of "{stored}", not of "{key}"; trace it again')
            if constants != JUDGE_CONSTANTS:
                raise InputError(f"{path}: was traced with other constants; trace it again")
            names, pixels = data["overlap_names"].tolist(), data["overlap_pixels"].tolist()
            return Truth(
                in_shadow=data["in_shadow"],
                is_surface=data["is_surface"],
                is_decidable=data["is_decidable"],
                face=data["face"],
                overlaps=tuple(
                    Overlap(names=(a, b), pixels=n) for (a, b), n in zip(names, pixels, strict=True)
                ),
            )
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as a judge's truth ({reason})") from None
