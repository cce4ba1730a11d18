"""PID on pose: the outer loop, from a pose target to a velocity over ground.

The error of position is formed in W, where the integral must live to outlast turns, and turned into
F at the end; the error of attitude is that of the quaternion. With the default gains it is P alone:
a velocity loop with an integral below it leaves no error.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.control.commands import BodyTwist, Estimate, PoseTarget
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PidPoseGains:
    """Gains of the pose loop."""

    position_per_s: float = 0.8
    """P: velocity per metre."""
    position_integral_per_s2: float = 0.0
    """I: growth of the velocity held per metre of error."""
    position_derivative: float = 0.0
    """D: velocity per m/s of error of velocity; below 1."""
    attitude_per_s: float = 2.5
    """P: angular velocity per radian."""
    integral_limit_mps: float = 0.3
    """Anti-windup: bound of the velocity held."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PidPoseCarry:
    """Memory of the pose loop."""

    integral_mps: jax.Array
    """[3] velocity held, in W."""


def check(gains: PidPoseGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("pid_pose", gains)


def reset(estimate: Estimate) -> PidPoseCarry:
    """Memory of a robot that begins."""
    return PidPoseCarry(integral_mps=jnp.zeros_like(estimate.p))


def step(
    gains: PidPoseGains,
    vehicle: VehicleParams,
    carry: PidPoseCarry,
    estimate: Estimate,
    command: PoseTarget,
    dt: float,
    density: float,
    gravity: float,
) -> tuple[PidPoseCarry, BodyTwist]:
    """One control step.

    v = v_d + k_p e + z + k_d (v_d - v), z' = k_i e, in W; bounded by `model.speed_limit`. While
    that bound is met the integral does not grow.

    Args:
        gains: of the loop.
        vehicle: of one robot.
        carry: its memory.
        estimate: its state as known to the controller.
        command: the pose to be at.
        dt: control period, s.
        density: of the water, kg/m^3; not used.
        gravity: m/s^2; not used.

    Returns:
        The new memory, and the velocity over ground to have.
    """
    error = command.position_m - estimate.p
    slip = command.velocity_mps - quaternion.rotate(estimate.q, estimate.nu[:3])
    wanted = (
        command.velocity_mps
        + gains.position_per_s * error
        + carry.integral_mps
        + gains.position_derivative * slip
    )
    velocity = model.limit_norm(wanted, model.speed_limit(vehicle))
    free = jnp.sum(wanted**2) <= model.speed_limit(vehicle) ** 2
    integral = model.hold_integral(
        carry.integral_mps,
        jnp.where(free, gains.position_integral_per_s2, 0.0) * error,
        jnp.asarray(gains.integral_limit_mps, error.dtype),
        dt,
    )
    yaw = model.choose_heading(vehicle, estimate, velocity, command.yaw_rad)
    turn = gains.attitude_per_s * model.attitude_error(estimate.q, yaw)
    nu = jnp.concatenate([quaternion.rotate_inverse(estimate.q, velocity), turn])
    return PidPoseCarry(integral_mps=integral), BodyTwist(nu=nu)
