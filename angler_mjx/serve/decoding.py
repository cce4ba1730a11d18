"""Commands of a session from the bytes of messages."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.report.interop.ros_encoding import find_decoder
from angler_mjx.report.interop.ros_messages import NANO
from angler_mjx.robot.control.commands import BodyTwist, ThrusterPwm
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint

BLUE_JOINTS = {"joint_x": "x", "joint_y": "y", "joint_z": "z", "joint_rz": "yaw"}
"""Names of the vehicle's joints in Blue's controllers, and in sessions."""
_LEVEL_JOINTS = ("joint_rx", "joint_ry")
"""Joints of Blue's controllers that a session does not command; they must stay at 0."""


def decode_message(name: str, data: bytes) -> Any:
    """Return a message as an object with its fields.

    Args:
        name: package/Name.
        data: CDR with its header.

    Raises:
        ConfigError: the bytes are not such a message.
    """
    try:
        return find_decoder(name)(data)
    except Exception as error:  # the decoder raises whatever the bytes lead to
        raise ConfigError(f"{len(data)} bytes are no {name}: {error!r}") from error


def decode_twist(data: bytes) -> BodyTwist:
    """Return the velocity over ground of a ``geometry_msgs/Twist``, in F."""
    message = decode_message("geometry_msgs/Twist", data)
    return BodyTwist(nu=as_leaf(np.array([*_xyz(message.linear), *_xyz(message.angular)])))


def decode_signals(data: bytes, thrusters: int) -> ThrusterPwm:
    """Return the signals, us, of a ``std_msgs/Float64MultiArray``.

    Raises:
        ConfigError: as of `decode_message`, or another number of thrusters.
    """
    signals = np.array(decode_message("std_msgs/Float64MultiArray", data).data, float)
    if signals.shape != (thrusters,):
        raise ConfigError(f"data: {signals.size} numbers for {thrusters} thrusters")
    return ThrusterPwm(pwm_us=as_leaf(signals))


def decode_trajectory(data: bytes) -> JointGoal:
    """Return the goal of a ``trajectory_msgs/JointTrajectory``; see `read_trajectory`."""
    return read_trajectory(decode_message("trajectory_msgs/JointTrajectory", data))


def read_trajectory(message: Any) -> JointGoal:
    """Return the goal of a decoded ``trajectory_msgs/JointTrajectory``.

    Joints have the names of sessions, or those of Blue's controllers, in any order.

    Raises:
        ConfigError: an effort, or a motion of a joint that must stay level.
    """
    names = tuple(str(name) for name in message.joint_names)
    if any(len(point.effort) for point in message.points):
        raise ConfigError("points.effort: efforts are not followed; leave them empty")
    goal = JointGoal(
        joint_names=names,
        stamp_s=read_time(message.header.stamp),
        points=tuple(
            JointPoint(
                time_s=read_time(point.time_from_start),
                positions=_floats(point.positions),
                velocities=_floats(point.velocities),
                accelerations=_floats(point.accelerations),
            )
            for point in message.points
        ),
    )
    return _rename_joints(goal)


def read_time(message: Any) -> float:
    """Return a decoded ``builtin_interfaces/Time`` or ``Duration``, s."""
    return float(message.sec) + float(message.nanosec) / NANO


def _rename_joints(goal: JointGoal) -> JointGoal:
    """Return a goal with the names of sessions in place of Blue's."""
    names = goal.joint_names
    if not set(names) & {*BLUE_JOINTS, *_LEVEL_JOINTS}:
        return goal
    columns = [i for i, name in enumerate(names) if name not in _LEVEL_JOINTS]
    level = [i for i, name in enumerate(names) if name in _LEVEL_JOINTS]

    def keep(values: tuple[float, ...]) -> tuple[float, ...]:
        if len(values) != len(names):  # the session refuses it
            return values
        if moved := [names[i] for i in level if not math.isclose(values[i], 0.0, abs_tol=1e-9)]:
            raise ConfigError(f"joint {moved[0]!r}: only 0 can be commanded; robots stay level")
        return tuple(values[i] for i in columns)

    return replace(
        goal,
        joint_names=tuple(BLUE_JOINTS.get(names[i], names[i]) for i in columns),
        points=tuple(
            replace(
                point,
                positions=keep(point.positions),
                velocities=keep(point.velocities),
                accelerations=keep(point.accelerations),
            )
            for point in goal.points
        ),
    )


def _xyz(vector: Any) -> tuple[float, float, float]:
    return float(vector.x), float(vector.y), float(vector.z)


def _floats(values: Sequence[float]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
