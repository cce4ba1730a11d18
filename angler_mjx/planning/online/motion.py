"""What is known of obstacles at a later time, and plans as traffic for each other."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.planning.path_search.traffic import GridTraffic, clear_of
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.sim.information import ObstacleInformation


def later(known: ObstacleInformation, delay_s: float) -> ObstacleInformation:
    """What is known of obstacles, its times counted from ``delay_s`` after the observation."""
    time, where = known.time_s, known.p_m
    if delay_s == 0.0:
        return known
    if time.shape[-1] == 1:
        return replace(known, p_m=where + known.velocity_mps[:, None] * delay_s)
    along = jax.vmap(jax.vmap(jnp.interp, (None, None, 1), 0), (None, None, 0))
    moved = jnp.moveaxis(along(time + delay_s, time, where), 1, 2)
    return replace(known, p_m=moved)


def plan_rows(plan: Trajectory, radius_m: jax.Array, counts: jax.Array) -> GridTraffic:
    """Plans [R] as traffic; ``counts`` [R] which of them do."""
    return GridTraffic(
        time_s=plan.time_s,
        position_m=plan.position_m,
        reach_m=radius_m,
        until_s=jnp.where(counts, jnp.inf, -1.0),
    )


def is_clear(path: Trajectory, traffic: GridTraffic, horizon_s: float) -> jax.Array:
    """Whether the path of one robot keeps the reach of all traffic until the horizon, bool []."""
    begin, end = path.time_s, jnp.append(path.time_s[1:], jnp.maximum(path.time_s[-1], horizon_s))
    after = jnp.concatenate([path.position_m[1:], path.position_m[-1:]])
    legs = jax.vmap(clear_of, (None, 0, 0, 0, 0))(traffic, path.position_m, begin, after, end)
    return jnp.all(legs | (begin >= horizon_s))
