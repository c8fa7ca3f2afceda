"""Notes of many files: what is the same of each is said once."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from svprep.ingest.parsed import encodable

_COUNT: Final = re.compile(r"([0-9]+) (.*)", re.DOTALL)
_EXAMPLES: Final = re.compile(r" \([^()]*\)")


def merged_notes(notes: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Return ``"NAME: note"``, and ``"9 files: note"`` for a note that several files share.

    Notes that begin with a count and go on alike are one, which sums the counts and has the
    examples (in brackets) of the first; other notes are one only if they are equal.

    Parameters
    ----------
    notes : iterable of (str, str)
        Name of a file, and a note of it.
    """
    groups: dict[str, list[tuple[str, str]]] = {}
    for name, note in notes:
        counted = _COUNT.fullmatch(note)
        key = f"# {_EXAMPLES.sub('', counted[2])}" if counted else note
        groups.setdefault(key, []).append((name, note))
    return tuple(encodable(_merged(group)) for group in groups.values())


def _merged(group: list[tuple[str, str]]) -> str:
    name, note = group[0]
    if len(group) == 1:
        return f"{name}: {note}"
    where = f"{len({name for name, _ in group})} files ({name}, ...)"
    counted = [found for _, text in group if (found := _COUNT.fullmatch(text))]
    if not counted:
        return f"{where}: {note}"
    total = sum(int(found[1]) for found in counted)
    rest = {found[2] for found in counted}
    text = counted[0][2] if len(rest) == 1 else _EXAMPLES.sub(_as_first, counted[0][2])
    return f"{where}: {total} {text}"


def _as_first(found: re.Match[str]) -> str:
    return f" (first: {found[0][2:]}"
