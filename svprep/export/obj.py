"""OBJ: an ``o`` statement per object, its vertices, its faces.

Numbers are the shortest that read back to the same float64. An ``o`` name is the object's
own where OBJ can say it. Where it cannot (line breaks, several blanks, nothing at all, the
name of an earlier object) the statement has a stand-in, and a comment at the head of the file
the name itself; types and parents stand there, too. Surfaces are not written.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from svprep.export.city import City, distinct
from svprep.export.header import TITLE, header_lines, line

HEAD: Final = f"# {TITLE.rpartition(' ')[0]}".encode()
_BLOCK: Final = 1 << 16
_RESERVED: Final = "default"
"""What OBJ calls the group that has no name."""


def written_names(names: tuple[str, ...]) -> list[str]:
    """Return a name for each ``o`` statement: all different, and read back as they are."""
    taken = set(names)
    written = []
    for i, name in enumerate(names):
        stand_in = f"object_{i}"
        while stand_in in taken:
            stand_in += "~"
        written.append(name if _survives(name) else stand_in)
    return distinct(written)


def _survives(name: str) -> bool:
    """Whether an ``o`` statement can say this name."""
    is_text = "\0" not in name and not any("\ud800" <= c <= "\udfff" for c in name)
    is_one_word_apart = " ".join(name.split()) == name and name not in ("", _RESERVED)
    # A backslash at the end of a line would join the next one to it.
    return is_text and is_one_word_apart and not name.endswith("\\")


def obj_parts(city: City) -> Iterator[bytes]:
    """Yield the file. About 1 us a face."""
    written = written_names(city.names)
    lines = list(header_lines(city))
    for o_name, name, kind, parent in zip(
        written, city.names, city.types, city.parents, strict=True
    ):
        if o_name != name or kind or parent:
            lines.append(line("object", [o_name, name, kind, parent]))
    yield "".join(f"# {text}\n" for text in lines).encode()
    # A coordinate occurs many times in a city: walls are upright, roofs level.
    numbers, which = np.unique(city.source_positions, return_inverse=True)
    text = np.array([repr(x) for x in numbers.tolist()], object)[which].reshape(-1, 3)
    ends = city.faces.astype(np.int64) + 1
    vertex_start, face_start = city.object_vertex_start, city.object_face_start
    for i, o_name in enumerate(written):
        yield f"o {o_name}\n".encode()
        yield from _rows("v %s %s %s\n", text[vertex_start[i] : vertex_start[i + 1]])
        yield from _rows("f %d %d %d\n", ends[face_start[i] : face_start[i + 1]])


def _rows(form: str, rows: NDArray[np.generic]) -> Iterator[bytes]:
    """Yield a line per row."""
    for begin in range(0, len(rows), _BLOCK):
        block = rows[begin : begin + _BLOCK]
        yield (form * len(block) % tuple(block.reshape(-1).tolist())).encode()
