"""Speed of a scenario on this device: drawing and planning its worlds, and simulating them.

The simulation is timed in its first seconds, from rest, while the robots move. Counted are the
physics steps that robots lived: one that has ended is not simulated for a living.
"""

from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.benchmark import flops
from angler_mjx.benchmark.speed import Row, check_repeats, peak_device_bytes, seconds_of, spread
from angler_mjx.errors import RunError
from angler_mjx.runs.scenario import Scenario
from angler_mjx.runs.simulator import Simulator
from angler_mjx.sim.state import Outcome, Sample, WorldState

MOVED_M = 1e-3
"""Way of a robot in the timed region below which it counts as standing."""
ACTIVE = 0.9
"""Least share of the steps that robots must have lived: else it is another workload."""
PLAIN_WORLDS = 8
"""In which operations are counted: for one step they do not depend on it."""


def measure(scenario: Scenario, *, label: str, worlds: int, repeats: int, devices: int = 1) -> Row:
    """Time the simulation of a scenario, one tile on each device.

    Args:
        scenario: what to simulate.
        label: name of the workload.
        worlds: of each device in one call.
        repeats: timed calls, after one that is not timed; all from the same state.
        devices: number of them.

    Returns:
        Rates in vehicle-steps/s: physics steps of all robots on their way.

    Raises:
        ConfigError: too few repeats.
        RunError: a result is not finite, robots stand still, or memory does not suffice.
    """
    check_repeats(repeats)
    simulator = Simulator(scenario, tile=worlds, devices=devices)
    compiled = simulator.compile()
    try:
        rates, active = _repeat(simulator, repeats)
    except jax.errors.JaxRuntimeError as error:
        simulator.explain(error)
        raise
    most = _most_steps(simulator)
    # The compiled program itself: XLA's account is of the very thing that was timed.
    program: Any = simulator._segment
    memory = program.memory_analysis()
    moved = memory.argument_size_in_bytes + memory.output_size_in_bytes if memory else None
    counted, how = _flops_per_step(simulator)
    return Row(
        workload=label,
        inside=_inside(simulator),
        worlds=worlds,
        robots=len(scenario.members()),
        unit="vehicle-steps/s",
        **spread(rates),
        compile_s=compiled.segment_s,
        devices=devices,
        engine=scenario.engine,
        kernels=simulator.kernels,
        flops=counted,
        flops_from=how,
        least_bytes=devices * moved / most if moved else None,
        program_bytes=(
            moved + memory.temp_size_in_bytes - memory.alias_size_in_bytes if moved else None
        ),
        device_peak_bytes=peak_device_bytes(),
        active_share=active,
    )


def measure_preparation(scenario: Scenario, *, label: str, worlds: int, repeats: int) -> Row:
    """Time the drawing and planning of worlds; every repeat makes other worlds.

    Args:
        scenario: whose worlds.
        label: name of the workload.
        worlds: in one device call.
        repeats: timed calls, after one that is not timed.

    Raises:
        ConfigError: too few repeats.
        RunError: a path is not finite, or memory does not suffice.
    """
    check_repeats(repeats)
    simulator = Simulator(scenario, tile=worlds)
    compiled = simulator.compile()
    taken = []
    for i in range(repeats + 1):
        try:
            seconds, made = seconds_of(simulator.worlds, i * worlds)
        except jax.errors.JaxRuntimeError as error:
            simulator.explain(error)
            raise
        if not _all_finite(made.path):
            raise RunError("a path in the timed worlds is not finite: no number is given")
        taken.append(seconds)
    return Row(
        workload=label,
        inside="drawing cells, obstacles, currents, starts and goals; planning all robots",
        worlds=worlds,
        robots=len(scenario.members()),
        unit="worlds/s",
        **spread([worlds / seconds for seconds in taken[1:]]),
        compile_s=compiled.prepare_s,
        flops_from="not counted: the planner searches until it has found",
        device_peak_bytes=peak_device_bytes(),
    )


