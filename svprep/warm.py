"""Kernels ready in time: loaded without Numba's compiler, or compiled by two processes.

Once kernels are compiled, a process only loads them. Numba starts its compiler for that as
well, 0.3 s of imports that nothing needs then; `load_without_compiler` leaves them until
something has to be compiled.

First run after install: Numba compiles in Python, on one core, ten to twelve seconds for all
kernels of a build. A build needs them one after the other, so while it compiles and uses the
first ones, a second process compiles the others: first the one that takes longest, of all
that the build needs late, then the last ones. Both keep what they made in Numba's cache.
Where they meet, the build finds the rest compiled. Without the second process the build only
takes longer.

On Linux the second process is a fork, which has Numba loaded and begins at once, and both
know which kernels the other one has taken (`Claims`). Both leave out passes of Numba's that
have nothing to do for these kernels.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import mmap
import os
import re
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from svprep import source_digest
from svprep.parallel import thread_count

SIGNATURES: dict[str, str] = {
    "half_edges.pair_half_edges": (
        "(i4[:,::1],u4[:,::1],b1[::1],b1[::1],i4[::1],i8[::1],i8,i8,i8,i4[::1])"
    ),
    "self_contact.touches_itself": "(i8[:,::1],u4[:,::1],i8[::1],i8[::1],i8,i8,b1[::1])",
    "half_edges.rebuild_faces": "(u4[:,::1],b1[::1],i4[::1],i4[::1],u4[:,::1],i4[::1],u4[::1])",
    "tree_build.write_cones": (
        "(f8[:,::1],u4[:,::1],u4[:,::1],f4[:,::1],f4[:,::1],i8[:,::1],f8,i8,i8,i2[::1])"
    ),
    "tree_build.write_boxes": (
        "(f8[:,::1],u4[:,::1],f4[:,::1],i8[:,::1],i8,i8,f8[:,::1],f8[:,::1],i2[::1])"
    ),
    "tree_build.order_pairs": "(f4[:,::1],u4[::1],i8[::1],i8,i8)",
    "tree_build.write_keys": (
        "(f8[:,::1],u4[:,::1],u4[:,::1],f4[:,::1],f4[:,::1],i8[::1],i8,i8,f4[:,::1],f4[:,::1])"
    ),
    "half_edges.write_edge_rows": (
        "(u4[:,::1],i4[::1],i8[::1],i4[::1],i4[::1],i8[::1],u4[::1],u4[:,::1],u1[::1])"
    ),
    "surface.grow_planes": ("(i4[:,::1],u4[:,::1],f8[:,::1],i4[::1],i4[::1],f8,f8,i4[::1])"),
    "surface.shape_hashes": "(i4[:,::1],u4[:,::1],i8[::1],u4[::1])",
    "rows.counting_order": "(i4[::1],i8,i4[::1],i8[::1])",
    "surface.component_volumes": (
        "(i4[:,::1],u4[:,::1],f8[:,::1],b1[::1],i4[::1],i4[::1],f8[::1],f8[::1])"
    ),
    "union_find.union_with_parity": "(i4[::1],i4[::1],b1[::1],i4[::1],b1[::1],b1[::1])",
    "half_edges.group_half_edges": ("(u4[:,::1],i8[::1],i8[::1],i8[::1],i8,i8,i4[::1],b1[::1])"),
}
"""Kernels after welding and the types a build calls them with, in the order to compile them."""

SUN_SIGNATURES: dict[str, str] = {
    "clamping.clamp_casters": (
        "(f8[:,::1],R(i8,1),f4[:,::1],R(u4,2),R(u4,1),R(i8,1),f4[:,:,::1],f8[:,::1],i8[::1],i8,"
        "f8[::1],f8,f8[::1],i8,i8,u4[::1],f4[:,::1],i2[:,::1])"
    ),
    "light_boxes.bound_casters": "(R(f4,2),R(u4,2),R(i8,1),f8,i8,i8,f8[:,::1])",
    "light_boxes.bound_clusters": (
        "(f4[:,::1],R(u4,2),R(u4,1),R(i8,1),f4[:,::1],f8[:,::1],f8,i8,i8,f4[:,:,::1],f8[:,::1])"
    ),
    "light_boxes.choose_normals": "(R(f4,2),R(u4,2),R(u4,1),R(i8,1),i8,i8,f4[:,::1])",
    "light_boxes.place_vertices": "(R(f4,2),f8[:,::1],i8,i8,f4[:,::1])",
}
"""Further ones of directional lights; ``R(type, dimensions)`` is an array that is read-only."""
POINT_SIGNATURES: dict[str, str] = {
    "point_clamping.clamp_casters_in_views": (
        "(R(f4,2),R(u4,2),R(i8,1),R(f4,1),f4[:,:,:,::1],f4[:,::1],i8[::1],i8,f8,f8[::1],i8,i8,"
        "u4[::1],f4[:,::1],i2[:,::1])"
    ),
    "point_clamping.bound_clusters_in_views": (
        "(R(f4,2),R(u4,2),R(u4,1),R(i8,1),R(f4,1),f8,i8,i8,f4[:,:,:,::1],f4[:,::1])"
    ),
    "light_boxes.choose_normals": SUN_SIGNATURES["light_boxes.choose_normals"],
}
"""Further ones of point lights."""
IDLE_PASSES: Final = frozenset(
    {
        "DeadBranchPrune",
        "FindLiterallyCalls",
        "GenericRewrites",
        "InlineClosureLikes",
        "InlineInlinables",
        "InlineOverloads",
        "LiteralUnroll",
        "MakeFunctionToJitFunction",
        "NopythonRewrites",
        "RewriteDynamicRaises",
        "RewriteSemanticConstants",
        "WithLifting",
    }
)
"""What Numba looks for and kernels do not have: closures, ``raise``, ``with``, branches on
constant arguments, sums of whole arrays. It takes a sixth of the time in front of LLVM."""
_PR_SET_PDEATHSIG: Final = 1
"""Of prctl(2)."""
_READ_ONLY = re.compile(r"R\((\w+),(\d)\)")
_not_kept: set[str] = set()
_LIGHTS: dict[str, dict[str, str]] = {"sun": SUN_SIGNATURES, "point": POINT_SIGNATURES}


def load_without_compiler() -> None:
    """Let Numba load compiled kernels without its compiler, and do without a place for new ones.

    For a process of our own: it holds for all that Numba loads there. What it has to
    compile starts the compiler, as ever.
    """
    from numba.core.caching import Cache
    from numba.core.runtime.nrt import rtsys

    if not (hasattr(Cache, "_load_overload") and hasattr(Cache, "_save_overload")):
        return  # a Numba that is built differently

    def load_overload(self: Cache, signature: object, target: object) -> object:
        rtsys.initialize(target)
        found = None
        for _ in range(2):
            with self._guard_against_spurious_io_errors():
                found = self._load_overload(signature, target)
            if found is not None or _claims is None or not _claims.is_made(_name_of(self)):
                break
        return found

    def save_overload(self: Cache, signature: object, compiled: object) -> None:
        try:
            with self._guard_against_spurious_io_errors():
                self._save_overload(signature, compiled)
        except OSError as error:  # a full disk: what was compiled is there all the same
            _not_kept.add(
                f"compiled kernels could not be kept in {self.cache_path} "
                f"({error.strerror or error}), so the next run compiles them again: make room "
                "there, or name another folder with NUMBA_CACHE_DIR"
            )

    Cache.load_overload, Cache.save_overload = load_overload, save_overload


def remarks() -> list[str]:
    """Return a remark if kernels that this process has compiled could not be kept."""
    return sorted(_not_kept)


class Claims:
    """Which of two processes compiles a kernel, so that none is compiled twice.

    A byte for each kernel, in memory that a fork shares: free, the build's, or the second
    process's, at work or done. Two that claim a kernel in the same microsecond both compile it.
    """

    _FREE, _FIRST, _SECOND, _DONE = range(4)

    def __init__(self, names: Sequence[str]) -> None:
        self._place = {name: i for i, name in enumerate(names)}
        self._states = mmap.mmap(-1, len(names))
        self.is_second_running: Callable[[], bool] = lambda: False

    def is_made(self, name: str) -> bool:
        """Whether the second process has compiled a kernel, once it has if it is at work.

        If not, the build has claimed it.
        """
        i = self._place.get(name)
        if i is None:
            return False
        while self._states[i] == self._SECOND and self.is_second_running():
            time.sleep(0.005)
        if self._states[i] == self._DONE:
            return True
        self._states[i] = self._FIRST
        return False

    def compile_free(self, makers: Mapping[str, Callable[[], object]]) -> None:
        """Compile what the build has not claimed, one after the other."""
        for name, make in makers.items():
            i = self._place[name]
            if self._states[i] == self._FREE:
                self._states[i] = self._SECOND
                make()
                self._states[i] = self._DONE


_claims: Claims | None = None
"""Of a build that compiles while a second process does."""


def _name_of(cache: Any) -> str:
    """Return the name in `wanted` of what one of Numba's caches is for."""
    function = getattr(cache, "_py_func", None)  # None with a Numba that is built differently
    return (
        "" if function is None else f"{function.__module__.rpartition('.')[2]}.{function.__name__}"
    )


