"""Tracking with feed-forward: the model moves the vehicle as the reference does, feedback the rest.

P on pose, PI on velocity, and the wrench that the hydrodynamic model needs: inertia and damping of
the reference, through the current as estimated, so that the vehicle's own damping and righting
moment stay in the loop, unlike in `computed_torque`. Coriolis terms alone are taken at the
estimated velocity: the Munk moment grows with the product of two velocities, and fed forward for a
velocity that is not reached yet it would tilt the vehicle by 20 degrees.
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
class TrackingGains:
    """Gains of the feedback; each vehicle brings its own inertia."""

    position_per_s: float = 0.8
    """Velocity per metre."""
    attitude_per_s: float = 2.5
    """Angular velocity per radian."""
    velocity_per_s: float = 2.5
    """Acceleration per m/s."""
    rate_per_s: float = 4.0
    """Angular acceleration per rad/s."""
    integral_per_s2: float = 2.0
    """Growth of the acceleration held, per m/s or rad/s of error."""
    integral_limit_mps2: float = 4.0
    """Anti-windup: bound of the acceleration held (m/s^2, and rad/s^2)."""
    back_calculation_per_s: float = 2.0
    """Anti-windup: how fast undelivered acceleration is taken out of the integral."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TrackingCarry:
    """Memory of the law."""

    integral: jax.Array
    """[6] acceleration held, in F."""
    demand: jax.Array
    """[6] wrench asked for in the step before."""


def check(gains: TrackingGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("tracking", gains)


def reset(estimate: Estimate) -> TrackingCarry:
    """Memory of a robot that begins."""
    zero = jnp.zeros_like(estimate.nu)
    return TrackingCarry(integral=zero, demand=zero)


def step(
    gains: TrackingGains,
    vehicle: VehicleParams,
    carry: TrackingCarry,
    estimate: Estimate,
    command: PoseTarget | TrackingTarget,
    dt: float,
    density: float,
    gravity: float,
    flow: jax.Array | None = None,
    realised: BodyWrench | None = None,
) -> tuple[TrackingCarry, BodyWrench]:
    """One control step.

    tau = (M_RB + M_A)(nu_d' + K_v e + z) + C_RB(nu) nu + C_A(nu_r) nu_r + D(nu_rr) nu_rr
    - M_A nu_c' + (W - B) up, with e = nu_ref - nu, nu_ref = nu_d + K_p (error of pose),
    nu_r = nu - nu_c, nu_rr = nu_ref - nu_c and z' = K_i e.

    Args:
        gains: of the feedback.
        vehicle: of one robot.
        carry: its memory.
        estimate: its state as known to the controller.
        command: the pose to be at, or to move with.
        dt: control period, s.
        density: of the water, kg/m^3.
        gravity: m/s^2.
        flow: [3] estimate of the current, m/s, in W; None for still water.
        realised: what the thrusters gave of the wrench asked for in the step before, if known.

    Returns:
        The new memory, and the wrench to exert.
    """
    target = as_tracking(command)
    wanted = model.velocity_reference(
        vehicle, estimate, target, gains.position_per_s, gains.attitude_per_s
    )
    error = wanted - estimate.nu
    excess = None
    if realised is not None:
        excess = (carry.demand - realised.tau) / model.inertia_diagonal(vehicle)
    integral = model.hold_integral(
        carry.integral,
        gains.integral_per_s2 * error,
        jnp.asarray(gains.integral_limit_mps2, error.dtype),
        dt,
        excess,
        gains.back_calculation_per_s,
    )
    acceleration = (
        model.target_acceleration(estimate, target, estimate.nu)
        + model.per_axis(gains.velocity_per_s, gains.rate_per_s, error) * error
        + integral
    )
    current = jnp.zeros_like(estimate.p) if flow is None else flow
    tau = model.motion_wrench(vehicle, estimate.q, estimate.nu, acceleration, current, wanted)
    tau = tau + model.holding_wrench(vehicle, estimate.q, density, gravity)
    return TrackingCarry(integral=integral, demand=tau), BodyWrench(tau=tau)
