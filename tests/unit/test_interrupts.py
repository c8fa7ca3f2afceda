"""A Ctrl-C that no one could take ends the program all the same."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

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
import sys, threading, time
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


def test_python_alone_loses_it() -> None:
    said, errors = _said(IN_A_CALLBACK)
    assert said == "lost"
    assert "KeyboardInterrupt" in errors


def test_what_else_no_one_could_take_is_printed() -> None:
    said, errors = _said("import ctypes\nctypes.CFUNCTYPE(None)(lambda: 1 / 0)()", "kept")
    assert said == "lost"
    assert "ZeroDivisionError" in errors
