"""What scenarios call priority: whole teams in each world of a batch, on the device.

The ways are those of `grid`, which knows one order of priority only; see `team` for how a team
comes to its own, and `queue` for how a batch of worlds is worked off.
"""

from dataclasses import dataclass

import jax

from angler_mjx.planning.path_search.bodies import bodies_traffic
from angler_mjx.planning.path_search.lattice import terrain
from angler_mjx.planning.path_search.robot import MOST_LAYERS, WayConfig
from angler_mjx.planning.priority import team
from angler_mjx.planning.priority.queue import work_off
from angler_mjx.planning.priority.team import PriorityTask
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.sim.information import ObstacleInformation
from angler_mjx.world.environment import Environment

ROOM_M = 0.8
"""Room between robots where a current carries slow ones, or drifting obstacles stop some of them in
the way of others; see `docs/planners.md` for its measurement."""

SLOTS = 1024
"""Worlds that are searched side by side; what they come to does not depend on it."""


@dataclass(frozen=True, kw_only=True)
class PrioritySettings:
    """What a scenario can choose of it, in [planner.priority]."""

    start_hold_s: float = WayConfig.start_hold_s
    """How long the start of a robot that is not planned yet is kept clear."""
    budget: int = 16
    """Searches of single robots, for each robot of the team; then what is planned is flown."""
    layers: int = 0
    """Layers of time that are searched; 0: as many as the fastest robot's steps need."""
    room_m: float | None = None
    """Distance between hulls beyond the margin, where a way allows it; if left out `ROOM_M` where
    the water or obstacles move, else 0. Plans made anew in flight keep the margin alone."""

    def __post_init__(self) -> None:
        """Refuse what is none."""
        if not 0.0 <= self.start_hold_s <= 86400.0:
            raise ValueError(f"start_hold_s = {self.start_hold_s:g}: must be 0 to 86400 s")
        if self.room_m is not None and not 0.0 <= self.room_m <= 1000.0:
            raise ValueError(f"room_m = {self.room_m:g}: must be 0 to 1000 m")
        for name, low, high in (("budget", 1, 10000), ("layers", 0, MOST_LAYERS)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)}: must be {low} to {high}")


class PriorityPlanner:
    """What scenarios call priority; `plan` is part of the program that draws the worlds."""

    Settings = PrioritySettings


def plan(
    environments: Environment,
    radius_m: jax.Array,
    speed_mps: jax.Array,
    seeds: jax.Array,
    config: WayConfig,
    budget: int,
    known: ObstacleInformation | None = None,
    slots: int = SLOTS,
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
        known: obstacles that may move; none do, if left out.
        slots: worlds that are searched side by side.
        first: [W, R] paths that some robots have already, none of which meet; they may be driven
            out for others.

    Returns:
        Trajectory [W, R], as `angler_mjx.planning.grid.plan` gives it for one world. No two paths
        meet, nor does one meet a robot without a way, which stands at its start.
    """

    def task(
        environment: Environment,
        radius: jax.Array,
        speed: jax.Array,
        seed: jax.Array,
        known: ObstacleInformation | None,
        first: Trajectory | None,
    ) -> PriorityTask:
        return PriorityTask(
            land=terrain(environment),
            start_m=environment.start_m,
            goal_m=environment.goal_m,
            radius_m=radius,
            speed_mps=speed,
            bodies=None if known is None else bodies_traffic(known, config.horizon_s),
            seed=seed,
            first=first,
        )

    tasks = jax.vmap(task)(environments, radius_m, speed_mps, seeds, known, first)
    best: Trajectory = work_off(
        tasks,
        radius_m.shape[0],
        slots,
        begin=lambda one: team.begin(one, config),
        step=lambda one, search: team.step(one, search, config),
        ended=lambda search: team.ended(search, budget),
        result=lambda search: search.best,
    )
    paths: Trajectory = jax.vmap(lambda one, plans: team.to_fly(one, plans, config))(tasks, best)
    return paths
