"""A control step, phase by phase: the table of contents of a simulation.

    sense       world      instruments and filters: estimates of the robots' motion
    hear        world      packets of other robots that came in, and those that are sent
    work        world      the task: what was done of it, and where robots go next
    policy      world      a function of what all robots of a world know commands them
    decide      robot      controllers: from a path or a command to the thrusters' signals
    move        robot      the physics steps of the control period
    obstacles   obstacle   drifting and scripted bodies
    judge       robot      contact, outcome and accounts, among all that moved

Phases of worlds are in `world_phases`. Those of robots and obstacles are here, each a pure function
of one dataclass; engines batch them: `angler_mjx.sim.engines.mjx` by ``vmap``, the fused engines on
lanes and in kernels, one for each phase of robots. What a phase records is declared in
`angler_mjx.sim.record`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp

from angler_mjx.robot.control import stack
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.stack import Command, ControlMemory, ControlParams
from angler_mjx.sim import robot
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.phase import BodyBatch, Phase, PhaseResult, Record, run_phase
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import Tally
from angler_mjx.world.currents import Current
from angler_mjx.world.obstacles import ObstacleState

PHASES = ("sense", "hear", "work", "policy", "decide", "move", "obstacles", "judge")
"""Names of the phases of a control step, in order."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class RobotState:
    """State of robots that lasts from step to step."""

    vehicle: VehicleState
    memory: ControlMemory
    """Of the controllers."""
    tally: Tally


@dataclass(frozen=True, kw_only=True)
class DecideInput:
    """Input of the controllers."""

    estimate: VehicleState | Belief
    """The true state, or the estimate that stands in for it."""
    memory: ControlMemory
    flow: jax.Array | None
    """[3] of `select_flow`."""
    params: ControlParams
    command: Plan | Command | MixedCommand
    """The robots' paths, or what drives them instead."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Decision:
    """Output of the controllers."""

    memory: ControlMemory
    thrust_n: jax.Array
    """[n_thruster] N that the thrusters settle at."""
    power_w: jax.Array
    """[] W of all thrusters."""


@dataclass(frozen=True, kw_only=True)
class MoveInput:
    """Input of the physics steps of a control period."""

    vehicle: VehicleState
    tally: Tally
    thrust_n: jax.Array
    """[n_thruster] N."""
    params: ControlParams
    current: Current


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Motion:
    """Output of the physics steps of a control period."""

    vehicle: VehicleState
    before_m: jax.Array
    """[3] position before them, in W."""
    broken: jax.Array
    """bool [] the robot diverged in them."""


@dataclass(frozen=True, kw_only=True)
class PlanApproach:
    """Plan of a robot, and when its last approach to the goal begins."""

    plan: Command | MixedCommand
    begin_s: jax.Array
    """[] s along the plan, of `plans.last_approach_s`."""


@dataclass(frozen=True, kw_only=True)
class JudgeInput:
    """Input of the accounts of a control step."""

    tally: Tally
    vehicle: VehicleState
    before_m: jax.Array
    power_w: jax.Array
    broken: jax.Array
    memory: ControlMemory
    goal_m: jax.Array
    """[3] in W."""
    contact: Contact
    """Of everything that has moved."""
    finished: jax.Array | None
    """bool [] the robot's part of the task is done; None where there is no task."""
    fails_at_s: jax.Array | None
    """[] s when the robot breaks down; None where none can."""
    approach: PlanApproach | jax.Array | None
    """bool [] whether the robot is on the last approach of a plan that a policy keeps, or the plan
    itself; None where the goal alone counts."""
    corners: tuple[jax.Array, jax.Array]
    """Lower and upper corner [3] of the region, m, in W."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Output of the accounts of a control step."""

    tally: Tally


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class MovedRobots:
    """Robots when everything has moved, before they are judged."""

    vehicle: VehicleState
    memory: ControlMemory
    tally: Tally
    before_m: jax.Array
    power_w: jax.Array
    broken: jax.Array


def select_flow(
    batch: BodyBatch, current: Callable[[], Current], estimate: VehicleState | Belief
) -> jax.Array | None:
    """Return the velocity [3] of the water as controllers know it; None where none wants it."""
    if isinstance(estimate, Belief):
        return estimate.flow
    return batch.flow(current(), estimate) if stack.wants_flow(batch.spec.stages) else None


def decide_commands(batch: BodyBatch, inputs: DecideInput) -> PhaseResult[Decision]:
    """Run the controllers, and look up what the thrusters settle at."""
    memory, target, command = batch.map_bodies(
        partial(robot.run_controllers, batch.spec),
        inputs.params,
        inputs.memory,
        inputs.estimate,
        inputs.command,
        inputs.flow,
    )
    pwm = stack.require_signals(command)
    thrust, power = batch.map_bodies(robot.thrust_and_power, inputs.params.vehicle, pwm)
    return PhaseResult(
        output=lambda: Decision(memory=memory, thrust_n=thrust, power_w=power),
        record=partial(record_decided, pwm.pwm_us, target),
    )


def record_decided(pwm_us: jax.Array, target_m: jax.Array) -> Record:
    """Return the record of `decide_commands`."""
    return {"pwm_us": pwm_us, "target_m": target_m}