def require_moving(after: WorldState, sample: Sample, most_s: float) -> float:
    """Refuse a timed region whose rate would say nothing.

    Args:
        after: state at its end, [W] leading.
        sample: taken in it.
        most_s: simulated time of the region.

    Returns:
        Share of all robot time that robots were on their way.

    Raises:
        RunError: a number is not finite, robots stood still, or too many had ended.
    """
    if not _all_finite((after.vehicles, sample.p, sample.q, sample.nu)):
        raise RunError("the timed run holds NaN: no number is given")
    running = np.asarray(after.tally.outcome) == Outcome.RUNNING
    standing = running & (np.asarray(after.tally.path_length_m) < MOVED_M)
    if standing.any():
        raise RunError(
            f"{standing.sum()} of {standing.size} robots stood still in the timed region: "
            "no number is given"
        )
    active = float(np.mean(np.asarray(after.tally.end_time_s, np.float64))) / most_s
    if active < ACTIVE:
        raise RunError(
            f"robots were on their way for only {active:.0%} of the timed region: "
            "no number is given"
        )
    return min(active, 1.0)


def _repeat(simulator: Simulator, repeats: int) -> tuple[list[float], float]:
    """Rates of the timed calls, and the least share of robot time in them."""
    worlds = jax.block_until_ready(simulator.worlds(0))
    if not np.asarray(worlds.environment.valid).all():
        raise RunError("some worlds cannot hold the fleet: no number is given; take fewer robots")
    seconds = simulator.segment_steps * simulator.spec.control_dt_s
    rates, actives = [], []
    for i in range(repeats + 1):
        state = jax.block_until_ready(simulator.reset(worlds))
        taken, (after, sample) = seconds_of(simulator.segment, worlds, state)
        active = require_moving(after, sample, seconds)
        # What is measured is freed before the next state is made: it counts in peak memory.
        del state, after, sample
        if i > 0:
            rates.append(active * _most_steps(simulator) / taken)
            actives.append(active)
    return rates, min(actives)


def _most_steps(simulator: Simulator) -> int:
    """Physics steps of all robots in one call, if none of them ends."""
    robots = len(simulator.scenario.members())
    worlds = simulator.devices * simulator.tile
    return worlds * robots * simulator.segment_steps * simulator.spec.physics_steps


def _flops_per_step(simulator: Simulator) -> tuple[float | None, str]:
    """Operations for one physics step of one robot, and how they were counted."""
    counted = _count(simulator.scenario.model_dump_json())
    if simulator.kernels == "xla" or counted.flops is None:
        return counted.flops, counted.how
    return counted.flops, f"{counted.how}; of the same engine with kernels = xla"


@cache
def _count(scenario: str) -> flops.Count:
    """Operations for one physics step of one robot of a scenario, on the plain engine."""
    plain = Simulator(
        Scenario.model_validate_json(scenario).model_copy(update={"kernels": "xla"}),
        tile=PLAIN_WORLDS,
    )
    worlds = plain.world_shape()
    counted = flops.count(plain.advance, worlds, jax.eval_shape(plain.reset, worlds))
    if counted.flops is None:
        return counted
    return replace(counted, flops=counted.flops / _most_steps(plain))


def _inside(simulator: Simulator) -> str:
    seconds = simulator.segment_steps * simulator.spec.control_dt_s
    every = simulator.steps_per_sample * simulator.spec.physics_steps
    return (
        f"{seconds:g} s of simulated time from rest, in one device call: current, water, rigid "
        f"body, rotors, control, allocation, obstacles, detection; samples every {every} physics "
        "steps, left on the device"
    )


@jax.jit
def _finite(tree: Any) -> jax.Array:
    leaves = [x for x in jax.tree.leaves(tree) if jnp.issubdtype(x.dtype, jnp.floating)]
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in leaves]))


def _all_finite(tree: Any) -> bool:
    return bool(_finite(tree))
