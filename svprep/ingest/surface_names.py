"""What polygons are called, as numbers of one byte."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

MOST: Final = 256
_OTHER: Final = "other"


@dataclass(slots=True)
class SurfaceNames:
    """Names of surfaces, numbered as they come; 0 is ``""``, not stated.

    If there are more than `MOST`, the last number is shared by all the rest, as ``"other"``.
    """

    _number: dict[str, int] = field(default_factory=lambda: {"": 0})
    _has_more: bool = False

    def number_of(self, name: str) -> int:
        """Return the number of a name."""
        found = self._number.get(name)
        if found is None:
            found = min(len(self._number), MOST - 1)
            if len(self._number) < MOST:
                self._number[name] = found
            else:
                self._has_more = True
        return found

    def names(self) -> tuple[str, ...]:
        """Return all names by number."""
        names = tuple(self._number)
        return (*names[:-1], _OTHER) if self._has_more else names
