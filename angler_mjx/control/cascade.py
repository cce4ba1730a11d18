"""The default cascade: follow a trajectory, hold a pose, hold a velocity, command the thrusters.

Each stage is a pure function ``(params, carry, estimate, command) -> (carry, next command down)``
of one robot. The order is guidance -> pose loop -> velocity loop -> allocation.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion, rigid_body
from angler_kernels.rigid_body import matrix_times
from angler_mjx.control import allocation, trajectory
from angler_mjx.control.allocation import AllocationParams
from angler_mjx.control.commands import BodyTwist, BodyWrench, Estimate, PoseTarget, ThrusterPwm
from angler_mjx.control.trajectory import Trajectory
from angler_mjx.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Gains:
    """Gains of the cascade, one set for all; each loop takes its inertia from its vehicle.

    Numbers in a run; a pytree, so that they can be differentiated (`angler_mjx.sim.gradients`).
    """

    position_per_s: float = 0.8
    """Pose loop: velocity per metre of position error."""
    attitude_per_s: float = 2.5
    """Pose loop: angular velocity per radian of attitude error."""
    velocity_per_s: float = 2.5
    """Velocity loop: acceleration per m/s of error."""
    rate_per_s: float = 4.0
    """Velocity loop: angular acceleration per rad/s of error."""
    integral_per_s2: float = 1.5
    """Velocity loop: growth of the acceleration held against the current."""
    integral_limit_mps2: float = 3.0
    """Anti-windup: bound of that acceleration."""
    yaw_rate_radps: float = 0.6
    """Guidance: how fast the heading reference turns."""
    lag_slow_m: float = 0.4
    """Guidance: behind the reference by more than this, its clock slows down ..."""
    lag_stop_m: float = 1.0
    """... and at this distance it waits."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CascadeParams:
    """What the cascade knows of one vehicle."""

    vehicle: VehicleParams
    allocation: AllocationParams
    cruise_speed_mps: jax.Array
    """[] speed along a planned path."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CascadeCarry:
    """Memory of the cascade of one robot."""

    clock_s: jax.Array
    """[] time along the trajectory; runs slower than time while the robot is behind."""
    yaw_rad: jax.Array
    """[] heading reference."""
    integral: jax.Array
    """[6] acceleration held against what the model does not know, in F."""


def reset(yaw_rad: jax.Array) -> CascadeCarry:
    """Carry of a robot that starts with a heading []."""
    return CascadeCarry(
        clock_s=jnp.zeros_like(yaw_rad),
        yaw_rad=yaw_rad,
        integral=jnp.zeros(6, yaw_rad.dtype),
    )


def step(
    gains: Gains,
    params: CascadeParams,
    carry: CascadeCarry,
    estimate: Estimate,
    path: Trajectory,
    dt: float,
    density: float,
    gravity: float,
) -> tuple[CascadeCarry, PoseTarget, ThrusterPwm]:
    """One control step of the whole cascade.

    Args:
        gains: of the cascade.
        params: of one robot.
        carry: its memory.
        estimate: its state as known to the controller.
        path: what it is to follow.
        dt: control period, s.
        density: of the water, kg/m^3.
        gravity: m/s^2.

    Returns:
        The new memory, the pose that was aimed at, and the thruster signals.
    """
    carry, target = guidance(gains, carry, estimate, path, dt)
    twist = pose_loop(gains, params, estimate, target)
    carry, wrench = velocity_loop(gains, params, carry, estimate, twist, dt, density, gravity)
    return carry, target, allocation.allocate(params.allocation, wrench)


def guidance(
    gains: Gains, carry: CascadeCarry, estimate: Estimate, path: Trajectory, dt: float
) -> tuple[CascadeCarry, PoseTarget]:
    """Move a target along a trajectory, waiting for the robot when it falls behind.

    The heading follows the path's horizontal direction, turning at a limited rate.
    """
    position, velocity = trajectory.sample(path, carry.clock_s)
    lag = jnp.sqrt(jnp.sum((position - estimate.p) ** 2))
    pace = jnp.clip((gains.lag_stop_m - lag) / (gains.lag_stop_m - gains.lag_slow_m), 0.0, 1.0)
    moving = velocity[0] ** 2 + velocity[1] ** 2 > 0.05**2
    wanted = jnp.where(
        moving,
        jnp.arctan2(jnp.where(moving, velocity[1], 0.0), jnp.where(moving, velocity[0], 1.0)),
        carry.yaw_rad,
    )
    turn = jnp.clip(
        wrap(wanted - carry.yaw_rad), -gains.yaw_rate_radps * dt, gains.yaw_rate_radps * dt
    )
    carry = CascadeCarry(
        clock_s=carry.clock_s + pace * dt,
        yaw_rad=wrap(carry.yaw_rad + turn),
        integral=carry.integral,
    )
    return carry, PoseTarget(
        position_m=position, velocity_mps=pace * velocity, yaw_rad=carry.yaw_rad
    )


def pose_loop(
    gains: Gains, params: CascadeParams, estimate: Estimate, target: PoseTarget
) -> BodyTwist:
    """Velocity that closes the pose error: P on position and on attitude, level.

    The speed is bounded by 1.5 times the cruise speed, and by 90 % of the vehicle's slowest
    terminal speed.
    """
    velocity = target.velocity_mps + gains.position_per_s * (target.position_m - estimate.p)
    speed = jnp.sqrt(jnp.sum(velocity**2) + 1e-12)
    bound = jnp.minimum(
        1.5 * params.cruise_speed_mps, 0.9 * jnp.min(params.vehicle.terminal_speed_mps)
    )
    velocity = velocity * jnp.minimum(1.0, bound / speed)
    wanted = quaternion.from_yaw(target.yaw_rad)
    error = quaternion.multiply(quaternion.conjugate(estimate.q), wanted)
    rotation = 2.0 * jnp.where(error[0] < 0, -1.0, 1.0) * error[1:]
    return BodyTwist(
        nu=jnp.concatenate(
            [quaternion.rotate_inverse(estimate.q, velocity), gains.attitude_per_s * rotation]
        )
    )


def velocity_loop(
    gains: Gains,
    params: CascadeParams,
    carry: CascadeCarry,
    estimate: Estimate,
    command: BodyTwist,
    dt: float,
    density: float,
    gravity: float,
) -> tuple[CascadeCarry, BodyWrench]:
    """PI on velocity, scaled by the vehicle's inertia; drag, C_A and net weight are fed forward.

    tau = (M_RB + M_A) (K_p e + z) + D(nu_cmd) nu_cmd + C_A(nu_cmd) nu_cmd + (W - B) up; z
    integrates e and is bounded. C_A holds the Munk moment, which would pitch and roll a vehicle
    that moves along two axes at once.
    """
    vehicle = params.vehicle
    error = command.nu - estimate.nu
    proportional = error * jnp.array(
        [gains.velocity_per_s] * 3 + [gains.rate_per_s] * 3, error.dtype
    )
    integral = jnp.clip(
        carry.integral + gains.integral_per_s2 * dt * error,
        -gains.integral_limit_mps2,
        gains.integral_limit_mps2,
    )
    acceleration = proportional + integral
    dry = jnp.concatenate(
        [
            vehicle.mass_kg * acceleration[:3],
            matrix_times(vehicle.inertia_kgm2, acceleration[3:]),
        ]
    )
    lift = (density * vehicle.volume_m3 - vehicle.mass_kg) * gravity
    drag = rigid_body.damping_wrench(vehicle.D_l, vehicle.D_q, command.nu)
    munk = rigid_body.added_mass_coriolis(vehicle.M_A, command.nu)
    buoyancy = rigid_body.buoyancy_wrench(estimate.q, lift, jnp.zeros(3, error.dtype))
    tau = dry + matrix_times(vehicle.M_A, acceleration) + munk - drag - buoyancy
    return (
        CascadeCarry(clock_s=carry.clock_s, yaw_rad=carry.yaw_rad, integral=integral),
        BodyWrench(tau=tau),
    )


def wrap(angle: jax.Array) -> jax.Array:
    """The same angle within [-pi, pi)."""
    return jnp.mod(angle + jnp.pi, 2 * jnp.pi) - jnp.pi
