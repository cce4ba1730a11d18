"""Problems out of drawn worlds."""

import jax
import jax.numpy as jnp

from angler_mjx.planning.problem import Problem, Team
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.sim import information
from angler_mjx.sim.information import Information, SceneObservation
from angler_mjx.sim.state import SimSpec, World

_POWERS = 9
"""Speeds of which a robot's power is told, that of lying still among them."""


def build_problems(
    world: World,
    seed: jax.Array,
    spec: SimSpec,
    knows: Information,
    horizon_s: float,
    deadline_s: float,
) -> Problem:
    """What a planner is asked in one world; ``vmap`` it for a batch.

    Args:
        world: drawn; its path is not looked at.
        seed: uint32 [] for what the planner draws.
        spec: of the simulation.
        knows: what may be known.
        horizon_s: nothing is flown after it.
        deadline_s: wall-clock time for the problem.
    """
    place = world.environment
    begun = team(world.control, place.start_m, place.start_yaw_rad, place.goal_m)
    return _build_problem(world, begun, seed, spec, knows, horizon_s, deadline_s, None)


def build_problem_now(
    world: World,
    seed: jax.Array,
    spec: SimSpec,
    knows: Information,
    horizon_s: float,
    deadline_s: float,
    now: SceneObservation,
    yaw_rad: jax.Array,
) -> Problem:
    """As `build_problems`, at a time of the flight; the problem's time is counted from it.

    Args:
        world: drawn; its path is not looked at.
        seed: uint32 [] for what the planner draws.
        spec: of the simulation.
        knows: what may be known.
        horizon_s: nothing is flown so long after it.
        deadline_s: wall-clock time for the problem.
        now: what is observed; robots start where they are then.
        yaw_rad: [R] their headings.
    """
    begun = team(world.control, now.at_m, yaw_rad, world.environment.goal_m)
    return _build_problem(world, begun, seed, spec, knows, horizon_s, deadline_s, now)


def _build_problem(
    world: World,
    begun: Team,
    seed: jax.Array,
    spec: SimSpec,
    knows: Information,
    horizon_s: float,
    deadline_s: float,
    now: SceneObservation | None,
) -> Problem:
    environment, water = world.environment, spec.water
    at_m, begin_s = (None, None) if now is None else (now.at_m, now.time_s)
    return Problem(
        grid=environment.grid,
        floor_z_m=environment.floor_z_m,
        team=begun,
        obstacles=information.obstacles(
            environment,
            knows,
            horizon_s,
            spec.control_dt_s,
            water.density_kgpm3,
            water.gravity_mps2,
            now,
        ),
        current=information.current(environment, knows.current, at_m, begin_s),
        seed=seed,
        horizon_s=horizon_s,
        goal_tolerance_m=spec.goal_tolerance_m,
        knows=knows,
        deadline_s=deadline_s,
    )


def team(
    control: ControlParams, start_m: jax.Array, start_yaw_rad: jax.Array, goal_m: jax.Array
) -> Team:
    """The robots of a problem, from where they are to where they go.

    Args:
        control: of the robots, [R] leading.
        start_m: [R, 3].
        start_yaw_rad: [R].
        goal_m: [R, 3].
    """
    vehicle = control.known
    speed = vehicle.terminal_speed_mps
    added = jnp.diagonal(vehicle.M_A, axis1=-2, axis2=-1)[..., :3]
    # At terminal speed damping takes all the force there is; from rest the mass does.
    force = (vehicle.D_l[..., :3] + vehicle.D_q[..., :3] * speed) * speed
    return Team(
        start_m=start_m,
        start_yaw_rad=start_yaw_rad,
        goal_m=goal_m,
        radius_m=vehicle.radius_m,
        capsule_a_m=vehicle.capsule_a_m,
        capsule_b_m=vehicle.capsule_b_m,
        capsule_r_m=vehicle.capsule_r_m,
        cruise_speed_mps=control.cruise_speed_mps,
        terminal_speed_mps=speed,
        acceleration_mps2=force / (vehicle.mass_kg[..., None] + added),
        power_w=jax.vmap(_powers)(control),
    )


def _powers(control: ControlParams) -> jax.Array:
    """Power [3, n] of one robot, see `Team.power_w`."""
    vehicle = control.known
    share = jnp.linspace(0.0, 1.0, _POWERS, dtype=vehicle.terminal_speed_mps.dtype)

    def at(axis: jax.Array, v: jax.Array) -> jax.Array:
        drag = jnp.eye(6, dtype=v.dtype)[axis] * (vehicle.D_l[axis] + vehicle.D_q[axis] * v) * v
        thrust = control.allocation.B_inverse @ drag
        each = jax.vmap(lambda f: jnp.interp(f, vehicle.thrust_n, vehicle.power_w))(thrust)
        return jnp.sum(jnp.where(vehicle.thruster_exists, each, 0.0))

    speeds = vehicle.terminal_speed_mps[:, None] * share
    return jax.vmap(jax.vmap(at, in_axes=(None, 0)))(jnp.arange(3), speeds)
