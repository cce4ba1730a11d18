"""Obstacles that move, as traffic: what is known of them as timed places to keep clear of.

A body counts as the sphere that holds it however it turns. Its places are told twice a second; a
way made of every fourth is kept, and the sphere grown by what that way leaves out.
"""

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.path_search.traffic import GridTraffic
from angler_mjx.sim.information import ObstacleInformation

STANDS_S = 2.0
"""How long a robot's goal must stay clear of bodies once it is there: then its way is over, and
what drifts by later does not find it. Of other robots it must stay clear for ever."""

_EVERY = 4
"""Of the places that are told."""


def bodies_traffic(known: ObstacleInformation, horizon_s: float) -> GridTraffic:
    """Moving bodies of one world; ``reach_m`` is the radius of each, to be grown by the robot's.

    What was only observed goes straight on.

    Args:
        known: of one world; what stands is left out, it is on the map.
        horizon_s: nothing is flown after it.
    """
    counts = known.exists & known.moves
    if known.time_s.shape[0] == 1:
        time = jnp.array([0.0, horizon_s], known.time_s.dtype)
        place = known.p_m + known.velocity_mps[:, None] * time[:, None]
        left_out = jnp.zeros_like(known.radius_m)
    else:
        kept = np.append(np.arange(0, known.time_s.shape[0] - 1, _EVERY), known.time_s.shape[0] - 1)
        time, place = known.time_s[kept], known.p_m[:, kept]
        left_out = _left_out(known.p_m, kept)
    return GridTraffic(
        time_s=jnp.broadcast_to(time, place.shape[:2]),
        position_m=place,
        reach_m=known.radius_m + left_out,
        until_s=jnp.where(counts, jnp.inf, -1.0).astype(place.dtype),
    )


def _left_out(place: jax.Array, kept: np.ndarray) -> jax.Array:
    """Greatest distance [n] of places [n, T, 3] from the way along the ``kept`` ones."""
    rows = np.arange(place.shape[1])
    above = np.clip(np.searchsorted(kept, rows, "right"), 1, kept.size - 1)
    low, high = kept[above - 1], kept[above]
    share = ((rows - low) / (high - low))[:, None]
    off = place - (place[:, low] + share * (place[:, high] - place[:, low]))
    return jnp.sqrt(jnp.max(jnp.sum(off * off, axis=-1), axis=1))
