"""The kernels that a second process compiles are exactly those that a build then uses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

COUNT_COMPILES = """
import json, sys
from numba.core import event
names = []
class Listener(event.Listener):
    def on_start(self, e):
        f = e.data["dispatcher"].py_func
        if f.__module__.startswith("svprep"):
            names.append(f.__module__.split(".")[-1] + "." + f.__name__)
    def on_end(self, e):
        pass
event.register("numba:compile", Listener())
{work}
print(json.dumps(names))
"""
BUILD = """
from svprep.ingest import read
from svprep.pipeline import BuildConfig, prepare
prepare(read([sys.argv[1]]), BuildConfig())
"""
WARM = "from svprep.warm import compile_last_first; compile_last_first()"


def compiled(work: str, cache: Path) -> list[str]:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            COUNT_COMPILES.format(work=work),
            str(ROOT / "data/small_city.obj.gz"),
        ],
        env={**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def test_a_build_after_warming_compiles_none_of_those_kernels(tmp_path: Path) -> None:
    from svprep.warm import SIGNATURES

    assert set(SIGNATURES) <= set(compiled(WARM, tmp_path))
    left = compiled(BUILD, tmp_path)
    assert not set(left) & set(SIGNATURES)
    # Reader and weld are compiled by the build itself; nothing else is left over.
    assert {name.split(".")[0] for name in left} <= {"obj_parser", "triangulate", "rows", "surface"}
    assert compiled(BUILD, tmp_path) == []
