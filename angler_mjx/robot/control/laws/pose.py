"""P on pose: from a pose target to a velocity over ground, level."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.control.commands import BodyTwist, Estimate, PoseTarget, TrackingTarget
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PoseGains:
    """Gains of the pose loop."""

    position_per_s: float = 0.8
    """Velocity per metre of position error."""
    attitude_per_s: float = 2.5
    """Angular velocity per radian of attitude error."""


def check(gains: PoseGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("pose", gains)


def step(
    gains: PoseGains,
    vehicle: VehicleParams,
    cruise_speed_mps: jax.Array,
    estimate: Estimate,
    command: PoseTarget | TrackingTarget,
) -> BodyTwist:
    """One control step.

    v = v_d + k_p (p_d - p), bounded by 1.5 times the cruise speed and by 90 % of the vehicle's
    slowest terminal speed; omega = k_a (attitude error), of the heading that `model.choose_heading`
    gives.

    Args:
        gains: of the loop.
        vehicle: of one robot.
        cruise_speed_mps: [] of that robot.
        estimate: its state as known to the controller.
        command: the pose to be at.

    Returns:
        The velocity over ground to have.
    """
    velocity = command.velocity_mps + gains.position_per_s * (command.position_m - estimate.p)
    limit = jnp.minimum(1.5 * cruise_speed_mps, model.speed_limit(vehicle))
    velocity = model.limit_norm(velocity, limit)
    yaw = model.choose_heading(vehicle, estimate, velocity, command.yaw_rad)
    rotation = model.attitude_error(estimate.q, yaw)
    return BodyTwist(
        nu=jnp.concatenate(
            [quaternion.rotate_inverse(estimate.q, velocity), gains.attitude_per_s * rotation]
        )
    )
