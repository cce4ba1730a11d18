"""Who is in a scene, and who can still be driven."""

from collections.abc import Sequence
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.runs.session.interface import RobotInfo
from angler_mjx.sim.state import Outcome


def require_robot(robots: Sequence[RobotInfo], robot: int) -> None:
    """Refuse the index of a robot that a session does not have.

    Raises:
        ConfigError: saying which there are.
    """
    if robot not in range(len(robots)):
        raise ConfigError(f"robot {robot}: there is none; this session has 0 to {len(robots) - 1}")


def require_running(robots: Sequence[RobotInfo], robot: int, outcomes: Any) -> None:
    """Refuse to drive a robot that failed.

    Args:
        robots: of the session.
        robot: index of one.
        outcomes: [R] `Outcome` of each.

    Raises:
        ConfigError: it is not there, or its episode ended.
    """
    require_robot(robots, robot)
    outcome = Outcome(int(outcomes[robot]))
    if outcome not in (Outcome.RUNNING, Outcome.REACHED):
        raise ConfigError(f"{robots[robot].name}: cannot go on, its episode ended ({outcome.name})")
