"""Paths among robots that hold their starts, as robots without a path do."""

import jax
import jax.numpy as jnp

from angler_mjx.planning.path_search.traffic import GridTraffic, is_motion_clear
from angler_mjx.robot.control.commands.trajectory import Trajectory

_ROUNDING_M = 1e-3
"""Rounding must not take back a path that just fits."""


def meets_starts(
    path: Trajectory, start_m: jax.Array, reach_m: jax.Array, horizon_s: float
) -> jax.Array:
    """Return whether a path comes too near to each robot's start, bool [R]; its own too.

    Args:
        path: of one robot.
        start_m: [R, 3].
        reach_m: [R] distance to keep between the centres.
        horizon_s: nothing is flown after it.
    """

    def meets_start(start: jax.Array, reach: jax.Array) -> jax.Array:
        path_traffic = GridTraffic(
            time_s=path.time_s[None],
            position_m=path.position_m[None],
            reach_m=reach[None] - _ROUNDING_M,
            until_s=jnp.full((1,), jnp.inf, reach.dtype),
        )
        zero = jnp.zeros((), reach.dtype)
        return ~is_motion_clear(path_traffic, start, zero, start, zero + horizon_s)

    return jax.vmap(meets_start)(start_m, reach_m)


def select_flyable(is_found: jax.Array, is_met: jax.Array) -> jax.Array:
    """Return which paths meet no start of a robot that stays there, bool [R].

    A path that is taken back is one more robot at its start, hence the rounds.

    Args:
        is_found: bool [R] whose paths there are.
        is_met: bool [R, R] whether the path of a robot (row) comes too near to another's start.
    """

    def remove_meeting(_: int, is_found: jax.Array) -> jax.Array:
        return is_found & ~jnp.any(is_met & ~is_found, axis=1)

    is_kept: jax.Array = jax.lax.fori_loop(0, is_found.shape[0], remove_meeting, is_found)
    return is_kept


def select_paths(is_selected: jax.Array, plans: Trajectory, hold_paths: Trajectory) -> Trajectory:
    """Select some robots' paths [R]; the others hold their starts and are not found.

    Args:
        is_selected: bool [R].
        plans: [R].
        hold_paths: [R] paths that stay at the starts.
    """

    def choose(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(is_selected.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)

    chosen: Trajectory = jax.tree.map(choose, plans, hold_paths)
    return chosen
