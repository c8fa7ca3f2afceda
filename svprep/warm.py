"""First run after install: compile kernels from both ends, in two processes.

Numba compiles in Python, on one core, about ten seconds for all kernels. A build
needs them one after the other, so while it compiles and uses the first ones, a
second process compiles the last ones first, and both keep what they made in
Numba's cache. Where they meet, the build finds the rest compiled. Nobody waits
for the other; without the second process the build only takes longer.
"""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from svprep.parallel import thread_count

SIGNATURES: dict[str, str] = {
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
    "self_contact.touches_itself": "(i8[:,::1],u4[:,::1],i8[::1],i8[::1],i8,i8,b1[::1])",
    "half_edges.write_edge_rows": (
        "(u4[:,::1],i4[::1],i8[::1],i4[::1],i8[::1],u4[::1],u4[:,::1],u1[::1])"
    ),
    "half_edges.count_edge_rows": "(u4[:,::1],i4[::1],i8[::1],i4[::1],i8[::1])",
    "surface.grow_planes": ("(i4[:,::1],u4[:,::1],f8[:,::1],i4[::1],i4[::1],f8,f8,i4[::1])"),
    "surface.shape_hashes": "(i4[:,::1],u4[:,::1],i8[::1],u4[::1])",
    "rows.counting_order": "(i4[::1],i8,i4[::1],i8[::1])",
    "surface.component_volumes": (
        "(i4[:,::1],u4[:,::1],f8[:,::1],b1[::1],i4[::1],i4[::1],f8[::1],f8[::1])"
    ),
    "half_edges.pair_half_edges": (
        "(i4[:,::1],u4[:,::1],b1[::1],b1[::1],i4[::1],i8[::1],i8,i8,i8,i4[::1])"
    ),
    "union_find.union_with_parity": "(i4[::1],i4[::1],b1[::1],i4[::1],b1[::1],b1[::1])",
    "half_edges.group_half_edges": ("(u4[:,::1],i8[::1],i8[::1],i8[::1],i8,i8,i4[::1],b1[::1])"),
}
"""Kernels after welding and the types a build calls them with, the last one first."""


def compile_last_first() -> None:
    """Compile every kernel of `SIGNATURES` that is not in Numba's cache yet."""
    from importlib import import_module

    from numba.core.sigutils import normalize_signature

    gc.disable()  # this process only compiles, and ends
    for name, signature in SIGNATURES.items():
        module, function = name.split(".")
        kernel = getattr(import_module(f"svprep.kernels.{module}"), function)
        # Numba files what it compiled under exactly what it is asked for: a call asks
        # with the argument types alone.
        types, _ = normalize_signature(signature)
        kernel.compile(types)


@contextlib.contextmanager
def second_compiler() -> Iterator[None]:
    """Let a second process compile kernels meanwhile, if they are not compiled yet.

    It ends with the block at the latest.
    """
    if thread_count() < 2 or not sys.executable or _is_compiled():
        yield
        return
    package_parent = str(Path(__file__).resolve().parents[1])
    try:
        process = subprocess.Popen(
            # -P: nothing is imported from the folder that the user happens to be in.
            [sys.executable, "-P", "-c", "from svprep.warm import compile_last_first as f; f()"],
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


def _is_compiled() -> bool:
    """Whether Numba's cache holds the first kernel that `compile_last_first` makes."""
    from svprep.kernels.tree_build import write_cones

    folder = write_cones.stats.cache_path
    return folder is None or any(Path(folder).glob("tree_build.write_cones-*.nbi"))
