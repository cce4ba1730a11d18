"""Command of one robot: the velocity of its samples, or the wrench that follows it."""

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, Estimate
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.vehicles.params import VehicleParams


def build_twist(
    vehicle: VehicleParams,
    estimate: Estimate,
    target_mps: jax.Array,
    yaw_rad: jax.Array,
    attitude_per_s: jax.Array | float,
) -> BodyTwist:
    """Return a velocity over ground, and the yaw rate that closes the heading error.

    Args:
        vehicle: one without sway turns its bow to where it goes.
        estimate: of its motion.
        target_mps: [3] velocity over ground, in W.
        yaw_rad: [] heading to hold.
        attitude_per_s: turn per radian of error.
    """
    heading = model.choose_heading(vehicle, estimate, target_mps, yaw_rad)
    turn = attitude_per_s * model.attitude_error(estimate.q, heading)
    return BodyTwist(nu=jnp.concatenate([quaternion.rotate_inverse(estimate.q, target_mps), turn]))


def build_wrench(
    vehicle: VehicleParams,
    estimate: Estimate,
    target_mps: jax.Array,
    yaw_rad: jax.Array,
    attitude_per_s: jax.Array | float,
    response_s: jax.Array | float,
    density_kgpm3: float,
    gravity_mps2: float,
) -> BodyWrench:
    """Return the wrench of the closed form that follows the commanded velocity as a lag.

    The moment turns the vehicle level and to its heading, critically damped, and carries what
    righting, drag and added mass do to it. The current is that of the estimate; none if it has
    none.

    Args:
        vehicle: as its controllers know it.
        estimate: of its motion, and of the current there.
        target_mps: [3] velocity over ground, in W.
        yaw_rad: [] heading to hold.
        attitude_per_s: rate of the return to it.
        response_s: time constant of the velocity.
        density_kgpm3: of the water.
        gravity_mps2: of the place.
    """
    q, nu = estimate.q, estimate.nu
    linear = (quaternion.rotate_inverse(q, target_mps) - nu[:3]) / response_s
    error = model.attitude_error(q, yaw_rad)
    turn = attitude_per_s * (attitude_per_s * error - 2.0 * nu[3:])
    # Rates are those of components in F, which turns.
    rates = jnp.concatenate([linear - jnp.cross(nu[3:], nu[:3]), turn])
    tau = model.model_wrench(vehicle, estimate, rates, estimate.flow, density_kgpm3, gravity_mps2)
    return BodyWrench(tau=tau)
