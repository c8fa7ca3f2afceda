"""What keys and mouse do: declared once, for the controls and for the help on screen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Binding:
    """One action."""

    action: str
    keys: tuple[str, ...]
    """As moderngl-window names them."""
    shown: str
    """The keys as help names them; empty: told by a line of another action."""
    words: str
    is_held: bool = False
    """It goes on for as long as its key is held."""


BINDINGS: Final = (
    Binding("forward", ("W", "UP"), "W A S D", "fly; with Shift four times as fast", True),
    Binding("left", ("A", "LEFT"), "", "", True),
    Binding("back", ("S", "DOWN"), "", "", True),
    Binding("right", ("D", "RIGHT"), "", "", True),
    Binding("down", ("Q", "PAGE_DOWN"), "Q E", "down, up", True),
    Binding("up", ("E", "PAGE_UP"), "", "", True),
    Binding("mode", ("TAB",), "Tab", "the left button turns around a point / looks about"),
    Binding("home", ("R", "HOME"), "R", "back to where the view began"),
    Binding("earlier", ("H",), "H J", "hour (or azimuth) back, on", True),
    Binding("later", ("J",), "", "", True),
    Binding("day_earlier", ("N",), "N M", "date (or altitude) back, on", True),
    Binding("day_later", ("M",), "", "", True),
    Binding("run", ("SPACE",), "Space", "let time pass, or stop it"),
    Binding("by_time", ("Y",), "Y", "the sun by date and hour / by angles"),
    Binding("next_light", ("L",), "L", "the next light takes keys and drags"),
    Binding("auto", ("NUMBER_1",), "1 2 3 4", "method: auto, z-pass, z-fail, zp+"),
    Binding("zpass", ("NUMBER_2",), "", ""),
    Binding("zfail", ("NUMBER_3",), "", ""),
    Binding("zp+", ("NUMBER_4",), "", ""),
    Binding("clamp", ("C",), "C", "clamped volumes on, off"),
    Binding("construction", ("G",), "G", "who builds volumes: vertex, geometry, triangles"),
    Binding("volumes", ("V",), "V", "shadow volumes"),
    Binding("silhouettes", ("O",), "O", "outlines as the light sees them (silhouettes)"),
    Binding("ends", ("X",), "X", "where clamped segments end"),
    Binding("counts", ("K",), "K", "how many volumes hold each point"),
    Binding("statistics", ("I",), "I", "statistics of passes"),
    Binding("names", ("T",), "T", "the object under the cursor"),
    Binding("texts", ("U",), "U", "hide or show all texts"),
    Binding("help", ("F1",), "F1 ?", "this help"),
    Binding("screenshot", ("P", "F12"), "P", "save a picture here (PNG)"),
    Binding("quit", ("ESCAPE",), "Esc", "quit"),
)

MOUSE: Final = (
    ("left drag", "turn around the point under the cursor; look about"),
    ("middle drag", "move across"),
    ("right drag", "the light: sideways hour, up and down date (azimuth, altitude)"),
    ("wheel", "nearer, farther; while looking about: the speed of flight"),
)
SHORT_HELP: Final = (
    "F1 help     drag: turn     wheel: zoom     W A S D Q E: fly     right drag: the sun     "
    "V O X K I: overlays     P picture     Esc quit"
)

ACTION_OF_KEY: Final = {key: binding.action for binding in BINDINGS for key in binding.keys}
HELD: Final = frozenset(binding.action for binding in BINDINGS if binding.is_held)


def help_rows() -> list[tuple[str, str]]:
    """Return the lines of the help on screen: what to press, and what it does."""
    return [*MOUSE, *((b.shown, b.words) for b in BINDINGS if b.shown)]
