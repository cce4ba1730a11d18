"""Computed torque: the vehicle's own dynamics are undone, and a linear law put in their place.

All terms of the model are taken at the estimated state, the righting moment included, so what is
left is nu' = a for each axis (Fossen 2021, chapter 16, "feedback linearization"; Slotine and Li
1991, section 9.1). The law for a is PD on pose with an integral for what the model does not know,
chiefly a current that nobody estimated.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.commands import (
    BodyWrench,
    Estimate,
    PoseTarget,
    TrackingTarget,
    as_tracking,
)
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ComputedTorqueGains:
    """Gains of the linear law; K_p of PD is the product of the two of a kind."""

    position_per_s: float = 0.8
    """Velocity per metre."""
    velocity_per_s: float = 3.0
    """Acceleration per m/s."""
    attitude_per_s: float = 2.5
    """Angular velocity per radian."""
    rate_per_s: float = 5.0
    """Angular acceleration per rad/s."""
    integral_per_s2: float = 2.0
    """Growth of the acceleration held, per m/s or rad/s of error."""
    integral_limit_mps2: float = 4.0
    """Anti-windup: bound of the acceleration held (m/s^2, and rad/s^2)."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ComputedTorqueCarry:
    """Memory of the law."""

    integral: jax.Array
    """[6] acceleration held, in F."""


def check(gains: ComputedTorqueGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("computed_torque", gains)


def reset(estimate: Estimate) -> ComputedTorqueCarry:
    """Memory of a robot that begins."""
    return ComputedTorqueCarry(integral=jnp.zeros_like(estimate.nu))


def step(
    gains: ComputedTorqueGains,
    vehicle: VehicleParams,
    carry: ComputedTorqueCarry,
    estimate: Estimate,
    command: PoseTarget | TrackingTarget,
    dt: float,
    density: float,
    gravity: float,
    flow: jax.Array | None = None,
) -> tuple[ComputedTorqueCarry, BodyWrench]:
    """One control step.

    a = nu_d' + K_v (nu_ref - nu) + z, nu_ref = nu_d + K_p (error of pose), z' = K_i (nu_ref - nu);
    tau = (M_RB + M_A) a + C_RB(nu) nu + C_A(nu_r) nu_r + D(nu_r) nu_r + g(q) - M_A nu_c'.

    Args:
        gains: of the law.
        vehicle: of one robot.
        carry: its memory.
        estimate: its state as known to the controller.
        command: the pose to be at, or to move with.
        dt: control period, s.
        density: of the water, kg/m^3.
        gravity: m/s^2.
        flow: [3] estimate of the current, m/s, in W; None for still water.

    Returns:
        The new memory, and the wrench to exert.
    """
    target = as_tracking(command)
    wanted = model.velocity_reference(
        vehicle, estimate, target, gains.position_per_s, gains.attitude_per_s
    )
    error = wanted - estimate.nu
    integral = model.hold_integral(
        carry.integral,
        gains.integral_per_s2 * error,
        jnp.asarray(gains.integral_limit_mps2, error.dtype),
        dt,
    )
    acceleration = (
        model.target_acceleration(estimate, target, estimate.nu)
        + model.per_axis(gains.velocity_per_s, gains.rate_per_s, error) * error
        + integral
    )
    tau = model.model_wrench(vehicle, estimate, acceleration, flow, density, gravity)
    return ComputedTorqueCarry(integral=integral), BodyWrench(tau=tau)
