"""The parts of a control step that concern one robot: decide, hold, account. Pure, of one robot.

Every engine runs these, as they are or on lanes; what lies between them is the engine's.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from angler_kernels import rigid_body, thruster
from angler_mjx.robot.control import mixed, stack
from angler_mjx.robot.control.commands import Estimate, ThrusterPwm
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import Action, Command, ControlMemory, ControlParams
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.thrusters import PWM_LOW_US, PWM_STEP_US
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import Outcome, SimSpec, Tally, Touched

DIVERGED_SPEED_MPS = 50.0
"""A robot faster than this has diverged: ten times what any of them can reach."""


def reset_controllers(spec: SimSpec, state: VehicleState, yaw_rad: jax.Array) -> ControlMemory:
    """The controllers' memory of a robot at its start, with its heading [] rad."""
    return stack.reset(spec.stages, Estimate(p=state.p, q=state.q, nu=state.nu), yaw_rad)


def run_controllers(
    spec: SimSpec,
    params: ControlParams,
    carry: ControlMemory,
    state: VehicleState | Belief,
    command: Command | MixedCommand,
    flow: jax.Array | None,
) -> tuple[ControlMemory, jax.Array, Command]:
    """Run one control step of the controllers of one robot.

    Args:
        spec: settings.
        params: of the robot.
        carry: the controllers' memory.
        state: of the robot, or what is believed of it.
        command: to the controllers: its path, or what drives it instead.
        flow: [3] water velocity there, in W, if the controllers want to know it.

    Returns:
        Their new memory, the position [3] that they aim at, and the command of the last stage.
    """
    step: Callable[..., Action] = mixed.step if isinstance(command, MixedCommand) else stack.step
    action = step(
        spec.stages,
        spec.gains,
        params,
        carry,
        Estimate(p=state.p, q=state.q, nu=state.nu, flow=flow),
        command,
        spec.control_dt_s,
        spec.water.density_kgpm3,
        spec.water.gravity_mps2,
    )
    return action.memory, action.target_m, action.command


def thrust_and_power(vehicle: VehicleParams, pwm: ThrusterPwm) -> tuple[jax.Array, jax.Array]:
    """Thrust [n_thruster] N that a signal settles at, and the power [] W of all thrusters."""
    pick = jax.vmap(thruster.lookup, (None, 0, None, None))
    thrust = pick(vehicle.thrust_n, pwm.pwm_us, PWM_LOW_US, PWM_STEP_US) * vehicle.thruster_health
    power = pick(vehicle.power_w, pwm.pwm_us, PWM_LOW_US, PWM_STEP_US)
    return thrust, jnp.sum(jnp.where(vehicle.thruster_exists, power, 0.0))


def thruster_wrench(vehicle: VehicleParams, outcome: jax.Array, thrust: jax.Array) -> jax.Array:
    """Force and moment [6] of the thrusters, N and N m, in F; NaN once the robot has diverged.

    Args:
        vehicle: of the robot.
        outcome: int32 [].
        thrust: of its `VehicleState`.
    """
    thrust_n = thrust if thrust.ndim == 1 else thrust[0]
    body_wrench = rigid_body.matrix_times(vehicle.B, thrust_n)
    return jnp.where(outcome == Outcome.DIVERGED, jnp.nan, body_wrench)


def hold_if_ended(
    outcome: jax.Array, before: VehicleState, after: VehicleState
) -> tuple[VehicleState, jax.Array]:
    """Hold a robot that failed or just diverged where it was, at rest.

    Args:
        outcome: int32 [] before the step.
        before: state before the step.
        after: state after it.

    Returns:
        The state to go on with, and bool [] whether the robot diverged in this step.
    """
    speed = jnp.sum(jnp.abs(after.nu))
    sound = jnp.isfinite(speed) & jnp.isfinite(jnp.sum(after.p)) & jnp.isfinite(jnp.sum(after.q))
    sound &= speed < DIVERGED_SPEED_MPS
    alive = (outcome == Outcome.RUNNING) | (outcome == Outcome.REACHED)
    goes_on = alive & sound
    held = VehicleState(
        p=jnp.where(goes_on, after.p, before.p),
        q=jnp.where(goes_on, after.q, before.q),
        nu=jnp.where(goes_on, after.nu, 0.0),
        force_before=jnp.where(goes_on, after.force_before, 0.0),
        thrust=jnp.where(goes_on, after.thrust, 0.0),
    )
    return held, alive & ~sound


def is_on_last_approach(
    spec: SimSpec,
    memory: ControlMemory,
    command: Command | MixedCommand,
    last_approach_s: jax.Array,
) -> jax.Array:
    """Return whether a robot is on the last approach of its plan to its goal, bool [].

    Args:
        spec: settings.
        memory: of the controllers, after the step.
        command: the plan, or a `MixedCommand` command that may hold one.
        last_approach_s: [] s, of `plans.last_approach_s`.
    """
    progress_s: Callable[..., jax.Array] = (
        mixed.progress_s if isinstance(command, MixedCommand) else stack.progress_s
    )
    return progress_s(spec.stages, memory, command) >= last_approach_s


