"""Protocols of planners: objects that compute a path, or the reason for none, for each robot.

A `Planner` plans one problem at a time, on the host, in processes of its own. A `BatchPlanner` is
written in JAX and plans a batch, on the device, within the program that samples the worlds. All it
may use is in the problem. `angler_mjx.planning.register` finds planners by name.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands.joint_trajectory import (
    CUBIC,
    LINEAR,
    VEHICLE_JOINTS,
    JointTrajectory,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.plans import Plan

type Path = Plan
"""Path of one robot: way-points joined by lines, or points with headings joined by lines or
cubics."""

MAX_POINTS = 1024
"""Limit of way-points of one path."""


@dataclass(frozen=True)
class NoPlan:
    """Answer for a robot without a path, which then holds its start."""

    reason: str
    """Reason in a few words, for a table."""


@runtime_checkable
class Planner(Protocol):
    """Plans one problem on the host.

    A class whose paths are `JointTrajectory` declares ``joints = True``, or its settings have an
    attribute of that name; ``arm = True`` likewise if they move the joints of arms too. A class
    with settings has a frozen dataclass ``Settings`` with defaults;
    its constructor takes one, and the scenario's table ``[planner.NAME]`` is checked against it.
    """

    def plan(self, problem: Problem) -> Sequence[Path | NoPlan]:
        """Return a path or a reason for each robot, in their order.

        Args:
            problem: arrays of NumPy. The time limit is ``problem.deadline_s``; a planner that takes
                more than a tenth longer is ended.
        """
        ...


@runtime_checkable
class BatchPlanner(Protocol):
    """Plans a batch on the device; its method is traced.

    Settings are declared as by `Planner`. Two methods are optional. ``check_problem(settings)``
    raises `ConfigError` for `ProblemSettings` that the planner cannot plan. ``plan_one(problem)``
    returns the paths [robot] of one problem; with it each world is planned where it is sampled, for
    planners that gain nothing from a batch.
    """

    def plan_batch(self, problems: Problem) -> Path:
        """Return the paths of all robots, before the flight or (``is_replan``) during it.

        Args:
            problems: arrays of JAX, [world] leading.

        Returns:
            A path with [world, robot] leading and ``problem.points`` rows; ``found`` is False
            where there is none.
        """
        ...


@dataclass(frozen=True)
class PathShape:
    """Shape of the paths of all robots; programs are compiled for it."""

    points: int
    """Rows; shorter paths repeat their last."""
    joints: bool = False
    """Whether paths are `JointTrajectory`, not `Trajectory`."""
    arm: tuple[str, ...] = ()
    """Names of the joints of arms that the paths move beside the base; only with ``joints``."""


def way_points(time_s: ArrayLike, position_m: ArrayLike) -> Trajectory:
    """Return a path along lines.

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
    time_s: ArrayLike,
    position_m: ArrayLike,
    yaw_rad: ArrayLike,
    velocity: ArrayLike | None = None,
    arm: Mapping[str, ArrayLike] | None = None,
) -> JointTrajectory:
    """Return a path with headings: lines, or cubics if velocities are given.

    Args:
        time_s: [n] increasing, from 0, s.
        position_m: [n, 3] m, W; the first is the robot's start.
        yaw_rad: [n] heading about z up, 0 = east; unwrapped.
        velocity: [n, 4 + J] of x, y, z in m/s, of the heading in rad/s and of the joints of the
            arm; lines where left out.
        arm: positions [n] of all joints of the arm by name, in the order of
            ``Problem.joint_names``, rad or m; left out, a path of the base alone.
    """
    time, columns = _as_float32(time_s), {} if arm is None else arm
    rows = [_as_float32(values)[:, None] for values in (yaw_rad, *columns.values())]
    position = np.concatenate([_as_float32(position_m), *rows], axis=1)
    degree = LINEAR if velocity is None else CUBIC
    zeros = _as_float32(np.zeros_like(position))
    return JointTrajectory(
        joints=(*VEHICLE_JOINTS, *columns),
        time_s=time,
        position=_as_float32(position),
        velocity=zeros if velocity is None else _as_float32(velocity),
        acceleration=zeros,
        degree=(0.0 * time + degree).astype(np.int32),
        commanded=(zeros[0] == 0.0),
        found=_as_float32(True).astype(bool),
    )


def _as_float32(values: ArrayLike) -> Any:
    return np.asarray(values, np.float32)
