"""What the C library does with memory that is freed, and the system with what is asked for.

Every other NumPy array of a build is short-lived and some hundred kilobytes long. By
default glibc gives such memory back at once and asks for it again, page by page: a sixth of
the time of a build. Nothing happens with another C library, or another system.
"""

from __future__ import annotations

import ctypes
import os
from typing import Final

_TRIM_THRESHOLD: Final = -1
_TOP_PAD: Final = -2
_MMAP_THRESHOLD: Final = -3
_ARENA_MAX: Final = -8
"""Parameters of mallopt(3)."""
_SET_THP_DISABLE: Final = 41
"""An operation of prctl(2)."""
_KEPT_BYTES: Final = 1 << 28
_PAD_BYTES: Final = 1 << 25
_LARGE_BYTES: Final = 1 << 25
"""The most that glibc takes for `_MMAP_THRESHOLD`."""


def share_free_memory() -> None:
    """Let two threads share a heap, where one takes what the other has freed.

    Else each has its own, and asks the system for more: a tenth of what a build takes. For a
    process of our own, before it has begun a thread: glibc asks once.
    """
    mallopt = _function("mallopt")
    if mallopt is not None:
        mallopt(_ARENA_MAX, max(1, (os.cpu_count() or 1) // 2))


def keep_free_memory() -> None:
    """Keep what is freed for later, up to 256 MiB a heap. For a process of our own."""
    mallopt = _function("mallopt")
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_TOP_PAD, _PAD_BYTES)
        mallopt(_MMAP_THRESHOLD, _LARGE_BYTES)


def use_small_pages() -> None:
    """Take memory from the system by pages of some kilobytes, never by 2 MiB at once.

    NumPy asks for large pages for arrays of 4 MiB and more. Clearing one takes 0.1 ms; in a
    virtual machine whose host has taken unused memory back, 5 ms, and large pages come from
    such memory first: 0.3 s of a build of a million triangles, that small pages never took.
    For a process of our own: where gigabytes are asked for, large pages are a twelfth faster.
    """
    prctl = _function("prctl")
    if prctl is not None:
        prctl(_SET_THP_DISABLE, *map(ctypes.c_ulong, (1, 0, 0, 0)))


def return_free_memory() -> None:
    """Give back what is freed but kept. Each thread may keep as much as its work took."""
    trim = _function("malloc_trim")
    if trim is not None:
        trim(0)


def _function(name: str) -> ctypes._NamedFuncPointer | None:
    if os.name != "posix":
        return None
    found: ctypes._NamedFuncPointer | None = getattr(ctypes.CDLL(None), name, None)
    return found
