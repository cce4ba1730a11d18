"""PID on velocity: from a velocity over ground to a wrench, scaled by the vehicle's inertia.

Of the model it knows inertia and net weight alone: drag, currents and coupling are left to the
integral. Two means against windup: the integral is clamped, and if the wrench that the thrusters
really gave is handed back, what was missing drives the integral back (back-calculation).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, Estimate
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PidVelocityGains:
    """Gains of the velocity loop, as accelerations: each vehicle brings its own inertia."""

    velocity_per_s: float = 5.0
    """P: acceleration per m/s."""
    rate_per_s: float = 10.0
    """P: angular acceleration per rad/s. With the pose loop above it this has to outweigh the Munk
    moment, of which the law knows nothing: with 4 vehicles that hold station in 0.65 m/s swing
    across the current without end."""
    velocity_integral_per_s2: float = 6.0
    """I: growth of the acceleration held per m/s."""
    rate_integral_per_s2: float = 8.0
    """I: growth of the angular acceleration held per rad/s."""
    velocity_derivative: float = 0.0
    """D: acceleration per m/s^2 of measured acceleration, against it."""
    rate_derivative: float = 0.0
    """D: likewise for angular acceleration."""
    derivative_filter_s: float = 0.1
    """Time constant of the filter on the differences of velocity."""
    integral_limit_mps2: float = 4.0
    """Anti-windup: bound of the acceleration held (m/s^2, and rad/s^2)."""
    back_calculation_per_s: float = 2.0
    """Anti-windup: how fast undelivered acceleration is taken out of the integral."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PidVelocityCarry:
    """Memory of the velocity loop."""

    integral: jax.Array
    """[6] acceleration held, in F."""
    nu: jax.Array
    """[6] velocity of the step before."""
    acceleration: jax.Array
    """[6] filtered difference of velocity."""
    demand: jax.Array
    """[6] wrench asked for in the step before."""


def check(gains: PidVelocityGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("pid_velocity", gains)


def reset(estimate: Estimate) -> PidVelocityCarry:
    """Memory of a robot that begins."""
    zero = jnp.zeros_like(estimate.nu)
    return PidVelocityCarry(integral=zero, nu=estimate.nu, acceleration=zero, demand=zero)


def step(
    gains: PidVelocityGains,
    vehicle: VehicleParams,
    carry: PidVelocityCarry,
    estimate: Estimate,
    command: BodyTwist,
    dt: float,
    density: float,
    gravity: float,
    realised: BodyWrench | None = None,
) -> tuple[PidVelocityCarry, BodyWrench]:
    """One control step.

    tau = (M_RB + M_A) (K_p e + z - K_d nu') + (W - B) up, z' = K_i e.

    Args:
        gains: of the loop.
        vehicle: of one robot.
        carry: its memory.
        estimate: its state as known to the controller.
        command: the velocity over ground to have.
        dt: control period, s.
        density: of the water, kg/m^3.
        gravity: m/s^2.
        realised: what the thrusters gave of the wrench asked for in the step before, if known.

    Returns:
        The new memory, and the wrench to exert.
    """
    error = command.nu - estimate.nu
    blend = dt / (dt + gains.derivative_filter_s)
    change = (estimate.nu - carry.nu) / dt
    acceleration = carry.acceleration + blend * (change - carry.acceleration)
    excess = None
    if realised is not None:
        excess = (carry.demand - realised.tau) / model.inertia_diagonal(vehicle)
    growth = model.per_axis(gains.velocity_integral_per_s2, gains.rate_integral_per_s2, error)
    integral = model.hold_integral(
        carry.integral,
        growth * error,
        jnp.asarray(gains.integral_limit_mps2, error.dtype),
        dt,
        excess,
        gains.back_calculation_per_s,
    )
    wanted = (
        model.per_axis(gains.velocity_per_s, gains.rate_per_s, error) * error
        + integral
        - model.per_axis(gains.velocity_derivative, gains.rate_derivative, error) * acceleration
    )
    tau = model.inertia_times(vehicle, wanted)
    tau = tau + model.holding_wrench(vehicle, estimate.q, density, gravity)
    carry = PidVelocityCarry(
        integral=integral, nu=estimate.nu, acceleration=acceleration, demand=tau
    )
    return carry, BodyWrench(tau=tau)
