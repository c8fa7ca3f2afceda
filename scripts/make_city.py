"""Write a generated, dirty city as Wavefront OBJ.

    python scripts/make_city.py --objects 300 --seed 7 -o city.obj.gz
    python scripts/make_city.py --objects 17420 --origin 390000 5820000 40 -o city.obj

The same options give the same bytes. ``--clean`` writes the same city with all
its defects repaired: every component closed, outward and free of itself.
"""

from __future__ import annotations

import argparse
import gzip
import io
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, TextIO, cast

from city_generator.city import Summary, write_city


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    parser = argparse.ArgumentParser(description="Write a generated, dirty city as OBJ.")
    parser.add_argument("--objects", type=_count, default=300, metavar="N", help="default 300")
    parser.add_argument("--seed", type=_natural, default=7, help="default 7")
    parser.add_argument("-o", "--output", type=Path, required=True, help=".obj or .obj.gz")
    parser.add_argument(
        "--origin", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("X", "Y", "Z"),
        help="added to every position [m]; default 0 0 0",
    )  # fmt: skip
    parser.add_argument("--clean", action="store_true", help="the same city, without defects")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON on stdout")
    args = parser.parse_args(argv)
    if not args.output.name.endswith((".obj", ".obj.gz")):
        parser.error(f"the output must end in .obj or .obj.gz: {args.output}")
    try:
        with _open_text(args.output) as stream:
            summary = write_city(
                stream, args.objects, args.seed, tuple(args.origin), clean=args.clean
            )
    except OSError as error:
        print(f"make_city: cannot write {args.output}: {error.strerror}", file=sys.stderr)
        return 1
    _report(summary, args.output)
    if args.json:
        print(json.dumps(summary.as_dict()))
    return 0


def _count(text: str) -> int:
    """Parse a number of at least 1."""
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {value}")
    return value


def _natural(text: str) -> int:
    """Parse a number of at least 0."""
    if (value := int(text)) < 0:
        raise argparse.ArgumentTypeError(f"must not be negative, got {value}")
    return value


@contextmanager
def _open_text(path: Path) -> Iterator[TextIO]:
    """Open `path` for text; ``.gz`` without name and time, so that bytes repeat."""
    with path.open("wb") as raw:
        binary: BinaryIO = raw
        if path.suffix == ".gz":
            binary = cast(BinaryIO, gzip.GzipFile("", "wb", 6, raw, mtime=0))
        with io.TextIOWrapper(binary, encoding="ascii", newline="\n") as text:
            yield text


def _report(summary: Summary, path: Path) -> None:
    """Print the summary on standard error."""
    table = summary.as_dict()
    size_mb = path.stat().st_size / 1e6
    print(f"{path}: {size_mb:.1f} MB", file=sys.stderr)
    for key, value in table.items():
        if isinstance(value, dict):
            print(f"{key}:", file=sys.stderr)
            for name, count in value.items():
                print(f"  {name:24}{count:>9,}", file=sys.stderr)
        else:
            print(f"{key:26}{value:>9,}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
