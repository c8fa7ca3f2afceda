"""How long the stages of a build took, and what they held and wrote."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from svprep.tiles import StageHook


@dataclass(frozen=True, slots=True)
class StageRow:
    """One stage of a build."""

    name: str
    seconds: float
    """Wall time. Tiles go through the stages from weld to silhouettes side by side: the time
    from the first tile to the last is shared among these stages by what each took."""
    peak_mb: float | None
    """[MB]: the most that the process had held until the stage ended; None where the system
    does not say. That of the tiles' stages is the same."""
    bytes_written: int
    """To the cache, or to files that take the place of memory."""
    mtri_per_s: float | None
    """Millions of triangles read, over the seconds."""


@dataclass(frozen=True, slots=True)
class _Row:
    """What a stage took so far."""

    seconds: float = 0.0
    peak_mb: float | None = None
    n_bytes: int = 0


@dataclass(slots=True)
class StageClock:
    """Times the stages of a build, and tells which one begins."""

    on_stage: StageHook | None
    n_spilled: Callable[[], int] = lambda: 0
    """Returns the bytes so far of files that take the place of memory."""
    _rows: dict[str, _Row] = field(default_factory=dict)
    _name: str = ""
    _begun: float = 0.0
    _bytes: int = 0
    _spilled_before: int = 0
    _told: set[str] = field(default_factory=set)

    def start(self, name: str) -> None:
        """Begin a stage, and end the one before it."""
        self._end()
        self._name, self._begun, self._bytes = name, time.perf_counter(), 0
        self._tell(name)

    def wrote(self, n_bytes: int) -> None:
        """Count bytes that the stage wrote."""
        self._bytes += n_bytes

    def tell_tiles(self, names: Sequence[str]) -> None:
        """Tell that a tile has been through these stages, once."""
        for name in names:
            if name not in self._told:
                self._tell(name)

    def share(self, seconds: Mapping[str, float]) -> None:
        """End the stage, as several that ran side by side and took so long each in all.

        The first one counts for what none of them took, the last one for what was written.
        """
        elapsed = time.perf_counter() - self._begun
        total = sum(seconds.values())
        for i, (name, spent) in enumerate(seconds.items()):
            share = spent / total if total else float(i == 0)
            self._add(name, share * elapsed, self._written() if i == len(seconds) - 1 else 0)
        self._name = ""

    def stop(self, n_triangles: int) -> tuple[StageRow, ...]:
        """Return all stages, of a build that read so many triangles."""
        self._end()
        return tuple(
            StageRow(
                name=name,
                seconds=row.seconds,
                peak_mb=row.peak_mb,
                bytes_written=row.n_bytes,
                mtri_per_s=n_triangles / row.seconds / 1e6 if row.seconds > 0.0 else None,
            )
            for name, row in self._rows.items()
        )

    def _end(self) -> None:
        if self._name:
            self._add(self._name, time.perf_counter() - self._begun, self._written())
            self._name = ""

    def _written(self) -> int:
        """Return the bytes that were written since a stage ended."""
        n_spilled = self.n_spilled()
        n_bytes = self._bytes + n_spilled - self._spilled_before
        self._bytes, self._spilled_before = 0, n_spilled
        return n_bytes

    def _add(self, name: str, seconds: float, n_bytes: int) -> None:
        """Count time and bytes for a stage, which may have some already."""
        row = self._rows.pop(name, _Row())  # it ends last
        self._rows[name] = _Row(row.seconds + seconds, _peak_mb(), row.n_bytes + n_bytes)

    def _tell(self, name: str) -> None:
        self._told.add(name)
        if self.on_stage is not None:
            self.on_stage(name)


def _peak_mb() -> float | None:
    """Return the most memory that this process has held so far [MB], None if that is unknown."""
    with contextlib.suppress(OSError, IndexError):
        # Of this program alone; what `getrusage` tells may be of the one that called it.
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    try:
        import resource
    except ImportError:  # not on Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6
