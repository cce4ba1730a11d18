"""Change of the motion of all bodies of a world by what they touch, over one physics step.

Contact is MuJoCo's: of each point that overlaps by r with speed v between the bodies, the normal
acceleration is asked to be omega^2 r - 2 zeta omega v_n and the tangential one - v_t / (2 dt),
softly, within a pyramid in Coulomb's cone; forces are those that come nearest to that in the metric
of the inertia (with added mass, and with all that is implicit in the step). zeta gives the
coefficient of restitution; a bounce as slow as what weight gives in `REST_STEPS` steps is none, and
critically damped.

Velocities [n] of a world here are MuJoCo's: of each robot the linear velocity in W, the angular one
in F and those of its joints; of each obstacle the first six.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import spd_solve
from angler_mjx.sim.physics.contact import mjx_contact
from angler_mjx.sim.physics.contact.grips import GripRows, GripSpec
from angler_mjx.sim.physics.contact.layout import BodyLayout
from angler_mjx.sim.physics.contact.mjx_contact import ContactProblem, Touches

SOFTNESS = 5e-4
"""Regularisation of a row of contact over the inverse of the effective mass: how far a point stays
behind the acceleration that is asked for. MuJoCo's (1 - d) / d, for an impedance d of 0.9995."""

REST_STEPS = 2.0
"""Steps of free acceleration towards each other, up to the speed of which bodies do not bounce: so
slow a bounce leaves contact for a step at most, and would go on for ever."""

MAX_REBOUND_MPS = 3.0
"""Speed at which springs of contact throw bodies apart at the most, which only what overlapped
before it moved can reach: twice that of a vehicle."""

_NO_INVERSE_MASS = 1e-9
"""Inverse of an effective mass, 1/kg, below which a body is one that cannot be pushed."""


@dataclass(frozen=True)
class ContactSpec:
    """Settings of contact that are fixed while it is compiled; classes are `SurfaceClass`."""

    friction: tuple[tuple[float, ...], ...]
    """Coulomb's coefficient of each pair of classes."""
    damping_ratio: tuple[tuple[float, ...], ...]
    """zeta of each pair of classes."""
    rate_radps: float
    """omega: natural frequency of a point of contact."""
    damage_energy_j: float | None = None
    """Energy of an impact above which a robot is damaged; None for never."""
    grip: GripSpec | None = None
    """Grips of the robots on a body; None where they hold nothing."""
    axis_pieces: tuple[int, ...] = ()
    """Number of pieces, in each of which the nearest rock is looked for, of the axes of the first
    obstacles of a world. It is 0 for a long one that nothing moves, which looks for no ground, and
    1 for all others that are not long, also those beyond the tuple. Empty where none is long."""


ROBOT, OBSTACLE, ROCK, FLOOR = range(4)
"""Classes of surfaces."""


@dataclass(frozen=True, kw_only=True)
class WorldBodies:
    """All bodies [B] of one world at the beginning of a physics step."""

    p: jax.Array
    """[B, 3] m in W."""
    rotation: jax.Array
    """[B, 3, 3] to W."""
    free: jax.Array
    """bool [B] whether the body can be pushed; others move as they are scripted."""
    velocity: jax.Array
    """[n] at the beginning."""
    unconstrained: jax.Array
    """[n] at the end, without contact."""
    M_robots: jax.Array
    """[R, 6 + J, 6 + J] inertia, linear part in W."""
    M_obstacles: jax.Array
    """[O, 6, 6] the same."""
    screws: jax.Array | None = None
    """[R, J, 6] velocity at the robot's centre in F by the speed of each joint."""
    moved: jax.Array | None = None
    """[G, J] 1 where a joint moves a shape of a robot, else 0."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ContactForces:
    """Solution of a step: [n] velocities and [k] points of contact, the deepest of the world."""

    velocity: jax.Array
    """[n] at the end."""
    touches: Touches
    normal_force_n: jax.Array
    """[k] >= 0."""
    closing_speed_mps: jax.Array
    """[k] normal speed towards each other at the beginning of the step; negative: apart."""
    impact_energy_j: jax.Array
    """[k] half the effective mass times the closing speed squared; 0 where they part."""
    touched: jax.Array
    """bool [B] whether contact or a grip changed the motion of the body."""
    grip_force_n: jax.Array | None = None
    """[R, 3] force of each robot's grip on the body, in W; None where robots hold nothing."""
    grip_moment_nm: jax.Array | None = None
    """[R, 3] its moment on the body about the robot's centre of mass, in W; None likewise."""


