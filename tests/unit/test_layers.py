"""Who may import whom: a layer that leaks is an error here."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STDLIB = frozenset(sys.stdlib_module_names)
OPENGL = frozenset({"OpenGL", "moderngl", "moderngl_window", "glcontext", "pyglet"})
PREPARING = ("ingest", "repair", "planes", "edges", "scene_tree", "clamp", "pipeline")


def is_type_checking(node: ast.AST) -> bool:
    """Whether `node` is the test of ``if TYPE_CHECKING:``."""
    name = node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", None)
    return name == "TYPE_CHECKING"


def walk(node: ast.AST, *, into_functions: bool) -> Iterator[ast.AST]:
    """Yield the nodes below `node` that run, at import or (`into_functions`) ever."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            if not into_functions:
                continue
        elif isinstance(child, ast.If) and is_type_checking(child.test):
            for other in child.orelse:
                yield other
                yield from walk(other, into_functions=into_functions)
            continue
        yield child
        yield from walk(child, into_functions=into_functions)


def imports_of(source: str, module: str, *, is_package: bool, lazy: bool) -> set[str]:
    """Return the dotted names that `source` imports: ``{"svprep.model", "numpy"}``.

    ``from svprep import edges`` counts as ``svprep.edges``; relative imports are
    resolved; `lazy` includes imports inside functions.
    """
    names: set[str] = set()
    for node in walk(ast.parse(source), into_functions=lazy):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".")
                kept = len(parts) - node.level + (1 if is_package else 0)
                base = ".".join([*parts[:kept], *([node.module] if node.module else [])])
            is_bare = base in ("svprep", "svprep_runtime") or (node.level and not node.module)
            names.update(f"{base}.{alias.name}" if is_bare else base for alias in node.names)
    return names


def modules_below(package: Path) -> Iterator[tuple[str, Path]]:
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


MODULES = dict(modules_below(ROOT / "svprep"))
RUNTIME = dict(modules_below(ROOT / "runtime" / "svprep_runtime"))


def imported(module: str, *, lazy: bool = True) -> set[str]:
    path = (MODULES | RUNTIME)[module]
    return imports_of(
        path.read_text("utf-8"), module, is_package=path.name == "__init__.py", lazy=lazy
    )


def is_in(name: str, *packages: str) -> bool:
    return any(name == package or name.startswith(package + ".") for package in packages)


def part(package: str) -> list[str]:
    """Return the modules of ``svprep.<package>``, which may be one file or a folder."""
    return [name for name in MODULES if is_in(name, f"svprep.{package}")]


def tops(names: set[str]) -> set[str]:
    return {name.partition(".")[0] for name in names}


def test_the_reader_of_imports_sees_what_it_should() -> None:
    source = """
from __future__ import annotations
import os.path, numpy as np
from typing import TYPE_CHECKING
from svprep import edges, model
from . import planes
from .weld import weld
from ..cache.reader import read
if TYPE_CHECKING:
    import never
try:
    import h5py
except ImportError:
    pass
class A:
    import inside
def f():
    import lazily
"""
    at_import = imports_of(source, "svprep.repair", is_package=True, lazy=False)
    assert at_import == {
        "__future__", "os.path", "numpy", "typing", "svprep.edges", "svprep.model",
        "svprep.repair.planes", "svprep.repair.weld", "svprep.cache.reader", "h5py", "inside",
    }  # fmt: skip
    ever = imports_of(source, "svprep.repair", is_package=True, lazy=True)
    assert ever == at_import | {"lazily"}
    from_module = imports_of("from .model import X", "svprep.light", is_package=False, lazy=True)
    assert from_module == {"svprep.model"}


@pytest.mark.parametrize("module", MODULES)
def test_svprep_never_imports_opengl(module: str) -> None:
    assert not tops(imported(module)) & OPENGL


@pytest.mark.parametrize("module", MODULES)
def test_only_functions_of_the_command_line_import_the_runtime(module: str) -> None:
    names = imported(module, lazy=not module.startswith("svprep.cli"))
    assert "svprep_runtime" not in tops(names)
    assert "runtime" not in tops(imported(module))


