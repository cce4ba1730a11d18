"""From a wrench to thruster signals, with a saturation that keeps the vehicle upright.

What cannot be delivered is given up in this order: surge and sway first (both by the same factor,
so the direction stays), then heave, then attitude.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import thruster
from angler_kernels.rigid_body import matrix_times
from angler_mjx.control.commands import BodyWrench, ThrusterPwm
from angler_mjx.vehicles.params import VehicleParams
from angler_mjx.vehicles.thrusters import PWM_LOW_US, PWM_STEP_US

NEUTRAL_US = 1500.0
"""The signal of a thruster that stands still."""
LEAST_THRUST_N = 0.005
"""Half a unit of the last place of the thrust data: less than this is no thrust. Without it the
rounding of a balanced wrench would switch a thruster between the two edges of its dead band."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AllocationParams:
    """The thrusters of one vehicle, as the allocation sees them."""

    B_inverse: jax.Array
    """[n_thruster, 6] pseudo-inverse of the wrench matrix, over the axes the thrusters command."""
    thrust_n: jax.Array
    """[n_pwm] thrust table at the battery's voltage."""


def build(vehicles: VehicleParams) -> AllocationParams:
    """Allocation of each variant; leading axis [n_variant] as in ``vehicles`` (host side).

    An axis that the thrusters command only through the geometry's small offsets (pitch on the
    six-thruster vehicle) is left out: its share diag(B B^+) of a demand is below one half.
    """
    inverses = []
    for matrix in np.asarray(vehicles.B, np.float64):
        commanded = np.diag(matrix @ np.linalg.pinv(matrix, rcond=1e-2)) > 0.5
        inverse = np.linalg.pinv(matrix * commanded[:, None], rcond=1e-2)
        inverse[np.abs(inverse) < 1e-7 * np.abs(inverse).max()] = 0.0  # B has 24 bits
        inverses.append(inverse)
    return AllocationParams(
        B_inverse=jnp.asarray(np.stack(inverses), vehicles.B.dtype), thrust_n=vehicles.thrust_n
    )


def allocate(params: AllocationParams, command: BodyWrench) -> ThrusterPwm:
    """Thruster signals for a wrench.

    Args:
        params: of one vehicle.
        command: wrench [6] at the centre of mass, in F.

    Returns:
        PWM [n_thruster]; a demand below ``LEAST_THRUST_N`` gives the neutral signal.
    """
    low, high = params.thrust_n[0], params.thrust_n[-1]
    tau = command.tau
    groups = jnp.array([[0, 0, 0, 1, 1, 1], [0, 0, 1, 0, 0, 0], [1, 1, 0, 0, 0, 0]], tau.dtype)
    thrust = jnp.zeros(params.B_inverse.shape[0], tau.dtype)
    for group in groups:
        extra = matrix_times(params.B_inverse, tau * group)
        thrust = thrust + _largest_share(thrust, extra, low, high) * extra
    pwm = jax.vmap(thruster.inverse_lookup, (None, 0, None, None))(
        params.thrust_n, thrust, PWM_LOW_US, PWM_STEP_US
    )
    return ThrusterPwm(pwm_us=jnp.where(jnp.abs(thrust) < LEAST_THRUST_N, NEUTRAL_US, pwm))


def _largest_share(base: jax.Array, extra: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """Largest factor in [0, 1] that keeps ``base + factor * extra`` [n] within [low, high]."""
    moving = jnp.abs(extra) > 1e-6
    room = jnp.where(extra > 0, high - base, low - base) / jnp.where(moving, extra, 1.0)
    return jnp.clip(jnp.min(jnp.where(moving, room, 1.0)), 0.0, 1.0)
