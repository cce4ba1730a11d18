"""Compiled functions of a scenario, shared by simulators of this process that need the same ones.

Tracing and compiling a scenario takes seconds to a minute, and a grid of cells, a notebook or a
test needs the same programs many times. `shared_programs` returns earlier programs where everything
that was traced into them is equal, files by their content; numbers that they take as arguments may
differ. Programs that hold a planner or policy of a caller are made anew for each simulator: their
code may have changed.
"""

import gc
import json
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property, partial
from weakref import WeakValueDictionary

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from angler_kernels.programs import without_kernels
from angler_mjx.files import JsonTable
from angler_mjx.planning.planner import PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.robot.control.stack import Command
from angler_mjx.runs.simulator import devices as on_devices
from angler_mjx.runs.simulator.compilation import (
    CompiledFunction,
    CompileTime,
    ParallelCompiler,
    PendingProgram,
)
from angler_mjx.runs.simulator.current_padding import cut_worlds
from angler_mjx.runs.simulator.devices import (
    REPLICATED,
    SHARDED,
    DeviceMemory,
    limit_bytes,
    tile_too_large,
    tree_bytes,
    with_sharding,
)
from angler_mjx.runs.simulator.sampling_numbers import (
    SamplingNumbers,
    sampling_numbers,
    static_table,
)
from angler_mjx.runs.simulator.stored_programs import ProgramStore, open_store, trace_settings
from angler_mjx.runs.simulator.world_preparation import build_preparer, build_tile_problems
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim import fleet
from angler_mjx.sim.engines import base as engines
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import FleetWorld, Outcome, SimSpec, World, WorldState
from angler_mjx.world import generate
from angler_mjx.world.config import resolve_world
from angler_mjx.world.currents import component_sizes, flight_sizes

type SegmentResult = tuple[WorldState, Sample, jax.Array]
"""State after a segment, samples of it, and the number of running robots of each world."""

MAX_SHARED = 16
"""Maximum number of sets that `shared_programs` keeps; the least recently used one is dropped."""

SEGMENT_SAMPLES, SEGMENT_STEPS = 25, 100
"""Maximum number of samples of a segment, or of control steps where that is more. A call took an
H200 2 ms to begin: as long as 70 control steps of 1,024 worlds of 8 robots."""

UNTRACED_KEYS = {"name", "description", "worlds", "seed", "tile"}
"""Keys of a scenario that no program depends on; the tile is a separate input."""
UNTRACED_PLANNER_KEYS = {"name", "requested", "settings", "information"}
"""Keys of a planner that no program depends on where it plans on the host, or where paths are
inputs; programs that build problems are kept by their information."""


