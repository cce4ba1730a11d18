"""View of a simulated scene after each step: one compiled function of its state."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion
from angler_kernels.rigid_body import matrix_times
from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.commands import (
    BodyWrench,
    Estimate,
    GripReading,
    ThrusterPwm,
    joint_tolerance,
)
from angler_mjx.robot.control.commands.joint_tolerance import Tolerances
from angler_mjx.robot.control.commands.joint_trajectory import (
    VEHICLE_JOINTS,
    JointState,
    JointTrajectory,
)
from angler_mjx.robot.control.commands.whole_body import JointTarget
from angler_mjx.robot.control.laws.follow import FollowCarry
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.runs.session.fleet_facts import FleetFacts
from angler_mjx.runs.session.interface import (
    Floats,
    Observation,
    RobotStatus,
    SceneCargo,
    SceneObstacles,
)
from angler_mjx.sim import robot
from angler_mjx.sim.cargo import CargoError, read_grips
from angler_mjx.sim.detection import detect_contacts
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import FleetWorld, WorldState


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WatchedTrajectories:
    """JointTrajectories with monitored tolerances; [R] leads."""

    trajectory: JointTrajectory
    allowed: Tolerances
    before: jax.Array
    """int32 [R] result of the step before; see `joint_tolerance.evaluate_goal`."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CargoView:
    """Body that robots hold together; [R] leads."""

    held: jax.Array
    reading: GripReading
    error: CargoError


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class StateView:
    """Scene at one time; [R] leads."""

    p: jax.Array
    q: jax.Array
    nu: jax.Array
    yaw_rad: jax.Array
    outcome: jax.Array
    pwm_us: jax.Array
    realised: jax.Array
    """[R, 6] N, N m."""
    demanded: jax.Array | None
    clearance_m: jax.Array
    obstacle_p: jax.Array
    obstacle_q: jax.Array
    clock_s: jax.Array
    """[R] progress along the path by the guidance, s; 0 where it keeps no clock."""
    heading_rad: jax.Array
    """[R] heading that the guidance demands; the robot's own where it keeps none."""
    result: jax.Array
    """int32 [R] result, a `joint_tolerance.ResultCode`."""
    joints: JointMotion | None = None
    """[R, J] motion of the joints, NaN of a robot without an arm; None where no robot has one."""
    joint_target: JointTarget | None = None
    """[R, J] motion that the joints were commanded in the step before."""
    cargo: CargoView | None = None
    """None where robots hold nothing together."""

    def arm_position(self, robot: int) -> Floats | None:
        """Return the positions [J] of a robot's joints, rad or m; None of one without an arm.

        Of a view on the host.
        """
        if self.joints is None:
            return None
        position = np.asarray(self.joints.position[robot], float)
        return position if np.isfinite(position).all() else None


@jax.jit
def view_state(
    worlds: FleetWorld, state: WorldState, pwm_us: jax.Array, watched: WatchedTrajectories | None
) -> StateView:
    """Return the view of the first world of a tile.

    Args:
        worlds: world, [1] leads.
        state: its state, [1] leads.
        pwm_us: [1, R, n_thruster] signals of the step before.
        watched: monitored trajectories, where the controllers take JointTrajectories.
    """
    world, current, signals = jax.tree.map(lambda leaf: leaf[0], (worlds, state, pwm_us))
    vehicles: VehicleState = current.vehicles
    yaw = jax.vmap(quaternion.yaw)(vehicles.q)
    first = current.carry.stages[0]
    clock, heading = jnp.zeros_like(yaw), yaw
    result = jnp.zeros_like(current.tally.outcome)
    if isinstance(first, FollowCarry):
        clock, heading = first.clock_s, first.yaw_rad
        if watched is not None:
            measured = jax.vmap(_measure_joints)(vehicles, yaw)
            allowed = jax.vmap(_lift_tolerances)(watched.trajectory, watched.allowed)
            result = jax.vmap(joint_tolerance.evaluate_goal)(
                watched.trajectory, allowed, clock, measured, watched.before
            )
    contact = detect_contacts(world.environment, world.control.vehicle, vehicles, current.obstacles)
    demanded = current.carry.demanded
    return StateView(
        p=vehicles.p,
        q=vehicles.q,
        nu=vehicles.nu,
        yaw_rad=yaw,
        outcome=current.tally.outcome,
        pwm_us=signals,
        realised=jax.vmap(_realised_wrench)(world.control.vehicle, signals),
        demanded=None if demanded is None else demanded.tau,
        clearance_m=contact.clearance_m,
        obstacle_p=current.obstacles.p,
        obstacle_q=current.obstacles.q,
        clock_s=clock,
        heading_rad=heading,
        result=result,
        joints=_view_joints(world.control.vehicle, vehicles),
        joint_target=current.carry.joints,
        cargo=_view_cargo(world, current),
    )


def _view_cargo(world: FleetWorld, state: WorldState) -> CargoView | None:
    """Return the view of the body that robots of one world hold; None where they hold nothing."""
    grips, error = state.grips, state.tally.cargo_error
    if grips is None or error is None:
        return None
    reading = read_grips(grips, world.grip_sensors, state.step)
    return CargoView(held=grips.held, reading=reading, error=error)


