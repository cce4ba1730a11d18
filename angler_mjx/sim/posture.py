"""Postures of vehicles with arms: where their links are, for pictures, messages and contact."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from angler_kernels.rigid_body import matrix_times
from angler_mjx.robot.vehicles.link_hull import LinkCapsules
from angler_mjx.robot.vehicles.link_motion import (
    EndEffectorMotion,
    locate_end_effector,
    locate_links,
)
from angler_mjx.robot.vehicles.link_params import LinkParams
from angler_mjx.robot.vehicles.params import VehicleParams

type Capsules = tuple[jax.Array, jax.Array, jax.Array]
"""Ends of the axes, [c, 3] each, m, and radii [c]."""


def hull_capsules(vehicles: VehicleParams, joint_position: jax.Array | None) -> Capsules:
    """Return the capsules of the hulls of robots [R] in F, those of their links behind the others.

    Args:
        vehicles: [R] leads.
        joint_position: [R, J] rad or m; whatever stands in it for a robot without links. None: no
            robot has joints.
    """
    base = vehicles.capsule_a_m, vehicles.capsule_b_m, vehicles.capsule_r_m
    links, capsules = vehicles.links, vehicles.link_capsules
    if links is None or capsules is None or joint_position is None:
        return base
    a, b = jax.vmap(_locate_capsules)(links, capsules, joint_position)
    moved = a, b, capsules.r_m
    a, b, r = (jnp.concatenate(pair, axis=1) for pair in zip(base, moved, strict=True))
    return a, b, r


def locate_end_effectors(
    vehicles: VehicleParams, joint_position: jax.Array | None
) -> EndEffectorMotion:
    """Return the end effectors of robots [R] in F.

    Args:
        vehicles: [R] leads.
        joint_position: [R, J] rad or m; None: no robot has joints.

    Raises:
        ValueError: the vehicles have no end effector.
    """
    if vehicles.links is None or joint_position is None:
        raise ValueError("the vehicles have no end effector")
    return jax.vmap(locate_end_effector)(vehicles.links, joint_position)


def bounding_radii(vehicles: VehicleParams, hulls: Capsules) -> jax.Array:
    """Return the radii [R] m of spheres about the centres of mass that hold hulls as they lie.

    Args:
        vehicles: [R] leads.
        hulls: of `hull_capsules`.
    """
    if vehicles.links is None:
        return vehicles.radius_m
    a, b, r = hulls
    ends = jnp.maximum(jnp.sum(a * a, axis=2), jnp.sum(b * b, axis=2))
    return jnp.max(jnp.sqrt(jax.lax.stop_gradient(ends)) + r, axis=1)


def _locate_capsules(
    links: LinkParams, capsules: LinkCapsules, position: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the ends [c, 3] of the axes of the capsules of one robot's links, in F."""
    poses = locate_links(links, position)
    # The base is the last, number -1.
    origin = jnp.concatenate([poses.origin, jnp.zeros_like(poses.origin[:1])])
    rotation = jnp.concatenate([poses.rotation, jnp.eye(3, dtype=origin.dtype)[None]])
    center, turn = origin[capsules.link], rotation[capsules.link]
    turned = jax.vmap(matrix_times)
    return center + turned(turn, capsules.a_m), center + turned(turn, capsules.b_m)


def trace_links(links: LinkParams, position: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return origins [T, L, 3] m and rotations [T, L, 3, 3] of links in F, on the host.

    Args:
        links: of one vehicle.
        position: [T, J] positions of its joints, rad or m.
    """
    origin, rotation = _locate_all(links, np.asarray(position, links.zero.dtype))
    return np.asarray(origin), np.asarray(rotation)


@jax.jit
def _locate_all(links: LinkParams, position: jax.Array) -> tuple[jax.Array, jax.Array]:
    def locate(position: jax.Array) -> tuple[jax.Array, jax.Array]:
        poses = locate_links(links, position)
        return poses.origin, poses.rotation

    return jax.vmap(locate)(position)
