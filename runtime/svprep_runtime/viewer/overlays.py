"""What lies over the picture: its colours, its legend, and the words of each panel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from svprep_runtime.measure import PassFigures
from svprep_runtime.viewer.hud import AMBER, GREY, WHITE, Colour, Row
from svprep_runtime.viewer.keys import SHORT_HELP, help_rows

COUNT_COLOURS: Final[tuple[Colour, ...]] = (
    (46, 64, 120, 255),
    (36, 110, 178, 255),
    (34, 156, 160, 255),
    (72, 182, 98, 255),
    (170, 200, 60, 255),
    (240, 196, 50, 255),
    (238, 140, 44, 255),
    (214, 70, 50, 255),
)
"""Of 1, 2, ... volumes around a point; the last one of as many and more."""
NEGATIVE: Final[Colour] = (255, 0, 255, 255)
OUTLINE: Final = (1.0, 0.86, 0.2)
FRONT: Final = (0.95, 0.45, 0.15)
BACK: Final = (0.25, 0.35, 0.9)
NEAR_END: Final = (0.1, 0.85, 0.95)
FAR_END: Final = (0.95, 0.2, 0.75)
"""Colours as the screen shows them, red, green and blue from 0 to 1."""


def palette() -> list[tuple[float, float, float, float]]:
    """Return the colours of counts for the shader: of 1, 2, ..., and last of negative ones."""
    return [(r / 255, g / 255, b / 255, a / 255) for r, g, b, a in (*COUNT_COLOURS, NEGATIVE)]


def _colour(rgb: tuple[float, float, float]) -> Colour:
    return round(255 * rgb[0]), round(255 * rgb[1]), round(255 * rgb[2]), 255


def legend(shown: set[str], *, has_segments: bool, highest: int) -> list[Row]:
    """Return the legend of the overlays that are `shown`; empty if none needs one."""
    rows: list[Row] = []
    if "volumes" in shown:
        rows += [
            Row(("volumes, seen from outside",), swatch=_colour(FRONT)),
            Row(("volumes, seen from inside",), swatch=_colour(BACK)),
        ]
    if "silhouettes" in shown:
        rows.append(Row(("silhouette edges",), swatch=_colour(OUTLINE)))
    if "ends" in shown and has_segments:
        rows += [
            Row(("segments begin",), swatch=_colour(NEAR_END)),
            Row(("segments end",), swatch=_colour(FAR_END)),
        ]
    if "ends" in shown and not has_segments:
        rows.append(Row(("no segments: the cache has none for this light",), GREY))
    if "counts" in shown:
        rows.append(Row((f"volumes around a point (most: {highest})",), AMBER))
        last = len(COUNT_COLOURS)
        for n, colour in enumerate(COUNT_COLOURS, 1):
            rows.append(Row((f"{n}" if n < last else f"{n} and more",), swatch=colour))
        rows.append(Row(("below 0: never, in a closed volume",), swatch=NEGATIVE))
    return rows


def status(
    name: str,
    light_words: Sequence[Sequence[str]],
    selected: int,
    settings_words: str,
    message: str,
) -> list[Row]:
    """Return what stands at the top left: the model, the lights, how it is drawn."""
    rows = [Row((name,), GREY)]
    for i, words in enumerate(light_words):
        mark = f"{i + 1}{' *' if i == selected else ''}  " if len(light_words) > 1 else ""
        colour = WHITE if i == selected else GREY
        rows += [Row((f"{mark}{words[0]}",), colour), *(Row((w,), colour) for w in words[1:])]
    rows.append(Row((settings_words,), GREY))
    if message:
        rows.append(Row((message,), AMBER))
    return rows


def statistics(
    figures: Sequence[PassFigures], frames_s: float, frame_ms: float, negative: int, renderer: str
) -> list[Row]:
    """Return the table of passes."""
    rows = [
        Row((renderer,), GREY),
        Row((f"{frame_ms:,.1f} ms a frame, {frames_s:,.1f} frames/s",)),
        Row(("pass", "ms", "triangles", "samples"), AMBER),
    ]
    for f in figures:
        which = "" if f.light is None else f" {f.light + 1}"
        cells = (f"{f.name}{which}", f"{f.ms:,.2f}", f"{f.n_primitives:,}", f"{f.n_samples:,}")
        rows.append(Row(cells))
    total = (
        f"{sum(f.ms for f in figures):,.2f}",
        f"{sum(f.n_primitives for f in figures):,}",
        f"{sum(f.n_samples for f in figures):,}",
    )
    rows.append(Row(("all", *total)))
    words = "pixels with a negative count: "
    rows.append(Row((f"{words}{negative:,}",), AMBER if negative else GREY))
    return rows


def help_panel() -> list[Row]:
    """Return the help on screen."""
    return [Row(("svprep view",), AMBER), *(Row(cells) for cells in help_rows())]


def short_help() -> list[Row]:
    """Return the one line that stands below the picture at the start."""
    return [Row((SHORT_HELP,), GREY)]
