"""The parts of a control step that concern one robot: decide, hold, account. Pure, of one robot.

Every engine runs these, as they are or on lanes; what lies between them is the engine's.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from angler_kernels import quaternion, rigid_body, thruster
from angler_mjx.robot.control import mixed, stack
from angler_mjx.robot.control.commands import Estimate, GripReading, ThrusterPwm
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import Action, Command, ControlMemory, ControlParams
from angler_mjx.robot.vehicles import link_motion
from angler_mjx.robot.vehicles.fins import settled_deflection
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.link_params import LinkParams
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.thrusters import PWM_LOW_US, PWM_STEP_US
from angler_mjx.robot.vehicles.trim import settled_trim, trim_power_w
from angler_mjx.sim.cargo import CargoError
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.impacts import Impacts
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief, JointRecord
from angler_mjx.sim.state import Outcome, SimSpec, Tally, Touched

DIVERGED_SPEED_MPS = 50.0
"""A robot faster than this has diverged: ten times what any of them can reach."""


def reset_controllers(spec: SimSpec, state: VehicleState, yaw_rad: jax.Array) -> ControlMemory:
    """The controllers' memory of a robot at its start, with its heading [] rad."""
    estimate = Estimate(p=state.p, q=state.q, nu=state.nu, joints=state.joints)
    return stack.reset(spec.stages, estimate, yaw_rad)


def run_controllers(
    spec: SimSpec,
    params: ControlParams,
    carry: ControlMemory,
    state: VehicleState | Belief,
    command: Command | MixedCommand,
    flow: jax.Array | None,
    joints: JointMotion | None = None,
    grip: GripReading | None = None,
) -> tuple[ControlMemory, jax.Array, Command]:
    """Run one control step of the controllers of one robot.

    Args:
        spec: settings.
        params: of the robot.
        carry: the controllers' memory.
        state: of the robot, or what is believed of it.
        command: to the controllers: its path, or what drives it instead.
        flow: [3] water velocity there, in W, if the controllers want to know it.
        joints: [J] motion of the joints.
        grip: measured by its grip; None where robots hold nothing.

    Returns:
        Their new memory, the position [3] that they aim at, and the command of the last stage.
    """
    step: Callable[..., Action] = mixed.step if isinstance(command, MixedCommand) else stack.step
    action = step(
        spec.stages,
        spec.gains,
        params,
        carry,
        Estimate(p=state.p, q=state.q, nu=state.nu, flow=flow, joints=joints, grip=grip),
        command,
        spec.control_dt_s,
        spec.water.density_kgpm3,
        spec.water.gravity_mps2,
    )
    return action.memory, action.target_m, action.command


def thrust_and_power(
    vehicle: VehicleParams, pwm: ThrusterPwm, actuators: jax.Array | None = None
) -> tuple[jax.Array, jax.Array]:
    """Return what signals settle at, and the power of all actuators.

    Args:
        vehicle: of the robot.
        pwm: signals [n_thruster].
        actuators: of its `VehicleState`; without them pumps and moving masses take no power.

    Returns:
        [n_thruster] thrust, N, of fins the deflection, rad, of tanks the water beyond half full,
        m^3, of moving masses the position, m; and power [] W.
    """
    rows = 0 if vehicle.thrust_n.ndim > 1 else None
    pick = jax.vmap(thruster.lookup, (rows, 0, None, None))
    thrust = pick(vehicle.thrust_n, pwm.pwm_us, PWM_LOW_US, PWM_STEP_US) * vehicle.thruster_health
    if vehicle.fins is not None:
        deflection = settled_deflection(vehicle.fins, pwm.pwm_us)
        thrust = jnp.where(vehicle.fins.is_fin, deflection, thrust)
    power = pick(vehicle.power_w, pwm.pwm_us, PWM_LOW_US, PWM_STEP_US)
    total = jnp.sum(jnp.where(vehicle.thruster_exists, power, 0.0))
    if vehicle.trim is not None:
        settled = settled_trim(vehicle.trim, pwm.pwm_us)
        thrust = jnp.where(vehicle.trim.is_trim, settled, thrust)
        if actuators is not None:
            total = total + trim_power_w(vehicle.trim, actuators, settled)
    return thrust, total


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


def record_joints(links: LinkParams, joints: JointMotion) -> JointRecord:
    """Return the record of the joints of a robot; NaN of joints that it does not have."""
    is_absent = links.armature > 0
    return JointRecord(
        position=jnp.where(is_absent, jnp.nan, joints.position),
        velocity=jnp.where(is_absent, jnp.nan, joints.velocity),
    )


