"""The elements of ArduPilot's loops: filtered PID and the square-root controller."""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

type Gain = float | jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PidCarry:
    """Memory of one PID, or of n alike."""

    target: jax.Array
    """[n] filtered target."""
    error: jax.Array
    """[n] filtered error."""
    derivative: jax.Array
    """[n] filtered derivative of the error."""
    integral: jax.Array
    """[n] its I term."""


@dataclass(frozen=True, kw_only=True)
class PidParameters:
    """As ArduPilot names them; numbers, or arrays [n]."""

    P: Gain
    I: Gain  # noqa: E741
    D: Gain
    IMAX: Gain
    """Bound of the I term, in the unit of the output."""
    FLTT: Gain
    """Cut-off of the filter on the target, Hz; 0 for none."""
    FLTE: Gain
    """... on the error."""
    FLTD: Gain
    """... on the derivative."""


def reset(like: jax.Array) -> PidCarry:
    """Memory of PIDs [n] that begin."""
    zero = jnp.zeros_like(like)
    return PidCarry(target=zero, error=zero, derivative=zero, integral=zero)


def update_pid(
    parameters: PidParameters,
    carry: PidCarry,
    target: jax.Array,
    measured: jax.Array,
    limited: jax.Array,
    dt: float,
) -> tuple[PidCarry, jax.Array]:
    """P e + I int e + D e', with a low-pass of first order on target, error and derivative.

    Args:
        parameters: of the PIDs.
        carry: their memory.
        target: [n].
        measured: [n].
        limited: bool [] the output was cut: I terms may only shrink.
        dt: s.

    Returns:
        The new memory and the output [n].
    """
    target = low_pass(carry.target, target, parameters.FLTT, dt)
    error = low_pass(carry.error, target - measured, parameters.FLTE, dt)
    slope = low_pass(carry.derivative, (error - carry.error) / dt, parameters.FLTD, dt)
    grown = carry.integral + parameters.I * dt * error
    kept = limited & (jnp.abs(grown) > jnp.abs(carry.integral))
    integral = jnp.clip(jnp.where(kept, carry.integral, grown), -parameters.IMAX, parameters.IMAX)
    carry = PidCarry(target=target, error=error, derivative=slope, integral=integral)
    return carry, parameters.P * error + integral + parameters.D * slope


def low_pass(old: jax.Array, new: jax.Array, cutoff_hz: Gain, dt: float) -> jax.Array:
    """First-order filter, one step; a cut-off of 0 lets everything through."""
    turns = 2.0 * math.pi * dt * jnp.asarray(cutoff_hz, old.dtype)
    alpha = jnp.where(turns > 0, turns / (1.0 + turns), 1.0)
    return old + alpha * (new - old)


def sqrt_controller(error: jax.Array, gain: Gain, acceleration: Gain, dt: float) -> jax.Array:
    """Rate [n] for an error [n]: P near zero, and what can be braked with ``acceleration`` beyond.

    P e for |e| <= a / P^2, else sgn(e) (2 a (|e| - a / (2 P^2)))^(1/2); never more than e / dt.
    """
    size = jnp.abs(error)
    linear = acceleration / gain**2
    far = size > linear
    braked = jnp.sqrt(2.0 * acceleration * jnp.where(far, size - 0.5 * linear, 1.0))
    rate = jnp.where(far, braked, gain * size)
    return jnp.where(error < 0, -1.0, 1.0) * jnp.minimum(rate, size / dt)
