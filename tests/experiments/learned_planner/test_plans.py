"""What the planner hands out, judged by an independent reading in NumPy."""

import itertools
from functools import partial

import jax
import numpy as np
import pytest

from angler_experiments.learned_planner import path_encoding
from angler_experiments.learned_planner.planner import LearnedPlanner, LearnedSettings
from angler_experiments.learned_planner.scene import build_frames

STEP_S = 0.05


def _positions(path, world, robot, time):
    when, where = path.time_s[world, robot], path.position_m[world, robot]
    return np.stack([np.interp(time, when, where[:, k]) for k in range(3)], axis=-1)


def test_most_robots_have_a_path(answered):
    assert answered.found.mean() > 0.5


def test_paths_go_from_start_to_goal_and_keep_the_cruise_speed(planned, answered):
    problems = planned[1]
    team = jax.tree.map(np.asarray, problems.team)
    assert answered.time_s.shape == (4, 4, 32)
    for world, robot in np.argwhere(answered.found):
        time, position = answered.time_s[world, robot], answered.position_m[world, robot]
        np.testing.assert_allclose(position[0], team.start_m[world, robot], atol=1e-4)
        np.testing.assert_allclose(position[-1], team.goal_m[world, robot], atol=1e-4)
        assert time[0] == 0.0
        assert time[-1] <= problems.horizon_s
        span, leg = np.diff(time), np.linalg.norm(np.diff(position, axis=0), axis=1)
        assert (span >= 0.0).all()
        assert (leg <= team.cruise_speed_mps[world, robot] * span * (1 + 1e-4) + 1e-5).all()
        assert time[-1] > 1.0


def test_who_has_none_holds_its_start(planned, answered):
    start = np.asarray(planned[1].team.start_m)
    for world, robot in np.argwhere(~answered.found):
        np.testing.assert_array_equal(
            answered.position_m[world, robot], np.tile(start[world, robot], (32, 1))
        )


def test_no_two_paths_meet_whoever_stands(planned, answered):
    radius = np.asarray(planned[1].team.radius_m)
    time = np.arange(0.0, 60.0, STEP_S)
    for world in range(4):
        position = [_positions(answered, world, robot, time) for robot in range(4)]
        for a, b in itertools.combinations(range(4), 2):
            if answered.found[world, a] or answered.found[world, b]:
                gap = np.linalg.norm(position[a] - position[b], axis=1).min()
                assert gap > radius[world, a] + radius[world, b] + 0.1 - 2e-3


def test_no_path_touches_rock_faces_or_floor(planned, answered):
    problems = planned[1]
    grid = jax.tree.map(np.asarray, problems.grid)
    radius, floor = np.asarray(problems.team.radius_m), np.asarray(problems.floor_z_m)
    assert grid.occupied.any(axis=(1, 2, 3)).all()
    for world, robot in np.argwhere(answered.found):
        end = answered.time_s[world, robot, -1]
        position = _positions(answered, world, robot, np.arange(0.0, end, STEP_S)).astype(float)
        need = radius[world, robot] + 0.1 - 2e-3
        origin, cell = grid.origin_m[world], grid.cell_m[world]
        low = origin + cell * np.argwhere(grid.occupied[world])
        nearest = np.clip(position[:, None], low, low + cell)
        gap = np.linalg.norm(position[:, None] - nearest, axis=-1)
        assert gap.min() > need
        top = origin + cell * np.array(grid.occupied.shape[1:])
        assert (position - origin).min() > need
        assert (top - position).min() > need
        assert position[:, 2].min() - floor[world] > need


def test_no_path_meets_obstacles_that_go_on_as_observed(planned, answered):
    problems = planned[1]
    bodies = jax.tree.map(np.asarray, problems.obstacles)
    radius = np.asarray(problems.team.radius_m)
    assert bodies.exists.any()
    for world, robot in np.argwhere(answered.found):
        time = np.arange(0.0, answered.time_s[world, robot, -1], STEP_S)
        position = _positions(answered, world, robot, time)
        for body in np.flatnonzero(bodies.exists[world]):
            there = bodies.p_m[world, body, 0] + time[:, None] * bodies.velocity_mps[world, body]
            gap = np.linalg.norm(position - there, axis=1).min()
            assert gap > bodies.radius_m[world, body] + radius[world, robot] + 0.1 - 2e-3


@pytest.mark.parametrize("robot", [0, 3])
def test_a_way_of_a_path_leads_back_near_to_it(planned, robot):
    worlds, problems = planned
    problem = jax.tree.map(lambda leaf: leaf[0], problems)
    path = jax.tree.map(lambda leaf: leaf[0, robot], worlds.path)
    assert path.found
    frame = jax.tree.map(lambda leaf: leaf[robot], build_frames(problem))
    speed = problem.team.cruise_speed_mps[robot]
    encoded = path_encoding.encode_path(path, frame, speed)
    position = np.asarray(path_encoding.decode_points(encoded, frame, problem.team.goal_m[robot]))
    corner = np.asarray(path.position_m, float)
    begin, leg = corner[:-1], np.diff(corner, axis=0)
    square = np.maximum((leg**2).sum(axis=1), 1e-12)
    share = np.clip(((position[:, None] - begin) * leg).sum(axis=-1) / square, 0.0, 1.0)
    off = np.linalg.norm(position[:, None] - (begin + share[..., None] * leg), axis=-1).min(axis=1)
    assert off.max() < 1e-3
    time, _ = path_encoding.time_path(
        position, path_encoding.decode_delays_s(encoded), np.float32(0.0), speed
    )
    # Corners are cut, so it is not later than the path; delays are kept.
    assert 0.8 * path.time_s[-1] < time[-1] < path.time_s[-1] + 0.5


@pytest.mark.nightly(
    by="tests/experiments/learned_planner/test_plans.py::test_no_two_paths_meet_whoever_stands"
)
def test_the_first_of_several_answers_is_the_one_that_is_given(planned, answered):
    planner = LearnedPlanner(LearnedSettings(samples=4, steps=2, rounds=2))
    teams = jax.jit(partial(planner.plan_teams, teams=3))(planned[1])
    assert teams.found.shape == (4, 3, 4)
    np.testing.assert_array_equal(teams.found[:, 0], answered.found)
    np.testing.assert_allclose(teams.position_m[:, 0], answered.position_m, atol=1e-4)
    assert np.abs(np.asarray(teams.position_m[:, 1:] - teams.position_m[:, :1])).max() > 0.1
