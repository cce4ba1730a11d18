"""An episode of one world: reset, one control step, one segment. Pure; the batch is a ``vmap``.

Robots whose episode is over stay where they are: failed ones stand still as obstacles, arrived ones
keep station under their own control. Both are still seen by the others.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.control import stack
from angler_mjx.control.stack import Command
from angler_mjx.physics import step as physics
from angler_mjx.physics.step import Multibody, VehicleState
from angler_mjx.sim import robot, senses
from angler_mjx.sim.detection import detect
from angler_mjx.sim.state import Belief, Sample, SimSpec, Tally, World, WorldState
from angler_mjx.world import currents
from angler_mjx.world import obstacles as obstacle_motion
from angler_mjx.world.environment import Environment


def reset(spec: SimSpec, engine: Multibody, bodies: Any, world: World) -> WorldState:
    """One world at t = 0: robots at rest at their starts, obstacles in place.

    Args:
        spec: settings.
        engine: of the fleet.
        bodies: the robots as the engine wants them, [R] leading.
        world: constants of the world.
    """
    environment, water = world.environment, spec.water
    attitude = jax.vmap(quaternion.from_yaw)(environment.start_yaw_rad)
    vehicles = jax.vmap(physics.reset, (None, 0, 0, 0, 0, None, None))(
        engine,
        bodies,
        world.control.vehicle,
        environment.start_m,
        attitude,
        environment.current,
        water,
    )
    moving = obstacle_motion.reset(
        environment.obstacles, environment.current, water.density_kgpm3, water.gravity_mps2
    )
    contact = detect(environment, world.control.vehicle, vehicles, moving)
    n, dtype = environment.start_m.shape[0], environment.start_m.dtype
    return WorldState(
        vehicles=vehicles,
        carry=jax.vmap(partial(robot.begin, spec))(vehicles, environment.start_yaw_rad),
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
        senses=senses.reset(spec, world, vehicles),
    )


def control_step(
    spec: SimSpec,
    engine: Multibody,
    world: World,
    state: WorldState,
    command: Command | None = None,
) -> tuple[WorldState, Sample]:
    """One control step of one world.

    Args:
        spec: settings.
        engine: of the fleet.
        world: constants of the world.
        state: of the world.
        command: to the controllers instead of the paths, [R] leading.

    Returns:
        The state one control period later, and the sample of the state before with its command.
    """
    environment, fleet = world.environment, world.control
    lo, hi = region(environment)
    before = state.vehicles
    t = state.step.astype(before.p.dtype) * spec.control_dt_s
    flow = jax.vmap(currents.velocity, (None, 0, None))(environment.current, before.p, t)
    told = flow if stack.wants_flow(spec.stages) else None
    known: VehicleState | Belief = before
    sensed, belief = state.senses, None
    if spec.crews:
        with jax.named_scope("sensing"):
            sensed, belief = senses.step(spec, world, sensed, state.step, before, told)
        known, told = belief, belief.flow
    with jax.named_scope("control"):
        carry, target, pwm = jax.vmap(partial(robot.decide, spec))(
            fleet,
            state.carry,
            known,
            world.path if command is None else command,
            told,
        )
    settled, power = jax.vmap(robot.thrust_and_power)(fleet.vehicle, pwm)
    vehicles = _advance_vehicles(spec, engine, world, before, settled, t)
    with jax.named_scope("obstacles"):
        moving = obstacle_motion.step(
            environment.obstacles,
            state.obstacles,
            environment.current,
            t,
            spec.control_dt_s,
            lo,
            hi,
            environment.grid,
            spec.water.density_kgpm3,
            spec.water.gravity_mps2,
        )
    vehicles, broken = jax.vmap(robot.hold_if_ended)(state.tally.outcome, before, vehicles)
    with jax.named_scope("detection"):
        contact = detect(environment, fleet.vehicle, vehicles, moving)
    tally = jax.vmap(partial(robot.account, spec), (0, None, None, 0, 0, 0, 0, 0, 0, None))(
        environment.goal_m, lo, hi, state.tally, before.p, vehicles.p, contact, power, broken, t
    )
    sample = Sample(
        p=before.p,
        q=before.q,
        nu=before.nu,
        pwm_us=pwm.pwm_us,
        target_m=target,
        current_mps=flow,
        outcome=state.tally.outcome,
        obstacle_p=state.obstacles.p,
        obstacle_q=state.obstacles.q,
        belief=belief,
    )
    after = WorldState(
        vehicles=vehicles,
        carry=carry,
        obstacles=moving,
        tally=tally,
        step=state.step + 1,
        senses=sensed,
    )
    return after, sample


def segment(
    spec: SimSpec,
    engine: Multibody,
    world: World,
    state: WorldState,
    n_sample: int,
    steps_per_sample: int,
    command: Command | None = None,
) -> tuple[WorldState, Sample]:
    """``n_sample * steps_per_sample`` control steps of one world, all with one command.

    Returns:
        The state at the end, and samples with a leading axis [n_sample].
    """
    # One control step stands in the program, not one for recorded and one for other steps: it is
    # most of what there is to compile.
    shapes = jax.eval_shape(lambda s: control_step(spec, engine, world, s, command)[1], state)
    nothing: Sample = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

    def one(carry: tuple[WorldState, Sample], i: jax.Array) -> tuple[Any, None]:
        state, kept = carry
        state, sample = control_step(spec, engine, world, state, command)
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


def _advance_vehicles(
    spec: SimSpec,
    engine: Multibody,
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
            world.control.vehicle,
            state,
            command,
            world.environment.current,
            now,
            dt,
            spec.water,
        )
        return state, None

    return jax.lax.scan(one, state, jnp.arange(spec.physics_steps))[0]
