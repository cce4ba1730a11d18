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
from angler_mjx.sim.fleet import carrying
from angler_mjx.sim.phase import Done, Phase, Slots, nothing
from angler_mjx.sim.record import ProgressRecord
from angler_mjx.sim.state import Outcome
from angler_mjx.sim.world_phases import hearing, sensing
from angler_mjx.sim.world_phases.context import Sent, WorldContext
from angler_mjx.world.tasks import work as tasks
from angler_mjx.world.tasks.spec import TaskState
from angler_mjx.world.tasks.task_belief import TaskScene
from angler_mjx.world.tasks.travel import Travel


def sense(here: WorldContext, now: Slots) -> Done:
    """Instruments read the truth, filters take the readings in."""
    if not here.spec.instrumented:
        return Done(slots=nothing)
    memory, belief = sensing.step(
        here.spec, here.world, now["senses"], here.number, here.vehicles, here.flow
    )
    return Done(
        slots=lambda: {"senses": memory, "known": belief}, record=lambda: {"belief": belief}
    )


def hear(here: WorldContext, now: Slots) -> Done:
    """Robots understand packets of others, and send theirs."""
    shared, memory = here.spec.acoustics, now["radio"]
    if shared is None:
        return Done(slots=nothing)
    belief = now.get("known")
    running = None if here.outcome is None else here.outcome == Outcome.RUNNING
    say = partial(
        hearing.words, here.policy, now["policy"], now["task"], memory.air.said.words, running
    )
    told = here.vehicles if belief is None else belief
    after, came = hearing.step(
        shared, here.world, memory, here.number, here.t, here.vehicles.p, told, say, here.every
    )

    def record() -> dict[str, Any]:
        asked = "acoustics" in here.spec.also
        return {"talk": hearing.record(after, here.t)} if asked else {}

    return Done(slots=lambda: {"radio": after, "heard": came}, record=record)


def work(here: WorldContext, now: Slots) -> Done:
    """The task: what was done of it, and where robots go next."""
    spec, task = here.spec.task, here.world.task
    if spec is None:
        return Done(slots=nothing)
    if here.outcome is None or task is None:
        raise RuntimeError("an engine does not say how robots ended, or a world has no task")
    known, outcome = now.get("known"), here.outcome
    scene = TaskScene(
        t=here.t,
        p=here.vehicles.p,
        q=here.vehicles.q,
        running=outcome == Outcome.RUNNING,
        believed_m=here.vehicles.p if known is None else known.p,
        grid=here.world.environment.grid,
        others=hearing.at_work(here.spec.acoustics, now["radio"], here.t),
    )
    travel = Travel(place_m=task.place_m, routes=here.world.routes)
    state: TaskState = every_n_steps(
        spec.period,
        here.number,
        lambda: tasks.look(spec, task, now["task"], scene, travel),
        lambda: now["task"],
        here.every,
    )
    return Done(
        slots=lambda: {
            "task": state,
            "sent": Sent(goal_m=state.goal_m, place=state.target),
            "finished": state.finished,
            "loaded": state.carrying >= 0 if spec.kind == "deliver" else None,
        },
        record=lambda: {"task": record_task(state)},
    )


def record_task(state: TaskState) -> ProgressRecord:
    """What is recorded of `work`."""
    return ProgressRecord(
        share=state.progress,
        target=state.target,
        carrying=state.carrying,
        done=state.did,
    )


def choose(here: WorldContext, now: Slots) -> Done:
    """A policy commands the robots of a world."""
    if here.policy is None:
        return Done(slots=nothing)
    world = carrying(here.fleet, here.world, now.get("loaded"))
    memory, command = policies.step(
        here.policy,
        here.world.policy_key,
        now["policy"],
        lambda: replace(here, world=world).known(
            now.get("known"), hearing.for_policy(now["radio"]), now.get("sent")
        ),
        here.number,
        here.every,
    )
    approaching, begin_s = _approach(here, here.policy, memory.carry, command)
    return Done(
        slots=lambda: {
            "policy": memory,
            "command": command,
            "approaching": approaching,
            "last_approach_s": begin_s,
        }
    )


def _approach(
    here: WorldContext, policy: policies.Policy, carry: Any, command: Any
) -> tuple[jax.Array | None, jax.Array | None]:
    """Return whether robots are on their last approach, bool [R], or when that begins, [R] s."""
    flown = policy.flown(carry, here.world.path)
    if flown is None:
        return None, last_approaches_s(here.spec, here.world, command)
    plan, time_s = flown
    begin_s = last_approaches_s(here.spec, here.world, plan)
    return None if begin_s is None else time_s >= begin_s, None


SENSE = Phase(name="sense", of="world", run=sense, reads=("senses",), gives=("senses", "known"))
HEAR = Phase(
    name="hear",
    of="world",
    run=hear,
    reads=("radio", "known", "policy", "task"),
    gives=("radio", "heard"),
)
WORK = Phase(
    name="work",
    of="world",
    run=work,
    reads=("task", "known", "radio"),
    gives=("task", "sent", "finished", "loaded"),
)
POLICY = Phase(
    name="policy",
    of="world",
    run=choose,
    reads=("policy", "known", "radio", "sent"),
    gives=("policy", "command", "approaching", "last_approach_s"),
)

PHASES = (SENSE, HEAR, WORK, POLICY)
"""In order."""
