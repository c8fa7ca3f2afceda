r"""Sun hours as a CSV table: a row per object and kind of surface.

    # svprep sun hours 2
    # header lines: 30
    # key: value                     ... every fact that explains the numbers
    "object_index","object","type","parent","source","kind",...
    0,"tower_0000","BuildingPart","tower","delft.city.json","roof",...

Texts are quoted, numbers are not, so a name may hold commas, quotes, line breaks or "#":
``pandas.read_csv(FILE, comment="#")`` and ``skiprows=`` the header lines both read it. Its
text is UTF-8; bytes of a name that are not are written as ``\udcXX``. A name that a
spreadsheet would compute (it begins with =, +, -, @) has an apostrophe before it, as in
the build's report: `object_index` is the key for joining tables.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from svprep.hours.facts import TITLE, WHAT, fact_lines
from svprep.hours.kinds import Kind
from svprep.hours.result import SunHours
from svprep.hours.summary import DEFINITION, PERCENTS, rows_of

OURS: Final = f"# {WHAT} ".encode()
"""What files of any version begin with."""
HEAD: Final = f"# {TITLE}\n".encode()
COLUMNS: Final = (
    "object_index",
    "object",
    "type",
    "parent",
    "source",
    "kind",
    "area_m2",
    "samples",
    "buried",
    *(f"{what}_{name}" for what in ("total", "longest") for name in (*PERCENTS, "mean")),
)
_ROWS_AT_ONCE = 10_000


def csv_parts(hours: SunHours, facts: dict[str, Any]) -> Iterator[bytes]:
    """Yield the table, piece by piece."""
    lines = [
        *fact_lines(facts),
        f"columns: total and longest run without a break in {DEFINITION}; empty where all are",
        "names: an apostrophe stands before one that begins with = + - @; texts are quoted",
    ]
    n_lines = len(lines) + 2
    yield HEAD
    yield f"# header lines: {n_lines}\n".encode()
    for line in lines:
        yield f"# {line}\n".encode()
    out = io.StringIO()
    writer = csv.writer(out, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    writer.writerow(COLUMNS)
    for number, row in enumerate(_rows(hours)):
        writer.writerow(row)
        if number % _ROWS_AT_ONCE == 0:
            yield _taken(out)
    yield _taken(out)


def _taken(out: io.StringIO) -> bytes:
    text = out.getvalue()
    out.seek(0)
    out.truncate()
    return text.encode("utf-8", "backslashreplace")


def _rows(hours: SunHours) -> Iterator[list[Any]]:
    """Yield the cells of each row, `COLUMNS`."""
    groups, rows = hours.groups, rows_of(hours)
    texts = (hours.object_names, hours.object_types, hours.object_parents, hours.object_sources)
    labels = [[_not_a_formula(text) for text in row] for row in zip(*texts, strict=True)]
    kinds = {int(kind): kind.name.lower() for kind in Kind}
    minutes = np.column_stack(
        [table[name] for table in (rows.total, rows.longest) for name in (*PERCENTS, "mean")]
    )
    for i, (owner, kind) in enumerate(
        zip(groups.object.tolist(), groups.kind.tolist(), strict=True)
    ):
        yield [
            owner,
            *labels[owner],
            kinds[kind],
            _number(float(groups.area_m2[i])),
            int(rows.samples[i]),
            int(rows.buried[i]),
            *(_number(value) for value in minutes[i].tolist()),
        ]


def _number(value: float) -> float | int | str:
    """Return a number of at most 4 decimals (more for a small one), ``""`` for none."""
    if math.isnan(value):
        return ""
    short = round(value, 4) if value >= 1.0 or value == 0.0 else float(f"{value:.4g}")
    return int(short) if short == int(short) else short


def _not_a_formula(name: str) -> str:
    """Return a name that a spreadsheet shows instead of computing."""
    return f"'{name}" if name.lstrip()[:1] in ("=", "+", "-", "@") and name.strip() else name
