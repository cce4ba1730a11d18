"""Path integral control of one robot: samples, their costs, and the new mean.

A sample is a row of knots, velocities over ground in W, joined by lines. Pure functions of one
robot; robots and worlds are the caller's ``vmap``. Samples are the last axis, and time is a scan,
so memory holds one step of them at a time.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.planning.mppi.costs import CostBodies, Weights, risk_cost
from angler_mjx.planning.mppi.distance_field import DistanceField, interpolate
from angler_mjx.planning.mppi.models import RobotModel

type SampleState = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
"""Positions, velocities [3, S], remaining path and cost [S] of samples."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class RolloutScene:
    """Scene of one robot over the horizon."""

    field: DistanceField
    """Fields of gap and remaining path, in this order."""
    bodies: CostBodies
    flow_mps: jax.Array
    """[H, 3] velocity of the water, in W, where the robot meant to be."""
    goal_m: jax.Array
    """[3] in W."""
    radius_m: jax.Array
    """[] of the robot."""
    limit_mps: jax.Array
    """[] no knot is faster, over ground."""


def shift_knots(knots: jax.Array, by_s: jax.Array | float, horizon_s: float) -> jax.Array:
    """Return knots [K, 3] as they are ``by_s`` [] later; held after the last."""
    last = knots.shape[0] - 1
    at = jnp.clip(jnp.arange(last + 1) + by_s * (last / horizon_s), 0.0, last)
    low = jnp.minimum(at.astype(jnp.int32), last - 1)
    fraction = (at - low)[:, None]
    return knots[low] * (1.0 - fraction) + knots[low + 1] * fraction


def improve_mean(
    weights: Weights,
    model: RobotModel,
    scene: RolloutScene,
    p: jax.Array,
    v: jax.Array,
    knots: jax.Array,
    key: jax.Array,
    samples: int,
    dt_s: float,
) -> tuple[jax.Array, jax.Array]:
    """Return a better mean and its path.

    Args:
        weights: of the cost.
        model: of the robot.
        scene: about it.
        p: [3] m in W.
        v: [3] velocity over ground in W.
        knots: [K, 3] the mean so far.
        key: of this robot and call.
        samples: among them the mean itself and standing still.
        dt_s: of a step.

    Returns:
        Knots [K, 3], and places [H, 3] at the end of each step.
    """
    noise = weights.noise * scene.limit_mps * jax.random.normal(key, (*knots.shape, samples))
    samples_mps = knots[..., None] + noise.at[..., 0].set(0.0)
    samples_mps = _limit_speed(samples_mps.at[..., 1].set(0.0), scene.limit_mps)
    cost = rollout_costs(weights, model, scene, p, v, samples_mps, dt_s)
    weight = jnp.exp((jnp.min(cost) - cost) / weights.temperature)
    mean = jnp.sum(samples_mps * (weight / jnp.sum(weight)), axis=-1)
    return mean, rollout_path(model, scene, p, v, mean, dt_s)


def rollout_costs(
    weights: Weights,
    model: RobotModel,
    scene: RolloutScene,
    p: jax.Array,
    v: jax.Array,
    knots: jax.Array,
    dt_s: float,
) -> jax.Array:
    """Return the costs [S] of knots [K, 3, S], m; other arguments as in `improve_mean`."""
    steps, near_m = scene.flow_mps.shape[0], 1.5 * scene.field.spacing_m

    def step(carry: SampleState, i: jax.Array) -> tuple[SampleState, None]:
        p, v, _, cost = carry
        p, v, power = _step_samples(model, scene, p, v, knots, i, dt_s)
        gap, left = interpolate(scene.field, (p[0], p[1], p[2]))
        # Lines between nodes are blunt at the goal; no wall is so thin as to lie within this.
        to_goal = jnp.sqrt(jnp.sum((p - scene.goal_m[:, None]) ** 2, axis=0))
        left = jnp.where(to_goal < near_m, to_goal, left)
        bodies = scene.bodies
        risk = risk_cost(weights, p, gap - scene.radius_m, bodies.centre_m[i], bodies.reach_m)
        running = weights.along * left + weights.effort * power
        return (p, v, left, cost + dt_s * risk + running / steps), None

    lanes = jnp.zeros(knots.shape[-1], p.dtype)
    start = (p[:, None] + lanes, v[:, None] + lanes, lanes, lanes)
    (_, _, left, cost), _ = jax.lax.scan(step, start, jnp.arange(steps))
    return cost + weights.end * left


def rollout_path(
    model: RobotModel,
    scene: RolloutScene,
    p: jax.Array,
    v: jax.Array,
    knots: jax.Array,
    dt_s: float,
) -> jax.Array:
    """Return the positions [H, 3] at the end of each step along knots [K, 3]."""

    def step(
        carry: tuple[jax.Array, jax.Array], i: jax.Array
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        p, v, _ = _step_samples(model, scene, *carry, knots[..., None], i, dt_s)
        return (p, v), p[:, 0]

    _, path_m = jax.lax.scan(step, (p[:, None], v[:, None]), jnp.arange(scene.flow_mps.shape[0]))
    return path_m


def _step_samples(
    model: RobotModel,
    scene: RolloutScene,
    p: jax.Array,
    v: jax.Array,
    knots: jax.Array,
    i: jax.Array,
    dt_s: float,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return positions and velocities [3, S] after step i of samples, and their power [S]."""
    last = knots.shape[0] - 1
    at = i * (last / scene.flow_mps.shape[0])
    low = jnp.minimum(at.astype(jnp.int32), last - 1)
    target_mps = knots[low] * (1.0 - (at - low)) + knots[low + 1] * (at - low)
    next_velocity, power = model.step(v, target_mps, scene.flow_mps[i], dt_s)
    return p + 0.5 * dt_s * (v + next_velocity), next_velocity, power


def _limit_speed(knots: jax.Array, limit_mps: jax.Array) -> jax.Array:
    length = jnp.sqrt(jnp.sum(knots**2, axis=1, keepdims=True) + 1e-12)
    return knots * jnp.minimum(1.0, limit_mps / length)
