"""JointTrajectory messages on the host: checked against a robot, and made into arrays.

A message names some of a robot's joints, in any order. `validate_goal` refuses what the robot
cannot follow before anything moves; `build_trajectory` fills in the other joints, unwraps angles
and pads.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands.joint_tolerance import ResultCode
from angler_mjx.robot.control.commands.joint_trajectory import (
    CUBIC,
    LINEAR,
    QUINTIC,
    JointState,
    JointTrajectory,
    interpolate_segment,
    is_continuous,
)

_SPEED_CHECK_FRACTIONS: Any = np.linspace(0.0, 1.0, 9)
"""Places on a segment at which its speed is looked at."""


class GoalError(ConfigError):
    """A trajectory that a robot refuses."""

    def __init__(self, message: str, code: ResultCode) -> None:
        """Message for a person, and the result that ROS has for it."""
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, kw_only=True)
class JointPoint:
    """As ``trajectory_msgs/JointTrajectoryPoint``, without effort."""

    time_s: float
    """From the start."""
    positions: tuple[float, ...]
    """m or rad, a number for each named joint."""
    velocities: tuple[float, ...] = ()
    """Likewise, or none at all."""
    accelerations: tuple[float, ...] = ()
    """Likewise, or none at all."""


@dataclass(frozen=True, kw_only=True)
class JointGoal:
    """As ``trajectory_msgs/JointTrajectory``."""

    joint_names: tuple[str, ...]
    points: tuple[JointPoint, ...]
    stamp_s: float = 0.0
    """When it starts; 0: at once."""


def shape_faults(goal: JointGoal) -> list[str]:
    """What is wrong with a message whatever the robot: lengths, order of time, numbers."""
    count = len(goal.joint_names)
    faults = [] if goal.points else ["points: empty; give at least one"]
    twice = sorted({name for name in goal.joint_names if goal.joint_names.count(name) > 1})
    faults += [f"joint_names: {name!r} is there twice; name each joint once" for name in twice]
    faults += [] if count else ["joint_names: empty; name at least one joint"]
    before = -math.inf
    for i, point in enumerate(goal.points):
        faults += _point_faults(f"points[{i}]", point, goal.joint_names)
        if not math.isfinite(point.time_s) or point.time_s < 0 or point.time_s <= before:
            rule = "must be at least 0" if i == 0 else f"must be later than {before:g} s before it"
            faults.append(f"points[{i}].time_from_start = {point.time_s:g} s: {rule}")
        before = point.time_s
    return faults


def validate_goal(
    goal: JointGoal,
    *,
    robot: str,
    joints: Sequence[str],
    position: Sequence[float],
    start_tolerance: float = 0.0,
    max_speed: Mapping[str, float] | None = None,
    now_s: float = 0.0,
) -> None:
    """Refuse a message that a robot cannot follow.

    Args:
        goal: the message.
        robot: its name, for the message of the error.
        joints: names of all the robot's joints.
        position: [n_joint] where they are, m or rad.
        start_tolerance: how far a point at time 0 may lie from there, m or rad; 0 or -1 is any
            distance.
        max_speed: the fastest each joint can go, m/s or rad/s; joints that are left out have no
            limit.
        now_s: time on the clock of the message's stamp.

    Raises:
        GoalError: one message with every fault, its joint, point and value.
    """
    unknown = [name for name in goal.joint_names if name not in joints]
    faults = [
        f"joint_names: {name!r} is no joint of this robot; have {', '.join(joints)}"
        for name in unknown
    ]
    code = ResultCode.INVALID_JOINTS if unknown else ResultCode.INVALID_GOAL
    faults += shape_faults(goal)
    if not faults:
        faults = [
            *_start_faults(goal, joints, position, start_tolerance),
            *_end_faults(goal),
            *_speed_faults(goal, joints, position, max_speed or {}),
        ]
    if not faults and goal.stamp_s > 0 and goal.stamp_s + goal.points[-1].time_s < now_s:
        code = ResultCode.OLD_HEADER_TIMESTAMP
        end = goal.stamp_s + goal.points[-1].time_s
        faults = [f"header.stamp = {goal.stamp_s:g} s: it ended at {end:g} s, and now is {now_s:g}"]
    if faults:
        head = f"robot {robot}: trajectory refused ({code.name}), {len(faults)} fault"
        raise GoalError("\n  ".join([head + "s" * (len(faults) > 1), *faults]), code)


def build_trajectory(
    goal: JointGoal, *, joints: Sequence[str], position: Sequence[float], size: int = 0
) -> JointTrajectory:
    """Arrays of a message that `shape_faults` and `validate_goal` have nothing against.

    A segment is a quintic where both its ends have velocities and accelerations, a cubic where both
    have velocities, and a line otherwise. A first point later than 0 is reached from rest at
    ``position``; joints that are not named stay there.

    Args:
        goal: the message.
        joints: names of all the robot's joints.
        position: [n_joint] where they are, m or rad.
        size: number of points to pad to; as many as needed if less.

    Returns:
        The trajectory of all joints.
    """
    tables, time, degree = _build_tables(goal, joints, np.asarray(position, float))
    rows = max(size, len(time), 2)
    padding = ((0, rows - len(time)), (0, 0))
    p, v, a = (jnp.asarray(np.pad(table, padding, mode="edge")) for table in tables)
    return JointTrajectory(
        joints=tuple(joints),
        time_s=jnp.asarray(np.pad(time, padding[0], mode="edge")),
        position=p,
        velocity=v,
        acceleration=a,
        degree=jnp.asarray(np.pad(degree, padding[0], mode="edge"), jnp.int32),
        commanded=jnp.asarray([name in goal.joint_names for name in joints]),
    )


def _build_tables(
    goal: JointGoal, joints: Sequence[str], position: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations [n, n_joint]; times and degrees [n]."""
    column = [list(joints).index(name) for name in goal.joint_names]
    p = np.tile(position, (len(goal.points), 1))
    v, a = np.zeros_like(p), np.zeros_like(p)
    degrees = np.full(len(p), LINEAR)
    for i, point in enumerate(goal.points):
        p[i, column] = point.positions
        if point.velocities:
            v[i, column] = point.velocities
            degrees[i] = CUBIC
        if point.velocities and point.accelerations:
            a[i, column] = point.accelerations
            degrees[i] = QUINTIC
    time = np.array([point.time_s for point in goal.points])
    if time[0] > 0:
        rest = np.zeros_like(position)
        p, v, a = (np.vstack([row, table]) for row, table in ((position, p), (rest, v), (rest, a)))
        time, degrees = np.append(0.0, time), np.append(QUINTIC, degrees)
    turning = [i for i, name in enumerate(joints) if is_continuous(name)]
    whole = np.vstack([position, p])[:, turning]
    p[:, turning] = np.unwrap(whole, axis=0)[1:]
    degree = np.append(np.minimum(degrees[:-1], degrees[1:]), LINEAR)
    return [p, v, a], time, degree


