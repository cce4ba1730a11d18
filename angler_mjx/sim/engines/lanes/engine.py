"""The fused engine in plain JAX: one array for every field, robots x worlds, in one loop.

Same equations, discretisation and random numbers as the mjx engine, with the closed form of a
rigid body in place of MJX. Lanes are [R, W] for robots, [n_obstacle, W] for obstacles and [W] for
worlds, so the worlds lie side by side in memory.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels import lanes
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.stack import Command, ControlParams
from angler_mjx.sim import sample_clearances, start
from angler_mjx.sim.approach import last_approaches_s
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.engines.lanes import pairs
from angler_mjx.sim.engines.lanes.layout import (
    GroupConstants,
    LaneRobots,
    LaneScene,
    LaneState,
    apply_load,
    broadcast_lanes,
    concatenate_groups,
    lane_state_of,
    lanes_of_group,
    of_group,
    outcome_of,
    scene_of,
    to_arrays,
    to_lanes,
    vehicles_of,
    world_state,
)
from angler_mjx.sim.engines.lanes.steps import Cells, GridShape, LaneContext
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.phase import Phase, Slots, run_phases
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import EngineConstants, SimSpec, World, WorldState
from angler_mjx.sim.step import (
    INDEPENDENT_PHASES,
    INTERACTION_PHASES,
    LATER_SLOTS,
    OBSTACLES,
    PERSISTENT_SLOTS,
)
from angler_mjx.sim.step_repetition import repeat_steps
from angler_mjx.sim.world_phases import running
from angler_mjx.sim.world_phases.running import WorldMemory, WorldPhaseOutput
from angler_mjx.world.currents import Current
from angler_mjx.world.obstacles import Obstacles, ObstacleState


class FusedEngine:
    """Closed-form rigid bodies on lanes, in plain JAX."""

    def reset(
        self, spec: SimSpec, fleet: Fleet, worlds: World, policy: Policy | None = None
    ) -> WorldState:
        """See `Engine.reset`."""
        engine = ClosedForm(gravity_mps2=spec.water.gravity_mps2)
        reset_world = partial(start.reset, spec, engine, policy=policy)
        state: WorldState = jax.vmap(reset_world)(worlds.control.vehicle, worlds)
        return state

    def pack_constants(self, fleet: Fleet, worlds: World) -> EngineConstants:
        """See `Engine.pack_constants`: nothing."""
        del fleet, worlds
        return ()

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
    ) -> tuple[WorldState, Sample]:
        """See `Engine.control_step`."""
        if steps > 1:
            step_once = partial(
                self.control_step, spec, fleet, worlds, command=command, policy=policy, rows=rows
            )
            return repeat_steps(step_once, state, steps)
        scene = scene_of(fleet, worlds, rows)
        number = state.step[0] if rows is None else state.step
        policy = running.active_policy(policy, command)
        memory, output = WorldMemory.of(state), WorldPhaseOutput()
        if running.has_world_phases(spec, policy):
            row_worlds = worlds if rows is None else jax.tree.map(lambda leaf: leaf[rows], worlds)
            memory, output = running.run_tile_phases(
                spec,
                policy,
                row_worlds,
                memory,
                number,
                state.vehicles,
                state.obstacles,
                state.tally.outcome,
                fleet=fleet,
            )
        moving = lane_state_of(fleet, state)
        stepped_worlds = worlds if rows is None else jax.tree.map(lambda leaf: leaf[rows], worlds)
        begin_s = output.last_approach_s
        if policy is None:
            begin_s = jax.vmap(partial(last_approaches_s, spec))(stepped_worlds, command)
        after, seen = _control_step(spec, scene, moving, number, command, output, begin_s)
        sample = Sample(**output.record, **to_arrays(seen, 2))
        sample = sample_clearances.add_clearances(spec, stepped_worlds, sample)
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
    ) -> tuple[WorldState, Sample]:
        """See `Engine.segment`."""
        del begins
        scene, policy = scene_of(fleet, worlds), running.active_policy(policy, command)
        row, rebuild = lanes.flatten(lane_state_of(fleet, state))
        rebuilds: list[Any] = []
        begin_s = None
        if policy is None:
            begin_s = jax.vmap(partial(last_approaches_s, spec))(worlds, command)

        @jax.jit  # traced once, for the types of its results and for the loop
        def fly(
            row: list[jax.Array], memory: WorldMemory, number: jax.Array
        ) -> tuple[Any, Any, Any]:
            moving, output = rebuild(row), WorldPhaseOutput()
            if running.has_world_phases(spec, policy):
                vehicles = vehicles_of(moving)
                bodies = (
                    to_arrays(moving.obstacles, 2) if running.observes_obstacles(policy) else None
                )
                ended = outcome_of(moving) if spec.by_task else None
                memory, output = running.run_tile_phases(
                    spec, policy, worlds, memory, number, vehicles, bodies, ended, fleet=fleet
                )
            after, sample = _control_step(spec, scene, moving, number, command, output, begin_s)
            now, again = lanes.flatten(sample)
            rebuilds.append(again)
            both = zip(lanes.flatten(after)[0], row, strict=True)
            return [lanes.broadcast_like(x, old) for x, old in both], memory, (now, output.record)

        initial_memory = WorldMemory.of(state)
        template = jax.eval_shape(fly, row, initial_memory, state.step[0])[2]
        empty_sample = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), template)

        def step_once(carry: Any, i: jax.Array) -> tuple[Any, None]:
            row, memory, kept, number = carry
            row, memory, now = fly(row, memory, number)
            kept = jax.tree.map(lambda new, old: jnp.where(i == 0, new, old), now, kept)
            return (row, memory, kept, number + 1), None

        def record_sample(carry: Any, _: None) -> tuple[Any, Any]:
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
        samples = Sample(**record, **to_arrays(rebuilds[0](kept), 3))
        return after, sample_clearances.add_all_clearances(spec, worlds, samples)


@dataclass(frozen=True, kw_only=True)
class SceneContext(LaneContext):
    """Obstacles of all worlds of a scene; see `phase.BatchContext`."""

    spec: SimSpec
    scene: LaneScene
    t: jax.Array
    shape: GridShape
    _flows: list[tuple[VehicleState, Any]] = field(default_factory=list, init=False)

    @property
    def current(self) -> Current:
        """See `LaneContext`."""
        return self.scene.current

    @property
    def cells(self) -> Cells:
        """See `LaneContext`."""
        return self.scene.cells

    @property
    def obstacles(self) -> Obstacles:
        """See `LaneContext`."""
        return self.scene.obstacles

    def flow(self, vehicle: VehicleState) -> Any:
        """See `phase.BatchContext`."""
        for cached_vehicle, flow in self._flows:  # controllers and the record ask for the same
            if cached_vehicle is vehicle:
                return flow
        self._flows.append((vehicle, super().flow(vehicle)))
        return self._flows[-1][1]


@dataclass(frozen=True, kw_only=True)
class GroupPhases(SceneContext):
    """Robots of a group, of all worlds."""

    constants: GroupConstants
    override_command: Any = None
    """Instead of their paths."""
    finished: Any = None
    """See `phase.BatchContext`."""
    loaded: Any = None
    """bool [] who carries a load; None where nobody can."""
    last_approach_s: Any = None
    """See `phase.BatchContext`."""
    approaching: Any = None
    """See `phase.BatchContext`."""
    nearest_contact: Contact | None = None
    """The nearest thing to each robot of the group, when all have moved."""

    @cached_property
    def params(self) -> ControlParams:
        """See `phase.BatchContext`."""
        light, laden = self.constants.params, self.constants.laden
        if self.loaded is None or laden is None:
            return light
        return apply_load(self.loaded, laden, light)

    @property
    def command(self) -> Any:
        """See `phase.BatchContext`."""
        if self.override_command is not None:
            return self.override_command
        return plans.check_plan(self.spec.stages, self.constants.path)

    @property
    def goal_m(self) -> Any:
        """See `phase.BatchContext`."""
        return self.constants.goal_m

    @property
    def fails_at_s(self) -> Any:
        """See `phase.BatchContext`."""
        return self.constants.fails_at_s

    def contact(self, now: Slots) -> Contact:
        """See `phase.BatchContext`."""
        if self.nearest_contact is None:
            raise RuntimeError("a phase that meets others began before they had moved")
        return self.nearest_contact


def _control_step(
    spec: SimSpec,
    scene: LaneScene,
    moving: LaneState,
    number: jax.Array,
    command: Command | None,
    output: WorldPhaseOutput,
    begin_s: jax.Array | None,
) -> tuple[LaneState, dict[str, Any]]:
    """One control step of all worlds, and its part of the sample.

    ``number`` is that of all worlds, or [W] of each; ``command`` [W, R, ...] stands in for the
    paths, and for the policy's; ``output`` [W, R, ...] is what the phases of worlds gave;
    ``begin_s`` [W, R] when the last approaches of plans begin.
    """
    like = moving.groups[0].vehicle.p[0]
    t = jnp.asarray(number, like.dtype) * spec.control_dt_s
    context_fields: dict[str, Any] = {"spec": spec, "scene": scene, "t": t, "shape": scene.shape}
    active_command = output.command if command is None else command
    groups, records = [], []
    for constants, robots in zip(scene.groups, moving.groups, strict=True):
        make = partial(GroupPhases, **context_fields, constants=constants)
        with jax.named_scope("robots"):
            now, record = lanes.compute_shared(
                partial(_run_independent, make, robots, active_command, output)
            )
        groups.append(now)
        records.append(record)
    sample = concatenate_groups(records)
    obstacles, seen = _advance_obstacles(SceneContext(**context_fields), moving.obstacles)
    sample |= seen
    met = lanes.compute_shared(partial(pairs.find_contact, scene, groups, obstacles))
    after, records = [], []
    for constants, now in zip(scene.groups, groups, strict=True):
        context = GroupPhases(
            **context_fields,
            constants=constants,
            override_command=None
            if begin_s is None
            else to_lanes(of_group(active_command, constants.group), 2),
            last_approach_s=to_lanes(of_group(begin_s, constants.group), 2),
            approaching=to_lanes(of_group(output.approaching, constants.group), 2),
            finished=to_lanes(of_group(output.finished, constants.group), 2),
            nearest_contact=lanes_of_group(met, constants.group),
        )
        judged, record = lanes.compute_shared(partial(_run_group, context, INTERACTION_PHASES, now))
        after.append(LaneRobots(**{name: judged[name] for name in PERSISTENT_SLOTS}))
        records.append(record)
    sample |= concatenate_groups(records)
    return LaneState(groups=tuple(after), obstacles=obstacles), sample


def _run_independent(
    make: Callable[..., GroupPhases],
    robots: LaneRobots,
    command: Command | None,
    output: WorldPhaseOutput,
) -> tuple[Any, Any]:
    """What the robots of a group do by themselves.

    ``command`` and ``output`` [W, R, ...] are their commands, and what the phases of worlds gave.
    """
    group = make().constants.group
    command, estimate, loaded = (
        to_lanes(of_group(x, group), 2) for x in (command, output.estimate, output.loaded)
    )
    slots = {**vars(robots), "estimate": robots.vehicle if estimate is None else estimate}
    return _run_group(make(override_command=command, loaded=loaded), INDEPENDENT_PHASES, slots)


def _run_group(context: GroupPhases, phases: tuple[Phase, ...], slots: Slots) -> tuple[Any, Any]:
    """Phases of a group: the slots that anybody reads after them, and the record."""
    now, record = run_phases(context, phases, slots)
    like = slots["vehicle"].p[0]
    # What a controller sets to a number is one number for all lanes.
    now["memory"], record = jax.tree.map(
        lambda leaf: broadcast_lanes(leaf, like), (now["memory"], record)
    )
    return {name: now[name] for name in LATER_SLOTS if name in now}, record


def _advance_obstacles(
    context: SceneContext, obstacles: ObstacleState
) -> tuple[ObstacleState, Any]:
    """The obstacles after a step, and their record; rows of padding stay where they are."""
    slots = {"obstacles": obstacles}
    if context.scene.n_obstacle == 0:
        return obstacles, OBSTACLES.run(context, slots).record()
    now, record = lanes.compute_shared(partial(run_phases, context, (OBSTACLES,), slots))
    return now["obstacles"], record