@dataclass(frozen=True, kw_only=True)
class ProgramSetup:
    """Inputs of a scenario's programs."""

    scenario: Scenario
    tile: int
    """Worlds of one device in one call."""
    mesh: Mesh
    kernels: str
    paths: PathShape
    planner: PlannerSpec | None
    """Planner that is part of the programs; None where paths come from outside them."""
    policy: tuple[Policy, ...]
    """Policy on the devices of the mesh; empty without one."""
    has_user_code: bool
    """Whether code of a caller is traced: a policy object, or a class with ``plan_batch``."""

    def numbers(self) -> SamplingNumbers:
        """Return the arguments of the sampling, with padded currents where programs are shared."""
        numbers = sampling_numbers(self.scenario)
        return numbers.padded() if self._is_shareable else numbers

    @property
    def current_sizes(self) -> tuple[int | None, ...]:
        """Return the sizes of the currents that flights take; see `currents.flight_sizes`."""
        samplers = sampling_numbers(self.scenario).world.currents
        return flight_sizes(samplers) if self._is_shareable else component_sizes(samplers)

    @property
    def _is_shareable(self) -> bool:
        """Return whether no code of a caller is traced."""
        return not self.has_user_code

    def key(self) -> Hashable | None:
        """Return a value equal for equal programs; None where they cannot be shared."""
        return self._key(self._traced_table(), self._traced_planner(), repr(self.planner))

    def flight_key(self) -> Hashable | None:
        """Return a value equal for equal programs of flights; None where they cannot be shared.

        Planners that plan at the start only are no part of them, nor is the rule that makes rock:
        flights take its cells.
        """
        table = self._traced_table()
        world = table["world"]
        assert isinstance(world, dict)
        del world["rule"]
        planner = self._traced_planner() if self.scenario.flown else {}
        return self._key(table, planner)

    def open_store(self, key: Hashable | None) -> ProgramStore | None:
        """Return the folder of executables; None for programs that hold fields of files."""
        return None if self.scenario.world.files else open_store(key, self.mesh)

    def _key(self, *traced: Hashable | JsonTable) -> Hashable | None:
        """Return a value of tables that are traced, and of all else that programs depend on."""
        if not self._is_shareable:
            return None
        arguments = (self.numbers(), self.policy)
        shapes = [(leaf.shape, str(leaf.dtype)) for leaf in jax.tree.leaves(arguments)]
        return (
            json.dumps(traced, sort_keys=True),
            self.scenario.world.file_digests,
            self.tile,
            self.mesh,
            self.kernels,
            self.paths,
            self.current_sizes,
            jax.tree.structure(arguments),
            tuple(shapes),
            trace_settings(),
        )

    def _traced_table(self) -> JsonTable:
        """Return the tables that are traced into the programs, but that of the planner.

        A name that was chosen by "auto" gives the program of the same name in the file.
        """
        excluded: dict[str, bool | set[str]] = dict.fromkeys({*UNTRACED_KEYS, "planner"}, True)
        table = static_table(self.scenario, {**excluded, "execution": {"requested"}})
        return {**table, "vehicles": [*self.scenario.fleet_tables()]}

    def _traced_planner(self) -> JsonTable:
        """Return the keys of the planner that programs depend on."""
        is_outside = self.planner is None and not self.scenario.planner.replan_hz
        return self.scenario.planner.model_dump(
            mode="json", exclude=UNTRACED_PLANNER_KEYS if is_outside else {"requested"}
        )


