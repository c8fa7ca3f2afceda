"""Freed memory is kept while a build runs, and given back where memory is short; page sizes."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CODE = """
import numpy as np
from svprep.process_memory import keep_free_memory, return_free_memory

def held_mb():
    text = open("/proc/self/status").read()
    return int(text.split("VmRSS:")[1].split()[0]) / 1024

keep_free_memory()
before = held_mb()
arrays = [np.ones(1 << 17) for _ in range(64)]
del arrays
kept = held_mb() - before
return_free_memory()
print(kept, held_mb() - before)
"""


@pytest.mark.skipif(
    not sys.platform.startswith("linux") or platform.libc_ver()[0] != "glibc",
    reason="only glibc is told what to do with freed memory",
)
def test_freed_memory_is_kept_and_given_back() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CODE], cwd=ROOT, capture_output=True, text=True, check=True
    )
    kept, left = map(float, done.stdout.split())
    assert kept > 48.0
    assert left < 16.0


SMALL_PAGES = """
import numpy as np
from svprep.process_memory import use_small_pages

use_small_pages()
array = np.ones(1 << 23)
text = open("/proc/self/smaps_rollup").read()
print(text.split("AnonHugePages:")[1].split()[0])
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux is told of pages")
def test_small_pages_hold_what_numpy_asks_large_ones_for() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SMALL_PAGES], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["0"]
