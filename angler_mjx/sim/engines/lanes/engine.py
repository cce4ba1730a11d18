"""The fused engine in plain JAX: one array for every field, robots x worlds, in one loop.

Same equations, discretisation and random numbers as the mjx engine, with the closed form of a
rigid body in place of MJX. Lanes are [R, W] for robots, [n_obstacle, W] for obstacles and [W] for
worlds, so the worlds lie side by side in memory.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_kernels import lanes
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.stack import Command
from angler_mjx.sim import sample_clearances, start
from angler_mjx.sim import world_phases as running
from angler_mjx.sim.approach import last_approaches_s
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.engines.lanes import pairs
from angler_mjx.sim.engines.lanes.layout import (
    GroupConstants,
    LaneScene,
    LaneState,
    apply_load,
    broadcast_lanes,
    concatenate_groups,
    lane_state_of,
    lanes_of_group,
    of_group,
    outcome_of,
    pack_cells,
    scene_of,
    to_arrays,
    to_lanes,
    vehicles_of,
    world_state,
)
from angler_mjx.sim.engines.lanes.steps import Cells, GridShape, LaneBatch, refuse_joints
from angler_mjx.sim.fleet import Fleet, add_parameters
from angler_mjx.sim.phase import Record, run_phase
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.record import Sample, WorldRecord, build_sample
from angler_mjx.sim.state import EngineConstants, SimSpec, World, WorldState
from angler_mjx.sim.step import (
    JUDGE,
    OBSTACLES,
    JudgeInput,
    Judgement,
    MovedRobots,
    PlanApproach,
    RobotState,
    move_independently,
)
from angler_mjx.sim.step_repetition import repeat_steps
from angler_mjx.sim.unpacked_states import UnpackedStates
from angler_mjx.sim.world_phases import WorldMemory, WorldPhaseOutput
from angler_mjx.world.currents import Current
from angler_mjx.world.obstacles import Obstacles, ObstacleState

type _SampleRow = tuple[list[jax.Array], WorldRecord]
"""A sample: lanes of what robots and obstacles recorded, and the record of the phases of worlds."""


class FusedEngine(UnpackedStates):
    """Closed-form rigid bodies on lanes, in plain JAX."""

    def reset(
        self, spec: SimSpec, fleet: Fleet, worlds: World, policy: Policy | None = None
    ) -> WorldState:
        """See `Engine.reset`; rigid vehicles only."""
        refuse_joints(fleet.control.vehicle)
        engine = ClosedForm(gravity_mps2=spec.water.gravity_mps2)
        reset_world = partial(start.reset, spec, engine, policy=policy)
        equipped = add_parameters(fleet, worlds)
        return jax.vmap(reset_world)(equipped.control.vehicle, equipped)

    def pack_constants(self, fleet: Fleet, worlds: World) -> EngineConstants:
        """See `Engine.pack_constants`: the cells."""
        del fleet
        return (pack_cells(worlds),)

    def pack_cells(self, worlds: World) -> jax.Array:
        """See `Engine.pack_cells`."""
        return pack_cells(worlds)

    def control_step(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        command: Command | None,
        policy: Policy | None = None,
        rows: jax.Array | None = None,
        constants: EngineConstants = (),
        steps: int = 1,
        cells: jax.Array | None = None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.control_step`."""
        if constants:
            (cells,) = constants
        if steps > 1:
            step_once = partial(
                self.control_step,
                spec,
                fleet,
                worlds,
                command=command,
                policy=policy,
                rows=rows,
                cells=cells,
            )
            return repeat_steps(step_once, state, steps)
        scene = scene_of(fleet, worlds, rows, cells)
        number = state.step[0] if rows is None else state.step
        policy = running.active_policy(policy, command)
        memory, output = WorldMemory.of(state), WorldPhaseOutput()
        row_worlds = worlds if rows is None else jax.tree.map(lambda leaf: leaf[rows], worlds)
        equipped = add_parameters(fleet, row_worlds)
        if running.has_world_phases(spec, policy):
            memory, output = running.run_tile_phases(
                spec,
                policy,
                equipped,
                memory,
                number,
                state.vehicles,
                state.obstacles,
                state.tally.outcome,
                fleet=fleet,
            )
        moving = lane_state_of(fleet, state)
        begin_s = output.last_approach_s
        if policy is None:
            begin_s = jax.vmap(partial(last_approaches_s, spec))(row_worlds, command)
        after, seen = _control_step(spec, scene, moving, number, command, output, begin_s)
        sample = build_sample(output.record, to_arrays(seen, 2))
        sample = sample_clearances.add_clearances(spec, equipped, sample)
        return world_state(after, state.step + 1, memory), sample

    def segment(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        *,
        n_sample: int,
        steps_per_sample: int,
        command: Command | None = None,
        policy: Policy | None = None,
        begins: int = 1,
        cells: jax.Array | None = None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.segment`."""
        del begins
        scene, equipped = scene_of(fleet, worlds, cells=cells), add_parameters(fleet, worlds)
        policy = running.active_policy(policy, command)
        row, rebuild = lanes.flatten(lane_state_of(fleet, state))
        rebuilds: list[Callable[[Sequence[jax.Array]], Record]] = []
        begin_s = None
        if policy is None:
            begin_s = jax.vmap(partial(last_approaches_s, spec))(worlds, command)

        @jax.jit  # traced once, for the types of its results and for the loop
        def fly(
            row: list[jax.Array], memory: WorldMemory, number: jax.Array
        ) -> tuple[list[jax.Array], WorldMemory, _SampleRow]:
            moving, output = rebuild(row), WorldPhaseOutput()
            if running.has_world_phases(spec, policy):
                vehicles = vehicles_of(moving)
                bodies = (
                    to_arrays(moving.obstacles, 2) if running.observes_obstacles(policy) else None
                )
                ended = outcome_of(moving) if spec.by_task else None
                memory, output = running.run_tile_phases(
                    spec, policy, equipped, memory, number, vehicles, bodies, ended, fleet=fleet
                )
            after, sample = _control_step(spec, scene, moving, number, command, output, begin_s)
            now, again = lanes.flatten(sample)
            rebuilds.append(again)
            both = zip(lanes.flatten(after)[0], row, strict=True)
            return [lanes.broadcast_like(x, old) for x, old in both], memory, (now, output.record)

        initial_memory = WorldMemory.of(state)
        template = jax.eval_shape(fly, row, initial_memory, state.step[0])[2]
        empty_sample = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), template)

        def step_once(
            carry: tuple[list[jax.Array], WorldMemory, _SampleRow, jax.Array], i: jax.Array
        ) -> tuple[tuple[list[jax.Array], WorldMemory, _SampleRow, jax.Array], None]:
            row, memory, kept, number = carry
            row, memory, now = fly(row, memory, number)
            kept = jax.tree.map(lambda new, old: jnp.where(i == 0, new, old), now, kept)
            return (row, memory, kept, number + 1), None

        def record_sample(
            carry: tuple[list[jax.Array], WorldMemory, jax.Array], _: None
        ) -> tuple[tuple[list[jax.Array], WorldMemory, jax.Array], _SampleRow]:
            row, memory, number = carry
            (row, memory, kept, number), _ = jax.lax.scan(
                step_once, (row, memory, empty_sample, number), jnp.arange(steps_per_sample)
            )
            return (row, memory, number), kept

        (row, memory, _), (kept, record) = jax.lax.scan(
            record_sample, (row, initial_memory, state.step[0]), length=n_sample
        )
        after = world_state(rebuild(row), state.step + n_sample * steps_per_sample, memory)
        record = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), record)
        samples = build_sample(record, to_arrays(rebuilds[0](kept), 3))
        return after, sample_clearances.add_all_clearances(spec, equipped, samples)


@dataclass(frozen=True, kw_only=True)
class SceneBatch(LaneBatch):
    """Bodies of all worlds of a scene; see `phase.BodyBatch`."""

    spec: SimSpec
    scene: LaneScene
    t: jax.Array
    shape: GridShape
    _flows: list[tuple[VehicleState, jax.Array]] = field(default_factory=list, init=False)

    @property
    def current(self) -> Current:
        """See `LaneBatch`."""
        return self.scene.current

    @property
    def cells(self) -> Cells:
        """See `LaneBatch`."""
        return self.scene.cells

    @property
    def obstacles(self) -> Obstacles:
        """See `LaneBatch`."""
        return self.scene.obstacles

    def flow(self, current: Current, vehicle: VehicleState) -> jax.Array:
        """See `phase.BodyBatch`."""
        for cached_vehicle, flow in self._flows:  # controllers and the record ask for the same
            if cached_vehicle is vehicle:
                return flow
        self._flows.append((vehicle, super().flow(current, vehicle)))
        return self._flows[-1][1]


def _control_step(
    spec: SimSpec,
    scene: LaneScene,
    moving: LaneState,
    number: jax.Array,
    command: Command | None,
    output: WorldPhaseOutput,
    begin_s: jax.Array | None,
) -> tuple[LaneState, Record]:
    """Return all worlds after a control step, and its part of the sample.

    ``number`` is that of all worlds, or [W] of each; ``command`` [W, R, ...] stands in for the
    paths, and for the policy's; ``output`` [W, R, ...] is that of the phases of worlds; ``begin_s``
    [W, R] when the last approaches of plans begin.
    """
    like = moving.groups[0].vehicle.p[0]
    t = jnp.asarray(number, like.dtype) * spec.control_dt_s
    make = partial(SceneBatch, spec=spec, scene=scene, t=t, shape=scene.shape)
    driver = output.command if command is None else command
    groups, records = [], []
    for constants, robots in zip(scene.groups, moving.groups, strict=True):
        with jax.named_scope("robots"):
            now, record = lanes.compute_shared(
                partial(_move_group, make(), constants, robots, driver, output)
            )
        groups.append(now)
        records.append(record)
    sample: Record = concatenate_groups(records)
    obstacles, seen = _advance_obstacles(make(), moving.obstacles)
    sample |= seen
    met = lanes.compute_shared(partial(pairs.find_contact, scene, groups, obstacles))
    after = []
    for constants, now in zip(scene.groups, groups, strict=True):
        contact = lanes_of_group(met, constants.group)
        judged = lanes.compute_shared(
            partial(_judge_group, make(), constants, now, contact, driver, output, begin_s)
        )
        after.append(RobotState(vehicle=now.vehicle, memory=now.memory, tally=judged.tally))
    return LaneState(groups=tuple(after), obstacles=obstacles), sample


def _select_driver(
    spec: SimSpec, constants: GroupConstants, command: Command | MixedCommand | None
) -> Plan | Command | MixedCommand:
    """Return the command of the robots of a group as lanes, or else their paths."""
    override = to_lanes(of_group(command, constants.group), 2)
    return plans.check_plan(spec.stages, constants.path) if override is None else override


def _move_group(
    batch: SceneBatch,
    constants: GroupConstants,
    robots: RobotState,
    command: Command | MixedCommand | None,
    output: WorldPhaseOutput,
) -> tuple[MovedRobots, Record]:
    """Move the robots of a group, each by itself.

    ``command`` and ``output`` [W, R, ...] are their commands, and that of the phases of worlds.
    """
    loaded = to_lanes(of_group(output.loaded, constants.group), 2)
    estimate = to_lanes(of_group(output.estimate, constants.group), 2)
    params = constants.params
    if loaded is not None and constants.laden is not None:
        params = apply_load(loaded, constants.laden, params)
    moved, record = move_independently(
        batch,
        robots,
        robots.vehicle if estimate is None else estimate,
        params,
        _select_driver(batch.spec, constants, command),
        batch.current,
    )
    like = robots.vehicle.p[0]
    # What a controller sets to a number is one number for all lanes.
    memory, record = jax.tree.map(lambda leaf: broadcast_lanes(leaf, like), (moved.memory, record))
    return replace(moved, memory=memory), record


def _judge_group(
    batch: SceneBatch,
    constants: GroupConstants,
    moved: MovedRobots,
    contact: Contact,
    command: Command | MixedCommand | None,
    output: WorldPhaseOutput,
    begin_s: jax.Array | None,
) -> Judgement:
    """Account for the step of the robots of a group; ``begin_s`` as in `_control_step`."""
    finished, approaching, begins = (
        to_lanes(of_group(x, constants.group), 2)
        for x in (output.finished, output.approaching, begin_s)
    )
    approach: PlanApproach | jax.Array | None = approaching
    if begins is not None:
        plan = _select_driver(batch.spec, constants, command)
        approach = PlanApproach(plan=plan, begin_s=begins)
    inputs = JudgeInput(
        **vars(moved),
        goal_m=constants.goal_m,
        contact=contact,
        finished=finished,
        fails_at_s=constants.fails_at_s,
        approach=approach,
        corners=(batch.cells.lo, batch.cells.hi),
    )
    return run_phase(JUDGE, batch, inputs)[0]


def _advance_obstacles(batch: SceneBatch, obstacles: ObstacleState) -> tuple[ObstacleState, Record]:
    """Return the obstacles after a step, and their record; rows of padding stay where they are."""
    if batch.scene.n_obstacle == 0:
        return obstacles, OBSTACLES.run(batch, obstacles).record()
    return lanes.compute_shared(partial(run_phase, OBSTACLES, batch, obstacles))
