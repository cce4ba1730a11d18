"""The grid planner: way-points for a whole fleet, one world, on the device.

Robots are planned in the order of their index. Each searches space and time on a lattice (see
`search`), keeping clear of the paths of the robots before it, which stand at their goals once they
have arrived, and of the starts of those after it during the first ``start_hold_s``. Then its way is
pulled straight (see `pulling`). A robot for which no way is found is told to hold its start; a
robot whose path runs over such a start holds too, so the plans that are handed out never meet.

It knows cells, faces of the cube, sea floor and static obstacles; obstacles that move as far as a
scenario lets it, as more of the traffic (see `bodies`). It does not know currents. Told nothing, it
is the base line that other planners are compared with.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_mjx.planning.path_search.bodies import bodies_traffic
from angler_mjx.planning.path_search.lattice import build_terrain
from angler_mjx.planning.path_search.robot_search import PathSearchConfig, grow_bodies, plan_robot
from angler_mjx.planning.path_search.starts import meets_starts, select_flyable, select_paths
from angler_mjx.planning.path_search.traffic import GridTraffic, PlannedTraffic
from angler_mjx.robot.control.trajectory import Trajectory, hold_position
from angler_mjx.sim.information import ObstacleInformation
from angler_mjx.world.environment import Environment


@dataclass(frozen=True, kw_only=True)
class GridSettings:
    """What a scenario can choose of it, in [planner.grid]."""

    start_hold_s: float = PathSearchConfig.start_hold_s
    """How long the start of a robot that is not planned yet is kept clear."""

    def __post_init__(self) -> None:
        """Refuse what is none."""
        if not 0.0 <= self.start_hold_s <= 86400.0:
            raise ValueError(f"start_hold_s = {self.start_hold_s:g}: must be 0 to 86400 s")


class GridPlanner:
    """What scenarios call grid; `plan_grid` is part of the program that draws the worlds."""

    Settings = GridSettings


def plan_grid(
    environment: Environment,
    radius_m: jax.Array,
    speed_mps: jax.Array,
    config: PathSearchConfig,
    obstacles: ObstacleInformation | None = None,
) -> Trajectory:
    """Plan the fleet of one world.

    Args:
        environment: one world.
        radius_m: [R] radius of the sphere about each robot's centre of mass that holds its hull.
        speed_mps: [R] cruise speed, positive.
        config: static.
        obstacles: obstacles that may move; none do, if left out.

    Returns:
        Trajectory with a leading axis R on every leaf: from start_m at time 0 to goal_m, never
        faster than the cruise speed; where ``found`` is False every row is the start.
    """
    terrain_map = build_terrain(environment)
    n_robot = radius_m.shape[0]
    hold_paths = hold_position(environment.start_m, config.n_point)
    bodies = None if obstacles is None else bodies_traffic(obstacles, config.horizon_s)

    def plan_next(plans: Trajectory, index: jax.Array) -> tuple[Trajectory, None]:
        planned = jnp.arange(n_robot) < index
        traffic = GridTraffic(
            time_s=plans.time_s,
            position_m=plans.position_m,
            reach_m=radius_m + radius_m[index] + config.margin_m,
            until_s=jnp.where(planned, jnp.inf, config.start_hold_s).at[index].set(-1.0),
        )
        path = plan_robot(
            terrain_map,
            PlannedTraffic(
                robots=traffic, bodies=grow_bodies(bodies, radius_m[index] + config.margin_m)
            ),
            environment.start_m[index],
            environment.goal_m[index],
            radius_m[index] + config.margin_m,
            speed_mps[index],
            config,
        )
        return jax.tree.map(lambda leaf, new_leaf: leaf.at[index].set(new_leaf), plans, path), None

    plans, _ = jax.lax.scan(plan_next, hold_paths, jnp.arange(n_robot))
    return _withdraw_conflicting(plans, hold_paths, radius_m, config)


def _withdraw_conflicting(
    plans: Trajectory, held: Trajectory, radius_m: jax.Array, config: PathSearchConfig
) -> Trajectory:
    """Take back every path that comes too near to the start of a robot without one.

    Only robots planned later can be met so: the others' paths were made with that start in view.
    """
    n_robot = radius_m.shape[0]
    distance_m = radius_m[:, None] + radius_m + config.margin_m

    def meets(row: jax.Array) -> jax.Array:
        path = jax.tree.map(lambda leaf: leaf[row], plans)
        return meets_starts(path, held.position_m[:, 0], distance_m[row], config.horizon_s)

    is_met = jax.vmap(meets)(jnp.arange(n_robot)) & ~jnp.eye(n_robot, dtype=bool)
    is_found = select_flyable(plans.found, is_met)
    return replace(select_paths(is_found, plans, held), found=is_found)
