"""What a planner is: an object that gives each robot of a problem a path, or says why not.

Written in NumPy (or anything that Python can call) it plans one problem at a time, on the host, in
processes of its own. Written in JAX it plans a batch, on the device, within the program that draws
the worlds. How one is found by its name stands in `angler_mjx.planning.register`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.joint_trajectory import CUBIC, LINEAR, VEHICLE_JOINTS, JointTrajectory
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.trajectory import Trajectory

type Path = Plan
"""Of one robot: way-points joined by lines; or points with headings, and with velocities cubics."""

MAX_POINTS = 1024
"""Of one path."""


@dataclass(frozen=True)
class NoPlan:
    """There is no path for a robot; it is told to hold its start."""

    reason: str
    """For a table: a few words."""


@runtime_checkable
class Planner(Protocol):
    """Plans one problem on the host.

    A class whose paths are `JointTrajectory` says so by ``joints = True``, or its settings do by an
    attribute of that name. One whose settings can be chosen has a frozen dataclass ``Settings``
    with defaults, and is made with one; the scenario's table ``[planner.NAME]`` is checked against
    it.
    """

    def plan(self, problem: Problem) -> Sequence[Path | NoPlan]:
        """A path for each robot, in their order, or why there is none.

        Args:
            problem: arrays of NumPy. It should be answered within ``problem.deadline_s``; who
                takes more than a tenth longer is ended.
        """
        ...


@runtime_checkable
class BatchPlanner(Protocol):
    """Plans a batch on the device; its method is traced."""

    def plan_batch(self, problems: Problem) -> Path:
        """Paths of all robots.

        Args:
            problems: arrays of JAX, [world] leading.

        Returns:
            A path with [world, robot] leading; ``found`` is False where there is none.
        """
        ...


@dataclass(frozen=True)
class PathShape:
    """What the paths of all robots are like; programs are compiled for it."""

    points: int
    """Rows; shorter paths repeat their last."""
    joints: bool = False
    """Whether they are `JointTrajectory`, not `Trajectory`."""


def way_points(time_s: Any, position_m: Any) -> Trajectory:
    """A path along lines.

    Args:
        time_s: [n] increasing, from 0, s.
        position_m: [n, 3] m, W; the first is the robot's start.
    """
    return Trajectory(
        time_s=_as_float32(time_s),
        position_m=_as_float32(position_m),
        found=_as_float32(True).astype(bool),
    )


def joint_path(
    time_s: Any, position_m: Any, yaw_rad: Any, velocity: Any | None = None
) -> JointTrajectory:
    """A path with headings, and with velocities, between which it runs along cubics.

    Args:
        time_s: [n] increasing, from 0, s.
        position_m: [n, 3] m, W; the first is the robot's start.
        yaw_rad: [n] heading about z up, 0 = east; unwrapped: a step of a turn is a turn.
        velocity: [n, 4] of x, y, z in m/s and of the heading in rad/s; lines where left out.
    """
    time = _as_float32(time_s)
    position = np.concatenate([_as_float32(position_m), _as_float32(yaw_rad)[:, None]], axis=1)
    degree = LINEAR if velocity is None else CUBIC
    zeros: Any = np.zeros_like(position)
    return JointTrajectory(
        joints=VEHICLE_JOINTS,
        time_s=time,
        position=_as_float32(position),
        velocity=zeros if velocity is None else _as_float32(velocity),
        acceleration=zeros,
        degree=(0.0 * time + degree).astype(np.int32),
        commanded=(zeros[0] == 0.0),
        found=_as_float32(True).astype(bool),
    )


def _as_float32(values: Any) -> Any:
    return np.asarray(values, np.float32)
