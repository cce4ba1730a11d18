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
        command: [n_thruster] N, what the thrusters settle at; of fins the deflection, rad, of tanks
            the water beyond half full, m^3, and of moving masses the position, m.
        dt: s; a number, not an array, where the rotors are of third order.

    Returns:
        States at the end of the step, and the mean thrusts [n_thruster] over it.
    """
    after, mean = _advance_thrusters(params, states, command, dt)
    value = states if states.ndim == 1 else states[0]
    if params.fins is not None:
        fins = params.fins
        turned = fin.turn_fins(value, command, fins.tau_s, fins.rate_radps, dt)
        after = _put_values(after, fins.is_fin, turned)
    if params.trim is not None:
        trim = params.trim
        moved = fin.turn_fins(value, command, trim.tau_s, trim.rate, dt)
        after = _put_values(after, trim.is_trim, moved)
    return after, mean


def _put_values(states: jax.Array, is_servo: jax.Array, values: jax.Array) -> jax.Array:
    """Return states with values [n_thruster] in the rows of servos, bool [n_thruster]."""
    if states.ndim == 1:
        return jnp.where(is_servo, values, states)
    rows = jnp.stack([values, jnp.zeros_like(values), jnp.zeros_like(values)])
    return jnp.where(is_servo[None, :], rows, states)


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
