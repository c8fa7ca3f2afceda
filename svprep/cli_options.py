"""Options that several commands share, as Typer takes them: loads nothing else."""

from __future__ import annotations

import re
from typing import Annotated, Final

import typer

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output.")
]

LIGHT_HELP = (
    "dir:AZIMUTH,ALTITUDE in degrees, clockwise from north and above the horizon; point:X,Y,Z in "
    "input coordinates; sun:LAT,LON,2026-06-21T12:00+02:00"
)
LightsOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="SPEC",
        help=f"Clamp the shadows of a light: {LIGHT_HELP}; or an arc, a light per step by day: "
        "sun:LAT,LON,2026-03-20/06:00/18:00/15m[Europe/Vienna]. May be repeated.",
    ),
]
CostVertexOption = Annotated[
    float | None,
    typer.Option(
        metavar="X",
        help="What drawing a vertex costs, for clamping: a gap is left where that of two more "
        "caps is less than that of the sides across it (V < R). Default 4.",
    ),
]
CostAreaOption = Annotated[
    float | None,
    typer.Option(
        metavar="X", help="What drawing a square metre of side or cap costs. Default 1; 0: no gaps."
    ),
]

CameraOption = Annotated[
    str | None,
    typer.Option(
        metavar="C",
        help="EX,EY,EZ,TX,TY,TZ[,FOV]: eye and target in input coordinates, vertical degrees. "
        "Default: all of the model, from the south-west.",
    ),
]
ViewLightsOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="SPEC", help=f"{LIGHT_HELP}. May be repeated. Default: azimuth 135, altitude 40."
    ),
]
PICTURE_SIZE = "1280x1024"
SizeOption = Annotated[str, typer.Option(metavar="WxH", help="Pixels.")]
MethodOption = Annotated[
    str,
    typer.Option(
        metavar="M", help="How to count: auto, zpass, zfail or zp+. Shadows are the same."
    ),
]
ClampOption = Annotated[
    str,
    typer.Option(
        metavar="K", help="auto: clamped volumes for lights that the cache holds; none: whole ones."
    ),
]
CounterOption = Annotated[
    str,
    typer.Option(
        metavar="T", help="float: exact to millions of layers; stencil: 8 bits, modulo 256."
    ),
]
ConstructionOption = Annotated[
    str,
    typer.Option(
        metavar="S", help="vertex: sides from silhouette edges; geometry: by a geometry shader."
    ),
]
SamplesOption = Annotated[
    int,
    typer.Option(metavar="N", help="Samples of a pixel, odd; the shadow is what most say."),
]
MemoryOption = Annotated[
    str | None,
    typer.Option(metavar="SIZE", help="Graphics memory for buffers, such as 512M. Default 4G."),
]

_SIZE: Final = re.compile(r"([0-9]{1,15}(?:\.[0-9]{1,15})?) ?([kmgt]?)(?:i?b)?", re.IGNORECASE)
_BYTES_OF_UNIT: Final = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30, "t": 1 << 40}


def memory_of(text: str, least: int = 0) -> int:
    """Return the bytes of ``"512M"``, ``"1.5GiB"``, ``"2 TB"`` or of a plain number of them.

    K, M, G and T are powers of 1024, however they are written.

    Raises
    ------
    typer.BadParameter
        It is not of that form, or less than `least`.
    """
    match = _SIZE.fullmatch(text.strip())
    if match is None:
        raise typer.BadParameter(f'--memory "{text[:40]}" is not a size like 512M or 2G')
    n_bytes = int(float(match[1]) * _BYTES_OF_UNIT[match[2].lower()])
    if n_bytes < least:
        raise typer.BadParameter(
            f'--memory "{text[:40]}" is {n_bytes:,} bytes, too little to build with; '
            f"give {least >> 20}M or more"
        )
    return n_bytes
