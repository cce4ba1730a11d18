"""What robots know of their own motion: the truth, the truth with noise, or a filter's estimate.

A part of a control step, before the controllers: instruments read the truth, filters take the
readings in, and the controllers are told a `Belief` instead of the state. Everything else in a
simulation goes by the truth. Plain arrays with robots leading, in every engine: a filter is matrix
arithmetic, which lanes have nothing to offer for. A fleet that is told the truth has none of this.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_mjx.control import navigation, stack
from angler_mjx.control.commands import Estimate
from angler_mjx.control.navigation import NavigationParams
from angler_mjx.physics.step import VehicleState
from angler_mjx.sensing import suite
from angler_mjx.sensing.readings import Truth
from angler_mjx.sim.state import Belief, Crew, Senses, SimSpec, World
from angler_mjx.world import currents
from angler_mjx.world.grid import height_above_bottom

OF_FILTER = 2**32 - 1
"""What a robot's key is folded with for the beginning of its filter; no step has this number."""


def reset(spec: SimSpec, world: World, vehicles: VehicleState) -> tuple[Senses | None, ...]:
    """Switch the instruments of one world's robots on.

    Args:
        spec: settings.
        world: constants of the world.
        vehicles: at the first step, [R] leading.
    """
    if not spec.crews:
        return ()
    truth, keys = _truth(world, vehicles), world.sensing_key
    return tuple(
        jax.vmap(_switched_on)(crew.params, *_of(crew, (keys, truth)))
        if crew.source == "ekf"
        else None
        for crew in spec.crews
    )


def step(
    spec: SimSpec,
    world: World,
    memory: tuple[Senses | None, ...],
    number: jax.Array,
    vehicles: VehicleState,
    flow: jax.Array | None,
) -> tuple[tuple[Senses | None, ...], Belief]:
    """One control step of one world.

    Args:
        spec: settings.
        world: constants of the world.
        memory: of each crew.
        number: int32 [] control steps taken.
        vehicles: now, [R] leading.
        flow: [R, 3] true current at the robots, in W, if a stage wants it.

    Returns:
        The memory, and what the controllers are to be told.
    """
    truth, after = _truth(world, vehicles), []
    zero = jnp.zeros_like(vehicles.p)
    belief = Belief(
        p=vehicles.p,
        q=vehicles.q,
        nu=vehicles.nu,
        flow=flow,
        position_std_m=zero,
        velocity_std_mps=zero,
        attitude_std_rad=zero,
    )
    for crew, senses in zip(spec.crews, memory, strict=True):
        key, seen, there = _of(crew, (world.sensing_key, truth, flow))
        if senses is None:
            known = jax.vmap(partial(_noisy, number=number))(crew.params, key, seen, there)
        else:
            navigated = jax.vmap(partial(_navigated, number=number))
            senses, known = navigated(crew.params, key, senses, seen, there)
        after.append(senses)
        belief = _with(crew, belief, known)
    return tuple(after), belief


def step_tile(
    spec: SimSpec,
    worlds: World,
    memory: tuple[Senses | None, ...],
    number: jax.Array,
    vehicles: VehicleState,
) -> tuple[tuple[Senses | None, ...], Belief]:
    """As `step` for worlds [W], all at step ``number`` []; the current is looked up here."""
    t = number.astype(vehicles.p.dtype) * spec.control_dt_s

    def one(world: World, memory: Any, vehicles: VehicleState) -> Any:
        flow = None
        if stack.wants_flow(spec.stages):
            current = world.environment.current
            flow = jax.vmap(currents.velocity, (None, 0, None))(current, vehicles.p, t)
        return step(spec, world, memory, number, vehicles, flow)

    after: tuple[Any, Belief] = jax.vmap(one)(worlds, memory, vehicles)
    return after


def _truth(world: World, vehicles: VehicleState) -> Truth:
    """What instruments are exposed to, [R] leading. Obstacles are no bottom."""
    environment = world.environment
    bottom = jax.vmap(height_above_bottom, (None, None, 0))
    return Truth(
        p=vehicles.p,
        q=vehicles.q,
        nu=vehicles.nu,
        altitude_m=bottom(environment.grid, environment.floor_z_m, vehicles.p),
    )


def _of(crew: Crew, tree: Any) -> Any:
    """The robots of a crew of arrays [R, ...]."""
    return jax.tree.map(lambda leaf: leaf[crew.first : crew.first + crew.count], tree)


def _with(crew: Crew, whole: Belief, part: Belief) -> Belief:
    """A belief [R] with that of a crew put in its place."""
    if crew.count == whole.p.shape[0]:
        return part
    rows = slice(crew.first, crew.first + crew.count)
    put: Belief = jax.tree.map(lambda old, new: old.at[rows].set(new), whole, part)
    return put


def _switched_on(params: NavigationParams, key: jax.Array, truth: Truth) -> Senses:
    """Instruments and filter of one robot, which begins off the truth by as much as it says."""
    wrapped = jax.random.wrap_key_data(key)
    estimate = Estimate(p=truth.p, q=truth.q, nu=truth.nu)
    return Senses(
        instruments=suite.reset(params.sensors, wrapped, truth),
        filter=navigation.reset(params, estimate, jax.random.fold_in(wrapped, OF_FILTER)),
    )


def _navigated(
    params: NavigationParams,
    key: jax.Array,
    senses: Senses,
    truth: Truth,
    flow: jax.Array | None,
    *,
    number: jax.Array,
) -> tuple[Senses, Belief]:
    """Instruments and filter of one robot. No instrument shows the current: still water."""
    wrapped = jax.random.wrap_key_data(key)
    instruments, reading = suite.step(params.sensors, senses.instruments, wrapped, number, truth)
    carry, out = navigation.step(params, senses.filter, reading)
    estimate = out.estimate
    return Senses(instruments=instruments, filter=carry), Belief(
        p=estimate.p,
        q=estimate.q,
        nu=estimate.nu,
        flow=None if flow is None else jnp.zeros_like(flow),
        position_std_m=out.std[:3],
        velocity_std_mps=out.std[3:6],
        attitude_std_rad=out.std[6:9],
    )


def _noisy(
    params: NavigationParams,
    key: jax.Array,
    truth: Truth,
    flow: jax.Array | None,
    *,
    number: jax.Array,
) -> Belief:
    """The true state of one robot with white noise."""
    wrapped, noise = jax.random.wrap_key_data(key), params.sensors.truth
    told = suite.disturb(params.sensors, wrapped, number, truth)
    if flow is not None:
        flow = suite.disturb_current(params.sensors, wrapped, number, flow)
    stds = (noise.position_std_m, noise.velocity_std_mps, noise.attitude_std_rad)
    position, velocity, attitude = (jnp.broadcast_to(std, (3,)) for std in stds)
    return Belief(
        p=told.p,
        q=told.q,
        nu=told.nu,
        flow=flow,
        position_std_m=position,
        velocity_std_mps=velocity,
        attitude_std_rad=attitude,
    )
