"""One projected metric frame for all inputs, x to the east, y to the north, z up.

The first file that states a CRS decides. If that CRS measures the ground in metres there
(`frames.plane_problem`), it is the frame, and the positions that are in it stay as they are, bit
for bit. Degrees, feet, earth-centred positions, axes to the south or west, mirror images
and maps of another scale (Web Mercator shows Vienna half as large again) make no frame for
shadows: then it is a transverse Mercator projection on the datum of that CRS, true to scale
along its meridian through the middle of the data. The middle is rounded to 0.001 degrees,
so that equal data have equal frames.

      stated CRS      measures metres?     frame           positions
    ----------------------------------------------------------------------------------
      EPSG:28992      yes                  EPSG:28992      untouched
      EPSG:7415       yes                  EPSG:7415       untouched
      EPSG:6697       degrees              local           through pyproj, point by point
      none            -                    of the others   untouched; refused if it is local

Heights stay what their CRS says they are, in metres; ellipsoidal ones for an earth-centred
CRS. They are never moved from one level surface to another: that takes a model of the
geoid, which PROJ has not got without files from the network, and a city is as right on
either. Files whose levels differ get a note with a warning: one may float above the other.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from svprep.errors import InputError, first_few, require_extra
from svprep.ingest.crs_names import (
    AREA_SLACK_DEG,
    crs_of,
    degrees_outside,
    has_pyproj,
    horizontal,
    is_north_first,
    longitude_latitude,
    needs_swap,
    normalised_crs,
    proportional,
)
from svprep.ingest.frames import (
    ELLIPSOID,
    Frame,
    best_transformer,
    degrees_in_unit,
    geographic,
    height_factor,
    is_same_plane,
    level_of,
    local_frame,
    middle_of,
    name_of,
    plane_problem,
)
from svprep.ingest.parsed import ParsedFile, box_of_faces, is_used, shown
from svprep.model import F64, Place
from svprep.path_names import told_apart
from svprep.sun import Site, meridian_convergence_deg, place_of

if TYPE_CHECKING:
    from pyproj import CRS

__all__ = ["in_one_frame", "is_north_first", "needs_swap", "normalised_crs", "proportional"]

FARTHEST_OUTSIDE_DEG: Final = 20.0
"""A city this far outside of the area of its CRS is not there. Norway's far east is within 14
degrees of the UTM zone that the whole country uses."""

Keep = Callable[[ParsedFile], ParsedFile]

_BLOCK: Final = 1 << 17
# Degrees or earth-centred, as far as a code shows it: most of EPSG's stand between these.
_NO_PLANE: Final = re.compile(r"EPSG:(4[0-9]{3}|66(66|68)|6697|7844|7843|7842)(\+.*)?|OGC:.*")
_EARTH_M: Final = 6_371_000.0
_TOO_SLENDER: Final = 100.0
_UNKNOWN: Final = "is none that pyproj knows"
_NAME_IT: Final = "name it: --crs EPSG:..."


@dataclass(frozen=True, slots=True)
class _Input:
    """A file, and what it says about where it is."""

    parsed: ParsedFile
    file: Path
    label: str
    """What notes on other files call it."""
    crs: CRS | None = None
    """None: it states none, or none that can be used."""
    box: F64 | None = None
    """``(2, 3)``: lowest and highest position of a face's corner; None without faces."""
    problem: str = ""
    """Why the stated CRS cannot be used."""
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return shown(normalised_crs(self.parsed.crs))


def _as_it_is(parsed: ParsedFile) -> ParsedFile:
    return parsed


