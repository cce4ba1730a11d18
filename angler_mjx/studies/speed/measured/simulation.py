"""Speed of a scenario on this device: drawing and planning its worlds, and simulating them.

The simulation is timed in its first seconds, from rest, while the robots move. Counted are the
physics steps that robots lived: one that has ended is not simulated for a living.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial

import jax
import numpy as np
from jax.stages import Compiled

from angler_mjx.errors import RunError
from angler_mjx.progress import Progress
from angler_mjx.runs import device_batches
from angler_mjx.runs.simulator import devices as on_devices
from angler_mjx.runs.simulator.current_padding import pad_worlds
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import Outcome, World, WorldState
from angler_mjx.studies.speed import flops
from angler_mjx.studies.speed.measured import repeated_worlds
from angler_mjx.studies.speed.rows import (
    SpeedRow,
    all_finite,
    check_repeats,
    iterate_turns,
    moved_bytes,
    peak_device_bytes,
    read_program_costs,
    seconds_of,
    summarise_rates,
)

MOVED_M = 1e-3
"""Way of a robot in the timed region below which it counts as standing."""
MIN_ACTIVE = 0.9
"""Least share of the steps that robots must have lived: else it is another workload."""
CALLS = 4
"""Device calls in a timed turn, one behind another as in a run; one where the time that a call
takes to begin is nothing beside it: on a CPU, and where it takes `LONG_CALL_S`."""
LONG_CALL_S = 1.0
"""Time of a call from which it is the only one of a turn."""
PLAIN_WORLDS = 8
"""In which operations are counted: for one step they do not depend on it."""


@dataclass(frozen=True, kw_only=True)
class TimedSimulation:
    """A scenario compiled for one size, with its worlds and its row."""

    simulator: Simulator
    worlds: World
    program: Compiled
    """Its segment: of fleet, worlds and state, whose memory is used up."""
    row: SpeedRow


def measure(
    scenario: Scenario,
    *,
    label: str,
    worlds: int,
    repeats: int,
    devices: int = 1,
    prepared: int | None = None,
    counted: bool = True,
    progress: Progress | None = None,
) -> SpeedRow:
    """Time the simulation of a scenario, one tile on each device.

    Args:
        scenario: what to simulate.
        label: name of the workload.
        worlds: of each device in one call.
        repeats: timed turns, after some that are not; all from the same state.
        devices: number of them.
        prepared: different worlds to draw, of which the first are taken; as many as are needed
            if left out, ``repeated_worlds.MAX_DIFFERENT`` at most in both cases.
        counted: whether the operations of a step are counted, which traces the program once more.
        progress: receives steps and turns.

    Returns:
        Rates in vehicle-steps/s: physics steps of all robots on their way.

    Raises:
        ConfigError: too few repeats.
        RunError: a result is not finite, robots stand still, or memory does not suffice.
    """
    timed = time_simulation(
        scenario,
        label=label,
        worlds=worlds,
        repeats=repeats,
        devices=devices,
        prepared=prepared,
        counted=counted,
        progress=progress,
    )
    return timed.row


def time_simulation(
    scenario: Scenario,
    *,
    label: str,
    worlds: int,
    repeats: int,
    devices: int = 1,
    prepared: int | None = None,
    counted: bool = True,
    progress: Progress | None = None,
) -> TimedSimulation:
    """As `measure`, with what was compiled for it."""
    check_repeats(repeats)
    progress = progress or Progress()
    progress.describe("sampling and planning worlds")
    simulator = Simulator(scenario, tile=worlds, devices=devices)
    sampled = pad_worlds(repeated_worlds.sample_worlds(scenario, prepared or devices * worlds))
    progress.describe("compiling the simulation")
    compile_s, program = _compile_segment(simulator, sampled)
    filled = repeated_worlds.repeat_worlds(sampled, worlds, devices)
    turns = _time_turns(simulator, program, filled, repeats, progress)
    worlds_text = repeated_worlds.describe_worlds(sampled, devices * worlds)
    if counted:
        progress.describe("counting operations")
    needs = _measure_needs(simulator, program) if counted else _StepNeeds()
    row = SpeedRow(
        workload=label,
        inside=f"{_describe_region(simulator, turns.calls)}; {worlds_text}",
        worlds=worlds,
        robots=len(scenario.members()),
        unit="vehicle-steps/s",
        **summarise_rates(turns.rates),
        compile_s=compile_s,
        devices=devices,
        engine=scenario.engine,
        kernels=simulator.kernels,
        controller=scenario.controller.title,
        flops=needs.flops,
        flops_from=needs.flops_from,
        least_bytes=needs.least_bytes,
        **read_program_costs(program),
        device_peak_bytes=peak_device_bytes(),
        active_share=turns.active_share,
    )
    return TimedSimulation(simulator=simulator, worlds=filled, program=program, row=row)


def measure_preparation(
    scenario: Scenario,
    *,
    label: str,
    worlds: int,
    repeats: int,
    progress: Progress | None = None,
) -> SpeedRow:
    """Time the drawing and planning of worlds; every repeat makes other worlds.

    Args:
        scenario: whose worlds.
        label: name of the workload.
        worlds: in one device call.
        repeats: timed calls, after one that is not timed.
        progress: receives steps and calls.

    Raises:
        ConfigError: too few repeats.
        RunError: a path is not finite, or memory does not suffice.
    """
    check_repeats(repeats)
    progress = progress or Progress()
    progress.describe("compiling")
    simulator = Simulator(scenario, tile=worlds)
    compiled = simulator.compile()
    taken = []
    progress.describe("sampling and planning worlds")
    progress.start(repeats, unit="turns")
    for i in range(repeats + 1):
        try:
            seconds, sampled = seconds_of(simulator.worlds, i * worlds)
        except jax.errors.JaxRuntimeError as error:
            simulator.explain(error)
            raise
        if not all_finite(sampled.path):
            raise RunError("a path in the timed worlds is not finite: no number is given")
        taken.append(seconds)
        progress.advance(int(i > 0))
    return SpeedRow(
        workload=label,
        inside="drawing cells, obstacles, currents, starts and goals; planning all robots",
        worlds=worlds,
        robots=len(scenario.members()),
        unit="worlds/s",
        **summarise_rates([worlds / seconds for seconds in taken[1:]]),
        compile_s=compiled.prepare_s,
        flops_from="not counted: the planner searches until it has found",
        device_peak_bytes=peak_device_bytes(),
    )


def require_moving(after: WorldState, sample: Sample, max_s: float) -> float:
    """Refuse a timed region whose rate would say nothing.

    Args:
        after: state at its end, [W] leading.
        sample: taken in it.
        max_s: simulated time of the region.

    Returns:
        Share of all robot time that robots were on their way.

    Raises:
        RunError: a number is not finite, or too many robots had ended or stood still.
    """
    if not all_finite((after.vehicles, sample.p, sample.q, sample.nu)):
        raise RunError("the timed run holds NaN: no number is given")
    running = np.asarray(after.tally.outcome) == Outcome.RUNNING
    standing = running & (np.asarray(after.tally.path_length_m) < MOVED_M)
    # A robot that stands, at its start or for want of a way, counts as one that ended at once.
    active_s = np.where(standing, 0.0, np.asarray(after.tally.end_time_s, np.float64))
    active = float(np.mean(active_s)) / max_s
    if active < MIN_ACTIVE:
        raise RunError(
            f"robots were on their way for only {active:.0%} of the timed region, and "
            f"{standing.sum()} of {standing.size} stood still: no number is given"
        )
    return min(active, 1.0)


@dataclass(frozen=True, kw_only=True)
class _Turns:
    """Timed turns of a simulation."""

    calls: int
    """Device calls of a turn."""
    rates: list[float]
    """Vehicle-steps/s of each turn."""
    active_share: float
    """Least share of robot time in a turn."""


def _time_turns(
    simulator: Simulator, program: Compiled, worlds: World, repeats: int, progress: Progress
) -> _Turns:
    """Time turns, each from rest, with as many calls as `_choose_calls` says."""
    fly = partial(
        _run_calls, simulator, program, worlds, simulator.programs.flight.pack_cells(worlds)
    )

    def time_call() -> float:
        state = jax.block_until_ready(simulator.reset(worlds))
        return seconds_of(fly, state, 1)[0]

    progress.describe("timing")
    calls = _choose_calls(_max_calls(simulator), time_call)
    seconds = calls * simulator.segment_steps * simulator.spec.control_dt_s
    rates, actives = [], []
    for counts in iterate_turns(repeats, progress):
        state = jax.block_until_ready(simulator.reset(worlds))
        taken, (after, sample) = seconds_of(fly, state, calls)
        active = require_moving(after, sample, seconds)
        # What is measured is freed before the next state is made: it counts in peak memory.
        del state, after, sample
        if counts:
            rates.append(active * calls * _max_steps(simulator) / taken)
            actives.append(active)
    return _Turns(calls=calls, rates=rates, active_share=min(actives))


def _max_calls(simulator: Simulator) -> int:
    """Return the device calls of a timed turn, if they are short."""
    return min(1 if jax.default_backend() == "cpu" else CALLS, simulator.segments)


def _choose_calls(max_calls: int, time_call: Callable[[], float]) -> int:
    """Return the device calls of a timed turn: one where a warm call takes `LONG_CALL_S`.

    Args:
        max_calls: of a turn with short calls.
        time_call: runs one call from rest and returns its time, s. A second call decides where the
            first is long, as the first may load the program.
    """
    if max_calls > 1 and all(time_call() >= LONG_CALL_S for _ in range(2)):
        return 1
    return max_calls


def _run_calls(
    simulator: Simulator,
    program: Compiled,
    worlds: World,
    cells: jax.Array | None,
    state: WorldState,
    calls: int,
) -> tuple[WorldState, Sample]:
    """Calls one behind another as in a run: the next is given while one is still computed."""
    in_flight: deque[jax.Array] = deque()
    for _ in range(calls):
        state, sample, running = program(
            simulator.fleet, worlds, state, cells, *simulator._policy_numbers
        )
        in_flight.append(running)
        if len(in_flight) == device_batches.SEGMENTS_IN_FLIGHT:
            in_flight.popleft().block_until_ready()
    return state, sample


def _compile_segment(simulator: Simulator, sampled: World) -> tuple[float, Compiled]:
    """Seconds it took to compile a segment of repeated worlds, and the program.

    Raises:
        RunError: its memory is more than a device has; nothing was allocated yet.
    """
    shapes = repeated_worlds.repeated_shape(sampled, simulator.tile, simulator.devices)
    mesh = on_devices.build_mesh(simulator.devices)
    driver = on_devices.with_sharding(simulator._policy_numbers, mesh, on_devices.REPLICATED)
    state = simulator.programs.flight.reset.shape(simulator.fleet, shapes, *driver)
    state = on_devices.with_sharding(state, mesh, on_devices.SHARDED)
    cells = simulator.programs.flight.pack_cells.shape(shapes)
    cells = on_devices.with_sharding(cells, mesh, on_devices.SHARDED)
    lowered = simulator.programs.flight.segment.lower(
        simulator.fleet, shapes, state, cells, *driver
    )
    compile_s, program = seconds_of(lowered.compile)
    _require_room(simulator.tile, program)
    return compile_s, program


def _require_room(tile: int, program: Compiled) -> None:
    """Refuse a program that by XLA's account needs more memory than a device has."""
    needed = read_program_costs(program).get("program_bytes")
    limit = on_devices.limit_bytes(jax.local_devices()[0])
    if needed is not None and needed > limit:
        raise on_devices.tile_too_large(tile, needed, limit, "before the first step")


