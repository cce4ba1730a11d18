"""Commands to a vehicle with joints: what they shall do beside the base, or the end effector."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    PoseTarget,
    ThrusterPwm,
    TrackingTarget,
)
from angler_mjx.robot.control.commands.joint_trajectory import (
    VEHICLE_JOINTS,
    JointTrajectory,
    sample_state,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.link_params import LinkParams

type BaseCommand = (
    Trajectory
    | JointTrajectory
    | TrackingTarget
    | PoseTarget
    | BodyTwist
    | BodyWrench
    | ThrusterPwm
    | "EndEffectorTarget"
)
"""Commands that say nothing of the joints, or all that they have to do; a JointTrajectory may hold
columns of them."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class JointTarget:
    """Motion that the servos of joints [J] shall follow, in the order of the vehicle file."""

    position: jax.Array
    """[J] rad or m."""
    velocity: jax.Array
    """[J] rad/s or m/s."""
    acceleration: jax.Array
    """[J] rad/s^2 or m/s^2."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WholeBodyCommand:
    """Command to the base, and the motion of the joints beside it.

    Beside a target of the end effector only those of grippers count.
    """

    base: BaseCommand
    joints: JointTarget


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class EndEffectorTarget:
    """Pose that the end effector shall have, with the velocity of that pose."""

    position_m: jax.Array
    """[3] in W."""
    q: jax.Array
    """[4] attitude of the end effector's frame, to W."""
    velocity_mps: jax.Array
    """[3] in W."""
    angular_velocity_radps: jax.Array
    """[3] in W."""
    is_oriented: jax.Array
    """bool [] whether the attitude counts, not only the position."""


def hold_joints(joints: JointMotion) -> JointTarget:
    """Return the target of joints that stay where they are."""
    still = jnp.zeros_like(joints.position)
    return JointTarget(position=joints.position, velocity=still, acceleration=still)


def sample_joints(command: JointTrajectory, clock_s: jax.Array, pace: jax.Array) -> JointTarget:
    """Return the motion of the joints of a trajectory, those of the vehicle left out.

    Args:
        command: of one robot.
        clock_s: [] s since its start.
        pace: [] seconds of the trajectory by second.
    """
    now = sample_state(command, clock_s)
    first = len(VEHICLE_JOINTS)
    return JointTarget(
        position=now.position[first:],
        velocity=pace * now.velocity[first:],
        acceleration=pace * pace * now.acceleration[first:],
    )


def limit_joints(links: LinkParams, target: JointTarget) -> tuple[JointTarget, jax.Array]:
    """Clip a target to the limits of position and speed of the joints.

    Args:
        links: of the vehicle.
        target: that was commanded.

    Returns:
        The target within the limits, at rest where a limit of position holds, and bool [] whether
        anything was beyond them.
    """
    position = jnp.clip(target.position, links.lower, links.upper)
    is_beyond = position != target.position
    velocity = jnp.clip(target.velocity, -links.max_speed, links.max_speed)
    is_fast = velocity != target.velocity
    limited = JointTarget(
        position=position,
        velocity=jnp.where(is_beyond, 0.0, velocity),
        acceleration=jnp.where(is_beyond | is_fast, 0.0, target.acceleration),
    )
    return limited, jnp.any(is_beyond | is_fast)
