"""Targets that a position controller below is guided by, moved on by twists and end effectors.

A twist moves the target on evenly, and the target waits for a robot that is behind. A target of the
end effector is resolved into a twist of the base and a motion of the joints
(`angler_mjx.robot.control.laws.whole_body`). The controller below knows nothing of an arm.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import (
    BodyTwist,
    Estimate,
    PoseTarget,
    TrackingTarget,
    as_tracking,
)
from angler_mjx.robot.control.commands.whole_body import (
    EndEffectorTarget,
    JointTarget,
    WholeBodyCommand,
)
from angler_mjx.robot.control.laws import whole_body
from angler_mjx.robot.control.laws.model import wrap_angle
from angler_mjx.robot.control.laws.whole_body import WholeBodyCarry, WholeBodyGains
from angler_mjx.robot.vehicles.link_params import LinkParams

LEASH_M, LEASH_RAD = 0.5, 0.5
"""Greatest lead of a twist's target over a robot that does not keep up."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GuidedCarry:
    """Memory of the target of the base."""

    position_m: jax.Array
    """[3] target of the previous step, in W."""
    yaw_rad: jax.Array
    """[] heading of the target."""
    steered: jax.Array
    """bool [] whether a twist moved the target."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GuidedArmCarry:
    """Memory of the targets of base and end effector."""

    base: GuidedCarry
    arm: WholeBodyCarry | tuple[()]
    """Empty for a vehicle without joints."""


def reset_base(estimate: Estimate, yaw_rad: jax.Array) -> GuidedCarry:
    """Return the memory of a base that begins at an estimate with a heading [] rad."""
    steered = jnp.zeros(jnp.shape(yaw_rad), bool)
    return GuidedCarry(position_m=estimate.p, yaw_rad=yaw_rad, steered=steered)


def step_base(
    carry: GuidedCarry,
    estimate: Estimate,
    command: PoseTarget | TrackingTarget | BodyTwist,
    dt: float,
) -> tuple[GuidedCarry, TrackingTarget]:
    """Return the memory and the target of the base of one control step of ``dt`` s."""
    if isinstance(command, BodyTwist):
        target = _advance_target(carry, estimate, command, dt)
    else:
        target = as_tracking(command)
    after = GuidedCarry(
        position_m=target.position_m,
        yaw_rad=target.yaw_rad,
        steered=jnp.full_like(carry.steered, isinstance(command, BodyTwist)),
    )
    return after, target


def reset(estimate: Estimate, yaw_rad: jax.Array) -> GuidedArmCarry:
    """Return the memory of a robot that begins at an estimate with a heading [] rad."""
    return GuidedArmCarry(base=reset_base(estimate, yaw_rad), arm=whole_body.reset(estimate))


def step(
    gains: WholeBodyGains,
    links: LinkParams | None,
    carry: GuidedArmCarry,
    estimate: Estimate,
    command: PoseTarget | TrackingTarget | BodyTwist | EndEffectorTarget,
    joints: JointTarget | None,
    dt: float,
) -> tuple[GuidedArmCarry, TrackingTarget | WholeBodyCommand]:
    """Return the target of the base, with the motion of the joints of a vehicle that has any.

    Args:
        gains: of the inverse kinematics.
        links: of the vehicle; None without any.
        carry: memory.
        estimate: state as known to the controller.
        command: of the base or the end effector.
        joints: motion of the joints that the command leaves alone; None without any.
        dt: control period, s.

    Raises:
        ConfigError: a target of the end effector, and no links.
    """
    if not isinstance(command, EndEffectorTarget):
        base, target = step_base(carry.base, estimate, command, dt)
        after = GuidedArmCarry(base=base, arm=whole_body.reset(estimate))
        return after, target if joints is None else WholeBodyCommand(base=target, joints=joints)
    if joints is None or links is None or not isinstance(carry.arm, WholeBodyCarry):
        raise ConfigError("command EndEffectorTarget: no robot of the fleet has links")
    arm, resolved = whole_body.step(gains, links, carry.arm, estimate, command, joints, dt)
    if not isinstance(resolved.base, BodyTwist):
        raise TypeError(f"inverse kinematics gives {type(resolved.base).__name__}")
    base, target = step_base(carry.base, estimate, resolved.base, dt)
    after = GuidedArmCarry(base=base, arm=arm)
    return after, WholeBodyCommand(base=target, joints=resolved.joints)


def _advance_target(
    carry: GuidedCarry, estimate: Estimate, command: BodyTwist, dt: float
) -> TrackingTarget:
    """Advance the target by a twist, starting at the robot after any other command."""
    yaw = quaternion.yaw(estimate.q)
    velocity = quaternion.rotate(quaternion.from_yaw(yaw), command.nu[:3])
    lead = jnp.where(carry.steered, carry.position_m - estimate.p, 0.0)
    ahead = jnp.where(carry.steered, wrap_angle(carry.yaw_rad - yaw), 0.0)
    away = jnp.sqrt(jnp.sum(lead**2) + 1e-12)
    lead = lead * jnp.minimum(1.0, LEASH_M / away) + velocity * dt
    ahead = jnp.clip(ahead, -LEASH_RAD, LEASH_RAD) + command.nu[5] * dt
    still = jnp.zeros_like(yaw)
    return TrackingTarget(
        position_m=estimate.p + lead,
        velocity_mps=velocity,
        acceleration_mps2=jnp.zeros_like(velocity),
        yaw_rad=wrap_angle(yaw + ahead),
        yaw_rate_radps=command.nu[5] + still,
        yaw_acceleration_radps2=still,
    )
