"""A control step, phase by phase: the table of contents of a simulation.

    sense       world      instruments and filters: what robots are told of their own motion
    hear        world      packets of other robots that came in, and those that are sent
    policy      world      a function of what all robots of a world know commands them
    decide      robot      controllers: from a path or a command to the thrusters' signals
    move        robot      the physics steps of the control period
    obstacles   obstacle   drifting and scripted bodies
    judge       robot      contact, outcome and accounts, among all that moved

`PHASES` is that table, and engines run what stands in it: `angler_mjx.sim.engines.mjx` by ``vmap``,
the fused engines on lanes and in kernels, one for each phase of robots. A phase is a pure function
of what it reads; `BatchContext` is how an engine applies a function of one body to all that it
works on, and holds what does not change. What a phase gives to the record is declared in
`angler_mjx.sim.record`.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_mjx.robot.control import stack
from angler_mjx.sim import robot
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.phase import BatchContext, Phase, PhaseResult, Slots
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import Tally
from angler_mjx.sim.world_phases import phases as world_phases
from angler_mjx.world.obstacles import ObstacleState


def decide_commands(context: BatchContext, now: Slots) -> PhaseResult:
    """The controllers give signals, and the thrusters settle at what these ask for."""
    spec, estimate = context.spec, now["estimate"]
    if isinstance(estimate, Belief):
        flow = estimate.flow
    else:
        flow = context.flow(estimate) if stack.wants_flow(spec.stages) else None
    memory, target, pwm = context.map_bodies(
        partial(robot.run_controllers, spec),
        context.params,
        now["memory"],
        estimate,
        context.command,
        flow,
    )
    thrust, power = context.map_bodies(robot.thrust_and_power, context.params.vehicle, pwm)
    return PhaseResult(
        slots=lambda: {"memory": memory, "thrust_n": thrust, "power_w": power},
        record=partial(record_decided, pwm.pwm_us, target),
    )


def record_decided(pwm_us: Any, target_m: Any) -> dict[str, Any]:
    """What is recorded of `decide_commands`."""
    return {"pwm_us": pwm_us, "target_m": target_m}


def move_robots(context: BatchContext, now: Slots) -> PhaseResult:
    """The physics steps of a control period; who failed or diverged stays where it was."""
    before, outcome = now["vehicle"], now["tally"].outcome
    params, current = context.params, context.current  # asked for once, not in every physics step

    def physics_substep(i: jax.Array, vehicle: VehicleState) -> VehicleState:
        t = context.t + i.astype(context.t.dtype) * context.spec.physics_dt_s
        return context.physics_step(params, vehicle, now["thrust_n"], current, t)

    def slots() -> dict[str, Any]:
        moved = context.repeat(context.spec.physics_steps, physics_substep, before)
        after, broken = context.map_bodies(robot.hold_if_ended, outcome, before, moved)
        return {"vehicle": after, "before_m": before.p, "broken": broken}

    def record() -> dict[str, Any]:
        seen = record_motion(before, outcome, context.flow(before))
        if "wrench" in context.spec.also:
            seen["wrench"] = context.map_bodies(
                robot.thruster_wrench, params.vehicle, outcome, before.thrust
            )
        return seen

    return PhaseResult(slots=slots, record=record)


def record_motion(vehicle: VehicleState, outcome: Any, flow: Any) -> dict[str, Any]:
    """What is recorded of `move_robots`, at its beginning."""
    return {
        "p": vehicle.p,
        "q": vehicle.q,
        "nu": vehicle.nu,
        "current_mps": flow,
        "outcome": outcome,
    }


def advance_obstacles(context: BatchContext, now: Slots) -> PhaseResult:
    """Drifting and scripted bodies go on by a control period."""
    before = now["obstacles"]
    return PhaseResult(
        slots=lambda: {"obstacles": context.advance(before)},
        record=lambda: record_obstacles(before),
    )


def record_obstacles(obstacles: ObstacleState) -> dict[str, Any]:
    """What is recorded of obstacles, at the beginning of the step."""
    return {"obstacle_p": obstacles.p, "obstacle_q": obstacles.q}


def is_approaching(context: BatchContext, now: Slots) -> Any:
    """Return whether robots are on the last approach of their plans, bool [].

    None where no plan is flown, or a task says who has finished: there the approach does not count.
    """
    if context.last_approach_s is None:
        return context.approaching
    return context.map_bodies(
        partial(robot.is_on_last_approach, context.spec),
        now["memory"],
        context.command,
        context.last_approach_s,
    )


def judge_robots(context: BatchContext, now: Slots) -> PhaseResult:
    """What the step came to for each robot."""

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
            context.spec,
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

    tally = context.map_bodies(
        account,
        context.goal_m,
        now["tally"],
        now["before_m"],
        now["vehicle"].p,
        context.contact(now),
        now["power_w"],
        now["broken"],
        context.finished,
        context.fails_at_s,
        is_approaching(context, now),
        shared=(*context.corners, context.t),
    )
    return PhaseResult(slots=lambda: {"tally": tally}, record=lambda: record_judged(tally))


def record_judged(tally: Tally) -> dict[str, Any]:
    """What is recorded of `judge_robots`, at the end of the step."""
    return {}


DECIDE = Phase(
    name="decide",
    of="robot",
    run=decide_commands,
    reads=("estimate", "memory"),
    gives=("memory", "thrust_n", "power_w"),
)
MOVE = Phase(
    name="move",
    of="robot",
    run=move_robots,
    reads=("vehicle", "tally", "thrust_n"),
    gives=("vehicle", "before_m", "broken"),
)
OBSTACLES = Phase(
    name="obstacles",
    of="obstacle",
    run=advance_obstacles,
    reads=("obstacles",),
    gives=("obstacles",),
)
JUDGE = Phase(
    name="judge",
    of="robot",
    run=judge_robots,
    reads=("tally", "vehicle", "before_m", "power_w", "broken", "memory"),
    gives=("tally",),
    meets=True,
)

PHASES = (*world_phases.PHASES, DECIDE, MOVE, OBSTACLES, JUDGE)
"""A control step, in order."""

INDEPENDENT_PHASES = tuple(phase for phase in PHASES if phase.of == "robot" and not phase.meets)
"""What each robot does by itself; obstacles move beside them."""
INTERACTION_PHASES = tuple(phase for phase in PHASES if phase.of == "robot" and phase.meets)
"""What follows when everything has moved."""

PERSISTENT_SLOTS = ("vehicle", "memory", "tally")
"""Slots of robots that last from step to step."""
LATER_SLOTS = tuple(
    dict.fromkeys(
        (*PERSISTENT_SLOTS, *(name for phase in INTERACTION_PHASES for name in phase.reads))
    )
)
"""Those, and what is still read when everything has moved."""


def scratch_shapes(number: Any, thrusters: Any) -> dict[str, Any]:
    """Shapes of what phases of one robot hand to each other within a step.

    Args:
        number: shape and type of a number [].
        thrusters: of one for each thruster.
    """
    three = jax.ShapeDtypeStruct((3,), number.dtype)
    broken = jax.ShapeDtypeStruct((), jnp.bool_)
    return {"thrust_n": thrusters, "power_w": number, "before_m": three, "broken": broken}
