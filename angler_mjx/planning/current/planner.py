"""Planner current: paths of least energy or least time in the known current.

Each robot is planned alone first: least costs from all cells (`search`), a path down them,
shortened and bent to lower its cost (`shaping`). Then departures are scheduled (`timetable`): a
robot whose path is blocked departs later. A robot that no departure suits is searched in space and
time as by the planner priority, which ignores the current. Speeds through the water are those of
least cost, so a robot may exceed its cruise speed over ground where the current carries it, unless
``limit_ground_speed`` is set.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp

from angler_kernels.programs import use_kernels
from angler_mjx.errors import ConfigError
from angler_mjx.planning.current import search, search_kernel
from angler_mjx.planning.current.map import step_costs
from angler_mjx.planning.current.motion_cost import Objective, PowerModel, power_model
from angler_mjx.planning.current.shaping import descend_path, leg_costs, resample_path, shorten_path
from angler_mjx.planning.current.timetable import schedule_departures
from angler_mjx.planning.path_search.bodies import moving_traffic, still_obstacles
from angler_mjx.planning.path_search.lattice import Terrain, build_terrain
from angler_mjx.planning.path_search.robot_search import PathSearchConfig, path_search_config
from angler_mjx.planning.priority import planner as priority
from angler_mjx.planning.problem import Problem, ProblemSettings, Team
from angler_mjx.robot.control.commands.trajectory import Trajectory, hold_position
from angler_mjx.sim.information import CurrentInformation

MAX_ROBOTS_AT_ONCE = 4096
"""Robots whose costs are in memory at once: 0.2 MB each in worlds of 16^3 cells."""

_DEPARTURE_STEP_S = 2.0
"""Time [s] between two possible departures."""
_MIN_POINTS = 4
"""Least number of way-points of a path: two ends, a late departure and a bend."""


@dataclass(frozen=True, kw_only=True)
class CurrentSettings:
    """Settings of the table [planner.current]."""

    least: Objective = "energy"
    """Objective: energy, with a price of time that makes the cruise speed optimal in still water;
    or time, at the cruise speed through the water."""
    effort: float = 0.7
    """Fraction of the terminal speeds that paths may use; the rest is left to the controllers."""
    start_hold_s: float = 30.0
    """Latest departure [s] of a robot."""
    limit_ground_speed: bool = False
    """Whether the cruise speed limits the speed over ground as well, as ANGLER-1 asks for."""
    budget: int = 4
    """Searches of single robots per robot of the team, for robots that no departure suits; 0: they
    get no path."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a value is out of its range.
        """
        if self.least not in ("energy", "time"):
            raise ValueError(f'least = "{self.least}": must be "energy" or "time"')
        if not 0.1 <= self.effort <= 1.0:
            raise ValueError(f"effort = {self.effort:g}: must be 0.1 to 1")
        if not 0.0 <= self.start_hold_s <= 600.0:
            raise ValueError(f"start_hold_s = {self.start_hold_s:g}: must be 0 to 600 s")
        if not 0 <= self.budget <= 10000:
            raise ValueError(f"budget = {self.budget}: must be 0 to 10000")


class CurrentPlanner:
    """Planner ``current`` of scenarios, a `BatchPlanner`."""

    Settings = CurrentSettings

    def __init__(self, settings: CurrentSettings) -> None:
        """Keep the settings."""
        self._settings = settings

    def check_problem(self, problem: ProblemSettings) -> None:
        """Refuse paths with too few points; see `BatchPlanner`."""
        if problem.points < _MIN_POINTS:
            raise ConfigError(
                f"planner.points = {problem.points}: the planner current needs at least "
                f"{_MIN_POINTS}"
            )

    def plan_batch(self, problems: Problem) -> Trajectory:
        """Return the paths of all worlds; see `BatchPlanner`."""
        return plan_paths(problems, self._settings, path_search_config(problems))


def plan_paths(
    problems: Problem, settings: CurrentSettings, config: PathSearchConfig
) -> Trajectory:
    """Plan the fleets of a batch of worlds, [W] leading everywhere.

    Args:
        problems: the worlds, R robots each.
        settings: static.
        config: static; of the search in space and time for robots that no departure suits.

    Returns:
        Trajectory [W, R] from the starts at time 0 to the goals; where ``found`` is False every row
        is the start. No two paths meet, nor does a path meet a robot without one.
    """
    paths = _plan_in_chunks(problems, settings, config)
    if settings.budget == 0:
        return paths
    return priority.plan_teams(problems, config, settings.budget, first=paths)


def _plan_in_chunks(
    problems: Problem, settings: CurrentSettings, config: PathSearchConfig
) -> Trajectory:
    worlds, robots = problems.team.radius_m.shape
    chunk = max(1, MAX_ROBOTS_AT_ONCE // robots)
    if worlds <= chunk:
        return _plan_batch(problems, settings, config)
    parts = -(-worlds // chunk)
    rows = jnp.minimum(jnp.arange(parts * chunk), worlds - 1).reshape(parts, chunk)

    def plan_chunk(row: jax.Array) -> Trajectory:
        return _plan_batch(jax.tree.map(lambda leaf: leaf[row], problems), settings, config)

    chunk_paths = jax.lax.map(plan_chunk, rows)
    paths: Trajectory = jax.tree.map(
        lambda leaf: leaf.reshape(parts * chunk, *leaf.shape[2:])[:worlds], chunk_paths
    )
    return paths


def _plan_batch(
    problems: Problem, settings: CurrentSettings, config: PathSearchConfig
) -> Trajectory:
    teams = problems.team
    worlds, robots = teams.radius_m.shape
    terrains = jax.vmap(_problem_terrain)(problems)
    models = jax.vmap(partial(_power_models, settings=settings))(teams)
    clearance = teams.radius_m + config.margin_m

    def costs(
        land: Terrain, team: PowerModel, clearance_m: jax.Array, flow: CurrentInformation
    ) -> jax.Array:
        zero = jnp.zeros((), clearance_m.dtype)
        return step_costs(land, team, clearance_m, lambda p: flow.velocity(p, zero))

    cost = jax.vmap(costs)(terrains, models, clearance, problems.current)
    start, goal = (
        jax.vmap(_cells_at)(terrains, points_m) for points_m in (teams.start_m, teams.goal_m)
    )
    flat = cost.reshape(worlds * robots, *cost.shape[2:])
    value = _costs_to_goal(flat, goal.reshape(-1, 3))
    value = value.reshape(worlds, robots, *value.shape[1:])

    def of_robot(
        land: Terrain,
        problem: Problem,
        robot: PowerModel,
        clearance_m: jax.Array,
        cost: jax.Array,
        value: jax.Array,
        ends: tuple[jax.Array, jax.Array, jax.Array],
    ) -> Trajectory:
        return _departure_paths(
            land,
            problem.floor_z_m,
            problem.current,
            robot,
            clearance_m - 1e-4,
            cost,
            value,
            ends,
            settings,
            config,
        )

    def of_world(
        land: Terrain,
        problem: Problem,
        robot: PowerModel,
        clearance_m: jax.Array,
        cost: jax.Array,
        value: jax.Array,
        start: jax.Array,
    ) -> Trajectory:
        team = problem.team
        ends = (start, team.start_m, team.goal_m)
        paths = jax.vmap(of_robot, in_axes=(None, None, 0, 0, 0, 0, 0))(
            land, problem, robot, clearance_m, cost, value, ends
        )
        return schedule_departures(
            paths,
            hold_position(team.start_m, config.n_point),
            team.radius_m,
            moving_traffic(problem),
            config.margin_m,
            config.horizon_s,
        )

    return jax.vmap(of_world)(terrains, problems, models, clearance, cost, value, start)


def _problem_terrain(problem: Problem) -> Terrain:
    return build_terrain(problem.grid, problem.floor_z_m, still_obstacles(problem.obstacles))


def _power_models(team: Team, settings: CurrentSettings) -> PowerModel:
    """Return the power models [R] of a team."""
    return jax.vmap(power_model, in_axes=(0, 0, 0, None, None, None))(
        team.cruise_speed_mps,
        team.terminal_speed_mps,
        team.power_w,
        settings.effort,
        settings.least,
        settings.limit_ground_speed,
    )


def _costs_to_goal(cost: jax.Array, goal: jax.Array) -> jax.Array:
    """Return `search.costs_to_goal`, by a program for each robot on a GPU."""
    if use_kernels():
        return jax.vmap(search_kernel.costs_to_goal)(cost, goal)
    return search.costs_to_goal(cost, goal)


def _cells_at(land: Terrain, position_m: jax.Array) -> jax.Array:
    """Return the cells int32 [R, 3] that hold points [R, 3], m, W."""
    top = jnp.array(land.layout.shape) - 1
    at = jnp.floor((position_m - land.grid.origin_m) / land.grid.cell_m).astype(jnp.int32)
    return jnp.clip(at, 0, top)


def _departure_paths(
    land: Terrain,
    floor_z_m: jax.Array,
    current: CurrentInformation,
    robot: PowerModel,
    clearance_m: jax.Array,
    cost: jax.Array,
    value: jax.Array,
    ends: tuple[jax.Array, jax.Array, jax.Array],
    settings: CurrentSettings,
    config: PathSearchConfig,
) -> Trajectory:
    """Return the path of one robot for each departure, [H] leading."""
    cell, start_m, goal_m = ends
    cells, reached = search.trace_path(cost, value, cell, 2 * sum(land.layout.shape))
    centres = land.grid.origin_m + (cells + 0.5) * land.grid.cell_m
    # From the middle of the goal's cell to the goal itself, and there for the rest.
    is_at_goal = jnp.cumsum(jnp.all(cells == cells[-1], axis=-1)) > 1
    centres = jnp.where(is_at_goal[:, None], goal_m, centres)
    rough_m = jnp.concatenate([start_m[None], centres, goal_m[None]])
    max_points = config.n_point - 1
    shortened_m, is_short_enough = shorten_path(
        land, robot, rough_m, clearance_m, current.velocity, max_points
    )
    points = resample_path(shortened_m, max_points)
    path_m = descend_path(
        land, robot, points, clearance_m, floor_z_m, current.velocity, current.stays
    )
    count = int(settings.start_hold_s // _DEPARTURE_STEP_S) + 1

    def departing_path(at_s: jax.Array) -> Trajectory:
        leg = leg_costs(robot, path_m, current.velocity, at_s, current.stays)
        time = at_s + jnp.concatenate([jnp.zeros(1, at_s.dtype), jnp.cumsum(leg.span_s)])
        is_possible = jnp.all(leg.cost < search.NO_PATH_COST) & jnp.all(jnp.isfinite(time))
        return Trajectory(
            time_s=jnp.concatenate([jnp.zeros(1, at_s.dtype), time]),
            position_m=jnp.concatenate([path_m[:1], path_m]),
            found=reached & is_short_enough & is_possible & (time[-1] <= config.horizon_s),
        )

    return jax.vmap(departing_path)(_DEPARTURE_STEP_S * jnp.arange(count, dtype=start_m.dtype))
