"""Plans of the robots: paths of the planner, or JointTrajectories from files."""

from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.report.interop import joint_trajectory_file
from angler_mjx.robot.control import joint_goal
from angler_mjx.robot.control.joint_goal import JointGoal
from angler_mjx.robot.control.joint_trajectory import VEHICLE_JOINTS, sample_state
from angler_mjx.runs.session.interface import Session
from angler_mjx.runs.session.recording import FlownPath

GRID = "grid"
PATH_POINTS = 256
"""Number of points of a rendered path."""


def load_trajectories(sources: Sequence[str], robots: int) -> dict[int, JointGoal]:
    """Return JointTrajectories by robot index; empty where the planner's paths are flown.

    Args:
        sources: ``grid``, or files as `angler_mjx.report.interop` writes them: one with all robots,
            or several. Robots in none of the files follow the planner's path.
        robots: number of robots.

    Raises:
        ConfigError: a file cannot be used, or a robot is in two of them.
    """
    if list(sources) == [GRID]:
        return {}
    goals: dict[int, JointGoal] = {}
    for name in sources:
        if name == GRID:
            raise ConfigError("--plan grid: give it alone, or files alone")
        more = joint_trajectory_file.read_trajectories(Path(name), robots=robots)
        if duplicates := sorted(goals.keys() & more.keys()):
            raise ConfigError(f"--plan {name}: robot {duplicates[0]} is in an earlier file already")
        goals.update(more)
    return goals


def sample_path(session: Session, robot: int, goal: JointGoal) -> FlownPath:
    """Return the path of a trajectory from the robot's position, with many points."""
    observation = session.observe()
    p, q = (np.asarray(part)[robot] for part in (observation.estimate.p, observation.estimate.q))
    start = [*p.tolist(), float(quaternion.yaw(q))]
    trajectory = joint_goal.build_trajectory(goal, joints=VEHICLE_JOINTS, position=start)
    times = np.linspace(0.0, float(trajectory.time_s[-1]), PATH_POINTS)
    points = np.asarray(jax.vmap(sample_state, (None, 0))(trajectory, jnp.asarray(times)).position)
    return FlownPath(time_s=goal.stamp_s + times, position_m=points[:, :3], yaw_rad=points[:, 3])


def check_goals(session: Session, goals: dict[int, JointGoal]) -> None:
    """Refuse trajectories that robots cannot follow from their positions.

    Raises:
        ConfigError: one message with the faults of all trajectories.
    """
    faults = []
    for robot, goal in goals.items():
        try:
            session.check(robot, goal)
        except ConfigError as error:
            faults.append(str(error))
    if faults:
        raise ConfigError("\n".join(["--plan: cannot be flown", *faults]))
