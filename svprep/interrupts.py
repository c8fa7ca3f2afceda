"""Ctrl-C that comes at an inconvenient moment: it must do no harm there, and not be lost.

Python raises KeyboardInterrupt wherever its main thread happens to be. In what C code calls
back (LLVM, through ctypes, while Numba compiles and loads kernels; HDF5, which writes through
an object of ours), or in what is run as objects are freed, no one can take an exception.
Python prints it and goes on; HDF5 may crash.
"""

from __future__ import annotations

import _thread
import contextlib
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

_ONE_S: Final = 0.05
"""Signals that come so soon after another one are the same Ctrl-C, passed on by a wrapper."""
_AGAIN_S: Final = 0.06


@contextlib.contextmanager
def interrupts_held_back() -> Iterator[Callable[[], None]]:
    """Have a Ctrl-C wait until the block ends, in any way, or until it calls what it is given.

    Nothing is changed on another than the main thread, and where Ctrl-C is ignored or ends
    the process at once.
    """
    before = signal.getsignal(signal.SIGINT)
    if not callable(before) or threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    came: list[Any] = []

    def interrupt() -> None:
        if came:
            frame = came.pop()
            came.clear()
            before(signal.SIGINT, frame)

    signal.signal(signal.SIGINT, lambda number, frame: came.append(frame))
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, before)
        interrupt()


def keep_interrupts() -> None:
    """Have a Ctrl-C that no one could take come again, until someone can; and come once.

    For a process of our own: it takes `sys.unraisablehook`, and the signal.
    """
    sys.unraisablehook = _told
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _Once())


class _Once:
    """Raises KeyboardInterrupt, but not for `_ONE_S` after it did: `_told` would be cut short."""

    def __init__(self) -> None:
        self._last_s = -math.inf

    def __call__(self, number: int, frame: object) -> None:
        now_s = time.monotonic()
        if now_s - self._last_s >= _ONE_S:
            self._last_s = now_s
            raise KeyboardInterrupt


def _told(lost: UnraisableHookArgs) -> None:
    """Take what no one could take: an interrupt is sent again, all else is printed, as ever."""
    if not issubclass(lost.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    again = threading.Timer(_AGAIN_S, _interrupt)  # now, it would be lost at the same place
    again.daemon = True
    again.start()


def _interrupt() -> None:
    """Interrupt the main thread, also where it waits."""
    if sys.platform == "win32":
        _thread.interrupt_main()
        return
    main = threading.main_thread().ident
    assert main is not None
    signal.pthread_kill(main, signal.SIGINT)
