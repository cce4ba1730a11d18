"""Integral sliding mode: from a velocity over ground to a wrench, against bounded disturbances.

Sliding variable, per axis, with e = nu_ref - nu::

    s = e - e(0) + K int e dt        (on s = 0: e' = -K e from the first moment)
    tau = M (K e + rho tanh(s / lambda)) + C(nu) nu + D(nu_ref) nu_ref + g(q)

With the model undone, s' = -rho tanh(s / lambda) + d, d what acts beside the model as an
acceleration. V = s^T s / 2 gives V' <= -sum |s| (rho tanh(|s| / lambda) - |d|) < 0 wherever
rho tanh(|s| / lambda) > |d|: with rho > |d| the state comes into, and stays in, the layer
|s| <= lambda artanh(|d| / rho). A constant d lets s settle inside it, and then e' = -K e: no error
is left. After Utkin and Shi, Integral sliding mode in systems operating under uncertainty
conditions, CDC 1996; Slotine and Li 1991, section 7.2 for the layer.

Damping is fed forward for the velocity that is wanted, so that the vehicle's own stays in the loop.
Undone at the velocity over ground, where a current carries the vehicle along it would push it on by
far more than there is damping: faster than the sliding term can hold, the vehicle would run away.

The layer bounds the slope rho / lambda of the sliding term, which a control period dt and the lag
of the rotors allow up to about 0.25 / dt. Nor must it be so thick that the term does nothing: a
slope of 0.1 N per m/s does nothing to a vehicle of 13 kg. Here rho is an acceleration, so one slope
fits light and heavy vehicles. Against windup the integral is kept where |s| stays below 2 lambda;
beyond, tanh has no more to give.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, Estimate
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles.params import VehicleParams

_LAYERS = 2.0
"""How many thicknesses |s| may reach by integration: tanh is 0.96 there."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class IsmcGains:
    """Gains of the law, as accelerations."""

    velocity_per_s: float = 2.0
    """K of the linear axes."""
    rate_per_s: float = 5.0
    """K of the angular axes."""
    sliding_mps2: float = 4.0
    """rho of the linear axes: the largest disturbance that is held."""
    sliding_radps2: float = 6.0
    """rho of the angular axes: the Munk moment of a current that nobody told is the largest."""
    layer_mps: float = 1.5
    """lambda of the linear axes."""
    layer_radps: float = 1.2
    """lambda of the angular axes."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class IsmcCarry:
    """Memory of the law."""

    integral: jax.Array
    """[6] s - e, that is K int e dt - e(0), in F."""
    fresh: jax.Array
    """bool [] nothing was commanded yet."""


def check(gains: IsmcGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("ismc", gains, positive=("layer_mps", "layer_radps"))


def reset(estimate: Estimate) -> IsmcCarry:
    """Memory of a robot that begins."""
    return IsmcCarry(integral=jnp.zeros_like(estimate.nu), fresh=jnp.ones_like(estimate.nu[0]) > 0)


def step(
    gains: IsmcGains,
    vehicle: VehicleParams,
    carry: IsmcCarry,
    estimate: Estimate,
    command: BodyTwist,
    dt: float,
    density: float,
    gravity: float,
    flow: jax.Array | None = None,
) -> tuple[IsmcCarry, BodyWrench]:
    """One control step.

    Args:
        gains: of the law.
        vehicle: of one robot.
        carry: its memory.
        estimate: its state as known to the controller.
        command: the velocity over ground to have.
        dt: control period, s.
        density: of the water, kg/m^3.
        gravity: m/s^2.
        flow: [3] estimate of the current, m/s, in W; None for still water.

    Returns:
        The new memory, and the wrench to exert.
    """
    error = command.nu - estimate.nu
    slope = model.per_axis(gains.velocity_per_s, gains.rate_per_s, error)
    layer = model.per_axis(gains.layer_mps, gains.layer_radps, error)
    before = jnp.where(carry.fresh, -error, carry.integral)
    grown = before + dt * slope * error
    bound = _LAYERS * layer
    # Where s would leave the bound, the integral may only go back.
    outward = jnp.abs(error + grown) > jnp.maximum(bound, jnp.abs(error + before))
    integral = jnp.clip(jnp.where(outward, before, grown), -bound, bound)
    sliding = sliding_term(gains, error + integral)
    tau = model.model_wrench(
        vehicle, estimate, slope * error + sliding, flow, density, gravity, damped=command.nu
    )
    return IsmcCarry(integral=integral, fresh=jnp.zeros_like(carry.fresh)), BodyWrench(tau=tau)


def sliding_term(gains: IsmcGains, s: jax.Array) -> jax.Array:
    """The sliding term rho tanh(s / lambda) [6], m/s^2 and rad/s^2, of a sliding variable [6]."""
    rho = model.per_axis(gains.sliding_mps2, gains.sliding_radps2, s)
    return rho * jnp.tanh(s / model.per_axis(gains.layer_mps, gains.layer_radps, s))
