"""Drag, thrusts and power of one robot that holds its heading, level.

Three directions alone, those of the robot's own axes; samples [S] are last. Turning is left out.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.laws.model import SPEED_FRACTION
from angler_mjx.robot.control.stack import ControlParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class DragHull:
    """Numbers of one robot at a heading."""

    heading: jax.Array
    """[2] cosine and sine of the heading."""
    inertia_kg: jax.Array
    """[3] with added mass, along the robot's axes."""
    linear: jax.Array
    """[3] damping, N s/m."""
    quadratic: jax.Array
    """[3] damping, N s^2/m^2."""
    lift_n: jax.Array
    """[] buoyancy less weight."""
    thrusters: jax.Array
    """[n_thruster, 3] thrust per newton of a force."""
    max_thrust_n: jax.Array
    """[] thrust limit of a thruster in both directions; [n_thruster] where thrusters differ."""
    fastest_mps: jax.Array
    """[3] through the water, along the robot's axes."""
    cruise_mps: jax.Array
    """[]"""


def build_drag_hull(
    params: ControlParams, yaw_rad: jax.Array, density_kgpm3: float, gravity_mps2: float
) -> DragHull:
    """Build the hull of one robot from its controllers' vehicle model.

    A vehicle without thrust in some direction is taken to turn its bow there.
    """
    vehicle = params.vehicle_model
    speed = vehicle.terminal_speed_mps
    return DragHull(
        heading=jnp.stack([jnp.cos(yaw_rad), jnp.sin(yaw_rad)]),
        inertia_kg=vehicle.mass_kg + jnp.diagonal(vehicle.M_A)[:3],
        linear=vehicle.D_l[:3],
        quadratic=vehicle.D_q[:3],
        lift_n=(density_kgpm3 * vehicle.volume_m3 - vehicle.mass_kg) * gravity_mps2,
        thrusters=params.allocation.B_inverse[:, :3],
        max_thrust_n=_find_limit(vehicle.thrust_n),
        fastest_mps=SPEED_FRACTION * jnp.where(speed > 0.0, speed, jnp.max(speed)),
        cruise_mps=params.cruise_speed_mps,
    )


def to_body(hull: DragHull, x: jax.Array) -> jax.Array:
    """Rotate vectors [3, S] from W to the robot's axes."""
    c, s = hull.heading[0], hull.heading[1]
    return jnp.stack([c * x[0] + s * x[1], c * x[1] - s * x[0], x[2]])


def to_world(hull: DragHull, x: jax.Array) -> jax.Array:
    """Rotate vectors [3, S] from the robot's axes to W."""
    c, s = hull.heading[0], hull.heading[1]
    return jnp.stack([c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]])


def drag_coefficient(hull: DragHull, through: jax.Array) -> jax.Array:
    """Return drag over velocity [3, S], N s/m, of velocities [3, S] through the water."""
    return hull.linear[:, None] + hull.quadratic[:, None] * jnp.abs(through)


def lift_force(hull: DragHull) -> jax.Array:
    """Return buoyancy less weight, a force [3, 1] along the robot's axes."""
    up = jnp.array([0.0, 0.0, 1.0], hull.lift_n.dtype)
    return (hull.lift_n * up)[:, None]


def limit_velocity(hull: DragHull, through: jax.Array) -> jax.Array:
    """Shorten velocities [3, S] through the water to those that thrust can hold.

    Surge and sway take the same thrusters: at half of the limit of each, forces add up.
    Those of quadratic drag then leave an ellipse of velocities. Heave has its own.
    """
    speed_ratio = through / hull.fastest_mps[:, None]
    level_ratio = jnp.sqrt(speed_ratio[0] ** 2 + speed_ratio[1] ** 2 + 1e-12)
    scale = 1.0 / jnp.maximum(level_ratio, 1.0)
    return jnp.stack(
        [
            through[0] * scale,
            through[1] * scale,
            through[2] / jnp.maximum(jnp.abs(speed_ratio[2]), 1.0),
        ]
    )


def allocate_thrust(hull: DragHull, force: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the realisable part of forces [3, S] along the robot's axes.

    Surge and sway are cut by one factor, heave by its own, so that no thruster runs past its end by
    either alone.

    Returns:
        Forces [3, S], and thrusts [n_thruster, S].
    """
    level = jnp.einsum("ti,is->ts", hull.thrusters[:, :2], force[:2])
    heave = hull.thrusters[:, 2:] * force[2]
    level_scale = jnp.minimum(1.0, _least_margin(hull, level))
    heave_scale = jnp.minimum(1.0, _least_margin(hull, heave))
    achieved_n = jnp.stack([force[0] * level_scale, force[1] * level_scale, force[2] * heave_scale])
    return achieved_n, level * level_scale + heave * heave_scale


def _find_limit(thrust_n: jax.Array) -> jax.Array:
    """Return `DragHull.max_thrust_n` of a thrust table [n], or [n_thruster, n]."""
    if thrust_n.ndim > 1:
        return jnp.minimum(thrust_n[:, -1], -thrust_n[:, 0])
    return jnp.minimum(thrust_n[-1], -thrust_n[0])


def _least_margin(hull: DragHull, thrust_n: jax.Array) -> jax.Array:
    """Return the least limit over thrust [S] of thrusts [n_thruster, S]."""
    size = jnp.abs(thrust_n)
    if hull.max_thrust_n.ndim > 0:
        return jnp.min(hull.max_thrust_n[:, None] / (size + 1e-6), axis=0)
    return hull.max_thrust_n / (jnp.max(size, axis=0) + 1e-6)


def relative_power(hull: DragHull, thrust_n: jax.Array) -> jax.Array:
    """Return the power [S] of thrusts [n_thruster, S] over that of cruising in still water.

    A propeller takes power as the 3/2 of its thrust.
    """
    ahead = hull.cruise_mps * jnp.array([1.0, 0.0, 0.0])[:, None]
    _, cruise_thrust_n = allocate_thrust(hull, drag_coefficient(hull, ahead) * ahead)
    return _three_halves(thrust_n) / jnp.maximum(_three_halves(cruise_thrust_n), 1e-6)


def _three_halves(thrust_n: jax.Array) -> jax.Array:
    size = jnp.abs(thrust_n)
    return jnp.sum(size * jnp.sqrt(size), axis=0)