def in_one_frame(
    parsed: Sequence[ParsedFile], files: Sequence[Path], keep: Keep = _as_it_is
) -> tuple[list[ParsedFile], Place]:
    """Return the files with all positions in one metric frame, and where that is.

    Parameters
    ----------
    parsed : sequence of ParsedFile
        Positions in the units of the CRS that each file states: x to the east, y to the
        north, as pyproj orders them with ``always_xy``; earth-centred ones as they are.
    files : sequence of Path
        Their names, for messages.
    keep
        Puts away each file whose positions were converted, before the next one's are.

    Returns
    -------
    list of ParsedFile
        With positions in the frame, and notes on what was done. `ParsedFile.crs` stays
        what the file states.
    Place
        The frame's CRS, and the middle of all faces in WGS 84.

    Raises
    ------
    InputError
        A file's positions are out of reach of its CRS, or nothing says where it lies
        beside the others: names file and CRS.
    EnvironmentProblem
        pyproj is missing and positions have to be converted. Where they need not be, it
        is a note, and true north is unknown.

    Notes
    -----
    Nothing, not even an import, for files that state no CRS. About 1 us a point that is
    converted, in blocks. No file of PROJ's is fetched over the network.
    """
    if not any(p.crs.strip() for p in parsed):
        return list(parsed), Place()
    if not has_pyproj():
        return _without_pyproj(parsed, files)
    from pyproj.exceptions import ProjError

    try:
        return _with_pyproj(parsed, files, keep)
    except ProjError as error:
        stated = first_few(dict.fromkeys(shown(p.crs) for p in parsed if p.crs))
        raise InputError(
            f'{files[0]}: PROJ cannot convert positions from the CRS "{stated}": {shown(error)}'
        ) from None


def _with_pyproj(
    parsed: Sequence[ParsedFile], files: Sequence[Path], keep: Keep
) -> tuple[list[ParsedFile], Place]:
    """Return what `in_one_frame` does."""
    inputs = [
        _looked_at(p, file, label)
        for p, file, label in zip(parsed, files, told_apart(files), strict=True)
    ]
    first = next((i for i in inputs if i.crs is not None and i.box is not None), None)
    if first is None:
        _refuse_different([i for i in inputs if i.problem])
        return [_noted(i.parsed, i.notes) for i in inputs], Place()
    frame = _frame(first, inputs)
    moved = [keep(_moved(i, first, frame)) for i in inputs]
    boxes = np.stack([box for p in moved if (box := box_of_faces(p)) is not None])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    x, y, _ = (low / 2 + high / 2).tolist()
    site = Site(frame.name, x, y)
    try:
        latitude, longitude = place_of(site)
        place = Place(frame.name, latitude, longitude, meridian_convergence_deg(site))
    except InputError as error:
        raise InputError(f"{first.file}: {error}") from None
    return moved, place


def _looked_at(parsed: ParsedFile, file: Path, label: str) -> _Input:
    """Return what a file says of its CRS, checked against its positions."""
    box = box_of_faces(parsed)
    stated = parsed.crs.strip()
    if not stated:
        return _Input(parsed, file, label, box=box)
    crs = crs_of(stated)
    problem, notes = "", tuple[str, ...]()
    if crs is None:
        problem = _UNKNOWN
    elif not (crs.is_projected or crs.is_geographic or crs.is_geocentric):
        problem = "does not say where on Earth the model lies"
    elif box is not None:
        problem, notes = _checked(shown(stated), crs, box, file)
    if problem:
        notes = (
            f'the CRS "{shown(stated)}" {problem}: positions are kept as they are and taken '
            f"for metres, and true north is unknown{f'; {_NAME_IT}' * (problem == _UNKNOWN)}",
        )
        return _Input(parsed, file, label, None, box, problem, notes)
    return _Input(parsed, file, label, crs, box, notes=notes)


def _checked(stated: str, crs: CRS, box: F64, file: Path) -> tuple[str, tuple[str, ...]]:
    """Return why the CRS cannot be that of positions in `box`, and notes.

    Raises
    ------
    InputError
        The positions are meant to be somewhere on Earth, but not where this CRS reaches.
    """
    largest = np.abs(box[:, :2]).max(axis=0)
    if crs.is_geographic and (largest * degrees_in_unit(horizontal(crs)) > (360.0, 90.0)).any():
        raise InputError(
            f'{file}: the CRS "{stated}" counts in degrees, but positions reach '
            f"({largest[0]:.10g}, {largest[1]:.10g}). State the CRS of these positions."
        )
    is_small = crs.is_projected and bool((largest <= 180.0).all())
    middle = middle_of(horizontal(crs), box[None])
    at = longitude_latitude(crs, middle)
    outside = 180.0 if at is None else degrees_outside(crs, *at)
    if outside <= AREA_SLACK_DEG:
        return "", ()
    if is_small and _looks_like_degrees(box):
        raise InputError(
            f'{file}: the CRS "{stated}" counts in metres, but positions such as '
            f"({middle[0]:.10g}, {middle[1]:.10g}) look like degrees. State the CRS of these "
            "positions."
        )
    if is_small:
        return "does not reach these positions, which are near 0, 0", ()
    where = f"({', '.join(f'{c:.10g}' for c in middle[: 3 if crs.is_geocentric else 2])})"
    if outside > FARTHEST_OUTSIDE_DEG:
        raise InputError(
            f'{file}: the CRS "{stated}" does not reach its positions, such as {where}. '
            "State the CRS of these positions, with its axes in their order."
        )
    note = (
        f"the middle of the model, {where}, lies {outside:.0f} degrees outside of the area "
        f'that the CRS "{stated}" is meant for'
    )
    return "", (note,)


