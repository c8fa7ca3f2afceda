"""The passes that count: how many volumes hold the visible point of each pixel.

    eye o------|>------<|-----X-----|>-------<|---      |> in   <| out

z-pass adds what lies strictly before X, +1 where a ray goes in, to the eye's own count.
z-fail takes the rest, +1 where it comes out. Either decides by one depth test, `greater`
or its exact complement `lequal` (reversed depth), so that the two never disagree about a
fragment, and what a query counts is what was updated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from svprep_runtime import gl_raw as g
from svprep_runtime.programs import Program, Programs
from svprep_runtime.state import PassState, apply, two_sided

Counter = Literal["float", "stencil"]
When = Literal["before", "behind", "before, cut at near"]
"""Which fragments count: those before X (z-pass; for zp+ from the near plane on), or at it
and behind (z-fail)."""

_DEPTH: Final[dict[When, Literal["greater", "lequal"]]] = {
    "before": "greater",
    "before, cut at near": "greater",
    "behind": "lequal",
}


@dataclass(frozen=True, slots=True)
class Draw:
    """One draw of volumes: entries that follow each other in the buffer."""

    kind: Literal["sides", "sides_to_point", "caps", "faces"]
    """``"faces"``: whole volumes, by the geometry shader."""
    orientation: int
    """+1: triangles are counter-clockwise seen from outside the volume; -1: clockwise."""
    first_entry: int
    n_entries: int
    is_far: bool = False
    """Caps: of the far end of segments."""
    is_own_cap: bool = False
    """The caps that z-pass does without: nothing is seen behind them."""
    each_alone: bool = False
    """Faces: with all their sides, as if they had no neighbours."""


def counting_state(counter: Counter, when: When, orientation: int) -> PassState:
    """Return the state in which a draw counts.

    Front faces of a volume add 1 before X and take 1 behind it, back faces the reverse.
    """
    if counter == "float":
        return PassState(depth_test=_DEPTH[when], blend="add")
    is_plus = (orientation > 0) == (when != "behind")
    plus, minus = two_sided("incr_wrap", "decr_wrap"), two_sided("decr_wrap", "incr_wrap")
    stencil = plus if is_plus else minus
    return PassState(depth_test=_DEPTH[when], color_write=False, stencil=stencil)


def count(
    programs: Programs,
    uniforms: dict[str, Any],
    draws: Sequence[Draw],
    counter: Counter,
    when: When,
    *,
    with_own_caps: bool,
) -> None:
    """Add the counts of `draws` to the bound target."""
    for draw in draws:
        if draw.n_entries == 0 or (draw.is_own_cap and not with_own_caps):
            continue
        apply(programs.context.gl, counting_state(counter, when, draw.orientation))
        program, mode, n_vertices = _program(programs, draw, when)
        program.set(uniforms)
        program.set(
            {
                "weight": 1.0 if (draw.orientation > 0) == (when != "behind") else -1.0,
                "first_entry": draw.first_entry,
                "is_far": draw.is_far,
                "has_all_caps": with_own_caps,
            }
        )
        program.draw(mode, n_vertices * draw.n_entries)


def count_near_plane(
    programs: Programs, uniforms: dict[str, Any], draws: Sequence[Draw], counter: Counter
) -> None:
    """Add, for zp+, the faces between light and near plane, each once (Hornus et al. 2005)."""
    stencil = None if counter == "float" else two_sided("incr_wrap", "incr_wrap")
    state = PassState(
        depth_test=None, color_write=counter == "float", blend="add", stencil=stencil, clip_planes=1
    )
    program = programs.get("near_plane.vert", "near_plane.frag")
    for draw in draws:
        apply(programs.context.gl, state)
        program.set(uniforms)
        program.set({"first_entry": draw.first_entry})
        program.draw(g.GL_TRIANGLES, 3 * draw.n_entries)


def _program(programs: Programs, draw: Draw, when: When) -> tuple[Program, int, int]:
    options: tuple[str, ...] = ("CUT_AT_NEAR",) if when == "before, cut at near" else ()
    if draw.kind == "faces":
        if draw.each_alone:
            options += ("EACH_ALONE",)
        return programs.get("volume.vert", "count.frag", "volume.geom", options), g.GL_POINTS, 1
    if draw.kind == "caps":
        return programs.get("caps.vert", "count.frag", options=options), g.GL_TRIANGLES, 3
    if draw.kind == "sides":
        return programs.get("sides.vert", "count.frag", options=options), g.GL_TRIANGLES, 6
    options += ("TO_A_POINT",)
    return programs.get("sides.vert", "count.frag", options=options), g.GL_TRIANGLES, 3
