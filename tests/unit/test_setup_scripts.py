"""What the two README commands do when a machine lacks something.

No test here reaches the network: pip, venv and apt-get are played by fakes.
"""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from tests.unit.scripts import SCRIPTS, load_script


@pytest.fixture
def setup(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return load_script("_setup", monkeypatch)


class FakeMachine:
    """Plays `subprocess.run`: records commands, makes what they would make."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.commands: list[list[str]] = []
        self.pip: Callable[[], tuple[int, str]] = lambda: (0, "")
        self.apt: Callable[[], tuple[int, str]] = lambda: (0, "")
        self.imports: Callable[[], int] = lambda: 0

    def run(self, command: list[Any], **_: object) -> SimpleNamespace:
        words = [str(word) for word in command]
        self.commands.append(words)
        status, output = 0, ""
        if words[1:3] == ["-m", "venv"]:
            for name in ("python", "svprep"):
                path = Path(words[3]) / "bin" / name
                path.parent.mkdir(exist_ok=True)
                path.touch()
        elif words[1:3] == ["-m", "pip"]:
            status, output = self.pip()
        elif words[0] == "apt-get":
            status, output = self.apt()
        elif words[1] == "-c":
            if not Path(words[0]).exists():
                raise FileNotFoundError(words[0])
            status = self.imports()
        return SimpleNamespace(returncode=status, stdout=output, stderr="")

    def ran(self, *words: str) -> list[list[str]]:
        return [c for c in self.commands if set(words) <= set(c)]


@pytest.fixture
def machine(setup: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeMachine:
    (tmp_path / "pyproject.toml").write_text("[project]\n")
    machine = FakeMachine(tmp_path)
    monkeypatch.setattr(setup.subprocess, "run", machine.run)
    return machine


@pytest.fixture
def environment(setup: ModuleType, machine: FakeMachine) -> Any:
    return setup.Environment(machine.root)


def without_ensurepip(setup: ModuleType, monkeypatch: pytest.MonkeyPatch) -> dict[str, bool]:
    state = {"has": False}
    find = importlib.util.find_spec

    def find_spec(name: str) -> object:
        return None if name == "ensurepip" and not state["has"] else find(name)

    monkeypatch.setattr(setup.importlib.util, "find_spec", find_spec)
    monkeypatch.setattr(setup.shutil, "which", lambda name: f"/usr/bin/{name}")
    return state


def raises_one_line(setup: ModuleType, match: str) -> Any:
    return pytest.raises(setup.SetupError, match=rf"\A[^\n]*{match}[^\n]*\Z")


# ---------------------------------------------------------------- the environment


def test_a_fresh_checkout_gets_a_complete_environment(
    environment: Any, machine: FakeMachine
) -> None:
    environment.ensure(["view"])
    stamp = environment.read_stamp()
    assert (stamp["ours"], stamp["complete"], stamp["extras"]) == (True, True, ["view"])
    assert len(machine.ran("--editable", ".[view]")) == 1


def test_a_complete_environment_is_left_alone(
    environment: Any, machine: FakeMachine, capsys: pytest.CaptureFixture[str]
) -> None:
    environment.ensure(["test", "view"])
    machine.commands.clear()
    environment.ensure(["view"])
    assert not machine.ran("pip")
    assert not machine.ran("venv")
    assert ".venv is ready" in capsys.readouterr().out


def test_a_further_extra_joins_those_that_are_there(environment: Any, machine: FakeMachine) -> None:
    environment.ensure(["view"])
    environment.ensure(["test"])
    assert len(machine.ran("venv")) == 1
    assert len(machine.ran(".[test,view]")) == 1
    assert environment.is_ready(["test", "view"])


def test_changed_dependencies_are_installed(environment: Any, machine: FakeMachine) -> None:
    environment.ensure(["view"])
    (machine.root / "pyproject.toml").write_text("[project]\nname = 'other'\n")
    environment.ensure(["view"])
    assert len(machine.ran("venv")) == 1
    assert len(machine.ran("pip")) == 2


def test_a_failed_first_installation_leaves_nothing(
    setup: ModuleType, environment: Any, machine: FakeMachine
) -> None:
    machine.pip = lambda: (1, "ERROR: Could not build wheels for h5py\n")
    with raises_one_line(setup, "h5py.*out/setup.log"):
        environment.ensure(["view"])
    assert not environment.path.exists()
    assert "h5py" in (machine.root / "out" / "setup.log").read_text()


@pytest.mark.parametrize("when", ["venv", "pip"])
def test_an_interrupted_setup_leaves_nothing(
    environment: Any, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    run = machine.run

    def interrupted(command: list[Any], **options: object) -> SimpleNamespace:
        done = run(command, **options)
        if when in command:
            raise KeyboardInterrupt
        return done

    monkeypatch.setattr(subprocess, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        environment.ensure(["view"])
    assert not environment.path.exists()


def test_what_a_killed_setup_left_is_removed_by_the_next(
    environment: Any, machine: FakeMachine
) -> None:
    environment.path.mkdir()
    environment._write_stamp(ours=True, complete=False, extras=["view"])
    (environment.path / "half").mkdir()
    environment.ensure(["view"])
    assert not (environment.path / "half").exists()
    assert environment.is_ready(["view"])


def test_a_failed_completion_keeps_the_environment_that_worked(
    setup: ModuleType, environment: Any, machine: FakeMachine
) -> None:
    environment.ensure(["view"])
    machine.pip = lambda: (1, "ERROR: no")
    with raises_one_line(setup, "pip: no"):
        environment.ensure(["test"])
    assert environment.is_ready(["view"])
    assert not environment.is_ready(["test"])


def test_an_environment_that_lost_its_python_is_made_anew(
    environment: Any, machine: FakeMachine
) -> None:
    environment.ensure(["view"])
    environment.python.unlink()
    environment.ensure(["view"])
    assert len(machine.ran("venv")) == 2
    assert environment.is_ready(["view"])


def test_a_moved_checkout_makes_its_environment_anew(
    setup: ModuleType, environment: Any, machine: FakeMachine, tmp_path_factory: Any
) -> None:
    environment.ensure(["view"])
    moved = tmp_path_factory.mktemp("elsewhere") / "checkout"
    machine.root.rename(moved)
    there = setup.Environment(moved)
    assert not there.is_ready(["view"])
    there.ensure(["view"])
    assert len(machine.ran("venv")) == 2


# ---------------------------------------------------------------- somebody else's .venv


def test_a_foreign_environment_is_used(environment: Any, machine: FakeMachine) -> None:
    environment.python.parent.mkdir(parents=True)
    environment.python.touch()
    environment.svprep.touch()
    environment.ensure(["view"])
    assert not machine.ran("venv")
    assert environment.is_ready(["view"])
    assert environment.read_stamp()["ours"] is False


def test_a_foreign_environment_survives_every_failure(
    setup: ModuleType, environment: Any, machine: FakeMachine
) -> None:
    environment.python.parent.mkdir(parents=True)
    environment.python.touch()
    for _ in range(2):
        machine.pip = lambda: (1, "ERROR: no")
        with raises_one_line(setup, "pip: no"):
            environment.ensure(["view"])
        environment.remove()
        assert environment.python.exists()
    machine.imports = lambda: 1
    with raises_one_line(setup, "not made by this script"):
        environment.ensure(["view"])
    assert environment.python.exists()


@pytest.mark.parametrize("stamp", ["", "[]", "{", '{"ours": false, "complete": true}'])
def test_a_stamp_that_does_not_say_ours_protects(environment: Any, stamp: str) -> None:
    environment.path.mkdir()
    environment.stamp_path.write_text(stamp)
    environment.remove()
    assert environment.stamp_path.exists()


# ---------------------------------------------------------------- Debian's packages


def test_without_ensurepip_the_debian_line_is_named(
    setup: ModuleType, environment: Any, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_ensurepip(setup, monkeypatch)
    monkeypatch.setattr(setup, "is_root", lambda: False)
    with raises_one_line(
        setup, r"lacks the module ensurepip.*Run: sudo apt-get install python3[.\d]*-venv"
    ):
        environment.ensure(["view"])
    assert not machine.ran("apt-get")
    assert not environment.path.exists()


def test_without_ensurepip_root_installs_it(
    setup: ModuleType, environment: Any, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = without_ensurepip(setup, monkeypatch)
    monkeypatch.setattr(setup, "is_root", lambda: True)

    def apt() -> tuple[int, str]:
        state["has"] = True
        return 0, ""

    machine.apt = apt
    environment.ensure(["view"])
    assert [c[1] for c in machine.ran("apt-get")] == ["update", "install"]
    assert environment.is_ready(["view"])


def test_a_failing_apt_get_is_one_line(
    setup: ModuleType, environment: Any, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_ensurepip(setup, monkeypatch)
    monkeypatch.setattr(setup, "is_root", lambda: True)
    machine.apt = lambda: (100, "Reading\nE: Unable to locate package python3-venv\nE: more\n")
    with raises_one_line(setup, "Unable to locate package"):
        environment.ensure(["view"])
    assert not environment.path.exists()


def test_a_system_without_apt_get_is_told_so(
    setup: ModuleType, environment: Any, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_ensurepip(setup, monkeypatch)
    monkeypatch.setattr(setup.shutil, "which", lambda name: None)
    with raises_one_line(setup, "lacks the module ensurepip.*package manager"):
        environment.ensure(["view"])


def test_missing_opengl_never_stops_the_tests(
    machine: FakeMachine, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = load_script("test", monkeypatch)
    monkeypatch.setattr(script, "missing_opengl", lambda: ["libegl1"])

    def fail(packages: list[str], why: str) -> None:
        raise script.SetupError(f"Run: sudo apt-get install {' '.join(packages)}")

    monkeypatch.setattr(script, "apt_install", fail)
    script.ensure_opengl()
    said = capsys.readouterr().out
    assert "WARNING: OpenGL is missing" in said
    assert "apt-get install libegl1 libgl1 libgl1-mesa-dri" in said


# ---------------------------------------------------------------- what is said


@pytest.mark.parametrize(
    ("output", "expected"),
    [
        (
            "WARNING: Retrying (Retry(total=1)) after connection broken by "
            "'NewConnectionError(': Failed to establish a new connection: [Errno -3] Temporary "
            "failure in name resolution')'\nERROR: Could not find a version that satisfies the "
            "requirement hatchling>=1.27 (from versions: none)\nERROR: No matching distribution\n",
            "the package index cannot be reached; is there a network? (pip: Could not find a "
            "version that satisfies the requirement hatchling>=1.27 (from versions: none))",
        ),
        ("ERROR: [Errno 28] No space left on device\n", "the disk is full (pip: [Errno 28] No "),
        ("ERROR: No matching distribution found for numba\nnote", "pip: No matching distribution"),
        ("Traceback\n  deep\nValueError: x\n", "pip: ValueError: x"),
        ("", "pip: pip said nothing"),
    ],
)
def test_pip_is_summarised_in_one_line(setup: ModuleType, output: str, expected: str) -> None:
    said = setup.summarise_pip(output)
    assert said.startswith(expected)
    assert "\n" not in said
    assert len(said) < 300


@pytest.mark.parametrize("script", ["quickstart", "test"])
def test_an_old_python_is_told_which_one_is_needed(script: str) -> None:
    code = (
        "import runpy, sys; sys.version_info = (3, 9, 2, 'final', 0); "
        f"sys.argv = ['x']; runpy.run_path({str(SCRIPTS / (script + '.py'))!r})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "needs Python 3.11 or newer; this is Python 3.9" in done.stderr


@pytest.mark.parametrize("script", ["quickstart", "test"])
def test_help_does_nothing_but_help(script: str) -> None:
    command = [sys.executable, str(SCRIPTS / f"{script}.py"), "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("usage:")


def test_a_failing_svprep_is_one_line_with_its_last_words(
    setup: ModuleType, machine: FakeMachine, environment: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = load_script("quickstart", monkeypatch)

    def fail(command: list[Any], **_: object) -> SimpleNamespace:
        return SimpleNamespace(returncode=1, stdout="", stderr="reading\nD302 OPEN_SHELL: x\n")

    monkeypatch.setattr(subprocess, "run", fail)
    with pytest.raises(script.SetupError, match=r"\Asvprep build ended with status 1: D302"):
        script.run_svprep(environment, "build", Path("model.obj"))


@pytest.mark.skipif(not hasattr(signal, "SIGTERM") or os.name == "nt", reason="needs signals")
def test_a_terminated_setup_cleans_up(tmp_path: Path) -> None:
    """With real processes: the set-up is ended by SIGTERM while "pip" runs."""
    (tmp_path / "pyproject.toml").write_text("[project]\n")
    started = tmp_path / "started"
    code = f"""
import sys, pathlib
sys.path.insert(0, {str(SCRIPTS)!r})
import _setup
environment = _setup.Environment(pathlib.Path({str(tmp_path)!r}))
def create():
    environment.python.parent.mkdir(parents=True)
    environment._write_stamp(ours=True, complete=False, extras=())
    text = "#!/bin/sh\\ntouch {started}\\nexec sleep 60\\n"
    environment.python.write_text(text)
    environment.python.chmod(0o755)
environment._create = create
_setup.run_main(lambda: environment.ensure(["view"]) or 0)
"""
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 30
    while not started.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert json.loads((tmp_path / ".venv" / "svprep-setup.json").read_text())["complete"] is False
    process.terminate()
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors == "interrupted\n"
    assert not (tmp_path / ".venv").exists()
