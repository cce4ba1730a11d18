"""Whether a robot keeps to a JointTrajectory: tolerances and results as ROS has them.

The meaning is that of ``control_msgs/FollowJointTrajectory`` in ros2_control's
JointTrajectoryController: the path tolerance holds until the last point's time, then the robot has
``goal_time`` to come within the goal tolerance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands.joint_trajectory import (
    JointState,
    JointTrajectory,
    is_continuous,
    sample_state,
)


class ResultCode(IntEnum):
    """Results of ``control_msgs/FollowJointTrajectory``, with one more for a goal under way."""

    ACTIVE = 1
    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


@dataclass(frozen=True, kw_only=True)
class JointTolerance:
    """As ``control_msgs/JointTolerance``: 0 means not specified, -1 means none."""

    position: float = 0.0
    """m or rad."""
    velocity: float = 0.0
    """m/s or rad/s."""
    acceleration: float = 0.0
    """m/s^2 or rad/s^2."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """What is allowed to one robot; infinite where nothing is asked."""

    path: JointState
    """Largest errors on the way, for each joint."""
    goal: JointState
    """Largest errors at the end, for each joint."""
    goal_time_s: jax.Array
    """[] how long after the last point the goal may be reached; infinite: for ever."""


def build_tolerances(
    joints: Sequence[str],
    *,
    path: Mapping[str, JointTolerance] | None = None,
    goal: Mapping[str, JointTolerance] | None = None,
    goal_time_s: float = 0.0,
    default_path: JointTolerance | None = None,
    default_goal: JointTolerance | None = None,
    default_goal_time_s: float = 0.0,
) -> Tolerances:
    """Tolerances of a goal, with a robot's own where the goal says nothing.

    Args:
        joints: of the robot.
        path: by joint; 0 takes the default, -1 lifts it.
        goal: by joint; likewise.
        goal_time_s: likewise.
        default_path: for every joint; 0 or -1 is none.
        default_goal: likewise.
        default_goal_time_s: s; 0 or -1 waits for ever.

    Raises:
        ConfigError: a joint is unknown, or a number is negative but not -1.
    """
    tables = {"path_tolerance": path or {}, "goal_tolerance": goal or {}}
    for key, table in tables.items():
        for joint, tolerance in table.items():
            if joint not in joints:
                raise ConfigError(
                    f"{key} of joint {joint!r}: no such joint; have {', '.join(joints)}"
                )
            for quantity, value in vars(tolerance).items():
                _check_tolerance(f"{key} of joint {joint!r}, {quantity}", value)
    _check_tolerance("goal_time_tolerance", goal_time_s)
    return Tolerances(
        path=_build_limits(joints, tables["path_tolerance"], default_path or JointTolerance()),
        goal=_build_limits(joints, tables["goal_tolerance"], default_goal or JointTolerance()),
        goal_time_s=jnp.asarray(_resolve_limit(goal_time_s, default_goal_time_s)),
    )


def evaluate_goal(
    trajectory: JointTrajectory,
    allowed: Tolerances,
    t: jax.Array,
    measured: JointState,
    before: jax.Array,
) -> jax.Array:
    """How a goal stands.

    Args:
        trajectory: what is followed.
        allowed: its tolerances.
        t: [] s since its start.
        measured: where the joints are.
        before: int32 [] what this said a step ago; ``ACTIVE`` at the start.

    Returns:
        int32 [] a `ResultCode`; one that ends the goal stays.
    """
    wanted = sample_state(trajectory, t)
    end = trajectory.time_s[-1]
    on_path = _is_within(trajectory.joints, wanted, measured, allowed.path)
    at_goal = _is_within(trajectory.joints, wanted, measured, allowed.goal)
    path_code = jnp.where(on_path, ResultCode.ACTIVE, ResultCode.PATH_TOLERANCE_VIOLATED)
    late = t > end + allowed.goal_time_s
    waiting = jnp.where(late, ResultCode.GOAL_TOLERANCE_VIOLATED, ResultCode.ACTIVE)
    end_code = jnp.where(at_goal, ResultCode.SUCCESSFUL, waiting)
    now = jnp.where(t < end, path_code, end_code)
    return jnp.where(before == ResultCode.ACTIVE, now, before).astype(jnp.int32)


def _check_tolerance(name: str, value: float) -> None:
    if not (value >= 0 or value == -1):
        raise ConfigError(f"{name} = {value}: give a positive number, 0 (default) or -1 (none)")


def _resolve_limit(value: float, default: float) -> float:
    chosen = default if value == 0 else value
    return chosen if chosen > 0 else float("inf")


def _build_limits(
    joints: Sequence[str], by_joint: Mapping[str, JointTolerance], default: JointTolerance
) -> JointState:
    def row(quantity: str) -> jax.Array:
        values = [getattr(by_joint.get(joint, JointTolerance()), quantity) for joint in joints]
        return jnp.asarray([_resolve_limit(value, getattr(default, quantity)) for value in values])

    return JointState(
        position=row("position"), velocity=row("velocity"), acceleration=row("acceleration")
    )


def _is_within(
    joints: tuple[str, ...], wanted: JointState, measured: JointState, limit: JointState
) -> jax.Array:
    """Whether all errors are at most their limit; a turning joint errs by half a turn at most."""
    away = measured.position - wanted.position
    turn = 2 * jnp.pi * jnp.round(away / (2 * jnp.pi))
    away = away - jnp.where(jnp.asarray([is_continuous(joint) for joint in joints]), turn, 0.0)
    return (
        (jnp.abs(away) <= limit.position)
        & (jnp.abs(measured.velocity - wanted.velocity) <= limit.velocity)
        & (jnp.abs(measured.acceleration - wanted.acceleration) <= limit.acceleration)
    ).all()
