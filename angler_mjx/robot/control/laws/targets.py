"""What a tracking law follows: a pose with its derivatives, level."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.commands import PoseTarget


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TrackingTarget:
    """A moving pose, level, with what it takes to feed its motion forward."""

    position_m: jax.Array
    """[3] in W."""
    velocity_mps: jax.Array
    """[3] in W."""
    acceleration_mps2: jax.Array
    """[3] in W."""
    yaw_rad: jax.Array
    """[] heading about z up, 0 = east."""
    yaw_rate_radps: jax.Array
    """[] about z up."""
    yaw_acceleration_radps2: jax.Array
    """[] about z up."""


def as_tracking(target: PoseTarget | TrackingTarget) -> TrackingTarget:
    """The same target; a pose target moves on with its velocity and does not turn."""
    if isinstance(target, TrackingTarget):
        return target
    still = jnp.zeros_like(target.yaw_rad)
    return TrackingTarget(
        position_m=target.position_m,
        velocity_mps=target.velocity_mps,
        acceleration_mps2=jnp.zeros_like(target.velocity_mps),
        yaw_rad=target.yaw_rad,
        yaw_rate_radps=still,
        yaw_acceleration_radps2=still,
    )
