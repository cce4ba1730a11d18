"""Two runs of one world beside each other: what is chosen, and what is drawn where."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import same_color
from matplotlib.patches import Circle, Polygon, Rectangle

from angler_mjx.errors import ConfigError
from angler_mjx.report.plotting import style
from angler_mjx.report.viewing.maps import comparison, comparison_map

from ..conftest import make_run, make_scene


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
    what = comparison.read_comparison(runs, None, None, ())
    assert (what.scenes[0].world, what.robot) == (1, 1)
    assert what.at_s == (12.0, 16.0, 20.0)
    assert comparison.read_comparison(runs, 0, None, ()).robot == 0
    assert comparison.read_comparison(runs, 1, 2, (3.0,)).at_s == (3.0,)


def test_robots_are_drawn_where_they_were_recorded(runs):
    what = comparison.read_comparison(runs, 1, 1, (5.0, 30.0))
    figure = comparison_map.plot_comparison(what)
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


def test_ways_end_where_the_robot_is_and_plans_of_the_start_are_drawn(runs):
    what = comparison.read_comparison(runs, 1, 1, (5.0, 18.0))
    for panel, axes in enumerate(comparison_map.plot_comparison(what).axes):
        robot, row = what.scenes[0].robots[1], round(what.at_s[panel % 2] / 0.2)
        lines = {line.get_linewidth(): line for line in axes.lines if drawn_as(line, 1)}
        np.testing.assert_allclose(lines[2.2].get_xydata(), robot.p_m[: row + 1, :2], atol=1e-6)
        np.testing.assert_allclose(lines[1.0].get_xydata()[0], robot.p_m[row, :2], atol=1e-6)
        np.testing.assert_allclose(lines[1.2].get_xydata(), robot.plan_m[:, :2], atol=1e-6)


def drawn_as(line, robot):
    return same_color(line.get_color(), style.robot_color(robot)) and line.get_marker() == "None"


def test_obstacles_are_drawn_where_they_were_and_rock_of_the_robots_layer_alone(runs):
    what = comparison.read_comparison(runs, 1, 0, (38.0, 50.0))
    one = what.scenes[0]
    grid, moved = one.environment.grid, 0
    for axes, t in zip(comparison_map.plot_comparison(what).axes[:2], what.at_s, strict=True):
        row = round(t / 0.2)
        shapes = [patch for patch in axes.patches if isinstance(patch, Polygon)]
        assert shapes
        for shape in shapes:  # outlines are symmetric about the centre
            corners = shape.get_xy()[:-1]
            middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
            gaps = np.linalg.norm(one.obstacle_p_m[row, :, :2] - middle, axis=1)
            assert gaps.min() < 1e-3
            at_start = one.obstacle_p_m[0, gaps.argmin(), :2]
            moved += t > 30.0 and np.linalg.norm(at_start - middle) > 1.0
        layer = int((one.robots[0].p_m[row, 2] - grid.origin_m[2]) // grid.cell_m)
        cells = {tuple(c) for c in np.argwhere(grid.occupied[:, :, layer])}
        squares = [p for p in axes.patches if isinstance(p, Rectangle) and p.get_zorder() == 1]
        origin = grid.origin_m[:2]
        drawn = [np.rint((np.array(p.get_xy()) - origin) / grid.cell_m) for p in squares]
        assert {tuple(c.astype(int)) for c in drawn} == cells
    assert moved


def test_all_pictures_have_one_scale_and_say_what_is_over(runs, tmp_path):
    short = make_scene(1)
    ends = [replace(r, end_time_s=min(r.end_time_s, 30.0)) for r in short.robots]
    cut = make_run(tmp_path / "d", [make_scene(0), replace(short, robots=tuple(ends))], 2)
    what = comparison.read_comparison([runs[1], cut], 1, 0, (10.0, 25.0, 50.0))
    axes = comparison_map.plot_comparison(what).axes
    sizes = [np.ptp(a.get_xlim()) for a in axes] + [np.ptp(a.get_ylim()) for a in axes]
    np.testing.assert_allclose(sizes, sizes[0])
    assert len({comparison_map._view_window(what, t)[1] for t in what.at_s}) > 1
    over = ["over since 30 s" in a.get_title(loc="left") for a in axes]
    assert over == [False] * 5 + [True]


def test_runs_of_other_worlds_are_refused(runs, tmp_path):
    other = [runs[0], make_run(tmp_path / "c", [make_scene(3), make_scene(4)], 2)]
    with pytest.raises(ConfigError, match=r"world 0 differs .*; give two runs of one scenario"):
        comparison.read_comparison(other, 0, None, ())
    for world, robot, at, says in (
        (7, None, (), "world 7 is not in"),
        (1, 9, (), "--robot 9: "),
        (1, 1, (61.0,), "--at 61: must be 0 to 60 s"),
    ):
        with pytest.raises(ConfigError, match=says):
            comparison.read_comparison(runs, world, robot, at)
