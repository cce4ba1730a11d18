"""Checks that a robot of a scene exists and can be commanded."""

from collections.abc import Sequence

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.runs.session.interface import RobotInfo
from angler_mjx.sim.state import Outcome


def require_robot(robots: Sequence[RobotInfo], robot: int) -> None:
    """Refuse the index of a robot that a session does not have.

    Raises:
        ConfigError: the robot does not exist; the message lists the robots.
    """
    if robot not in range(len(robots)):
        raise ConfigError(f"robot {robot}: does not exist; this session has 0 to {len(robots) - 1}")


def require_running(
    robots: Sequence[RobotInfo], robot: int, outcomes: jax.Array | np.ndarray
) -> None:
    """Refuse to command a robot that failed.

    Args:
        robots: robots of the session.
        robot: index of the robot.
        outcomes: [R] `Outcome` of each.

    Raises:
        ConfigError: the robot does not exist, or its episode ended.
    """
    require_robot(robots, robot)
    outcome = Outcome(int(outcomes[robot]))
    if outcome not in (Outcome.RUNNING, Outcome.REACHED):
        raise ConfigError(f"{robots[robot].name}: cannot go on, its episode ended ({outcome.name})")
