"""Build problems from sampled worlds."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.planning.problem import CargoProblem, Problem, ProblemSettings, Team, TeamArms
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles.fins import flies_by_fins
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim import information
from angler_mjx.sim.information import SceneObservation
from angler_mjx.sim.posture import bounding_radii, hull_capsules
from angler_mjx.sim.state import FleetWorld, SimSpec
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import BOX, bounding_radius

CLIMB_RAD = 0.4
"""Pitch at which vehicles that fly by their fins climb and dive in problems, as `los` does."""
_N_POWER_SPEEDS = 9
"""Speeds at which a robot's power is given, 0 among them."""


def build_problem(
    world: FleetWorld,
    seed: jax.Array,
    spec: SimSpec,
    settings: ProblemSettings,
    now: SceneObservation | None = None,
    yaw_rad: jax.Array | None = None,
    joint_position: jax.Array | None = None,
) -> Problem:
    """Build the problem of one world, at its start or during the flight; ``vmap`` it for a batch.

    Args:
        world: one sampled world; its path is not used.
        seed: uint32 [] of the planner's random draws.
        spec: of the simulation.
        settings: of the problem; its times are counted from ``now``.
        now: observation in flight, whose positions the robots start from; None at t = 0.
        yaw_rad: [R] headings at ``now``, rad.
        joint_position: [R, J] joints of arms at ``now``, rad or m; those at home if left out.
    """
    environment, water, levels = world.environment, spec.water, settings.information
    start_m, start_yaw_rad = environment.start_m, environment.start_yaw_rad
    cargo, environment = _take_cargo(spec, environment, now)
    at_m = begin_s = None
    if now is not None:
        at_m, begin_s = now.at_m, now.time_s
        start_m = at_m
    if yaw_rad is not None:
        start_yaw_rad = yaw_rad
    return Problem(
        grid=environment.grid,
        floor_z_m=environment.floor_z_m,
        team=build_team(world.control, start_m, start_yaw_rad, environment.goal_m, joint_position),
        obstacles=information.obstacle_information(
            environment,
            levels,
            settings.horizon_s,
            spec.control_dt_s,
            water.density_kgpm3,
            water.gravity_mps2,
            now,
        ),
        current=information.current_information(environment, levels.current, at_m, begin_s),
        seed=seed,
        cargo=cargo,
        **settings.static_fields(),
    )


def _take_cargo(
    spec: SimSpec, environment: Environment, now: SceneObservation | None
) -> tuple[CargoProblem | None, Environment]:
    """Return what the team carries, from where it is now, and the environment without it."""
    if spec.cargo is None:
        return None, environment
    body, rows = spec.cargo.body, environment.obstacles
    start_m, start_q, turn_rad = rows.p0[body], rows.q0[body], spec.cargo.turn_rad
    turned_rad = jnp.zeros((), start_m.dtype)
    if now is not None:
        start_m, start_q = now.obstacles.p[body], now.obstacles.q[body]
        turn = quaternion.multiply(start_q, quaternion.conjugate(rows.q0[body]))
        # Less than half a turn backwards, so that turns beyond half a turn are counted.
        least_rad = -0.5 * jnp.pi if turn_rad >= 0.0 else -1.5 * jnp.pi
        turned_rad = jnp.mod(quaternion.yaw(turn) - least_rad, 2.0 * jnp.pi) + least_rad
    kind, size = rows.kind[body], rows.size_m[body]
    # Along the longest edge of a box, as thick as its section's circumcircle.
    longest = jnp.arange(3) == jnp.argmax(size)
    axis = jnp.where(kind == BOX, jnp.where(longest, size, 0.0), jnp.zeros(3).at[2].set(size[1]))
    section = jnp.sqrt(jnp.sum(jnp.where(longest, 0.0, size) ** 2))
    cargo = CargoProblem(
        axis_m=quaternion.rotate(start_q, axis),
        thickness_m=jnp.where(kind == BOX, section, size[0]),
        start_m=start_m,
        goal_m=jnp.asarray(spec.cargo.goal_m, start_m.dtype),
        turn_rad=jnp.asarray(turn_rad, start_m.dtype) - turned_rad,
        radius_m=bounding_radius(kind, size),
    )
    if now is None and spec.cargo.approach is not None:
        approach, dtype = spec.cargo.approach, start_m.dtype
        cargo = replace(
            cargo,
            grip_m=environment.start_m.at[:, 2].add(-approach.above_m),
            wait_s=jnp.asarray(approach.wait_s, dtype),
            lift_m=jnp.asarray(approach.lift_m, dtype),
        )
    others = replace(rows, exists=rows.exists.at[body].set(False))
    return cargo, replace(environment, obstacles=others)


