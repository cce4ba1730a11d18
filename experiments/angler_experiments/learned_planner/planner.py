"""Planner learned: paths sampled by a network, repaired and chosen in closed form."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner import checkpoint, flow, network, path_encoding, repair
from angler_experiments.learned_planner.repair import RepairConfig
from angler_experiments.learned_planner.scene import build_frames, build_scene
from angler_experiments.learned_planner.shapes import N_CHANNELS, N_INNER_POINTS
from angler_mjx.errors import ConfigError
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands.trajectory import Trajectory

MAX_ROBOTS_AT_ONCE = {"gpu": 2048}
DEFAULT_MAX_ROBOTS_AT_ONCE = 64
"""Robots whose candidates are in memory at once, by platform."""

_N_START_HOLDS = 6
"""Number of start times of a robot."""
_TEAM_SEED, _COST_NOISE = 7, 0.3
"""Seed of alternative teams, and its random increase of arrival times."""


@dataclass(frozen=True, kw_only=True)
class LearnedSettings:
    """Settings of the planner, in [planner.learned]."""

    samples: int = 16
    """Paths sampled for each robot; the straight line is one more candidate."""
    steps: int = 4
    """Steps of the flow from noise to paths."""
    repair: bool = True
    """False: the first sampled path is flown without checks."""
    draw: Literal["learned", "noise"] = "learned"
    """Source of sampled paths: the network; or, for comparison, smooth noise."""
    pushes: int = 60
    """Number of pushes of way-points out of rock."""
    rounds: int = 4
    """Number of choices of the team, robots without a path first."""
    start_hold_s: float = 25.0
    """Latest start time of a robot."""
    margin_m: float = 0.1
    """Margin beyond the radii, from rock and between robots."""
    points: int = 32
    """Points of a path; the same as planner.points."""
    checkpoint: str = ""
    """File of a network; empty: the shipped one."""

    def __post_init__(self) -> None:
        """Refuse settings out of range."""
        for name, low, high in (
            ("samples", 1, 1024),
            ("steps", 1, 100),
            ("pushes", 0, 1000),
            ("rounds", 1, 100),
            ("points", N_INNER_POINTS + 3, 1024),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)}: must be {low} to {high}")
        if self.draw not in ("learned", "noise"):
            raise ValueError(f'draw = "{self.draw}": must be "learned" or "noise"')
        if not 0.0 <= self.start_hold_s <= 600.0:
            raise ValueError(f"start_hold_s = {self.start_hold_s:g}: must be 0 to 600 s")
        if not 0.0 <= self.margin_m <= 10.0:
            raise ValueError(f"margin_m = {self.margin_m:g}: must be 0 to 10 m")


class LearnedPlanner:
    """Plans batches of worlds on the device."""

    Settings = LearnedSettings

    def __init__(self, settings: LearnedSettings | None = None) -> None:
        """Read the network.

        Raises:
            ConfigError: the checkpoint does not exist, or is for another version.
        """
        self.settings = settings or LearnedSettings()
        file = self.settings.checkpoint
        self._params = checkpoint.load_checkpoint(Path(file).expanduser() if file else None).params

    def plan_batch(self, problems: Problem) -> Trajectory:
        """Return paths [world, robot]; ``found`` is False where all candidates collide.

        Args:
            problems: problems, [world] leading.

        Raises:
            ConfigError: the grid is higher than the check of lines allows.
        """
        shape = problems.grid.occupied.shape
        if shape[-1] > 32:
            raise ConfigError(
                f"planner learned: takes at most 32 cells along z, this grid has {shape[-1]}"
            )
        paths: Trajectory = jax.tree.map(lambda leaf: leaf[:, 0], self.plan_teams(problems, 1))
        return paths

    def plan_teams(self, problems: Problem, teams: int) -> Trajectory:
        """Return several answers to each problem, for a choice by simulation.

        Args:
            problems: problems, [world] leading.
            teams: number of answers; the first is that of `plan_batch`, the others are chosen from
                the same candidates with arrivals delayed at random. Without repair all are equal.

        Returns:
            Paths [world, team, robot].
        """
        robots = problems.team.radius_m.shape[-1]
        max_robots = MAX_ROBOTS_AT_ONCE.get(jax.default_backend(), DEFAULT_MAX_ROBOTS_AT_ONCE)
        batch = max(1, min(problems.team.radius_m.shape[0], max_robots // robots))
        paths: Trajectory = jax.lax.map(
            partial(self._plan_world, teams), problems, batch_size=batch
        )
        return paths

    def _plan_world(self, teams: int, problem: Problem) -> Trajectory:
        settings, frames = self.settings, build_frames(problem)
        samples = self._sample_paths(problem)
        if settings.repair:
            config = RepairConfig(
                margin_m=settings.margin_m,
                pushes=settings.pushes,
                hold_s=tuple(
                    settings.start_hold_s * k / (_N_START_HOLDS - 1) for k in range(_N_START_HOLDS)
                ),
                rounds=settings.rounds,
            )
            candidates = repair.build_candidates(problem, frames, samples, config)
            shape = candidates.paths.time_s.shape[:2]
            key = jax.random.fold_in(jax.random.key(problem.seed), _TEAM_SEED)
            cost_factors = 1.0 + _COST_NOISE * jnp.abs(jax.random.normal(key, (teams - 1, *shape)))
            cost_factors = jnp.concatenate([jnp.ones((1, *shape)), cost_factors])
            choose_team = partial(repair.choose_team_paths, problem, candidates, config)
            team_paths = jax.vmap(choose_team)(cost_factors)
        else:
            team = problem.team
            position_m = jax.vmap(path_encoding.decode_points)(samples[0], frames, team.goal_m)
            delays_s = jax.vmap(path_encoding.decode_delays_s)(samples[0])
            time, position_m = jax.vmap(path_encoding.time_path)(
                position_m, delays_s, jnp.zeros_like(team.radius_m), team.cruise_speed_mps
            )
            team_paths = Trajectory(
                time_s=time, position_m=position_m, found=time[:, -1] <= problem.horizon_s
            )
            team_paths = jax.tree.map(lambda leaf: jnp.stack([leaf] * teams), team_paths)
        path = jax.vmap(
            jax.vmap(lambda team_path: path_encoding.pad_path(team_path, settings.points))
        )(team_paths)
        start = problem.team.start_m[:, None]
        return replace(
            path,
            time_s=jnp.where(path.found[..., None], path.time_s, 0.0),
            position_m=jnp.where(path.found[..., None, None], path.position_m, start),
        )

    def _sample_paths(self, problem: Problem) -> jax.Array:
        settings, robots = self.settings, problem.team.radius_m.shape[0]
        key = jax.random.key(problem.seed)
        if settings.draw == "learned":
            context = network.encode_scene(self._params, build_scene(problem))
            return flow.sample_paths(self._params, context, key, settings.samples, settings.steps)
        return _smooth_noise(flow.sample_noise(key, settings.samples, robots))


def _smooth_noise(noise: jax.Array) -> jax.Array:
    """Return noise [..., inner, 4] as paths of two half waves sideways, without delays."""
    fraction = jnp.arange(1, N_INNER_POINTS + 1) / (N_INNER_POINTS + 1)
    first = noise[..., :1, :] * jnp.sin(jnp.pi * fraction)[:, None]
    second = 0.5 * noise[..., 1:2, :] * jnp.sin(2.0 * jnp.pi * fraction)[:, None]
    across = jnp.array([0.0, 1.0, 1.0, 0.0])[:N_CHANNELS]
    return (first + second) * across