@dataclass(frozen=True, kw_only=True)
class _StepNeeds:
    """Least operations and bytes of one physics step of one robot."""

    flops: float | None = None
    flops_from: str = "not asked for"
    least_bytes: float | None = None


def _measure_needs(simulator: Simulator, program: Compiled) -> _StepNeeds:
    """What one physics step of one robot needs at least: operations and bytes."""
    counted, how = _flops_per_step(simulator)
    moved = moved_bytes(program)
    bytes_each = simulator.devices * moved / _max_steps(simulator) if moved else None
    return _StepNeeds(flops=counted, flops_from=how, least_bytes=bytes_each)


def _max_steps(simulator: Simulator) -> int:
    """Physics steps of all robots in one call, if none of them ends."""
    robots = len(simulator.scenario.members())
    worlds = simulator.devices * simulator.tile
    return worlds * robots * simulator.segment_steps * simulator.spec.physics_steps


def _flops_per_step(simulator: Simulator) -> tuple[float | None, str]:
    """Operations for one physics step of one robot, and how they were counted."""
    counted = _count_scenario_flops(simulator.scenario.model_dump_json())
    if simulator.kernels == "xla" or counted.flops is None:
        return counted.flops, counted.how
    return counted.flops, f"{counted.how}; of the same engine with kernels = xla"


@cache
def _count_scenario_flops(scenario: str) -> flops.OperationCount:
    """Operations for one physics step of one robot of a scenario, on the plain engine."""
    plain = Simulator(
        Scenario.model_validate_json(scenario).model_copy(update={"kernels": "xla"}),
        tile=PLAIN_WORLDS,
    )
    worlds = plain.world_shape()
    counted = flops.count_operations(plain.advance, worlds, jax.eval_shape(plain.reset, worlds))
    if counted.flops is None:
        return counted
    return replace(counted, flops=counted.flops / _max_steps(plain))


def _describe_region(simulator: Simulator, calls: int) -> str:
    seconds = calls * simulator.segment_steps * simulator.spec.control_dt_s
    times = "one device call" if calls == 1 else f"{calls} device calls"
    if calls < _max_calls(simulator):
        times += f", as it takes {LONG_CALL_S:g} s or more"
    every = simulator.steps_per_sample * simulator.spec.physics_steps
    return (
        f"{seconds:g} s of simulated time from rest, in {times}: current, water, rigid "
        f"body, rotors, control, allocation, obstacles, detection; samples every {every} physics "
        "steps, left on the device"
    )
