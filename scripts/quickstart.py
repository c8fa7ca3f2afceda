"""Set svprep up in .venv, prepare the sample city, check it, and say what to do next."""

import sys

if sys.version_info < (3, 11):
    sys.exit(
        "error: svprep needs Python 3.11 or newer; this is Python %d.%d. "
        "Run this script with a newer one, such as: python3.11 scripts/quickstart.py"
        % sys.version_info[:2]
    )

import argparse
import subprocess
from pathlib import Path

from _setup import (
    OPENGL_PACKAGES,
    ROOT,
    Environment,
    SetupError,
    apt_install,
    missing_opengl,
    run_main,
    shown,
    step,
)

VIEW = ["--light", "dir:250,25", "--camera=-60,-230,80,0,0,-10,45", "--size", "1280x720"]
"""Over the sample city's park, on a late afternoon; five samples smooth the edges."""


def main():
    """Run the steps in order; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="quickstart.py",
        description="Make .venv (or complete it), install svprep with its viewer in it, build the "
        "sample city's cache in out/, validate it, show what it holds, and draw it in shadow. "
        "Run it again at any time: what is done is not done twice.",
    )
    parser.parse_args()

    environment = Environment()
    environment.ensure(["view"])
    sample = find_sample()
    cache = ROOT / "out" / "small_city.svp.h5"
    cache.parent.mkdir(exist_ok=True)
    run_svprep(environment, "build", sample, "-o", cache)
    run_svprep(environment, "validate", cache)
    told = run_svprep(environment, "info", cache).splitlines()
    print("\n".join(line for line in told if not line.startswith("bytes ")))

    picture = draw(environment, cache)
    activate = "Scripts\\activate" if sys.platform == "win32" else "bin/activate"
    verb = "" if sys.platform == "win32" else ". "
    print(f"""
Made {shown(cache)} ({cache.stat().st_size / 1e6:.1f} MB) from {shown(sample)}.
{f"Its picture: {shown(picture)}" if picture else "No picture was drawn; see above."}
Next:
    {verb}{Path(".venv") / activate}
    svprep info {shown(cache)}
    svprep view {shown(cache)}
    svprep build YOUR_MODEL.obj
    svprep --help""")
    return 0


def draw(environment, cache):
    """Draw the sample city; return the picture's path, or None where there is no OpenGL."""
    missing = missing_opengl()
    if missing:
        try:
            apt_install(missing, why="to draw")
        except SetupError as error:
            print(f"WARNING: {error} (to draw: apt-get install {' '.join(OPENGL_PACKAGES)})")
            return None
    picture = cache.with_name("small_city.png")
    try:
        run_svprep(environment, "render", cache, *VIEW, "--samples", "5", "-o", picture)
    except SetupError as error:
        print(f"WARNING: the city was built, but not drawn: {error}")
        return None
    return picture


def find_sample():
    """Return the sample city's path."""
    found = sorted((ROOT / "data").glob("small_city.obj*"))
    if not found:
        raise SetupError("data/small_city.obj.gz is missing: the checkout is not complete")
    return found[0]


def run_svprep(environment, command, *arguments):
    """Run one svprep command; return what it printed."""
    words = [command, *(shown(a) if isinstance(a, Path) else a for a in arguments)]
    with step(f"svprep {' '.join(words)}"):
        done = subprocess.run(
            [environment.svprep, *words],
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
        )
        if done.returncode != 0:
            said = (done.stderr.strip() or done.stdout.strip()).splitlines()
            raise SetupError(
                f"svprep {command} ended with status {done.returncode}: "
                f"{said[-1] if said else 'it said nothing'}"
            )
    return done.stdout


if __name__ == "__main__":
    run_main(main)
