"""The rounds of one command, and what is computed of them."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from build_benchmark.processes import Built
from build_benchmark.rounds import Row

ENDS = ("load", "write")
"""The stages that every build does whole."""


@dataclass(frozen=True, slots=True)
class Series:
    """One command, round after round."""

    rows: list[Row]

    @property
    def wall_s(self) -> list[float]:
        """Wall seconds."""
        return [row.run.wall_s for row in self.rows]

    @property
    def cpu_s(self) -> list[float]:
        """Processor seconds."""
        return [row.run.cpu_s for row in self.rows]

    @property
    def peak_mb(self) -> float:
        """The most resident memory of any."""
        return max(row.run.peak_mb for row in self.rows)

    @property
    def builds(self) -> list[Built]:
        """What was built."""
        return [row.built for row in self.rows if row.built is not None]

    @property
    def problem(self) -> str:
        """Why it gave up; empty if it did not."""
        failed = [row.run for row in self.rows if row.run.exit_status]
        return (failed[0].last_words or f"exit status {failed[0].exit_status}") if failed else ""

    @property
    def median_row(self) -> Row:
        """The round of the median time, of an even number the faster one in the middle."""
        return sorted(self.rows, key=lambda row: row.run.wall_s)[(len(self.rows) - 1) // 2]

    def ratios(self, other: Series) -> list[float]:
        """Return its wall seconds over those of another, round by round."""
        theirs = {row.turn: row.run.wall_s for row in other.rows}
        return [row.run.wall_s / theirs[row.turn] for row in self.rows if row.turn in theirs]


def middle_s(built: Built, *, with_clamp: bool = True) -> float:
    """Return the seconds of a build's stages between load and write."""
    left_out = ENDS if with_clamp else (*ENDS, "clamp")
    return sum(stage.seconds for stage in built.stages if stage.name not in left_out)


def spread(values: Sequence[float], digits: int = 2) -> str:
    """Return ``median (min-max)``, of one value that alone."""
    median = f"{statistics.median(values):,.{digits}f}"
    if len(values) == 1:
        return median
    return f"{median} ({min(values):,.{digits}f}-{max(values):,.{digits}f})"
