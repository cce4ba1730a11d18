"""The phases of worlds: what goes on aboard the robots before their controllers act.

Plain arrays with robots leading, in every engine: filters and policies are matrix arithmetic, which
lanes have nothing to offer for. The fused engines run them between their own phases.
"""

import math
from dataclasses import dataclass, field, fields, replace
from functools import partial

import jax

from angler_mjx.periods import every_n_steps
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import Command
from angler_mjx.sim import hearing, sensing
from angler_mjx.sim import policy as policies
from angler_mjx.sim.approach import last_approaches_s
from angler_mjx.sim.fleet import Fleet, apply_loads
from angler_mjx.sim.physics.contact.grips import Grips
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.policy import Policy, PolicyMemory
from angler_mjx.sim.record import Belief, ProgressRecord, WorldRecord
from angler_mjx.sim.state import FleetWorld, Outcome, SensingMemory, SimSpec, WorldState
from angler_mjx.sim.world_context import GoalAssignment, WorldContext
from angler_mjx.world.acoustics.channel import ModemState
from angler_mjx.world.obstacles import ObstacleState
from angler_mjx.world.tasks import task_update as tasks
from angler_mjx.world.tasks.spec import TaskState
from angler_mjx.world.tasks.task_belief import TaskScene
from angler_mjx.world.tasks.travel import Travel