def resolve_contact(
    spec: ContactSpec,
    layout: BodyLayout,
    bodies: WorldBodies,
    touches: Touches,
    dt: jax.Array | float,
    grips: GripRows | None = None,
) -> ContactForces:
    """Return the motion of the bodies of one world after a step with contact.

    Args:
        spec: settings.
        layout: numbers of bodies and shapes.
        bodies: at the beginning of the step.
        touches: candidates; the deepest ``layout.points`` are solved for.
        dt: [] s.
        grips: of the robots; None where they hold nothing.
    """
    touches = _deepest(touches, layout.points)
    active = touches.depth_m > 0.0
    along_body = _jacobian(layout, bodies, touches) * active[:, None, None]  # [k, 3, n] in W
    free = along_body @ bodies.unconstrained
    frame = _slip_frames(touches.normal, free)
    relative = jnp.sum(frame * (along_body @ bodies.velocity)[:, None], axis=2)
    gained = relative[:, 0] - jnp.sum(touches.normal * free, axis=1)
    pushed = jnp.repeat(bodies.free, _dofs(layout), total_repeat_length=layout.velocities)
    J = jnp.sum(frame[:, :, :, None] * along_body[:, None], axis=2) * pushed
    inverse_mass = _inverse_mass(layout, bodies, J[:, 0])
    # What two bodies that cannot be pushed ask for would hide in the solver's cost what others do.
    acts = active & (inverse_mass > _NO_INVERSE_MASS)
    friction, zeta = _pair_values(spec, layout, touches)
    zeta = _damp_rest(spec, zeta, touches.depth_m, relative[:, 0], gained)
    spring = jnp.minimum(spec.rate_radps * touches.depth_m, MAX_REBOUND_MPS)
    asked = spec.rate_radps * (spring - 2.0 * zeta * relative[:, 0])
    asked = jnp.minimum(asked, (MAX_REBOUND_MPS - relative[:, 0]) / dt)
    sliding = -relative[:, 1:] / (2.0 * dt)
    k, n = touches.depth_m.shape[0], layout.velocities
    # Edges of a pyramid about the normal: normal plus and minus friction along either tangent.
    sides = jnp.asarray([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]], J.dtype)
    sides = sides * friction[:, None, None]  # [k, 4, 2]
    edges = J[:, :1] + jnp.sum(sides[..., None] * J[:, None, 1:], axis=2)  # [k, 4, n]
    reference = (asked[:, None] + jnp.sum(sides * sliding[:, None], axis=2)) * acts[:, None]
    mass = jnp.where(acts, 1.0 / jnp.where(acts, inverse_mass, 1.0), 0.0)
    D = jnp.where(acts, mass / (4.0 * SOFTNESS), 1.0)
    rows = _Rows(
        J=jnp.reshape(edges, (4 * k, n)),
        reference=jnp.reshape(reference, 4 * k),
        D=jnp.repeat(D, 4),
    )
    gripping, limits = 0, None
    if grips is not None:
        by_grips = _grip_rows(spec, layout, bodies, grips, pushed, dt)
        gripping = by_grips.D.shape[0]
        rows = jax.tree.map(lambda *parts: jnp.concatenate(parts), by_grips, rows)
        if spec.grip is not None and spec.grip.friction_limits is not None:
            limits = jnp.tile(jnp.asarray(spec.grip.friction_limits, J.dtype), layout.robots)
    with_contact, force = mjx_contact.solve_contact(
        layout,
        ContactProblem(
            M=_join_blocks(bodies),
            acceleration=(bodies.unconstrained - bodies.velocity) / dt,
            J=rows.J,
            reference=rows.reference,
            D=rows.D,
            equalities=gripping if limits is None else 0,
            friction_limits=limits,
        ),
    )
    normal = jnp.sum(jnp.reshape(force[gripping:], (k, 4)), axis=1)
    hit = jnp.any(J != 0.0, axis=1) & (normal > 0.0)[:, None]  # [k, n]
    bodies_of = np.repeat(np.arange(layout.bodies), _dofs(layout))
    touched = jnp.zeros(layout.bodies, bool).at[bodies_of].max(jnp.any(hit, axis=0))
    pull = moment = None
    if grips is not None and spec.grip is not None:
        wrench = jnp.reshape(force[:gripping], (layout.robots, 2, 3))
        if grips.axes is not None:
            wrench = jnp.einsum("rij,rkj->rki", grips.axes, wrench)
        pull, moment = wrench[:, 0], wrench[:, 1]
        touched = touched.at[: layout.robots].max(grips.held)
        touched = touched.at[layout.robots + spec.grip.body].max(jnp.any(grips.held))
    closing = -relative[:, 0]
    return ContactForces(
        velocity=bodies.velocity + dt * with_contact,
        touches=touches,
        normal_force_n=normal,
        closing_speed_mps=closing,
        impact_energy_j=0.5 * mass * jnp.square(jnp.maximum(closing, 0.0)),
        touched=touched,
        grip_force_n=pull,
        grip_moment_nm=moment,
    )


