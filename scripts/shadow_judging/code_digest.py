"""A digest of code that changes when what it does may change.

Of a module and all modules of the product that it imports, however indirectly: their syntax
trees without docstrings, so that neither comments nor layout matter. Shaders count by byte.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
_FOLDERS: Final = {"svprep": ROOT / "svprep", "svprep_runtime": ROOT / "runtime" / "svprep_runtime"}


def code_digest(modules: Sequence[str], shaders: bool = False) -> str:
    """Return 16 hexadecimal digits for `modules` and what they import."""
    found: dict[Path, bytes] = {}
    waiting = [path for name in modules if (path := _path(name))]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found[path], imports = _looked_at(path, path.stat().st_mtime_ns)
            waiting += [other for name in imports if (other := _path(name))]
    total = hashlib.sha256()
    for path in sorted(found):
        total.update(path.relative_to(ROOT).as_posix().encode() + found[path])
    if shaders:
        for path in sorted((_FOLDERS["svprep_runtime"] / "glsl").rglob("*")):
            if path.is_file():
                total.update(path.name.encode() + path.read_bytes())
    return total.hexdigest()[:16]


def _path(module: str) -> Path | None:
    """Return the file of one of our modules, None for others and for names in modules."""
    first, *rest = module.split(".")
    if first not in _FOLDERS:
        return None
    path = _FOLDERS[first].joinpath(*rest)
    for found in (path.with_suffix(".py"), path / "__init__.py"):
        if found.is_file():
            return found
    return None


@cache
def _looked_at(path: Path, _changed_ns: int) -> tuple[bytes, tuple[str, ...]]:
    """Return a digest of a module's syntax tree without texts, and all that it imports."""
    tree = ast.parse(path.read_bytes())
    imports: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            imports += [node.module, *(f"{node.module}.{name.name}" for name in node.names)]
        elif isinstance(node, ast.Import):
            imports += [name.name for name in node.names]
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [one for one in body if not _is_text(one)]  # type: ignore[attr-defined]
    ours = tuple(name for name in imports if name.partition(".")[0] in _FOLDERS)
    return hashlib.sha256(ast.dump(tree).encode()).digest(), ours


def _is_text(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
