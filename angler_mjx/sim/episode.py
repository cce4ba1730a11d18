"""An episode of one world: reset, one control step, one segment. Pure; the batch is a ``vmap``.

Robots whose episode is over stay where they are: failed ones stand still as obstacles, arrived ones
keep station under their own control. Both are still seen by the others.
"""

from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels import quaternion, thruster
from angler_mjx.control import cascade
from angler_mjx.control.commands import Estimate, ThrusterPwm
from angler_mjx.physics import step as physics
from angler_mjx.physics.mjx_engine import MjxEngine
from angler_mjx.physics.step import VehicleState
from angler_mjx.sim.detection import Contact, detect
from angler_mjx.sim.state import (
    Outcome,
    Sample,
    SimSpec,
    Tally,
    Touched,
    World,
    WorldState,
)
from angler_mjx.vehicles.thrusters import PWM_LOW_US, PWM_STEP_US
from angler_mjx.world import currents
from angler_mjx.world import obstacles as obstacle_motion
from angler_mjx.world.environment import Environment

SPEED_OF_NONSENSE_MPS = 50.0
"""A robot faster than this has diverged: ten times what any of them can reach."""


def reset(spec: SimSpec, engine: MjxEngine, world: World) -> WorldState:
    """One world at t = 0: robots at rest at their starts, obstacles in place."""
    environment, water = world.environment, spec.water
    attitude = jax.vmap(quaternion.from_yaw)(environment.start_yaw_rad)
    vehicles = jax.vmap(physics.reset, (None, 0, 0, 0, 0, None, None))(
        engine,
        world.body,
        world.cascade.vehicle,
        environment.start_m,
        attitude,
        environment.current,
        water,
    )
    moving = obstacle_motion.reset(
        environment.obstacles, environment.current, water.density_kgpm3, water.gravity_mps2
    )
    contact = detect(environment, world.cascade.vehicle, vehicles, moving)
    n, dtype = environment.start_m.shape[0], environment.start_m.dtype
    return WorldState(
        vehicles=vehicles,
        carry=jax.vmap(cascade.reset)(environment.start_yaw_rad),
        obstacles=moving,
        tally=Tally(
            outcome=jnp.zeros(n, jnp.int32),
            end_time_s=jnp.zeros(n, dtype),
            path_length_m=jnp.zeros(n, dtype),
            energy_j=jnp.zeros(n, dtype),
            min_clearance_m=contact.clearance_m,
            min_separation_m=contact.separation_m,
            touched=jnp.zeros(n, jnp.int32),
            touched_index=jnp.full(n, -1, jnp.int32),
            impact_speed_mps=jnp.full(n, jnp.nan, dtype),
        ),
        step=jnp.zeros((), jnp.int32),
    )


def control_step(
    spec: SimSpec,
    engine: MjxEngine,
    world: World,
    state: WorldState,
    command: ThrusterPwm | None = None,
) -> tuple[WorldState, Sample]:
    """One control step of one world.

    Args:
        spec: settings.
        engine: of the fleet.
        world: constants of the world.
        state: of the world.
        command: signals [R, n_thruster] to send instead of the cascade's.

    Returns:
        The state one control period later, and the sample of the state before with its command.
    """
    environment, fleet = world.environment, world.cascade
    before = state.vehicles
    t = state.step.astype(before.p.dtype) * spec.control_dt_s
    with jax.named_scope("control"):
        carry, target, pwm = jax.vmap(
            lambda params, memory, at, path: cascade.step(
                spec.gains,
                params,
                memory,
                Estimate(p=at.p, q=at.q, nu=at.nu),
                path,
                spec.control_dt_s,
                spec.water.density_kgpm3,
                spec.water.gravity_mps2,
            )
        )(fleet, state.carry, before, world.path)
        if command is not None:
            pwm = command
    settled, power = jax.vmap(_thrust_and_power)(fleet, pwm.pwm_us)
    vehicles = _advance_vehicles(spec, engine, world, before, settled, t)
    with jax.named_scope("obstacles"):
        moving = obstacle_motion.step(
            environment.obstacles,
            state.obstacles,
            environment.current,
            t,
            spec.control_dt_s,
            *region(environment),
            environment.grid,
            spec.water.density_kgpm3,
            spec.water.gravity_mps2,
        )
    vehicles, broken = _stop_ended(state.tally, before, vehicles)
    with jax.named_scope("detection"):
        contact = detect(environment, fleet.vehicle, vehicles, moving)
    tally = _keep_tally(spec, world, state.tally, before, vehicles, contact, power, broken, t)
    sample = Sample(
        p=before.p,
        q=before.q,
        nu=before.nu,
        pwm_us=pwm.pwm_us,
        target_m=target.position_m,
        current_mps=jax.vmap(currents.velocity, (None, 0, None))(environment.current, before.p, t),
        outcome=state.tally.outcome,
        obstacle_p=state.obstacles.p,
        obstacle_q=state.obstacles.q,
    )
    after = WorldState(
        vehicles=vehicles, carry=carry, obstacles=moving, tally=tally, step=state.step + 1
    )
    return after, sample


