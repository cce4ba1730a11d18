"""MuJoCo MJX: multibody models, the phases of one world, and one ``vmap`` over worlds."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_mjx.errors import UnsupportedError
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.stack import Command, ControlParams
from angler_mjx.sim import sample_clearances, start
from angler_mjx.sim.approach import last_approaches_s
from angler_mjx.sim.detection import Contact, detect_contacts
from angler_mjx.sim.fleet import Fleet, apply_loads
from angler_mjx.sim.phase import Slots, run_phases
from angler_mjx.sim.physics import mjx_engine
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.step import Multibody, VehicleState
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import EngineConstants, SimSpec, World, WorldState
from angler_mjx.sim.step import INDEPENDENT_PHASES, INTERACTION_PHASES, OBSTACLES
from angler_mjx.sim.step_repetition import repeat_steps
from angler_mjx.sim.world_phases import running
from angler_mjx.sim.world_phases.running import WorldMemory, WorldPhaseOutput
from angler_mjx.world import currents
from angler_mjx.world import obstacles as obstacle_motion
from angler_mjx.world.currents import Current
from angler_mjx.world.environment import region_corners
from angler_mjx.world.obstacles import ObstacleState


@dataclass(frozen=True, kw_only=True)
class SingleWorld:
    """Robots [R] and obstacles [n] of one world, as phases want them; see `phase.BatchContext`."""

    spec: SimSpec
    world: World
    t: jax.Array
    engine: Any = None
    """A `Multibody` of the fleet; None for those who move the vehicles themselves."""
    override_command: Command | None = None
    """Instead of the paths."""
    finished: jax.Array | None = None
    """See `phase.BatchContext`."""
    last_approach_s: jax.Array | None = None
    """See `phase.BatchContext`."""
    approaching: jax.Array | None = None
    """See `phase.BatchContext`."""
    _flows: list[tuple[VehicleState, jax.Array]] = field(default_factory=list, init=False)

    @property
    def params(self) -> ControlParams:
        """See `phase.BatchContext`."""
        return self.world.control

    @property
    def command(self) -> Any:
        """See `phase.BatchContext`."""
        if self.override_command is not None:
            return self.override_command
        return plans.check_plan(self.spec.stages, self.world.path)

    @property
    def current(self) -> Current:
        """See `phase.BatchContext`."""
        return self.world.environment.current

    @property
    def goal_m(self) -> jax.Array:
        """See `phase.BatchContext`."""
        return self.world.environment.goal_m

    @property
    def fails_at_s(self) -> jax.Array | None:
        """See `phase.BatchContext`."""
        return self.world.fails_at_s

    @cached_property
    def corners(self) -> tuple[jax.Array, jax.Array]:
        """See `phase.BatchContext`."""
        return region_corners(self.world.environment)

    def flow(self, vehicle: VehicleState) -> jax.Array:
        """See `phase.BatchContext`."""
        for cached_vehicle, flow in self._flows:  # controllers and the record ask for the same
            if cached_vehicle is vehicle:
                return flow
        flow = jax.vmap(currents.velocity, (None, 0, None))(self.current, vehicle.p, self.t)
        self._flows.append((vehicle, flow))
        return flow

    def map_bodies(
        self, function: Callable[..., Any], *bodies: Any, shared: tuple[Any, ...] = ()
    ) -> Any:
        """See `phase.BatchContext`."""
        axes = (0,) * len(bodies) + (None,) * len(shared)
        return jax.vmap(function, axes)(*bodies, *shared)

    def repeat(self, times: int, body: Callable[[jax.Array, Any], Any], tree: Any) -> Any:
        """See `phase.BatchContext`; with derivatives backwards."""

        def step_once(now: Any, i: jax.Array) -> tuple[Any, None]:
            return body(i, now), None

        return jax.lax.scan(step_once, tree, jnp.arange(times))[0]

    def physics_step(
        self,
        params: ControlParams,
        vehicle: VehicleState,
        thrust_n: Any,
        current: Current,
        t: jax.Array,
    ) -> VehicleState:
        """See `phase.BatchContext`."""
        moved: VehicleState = jax.vmap(physics.step, (None, 0, 0, 0, 0, None, None, None, None))(
            self.engine,
            self.world.body,
            params.vehicle,
            vehicle,
            thrust_n,
            current,
            t,
            self.spec.physics_dt_s,
            self.spec.water,
        )
        return moved

    def advance(self, obstacles: ObstacleState) -> ObstacleState:
        """See `phase.BatchContext`."""
        environment = self.world.environment
        return obstacle_motion.step(
            environment.obstacles,
            obstacles,
            environment.current,
            self.t,
            self.spec.control_dt_s,
            *self.corners,
            environment.grid,
            self.spec.water.density_kgpm3,
            self.spec.water.gravity_mps2,
        )

    def contact(self, now: Slots) -> Contact:
        """See `phase.BatchContext`."""
        vehicles = self.world.control.vehicle
        return detect_contacts(self.world.environment, vehicles, now["vehicle"], now["obstacles"])


def control_step(
    spec: SimSpec,
    engine: Multibody,
    world: World,
    state: WorldState,
    command: Command | None = None,
    policy: Policy | None = None,
    number: jax.Array | None = None,
    fleet: Fleet | None = None,
) -> tuple[WorldState, Sample]:
    """One control step of one world.

    Args:
        spec: settings.
        engine: of the fleet.
        world: constants of the world.
        state: of the world.
        command: to the controllers instead of the paths, [R] leading.
        policy: that commands them, if one does.
        number: ``state.step``, as one number for all worlds of a batch: a policy with a period is
            then called in its steps alone.
        fleet: whose robots may carry loads; if left out they do not.

    Returns:
        The state one control period later, and the sample of the state before with its command.
    """
    t = state.step.astype(state.vehicles.p.dtype) * spec.control_dt_s
    memory, output = WorldMemory.of(state), WorldPhaseOutput()
    policy = running.active_policy(policy, command)
    if running.has_world_phases(spec, policy):
        count = state.step if number is None else number
        memory, output = running.run_world_phases(
            spec,
            policy,
            world,
            memory,
            count,
            state.vehicles,
            state.obstacles,
            state.tally.outcome,
            fleet=fleet,
        )
    context = SingleWorld(
        spec=spec,
        world=apply_loads(fleet, world, output.loaded),
        t=t,
        engine=engine,
        override_command=output.command if command is None else command,
        finished=output.finished,
        last_approach_s=output.last_approach_s
        if policy is not None
        else last_approaches_s(spec, world, command),
        approaching=output.approaching,
    )
    slots = {
        "vehicle": state.vehicles,
        "estimate": state.vehicles if output.estimate is None else output.estimate,
        "memory": state.carry,
        "tally": state.tally,
        "obstacles": state.obstacles,
    }
    now, record = run_phases(context, (*INDEPENDENT_PHASES, OBSTACLES, *INTERACTION_PHASES), slots)
    after = WorldState(
        vehicles=now["vehicle"],
        carry=now["memory"],
        obstacles=now["obstacles"],
        tally=now["tally"],
        step=state.step + 1,
        **vars(memory),
    )
    return after, Sample(**output.record, **record)


def segment(
    spec: SimSpec,
    engine: Multibody,
    world: World,
    state: WorldState,
    n_sample: int,
    steps_per_sample: int,
    command: Command | None = None,
    policy: Policy | None = None,
    number: jax.Array | None = None,
    fleet: Fleet | None = None,
) -> tuple[WorldState, Sample]:
    """``n_sample * steps_per_sample`` control steps of one world, all with one command.

    Returns:
        The state at the end, and samples with a leading axis [n_sample].
    """
    # One control step stands in the program, not one for recorded and one for other steps: it is
    # most of what there is to compile.
    fly = partial(control_step, spec, engine, world, command=command, policy=policy, fleet=fleet)
    shapes = jax.eval_shape(fly, state)[1]
    empty_sample: Sample = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

    def step_once(carry: Any, i: jax.Array) -> tuple[Any, None]:
        state, number, kept = carry
        state, sample = fly(state, number=number)
        kept = jax.tree.map(lambda new, old: jnp.where(i == 0, new, old), sample, kept)
        return (state, None if number is None else number + 1, kept), None

    def record_sample(now: Any, _: None) -> tuple[Any, Sample]:
        (*now, kept), _ = jax.lax.scan(
            step_once, (*now, empty_sample), jnp.arange(steps_per_sample)
        )
        return tuple(now), kept

    (after, _), samples = jax.lax.scan(record_sample, (state, number), length=n_sample)
    return after, samples


class MjxEngine:
    """MuJoCo MJX on worlds [tile]."""

    def reset(
        self, spec: SimSpec, fleet: Fleet, worlds: World, policy: Policy | None = None
    ) -> WorldState:
        """See `Engine.reset`."""
        reset_world = partial(
            start.reset, spec, _select_multibody(spec, fleet, worlds), policy=policy
        )
        state: WorldState = jax.vmap(reset_world)(worlds.body, worlds)
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
        if rows is not None:
            worlds = jax.tree.map(lambda leaf: leaf[rows], worlds)
        engine = _select_multibody(spec, fleet, worlds)

        def step_tile(state: WorldState) -> tuple[WorldState, Sample]:
            number = _shared_step_number(spec, state, policy) if rows is None else None
            step_world = partial(control_step, spec, policy=policy, number=number, fleet=fleet)
            after: WorldState
            after, sample = jax.vmap(step_world, (None, 0, 0, 0))(engine, worlds, state, command)
            return after, sample_clearances.add_clearances(spec, worlds, sample)

        return repeat_steps(step_tile, state, steps)

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
        count: dict[str, Any] = {"n_sample": n_sample, "steps_per_sample": steps_per_sample}
        options: dict[str, Any] = {
            "number": _shared_step_number(spec, state, policy),
            "fleet": fleet,
        }
        fly: Any = partial(segment, spec, policy=policy, **options, **count)

        def run_world(world: World, state: WorldState, command: Command | None) -> Any:
            return fly(_select_multibody(spec, fleet, worlds), world, state, command=command)

        after: WorldState
        after, samples = jax.vmap(run_world)(worlds, state, command)
        return after, sample_clearances.add_all_clearances(spec, worlds, samples)


def _shared_step_number(
    spec: SimSpec, state: WorldState, policy: Policy | None
) -> jax.Array | None:
    """Control steps that all worlds have taken, where a policy, task or acoustics want to know."""
    wanted = policy is not None or spec.by_task or spec.acoustics is not None
    return state.step[0] if wanted else None


def _select_multibody(spec: SimSpec, fleet: Fleet, worlds: World) -> mjx_engine.MjxPhysics:
    if fleet.engine is None:
        raise UnsupportedError(
            "the fleet was built without multibody models: engine mjx needs them"
        )
    if worlds.body.fields.keys() != fleet.body.fields.keys():
        raise UnsupportedError(
            "the worlds were drawn of a fleet without the multibody fields of this one: engine mjx "
            "needs them (`Simulator.adopt` gives them)"
        )
    return fleet.engine.with_gravity(spec.water.gravity_mps2)
