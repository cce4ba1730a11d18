"""Grips: robots hold a body at one pose in its frame, as rigidly as contact pushes.

A robot holds it by its hull or by its end effector: the point of the grip is the centre of mass,
with the attitude of the hull, or the frame of the end effector, which the joints move. Jaws that
close with a force hold by dry friction instead: the six rows are bounded in the frame of the grip,
and ask for no velocity instead of no error, so that the body slips where a bound is met (soft
fingers: Howe and Cutkosky 1996, International Journal of Robotics Research 15; bounds axis by axis
instead of their ellipsoid). A grip that has slipped too far is lost.

A grip is MuJoCo's weld: six rows of equality, which pull the error of position and attitude to zero
as a critically damped spring of the contact's natural frequency, and whose forces are part of the
same solution as those of contact. A grip whose force exceeds a limit breaks, and stays broken.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax.scipy.spatial.transform import Rotation

from angler_kernels import quaternion
from angler_mjx.robot.vehicles.link_motion import EndEffectorMotion
from angler_mjx.sim.physics.contact.layout import BodyLayout


@dataclass(frozen=True)
class GripSpec:
    """Settings of grips that are fixed while a program is compiled."""

    body: int
    """Index of the held obstacle."""
    break_force_n: float | None = None
    """Force above which a grip breaks, N; None for never."""
    by_end_effector: bool = False
    """Whether robots hold the body by their end effectors instead of their hulls."""
    friction_limits: tuple[float, ...] | None = None
    """Greatest forces [3], N, and moments [3], N m, of jaws along the axes of the end effector;
    None where the grip is a weld."""
    max_slip_m: float = 0.05
    """Slip beyond which jaws have lost the body, m."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Grips:
    """Grips of the robots [R] of one world on its held body."""

    held: jax.Array
    """bool [R]."""
    position_m: jax.Array
    """[R, 3] point of each grip, m, in the frame of the body."""
    q: jax.Array
    """[R, 4] attitude of each grip in that frame."""
    center_m: jax.Array
    """[R, 3] centre of the body from the robot's centre of mass, m, in F."""
    lever_m: jax.Array
    """[R, 3] point of the grip from there, m, in F; of a hull 0 but for the height of the body."""
    wrench: jax.Array
    """[R, 6] wrench of the body on each robot at its centre of mass, N and N m, in F: its mean over
    the last control period, as a force-torque sensor in the wrist gives it; 0 at the start."""
    at_goal_s: jax.Array
    """[R] time for which the body has been at its goal."""
    closed_s: jax.Array | None = None
    """[R] when each gripper closed, inf before; None where robots hold the body from the start."""


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


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GripPoints:
    """Points [R] by which the robots of a world hold a body."""

    position_m: jax.Array
    """[R, 3] m in W."""
    rotation: jax.Array
    """[R, 3, 3] attitude of the grip, to W."""
    jacobian: jax.Array | None = None
    """[R, 6, 6 + J] velocity and angular velocity, in W, by the velocities of the robot (linear in
    W, angular in F, joints); None for the robot's centre of mass."""


def friction_limits(closing_force_n: float, friction: float, jaw_m: float) -> tuple[float, ...]:
    """Return the greatest forces, N, and moments, N m, of two jaws in the frame of the grip.

    Jaws close along y, each presses with the closing force on a round patch: along y they hold as
    much as closes them, along x and z twice the friction of one; about y the friction of two
    patches of even pressure, 2 mu N 2/3 r; about x and z N r, at which one edge of a patch lifts.

    Args:
        closing_force_n: N.
        friction: mu, Coulomb's coefficient.
        jaw_m: r, radius of the patch, m.
    """
    slip_n = 2.0 * friction * closing_force_n
    tilt_nm = closing_force_n * jaw_m
    return slip_n, closing_force_n, slip_n, tilt_nm, slip_n * jaw_m * 2.0 / 3.0, tilt_nm


@dataclass(frozen=True, kw_only=True)
class GripRows:
    """Six rows for each robot: the first three of position, the others of attitude, in W.

    Those of jaws that hold by friction are along the axes of the grip.
    """

    J: jax.Array
    """[R, 6, n] velocity of the body at the grip against the robot's; 0 where nothing is held."""
    error: jax.Array
    """[R, 6] m and rad."""
    held: jax.Array
    """bool [R]."""
    axes: jax.Array | None = None
    """[R, 3, 3] axes of the rows, to W; None for those of W."""


def take_hold(
    spec: GripSpec,
    p: jax.Array,
    q: jax.Array,
    body_p: jax.Array,
    body_q: jax.Array,
    tips: EndEffectorMotion | None = None,
) -> Grips:
    """Return grips of all robots where they are.

    Args:
        spec: settings.
        p: [R, 3] centres of mass of the robots, m, in W.
        q: [R, 4] their attitudes.
        body_p: [O, 3] centres of the obstacles, m, in W.
        body_q: [O, 4] their attitudes.
        tips: [R] end effectors in F, where they hold the body.
    """
    at, turned = body_p[spec.body], body_q[spec.body]
    back = quaternion.conjugate(turned)
    center_m = jax.vmap(quaternion.rotate_inverse)(q, at - p)
    grip_p, grip_q, lever_m = p, q, center_m * jnp.asarray([0.0, 0.0, 1.0], p.dtype)
    if tips is not None:
        lever_m = tips.position
        grip_p = p + jax.vmap(quaternion.rotate)(q, lever_m)
        turned_tips = Rotation.from_matrix(tips.rotation).as_quat()[:, jnp.array([3, 0, 1, 2])]
        grip_q = jax.vmap(quaternion.multiply)(q, turned_tips)
    return Grips(
        held=jnp.ones(p.shape[0], bool),
        position_m=jax.vmap(quaternion.rotate_inverse, (None, 0))(turned, grip_p - at),
        q=jax.vmap(quaternion.multiply, (None, 0))(back, grip_q),
        center_m=center_m,
        lever_m=lever_m,
        wrench=jnp.zeros((p.shape[0], 6), p.dtype),
        at_goal_s=jnp.zeros(p.shape[0], p.dtype),
    )


