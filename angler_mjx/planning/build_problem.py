"""Problems out of drawn worlds."""

import jax
import jax.numpy as jnp

from angler_mjx.planning.problem import Problem, Team
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.sim import information
from angler_mjx.sim.information import Information, SceneObservation
from angler_mjx.sim.state import SimSpec, World

_N_POWER_SPEEDS = 9
"""Speeds of which a robot's power is told, that of lying still among them."""


def build_problems(
    world: World,
    seed: jax.Array,
    spec: SimSpec,
    information: Information,
    horizon_s: float,
    deadline_s: float,
) -> Problem:
    """What a planner is asked in one world; ``vmap`` it for a batch.

    Args:
        world: drawn; its path is not looked at.
        seed: uint32 [] for what the planner draws.
        spec: of the simulation.
        information: what may be known.
        horizon_s: nothing is flown after it.
        deadline_s: wall-clock time for the problem.
    """
    environment = world.environment
    team_state = build_team(
        world.control, environment.start_m, environment.start_yaw_rad, environment.goal_m
    )
    return _build_problem(world, team_state, seed, spec, information, horizon_s, deadline_s, None)


def build_problem_now(
    world: World,
    seed: jax.Array,
    spec: SimSpec,
    information_level: Information,
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
        information_level: what may be known.
        horizon_s: nothing is flown so long after it.
        deadline_s: wall-clock time for the problem.
        now: what is observed; robots start where they are then.
        yaw_rad: [R] their headings.
    """
    team_state = build_team(world.control, now.at_m, yaw_rad, world.environment.goal_m)
    return _build_problem(
        world, team_state, seed, spec, information_level, horizon_s, deadline_s, now
    )


def _build_problem(
    world: World,
    team_state: Team,
    seed: jax.Array,
    spec: SimSpec,
    information_level: Information,
    horizon_s: float,
    deadline_s: float,
    observation: SceneObservation | None,
) -> Problem:
    environment, water = world.environment, spec.water
    at_m, begin_s = (None, None) if observation is None else (observation.at_m, observation.time_s)
    return Problem(
        grid=environment.grid,
        floor_z_m=environment.floor_z_m,
        team=team_state,
        obstacles=information.obstacle_information(
            environment,
            information_level,
            horizon_s,
            spec.control_dt_s,
            water.density_kgpm3,
            water.gravity_mps2,
            observation,
        ),
        current=information.current_information(
            environment, information_level.current, at_m, begin_s
        ),
        seed=seed,
        horizon_s=horizon_s,
        goal_tolerance_m=spec.goal_tolerance_m,
        information=information_level,
        deadline_s=deadline_s,
    )


def build_team(
    control: ControlParams, start_m: jax.Array, start_yaw_rad: jax.Array, goal_m: jax.Array
) -> Team:
    """The robots of a problem, from where they are to where they go.

    Args:
        control: of the robots, [R] leading.
        start_m: [R, 3].
        start_yaw_rad: [R].
        goal_m: [R, 3].
    """
    vehicle = control.vehicle_model
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
        power_w=jax.vmap(_power_curves)(control),
    )


def _power_curves(control: ControlParams) -> jax.Array:
    """Power [3, n] of one robot, see `Team.power_w`."""
    vehicle = control.vehicle_model
    fractions = jnp.linspace(0.0, 1.0, _N_POWER_SPEEDS, dtype=vehicle.terminal_speed_mps.dtype)

    def power_at(axis: jax.Array, v: jax.Array) -> jax.Array:
        drag = jnp.eye(6, dtype=v.dtype)[axis] * (vehicle.D_l[axis] + vehicle.D_q[axis] * v) * v
        thrust = control.allocation.B_inverse @ drag
        thruster_power_w = jax.vmap(lambda f: jnp.interp(f, vehicle.thrust_n, vehicle.power_w))(
            thrust
        )
        return jnp.sum(jnp.where(vehicle.thruster_exists, thruster_power_w, 0.0))

    speeds = vehicle.terminal_speed_mps[:, None] * fractions
    return jax.vmap(jax.vmap(power_at, in_axes=(None, 0)))(jnp.arange(3), speeds)
