"""The rotors of one vehicle: how thrusts follow what their signals settle at."""

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from angler_kernels import fin, thruster
from angler_mjx.robot.vehicles import rotor
from angler_mjx.robot.vehicles.params import VehicleParams


def at_rest(params: VehicleParams, dtype: DTypeLike) -> jax.Array:
    """States of still rotors: [n_thruster], or [3, n_thruster] where they are of third order."""
    n = params.B.shape[-1]
    return jnp.zeros(n if params.rotor is None else (rotor.ORDER, n), dtype)


def advance_rotors(
    params: VehicleParams, states: jax.Array, command: jax.Array, dt: jax.Array | float
) -> tuple[jax.Array, jax.Array]:
    """One step of all rotors, exact for a command held over it.

    Args:
        params: of the vehicle.
        states: as `at_rest` gives them, N.
        command: [n_thruster] N, what the thrusters settle at; of fins the deflection, rad.
        dt: s; a number, not an array, where the rotors are of third order.

    Returns:
        States at the end of the step, and the mean thrusts [n_thruster] over it.
    """
    after, mean = _advance_thrusters(params, states, command, dt)
    if params.fins is None:
        return after, mean
    fins = params.fins
    angle = states if states.ndim == 1 else states[0]
    turned = fin.turn_fins(angle, command, fins.tau_s, fins.rate_radps, dt)
    if after.ndim == 1:
        return jnp.where(fins.is_fin, turned, after), mean
    rows = jnp.stack([turned, jnp.zeros_like(turned), jnp.zeros_like(turned)])
    return jnp.where(fins.is_fin[None, :], rows, after), mean


def _advance_thrusters(
    params: VehicleParams, states: jax.Array, command: jax.Array, dt: jax.Array | float
) -> tuple[jax.Array, jax.Array]:
    """See `advance_rotors`; what it gives in columns of fins has no meaning."""
    if params.rotor is None:
        return thruster.rotor_lag(states, command, params.tau_s, dt)
    step = rotor.discretise_rotor(params.rotor, float(dt))
    settled, transition, mean = (
        jnp.asarray(part, states.dtype) for part in (step.settled, step.transition, step.mean)
    )
    return thruster.rotor_filter(states, command, settled, transition, mean)
