"""The three families of failure, and the exit status each one ends in.

An error says what is wrong, where (file, line, object, first few ids, how
many), what was expected and what was found, and what to do next, in one line.
The command line prints that line and nothing else; Python callers catch the
family.
"""

from __future__ import annotations

import sys


class SvprepError(Exception):
    """Base of every error that svprep raises on purpose."""

    exit_status = 1


class InputError(SvprepError):
    """The user's input cannot be used: a model file, an option, a light."""


class CacheError(SvprepError):
    """A cache file is missing, foreign, damaged, locked or of another schema."""


class EnvironmentProblem(SvprepError):
    """The machine lacks something: an extra package, disk space, permission."""


class InternalError(SvprepError):
    """Our own bug: an invariant that the code relies on does not hold."""

    exit_status = 70


def first_few(ids: object, limit: int = 3) -> str:
    """Return the first few of `ids` for a message: ``"41, 42, 90, ... (12)"``."""
    listed = list(ids)  # type: ignore[call-overload]
    shown = ", ".join(str(i) for i in listed[:limit])
    return shown if len(listed) <= limit else f"{shown}, ... ({len(listed)})"


def require_extra(package: str, extra: str, purpose: str) -> EnvironmentProblem:
    """Return the error that names the install command of a missing extra."""
    return EnvironmentProblem(
        f'{purpose} needs the package "{package}", which is not installed. '
        f"Run: {sys.executable or 'python3'} -m pip install 'svprep[{extra}]'"
    )
