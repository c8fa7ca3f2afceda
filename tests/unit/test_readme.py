"""The README's tour, run: every line of output it shows is really printed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", (ROOT / "README.md").read_text(), re.M | re.S)


def run(line: str, folder: Path) -> str:
    function = f'svprep() {{ "{sys.executable}" -m svprep "$@"; }}; '
    done = subprocess.run(
        ["bash", "-c", function + line],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'runtime'}"},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


def test_the_tour_prints_what_the_readme_shows(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "out").mkdir()
    for name in ("small_city.obj.gz", "hamlet.city.json"):
        shutil.copy(ROOT / "data" / name, tmp_path / "data")
    tried = 0
    for block in [text for _, text in BLOCKS if text.startswith("$ ")]:
        shown: list[str] = []
        printed = ""
        for line in [*block.splitlines(), "$ end"]:
            if not line.startswith("$ "):
                shown += [line] if line != "..." else []
                continue
            missing = [text for text in shown if text not in printed.splitlines()]
            assert not missing, missing
            tried += len(shown)
            shown = []
            command = line.removeprefix("$ ")
            if command.startswith(("svprep", "grep")):
                printed = run(command, tmp_path / "out")
    assert tried >= 20


def test_the_python_example_runs(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "out").mkdir()
    shutil.copy(ROOT / "data" / "small_city.obj.gz", tmp_path / "data")
    (code,) = [text for language, text in BLOCKS if language == "python"]
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path / "out",
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'runtime'}"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "triangles" in done.stdout


def test_every_link_leads_somewhere() -> None:
    for name in ("README.md", "ARCHITECTURE.md", "FORMAT.md"):
        text = (ROOT / name).read_text()
        for target in re.findall(r"\]\(([^)#]+)\)", text):
            assert target.startswith("http") or (ROOT / target).exists(), target
