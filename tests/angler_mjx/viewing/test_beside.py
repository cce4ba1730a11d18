"""Two runs of one world beside each other: what is chosen, and what is drawn where."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.patches import Circle

from angler_mjx.errors import ConfigError
from angler_mjx.viewing.maps import beside

from .conftest import make_run, make_scene


def otherwise(scene, **robot_1):
    """The same world, in which robot 1 fares differently."""
    robots = [replace(one, **robot_1) if one.index == 1 else one for one in scene.robots]
    return replace(scene, robots=tuple(robots))


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Robot 1 hits rock after 20 s in the first run and arrives in the second."""
    place, scenes = tmp_path_factory.mktemp("beside"), [make_scene(0), make_scene(1)]
    there = dict(outcome="reached", end_time_s=50.0, failure_pair="none")
    well = [scenes[0], otherwise(scenes[1], **there, failure_m=np.full(3, np.nan))]
    return [make_run(place / name, some, 2) for name, some in (("a", scenes), ("b", well))]


def test_the_robot_that_ends_differently_is_shown_before_it_fails(runs):
    what = beside.choose(runs, None, None, ())
    assert (what.scenes[0].world, what.robot) == (1, 1)
    assert what.at_s == (12.0, 16.0, 20.0)
    assert beside.choose(runs, 0, None, ()).robot == 0
    assert beside.choose(runs, 1, 2, (3.0,)).at_s == (3.0,)


def test_robots_are_drawn_where_they_were_recorded(runs):
    what = beside.choose(runs, 1, 1, (5.0, 30.0))
    figure = beside.draw(what)
    assert len(figure.axes) == 4
    for panel, axes in enumerate(figure.axes):
        one, t = what.scenes[panel // 2], what.at_s[panel % 2]
        discs = [patch for patch in axes.patches if isinstance(patch, Circle)]
        for disc, robot in zip(discs, one.robots, strict=True):
            row = round(min(t, robot.end_time_s) / 0.2)
            np.testing.assert_allclose(disc.center, robot.p_m[row, :2], atol=1e-6)
        # The robot, or where it was lost, is inside of what is seen.
        x, y = discs[1].center
        assert axes.get_xlim()[0] < x < axes.get_xlim()[1]
        assert axes.get_ylim()[0] < y < axes.get_ylim()[1]
    # Only after its failure, and in the first run alone.
    crosses = [sum(line.get_marker() == "X" for line in axes.lines) for axes in figure.axes]
    assert crosses == [0, 1, 0, 0]


def test_runs_of_other_worlds_are_refused(runs, tmp_path):
    other = [runs[0], make_run(tmp_path / "c", [make_scene(3), make_scene(4)], 2)]
    with pytest.raises(ConfigError, match=r"world 0 differs .*; give two runs of one scenario"):
        beside.choose(other, 0, None, ())
    for world, robot, at, says in (
        (7, None, (), "world 7 is not in"),
        (1, 9, (), "--robot 9: "),
        (1, 1, (500.0,), "--at 500: must be 0 to 120 s"),
    ):
        with pytest.raises(ConfigError, match=says):
            beside.choose(runs, world, robot, at)
