"""Inverse kinematics of base and arm together: velocities that bring the end effector to a target.

Task-priority redundancy resolution (Nakamura, Hanafusa and Yoshikawa 1987; Antonelli, Underwater
Robots, chapter 6) with two tasks: the pose of the end effector first, and in what it leaves free
the arm's middle posture. The base moves along surge, sway, heave and yaw; it is kept level.

Velocities are weighted by the limits of speed of each axis. Singular postures are met by damped
least squares, with a damping that grows with the velocity asked for (Sugihara 2011). Each axis has
bounds of velocity, which fall to zero at a joint's limits (Faverjon and Tournassoud 1987); an axis
that would be beyond its bounds is held there, and the others take over what it lacks (saturation in
the null space: Flacco, De Luca and Khatib 2012).
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp

from angler_kernels import quaternion, spd_solve
from angler_mjx.robot.control.commands import BodyTwist, Estimate
from angler_mjx.robot.control.commands.whole_body import (
    EndEffectorTarget,
    JointTarget,
    WholeBodyCommand,
)
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles import link_motion
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.link_params import LinkParams

PASSES = 3
"""Axes are held at their bounds in so many passes."""
LAG_RAD = 0.1
"""Distance, rad or m, that the reference of a joint may lead the joint."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WholeBodyGains:
    """Gains of the inverse kinematics."""

    position_per_s: float = 1.0
    """Velocity of the end effector per metre of error."""
    attitude_per_s: float = 1.0
    """Angular velocity of the end effector per radian of error."""
    posture_per_s: float = 0.2
    """Velocity of joints per radian from the middle of their limits, where the end effector
    permits."""
    level_per_s: float = 2.5
    """Angular velocity of the base per radian of roll and pitch."""
    limit_per_s: float = 2.0
    """Greatest speed of a joint per radian to its limit."""
    speed_mps: float = 0.3
    """Greatest speed of the end effector and of the base along an axis."""
    turn_radps: float = 0.5
    """Greatest angular speed of the end effector and of the base about the vertical."""
    damping: float = 0.01
    """Damping per square of the weighted velocity of the end effector."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WholeBodyCarry:
    """Memory of the inverse kinematics."""

    position: jax.Array
    """[J] reference of the joints."""
    velocity: jax.Array
    """[J] their speeds in the step before."""


def check(gains: WholeBodyGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("whole_body", gains, positive=("speed_mps", "turn_radps", "damping"))


def reset(estimate: Estimate) -> WholeBodyCarry | tuple[()]:
    """Return the memory of a robot that begins; none of a vehicle without joints."""
    if estimate.joints is None:
        return ()
    position = estimate.joints.position
    return WholeBodyCarry(position=position, velocity=jnp.zeros_like(position))


def step(
    gains: WholeBodyGains,
    links: LinkParams,
    carry: WholeBodyCarry,
    estimate: Estimate,
    target: EndEffectorTarget,
    commanded: JointTarget,
    dt: float,
) -> tuple[WholeBodyCarry, WholeBodyCommand]:
    """One control step.

    Args:
        gains: of the inverse kinematics.
        links: of the vehicle.
        carry: memory.
        estimate: state as known to the controller, with its joints.
        target: pose of the end effector.
        commanded: motion of the joints; that of grippers is kept.
        dt: control period, s.

    Returns:
        The new memory, and the velocity of the base with the motion of the joints.

    Raises:
        ValueError: the vehicle has no end effector, or the estimate no joints.
    """
    joints = estimate.joints
    if joints is None:
        raise ValueError("the vehicle has no joints")
    tip = link_motion.locate_end_effector(links, joints.position)
    counts = jnp.where(target.is_oriented, 1.0, jnp.asarray([1.0] * 3 + [0.0] * 3))
    wanted = counts * end_effector_velocity(gains, estimate, tip, target)
    jacobian = counts[:, None] * tip.jacobian
    is_gripper = jnp.asarray(links.tree.grippers)
    # Roll and pitch are no means of the task: what they do is made good by the other axes.
    rest = wanted - jnp.sum(jacobian[:, 3:5] * estimate.nu[3:5], axis=1)
    lower, upper = velocity_bounds(gains, links, joints)
    posture = gains.posture_per_s * (0.5 * (links.lower + links.upper) - joints.position)
    preferred = jnp.concatenate([jnp.zeros(4, posture.dtype), posture])
    axes = jnp.asarray([0, 1, 2, 5, *range(6, jacobian.shape[1])])
    velocity = resolve(gains.damping, jacobian[:, axes], rest, preferred, lower, upper)
    # The arm makes good what the base does otherwise than it is told.
    rest = rest - jnp.sum(jacobian[:, axes[:4]] * estimate.nu[axes[:4]], axis=1)
    speed = resolve(gains.damping, jacobian[:, 6:], rest, velocity[4:], lower[4:], upper[4:])
    level = gains.level_per_s * model.attitude_error(estimate.q, quaternion.yaw(estimate.q))
    nu = jnp.concatenate([velocity[:3], level[:2], velocity[3:4]])
    position = carry.position + dt * speed
    position = joints.position + jnp.clip(position - joints.position, -LAG_RAD, LAG_RAD)
    moved = JointTarget(
        position=jnp.clip(position, links.lower, links.upper),
        velocity=speed,
        acceleration=(speed - carry.velocity) / dt,
    )
    target_joints = jax.tree.map(partial(jnp.where, is_gripper), commanded, moved)
    after = WholeBodyCarry(position=target_joints.position, velocity=target_joints.velocity)
    return after, WholeBodyCommand(base=BodyTwist(nu=nu), joints=target_joints)


def end_effector_velocity(
    gains: WholeBodyGains,
    estimate: Estimate,
    tip: link_motion.EndEffectorMotion,
    target: EndEffectorTarget,
) -> jax.Array:
    """Return the velocity [6] that the end effector shall have, in F."""
    offset = target.position_m - estimate.p
    error = quaternion.rotate_inverse(estimate.q, offset) - tip.position
    R = quaternion.to_matrix(estimate.q)
    wanted = jnp.sum(R[:, :, None] * quaternion.to_matrix(target.q)[:, None, :], axis=0)
    turn = rotation_vector(jnp.sum(wanted[:, None, :] * tip.rotation[None], axis=2))
    linear = gains.position_per_s * error
    linear = linear + quaternion.rotate_inverse(estimate.q, target.velocity_mps)
    angular = gains.attitude_per_s * turn
    angular = angular + quaternion.rotate_inverse(estimate.q, target.angular_velocity_radps)
    return jnp.concatenate(
        [
            model.limit_norm(linear, jnp.asarray(gains.speed_mps, linear.dtype)),
            model.limit_norm(angular, jnp.asarray(gains.turn_radps, angular.dtype)),
        ]
    )


def rotation_vector(R: jax.Array) -> jax.Array:
    """Return axis times sine of the angle [3] of a rotation [3, 3], of length 1 beyond 90 degrees.

    A half turn has no axis in it: 0, an unstable rest.
    """
    sine = 0.5 * jnp.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    length = jnp.sqrt(jnp.sum(sine * sine) + 1e-12)
    return jnp.where(cosine > 0, sine, sine / length)


def velocity_bounds(
    gains: WholeBodyGains, links: LinkParams, joints: JointMotion
) -> tuple[jax.Array, jax.Array]:
    """Return the least and the greatest velocity [4 + J] of surge, sway, heave, yaw and joints."""
    base = jnp.asarray([gains.speed_mps] * 3 + [gains.turn_radps], joints.position.dtype)
    limit = jnp.where(jnp.asarray(links.tree.grippers), 0.0, links.max_speed)
    lower = jnp.clip(gains.limit_per_s * (links.lower - joints.position), -limit, limit)
    upper = jnp.clip(gains.limit_per_s * (links.upper - joints.position), -limit, limit)
    return jnp.concatenate([-base, lower]), jnp.concatenate([base, upper])


def resolve(
    damping: float,
    jacobian: jax.Array,
    wanted: jax.Array,
    preferred: jax.Array,
    lower: jax.Array,
    upper: jax.Array,
) -> jax.Array:
    """Return velocities within bounds that give a task its velocity, near those preferred.

    Args:
        damping: of least squares, per square of the task's velocity.
        jacobian: [6, k] velocity of the task by that of each axis.
        wanted: [6] velocity of the task.
        preferred: [k] velocities of the axes where the task leaves them free.
        lower: [k] least velocity of each axis.
        upper: [k] greatest.
    """
    span = 0.5 * (upper - lower)
    weight = span * span
    square = damping * jnp.sum(wanted * wanted) + 1e-8
    identity = jnp.eye(jacobian.shape[0], dtype=jacobian.dtype)
    free, held = jnp.ones_like(lower), jnp.zeros_like(lower)
    preferred = jnp.clip(preferred, lower, upper)
    velocity = preferred
    for _ in range(PASSES):
        begin = jnp.where(free > 0, preferred, held)
        weighted = jacobian * (weight * free)
        gram = jnp.sum(weighted[:, None, :] * jacobian[None], axis=2) + square * identity
        rest = wanted - jnp.sum(jacobian * begin, axis=1)
        factor = spd_solve.solve(gram, rest[:, None])[:, 0]
        velocity = begin + jnp.sum(weighted * factor[:, None], axis=0)
        clipped = jnp.clip(velocity, lower, upper)
        held = jnp.where(velocity == clipped, held, clipped)
        free = jnp.where(velocity == clipped, free, 0.0)
    return jnp.clip(velocity, lower, upper)
