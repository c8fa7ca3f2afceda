"""``--crs``: the CRS of files that state none, or one that pyproj does not know.

It stands in for what such a file does not say, and is read as if the file stated it. A CRS
that is known is never overridden: whoever has a file with a wrong one mends the file.
"""

from __future__ import annotations

from dataclasses import replace

from svprep.ingest.crs_names import crs_of, has_pyproj
from svprep.ingest.parsed import ParsedFile, shown


def crs_in_use(stated: str, given: str) -> str:
    """Return the CRS that counts for a file that states `stated`, "" for none."""
    if not given or not stated.strip():
        return given or stated
    is_known = not has_pyproj() or crs_of(stated) is not None
    return stated if is_known else given


def with_crs_given(parsed: ParsedFile, given: str) -> ParsedFile:
    """Return a file with the CRS that counts, and a note on what `given` means for it."""
    if not given:
        return parsed
    stated = shown(parsed.crs)
    crs = crs_in_use(parsed.crs, given)
    if crs == parsed.crs:
        note = f'the CRS "{stated}" is stated, so --crs {shown(given)} is ignored'
    elif stated:
        note = f'the CRS "{stated}" is none that pyproj knows; taken to be {shown(given)} (--crs)'
    else:
        note = f"no CRS is stated; taken to be {shown(given)} (--crs)"
    return replace(parsed, crs=crs, notes=(*parsed.notes, note))