def _looks_like_degrees(box: F64) -> bool:
    """Whether it is less than a unit wide, and `_TOO_SLENDER` times as high."""
    wide, high = float(np.ptp(box[:, :2], axis=0).max()), float(np.ptp(box[:, 2]))
    return wide < 1.0 and high > _TOO_SLENDER * wide


def _refuse_different(unusable: Sequence[_Input]) -> None:
    """Raise `InputError` if files state different CRS of which none can be used."""
    for other in unusable[1:]:
        if other.name != unusable[0].name:
            raise InputError(
                f'{other.file}: its CRS "{other.name}" {other.problem}, so it has no place '
                f'beside {unusable[0].file}, in "{unusable[0].name}". Build the files apart, '
                "or state CRS that pyproj knows (--crs EPSG:... for those that it does not)."
            )


def _frame(first: _Input, inputs: Sequence[_Input]) -> Frame:
    """Return the frame that the first file with a CRS asks for."""
    assert first.crs is not None
    assert first.box is not None
    flat = horizontal(first.crs)
    if not plane_problem(flat, first.box):
        name = normalised_crs(first.parsed.crs)
        if height_factor(first.crs) != 1.0 or ("+" in name and not first.crs.is_compound):
            name = name_of(flat)
        elif not name.startswith("EPSG:"):
            name = name_of(first.crs)
        near = longitude_latitude(flat, middle_of(flat, first.box[None]))
        words = name if name.startswith("EPSG:") else f'"{shown(flat.name)}"'
        return Frame(name, words, flat, near, is_local=False)
    alike = [i.box for i in inputs if i.box is not None and i.crs and is_same_plane(flat, i.crs)]
    return local_frame(flat, np.stack(alike))


def _moved(each: _Input, first: _Input, frame: Frame) -> ParsedFile:
    """Return a file with its positions in the frame."""
    assert first.crs is not None
    if each.problem:
        name_it = f", or {_NAME_IT}" if each.problem == _UNKNOWN else ""
        raise InputError(
            f'{each.file}: its CRS "{each.name}" {each.problem}, so it has no place beside '
            f'{first.file}, in "{first.name}". Build it alone, or state the CRS of '
            f"its positions{name_it}."
        )
    if each.crs is None:
        if frame.is_local:
            raise InputError(
                f"{each.file} states no CRS, so it has no place beside {first.file}, whose "
                f'positions are converted from "{first.name}" to metres. Build it alone, or state '
                f"its CRS, or {_NAME_IT}."
            )
        note = f"no CRS is stated; taken to be in {frame.words}, as {first.label} is"
        return _noted(each.parsed, (note,))
    notes = [*each.notes, *_on_heights(each, first)]
    factor = height_factor(each.crs)
    if each.box is None:
        return _noted(each.parsed, notes)
    if not frame.is_local and is_same_plane(frame.flat, each.crs):
        if factor == 1.0:
            return _noted(each.parsed, notes)
        positions = each.parsed.positions * (1.0, 1.0, factor)
        notes.append(f"heights are turned into metres: 1 is {factor:.10g} m")
    else:
        positions, accuracy = _converted(each, frame)
        notes.append(_on_conversion(each, frame, positions, factor, accuracy))
    return _noted(replace(each.parsed, positions=positions), notes)


