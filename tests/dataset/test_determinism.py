"""The same input and configuration give the same bytes, whatever the threads."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.dataset.datasets import DATA, ROOT, SHARED, label

MODELS = [DATA / "small_city.obj.gz", SHARED / "cities/monastery.obj.gz"]


@pytest.mark.parametrize("path", [p for p in MODELS if p.exists()], ids=label)
def test_builds_are_identical_with_one_thread_and_with_two(path: Path, tmp_path: Path) -> None:
    caches = []
    for turn, threads in enumerate(("1", "2", "2", "3")):
        cache = tmp_path / f"{turn}.svp.h5"
        subprocess.run(
            [sys.executable, "-m", "svprep", "build", str(path), "-o", str(cache)],
            env={**os.environ, "PYTHONPATH": str(ROOT), "SVPREP_THREADS": threads},
            check=True,
            capture_output=True,
        )
        caches.append(cache.read_bytes())
    assert all(cache == caches[0] for cache in caches[1:])
