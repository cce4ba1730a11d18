"""Worlds read back from a run folder, and the figures drawn from it alone."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.report.plotting import scene
from angler_mjx.report.viewing import figures
from angler_mjx.robot.control.plans import PIECES


def test_a_world_is_read_back_as_it_was_written(run, scene_maker):
    read, written = scene.read_scene(run, 1), scene_maker(1)
    last = max(robot.end_time_s for robot in written.robots)
    assert read.time_s[-1] <= last < read.time_s[-1] + 0.2 + 1e-9
    count = read.time_s.size
    for got, wanted in zip(read.robots, written.robots, strict=True):
        # Positions up to 40 m are stored as float32: half a unit in the last place is 2e-6 m.
        np.testing.assert_allclose(got.p_m, wanted.p_m[:count], atol=2e-6)
        np.testing.assert_allclose(got.plan_m, wanted.plan_m, atol=2e-6)
        np.testing.assert_allclose(got.failure_m, wanted.failure_m, atol=2e-6)
        assert (got.outcome, got.end_time_s, got.failure_pair) == (
            wanted.outcome,
            wanted.end_time_s,
            wanted.failure_pair,
        )
    jax.tree.map(np.testing.assert_array_equal, read.environment, written.environment)


def test_plans_with_velocities_are_shown_as_they_bend(jointed, scene_maker):
    run, motion = jointed
    read, written = scene.read_scene(run, 1), scene_maker(1)
    for i, (got, robot) in enumerate(zip(read.robots, written.robots, strict=True)):
        points = np.asarray(robot.plan_m, np.float32)
        # Two segments of so many pieces, through the way-points; padding dropped.
        assert got.plan_m.shape == (1 + 2 * PIECES, 3)
        np.testing.assert_allclose(got.plan_m[::PIECES], points, atol=1e-5)
        u, v = motion["plan_velocity"][1, i, :2, :3]
        half = 0.5 * (points[0] + points[1]) + 30.0 / 8 * (u - v)
        np.testing.assert_allclose(got.plan_m[PIECES // 2], half, atol=1e-5)


def test_the_current_of_a_stored_world_is_the_one_that_was_there(run, scene_maker):
    points = np.random.default_rng(0).uniform(-10.0, 10.0, (20, 3))
    read, written = scene.read_scene(run, 0), scene_maker(0)
    np.testing.assert_array_equal(read.current_at(points, 3.0), written.current_at(points, 3.0))


def test_all_figures_are_drawn_from_the_folder(run):
    paths = figures.plot_figures(run)
    assert [path.name for path in paths] == [
        "outcomes.png",
        "distances.png",
        "time_to_goal.png",
        "map_world_0.png",
    ]  # both worlds went alike, so the first one is the worst and the good one
    assert all(path.parent == run.path / "figures" for path in paths)
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


def test_worlds_can_be_named(run):
    assert figures.plot_figures(run, [1])[-1].name == "map_world_1.png"


def test_an_unknown_world_is_an_error(run):
    with pytest.raises(ConfigError, match="world 7 is not in"):
        figures.plot_figures(run, [7])


def test_without_trajectories_the_maps_are_left_out(run, tmp_path):
    scenario = run.scenario.model_copy(
        update={"time": run.scenario.time.model_copy(update={"record_hz": 0.0})}
    )
    bare = SimpleNamespace(path=tmp_path, scenario=scenario, episodes=run.episodes)
    assert len(figures.plot_figures(bare)) == 3
