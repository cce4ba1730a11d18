"""The recipe that tests of whole worlds share: for one fleet and count it is compiled once.

Walls are as they were drawn, and so few that robots and obstacles can be nearly anywhere. Half of
the drawings have too few of them and are thrown away, so that every batch draws worlds again, and
an eighth of the worlds reach the limit.
"""

import numpy as np

from angler_mjx.files import parse_model
from angler_mjx.world.config import WorldConfig

MIN_OBSTACLES = 58
RADIUS = np.array([0.4, 0.3, 0.4])
SEED = 7
SHAPE = (8, 8, 6)
COUNT = 2001
"""More than go through at once, and an odd number: the last tile is filled up."""
SALT = {"type": "automaton", "die_below": 0, "born_above": 26, "steps": 0}
RECIPE = parse_model(
    WorldConfig,
    {
        "preset": "reef",
        "shape": list(SHAPE),
        "rule": SALT,
        "fill": 0.15,
        "min_obstacles": MIN_OBSTACLES,
        "redraw_limit": 2,
        "placement": "random",
        "currents": [
            {"type": "gauss_markov", "max_speed_mps": 0.3, "vertical_fraction": 1.0},
            {"type": "gauss_markov", "max_speed_mps": 0.3, "vertical_fraction": 1.0},
            {"type": "vortices", "count": 2, "peak_speed_mps": [0.1, 0.3]},
        ],
        "obstacles": {
            "dynamic": {
                "count": 2,
                "cube_fraction": 0.5,
                "rise_fraction": 0.3,
                "sink_fraction": 0.3,
                "vertical_speed_mps": [0.1, 0.2],
            },
            "explicit": [{"type": "box", "size_m": [2, 2, 8], "position_m": [0, 0, -8]}],
        },
    },
    source="test",
)
