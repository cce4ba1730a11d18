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
from angler_mjx.robot.sensing.params import SensorParams, scale_noise
from angler_mjx.robot.sensing.readings import Truth
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import InstrumentedRobots, SensingMemory, SimSpec, World
from angler_mjx.world.rock.grid import height_above_bottom

FILTER_STEP = 2**32 - 1
"""What a robot's key is folded with for the beginning of its filter; no step has this number."""


def reset(spec: SimSpec, world: World, vehicles: VehicleState) -> tuple[SensingMemory | None, ...]:
    """Switch the instruments of one world's robots on.

    Args:
        spec: settings.
        world: constants of the world.
        vehicles: at the first step, [R] leading.
    """
    if not spec.instrumented:
        return ()
    truth, keys, noise_factor = (
        _measured_truth(world, vehicles),
        world.sensing_key,
        _noise_factor(world),
    )
    return tuple(
        jax.vmap(_switch_on)(robots.params, *_select_robots(robots, (keys, noise_factor, truth)))
        if robots.source == "ekf"
        else None
        for robots in spec.instrumented
    )


def step(
    spec: SimSpec,
    world: World,
    memory: tuple[SensingMemory | None, ...],
    number: jax.Array,
    vehicles: VehicleState,
    flow: jax.Array | None,
) -> tuple[tuple[SensingMemory | None, ...], Belief]:
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
    truth, after = _measured_truth(world, vehicles), []
    belief = truth_belief(vehicles, flow)
    for robots, senses in zip(spec.instrumented, memory, strict=True):
        key, noise_factor, seen, robot_flow = _select_robots(
            robots, (world.sensing_key, _noise_factor(world), truth, flow)
        )
        if senses is None:
            estimate = jax.vmap(partial(_add_noise, number=number))(
                robots.params, key, noise_factor, seen, robot_flow
            )
        else:
            run_filter = jax.vmap(partial(_run_filter, number=number))
            senses, estimate = run_filter(
                robots.params, key, noise_factor, senses, seen, robot_flow
            )
        after.append(senses)
        belief = _replace_robots(robots, belief, estimate)
    return tuple(after), belief


def truth_belief(vehicles: VehicleState, flow: jax.Array | None) -> Belief:
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


def _measured_truth(world: World, vehicles: VehicleState) -> Truth:
    """What instruments are exposed to, [R] leading. Obstacles are no bottom."""
    environment = world.environment
    bottom = jax.vmap(height_above_bottom, (None, None, 0))
    return Truth(
        p=vehicles.p,
        q=vehicles.q,
        nu=vehicles.nu,
        altitude_m=bottom(environment.grid, environment.floor_z_m, vehicles.p),
    )


def _noise_factor(world: World) -> jax.Array | None:
    """[R] times the noise that the files say; None for just that."""
    return None if world.factors is None else world.factors.sensor_noise


def _noisy_sensors(params: NavigationParams, noise_factor: jax.Array | None) -> SensorParams:
    """The instruments of one robot as noisy as they are; its filter believes ``params``."""
    return params.sensors if noise_factor is None else scale_noise(params.sensors, noise_factor)


def _select_robots(robots: InstrumentedRobots, tree: Any) -> Any:
    """The rows of some robots of arrays [R, ...]."""
    rows = slice(robots.first, robots.first + robots.count)
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def _replace_robots(robots: InstrumentedRobots, whole: Belief, part: Belief) -> Belief:
    """A belief [R] with that of some robots put in its place."""
    if robots.count == whole.p.shape[0]:
        return part
    rows = slice(robots.first, robots.first + robots.count)
    put: Belief = jax.tree.map(lambda old, new: old.at[rows].set(new), whole, part)
    return put


def _switch_on(
    params: NavigationParams, key: jax.Array, noise_factor: jax.Array | None, truth: Truth
) -> SensingMemory:
    """Instruments and filter of one robot, which begins off the truth by as much as it says."""
    wrapped = jax.random.wrap_key_data(key)
    estimate = Estimate(p=truth.p, q=truth.q, nu=truth.nu)
    return SensingMemory(
        instruments=suite.reset(_noisy_sensors(params, noise_factor), wrapped, truth),
        filter=navigation.reset(params, estimate, jax.random.fold_in(wrapped, FILTER_STEP)),
    )


def _run_filter(
    params: NavigationParams,
    key: jax.Array,
    noise_factor: jax.Array | None,
    senses: SensingMemory,
    truth: Truth,
    flow: jax.Array | None,
    *,
    number: jax.Array,
) -> tuple[SensingMemory, Belief]:
    """Instruments and filter of one robot. No instrument shows the current: still water."""
    wrapped = jax.random.wrap_key_data(key)
    sensors = _noisy_sensors(params, noise_factor)
    instruments, reading = suite.step(sensors, senses.instruments, wrapped, number, truth)
    carry, out = navigation.step(params, senses.filter, reading)
    estimate = out.estimate
    return SensingMemory(instruments=instruments, filter=carry), Belief(
        p=estimate.p,
        q=estimate.q,
        nu=estimate.nu,
        flow=None if flow is None else jnp.zeros_like(flow),
        position_std_m=out.std[:3],
        velocity_std_mps=out.std[3:6],
        attitude_std_rad=out.std[6:9],
    )


def _add_noise(
    params: NavigationParams,
    key: jax.Array,
    noise_factor: jax.Array | None,
    truth: Truth,
    flow: jax.Array | None,
    *,
    number: jax.Array,
) -> Belief:
    """The true state of one robot with white noise."""
    wrapped, noise = jax.random.wrap_key_data(key), params.sensors.truth
    sensors = _noisy_sensors(params, noise_factor)
    measured = suite.disturb_truth(sensors, wrapped, number, truth)
    if flow is not None:
        flow = suite.disturb_current(sensors, wrapped, number, flow)
    stds = (noise.position_std_m, noise.velocity_std_mps, noise.attitude_std_rad)
    position, velocity, attitude = (jnp.broadcast_to(std, (3,)) for std in stds)
    return Belief(
        p=measured.p,
        q=measured.q,
        nu=measured.nu,
        flow=flow,
        position_std_m=position,
        velocity_std_mps=velocity,
        attitude_std_rad=attitude,
    )
