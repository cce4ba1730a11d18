"""Key bindings: those of ROS 2's teleop_twist_keyboard, and six more; `arm_jog` has those of arms.

The tables hold the documented bindings of that program (ros2/teleop_twist_keyboard, README); its
rule that any unknown key stops the robot holds here too.
"""

from enum import Enum
from typing import NamedTuple


class Direction(NamedTuple):
    """Direction of a key: fractions of the set speeds, -1, 0 or 1, in the robot's level frame."""

    surge: int
    """Forward, as a fraction of the set speed."""
    sway: int
    """To port, as a fraction of the set speed."""
    heave: int
    """Up, as a fraction of the set speed."""
    yaw: int
    """Turning to port, as a fraction of the set speed."""


STILL = Direction(0, 0, 0, 0)

MOVES: dict[str, Direction] = {
    "u": Direction(1, 0, 0, 1),
    "i": Direction(1, 0, 0, 0),
    "o": Direction(1, 0, 0, -1),
    "j": Direction(0, 0, 0, 1),
    "k": STILL,
    "l": Direction(0, 0, 0, -1),
    "m": Direction(-1, 0, 0, -1),
    ",": Direction(-1, 0, 0, 0),
    ".": Direction(-1, 0, 0, 1),
    "U": Direction(1, 1, 0, 0),
    "I": Direction(1, 0, 0, 0),
    "O": Direction(1, -1, 0, 0),
    "J": Direction(0, 1, 0, 0),
    "K": STILL,
    "L": Direction(0, -1, 0, 0),
    "M": Direction(-1, 1, 0, 0),
    "<": Direction(-1, 0, 0, 0),
    ">": Direction(-1, -1, 0, 0),
    "t": Direction(0, 0, 1, 0),
    "b": Direction(0, 0, -1, 0),
}
"""Driving keys."""

FACTORS: dict[str, tuple[float, float]] = {
    "q": (1.1, 1.1),
    "z": (0.9, 0.9),
    "w": (1.1, 1.0),
    "x": (0.9, 1.0),
    "e": (1.0, 1.1),
    "c": (1.0, 0.9),
}
"""Keys that multiply the set speeds: linear, angular."""


class KeyAction(Enum):
    """Other actions of a key."""

    NEXT = "next robot"
    ALL = "all robots"
    PLAN = "back to the plan"
    HOLD = "hold"
    HELP = "help"
    QUIT = "end"


ACTIONS: dict[str, KeyAction] = {
    "\t": KeyAction.NEXT,
    "a": KeyAction.ALL,
    "p": KeyAction.PLAN,
    "h": KeyAction.HOLD,
    "?": KeyAction.HELP,
    "Q": KeyAction.QUIT,
    "\x03": KeyAction.QUIT,
}

NAMES: dict[str, str] = {
    "tab": "\t",
    "space": " ",
    "enter": "\r",
    "escape": "\x1b",
    "ctrl-c": "\x03",
}
"""Names of keys in angle brackets in a file, as in ``<tab>``."""

HELP = (
    "   u  i  o    forward, turning       U  I  O    forward, to the side",
    "   j  k  l    turn, stop             J  K  L    to the side, stop",
    "   m  ,  .    backward, turning      M  <  >    backward, to the side",
    "   t / b      up / down              any other key stops",
    "   q / z      both speeds +- 10 %    w / x  linear     e / c  angular",
    "   tab        next robot             a          all of them at once",
    "   1 to 9     joint of an arm        [ / ]      move it     g / v  open, close",
    "   p          back to the plan       h          hold position here",
    "   ?          this help              Q, Ctrl-C  end",
)
"""Help text of the screen; 80 columns at most."""


def format_key(key: str) -> str:
    """Return the written form of a key; unwritable keys all stop, as ``<space>`` does."""
    named = {value: f"<{key_name}>" for key_name, value in NAMES.items()}
    written = key if key.isprintable() and key != "#" else "<space>"
    return named.get(key, written)
