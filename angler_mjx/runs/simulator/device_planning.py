"""The planners that are part of the program which draws the worlds: chosen, and put to it."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax

from angler_mjx.errors import ConfigError, report_user_errors
from angler_mjx.planning import grid as grid_planner
from angler_mjx.planning.current import planner as current
from angler_mjx.planning.current.planner import CurrentConfig, CurrentSettings
from angler_mjx.planning.path_search.robot_search import PathSearchConfig, required_layers
from angler_mjx.planning.planner import Path
from angler_mjx.planning.priority import planner as priority
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World
from angler_mjx.world.config import resolve_world

GRID = "grid"
"""The planner that plans each world as it is drawn."""

CURRENT = "current"
"""The one that is told of the current."""


def build_device_planner(scenario: Scenario, spec: PlannerSpec) -> Callable[[World, Problem], Path]:
    """The function by which a planner of the device plans worlds that are drawn; to be traced.

    Args:
        scenario: with its margin, points and horizon.
        spec: the planner.
    """
    if not spec.reference.on_device:
        name, file = spec.reference.name, spec.reference.file
        with report_user_errors(f"planner {name}: its constructor", file):
            planner = spec.make()

        def batch(worlds: World, problems: Problem) -> Path:
            with report_user_errors(f"planner {name}: plan_batch", file):
                path: Path = planner.plan_batch(problems)
            return path

        return batch
    if spec.reference.name == CURRENT:
        settings = current_config(scenario, spec)

        def by_current(worlds: World, problems: Problem) -> Path:
            return current.plan_paths(
                worlds.environment,
                problems.team,
                problems.current,
                problems.obstacles,
                problems.seed,
                settings,
            )

        return by_current
    config = path_search_config(scenario, spec)
    if spec.reference.name == GRID:
        plan = partial(grid_planner.plan_grid, config=config)

        def by_grid(worlds: World, problems: Problem) -> Path:
            obstacles = problems.obstacles if has_obstacle_information(scenario) else None
            team = problems.team
            path: Path = jax.vmap(plan)(
                worlds.environment, team.radius_m, team.cruise_speed_mps, obstacles=obstacles
            )
            return path

        return by_grid
    budget = priority_budget(spec)

    def by_priority(worlds: World, problems: Problem) -> Path:
        obstacles = problems.obstacles if has_obstacle_information(scenario) else None
        team = problems.team
        return priority.plan_teams(
            worlds.environment,
            team.radius_m,
            team.cruise_speed_mps,
            problems.seed,
            config,
            budget,
            obstacles,
        )

    return by_priority


def path_search_config(scenario: Scenario, spec: PlannerSpec) -> PathSearchConfig:
    """How a planner of the device looks for ways.

    Raises:
        ConfigError: it is to know what it cannot use.
    """
    information, name = scenario.planner.information, spec.reference.name
    if information.current != "nothing" and information.obstacles != "predicted":
        raise ConfigError(
            f'planner.information.current = "{information.current}": the planner {name} plans in '
            "still water, where the current can only help to predict obstacles; take "
            'planner.information.obstacles = "predicted", or "nothing" here, or another planner'
        )
    config = _base_search_config(scenario)
    if name == GRID:
        return replace(config, **spec.settings)
    settings = priority.PrioritySettings(**spec.settings)
    room_m = settings.room_m
    if room_m is None:
        room_m = priority.DEFAULT_ROOM_M if scenario.water_or_obstacles_move else 0.0
    return replace(
        config,
        start_hold_s=settings.start_hold_s,
        n_layer=settings.layers or config.n_layer,
        room_m=room_m,
    )


def _base_search_config(scenario: Scenario) -> PathSearchConfig:
    """With as many layers as the fastest robot needs."""
    horizon_s = scenario.time.horizon_s
    fastest = max(entry.cruise_speed_mps for entry in scenario.fleet)
    return PathSearchConfig(
        horizon_s=horizon_s,
        margin_m=scenario.planner.margin_m,
        n_point=scenario.planner.points,
        n_layer=required_layers(horizon_s, fastest, resolve_world(scenario.world).cell_m),
    )


def priority_budget(spec: PlannerSpec) -> int:
    """Searches of single robots that the planner priority has for each robot of a team."""
    return priority.PrioritySettings(**spec.settings).budget


def current_config(scenario: Scenario, spec: PlannerSpec) -> CurrentConfig:
    """How the planner current plans.

    Raises:
        ConfigError: paths have too few points.
    """
    if scenario.planner.points < 4:
        raise ConfigError(
            f"planner.points = {scenario.planner.points}: the planner current needs at least 4"
        )
    return CurrentConfig(
        settings=CurrentSettings(**spec.settings),
        horizon_s=scenario.time.horizon_s,
        margin_m=scenario.planner.margin_m,
        n_point=scenario.planner.points,
        observes_moving_obstacles=has_obstacle_information(scenario),
        search_config=_base_search_config(scenario),
    )


def has_obstacle_information(scenario: Scenario) -> bool:
    """Whether the planner may know of obstacles that move."""
    return scenario.planner.information.obstacles != "nothing"
