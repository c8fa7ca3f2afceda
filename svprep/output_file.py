"""Files that a user asks for by name: guarded before the work, written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from svprep.cache.files import Temporary, problem_of
from svprep.errors import InputError


@dataclass(frozen=True, slots=True)
class OutputKind:
    """One kind of output: how it is called, and how an older one of ours is known."""

    name: str
    """As in "name ... otherwise": ``"the lines"``."""
    form: str
    """``"lines are written as .ply, .obj or .npz"``"""
    what: str
    """As in "exists and ...": ``"is not a silhouette of svprep"``."""
    suffixes: tuple[str, ...]
    is_ours: Callable[[bytes], bool]
    """Told the first 128 bytes of a file."""
    option: str = "-o"
    """What it is asked for with."""

    def has_suffix(self, path: str | os.PathLike[str]) -> bool:
        """Whether `path` ends in one of the suffixes, whatever the case."""
        return suffix_of(path) in self.suffixes

    def checked_path(
        self, path: str | os.PathLike[str], others: Sequence[str | os.PathLike[str]] = ()
    ) -> Path:
        """Return the file that `path` names, links followed, if this may be written there.

        Parameters
        ----------
        path : path-like
            The text that the user gave: a `Path` has lost the slash that names a folder.
        others : sequence of path-like
            Files that must not be harmed: inputs, the cache; they need not exist.

        Raises
        ------
        InputError
            Another suffix, one of `others`, or a file that is not of this kind.
        EnvironmentProblem
            The folder is missing or takes no new files.
        """
        given = os.fspath(path)
        if not self.has_suffix(given):
            raise InputError(f"{given}: {self.form}; name the file so")
        target = Path(os.path.realpath(given))
        try:
            for other in map(Path, others):
                if target == Path(os.path.realpath(other)) or (
                    target.exists() and other.exists() and target.samefile(other)
                ):
                    raise InputError(
                        f"{given} is an input, the cache itself or another output; "
                        f"name {self.name} otherwise"
                    )
            if target.exists() and not target.is_file():
                raise InputError(f"{given} is not a regular file; name {self.name} otherwise")
            if target.exists() and target.stat().st_size and not self.is_ours(_head(target)):
                raise InputError(
                    f"{given} exists and {self.what}, so it is not overwritten. "
                    "Choose another name, or remove it first"
                )
            with Temporary(target):
                pass
        except OSError as error:
            raise problem_of(error, target, self.option) from error
        return target


def suffix_of(path: str | os.PathLike[str]) -> str:
    """Return the suffix in lower case, ``""`` where `path` names a folder by a slash."""
    return os.path.splitext(os.fspath(path))[1].lower()


def write_whole(target: Path, parts: Iterable[bytes | memoryview]) -> None:
    """Write `parts` beside `target` and rename: an older file stays whole until then.

    Raises
    ------
    EnvironmentProblem
        The disk is full, or the folder takes no new files.
    """
    try:
        with Temporary(target) as file:
            for part in parts:
                file.write(memoryview(part))
            file.sync()
            file.rename()
    except OSError as error:
        raise problem_of(error, target) from error


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(128)
