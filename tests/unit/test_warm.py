"""Kernels ready in time: what a second process compiles is what a build then loads."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from numba import njit
from numba.core import typed_passes, untyped_passes
from numba.core.caching import Cache

from svprep import warm
from svprep.kernels.rows import counting_order

ROOT = Path(__file__).resolve().parents[2]
HEAD = """
import json, sys
from numba import types
from numba.core import event
from svprep import pipeline, warm
"""
CALLED = """
def short(t):
    if not isinstance(t, types.Array):
        return f"{str(t)[0]}{t.bitwidth // 8}"
    kind = "b1" if t.dtype == types.boolean else short(t.dtype)
    return f"{kind}[{':,' * (t.ndim - 1)}::1]" if t.mutable else f"R({kind},{t.ndim})"

warm.load_without_compiler()
lights = ["dir:110,40", "point:0,0,300"]
pipeline.build([sys.argv[1]], sys.argv[2], lights=lights, is_full=True)
called = {
    f"{name.removeprefix('svprep.kernels.')}.{kernel.__name__}": [
        "(" + ",".join(map(short, each)) + ")" for each in kernel.overloads
    ]
    for name, module in list(sys.modules.items())
    if name.startswith("svprep.kernels.")
    for kernel in vars(module).values()
    if getattr(kernel, "overloads", None) and not kernel.__name__.startswith("_")
}
print(json.dumps(called))
"""
COMPILED = """
count = [0]

class Listener(event.Listener):
    def on_start(self, e):
        count[0] += 1

    def on_end(self, e):
        pass

event.register("numba:compile", Listener())
warm.SIGNATURES = {name: warm.SIGNATURES[name] for name in ["rows.counting_order"]}
warm.SUN_SIGNATURES.clear()
warm.compile_ahead("sun")
import scipy.linalg.cython_blas  # it can be imported afterwards
print(count[0])
"""
LOADED = """
import numpy as np
warm.load_without_compiler()
from svprep.kernels.rows import counting_order
groups, order, start = np.array([1, 0, 1], np.int32), np.empty(3, np.int32), np.empty(3, np.int64)
counting_order(groups, 2, order, start)
n_loaded = sum(counting_order.stats.cache_hits.values())
print(order.tolist(), "numba.np.arraymath" in sys.modules, n_loaded)
"""
FORKED = """
import gc, os, time
from svprep.kernels.rows import counting_order
warm.SIGNATURES = {name: warm.SIGNATURES[name] for name in ["rows.counting_order"]}
with warm.second_compiler():
    is_collecting = gc.isenabled()
    until = time.monotonic() + 60
    while not warm._is_compiled([]) and time.monotonic() < until:
        time.sleep(0.02)
try:
    os.waitpid(-1, 0)
except ChildProcessError:
    print(warm._is_compiled([]), is_collecting, gc.isenabled(), len(counting_order.overloads))
"""
EARLY = {
    "content.digest_objects",
    "obj_parser.parse_obj",
    "rows.first_equal_row",
    "rows.weld_corners",
    "surface.face_normals",
    "triangulate.clip_rings",
}
"""What a build compiles by itself: kernels that come first, or are quickly compiled."""


def run(program: str, *arguments: object, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", HEAD + program, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_signatures_are_those_that_a_build_calls_kernels_with(tmp_path: Path) -> None:
    called = json.loads(run(CALLED, ROOT / "data/small_city.obj.gz", tmp_path / "a.svp.h5"))
    promised = warm.wanted(["sun", "point"])
    for name, signature in promised.items():
        assert called[name] == [signature], name
    assert set(called) - set(promised) <= EARLY


def test_what_is_compiled_ahead_is_then_loaded_without_the_compiler(tmp_path: Path) -> None:
    place = {"NUMBA_CACHE_DIR": str(tmp_path)}
    assert int(run(COMPILED, **place)) >= 1
    assert run(LOADED, **place) == "[1, 0, 2] False 1\n"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a new process is started")
def test_the_second_compiler_is_a_fork_that_ends_with_the_build(tmp_path: Path) -> None:
    place = {"NUMBA_CACHE_DIR": str(tmp_path), "SVPREP_THREADS": "2"}
    assert run(FORKED, **place) == "True False True 0\n"


def test_no_kernel_is_compiled_by_both_processes() -> None:
    claims, made = warm.Claims(["a", "b", "c"]), []
    assert not claims.is_made("b")  # the build compiles it
    assert not claims.is_made("of no list")
    makers = {name: partial(made.append, name) for name in "abc"}
    claims.compile_free(makers)
    assert made == ["a", "c"]
    assert [claims.is_made(name) for name in "abc"] == [True, False, True]


def test_the_build_waits_for_a_kernel_that_is_being_compiled_and_for_no_dead_process() -> None:
    claims, asked = warm.Claims(["a"]), []

    def at_work() -> None:
        claims.is_second_running = lambda: bool(asked.append(1)) or len(asked) < 3
        assert not claims.is_made("a")  # the process has ended before it was done

    claims.compile_free({"a": at_work})
    assert len(asked) == 3


def test_numbas_caches_say_what_they_are_for() -> None:
    assert warm._name_of(counting_order._cache) == "rows.counting_order"


def test_passes_that_are_left_out_are_numbas() -> None:
    # By name: with a Numba that calls them otherwise, first builds would take longer again.
    here = {*vars(untyped_passes), *vars(typed_passes)}
    assert here >= warm.IDLE_PASSES


def test_kernels_of_lights_are_compiled_for_such_lights_only() -> None:
    assert list(warm.wanted([])) == list(warm.SIGNATURES)
    suns, points = set(warm.wanted(["sun"])), set(warm.wanted(["point"]))
    assert suns - points == set(warm.SUN_SIGNATURES) - set(warm.POINT_SIGNATURES)
    assert "point_clamping.clamp_casters_in_views" in points - suns


def test_kernels_that_cannot_be_kept_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Cache, "load_overload", Cache.load_overload)  # put back afterwards
    monkeypatch.setattr(Cache, "save_overload", Cache.save_overload)
    monkeypatch.setattr(warm, "_not_kept", set())
    warm.load_without_compiler()

    def full(self: Cache, signature: object, compiled: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Cache, "_save_overload", full)

    @njit(cache=True)  # type: ignore[untyped-decorator]  # Numba has no types
    def twice(x: int) -> int:
        return 2 * x

    assert twice(4) == 8
    (line,) = warm.remarks()
    assert "(No space left on device), so the next run compiles them again" in line
