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
from angler_mjx.sim.phase import BatchContext, Done, Phase, Slots
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import Tally
from angler_mjx.sim.world_phases import phases as world_phases
from angler_mjx.world.obstacles import ObstacleState


def decide(here: BatchContext, now: Slots) -> Done:
    """The controllers give signals, and the thrusters settle at what these ask for."""
    spec, known = here.spec, now["known"]
    if isinstance(known, Belief):
        flow = known.flow
    else:
        flow = here.flow(known) if stack.wants_flow(spec.stages) else None
    memory, target, pwm = here.each(
        partial(robot.decide, spec), here.params, now["memory"], known, here.command, flow
    )
    thrust, power = here.each(robot.thrust_and_power, here.params.vehicle, pwm)
    return Done(
        slots=lambda: {"memory": memory, "thrust_n": thrust, "power_w": power},
        record=partial(record_decided, pwm.pwm_us, target),
    )


def record_decided(pwm_us: Any, target_m: Any) -> dict[str, Any]:
    """What is recorded of `decide`."""
    return {"pwm_us": pwm_us, "target_m": target_m}


def move(here: BatchContext, now: Slots) -> Done:
    """The physics steps of a control period; who failed or diverged stays where it was."""
    before, outcome = now["vehicle"], now["tally"].outcome
    params, current = here.params, here.current  # asked for once, not in every physics step

    def one(i: jax.Array, vehicle: VehicleState) -> VehicleState:
        t = here.t + i.astype(here.t.dtype) * here.spec.physics_dt_s
        return here.physics_step(params, vehicle, now["thrust_n"], current, t)

    def slots() -> dict[str, Any]:
        moved = here.repeat(here.spec.physics_steps, one, before)
        after, broken = here.each(robot.hold_if_ended, outcome, before, moved)
        return {"vehicle": after, "before_m": before.p, "broken": broken}

    def record() -> dict[str, Any]:
        seen = record_motion(before, outcome, here.flow(before))
        if "wrench" in here.spec.also:
            seen["wrench"] = here.each(robot.wrench, params.vehicle, outcome, before.thrust)
        return seen

    return Done(slots=slots, record=record)


def record_motion(vehicle: VehicleState, outcome: Any, flow: Any) -> dict[str, Any]:
    """What is recorded of `move`, at its beginning."""
    return {
        "p": vehicle.p,
        "q": vehicle.q,
        "nu": vehicle.nu,
        "current_mps": flow,
        "outcome": outcome,
    }


def advance_obstacles(here: BatchContext, now: Slots) -> Done:
    """Drifting and scripted bodies go on by a control period."""
    before = now["obstacles"]
    return Done(
        slots=lambda: {"obstacles": here.advance(before)},
        record=lambda: record_obstacles(before),
    )


def record_obstacles(obstacles: ObstacleState) -> dict[str, Any]:
    """What is recorded of obstacles, at the beginning of the step."""
    return {"obstacle_p": obstacles.p, "obstacle_q": obstacles.q}


def approaching(here: BatchContext, now: Slots) -> Any:
    """Return whether robots are on the last approach of their plans, bool [].

    None where no plan is flown, or a task says who has finished: there the approach does not count.
    """
    if here.last_approach_s is None:
        return here.approaching
    return here.each(
        partial(robot.approaches, here.spec), now["memory"], here.command, here.last_approach_s
    )


def judge(here: BatchContext, now: Slots) -> Done:
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
        return robot.account(
            here.spec,
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

    tally = here.each(
        account,
        here.goal_m,
        now["tally"],
        now["before_m"],
        now["vehicle"].p,
        here.contact(now),
        now["power_w"],
        now["broken"],
        here.finished,
        here.fails_at_s,
        approaching(here, now),
        shared=(*here.corners, here.t),
    )
    return Done(slots=lambda: {"tally": tally}, record=lambda: record_judged(tally))


def record_judged(tally: Tally) -> dict[str, Any]:
    """What is recorded of `judge`, at the end of the step."""
    return {}


DECIDE = Phase(
    name="decide",
    of="robot",
    run=decide,
    reads=("known", "memory"),
    gives=("memory", "thrust_n", "power_w"),
)
MOVE = Phase(
    name="move",
    of="robot",
    run=move,
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
    run=judge,
    reads=("tally", "vehicle", "before_m", "power_w", "broken", "memory"),
    gives=("tally",),
    meets=True,
)

PHASES = (*world_phases.PHASES, DECIDE, MOVE, OBSTACLES, JUDGE)
"""A control step, in order."""

ALONE = tuple(phase for phase in PHASES if phase.of == "robot" and not phase.meets)
"""What each robot does by itself; obstacles move beside them."""
MEETING = tuple(phase for phase in PHASES if phase.of == "robot" and phase.meets)
"""What follows when everything has moved."""

KEPT = ("vehicle", "memory", "tally")
"""Slots of robots that last from step to step."""
LASTING = tuple(dict.fromkeys((*KEPT, *(name for phase in MEETING for name in phase.reads))))
"""Those, and what is still read when everything has moved."""


def handed_on(number: Any, thrusters: Any) -> dict[str, Any]:
    """Shapes of what phases of one robot hand to each other within a step.

    Args:
        number: shape and type of a number [].
        thrusters: of one for each thruster.
    """
    three = jax.ShapeDtypeStruct((3,), number.dtype)
    broken = jax.ShapeDtypeStruct((), jnp.bool_)
    return {"thrust_n": thrusters, "power_w": number, "before_m": three, "broken": broken}
