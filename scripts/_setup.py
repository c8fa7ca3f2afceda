"""What the two README commands share: the environment in .venv, and how they talk.

Standard library only. An environment made here carries a stamp file from its
first moment, which says that it is ours and whether it is complete; nothing
without that mark is ever removed.
"""

from __future__ import annotations

import contextlib
import ctypes
import glob
import hashlib
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STAMP_NAME = "svprep-setup.json"
OPENGL_PACKAGES = ("libegl1", "libgl1", "libgl1-mesa-dri")

_NETWORK_SIGNS = (
    "Failed to establish a new connection",
    "NameResolutionError",
    "Temporary failure in name resolution",
    "Name or service not known",
    "Network is unreachable",
    "Connection refused",
    "ConnectTimeoutError",
    "ReadTimeoutError",
    "ProxyError",
)


class SetupError(Exception):
    """Something that the person at the keyboard can put right, in one line."""


# ---------------------------------------------------------------- talking


@contextlib.contextmanager
def step(title: str) -> Iterator[list[str]]:
    """Print `title`, and when the block ends the seconds it took.

    What the block appends to the list is printed behind the seconds.
    """
    print(f"{title} ...", end=" ", flush=True)
    start = time.perf_counter()
    remarks: list[str] = []
    try:
        yield remarks
    except BaseException:
        print(f"failed after {time.perf_counter() - start:.1f} s", flush=True)
        raise
    remark = f"  {'; '.join(remarks)}" if remarks else ""
    print(f"{time.perf_counter() - start:.1f} s{remark}", flush=True)


def run_main(main: Callable[[], int]) -> None:
    """Exit with what `main` returns; problems become one line, Ctrl-C status 130."""
    for name in ("SIGTERM", "SIGHUP"):  # cleaning up goes the way of Ctrl-C
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), _interrupt)
    try:
        status = main()
    except SetupError as error:
        print(f"error: {error}", file=sys.stderr)
        status = 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        status = 130
    sys.stdout.flush()
    sys.exit(status)


def _interrupt(signum: int, frame: object) -> None:
    raise KeyboardInterrupt


def shown(path: Path, root: Path = ROOT) -> str:
    """Return `path` as a reader in the repository's root would type it."""
    try:
        return str(path.relative_to(root))
    except ValueError:
        return str(path)


# ---------------------------------------------------------------- Debian's packages


def is_root() -> bool:
    """Whether this process may install system packages."""
    return hasattr(os, "geteuid") and os.geteuid() == 0


def apt_install(packages: Sequence[str], why: str) -> None:
    """Install Debian packages when root; else raise with the line to run.

    Raises
    ------
    SetupError
        No apt-get here, not root, or apt-get failed.
    """
    line = f"apt-get install {' '.join(packages)}"
    if shutil.which("apt-get") is None:
        raise SetupError(
            f"Install it with this system's package manager (Debian's line is: {line})"
        )
    if not is_root():
        raise SetupError(f"Run: sudo {line}")
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    commands = (
        ["apt-get", "update", "-q"],
        ["apt-get", "install", "-q", "-y", "--no-install-recommends", *packages],
    )
    with step(f"{line} ({why})"):
        for command in commands:
            try:
                done = subprocess.run(
                    command,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                    errors="replace",
                    timeout=600,
                )
            except subprocess.TimeoutExpired:
                raise SetupError(f'"{" ".join(command)}" took more than 10 minutes') from None
        # A failing update matters only when the packages are not found after it.
        if done.returncode != 0:
            said = [text for text in done.stdout.splitlines() if text.startswith("E:")]
            why_not = said[0] if said else f"status {done.returncode}"
            raise SetupError(f'"{line}" failed: {why_not}')


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def missing_opengl() -> list[str]:
    """Return the Debian packages of OpenGL whose libraries are not found (Linux only)."""
    if sys.platform != "linux":
        return []
    drivers = ("/usr/lib*/dri/*_dri.so", "/usr/lib*/*/dri/*_dri.so", "/usr/lib*/*/libgallium*.so")
    is_there = {
        "libegl1": _loads("libEGL.so.1"),
        "libgl1": _loads("libGL.so.1"),
        "libgl1-mesa-dri": any(glob.glob(pattern) for pattern in drivers),
    }
    return [package for package in OPENGL_PACKAGES if not is_there[package]]


# ---------------------------------------------------------------- the environment


