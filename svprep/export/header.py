"""Comment lines of OBJ and PLY exports: what the formats themselves have no place for.

    svprep export 1                     the first line; the number is that of this layout
    crs "EPSG:28992"                    of the positions
    digest "3f6a..."                    of the cache's content
    source ["city.gml", "9c41..."]      path and SHA-256 of a file that the cache was built of
    object ["o name", "name", "Building", "parent"]
    surface "RoofSurface"               in the order of their numbers

Values are JSON, so that a line break in a name stays in its line. `svprep.ingest.own_header`
reads the lines back.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Final

from svprep.export.city import City

TITLE: Final = "svprep export 1"


def header_lines(city: City) -> Iterator[str]:
    """Yield the lines about the whole file, without what makes them comments."""
    yield TITLE
    if city.crs:
        yield line("crs", city.crs)
    yield line("digest", city.digest)
    for source in city.sources:
        yield line("source", [source.path, source.sha256])


def line(key: str, value: object) -> str:
    """Return one line: ASCII, without line breaks."""
    return f"{key} {json.dumps(value)}"
