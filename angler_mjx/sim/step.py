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
from angler_mjx.robot.control.commands import GripReading
from angler_mjx.robot.control.commands.whole_body import JointTarget
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.stack import Command, ControlMemory, ControlParams
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.sim import robot
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.impacts import Impacts
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
    joints: JointMotion | None = None
    """[J] motion of the joints; None where no robot has any."""
    grip: GripReading | None = None
    """Measured by the grips; None where robots hold nothing."""
    actuators: jax.Array | None = None
    """[n_thruster] present states, for the power of pumps and moving masses; None where no robot
    has any."""


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
    joints: JointTarget | None = None
    """[J] motion that the servos of joints follow; None where no robot has any."""


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
    reaching: ControlParams | None = None
    """Of the robots, where their end effectors have to come to the goals; else None."""
    impacts: Impacts | None = None
    """What contact did to the robots in the step; None where the first touch is the end."""


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


def select_actuators(params: ControlParams, vehicle: VehicleState) -> jax.Array | None:
    """Return the states of actuators where some robot has ballast or moving masses, else None."""
    return None if params.vehicle.trim is None else vehicle.thrust


def decide_commands(batch: BodyBatch, inputs: DecideInput) -> PhaseResult[Decision]:
    """Run the controllers, and look up what the thrusters settle at."""
    memory, target, command = batch.map_bodies(
        partial(robot.run_controllers, batch.spec),
        inputs.params,
        inputs.memory,
        inputs.estimate,
        inputs.command,
        inputs.flow,
        inputs.joints,
        inputs.grip,
    )
    pwm = stack.require_signals(command)
    thrust, power = batch.map_bodies(
        robot.thrust_and_power, inputs.params.vehicle, pwm, inputs.actuators
    )
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
        elapsed_s = i.astype(batch.t.dtype) * batch.spec.physics_dt_s
        reference = None if inputs.joints is None else joint_reference(inputs.joints, elapsed_s)
        t = batch.t + elapsed_s
        return batch.physics_step(params, vehicle, inputs.thrust_n, current, t, reference)

    def output() -> Motion:
        moved = batch.repeat(batch.spec.physics_steps, physics_substep, before)
        after, broken = batch.map_bodies(robot.hold_if_ended, outcome, before, moved)
        return Motion(vehicle=after, before_m=before.p, broken=broken)

    return PhaseResult(output=output, record=partial(record_move, batch, inputs))


def record_move(batch: BodyBatch, inputs: MoveInput) -> Record:
    """Return the record of `move_robots`."""
    before, outcome, params = inputs.vehicle, inputs.tally.outcome, inputs.params
    seen = record_motion(before, outcome, batch.flow(inputs.current, before))
    if "wrench" in batch.spec.also:
        seen["wrench"] = batch.map_bodies(
            robot.thruster_wrench, params.vehicle, outcome, before.thrust
        )
    if before.joints is not None:
        links = params.vehicle.links
        seen["joints"] = batch.map_bodies(robot.record_joints, links, before.joints)
    return seen


def joint_reference(joints: JointTarget, elapsed_s: jax.Array | float) -> JointMotion:
    """Return what servos hold so long after the beginning of a control period: [] s."""
    change = elapsed_s * joints.acceleration
    return JointMotion(
        position=joints.position + elapsed_s * (joints.velocity + 0.5 * change),
        velocity=joints.velocity + change,
    )


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


def _arriving(batch: BodyBatch, inputs: JudgeInput) -> jax.Array | None:
    """Return the positions [3] of what has to come to the goals; None: the robots' own."""
    if inputs.reaching is None:
        return None
    return batch.map_bodies(robot.end_effector_m, inputs.reaching.vehicle, inputs.vehicle)


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
        arriving_m: jax.Array | None,
        impacts: Impacts | None,
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
            arriving_m,
            impacts,
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
        _arriving(batch, inputs),
        inputs.impacts,
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


def decide(
    batch: BodyBatch,
    robots: RobotState,
    estimate: VehicleState | Belief,
    params: ControlParams,
    command: Plan | Command | MixedCommand,
    current: Current,
    grip: GripReading | None = None,
) -> tuple[Decision, Record]:
    """Return the output of `DECIDE` and its record.

    Arguments as of `move_independently`, and what the grips of the robots measured.
    """
    return run_phase(
        DECIDE,
        batch,
        DecideInput(
            estimate=estimate,
            memory=robots.memory,
            flow=select_flow(batch, lambda: current, estimate),
            params=params,
            command=command,
            joints=robots.vehicle.joints,
            grip=grip,
            actuators=select_actuators(params, robots.vehicle),
        ),
    )


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
    decision, decided = decide(batch, robots, estimate, params, command, current)
    motion, moved = run_phase(
        MOVE,
        batch,
        MoveInput(
            vehicle=robots.vehicle,
            tally=robots.tally,
            thrust_n=decision.thrust_n,
            params=params,
            current=current,
            joints=decision.memory.joints,
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
