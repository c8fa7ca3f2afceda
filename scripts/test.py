"""Run every check: ruff, mypy and all tests, in .venv; arguments go to pytest."""

import sys

if sys.version_info < (3, 11):
    sys.exit(
        "error: svprep needs Python 3.11 or newer; this is Python %d.%d. "
        "Run this script with a newer one, such as: python3.11 scripts/test.py"
        % sys.version_info[:2]
    )

import subprocess

from _setup import (
    OPENGL_PACKAGES,
    ROOT,
    Environment,
    SetupError,
    apt_install,
    missing_opengl,
    run_main,
    step,
)

HELP = """usage: test.py [-h] [PYTEST_ARGUMENT ...]

Make .venv (or complete it), install svprep with its test packages in it, and
run ruff, mypy and pytest. All arguments go to pytest:

    python3 scripts/test.py               everything but the checks that take minutes
    python3 scripts/test.py --long        those, too
    python3 scripts/test.py -k weld -x    tests whose name has "weld", to the first failure

The exit status is the worst of the four. What was skipped is listed by name
before pytest's closing line."""

CHECKS = (
    ("ruff check", ["ruff", "check", "."]),
    ("ruff format", ["ruff", "format", "--check", "."]),
    ("mypy", ["mypy"]),
)


def main():
    """Run the checks in order; return the worst exit status."""
    arguments = sys.argv[1:]
    if arguments[:1] in (["-h"], ["--help"]):
        print(HELP)
        return 0
    environment = Environment()
    environment.ensure(["test", "view"])
    ensure_opengl()
    statuses = {name: run_check(environment, name, words) for name, words in CHECKS}
    print("pytest ...", flush=True)
    # Each skipped test on a line of its own, before the closing line.
    words = ["-m", "pytest", "-ra", "--no-fold-skipped", *arguments]
    statuses["pytest"] = exit_status(subprocess.run([environment.python, *words], cwd=ROOT))
    failed = [name for name, status in statuses.items() if status]
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return max(statuses.values())


def ensure_opengl():
    """Install what OpenGL tests need where it is missing, or say loudly that it is not there."""
    missing = missing_opengl()
    if not missing:
        return
    try:
        apt_install(missing, why="for tests that draw")
        left = missing_opengl()
        problem = f"Installed, but its libraries are not found: {' '.join(left)}" if left else None
    except SetupError as error:
        problem = str(error)
    if problem:
        print(
            f"WARNING: OpenGL is missing; tests that draw are skipped. {problem} "
            f"(all of it: apt-get install {' '.join(OPENGL_PACKAGES)})",
            flush=True,
        )


def run_check(environment, name, words):
    """Run one checker, print what it says if it fails, and return its exit status."""
    command = [environment.python, "-m", *words]
    try:
        with step(name):
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
            if done.returncode != 0:
                raise SetupError(done.stdout + done.stderr)
    except SetupError as error:
        print(error, flush=True)
    return exit_status(done)


def exit_status(done):
    """Return the status of a process as a shell would: 128 + n when signal n ended it."""
    return done.returncode if done.returncode >= 0 else 128 - done.returncode


if __name__ == "__main__":
    run_main(main)
