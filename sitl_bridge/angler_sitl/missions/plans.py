"""What robots fly along: the paths of the planner, or JointTrajectories from files."""

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
from angler_mjx.robot.control.joint_trajectory import VEHICLE_JOINTS, sample
from angler_mjx.runs.session.interface import Session
from angler_mjx.runs.session.recording import FlownPath

GRID = "grid"
WAY_POINTS = 256
"""Of a way that is drawn."""


def read(given: Sequence[str], robots: int) -> dict[int, JointGoal]:
    """JointTrajectories by index of the robot; none of them where the planner's paths are flown.

    Args:
        given: ``grid``, or files as `angler_mjx.report.interop` writes them: one with all robots,
            or several. Robots that are in none of them follow the planner's path.
        robots: how many there are.

    Raises:
        ConfigError: a file cannot be used, or a robot is in two of them.
    """
    if list(given) == [GRID]:
        return {}
    goals: dict[int, JointGoal] = {}
    for name in given:
        if name == GRID:
            raise ConfigError("--plan grid: give it alone, or files alone")
        more = joint_trajectory_file.read(Path(name), robots=robots)
        if twice := sorted(goals.keys() & more.keys()):
            raise ConfigError(f"--plan {name}: robot {twice[0]} is in an earlier file already")
        goals.update(more)
    return goals


def way(session: Session, robot: int, goal: JointGoal) -> FlownPath:
    """Where a trajectory takes a robot from where it is, as a path of many points."""
    now = session.observe()
    p, q = (np.asarray(part)[robot] for part in (now.estimate.p, now.estimate.q))
    here = [*p.tolist(), float(quaternion.yaw(q))]
    made = joint_goal.build(goal, joints=VEHICLE_JOINTS, position=here)
    times = np.linspace(0.0, float(made.time_s[-1]), WAY_POINTS)
    points = np.asarray(jax.vmap(sample, (None, 0))(made, jnp.asarray(times)).position)
    return FlownPath(time_s=goal.stamp_s + times, position_m=points[:, :3], yaw_rad=points[:, 3])


def check(session: Session, goals: dict[int, JointGoal]) -> None:
    """Refuse trajectories that robots cannot follow from where they are.

    Raises:
        ConfigError: one message with the faults of all of them.
    """
    faults = []
    for robot, goal in goals.items():
        try:
            session.check(robot, goal)
        except ConfigError as error:
            faults.append(str(error))
    if faults:
        raise ConfigError("\n".join(["--plan: cannot be flown", *faults]))
