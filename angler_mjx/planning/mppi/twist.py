"""Path integral control of one robot by velocities: samples, their costs, and the new mean.

A sample is a row of knots, velocities over ground in W, joined by lines. The velocity loop is taken
as a first-order lag. Pure functions of one robot; robots and worlds are the caller's ``vmap``.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.planning.mppi.field import Field, read


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
    effort: float = 0.05
    """Mean cube of the speed asked for, over the limit's."""
    temperature: float = 0.05
    """m."""
    noise: float = 0.5
    """Standard deviation of a knot, over the limit of speed."""
    response_s: float = 0.3
    """Time constant of the velocity loop."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Bodies:
    """What moves, over the horizon."""

    centre_m: jax.Array
    """[H, n, 3] at the end of each step, in W."""
    reach_m: jax.Array
    """[n] least distance between centres without contact; far below zero for none."""


def shifted(knots: jax.Array, by_s: jax.Array, horizon_s: float) -> jax.Array:
    """Knots [K, 3] as they are ``by_s`` [] later; held after the last."""
    last = knots.shape[0] - 1
    at = jnp.clip(jnp.arange(last + 1) + by_s * (last / horizon_s), 0.0, last)
    low = jnp.minimum(at.astype(jnp.int32), last - 1)
    share = (at - low)[:, None]
    return knots[low] * (1.0 - share) + knots[low + 1] * share


def improve(
    weights: Weights,
    field: Field,
    bodies: Bodies,
    p: jax.Array,
    v: jax.Array,
    knots: jax.Array,
    radius_m: jax.Array,
    limit_mps: jax.Array,
    key: jax.Array,
    samples: int,
    dt_s: float,
) -> tuple[jax.Array, jax.Array]:
    """A better mean, and where it leads.

    Args:
        weights: of the cost.
        field: of gap and way left, in this order.
        bodies: other robots and obstacles.
        p: [3] m in W.
        v: [3] velocity over ground in W.
        knots: [K, 3] the mean so far.
        radius_m: [] of the robot.
        limit_mps: [] no knot is faster.
        key: of this robot and call.
        samples: among them the mean itself and standing still.
        dt_s: of a step.

    Returns:
        Knots [K, 3], and places [H, 3] at the end of each step.
    """
    noise = weights.noise * limit_mps * jax.random.normal(key, (*knots.shape, samples))
    drawn = knots[..., None] + noise.at[..., 0].set(0.0)
    drawn = _bounded(drawn.at[..., 1].set(0.0), limit_mps)
    cost, _ = fly(weights, field, bodies, p, v, drawn, radius_m, limit_mps, dt_s)
    share = jnp.exp((jnp.min(cost) - cost) / weights.temperature)
    mean = jnp.sum(drawn * (share / jnp.sum(share)), axis=-1)
    _, way = fly(weights, field, bodies, p, v, mean[..., None], radius_m, limit_mps, dt_s)
    return mean, way[..., 0]


def fly(
    weights: Weights,
    field: Field,
    bodies: Bodies,
    p: jax.Array,
    v: jax.Array,
    knots: jax.Array,
    radius_m: jax.Array,
    limit_mps: jax.Array,
    dt_s: float,
) -> tuple[jax.Array, jax.Array]:
    """Costs [S] of knots [K, 3, S] and places [H, 3, S]; other arguments as in `improve`."""
    steps, last = bodies.centre_m.shape[0], knots.shape[0] - 1
    keep = jnp.exp(-dt_s / weights.response_s)

    def near(gap: jax.Array) -> jax.Array:
        missing = jnp.clip(1.0 - gap / weights.margin_m, 0.0, 1.0)
        return weights.near_per_s * missing**2 + weights.touch_per_s * (gap < 0.0)

    def step(
        carry: tuple[jax.Array, jax.Array, jax.Array], i: jax.Array
    ) -> tuple[tuple[jax.Array, jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
        p, v, cost = carry
        at = i * (last / steps)
        low = jnp.minimum(at.astype(jnp.int32), last - 1)
        asked = knots[low] * (1.0 - (at - low)) + knots[low + 1] * (at - low)
        after = asked + (v - asked) * keep
        p = p + 0.5 * dt_s * (v + after)
        gap, left = read(field, (p[0], p[1], p[2]))
        away = bodies.centre_m[i][..., None] - p
        apart = jnp.sqrt(jnp.sum(away**2, axis=1)) - bodies.reach_m[:, None]
        danger = near(gap - radius_m) + jnp.sum(near(apart), axis=0)
        speed = jnp.sqrt(jnp.sum(asked**2, axis=0)) / limit_mps
        running = weights.along * left + weights.effort * speed**3
        return (p, after, cost + dt_s * danger + running / steps), (p, left)

    lanes = jnp.zeros(knots.shape[-1], p.dtype)
    start = (p[:, None] + lanes, v[:, None] + lanes, lanes)
    (_, _, cost), (way, left) = jax.lax.scan(step, start, jnp.arange(steps))
    return cost + weights.end * left[-1], way


def _bounded(knots: jax.Array, limit_mps: jax.Array) -> jax.Array:
    length = jnp.sqrt(jnp.sum(knots**2, axis=1, keepdims=True) + 1e-12)
    return knots * jnp.minimum(1.0, limit_mps / length)