def build_team(
    control: ControlParams,
    start_m: jax.Array,
    start_yaw_rad: jax.Array,
    goal_m: jax.Array,
    joint_position: jax.Array | None = None,
) -> Team:
    """Build the robots of a problem, from their starts to their goals.

    Args:
        control: of the robots, [R] leading.
        start_m: [R, 3] m, W.
        start_yaw_rad: [R] rad.
        goal_m: [R, 3] m, W.
        joint_position: [R, J] joints of arms at the start, rad or m; hulls and radii are those of
            this posture. Arms are at home if left out.
    """
    vehicle = control.vehicle_model
    links, speed, radius_m = vehicle.links, vehicle.terminal_speed_mps, vehicle.radius_m
    posture = links.home if links is not None and joint_position is None else joint_position
    hulls = hull_capsules(vehicle, posture)
    if joint_position is not None:
        radius_m = bounding_radii(vehicle, hulls)
    a_m, b_m, r_m = hulls
    added = jnp.diagonal(vehicle.M_A, axis1=-2, axis2=-1)[..., :3]
    # At terminal speed damping takes all the force there is; from rest the mass does.
    force = (vehicle.D_l[..., :3] + vehicle.D_q[..., :3] * speed) * speed
    power_w = jax.vmap(_power_curves)(control)
    if vehicle.fins is not None:
        # With its bow up a vehicle climbs by the power of its way ahead.
        climbs = jax.vmap(flies_by_fins)(vehicle)
        speed = speed.at[..., 2].set(
            jnp.where(climbs, math.sin(CLIMB_RAD) * speed[..., 0], speed[..., 2])
        )
        power_w = power_w.at[..., 2, :].set(
            jnp.where(climbs[..., None], power_w[..., 0, :], power_w[..., 2, :])
        )
    return Team(
        start_m=start_m,
        start_yaw_rad=start_yaw_rad,
        goal_m=goal_m,
        radius_m=radius_m,
        capsule_a_m=a_m,
        capsule_b_m=b_m,
        capsule_r_m=r_m,
        cruise_speed_mps=control.cruise_speed_mps,
        terminal_speed_mps=speed,
        acceleration_mps2=force / (vehicle.mass_kg[..., None] + added),
        power_w=power_w,
        arms=_build_arms(vehicle, posture),
    )


def _build_arms(vehicle: VehicleParams, posture: jax.Array | None) -> TeamArms | None:
    """Return the links of robots [R] that start in postures [R, J]; None without links."""
    if vehicle.links is None or vehicle.link_capsules is None or posture is None:
        return None
    return TeamArms(links=vehicle.links, capsules=vehicle.link_capsules, joint_position=posture)


def _power_curves(control: ControlParams) -> jax.Array:
    """Return the power [3, n] of one robot, see `Team.power_w`."""
    vehicle = control.vehicle_model
    fractions = jnp.linspace(0.0, 1.0, _N_POWER_SPEEDS, dtype=vehicle.terminal_speed_mps.dtype)

    def power_at(axis: jax.Array, v: jax.Array) -> jax.Array:
        drag = jnp.eye(6, dtype=v.dtype)[axis] * (vehicle.D_l[axis] + vehicle.D_q[axis] * v) * v
        thrust = control.allocation.B_inverse @ drag
        rows = 0 if vehicle.thrust_n.ndim > 1 else None
        thruster_power_w = jax.vmap(jnp.interp, (0, rows, rows))(
            thrust, vehicle.thrust_n, vehicle.power_w
        )
        return jnp.sum(jnp.where(vehicle.thruster_exists, thruster_power_w, 0.0))

    speeds = vehicle.terminal_speed_mps[:, None] * fractions
    return jax.vmap(jax.vmap(power_at, in_axes=(None, 0)))(jnp.arange(3), speeds)