class _Rows(NamedTuple):
    """Rows of `ContactProblem`."""

    J: jax.Array
    reference: jax.Array
    D: jax.Array


def _grip_rows(
    spec: ContactSpec,
    layout: BodyLayout,
    bodies: WorldBodies,
    grips: GripRows,
    pushed: jax.Array,
    dt: jax.Array | float,
) -> _Rows:
    """Return the rows of grips; ``pushed`` bool [n] is where bodies can be moved.

    Welds draw errors back; friction asks for no velocity, as that of contact does.
    """
    J = jnp.reshape(grips.J * pushed, (6 * layout.robots, layout.velocities))
    inverse_mass = _inverse_mass(layout, bodies, J)
    acts = inverse_mass > 0.0
    speed, error = J @ bodies.velocity, jnp.reshape(grips.error, -1)
    asked = -spec.rate_radps * (spec.rate_radps * error + 2.0 * speed)
    if spec.grip is not None and spec.grip.friction_limits is not None:
        asked = -speed / (2.0 * dt)
    D = 1.0 / (SOFTNESS * jnp.where(acts, inverse_mass, 1.0))
    return _Rows(J=J, reference=jnp.where(acts, asked, 0.0), D=jnp.where(acts, D, 1.0))


def _dofs(layout: BodyLayout) -> np.ndarray:
    """Return int [B]: the number of velocities of each body."""
    return np.array([layout.robot_velocities] * layout.robots + [6] * layout.obstacles)


def _deepest(touches: Touches, points: int) -> Touches:
    """Return the ``points`` candidates that overlap most."""
    if touches.depth_m.shape[0] <= points:
        return touches
    _, rows = jax.lax.top_k(touches.depth_m, points)
    chosen: Touches = jax.tree.map(lambda leaf: leaf[rows], touches)
    return chosen


def _slip_frames(normal: jax.Array, velocity: jax.Array) -> jax.Array:
    """Return right-handed frames [k, 3, 3] whose rows are the normal, and the slip and across it.

    A pyramid of friction is as wide as the cone along its tangents alone, so the first is that
    along which the point would slip.

    Args:
        normal: [k, 3].
        velocity: [k, 3] of the point without contact.
    """
    slip = velocity - normal * jnp.sum(velocity * normal, axis=1, keepdims=True)
    square = jnp.sum(slip * slip, axis=1, keepdims=True)
    eye = jnp.eye(3, dtype=normal.dtype)
    helper = jnp.where(jnp.abs(normal[:, 1:2]) < 0.5, eye[1], eye[2])
    helper = helper - normal * jnp.sum(helper * normal, axis=1, keepdims=True)
    first = jnp.where(square > 1e-12, slip, helper)
    first = first / jnp.sqrt(jnp.sum(first * first, axis=1, keepdims=True))
    return jnp.stack([normal, first, jnp.cross(normal, first)], axis=1)


def _owners(layout: BodyLayout) -> np.ndarray:
    """Return int32 [G + 2]: the body of each shape; -1 for rock and floor."""
    return np.concatenate([layout.shape_bodies(), np.full(2, -1, np.int32)])


def _classes(layout: BodyLayout) -> np.ndarray:
    """Return int32 [G + 2]: the class of the surface of each shape, of rock, and of the floor."""
    owners = layout.shape_bodies()
    return np.concatenate([np.where(owners < layout.robots, ROBOT, OBSTACLE), [ROCK, FLOOR]])


def _pair_values(
    spec: ContactSpec, layout: BodyLayout, touches: Touches
) -> tuple[jax.Array, jax.Array]:
    """Return friction and damping ratio [k]."""
    classes, dtype = jnp.asarray(_classes(layout)), touches.depth_m.dtype
    pair = classes[touches.first], classes[touches.second]
    return jnp.asarray(spec.friction, dtype)[pair], jnp.asarray(spec.damping_ratio, dtype)[pair]


