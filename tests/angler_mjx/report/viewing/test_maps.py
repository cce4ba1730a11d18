"""The map of a world: what stands where on it."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import PatchCollection
from matplotlib.quiver import Quiver

from angler_mjx.report.plotting import style
from angler_mjx.report.viewing.maps import world_map as maps


@pytest.fixture(scope="module")
def figure(scene):
    return maps.plot_world(scene, title="title", subtitle="subtitle")


def _texts(axes):
    return {text.get_text(): text for text in axes.texts}


def test_each_failure_has_a_cross_where_it_happened_with_its_cause(figure, scene):
    for axes, plane in zip(figure.axes, ((0, 1), (0, 2)), strict=True):
        shown = _texts(axes)
        for robot, cause in zip(scene.robots[1:], ("rock", "obstacle", "time out"), strict=True):
            place = shown[f"{robot.index}: {cause}"].xy
            np.testing.assert_allclose(place, robot.failure_m[list(plane)])
        assert not [text for text in shown if text.startswith("0: ")]


def test_a_square_stands_for_each_column_of_rock(figure, scene):
    occupied = scene.environment.grid.occupied
    for axes, depth in zip(figure.axes, (2, 1), strict=True):
        rock = next(c for c in axes.collections if isinstance(c, PatchCollection))
        assert len(rock.get_paths()) == occupied.any(axis=depth).sum()


def test_rock_is_lighter_where_it_is_higher(figure, scene):
    grid = scene.environment.grid
    top = grid.occupied.shape[2] - 1 - grid.occupied[:, :, ::-1].argmax(axis=2)
    rock = next(c for c in figure.axes[0].collections if isinstance(c, PatchCollection))
    light = rock.get_facecolor()[:, :3].sum(axis=1)
    order = np.argsort(top[grid.occupied.any(axis=2)], kind="stable")
    assert np.all(np.diff(light[order]) >= 0)


def test_arrows_are_the_current_at_their_place(figure, scene):
    arrows = next(c for c in figure.axes[0].collections if isinstance(c, Quiver))
    places = np.c_[arrows.XY, np.full(len(arrows.XY), -14.0)]
    flow = scene.current_at(places, 0.0)
    # The map asks for them in float32.
    np.testing.assert_allclose(np.c_[arrows.U, arrows.V], flow[:, :2], atol=1e-5)


def test_the_way_taken_ends_with_the_episode(figure, scene):
    robot = scene.robots[1]
    ways = [
        line.get_xydata()
        for line in figure.axes[0].lines
        if line.get_color() == style.robot_color(1) and line.get_linestyle() == "-"
    ]
    taken = max(ways, key=len)
    np.testing.assert_allclose(taken[-1], robot.failure_m[:2])


def test_description_counts_arrivals_and_causes(scene):
    text = maps.describe_outcomes(scene)
    assert text.startswith("1 of 4 robots arrived")
    assert "1 hit rock or floor" in text
    assert "1 ran out of time" in text


def test_a_world_of_still_water_without_rock_and_obstacles_can_be_drawn(scene, tmp_path):
    environment = scene.environment
    bare = replace(
        scene,
        environment=replace(
            environment,
            grid=replace(environment.grid, occupied=np.zeros((4, 6, 3), bool)),
            obstacles=replace(environment.obstacles, exists=np.zeros(12, bool)),
            current=(),
        ),
    )
    path = style.save_figure(
        maps.plot_world(bare, title="bare", subtitle=""), tmp_path / "bare.png"
    )
    assert path.read_bytes().startswith(b"\x89PNG")


def test_a_large_fleet_is_drawn_whole_but_listed_in_part(scene):
    many = tuple(replace(scene.robots[i % 4], index=i) for i in range(30))
    crowd = replace(scene, robots=many)
    figure = maps.plot_world(crowd, title="crowd", subtitle="")
    listed = [text.get_text() for text in figure.legends[0].get_texts()]
    assert listed[-1] == "... and 18 more"
    starts = {text.get_text() for text in figure.axes[0].texts}
    assert {str(i) for i in range(30)} <= starts