@pytest.mark.parametrize("module", part("ingest"))
def test_ingest_never_imports_the_cache(module: str) -> None:
    assert not [name for name in imported(module) if is_in(name, "svprep.cache")]


@pytest.mark.parametrize("module", part("cache"))
def test_the_cache_imports_no_preparing_stage(module: str) -> None:
    stages = [f"svprep.{stage}" for stage in PREPARING]
    assert not [name for name in imported(module) if is_in(name, *stages)]


@pytest.mark.parametrize("module", part("silhouette"))
def test_silhouettes_import_no_preparing_stage(module: str) -> None:
    stages = [f"svprep.{stage}" for stage in PREPARING]
    assert not [name for name in imported(module) if is_in(name, *stages)]


@pytest.mark.parametrize("module", [m for m in part("kernels") if m != "svprep.kernels"])
def test_a_kernel_is_a_file_for_itself(module: str) -> None:
    # Numba's cache does not notice a change in an imported file. llvmlite is Numba's own
    # compiler library: intrinsics are written in it.
    allowed = {"__future__", "llvmlite", "math", "numba", "numpy", "typing"}
    assert tops(imported(module)) <= allowed


def test_the_kernels_folder_is_chosen_before_numba_is_imported() -> None:
    names = imported("svprep.kernels")
    assert tops(names) <= STDLIB | {"svprep"}
    assert {name for name in names if is_in(name, "svprep")} <= {"svprep.errors"}


@pytest.mark.parametrize("module", MODULES)
def test_kernels_are_defined_nowhere_else(module: str) -> None:
    # Only there has a folder for compiled code been made sure of.
    if not is_in(module, "svprep.kernels"):
        assert "numba" not in tops(imported(module, lazy=False))


@pytest.mark.parametrize("module", part("reference"))
def test_twins_import_nothing_that_they_judge(module: str) -> None:
    ours = {name for name in imported(module) if is_in(name, "svprep")}
    allowed = ("svprep.errors", "svprep.model", "svprep.reference")
    assert not {name for name in ours if not is_in(name, *allowed)}


def test_the_model_needs_numpy_only() -> None:
    assert tops(imported("svprep.model")) <= STDLIB | {"numpy"}


@pytest.mark.parametrize("module", ["svprep.errors", "svprep.defects"])
def test_errors_and_defects_need_nothing(module: str) -> None:
    assert tops(imported(module)) <= STDLIB


def test_a_light_needs_the_model_and_errors_only() -> None:
    # pvlib and pyproj are slow to import: only who asks for the sun pays for them.
    parts = {"svprep.light", "svprep.arc", "svprep.light_spec", "svprep.sun"}
    for part in sorted(parts):
        names = imported(part, lazy=False)
        assert tops(names) <= STDLIB | {"numpy", "svprep"}
        assert {n for n in names if is_in(n, "svprep")} <= {"svprep.model", "svprep.errors"} | parts


@pytest.mark.parametrize(
    "module", RUNTIME or [pytest.param("", marks=pytest.mark.skip(reason="no runtime package yet"))]
)
def test_the_runtime_imports_no_preparing_stage(module: str) -> None:
    # Rays, facing and threads prepare nothing: the judge decides sides of planes, meets faces
    # and shares out its work by the same code as the stages do.
    shared = ("rays", "facing", "parallel")
    allowed = ["cache", "light", "silhouette", "model", "errors", *shared]
    allowed = [f"svprep.{name}" for name in allowed]
    ours = {name for name in imported(module) if is_in(name, "svprep")}
    assert not {name for name in ours if name != "svprep" and not is_in(name, *allowed)}


def test_the_command_line_starts_without_heavy_imports() -> None:
    # `svprep --help` answers at once: each of these costs 0.1 to 0.7 s.
    heavy = ["numpy", "scipy", "numba", "trimesh", "pvlib", "h5py", "svprep_runtime"]
    code = f"import sys, svprep.cli; print(*[m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []
