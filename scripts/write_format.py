#!/usr/bin/env python3
"""Write the generated parts of FORMAT.md from the cache's schema.

    python3 scripts/write_format.py            write FORMAT.md
    python3 scripts/write_format.py --check    exit 1 if it is out of step

The text between ``<!-- begin NAME -->`` and ``<!-- end NAME -->`` is generated;
the rest of the file is written by hand.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from svprep.cache.checks import CHECKS  # noqa: E402
from svprep.cache.schema import ATTRIBUTES, DATASETS  # noqa: E402
from svprep.cache.vtkhdf import VTK_ITEMS  # noqa: E402
from svprep.defects import DEFECTS  # noqa: E402


def _table(*rows: tuple[str, ...]) -> str:
    head, *body = ["| " + " | ".join(cell or " " for cell in row) + " |" for row in rows]
    rule = "|" + "---|" * len(rows[0])
    return "\n".join([head, rule, *body])


def _attributes() -> str:
    rows = [
        (
            f"`{s.name}`",
            f"`{s.dtype}`" + (f" {s.shape}" if s.shape else ""),
            s.unit,
            s.meaning,
            "yes" if s.in_content else "no",
        )
        for s in ATTRIBUTES
    ]
    return _table(("name", "type", "unit", "meaning", "in the content digest"), *rows)


def _datasets() -> str:
    rows = [(f"`{s.path}`", f"`{s.dtype}`", s.shape_text, s.unit, s.meaning) for s in DATASETS]
    return _table(("path", "type", "shape", "unit", "meaning"), *rows)


def _vtkhdf() -> str:
    rows = [
        (
            f"`VTKHDF/{item.path}`",
            f"`{item.link}`" if item.link else "",
            f"`{item.dtype}`" if item.dtype else "group",
            item.shape,
            item.meaning,
        )
        for item in VTK_ITEMS
    ]
    return _table(("path", "hard link to", "type", "shape", "meaning"), *rows)


def _checks() -> str:
    rows = [(c.label, c.summary) for c in CHECKS.values()]
    return _table(("code", "what is wrong"), *rows)


def _defects() -> str:
    rows = [(str(int(d.code)), d.label, d.unit, d.summary) for d in DEFECTS.values()]
    return _table(("stored", "defect", "counted per", "what it is"), *rows)


PARTS = {
    "attributes": _attributes,
    "datasets": _datasets,
    "vtkhdf": _vtkhdf,
    "checks": _checks,
    "defects": _defects,
}


def regenerated(text: str) -> str:
    """Return FORMAT.md's `text` with every generated part written anew."""
    for name, part in PARTS.items():
        begin, end = f"<!-- begin {name} -->\n", f"\n<!-- end {name} -->"
        pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
        if len(pattern.findall(text)) != 1:
            raise SystemExit(
                f'FORMAT.md: expected one generated part "{name}", found another count'
            )
        text = pattern.sub((begin + part() + end).replace("\\", r"\\"), text)
    return text


def main() -> int:
    """Write FORMAT.md, or check it."""
    path = ROOT / "FORMAT.md"
    old = path.read_text(encoding="utf-8")
    new = regenerated(old)
    if "--check" in sys.argv[1:]:
        if new != old:
            print("FORMAT.md is out of step with the schema. Run: python3 scripts/write_format.py")
        return int(new != old)
    path.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
