"""Which level of detail each object of a city file contributes.

City formats store an object at several levels of detail (LoD) side by side; to build two
of them is to build every wall twice. Names of levels are texts (``"1"``, ``"2.2"``) that
compare as numbers: ``"10"`` is above ``"2"``, and ``"2.0"`` is ``"2"``.

A *family* is an object with its parts, and theirs: the descendants of a type that ends in
``Part``. What hangs below a family otherwise (an installation, a room, furniture) is one
for itself.

With ``highest``, a family takes the highest level that any member has:

    Building        1, 2        2.2 is the highest of the family: both parts are built
      BuildingPart  1, 2.2      at 2.2, and the outline of the whole building at LoD 2,
      BuildingPart  2.2         which would double them, is not

A member without that level contributes its own highest one, if none of its ancestors and
descendants in the family contributes a higher: then nothing else stands where it does.
A family below another takes the level of that one if it has it, else its own highest.
LoD 0, a footprint, is never taken unless it is named; of terrain, water and roads it is the
ground itself, and taken where there is no higher one.

With a name L, an object contributes level L; where it has none and L is a whole number, the
highest of its L.x. So ``2`` takes LoD 2.2 of 3DBAG, and ``2.2`` takes LoD 2.2 alone. Of a
family, what would double a higher one is left out here too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from svprep.errors import InputError, first_few
from svprep.ingest.options import HIGHEST
from svprep.ingest.parsed import count_of, shown
from svprep.model import I64

_LEVEL: Final = re.compile(r"(?:lod)?\s*(\d+(?:\.\d+)?)", re.IGNORECASE | re.ASCII)
_UNSTATED: Final = -1.0  # below every level that is stated
_SHOWN: Final = 3  # ids in a note
_GROUND: Final = frozenset(
    {"landuse", "road", "railway", "square", "track", "transportsquare", "transportationcomplex"}
    | {"waterbody", "waterway"}
)


@dataclass(frozen=True, slots=True)
class LodChoice:
    """What `choose_lods` returns."""

    lods: tuple[str | None, ...]
    """Per object the name of the level that it contributes, as the file writes it; None if
    it contributes nothing."""
    only_footprint: I64
    """Objects left out because LoD 0 is all that they have."""
    without_level: I64
    """Objects with geometry, but not at the level that was asked for."""
    n_doubled: int
    """Objects left out because their ancestors or descendants hold the family's level."""
    cut_parents: I64
    """Objects whose parent was ignored, because they are among their own ancestors."""

    def notes(self, names: Sequence[str], lod: str) -> tuple[str, ...]:
        """Return a line on each kind of object that was left out."""

        def some(objects: I64) -> str:
            return first_few((shown(names[i]) for i in objects.tolist()), _SHOWN)

        notes = []
        if self.only_footprint.size:
            n = count_of(self.only_footprint.size, "object")
            notes.append(
                f"{n} with LoD 0 (a footprint) only left out: {some(self.only_footprint)}; "
                "--lod 0 takes footprints"
            )
        if self.without_level.size:
            n = count_of(self.without_level.size, "object")
            notes.append(f"{n} without LoD {shown(lod)} left out: {some(self.without_level)}")
        if self.n_doubled:
            n = count_of(self.n_doubled, "object")
            notes.append(
                f"{n} at a lower LoD left out, whose parts or wholes are there at a higher"
            )
        if self.cut_parents.size:
            n = count_of(self.cut_parents.size, "object")
            notes.append(f"{n} that are their own ancestors: {some(self.cut_parents)}")
        return tuple(notes)


def choose_lods(
    parents: Sequence[int],
    types: Sequence[str],
    lods: Sequence[Sequence[str]],
    lod: str,
    path: Path,
) -> LodChoice:
    """Choose the level of detail that each object contributes.

    Parameters
    ----------
    parents
        Per object the index of the object that it belongs to, or -1. A cycle is cut.
    types
        ``"BuildingPart"``: what ends in ``Part`` is of one family with its parent.
    lods
        Per object the levels of its geometries, in any order, repeated or not; ``""`` is a
        geometry that states none, and stands below LoD 0 of the same family.
    lod
        ``"highest"``, or the name of a level.
    path
        For messages.

    Raises
    ------
    InputError
        If no object has the level that was asked for, or `lod` names none.

    Notes
    -----
    O(n) and a sort of the levels, whatever the depth.
    """
    wanted = lod if lod == HIGHEST else _wanted(lod)
    parent, cut = _without_cycles(parents)
    numbers = [{number_of(name): name for name in reversed(names)} for names in lods]
    if wanted != HIGHEST:
        return _named(numbers, _families(parent, types), lod, cut, path)
    least = [0.0 if is_ground(kind) else 1.0 for kind in types]
    return _highest(numbers, least, parent, _families(parent, types), cut)


def _families(parent: list[int], types: Sequence[str]) -> list[int]:
    """Return per object its parent within its family, or -1."""
    return [p if kind.endswith("Part") else -1 for p, kind in zip(parent, types, strict=True)]


def _wanted(lod: str) -> str:
    """Return `lod`; raise `InputError` where it is no name of a level."""
    if number_of(lod) < 0:
        raise InputError(
            f'--lod {shown(lod)} names no level of detail; it takes "highest" or a level such as '
            "1, 2 or 2.2."
        )
    return lod


def is_ground(kind: str) -> bool:
    """Whether surfaces of this type are the ground, at LoD 0 too."""
    kind = kind.casefold().lstrip("+")
    return kind in _GROUND or kind.endswith(("relief", "relieffeature"))


