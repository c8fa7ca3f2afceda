"""The kinds of surface that sun hours tell apart."""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class Kind(IntEnum):
    """What a face is. The numbers stand in PLY files."""

    ROOF = 0
    WALL = 1
    GROUND = 2
    UNDERSIDE = 3


LEVEL: Final = 0.5
"""A face is level from this |nz| of its unit normal on, else steep: 60 degrees."""