def start_compiler() -> None:
    """Load Numba's compiler without SciPy's BLAS, which only np.dot in a kernel needs (0.2 s).

    For a process of our own, too.
    """
    library = "scipy.linalg.cython_blas"
    if library in sys.modules:
        return
    sys.modules[library] = None  # type: ignore[assignment]  # an import of it fails
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        del sys.modules[library]


def leave_out_idle_passes() -> None:
    """Let Numba compile the kernels imported so far without `IDLE_PASSES`.

    Numba takes a compiler of one's own as an option of ``njit``. It is given to kernels here
    instead, so that each of their files still says all that its compiled code depends on.
    For a process of our own, too. A Numba that is built differently compiles with all passes.
    """
    from numba.core.compiler import Compiler

    class KernelCompiler(Compiler):  # type: ignore[misc]  # Numba has no types
        def define_pipelines(self) -> list[Any]:
            pipelines: list[Any] = super().define_pipelines()
            for pipeline in pipelines:
                named = [(each[0].__name__, each) for each in pipeline.passes]
                pipeline.passes = [each for name, each in named if name not in IDLE_PASSES]
                pipeline.finalize()
            return pipelines

    for module_name, module in list(sys.modules.items()):
        if module_name.startswith("svprep.kernels."):
            compilers = [getattr(each, "_compiler", None) for each in vars(module).values()]
            for each in compilers:
                if each is not None and getattr(each, "pipeline_class", None) is Compiler:
                    each.pipeline_class = KernelCompiler