def number_of(name: str) -> float:
    """Return a level such as ``2.2`` or ``LOD2`` as a number, -1 where it states none."""
    found = _LEVEL.fullmatch(name.strip())
    number = float(found[1]) if found else _UNSTATED
    return number if number < 1000 else _UNSTATED


def _without_cycles(parents: Sequence[int]) -> tuple[list[int], I64]:
    """Return the parents, -1 for one object of each cycle, and those objects."""
    parent = list(parents)
    state = bytearray(len(parent))  # 0 unseen, 1 on this walk, 2 done
    cut = []
    for start in range(len(parent)):
        walk, i = [], start
        while i >= 0 and state[i] == 0:
            state[i] = 1
            walk.append(i)
            i = parent[i]
        if i >= 0 and state[i] == 1:
            parent[i] = -1
            cut.append(i)
        for j in walk:
            state[j] = 2
    return parent, np.array(sorted(cut), np.int64)


def _named(
    numbers: list[dict[float, str]], in_family: list[int], lod: str, cut: I64, path: Path
) -> LodChoice:
    """Choose the level that was asked for."""
    wanted = number_of(lod)
    above = wanted + 1 if wanted == int(wanted) else wanted
    own = [
        wanted if wanted in levels else max((n for n in levels if wanted < n < above), default=None)
        for levels in numbers
    ]
    without = [i for i, level in enumerate(own) if level is None and numbers[i]]
    if without and all(level is None for level in own):
        known = sorted({number for levels in numbers for number in levels})
        names = [f"{number:g}" if number >= 0 else "not stated" for number in known]
        raise InputError(
            f"{path}: no object has LoD {shown(lod)}; the levels in this file: "
            f"{first_few(names, 20)}."
        )
    nothing = np.empty(0, np.int64)
    return _chosen(numbers, own, in_family, nothing, np.array(without, np.int64), cut)


def _chosen(
    numbers: list[dict[float, str]],
    own: list[float | None],
    in_family: list[int],
    only_footprint: I64,
    without_level: I64,
    cut: I64,
) -> LodChoice:
    """Choose the objects' own levels, but of a family nothing twice."""
    is_chosen = _not_doubled(own, in_family)
    lods = [
        numbers[i][level] if level is not None and is_chosen[i] else None
        for i, level in enumerate(own)
    ]
    n_doubled = sum(level is not None for level in own) - sum(is_chosen)
    return LodChoice(tuple(lods), only_footprint, without_level, n_doubled, cut)


def _highest(
    numbers: list[dict[float, str]],
    least: list[float],
    parent: list[int],
    in_family: list[int],
    cut: I64,
) -> LodChoice:
    """Choose the highest level of each family."""
    order = _downwards(parent)
    root = list(range(len(parent)))
    members: dict[int, list[int]] = {}
    for i in order:
        if in_family[i] >= 0:
            root[i] = root[in_family[i]]
        members.setdefault(root[i], []).append(i)

    own: list[float | None] = [None] * len(parent)
    level_of_family: dict[int, float | None] = {}
    for head, family in members.items():
        whole = level_of_family[root[parent[head]]] if parent[head] >= 0 else None
        has_whole = whole is not None and any(whole in numbers[i] for i in family)
        for i in family:
            own[i] = _own_level(numbers[i], least[i], whole if has_whole else None)
        level_of_family[head] = max((n for i in family if (n := own[i]) is not None), default=None)

    footprints = [i for i, level in enumerate(own) if level is None and numbers[i]]
    nothing = np.empty(0, np.int64)
    return _chosen(numbers, own, in_family, np.array(footprints, np.int64), nothing, cut)


def _own_level(levels: dict[float, str], least: float, most: float | None) -> float | None:
    """Return the highest level from `least` on, up to `most` if there is one."""
    solid = [level for level in levels if level >= least or level == _UNSTATED]
    up_to = solid if most is None else [level for level in solid if level <= most]
    return max(up_to or solid, default=None)


def _not_doubled(own: list[float | None], parent: list[int]) -> list[bool]:
    """Return which objects contribute their own level.

    From the highest level down: those that have no ancestor and no descendant which
    contributes a higher one.
    """
    children: dict[int, list[int]] = {}
    for i, p in enumerate(parent):
        children.setdefault(p, []).append(i)
    by_level: dict[float, list[int]] = {}
    for i, level in enumerate(own):
        if level is not None:
            by_level.setdefault(level, []).append(i)
    is_chosen = [False] * len(own)
    is_above, is_below = [False] * len(own), [False] * len(own)  # something that contributes
    for level in sorted(by_level, reverse=True):
        chosen = [i for i in by_level[level] if not (is_above[i] or is_below[i])]
        for i in chosen:
            is_chosen[i] = True
            p = parent[i]
            while p >= 0 and not is_above[p]:
                is_above[p] = True
                p = parent[p]
            below = children.get(i, [])[:]
            while below:
                j = below.pop()
                if not is_below[j]:
                    is_below[j] = True
                    below += children.get(j, [])
    return is_chosen


def _downwards(parent: list[int]) -> list[int]:
    """Return all objects, each behind its parent."""
    children: dict[int, list[int]] = {}
    for i, p in enumerate(parent):
        children.setdefault(p, []).append(i)
    order = children.get(-1, [])
    for i in order:  # grows while it is walked
        order += children.get(i, [])
    return order