def _view_joints(vehicle: VehicleParams, vehicles: VehicleState) -> JointMotion | None:
    """Return the motion [R, J] of the joints of robots; None where no robot has any."""
    if vehicle.links is None or vehicles.joints is None:
        return None
    recorded = jax.vmap(robot.record_joints)(vehicle.links, vehicles.joints)
    return JointMotion(position=recorded.position, velocity=recorded.velocity)


def _lift_tolerances(trajectory: JointTrajectory, allowed: Tolerances) -> Tolerances:
    """Return the tolerances of one robot without those of arm joints that are not commanded."""
    is_judged = trajectory.commanded.at[: len(VEHICLE_JOINTS)].set(True)

    def lift(limit: jax.Array) -> jax.Array:
        return jnp.where(is_judged, limit, jnp.inf)

    return replace(
        allowed, path=jax.tree.map(lift, allowed.path), goal=jax.tree.map(lift, allowed.goal)
    )


def _measure_joints(vehicle: VehicleState, yaw: jax.Array) -> JointState:
    """Return a robot's joints x, y, z and yaw, then its arm's; accelerations are not measured."""
    velocity = quaternion.rotate(vehicle.q, vehicle.nu[:3])
    turn = quaternion.rotate(vehicle.q, vehicle.nu[3:])[2:]
    joints, rates = jnp.concatenate([vehicle.p, yaw[None]]), jnp.concatenate([velocity, turn])
    if vehicle.joints is not None:
        joints = jnp.concatenate([joints, vehicle.joints.position])
        rates = jnp.concatenate([rates, vehicle.joints.velocity])
    return JointState(position=joints, velocity=rates, acceleration=jnp.zeros_like(joints))


def _realised_wrench(vehicle: VehicleParams, pwm_us: jax.Array) -> jax.Array:
    """Return the wrench [6] that signals settle at, faults included."""
    thrust, _ = robot.thrust_and_power(vehicle, ThrusterPwm(pwm_us=pwm_us))
    wrench: jax.Array = matrix_times(vehicle.B, thrust)
    return wrench


def rotate_vectors(q: Floats, v: Floats) -> Floats:
    """Rotate vectors [..., 3] from F to W on the host, at attitudes [..., 4]."""
    w, axis = q[..., :1], q[..., 1:]
    twice_cross = 2.0 * np.cross(axis, v)
    rotated: Floats = v + w * twice_cross + np.cross(axis, twice_cross)
    return rotated


def apply_belief(view: StateView, belief: Belief | None) -> StateView:
    """Return the view with the controllers' estimate: the only source of the estimate.

    Args:
        view: true state.
        belief: belief of the step before, [1] leads. None where it is the truth.
    """
    if belief is None:
        return view
    p, q, nu = (np.asarray(part)[0] for part in (belief.p, belief.q, belief.nu))
    w, x, y, z = np.moveaxis(q, -1, 0)
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return replace(view, p=as_leaf(p), q=as_leaf(q), nu=as_leaf(nu), yaw_rad=as_leaf(yaw))


def belief_covariance(belief: Belief | None) -> Floats | None:
    """Return covariance [R, 9, 9] of position, attitude and velocity, as known: the diagonal."""
    if belief is None:
        return None
    parts = (belief.position_std_m, belief.attitude_std_rad, belief.velocity_std_mps)
    std = np.concatenate([np.asarray(part)[0] for part in parts], axis=-1)
    variance: Floats = std[:, :, None] * std[:, None, :] * np.eye(9)
    return variance


def _build_estimate(view: StateView) -> Estimate:
    return Estimate(p=view.p, q=view.q, nu=view.nu, joints=view.joints)


def _build_cargo(facts: FleetFacts, view: StateView) -> SceneCargo | None:
    cargo = view.cargo
    if cargo is None or facts.cargo is None:
        return None
    return SceneCargo(
        obstacle=facts.cargo,
        held=np.asarray(cargo.held),
        reading=cargo.reading,
        distance_m=np.asarray(cargo.error.distance_m),
        angle_rad=np.asarray(cargo.error.angle_rad),
    )


def build_observation(
    facts: FleetFacts,
    view: StateView,
    estimated: StateView,
    *,
    time_s: float,
    covariance: Floats | None,
    target_m: Floats,
    status: tuple[RobotStatus, ...],
) -> Observation:
    """Build an observation of a session.

    Args:
        facts: facts of its robots.
        view: true state.
        estimated: view with the controllers' estimate.
        time_s: time of the session.
        covariance: see `Observation`.
        target_m: [R, 3] set-point of the position in the last step, in W.
        status: status of each robot.
    """
    rows = facts.obstacles
    return Observation(
        time_s=time_s,
        estimate=_build_estimate(estimated),
        covariance=covariance,
        truth=_build_estimate(view),
        pwm=ThrusterPwm(pwm_us=view.pwm_us),
        demanded=None if view.demanded is None else BodyWrench(tau=view.demanded),
        realised=BodyWrench(tau=view.realised),
        target_m=target_m,
        clearance_m=np.asarray(view.clearance_m),
        obstacles=SceneObstacles(
            position_m=np.asarray(view.obstacle_p)[rows.which],
            attitude=np.asarray(view.obstacle_q)[rows.which],
            kind=rows.kind,
            half_size_m=rows.size_m,
        ),
        cargo=_build_cargo(facts, view),
        status=status,
    )
