"""Kernels ready in time: loaded without Numba's compiler, or compiled by two processes.

Once kernels are compiled, a process only loads them. Numba starts its compiler for that as
well, 0.3 s of imports that nothing needs then; `load_without_compiler` leaves them until
something has to be compiled.

First run after install: Numba compiles in Python, on one core, about twelve seconds for all
kernels of a build. A build needs them one after the other, so while it compiles and uses the
first ones, a second process compiles the others: first the one that takes longest, of all
that the build needs late, then the last ones. Both keep what they made in Numba's cache.
Where they meet, the build finds the rest compiled. Nobody waits for the other; without the
second process the build only takes longer.
"""

from __future__ import annotations

import contextlib
import gc
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

from svprep.parallel import thread_count

SIGNATURES: dict[str, str] = {
    "half_edges.pair_half_edges": (
        "(i4[:,::1],u4[:,::1],b1[::1],b1[::1],i4[::1],i8[::1],i8,i8,i8,i4[::1])"
    ),
    "self_contact.touches_itself": "(i8[:,::1],u4[:,::1],i8[::1],i8[::1],i8,i8,b1[::1])",
    "tree_build.order_pairs": "(f4[:,::1],u4[::1],i8[::1],i8,i8)",
    "tree_build.write_cones": (
        "(f8[:,::1],u4[:,::1],u4[:,::1],f4[:,::1],f4[:,::1],i8[:,::1],f8,i8,i8,i2[::1])"
    ),
    "tree_build.write_boxes": (
        "(f8[:,::1],u4[:,::1],f4[:,::1],i8[:,::1],i8,i8,f8[:,::1],f8[:,::1],i2[::1])"
    ),
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
"""Kernels after welding and the types a build calls them with."""

SUN_SIGNATURES: dict[str, str] = {
    "clamping.clamp_casters": (
        "(f8[:,::1],R(i8,1),f4[:,::1],R(u4,2),R(u4,1),R(i8,1),f4[:,:,::1],f8[:,::1],i8[::1],i8,"
        "f8[::1],f8,f8[::1],i8,i8,u4[::1],f4[:,::1],i2[:,::1])"
    ),
    "light_boxes.bound_casters": "(R(f4,2),R(u4,2),R(i8,1),f8,i8,i8,f8[:,::1])",
    "light_boxes.raise_levels": "(i8[::1],i8,i8,f4[:,:,::1])",
    "light_boxes.bound_clusters": (
        "(f4[:,::1],R(u4,2),R(u4,1),R(i8,1),f4[:,::1],f8[:,::1],f8,i8,i8,f4[:,:,::1],f8[:,::1])"
    ),
    "light_boxes.choose_normals": "(R(f4,2),R(u4,2),R(u4,1),R(i8,1),i8,i8,f4[:,::1])",
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
_READ_ONLY = re.compile(r"R\((\w+),(\d)\)")
_LIGHTS: dict[str, dict[str, str]] = {"sun": SUN_SIGNATURES, "point": POINT_SIGNATURES}


def load_without_compiler() -> None:
    """Let Numba load compiled kernels without starting its compiler.

    For a process of our own: it holds for all that Numba loads there. What it has to
    compile starts the compiler, as ever.
    """
    from numba.core.caching import Cache
    from numba.core.runtime.nrt import rtsys

    if not hasattr(Cache, "_load_overload"):  # a Numba that is built differently
        return

    def load_overload(self: Cache, signature: object, target: object) -> object:
        rtsys.initialize(target)
        found = None
        with self._guard_against_spurious_io_errors():
            found = self._load_overload(signature, target)
        return found

    Cache.load_overload = load_overload


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


def compile_ahead(*lights: str) -> None:
    """Compile the kernels of a build, and of lights (``sun``, ``point``), not yet compiled."""
    gc.disable()  # this process only compiles, and ends
    load_without_compiler()
    start_compiler()
    load_ahead(lights)


def load_ahead(lights: Sequence[str]) -> None:
    """Have the kernels of a build, and of lights, ready before they are called."""
    from importlib import import_module

    for name, signature in wanted(lights).items():
        module, function = name.split(".")
        kernel = getattr(import_module(f"svprep.kernels.{module}"), function)
        kernel.compile(argument_types(signature))


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
    if thread_count() < 2 or not sys.executable:
        yield
        return
    package_parent = str(Path(__file__).resolve().parents[1])
    code = f"from svprep.warm import compile_ahead as f; f(*{lights})"
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
        yield
        return
    try:
        yield
    finally:
        process.terminate()
        process.wait()


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