class FlightPrograms:
    """Compiled functions that advance worlds; planners that plan at the start are no part of them.

    Attributes:
        fleet: compiled vehicles, on every device.
        engine: engine that advances the worlds.
        samples: stored samples in one segment.
        steps_per_sample: control steps between samples.
        reset: states of the fleet's worlds at t = 0.
        step: one control step.
        segment: one segment of a run, from the end of the segment before.
        segment_any_step: one segment from any control step.
        commanded: one segment with a command in place of the paths.
        add_parameters: worlds with the parameters of the fleet's variants.
        pack_cells: cells of worlds as the engine reads them; None where it reads the grid itself.
    """

    def __init__(self, setup: ProgramSetup) -> None:
        """Compile the vehicles and build the functions; programs are compiled later.

        Raises:
            ConfigError: a vehicle file has faults.
        """
        self._setup, scenario = setup, setup.scenario
        self.spec: SimSpec = scenario.sim_spec()
        self.fleet: Fleet = jax.device_put(
            fleet.build_fleet(
                scenario.members(),
                multibody=scenario.engine == "mjx",
                load=scenario.carried(),
                cargo=scenario.cargo_load(),
            ),
            NamedSharding(setup.mesh, REPLICATED),
        )
        self.samples, self.steps_per_sample = _segment_size(scenario)
        self.engine = engines.by_name(scenario.engine, setup.kernels)
        self._state: WorldState | None = None
        shard = partial(_shard_function, setup, setup.open_store(setup.flight_key()))
        # A policy is an argument of the programs: one with other numbers needs no compilation.
        policy_specs = (REPLICATED,) * len(setup.policy)
        reset = partial(self.engine.reset, self.spec)
        self.reset: CompiledFunction[WorldState] = shard(
            reset, REPLICATED, SHARDED, *policy_specs, stored_name="reset"
        )
        self.step: CompiledFunction[tuple[WorldState, Sample]] = shard(
            self._run_step,
            *(REPLICATED, SHARDED, SHARDED, SHARDED, SHARDED, *policy_specs),
            stored_name="step",
        )
        # Of runs, whose segments begin where the one before ended; and of any.
        steps = self.samples * self.steps_per_sample
        of_run, of_any = (partial(self._run_segment, n) for n in (steps, 1))
        self.segment: CompiledFunction[SegmentResult] = shard(
            of_run,
            *(REPLICATED, SHARDED, SHARDED, SHARDED, *policy_specs),
            donate_argnums=2,
            stored_name="segment",
        )
        self.segment_any_step: CompiledFunction[SegmentResult] = shard(
            of_any,
            *(REPLICATED, SHARDED, SHARDED, SHARDED, *policy_specs),
            donate_argnums=2,
            stored_name="segment_any_step",
        )
        self.commanded: CompiledFunction[SegmentResult] = shard(
            self._run_commanded,
            *(REPLICATED, SHARDED, SHARDED, SHARDED, SHARDED),
            donate_argnums=2,
            stored_name="commanded",
        )
        self.add_parameters: CompiledFunction[FleetWorld] = shard(
            fleet.add_parameters, REPLICATED, SHARDED
        )
        self.pack_cells: CompiledFunction[jax.Array | None] = shard(self.engine.pack_cells, SHARDED)

    def begin(
        self, programs: ParallelCompiler, worlds: World
    ) -> tuple[WorldState, list[PendingProgram]]:
        """Begin to compile reset and segment; return the shapes of states and both programs."""
        mesh = self._setup.mesh
        kinds = with_sharding(self.fleet, mesh, REPLICATED)
        policy_shapes = with_sharding(self._setup.policy, mesh, REPLICATED)
        # Each is traced for the result shapes of the one before, known from its trace.
        reset = programs.begin(self.reset, kinds, worlds, *policy_shapes)
        if self._state is None:
            shapes = self.reset.shape(kinds, worlds, *policy_shapes)
            self._state = with_sharding(shapes, mesh, SHARDED)
        cells = with_sharding(self.pack_cells.shape(worlds), mesh, SHARDED)
        segment = programs.begin(self.segment, kinds, worlds, self._state, cells, *policy_shapes)
        return self._state, [reset, segment]

    def _run_step(
        self,
        kinds: Fleet,
        worlds: World,
        state: WorldState,
        cells: jax.Array | None,
        command: Command | None,
        policy: Policy | None = None,
    ) -> tuple[WorldState, Sample]:
        return self.engine.control_step(
            self.spec, kinds, worlds, state, command, policy, cells=cells
        )

    def _run_segment(
        self,
        begins: int,
        kinds: Fleet,
        worlds: World,
        state: WorldState,
        cells: jax.Array | None,
        policy: Policy | None = None,
        command: Command | None = None,
    ) -> SegmentResult:
        after, sample = self.engine.segment(
            self.spec,
            kinds,
            worlds,
            state,
            n_sample=self.samples,
            steps_per_sample=self.steps_per_sample,
            command=command,
            policy=policy,
            begins=begins,
            cells=cells,
        )
        running = jnp.sum(after.tally.outcome == Outcome.RUNNING, axis=-1, dtype=jnp.int32)
        return after, sample, running

    def _run_commanded(
        self,
        kinds: Fleet,
        worlds: World,
        state: WorldState,
        cells: jax.Array | None,
        command: Command,
    ) -> SegmentResult:
        return self._run_segment(1, kinds, worlds, state, cells, None, command)


