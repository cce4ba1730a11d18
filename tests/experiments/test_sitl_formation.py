"""The formation of `sitl_formation`: it ends at the goals, and robots keep apart on the way."""

import numpy as np
import pytest

from angler_experiments.sitl_formation import MOVE_S, SCENARIO, build_goals, main, robot_positions
from angler_mjx.report.interop import joint_trajectory_file
from angler_mjx.scenario.scenario import load_scenario


@pytest.fixture(scope="module")
def world():
    return load_scenario(SCENARIO).world


def test_it_ends_at_the_goals_of_the_scenario(world):
    np.testing.assert_allclose(
        robot_positions(np.array(world.start_m), MOVE_S), world.goal_m, atol=1e-5
    )


def test_robots_keep_apart_on_the_way(world):
    start = np.array(world.start_m)
    for time_s in np.linspace(0.0, MOVE_S, 31):
        p = robot_positions(start, time_s)
        apart = np.linalg.norm(p[:, None] - p, axis=2) + 9.0 * np.eye(len(p))
        assert apart.min() > 2.0 - 1e-9  # as at the start


def test_velocities_are_those_of_the_places(world):
    made = build_goals(np.array(world.start_m))[5]
    point = made.points[7]
    ahead = robot_positions(np.array(world.start_m), point.time_s + 0.1)[5]
    predicted = np.array(point.positions) + 0.1 * np.array(point.velocities)
    predicted += 0.005 * np.array(point.accelerations)
    np.testing.assert_allclose(predicted, ahead, atol=1e-5)  # jerk of 0.02 m/s^3 times 0.1^3 / 6


def test_the_file_holds_all_robots(world, tmp_path):
    main(tmp_path / "formation.json")
    read = joint_trajectory_file.read_trajectories(
        tmp_path / "formation.json", robots=len(world.start_m)
    )
    assert read == build_goals(np.array(world.start_m))
