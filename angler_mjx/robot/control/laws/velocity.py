"""PI on velocity with feed-forward: from a velocity over ground to a wrench.

Drag, net weight and the Munk moment of the commanded velocity are fed forward; what the model does
not know, chiefly a current, is left to the integral.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import rigid_body
from angler_kernels.rigid_body import matrix_times
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, Estimate
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles.damping import damping_wrench
from angler_mjx.robot.vehicles.fins import flies_by_fins
from angler_mjx.robot.vehicles.params import VehicleParams

FIN_SPEED_ERROR_MPS = 0.15
"""Error of speed up to which the integral of a vehicle that flies by its fins grows."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class VelocityGains:
    """Gains of the velocity loop, as accelerations: each vehicle brings its own inertia."""

    velocity_per_s: float = 4.0
    """Acceleration per m/s of error."""
    rate_per_s: float = 6.0
    """Angular acceleration per rad/s of error."""
    integral_per_s2: float = 3.0
    """Growth of the acceleration held against the current."""
    integral_limit_mps2: float = 3.0
    """Anti-windup: bound of that acceleration."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class VelocityCarry:
    """Memory of the velocity loop."""

    integral: jax.Array
    """[6] acceleration held against what the model does not know, in F."""


def check(gains: VelocityGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("velocity", gains)


def reset(estimate: Estimate) -> VelocityCarry:
    """Memory of a robot that begins."""
    return VelocityCarry(integral=jnp.zeros_like(estimate.nu))


def step(
    gains: VelocityGains,
    vehicle: VehicleParams,
    carry: VelocityCarry,
    estimate: Estimate,
    command: BodyTwist,
    dt: float,
    density: float,
    gravity: float,
) -> tuple[VelocityCarry, BodyWrench]:
    """One control step.

    tau = (M_RB + M_A) (K_p e + z) + D(nu_cmd) nu_cmd + C_A(nu_cmd) nu_cmd + (W - B) up; z
    integrates e and is bounded; of a vehicle that flies by its fins, ahead alone. C_A holds the
    Munk moment, which would pitch and roll a vehicle that moves along two axes at once.

    Args:
        gains: of the loop.
        vehicle: of one robot.
        carry: its memory.
        estimate: its state as known to the controller.
        command: the velocity over ground to have.
        dt: control period, s.
        density: of the water, kg/m^3.
        gravity: m/s^2.

    Returns:
        The new memory, and the wrench to exert.
    """
    error = command.nu - estimate.nu
    proportional = error * jnp.array(
        [gains.velocity_per_s] * 3 + [gains.rate_per_s] * 3, error.dtype
    )
    growth = error
    if vehicle.fins is not None:
        # Fins run to their ends, neither sway nor heave is there to be had, and while a single
        # propeller brings it to speed there is nothing to learn.
        steady = jnp.where(jnp.abs(error[0]) < FIN_SPEED_ERROR_MPS, error[0], 0.0)
        ahead = jnp.concatenate([steady[None], jnp.zeros_like(error[1:])])
        growth = jnp.where(flies_by_fins(vehicle), ahead, error)
    integral = jnp.clip(
        carry.integral + gains.integral_per_s2 * dt * growth,
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
    drag = damping_wrench(vehicle, command.nu)
    munk = rigid_body.added_mass_coriolis(vehicle.M_A, command.nu)
    buoyancy = rigid_body.buoyancy_wrench(estimate.q, lift, jnp.zeros(3, error.dtype))
    tau = dry + matrix_times(vehicle.M_A, acceleration) + munk - drag - buoyancy
    return VelocityCarry(integral=integral), BodyWrench(tau=tau)
