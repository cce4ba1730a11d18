"""Planner priority: teams of a batch of worlds, by a search over orders of priority.

Paths of single robots are searched as by `grid`, which has one order of priority only. Module
`team` searches the order of a team, and `queue` works off a batch of worlds.
"""

from dataclasses import dataclass, replace

import jax

from angler_mjx.planning.path_search.bodies import moving_traffic, still_obstacles
from angler_mjx.planning.path_search.lattice import build_terrain
from angler_mjx.planning.path_search.robot_search import (
    MAX_LAYERS,
    PathSearchConfig,
    path_search_config,
    require_still_water,
)
from angler_mjx.planning.priority import team
from angler_mjx.planning.priority.queue import run_slots
from angler_mjx.planning.priority.team import PriorityTask
from angler_mjx.planning.problem import Problem, ProblemSettings
from angler_mjx.robot.control.commands.trajectory import Trajectory

DEFAULT_ROOM_M = 0.8
"""Distance [m] between robots beyond the margin where a current carries slow robots, or drifting
obstacles stop robots on the paths of others; `docs/reference/planners.md` has its measurement."""

MAX_SLOTS = 1024
"""Worlds that are searched side by side; paths do not depend on it."""


@dataclass(frozen=True, kw_only=True)
class PrioritySettings:
    """Settings of the table [planner.priority]."""

    start_hold_s: float = PathSearchConfig.start_hold_s
    """Time [s] for which the start of a robot that is not planned yet is kept clear."""
    budget: int = 16
    """Searches of single robots per robot of the team; after them the robots without a path
    hold."""
    layers: int = 0
    """Layers of time that are searched; 0: as many as the fastest robot's steps need."""
    room_m: float | None = None
    """Distance [m] between hulls beyond the margin, where a path allows it; left out,
    `DEFAULT_ROOM_M` where the water or obstacles move, else 0. Replanning keeps the margin
    alone."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a number is out of its range.
        """
        if not 0.0 <= self.start_hold_s <= 86400.0:
            raise ValueError(f"start_hold_s = {self.start_hold_s:g}: must be 0 to 86400 s")
        if self.room_m is not None and not 0.0 <= self.room_m <= 1000.0:
            raise ValueError(f"room_m = {self.room_m:g}: must be 0 to 1000 m")
        for name, low, high in (("budget", 1, 10000), ("layers", 0, MAX_LAYERS)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)}: must be {low} to {high}")


class PriorityPlanner:
    """Planner ``priority`` of scenarios, a `BatchPlanner`."""

    Settings = PrioritySettings

    def __init__(self, settings: PrioritySettings) -> None:
        """Keep the settings."""
        self._settings = settings

    def check_problem(self, problem: ProblemSettings) -> None:
        """Refuse problems with information that the planner cannot use; see `BatchPlanner`."""
        require_still_water(problem, "priority")

    def plan_batch(self, problems: Problem) -> Trajectory:
        """Return the paths of all worlds; see `BatchPlanner`."""
        return plan_teams(problems, self._search_config(problems), self._settings.budget)

    def _search_config(self, problem: ProblemSettings) -> PathSearchConfig:
        settings, config = self._settings, path_search_config(problem)
        room_m = settings.room_m
        if room_m is None:
            room_m = DEFAULT_ROOM_M if problem.water_or_obstacles_move else 0.0
        return replace(
            config,
            start_hold_s=settings.start_hold_s,
            n_layer=settings.layers or config.n_layer,
            room_m=0.0 if problem.is_replan else room_m,
        )


def plan_teams(
    problems: Problem,
    config: PathSearchConfig,
    budget: int,
    slots: int = MAX_SLOTS,
    first: Trajectory | None = None,
) -> Trajectory:
    """Plan the fleets of a batch of worlds, [W] leading everywhere.

    Args:
        problems: the worlds, R robots each.
        config: static.
        budget: searches of single robots per robot of the team.
        slots: worlds that are searched side by side.
        first: [W, R] paths that robots have already and that do not meet; a path can be displaced
            by that of another robot.

    Returns:
        Trajectory [W, R], as `angler_mjx.planning.path_search.grid.plan_grid` gives it for one
        world. No two paths meet, nor does a path meet a robot without one, which stands at its
        start.
    """

    def build_task(problem: Problem, first: Trajectory | None) -> PriorityTask:
        still = still_obstacles(problem.obstacles)
        return PriorityTask(
            land=build_terrain(problem.grid, problem.floor_z_m, still),
            start_m=problem.team.start_m,
            goal_m=problem.team.goal_m,
            radius_m=problem.team.radius_m,
            speed_mps=problem.team.cruise_speed_mps,
            bodies=moving_traffic(problem),
            seed=problem.seed,
            first=first,
        )

    tasks = jax.vmap(build_task)(problems, first)
    best: Trajectory = run_slots(
        tasks,
        problems.seed.shape[0],
        slots,
        begin=lambda team_task: team.begin_search(team_task, config),
        step=lambda team_task, search: team.search_next_robot(team_task, search, config),
        ended=lambda search: team.is_finished(search, budget),
        result=lambda search: search.best,
    )
    return jax.vmap(lambda team_task, plans: team.select_flyable_paths(team_task, plans, config))(
        tasks, best
    )
