"""What is run: builds and their peers, by turns, in fresh processes.

Every build says the digest of what its cache holds. Builds of the same model and lights must
agree, whatever they took over and however little memory they had; of others they must differ.
"""

from __future__ import annotations

import os
import random
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from build_benchmark.models import Building, lamp_near, make_city, write_edited, write_without
from build_benchmark.processes import (
    Built,
    CommandFailed,
    Run,
    answer_of,
    environment,
    has_module,
    run,
)

Execute = Callable[[Sequence[str], Mapping[str, str] | None], Run]
Kind = tuple[str, str, Path, Sequence[str]]
"""A build over an older cache: name, content, model, options."""

BUILD, FIRST, HELP, INCREMENTAL, REGION = "build", "first", "help", "incremental", "region"
FULL = "svprep build"
LIGHT: Final = ("--light", "dir:135,40")
LEAST_FIRST_ROUNDS, MOST_REGION_ROUNDS, HELP_ROUNDS = 3, 3, 20
REGION_FACTOR = 10
MEMORY = "1G"

READ, PYMESHLAB_LOAD = "read bytes", "pymeshlab load"
PEERS: Final = {
    READ: "import sys; open(sys.argv[1], 'rb').read()",
    "trimesh load": "import sys, trimesh; trimesh.load(sys.argv[1], process=False)",
    PYMESHLAB_LOAD: "import sys, pymeshlab as p; p.MeshSet().load_new_mesh(sys.argv[1])",
    "pymeshlab load + repair": (
        "import sys, pymeshlab as p; m = p.MeshSet(); m.load_new_mesh(sys.argv[1]); "
        "m.meshing_remove_duplicate_vertices(); m.meshing_remove_duplicate_faces(); "
        "m.meshing_remove_null_faces(); m.meshing_repair_non_manifold_edges()"
    ),
    "MeshLib load": "import sys; from meshlib import mrmeshpy as m; m.loadMesh(sys.argv[1])",
}
MODULES: Final = {"trimesh": "trimesh", "pymeshlab": "pymeshlab", "MeshLib": "meshlib"}

UNEDITED, EDITED, REMOVED, UNLIT = (
    "nothing changed",
    "a building edited",
    "a building removed",
    "the light dropped",
)
LAMP_FULL, LAMP_EDITED = "svprep build, a lamp", "a building edited, a lamp"
FULL_OF: Final = {
    **dict.fromkeys((FULL, UNEDITED, EDITED, REMOVED, UNLIT), FULL),
    **dict.fromkeys((LAMP_FULL, LAMP_EDITED), LAMP_FULL),
}
"""The full builds that builds over an older cache are compared with, in the report's order."""
EMPTY, FILLED = "no kernel compiled", "the same kernels, compiled"
LARGE, LITTLE_MEMORY = "ten times the city", f"ten times the city, --memory {MEMORY}"
SVPREP_HELP, PLAIN_TYPER, RICH_TYPER = "svprep --help", "bare Typer, plain", "bare Typer, Rich"

_BARE = """
import typer
app = typer.Typer({options})
"""
_BARE_COMMAND = """
@app.command()
def command_{number}(name: str = "") -> None:
    "Do something."
"""
_COUNT = "from svprep.cli import app; print(len(app.registered_commands))"
_NUMPY = "import sys; from svprep import cli; cli.app(['--help'], standalone_mode=False); "


class Inconsistent(Exception):
    """Two caches that must be equal differ, or the other way about."""


@dataclass(frozen=True, slots=True)
class Row:
    """One process of the run."""

    part: str
    name: str
    turn: int
    """The round, from 0; -1 before the first."""
    run: Run
    built: Built | None = None