def compile_ahead(*lights: str, claims: Claims | None = None) -> None:
    """Compile the kernels of a build, and of lights (``sun``, ``point``), not yet compiled."""
    gc.disable()  # this process only compiles, and ends
    load_without_compiler()
    start_compiler()
    made = _makers(lights)
    leave_out_idle_passes()
    if claims is not None:
        claims.compile_free(made)
        return
    for make in made.values():
        make()


def load_ahead(lights: Sequence[str]) -> None:
    """Have the kernels of a build, and of lights, ready before they are called."""
    for make in _makers(lights).values():
        make()


def _makers(lights: Sequence[str]) -> dict[str, Callable[[], object]]:
    """Return what loads or compiles each of the `wanted` kernels, which are imported."""
    from importlib import import_module

    found: dict[str, Callable[[], object]] = {}
    for name, signature in wanted(lights).items():
        module, function = name.split(".")
        kernel = getattr(import_module(f"svprep.kernels.{module}"), function)
        found[name] = partial(kernel.compile, argument_types(signature))
    return found


def argument_types(signature: str) -> tuple[object, ...]:
    """Return Numba's types of a signature's arguments.

    Numba files what it compiled under exactly what it is asked for: a call asks with the
    argument types alone.
    """
    from numba.core.sigutils import normalize_signature

    types, _ = normalize_signature(_READ_ONLY.sub(r"Array(\1,\2,'C',True)", signature))
    return tuple(types)


