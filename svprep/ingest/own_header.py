"""The comment lines at the head of svprep's own OBJ and PLY exports, read back.

`svprep.export.header` writes them and says what they are.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from svprep.errors import InputError
from svprep.ingest.parsed import shown

TITLE: Final = "svprep export "


@dataclass(frozen=True, slots=True)
class NamedObject:
    """What an export says of one object."""

    written: str
    """What the format calls it."""
    name: str
    type: str
    parent: str


@dataclass(frozen=True, slots=True)
class OwnHeader:
    """What an export says of itself."""

    crs: str
    objects: tuple[NamedObject, ...]
    surface_names: tuple[str, ...]


def parse_header(lines: Iterable[str], path: Path) -> OwnHeader | None:
    """Return what the comments at the head of a file say, if it is an export of svprep.

    Parameters
    ----------
    lines
        Comments without what makes them comments, the first one first.

    Raises
    ------
    InputError
        A line is not as it was written.
    """
    crs = ""
    objects: list[NamedObject] = []
    surfaces: list[str] = []
    for number, text in enumerate(lines):
        if number == 0:
            if not text.startswith(TITLE):
                return None
            continue
        key, _, value = text.partition(" ")
        if key not in ("crs", "object", "surface"):
            continue
        try:
            found: Any = json.loads(value)
            texts = found if isinstance(found, list) else [found]
            if len(texts) != (4 if key == "object" else 1):
                raise ValueError
            if not all(isinstance(t, str) for t in texts):
                raise ValueError
        except (ValueError, RecursionError):
            raise InputError(
                f'{path}: the comment "{shown(text)[:60]}" of this export of svprep is damaged; '
                "export it again, or remove all comments at the head of the file."
            ) from None
        if key == "crs":
            crs = texts[0]
        elif key == "object":
            objects.append(NamedObject(*texts))
        else:
            surfaces.append(texts[0])
    return OwnHeader(crs, tuple(objects), tuple(surfaces)) if lines else None