def _damp_rest(
    spec: ContactSpec, zeta: jax.Array, depth_m: jax.Array, speed: jax.Array, gained: jax.Array
) -> jax.Array:
    """Return the damping ratios [k], at least 1 where bodies come to rest on each other.

    The measure is the speed of an undamped bounce, sqrt(speed^2 + omega^2 depth^2).

    Args:
        spec: settings.
        zeta: [k] of the materials.
        depth_m: [k].
        speed: [k] normal speed of the bodies, apart, m/s.
        gained: [k] speed towards each other that the step gives without contact, m/s.
    """
    bounce = jnp.square(speed) + jnp.square(spec.rate_radps * depth_m)
    slow = bounce < jnp.square(REST_STEPS * jnp.maximum(gained, 0.0))
    return jnp.where(slow, jnp.maximum(zeta, 1.0), zeta)


def _jacobian(layout: BodyLayout, bodies: WorldBodies, touches: Touches) -> jax.Array:
    """Return [k, 3, n]: velocity of the second at the point against the first, in W."""
    dtype = touches.position.dtype
    owners = jnp.asarray(_owners(layout))
    first, second = owners[touches.first], owners[touches.second]
    each = jnp.arange(layout.bodies)
    is_second = second[:, None] == each
    sign = is_second.astype(dtype) - (first[:, None] == each)
    arm = touches.position[:, None] - bodies.p  # [k, B, 3]
    # By the angular velocity about each of the body's axes: axis x arm, in W.
    axes = jnp.swapaxes(bodies.rotation, 1, 2)  # [B, axis, 3]
    turning = jnp.cross(axes[None], arm[:, :, None])  # [k, B, axis, 3]
    unit = jnp.broadcast_to(jnp.eye(3, dtype=dtype), turning.shape)
    columns = jnp.concatenate([unit, turning], axis=2)  # [k, B, 6, 3]
    along = jnp.transpose(columns, (0, 3, 1, 2)) * sign[:, None, :, None]  # [k, 3, B, 6]
    k, robots = touches.depth_m.shape[0], layout.robots
    obstacles = jnp.reshape(along[:, :, robots:], (k, 3, layout.obstacles * 6))
    of_robots = along[:, :, :robots]
    if layout.joints:
        if bodies.screws is None or bodies.moved is None:
            raise RuntimeError("robots have joints, and no screws of them")
        moved = jnp.concatenate([bodies.moved, jnp.zeros((2, layout.joints), dtype)])
        shape = jnp.where(is_second[:, :robots], touches.second[:, None], touches.first[:, None])
        point = jnp.einsum("bfg,kbf->kbg", bodies.rotation[:robots], arm[:, :robots])
        linear = bodies.screws[..., :3] + jnp.cross(bodies.screws[..., 3:], point[:, :, None])
        linear = linear * moved[shape][..., None]  # [k, R, J, 3] in F
        by_joint = jnp.einsum("bfg,kbjg->kfbj", bodies.rotation[:robots], linear)
        by_joint = by_joint * sign[:, None, :robots, None]
        of_robots = jnp.concatenate([of_robots, by_joint], axis=3)
    of_robots = jnp.reshape(of_robots, (k, 3, robots * layout.robot_velocities))
    return jnp.concatenate([of_robots, obstacles], axis=2)


def _blocks(layout: BodyLayout, rows: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return rows [k, n] by body: [k, R, 6 + J] and [k, O, 6]."""
    k, split = rows.shape[0], layout.robots * layout.robot_velocities
    robots = jnp.reshape(rows[:, :split], (k, layout.robots, layout.robot_velocities))
    return robots, jnp.reshape(rows[:, split:], (k, layout.obstacles, 6))


def _inverse_mass(layout: BodyLayout, bodies: WorldBodies, rows: jax.Array) -> jax.Array:
    """Return J M^-1 J^T [k] of single rows J [k, n]."""
    total = jnp.zeros(rows.shape[0], rows.dtype)
    for block, M in zip(_blocks(layout, rows), (bodies.M_robots, bodies.M_obstacles), strict=True):
        if M.shape[0]:
            solved = jax.vmap(spd_solve.solve)(M, jnp.transpose(block, (1, 2, 0)))  # [B, m, k]
            total = total + jnp.einsum("kbm,bmk->k", block, solved)
    return total


def _join_blocks(bodies: WorldBodies) -> jax.Array:
    """Return the inertia [n, n] of all bodies."""
    blocks = [*bodies.M_robots, *bodies.M_obstacles]
    joined: jax.Array = jax.scipy.linalg.block_diag(*blocks)
    return joined
