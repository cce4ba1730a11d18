"""Flights ahead of teams: the best of several answers by simulation with the available information.

A planner's problem holds no vehicles; the owner of a simulator can fly. The robots are then those
of the simulator, with their controllers, in the current as known; moving bodies are left out of the
flight, and its samples are checked against their known positions.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.planner import PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.information import ObstacleInformation
from angler_mjx.sim.state import Outcome, World
from angler_mjx.world.obstacles.types import STATIC

SAMPLE_HZ = 2.0
"""Sample rate of a flight ahead."""


def restrict_to_information(worlds: World, problems: Problem) -> World:
    """Return worlds reduced to the available information: the water, and fixed bodies."""
    environment = worlds.environment
    bodies = environment.obstacles
    static_bodies = replace(bodies, exists=bodies.exists & (bodies.motion == STATIC))
    components = problems.current.components
    return replace(
        worlds, environment=replace(environment, obstacles=static_bodies, current=components)
    )


class LookaheadSimulator:
    """Simulator of teams with the available information."""

    def __init__(self, scenario: Scenario) -> None:
        """Set up a simulator; it is compiled at its first use.

        Args:
            scenario: scenario with worlds of one tile.
        """
        sampled_time = scenario.time.model_copy(update={"record_hz": SAMPLE_HZ})
        self._simulator = Simulator(
            scenario.model_copy(update={"time": sampled_time}),
            tile=scenario.worlds,
            paths=PathShape(points=scenario.planner.points),
        )

    def select_best(self, worlds: World, teams: Trajectory, problems: Problem) -> Trajectory:
        """Return of each world's teams the one with most arrivals; of equals the first.

        Args:
            worlds: true worlds.
            teams: paths [world, team, robot].
            problems: problems of the worlds.
        """
        reduced_worlds = restrict_to_information(worlds, problems)
        candidates = [
            jax.tree.map(partial(_select_team, k), teams) for k in range(teams.found.shape[1])
        ]
        safe = jnp.stack(
            [self._count_safe(reduced_worlds, candidate, problems) for candidate in candidates],
            axis=1,
        )
        rows, best_index = jnp.arange(safe.shape[0]), jnp.argmax(safe, axis=1)
        chosen: Trajectory = jax.tree.map(lambda leaf: leaf[rows, best_index], teams)
        return chosen

    def _count_safe(self, reduced_worlds: World, path: Trajectory, problems: Problem) -> jax.Array:
        """Count robots [world] that arrive and meet no body at its known position."""
        simulator = self._simulator
        worlds = simulator.with_paths(reduced_worlds, path)
        state = simulator.reset(worlds)
        min_gap_m = jnp.full(path.found.shape, jnp.inf)
        step_s = simulator.steps_per_sample * simulator.spec.control_dt_s
        for segment in range(simulator.segments):
            state, sample, running = simulator.advance(worlds, state)
            time = (segment * simulator.samples + jnp.arange(simulator.samples)) * step_s
            gap_m = _compute_gaps(problems.obstacles, sample.p, time)
            is_flying = sample.outcome == Outcome.RUNNING
            min_gap_m = jnp.minimum(
                min_gap_m, jnp.min(jnp.where(is_flying, gap_m, jnp.inf), axis=1)
            )
            if not np.asarray(running).any():
                break
        is_reached = state.tally.outcome == Outcome.REACHED
        return jnp.sum(is_reached & (min_gap_m > problems.team.radius_m), axis=1)


def _select_team(k: int, leaf: jax.Array) -> jax.Array:
    return leaf[:, k]


@jax.jit
def _compute_gaps(
    obstacles: ObstacleInformation, position_m: jax.Array, time: jax.Array
) -> jax.Array:
    """Return distances [world, time, robot] of samples [world, time, robot, 3] to bodies, m."""

    def of_world(obstacles: ObstacleInformation, position_m: jax.Array) -> jax.Array:
        if obstacles.radius_m.shape[0] == 0:
            return jnp.full(position_m.shape[:2], jnp.inf)

        def of_body(start_m: jax.Array, velocity: jax.Array) -> jax.Array:
            if obstacles.time_s.shape[0] == 1:
                return start_m[0] + time[:, None] * velocity
            return jax.vmap(partial(jnp.interp, time, obstacles.time_s), 1, 1)(start_m)

        bodies = jax.vmap(of_body)(obstacles.p_m, obstacles.velocity_mps)
        offset = position_m[None] - bodies[:, :, None]
        gap = jnp.sqrt(jnp.sum(offset * offset, axis=-1)) - obstacles.radius_m[:, None, None]
        is_moving = obstacles.exists & obstacles.moves
        return jnp.min(jnp.where(is_moving[:, None, None], gap, jnp.inf), axis=0)

    return jax.vmap(of_world)(obstacles, position_m)