def is_moving(outcome: jax.Array) -> jax.Array:
    """Return whether robots with these outcomes still move: a robot that failed is held."""
    return (outcome == Outcome.RUNNING) | (outcome == Outcome.REACHED)


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
    if after.joints is not None:
        sound &= jnp.isfinite(jnp.sum(after.joints.position) + jnp.sum(after.joints.velocity))
    goes_on = is_moving(outcome) & sound
    held = VehicleState(
        p=jnp.where(goes_on, after.p, before.p),
        q=jnp.where(goes_on, after.q, before.q),
        nu=jnp.where(goes_on, after.nu, 0.0),
        force_before=jnp.where(goes_on, after.force_before, 0.0),
        thrust=jnp.where(goes_on, after.thrust, 0.0),
        joints=_hold_joints(goes_on, before.joints, after.joints),
        change=None if after.change is None else jnp.where(goes_on, after.change, 0.0),
    )
    return held, is_moving(outcome) & ~sound


def _hold_joints(
    goes_on: jax.Array, before: JointMotion | None, after: JointMotion | None
) -> JointMotion | None:
    """Return joints as they move on, or held where they were."""
    if before is None or after is None:
        return None
    return JointMotion(
        position=jnp.where(goes_on, after.position, before.position),
        velocity=jnp.where(goes_on, after.velocity, 0.0),
    )


def end_effector_m(vehicle: VehicleParams, state: VehicleState) -> jax.Array:
    """Return the position [3] of a robot's end effector, m, in W.

    Raises:
        ValueError: the vehicle has none.
    """
    if vehicle.links is None or state.joints is None:
        raise ValueError("the vehicle has no end effector")
    tip = link_motion.locate_end_effector(vehicle.links, state.joints.position)
    return state.p + quaternion.rotate(state.q, tip.position)


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


def begin_tally(
    contact: Contact,
    dtype: DTypeLike,
    *,
    collides: bool = False,
    cargo: CargoError | None = None,
) -> Tally:
    """Return the tally of running robots at their starts, [R] leading.

    Args:
        contact: of the start; [R] leads.
        dtype: of numbers that are accumulated.
        collides: whether impacts are accounted for, because a touch is not the end.
        cargo: [R] error of what the robots carry; None where they carry nothing together.
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
        impact_energy_j=jnp.zeros(n, dtype) if collides else None,
        contact_depth_m=jnp.zeros(n, dtype) if collides else None,
        grip_force_n=None if cargo is None else jnp.zeros(n, dtype),
        internal_force_n=None if cargo is None else jnp.zeros(n, dtype),
        cargo_error=cargo,
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
    arriving_m: jax.Array | None = None,
    impacts: Impacts | None = None,
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
        arriving_m: [3] what has to be at the goal, in W; its own position if left out.
        impacts: what contact did to it in the step; None where the first touch is the end.
    """
    running = tally.outcome == Outcome.RUNNING
    dt = spec.control_dt_s
    passed_early = tally.passed_early
    if finished is None:
        arriving_m = after_m if arriving_m is None else arriving_m
        finished = jnp.sqrt(jnp.sum((arriving_m - goal_m) ** 2)) < spec.goal_tolerance_m
        if approaching is not None:
            passed_early = passed_early | (running & finished & ~approaching)
            finished = finished & approaching
    fails = None if fails_at_s is None else t + dt >= fails_at_s
    collision = _judge_collision(contact) if impacts is None else _judge_damage(spec, impacts)
    outcome = jnp.where(
        running, _judge_outcome(finished, fails, lo, hi, after_m, collision, broken), tally.outcome
    )
    touch = _log_touch(tally, contact, impacts, running, outcome)
    moved = jnp.sqrt(jnp.sum((after_m - before_m) ** 2))
    clearance = jnp.minimum(tally.min_clearance_m, contact.clearance_m)
    separation = jnp.minimum(tally.min_separation_m, contact.separation_m)
    after = Tally(
        outcome=outcome,
        end_time_s=jnp.where(running, t + dt, tally.end_time_s),
        passed_early=passed_early,
        path_length_m=tally.path_length_m + jnp.where(running, moved, 0.0),
        energy_j=tally.energy_j + jnp.where(running, power * dt, 0.0),
        min_clearance_m=jnp.where(running, clearance, tally.min_clearance_m),
        min_separation_m=jnp.where(running, separation, tally.min_separation_m),
        touched=touch.touched,
        touched_index=touch.touched_index,
        impact_speed_mps=touch.impact_speed_mps,
        impact_energy_j=touch.impact_energy_j,
        contact_depth_m=touch.contact_depth_m,
        grip_force_n=tally.grip_force_n,
        internal_force_n=tally.internal_force_n,
        cargo_error=tally.cargo_error,
    )
    return _log_grip(after, impacts, running)