def move_robots(batch: BodyBatch, inputs: MoveInput) -> PhaseResult[Motion]:
    """Take the physics steps of a control period; a robot that failed or diverged stays."""
    before, outcome = inputs.vehicle, inputs.tally.outcome
    params, current = inputs.params, inputs.current

    def physics_substep(i: jax.Array, vehicle: VehicleState) -> VehicleState:
        t = batch.t + i.astype(batch.t.dtype) * batch.spec.physics_dt_s
        return batch.physics_step(params, vehicle, inputs.thrust_n, current, t)

    def output() -> Motion:
        moved = batch.repeat(batch.spec.physics_steps, physics_substep, before)
        after, broken = batch.map_bodies(robot.hold_if_ended, outcome, before, moved)
        return Motion(vehicle=after, before_m=before.p, broken=broken)

    def record() -> Record:
        seen = record_motion(before, outcome, batch.flow(current, before))
        if "wrench" in batch.spec.also:
            seen["wrench"] = batch.map_bodies(
                robot.thruster_wrench, params.vehicle, outcome, before.thrust
            )
        return seen

    return PhaseResult(output=output, record=record)


def record_motion(vehicle: VehicleState, outcome: jax.Array, flow: jax.Array) -> Record:
    """Return the record of `move_robots`, of its beginning."""
    return {
        "p": vehicle.p,
        "q": vehicle.q,
        "nu": vehicle.nu,
        "current_mps": flow,
        "outcome": outcome,
    }


def advance_obstacles(batch: BodyBatch, obstacles: ObstacleState) -> PhaseResult[ObstacleState]:
    """Move drifting and scripted bodies on by a control period."""
    return PhaseResult(
        output=lambda: batch.advance(obstacles), record=lambda: record_obstacles(obstacles)
    )


def record_obstacles(obstacles: ObstacleState) -> Record:
    """Return the record of obstacles, of the beginning of the step."""
    return {"obstacle_p": obstacles.p, "obstacle_q": obstacles.q}


def is_approaching(batch: BodyBatch, inputs: JudgeInput) -> jax.Array | None:
    """Return whether robots are on the last approach of their plans, bool [].

    None where no plan is flown, or a task says who has finished: there the approach does not count.
    """
    if not isinstance(inputs.approach, PlanApproach):
        return inputs.approach
    return batch.map_bodies(
        partial(robot.is_on_last_approach, batch.spec),
        inputs.memory,
        inputs.approach.plan,
        inputs.approach.begin_s,
    )


def judge_robots(batch: BodyBatch, inputs: JudgeInput) -> PhaseResult[Judgement]:
    """Account for the step of each robot."""

    def account(
        goal_m: jax.Array,
        tally: Tally,
        before_m: jax.Array,
        after_m: jax.Array,
        contact: Contact,
        power: jax.Array,
        broken: jax.Array,
        finished: jax.Array | None,
        fails_at_s: jax.Array | None,
        approaching: jax.Array | None,
        lo: jax.Array,
        hi: jax.Array,
        t: jax.Array,
    ) -> Tally:
        return robot.update_tally(
            batch.spec,
            goal_m,
            lo,
            hi,
            tally,
            before_m,
            after_m,
            contact,
            power,
            broken,
            t,
            finished,
            fails_at_s,
            approaching,
        )

    tally = batch.map_bodies(
        account,
        inputs.goal_m,
        inputs.tally,
        inputs.before_m,
        inputs.vehicle.p,
        inputs.contact,
        inputs.power_w,
        inputs.broken,
        inputs.finished,
        inputs.fails_at_s,
        is_approaching(batch, inputs),
        shared=(*inputs.corners, batch.t),
    )
    return PhaseResult(output=lambda: Judgement(tally=tally))


DECIDE = Phase(name="decide", run=decide_commands, takes=DecideInput, gives=Decision)
MOVE = Phase(name="move", run=move_robots, takes=MoveInput, gives=Motion)
OBSTACLES = Phase(
    name="obstacles",
    of="obstacle",
    run=advance_obstacles,
    takes=ObstacleState,
    gives=ObstacleState,
)
JUDGE = Phase(name="judge", run=judge_robots, takes=JudgeInput, gives=Judgement, meets=True)


def move_independently(
    batch: BodyBatch,
    robots: RobotState,
    estimate: VehicleState | Belief,
    params: ControlParams,
    command: Plan | Command | MixedCommand,
    current: Current,
) -> tuple[MovedRobots, Record]:
    """Return robots after `DECIDE` and `MOVE`, which look at no other body, and their record.

    Args:
        batch: the robots.
        robots: their state.
        estimate: their motion as controllers know it.
        params: of them.
        command: their paths, or what drives them instead.
        current: of their worlds.
    """
    decision, decided = run_phase(
        DECIDE,
        batch,
        DecideInput(
            estimate=estimate,
            memory=robots.memory,
            flow=select_flow(batch, lambda: current, estimate),
            params=params,
            command=command,
        ),
    )
    motion, moved = run_phase(
        MOVE,
        batch,
        MoveInput(
            vehicle=robots.vehicle,
            tally=robots.tally,
            thrust_n=decision.thrust_n,
            params=params,
            current=current,
        ),
    )
    after = MovedRobots(
        vehicle=motion.vehicle,
        memory=decision.memory,
        tally=robots.tally,
        before_m=motion.before_m,
        power_w=decision.power_w,
        broken=motion.broken,
    )
    return after, decided | moved


def scratch_shapes(
    number: jax.ShapeDtypeStruct, thrusters: jax.ShapeDtypeStruct
) -> dict[str, jax.ShapeDtypeStruct]:
    """Return shapes of what phases of one robot hand to each other within a step, by field.

    Args:
        number: shape and type of a number [].
        thrusters: of one for each thruster.
    """
    three = jax.ShapeDtypeStruct((3,), number.dtype)
    broken = jax.ShapeDtypeStruct((), jnp.bool_)
    return {"thrust_n": thrusters, "power_w": number, "before_m": three, "broken": broken}
