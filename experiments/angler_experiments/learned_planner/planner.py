"""What scenarios call learned: ways drawn by a network, repaired and chosen in closed form."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner import checkpoint, flow, network, path_encoding, repair
from angler_experiments.learned_planner.repair import RepairConfig
from angler_experiments.learned_planner.scene import lines, scene
from angler_experiments.learned_planner.shapes import CHANNELS, INNER
from angler_mjx.errors import ConfigError
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.trajectory import Trajectory

AT_ONCE = {"gpu": 2048}
AT_ONCE_ELSEWHERE = 64
"""Robots whose candidates are in memory at once, by platform."""

_HOLDS = 6
"""Times at which a robot may set off."""
_TEAMS, _WORSE = 7, 0.3
"""Number of the lot by which teams are drawn, and how much worse it makes arrivals."""


@dataclass(frozen=True, kw_only=True)
class LearnedSettings:
    """What a scenario can choose of it, in [planner.learned]."""

    samples: int = 16
    """Ways drawn for each robot; the straight line is one more candidate."""
    steps: int = 4
    """Of the flow from noise to ways."""
    repair: bool = True
    """False: the first way that is drawn is flown, whatever it meets."""
    draw: Literal["learned", "noise"] = "learned"
    """What ways are drawn from: the network; or, for comparison, smooth noise."""
    pushes: int = 60
    """How often way-points are moved out of rock."""
    rounds: int = 4
    """How often the team is chosen anew, with those who found nothing first."""
    start_hold_s: float = 25.0
    """The latest time at which a robot sets off."""
    margin_m: float = 0.1
    """Kept beyond the radii, from rock and between robots."""
    points: int = 32
    """Of a path; the same as planner.points."""
    checkpoint: str = ""
    """File of a network; empty: the one that comes with this package."""

    def __post_init__(self) -> None:
        """Refuse what is none."""
        for name, low, high in (
            ("samples", 1, 1024),
            ("steps", 1, 100),
            ("pushes", 0, 1000),
            ("rounds", 1, 100),
            ("points", INNER + 3, 1024),
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
            ConfigError: there is no such checkpoint, or it is for another version.
        """
        self.settings = settings or LearnedSettings()
        file = self.settings.checkpoint
        self._params = checkpoint.load(Path(file).expanduser() if file else None).params

    def plan_batch(self, problems: Problem) -> Trajectory:
        """Paths [world, robot]; ``found`` is False where all candidates meet something.

        Args:
            problems: [world] leading.

        Raises:
            ConfigError: the grid is higher than the check of lines takes.
        """
        shape = problems.grid.occupied.shape
        if shape[-1] > 32:
            raise ConfigError(
                f"planner learned: takes at most 32 cells along z, this grid has {shape[-1]}"
            )
        paths: Trajectory = jax.tree.map(lambda leaf: leaf[:, 0], self.plan_teams(problems, 1))
        return paths

    def plan_teams(self, problems: Problem, teams: int) -> Trajectory:
        """Several answers to each problem, to be judged by who can fly them.

        Args:
            problems: [world] leading.
            teams: how many; the first is that of `plan_batch`, the others are chosen from the same
                candidates with arrivals made worse at random. Without repair all are one.

        Returns:
            Paths [world, team, robot].
        """
        robots = problems.team.radius_m.shape[-1]
        at_once = AT_ONCE.get(jax.default_backend(), AT_ONCE_ELSEWHERE)
        batch = max(1, min(problems.team.radius_m.shape[0], at_once // robots))
        paths: Trajectory = jax.lax.map(partial(self._one, teams), problems, batch_size=batch)
        return paths

    def _one(self, teams: int, problem: Problem) -> Trajectory:
        settings, frames = self.settings, lines(problem)
        drawn = self._drawn(problem)
        if settings.repair:
            config = RepairConfig(
                margin_m=settings.margin_m,
                pushes=settings.pushes,
                hold_s=tuple(settings.start_hold_s * k / (_HOLDS - 1) for k in range(_HOLDS)),
                rounds=settings.rounds,
            )
            given = repair.candidates(problem, frames, drawn, config)
            shape = given.paths.time_s.shape[:2]
            key = jax.random.fold_in(jax.random.key(problem.seed), _TEAMS)
            worse = 1.0 + _WORSE * jnp.abs(jax.random.normal(key, (teams - 1, *shape)))
            worse = jnp.concatenate([jnp.ones((1, *shape)), worse])
            choose = partial(repair.choose, problem, given, config)
            found = jax.vmap(choose)(worse)
        else:
            team = problem.team
            place = jax.vmap(path_encoding.points)(drawn[0], frames, team.goal_m)
            added = jax.vmap(path_encoding.delays_s)(drawn[0])
            time, place = jax.vmap(path_encoding.timed)(
                place, added, jnp.zeros_like(team.radius_m), team.cruise_speed_mps
            )
            found = Trajectory(
                time_s=time, position_m=place, found=time[:, -1] <= problem.horizon_s
            )
            found = jax.tree.map(lambda leaf: jnp.stack([leaf] * teams), found)
        path = jax.vmap(jax.vmap(lambda one: path_encoding.padded(one, settings.points)))(found)
        start = problem.team.start_m[:, None]
        return replace(
            path,
            time_s=jnp.where(path.found[..., None], path.time_s, 0.0),
            position_m=jnp.where(path.found[..., None, None], path.position_m, start),
        )

    def _drawn(self, problem: Problem) -> jax.Array:
        settings, robots = self.settings, problem.team.radius_m.shape[0]
        key = jax.random.key(problem.seed)
        if settings.draw == "learned":
            context = network.encode(self._params, scene(problem))
            return flow.draw(self._params, context, key, settings.samples, settings.steps)
        return _waves(flow.noise(key, settings.samples, robots))


def _waves(noise: jax.Array) -> jax.Array:
    """Noise [..., inner, 4] as ways of two half waves across, with no delays."""
    share = jnp.arange(1, INNER + 1) / (INNER + 1)
    first = noise[..., :1, :] * jnp.sin(jnp.pi * share)[:, None]
    second = 0.5 * noise[..., 1:2, :] * jnp.sin(2.0 * jnp.pi * share)[:, None]
    across = jnp.array([0.0, 1.0, 1.0, 0.0])[:CHANNELS]
    return (first + second) * across
