"""Windows against the episodes that they are cut from."""

import pickle

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.learning import datasets
from angler_mjx.learning.datasets.windows import Windows


@pytest.fixture(scope="module")
def data(made):
    return datasets.open(made)


def test_windows_are_episodes_padded_and_masked(data):
    windows = Windows(data, 5, stride=2, every=2)
    starts = np.maximum((data.samples - 9) // 2 + 1, 0)
    assert len(windows) == starts.sum()
    seen = set()
    for window in windows:
        i, first = int(window["episode"]), int(window["first"])
        seen.add((i, first))
        episode, times = data.episode(i), slice(first, first + 9, 2)
        team = episode.running.shape[1]
        np.testing.assert_array_equal(window["p_m"][:, :team], episode.arrays["p_m"][times])
        assert not window["p_m"][:, team:].any()
        np.testing.assert_array_equal(window["mask"][:, :team], episode.running[times])
        assert not window["mask"][:, team:].any()
        np.testing.assert_array_equal(window["goal_m"][:team], episode.goal_m)
        assert window["p_m"].shape == (5, 2, 3)
        assert window["obstacle_p_m"].shape == (5, 2, 3)
        assert window["obstacle_mask"].all()
    assert len(seen) == len(windows)
    with pytest.raises(IndexError):
        windows[len(windows)]


def test_windows_of_robots_lead_with_the_robot_and_its_nearest(data):
    windows, of_teams = Windows(data, 4, of="robot", neighbours=1), Windows(data, 4)
    count = {0: 0, 1: 0}
    for window in windows:
        i, first = int(window["episode"]), int(window["first"])
        episode = data.episode(i)
        positions_m = episode.arrays["p_m"][first : first + 4]
        leading = [
            robot
            for robot in range(positions_m.shape[1])
            if np.array_equal(positions_m[:, robot], window["p_m"][:, 0])
            and np.array_equal(episode.goal_m[robot], window["goal_m"][0])
        ]
        assert leading
        count[leading[0]] += 1
        if positions_m.shape[1] == 2:
            np.testing.assert_array_equal(window["p_m"][:, 1], positions_m[:, 1 - leading[0]])
        else:
            assert not window["mask"][:, 1].any()
    assert len(windows) == count[0] + count[1]
    assert count[0] == len(of_teams)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"length": 0}, "length = 0: must be 1 or more"),
        ({"length": 10_000}, "longest episode has"),
        ({"length": 2, "stride": 0}, "stride = 0: must be 1 or more"),
        ({"length": 2, "every": 0}, "every = 0: must be 1 or more"),
        ({"length": 2, "of": "fleet"}, '"team" or "robot"'),
        ({"length": 2, "neighbours": 2}, "of windows of single robots"),
        ({"length": 2, "of": "robot", "neighbours": -1}, "neighbours = -1: must be 0 or more"),
    ],
)
def test_settings_out_of_range_are_refused(data, settings, message):
    with pytest.raises(ConfigError, match=message):
        Windows(data, **settings)


def test_windows_without_obstacles_have_no_arrays_of_them(made):
    window = Windows(datasets.open(made, fields=("p_m", "q")), 4)[0]
    assert window.keys() == {"p_m", "q", "mask", "goal_m", "episode", "first"}


def test_pickled_windows_are_the_same(data):
    windows = Windows(data, 4)
    copied = pickle.loads(pickle.dumps(windows))
    for name, values in windows[2].items():
        np.testing.assert_array_equal(copied[2][name], values)
