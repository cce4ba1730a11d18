"""What a sample costs: the way that is left, what it comes too near to, and the power it takes."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Weights:
    """What a sample costs, in metres of way; and how samples are drawn and weighed."""

    end: float = 1.0
    """Way left at the end."""
    along: float = 1.0
    """Way left, mean over the horizon."""
    touch_per_s: float = 100.0
    """Of being in touch with anything."""
    near_per_s: float = 2.0
    """Of being nearer than the margin; grows with the square of what is missing."""
    margin_m: float = 0.3
    """Gap to anything from which on nearness costs."""
    effort: float = 0.05
    """Mean power, over that of cruising through still water."""
    temperature: float = 0.05
    """A sample that is so many metres dearer than the best counts 1 / e of it."""
    noise: float = 0.5
    """Standard deviation of a knot, over the cruise speed."""
    response_s: float = 0.3
    """Time constant by which asked velocities are taken up."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CostBodies:
    """What moves, over the horizon."""

    centre_m: jax.Array
    """[H, n, 3] at the end of each step, in W."""
    reach_m: jax.Array
    """[n] least distance between centres without contact; far below zero for none."""


def nearness_cost(weights: Weights, gap_m: jax.Array) -> jax.Array:
    """Cost per second of gaps [...] to a body."""
    shortfall = jnp.clip(1.0 - gap_m / weights.margin_m, 0.0, 1.0)
    return weights.near_per_s * shortfall**2 + weights.touch_per_s * (gap_m < 0.0)


def risk_cost(
    weights: Weights, p: jax.Array, clear_m: jax.Array, centre_m: jax.Array, reach_m: jax.Array
) -> jax.Array:
    """Cost per second [S] of being where samples are.

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