def _point_faults(key: str, point: JointPoint, names: Sequence[str]) -> Iterator[str]:
    for quantity in ("positions", "velocities", "accelerations"):
        values = getattr(point, quantity)
        if len(values) != len(names) and (values or quantity == "positions"):
            optional = "" if quantity == "positions" else ", or none"
            yield (
                f"{key}.{quantity}: {len(values)} numbers for {len(names)} joints; "
                f"give one for each joint_name{optional}"
            )
            continue
        for name, value in zip(names, values, strict=False):
            if not math.isfinite(value):
                yield f"{key}.{quantity}, joint {name!r} = {value}: must be a finite number"
    if point.accelerations and not point.velocities:
        yield f"{key}.accelerations: given without velocities; give both, or leave them out"


def _start_faults(
    goal: JointGoal, joints: Sequence[str], position: Sequence[float], tolerance: float
) -> Iterator[str]:
    first = goal.points[0]
    if first.time_s > 0 or tolerance <= 0:
        return
    for name, value in zip(goal.joint_names, first.positions, strict=True):
        current = float(position[list(joints).index(name)])
        away = abs(
            math.remainder(value - current, math.tau) if is_continuous(name) else value - current
        )
        if away > tolerance:
            yield (
                f"points[0], joint {name!r} = {value:g}: the robot is at {current:g}, farther than "
                f"the start tolerance {tolerance:g}; start nearer, or give the point a time above 0"
            )


def _end_faults(goal: JointGoal) -> Iterator[str]:
    """A trajectory ends at rest, because it is held there."""
    end = len(goal.points) - 1
    for name, value in zip(goal.joint_names, goal.points[end].velocities, strict=False):
        if value != 0:
            yield f"points[{end}].velocities, joint {name!r} = {value:g}: the last must be 0"


def _speed_faults(
    goal: JointGoal, joints: Sequence[str], position: Sequence[float], limit: Mapping[str, float]
) -> Iterator[str]:
    """For each point and joint, the top speed on the way there."""
    (p, v, a), time, degree = _build_tables(goal, joints, np.asarray(position, float))
    shift = len(time) - len(goal.points)
    for k in range(len(time) - 1):
        begin, end = (
            JointState(position=p[i], velocity=v[i], acceleration=a[i]) for i in (k, k + 1)
        )
        span = time[k + 1] - time[k]
        speeds = [
            interpolate_segment(begin, end, span, s, degree[k]).velocity
            for s in _SPEED_CHECK_FRACTIONS
        ]
        fastest = np.max(np.abs(speeds), axis=0)
        for name in goal.joint_names:
            speed = float(fastest[list(joints).index(name)])
            # A path planned at the very limit passes in spite of rounding.
            if name in limit and speed > limit[name] * (1 + 1e-6):
                yield (
                    f"points[{k + 1 - shift}], joint {name!r}: needs {speed:.3g} per s on the way "
                    f"there, {limit[name]:.3g} is the most; give it more time"
                )
