"""Scripts of ``scripts/`` as modules, to be tested in this process."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def load_script(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return a script as a module of its own, as ``python3 scripts/NAME.py`` finds it."""
    monkeypatch.syspath_prepend(SCRIPTS)
    path = SCRIPTS / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"svprep_script_{name}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
