"""What engines ask of the phases of worlds: whether, when, and what they tell the robots."""

import math
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import jax

from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.phase import run_phases
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import SimSpec, World, WorldState
from angler_mjx.sim.world_phases.context import WorldContext
from angler_mjx.sim.world_phases.phases import HEAR, PHASES, POLICY, SENSE, WORK
from angler_mjx.world.obstacles import ObstacleState


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldPhaseOutput:
    """What robots are told in a control step, [R] leading; None where nothing is."""

    estimate: Belief | None = None
    """Of their own motion."""
    command: Any = None
    """By a policy."""
    finished: jax.Array | None = None
    """bool [R] whose part of the task is done; None where each robot has a goal of its own."""
    loaded: jax.Array | None = None
    """bool [R] who carries a load; None where there are none."""
    approaching: jax.Array | None = None
    """bool [R] who is on the last approach of a plan that a policy keeps; None where none does."""
    last_approach_s: jax.Array | None = None
    """[R] s, of `last_approaches_s` of a policy's command."""
    record: dict[str, Any] = field(default_factory=dict)
    """Of the phases of worlds."""

    def to_slots(self) -> dict[str, Any]:
        """What there is of it for the phases of robots, by the names of their slots."""
        return {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if field.name != "record" and getattr(self, field.name) is not None
        }


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldMemory:
    """Memories of the phases of worlds; fields of `WorldState`."""

    senses: Any
    policy: Any
    task: Any
    modem: Any

    @classmethod
    def of(cls, state: WorldState) -> "WorldMemory":
        """Those of a state."""
        return cls(senses=state.senses, policy=state.policy, task=state.task, modem=state.modem)


def active_policy(policy: Policy | None, command: Any) -> Policy | None:
    """The policy, where no command stands in for it; otherwise it keeps its memory."""
    return policy if command is None else None


def has_world_phases(spec: SimSpec, policy: Policy | None) -> bool:
    """Whether the phases of worlds have anything to do."""
    wanted = policy is not None or spec.by_task or spec.acoustics is not None
    return bool(spec.instrumented) or wanted


def phase_period(spec: SimSpec, policy: Policy | None) -> int:
    """Control steps of which the phases of worlds act in none but the first, counted from t = 0.

    What they give holds in the others. A phase that is not known here acts in every step.
    """
    every = {
        SENSE.name: 1 if spec.instrumented else 0,
        HEAR.name: _hearing_period(spec),
        WORK.name: 0 if spec.task is None else spec.task.period,
        POLICY.name: 0 if policy is None else policy.period,
    }
    return math.gcd(*(every.get(phase.name, 1) for phase in PHASES)) or 1


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
    world: World,
    memory: WorldMemory,
    number: jax.Array,
    vehicles: VehicleState,
    obstacles: ObstacleState | None = None,
    outcome: jax.Array | None = None,
    *,
    fleet: Fleet | None = None,
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
        every=every,
    )
    now, record = run_phases(context, PHASES, vars(memory))
    after = WorldMemory(**{name: now[name] for name in vars(memory)})
    output = WorldPhaseOutput(
        estimate=now.get("estimate"),
        command=now.get("command"),
        finished=now.get("finished"),
        loaded=now.get("loaded") if fleet is not None and fleet.can_carry else None,
        approaching=now.get("approaching"),
        last_approach_s=now.get("last_approach_s"),
        record=record,
    )
    return after, output


def run_tile_phases(
    spec: SimSpec,
    policy: Policy | None,
    worlds: World,
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
    after: tuple[WorldMemory, WorldPhaseOutput] = jax.vmap(run_world, axes)(
        worlds, memory, number, vehicles, obstacles, outcome
    )
    return after