def segment(
    spec: SimSpec,
    engine: MjxEngine,
    world: World,
    state: WorldState,
    n_sample: int,
    steps_per_sample: int,
) -> tuple[WorldState, Sample]:
    """``n_sample * steps_per_sample`` control steps of one world.

    Returns:
        The state at the end, and samples with a leading axis [n_sample].
    """
    # One control step stands in the program, not one for recorded and one for other steps: it is
    # most of what there is to compile.
    shapes = jax.eval_shape(lambda s: control_step(spec, engine, world, s)[1], state)
    nothing: Sample = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

    def one(carry: tuple[WorldState, Sample], i: jax.Array) -> tuple[Any, None]:
        state, kept = carry
        state, sample = control_step(spec, engine, world, state)
        kept = jax.tree.map(lambda new, old: jnp.where(i == 0, new, old), sample, kept)
        return (state, kept), None

    def recorded(state: WorldState, _: None) -> tuple[WorldState, Sample]:
        return jax.lax.scan(one, (state, nothing), jnp.arange(steps_per_sample))[0]

    return jax.lax.scan(recorded, state, length=n_sample)


def region(environment: Environment) -> tuple[jax.Array, jax.Array]:
    """Lower and upper corner [3] of the cube that fleets work in, m, in W."""
    grid = environment.grid
    size = jnp.array(grid.occupied.shape, grid.origin_m.dtype) * grid.cell_m
    return grid.origin_m, grid.origin_m + size