type SensingMemories = tuple[SensingMemory | None, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldMemory:
    """Memories of the phases of worlds; fields of `WorldState`."""

    senses: SensingMemories
    policy: PolicyMemory | None
    task: TaskState | None
    modem: ModemState | None

    @classmethod
    def of(cls, state: WorldState) -> "WorldMemory":
        """Return those of a state."""
        return cls(senses=state.senses, policy=state.policy, task=state.task, modem=state.modem)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldPhaseOutput:
    """Output of the phases of worlds for the robots, [R] leading; None where there is none."""

    estimate: Belief | None = None
    """Of their own motion."""
    command: Command | MixedCommand | None = None
    """By a policy."""
    finished: jax.Array | None = None
    """bool [R] whose part of the task is done; None where each robot has a goal of its own."""
    loaded: jax.Array | None = None
    """bool [R] who carries a load; None where there are none."""
    approaching: jax.Array | None = None
    """bool [R] who is on the last approach of a plan that a policy keeps; None where none does."""
    last_approach_s: jax.Array | None = None
    """[R] s, of `last_approaches_s` of a policy's command."""
    record: WorldRecord = field(default_factory=WorldRecord)

    def to_slots(self) -> dict[str, object]:
        """Return what there is of it by field, without the record."""
        return {
            entry.name: getattr(self, entry.name)
            for entry in fields(self)
            if entry.name != "record" and getattr(self, entry.name) is not None
        }


@dataclass(frozen=True, kw_only=True)
class TaskOutput:
    """Output of the task of a world, [R] leading; None where there is no task."""

    state: TaskState | None = None
    assignment: GoalAssignment | None = None
    finished: jax.Array | None = None
    """bool [R]."""
    loaded: jax.Array | None = None
    """bool [R]; None where nothing is carried."""
    record: ProgressRecord | None = None


@dataclass(frozen=True, kw_only=True)
class PolicyOutput:
    """Output of the policy of a world, [R] leading; None where there is no policy."""

    memory: PolicyMemory | None
    command: Command | MixedCommand | None = None
    approaching: jax.Array | None = None
    last_approach_s: jax.Array | None = None


def sense_motion(
    context: WorldContext, senses: SensingMemories
) -> tuple[SensingMemories, Belief | None]:
    """Read the instruments and filter the readings; None where all robots know the truth."""
    if not context.spec.instrumented:
        return senses, None
    return sensing.step(
        context.spec, context.world, senses, context.number, context.vehicles, context.flow
    )


def exchange_packets(
    context: WorldContext, memory: WorldMemory, estimate: Belief | None
) -> ModemState | None:
    """Receive packets of other robots, and send the robots' own."""
    shared, modem = context.spec.acoustics, memory.modem
    if shared is None or modem is None:
        return modem
    running = None if context.outcome is None else context.outcome == Outcome.RUNNING
    make_payload = partial(
        hearing.build_payload,
        context.policy,
        memory.policy,
        memory.task,
        modem.in_flight.packet.payload,
        running,
    )
    after, _ = hearing.step(
        shared,
        context.world,
        modem,
        context.number,
        context.t,
        context.vehicles.p,
        context.vehicles if estimate is None else estimate,
        make_payload,
        context.every,
    )
    return after


def advance_task(
    context: WorldContext,
    state: TaskState | None,
    modem: ModemState | None,
    estimate: Belief | None,
) -> TaskOutput:
    """Account for the task, and assign the robots' next goals."""
    spec, task = context.spec.task, context.world.task
    if spec is None:
        return TaskOutput(state=state)
    if context.outcome is None or task is None or state is None:
        raise RuntimeError("an engine does not say how robots ended, or a world has no task")
    before = state
    scene = TaskScene(
        t=context.t,
        p=context.vehicles.p,
        q=context.vehicles.q,
        running=context.outcome == Outcome.RUNNING,
        believed_m=context.vehicles.p if estimate is None else estimate.p,
        grid=context.world.environment.grid,
        others=hearing.working_robots(context.spec.acoustics, modem, context.t),
    )
    travel = Travel(position_m=task.position_m, routes=context.world.routes)
    after: TaskState = every_n_steps(
        spec.period,
        context.number,
        lambda: tasks.update_task(spec, task, before, scene, travel),
        lambda: before,
        context.every,
    )
    return TaskOutput(
        state=after,
        assignment=GoalAssignment(goal_m=after.goal_m, goal_index=after.target),
        finished=after.finished,
        loaded=after.carrying >= 0 if spec.kind == "deliver" else None,
        record=record_task(after),
    )


def record_task(state: TaskState) -> ProgressRecord:
    """Return the record of `advance_task`."""
    return ProgressRecord(
        fraction=state.progress,
        target=state.target,
        carrying=state.carrying,
        done=state.did,
    )


def run_policy(
    context: WorldContext,
    memory: PolicyMemory | None,
    modem: ModemState | None,
    estimate: Belief | None,
    task: TaskOutput,
) -> PolicyOutput:
    """Have the policy command the robots of a world."""
    if context.policy is None:
        return PolicyOutput(memory=memory)
    if memory is None:
        raise RuntimeError("the state was begun without the policy")
    world = apply_loads(context.fleet, context.world, task.loaded)
    after, command = policies.step(
        context.policy,
        context.world.policy_key,
        memory,
        lambda: replace(context, world=world).build_policy_input(
            estimate, hearing.policy_reports(modem), task.assignment
        ),
        context.number,
        context.every,
    )
    approaching, begin_s = _find_approach(context, context.policy, after.carry, command)
    return PolicyOutput(
        memory=after, command=command, approaching=approaching, last_approach_s=begin_s
    )


def _find_approach(
    context: WorldContext, policy: Policy, carry: object, command: Command | MixedCommand
) -> tuple[jax.Array | None, jax.Array | None]:
    """Return whether robots are on their last approach, bool [R], or when that begins, [R] s."""
    executed = policy.executed_plans(carry, context.world.path)
    if executed is None:
        return None, last_approaches_s(context.spec, context.world, command)
    plan, time_s = executed
    begin_s = last_approaches_s(context.spec, context.world, plan)
    return None if begin_s is None else time_s >= begin_s, None


def active_policy(policy: Policy | None, command: object) -> Policy | None:
    """The policy, where no command stands in for it; otherwise it keeps its memory."""
    return policy if command is None else None


def has_world_phases(spec: SimSpec, policy: Policy | None) -> bool:
    """Whether the phases of worlds have anything to do."""
    wanted = policy is not None or spec.by_task or spec.acoustics is not None
    return bool(spec.instrumented) or wanted


def phase_period(spec: SimSpec, policy: Policy | None) -> int:
    """Control steps of which the phases of worlds act in none but the first, counted from t = 0.

    What they give holds in the others.
    """
    sensing_period = 1 if spec.instrumented else 0
    task_period = 0 if spec.task is None else spec.task.period
    policy_period = 0 if policy is None else policy.period
    return math.gcd(sensing_period, _hearing_period(spec), task_period, policy_period) or 1


def _hearing_period(spec: SimSpec) -> int:
    """As `phase_period`, of what robots hear: every step where it is recorded."""
    if spec.acoustics is None:
        return 0
    return 1 if "acoustics" in spec.also else spec.acoustics.access.period


def observes_obstacles(policy: Policy | None) -> bool:
    """Whether a policy asks where obstacles are."""
    return policy is not None and policy.information is not None


def run_world_phases(
    spec: SimSpec,
    policy: Policy | None,
    world: FleetWorld,
    memory: WorldMemory,
    number: jax.Array,
    vehicles: VehicleState,
    obstacles: ObstacleState | None = None,
    outcome: jax.Array | None = None,
    *,
    fleet: Fleet | None = None,
    grips: Grips | None = None,
    every: int = 1,
) -> tuple[WorldMemory, WorldPhaseOutput]:
    """The phases of one world.

    Args:
        spec: settings.
        policy: that commands the robots, if one does.
        world: constants.
        memory: memories.
        number: int32 [] control steps taken.
        vehicles: now, [R] leading.
        obstacles: now, [n] leading, where a policy asks (`observes_obstacles`).
        outcome: int32 [R] of the robots so far, where there is a task.
        fleet: whose robots may carry loads; if left out they do not.
        grips: of the robots now; None where they hold nothing together.
        every: ``number`` is a multiple of it.
    """
    context = WorldContext(
        spec=spec,
        policy=policy,
        world=world,
        number=number,
        vehicles=vehicles,
        obstacles=obstacles,
        outcome=outcome,
        fleet=fleet,
        grips=grips,
        every=every,
    )
    talk = None
    with jax.named_scope("sense"):
        senses, estimate = sense_motion(context, memory.senses)
    with jax.named_scope("hear"):
        modem = exchange_packets(context, memory, estimate)
        if modem is not None and "acoustics" in spec.also:
            talk = hearing.record_acoustics(modem, context.t)
    with jax.named_scope("work"):
        task = advance_task(context, memory.task, modem, estimate)
    with jax.named_scope("policy"):
        driven = run_policy(context, memory.policy, modem, estimate, task)
    after = WorldMemory(senses=senses, policy=driven.memory, task=task.state, modem=modem)
    return after, WorldPhaseOutput(
        estimate=estimate,
        command=driven.command,
        finished=task.finished,
        loaded=task.loaded if fleet is not None and fleet.can_carry else None,
        approaching=driven.approaching,
        last_approach_s=driven.last_approach_s,
        record=WorldRecord(belief=estimate, talk=talk, task=task.record),
    )


def run_tile_phases(
    spec: SimSpec,
    policy: Policy | None,
    worlds: FleetWorld,
    memory: WorldMemory,
    number: jax.Array,
    vehicles: VehicleState,
    obstacles: ObstacleState | None = None,
    outcome: jax.Array | None = None,
    *,
    fleet: Fleet | None = None,
    every: int = 1,
) -> tuple[WorldMemory, WorldPhaseOutput]:
    """As `run_world_phases` for worlds [W], all at step ``number`` [], or each at its own, [W]."""
    run_world = partial(run_world_phases, spec, policy, fleet=fleet, every=every)
    axes = (0, 0, 0 if number.ndim else None, 0, 0, 0)
    return jax.vmap(run_world, axes)(worlds, memory, number, vehicles, obstacles, outcome)
