"""The stored tables as the checks see them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svprep.cache.checks import Problem
from svprep.model import I64, U32


@dataclass(frozen=True, slots=True)
class Tables:
    """The whole datasets of a file, as stored, and what its attributes say."""

    arrays: Mapping[str, NDArray[Any]]
    sizes: Mapping[str, int]
    step_m: float
    tolerance_m: float

    def __getitem__(self, path: str) -> NDArray[Any]:
        return self.arrays[path]


CheckFunction = Callable[[Tables], list[Problem]]


def owner_of_rows(start: U32) -> I64:
    """Return the group of each row, from the groups' offsets."""
    return np.repeat(np.arange(len(start) - 1), start[1:] - start[:-1])
