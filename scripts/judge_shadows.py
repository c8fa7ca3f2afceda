"""Judge the shadows of whole datasets, pixel by pixel, by rays.

    python3 scripts/judge_shadows.py --work ~/svprep-judge -o shadows.md
    python3 scripts/judge_shadows.py --work ~/svprep-judge --datasets monastery conformance
    python3 scripts/judge_shadows.py --work ~/svprep-judge --small --datasets small_city

The sample city, every model beside the checkout that svprep reads, and the conformance files:
24 pictures of each (4 small ones of a conformance file, or with --small), found by rays and
drawn in all ways by turns. What rays say is traced once and kept in --work, as are results,
by the code that made them: a run goes on where the last one ended, and after a change to the
renderer draws again. Empty the folder after a change to the build.

A report that is written again keeps what stands in it between the marks "written by hand".

Exit status 1 if more pixels differ than tests/benchmarks/shadows_admitted.toml admits.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
for folder in (ROOT / "runtime", ROOT):
    if str(folder) not in sys.path:
        sys.path.insert(1, str(folder))  # the svprep beside this script, installed or not

from shadow_judging import admitted as admit  # noqa: E402
from shadow_judging.datasets import (  # noqa: E402
    BuildFailed,
    LeftOut,
    MissingDataset,
    Source,
    prepare,
    sources,
)
from shadow_judging.judging import Judged, Session  # noqa: E402
from shadow_judging.plan import shots  # noqa: E402
from shadow_judging.store import Code, Store  # noqa: E402
from shadow_judging.table import (  # noqa: E402
    Block,
    Report,
    markdown,
    n_differing,
    with_written,
)
from silhouette_benchmark.report import machine  # noqa: E402
from svprep.errors import SvprepError  # noqa: E402
from svprep_runtime.camera import check_size  # noqa: E402
from svprep_runtime.context import headless  # noqa: E402

ADMITTED = ROOT / "tests" / "benchmarks" / "shadows_admitted.toml"
SIZE, SMALL_SIZE = (1280, 1024), (320, 256)


class CodeChanged(Exception):
    """The files of the runtime are no longer those that this process has loaded."""


class Progress:
    """What is being judged, and about how long the rest takes."""

    def __init__(self, n: int) -> None:
        self._n, self._done, self._began = n, 0, time.perf_counter()
        self._n_kept = 0
        self.n_new = 0

    def __call__(self, what: str) -> None:
        """Tell that a picture begins."""
        self._done += 1
        if what.endswith("kept"):
            self._n_kept += 1
            return
        past = time.perf_counter() - self._began
        left = ""
        if self.n_new:
            left = f", {self._minutes(past / self.n_new * (self._n - self._done + 1))} left"
        self.n_new += 1
        print(f"[{self._done}/{self._n}{left}] {what}", file=sys.stderr, flush=True)

    def skip(self, n: int) -> None:
        """Tell that so many pictures will not be judged."""
        self._n -= n

    @staticmethod
    def _minutes(seconds: float) -> str:
        return f"{seconds / 60.0:.0f} min" if seconds >= 90.0 else f"{seconds:.0f} s"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    options = _options(argv)
    with tempfile.TemporaryDirectory() as folder:
        work = options.work or Path(folder)
        work.mkdir(parents=True, exist_ok=True)
        try:
            report = _run(options, work)
        except (BuildFailed, CodeChanged, SvprepError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print("interrupted; the same command goes on from here", file=sys.stderr)
            return 130
    text = markdown(report)
    print(text, end="")
    for path in options.output:
        earlier = path.read_text(encoding="utf-8") if path.exists() else ""
        path.write_text(with_written(text, earlier), encoding="utf-8")
    if options.json:
        options.json.write_text(json.dumps(asdict(report), indent=1) + "\n", encoding="utf-8")
    return int(any(block.exceeded for block in report.blocks))


def _run(options: argparse.Namespace, work: Path) -> Report:
    """Judge everything that is asked for."""
    began, code = time.perf_counter(), Code.now()
    found, left_out = sources(options.datasets)
    store = Store(work, code, keep=options.keep)
    small = {source: options.small or source.is_conformance for source in found}
    progress = Progress(sum(len(shots(source.name, small=small[source])) for source in found))
    judged: dict[tuple[bool, tuple[int, int]], list[Judged]] = {}
    with headless() as context:
        for source in found:
            size = options.size or (SMALL_SIZE if small[source] else SIZE)
            if source.is_conformance:
                size = min(size, SMALL_SIZE)
            wanted = shots(source.name, small=small[source])
            session = Session(context, store, work, size, progress, options.pictures)
            try:
                result = session.judge(prepare(source, work), wanted)
            except (MissingDataset, BuildFailed, SvprepError) as error:
                left_out.append(LeftOut(source.name, _why(error, source)))
                progress.skip(len(wanted))
                continue
            if Code.now() != code:
                raise CodeChanged(
                    "the code of the judge or the runtime changed while it ran; what was judged "
                    f"of {source.name} may be mixed. Run the same command again"
                )
            judged.setdefault((small[source], size), []).append(result)
        renderer = f"{context.renderer}, OpenGL {context.version}"
    return Report(
        machine=machine(),
        renderer=renderer,
        seconds=time.perf_counter() - began,
        n_new=progress.n_new,
        code=code,
        blocks=[_block(key, of, options.admit) for key, of in judged.items()],
        left_out=left_out,
    )


def _block(key: tuple[bool, tuple[int, int]], judged: list[Judged], is_admitting: bool) -> Block:
    """Return datasets that were judged alike, compared with what is admitted of them."""
    small, (width, height) = key
    mode = f"{width}x{height}" + (" small" if small else "")
    seen = {one.name: n_differing(one.results) for one in judged}
    admitted = admit.load(ADMITTED)
    if is_admitting:
        admitted = admit.lowered(admitted, mode, seen)
        ADMITTED.write_text(admit.text(admitted), encoding="utf-8")
    title = "Small pictures, 2 views by 2 lights" if small else "6 views by 4 lights"
    return Block(title, (width, height), judged, admit.exceeded(admitted.get(mode, {}), seen))


def _why(error: Exception, source: Source) -> str:
    """Return why a model is left out, without the folders of this machine."""
    words = re.sub(r"\S*/(?=[^/\s]+)", "", str(error).splitlines()[0])
    return words.removeprefix(f"{Path(source.name).name}: ")


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--datasets", nargs="+", default=[], metavar="NAME",
        help="rows of the report, file names without suffixes, paths, or conformance; default all",
    )  # fmt: skip
    parser.add_argument("--work", type=Path, metavar="FOLDER", help="keep and reuse all that here")
    parser.add_argument("--size", type=_size, metavar="WxH", help="of pictures; default 1280x1024")
    parser.add_argument(
        "--small", action="store_true", help="320x256, 2 views by 2 lights of each dataset"
    )
    parser.add_argument(
        "--keep", action="store_true", help="also take results and truths of older code"
    )
    parser.add_argument(
        "--admit", action="store_true", help="write or lower what is admitted to what is seen"
    )
    parser.add_argument(
        "--pictures", type=Path, metavar="FOLDER",
        help="save what is newly judged, beside the difference picture, as PNG",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", type=Path, action="append", default=[], metavar="FILE.md",
        help="also write the report; may be repeated",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all results")
    return parser.parse_args(argv)


def _size(text: str) -> tuple[int, int]:
    """Parse a picture's size."""
    width, _, height = text.partition("x")
    try:
        size = int(width), int(height)
        check_size(*size)
    except (ValueError, SvprepError) as error:
        raise argparse.ArgumentTypeError(f"expected WxH, such as 1280x1024, got {text}") from error
    return size


if __name__ == "__main__":
    sys.exit(main())
