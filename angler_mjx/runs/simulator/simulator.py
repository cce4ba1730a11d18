"""Runnable scenario: worlds from indices, and the compiled reset, step and segment.

Its compiled functions are those of `angler_mjx.runs.simulator.programs`. Every call works on one
tile per device: a fixed number of worlds with consecutive global indices, so a run of any size
compiles once, and the same tile on the same kind of device gives the same bytes at any position of
a run and for any number of devices.
"""

from collections.abc import Sequence
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding

from angler_mjx.errors import ConfigError
from angler_mjx.planning.planner import Path, PathShape
from angler_mjx.planning.problem import Problem, ProblemName
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.robot.control import command_checks, stack
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import Command
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.params import joint_names
from angler_mjx.runs.simulator import compile_cache, host_planning, programs, scenario_policy
from angler_mjx.runs.simulator import devices as on_devices
from angler_mjx.runs.simulator.compilation import CompileTime
from angler_mjx.runs.simulator.current_padding import CurrentPadding
from angler_mjx.runs.simulator.devices import REPLICATED, SHARDED
from angler_mjx.runs.simulator.host_planning import PlanNotes, SampledBatch
from angler_mjx.runs.simulator.programs import Programs, SegmentResult
from angler_mjx.runs.simulator.sampling_numbers import sampling_numbers
from angler_mjx.runs.simulator.world_preparation import (
    check_key_number,
    check_worlds,
    replace_paths,
)
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim import fleet
from angler_mjx.sim import policy as policies
from angler_mjx.sim.engines import base as engines
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import FleetWorld, SimSpec, World, WorldState

DEFAULT_TILE = {"cpu": 128, "gpu": 4096}
"""Worlds in one device call where the scenario does not say."""


def default_tile(worlds: int) -> int:
    """Return tile of a run of ``worlds`` on the default device: at most the worlds of the run."""
    return min(worlds, DEFAULT_TILE.get(jax.default_backend(), DEFAULT_TILE["cpu"]))


MIN_POINTS = 2
"""Number of points of unused paths."""


