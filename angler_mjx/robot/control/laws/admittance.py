"""Admittance: a reference that yields to the force of what the robot holds, and springs back.

Every robot that carries a body with others follows a reference of its own. Where references do not
fit the body, robots pull at each other; with this law each gives way, as a mass on a damper and a
spring at its reference does (N. Hogan, "Impedance control: an approach to manipulation", Journal of
Dynamic Systems, Measurement, and Control 107 (1985), realised as an admittance above a position
loop). No robot knows the plan, the commands or the forces of another.

At rest the force that two robots pull with along a line is half the misfit of their references
times the stiffness.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.control.commands import Estimate, PoseTarget, TrackingTarget
from angler_mjx.robot.control.laws.cargo_part import CargoPartGains, find_excess
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.control.laws.model import wrap_angle
from angler_mjx.robot.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AdmittanceGains(CargoPartGains):
    """Mass, damper and spring between the reference and what the robot aims at."""

    mass_kg: float = 20.0
    """Apparent mass of the reference."""
    damping_ns_per_m: float = 90.0
    """Damper; critical is twice the root of mass times stiffness."""
    stiffness_n_per_m: float = 100.0
    """Spring."""
    inertia_kgm2: float = 5.0
    """Apparent inertia about the vertical."""
    damping_nms_per_rad: float = 20.0
    """Damper of the heading."""
    stiffness_nm_per_rad: float = 20.0
    """Spring of the heading."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AdmittanceCarry:
    """Offset of the reference, and its rate."""

    offset_m: jax.Array
    """[3] in W."""
    velocity_mps: jax.Array
    """[3] in W."""
    yaw_rad: jax.Array
    """[] about z up."""
    yaw_rate_radps: jax.Array
    """[] about z up."""


def check(gains: AdmittanceGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("admittance", gains, positive=("mass_kg", "inertia_kgm2"))


def reset(estimate: Estimate) -> AdmittanceCarry:
    """Return the memory of a robot that begins: no offset."""
    zero = jnp.zeros_like(estimate.p)
    return AdmittanceCarry(
        offset_m=zero, velocity_mps=zero, yaw_rad=zero[0], yaw_rate_radps=zero[0]
    )


def step(
    gains: AdmittanceGains,
    vehicle: VehicleParams,
    carry: AdmittanceCarry,
    estimate: Estimate,
    command: PoseTarget | TrackingTarget,
    dt: float,
    density: float,
    gravity: float,
    flow: jax.Array | None = None,
) -> tuple[AdmittanceCarry, PoseTarget]:
    """One control step.

    m x'' + d x' + k x = f with f the measured force beyond the robot's part of the load, in W, and
    the same of the heading with the moment about the vertical; x is added to the reference. The
    damper is implicit in the step.

    Args:
        gains: of the law.
        vehicle: not used, as density, gravity and flow.
        carry: memory.
        estimate: state as known to the controller, with the wrench of its grip and the current.
        command: the reference.
        dt: control period, s.
        density: kg/m^3.
        gravity: m/s^2.
        flow: [3] velocity of the water, m/s, in W; that of the estimate counts.

    Raises:
        ConfigError: the robots hold nothing.
    """
    del vehicle, density, gravity, flow
    excess = find_excess("admittance", gains, estimate)
    force = quaternion.rotate(estimate.q, excess[:3])
    moment = jnp.sum(quaternion.world_up(estimate.q) * excess[3:])
    velocity = _next_rate(
        carry.velocity_mps,
        force - gains.stiffness_n_per_m * carry.offset_m,
        gains.mass_kg,
        gains.damping_ns_per_m,
        dt,
    )
    yaw_rate = _next_rate(
        carry.yaw_rate_radps,
        moment - gains.stiffness_nm_per_rad * carry.yaw_rad,
        gains.inertia_kgm2,
        gains.damping_nms_per_rad,
        dt,
    )
    after = AdmittanceCarry(
        offset_m=carry.offset_m + dt * velocity,
        velocity_mps=velocity,
        yaw_rad=carry.yaw_rad + dt * yaw_rate,
        yaw_rate_radps=yaw_rate,
    )
    return after, PoseTarget(
        position_m=command.position_m + after.offset_m,
        velocity_mps=command.velocity_mps + velocity,
        yaw_rad=wrap_angle(command.yaw_rad + after.yaw_rad),
    )


def _next_rate(
    rate: jax.Array, force: jax.Array, mass: float, damping: float, dt: float
) -> jax.Array:
    """Return the rate of a mass on a damper after a step under a force."""
    return (rate + (dt / mass) * force) / (1.0 + dt * damping / mass)
