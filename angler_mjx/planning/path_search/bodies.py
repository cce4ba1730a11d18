"""Obstacles of a problem: moving ones as traffic, still ones as bodies on the map.

A moving body counts as the sphere that holds it in every attitude. Its positions are known every
0.5 s; a path along every fourth of them is kept, and the sphere grown by the deviation of the
others from it.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.path_search.traffic import GridTraffic
from angler_mjx.planning.problem import Problem
from angler_mjx.sim.information import ObstacleInformation
from angler_mjx.world.obstacles import STATIC, Obstacles

GOAL_CLEAR_S = 2.0
"""Time [s] after its arrival for which a robot's goal must stay clear of bodies, as its path ends
then. Of other robots it must stay clear until the horizon."""

_EVERY_N_POSITIONS = 4
"""Stride of the known positions that a path keeps."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class StillObstacles:
    """Obstacles that stand, [n] rows."""

    kind: jax.Array
    """int32 [n], as of `ObstacleInformation`."""
    half_size_m: jax.Array
    """[n, 3] m, as of `ObstacleInformation`."""
    p_m: jax.Array
    """[n, 3] centres, m, W."""
    q: jax.Array
    """[n, 4] attitudes, wxyz, body to W."""
    exists: jax.Array
    """bool [n] False for padding and for obstacles that move."""
    kinds: tuple[int, ...] = field(metadata={"static": True})
    """Kinds that occur."""


def still_obstacles(information: ObstacleInformation) -> StillObstacles | None:
    """Return the obstacles that stand; None where there can be none."""
    if not (information.some_stand and information.radius_m.shape[0]):
        return None
    return StillObstacles(
        kind=information.kind,
        half_size_m=information.half_size_m,
        p_m=information.p_m[:, 0],
        q=information.q[:, 0],
        exists=information.exists & ~information.moves,
        kinds=information.kinds,
    )


def select_still(obstacles: Obstacles) -> StillObstacles | None:
    """Return the obstacles of a sampled world that stand; None where there can be none."""
    if STATIC not in obstacles.motions:
        return None
    return StillObstacles(
        kind=obstacles.kind,
        half_size_m=obstacles.size_m,
        p_m=obstacles.p0,
        q=obstacles.q0,
        exists=obstacles.exists & (obstacles.motion == STATIC),
        kinds=obstacles.kinds,
    )


def moving_obstacles(problem: Problem) -> ObstacleInformation | None:
    """Return the obstacles if any may move and their information level is not nothing."""
    information = problem.obstacles
    if problem.information.obstacles == "nothing" or not information.radius_m.shape[-1]:
        return None
    return information


def moving_traffic(problem: Problem) -> GridTraffic | None:
    """Return the moving bodies of a problem as traffic until its horizon; None if unknown."""
    information = moving_obstacles(problem)
    return None if information is None else bodies_traffic(information, problem.horizon_s)


def bodies_traffic(information: ObstacleInformation, horizon_s: float) -> GridTraffic:
    """Return the moving bodies of one world; ``reach_m`` is the radius of each without the robot's.

    Bodies that are only observed go straight on.

    Args:
        information: of one world; still obstacles are left out.
        horizon_s: end of the flight, s.
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
    """Return the greatest distance [n] of positions [n, T, 3] from the path of ``kept`` ones."""
    rows = np.arange(position_m.shape[1])
    above = np.clip(np.searchsorted(kept, rows, "right"), 1, kept.size - 1)
    low, high = kept[above - 1], kept[above]
    fraction = ((rows - low) / (high - low))[:, None]
    deviation = position_m - (
        position_m[:, low] + fraction * (position_m[:, high] - position_m[:, low])
    )
    return jnp.sqrt(jnp.max(jnp.sum(deviation * deviation, axis=-1), axis=1))
