"""What is kept in the work folder, so that a run goes on where the last one ended.

    truths/KEY-CODE.npz    KEY: model, camera, light, size, constants; CODE: of the judge
    results.jsonl          a line a judged picture; the last one of a key counts

With ``keep`` answers of older code are taken as well, the newest of them.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from shadow_judging.code_digest import code_digest
from shadow_judging.plan import Shot
from svprep.errors import InputError
from svprep.model import F32
from svprep_runtime.camera import Camera
from svprep_runtime.judge_constants import JUDGE_CONSTANTS
from svprep_runtime.judge_report import Truth, load_truth, save_truth

MOST_PIXELS_LISTED = 200
"""Of one picture, in its result."""


@dataclass(frozen=True, slots=True)
class Code:
    """Digests of the code that judges and draws."""

    judge: str
    runtime: str

    @classmethod
    def now(cls) -> Code:
        """Return those of the files as they are."""
        return cls(
            judge=code_digest(["svprep_runtime.judge"]),
            runtime=code_digest(
                ["svprep_runtime.frame", "svprep_runtime.context", "svprep.clamp"], shaders=True
            ),
        )


@dataclass(frozen=True, slots=True)
class Result:
    """One picture, drawn in one way and judged."""

    dataset: str
    shot: Shot
    size: tuple[int, int]
    camera_spec: str
    near_m: float
    light_spec: str
    n_surface: int
    n_decidable: int
    n_differing: int
    differing: list[list[int]]
    """Column and row of the first `MOST_PIXELS_LISTED`, and what the picture says there: 1
    shadow, 0 lit."""
    n_negative: int
    n_shadow_in_sky: int
    highest_count: int
    n_clamped_segments: int
    overlaps: list[list[Any]] = field(default_factory=list)
    causes: list[str] = field(default_factory=list)
    """Of the first `svprep_runtime.judge_causes.MOST_TRACED` of `differing`."""
    truth_s: float = 0.0
    """0.0 if the truth was there already."""
    draw_s: float = 0.0


class Store:
    """Truths and results of a work folder."""

    def __init__(self, work: Path, code: Code, *, keep: bool) -> None:
        self.code, self._keep = code, keep
        self._truths = work / "truths"
        self._truths.mkdir(parents=True, exist_ok=True)
        self._path = work / "results.jsonl"
        self._results: dict[str, Result] = {}
        if self._path.exists():
            for line in self._path.read_text(encoding="utf-8").splitlines():
                self._remember(line)

    def _remember(self, line: str) -> None:
        """Take a line of an earlier run; one that was cut off, or of another form, is not one."""
        try:
            stored = json.loads(line)
            fields = stored["result"]
            result = Result(**{**fields, "shot": Shot(**fields["shot"])})
        except (ValueError, KeyError, TypeError):
            return
        if self._keep or stored["code"] == asdict(self.code):
            self._results[stored["key"]] = result

    def result(self, picture: str, shot: Shot) -> Result | None:
        """Return an earlier result."""
        return self._results.get(_result_key(picture, shot))

    def add(self, picture: str, shot: Shot, result: Result) -> None:
        """Keep a result."""
        key = _result_key(picture, shot)
        self._results[key] = result
        line = json.dumps({"key": key, "code": asdict(self.code), "result": asdict(result)})
        with self._path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")
            file.flush()
            os.fsync(file.fileno())

    def truth(self, picture: str) -> Truth | None:
        """Return an earlier truth."""
        stem = _digest(picture)
        paths = [self._truth_path(picture)]
        if self._keep:
            others = self._truths.glob(f"{stem}-*.npz")
            paths += sorted(others, key=lambda path: -path.stat().st_mtime_ns)
        for path in paths:
            code = path.stem.partition("-")[2]
            try:
                return load_truth(path, f"{picture} {code}")
            except InputError:
                continue
        return None

    def add_truth(self, picture: str, truth: Truth) -> None:
        """Keep a truth."""
        save_truth(self._truth_path(picture), truth, f"{picture} {self.code.judge}")

    def _truth_path(self, picture: str) -> Path:
        return self._truths / f"{_digest(picture)}-{self.code.judge}.npz"


def picture_key(digest: str, camera: Camera, light: F32) -> str:
    """Return what tells one picture from all others, whatever draws it."""
    numbers = [
        camera.eye.tobytes().hex(), camera.rows.tobytes().hex(), repr(camera.near_m),
        f"{camera.width_px}x{camera.height_px}", light.tobytes().hex(),
    ]  # fmt: skip
    return " ".join([digest, *numbers, JUDGE_CONSTANTS])


def _result_key(picture: str, shot: Shot) -> str:
    return _digest(f"{picture} {shot.part} {shot.way}")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:32]
