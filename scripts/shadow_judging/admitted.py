"""How many pixels may differ, a dataset: numbers that only go down."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

HEAD = """\
# Pixels that are decidable and yet differ from ray tracing, a dataset: each pixel of a view and
# a light once, in however many ways of drawing it differs. More fail scripts/judge_shadows.py,
# which writes this file with --admit; it lowers numbers and adds datasets, and never raises one.
"""


def load(path: Path) -> dict[str, dict[str, int]]:
    """Return what is admitted: per mode (such as ``1280x1024``) and dataset."""
    if not path.exists():
        return {}
    return tomllib.loads(path.read_text(encoding="utf-8"))


def exceeded(admitted: Mapping[str, int], seen: Mapping[str, int]) -> dict[str, tuple[int, int]]:
    """Return ``(seen, admitted)`` of the datasets in which more differ than may."""
    pairs = {name: (n, admitted.get(name, 0)) for name, n in seen.items()}
    return {name: pair for name, pair in pairs.items() if pair[0] > pair[1]}


def lowered(
    admitted: Mapping[str, Mapping[str, int]], mode: str, seen: Mapping[str, int]
) -> dict[str, dict[str, int]]:
    """Return what is admitted from now on."""
    new = {name: dict(counts) for name, counts in admitted.items()}
    of_mode = new.setdefault(mode, {})
    for name, n in seen.items():
        of_mode[name] = min(n, of_mode.get(name, n))
    return new


def text(admitted: Mapping[str, Mapping[str, int]]) -> str:
    """Return the file's content."""
    lines = [HEAD]
    for mode in sorted(admitted):
        lines.append(f'["{mode}"]')
        lines += [f'"{name}" = {n}' for name, n in sorted(admitted[mode].items())]
        lines.append("")
    return "\n".join(lines)
