"""What scenarios call priority: whole teams in each world of a batch, on the device.

The ways are those of `grid`, which knows one order of priority only; see `team` for how a team
comes to its own, and `queue` for how a batch of worlds is worked off.
"""

from dataclasses import dataclass

import jax

from angler_mjx.planning.path_search.bodies import bodies_traffic
from angler_mjx.planning.path_search.lattice import build_terrain
from angler_mjx.planning.path_search.robot_search import MAX_LAYERS, PathSearchConfig
from angler_mjx.planning.priority import team
from angler_mjx.planning.priority.queue import run_slots
from angler_mjx.planning.priority.team import PriorityTask
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.sim.information import ObstacleInformation
from angler_mjx.world.environment import Environment

DEFAULT_ROOM_M = 0.8
"""Room between robots where a current carries slow ones, or drifting obstacles stop some of them in
the way of others; see `docs/planners.md` for its measurement."""

MAX_SLOTS = 1024
"""Worlds that are searched side by side; what they come to does not depend on it."""


@dataclass(frozen=True, kw_only=True)
class PrioritySettings:
    """What a scenario can choose of it, in [planner.priority]."""

    start_hold_s: float = PathSearchConfig.start_hold_s
    """How long the start of a robot that is not planned yet is kept clear."""
    budget: int = 16
    """Searches of single robots, for each robot of the team; then what is planned is flown."""
    layers: int = 0
    """Layers of time that are searched; 0: as many as the fastest robot's steps need."""
    room_m: float | None = None
    """Distance between hulls beyond the margin, where a path allows it; left out, `DEFAULT_ROOM_M`
    where the water or obstacles move, else 0. Replanning keeps the margin alone."""

    def __post_init__(self) -> None:
        """Refuse what is none."""
        if not 0.0 <= self.start_hold_s <= 86400.0:
            raise ValueError(f"start_hold_s = {self.start_hold_s:g}: must be 0 to 86400 s")
        if self.room_m is not None and not 0.0 <= self.room_m <= 1000.0:
            raise ValueError(f"room_m = {self.room_m:g}: must be 0 to 1000 m")
        for name, low, high in (("budget", 1, 10000), ("layers", 0, MAX_LAYERS)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)}: must be {low} to {high}")


class PriorityPlanner:
    """What scenarios call priority; `plan_teams` is part of the program that draws the worlds."""

    Settings = PrioritySettings


def plan_teams(
    environments: Environment,
    radius_m: jax.Array,
    speed_mps: jax.Array,
    seeds: jax.Array,
    config: PathSearchConfig,
    budget: int,
    obstacles: ObstacleInformation | None = None,
    slots: int = MAX_SLOTS,
    first: Trajectory | None = None,
) -> Trajectory:
    """Plan the fleets of a batch of worlds, [W] leading everywhere.

    Args:
        environments: the worlds.
        radius_m: [W, R] radius of the sphere about each robot's centre of mass that holds its hull.
        speed_mps: [W, R] cruise speed, positive.
        seeds: uint32 [W] for what is drawn by lot.
        config: static.
        budget: searches of single robots, for each robot of the team.
        obstacles: obstacles that may move; none do, if left out.
        slots: worlds that are searched side by side.
        first: [W, R] paths that some robots have already, none of which meet; they may be driven
            out for others.

    Returns:
        Trajectory [W, R], as `angler_mjx.planning.grid.plan_grid` gives it for one world. No two
        paths meet, nor does one meet a robot without a way, which stands at its start.
    """

    def build_task(
        environment: Environment,
        radius: jax.Array,
        speed: jax.Array,
        seed: jax.Array,
        obstacles: ObstacleInformation | None,
        first: Trajectory | None,
    ) -> PriorityTask:
        return PriorityTask(
            land=build_terrain(environment),
            start_m=environment.start_m,
            goal_m=environment.goal_m,
            radius_m=radius,
            speed_mps=speed,
            bodies=None if obstacles is None else bodies_traffic(obstacles, config.horizon_s),
            seed=seed,
            first=first,
        )

    tasks = jax.vmap(build_task)(environments, radius_m, speed_mps, seeds, obstacles, first)
    best: Trajectory = run_slots(
        tasks,
        radius_m.shape[0],
        slots,
        begin=lambda team_task: team.begin_search(team_task, config),
        step=lambda team_task, search: team.search_next_robot(team_task, search, config),
        ended=lambda search: team.is_finished(search, budget),
        result=lambda search: search.best,
    )
    paths: Trajectory = jax.vmap(
        lambda team_task, plans: team.select_flyable_paths(team_task, plans, config)
    )(tasks, best)
    return paths
