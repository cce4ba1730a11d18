"""Cost of a sample: remaining path, approach to bodies, and power."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights of costs, in metres of path, and settings of the sampling."""

    end: float = 1.0
    """Weight of the remaining path at the end."""
    along: float = 1.0
    """Weight of the mean remaining path over the horizon."""
    touch_per_s: float = 100.0
    """Of being in touch with anything."""
    near_per_s: float = 2.0
    """Weight of an approach below the margin; the cost grows with the square of the deficit."""
    margin_m: float = 0.3
    """Gap to anything from which on nearness costs."""
    effort: float = 0.05
    """Mean power, over that of cruising through still water."""
    temperature: float = 0.05
    """A sample that is so many metres dearer than the best counts 1 / e of it."""
    noise: float = 0.5
    """Standard deviation of a knot, over the cruise speed."""
    response_s: float = 0.3
    """Time constant [s] with which commanded velocities are followed."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CostBodies:
    """Moving bodies over the horizon."""

    centre_m: jax.Array
    """[H, n, 3] at the end of each step, in W."""
    reach_m: jax.Array
    """[n] least distance between centres without contact; far below zero for none."""


def nearness_cost(weights: Weights, gap_m: jax.Array) -> jax.Array:
    """Return the cost per second of gaps [...] to a body."""
    shortfall = jnp.clip(1.0 - gap_m / weights.margin_m, 0.0, 1.0)
    return weights.near_per_s * shortfall**2 + weights.touch_per_s * (gap_m < 0.0)


def risk_cost(
    weights: Weights, p: jax.Array, clear_m: jax.Array, centre_m: jax.Array, reach_m: jax.Array
) -> jax.Array:
    """Return the cost per second [S] of the positions of samples.

    Args:
        weights: of the cost.
        p: [3, S] in W.
        clear_m: [S] gap to rock, faces and floor.
        centre_m: [n, 3] of bodies, in W.
        reach_m: [n] as in `CostBodies`.
    """
    offset_m = centre_m[..., None] - p
    gap_m = jnp.sqrt(jnp.sum(offset_m**2, axis=1)) - reach_m[:, None]
    return nearness_cost(weights, clear_m) + jnp.sum(nearness_cost(weights, gap_m), axis=0)
