"""What files are called beside each other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from os import PathLike
from pathlib import Path


def told_apart(paths: Sequence[str | PathLike[str]]) -> tuple[str, ...]:
    """Return the shortest end of each path that no other one has: names, where those differ.

    ``x/a/city.gml`` beside ``x/b/city.gml`` is ``a/city.gml``. Equal paths stay equal.
    O(n) for paths of a bounded depth.
    """
    parts = [Path(path).parts or (str(path),) for path in paths]
    n_parts = [1] * len(parts)
    while True:
        ends = [p[-n:] for p, n in zip(parts, n_parts, strict=True)]
        times = Counter(ends)
        longer = [i for i, end in enumerate(ends) if times[end] > 1 and n_parts[i] < len(parts[i])]
        if not longer:
            return tuple(str(Path(*end)) for end in ends)
        for i in longer:
            n_parts[i] += 1
