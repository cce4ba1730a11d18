"""Vehicle files that do not ship: the BlueROV2 with other thrusters, written where a test says."""

import re
from pathlib import Path

SHIPPED = Path(__file__).parents[4] / "angler_mjx" / "robot" / "vehicles" / "data" / "bluerov2.toml"

FOUR = (
    ("port", (-0.1, 0.15, 0.011), (1.0, 0.0, 0.0), 1),
    ("starboard", (-0.1, -0.15, 0.011), (1.0, 0.0, 0.0), -1),
    ("left", (0.0, 0.11, 0.07), (0.0, 0.0, 1.0), 1),
    ("right", (0.0, -0.11, 0.07), (0.0, 0.0, 1.0), -1),
)
"""Two thrusters along x and two along z: surge, heave, roll and yaw, no sway, no pitch."""

TORPEDO = (
    ("main", (-0.2, 0.0, 0.011), (1.0, 0.0, 0.0), 1),
    ("rudder", (-0.2, 0.0, 0.011), (0.0, 1.0, 0.0), 1),
)
"""One along x and one to the side at the stern: no heave, and yaw only along with sway."""


def write(path, thrusters, name="made_up", **changes):
    """A vehicle file with these thrusters; ``changes`` replace ``key = old`` lines of the file."""
    text = SHIPPED.read_text(encoding="utf-8")
    rows = ",\n".join(
        f'  {{ name = "{label}", position_m = {list(position)}, direction = {list(direction)}, '
        f"spin = {spin} }}"
        for label, position, direction, spin in thrusters
    )
    text = re.sub(r"layout = \[\n.*?\n\]", f"layout = [\n{rows}\n]", text, count=1, flags=re.S)
    text = re.sub(r"\[ardusub\]\n.*?\n\n", "", text, count=1, flags=re.S)
    text = text.replace('name = "bluerov2"', f'name = "{name}"', 1)
    for key, value in changes.items():
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, count=1, flags=re.M)
    path.write_text(text, encoding="utf-8")
    return path
