"""What scenarios call current: ways that take least energy or least time in the current it knows.

For each robot alone: least costs from all cells (`search`), the way that leads down them, shortened
and bent by what it costs (`shaping`). Then the team is put in time: who cannot go at once sets off
later (`timetable`); for whom no time suits a way is sought in space and time, as the planner
priority does, which knows no current. Speeds are those through the water that cost least, so that a
robot may be faster over ground than it cruises where the water carries it.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels.programs import on_gpu
from angler_mjx.planning.current import search, search_kernel
from angler_mjx.planning.current.map import step_costs
from angler_mjx.planning.current.motion_cost import Objective, PowerModel, power_model
from angler_mjx.planning.current.shaping import descend_path, leg_costs, resample_path, shorten_path
from angler_mjx.planning.current.timetable import schedule_departures
from angler_mjx.planning.path_search.bodies import bodies_traffic
from angler_mjx.planning.path_search.lattice import Terrain, build_terrain
from angler_mjx.planning.path_search.robot_search import PathSearchConfig
from angler_mjx.planning.priority import planner as priority
from angler_mjx.planning.problem import Team
from angler_mjx.robot.control.trajectory import Trajectory, hold_position
from angler_mjx.sim.information import CurrentInformation, ObstacleInformation
from angler_mjx.world.environment import Environment

MAX_ROBOTS_AT_ONCE = 4096
"""Robots whose costs are in memory at once: 0.2 MB each in worlds of 16^3 cells."""

_DEPARTURE_STEP_S = 2.0
"""Between the times at which a robot can set off."""


@dataclass(frozen=True, kw_only=True)
class CurrentSettings:
    """What a scenario can choose of it, in [planner.current]."""

    least: Objective = "energy"
    """What ways take least of: energy, with a second worth what makes the cruise speed the best one
    in still water; or time, at the cruise speed through the water."""
    effort: float = 0.7
    """Share of the terminal speeds that may be swum; the rest is left to the controllers."""
    start_hold_s: float = 30.0
    """The latest time at which a robot sets off."""
    budget: int = 4
    """Searches of single robots, for each robot of the team, for those for whom no such time
    suits; 0: they get no path."""

    def __post_init__(self) -> None:
        """Refuse what is none."""
        if self.least not in ("energy", "time"):
            raise ValueError(f'least = "{self.least}": must be "energy" or "time"')
        if not 0.1 <= self.effort <= 1.0:
            raise ValueError(f"effort = {self.effort:g}: must be 0.1 to 1")
        if not 0.0 <= self.start_hold_s <= 600.0:
            raise ValueError(f"start_hold_s = {self.start_hold_s:g}: must be 0 to 600 s")
        if not 0 <= self.budget <= 10000:
            raise ValueError(f"budget = {self.budget}: must be 0 to 10000")


@dataclass(frozen=True, kw_only=True)
class CurrentConfig:
    """Of a scenario; hashable, static under jit."""

    settings: CurrentSettings
    horizon_s: float
    margin_m: float
    """Kept beyond the radii."""
    n_point: int
    """Way-points of a path."""
    observes_moving_obstacles: bool
    """Whether obstacles that move are known of."""
    search_config: PathSearchConfig
    """How ways are sought for those for whom no time suits."""


class CurrentPlanner:
    """What scenarios call current; `plan_paths` is part of the program that draws the worlds."""

    Settings = CurrentSettings


def plan_paths(
    environments: Environment,
    teams: Team,
    current: CurrentInformation,
    obstacles: ObstacleInformation,
    seeds: jax.Array,
    config: CurrentConfig,
) -> Trajectory:
    """Plan the fleets of a batch of worlds, [W] leading everywhere.

    Args:
        environments: the worlds; their own currents are not looked at.
        teams: with starts and goals.
        current: as far as it is known.
        obstacles: that may move.
        seeds: uint32 [W] for what is drawn by lot.
        config: static.

    Returns:
        Trajectory [W, R] from the starts at time 0 to the goals; where ``found`` is False every row
        is the start. No two paths meet, nor does one meet a robot without a way.
    """
    paths = _plan_in_chunks(environments, teams, current, obstacles, config)
    if config.settings.budget == 0:
        return paths
    return priority.plan_teams(
        environments,
        teams.radius_m,
        teams.cruise_speed_mps,
        seeds,
        config.search_config,
        config.settings.budget,
        obstacles if config.observes_moving_obstacles else None,
        first=paths,
    )


def _plan_in_chunks(
    environments: Environment,
    teams: Team,
    current: CurrentInformation,
    obstacles: ObstacleInformation,
    config: CurrentConfig,
) -> Trajectory:
    worlds, robots = teams.radius_m.shape
    chunk = max(1, MAX_ROBOTS_AT_ONCE // robots)
    if worlds <= chunk:
        return _plan_batch(environments, teams, current, obstacles, config)
    parts = -(-worlds // chunk)
    rows = jnp.minimum(jnp.arange(parts * chunk), worlds - 1).reshape(parts, chunk)

    def plan_chunk(row: jax.Array) -> Trajectory:
        environment, team, flow, bodies = jax.tree.map(
            lambda leaf: leaf[row], (environments, teams, current, obstacles)
        )
        return _plan_batch(environment, team, flow, bodies, config)

    chunk_paths = jax.lax.map(plan_chunk, rows)
    paths: Trajectory = jax.tree.map(
        lambda leaf: leaf.reshape(parts * chunk, *leaf.shape[2:])[:worlds], chunk_paths
    )
    return paths


def _plan_batch(
    environments: Environment,
    teams: Team,
    current: CurrentInformation,
    obstacles: ObstacleInformation,
    config: CurrentConfig,
) -> Trajectory:
    worlds, robots = teams.radius_m.shape
    settings = config.settings
    terrains = jax.vmap(build_terrain)(environments)

    def of_team(team: Team) -> PowerModel:
        return jax.vmap(power_model, in_axes=(0, 0, 0, None, None))(
            team.cruise_speed_mps,
            team.terminal_speed_mps,
            team.power_w,
            settings.effort,
            settings.least,
        )

    models = jax.vmap(of_team)(teams)
    clearance = teams.radius_m + config.margin_m

    def costs(
        land: Terrain, team: PowerModel, clearance_m: jax.Array, flow: CurrentInformation
    ) -> jax.Array:
        zero = jnp.zeros((), clearance_m.dtype)
        return step_costs(land, team, clearance_m, lambda p: flow.velocity(p, zero))

    cost = jax.vmap(costs)(terrains, models, clearance, current)
    start, goal = (
        jax.vmap(_cells_at)(terrains, points_m) for points_m in (teams.start_m, teams.goal_m)
    )
    flat = cost.reshape(worlds * robots, *cost.shape[2:])
    value = _costs_to_goal(flat, goal.reshape(-1, 3))
    value = value.reshape(worlds, robots, *value.shape[1:])

    def of_robot(
        land: Terrain,
        floor_z_m: jax.Array,
        flow: CurrentInformation,
        robot: PowerModel,
        clearance_m: jax.Array,
        cost: jax.Array,
        value: jax.Array,
        ends: tuple[jax.Array, jax.Array, jax.Array],
    ) -> Trajectory:
        return _departure_paths(
            land, floor_z_m, flow, robot, clearance_m - 1e-4, cost, value, ends, config
        )

    def of_world(
        land: Terrain,
        floor_z_m: jax.Array,
        flow: CurrentInformation,
        bodies: ObstacleInformation,
        team: Team,
        robot: PowerModel,
        clearance_m: jax.Array,
        cost: jax.Array,
        value: jax.Array,
        start: jax.Array,
    ) -> Trajectory:
        ends = (start, team.start_m, team.goal_m)
        paths = jax.vmap(of_robot, in_axes=(None, None, None, 0, 0, 0, 0, 0))(
            land, floor_z_m, flow, robot, clearance_m, cost, value, ends
        )
        moving = (
            bodies_traffic(bodies, config.horizon_s) if config.observes_moving_obstacles else None
        )
        return schedule_departures(
            paths,
            hold_position(team.start_m, config.n_point),
            team.radius_m,
            moving,
            config.margin_m,
            config.horizon_s,
        )

    return jax.vmap(of_world)(
        terrains,
        environments.floor_z_m,
        current,
        obstacles,
        teams,
        models,
        clearance,
        cost,
        value,
        start,
    )


def _costs_to_goal(cost: jax.Array, goal: jax.Array) -> jax.Array:
    """`search.costs_to_goal`, by a program for each robot where that is possible."""
    if on_gpu():
        return jax.vmap(search_kernel.costs_to_goal)(cost, goal)
    return search.costs_to_goal(cost, goal)


def _cells_at(land: Terrain, position_m: jax.Array) -> jax.Array:
    """Cells int32 [R, 3] that hold places [R, 3]."""
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
    config: CurrentConfig,
) -> Trajectory:
    """The way of one robot for each time at which it can set off, [H] leading."""
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
    count = int(config.settings.start_hold_s // _DEPARTURE_STEP_S) + 1

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
