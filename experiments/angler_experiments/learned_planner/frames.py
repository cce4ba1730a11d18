"""Straight frame of one robot: its start, and axes towards the goal, sideways and up."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

_SHORT_M = 1e-6


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class StraightFrame:
    """Frame of one robot; ``vmap`` it for a team."""

    start_m: jax.Array
    """[3] start in W."""
    length_m: jax.Array
    """[] distance from start to goal."""
    axes: jax.Array
    """[3, 3] rows: along the straight line, level to the left of it, and up across both; in W."""

    def to_frame(self, vector: jax.Array) -> jax.Array:
        """Transform vectors [..., 3] of W into this frame."""
        return jnp.einsum("...i,ki->...k", vector, self.axes, precision="highest")

    def to_world(self, vector: jax.Array) -> jax.Array:
        """Transform vectors [..., 3] of this frame into W."""
        return jnp.einsum("...k,ki->...i", vector, self.axes, precision="highest")

    def points_on_line(self, fraction: jax.Array) -> jax.Array:
        """Return points [n, 3] of the straight line in W at fractions [n] of its length."""
        return self.start_m + fraction[:, None] * self.length_m * self.axes[0]


def build_straight_frame(start_m: jax.Array, goal_m: jax.Array) -> StraightFrame:
    """Build the frame of a robot from ``start_m`` [3] to ``goal_m`` [3].

    A vertical line takes x for its left; a line of no length runs along x.
    """
    delta = goal_m - start_m
    length = jnp.sqrt(jnp.sum(delta * delta))
    east = jnp.array([1.0, 0.0, 0.0], delta.dtype)
    along = jnp.where(length > _SHORT_M, delta / jnp.where(length > _SHORT_M, length, 1.0), east)
    level_length = jnp.sqrt(along[0] ** 2 + along[1] ** 2)
    safe = jnp.where(level_length > _SHORT_M, level_length, 1.0)
    left = jnp.where(
        level_length > _SHORT_M,
        jnp.stack([-along[1] / safe, along[0] / safe, jnp.zeros_like(safe)]),
        east,
    )
    return StraightFrame(
        start_m=start_m,
        length_m=length,
        axes=jnp.stack([along, left, jnp.cross(along, left)]),
    )
