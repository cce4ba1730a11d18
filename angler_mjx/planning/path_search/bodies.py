"""Obstacles that move, as traffic: what is known of them as timed places to keep clear of.

A body counts as the sphere that holds it however it turns. Its places are told twice a second; a
way made of every fourth is kept, and the sphere grown by what that way leaves out.
"""

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.path_search.traffic import GridTraffic
from angler_mjx.sim.information import ObstacleInformation

GOAL_CLEAR_S = 2.0
"""How long a robot's goal must stay clear of bodies once it is there: then its way is over, and
what drifts by later does not find it. Of other robots it must stay clear for ever."""

_EVERY_N_POSITIONS = 4
"""Of the places that are told."""


def bodies_traffic(information: ObstacleInformation, horizon_s: float) -> GridTraffic:
    """Moving bodies of one world; ``reach_m`` is the radius of each, to be grown by the robot's.

    What was only observed goes straight on.

    Args:
        information: of one world; what stands is left out, it is on the map.
        horizon_s: nothing is flown after it.
    """
    is_moving = information.exists & information.moves
    if information.time_s.shape[0] == 1:
        time = jnp.array([0.0, horizon_s], information.time_s.dtype)
        position_m = information.p_m + information.velocity_mps[:, None] * time[:, None]
        deviation_m = jnp.zeros_like(information.radius_m)
    else:
        kept_rows = np.append(
            np.arange(0, information.time_s.shape[0] - 1, _EVERY_N_POSITIONS),
            information.time_s.shape[0] - 1,
        )
        time, position_m = information.time_s[kept_rows], information.p_m[:, kept_rows]
        deviation_m = _max_deviation(information.p_m, kept_rows)
    return GridTraffic(
        time_s=jnp.broadcast_to(time, position_m.shape[:2]),
        position_m=position_m,
        reach_m=information.radius_m + deviation_m,
        until_s=jnp.where(is_moving, jnp.inf, -1.0).astype(position_m.dtype),
    )


def _max_deviation(position_m: jax.Array, kept: np.ndarray) -> jax.Array:
    """Greatest distance [n] of places [n, T, 3] from the way along the ``kept`` ones."""
    rows = np.arange(position_m.shape[1])
    above = np.clip(np.searchsorted(kept, rows, "right"), 1, kept.size - 1)
    low, high = kept[above - 1], kept[above]
    fraction = ((rows - low) / (high - low))[:, None]
    deviation = position_m - (
        position_m[:, low] + fraction * (position_m[:, high] - position_m[:, low])
    )
    return jnp.sqrt(jnp.max(jnp.sum(deviation * deviation, axis=-1), axis=1))
