"""Obstacle information at a later time, and plans as traffic for each other."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.planning.path_search.traffic import GridTraffic, is_motion_clear
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.sim.information import ObstacleInformation


def advance_obstacles(information: ObstacleInformation, delay_s: float) -> ObstacleInformation:
    """Return obstacle information with times counted from ``delay_s`` after the observation."""
    time, position_m = information.time_s, information.p_m
    if delay_s == 0.0:
        return information
    if time.shape[-1] == 1:
        return replace(information, p_m=position_m + information.velocity_mps[:, None] * delay_s)
    interpolate = jax.vmap(jax.vmap(jnp.interp, (None, None, 1), 0), (None, None, 0))
    moved = jnp.moveaxis(interpolate(time + delay_s, time, position_m), 1, 2)
    return replace(information, p_m=moved)


def plans_as_traffic(plan: Trajectory, radius_m: jax.Array, counts: jax.Array) -> GridTraffic:
    """Plans [R] as traffic; ``counts`` [R] which of them do."""
    return GridTraffic(
        time_s=plan.time_s,
        position_m=plan.position_m,
        reach_m=radius_m,
        until_s=jnp.where(counts, jnp.inf, -1.0),
    )


def is_clear(path: Trajectory, traffic: GridTraffic, horizon_s: float) -> jax.Array:
    """Return whether the path of one robot keeps the reach of all traffic, bool []."""
    begin, end = path.time_s, jnp.append(path.time_s[1:], jnp.maximum(path.time_s[-1], horizon_s))
    after = jnp.concatenate([path.position_m[1:], path.position_m[-1:]])
    legs = jax.vmap(is_motion_clear, (None, 0, 0, 0, 0))(
        traffic, path.position_m, begin, after, end
    )
    return jnp.all(legs | (begin >= horizon_s))