def _log_grip(tally: Tally, impacts: Impacts | None, running: jax.Array) -> Tally:
    """Return a tally with what a step did to a robot that carries something with others."""
    if impacts is None or impacts.grips is None:
        return tally
    now = (impacts.grips.force_n, impacts.grips.internal_n)
    most = [
        None if old is None else jnp.where(running, jnp.maximum(old, new), old)
        for old, new in zip((tally.grip_force_n, tally.internal_force_n), now, strict=True)
    ]
    error: CargoError | None = jax.tree.map(
        lambda new, old: jnp.where(running, new, old), impacts.cargo, tally.cargo_error
    )
    return replace(tally, grip_force_n=most[0], internal_force_n=most[1], cargo_error=error)


@dataclass(frozen=True, kw_only=True)
class _Touch:
    """Fields of `Tally` of what a robot touched."""

    touched: jax.Array
    touched_index: jax.Array
    impact_speed_mps: jax.Array
    impact_energy_j: jax.Array | None = None
    contact_depth_m: jax.Array | None = None


def _log_touch(
    tally: Tally,
    contact: Contact,
    impacts: Impacts | None,
    running: jax.Array,
    outcome: jax.Array,
) -> _Touch:
    """Return what a robot touched: what ended its episode or, with contact, its hardest impact."""
    depth = tally.contact_depth_m
    if impacts is None or tally.impact_energy_j is None or depth is None:
        hit = running & (
            (outcome == Outcome.COLLISION_STATIC)
            | (outcome == Outcome.COLLISION_DYNAMIC)
            | (outcome == Outcome.COLLISION_ROBOT)
        )
        kind, index = contact.nearest, contact.nearest_index
        speed, energy = contact.closing_speed_mps, None
    else:
        hit = running & (impacts.touched != Touched.NOTHING)
        hit &= (tally.touched == Touched.NOTHING) | (impacts.energy_j > tally.impact_energy_j)
        kind, index = impacts.touched, impacts.touched_index
        speed = impacts.closing_speed_mps
        energy = jnp.where(hit, impacts.energy_j, tally.impact_energy_j)
        depth = jnp.where(running, jnp.maximum(impacts.depth_m, depth), depth)
    return _Touch(
        touched=jnp.where(hit, kind, tally.touched).astype(jnp.int32),
        touched_index=jnp.where(hit, index, tally.touched_index).astype(jnp.int32),
        impact_speed_mps=jnp.where(hit, speed, tally.impact_speed_mps),
        impact_energy_j=energy,
        contact_depth_m=depth,
    )


def _judge_collision(contact: Contact) -> tuple[jax.Array, jax.Array]:
    """Return bool [] whether a robot touches something, and int32 [] the outcome of that."""
    outcome = jnp.where(
        contact.nearest == Touched.ROBOT,
        Outcome.COLLISION_ROBOT,
        jnp.where(contact.nearest_is_static, Outcome.COLLISION_STATIC, Outcome.COLLISION_DYNAMIC),
    )
    return jnp.minimum(contact.clearance_m, contact.separation_m) <= 0.0, outcome


def _judge_damage(spec: SimSpec, impacts: Impacts) -> tuple[jax.Array, jax.Array]:
    """Return bool [] whether an impact damages a robot or its grip broke, and which outcome."""
    limit = None if spec.contact is None else spec.contact.damage_energy_j
    damaged = impacts.energy_j > (jnp.inf if limit is None else limit)
    if impacts.grips is None:
        return damaged, jnp.full((), Outcome.DAMAGED)
    dropped = impacts.grips.broke
    return damaged | dropped, jnp.where(damaged, Outcome.DAMAGED, Outcome.DROPPED)


def _judge_outcome(
    finished: jax.Array,
    fails: jax.Array | None,
    lo: jax.Array,
    hi: jax.Array,
    p: jax.Array,
    collision: tuple[jax.Array, jax.Array],
    broken: jax.Array,
) -> jax.Array:
    """int32 []: what the state means for a robot that is still on its way.

    Args:
        finished: bool [] it has arrived, or done its part.
        fails: bool [] it breaks down; None where none can.
        lo: [3] lower corner of the region, m, in W.
        hi: [3] upper corner.
        p: [3] m in W.
        collision: bool [] whether a touch ends the episode, and int32 [] with which outcome.
        broken: bool [] it diverged.
    """
    outside = jnp.any((p < lo) | (p > hi))
    outcome = jnp.where(finished, Outcome.REACHED, Outcome.RUNNING)
    if fails is not None:
        outcome = jnp.where(fails, Outcome.FAILED, outcome)
    outcome = jnp.where(outside, Outcome.OUT_OF_BOUNDS, outcome)
    outcome = jnp.where(collision[0], collision[1], outcome)
    return jnp.where(broken, Outcome.DIVERGED, outcome).astype(jnp.int32)