class Programs:
    """Compiled functions of one scenario for one tile per device; shapes as in `Simulator`.

    Attributes:
        flight: functions that advance the worlds; other planners of the same worlds share them.
        prepare: worlds of the fleet, from the scenario's numbers, the seed and the first world of
            each device.
        store: executables on disk; None where none are stored.
    """

    def __init__(self, setup: ProgramSetup) -> None:
        """Compile the vehicles and build the functions; programs are compiled later.

        Raises:
            ConfigError: a vehicle file has faults, or the fleet does not fit the world's cells.
        """
        self._setup, scenario = setup, setup.scenario
        self.flight = _shared_flight(setup)
        generate.check_fleet(
            resolve_world(scenario.world),
            np.asarray(jax.jit(fleet.radius_bound)(self.flight.fleet)),
            by_end_effector=scenario.by_end_effector,
            held=scenario.held_body,
        )
        self.memory: DeviceMemory | None = None
        self._problems: dict[Information, CompiledFunction[Problem]] = {}
        self._compiled, self._lock = False, threading.Lock()
        self._compile_time = CompileTime()
        policy = setup.policy[0] if setup.policy else None
        sampling = build_preparer(
            scenario, setup.planner, setup.tile, shape=setup.paths, policy=policy
        )
        self.store = setup.open_store(setup.key())
        self.prepare: CompiledFunction[World] = _shard_function(
            setup,
            self.store,
            sampling,
            *(REPLICATED, REPLICATED, REPLICATED, SHARDED),
            stored_name="prepare",
        )

    def problem(self, information: Information) -> CompiledFunction[Problem]:
        """Return the program that builds problems of worlds at an information level."""
        if information not in self._problems:
            build = partial(build_tile_problems, self._setup.scenario, information)
            self._problems[information] = _shard_function(
                self._setup,
                self.store,
                build,
                *(REPLICATED, SHARDED, REPLICATED, SHARDED),
                stored_name=f"problem {information!r}",
            )
        return self._problems[information]

    @cached_property
    def batch_shape(self) -> World:
        """Return shapes, types and shardings of a device batch, with currents of flights.

        Tracing a planner takes long.
        """
        sampled = self.prepare.shape(*self._prepare_shapes())
        shapes = jax.eval_shape(partial(cut_worlds, sizes=self._setup.current_sizes), sampled)
        worlds: World = with_sharding(shapes, self._setup.mesh, SHARDED)
        return worlds

    def compile(self) -> CompileTime:
        """Compile for the tile ahead of time; later calls use the compiled functions.

        Returns:
            Seconds of each program; zeros if an earlier call returned them.

        Raises:
            RunError: the tile does not fit into device memory; names a tile that does. Or the
                kernels do not compile; names other kernels.
        """
        with self._lock:
            self._compile_once()
            compile_time, self._compile_time = self._compile_time, CompileTime()
        return compile_time

    def compile_ahead(self) -> None:
        """Compile as `compile` does; its next call returns the seconds. Errors as of `compile`."""
        with self._lock:
            self._compile_once()

    def _compile_once(self) -> None:
        if not self._compiled:
            self._compile_time = self._compile()
            self._compiled = True

    def explain(self, error: Exception) -> None:
        """Turn a device's out-of-memory error into one that names a fitting tile.

        Raises:
            RunError: the error is of that kind; others are ignored.
        """
        if not on_devices.is_out_of_memory(error):
            return
        limit = limit_bytes(self._setup.mesh.devices.flat[0])
        # The failed program needs more than the limit, in spite of the report.
        needed = None if self.memory is None else max(self.memory.needed, limit)
        cause = str(error).splitlines()[0][:120]
        raise tile_too_large(self._setup.tile, needed, limit, cause) from error

    def _compile(self) -> CompileTime:
        start, mesh = time.perf_counter(), self._setup.mesh
        worlds, state, pending = self._start_compilation()
        try:
            results = [program.result() for program in pending]
        except jax.errors.JaxRuntimeError as error:
            # No report of the programs' memory is available: the size of their results is a lower
            # bound.
            min_bytes = (2 * tree_bytes(worlds) + tree_bytes(state)) // mesh.size
            self.memory = DeviceMemory(prepare=min_bytes, segment=min_bytes)
            self.explain(error)
            raise
        functions, seconds = zip(*results, strict=True)
        self.memory = on_devices.analyse_memory(*functions)
        limit = limit_bytes(mesh.devices.flat[0])
        if self.memory is not None and self.memory.needed > limit:
            raise tile_too_large(
                self._setup.tile, self.memory.needed, limit, "before the first world"
            )
        programs = (self.prepare, self.flight.reset, self.flight.segment)
        for program, executable in zip(programs, functions, strict=True):
            program.keep(executable)
        prepare_s, reset_s, segment_s = seconds
        return CompileTime(
            prepare_s=prepare_s,
            reset_s=reset_s,
            segment_s=segment_s,
            total_s=time.perf_counter() - start,
        )

    def _start_compilation(self) -> tuple[World, WorldState, list[PendingProgram]]:
        """Start compiling prepare, reset and segment; return shapes of worlds and states."""
        with ParallelCompiler(3) as programs:
            prepare = programs.begin(self.prepare, *self._prepare_shapes())
            worlds = self.batch_shape
            state, of_flight = self.flight.begin(programs, worlds)
        return worlds, state, [prepare, *of_flight]

    def _prepare_shapes(
        self,
    ) -> tuple[Fleet, SamplingNumbers, jax.ShapeDtypeStruct, jax.ShapeDtypeStruct]:
        """Return the arguments of the preparing function: fleet, numbers, seed, first worlds."""
        mesh = self._setup.mesh
        number = jax.ShapeDtypeStruct((), jnp.uint32)
        firsts = jax.ShapeDtypeStruct((mesh.size,), jnp.uint32)
        return (
            with_sharding(self.flight.fleet, mesh, REPLICATED),
            with_sharding(self._setup.numbers(), mesh, REPLICATED),
            with_sharding(number, mesh, REPLICATED),
            with_sharding(firsts, mesh, SHARDED),
        )


