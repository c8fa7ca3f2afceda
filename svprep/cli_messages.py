"""What the command line writes where: results, one line per failure, progress, a log of a bug."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

from svprep import __version__


def crs_name(crs: str) -> str:
    """Return a CRS as people are shown it: WKT by its name alone."""
    is_wkt = "[" in crs and crs.count('"') >= 2
    return crs.split('"')[1] if is_wkt else crs


def show(summary: dict[str, Any], lines: list[str], *, as_json: bool) -> None:
    """Print a summary: one JSON object, or lines for people."""
    if as_json:
        import json

        print(json.dumps(summary))
        return
    for line in lines:
        print(plain(line))


def complain(text: str) -> None:
    """Write one line to standard error, if there is one; control characters are escaped."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError):
            print(f"svprep: {plain(text)}", file=sys.stderr)


def plain(text: str) -> str:
    """Return `text` on one line, without what would steer a terminal."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text
    )


def silence_output() -> None:
    """Drop what standard output still holds, so that leaving does not fail on it again."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def report_bug(bug: Exception) -> int:
    """Write the traceback to a log file and say in one line where it is."""
    import tempfile
    import traceback

    try:
        handle, name = tempfile.mkstemp(prefix="svprep-", suffix=".log")
        with os.fdopen(handle, "w") as log:
            log.write(f"svprep {__version__}, Python {sys.version}\n{sys.argv}\n")
            traceback.print_exception(bug, file=log)
    except OSError:
        name = "not written"
    complain(f"this is a bug in svprep ({type(bug).__name__}: {bug}); log: {name}")
    return 70


@contextlib.contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a progress line on standard error while it is a terminal, else nothing."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda what, done, of: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    with Progress(
        TextColumn("{task.description:24}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        task = bar.add_task("", total=None)

        def tell(what: str, done: int, of: int) -> None:
            bar.update(task, description=what, completed=done, total=of)

        yield tell