class Simulator:
    """Compiled simulation of one scenario, in device batches: one tile of worlds on each device.

    With one device, a device batch is a tile. Every leaf of a method's arguments and results has
    [devices * tile] worlds leading, spread over the devices.

    Attributes:
        scenario: simulated scenario.
        tile: worlds of one device in one call.
        devices: number of devices.
        samples: stored samples in one segment.
        steps_per_sample: control steps between samples.
        paths: type and number of points of the robots' paths.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        tile: int | None = None,
        devices: int | None = 1,
        policy: Policy | None = None,
        workers: int | None = None,
        paths: PathShape | None = None,
    ) -> None:
        """Read the vehicles and build the functions; they are compiled later.

        Args:
            scenario: scenario to simulate.
            tile: worlds in one call; the scenario's, or else the device's default.
            devices: devices to spread tiles over; all of this process if None.
            policy: policy that commands the robots in every control step, instead of their paths.
            workers: number of processes of a host planner; one for each processor if left out. It
                changes no byte of the results.
            paths: type and number of points of paths from `replace_paths`, where no planner is
                used.

        Raises:
            ConfigError: a vehicle file has faults, the fleet does not fit the world's cells, or the
                process has fewer devices.
        """
        compile_cache.enable_cache()
        on_devices.require_memory(scenario.world.held_bytes)
        has_policy = policy is not None
        self.scenario, policy = scenario, scenario_policy.resolve_policy(scenario, policy)
        self.tile = tile or scenario.tile or default_tile(scenario.worlds)
        self._mesh = on_devices.build_mesh(devices)
        self.devices = self._mesh.size
        self.kernels = scenario.kernels or engines.default_kernels(
            scenario.engine, jax.default_backend()
        )
        if self.kernels != "xla" and jax.default_backend() != "gpu":
            raise ConfigError(
                f'kernels = "{self.kernels}": needs an NVIDIA GPU, and JAX computes on '
                f'{jax.default_backend()}; use kernels = "xla"'
            )
        by_task = scenario.task_spec() is not None
        # Along routes of several places no path to a single goal is planned.
        is_unplanned = paths is not None or by_task
        self._planner_spec = None if is_unplanned else scenario.planner.planner_spec()
        points = MIN_POINTS if by_task else scenario.planner.points
        self.paths = paths or host_planning.path_shape(
            self._planner_spec, points, scenario.joint_names()
        )
        self._planners = host_planning.start_planners(self._planner_spec, self.paths, workers)
        self._policy_numbers: tuple[Policy, ...] = (
            () if policy is None else (self._replicate_policy(policy),)
        )
        setup = programs.ProgramSetup(
            scenario=scenario,
            tile=self.tile,
            mesh=self._mesh,
            kernels=self.kernels,
            paths=self.paths,
            planner=None if self._planners else self._planner_spec,
            policy=self._policy_numbers,
            has_user_code=has_policy or self._traces_planner() or scenario.has_user_code,
        )
        self._programs = programs.shared_programs(setup)
        numbers = setup.numbers()
        self._numbers = jax.device_put(numbers, NamedSharding(self._mesh, REPLICATED))
        self._currents = CurrentPadding(sampling_numbers(scenario), numbers, self._mesh)
        self.samples = self._programs.flight.samples
        self.steps_per_sample = self._programs.flight.steps_per_sample
        self._packed: tuple[jax.Array, jax.Array | None] | None = None

    def _traces_planner(self) -> bool:
        """Return whether planner code of a user is part of the programs."""
        if self.scenario.planner.replan_hz:
            reference = self.scenario.planner.planner_spec().reference
            return not (reference.is_built_in and reference.on_device)
        spec = self._planner_spec
        return spec is not None and self._planners is None and not spec.reference.is_built_in

    def _replicate_policy(self, policy: Policy) -> Policy:
        """Return a policy with its numbers as JAX arrays on every device."""
        numbers = jax.tree.map(
            lambda leaf: (
                leaf if isinstance(leaf, jax.Array) else np.asarray(leaf, jnp.result_type(leaf))
            ),
            policy,
        )
        sharded: Policy = jax.device_put(numbers, NamedSharding(self._mesh, REPLICATED))
        return sharded

    def _policy_arguments(self, policy: Policy | None) -> tuple[Policy, ...]:
        """Return last argument of programs: the simulator's policy, or one with other numbers."""
        if policy is None:
            return self._policy_numbers
        if not self._policy_numbers:
            raise ConfigError(
                f"policy {type(policy).__name__}: the simulator was made without one; "
                "give it to Simulator(scenario, policy=...)"
            )
        policies.require_alike(self._policy_numbers[0], policy)
        return (self._replicate_policy(policy),)

    @property
    def policy(self) -> Policy | None:
        """Return the policy that commands the robots."""
        return self._policy_numbers[0] if self._policy_numbers else None

    @property
    def fleet(self) -> Fleet:
        """Return compiled vehicles, constants of programs.

        Another fleet needs another simulator.
        """
        return self._programs.flight.fleet

    @property
    def spec(self) -> SimSpec:
        """Return the settings of the simulation, constants of its programs."""
        return self._programs.flight.spec

    @property
    def thrusters(self) -> int:
        """Number of thrusters of a robot, padding included."""
        return int(self.fleet.control.vehicle.B.shape[-1])

    @property
    def segment_steps(self) -> int:
        """Return the control steps of one segment."""
        return self.samples * self.steps_per_sample

    @property
    def segments(self) -> int:
        """Return the segments of the horizon."""
        return self.scenario.time.control_steps // self.segment_steps

    def variants(self) -> list[tuple[str, str]]:
        """Return vehicle and parameter set of each variant, in the order of ``World.variant``."""
        kinds = fleet.list_variants(self.scenario.members())
        return [(kind.vehicle, kind.parameter_set) for kind in kinds]

    def labels(self) -> list[tuple[str, str]]:
        """Return `variants` with labels for tables: the vehicle's name from its file."""
        variants = self.variants()
        names = library.label_vehicles(vehicle for vehicle, _ in variants)
        return [(names[vehicle], parameter_set) for vehicle, parameter_set in variants]

    def worlds(self, first: int = 0, *, seed: int | None = None) -> World:
        """Return worlds first, first + 1 and so on: sampled and planned.

        Args:
            first: global index of the first world.
            seed: seed; the scenario's if left out.

        Returns:
            World with [devices * tile] leading on every leaf.

        Raises:
            ConfigError: index or seed is not a whole number from 0 to 2**32 - 1.
        """
        return self.device_batch([first + i * self.tile for i in range(self.devices)], seed=seed)

    def device_batch(self, firsts: Sequence[int], *, seed: int | None = None) -> World:
        """Return worlds as `worlds`, from the first world of each device's tile.

        Args:
            firsts: global indices, one per device.
            seed: seed; the scenario's if left out.

        Raises:
            ConfigError: as `worlds`.
        """
        worlds, notes = self.finish(self.begin(firsts, seed=seed))
        host_planning.warn_of_failures(notes, firsts[0])
        return worlds

    @property
    def planner(self) -> PlannerSpec | None:
        """Return the planner; None where paths are inputs, or robots follow routes."""
        return self._planner_spec

    @property
    def hosted(self) -> bool:
        """Return whether worlds are planned by processes of the host."""
        return self._planners is not None

    def begin(
        self, firsts: Sequence[int], *, seed: int | None = None, counts: Sequence[int] | None = None
    ) -> SampledBatch:
        """Sample the worlds of a device batch, and submit their problems to host planners.

        Errors as of `device_batch`. `finish` returns the worlds; in between the device can simulate
        others.

        Args:
            firsts: as of `device_batch`.
            seed: as of `device_batch`.
            counts: number of used worlds of each tile; the host plans for no others.
        """
        run_seed = self.scenario.seed if seed is None else seed
        number = check_key_number("seed", run_seed)
        indices = [check_key_number("first", first) for first in firsts]
        # Placed as in `compile`: other placements are another program.
        numbers = jax.device_put(
            (number, np.asarray(indices, np.uint32)),
            (NamedSharding(self._mesh, REPLICATED), NamedSharding(self._mesh, SHARDED)),
        )
        worlds = self._sample(numbers)
        if self._planners is None:
            return SampledBatch(worlds=worlds)
        names = [
            self._problem_name(int(run_seed), first + i)
            for first in firsts
            for i in range(self.tile)
        ]
        problems = host_planning.split_problems(
            self._programs.problem(self._information)(self.fleet, worlds, *numbers), names
        )
        counts = [self.tile] * len(firsts) if counts is None else counts
        rows = [t * self.tile + i for t, count in enumerate(counts) for i in range(count)]
        return SampledBatch(
            worlds=worlds, tickets=self._planners.begin({i: problems[i] for i in rows})
        )

    def _sample(self, numbers: tuple[jax.Array, jax.Array]) -> World:
        """Sample worlds by a seed and the first world of each device, on their devices."""
        return self._currents.cut(self._programs.prepare(self.fleet, self._numbers, *numbers))

    def finish(self, sampled: SampledBatch) -> tuple[World, PlanNotes | None]:
        """Return the planned worlds of a sampled device batch.

        Returns:
            Worlds as of `device_batch`, and planning notes of a host planner.

        Raises:
            RunError: the planner cannot be created.
        """
        if self._planners is None:
            return sampled.worlds, None
        initial = jax.device_get(sampled.worlds.path)
        path, notes = host_planning.gather_paths(self._planners.finish(sampled.tickets), initial)
        return self.with_paths(sampled.worlds, path), notes

    def sample_problems(
        self, first: int = 0, *, seed: int | None = None, information: Information | None = None
    ) -> tuple[World, Problem]:
        """Return a device batch of worlds without plans, and its planning problems.

        Args:
            first: global index of the first world; each device has the same tile.
            seed: seed; the scenario's if left out.
            information: information levels; the scenario's if left out.

        Returns:
            Worlds, and problems with [devices * tile] leading.

        Raises:
            ConfigError: as `worlds`.
        """
        run_seed = self.scenario.seed if seed is None else seed
        number, index = check_key_number("seed", run_seed), check_key_number("first", first)
        numbers = jax.device_put(
            (number, np.full(self.devices, index, np.uint32)),
            (NamedSharding(self._mesh, REPLICATED), NamedSharding(self._mesh, SHARDED)),
        )
        worlds = self._sample(numbers)
        build = self._programs.problem(information or self._information)
        return worlds, build(self.fleet, worlds, *numbers)

    def problems(
        self,
        first: int = 0,
        count: int = 1,
        *,
        seed: int | None = None,
        information: Information | None = None,
    ) -> list[Problem]:
        """Return the planning problems of worlds first, first + 1 and so on, in arrays of NumPy.

        Args:
            first: global index of the first world.
            count: number of worlds, at most a tile.
            seed: seed; the scenario's if left out.
            information: as in `sample_problems`.

        Raises:
            ConfigError: as `worlds`.
        """
        if not 0 < count <= self.tile:
            raise ConfigError(f"count = {count}: must be 1 to {self.tile}, the worlds of a tile")
        batch = self.sample_problems(first, seed=seed, information=information)[1]
        return self.named(batch, first, count, seed=seed)

    def named(
        self, problems: Problem, first: int, count: int, *, seed: int | None = None
    ) -> list[Problem]:
        """Split problems of a batch and name each, as `problems` returns them.

        Args:
            problems: problems of `sample_problems`.
            first: index of the first world.
            count: number of worlds.
            seed: seed of their worlds; the scenario's if left out.
        """
        run_seed = int(self.scenario.seed if seed is None else seed)
        return host_planning.split_problems(
            problems, [self._problem_name(run_seed, first + i) for i in range(count)]
        )

    @property
    def _information(self) -> Information:
        return self.scenario.planner.information.to_information()

    def with_paths(self, worlds: World, path: Path) -> World:
        """Return worlds with other paths.

        Args:
            worlds: worlds of this simulator.
            path: arrays of NumPy or JAX, [devices * tile, robot] leading.

        Raises:
            ConfigError: the paths have another shape than the simulator's.
        """
        sharded = jax.device_put(path, NamedSharding(self._mesh, SHARDED))
        return replace_paths(worlds, sharded, self.scenario.planner.name, self.paths)

    def _problem_name(self, seed: int, world: int) -> ProblemName:
        return ProblemName(
            scenario=self.scenario.name,
            preset=self.scenario.world.preset,
            seed=seed,
            world=world,
            digest=self._digest,
        )

    @cached_property
    def _digest(self) -> str:
        """Return the digest of the scenario, cached: it takes half a millisecond."""
        return self.scenario.digest()

    def close(self) -> None:
        """End the planning processes, if any."""
        if self._planners is not None:
            self._planners.close()

    def adopt(self, worlds: World) -> World:
        """Return sampled worlds that `engine` may be given, checked.

        For worlds of another simulator or with edits, and for programs of one's own.

        Args:
            worlds: any number of worlds, leading.

        Raises:
            ConfigError: a robot cannot be its variant, or there is no code for the kind or motion
                of an obstacle.
        """
        check_worlds(self.fleet, worlds)
        return worlds.sampled if isinstance(worlds, FleetWorld) else worlds

    def add_parameters(self, worlds: World) -> FleetWorld:
        """Return worlds with the parameters of their robots.

        Args:
            worlds: [devices * tile] leading.

        Raises:
            ConfigError: as `adopt`.
        """
        equipped: FleetWorld = self._programs.flight.add_parameters(self.fleet, self.adopt(worlds))
        return equipped

    def _flight_worlds(self, worlds: World) -> World:
        """Return adopted worlds as the programs of flights take them."""
        return self._currents.pad(self.adopt(worlds))

    def _pack_cells(self, worlds: World) -> jax.Array | None:
        """Cells as the engine looks them up; those of the grid of the call before are kept."""
        occupied = worlds.environment.grid.occupied
        if self._packed is not None and self._packed[0] is occupied:
            return self._packed[1]
        packed: jax.Array | None = self._programs.flight.pack_cells(worlds)
        if isinstance(occupied, jax.Array) and not isinstance(occupied, jax.core.Tracer):
            self._packed = (occupied, packed)
        return packed

    @property
    def engine(self) -> engines.Engine:
        """Return the engine, for programs of the user (`angler_mjx.learning`)."""
        return self._programs.flight.engine

    def world_shape(self) -> World:
        """Return shapes and types of one tile of worlds, without computing any."""

        def of_tile(leaf: jax.ShapeDtypeStruct) -> jax.ShapeDtypeStruct:
            return jax.ShapeDtypeStruct((self.tile, *leaf.shape[1:]), leaf.dtype)

        cut = jax.eval_shape(self._currents.cut, self._programs.batch_shape)
        shapes: World = jax.tree.map(of_tile, cut)
        return shapes

    def reset(self, worlds: World, *, policy: Policy | None = None) -> WorldState:
        """Return the state of each world at t = 0.

        Args:
            worlds: from ``worlds``.
            policy: the simulator's policy with other numbers.

        Raises:
            ConfigError: as `adopt`, and in `step` and `segment`; no stage of the controllers takes
                what the policy commands, or it is made otherwise than the simulator's.
        """
        adopted, policy_arguments = self._flight_worlds(worlds), self._policy_arguments(policy)
        state: WorldState = self._programs.flight.reset(self.fleet, adopted, *policy_arguments)
        return state

    def step(
        self,
        worlds: World,
        state: WorldState,
        command: Command | MixedCommand | None = None,
        *,
        policy: Policy | None = None,
    ) -> tuple[WorldState, Sample]:
        """Advance the worlds by one control step.

        Args:
            worlds: from ``worlds``.
            state: from ``reset`` or the step before.
            command: to the controllers of all robots instead of their paths, [world, robot]
                leading; it enters at the first stage that takes its type. `MixedCommand` drives
                each robot by a command of another type. The policy is not called then.
            policy: the simulator's policy with other numbers.

        Returns:
            The next state, and the sample of the state before with its command.

        Raises:
            ConfigError: no stage of the controllers takes the command, an array of it does not have
                the shape for every robot of every world, or pulse widths in NumPy's arrays are
                outside the thrust table; or as `reset`.
        """
        if command is not None:
            self._check(command, state)
        adopted, policy_arguments = self._flight_worlds(worlds), self._policy_arguments(policy)
        after, sample = self._programs.flight.step(
            self.fleet, adopted, state, self._pack_cells(adopted), command, *policy_arguments
        )
        return after, sample

    def segment(
        self,
        worlds: World,
        state: WorldState,
        command: Command | None = None,
        *,
        policy: Policy | None = None,
    ) -> tuple[WorldState, Sample]:
        """Advance the worlds by ``segment_steps`` control steps; the state's memory is reused.

        Args:
            worlds: from ``worlds``.
            state: from ``reset``, or from the segment or step before.
            command: as for `step`; the same in all steps.
            policy: as for `step`.

        Returns:
            State after the segment, and samples [world, samples, ...].

        Raises:
            ConfigError: as `step`.
        """
        if command is None:
            if int(state.step[0]) % self.segment_steps == 0:
                after, sample, _ = self.advance(worlds, state, policy=policy)
                return after, sample
            adopted, policy_arguments = self._flight_worlds(worlds), self._policy_arguments(policy)
            after, sample, _ = self._programs.flight.segment_any_step(
                self.fleet, adopted, state, self._pack_cells(adopted), *policy_arguments
            )
            return after, sample
        self._check(command, state)
        adopted = self._flight_worlds(worlds)
        after, sample, _ = self._programs.flight.commanded(
            self.fleet, adopted, state, self._pack_cells(adopted), command
        )
        return after, sample

    def advance(
        self, worlds: World, state: WorldState, *, policy: Policy | None = None
    ) -> SegmentResult:
        """Advance as `segment`, and count the running robots of each world, int32 [world].

        The state is that of `reset` or of the segment before. The count is an array of its own: it
        can be read after the state was used up.
        """
        adopted, policy_arguments = self._flight_worlds(worlds), self._policy_arguments(policy)
        after, sample, running = self._programs.flight.segment(
            self.fleet, adopted, state, self._pack_cells(adopted), *policy_arguments
        )
        return after, sample, running

    def _check(self, command: Command | MixedCommand, state: WorldState) -> None:
        """Refuse commands that the controllers cannot take."""
        lead, thrusters = state.tally.outcome.shape, self.thrusters
        joints = len(joint_names(self.fleet.control.vehicle))
        for part in command.commands if isinstance(command, MixedCommand) else [command]:
            stack.check_command(self.spec.stages, part, lead, thrusters, joints)
        if isinstance(command, MixedCommand):  # unused elements of its commands hold any numbers
            command_checks.check_choice(command, lead, joints)
        else:
            command_checks.check_pulses(command)

    def compile(self) -> CompileTime:
        """Compile for this tile ahead of time; later calls use the compiled functions.

        Returns:
            Seconds of each program; zeros if they were returned before, also to another simulator
            that needs the same programs.

        Raises:
            RunError: the tile does not fit into device memory; the message names one that does.
        """
        return self._programs.compile()

    def compile_ahead(self) -> None:
        """Compile as `compile` does; its next call returns the seconds. Errors as of `compile`."""
        self._programs.compile_ahead()

    @property
    def programs(self) -> Programs:
        """Return compiled functions, which simulators of equal scenarios share."""
        return self._programs

    def explain(self, error: Exception) -> None:
        """Turn a device's out-of-memory error into one that names a fitting tile.

        Raises:
            RunError: the error is of that kind; others are ignored.
        """
        self._programs.explain(error)
