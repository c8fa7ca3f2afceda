"""Which pictures are judged, and how each is drawn.

Every view by every light is judged once. Method, construction and clamping go around so that
each of their twelve combinations occurs equally often among a dataset's 24 pictures, and each
light sees each method twice and each pair of the others at least once. One picture of each
dataset is drawn in all ways, and those that are there to compare with stand apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal
from zlib import crc32

from shadow_judging.views import LAMP, LIGHTS, VIEWS
from svprep_runtime.frame import Method, Settings
from svprep_runtime.passes.counting import Counter
from svprep_runtime.scene import Construction

METHODS: Final[tuple[Method, ...]] = ("zfail", "zpass", "auto")
CONSTRUCTIONS: Final[tuple[Construction, ...]] = ("vertex", "geometry")
SMALL_VIEWS: Final = ("in shadow", "bird")
SMALL_LIGHTS: Final = ("sun 20", LAMP)

Part = Literal["once", "all", "apart"]
"""``once``: of the 24. ``all``: the picture in all ways. ``apart``: it with zp+, which is not
exact, and is not counted."""


@dataclass(frozen=True, slots=True)
class Shot:
    """A picture, and one way to draw it."""

    part: Part
    view: str
    light: str
    method: Method
    construction: Construction
    clamp: bool
    counter: Counter = "float"

    @property
    def settings(self) -> Settings:
        """The same for `svprep_runtime.frame.render`."""
        return Settings(
            method=self.method,
            clamp=self.clamp,
            construction=self.construction,
            counter=self.counter,
        )

    @property
    def way(self) -> str:
        """In words: ``"zpass, vertex, clamped"``."""
        words = [self.method, self.construction, "clamped" if self.clamp else "whole"]
        return ", ".join(words + (["stencil"] if self.counter == "stencil" else []))


def shots(dataset: str, *, small: bool) -> list[Shot]:
    """Return what is judged of a dataset, pictures of one light together.

    Where the round begins, and which picture is drawn in all ways, follows from the name, so
    that it does not depend on what other datasets there are.
    """
    turn = crc32(dataset.encode())
    if small:
        return list(_small(turn))
    every = list(_once(turn))
    view, light = VIEWS[turn % 6], LIGHTS[turn // 6 % 4]
    every += _all_ways(view, light)
    return sorted(every, key=lambda shot: LIGHTS.index(shot.light))


def _once(turn: int) -> Iterator[Shot]:
    for v, view in enumerate(VIEWS):
        for n, light in enumerate(LIGHTS):
            method = (v + n) % 3
            pair = (n + method + 2 * (v // 3) + turn) % 4
            yield Shot(
                "once", view, light, METHODS[(method + turn) % 3], CONSTRUCTIONS[pair % 2], pair > 1
            )


def _small(turn: int) -> Iterator[Shot]:
    """Yield four pictures: each pair of construction and clamping once, all three methods."""
    for i, light in enumerate(SMALL_LIGHTS):
        for k, view in enumerate(SMALL_VIEWS):
            way = turn + 2 * i + k
            method = METHODS[(turn // 4 + way) % 3]
            yield Shot("once", view, light, method, CONSTRUCTIONS[way % 2], way // 2 % 2 > 0)


def _all_ways(view: str, light: str) -> Iterator[Shot]:
    for construction in CONSTRUCTIONS:
        for clamp in (False, True):
            for method in METHODS:
                yield Shot("all", view, light, method, construction, clamp)
                yield Shot("all", view, light, method, construction, clamp, "stencil")
            yield Shot("apart", view, light, "zp+", construction, clamp)
