"""Cargo: a body that the robots of a world hold together and bring to a pose."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.control.commands import GripReading
from angler_mjx.sim.physics.contact.grips import Grips
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import GripRecord
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import ObstacleState


@dataclass(frozen=True, kw_only=True)
class ApproachSpec:
    """Way of robots to a body that they do not hold from the start."""

    above_m: float
    """Height of the robots at the start above where they hold it."""
    within_m: float
    """Offset of a gripper from where it is to hold the body, within which it closes."""
    within_rad: float
    """Angle from the attitude in which it is to hold the body, within which it closes."""
    within_mps: float
    """Speed against the body below which it closes."""
    wait_s: float
    """Time for which plans leave the robots at the body."""
    lift_m: float
    """Height by which plans lift the body straight up first."""


@dataclass(frozen=True)
class CargoSpec:
    """Goal of the cargo; fixed while a program is compiled."""

    body: int
    """Index of the obstacle that is carried."""
    goal_m: tuple[float, float, float]
    """Position of its centre at the goal, m, in W."""
    turn_rad: float
    """Turn about z up from its attitude at the start to that at the goal."""
    tolerance_m: float
    """Distance from the goal below which it has arrived."""
    tolerance_rad: float
    """Angle from the attitude at the goal below which it has arrived."""
    hold_s: float = 0.0
    """Time without a break for which it has to be there."""
    release: bool = False
    """Whether grips open when it has arrived."""
    approach: ApproachSpec | None = None
    """Way of the robots to it; None where they hold it from the start."""


@dataclass(frozen=True, kw_only=True)
class GripNoise:
    """Errors of the force-torque sensors of grips: standard deviations along each axis."""

    force_std_n: float
    """Of each reading, N."""
    torque_std_nm: float
    """Of each reading, N m."""
    force_bias_n: float
    """Of what a sensor is off by in a whole flight, N."""
    torque_bias_nm: float
    """The same of moments, N m."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GripSensors:
    """Force-torque sensors of the robots [R] of one world."""

    key: jax.Array
    """uint32 [R, 2] of each sensor's noise."""
    bias: jax.Array
    """[R, 6] N and N m."""
    std: jax.Array
    """[6] N and N m, of each reading."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CargoError:
    """Error of the cargo's pose at its goal; [R] the same for all robots, or []."""

    distance_m: jax.Array
    angle_rad: jax.Array


def find_error(spec: CargoSpec, environment: Environment, obstacles: ObstacleState) -> CargoError:
    """Return the error [] of the cargo of one world."""
    dtype = obstacles.p.dtype
    turn = quaternion.from_yaw(jnp.asarray(spec.turn_rad, dtype))
    wanted = quaternion.multiply(turn, environment.obstacles.q0[spec.body])
    apart = quaternion.multiply(quaternion.conjugate(wanted), obstacles.q[spec.body])
    offset = obstacles.p[spec.body] - jnp.asarray(spec.goal_m, dtype)
    return CargoError(
        distance_m=jnp.sqrt(jnp.sum(offset * offset)),
        angle_rad=2.0 * jnp.arctan2(jnp.sqrt(jnp.sum(apart[1:] ** 2)), jnp.abs(apart[0])),
    )


def has_arrived(spec: CargoSpec, error: CargoError) -> jax.Array:
    """Return whether the cargo is at its goal, bool as the error."""
    return (error.distance_m < spec.tolerance_m) & (error.angle_rad < spec.tolerance_rad)


def finish_carrying(
    spec: CargoSpec, grips: Grips, error: CargoError, dt: float
) -> tuple[Grips, jax.Array]:
    """Return grips after a control step of dt s, and whether robots are finished, bool [R].

    Robots that hold the cargo are finished when it has been at its goal for `CargoSpec.hold_s`;
    with `CargoSpec.release` their grips open then.

    Args:
        spec: settings.
        grips: at the end of the step.
        error: [R] of the cargo then.
        dt: control period, s.
    """
    at_goal_s = jnp.where(has_arrived(spec, error), grips.at_goal_s + dt, 0.0)
    # Half a step less, so that rounding of the sum makes no step more.
    finished = grips.held & (at_goal_s > max(spec.hold_s - 0.5 * dt, 0.0))
    held = grips.held & ~finished if spec.release else grips.held
    return replace(grips, held=held, at_goal_s=at_goal_s), finished


def open_grips(grips: Grips) -> Grips:
    """Return grips that were never closed."""
    return replace(
        grips,
        held=jnp.zeros_like(grips.held),
        closed_s=jnp.full(grips.held.shape, jnp.inf, grips.wrench.dtype),
    )