def begin_tally(contact: Contact, dtype: DTypeLike) -> Tally:
    """Return the tally of running robots at their starts, [R] leading.

    Args:
        contact: of the start; [R] leads.
        dtype: of numbers that are accumulated.
    """
    n = contact.clearance_m.shape[0]
    return Tally(
        outcome=jnp.zeros(n, jnp.int32),
        end_time_s=jnp.zeros(n, dtype),
        passed_early=jnp.zeros(n, bool),
        path_length_m=jnp.zeros(n, dtype),
        energy_j=jnp.zeros(n, dtype),
        min_clearance_m=contact.clearance_m,
        min_separation_m=contact.separation_m,
        touched=jnp.zeros(n, jnp.int32),
        touched_index=jnp.full(n, -1, jnp.int32),
        impact_speed_mps=jnp.full(n, jnp.nan, dtype),
    )


def update_tally(
    spec: SimSpec,
    goal_m: jax.Array,
    lo: jax.Array,
    hi: jax.Array,
    tally: Tally,
    before_m: jax.Array,
    after_m: jax.Array,
    contact: Contact,
    power: jax.Array,
    broken: jax.Array,
    t: jax.Array,
    finished: jax.Array | None = None,
    fails_at_s: jax.Array | None = None,
    approaching: jax.Array | None = None,
) -> Tally:
    """Account for one control step of a robot, if it is still on its way.

    Args:
        spec: settings.
        goal_m: [3] in W.
        lo: [3] lower corner of the region, m, in W.
        hi: [3] upper corner.
        tally: so far.
        before_m: [3] position before the step, in W.
        after_m: [3] and after it.
        contact: after it.
        power: [] W during it.
        broken: bool [] the robot diverged in it.
        t: [] s at its beginning.
        finished: bool [] its part of the task is done; where there is a task, its goal is not
            looked at.
        fails_at_s: [] s when it breaks down, if robots can.
        approaching: bool [] whether it is on the last approach of its plan; without a plan its goal
            alone counts.
    """
    running = tally.outcome == Outcome.RUNNING
    dt = spec.control_dt_s
    passed_early = tally.passed_early
    if finished is None:
        finished = jnp.sqrt(jnp.sum((after_m - goal_m) ** 2)) < spec.goal_tolerance_m
        if approaching is not None:
            passed_early = passed_early | (running & finished & ~approaching)
            finished = finished & approaching
    fails = None if fails_at_s is None else t + dt >= fails_at_s
    outcome = jnp.where(
        running, _judge_outcome(finished, fails, lo, hi, after_m, contact, broken), tally.outcome
    )
    hit = running & (
        (outcome == Outcome.COLLISION_STATIC)
        | (outcome == Outcome.COLLISION_DYNAMIC)
        | (outcome == Outcome.COLLISION_ROBOT)
    )
    moved = jnp.sqrt(jnp.sum((after_m - before_m) ** 2))
    clearance = jnp.minimum(tally.min_clearance_m, contact.clearance_m)
    separation = jnp.minimum(tally.min_separation_m, contact.separation_m)
    return Tally(
        outcome=outcome,
        end_time_s=jnp.where(running, t + dt, tally.end_time_s),
        passed_early=passed_early,
        path_length_m=tally.path_length_m + jnp.where(running, moved, 0.0),
        energy_j=tally.energy_j + jnp.where(running, power * dt, 0.0),
        min_clearance_m=jnp.where(running, clearance, tally.min_clearance_m),
        min_separation_m=jnp.where(running, separation, tally.min_separation_m),
        touched=jnp.where(hit, contact.nearest, tally.touched).astype(jnp.int32),
        touched_index=jnp.where(hit, contact.nearest_index, tally.touched_index).astype(jnp.int32),
        impact_speed_mps=jnp.where(hit, contact.closing_speed_mps, tally.impact_speed_mps),
    )


def _judge_outcome(
    finished: jax.Array,
    fails: jax.Array | None,
    lo: jax.Array,
    hi: jax.Array,
    p: jax.Array,
    contact: Contact,
    broken: jax.Array,
) -> jax.Array:
    """int32 []: what the state means for a robot that is still on its way."""
    outside = jnp.any((p < lo) | (p > hi))
    touching = jnp.minimum(contact.clearance_m, contact.separation_m) <= 0.0
    collision = jnp.where(
        contact.nearest == Touched.ROBOT,
        Outcome.COLLISION_ROBOT,
        jnp.where(contact.nearest_is_static, Outcome.COLLISION_STATIC, Outcome.COLLISION_DYNAMIC),
    )
    outcome = jnp.where(finished, Outcome.REACHED, Outcome.RUNNING)
    if fails is not None:
        outcome = jnp.where(fails, Outcome.FAILED, outcome)
    outcome = jnp.where(outside, Outcome.OUT_OF_BOUNDS, outcome)
    outcome = jnp.where(touching, collision, outcome)
    return jnp.where(broken, Outcome.DIVERGED, outcome).astype(jnp.int32)
