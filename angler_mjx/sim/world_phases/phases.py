"""The phases of worlds: what goes on aboard the robots before their controllers act.

Plain arrays with robots leading, in every engine: filters and policies are matrix arithmetic, which
lanes have nothing to offer for. The fused engines run them between their own phases.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import jax

from angler_mjx.periods import every_n_steps
from angler_mjx.sim import policy as policies
from angler_mjx.sim.approach import last_approaches_s
from angler_mjx.sim.fleet import apply_loads
from angler_mjx.sim.phase import Phase, PhaseResult, Slots, no_slots
from angler_mjx.sim.record import ProgressRecord
from angler_mjx.sim.state import Outcome
from angler_mjx.sim.world_phases import hearing, sensing
from angler_mjx.sim.world_phases.context import GoalAssignment, WorldContext
from angler_mjx.world.tasks import task_update as tasks
from angler_mjx.world.tasks.spec import TaskState
from angler_mjx.world.tasks.task_belief import TaskScene
from angler_mjx.world.tasks.travel import Travel


def sense_motion(context: WorldContext, now: Slots) -> PhaseResult:
    """Instruments read the truth, filters take the readings in."""
    if not context.spec.instrumented:
        return PhaseResult(slots=no_slots)
    memory, belief = sensing.step(
        context.spec, context.world, now["senses"], context.number, context.vehicles, context.flow
    )
    return PhaseResult(
        slots=lambda: {"senses": memory, "estimate": belief}, record=lambda: {"belief": belief}
    )


def exchange_packets(context: WorldContext, now: Slots) -> PhaseResult:
    """Robots understand packets of others, and send theirs."""
    shared, memory = context.spec.acoustics, now["modem"]
    if shared is None:
        return PhaseResult(slots=no_slots)
    belief = now.get("estimate")
    running = None if context.outcome is None else context.outcome == Outcome.RUNNING
    make_payload = partial(
        hearing.build_payload,
        context.policy,
        now["policy"],
        now["task"],
        memory.in_flight.packet.payload,
        running,
    )
    estimate = context.vehicles if belief is None else belief
    after, heard = hearing.step(
        shared,
        context.world,
        memory,
        context.number,
        context.t,
        context.vehicles.p,
        estimate,
        make_payload,
        context.every,
    )

    def record() -> dict[str, Any]:
        is_recorded = "acoustics" in context.spec.also
        return {"talk": hearing.record_acoustics(after, context.t)} if is_recorded else {}

    return PhaseResult(slots=lambda: {"modem": after, "heard": heard}, record=record)


def advance_task(context: WorldContext, now: Slots) -> PhaseResult:
    """The task: what was done of it, and where robots go next."""
    spec, task = context.spec.task, context.world.task
    if spec is None:
        return PhaseResult(slots=no_slots)
    if context.outcome is None or task is None:
        raise RuntimeError("an engine does not say how robots ended, or a world has no task")
    estimate, outcome = now.get("estimate"), context.outcome
    scene = TaskScene(
        t=context.t,
        p=context.vehicles.p,
        q=context.vehicles.q,
        running=outcome == Outcome.RUNNING,
        believed_m=context.vehicles.p if estimate is None else estimate.p,
        grid=context.world.environment.grid,
        others=hearing.working_robots(context.spec.acoustics, now["modem"], context.t),
    )
    travel = Travel(position_m=task.position_m, routes=context.world.routes)
    state: TaskState = every_n_steps(
        spec.period,
        context.number,
        lambda: tasks.update_task(spec, task, now["task"], scene, travel),
        lambda: now["task"],
        context.every,
    )
    return PhaseResult(
        slots=lambda: {
            "task": state,
            "sent": GoalAssignment(goal_m=state.goal_m, goal_index=state.target),
            "finished": state.finished,
            "loaded": state.carrying >= 0 if spec.kind == "deliver" else None,
        },
        record=lambda: {"task": record_task(state)},
    )


def record_task(state: TaskState) -> ProgressRecord:
    """What is recorded of `advance_task`."""
    return ProgressRecord(
        fraction=state.progress,
        target=state.target,
        carrying=state.carrying,
        done=state.did,
    )


def run_policy(context: WorldContext, now: Slots) -> PhaseResult:
    """A policy commands the robots of a world."""
    if context.policy is None:
        return PhaseResult(slots=no_slots)
    world = apply_loads(context.fleet, context.world, now.get("loaded"))
    memory, command = policies.step(
        context.policy,
        context.world.policy_key,
        now["policy"],
        lambda: replace(context, world=world).build_policy_input(
            now.get("estimate"), hearing.policy_reports(now["modem"]), now.get("sent")
        ),
        context.number,
        context.every,
    )
    approaching, begin_s = _find_approach(context, context.policy, memory.carry, command)
    return PhaseResult(
        slots=lambda: {
            "policy": memory,
            "command": command,
            "approaching": approaching,
            "last_approach_s": begin_s,
        }
    )


def _find_approach(
    context: WorldContext, policy: policies.Policy, carry: Any, command: Any
) -> tuple[jax.Array | None, jax.Array | None]:
    """Return whether robots are on their last approach, bool [R], or when that begins, [R] s."""
    executed = policy.executed_plans(carry, context.world.path)
    if executed is None:
        return None, last_approaches_s(context.spec, context.world, command)
    plan, time_s = executed
    begin_s = last_approaches_s(context.spec, context.world, plan)
    return None if begin_s is None else time_s >= begin_s, None


SENSE = Phase(
    name="sense", of="world", run=sense_motion, reads=("senses",), gives=("senses", "estimate")
)
HEAR = Phase(
    name="hear",
    of="world",
    run=exchange_packets,
    reads=("modem", "estimate", "policy", "task"),
    gives=("modem", "heard"),
)
WORK = Phase(
    name="work",
    of="world",
    run=advance_task,
    reads=("task", "estimate", "modem"),
    gives=("task", "sent", "finished", "loaded"),
)
POLICY = Phase(
    name="policy",
    of="world",
    run=run_policy,
    reads=("policy", "estimate", "modem", "sent"),
    gives=("policy", "command", "approaching", "last_approach_s"),
)

PHASES = (SENSE, HEAR, WORK, POLICY)
"""In order."""
