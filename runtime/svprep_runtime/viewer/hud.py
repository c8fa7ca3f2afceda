"""Texts and legends as pictures, by Pillow and its own font: no font file is needed.

A panel is rows of cells in columns, on a dark plate; one pixel of it is one pixel of the
window, so that it stays crisp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from svprep.errors import require_extra
from svprep.model import U8

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont, ImageFont

TEXT_PX: Final = 14
PLATE: Final = (14, 18, 26, 222)
WHITE: Final = (240, 244, 250, 255)
GREY: Final = (168, 178, 194, 255)
AMBER: Final = (255, 205, 96, 255)
Colour = tuple[int, int, int, int]
_PAD: Final = 9
_GAP: Final = 20
# Signs that Pillow's own font has not.
_PLAIN: Final = str.maketrans({"×": "x", "−": "-", "–": "-", "→": ">", "≥": ">", "\t": " "})


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a panel."""

    cells: tuple[str, ...]
    """One a column; a single one may be as long as the panel."""
    colour: Colour = WHITE
    swatch: Colour | None = None
    """A filled square before it."""


@lru_cache(maxsize=8)
def font(size_px: int) -> FreeTypeFont | ImageFont:
    """Return Pillow's own font.

    Raises
    ------
    EnvironmentProblem
        Pillow is missing.
    """
    try:
        from PIL import ImageFont
    except ImportError:
        raise require_extra("Pillow", "view", "text in the viewer") from None
    return ImageFont.load_default(size_px)


def panel(
    rows: Sequence[Row], *, scale: float = 1.0, most_px: int = 4096, numbers_right: bool = False
) -> U8:
    """Return ``(height, width, 4) uint8``: rows of text on a plate, the top row first.

    Parameters
    ----------
    rows : sequence of Row
        At least one.
    scale : float
        Pixels of the window's buffer for one of the screen.
    most_px : int
        Wider pictures are cut.
    numbers_right : bool
        Columns after the first end at the same place instead of beginning there.
    """
    from PIL import Image, ImageDraw

    face = font(max(round(TEXT_PX * scale), 6))
    pad, gap, line = (round(n * scale) for n in (_PAD, _GAP, TEXT_PX * 1.45))
    texts = [tuple(cell.translate(_PLAIN) for cell in row.cells) for row in rows]
    columns = max(len(cells) for cells in texts)
    widths = [0] * columns
    for cells in texts:
        if len(cells) > 1:
            for i, cell in enumerate(cells):
                widths[i] = max(widths[i], round(face.getlength(cell)))
    starts = [sum(widths[:i]) + gap * i for i in range(columns)]
    indent = line if any(row.swatch for row in rows) else 0
    table = starts[-1] + widths[-1]
    alone = max((round(face.getlength(c[0])) for c in texts if len(c) == 1), default=0)
    width = min(max(table, alone) + indent + 2 * pad, most_px)
    height = line * len(rows) + 2 * pad - round(0.25 * line)
    image = Image.new("RGBA", (width, height), (*PLATE[:3], 0))
    draw = ImageDraw.Draw(image)
    draw.rounded_rectangle((0, 0, width - 1, height - 1), radius=round(6 * scale), fill=PLATE)
    for nth, (row, cells) in enumerate(zip(rows, texts, strict=True)):
        y = pad + nth * line
        if row.swatch:
            side = round(0.7 * line)
            draw.rectangle((pad, y, pad + side, y + side), fill=row.swatch)
        for i, cell in enumerate(cells):
            # Cells after the first are numbers or words: the colour tells them apart.
            fill = row.colour if i == 0 or row.colour != WHITE else GREY
            x = pad + indent + starts[i]
            if numbers_right and i > 0:
                x += widths[i] - round(face.getlength(cell))
            draw.text((x, y - round(0.1 * line)), cell, fill=fill, font=face)
    return np.asarray(image, np.uint8)
