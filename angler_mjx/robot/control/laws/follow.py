"""Guidance along a trajectory: a target that moves in time, and waits for a robot that is behind.

The target goes along the trajectory on a clock of its own, which slows down as the robot falls
behind and stands when it is too far away. On a planner's way-points the heading follows the
path's horizontal direction, turning at a limited rate; a JointTrajectory brings its own.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import (
    Estimate,
    PoseTarget,
    TrackingTarget,
    joint_trajectory,
    trajectory,
)
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory, segment_at
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.control.laws.model import wrap_angle


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FollowGains:
    """Gains of the guidance."""

    yaw_rate_radps: float = 0.6
    """How fast the heading reference turns along way-points."""
    lag_slow_m: float = 0.4
    """Behind the reference by more than this, its clock slows down ..."""
    lag_stop_m: float = 1.0
    """... and at this distance it waits."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FollowCarry:
    """Memory of the guidance."""

    clock_s: jax.Array
    """[] time along the trajectory; runs slower than time while the robot is behind."""
    yaw_rad: jax.Array
    """[] heading reference."""
    segment: jax.Array
    """int32 [] of the trajectory at that time: where the next step begins to look for its own."""


def check(gains: FollowGains, law: str = "follow") -> None:
    """Refuse gains that make no sense (host side); ``law`` is what the user calls it.

    Raises:
        ConfigError: naming them.
    """
    check_gains(law, gains, positive=("yaw_rate_radps", "lag_stop_m"))
    if gains.lag_stop_m <= gains.lag_slow_m:
        raise ConfigError(
            f"gains of {law}: lag_stop_m = {gains.lag_stop_m:g} must be greater than "
            f"lag_slow_m = {gains.lag_slow_m:g}"
        )


def reset(yaw_rad: jax.Array) -> FollowCarry:
    """Memory of a robot that starts with a heading []."""
    return FollowCarry(
        clock_s=jnp.zeros_like(yaw_rad), yaw_rad=yaw_rad, segment=jnp.zeros((), jnp.int32)
    )


def step(
    gains: FollowGains,
    carry: FollowCarry,
    estimate: Estimate,
    command: Trajectory | JointTrajectory,
    dt: float,
) -> tuple[FollowCarry, PoseTarget]:
    """One control step, to a pose that moves.

    Args:
        gains: of the guidance.
        carry: its memory.
        estimate: the robot's state as known to the controller.
        command: what to follow; its time is counted in the steps in which it was followed.
        dt: control period, s.

    Returns:
        The new memory, and the pose to be at.
    """
    if isinstance(command, JointTrajectory):
        carry, moving = _follow_joints(gains, carry, estimate, command, dt)
        return carry, PoseTarget(
            position_m=moving.position_m,
            velocity_mps=moving.velocity_mps,
            yaw_rad=moving.yaw_rad,
        )
    carry, target, _ = _follow_points(gains, carry, estimate, command, dt)
    return carry, target


def track_target(
    gains: FollowGains,
    carry: FollowCarry,
    estimate: Estimate,
    command: Trajectory | JointTrajectory,
    dt: float,
) -> tuple[FollowCarry, TrackingTarget]:
    """As `step`, to a target with what its motion takes: rate of turn and accelerations.

    Way-points are joined by lines: what their corners would take is not finite and is left out.
    """
    if isinstance(command, JointTrajectory):
        return _follow_joints(gains, carry, estimate, command, dt)
    carry, target, turn = _follow_points(gains, carry, estimate, command, dt)
    still = jnp.zeros_like(target.position_m)
    return carry, TrackingTarget(
        position_m=target.position_m,
        velocity_mps=target.velocity_mps,
        acceleration_mps2=still,
        yaw_rad=target.yaw_rad,
        yaw_rate_radps=turn / dt,
        yaw_acceleration_radps2=still[0],
    )


def _follow_points(
    gains: FollowGains, carry: FollowCarry, estimate: Estimate, path: Trajectory, dt: float
) -> tuple[FollowCarry, PoseTarget, jax.Array]:
    """Along way-points; with the turn [] rad of the heading reference in this step."""
    segment = segment_at(path.time_s, carry.clock_s, carry.segment)
    position, velocity = trajectory.sample_reference(path, carry.clock_s, segment)
    pace = _clock_rate(gains, position, estimate)
    moving = velocity[0] ** 2 + velocity[1] ** 2 > 0.05**2
    wanted = jnp.where(
        moving,
        jnp.arctan2(jnp.where(moving, velocity[1], 0.0), jnp.where(moving, velocity[0], 1.0)),
        carry.yaw_rad,
    )
    turn = jnp.clip(
        wrap_angle(wanted - carry.yaw_rad), -gains.yaw_rate_radps * dt, gains.yaw_rate_radps * dt
    )
    carry = FollowCarry(
        clock_s=carry.clock_s + pace * dt, yaw_rad=wrap_angle(carry.yaw_rad + turn), segment=segment
    )
    target = PoseTarget(position_m=position, velocity_mps=pace * velocity, yaw_rad=carry.yaw_rad)
    return carry, target, turn


def _follow_joints(
    gains: FollowGains, carry: FollowCarry, estimate: Estimate, command: JointTrajectory, dt: float
) -> tuple[FollowCarry, TrackingTarget]:
    """Along a JointTrajectory, whose first joints are the vehicle's x, y, z and yaw."""
    segment = segment_at(command.time_s, carry.clock_s, carry.segment)
    now = joint_trajectory.sample_state(command, carry.clock_s, segment)
    position = now.position[:3]
    pace = _clock_rate(gains, position, estimate)
    yaw = wrap_angle(now.position[3])
    carry = FollowCarry(clock_s=carry.clock_s + pace * dt, yaw_rad=yaw, segment=segment)
    return carry, TrackingTarget(
        position_m=position,
        velocity_mps=pace * now.velocity[:3],
        acceleration_mps2=pace * pace * now.acceleration[:3],
        yaw_rad=yaw,
        yaw_rate_radps=pace * now.velocity[3],
        yaw_acceleration_radps2=pace * pace * now.acceleration[3],
    )


def _clock_rate(gains: FollowGains, position: jax.Array, estimate: Estimate) -> jax.Array:
    """Share [] of time at which the clock runs, for a reference at a position [3]."""
    lag = jnp.sqrt(jnp.sum((position - estimate.p) ** 2))
    return jnp.clip((gains.lag_stop_m - lag) / (gains.lag_stop_m - gains.lag_slow_m), 0.0, 1.0)
