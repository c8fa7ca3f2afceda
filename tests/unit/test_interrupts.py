"""A Ctrl-C that comes where no one can take it waits, or comes again; it is never lost."""

from __future__ import annotations

import errno
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from svprep.interrupts import interrupts_held_back

ROOT = Path(__file__).resolve().parents[2]
IN_A_CALLBACK = """
import ctypes, signal
call = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))
call()
"""
AS_AN_OBJECT_IS_FREED = """
import signal
class Last:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)
last = Last()
del last
"""
WAITED = """
import signal, sys, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from svprep.interrupts import keep_interrupts
if sys.argv[1:] == ["kept"]:
    keep_interrupts()
began = time.monotonic()
try:
    exec(CODE)
    threading.Event().wait(2.0)
    print("lost")
except KeyboardInterrupt:
    print("heard", time.monotonic() - began < 1.0)
"""


@pytest.fixture(autouse=True)
def interrupts_as_in_a_terminal() -> Iterator[None]:
    """Have Ctrl-C heard, which a shell's jobs in the background ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def _said(code: str, *arguments: str) -> tuple[str, str]:
    done = subprocess.run(
        [sys.executable, "-c", f"CODE = {code!r}{WAITED}", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip(), done.stderr


@pytest.mark.parametrize("code", [IN_A_CALLBACK, AS_AN_OBJECT_IS_FREED], ids=["callback", "del"])
def test_an_interrupt_that_no_one_could_take_comes_again(code: str) -> None:
    assert _said(code, "kept") == ("heard True", "")


def test_two_signals_at_once_are_one() -> None:
    twice = IN_A_CALLBACK.replace("call()", "call(); signal.raise_signal(signal.SIGINT)")
    assert _said(twice, "kept") == ("heard True", "")


def test_python_alone_loses_it() -> None:
    said, errors = _said(IN_A_CALLBACK)
    assert said == "lost"
    assert "KeyboardInterrupt" in errors


def test_what_else_no_one_could_take_is_printed() -> None:
    said, errors = _said("import ctypes\nctypes.CFUNCTYPE(None)(lambda: 1 / 0)()", "kept")
    assert said == "lost"
    assert "ZeroDivisionError" in errors


def test_an_interrupt_held_back_comes_where_it_is_asked_for() -> None:
    reached = []

    def go() -> None:
        with interrupts_held_back() as interrupt:
            signal.raise_signal(signal.SIGINT)
            reached.append("after it came")
            interrupt()
            reached.append("after it was asked for")

    with pytest.raises(KeyboardInterrupt):
        go()
    assert reached == ["after it came"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_held_back_comes_at_the_end_and_once() -> None:
    def go() -> None:
        with interrupts_held_back():
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        go()
    with interrupts_held_back() as interrupt:
        interrupt()


def test_an_interrupt_held_back_comes_before_an_error() -> None:
    def go() -> None:
        with interrupts_held_back():
            signal.raise_signal(signal.SIGINT)
            raise OSError(errno.ENOSPC, "full")

    with pytest.raises(KeyboardInterrupt):
        go()


def test_an_ignored_interrupt_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupts_held_back() as interrupt:
            signal.raise_signal(signal.SIGINT)
            interrupt()
    finally:
        signal.signal(signal.SIGINT, before)


def test_other_threads_hold_nothing_back() -> None:
    handlers = []

    def look() -> None:
        with interrupts_held_back():
            handlers.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert handlers == [signal.default_int_handler]
