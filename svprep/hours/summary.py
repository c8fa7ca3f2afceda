"""Medians and other quantiles of sun, per object and kind, and per kind over the model.

The quantile q is the least value that at least the share q of the area does not exceed
(Hyndman and Fan 1996, type 1: the inverse of the distribution function), so it is always
a value that some sample has. Buried samples are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from svprep.hours.kinds import Kind
from svprep.hours.result import SunHours
from svprep.model import F64, I64, U32

PERCENTS: Final = {"median": 50, "min": 0, "p10": 10, "p90": 90}
"""What is said of a group, and which percentage of its area it bounds."""
DEFINITION: Final = (
    "minutes; a quantile is the least value not exceeded on that share of the area (type 1 of "
    "Hyndman and Fan 1996); buried samples left out"
)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """A row per object and kind, as the CSV has it. NaN: all samples are buried."""

    samples: I64
    """``(n_groups,)``, buried ones too."""
    buried: I64
    """``(n_groups,)``"""
    total: dict[str, F64]
    """By the names of `PERCENTS`, and ``"mean"``: ``(n_groups,)`` [min]."""
    longest: dict[str, F64]
    """The same of the sun without a break."""


def rows_of(hours: SunHours) -> Rows:
    """Return the statistics of each group of `hours`. O(n log n)."""
    start = hours.groups.sample_start
    samples = np.diff(start)
    owner = np.repeat(np.arange(len(samples)), samples)
    is_counted = ~hours.is_buried
    counted = np.bincount(owner[is_counted], minlength=len(samples))
    step = hours.arc.step_minutes
    owner = owner[is_counted]
    return Rows(
        samples=samples,
        buried=samples - counted,
        total=_quantiles(owner, hours.points.total_steps[is_counted], counted, step),
        longest=_quantiles(owner, hours.points.longest_steps[is_counted], counted, step),
    )


def _quantiles(owner: I64, steps: U32, count: I64, step_minutes: float) -> dict[str, F64]:
    """Return quantiles of `steps` per owner (ascending), in minutes."""
    width = int(steps.max(initial=0)) + 1
    ordered = np.sort(owner * width + steps) % width
    first = np.cumsum(count) - count
    found = {}
    for name, percent in PERCENTS.items():
        # The ceil(q n)-th of n equal weights, in whole numbers; the first for q = 0.
        rank = np.maximum((count * percent + 99) // 100, 1)
        at = np.where(count > 0, first + rank - 1, 0)
        value = ordered[at] if len(ordered) else np.zeros(len(at), np.int64)
        found[name] = np.where(count > 0, value * step_minutes, np.nan)
    total = np.bincount(owner, steps, len(count))
    found["mean"] = np.where(count > 0, total / np.maximum(count, 1) * step_minutes, np.nan)
    return found


@dataclass(frozen=True, slots=True)
class KindTotal:
    """One kind of surface over the whole model. NaN: no sample is left."""

    kind: Kind
    area_m2: float
    samples: int
    buried: int
    total: dict[str, float]
    """By the names of `PERCENTS` [min], samples weighted by the area they stand for."""
    longest: dict[str, float]
    total_mean: float
    """[min], weighted."""


def kind_totals(hours: SunHours) -> list[KindTotal]:
    """Return each kind that has area, in the order of `Kind`."""
    weight = hours.area_of_sample_m2
    found = []
    for kind in Kind:
        chosen = np.flatnonzero(hours.kind == kind)
        if len(chosen) == 0:
            continue
        left = chosen[~hours.is_buried[chosen]]
        step = hours.arc.step_minutes
        total = hours.points.total_steps[left]
        mean = float(np.average(total, weights=weight[left])) * step if len(left) else np.nan
        found.append(
            KindTotal(
                kind=kind,
                area_m2=float(hours.groups.area_m2[hours.groups.kind == kind].sum()),
                samples=len(chosen),
                buried=len(chosen) - len(left),
                total=_weighted(total, weight[left], step),
                longest=_weighted(hours.points.longest_steps[left], weight[left], step),
                total_mean=mean,
            )
        )
    return found


def _weighted(steps: U32, weight: F64, step_minutes: float) -> dict[str, float]:
    """Return the quantiles of `steps`, each sample with its weight, in minutes."""
    if len(steps) == 0:
        return dict.fromkeys(PERCENTS, float("nan"))
    area_of_value = np.bincount(steps, weight)
    reach = np.cumsum(area_of_value)
    # A value that no sample has is never the answer; sums may miss a share by rounding.
    values = np.flatnonzero(np.bincount(steps))
    reach = reach[values]
    found = {}
    for name, percent in PERCENTS.items():
        wanted = reach[-1] * (percent / 100.0) * (1.0 - 1e-12)
        found[name] = float(values[int(np.searchsorted(reach, wanted))] * step_minutes)
    return found
