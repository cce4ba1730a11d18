"""Sizes that a checkpoint and the arrays of its examples share."""

from dataclasses import asdict, dataclass
from typing import Any

SCHEMA = 1
"""Of checkpoints and examples: what is fed to the network, and what it gives."""

N_INNER_POINTS = 14
"""Way-points of a way between its start and its goal."""
N_SLICES = N_INNER_POINTS + 2
"""Places along the straight line at which surroundings are looked at."""
N_ASIDE = 9
"""Looks across the line, level."""
N_ABOVE = 7
"""Looks across the line, upwards."""
SAMPLE_SPACING_M = 1.5
"""Between looks."""
N_CHANNELS = 4
"""Of a way-point: three metres off the straight line, and a delay."""
OFFSET_SCALE_M = 2.0
"""What one unit of the network's way off the line is."""
DELAY_SCALE_S = 5.0
"""What one unit of its delays is."""
N_ROBOT_FEATURES, N_PAIR_FEATURES, N_BODY_FEATURES = 4, 14, 7
"""Numbers that describe a robot, one robot to another, and an obstacle to a robot."""


@dataclass(frozen=True, kw_only=True)
class NetworkSize:
    """How large a network is."""

    units: int = 64
    """Of each token."""
    blocks: int = 3

    def table(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)
