"""The phases of worlds: what goes on aboard the robots before their controllers act.

Plain arrays with robots leading, in every engine: filters and policies are matrix arithmetic, which
lanes have nothing to offer for. The fused engines run them between their own phases.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_mjx.acoustics.channel import Others
from angler_mjx.control import stack
from angler_mjx.physics.step import VehicleState
from angler_mjx.sim import hearing, knowledge, senses
from angler_mjx.sim import policy as policies
from angler_mjx.sim.fleet import Fleet, carrying
from angler_mjx.sim.knowledge import KnownObstacles, Observation
from angler_mjx.sim.phase import Done, Phase, Slots, nothing, run
from angler_mjx.sim.policy import Known, Policy
from angler_mjx.sim.record import Belief, Progress
from angler_mjx.sim.state import Outcome, SimSpec, World, WorldState
from angler_mjx.tasks import work as tasks
from angler_mjx.tasks.spec import TaskState
from angler_mjx.tasks.travel import Travel
from angler_mjx.tasks.work import Scene
from angler_mjx.world import currents
from angler_mjx.world.obstacles import ObstacleState


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Sent:
    """Where robots are to go, [R] leading."""

    goal_m: jax.Array
    """[R, 3] in W."""
    place: jax.Array | None
    """int32 [R] which place of the world's routes that is; -1: none, it stays."""


@dataclass(frozen=True, kw_only=True)
class Aboard:
    """Where phases of worlds are run: in plain arrays, [R] leading, in every engine."""

    spec: SimSpec
    policy: Policy | None
    world: World
    number: jax.Array
    """int32 [] control steps taken."""
    vehicles: VehicleState
    obstacles: ObstacleState | None = None
    """Now; None where no policy asks for them."""
    outcome: jax.Array | None = None
    """int32 [R] of the robots so far; None where there is no task."""
    fleet: Fleet | None = None
    """None where robots carry nothing."""

    @property
    def t(self) -> jax.Array:
        """[] s."""
        return self.number.astype(self.vehicles.p.dtype) * self.spec.control_dt_s

    @property
    def flow(self) -> jax.Array | None:
        """[R, 3] true current at the robots, m/s, in W; None where nobody wants it."""
        if self.policy is None and not stack.wants_flow(self.spec.stages):
            return None
        current = self.world.environment.current
        flow: jax.Array = jax.vmap(currents.velocity, (None, 0, None))(
            current, self.vehicles.p, self.t
        )
        return flow

    def known(
        self, belief: Belief | None, others: Others | None = None, sent: Sent | None = None
    ) -> Known:
        """What the robots know, for a policy.

        Args:
            belief: what they are told of their motion; None for the truth.
            others: what they have heard of each other; None where everybody knows everything.
            sent: where the task sends them; None where each has a goal of its own.
        """
        to = self._goals() if sent is None else sent
        return Known(
            belief=senses.truth_told(self.vehicles, self.flow) if belief is None else belief,
            time_s=self.t,
            goal_m=to.goal_m,
            path=self.world.path,
            params=self.world.control,
            others=others,
            routes=self.world.routes,
            place=to.place,
            **self._scenery(),
        )

    def _goals(self) -> Sent:
        """Each robot to its goal, which is its place of the routes too."""
        place = None
        if self.world.routes is not None:
            place = jnp.arange(self.world.variant.shape[0], dtype=jnp.int32)
        return Sent(goal_m=self.world.environment.goal_m, place=place)

    def _scenery(self) -> dict[str, Any]:
        """What a policy that asks for it is told of the world about the robots."""
        if self.policy is None or self.policy.knows is None:
            return {}
        if self.obstacles is None:
            raise RuntimeError("an engine does not say where obstacles are to a policy that asks")
        policy, knows = self.policy, self.policy.knows
        environment, water = self.world.environment, self.spec.water
        at_m, seen = (
            self.vehicles.p,
            Observation(time_s=self.t, obstacles=self.obstacles, at_m=self.vehicles.p),
        )

        def look() -> KnownObstacles:
            return knowledge.obstacles(
                environment,
                knows,
                policy.ahead_s,
                self.spec.control_dt_s,
                water.density_kgpm3,
                water.gravity_mps2,
                seen,
            )

        return {
            "grid": environment.grid,
            "floor_z_m": environment.floor_z_m,
            "obstacles": self._at_times(look, policy.looks),
            "current": knowledge.current(environment, knows.current, at_m, self.t),
        }

    def _at_times[T](self, look: Callable[[], T], every: int) -> T:
        """What is seen in every n-th control step, and zeros of its shapes in the others."""
        if every == 1:
            return look()
        shapes = jax.eval_shape(look)

        def nothing() -> T:
            zeros: T = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
            return zeros

        seen: T = jax.lax.cond(self.number % every == 0, look, nothing)
        return seen


def sense(here: Aboard, now: Slots) -> Done:
    """Instruments read the truth, filters take the readings in."""
    if not here.spec.instrumented:
        return Done(slots=nothing)
    memory, belief = senses.step(
        here.spec, here.world, now["senses"], here.number, here.vehicles, here.flow
    )
    return Done(
        slots=lambda: {"senses": memory, "known": belief}, record=lambda: {"belief": belief}
    )


def hear(here: Aboard, now: Slots) -> Done:
    """Robots understand packets of others, and send theirs."""
    shared, memory = here.spec.acoustics, now["radio"]
    if shared is None:
        return Done(slots=nothing)
    belief = now.get("known")
    say = partial(hearing.words, here.policy, now["policy"], now["task"], memory.air.said.words)
    told = here.vehicles if belief is None else belief
    after, came = hearing.step(
        shared, here.world, memory, here.number, here.t, here.vehicles.p, told, say
    )

    def record() -> dict[str, Any]:
        asked = "acoustics" in here.spec.also
        return {"talk": hearing.record(after, here.t)} if asked else {}

    return Done(slots=lambda: {"radio": after, "heard": came}, record=record)


