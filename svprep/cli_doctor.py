"""What ``svprep doctor`` looks at: Python, packages, OpenGL, a window."""

from __future__ import annotations

import ctypes.util
import importlib.metadata
import importlib.util
import os
import platform
import sys
from collections.abc import Sequence
from typing import Any, Final

from svprep import __version__
from svprep.errors import EnvironmentProblem

_PACKAGES: Final = (
    ("", ("numpy", "scipy", "h5py", "numba", "trimesh", "mapbox-earcut", "pvlib")),
    ("view", ("moderngl", "moderngl-window", "Pillow")),
    ("judge", ("embreex", "manifold3d", "pymeshlab")),
    ("formats", ("pyproj", "DracoPy")),
)
"""By the extra that brings them; the first are always needed."""
_DRAWING: Final = ("moderngl", "glcontext")
_USES: Final = {
    "moderngl": "svprep render and view",
    "moderngl-window": "svprep view",
    "Pillow": "svprep render and view",
    "embreex": "svprep hours, validate --deep and validate --shadows",
    "manifold3d": "svprep validate --deep",
    "pymeshlab": "comparisons in tests and benchmarks",
    "pyproj": "city files with a CRS",
    "DracoPy": "Draco-compressed tiles",
}


def look() -> list[dict[str, Any]]:
    """Return what was looked at: name, ``status`` (good, missing, bad), what was found, remedy.

    Missing is what an optional part lacks; bad is what keeps svprep from working as asked.
    """
    found = [_fact("svprep", "good", f"{__version__}, Python {platform.python_version()}")]
    for extra, names in _PACKAGES:
        found += [_package(name, extra) for name in names]
    lacking = [name for name in _DRAWING if importlib.util.find_spec(name) is None]
    if lacking:
        said = f"not tried without {lacking[0]}"
        found.append(_fact("OpenGL", "missing", said, _install("view")))
        return found
    found += _libraries()
    from svprep_runtime.doctor import findings

    try:
        for each in findings():
            status = "good" if each.is_good else "bad"
            found.append(_fact(each.name, status, each.found, each.remedy))
    except EnvironmentProblem as problem:
        found.append(_fact("OpenGL", "bad", str(problem)))
    found.append(_window())
    return found


def lines(found: Sequence[dict[str, Any]]) -> list[str]:
    """Return a line for each, and one that sums up."""
    shown = [
        f"{each['status']:<8} {each['name']}: {each['found']}"
        + (f". {each['remedy']}" if each["remedy"] and each["status"] != "good" else "")
        for each in found
    ]
    bad = [each["name"] for each in found if each["status"] == "bad"]
    missing = [each["name"] for each in found if each["status"] == "missing"]
    if bad:
        shown.append(f"not well: {', '.join(bad)}")
    elif missing:
        shown.append(f"well; not there, and needed only for some commands: {', '.join(missing)}")
    else:
        shown.append("well")
    return shown


def _fact(name: str, status: str, found: str, remedy: str = "") -> dict[str, Any]:
    return {"name": name, "status": status, "found": found, "remedy": remedy}


def _install(extra: str) -> str:
    wanted = f"'svprep[{extra}]'" if extra else "svprep"
    return f"Run: {sys.executable or 'python3'} -m pip install {wanted}"


def _package(name: str, extra: str) -> dict[str, Any]:
    try:
        return _fact(name, "good", importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        status = "missing" if extra else "bad"
        use = f", for {_USES[name]}" if extra else ""
        return _fact(name, status, f"not installed{use}", _install(extra))


def _libraries() -> list[dict[str, Any]]:
    found = []
    for library, package in (("GL", "libgl1"), ("EGL", "libegl1")):
        where = ctypes.util.find_library(library)
        found.append(
            _fact(f"lib{library}", "good", where)
            if where
            else _fact(
                f"lib{library}",
                "bad",
                "not found, for svprep render and view",
                f"Run: apt-get install {package} libgl1-mesa-dri",
            )
        )
    return found


def _window() -> dict[str, Any]:
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if display or sys.platform in ("darwin", "win32"):
        return _fact("window", "good", f"display {display}" if display else sys.platform)
    return _fact(
        "window",
        "missing",
        "no display, for svprep view",
        "svprep render draws without one",
    )
