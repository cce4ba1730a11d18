"""Adaptive integral terminal sliding mode: from a velocity over ground to a wrench.

Per axis, with e = nu_ref - nu and an exponent 0 < r < 1::

    s = e + alpha z,   z' = |e|^r sgn(e)
    tau = M (alpha z' + k_1 |s|^(1/2) sat(s / lambda) + k_2 s) + C(nu) nu + D(nu_ref) nu_ref + g(q)
    k_1' = k_theta |s| - leak (k_1 - k_min),   k_min <= k_1 <= k_max

On s = 0 the error obeys z' = -|alpha z|^r sgn(z), which reaches zero in finite time: a terminal
surface. With the model undone, s' = -k_1 |s|^(1/2) sat(s / lambda) - k_2 s + d. For
V = s^2 / 2, V' <= -|s| (k_1 |s|^(1/2) + k_2 |s| - |d|) outside the layer: s comes to where
k_1 |s|^(1/2) + k_2 |s| = |d|, and k_1 grows while |s| is large, so the better the larger the
disturbance; the leakage lets it fall again afterwards, and the bounds keep it from bursting. Adding
(k_1 - k*)^2 / (2 k_theta) to V shows s and k_1 to be ultimately bounded (Qiao and Zhang, Adaptive
second-order fast nonsingular terminal sliding mode tracking control for fully actuated autonomous
underwater vehicles, IEEE J. Ocean. Eng. 44, 2019; leakage after Ioannou and Sun, Robust Adaptive
Control, 1996, section 8.4). A constant d lets z settle, and then e = 0.

Both z and k_1 are integrated over time. Against windup z is kept where |s| stays below the
``surface_limit``.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, Estimate
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles.params import VehicleParams

_LINEAR = 9e-4
"""Square of 3 cm/s and 0.03 rad/s, below which the power law is linear: its slope at zero is
infinite, and with a control period of 50 ms the loop stands about 10 1/s."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AitsmGains:
    """Gains of the law, as accelerations."""

    terminal: float = 1.5
    """alpha, of |e|^r."""
    exponent: float = 0.6
    """r, between 0 and 1."""
    reaching_per_s: float = 2.0
    """k_2."""
    sliding_least: float = 0.5
    """k_min, (m/s)^(1/2)/s."""
    sliding_most: float = 4.0
    """k_max."""
    adaptation: float = 2.0
    """k_theta: growth of k_1 per m/s of |s|."""
    leak_per_s: float = 0.2
    """How fast k_1 falls back to k_min."""
    layer: float = 0.3
    """lambda, m/s and rad/s."""
    surface_limit: float = 1.5
    """Bound of |s| by integration, m/s and rad/s."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AitsmCarry:
    """Memory of the law."""

    z: jax.Array
    """[6] integral of |e|^r sgn(e), in F."""
    k_1: jax.Array
    """[6] adaptive gain; 0 until the first step puts it between its bounds."""


def check(gains: AitsmGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("aitsm", gains, positive=("terminal", "exponent", "layer", "surface_limit"))
    if gains.exponent >= 1:
        raise ConfigError(f"gains of aitsm: exponent = {gains.exponent:g} must be less than 1")
    if gains.sliding_most < gains.sliding_least:
        raise ConfigError(
            f"gains of aitsm: sliding_most = {gains.sliding_most:g} must not be less than "
            f"sliding_least = {gains.sliding_least:g}"
        )


def reset(estimate: Estimate) -> AitsmCarry:
    """Memory of a robot that begins."""
    zero = jnp.zeros_like(estimate.nu)
    return AitsmCarry(z=zero, k_1=zero)


def step(
    gains: AitsmGains,
    vehicle: VehicleParams,
    carry: AitsmCarry,
    estimate: Estimate,
    command: BodyTwist,
    dt: float,
    density: float,
    gravity: float,
    flow: jax.Array | None = None,
) -> tuple[AitsmCarry, BodyWrench]:
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
    # |e|^r sgn(e), linear near zero.
    power = error * jnp.exp(0.5 * (gains.exponent - 1.0) * jnp.log(error * error + _LINEAR))
    grown = carry.z + dt * power
    before = jnp.abs(error + gains.terminal * carry.z)
    outward = jnp.abs(error + gains.terminal * grown) > jnp.maximum(gains.surface_limit, before)
    z = jnp.where(outward, carry.z, grown)
    s = error + gains.terminal * z
    k_1 = adapt_gain(gains, carry.k_1, s, dt)
    acceleration = gains.terminal * power + sliding_term(gains, k_1, s) + gains.reaching_per_s * s
    # Damping for the velocity that is wanted: see `angler_mjx.robot.control.laws.ismc`.
    tau = model.model_wrench(
        vehicle, estimate, acceleration, flow, density, gravity, damped=command.nu
    )
    return AitsmCarry(z=z, k_1=k_1), BodyWrench(tau=tau)


def adapt_gain(gains: AitsmGains, k_1: jax.Array, s: jax.Array, dt: float) -> jax.Array:
    """The adaptive gain [6] one step on, for a sliding variable [6]."""
    rate = gains.adaptation * jnp.abs(s) - gains.leak_per_s * (k_1 - gains.sliding_least)
    return jnp.clip(k_1 + dt * rate, gains.sliding_least, gains.sliding_most)


def sliding_term(gains: AitsmGains, k_1: jax.Array, s: jax.Array) -> jax.Array:
    """The sliding term k_1 |s|^(1/2) sat(s / lambda) [6], m/s^2 and rad/s^2."""
    return k_1 * jnp.sqrt(jnp.abs(s) + 1e-12) * jnp.clip(s / gains.layer, -1.0, 1.0)
