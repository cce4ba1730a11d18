"""The planners that are part of the program which draws the worlds: chosen, and put to it."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax

from angler_mjx.errors import ConfigError, raised_by
from angler_mjx.planning import grid as grid_planner
from angler_mjx.planning.current import planner as current
from angler_mjx.planning.current.planner import CurrentConfig, CurrentSettings
from angler_mjx.planning.path_search.robot import WayConfig, layers
from angler_mjx.planning.planner import Path
from angler_mjx.planning.priority import planner as priority
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World
from angler_mjx.world.config import resolve

GRID = "grid"
"""The planner that plans each world as it is drawn."""

CURRENT = "current"
"""The one that is told of the current."""


def device_planner(scenario: Scenario, spec: PlannerSpec) -> Callable[[World, Problem], Path]:
    """The function by which a planner of the device plans worlds that are drawn; to be traced.

    Args:
        scenario: with its margin, points and horizon.
        spec: the planner.
    """
    if not spec.reference.on_device:
        name, file = spec.reference.name, spec.reference.file
        with raised_by(f"planner {name}: its constructor", file):
            planner = spec.make()

        def batch(worlds: World, problems: Problem) -> Path:
            with raised_by(f"planner {name}: plan_batch", file):
                path: Path = planner.plan_batch(problems)
            return path

        return batch
    if spec.reference.name == CURRENT:
        chosen = current_config(scenario, spec)

        def by_current(worlds: World, problems: Problem) -> Path:
            return current.plan(
                worlds.environment,
                problems.team,
                problems.current,
                problems.obstacles,
                problems.seed,
                chosen,
            )

        return by_current
    config = ways_config(scenario, spec)
    if spec.reference.name == GRID:
        plan = partial(grid_planner.plan, config=config)

        def by_grid(worlds: World, problems: Problem) -> Path:
            known = problems.obstacles if foresees(scenario) else None
            team = problems.team
            path: Path = jax.vmap(plan)(
                worlds.environment, team.radius_m, team.cruise_speed_mps, known=known
            )
            return path

        return by_grid
    budget = priority_budget(spec)

    def by_priority(worlds: World, problems: Problem) -> Path:
        known = problems.obstacles if foresees(scenario) else None
        team = problems.team
        return priority.plan(
            worlds.environment,
            team.radius_m,
            team.cruise_speed_mps,
            problems.seed,
            config,
            budget,
            known,
        )

    return by_priority


def ways_config(scenario: Scenario, spec: PlannerSpec) -> WayConfig:
    """How a planner of the device looks for ways.

    Raises:
        ConfigError: it is to know what it cannot use.
    """
    knows, name = scenario.planner.knows, spec.reference.name
    if knows.current != "nothing" and knows.obstacles != "predicted":
        raise ConfigError(
            f'planner.knows.current = "{knows.current}": the planner {name} plans in still water, '
            "where the current can only help to predict obstacles; "
            'take planner.knows.obstacles = "predicted", or "nothing" here, or another planner'
        )
    config = _ways(scenario)
    if name == GRID:
        return replace(config, **spec.settings)
    chosen = priority.PrioritySettings(**spec.settings)
    room_m = chosen.room_m
    if room_m is None:
        room_m = priority.ROOM_M if scenario.water_or_obstacles_move else 0.0
    return replace(
        config,
        start_hold_s=chosen.start_hold_s,
        n_layer=chosen.layers or config.n_layer,
        room_m=room_m,
    )


def _ways(scenario: Scenario) -> WayConfig:
    """With as many layers as the fastest robot needs."""
    horizon_s = scenario.time.horizon_s
    fastest = max(entry.cruise_speed_mps for entry in scenario.fleet)
    return WayConfig(
        horizon_s=horizon_s,
        margin_m=scenario.planner.margin_m,
        n_point=scenario.planner.points,
        n_layer=layers(horizon_s, fastest, resolve(scenario.world).cell_m),
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
        foresees=foresees(scenario),
        ways=_ways(scenario),
    )


def foresees(scenario: Scenario) -> bool:
    """Whether the planner may know of obstacles that move."""
    return scenario.planner.knows.obstacles != "nothing"
