"""Ctrl-C that is heard at an inconvenient moment, and must not be lost.

Python raises KeyboardInterrupt wherever its main thread happens to be. In what C code calls
back (LLVM, through ctypes, while Numba compiles and loads kernels), in what is run as objects
are freed, no one can take an exception: Python would print it, and go on.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

_SOON_S: Final = 0.01


def keep_interrupts() -> None:
    """Have a Ctrl-C that no one could take come again, until someone can.

    For a process of our own: it takes `sys.unraisablehook`.
    """
    sys.unraisablehook = _told


def _told(lost: UnraisableHookArgs) -> None:
    """Take what no one could take: an interrupt is sent again, all else is printed, as ever."""
    if not issubclass(lost.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    again = threading.Timer(_SOON_S, _interrupt)  # now, it would be lost at the same place
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