def find_grip_rows(
    spec: GripSpec,
    layout: BodyLayout,
    grips: Grips,
    points: GripPoints,
    p: jax.Array,
    rotation: jax.Array,
) -> GripRows:
    """Return the rows of the grips of one world.

    Args:
        spec: settings.
        layout: of the world.
        grips: of its robots.
        points: by which they hold the body.
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
        if points.jacobian is not None:
            J = J.at[robot, :, at : at + layout.robot_velocities].set(-points.jacobian[robot])
            continue
        J = J.at[robot, :3, at : at + 3].set(-eye)
        J = J.at[robot, 3:, at + 3 : at + 6].set(-rotation[robot])
    error = jnp.concatenate(
        [p[body] + arm - points.position_m, _turn_between(points.rotation, wanted)], axis=1
    )
    held, axes = grips.held, None
    if spec.friction_limits is not None:
        axes = points.rotation
        J = jnp.einsum("rij,rkin->rkjn", axes, J.reshape(robots, 2, 3, n)).reshape(robots, 6, n)
    return GripRows(
        J=J * held[:, None, None],
        error=jnp.where(held[:, None], error, 0.0),
        held=held,
        axes=axes,
    )


def _turn_between(first: jax.Array, second: jax.Array) -> jax.Array:
    """Return the small rotations [R, 3] rad, in W, from attitudes [R, 3, 3] to others."""
    turn = second @ jnp.swapaxes(first, 1, 2)
    skew = 0.5 * (turn - jnp.swapaxes(turn, 1, 2))
    return jnp.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


def measure_forces(
    spec: GripSpec, held: jax.Array, force_n: jax.Array, slip_m: jax.Array | None = None
) -> GripForces:
    """Return the forces of a step.

    Args:
        spec: settings.
        held: bool [R].
        force_n: [R, 3] of the grips on the body, N, in W.
        slip_m: [R] distance of the points of the grips from where they took hold; None of welds.
    """
    force_n = jnp.where(held[:, None], force_n, 0.0)
    mean = jnp.sum(force_n, axis=0) / jnp.maximum(jnp.sum(held), 1)
    internal = jnp.where(held[:, None], force_n - mean, 0.0)
    norm_n = jnp.sqrt(jnp.sum(force_n * force_n, axis=1))
    limit = jnp.inf if spec.break_force_n is None else spec.break_force_n
    return GripForces(
        force_n=norm_n,
        internal_n=jnp.sqrt(jnp.sum(internal * internal, axis=1)),
        broke=held & (norm_n > limit if slip_m is None else slip_m > spec.max_slip_m),
    )


def measure_wrench(
    held: jax.Array, wrench: jax.Array, rotation: jax.Array, lever_m: jax.Array | None = None
) -> jax.Array:
    """Return the wrenches [R, 6] of the body on the robots in a step, N and N m, in F.

    Moments are about the robots' centres of mass.

    Args:
        held: bool [R].
        wrench: [R, 6] of the grips on the body at their points, in W.
        rotation: [R, 3, 3] attitudes of the robots, to W.
        lever_m: [R, 3] points of the grips in F; None for the robots' centres of mass.
    """
    on_robot = -jnp.reshape(wrench, (-1, 2, 3))
    in_body = jnp.sum(rotation[:, None] * on_robot[..., None], axis=2)
    if lever_m is not None:
        in_body = in_body.at[:, 1].add(jnp.cross(lever_m, in_body[:, 0]))
    return jnp.where(held[:, None], jnp.reshape(in_body, (-1, 6)), 0.0)


def find_grip_points(
    spec: GripSpec, p: jax.Array, rotation: jax.Array, tips: EndEffectorMotion | None
) -> GripPoints:
    """Return where the robots [R] of one world hold a body.

    Args:
        spec: settings.
        p: [R, 3] centres of mass of the robots, m, in W.
        rotation: [R, 3, 3] their attitudes, to W.
        tips: [R] end effectors in F; None where robots hold it by their hulls.

    Raises:
        ValueError: they hold it by end effectors that they do not have.
    """
    if not spec.by_end_effector:
        return GripPoints(position_m=p, rotation=rotation)
    if tips is None:
        raise ValueError("robots hold a body by end effectors, and have none")
    # Velocities of robots are linear in W here, and in F in the Jacobian of the end effector.
    in_world = jnp.einsum("rij,rkjn->rkin", rotation, tips.jacobian.reshape(len(p), 2, 3, -1))
    linear = jnp.einsum("rkin,rmn->rkim", in_world[..., :3], rotation)
    jacobian = jnp.concatenate([linear, in_world[..., 3:]], axis=-1)
    return GripPoints(
        position_m=p + jnp.einsum("rij,rj->ri", rotation, tips.position),
        rotation=jnp.einsum("rij,rjk->rik", rotation, tips.rotation),
        jacobian=jacobian.reshape(len(p), 6, -1),
    )


def let_go(grips: Grips, forces: GripForces, alive: jax.Array) -> Grips:
    """Return grips after a step: those broken by their force, and of robots that ended, are gone.

    Args:
        grips: before.
        forces: of the step.
        alive: bool [R] robots whose episode goes on, or that have arrived.
    """
    return replace(grips, held=grips.held & alive & ~forces.broke)