def _missing_venv_package() -> str | None:
    """Return the Debian package without which ``python -m venv`` cannot work, or None."""
    importlib.invalidate_caches()
    if all(importlib.util.find_spec(name) for name in ("venv", "ensurepip")):
        return None
    here, default = Path(sys.executable).resolve(), Path("/usr/bin/python3")
    if default.exists() and default.resolve() != here and here.parent == default.parent:
        return f"python3.{sys.version_info.minor}-venv"
    return "python3-venv"


def ensure_venv_module() -> None:
    """Make sure that this Python can make environments.

    Raises
    ------
    SetupError
        It cannot, and the package that it lacks could not be installed.
    """
    package = _missing_venv_package()
    if package is None:
        return
    try:
        apt_install([package], why="this Python cannot make environments without it")
    except SetupError as error:
        raise SetupError(
            f"{sys.executable} lacks the module ensurepip, without which no environment "
            f"can be made. {error}"
        ) from None
    if _missing_venv_package() is not None:
        raise SetupError(f"{package} is installed, but {sys.executable} still lacks ensurepip")


def summarise_pip(output: str) -> str:
    """Return one line that says why pip failed."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line.removeprefix("ERROR: ") for line in lines if line.startswith("ERROR:")]
    said = errors[0] if errors else (lines[-1] if lines else "pip said nothing")
    if len(said) > 200:
        said = said[:197] + "..."
    if any(sign in output for sign in _NETWORK_SIGNS):
        return f"the package index cannot be reached; is there a network? (pip: {said})"
    if "No space left on device" in output:
        return f"the disk is full (pip: {said})"
    return f"pip: {said}"


class Environment:
    """The virtual environment of a checkout.

    Parameters
    ----------
    root : Path
        The checkout: the environment is ``root/.venv``, logs go to ``root/out``.
    """

    def __init__(self, root: Path = ROOT) -> None:
        self.root = root
        self.path = root / ".venv"
        self.stamp_path = self.path / STAMP_NAME
        self.log_path = root / "out" / "setup.log"
        folder, suffix = ("Scripts", ".exe") if os.name == "nt" else ("bin", "")
        self.python = self.path / folder / f"python{suffix}"
        self.svprep = self.path / folder / f"svprep{suffix}"

    # The stamp: {"ours": bool, "complete": bool, "root": str, "hash": str of
    # pyproject.toml, "extras": [str]}. A venv cannot be moved, hence the root.

    def read_stamp(self) -> dict[str, object] | None:
        """Return the stamp; None where there is none."""
        try:
            stamp = json.loads(self.stamp_path.read_text("utf-8"))
        except (OSError, ValueError):
            return None
        return stamp if isinstance(stamp, dict) else None

    def _write_stamp(self, *, ours: bool, complete: bool, extras: Sequence[str]) -> None:
        stamp = {
            "made by": "scripts/_setup.py",
            "ours": ours,
            "complete": complete,
            "root": str(self.root),
            "hash": self._hash(),
            "extras": sorted(extras),
        }
        temporary = self.stamp_path.with_suffix(".tmp")
        temporary.write_text(json.dumps(stamp) + "\n", "utf-8")
        os.replace(temporary, self.stamp_path)

    def _hash(self) -> str:
        return hashlib.sha256((self.root / "pyproject.toml").read_bytes()).hexdigest()

    def _works(self, module: str = "sys") -> bool:
        """Whether the environment's Python starts, is new enough and imports `module`."""
        code = f"import sys, {module}; sys.exit(sys.version_info < (3, 11))"
        try:
            return subprocess.run([self.python, "-c", code], capture_output=True).returncode == 0
        except OSError:
            return False

    def is_ready(self, extras: Sequence[str]) -> bool:
        """Whether nothing has to be done for `extras`."""
        stamp = self.read_stamp() or {}
        installed = stamp.get("extras")
        return (
            stamp.get("complete") is True
            and stamp.get("root") == str(self.root)
            and stamp.get("hash") == self._hash()
            and isinstance(installed, list)
            and set(extras) <= set(installed)
            and self.svprep.exists()
            and self._works("svprep")
        )

    def ensure(self, extras: Sequence[str]) -> None:
        """Make or complete the environment, with svprep and `extras` installed in it.

        Quick when it is complete. A failed or interrupted set-up leaves no half
        environment of ours; one that was made by somebody else is used, and
        never removed.

        Raises
        ------
        SetupError
            It could not be made, in one line.
        """
        with _only_one_at_a_time(self.root):
            if self.is_ready(extras):
                print(f"Environment {shown(self.path, self.root)} is ready.", flush=True)
                return
            self._prepare_folder()
            self._install(extras)

    def _prepare_folder(self) -> None:
        """Leave a folder that pip can install into, or raise."""
        stamp = self.read_stamp()
        if stamp is not None and stamp.get("ours") is True:
            is_whole = stamp.get("complete") is True and stamp.get("root") == str(self.root)
            if is_whole and self._works("svprep"):
                return
            self.remove("unfinished, moved or broken")
        elif os.path.lexists(self.path) and not self._is_empty_folder():
            if not self._works():
                raise SetupError(
                    f"{self.path} is there, was not made by this script and holds no working "
                    "Python 3.11 or newer. Move it away, and run this again"
                )
            print(f"Using {shown(self.path, self.root)}, which this script did not make.")
            return
        ensure_venv_module()
        self._create()

    def _is_empty_folder(self) -> bool:
        return self.path.is_dir() and not any(self.path.iterdir())

    def _create(self) -> None:
        try:
            with step(f"Making the environment {shown(self.path, self.root)}"):
                self.path.mkdir(exist_ok=True)
                self._write_stamp(ours=True, complete=False, extras=())
                command = [sys.executable, "-m", "venv", str(self.path)]
                done = subprocess.run(command, capture_output=True, text=True)
                if done.returncode != 0:
                    said = (done.stdout + done.stderr).strip().splitlines()
                    raise SetupError(f"python -m venv failed: {said[-1] if said else 'silently'}")
        except OSError as error:
            self.remove()
            raise SetupError(f"the environment cannot be made: {error}") from None
        except BaseException:
            self.remove()
            raise

    def _install(self, extras: Sequence[str]) -> None:
        """Install the checkout; see `ensure` for what a failure leaves behind."""
        before = self.read_stamp()
        ours = before is not None and before.get("ours") is True
        was_complete = before is not None and before.get("complete") is True
        installed = before.get("extras") if before else None
        wanted = sorted({*extras, *(installed if isinstance(installed, list) else ())})
        target = f".[{','.join(wanted)}]"
        if ours:
            self._write_stamp(ours=True, complete=False, extras=wanted)
        try:
            with step(f"Installing {target} and what it needs"):
                self._pip("install", "--editable", target)
        except SetupError:
            # pip changes nothing before it has everything, and undoes what fails
            # later: an environment that was complete still works as before.
            if ours and was_complete and before is not None:
                self.stamp_path.write_text(json.dumps(before) + "\n", "utf-8")
            elif ours:
                self.remove()
            raise
        except BaseException:
            if ours:
                self.remove()
            raise
        self._write_stamp(ours=ours, complete=True, extras=wanted)

    def _pip(self, *arguments: str) -> None:
        options = ["--disable-pip-version-check", "--no-input", "--quiet", "--retries", "2"]
        try:
            done = subprocess.run(
                [self.python, "-m", "pip", *arguments, *options],
                cwd=self.root,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
            )
        except OSError as error:
            raise SetupError(f"pip cannot be started: {error}") from None
        if done.returncode != 0:
            with contextlib.suppress(OSError):
                self.log_path.parent.mkdir(exist_ok=True)
                self.log_path.write_text(done.stdout, "utf-8")
            raise SetupError(
                f"{summarise_pip(done.stdout)}. All it said: {shown(self.log_path, self.root)}"
            )

    def remove(self, why: str = "") -> None:
        """Remove the environment, if the stamp says that it is ours; the stamp goes last."""
        stamp = self.read_stamp()
        if stamp is None or stamp.get("ours") is not True:
            return
        if why:
            print(f"Removing {shown(self.path, self.root)} of an earlier run: {why}.", flush=True)
        for entry in self.path.iterdir():
            if entry.name == STAMP_NAME:
                continue
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry, ignore_errors=True)
            else:
                entry.unlink(missing_ok=True)
        shutil.rmtree(self.path, ignore_errors=True)


@contextlib.contextmanager
def _only_one_at_a_time(root: Path) -> Iterator[None]:
    """Hold a lock on the checkout's folder while an environment is made in it."""
    try:
        import fcntl
    except ImportError:  # Windows: best effort
        yield
        return
    descriptor = os.open(root, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            print("Waiting for another set-up of this checkout to end ...", flush=True)
            with contextlib.suppress(OSError):  # a file system without locks
                fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
