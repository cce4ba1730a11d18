"""Flights ahead: in nothing but what is told, and the best of several answers."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.learned_planner.evaluate import lookahead
from angler_experiments.learned_planner.evaluate.lookahead import LookaheadSimulator
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.world.currents import Uniform


def test_nothing_that_moves_is_left_and_the_water_is_as_told(planned):
    worlds, problems = planned
    assert np.asarray(worlds.environment.obstacles.exists).any()
    water = (Uniform(velocity_mps=jnp.full((4, 3), 0.25)),)
    restricted = lookahead.restrict_to_information(
        worlds, replace(problems, current=replace(problems.current, components=water))
    )
    assert not np.asarray(restricted.environment.obstacles.exists).any()
    assert restricted.environment.current is water
    np.testing.assert_array_equal(
        restricted.environment.grid.occupied, worlds.environment.grid.occupied
    )


def test_distances_are_to_where_bodies_are_told_to_be(planned):
    moving = planned[1].obstacles
    time = np.array([0.0, 3.0, 20.0], np.float32)
    position = np.random.default_rng(0).uniform(-12.0, 0.0, (4, 3, 2, 3)).astype(np.float32)
    found = np.asarray(lookahead._compute_gaps(moving, jnp.asarray(position), jnp.asarray(time)))
    there = jax.tree.map(np.asarray, moving)
    counts = there.exists & there.moves
    assert counts.any()
    for world, when, robot in np.ndindex(4, 3, 2):
        bodies = there.p_m[world, :, 0] + time[when] * there.velocity_mps[world]
        gap = np.linalg.norm(position[world, when, robot] - bodies, axis=1) - there.radius_m[world]
        expected = gap[counts[world]].min() if counts[world].any() else np.inf
        np.testing.assert_allclose(found[world, when, robot], expected, rtol=1e-4, atol=1e-3)


def test_the_best_answer_is_taken_and_of_equals_the_first(monkeypatch):
    safe = np.array([[1, 3, 2], [2, 2, 2], [0, 1, 4]])
    monkeypatch.setattr(lookahead, "restrict_to_information", lambda worlds, problems: None)
    flies = SimpleNamespace(
        _count_safe=lambda restricted, path, _: jnp.asarray(path.time_s[:, 0, 0])
    )
    teams = Trajectory(
        time_s=jnp.broadcast_to(jnp.asarray(safe)[:, :, None, None], (3, 3, 2, 5)),
        position_m=jnp.broadcast_to(jnp.arange(3.0)[None, :, None, None, None], (3, 3, 2, 5, 3)),
        found=jnp.ones((3, 3, 2), bool),
    )
    chosen = LookaheadSimulator.select_best(flies, None, teams, None)
    np.testing.assert_array_equal(chosen.position_m[:, 0, 0, 0], [1.0, 0.0, 2.0])
    assert chosen.found.shape == (3, 2)