def _shard_function[R](
    setup: ProgramSetup,
    store: ProgramStore | None,
    function: Callable[..., R],
    *specs: PartitionSpec,
    donate_argnums: int | None = None,
    stored_name: str = "",
) -> CompiledFunction[R]:
    """Return a compiled function that runs on each device, on its tile.

    Results carry their sharding by tiles: a function of them is then one program, whether it was
    compiled ahead of time or is called.

    Args:
        setup: inputs of the programs.
        store: executables on disk.
        function: function of one device's tile.
        specs: sharding of its arguments.
        donate_argnums: number of the argument whose memory the results take.
        stored_name: of its executable on disk; empty to store none.
    """
    # Where a scenario names xla, not only its engine does without kernels.
    if setup.scenario.kernels == "xla":
        function = without_kernels(function)
    return CompiledFunction(
        on_devices.shard_function(setup.mesh, function, *specs),
        out_shardings=NamedSharding(setup.mesh, SHARDED),
        donate_argnums=donate_argnums,
        name=stored_name,
        store=store if stored_name else None,
    )


_shared: OrderedDict[Hashable, Programs] = OrderedDict()
_flights: WeakValueDictionary[Hashable, FlightPrograms] = WeakValueDictionary()
"""Those of programs in use."""
_lock = threading.Lock()


def shared_programs(setup: ProgramSetup) -> Programs:
    """Return the programs of a setup: those of an equal setup if they are still held.

    Raises:
        ConfigError: as `Programs`.
    """
    key = setup.key()
    if key is None:
        return Programs(setup)
    with _lock:
        cached = _shared.get(key)
    created = cached or Programs(setup)
    with _lock:
        stored = _shared.setdefault(key, created)
        _shared.move_to_end(key)
        while len(_shared) > MAX_SHARED:
            _shared.popitem(last=False)
    return stored


def _shared_flight(setup: ProgramSetup) -> FlightPrograms:
    """Return the flight programs of a setup: those of an equal setup if they are in use."""
    key = setup.flight_key()
    if key is None:
        return FlightPrograms(setup)
    with _lock:
        cached = _flights.get(key)
    created = cached or FlightPrograms(setup)
    with _lock:
        return _flights.setdefault(key, created)


def release_memory() -> None:
    """Release the memory of programs that no simulator uses any more.

    Programs of many runs together would use up the memory maps of a process.
    """
    jax.clear_caches()
    gc.collect()


def clear_shared() -> None:
    """Drop all shared programs; simulators that use them keep theirs."""
    with _lock:
        _shared.clear()
        _flights.clear()


def _segment_size(scenario: Scenario) -> tuple[int, int]:
    """Return samples in one segment, and control steps between samples."""
    timing = scenario.time
    steps = timing.steps_per_sample or _largest_divisor(timing.control_steps, 100)
    if not timing.steps_per_sample:
        return 1, steps
    max_samples = max(SEGMENT_SAMPLES, SEGMENT_STEPS // steps)
    return _largest_divisor(timing.control_steps // steps, max_samples), steps


def _largest_divisor(total: int, max_divisor: int) -> int:
    """Return the largest divisor of ``total`` up to ``max_divisor``."""
    return max(n for n in range(1, max_divisor + 1) if total % n == 0)