def _thrust_and_power(
    params: cascade.CascadeParams, pwm_us: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Thrust [n_thruster] N that a signal settles at, and the power [] W of all thrusters."""
    vehicle = params.vehicle
    pick = jax.vmap(thruster.lookup, (None, 0, None, None))
    thrust = pick(vehicle.thrust_n, pwm_us, PWM_LOW_US, PWM_STEP_US)
    power = pick(vehicle.power_w, pwm_us, PWM_LOW_US, PWM_STEP_US)
    return thrust, jnp.sum(jnp.where(vehicle.thruster_exists, power, 0.0))


def _advance_vehicles(
    spec: SimSpec,
    engine: MjxEngine,
    world: World,
    state: VehicleState,
    command: jax.Array,
    t: jax.Array,
) -> VehicleState:
    """The physics steps of one control step, for every robot."""
    dt = spec.physics_dt_s

    def one(state: VehicleState, i: jax.Array) -> tuple[VehicleState, None]:
        now = t + i.astype(t.dtype) * dt
        state = jax.vmap(physics.step, (None, 0, 0, 0, 0, None, None, None, None))(
            engine,
            world.body,
            world.cascade.vehicle,
            state,
            command,
            world.environment.current,
            now,
            dt,
            spec.water,
        )
        return state, None

    return jax.lax.scan(one, state, jnp.arange(spec.physics_steps))[0]


def _stop_ended(
    tally: Tally, before: VehicleState, after: VehicleState
) -> tuple[VehicleState, jax.Array]:
    """Hold robots that failed or just diverged where they were, at rest.

    Returns:
        The state to go on with, and bool [R] which robots diverged in this step.
    """
    speed = jnp.sum(jnp.abs(after.nu), axis=1)
    sound = jnp.isfinite(speed) & jnp.all(jnp.isfinite(after.p), axis=1)
    sound &= jnp.all(jnp.isfinite(after.q), axis=1) & (speed < SPEED_OF_NONSENSE_MPS)
    alive = (tally.outcome == Outcome.RUNNING) | (tally.outcome == Outcome.REACHED)
    goes_on = (alive & sound)[:, None]
    still = jnp.zeros_like(after.nu)
    held = VehicleState(
        p=jnp.where(goes_on, after.p, before.p),
        q=jnp.where(goes_on, after.q, before.q),
        nu=jnp.where(goes_on, after.nu, still),
        force_before=jnp.where(goes_on, after.force_before, still),
        thrust=jnp.where(goes_on, after.thrust, 0.0),
    )
    return held, alive & ~sound


def _keep_tally(
    spec: SimSpec,
    world: World,
    tally: Tally,
    before: VehicleState,
    after: VehicleState,
    contact: Contact,
    power: jax.Array,
    broken: jax.Array,
    t: jax.Array,
) -> Tally:
    """Account for one control step of every robot that is still on its way."""
    running = tally.outcome == Outcome.RUNNING
    outcome = _judge(spec, world, after, contact, broken)
    outcome = jnp.where(running, outcome, tally.outcome)
    ended = running & (outcome != Outcome.RUNNING)
    hit = ended & jnp.isin(outcome, jnp.array(COLLISIONS))
    dt = spec.control_dt_s
    moved = jnp.sqrt(jnp.sum((after.p - before.p) ** 2, axis=1))
    return Tally(
        outcome=outcome,
        end_time_s=jnp.where(running, t + dt, tally.end_time_s),
        path_length_m=tally.path_length_m + jnp.where(running, moved, 0.0),
        energy_j=tally.energy_j + jnp.where(running, power * dt, 0.0),
        min_clearance_m=jnp.where(
            running, jnp.minimum(tally.min_clearance_m, contact.clearance_m), tally.min_clearance_m
        ),
        min_separation_m=jnp.where(
            running,
            jnp.minimum(tally.min_separation_m, contact.separation_m),
            tally.min_separation_m,
        ),
        touched=jnp.where(hit, contact.nearest, tally.touched),
        touched_index=jnp.where(hit, contact.nearest_index, tally.touched_index),
        impact_speed_mps=jnp.where(hit, contact.closing_speed_mps, tally.impact_speed_mps),
    )


COLLISIONS = (Outcome.COLLISION_STATIC, Outcome.COLLISION_DYNAMIC, Outcome.COLLISION_ROBOT)


def _judge(
    spec: SimSpec, world: World, state: VehicleState, contact: Contact, broken: jax.Array
) -> jax.Array:
    """int32 [R]: what the state means for a robot that is still on its way."""
    environment = world.environment
    lo, hi = region(environment)
    outside = jnp.any((state.p < lo) | (state.p > hi), axis=1)
    to_goal = jnp.sqrt(jnp.sum((state.p - environment.goal_m) ** 2, axis=1))
    touching = jnp.minimum(contact.clearance_m, contact.separation_m) <= 0.0
    collision = jnp.where(
        contact.nearest == Touched.ROBOT,
        Outcome.COLLISION_ROBOT,
        jnp.where(contact.nearest_is_static, Outcome.COLLISION_STATIC, Outcome.COLLISION_DYNAMIC),
    )
    outcome = jnp.where(to_goal < spec.goal_tolerance_m, Outcome.REACHED, Outcome.RUNNING)
    outcome = jnp.where(outside, Outcome.OUT_OF_BOUNDS, outcome)
    outcome = jnp.where(touching, collision, outcome)
    return jnp.where(broken, Outcome.DIVERGED, outcome).astype(jnp.int32)