@dataclass(slots=True)
class Bench:
    """The run: what it uses, and the processes that it has finished."""

    city: Path
    work: Path
    n_rounds: int
    execute: Execute = run
    rows: list[Row] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    """Peers that are not installed."""
    _digests: dict[str, str] = field(default_factory=dict)

    def compare(self) -> None:
        """Time a full build, and others that read the same file."""
        peers = dict(self._installed())
        self.full(BUILD, -1)
        for turn in range(self.n_rounds):
            # In another order each time: what a large process gave back costs the next one time.
            names = [FULL, *peers]
            random.Random(turn).shuffle(names)
            for name in names:
                if name == FULL:
                    self.full(BUILD, turn)
                    continue
                command = [sys.executable, "-c", peers[name], str(self.city)]
                if self._run(BUILD, name, turn, command).exit_status:  # it would again
                    del peers[name]

    def first_builds(self) -> None:
        """Time builds with no compiled kernel, each one followed by one with those it left."""
        for turn in range(max(LEAST_FIRST_ROUNDS, self.n_rounds)):
            with tempfile.TemporaryDirectory(dir=self.work) as folder:
                for name in (EMPTY, FILLED):
                    self._build(
                        FIRST, name, turn, "city", self.city, self._cache, ["--full", *LIGHT],
                        {"NUMBA_CACHE_DIR": folder},
                    )  # fmt: skip

    def helps(self, n_rounds: int = HELP_ROUNDS) -> None:
        """Time ``svprep --help`` and bare Typer programs with as many commands."""
        with tempfile.TemporaryDirectory(dir=self.work) as folder:
            counted = self.execute([sys.executable, "-c", _COUNT], None)
            n_commands = int(answer_of(counted, "svprep.cli"))
            programs = {SVPREP_HELP: "svprep"}
            for module, name, options in (
                ("bare_plain", PLAIN_TYPER, "add_completion=False, rich_markup_mode=None"),
                ("bare_rich", RICH_TYPER, ""),
            ):
                programs[name] = module
                text = _bare_program(n_commands, options)
                (Path(folder) / f"{module}.py").write_text(text, encoding="utf-8")
            variables = {"PYTHONPATH": _path_with(folder)}
            for turn in range(-1, n_rounds):  # the first time compiles them to bytecode
                for name, module in programs.items():
                    command = [sys.executable, "-m", module, "--help"]
                    check_help(self._run(HELP, name, turn, command, variables), name)

    def imports_numpy(self) -> bool:
        """Whether ``svprep --help`` imports NumPy."""
        code = _NUMPY + "print('', 'numpy' in sys.modules)"
        done = self.execute([sys.executable, "-c", code], None)
        check_help(done, SVPREP_HELP)
        return done.said.split()[-1] == "True"

    def incremental(self, building: Building) -> None:
        """Time builds over an older cache, each kind after a full build of the same round."""
        with tempfile.TemporaryDirectory(dir=self.work) as folder:
            edited, removed = (Path(folder) / name / self.city.name for name in ("edited", "less"))
            for path, write in ((edited, write_edited), (removed, write_without)):
                path.parent.mkdir()
                write(self.city, building, path)
            kinds: list[Kind] = [
                (UNEDITED, "city", self.city, LIGHT),
                (EDITED, "edited", edited, LIGHT),
                (REMOVED, "removed", removed, LIGHT),
                (UNLIT, "city, no light", self.city, ()),
            ]
            self._over_older(kinds, Path(folder) / "older.svp.h5")
            self._with_lamp(edited, ["--light", lamp_near(self.city, building)])

    def _over_older(self, kinds: Sequence[Kind], older: Path) -> None:
        """Build each kind of model over a copy of the cache `older`, which is made first."""
        self._build(INCREMENTAL, FULL, -1, "city", self.city, older, ["--full", *LIGHT])
        for name, content, model, light in kinds:  # what each must be equal to
            full = f"{FULL}, {name}"
            self._build(INCREMENTAL, full, -1, content, model, self._cache, ["--full", *light])
        for turn in range(-1, self.n_rounds):
            if turn >= 0:
                self.full(INCREMENTAL, turn)
            for name, content, model, light in kinds:
                shutil.copyfile(older, self._cache)
                self._build(INCREMENTAL, name, turn, content, model, self._cache, light)

    def _with_lamp(self, edited: Path, lamp: Sequence[str]) -> None:
        """Build the city with a lamp whole, and a building edited over what that made."""
        whole, cache = ["--full", *lamp], self._cache
        name = f"{FULL}, {LAMP_EDITED}"
        self._build(INCREMENTAL, name, -1, "edited, lamp", edited, cache, whole)
        for turn in range(-1, self.n_rounds):
            self._build(INCREMENTAL, LAMP_FULL, turn, "city, lamp", self.city, cache, whole)
            self._build(INCREMENTAL, LAMP_EDITED, turn, "edited, lamp", edited, cache, lamp)

    def region(self, objects: int) -> None:
        """Time ten times the city, whole and with little memory, after the small one."""
        large = make_city(objects, self.work / f"city_{objects}.obj")
        options = ["--full", *LIGHT]
        read = [sys.executable, "-c", PEERS[READ], str(large)]
        self._run(REGION, READ, -1, read)  # so that no build waits for the disk
        for turn in range(min(MOST_REGION_ROUNDS, self.n_rounds)):
            self.full(REGION, turn)
            self._build(REGION, LARGE, turn, "region", large, self._cache, options)
            little = [*options, "--memory", MEMORY]
            self._build(REGION, LITTLE_MEMORY, turn, "region", large, self._cache, little)

    def full(self, part: str, turn: int) -> None:
        """Build the city whole, with all indices and one light."""
        self._build(part, FULL, turn, "city", self.city, self._cache, ["--full", *LIGHT])

    def clean(self) -> None:
        """Remove the caches; cities stay."""
        self._cache.unlink(missing_ok=True)

    @property
    def _cache(self) -> Path:
        return self.work / "benchmark.svp.h5"

    def _build(
        self,
        part: str,
        name: str,
        turn: int,
        content: str,
        model: Path,
        cache: Path,
        options: Sequence[str],
        variables: Mapping[str, str] | None = None,
    ) -> None:
        """Build once, and check what the cache holds against the other builds of `content`.

        Raises
        ------
        CommandFailed
            The build did not end well.
        Inconsistent
            The digests are wrong.
        """
        _tell(part, name, turn)
        command = [sys.executable, "-m", "svprep", "build", str(model), "-o", str(cache), "--json"]
        done = self.execute([*command, *options], variables)
        # What it printed is read, and not kept.
        built = Built.of(answer_of(done, f"{name}: svprep build {model.name}"))
        self.rows.append(Row(part, name, turn, replace(done, said=""), built))
        self._check(name, content, built.content_digest)

    def _check(self, name: str, content: str, digest: str) -> None:
        expected = self._digests.setdefault(content, digest)
        if digest != expected:
            raise Inconsistent(
                f"{name}: the cache has content digest {digest}, another build of the same "
                f"({content}) had {expected}. One of the two is wrong"
            )
        same = [other for other, held in self._digests.items() if held == digest]
        if len(same) > 1:
            raise Inconsistent(f"{name}: {' and '.join(same)} have one content digest, {digest}")

    def _run(
        self,
        part: str,
        name: str,
        turn: int,
        command: Sequence[str],
        variables: Mapping[str, str] | None = None,
    ) -> Run:
        _tell(part, name, turn)
        done = self.execute(command, variables)
        words = done.last_words.replace(str(self.city), self.city.name)
        self.rows.append(Row(part, name, turn, replace(done, said="", last_words=words)))
        return done

    def _installed(self) -> list[tuple[str, str]]:
        """Return the peers that this Python can import; note the others."""
        found = []
        for name, code in PEERS.items():
            module = MODULES.get(name.split()[0])
            if module is None or has_module(module):
                found.append((name, code))
            else:
                self.left_out.append(name)
        return found


def check_help(done: Run, name: str) -> None:
    """Raise `CommandFailed` unless a program has shown its help."""
    if done.exit_status or "Usage" not in done.said:
        raise CommandFailed(f"{name}: no help; {done.last_words or done.said[:80]}")


def _bare_program(n_commands: int, options: str) -> str:
    """Return the text of a program that does nothing but have commands."""
    commands = "".join(_BARE_COMMAND.format(number=i) for i in range(n_commands))
    return f"{_BARE.format(options=options)}{commands}\napp()\n"


def _path_with(folder: str) -> str:
    return os.pathsep.join([folder, environment()["PYTHONPATH"]])


def _tell(part: str, name: str, turn: int) -> None:
    when = "before the rounds" if turn < 0 else f"round {turn + 1}"
    print(f"{part}: {name}, {when} ...", file=sys.stderr, flush=True)
