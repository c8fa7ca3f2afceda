"""What ``svprep view`` does with its options: understand them, open the window."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from svprep.cli_render import CLAMPS, METHODS, one_of, size_of
from svprep.errors import require_extra
from svprep.light import is_arc, is_sun, parse_light

DEFAULT_SIZE: Final = "1280x800"


def view(
    cache: Path,
    lights: Sequence[str],
    size: str,
    camera: str | None,
    method: str,
    clamp: str,
    tell: Callable[[str], None],
) -> None:
    """Show a cache in a window until it is closed.

    Parameters
    ----------
    cache : Path
    lights : sequence of str
        Of ``--light``; none: azimuth 135, altitude 40, which `tell` is told.
    size : str
        ``"1280x800"``
    camera : str, optional
        ``EX,EY,EZ,TX,TY,TZ[,FOV]``; None: all of the model.
    method, clamp : str
        One of `METHODS`, one of `CLAMPS`.
    tell : callable
        Takes a line for people.

    Raises
    ------
    typer.BadParameter
        An option is not of its kind.
    InputError, CacheError, EnvironmentProblem
        A bad cache, light or camera, no window.
    """
    width_px, height_px = size_of(size)
    one_of("--method", method, METHODS)
    one_of("--clamp", clamp, CLAMPS)
    for spec in lights:
        # The sun is looked at later: it may need the cache's CRS.
        if not (is_sun(spec) or is_arc(spec)):
            parse_light(spec)
    try:
        from svprep_runtime.app import view as show
        from svprep_runtime.frame import METHODS as methods
        from svprep_runtime.frame import Settings
        from svprep_runtime.viewer.lights import DEFAULT_SPEC
    except ImportError as error:
        raise require_extra(error.name or "moderngl", "view", "svprep view") from None
    if not lights:
        tell(f"no --light SPEC is given; using {DEFAULT_SPEC} (azimuth 135, altitude 40)")
    settings = Settings(
        method=next(m for m in methods if m == method),
        clamp=clamp == "auto",
    )
    show(cache, list(lights), (width_px, height_px), settings, camera=camera or "")
