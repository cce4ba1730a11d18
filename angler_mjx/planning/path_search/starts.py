"""Paths among robots that stay where they start, as those do that have no way."""

import jax
import jax.numpy as jnp

from angler_mjx.planning.path_search.traffic import GridTraffic, clear_of
from angler_mjx.robot.control.trajectory import Trajectory

_ROUNDING_M = 1e-3
"""Rounding must not take back a path that just fits."""


def meets_starts(
    path: Trajectory, start_m: jax.Array, reach_m: jax.Array, horizon_s: float
) -> jax.Array:
    """Whether a path comes too near to each robot's start, bool [R]; its own too.

    Args:
        path: of one robot.
        start_m: [R, 3].
        reach_m: [R] distance to keep between the centres.
        horizon_s: nothing is flown after it.
    """

    def one(start: jax.Array, reach: jax.Array) -> jax.Array:
        alone = GridTraffic(
            time_s=path.time_s[None],
            position_m=path.position_m[None],
            reach_m=reach[None] - _ROUNDING_M,
            until_s=jnp.full((1,), jnp.inf, reach.dtype),
        )
        zero = jnp.zeros((), reach.dtype)
        return ~clear_of(alone, start, zero, start, zero + horizon_s)

    return jax.vmap(one)(start_m, reach_m)


def standing(found: jax.Array, met: jax.Array) -> jax.Array:
    """Which paths may be flown, bool [R]: none that meets the start of a robot that stays there.

    A path that is taken back is one more robot at its start, hence the rounds.

    Args:
        found: bool [R] whose paths there are.
        met: bool [R, R] whether the path of a robot (row) comes too near to another's start.
    """

    def again(_: int, found: jax.Array) -> jax.Array:
        return found & ~jnp.any(met & ~found, axis=1)

    kept: jax.Array = jax.lax.fori_loop(0, found.shape[0], again, found)
    return kept


def only(which: jax.Array, plans: Trajectory, held: Trajectory) -> Trajectory:
    """Some robots' paths [R]; the others hold their starts, and are not found.

    Args:
        which: bool [R].
        plans: [R].
        held: [R] paths that stay at the starts.
    """

    def choose(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(which.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)

    chosen: Trajectory = jax.tree.map(choose, plans, held)
    return chosen
