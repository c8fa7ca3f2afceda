"""The text of a CityJSON file: which member stands where, and a member at a time as a tree."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from svprep.errors import InputError
from svprep.ingest.parsed import count_of, shown
from svprep.kernels import json_text
from svprep.model import F64, I64, U8

BATCH_BYTES: Final = 1 << 20
"""Of text that is made a tree at a time."""

_NUMBER: Final = re.compile(rb"-?(0|[1-9][0-9]*)(\.[0-9]+)?([eE][+-]?[0-9]+)?")
_UNREAD_NAMES: Final = (
    "attributes",
    "generic-attributes",
    "geographicalExtent",
    "address",
    "material",
    "texture",
)
"""Of objects and of geometries: more than half the text of many a file."""
_UNREAD: Final = np.zeros((len(_UNREAD_NAMES), 24), np.uint8)
for _row, _name in zip(_UNREAD, _UNREAD_NAMES, strict=True):
    _row[: len(_name) + 1] = [len(_name), *_name.encode()]
_LEAST_VERTEX_BYTES: Final = 7  # "[0,0,0]"

Span = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Text:
    """A JSON text and the file that it is from."""

    data: U8
    """``(n_bytes + 1,)``, a line feed behind the text."""
    path: Path

    def begin(self) -> int:
        """Return where the text begins: behind a byte order mark."""
        head = self.data[:3].tobytes()
        if head.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise InputError(f"{self.path}: this is UTF-16 text; save it as UTF-8.")
        return 3 if head == b"\xef\xbb\xbf" else 0

    def skip_blanks(self, pos: int) -> int:
        """Return the first byte from `pos` on that is no white space, or the end."""
        while pos < self.data.size and self.data[pos] in b" \t\r\n":
            pos += 1
        return pos

    def members(self, begin: int, end: int, what: str) -> tuple[I64, int]:
        """Return the spans of the members of an object, and where it ends."""
        spans, status, pos = json_text.object_members(self.data, begin, end)
        if status:
            raise self._problem(status, pos, what)
        return spans, pos

    def by_name(self, spans: I64, what: str) -> dict[str, Span]:
        """Return where the value of each member stands."""
        found: dict[str, Span] = {}
        for key_begin, key_end, begin, end in spans.tolist():
            name = self.tree((key_begin, key_end), what)
            if name in found:
                raise InputError(f'{self.path}: {what} has "{shown(name)}" twice; remove one.')
            found[name] = (begin, end)
        return found

    def tree(self, span: Span, what: str) -> Any:
        """Return a value as Python objects."""
        return self._parsed(self.data[span[0] : span[1]].tobytes(), what)

    def objects(self, spans: I64, kind: str) -> Iterator[tuple[list[tuple[str, Any]], int]]:
        """Yield the city objects with their names, in batches, and where each batch ends.

        Without what nobody reads. A name that comes twice comes twice here, too.
        """
        ends = spans[:, 3]
        row = 0
        while row < len(spans):
            stop = int(np.searchsorted(ends, spans[row, 0] + BATCH_BYTES, "right"))
            stop = max(stop, row + 1)
            out = np.empty(ends[stop - 1] - spans[row, 0], np.uint8)
            n = json_text.without_members(self.data, spans[row, 0], ends[stop - 1], _UNREAD, out)
            try:
                batch = self._parsed(b"{" + out[:n].tobytes() + b"}", kind)
            except InputError:
                batch = {}
            if len(batch) == stop - row:
                yield list(batch.items()), int(ends[stop - 1])
            else:
                yield list(self._one_by_one(spans[row:stop], kind)), int(ends[stop - 1])
            row = stop

    def _one_by_one(self, spans: I64, kind: str) -> Iterator[tuple[str, Any]]:
        """Yield members; the first that cannot be read is named."""
        for key_begin, key_end, begin, end in spans.tolist():
            name = self.tree((key_begin, key_end), f"the name of an {kind}")
            yield name, self.tree((begin, end), f'{kind} "{shown(name)}"')

    def _parsed(self, text: bytes, what: str) -> Any:
        try:
            return json.loads(text.decode("utf-8"))
        except UnicodeDecodeError:
            raise InputError(
                f"{self.path}: {what}: this is not UTF-8 text; save it as UTF-8."
            ) from None
        except ValueError as error:
            raise InputError(f"{self.path}: {what}: no readable JSON ({shown(error)}).") from None
        except RecursionError:
            raise InputError(f"{self.path}: {what}: the JSON is nested too deeply.") from None

    def vertices(self, span: Span, what: str) -> F64:
        """Return an array of vertices, ``(n, 3)``."""
        begin, end = span
        xyz = np.empty(
            3 * ((end - begin) // _LEAST_VERTEX_BYTES + 1)
        )  # untouched pages cost nothing
        n, deferred, status, pos = json_text.parse_vertices(self.data, begin, end, xyz)
        if status:
            raise self._problem(status, pos, f"{what}: vertex {n // 3}: three numbers are needed")
        for slot, first, last in deferred.tolist():
            token = self.data[first:last].tobytes()
            value = float(token) if _NUMBER.fullmatch(token) else float("nan")
            if value - value != 0.0:
                text = shown(token.decode("utf-8", "replace"))
                raise InputError(
                    f'{self.path}: {what}: "{text}" in vertex {slot // 3} is not a finite number; '
                    "remove or repair it."
                )
            xyz[slot] = value
        return xyz[:n].reshape(-1, 3)

    def _problem(self, status: int, pos: int, what: str) -> InputError:
        """Say what stopped a kernel."""
        if status == json_text.CUT_OFF:
            n = count_of(self.data.size - 1, "byte")
            return InputError(
                f"{self.path}: {what}: the text ends in the middle of it (after {n}); the file is "
                "incomplete. Copy or download it again."
            )
        found = shown(self.data[pos : pos + 20].tobytes().decode("utf-8", "replace"))
        return InputError(
            f"{self.path}: {what}: no readable JSON; byte {pos} begins {json.dumps(found)}."
        )
