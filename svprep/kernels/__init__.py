"""Compiled kernels, and a place for their compiled code.

Numba keeps what it compiled in the first of these folders that it can write to:
``NUMBA_CACHE_DIR``, ``__pycache__`` beside the source, the user's cache folder.
Where it can write to none (a read-only install used by a service without a home)
it refuses to define a kernel at all: "cannot cache function: no locator
available". Importing this package comes before any kernel's ``import numba``, so
here ``NUMBA_CACHE_DIR`` is pointed at a temporary folder in that case, and only
then. Numba's search is `numba.core.caching`, ``CacheImpl._locator_classes``.
"""

from __future__ import annotations

import atexit
import os
import shutil
import stat
import sys
import tempfile
from pathlib import Path

from svprep.errors import EnvironmentProblem

_SOURCE_DIR = Path(__file__).resolve().parent


def _is_writable(folder: Path) -> bool:
    """Whether a file can be created in `folder`, made if absent, as Numba asks it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _user_cache_dir() -> Path | None:
    """Return Numba's user-wide cache folder on this system; None without a home.

    (There Numba would make a folder named ``~`` in the current one.)
    """
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "win32":
        local = os.environ.get("LOCALAPPDATA")
        return Path(local or home / "AppData" / "Local") / "numba" / "Cache"
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "numba"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache") / "numba"


def _is_private(folder: Path) -> bool:
    """Whether `folder` is a real folder of this user that nobody else can write to.

    Compiled code is loaded from it, and the temporary folder is everybody's.
    """
    status = folder.lstat()
    return (
        stat.S_ISDIR(status.st_mode)
        and (not hasattr(os, "getuid") or status.st_uid == os.getuid())
        and (os.name == "nt" or not status.st_mode & 0o022)
    )


def _is_last_resort(temporary: Path) -> bool:
    """Whether `tempfile` takes the current folder because no temporary one is writable."""
    places = [os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP")]
    places += ["/tmp", "/var/tmp", "/usr/tmp"]
    return temporary.samefile(os.curdir) and not any(
        place and os.path.isdir(place) and temporary.samefile(place) for place in places
    )


def _temporary_cache_dir() -> Path:
    """Return a folder that only this user can write to, kept for the next run if possible."""
    user = os.getuid() if hasattr(os, "getuid") else "cache"
    temporary = Path(tempfile.gettempdir())
    folder = temporary / f"svprep-numba-{user}"
    try:
        if not _is_last_resort(temporary):
            folder.mkdir(mode=0o700, exist_ok=True)
            if _is_private(folder) and _is_writable(folder):
                return folder
    except OSError:
        pass
    own = Path(tempfile.mkdtemp(prefix="svprep-numba-"))
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    return own


def ensure_cache_dir(source_dir: Path = _SOURCE_DIR) -> Path | None:
    """Point Numba at a temporary folder if it could keep compiled code nowhere else.

    Parameters
    ----------
    source_dir : Path
        The folder of the kernels' source files.

    Returns
    -------
    Path or None
        The temporary folder; None where Numba finds a folder by itself.

    Raises
    ------
    EnvironmentProblem
        No temporary folder is writable either.

    Notes
    -----
    One file created and removed where the first candidate is writable (0.1 ms).
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    user = _user_cache_dir()
    candidates = [Path(given)] if given else []
    candidates += [source_dir / "__pycache__", *([user] if user else [])]
    if any(_is_writable(folder) for folder in candidates):
        return None
    try:
        folder = _temporary_cache_dir()
    except OSError as error:
        tried = ", ".join(str(c) for c in candidates)
        raise EnvironmentProblem(
            f"no folder for compiled kernels is writable (tried {tried} and the temporary "
            f"folder: {error}). Set NUMBA_CACHE_DIR to a folder that is"
        ) from error
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:  # it read the environment when it was imported
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    return folder


ensure_cache_dir()
