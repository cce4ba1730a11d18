"""Sizes that a checkpoint and the arrays of its examples share."""

from dataclasses import asdict, dataclass

SCHEMA = 1
"""Version of checkpoints and examples: input and output of the network."""

N_INNER_POINTS = 14
"""Number of way-points of an encoded path between its start and its goal."""
N_SLICES = N_INNER_POINTS + 2
"""Number of positions along the straight line with sampled surroundings."""
N_ASIDE = 9
"""Number of samples across the line, level."""
N_ABOVE = 7
"""Number of samples across the line, upwards."""
SAMPLE_SPACING_M = 1.5
"""Distance between samples."""
N_CHANNELS = 4
"""Number of channels of a way-point: three metres off the straight line, and a delay."""
OFFSET_SCALE_M = 2.0
"""Metres in one unit of the network's offset from the line."""
DELAY_SCALE_S = 5.0
"""Seconds in one unit of its delays."""
N_ROBOT_FEATURES, N_PAIR_FEATURES, N_BODY_FEATURES = 4, 14, 7
"""Numbers of features of a robot, of a robot relative to another, and of an obstacle relative to a
robot."""


@dataclass(frozen=True, kw_only=True)
class NetworkSize:
    """Size of a network."""

    units: int = 64
    """Number of units of each token."""
    blocks: int = 3

    def table(self) -> dict[str, int]:
        """Return the size as a table for a file."""
        return asdict(self)
