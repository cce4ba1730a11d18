"""One flight of a team, as those who learn from it see it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Episode:
    """A flight: until its last robot had ended."""

    about: Mapping[str, Any]
    """Its row of the index."""
    time_s: np.ndarray
    """[t]."""
    arrays: Mapping[str, np.ndarray]
    """By their names in the run, [t, robot, ...] or [t, obstacle, ...]; the manifest says units."""
    running: np.ndarray
    """bool [t, robot]: whether a robot was still on its way. What comes after its end repeats its
    last state."""
    plan_time_s: np.ndarray
    """[robot, point]; the last one is repeated."""
    plan_m: np.ndarray
    """[robot, point, 3] in W."""
    start_m: np.ndarray
    """[robot, 3] in W."""
    goal_m: np.ndarray
    """[robot, 3] in W."""
    environment: Mapping[str, np.ndarray]
    """Rock, floor, obstacles and current by their names in the run."""
    outcomes: tuple[str, ...]
    """How each robot ended."""