def _converted(each: _Input, frame: Frame) -> tuple[F64, str]:
    """Return the positions in the frame, and how accurate the change of datum is."""
    assert each.crs is not None
    assert each.box is not None
    flat = horizontal(each.crs)
    steps = [(flat, frame.flat)]
    if flat.is_geocentric:
        steps = [(flat, geographic(flat)), (geographic(flat).to_2d(), frame.flat)]
    chain = [best_transformer(*step, frame.near) for step in steps]
    positions = np.array(each.parsed.positions, np.float64, order="C")
    if not flat.is_geocentric:
        positions[:, 2] *= height_factor(each.crs)
    for transformer, _ in chain:
        n = 3 if transformer.source_crs is not None and transformer.source_crs.is_geocentric else 2
        for begin in range(0, len(positions), _BLOCK):
            block = positions[begin : begin + _BLOCK]
            for axis, values in enumerate(transformer.transform(*block[:, :n].T)):
                block[:, axis] = values
    is_bad = ~np.isfinite(positions).all(axis=1)
    if is_bad.any():
        bad = np.flatnonzero(is_bad & is_used(each.parsed))
        if bad.size:
            at = ", ".join(f"{c:.10g}" for c in each.parsed.positions[bad[0]])
            raise InputError(
                f'{each.file}: the CRS "{each.name}" does not reach {bad.size} of its vertices, '
                f"the first ({at}). Mend or remove them, or state the CRS of these positions."
            )
        positions[is_bad] = 0.0  # of no face
    return positions, chain[-1][1]


def _on_conversion(each: _Input, frame: Frame, positions: F64, factor: float, accuracy: str) -> str:
    """Return the note on what was done to positions."""
    assert each.crs is not None
    assert each.box is not None
    flat = horizontal(each.crs)
    heights = "heights above the ellipsoid" if flat.is_geocentric else "heights kept"
    if factor != 1.0:
        heights = f"heights turned into metres: 1 is {factor:.10g} m"
    precision = ""
    if frame.is_local:
        far = float(np.abs(positions[is_used(each.parsed), 0]).max())
        precision = f", lengths off by at most {1e6 * far**2 / (2 * _EARTH_M**2):.2g} mm in a km"
    why = plane_problem(flat, each.box)
    return (
        f"positions converted from {each.name}{f' ({why})' if why else ''} to {frame.words}"
        f"{precision}; {heights}{accuracy}"
    )


def _on_heights(each: _Input, first: _Input) -> list[str]:
    """Return the note that heights count from different levels."""
    assert each.crs is not None
    assert first.crs is not None
    own, others = level_of(each.crs), level_of(first.crs)
    if not own or not others or own == others:
        return []
    # Between a geoid and an ellipsoid lie up to a hundred metres, between two geoids far less.
    is_far = (own + others).count(ELLIPSOID) == 1
    return [
        f"warning: heights are not brought together: these count from {own}, those of "
        f"{first.label} from {others}{', which may differ by tens of metres' if is_far else ''}"
    ]


def _noted(parsed: ParsedFile, notes: Sequence[str]) -> ParsedFile:
    return replace(parsed, notes=(*parsed.notes, *notes)) if notes else parsed


def _without_pyproj(
    parsed: Sequence[ParsedFile], files: Sequence[Path]
) -> tuple[list[ParsedFile], Place]:
    """Return the files as they are, if nothing tells that they need a conversion.

    Raises
    ------
    EnvironmentProblem
        Positions are, or look like, degrees, or are earth-centred, or of several CRS.
    """
    names = [normalised_crs(p.crs) for p in parsed]
    stated = list(dict.fromkeys(filter(None, names)))
    if len(stated) > 1:
        raise require_extra(
            "pyproj", "formats", f"a frame for inputs in {first_few(map(shown, stated))}"
        )
    for p, file, name in zip(parsed, files, names, strict=True):
        box = box_of_faces(p)
        is_plane = not _NO_PLANE.fullmatch(name)
        if box is None or not name:
            continue
        if not is_plane or bool((np.abs(box[:, :2]) <= (180.0, 90.0)).all()):
            raise require_extra("pyproj", "formats", f'{file}: the CRS "{shown(name)}"')
    note = (
        "pyproj is not installed, so positions are taken for metres in the CRS "
        f'"{shown(stated[0])}" as they are, and true north is unknown '
        "(pip install 'svprep[formats]')"
    )
    done = [_noted(p, (note,)) if name else p for p, name in zip(parsed, names, strict=True)]
    return done, Place(stated[0])
