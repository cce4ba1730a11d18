"""Departures of a team, so that paths fixed in space do not meet in time."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.planning.path_search.bodies import GOAL_CLEAR_S
from angler_mjx.planning.path_search.starts import meets_starts, select_flyable, select_paths
from angler_mjx.planning.path_search.string_pulling import is_path_clear
from angler_mjx.planning.path_search.traffic import GridTraffic, meets_traffic
from angler_mjx.robot.control.commands.trajectory import Trajectory

_N_ORDERS = 3
"""Orders of the team that are tried; a robot left without a departure is first in the next."""


def schedule_departures(
    candidates: Trajectory,
    hold_paths: Trajectory,
    radius_m: jax.Array,
    bodies: GridTraffic | None,
    margin_m: float,
    horizon_s: float,
) -> Trajectory:
    """Select one candidate path for each robot of a team, so that none meet.

    Args:
        candidates: [R, H] path of each robot for each departure, the first
            preferred; ``is_found`` says whether there is one.
        hold_paths: [R] paths that stay at the starts.
        radius_m: [R].
        bodies: obstacles that move; None where none is known of.
        margin_m: kept beyond the radii.
        horizon_s: nothing is flown after it.

    Returns:
        [R] paths; those of the others stay at the starts.
    """
    n = radius_m.shape[0]
    distance_m = radius_m[:, None] + radius_m + margin_m
    is_clear_of_bodies = jax.vmap(
        lambda robot, radius: _is_clear_of_bodies(robot, bodies, radius + margin_m)
    )(candidates, radius_m)

    def schedule_robot(
        state: tuple[Trajectory, jax.Array, jax.Array], robot: jax.Array
    ) -> tuple[tuple[Trajectory, jax.Array, jax.Array], None]:
        plans, is_scheduled, is_found = state
        traffic = GridTraffic(
            time_s=plans.time_s,
            position_m=plans.position_m,
            reach_m=distance_m[robot],
            until_s=jnp.where(is_scheduled, jnp.inf, -1.0),
        )
        robot_candidates: Trajectory = jax.tree.map(lambda leaf: leaf[robot], candidates)
        free = is_clear_of_bodies[robot] & ~jax.vmap(
            lambda candidate: jnp.any(meets_traffic(candidate, traffic))
        )(robot_candidates)
        first = jnp.argmax(free)
        is_possible = free[first]
        path = jax.tree.map(
            lambda candidate, stay: jnp.where(is_possible, candidate[first], stay[robot]),
            robot_candidates,
            hold_paths,
        )
        plans = jax.tree.map(lambda all_, row: all_.at[robot].set(row), plans, path)
        return (plans, is_scheduled.at[robot].set(True), is_found.at[robot].set(is_possible)), None

    def try_order(
        state: tuple[Trajectory, jax.Array], _: None
    ) -> tuple[tuple[Trajectory, jax.Array], None]:
        best, rank = state
        order_of_robots = jnp.argsort(rank)
        begin = (hold_paths, jnp.zeros(n, bool), jnp.zeros(n, bool))
        (plans, _all, is_found), _none = jax.lax.scan(schedule_robot, begin, order_of_robots)
        is_met = jax.vmap(
            lambda path, far: meets_starts(path, hold_paths.position_m[:, 0], far, horizon_s)
        )(plans, distance_m)
        is_found = select_flyable(is_found, is_met & ~jnp.eye(n, dtype=bool))
        is_better = jnp.sum(is_found) > jnp.sum(best.found)
        plans = replace(select_paths(is_found, plans, hold_paths), found=is_found)
        best = jax.tree.map(lambda new, old: jnp.where(is_better, new, old), plans, best)
        # Those without any way stand from the beginning; then those that were left out.
        has_no_candidate = ~jnp.any(is_clear_of_bodies, axis=1)
        rank = jnp.where(is_found, rank, rank - n * (1 + has_no_candidate))
        return (best, rank), None

    no_paths = replace(hold_paths, found=jnp.zeros(n, bool))
    first = jnp.arange(n) - 2 * n * ~jnp.any(is_clear_of_bodies, axis=1)
    (best, _), _ = jax.lax.scan(try_order, (no_paths, first), None, length=_N_ORDERS)
    return best


def _is_clear_of_bodies(
    candidates: Trajectory, bodies: GridTraffic | None, by_m: jax.Array
) -> jax.Array:
    """Return which paths [H] of a robot exist and stay clear of bodies to their end, bool [H]."""
    if bodies is None:
        return candidates.found
    inflated = replace(bodies, reach_m=bodies.reach_m + by_m)

    def is_clear(candidate: Trajectory) -> jax.Array:
        return is_path_clear(inflated, candidate, candidate.time_s[-1] + GOAL_CLEAR_S)

    return candidates.found & jax.vmap(is_clear)(candidates)
