"""Planner grid: way-points of a fleet, robot by robot, on the device.

Robots are planned in the order of their index. Each searches space and time on a lattice
(`path_search.search`). It keeps clear of the paths of the robots before it, which stand at their
goals after arrival, and of the starts of the robots after it during the first ``start_hold_s``.
Then its path is pulled straight (`path_search.string_pulling`). A robot without a path holds its
start; a robot whose path crosses such a start holds too, so no two plans meet.

The planner uses rock, faces of the cube, sea floor, still obstacles, and moving obstacles as far as
the problem has them (`path_search.bodies`). It ignores currents. With the information level nothing
it is the baseline of other planners.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_kernels.rows import write_row
from angler_mjx.planning.path_search.bodies import moving_traffic, still_obstacles
from angler_mjx.planning.path_search.lattice import build_terrain
from angler_mjx.planning.path_search.robot_search import (
    PathSearchConfig,
    grow_bodies,
    path_search_config,
    plan_robot,
    require_still_water,
)
from angler_mjx.planning.path_search.starts import meets_starts, select_flyable, select_paths
from angler_mjx.planning.path_search.traffic import GridTraffic, PlannedTraffic
from angler_mjx.planning.problem import Problem, ProblemSettings
from angler_mjx.robot.control.commands.trajectory import Trajectory, hold_position


@dataclass(frozen=True, kw_only=True)
class GridSettings:
    """Settings of the table [planner.grid]."""

    start_hold_s: float = PathSearchConfig.start_hold_s
    """Time [s] for which the start of a robot that is not planned yet is kept clear."""

    def __post_init__(self) -> None:
        """Check the range.

        Raises:
            ValueError: the time is negative or longer than a day.
        """
        if not 0.0 <= self.start_hold_s <= 86400.0:
            raise ValueError(f"start_hold_s = {self.start_hold_s:g}: must be 0 to 86400 s")


class GridPlanner:
    """Planner ``grid`` of scenarios, a `BatchPlanner`."""

    Settings = GridSettings

    def __init__(self, settings: GridSettings) -> None:
        """Keep the settings."""
        self._settings = settings

    def check_problem(self, problem: ProblemSettings) -> None:
        """Refuse problems with information that the planner cannot use; see `BatchPlanner`."""
        require_still_water(problem, "grid")

    def plan_one(self, problem: Problem) -> Trajectory:
        """Return the paths of one world; see `BatchPlanner`."""
        config = path_search_config(problem)
        return plan_grid(problem, replace(config, start_hold_s=self._settings.start_hold_s))

    def plan_batch(self, problems: Problem) -> Trajectory:
        """Return the paths of all worlds; see `BatchPlanner`."""
        return jax.vmap(self.plan_one)(problems)


def plan_grid(problem: Problem, config: PathSearchConfig) -> Trajectory:
    """Plan the fleet of one world.

    Args:
        problem: one world, R robots.
        config: static.

    Returns:
        Trajectory with a leading axis R on every leaf: from the start at time 0 to the goal, at
        most at cruise speed; where ``found`` is False every row is the start.
    """
    terrain_map = build_terrain(problem.grid, problem.floor_z_m, still_obstacles(problem.obstacles))
    team = problem.team
    radius_m, speed_mps = team.radius_m, team.cruise_speed_mps
    n_robot = radius_m.shape[0]
    hold_paths = hold_position(team.start_m, config.n_point)
    bodies = moving_traffic(problem)
    rows, hold_s = jnp.arange(n_robot), config.start_hold_s

    def plan_next(plans: Trajectory, index: jax.Array) -> tuple[Trajectory, None]:
        planned = rows < index
        traffic = GridTraffic(
            time_s=plans.time_s,
            position_m=plans.position_m,
            reach_m=radius_m + radius_m[index] + config.margin_m,
            until_s=jnp.where(rows == index, -1.0, jnp.where(planned, jnp.inf, hold_s)),
        )
        path = plan_robot(
            terrain_map,
            PlannedTraffic(
                robots=traffic, bodies=grow_bodies(bodies, radius_m[index] + config.margin_m)
            ),
            team.start_m[index],
            team.goal_m[index],
            radius_m[index] + config.margin_m,
            speed_mps[index],
            config,
        )
        return write_row(plans, path, index), None

    plans, _ = jax.lax.scan(plan_next, hold_paths, jnp.arange(n_robot))
    return _withdraw_conflicting(plans, hold_paths, radius_m, config)


def _withdraw_conflicting(
    plans: Trajectory, held: Trajectory, radius_m: jax.Array, config: PathSearchConfig
) -> Trajectory:
    """Withdraw every path that comes too near to the start of a robot without a path.

    It can only be the path of a robot planned earlier: later ones keep clear of that start.
    """
    n_robot = radius_m.shape[0]
    distance_m = radius_m[:, None] + radius_m + config.margin_m

    def meets(row: jax.Array) -> jax.Array:
        path = jax.tree.map(lambda leaf: leaf[row], plans)
        return meets_starts(path, held.position_m[:, 0], distance_m[row], config.horizon_s)

    is_met = jax.vmap(meets)(jnp.arange(n_robot)) & ~jnp.eye(n_robot, dtype=bool)
    is_found = select_flyable(plans.found, is_met)
    return replace(select_paths(is_found, plans, held), found=is_found)
