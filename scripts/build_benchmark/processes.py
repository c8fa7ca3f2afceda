"""Processes run to their end, and what they took. This one stays small.

Linux counts to a new process what its parent held when it was started. So nothing large is
read or imported here, not even NumPy.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("NumPy", "Numba", "h5py", "Typer", "pymeshlab", "meshlib", "trimesh")


class CommandFailed(Exception):
    """A command that must work did not."""


@dataclass(frozen=True, slots=True)
class Run:
    """One finished process."""

    wall_s: float
    cpu_s: float
    """Of all its threads and of the processes that it waited for."""
    peak_mb: float
    """[MB]: the most resident memory of the process, or of one that it waited for."""
    exit_status: int
    last_words: str
    """The last line of standard error."""
    said: str = ""
    """Standard output."""


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of a build, as ``svprep build --json`` tells it."""

    name: str
    seconds: float
    peak_mb: float | None
    mtri_per_s: float | None
    bytes_written: int


@dataclass(frozen=True, slots=True)
class Built:
    """What ``svprep build --json`` said, as far as it is reported."""

    n_bytes: int
    content_digest: str
    objects: int
    triangles: int
    reused: int
    lights: int
    stages: tuple[Stage, ...]

    @classmethod
    def of(cls, said: Mapping[str, Any]) -> Built:
        """Return what a build printed."""
        fields = Stage.__dataclass_fields__
        return cls(
            n_bytes=said["n_bytes"],
            content_digest=said["content_digest"],
            objects=said["objects"],
            triangles=said["triangles_in"],
            reused=said["reused_objects"],
            lights=len(said["lights"]),
            stages=tuple(Stage(**{key: row[key] for key in fields}) for row in said["stages"]),
        )


def run(command: Sequence[str], variables: Mapping[str, str] | None = None) -> Run:
    """Run a command to its end and account for it. `variables` are added to the environment."""
    begun = time.perf_counter()
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command, stdout=output, stderr=errors, env={**environment(), **(variables or {})}
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - begun
        process.returncode = os.waitstatus_to_exitcode(status)
        said, words = (_text_of(file) for file in (output, errors))
    lines = words.strip().splitlines()
    return Run(
        wall_s=wall_s,
        cpu_s=usage.ru_utime + usage.ru_stime,
        peak_mb=usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6,
        exit_status=process.returncode,
        last_words=lines[-1] if lines else "",
        said=said,
    )


def _text_of(file: Any) -> str:
    file.seek(0)
    return file.read().decode(errors="replace")


def environment() -> dict[str, str]:
    """Return the environment in which a new process finds this svprep.

    It may keep svprep's bytecode, which an installed program has from the beginning.
    """
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    others = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return {**others, "PYTHONPATH": path}


def answer_of(done: Run, what: str) -> dict[str, Any]:
    """Return the JSON that a process printed.

    Raises
    ------
    CommandFailed
        It did not end well.
    """
    if done.exit_status:
        words = done.last_words or f"exit status {done.exit_status}"
        raise CommandFailed(f"{what}: {words}")
    return json.loads(done.said)


def has_module(name: str) -> bool:
    """Whether this Python can import a peer."""
    return not run([sys.executable, "-c", f"import {name}"]).exit_status


def machine() -> str:
    """Return what the figures depend on, in words."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    named = [f"{name} {found}" for name in PACKAGES if (found := _version(name))]
    return (
        f"{platform.system()} {platform.machine()}, {cores} cores, "
        f"Python {platform.python_version()}, {', '.join(named)}; {datetime.now(UTC):%Y-%m-%d}"
    )


def load() -> str:
    """Return how many processes have wanted a core in the last minute."""
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
