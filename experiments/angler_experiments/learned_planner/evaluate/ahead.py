"""Teams flown ahead: the best of several answers, by a flight in the engine in what is told.

A planner is asked by a problem, which holds no vehicles; whoever has a simulator can fly. The
robots are then those of the simulator, with their controllers, in the current as it is told; bodies
that move are left out of the flight, and its samples are held against the places that are told.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.planner import PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.information import ObstacleInformation
from angler_mjx.sim.state import Outcome, World
from angler_mjx.world.obstacles.types import STATIC

HZ = 2.0
"""Samples of a flight ahead."""


def as_told(worlds: World, problems: Problem) -> World:
    """Worlds in which nothing is but what was told: the water, and bodies that stand."""
    around = worlds.environment
    bodies = around.obstacles
    stand = replace(bodies, exists=bodies.exists & (bodies.motion == STATIC))
    components = problems.current.components
    return replace(worlds, environment=replace(around, obstacles=stand, current=components))


class Ahead:
    """Flies teams in what is told."""

    def __init__(self, scenario: Scenario) -> None:
        """With a simulator of its own; it is compiled when first asked.

        Args:
            scenario: whose worlds are one tile.
        """
        sampled = scenario.time.model_copy(update={"record_hz": HZ})
        self._simulator = Simulator(
            scenario.model_copy(update={"time": sampled}),
            tile=scenario.worlds,
            paths=PathShape(points=scenario.planner.points),
        )

    def best(self, worlds: World, teams: Trajectory, problems: Problem) -> Trajectory:
        """Of each world's teams that of which most robots arrive; of equals the first.

        Args:
            worlds: as they are.
            teams: paths [world, team, robot].
            problems: what is told of the worlds.
        """
        told = as_told(worlds, problems)
        each = [jax.tree.map(partial(_team, k), teams) for k in range(teams.found.shape[1])]
        safe = jnp.stack([self._safe(told, one, problems) for one in each], axis=1)
        rows, which = jnp.arange(safe.shape[0]), jnp.argmax(safe, axis=1)
        chosen: Trajectory = jax.tree.map(lambda leaf: leaf[rows, which], teams)
        return chosen

    def _safe(self, told: World, path: Trajectory, problems: Problem) -> jax.Array:
        """Robots [world] that arrive and meet no body where it was told to be."""
        simulator = self._simulator
        worlds = simulator.with_paths(told, path)
        state = simulator.reset(worlds)
        near = jnp.full(path.found.shape, jnp.inf)
        step_s = simulator.steps_per_sample * simulator.spec.control_dt_s
        for segment in range(simulator.segments):
            state, sample, running = simulator.advance(worlds, state)
            time = (segment * simulator.samples + jnp.arange(simulator.samples)) * step_s
            gap = _gaps(problems.obstacles, sample.p, time)
            flies = sample.outcome == Outcome.RUNNING
            near = jnp.minimum(near, jnp.min(jnp.where(flies, gap, jnp.inf), axis=1))
            if not np.asarray(running).any():
                break
        reached = state.tally.outcome == Outcome.REACHED
        return jnp.sum(reached & (near > problems.team.radius_m), axis=1)


def _team(k: int, leaf: jax.Array) -> jax.Array:
    return leaf[:, k]


@jax.jit
def _gaps(known: ObstacleInformation, place: jax.Array, time: jax.Array) -> jax.Array:
    """Distances [world, time, robot] of samples [world, time, robot, 3] to what moves, m."""

    def of_world(known: ObstacleInformation, place: jax.Array) -> jax.Array:
        if known.radius_m.shape[0] == 0:
            return jnp.full(place.shape[:2], jnp.inf)

        def of_body(there: jax.Array, rate: jax.Array) -> jax.Array:
            if known.time_s.shape[0] == 1:
                return there[0] + time[:, None] * rate
            return jax.vmap(partial(jnp.interp, time, known.time_s), 1, 1)(there)

        bodies = jax.vmap(of_body)(known.p_m, known.velocity_mps)
        off = place[None] - bodies[:, :, None]
        gap = jnp.sqrt(jnp.sum(off * off, axis=-1)) - known.radius_m[:, None, None]
        counts = known.exists & known.moves
        return jnp.min(jnp.where(counts[:, None, None], gap, jnp.inf), axis=0)

    return jax.vmap(of_world)(known, place)