def find_grip_speeds(
    spec: CargoSpec, vehicles: VehicleState, lever_m: jax.Array, obstacles: ObstacleState
) -> jax.Array:
    """Return the speeds [R] m/s of grippers against the body; joints are taken to be at rest.

    Args:
        spec: settings.
        vehicles: [R] of one world.
        lever_m: [R, 3] points of the grips from the robots' centres of mass, m, in F.
        obstacles: of that world.
    """
    p, q, nu = obstacles.p[spec.body], obstacles.q[spec.body], obstacles.nu[spec.body]

    def find_speed(
        robot_p: jax.Array, robot_q: jax.Array, robot_nu: jax.Array, lever: jax.Array
    ) -> jax.Array:
        point = robot_p + quaternion.rotate(robot_q, lever)
        velocity = quaternion.rotate(robot_q, robot_nu[:3] + jnp.cross(robot_nu[3:], lever))
        arm = quaternion.rotate_inverse(q, point - p)
        of_body = quaternion.rotate(q, nu[:3] + jnp.cross(nu[3:], arm))
        return jnp.sqrt(jnp.sum((velocity - of_body) ** 2))

    speeds: jax.Array = jax.vmap(find_speed)(vehicles.p, vehicles.q, vehicles.nu, lever_m)
    return speeds


def close_grips(
    approach: ApproachSpec,
    grips: Grips,
    now: Grips,
    speed_mps: jax.Array,
    running: jax.Array,
    time_s: jax.Array,
) -> Grips:
    """Return grips after those closed that are at the body, as they are there.

    A gripper closes once; one that broke or opened stays so.

    Args:
        approach: settings.
        grips: of the robots [R] of one world, open ones where they are to hold the body.
        now: grips where the robots are.
        speed_mps: [R] of the grippers against the body.
        running: bool [R] whether a robot's episode goes on.
        time_s: [] at which they close.
    """
    if grips.closed_s is None:
        raise RuntimeError("grips of this world are closed from the start")
    offset = now.position_m - grips.position_m
    turned = jax.vmap(quaternion.multiply)(jax.vmap(quaternion.conjugate)(grips.q), now.q)
    angle = 2.0 * jnp.arctan2(jnp.sqrt(jnp.sum(turned[:, 1:] ** 2, axis=1)), jnp.abs(turned[:, 0]))
    near = jnp.sqrt(jnp.sum(offset * offset, axis=1)) < approach.within_m
    near &= (angle < approach.within_rad) & (speed_mps < approach.within_mps)
    closes = running & jnp.isinf(grips.closed_s) & near

    def take(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(closes.reshape(-1, *(1,) * (new.ndim - 1)), new, old)

    return replace(
        grips,
        held=grips.held | closes,
        position_m=take(now.position_m, grips.position_m),
        q=take(now.q, grips.q),
        center_m=take(now.center_m, grips.center_m),
        lever_m=take(now.lever_m, grips.lever_m),
        closed_s=jnp.where(closes, time_s, grips.closed_s),
    )


def record_grips(grips: Grips) -> GripRecord:
    """Return the record of the grips of one world."""
    return GripRecord(held=grips.held.astype(jnp.int32), wrench=grips.wrench)


def sample_sensors(noise: GripNoise, key: jax.Array, robots: int) -> GripSensors:
    """Return the force-torque sensors of one world.

    Args:
        noise: their errors.
        key: of the world.
        robots: number of robots.
    """
    keys = jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(robots))
    axes = jnp.ones(3)
    bias = jnp.concatenate([noise.force_bias_n * axes, noise.torque_bias_nm * axes])
    return GripSensors(
        key=jax.vmap(jax.random.key_data)(keys),
        bias=bias * jax.vmap(lambda one: jax.random.normal(one, (6,)))(keys),
        std=jnp.concatenate([noise.force_std_n * axes, noise.torque_std_nm * axes]),
    )


def read_grips(grips: Grips, sensors: GripSensors | None, number: jax.Array) -> GripReading:
    """Return what the robots [R] of one world measure of the body that they hold.

    Args:
        grips: of the robots.
        sensors: of the grips; None of such without errors.
        number: int32 [] control steps taken; a reading of a step is the same whoever takes it.
    """
    wrench = grips.wrench
    if sensors is not None:
        keys = jax.vmap(jax.random.fold_in, (0, None))(
            jax.vmap(jax.random.wrap_key_data)(sensors.key), number
        )
        noise = jax.vmap(lambda key: jax.random.normal(key, (6,), wrench.dtype))(keys)
        read = wrench + sensors.bias.astype(wrench.dtype) + sensors.std.astype(wrench.dtype) * noise
        wrench = jnp.where(jnp.any(wrench != 0.0, axis=1, keepdims=True), read, wrench)
    return GripReading(wrench=wrench, center_m=grips.center_m, lever_m=grips.lever_m)
