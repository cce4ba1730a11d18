"""When each robot of a team sets off, so that ways fixed in space do not meet in time."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.planning.path_search.bodies import STANDS_S
from angler_mjx.planning.path_search.pulling import keeps_clear
from angler_mjx.planning.path_search.starts import meets_starts, only, standing
from angler_mjx.planning.path_search.traffic import GridTraffic, met_by
from angler_mjx.robot.control.trajectory import Trajectory

_ROUNDS = 3
"""Orders of the team that are tried; who was left without a time goes first in the next."""


def scheduled(
    ways: Trajectory,
    held: Trajectory,
    radius_m: jax.Array,
    bodies: GridTraffic | None,
    margin_m: float,
    horizon_s: float,
) -> Trajectory:
    """One of its ways for each robot of a team, none of which meet.

    Args:
        ways: [R, H]: the way of each robot for each time at which it can set off, the first
            preferred; ``found`` says whether there is one.
        held: [R] paths that stay at the starts.
        radius_m: [R].
        bodies: obstacles that move; None where none is known of.
        margin_m: kept beyond the radii.
        horizon_s: nothing is flown after it.

    Returns:
        [R] paths; those of the others stay at the starts.
    """
    n = radius_m.shape[0]
    reach = radius_m[:, None] + radius_m + margin_m
    possible = jax.vmap(lambda robot, radius: _clear_of_bodies(robot, bodies, radius + margin_m))(
        ways, radius_m
    )

    def one(
        state: tuple[Trajectory, jax.Array, jax.Array], robot: jax.Array
    ) -> tuple[tuple[Trajectory, jax.Array, jax.Array], None]:
        plans, done, found = state
        traffic = GridTraffic(
            time_s=plans.time_s,
            position_m=plans.position_m,
            reach_m=reach[robot],
            until_s=jnp.where(done, jnp.inf, -1.0),
        )
        mine: Trajectory = jax.tree.map(lambda leaf: leaf[robot], ways)
        free = possible[robot] & ~jax.vmap(lambda way: jnp.any(met_by(way, traffic)))(mine)
        first = jnp.argmax(free)
        goes = free[first]
        path = jax.tree.map(lambda way, stay: jnp.where(goes, way[first], stay[robot]), mine, held)
        plans = jax.tree.map(lambda all_, row: all_.at[robot].set(row), plans, path)
        return (plans, done.at[robot].set(True), found.at[robot].set(goes)), None

    def order(
        state: tuple[Trajectory, jax.Array], _: None
    ) -> tuple[tuple[Trajectory, jax.Array], None]:
        best, rank = state
        turn = jnp.argsort(rank)
        begin = (held, jnp.zeros(n, bool), jnp.zeros(n, bool))
        (plans, _all, found), _none = jax.lax.scan(one, begin, turn)
        met = jax.vmap(lambda path, far: meets_starts(path, held.position_m[:, 0], far, horizon_s))(
            plans, reach
        )
        found = standing(found, met & ~jnp.eye(n, dtype=bool))
        more = jnp.sum(found) > jnp.sum(best.found)
        plans = replace(only(found, plans, held), found=found)
        best = jax.tree.map(lambda new, old: jnp.where(more, new, old), plans, best)
        # Those without any way stand from the beginning; then those that were left out.
        none = ~jnp.any(possible, axis=1)
        rank = jnp.where(found, rank, rank - n * (1 + none))
        return (best, rank), None

    nothing = replace(held, found=jnp.zeros(n, bool))
    first = jnp.arange(n) - 2 * n * ~jnp.any(possible, axis=1)
    (best, _), _ = jax.lax.scan(order, (nothing, first), None, length=_ROUNDS)
    return best


def _clear_of_bodies(ways: Trajectory, bodies: GridTraffic | None, by_m: jax.Array) -> jax.Array:
    """Which ways [H] of a robot are there, and clear of bodies until they are over, bool [H]."""
    if bodies is None:
        return ways.found
    wide = replace(bodies, reach_m=bodies.reach_m + by_m)

    def clear(way: Trajectory) -> jax.Array:
        return keeps_clear(wide, way, way.time_s[-1] + STANDS_S)

    return ways.found & jax.vmap(clear)(ways)
