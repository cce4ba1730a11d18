"""A scenario made runnable: worlds from indices, and the compiled reset, step and segment.

Its compiled functions are those of `angler_mjx.runs.simulator.programs`. Every call works on one
tile a device: a fixed number of worlds with consecutive global indices, so a run of any size
compiles once, and the same tile on the same kind of device gives the same bytes wherever it stands
in a run and however many devices there are.
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
from angler_mjx.runs.simulator import compile_cache, host_planning, programs, scenario_policy
from angler_mjx.runs.simulator import devices as on_devices
from angler_mjx.runs.simulator.compilation import CompileTime
from angler_mjx.runs.simulator.devices import REPLICATED, SHARDED
from angler_mjx.runs.simulator.host_planning import PlanNotes, SampledBatch
from angler_mjx.runs.simulator.programs import Programs, SegmentResult
from angler_mjx.runs.simulator.world_preparation import check_key_number, replace_paths
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim import fleet
from angler_mjx.sim import policy as policies
from angler_mjx.sim.engines import base as engines
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import SimSpec, World, WorldState
from angler_mjx.sim.validate_worlds import WorldValidator

DEFAULT_TILE = {"cpu": 128, "gpu": 4096}
"""Worlds in one device call where the scenario does not say: measured in docs/validation.md."""


def default_tile(worlds: int) -> int:
    """Tile for a run of ``worlds`` on the default device: never more than the run holds."""
    return min(worlds, DEFAULT_TILE.get(jax.default_backend(), DEFAULT_TILE["cpu"]))


MIN_POINTS = 2
"""Of paths that nobody flies."""


class Simulator:
    """Compiled simulation of one scenario, in device batches: one tile of worlds on each device.

    With one device, a device batch is a tile. Every leaf that a method gives or takes has [devices
    * tile] worlds leading, spread over the devices.

    Attributes:
        scenario: what is simulated.
        tile: worlds of one device in one call.
        devices: number of devices.
        samples: stored samples in one segment.
        steps_per_sample: control steps from one to the next.
        paths: what the robots' paths are like.
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
        """Read the vehicles and put the functions together; nothing is compiled yet.

        Args:
            scenario: what to simulate.
            tile: worlds in one call; the scenario's, or else the device's default.
            devices: devices to spread tiles over; all of this process if None.
            policy: that commands the robots in every control step, instead of their paths.
            workers: processes that plan, where the planner is one of the host; one for each
                processor if left out. Changes no byte of the results.
            paths: what those that `replace_paths` will give are like, where no planner is to be
                asked.

        Raises:
            ConfigError: a vehicle file has faults, the fleet does not fit the world's cells, or
                there are fewer devices.
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
        if self.kernels == "triton" and jax.default_backend() != "gpu":
            raise ConfigError(
                'kernels = "triton": needs an NVIDIA GPU, and JAX computes on '
                f'{jax.default_backend()} here; use kernels = "xla"'
            )
        by_task = scenario.task_spec() is not None
        # Where robots have one place after another to go to, nobody plans a way to one goal.
        is_unplanned = paths is not None or by_task
        self._planner_spec = None if is_unplanned else scenario.planner.planner_spec()
        points = MIN_POINTS if by_task else scenario.planner.points
        self.paths = paths or host_planning.path_shape(self._planner_spec, points)
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
            has_user_code=has_policy or self._traces_planner(),
        )
        self._programs = programs.shared_programs(setup)
        self.samples = self._programs.samples
        self.steps_per_sample = self._programs.steps_per_sample
        self._validator = WorldValidator(
            self.fleet, take=self._programs.take, pack=self._programs.pack
        )

    def _traces_planner(self) -> bool:
        """Whether code of a planner of somebody else is a part of the programs."""
        if self.scenario.planner.replan_hz:
            return not self.scenario.planner.planner_spec().reference.on_device
        spec = self._planner_spec
        return spec is not None and self._planners is None and not spec.reference.on_device

    def _replicate_policy(self, policy: Policy) -> Policy:
        """A policy with its numbers, as arrays of JAX's types, on every device."""
        numbers = jax.tree.map(
            lambda leaf: (
                leaf if isinstance(leaf, jax.Array) else np.asarray(leaf, jnp.result_type(leaf))
            ),
            policy,
        )
        sharded: Policy = jax.device_put(numbers, NamedSharding(self._mesh, REPLICATED))
        return sharded

    def _policy_arguments(self, policy: Policy | None) -> tuple[Policy, ...]:
        """The last argument of the programs: the simulator's policy, or one with other numbers."""
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
        """That commands the robots."""
        return self._policy_numbers[0] if self._policy_numbers else None

    @property
    def fleet(self) -> Fleet:
        """Compiled vehicles; programs hold their numbers, so another fleet is another simulator."""
        return self._programs.fleet

    @property
    def spec(self) -> SimSpec:
        """Settings of the simulation, which its programs hold."""
        return self._programs.spec

    @property
    def segment_steps(self) -> int:
        """Control steps in one segment."""
        return self.samples * self.steps_per_sample

    @property
    def segments(self) -> int:
        """Segments in the horizon."""
        return self.scenario.time.control_steps // self.segment_steps

    def variants(self) -> list[tuple[str, str]]:
        """Vehicle and parameter set of each variant, in the order of ``World.variant``."""
        kinds = fleet.list_variants(self.scenario.members())
        return [(kind.vehicle, kind.parameter_set) for kind in kinds]

    def labels(self) -> list[tuple[str, str]]:
        """As `variants`, for tables: a vehicle is called what its file says, wherever that lies."""
        variants = self.variants()
        names = library.label_vehicles(vehicle for vehicle, _ in variants)
        return [(names[vehicle], parameter_set) for vehicle, parameter_set in variants]

    def worlds(self, first: int = 0, *, seed: int | None = None) -> World:
        """Worlds first, first + 1 and on: drawn, furnished and planned.

        Args:
            first: global index of the first world.
            seed: instead of the scenario's.

        Returns:
            World with [devices * tile] leading on every leaf.

        Raises:
            ConfigError: index or seed is no whole number from 0 to 2**32 - 1.
        """
        return self.device_batch([first + i * self.tile for i in range(self.devices)], seed=seed)

    def device_batch(self, firsts: Sequence[int], *, seed: int | None = None) -> World:
        """As `worlds`, with the first world of each device's tile given on its own.

        Args:
            firsts: global indices, one a device.
            seed: instead of the scenario's.

        Raises:
            ConfigError: as `worlds`.
        """
        worlds, notes = self.finish(self.begin(firsts, seed=seed))
        host_planning.warn_of_failures(notes, firsts[0])
        return worlds

    @property
    def planner(self) -> PlannerSpec | None:
        """That plans; None where paths are given, or robots go from place to place."""
        return self._planner_spec

    @property
    def hosted(self) -> bool:
        """Whether worlds are planned by processes of the host."""
        return self._planners is not None

    def begin(
        self, firsts: Sequence[int], *, seed: int | None = None, counts: Sequence[int] | None = None
    ) -> SampledBatch:
        """Sample the worlds of a device batch, and hand their problems to planners on the host.

        Errors as of `device_batch`. `finish` returns the worlds; in between the device can fly
        others.

        Args:
            firsts: as of `device_batch`.
            seed: as of `device_batch`.
            counts: number of worlds of each tile that count; the host plans for no others.
        """
        run_seed = self.scenario.seed if seed is None else seed
        number = check_key_number("seed", run_seed)
        indices = [check_key_number("first", first) for first in firsts]
        # Put in their places, as `compile` says they are: otherwise it is another program.
        numbers = jax.device_put(
            (number, np.asarray(indices, np.uint32)),
            (NamedSharding(self._mesh, REPLICATED), NamedSharding(self._mesh, SHARDED)),
        )
        worlds = self._validator.accept_sampled(self._programs.prepare(self.fleet, *numbers))
        if self._planners is None:
            return SampledBatch(worlds=worlds)
        names = [
            self._problem_name(int(run_seed), first + i)
            for first in firsts
            for i in range(self.tile)
        ]
        problems = host_planning.split_problems(
            self._programs.problem(self._information)(worlds, *numbers), names
        )
        counts = [self.tile] * len(firsts) if counts is None else counts
        rows = [t * self.tile + i for t, count in enumerate(counts) for i in range(count)]
        return SampledBatch(
            worlds=worlds, tickets=self._planners.begin({i: problems[i] for i in rows})
        )

    def finish(self, sampled: SampledBatch) -> tuple[World, PlanNotes | None]:
        """The worlds of a device batch that was begun, planned.

        Returns:
            As `device batch`, and how they were planned, where that was not on the device.

        Raises:
            RunError: the planner cannot be made.
        """
        if self._planners is None:
            return sampled.worlds, None
        initial = jax.device_get(sampled.worlds.path)
        path, notes = host_planning.gather_paths(self._planners.finish(sampled.tickets), initial)
        return self.with_paths(sampled.worlds, path), notes

    def sample_problems(
        self, first: int = 0, *, seed: int | None = None, information: Information | None = None
    ) -> tuple[World, Problem]:
        """A device batch of worlds that nobody has planned, and what a planner is asked in them.

        Args:
            first: global index of the first world; each device has the same tile.
            seed: instead of the scenario's.
            information: what may be known; instead of what the scenario says.

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
        worlds = self._validator.accept_sampled(self._programs.prepare(self.fleet, *numbers))
        return worlds, self._programs.problem(information or self._information)(worlds, *numbers)

    def problems(
        self,
        first: int = 0,
        count: int = 1,
        *,
        seed: int | None = None,
        information: Information | None = None,
    ) -> list[Problem]:
        """What a planner is asked in worlds first, first + 1 and on, in arrays of NumPy.

        Args:
            first: global index of the first world.
            count: how many, at most a tile.
            seed: instead of the scenario's.
            information: as in `asked`.

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
        """Problems of a batch as `problems` gives them, one by one, each with its name.

        Args:
            problems: of `asked`.
            first: index of the first.
            count: how many of them.
            seed: of their worlds; the scenario's if left out.
        """
        run_seed = int(self.scenario.seed if seed is None else seed)
        return host_planning.split_problems(
            problems, [self._problem_name(run_seed, first + i) for i in range(count)]
        )

    @property
    def _information(self) -> Information:
        return self.scenario.planner.information.to_information()

    def with_paths(self, worlds: World, path: Path) -> World:
        """Worlds whose robots are told other paths.

        Args:
            worlds: of this simulator.
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
        """Of the scenario: half a millisecond to make, and the same for all worlds."""
        return self.scenario.digest()

    def close(self) -> None:
        """End the processes that plan, where there are any."""
        if self._planners is not None:
            self._planners.close()

    def adopt(self, worlds: World) -> World:
        """Worlds with the parameters that this simulator's fleet gives to their variants.

        For worlds that another simulator drew, or whose ``variant`` was edited.

        Args:
            worlds: [devices * tile] leading.

        Raises:
            ConfigError: a robot cannot be its variant.
        """
        return self._validator.adopt(worlds)

    def validate_worlds(self, worlds: World) -> World:
        """Worlds as programs of one's own may give them to `engine`: checked, cells packed.

        Args:
            worlds: any number of them, leading.

        Raises:
            ConfigError: as `reset`.
        """
        return self._validator.validate_worlds(worlds)

    @property
    def engine(self) -> engines.Engine:
        """What advances the worlds, for programs of one's own (`angler_mjx.learning`)."""
        return self._programs.engine

    def world_shape(self) -> World:
        """Shapes and types of one tile of worlds, without computing any."""

        def of_tile(leaf: jax.ShapeDtypeStruct) -> jax.ShapeDtypeStruct:
            return jax.ShapeDtypeStruct((self.tile, *leaf.shape[1:]), leaf.dtype)

        shapes: World = jax.tree.map(of_tile, self._programs.batch_shape)
        return shapes

    def reset(self, worlds: World, *, policy: Policy | None = None) -> WorldState:
        """State of each world at t = 0.

        Args:
            worlds: from ``worlds``.
            policy: the simulator's with other numbers in it.

        Raises:
            ConfigError: the worlds hold what the engine would not see
                (`angler_mjx.sim.validate_worlds`), as in `step` and `segment`; no stage of the
                controllers takes what the policy commands, or it is made otherwise than the
                simulator's.
        """
        validated, policy_arguments = (
            self._validator.validate_worlds(worlds),
            self._policy_arguments(policy),
        )
        state: WorldState = self._programs.reset(self.fleet, validated, *policy_arguments)
        return state

    def step(
        self,
        worlds: World,
        state: WorldState,
        command: Command | MixedCommand | None = None,
        *,
        policy: Policy | None = None,
    ) -> tuple[WorldState, Sample]:
        """One control step.

        Args:
            worlds: from ``worlds``.
            state: from ``reset`` or the step before.
            command: to the controllers of all robots instead of their paths, [world, robot]
                leading; it enters at the first stage that takes its type. `MixedCommand` drives
                each robot by a command of another type. A policy is not asked then.
            policy: the simulator's with other numbers in it.

        Returns:
            The next state, and the sample of the state before with its command.

        Raises:
            ConfigError: no stage of the controllers takes the command, an array of it has another
                shape than every robot of every world wants, or pulse widths in NumPy's arrays are
                outside the thrust table; or as `reset`.
        """
        if command is not None:
            self._check(command, worlds, state)
        validated = self._validator.validate_worlds(worlds)
        policy_arguments = self._policy_arguments(policy)
        after, sample = self._programs.step(
            self.fleet, validated, state, command, *policy_arguments
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
        """``segment_steps`` control steps; the given state's memory is used up.

        Args:
            worlds: from ``worlds``.
            state: from ``reset``, or from the segment or step before.
            command: as for `step`; the same in all steps.
            policy: as for `step`.

        Returns:
            The state after them, and samples [world, samples, ...].

        Raises:
            ConfigError: as `step`.
        """
        if command is None:
            if int(state.step[0]) % self.segment_steps == 0:
                after, sample, _ = self.advance(worlds, state, policy=policy)
                return after, sample
            validated, policy_arguments = (
                self._validator.validate_worlds(worlds),
                self._policy_arguments(policy),
            )
            after, sample, _ = self._programs.segment_any_step(
                self.fleet, validated, state, *policy_arguments
            )
            return after, sample
        self._check(command, worlds, state)
        validated = self._validator.validate_worlds(worlds)
        after, sample, _ = self._programs.commanded(self.fleet, validated, state, command)
        return after, sample

    def advance(
        self, worlds: World, state: WorldState, *, policy: Policy | None = None
    ) -> SegmentResult:
        """As `segment`, and int32 [world]: how many robots of each are still on their way.

        The state is of `reset` or of the segment before: of whole segments.
        The count is an array of its own: it can be read after the state was used up.
        """
        validated, policy_arguments = (
            self._validator.validate_worlds(worlds),
            self._policy_arguments(policy),
        )
        after, sample, running = self._programs.segment(
            self.fleet, validated, state, *policy_arguments
        )
        return after, sample, running

    def _check(self, command: Command | MixedCommand, worlds: World, state: WorldState) -> None:
        """Refuse commands that the controllers cannot be given."""
        lead, thrusters = state.tally.outcome.shape, worlds.control.vehicle.B.shape[-1]
        for part in command.commands if isinstance(command, MixedCommand) else [command]:
            stack.check_command(self.spec.stages, part, lead, thrusters)
        if isinstance(command, MixedCommand):  # of its commands some hold any numbers
            command_checks.check_choice(command, lead)
        else:
            command_checks.check_pulses(command)

    def compile(self) -> CompileTime:
        """Compile for this tile ahead of time; later calls use the compiled functions.

        Returns:
            Seconds of each program; zeros if it was done before, also by another simulator that
            needs the same programs.

        Raises:
            RunError: the tile does not fit into device memory; says which one does.
        """
        return self._programs.compile()

    @property
    def programs(self) -> Programs:
        """Compiled functions, which simulators of equal scenarios share."""
        return self._programs

    def explain(self, error: Exception) -> None:
        """Turn a device's error for want of memory into one that says which tile would fit.

        Raises:
            RunError: it is one of those; others are left as they are.
        """
        self._programs.explain(error)