def work(here: Aboard, now: Slots) -> Done:
    """The task: what was done of it, and where robots go next."""
    spec, task = here.spec.task, here.world.task
    if spec is None:
        return Done(slots=nothing)
    if here.outcome is None or task is None:
        raise RuntimeError("an engine does not say how robots ended, or a world has no task")
    known, outcome = now.get("known"), here.outcome
    scene = Scene(
        t=here.t,
        p=here.vehicles.p,
        q=here.vehicles.q,
        running=outcome == Outcome.RUNNING,
        believed_m=here.vehicles.p if known is None else known.p,
        grid=here.world.environment.grid,
        others=hearing.at_work(here.spec.acoustics, now["radio"], here.t),
    )
    travel = Travel(place_m=task.place_m, routes=here.world.routes)
    state: TaskState = jax.lax.cond(
        here.number % spec.period == 0,
        lambda: tasks.look(spec, task, now["task"], scene, travel),
        lambda: now["task"],
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


def record_task(state: TaskState) -> Progress:
    """What is recorded of `work`."""
    return Progress(
        share=state.progress,
        target=state.target,
        carrying=state.carrying,
        done=state.did,
    )


def choose(here: Aboard, now: Slots) -> Done:
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
    )
    return Done(slots=lambda: {"policy": memory, "command": command})


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
    gives=("policy", "command"),
)

PHASES = (SENSE, HEAR, WORK, POLICY)
"""In order."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Told:
    """What robots are told in a control step, [R] leading; None where nothing is."""

    known: Belief | None = None
    """Of their own motion."""
    command: Any = None
    """By a policy."""
    finished: jax.Array | None = None
    """bool [R] whose part of the task is done; None where each robot has a goal of its own."""
    loaded: jax.Array | None = None
    """bool [R] who carries a load; None where there are none."""
    record: dict[str, Any] = field(default_factory=dict)
    """Of the phases of worlds."""

    def given(self) -> dict[str, Any]:
        """What there is of it for the phases of robots, by the names of their slots."""
        return {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if field.name != "record" and getattr(self, field.name) is not None
        }


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Minds:
    """Memories of the phases of worlds; fields of `WorldState`."""

    senses: Any
    policy: Any
    task: Any
    radio: Any

    @classmethod
    def of(cls, state: WorldState) -> "Minds":
        """Those of a state."""
        return cls(senses=state.senses, policy=state.policy, task=state.task, radio=state.radio)


def asked(policy: Policy | None, command: Any) -> Policy | None:
    """The policy, where no command stands in for it; otherwise it keeps its memory."""
    return policy if command is None else None


def tells(spec: SimSpec, policy: Policy | None) -> bool:
    """Whether the phases of worlds have anything to do."""
    wanted = policy is not None or spec.by_task or spec.acoustics is not None
    return bool(spec.instrumented) or wanted


def period(spec: SimSpec, policy: Policy | None) -> int:
    """Control steps of which the phases of worlds act in none but the first, counted from t = 0.

    What they give holds in the others. A phase that is not known here acts in every step.
    """
    every = {
        SENSE.name: 1 if spec.instrumented else 0,
        HEAR.name: 0 if spec.acoustics is None else 1,
        WORK.name: 0 if spec.task is None else spec.task.period,
        POLICY.name: 0 if policy is None else policy.period,
    }
    return math.gcd(*(every.get(phase.name, 1) for phase in PHASES)) or 1


def watches(policy: Policy | None) -> bool:
    """Whether a policy asks where obstacles are."""
    return policy is not None and policy.knows is not None


def tell(
    spec: SimSpec,
    policy: Policy | None,
    world: World,
    minds: Minds,
    number: jax.Array,
    vehicles: VehicleState,
    obstacles: ObstacleState | None = None,
    outcome: jax.Array | None = None,
    *,
    fleet: Fleet | None = None,
) -> tuple[Minds, Told]:
    """The phases of one world.

    Args:
        spec: settings.
        policy: that commands the robots, if one does.
        world: constants.
        minds: memories.
        number: int32 [] control steps taken.
        vehicles: now, [R] leading.
        obstacles: now, [n] leading, where a policy asks (`watches`).
        outcome: int32 [R] of the robots so far, where there is a task.
        fleet: whose robots may carry loads; if left out they do not.
    """
    here = Aboard(
        spec=spec,
        policy=policy,
        world=world,
        number=number,
        vehicles=vehicles,
        obstacles=obstacles,
        outcome=outcome,
        fleet=fleet,
    )
    now, record = run(here, PHASES, vars(minds))
    after = Minds(**{name: now[name] for name in vars(minds)})
    told = Told(
        known=now.get("known"),
        command=now.get("command"),
        finished=now.get("finished"),
        loaded=now.get("loaded") if fleet is not None and fleet.carries else None,
        record=record,
    )
    return after, told


def tell_tile(
    spec: SimSpec,
    policy: Policy | None,
    worlds: World,
    minds: Minds,
    number: jax.Array,
    vehicles: VehicleState,
    obstacles: ObstacleState | None = None,
    outcome: jax.Array | None = None,
    *,
    fleet: Fleet | None = None,
) -> tuple[Minds, Told]:
    """As `tell` for worlds [W], all at step ``number`` [], or each at its own, [W]."""
    one = partial(tell, spec, policy, fleet=fleet)
    axes = (0, 0, 0 if number.ndim else None, 0, 0, 0)
    after: tuple[Minds, Told] = jax.vmap(one, axes)(
        worlds, minds, number, vehicles, obstacles, outcome
    )
    return after
