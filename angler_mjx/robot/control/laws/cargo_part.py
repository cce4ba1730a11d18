"""What a robot knows of a load that it holds with others: its part, and the force beyond that.

The part hangs below the robot's centre of mass and has weight and quadratic drag. What a
force-torque sensor measures beyond that is inertia, errors of the model, and the internal force:
with which robots pull at each other and which moves nothing.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import Estimate, GripReading


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CargoPartGains:
    """The robot's part of the load; that of the task carry where the file gives none."""

    depth_m: float = 0.0
    """How far below the centre of mass the load is held."""
    weight_n: float = 0.0
    """Weight of the part in water; a load that rises has none."""
    drag_x_n: float = 0.0
    """Drag at 1 m/s in surge, quadratic."""
    drag_y_n: float = 0.0
    """The same in sway."""
    drag_z_n: float = 0.0
    """The same in heave."""


def find_wrench(
    gains: CargoPartGains, estimate: Estimate, flow: jax.Array | None = None
) -> jax.Array:
    """Return the wrench [6] of the robot's part of a load on it, N and N m, in F, at its centre.

    f = f_g - d |v_r| v_r and m = r x f with r = (0, 0, -depth) and v_r the velocity of that point
    through the water.

    Args:
        gains: with the part.
        estimate: state as known to the controller.
        flow: [3] velocity of the water, m/s, in W; None for still water.
    """
    nu, q = estimate.nu, estimate.q
    lever = jnp.stack([jnp.asarray(x, nu.dtype) for x in (0.0, 0.0, -gains.depth_m)])
    through = nu[:3] + jnp.cross(nu[3:], lever)
    if flow is not None:
        through = through - quaternion.rotate_inverse(q, flow)
    drag = jnp.stack([jnp.asarray(x, nu.dtype) for x in _drag_n(gains)])
    force = -gains.weight_n * quaternion.world_up(q) - drag * jnp.abs(through) * through
    return jnp.concatenate([force, jnp.cross(lever, force)])


def _drag_n(gains: CargoPartGains) -> tuple[float, float, float]:
    return gains.drag_x_n, gains.drag_y_n, gains.drag_z_n


def find_excess(law: str, gains: CargoPartGains, estimate: Estimate) -> jax.Array:
    """Return the measured wrench [6] of the load beyond the robot's part of it, N and N m, in F.

    It is 0 where nothing is measured: before the first measurement, and when the grip is open.

    Args:
        law: name of the stage that asks.
        gains: with the part.
        estimate: state as known to the controller.

    Raises:
        ConfigError: the robots hold nothing.
    """
    measured = require_grip(law, estimate).wrench
    is_measured = jnp.sum(jnp.abs(measured)) > 0.0
    return jnp.where(is_measured, measured - find_wrench(gains, estimate, estimate.flow), 0.0)


def require_grip(law: str, estimate: Estimate) -> GripReading:
    """Return what the robot's grip measured; ``law`` is the name of the stage that asks.

    Raises:
        ConfigError: the robots hold nothing.
    """
    if estimate.grip is None:
        raise ConfigError(
            f"stage {law}: it takes the force of a grip, and the robots hold nothing; take "
            'task.type = "carry"'
        )
    return estimate.grip
