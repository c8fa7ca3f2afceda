"""Cold starts: a fresh process each, its steps apart."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from silhouette_benchmark.datasets import ROOT, environment

CHILD: Final = Path(__file__).with_name("cold_child.py")
STEPS: Final = (
    "import",
    "open",
    "read",
    "context",
    "camera",
    "start Numba",
    "facing",
    "silhouette query",
    "lists",
    "upload",
    "eye",
    "shader compile",
    "first frame",
    "rest",
)
"""In their order; each without the others inside it."""


class ColdFailed(Exception):
    """A cold start did not end well."""


@dataclass(frozen=True, slots=True)
class Start:
    """One process."""

    seconds: dict[str, float]
    cpu_seconds: dict[str, float]
    """Of all threads: what other processes take from a core is not in it."""
    first_draw_s: float
    """From opening the cache to the first draw call."""
    first_picture_s: float
    """From opening the cache to the picture in memory."""
    peak_bytes: int
    """Resident, of the process."""
    buffer_bytes: int
    """Of graphics memory; of a software driver also resident."""
    n_segments: int


@dataclass(frozen=True, slots=True)
class Cold:
    """Cold starts with one cache."""

    name: str
    triangles: int
    starts: list[Start]
    first_ever: Start | None
    """With no compiled kernel and no compiled shader kept from before."""


def cold_start(cache: Path, light: str, size: str, *, first_ever: bool = False) -> Start:
    """Start once."""
    with tempfile.TemporaryDirectory() as folder:
        kept = {
            "NUMBA_CACHE_DIR": folder,
            "MESA_SHADER_CACHE_DIR": folder,
            "__GL_SHADER_DISK_CACHE_PATH": folder,
        }
        variables = environment() | (kept if first_ever else {})
        variables["PYTHONPATH"] = os.pathsep.join([str(ROOT / "runtime"), variables["PYTHONPATH"]])
        arguments = [sys.executable, str(CHILD), str(cache), light, size]
        done = subprocess.run(arguments, capture_output=True, text=True, env=variables)
    if done.returncode:
        words = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        raise ColdFailed(f"{cache.name}: {words[-1]}")
    return Start(**json.loads(done.stdout))
