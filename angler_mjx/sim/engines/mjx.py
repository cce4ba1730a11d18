"""MuJoCo MJX: multibody models, the phases of one world, and one ``vmap`` over worlds."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import jax
import jax.numpy as jnp

from angler_mjx.errors import UnsupportedError
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.stack import Command, ControlParams
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.params import joint_names
from angler_mjx.sim import cargo, robot, sample_clearances, start
from angler_mjx.sim import world_phases as running
from angler_mjx.sim.approach import last_approaches_s
from angler_mjx.sim.contact_motion import MovingWorld, find_layout, move_together
from angler_mjx.sim.detection import detect_contacts
from angler_mjx.sim.fleet import Fleet, add_parameters, apply_loads
from angler_mjx.sim.impacts import Impacts
from angler_mjx.sim.phase import Record, run_phase
from angler_mjx.sim.physics import mjx_engine
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.contact.candidates import Rock
from angler_mjx.sim.physics.contact.grips import Grips, take_hold
from angler_mjx.sim.physics.mjx_engine import BodyInertia
from angler_mjx.sim.physics.step import Multibody, VehicleState
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.posture import locate_end_effectors
from angler_mjx.sim.record import Belief, Sample, build_sample
from angler_mjx.sim.state import (
    EngineConstants,
    FleetWorld,
    Outcome,
    SimSpec,
    World,
    WorldState,
)
from angler_mjx.sim.step import (
    JUDGE,
    OBSTACLES,
    JudgeInput,
    Judgement,
    MovedRobots,
    MoveInput,
    PlanApproach,
    RobotState,
    decide,
    move_independently,
    record_move,
    record_obstacles,
)
from angler_mjx.sim.step_repetition import repeat_steps
from angler_mjx.sim.unpacked_states import UnpackedStates
from angler_mjx.sim.world_phases import WorldMemory, WorldPhaseOutput
from angler_mjx.world import currents
from angler_mjx.world import obstacles as obstacle_motion
from angler_mjx.world.currents import Current
from angler_mjx.world.environment import region_corners
from angler_mjx.world.obstacles import ObstacleState


@dataclass(frozen=True, kw_only=True)
class SingleWorld:
    """Robots [R] and obstacles [n] of one world; a `phase.BodyBatch`."""

    spec: SimSpec
    world: FleetWorld
    t: jax.Array
    engine: Multibody[BodyInertia] | None = None
    """Of the fleet; None where the vehicles are moved by something else."""
    rock: Rock | None = None
    """Of the world; None where nothing touches."""
    _flows: list[tuple[VehicleState, jax.Array]] = field(default_factory=list, init=False)

    @cached_property
    def corners(self) -> tuple[jax.Array, jax.Array]:
        """Lower and upper corner [3] of the region, m, in W."""
        return region_corners(self.world.environment)

    def flow(self, current: Current, vehicle: VehicleState) -> jax.Array:
        """See `phase.BodyBatch`."""
        for cached_vehicle, flow in self._flows:  # controllers and the record ask for the same
            if cached_vehicle is vehicle:
                return flow
        flow = jax.vmap(currents.velocity, (None, 0, None))(current, vehicle.p, self.t)
        self._flows.append((vehicle, flow))
        return flow

    def map_bodies[T](
        self, function: Callable[..., T], *bodies: object, shared: tuple[object, ...] = ()
    ) -> T:
        """See `phase.BodyBatch`."""
        axes = (0,) * len(bodies) + (None,) * len(shared)
        return jax.vmap(function, axes)(*bodies, *shared)

    def repeat[T](self, times: int, body: Callable[[jax.Array, T], T], tree: T) -> T:
        """See `phase.BodyBatch`; with derivatives backwards."""

        def step_once(now: T, i: jax.Array) -> tuple[T, None]:
            return body(i, now), None

        return jax.lax.scan(step_once, tree, jnp.arange(times))[0]

    def physics_step(
        self,
        params: ControlParams,
        vehicle: VehicleState,
        thrust_n: jax.Array,
        current: Current,
        t: jax.Array,
        joints: JointMotion | None,
    ) -> VehicleState:
        """See `phase.BodyBatch`."""
        if self.engine is None:
            raise RuntimeError("these vehicles are moved by something else")
        axes = (None, 0, 0, 0, 0, None, None, None, None, 0)
        return jax.vmap(physics.step, axes)(
            self.engine,
            self.world.body,
            params.vehicle,
            vehicle,
            thrust_n,
            current,
            t,
            self.spec.physics_dt_s,
            self.spec.water,
            joints,
        )

    def advance(self, obstacles: ObstacleState) -> ObstacleState:
        """See `phase.BodyBatch`."""
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


def judge_world(
    batch: SingleWorld,
    moved: MovedRobots,
    obstacles: ObstacleState,
    *,
    finished: jax.Array | None = None,
    approach: PlanApproach | jax.Array | None = None,
    impacts: Impacts | None = None,
) -> Judgement:
    """Account for the step of one world when everything in it has moved.

    Args:
        batch: the world.
        moved: its robots.
        obstacles: its obstacles.
        finished: as in `step.JudgeInput`.
        approach: as in `step.JudgeInput`.
        impacts: as in `step.JudgeInput`.
    """
    environment = batch.world.environment
    inputs = JudgeInput(
        **vars(moved),
        goal_m=environment.goal_m,
        contact=detect_contacts(environment, batch.world.control.vehicle, moved.vehicle, obstacles),
        finished=finished,
        fails_at_s=batch.world.fails_at_s,
        approach=approach,
        corners=batch.corners,
        reaching=batch.world.control if batch.spec.by_end_effector else None,
        impacts=impacts,
    )
    return run_phase(JUDGE, batch, inputs)[0]


def move_in_contact(
    batch: SingleWorld,
    robots: RobotState,
    obstacles: ObstacleState,
    estimate: VehicleState | Belief,
    params: ControlParams,
    command: Plan | Command | MixedCommand,
    current: Current,
    grips: Grips | None,
    number: jax.Array,
) -> tuple[MovedRobots, ObstacleState, Grips | None, Impacts, Record]:
    """Return robots and obstacles of one world after a control period in which they may touch.

    Arguments as of `step.move_independently`, the obstacles, the robots' grips (None where they
    hold nothing), and the number int32 [] of the step. Contact is
    solved with the inertia of ``params``, loads included.
    """
    spec, vehicles = batch.spec, robots.vehicle
    if spec.contact is None or batch.engine is None or batch.rock is None:
        raise RuntimeError("the simulation has no contact")
    measured = None
    if grips is not None:
        measured = cargo.read_grips(grips, batch.world.grip_sensors, number)
    decision, record = decide(batch, robots, estimate, params, command, current, measured)
    inputs = MoveInput(
        vehicle=vehicles,
        tally=robots.tally,
        thrust_n=decision.thrust_n,
        params=params,
        current=current,
        joints=decision.memory.joints,
    )
    outcome = robots.tally.outcome
    moving = MovingWorld(
        contact=spec.contact,
        layout=find_layout(spec.contact, batch.world.environment, params.vehicle, vehicles),
        engine=batch.engine,
        body=batch.world.body,
        rock=batch.rock,
        world=batch.world,
        water=spec.water,
        dt=spec.physics_dt_s,
        thrust_n=decision.thrust_n,
        alive=robot.is_moving(outcome),
    )
    moved, obstacles, grips, impacts = move_together(
        moving, vehicles, obstacles, batch.t, spec.physics_steps, inputs.joints, grips
    )
    after, broken = batch.map_bodies(robot.hold_if_ended, outcome, vehicles, moved)
    result = MovedRobots(
        vehicle=after,
        memory=decision.memory,
        tally=robots.tally,
        before_m=vehicles.p,
        power_w=decision.power_w,
        broken=broken,
    )
    return result, obstacles, grips, impacts, record | record_move(batch, inputs)


def close_grips(
    batch: SingleWorld, robots: MovedRobots, obstacles: ObstacleState, grips: Grips | None
) -> Grips | None:
    """Return grips of one world after those closed that have come to the body."""
    carried, contact = batch.spec.cargo, batch.spec.contact
    if grips is None or carried is None or carried.approach is None:
        return grips
    if contact is None or contact.grip is None:
        raise RuntimeError("the simulation has no contact")
    vehicles, tips = robots.vehicle, None
    if contact.grip.by_end_effector and vehicles.joints is not None:
        params = batch.world.control.vehicle
        tips = locate_end_effectors(params, vehicles.joints.position)
    now = take_hold(contact.grip, vehicles.p, vehicles.q, obstacles.p, obstacles.q, tips)
    speed_mps = cargo.find_grip_speeds(carried, vehicles, now.lever_m, obstacles)
    running = robots.tally.outcome == Outcome.RUNNING
    end_s = batch.t + batch.spec.control_dt_s
    return cargo.close_grips(carried.approach, grips, now, speed_mps, running, end_s)


def measure_cargo(
    batch: SingleWorld, obstacles: ObstacleState, grips: Grips | None, impacts: Impacts
) -> tuple[Impacts, Grips | None, jax.Array | None]:
    """Return impacts with the cargo's error, grips, and which robots have brought it, bool [R].

    Where robots carry nothing: impacts and grips as they are, and None.
    """
    spec = batch.spec.cargo
    if spec is None or grips is None:
        return impacts, grips, None
    error, robots = cargo.find_error(spec, batch.world.environment, obstacles), grips.held.shape
    of_robots = jax.tree.map(lambda x: jnp.broadcast_to(x, robots), error)
    grips, finished = cargo.finish_carrying(spec, grips, of_robots, batch.spec.control_dt_s)
    return replace(impacts, cargo=of_robots), grips, finished


def prepare_rock(spec: SimSpec, world: World) -> Rock | None:
    """Return the rock of one world for contact; None where nothing touches."""
    return None if spec.contact is None else Rock.of(world.environment.grid)


def control_step(
    spec: SimSpec,
    engine: Multibody[BodyInertia],
    world: FleetWorld,
    state: WorldState,
    command: Command | None = None,
    policy: Policy | None = None,
    number: jax.Array | None = None,
    fleet: Fleet | None = None,
    rock: Rock | None = None,
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
        rock: of the world, prepared once for many steps (`prepare_rock`).

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
            grips=state.grips,
        )
    flown = mark_leader(spec, apply_loads(fleet, world, output.loaded))
    rock = prepare_rock(spec, world) if rock is None else rock
    batch = SingleWorld(spec=spec, world=flown, t=t, engine=engine, rock=rock)
    override = output.command if command is None else command
    driver = override
    if driver is None:
        driver = plans.check_plan(spec.stages, world.path, joint_names(world.control.vehicle))
    robots = RobotState(vehicle=state.vehicles, memory=state.carry, tally=state.tally)
    estimate = state.vehicles if output.estimate is None else output.estimate
    driven = estimate, flown.control, driver, world.environment.current
    impacts, grips, finished = None, state.grips, output.finished
    if spec.contact is None:
        moved, record = move_independently(batch, robots, *driven)
        obstacles, seen = run_phase(OBSTACLES, batch, state.obstacles)
    else:
        moved, obstacles, grips, impacts, record = move_in_contact(
            batch, robots, state.obstacles, *driven, grips, state.step
        )
        seen = record_obstacles(state.obstacles)
        grips = close_grips(batch, moved, obstacles, grips)
        impacts, grips, brought = measure_cargo(batch, obstacles, grips, impacts)
        finished = output.finished if brought is None else brought
    begin_s = output.last_approach_s
    if policy is None:
        begin_s = last_approaches_s(spec, world, command)
    judgement = judge_world(
        batch,
        moved,
        obstacles,
        finished=finished,
        approach=output.approaching
        if begin_s is None
        else PlanApproach(plan=driver, begin_s=begin_s),
        impacts=impacts,
    )
    after = WorldState(
        vehicles=moved.vehicle,
        carry=moved.memory,
        obstacles=obstacles,
        tally=judgement.tally,
        step=state.step + 1,
        grips=grips,
        **vars(memory),
    )
    record |= seen
    if "grips" in spec.also and state.grips is not None:
        record["grips"] = cargo.record_grips(state.grips)
    return after, build_sample(output.record, record)


def mark_leader(spec: SimSpec, world: FleetWorld) -> FleetWorld:
    """Return a world whose controllers know which robot leads, where one does."""
    if spec.leader is None:
        return world
    is_leader = jnp.arange(world.variant.shape[0]) == spec.leader
    return replace(world, control=replace(world.control, is_leader=is_leader))


class MjxEngine(UnpackedStates):
    """MuJoCo MJX on worlds [tile]."""

    def reset(
        self, spec: SimSpec, fleet: Fleet, worlds: World, policy: Policy | None = None
    ) -> WorldState:
        """See `Engine.reset`."""
        reset_world = partial(start.reset, spec, _select_multibody(spec, fleet), policy=policy)
        equipped = add_parameters(fleet, worlds)
        return jax.vmap(reset_world)(equipped.body, equipped)

    def pack_constants(self, fleet: Fleet, worlds: World) -> EngineConstants:
        """See `Engine.pack_constants`: nothing."""
        del fleet, worlds
        return ()

    def pack_cells(self, worlds: World) -> None:
        """See `Engine.pack_cells`: None."""
        del worlds

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
        del constants, cells
        if rows is not None:
            worlds = jax.tree.map(lambda leaf: leaf[rows], worlds)
        engine, equipped = _select_multibody(spec, fleet), add_parameters(fleet, worlds)

        def step_tile(state: WorldState) -> tuple[WorldState, Sample]:
            number = _shared_step_number(spec, state, policy) if rows is None else None
            step_world = partial(control_step, spec, policy=policy, number=number, fleet=fleet)
            after: WorldState
            after, sample = jax.vmap(step_world, (None, 0, 0, 0))(engine, equipped, state, command)
            return after, sample_clearances.add_clearances(spec, equipped, sample)

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
        cells: jax.Array | None = None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.segment`."""
        del begins, cells
        engine, equipped = _select_multibody(spec, fleet), add_parameters(fleet, worlds)
        number = _shared_step_number(spec, state, policy)
        rock = jax.vmap(partial(prepare_rock, spec))(equipped)

        # One control step stands in the program, not one for recorded and one for other steps: it
        # is most of what there is to compile. It is traced once, for the types of its results and
        # for the loop; a loop within `vmap` would be traced, and then batched twice.
        @partial(jax.jit, inline=True)
        def fly(state: WorldState, number: jax.Array | None) -> tuple[WorldState, Sample]:
            step_world = partial(control_step, spec, policy=policy, number=number, fleet=fleet)

            def step_one(
                world: FleetWorld, state: WorldState, command: Command | None, rock: Rock | None
            ) -> tuple[WorldState, Sample]:
                return step_world(engine, world, state, command, rock=rock)

            return jax.vmap(step_one)(equipped, state, command, rock)

        shapes = jax.eval_shape(fly, state, number)[1]
        empty_sample: Sample = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

        def step_once(
            carry: tuple[WorldState, jax.Array | None, Sample], i: jax.Array
        ) -> tuple[tuple[WorldState, jax.Array | None, Sample], None]:
            state, number, kept = carry
            state, sample = fly(state, number)
            kept = jax.tree.map(lambda new, old: jnp.where(i == 0, new, old), sample, kept)
            return (state, None if number is None else number + 1, kept), None

        def record_sample(
            now: tuple[WorldState, jax.Array | None], _: None
        ) -> tuple[tuple[WorldState, jax.Array | None], Sample]:
            (after, count, kept), _ = jax.lax.scan(
                step_once, (*now, empty_sample), jnp.arange(steps_per_sample)
            )
            return (after, count), kept

        (after, _), samples = jax.lax.scan(record_sample, (state, number), length=n_sample)
        samples = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), samples)
        return after, sample_clearances.add_all_clearances(spec, equipped, samples)


def _shared_step_number(
    spec: SimSpec, state: WorldState, policy: Policy | None
) -> jax.Array | None:
    """Control steps that all worlds have taken, where a policy, task or acoustics want to know."""
    wanted = policy is not None or spec.by_task or spec.acoustics is not None
    return state.step[0] if wanted else None


def _select_multibody(spec: SimSpec, fleet: Fleet) -> mjx_engine.MjxPhysics:
    if fleet.engine is None:
        raise UnsupportedError(
            "the fleet was built without multibody models: engine mjx needs them"
        )
    return fleet.engine.with_gravity(spec.water.gravity_mps2)
