"""Feed-forward of the moment of the force that a robot's grip measures on its lever.

It takes the place of `cargo_wrench` where the current is unknown: that law works out the force from
a model of the load and the current, this one lets a force-torque sensor measure it. The measured
moment itself is not fed forward: it holds what robots twist at each other through the load, which
is no disturbance; robots that cancel it lose hold of the load's attitude. A low-pass filter keeps
the loop over the sensor slower than the thrusters.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.commands import BodyWrench, Estimate
from angler_mjx.robot.control.laws.cargo_part import require_grip
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GripMomentGains:
    """Filter of the measurement."""

    filter_s: float = 0.5
    """Time constant of the low-pass filter."""


def check(gains: GripMomentGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("grip_moment", gains)


def reset(estimate: Estimate) -> jax.Array:
    """Return the memory at the start: the filtered force [3], N, in F, of 0."""
    return jnp.zeros_like(estimate.p)


def step(
    gains: GripMomentGains,
    vehicle: VehicleParams,
    carry: jax.Array,
    estimate: Estimate,
    command: BodyWrench,
    dt: float,
    density: float,
    gravity: float,
) -> tuple[jax.Array, BodyWrench]:
    """One control step.

    f_f' = (f - f_f) / T, implicit in the step, and tau = tau_robot - [0; r x f_f], with f the
    measured force of the load on the robot and r the point of its grip, all in F.

    Args:
        gains: of the law.
        vehicle: not used, as density and gravity.
        carry: [3] filtered force.
        estimate: state as known to the controller, with the wrench of its grip.
        command: wrench for the robot and the force of the load.
        dt: control period, s.
        density: kg/m^3.
        gravity: m/s^2.

    Raises:
        ConfigError: the robots hold nothing.
    """
    del vehicle, density, gravity
    grip = require_grip("grip_moment", estimate)
    force = carry + dt / (gains.filter_s + dt) * (grip.wrench[:3] - carry)
    moment = jnp.cross(grip.lever_m, force)
    return force, BodyWrench(tau=command.tau - jnp.concatenate([jnp.zeros_like(moment), moment]))
