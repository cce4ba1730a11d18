"""Grips: robots hold a body at one pose in its frame, as rigidly as contact pushes.

A grip is MuJoCo's weld: six rows of equality, which pull the error of position and attitude to zero
as a critically damped spring of the contact's natural frequency, and whose forces are part of the
same solution as those of contact. A grip whose force exceeds a limit breaks, and stays broken.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.sim.physics.contact.layout import BodyLayout


@dataclass(frozen=True)
class GripSpec:
    """Settings of grips that are fixed while a program is compiled."""

    body: int
    """Index of the held obstacle."""
    break_force_n: float | None = None
    """Force above which a grip breaks, N; None for never."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Grips:
    """Grips of the robots [R] of one world on its held body."""

    held: jax.Array
    """bool [R]."""
    position_m: jax.Array
    """[R, 3] centre of mass of each robot, m, in the frame of the body."""
    q: jax.Array
    """[R, 4] attitude of each robot in that frame."""
    wrench: jax.Array
    """[R, 6] wrench of the body on each robot at its centre of mass, N and N m, in F: its mean over
    the last control period, as a force-torque sensor in the wrist gives it; 0 at the start."""
    at_goal_s: jax.Array
    """[R] time for which the body has been at its goal."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GripForces:
    """Greatest forces of the grips [R] in a number of steps."""

    force_n: jax.Array
    """[R] norm of the force of a grip."""
    internal_n: jax.Array
    """[R] norm of that force less the mean of those of all grips: what moves nothing."""
    broke: jax.Array
    """bool [R] whether the grip broke."""


@dataclass(frozen=True, kw_only=True)
class GripRows:
    """Six rows for each robot: the first three of position, the others of attitude, in W."""

    J: jax.Array
    """[R, 6, n] velocity of the body at the grip against the robot's; 0 where nothing is held."""
    error: jax.Array
    """[R, 6] m and rad."""
    held: jax.Array
    """bool [R]."""


def take_hold(
    spec: GripSpec, p: jax.Array, q: jax.Array, body_p: jax.Array, body_q: jax.Array
) -> Grips:
    """Return grips of all robots where they are.

    Args:
        spec: settings.
        p: [R, 3] centres of mass of the robots, m, in W.
        q: [R, 4] their attitudes.
        body_p: [O, 3] centres of the obstacles, m, in W.
        body_q: [O, 4] their attitudes.
    """
    at, turned = body_p[spec.body], body_q[spec.body]
    back = quaternion.conjugate(turned)
    return Grips(
        held=jnp.ones(p.shape[0], bool),
        position_m=jax.vmap(quaternion.rotate_inverse, (None, 0))(turned, p - at),
        q=jax.vmap(quaternion.multiply, (None, 0))(back, q),
        wrench=jnp.zeros((p.shape[0], 6), p.dtype),
        at_goal_s=jnp.zeros(p.shape[0], p.dtype),
    )


def find_grip_rows(
    spec: GripSpec,
    layout: BodyLayout,
    grips: Grips,
    p: jax.Array,
    rotation: jax.Array,
) -> GripRows:
    """Return the rows of the grips of one world.

    Args:
        spec: settings.
        layout: of the world.
        grips: of its robots.
        p: [B, 3] positions of all bodies, m, in W.
        rotation: [B, 3, 3] their attitudes, to W.
    """
    robots, split = layout.robots, layout.robots * layout.robot_velocities
    body = robots + spec.body
    dtype, n = p.dtype, layout.velocities
    arm = grips.position_m @ rotation[body].T  # [R, 3] in W
    wanted = rotation[body] @ jax.vmap(quaternion.to_matrix)(grips.q)
    eye = jnp.eye(3, dtype=dtype)
    J = jnp.zeros((robots, 6, n), dtype)
    first = split + 6 * spec.body
    # By the angular velocity about each of the body's axes: axis x arm.
    turning = jnp.cross(rotation[body].T[None], arm[:, None])  # [R, axis, 3]
    J = J.at[:, :3, first : first + 3].set(eye)
    J = J.at[:, :3, first + 3 : first + 6].set(jnp.swapaxes(turning, 1, 2))
    J = J.at[:, 3:, first + 3 : first + 6].set(rotation[body])
    for robot in range(robots):
        at = robot * layout.robot_velocities
        J = J.at[robot, :3, at : at + 3].set(-eye)
        J = J.at[robot, 3:, at + 3 : at + 6].set(-rotation[robot])
    error = jnp.concatenate(
        [p[body] + arm - p[:robots], _turn_between(rotation[:robots], wanted)], axis=1
    )
    held = grips.held
    return GripRows(
        J=J * held[:, None, None], error=jnp.where(held[:, None], error, 0.0), held=held
    )


def _turn_between(first: jax.Array, second: jax.Array) -> jax.Array:
    """Return the small rotations [R, 3] rad, in W, from attitudes [R, 3, 3] to others."""
    turn = second @ jnp.swapaxes(first, 1, 2)
    skew = 0.5 * (turn - jnp.swapaxes(turn, 1, 2))
    return jnp.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


def measure_forces(spec: GripSpec, held: jax.Array, force_n: jax.Array) -> GripForces:
    """Return the forces of a step.

    Args:
        spec: settings.
        held: bool [R].
        force_n: [R, 3] of the grips on the body, N, in W.
    """
    force_n = jnp.where(held[:, None], force_n, 0.0)
    mean = jnp.sum(force_n, axis=0) / jnp.maximum(jnp.sum(held), 1)
    internal = jnp.where(held[:, None], force_n - mean, 0.0)
    norm_n = jnp.sqrt(jnp.sum(force_n * force_n, axis=1))
    limit = jnp.inf if spec.break_force_n is None else spec.break_force_n
    return GripForces(
        force_n=norm_n,
        internal_n=jnp.sqrt(jnp.sum(internal * internal, axis=1)),
        broke=held & (norm_n > limit),
    )


def measure_wrench(held: jax.Array, wrench: jax.Array, rotation: jax.Array) -> jax.Array:
    """Return the wrenches [R, 6] of the body on the robots in a step, N and N m, in F.

    Args:
        held: bool [R].
        wrench: [R, 6] of the grips on the body at the robots' centres of mass, in W.
        rotation: [R, 3, 3] attitudes of the robots, to W.
    """
    on_robot = -jnp.reshape(wrench, (-1, 2, 3))
    in_body = jnp.sum(rotation[:, None] * on_robot[..., None], axis=2)
    return jnp.where(held[:, None], jnp.reshape(in_body, (-1, 6)), 0.0)


def let_go(grips: Grips, forces: GripForces, alive: jax.Array) -> Grips:
    """Return grips after a step: those broken by their force, and of robots that ended, are gone.

    Args:
        grips: before.
        forces: of the step.
        alive: bool [R] robots whose episode goes on, or that have arrived.
    """
    return replace(grips, held=grips.held & alive & ~forces.broke)
