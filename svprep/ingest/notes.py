"""Notes of many files: what is the same of each is said once."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from typing import Final

from svprep.ingest.parsed import encodable

_COUNT: Final = re.compile(r"([0-9]+) (.*)", re.DOTALL)
_EXAMPLES: Final = re.compile(r" \(([^()]*)\)")
_LEFT_OUT: Final = "left out by --"
_SHARE: Final = re.compile(r"(.*\S) ([0-9]+)", re.DOTALL)
_CUT_BREAKDOWN: Final = re.compile(r" \((?:[^()]* [0-9]+, )+\.\.\. \([0-9]+\)\)")


def merged_notes(notes: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Return ``"NAME: note"``, and ``"9 files: note"`` for a note that several files share.

    Notes that begin with a count and go on alike are one, which sums the counts. What stands
    in brackets is summed too if it is a breakdown ("Window 2, Door 1"), left out if that is
    cut short; else it is the examples of the first. Other notes are one only if they are equal.

    Parameters
    ----------
    notes : iterable of (str, str)
        Name of a file, and a note of it.
    """
    groups: dict[str, list[tuple[str, str]]] = {}
    for name, note in notes:
        counted = _COUNT.fullmatch(note)
        key = f"# {_without_brackets(counted[2])}" if counted else note
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
    counts = [(int(found[1]), found[2]) for found in counted]
    return f"{where}: {sum(n for n, _ in counts)} {_summed(counts)}"


def _without_brackets(text: str) -> str:
    return _EXAMPLES.sub("", _CUT_BREAKDOWN.sub("", text))


def _summed(notes: list[tuple[int, str]]) -> str:
    """Return what stands behind the sum of counts of notes that are alike but for brackets."""
    first = notes[0][1]
    shares = [_shares_of(n, text) for n, text in notes]
    if all(shares):
        counts: Counter[str] = Counter()
        for of_note in shares:
            counts.update(of_note)
        ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
        summed = ", ".join(f"{name} {n}" for name, n in ordered)
        return _EXAMPLES.sub(lambda found: f" ({summed})", first)
    if any(_CUT_BREAKDOWN.search(text) for _, text in notes):
        return _without_brackets(first)
    if len({text for _, text in notes}) == 1:
        return first
    if any(shares):
        return _without_brackets(first)
    return _EXAMPLES.sub(lambda found: f" (first: {found[1]})", first)


def _shares_of(n: int, text: str) -> dict[str, int]:
    """Return the breakdown of the count `n` in the brackets of a note; nothing if there is none.

    Only what an option left out has one: elsewhere a number in brackets may be one of a line.
    """
    if _LEFT_OUT not in text:
        return {}
    brackets = _EXAMPLES.findall(text)
    found = [_SHARE.fullmatch(share) for share in brackets[0].split(", ")] if brackets else []
    shares = {share[1]: int(share[2]) for share in found if share}
    is_breakdown = len(brackets) == 1 and len(shares) == len(found) and sum(shares.values()) == n
    return shares if is_breakdown else {}