def wanted(lights: Sequence[str]) -> dict[str, str]:
    """Return the kernels of a build with such lights, in the order to compile them."""
    first, *others = SIGNATURES.items()
    of_lights = {name: each for light in lights for name, each in _LIGHTS[light].items()}
    return dict([first, *of_lights.items(), *others])


@contextlib.contextmanager
def second_compiler(specs: Sequence[str] = ()) -> Iterator[None]:
    """Let a second process compile kernels meanwhile, or a thread load them if they are compiled.

    The process ends with the block at the latest. `specs` are the lights of the build.
    """
    lights = sorted({"point" if spec.startswith("point:") else "sun" for spec in specs})
    if _is_compiled(lights):
        # A few milliseconds each, which the build would wait for one by one.
        threading.Thread(target=load_ahead, args=(lights,), daemon=True).start()
        yield
        return
    start_compiler()
    leave_out_idle_passes()
    source_digest.settle()
    end = None
    if thread_count() > 1:
        # A fork has only the thread that forks: what others were at would stay half done.
        is_alone = sys.platform == "linux" and threading.active_count() == 1
        end = _forked(lights) if is_alone else _started(lights)
    collects = gc.isenabled()
    gc.disable()  # Numba's garbage, 50 MB of it, is not worth looking for (0.4 s)
    try:
        yield
    finally:
        if collects:
            gc.enable()
        if end is not None:
            end()


def _forked(lights: Sequence[str]) -> Callable[[], None] | None:
    """Let a fork of this process compile; return what ends it. None if there can be none."""
    global _claims
    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    claims = Claims(list(wanted(lights)))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ends)  # none may find the fork half made
    build, process = os.getpid(), -1
    try:
        with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
            process = os.fork()  # warned of are threads; those of NumPy's BLAS do no harm
        if process == 0:
            _end_with(build)
            for number in ends:
                signal.signal(number, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            nowhere = os.open(os.devnull, os.O_RDWR)
            for stream in range(3):
                os.dup2(nowhere, stream)
            compile_ahead(*lights, claims=claims)
    except OSError:
        return None
    finally:
        if process == 0:
            os._exit(0)  # nothing of what the build is to do at its end is done here
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    child = _Child(process)
    claims.is_second_running = child.is_running
    _claims = claims

    def end() -> None:
        global _claims
        _claims = None
        child.end()

    return end


class _Child:
    """A fork, which is waited for once."""

    def __init__(self, process: int) -> None:
        self._process = process
        self._has_ended = False

    def is_running(self) -> bool:
        """Whether it has not ended yet."""
        if not self._has_ended:
            try:
                self._has_ended = os.waitpid(self._process, os.WNOHANG)[0] != 0
            except ChildProcessError:  # another has waited for it
                self._has_ended = True
        return not self._has_ended

    def end(self) -> None:
        """End it, also where it is stopped, and wait until it has."""
        if self.is_running():
            with contextlib.suppress(ProcessLookupError, ChildProcessError):
                os.kill(self._process, signal.SIGKILL)
                os.waitpid(self._process, 0)


def _end_with(process: int) -> None:
    """Let the system end this process when `process`, which forked it, ends in any way."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != process:  # it has ended already
        os._exit(0)


def _started(lights: Sequence[str]) -> Callable[[], None] | None:
    """Let a new process compile; return what ends it. None if there can be none."""
    if not sys.executable:
        return None
    package_parent = str(Path(__file__).resolve().parents[1])
    code = f"from svprep.warm import compile_ahead as f; f(*{list(lights)})"
    try:
        process = subprocess.Popen(
            # -P: nothing is imported from the folder that the user happens to be in.
            [sys.executable, "-P", "-c", code],
            env={**os.environ, "PYTHONPATH": package_parent},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None

    def end() -> None:
        process.terminate()
        process.wait()

    return end


def _is_compiled(lights: Sequence[str]) -> bool:
    """Whether Numba's cache holds the kernels that `compile_ahead` makes."""
    from svprep.kernels.tree_build import write_cones

    folder = write_cones.stats.cache_path
    if folder is None:
        return True
    with contextlib.suppress(OSError):
        held = {name.split("-")[0] for name in os.listdir(folder) if name.endswith(".nbi")}
        return held.issuperset(wanted(lights))
    return False
