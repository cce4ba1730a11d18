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

from angler_mjx.robot.control import navigation
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.navigation import NavigationParams
from angler_mjx.robot.sensing import suite
from angler_mjx.robot.sensing.params import SensorParams, louder
from angler_mjx.robot.sensing.readings import Truth
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import InstrumentedRobots, Senses, SimSpec, World
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
    if not spec.instrumented:
        return ()
    truth, keys, loud = _truth(world, vehicles), world.sensing_key, _loudness(world)
    return tuple(
        jax.vmap(_switched_on)(robots.params, *_of(robots, (keys, loud, truth)))
        if robots.source == "ekf"
        else None
        for robots in spec.instrumented
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
        memory: of each robots.
        number: int32 [] control steps taken.
        vehicles: now, [R] leading.
        flow: [R, 3] true current at the robots, in W, if a stage wants it.

    Returns:
        The memory, and what the controllers are to be told.
    """
    truth, after = _truth(world, vehicles), []
    belief = truth_told(vehicles, flow)
    for robots, senses in zip(spec.instrumented, memory, strict=True):
        key, loud, seen, there = _of(robots, (world.sensing_key, _loudness(world), truth, flow))
        if senses is None:
            known = jax.vmap(partial(_noisy, number=number))(robots.params, key, loud, seen, there)
        else:
            navigated = jax.vmap(partial(_navigated, number=number))
            senses, known = navigated(robots.params, key, loud, senses, seen, there)
        after.append(senses)
        belief = _with(robots, belief, known)
    return tuple(after), belief


def truth_told(vehicles: VehicleState, flow: jax.Array | None) -> Belief:
    """The truth in the form of what robots are told.

    Args:
        vehicles: now, [R] leading.
        flow: [R, 3] true current at the robots, in W, if anybody wants it.
    """
    zero = jnp.zeros_like(vehicles.p)
    return Belief(
        p=vehicles.p,
        q=vehicles.q,
        nu=vehicles.nu,
        flow=flow,
        position_std_m=zero,
        velocity_std_mps=zero,
        attitude_std_rad=zero,
    )


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


def _loudness(world: World) -> jax.Array | None:
    """[R] times the noise that the files say; None for just that."""
    return None if world.factors is None else world.factors.sensor_noise


def _heard(params: NavigationParams, loud: jax.Array | None) -> SensorParams:
    """The instruments of one robot as noisy as they are; its filter believes ``params``."""
    return params.sensors if loud is None else louder(params.sensors, loud)


def _of(robots: InstrumentedRobots, tree: Any) -> Any:
    """The rows of some robots of arrays [R, ...]."""
    return jax.tree.map(lambda leaf: leaf[robots.first : robots.first + robots.count], tree)


def _with(robots: InstrumentedRobots, whole: Belief, part: Belief) -> Belief:
    """A belief [R] with that of some robots put in its place."""
    if robots.count == whole.p.shape[0]:
        return part
    rows = slice(robots.first, robots.first + robots.count)
    put: Belief = jax.tree.map(lambda old, new: old.at[rows].set(new), whole, part)
    return put


def _switched_on(
    params: NavigationParams, key: jax.Array, loud: jax.Array | None, truth: Truth
) -> Senses:
    """Instruments and filter of one robot, which begins off the truth by as much as it says."""
    wrapped = jax.random.wrap_key_data(key)
    estimate = Estimate(p=truth.p, q=truth.q, nu=truth.nu)
    return Senses(
        instruments=suite.reset(_heard(params, loud), wrapped, truth),
        filter=navigation.reset(params, estimate, jax.random.fold_in(wrapped, OF_FILTER)),
    )


def _navigated(
    params: NavigationParams,
    key: jax.Array,
    loud: jax.Array | None,
    senses: Senses,
    truth: Truth,
    flow: jax.Array | None,
    *,
    number: jax.Array,
) -> tuple[Senses, Belief]:
    """Instruments and filter of one robot. No instrument shows the current: still water."""
    wrapped = jax.random.wrap_key_data(key)
    heard = _heard(params, loud)
    instruments, reading = suite.step(heard, senses.instruments, wrapped, number, truth)
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
    loud: jax.Array | None,
    truth: Truth,
    flow: jax.Array | None,
    *,
    number: jax.Array,
) -> Belief:
    """The true state of one robot with white noise."""
    wrapped, noise = jax.random.wrap_key_data(key), params.sensors.truth
    heard = _heard(params, loud)
    told = suite.disturb(heard, wrapped, number, truth)
    if flow is not None:
        flow = suite.disturb_current(heard, wrapped, number, flow)
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
